"""Stability quantifiers of attractors along a parameter, from one settle table."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from jaxtyping import Bool, Shaped

from gaitsweep.analysis.basins.attractor_matching import follow_attractors
from gaitsweep.analysis.basins.fractal_boundaries import uncertainty_exponent, uncertainty_fraction
from gaitsweep.analysis.basins.fractions import LEVEL, fractions, panels_and_axes
from gaitsweep.analysis.basins.grid import find_grid
from gaitsweep.analysis.basins.state_space import Space
from gaitsweep.analysis.basins.wada import RADIUS, boundaries_nearby
from gaitsweep.analysis.records import AnalysisError, require
from gaitsweep.status import Status

TAIL = 0.95  # share of the starts of a basin whose convergence is faster than the tail
_EXPONENT = "lyapunov_1"
# The columns of a share of starts and of its interval: of all starts, and of those that settle in time.
_SHARE: tuple[str, str, str] = ("fraction", "low", "high")
_SHARE_IN_TIME: tuple[str, str, str] = ("within", "within_low", "within_high")
_COLUMNS = [
    *("rows", *_SHARE, *_SHARE_IN_TIME),
    *("time_mean", "time_median", "time_tail", "time_most", "resilience", "least_shock"),
    *("boundary_exponent", "wada"),
]


def quantifiers(
    table: pd.DataFrame,
    parameter: str,
    *,
    label: str = "attractor",
    within: float | None = None,
    level: float = LEVEL,
    scales: Mapping[str, float] | None = None,
    **grouping: Any,
) -> pd.DataFrame:
    """Quantify the stability of each attractor at each value of a parameter.

    Args:
        table: a settle table over starts and the parameter.
        parameter: the column of the parameter.
        label: the column of the outcomes; `attractor` matches the attractors along the parameter
            (`analyses.follow_attractors`) if the table does not have it.
        within: a time (s), for the share of starts that settle to the attractor until then.
        level: confidence level of the intervals.
        scales: unit of each axis of starts in the distance of shocks, where axes have different units.
        grouping: arguments of `analyses.attractors`.

    Returns:
        One record for each value and attractor, with columns that are NaN where they do not follow from the
        table.

        - rows, fraction, low, high: starts that settle to it, their share of all starts and its interval:
          the basin stability (Menck, Heitzig, Marwan and Kurths 2013, Nat. Phys. 9:89).
        - within, within_low, within_high: the same of starts that settle until `within`: the finite-time
          basin stability (Schultz, Menck, Heitzig and Kurths 2017, New J. Phys. 19:023005).
        - time_mean, time_median, time_tail, time_most (s): times after which starts have settled: their mean,
          median, the time that 5 % exceed, and the longest. They include the crossings that the test of
          settling needs. Chaotic and quasi-periodic rows have none, since they run to their limit.
        - resilience (1/s): the rate at which small deviations decay, -lyapunov_1 in the mean (Pimm 1984,
          Nature 307:321). It needs `exponents` in the run.
        - least_shock: the distance from the attractor's crossings to the nearest start with another outcome,
          in the units of the starts: the minimal fatal shock (Halekotte and Feudel 2020, Sci. Rep. 10:11783).
          It is no less than the true one, which lies between starts. It needs the observables of all axes
          (x_end for x_0), so that starts are displaced crossings.
        - boundary_exponent: the uncertainty exponent of the basin against all others: 1 for a smooth
          boundary, less for a fractal one, and 0 for basins that are intermingled (Grebogi, McDonald, Ott and
          Yorke 1983, Phys. Lett. A 99:415; Ott, Alexander, Kan, Sommerer and Yorke 1994, Physica D 76:384).
          It needs a grid of starts with three sizes, so 32 starts along each axis.
        - wada: the least share of the basin's boundary that is within 5 steps of the boundary of another
          basin: 1 for a boundary that all basins share, at the resolution of the grid (Daza, Wagemakers and
          Sanjuan 2018, Sci. Rep. 8:9954). It needs a grid of starts and three outcomes.

    Raises:
        AnalysisError: the table lacks a column, or an argument is not allowed.

    Example:
        >>> import numpy as np, gaitsweep as gs
        >>> class Wells(gs.MapModel):
        ...     pull = gs.parameter("1", "pull to the wells at -1 and 1", 0.2)
        ...     x = gs.variable("1", "place", 0.0)
        ...
        ...     def image(self, p, s):
        ...         return {"x": s.x + p.pull * (s.x - s.x**3)}
        >>> run = gs.Settle(exponents=1, tolerance=1e-6)
        >>> table = gs.sweep(Wells(), x_0=np.linspace(-1.5, 1.5, 100), pull=[0.2, 0.4], run=run).table
        >>> quantified = gs.quantifiers(table, "pull")
        >>> quantified[["pull", "fraction", "resilience", "least_shock"]].round(2).to_numpy().tolist()
        [[0.2, 0.5, 0.51, 1.02], [0.2, 0.5, 0.51, 1.02], [0.4, 0.5, 1.61, 1.02], [0.4, 0.5, 1.61, 1.02]]
    """
    if within is not None and not within > 0.0:
        raise AnalysisError(f"within is {within:g} s, but must be above 0.")
    require(table, parameter, "status", "t_end")
    if label == "attractor" and label not in table:
        column = follow_attractors(table, parameter, **grouping).column
        table = _with_column(table, label, column.astype(object).to_numpy())
    require(table, label)
    table, by, axes = panels_and_axes(table, parameter, None)
    shares = {_SHARE: fractions(table, axes, label=label, by=by, level=level)}
    if within is not None:
        in_time = _in_time(table, label, within)
        shares[_SHARE_IN_TIME] = fractions(in_time, axes, label=label, by=by, level=level)
    space = Space.of(table, axes, scales) if axes else None
    records = _records(table, parameter, label, shares, space, axes)
    return pd.DataFrame(records, columns=[parameter, label, *_COLUMNS])


def _in_time(table: pd.DataFrame, label: str, within: float) -> pd.DataFrame:
    """The table without the outcomes of rows that took longer than `within` (s)."""
    outcomes = np.array(table[label].astype(object))
    outcomes[~(table["t_end"].to_numpy(float) <= within)] = None
    return _with_column(table, label, outcomes)


def _records(
    table: pd.DataFrame,
    parameter: str,
    label: str,
    shares: Mapping[tuple[str, str, str], pd.DataFrame],
    space: Space | None,
    axes: Sequence[str],
) -> list[dict[str, Any]]:
    """The quantifiers of each outcome at each value of the parameter.

    Args:
        table: a settle table.
        parameter, label: the columns of the parameter and of the outcomes.
        shares: the `fractions` of the outcomes, by the columns that they fill (`_SHARE`, `_SHARE_IN_TIME`).
        space: the space of the starts; None if no axis is one of starts.
        axes: the axes of the starts.
    """
    values = table[parameter].to_numpy(float)
    names = table[label].astype(object).to_numpy()
    records = []
    for value in np.unique(values[np.isfinite(values)]):
        at = values == value
        shapes = _boundaries(_rows_of(table, at), axes, names[at].astype(str))
        for name in sorted({str(name) for name in names[at & pd.notna(names)]}):
            in_basin = at & (names.astype(str) == name)
            basin = _rows_of(table, in_basin)
            record: dict[str, Any] = {parameter: value, label: name, "rows": len(basin)}
            for columns, of_outcomes in shares.items():
                record |= zip(columns, _share(of_outcomes, parameter, value, name), strict=True)
            record |= _times(basin)
            if _EXPONENT in table:
                record["resilience"] = -float(basin[_EXPONENT].to_numpy(float).mean())
            if space is not None:
                record["least_shock"] = _least_shock(space, basin, _rows_of(table, at & ~in_basin), axes)
            record |= shapes.get(name, {})
            records.append(record)
    return records


def _rows_of(table: pd.DataFrame, mask: Bool[np.ndarray, " rows"]) -> pd.DataFrame:
    """The rows of a table where a mask (n,) is true."""
    return table.iloc[np.flatnonzero(mask)]


def _with_column(table: pd.DataFrame, name: str, values: Shaped[np.ndarray, " rows"]) -> pd.DataFrame:
    """The table with other values in a column, and with its attributes."""
    changed = table.assign(**{name: values})
    changed.attrs = table.attrs
    return changed


def _share(shares: pd.DataFrame, parameter: str, value: float, name: str) -> list[float]:
    """The share of an outcome at a value of the parameter, and its interval; 0 if it has no record."""
    mask = (shares[parameter].to_numpy(float) == value) & (shares["outcome"].astype(str).to_numpy() == name)
    numbers = _rows_of(shares, mask)[list(_SHARE)].to_numpy(float)
    return numbers[0].tolist() if len(numbers) else [0.0] * len(_SHARE)


def _times(basin: pd.DataFrame) -> dict[str, float]:
    """Mean, median, tail and maximum of the times after which rows have settled."""
    settled = basin["status"].astype(str).isin([Status.settled.name, Status.at_rest.name]).to_numpy()
    times = basin["t_end"].to_numpy(float)[settled]
    if not times.size:
        return {}
    return {
        "time_mean": float(times.mean()),
        "time_median": float(np.median(times)),
        "time_tail": float(np.quantile(times, TAIL)),
        "time_most": float(times.max()),
    }


def _boundaries(
    table: pd.DataFrame, axes: Sequence[str], labels: Shaped[np.ndarray, " rows"]
) -> dict[str, dict[str, float]]:
    """The exponent of the boundary of each outcome, and how much of it all others share, by its name."""
    grid = find_grid(table, axes)
    if grid is None:
        return {}
    boundaries: dict[str, dict[str, float]] = {}
    for name in map(str, np.unique(labels)):
        exponent = uncertainty_exponent(uncertainty_fraction(grid, labels == name)).value
        boundaries[name] = {"boundary_exponent": exponent}
    if len(boundaries) > 2:
        for record in boundaries_nearby(grid, labels, RADIUS):
            boundary = boundaries[str(record["outcome"])]
            boundary["wada"] = min(boundary.get("wada", 1.0), float(record["within"]))
    return boundaries


def _least_shock(space: Space, basin: pd.DataFrame, others: pd.DataFrame, axes: Sequence[str]) -> float:
    """The distance from the crossings of an attractor to the nearest start with another outcome.

    Args:
        space: the space of the starts.
        basin: the rows that end at the attractor.
        others: the rows with another outcome.
        axes: the axes of the starts.
    """
    last = [f"{axis.removesuffix('_0')}_end" for axis in axes]
    if not len(others) or not set(last) <= set(basin):
        return float("nan")
    later = ([f"{name}_{k}" for name in last] for k in itertools.count(2))
    crossings = [last, *itertools.takewhile(lambda names: set(names) <= set(basin), later)]
    states = np.concatenate([space.points(basin, names) for names in crossings])
    states = states[np.isfinite(states).all(axis=1)]
    return float(space.nearest_distance(states, space.points(others, list(axes))).min(initial=np.inf))
