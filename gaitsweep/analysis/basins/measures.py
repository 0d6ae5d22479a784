"""Basins of attraction in numbers: shares, entropies, the exponent of uncertainty, the smallest shocks."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd

from gaitsweep.analysis.attractors.attractors import with_attractors
from gaitsweep.analysis.basins.fractal_boundaries import (
    BOX,
    basin_entropy,
    uncertain_shares,
    uncertainty_exponent,
)
from gaitsweep.analysis.basins.fractions import fractions, panels_and_axes, panels_of
from gaitsweep.analysis.basins.grid import BasinGrid, find_grid
from gaitsweep.analysis.basins.outcomes import in_order, outcomes
from gaitsweep.analysis.basins.proportions import LEVEL
from gaitsweep.analysis.basins.shocks import shocks
from gaitsweep.analysis.gaits.records import AnalysisError


@dataclasses.dataclass(frozen=True)
class Basins:
    """What was measured of the basins in a table.

    `rows`: the table with the columns outcome (category), shock (to the nearest start that comes out
    otherwise) and shock_to (that start's outcome). `fractions`: one record a panel and outcome (rows, of,
    fraction, low, high, interval, shock_median, shock_mean of its starts). `panels`: one record a panel
    (rows, grid: whether its starts are one; basin_entropy, boundary_entropy, crossed, exponent,
    exponent_error, boundary_dimension). `uncertainty`: one record a panel and eps (steps, eps, uncertain).
    """

    rows: pd.DataFrame
    fractions: pd.DataFrame
    panels: pd.DataFrame
    uncertainty: pd.DataFrame


def basins(
    table: pd.DataFrame,
    axes: Sequence[str] | None = None,
    *,
    label: str = "gait",
    by: str | Sequence[str] = (),
    level: float = LEVEL,
    interval: str | None = None,
    box: int = BOX,
    sizes: Sequence[int] | None = None,
    scales: Mapping[str, float] | None = None,
) -> Basins:
    """Measure the basins of a settle table, refined or not, grid or random starts.

    Args:
        table: a settle table; rows that were inferred count as others do.
        axes: the columns of the starts that make the plane (or line, or space) of the basins; what varies and
            is not in `by` if not given.
        label: the column of what starts come to; `attractor` is worked out where it is not there.
        by: columns of which each combination of values is a panel, measured by itself.
        level: of the intervals of fractions.
        interval: as for `fractions`.
        box: cells along a side of the boxes of the basin entropy.
        sizes: eps of the uncertain shares, in steps of the grid; up to an eighth of the shortest axis, halved
            four times, if not given.
        scales: for the shock, by axis, what counts as one; needed where axes have different units.

    Raises:
        AnalysisError: a column is not there, no axis is left, or an argument is not one of those allowed.
    """
    by, axes = panels_and_axes(table, by, axes)
    if not axes:
        raise AnalysisError("No axis is left for the basins: name the columns of the starts as `axes`.")
    if label == "attractor" and label not in table.columns:
        table = with_attractors(table)
    counted = fractions(table, axes, label=label, by=by, level=level, interval=interval)
    came_to = outcomes(table, label)
    names = in_order(table, label, came_to)
    apart = np.full(len(table), np.nan)
    towards = np.full(len(table), None, object)
    panels, uncertainty = [], []
    for place, rows in panels_of(table, by):
        part, mine = table.iloc[rows], came_to.iloc[rows]
        apart[rows], towards[rows] = shocks(part, axes, mine, scales)
        grid = find_grid(part, axes)
        shares = _uncertain(grid, mine.to_numpy(), sizes)
        uncertainty += [{**place, **record} for record in shares.to_dict("records")]
        panels.append({**place, "rows": len(part), **_entangled(grid, mine.to_numpy(), shares, box)})
    measured = table.assign(
        outcome=pd.Categorical(came_to, names), shock=apart, shock_to=pd.Categorical(towards, names)
    )
    measured.attrs = table.attrs
    return Basins(
        measured,
        counted.merge(_shock_of_outcomes(measured, by), how="left", on=[*by, "outcome"]),
        pd.DataFrame(panels, columns=[*by, *_PANELS]),
        pd.DataFrame(uncertainty, columns=[*by, "steps", "eps", "uncertain"]),
    )


_PANELS = [
    *("rows", "grid", "basin_entropy", "boundary_entropy", "crossed"),
    *("exponent", "exponent_error", "boundary_dimension"),
]


def _shock_of_outcomes(measured: pd.DataFrame, by: Sequence[str]) -> pd.DataFrame:
    """The median and the mean shock of the starts of each outcome, panel by panel."""
    finite = measured.iloc[np.flatnonzero(np.isfinite(measured["shock"].to_numpy(float)))]
    named = finite.assign(outcome=finite["outcome"].astype(object))
    of = named.groupby([*by, "outcome"], observed=True)["shock"]
    return of.agg(shock_median="median", shock_mean="mean").reset_index()


def _uncertain(grid: BasinGrid | None, came_to: np.ndarray, sizes: Sequence[int] | None) -> pd.DataFrame:
    if grid is None:
        return pd.DataFrame(columns=["steps", "eps", "uncertain"])
    return uncertain_shares(grid, came_to, None if sizes is None else list(sizes))


def _entangled(
    grid: BasinGrid | None, came_to: np.ndarray, shares: pd.DataFrame, box: int
) -> dict[str, object]:
    """Entropies and exponent of a panel; NaN where its starts are no grid."""
    if grid is None:
        return {"grid": False}
    entropy = basin_entropy(grid, came_to, box)
    exponent = uncertainty_exponent(shares)
    return {
        "grid": True,
        "basin_entropy": entropy.basin,
        "boundary_entropy": entropy.boundary,
        "crossed": entropy.crossed,
        "exponent": exponent.value,
        "exponent_error": exponent.error,
        "boundary_dimension": len(grid.lengths) - exponent.value,
    }
