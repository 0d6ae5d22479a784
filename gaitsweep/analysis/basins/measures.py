"""Basin measures: fractions, basin entropies, uncertainty exponent, minimal fatal shocks."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd
from jaxtyping import Float, Shaped

from gaitsweep.analysis.basins.attractors import with_attractors
from gaitsweep.analysis.basins.basin_boundaries import (
    ENTROPY_BOX,
    Uncertainty,
    basin_entropy,
    uncertainty_exponent,
    uncertainty_fraction,
)
from gaitsweep.analysis.basins.fractions import LEVEL, Interval, fractions, panels_and_axes
from gaitsweep.analysis.basins.grid import BasinGrid, find_grid
from gaitsweep.analysis.basins.state_space import Space
from gaitsweep.analysis.records import (
    AnalysisError,
    in_order,
    names_in,
    outcome_labels,
    panels_of,
    require,
    require_rows,
)

# Values of the column `recovery` of a gait that is lost.
FATAL = ("elsewhere", "fell", "failed")
_PANEL_COLUMNS = [
    *("rows", "grid", "basin_entropy", "boundary_entropy", "crossed"),
    *("exponent", "exponent_low", "exponent_high", "boundary_dimension"),
]


@dataclasses.dataclass(frozen=True)
class Basins:
    """The measures of the basins in a table.

    `rows`: the table with the columns outcome (category), shock (distance to the nearest start with another
    outcome; NaN where the axes have different units and no scale) and shock_to (that outcome). `fractions`:
    one record for each panel and outcome (rows, of, fraction, low, high, interval, shock_median, shock_mean
    of its starts). `panels`: one record a panel (rows, grid: whether its starts form a grid, basin_entropy,
    boundary_entropy, crossed, exponent, exponent_low, exponent_high, boundary_dimension). `uncertainty`: one
    record for each panel and eps (steps, eps, uncertain).
    """

    rows: pd.DataFrame
    fractions: pd.DataFrame
    panels: pd.DataFrame
    uncertainty: pd.DataFrame


def basins(
    table: pd.DataFrame | Sequence[pd.DataFrame],
    axes: str | Sequence[str] | None = None,
    *,
    label: str = "gait",
    by: str | Sequence[str] = (),
    level: float = LEVEL,
    interval: Interval | None = None,
    box: int = ENTROPY_BOX,
    sizes: Sequence[int] | None = None,
    scales: Mapping[str, float] | None = None,
) -> Basins:
    """Measure the basins of a settle table, refined or not, with grid or random starts.

    Args:
        table: a settle table, or several that differ in constants, which `by` then names; rows that were
            inferred count as others do.
        axes: the columns of the starts that span the line, plane or space of the basins; by default the swept
            axes that are not in `by`.
        label: the column of the outcomes; `attractor` is computed if the table does not have it.
        by: columns, or constants of the table's job, of which each combination of values is a panel, measured
            separately.
        level: confidence level of the intervals.
        interval: as for `fractions`.
        box: cells along a side of the boxes of the basin entropy.
        sizes: eps of the uncertainty fractions, in steps of the grid; by default 1, 2, 4, ... up to an eighth
            of the shortest axis.
        scales: unit of each axis in the shock's distance; without them there is no shock where axes have
            different units, such as m/s and rad.

    Raises:
        AnalysisError: the table does not have a column or any row, no axis is left, or an argument is not
            allowed.

    Example:
        Two basins with a straight boundary at x = 0 have equal shares, and the boundary's dimension is 1:

        >>> import numpy as np, pandas as pd, gaitsweep as gs
        >>> x, y = np.reshape(np.meshgrid(np.arange(-31.5, 32.0), np.arange(64.0)), (2, -1))
        >>> gait = np.where(x < 0.0, "walk", "trot")
        >>> measured = gs.basins(pd.DataFrame({"x": x, "y": y, "status": "settled", "gait": gait}))
        >>> measured.fractions["fraction"].tolist()
        [0.5, 0.5]
        >>> measured.panels["boundary_dimension"].round(2).tolist()
        [1.0]
    """
    table, by, axes = panels_and_axes(table, by, axes)
    require_rows(table)
    for order in ("stair", "crossing", "point"):
        if order in table.columns and len(table[order].unique()) > 1:
            raise AnalysisError(
                f"The table has a record for each {order}, but basins count each start once: keep one, "
                f'such as table[table["{order}"] == {table[order].iloc[0]}], or run kind settle.'
            )
    if not axes:
        raise AnalysisError("No axis is left for the basins: name the columns of the starts as `axes`.")
    if not isinstance(box, int | np.integer) or box < 2:
        raise AnalysisError(f"box is {box}, but a box needs 2 cells along a side or a larger whole number.")
    if label == "attractor" and label not in table.columns:
        table = with_attractors(table)
    shares = fractions(table, axes, label=label, by=by, level=level, interval=interval)
    labels = outcome_labels(table, label)
    rows = _with_shocks(table, axes, label, labels, by, scales)
    panels: list[dict[str, object]] = []
    uncertainty: list[dict[str, object]] = []
    for panel, rows_of_panel in panels_of(table, by):
        grid = find_grid(table.iloc[rows_of_panel], axes)
        record = {**panel, "rows": len(rows_of_panel), "grid": grid is not None}
        if grid is not None:
            outcomes = labels.iloc[rows_of_panel].to_numpy()
            uncertain = uncertainty_fraction(grid, outcomes, sizes)
            uncertainty += [{**panel, **of_size} for of_size in uncertain.fractions.to_dict("records")]
            record |= _fractality(grid, outcomes, uncertain, box, level)
        panels.append(record)
    return Basins(
        rows,
        shares.merge(_shock_of_outcomes(rows, by), how="left", on=[*by, "outcome"]),
        pd.DataFrame(panels, columns=[*by, *_PANEL_COLUMNS]),
        pd.DataFrame(uncertainty, columns=[*by, "steps", "eps", "uncertain"]),
    )


def _with_shocks(
    table: pd.DataFrame,
    axes: Sequence[str],
    label: str,
    labels: pd.Series,
    by: Sequence[str],
    scales: Mapping[str, float] | None,
) -> pd.DataFrame:
    """The table with the columns outcome, shock and shock_to; arguments are those of `basins`.

    `labels` are the outcomes that the column `label` gives.
    """
    shock = np.full(len(table), np.nan)
    towards = np.full(len(table), None, object)
    measurable = len(_units(table, axes, scales)) <= 1
    for _, rows in panels_of(table, by) if measurable else ():
        shock[rows], towards[rows] = minimal_fatal_shock(table.iloc[rows], axes, labels.iloc[rows], scales)
    names = in_order(table, label, labels)
    outcome, shock_to = (pd.Categorical(values, names) for values in (labels, towards))
    with_shocks = table.assign(outcome=outcome, shock=shock, shock_to=shock_to)
    with_shocks.attrs = {**table.attrs, "outcome_of": label}
    return with_shocks


def _shock_of_outcomes(measured: pd.DataFrame, by: Sequence[str]) -> pd.DataFrame:
    """The median and the mean shock of the starts of each panel and outcome."""
    finite = measured.iloc[np.flatnonzero(np.isfinite(measured["shock"].to_numpy(float)))]
    named = finite.assign(outcome=finite["outcome"].astype(object))
    groups = named.groupby([*by, "outcome"], observed=True, dropna=False)["shock"]
    return groups.agg(shock_median="median", shock_mean="mean").reset_index()


def _fractality(
    grid: BasinGrid, labels: Shaped[np.ndarray, " rows"], uncertainty: Uncertainty, box: int, level: float
) -> dict[str, object]:
    """Entropies and uncertainty exponent of a panel."""
    entropy = basin_entropy(grid, labels, box)
    exponent = uncertainty_exponent(uncertainty, level)
    return {
        "basin_entropy": entropy.basin,
        "boundary_entropy": entropy.boundary,
        "crossed": entropy.crossed,
        "exponent": exponent.value,
        "exponent_low": exponent.low,
        "exponent_high": exponent.high,
        "boundary_dimension": len(grid.lengths) - exponent.value,
    }


def minimal_fatal_shock(
    table: pd.DataFrame, axes: Sequence[str], labels: pd.Series, scales: Mapping[str, float] | None = None
) -> tuple[Float[np.ndarray, " rows"], Shaped[np.ndarray, " rows"]]:
    """The minimal fatal shock: the distance from each start to the nearest start with another outcome.

    Angles are compared by the shorter way. The distance is exact among the given starts: on a grid the
    boundary itself is up to one step nearer.

    Args:
        table: a settle table; its rows differ along `axes` alone.
        axes: the columns of the starts.
        labels: the outcome of each row.
        scales: the unit of each column in the distance; by default 1 in the column's own unit.

    Returns:
        Distances (n,), inf where all starts have one outcome, and the outcomes there (n,), None likewise.

    Raises:
        AnalysisError: the table does not have a column or a start of a row, or the axes have different units
            and no scale.
    """
    require_one_unit(table, axes, scales)
    space = Space.of(table, axes, scales)
    points = space.points(table, axes)
    if (missing := int((~np.isfinite(points)).any(axis=1).sum())) > 0:
        rows_have = "row has" if missing == 1 else "rows have"
        raise AnalysisError(f"{missing} {rows_have} no start along {', '.join(axes)}: leave out such rows.")
    shock = np.full(len(table), np.inf)
    towards = np.full(len(table), None, object)
    outcome = labels.to_numpy()
    for label in pd.unique(outcome):
        rows, others = np.flatnonzero(outcome == label), np.flatnonzero(outcome != label)
        if others.size:
            shock[rows], nearest = space.tree(points[others]).query(points[rows])
            towards[rows] = outcome[others[nearest]]
    return shock, towards


def least_fatal_push(
    table: pd.DataFrame,
    pushes: str | Sequence[str],
    by: str | Sequence[str] = (),
    *,
    scales: Mapping[str, float] | None = None,
) -> pd.DataFrame:
    """The smallest pushes after which a gait did not recover; with `by="push_phase"` around its cycle.

    Args:
        table: a table of kind `perturb`.
        pushes: the columns of the amounts, such as `push_stance_rate`.
        by: columns, or constants of the table's job, of which each combination of values is searched
            separately.
        scales: the unit of each amount in the size; by default 1 in the column's own unit.

    Returns:
        One record for each combination with a fatal push: by, the amounts, size (their Euclidean length) and
        recovery (elsewhere, fell or failed). The least push of all lies between those of the table, so it is
        no larger than this one. Pushes after which a row had not settled again are not decided, and no
        fatal ones.

    Raises:
        AnalysisError: the table does not have a column or a row, the amounts have different units and no
            scale, or a scale is not above 0 or of no amount.

    Source: Halekotte and Feudel 2020, Sci. Rep. 10:11783, of the minimal fatal shock.
    """
    pushes = names_in(pushes)
    table, by, _ = panels_and_axes(table, by, pushes)
    require(table, "recovery")
    require_rows(table)
    require_one_unit(table, pushes, scales)
    lengths = Space.of(table, pushes, scales).scales
    size = np.linalg.norm(table[pushes].to_numpy(float) / lengths, axis=1)
    recovery = table["recovery"].astype(str).to_numpy()
    size = np.where(np.isin(recovery, FATAL) & np.isfinite(size), size, np.inf)
    records = []
    for panel, rows in panels_of(table, by):
        least = rows[np.argmin(size[rows])]
        if np.isfinite(size[least]):
            amounts = {name: float(table[name].iloc[least]) for name in pushes}
            records.append({**panel, **amounts, "size": size[least], "recovery": recovery[least]})
    return pd.DataFrame(records, columns=[*by, *pushes, "size", "recovery"])


def require_one_unit(
    table: pd.DataFrame, axes: Sequence[str], scales: Mapping[str, float] | None = None
) -> None:
    """Refuse axes without a scale that have different units.

    Raises:
        AnalysisError: they have; the message names them.
    """
    units = _units(table, axes, scales)
    if len(units) > 1:
        shown = ", ".join(f"{name} in {unit or '1'}" for unit, names in units.items() for name in names)
        raise AnalysisError(
            f"A distance needs one unit, but the axes are {shown}: give scales, such as "
            f"{{{next(iter(units.values()))[0]!r}: 1.0}}, the lengths that count as 1 along them."
        )


def _units(
    table: pd.DataFrame, axes: Sequence[str], scales: Mapping[str, float] | None
) -> dict[str, list[str]]:
    """The units of axes without a scale, and the axes of each."""
    quantities = table.attrs.get("quantities", {})
    units: dict[str, list[str]] = {}
    for name in axes:
        if name not in (scales or {}):
            units.setdefault(str(quantities.get(name, {}).get("unit", "")), []).append(name)
    return units
