"""Stability quantifiers of attractors along a parameter, from one settle table."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from jaxtyping import Bool, Float, Shaped

from gaitsweep.analysis.basins.attractor_matching import follow_attractors
from gaitsweep.analysis.basins.attractors import orbit_periods
from gaitsweep.analysis.basins.basin_boundaries import (
    RADIUS,
    boundaries_nearby,
    uncertainty_exponent,
    uncertainty_fraction,
)
from gaitsweep.analysis.basins.fractions import LEVEL, fractions, panels_and_axes, proportion_interval
from gaitsweep.analysis.basins.grid import find_grid
from gaitsweep.analysis.basins.state_space import Space, check_scales, crossing_columns
from gaitsweep.analysis.records import (
    AnalysisError,
    outcome_labels,
    refuse_inferred,
    require,
    require_numbers,
    require_rows,
)
from gaitsweep.status import Status

TAIL = 0.95  # share of the starts of a basin whose convergence is faster than the tail
_EXPONENT = "lyapunov_1"
# The columns of a share of starts and of its interval: of all starts, and of those that settle in time.
_SHARE: tuple[str, str, str] = ("fraction", "low", "high")
_SHARE_IN_TIME: tuple[str, str, str] = ("within", "within_low", "within_high")
_COLUMNS = [
    *("rows", *_SHARE, *_SHARE_IN_TIME),
    *("time_mean", "time_median", "time_tail", "time_most", "resilience", "least_shock"),
    *("boundary_exponent", "wada", "amplification"),
]
# Maximal amplifications (n,) of the attractors of rows of a table, one row each.
Amplifications = Callable[[pd.DataFrame], Float[np.ndarray, " attractors"]]


def quantifiers(
    table: pd.DataFrame,
    parameter: str,
    *,
    label: str = "attractor",
    within: float | None = None,
    level: float = LEVEL,
    scales: Mapping[str, float] | None = None,
    amplifications: Amplifications | None = None,
    **grouping: Any,
) -> pd.DataFrame:
    """Quantify the stability of each attractor at each value of a parameter, as `gaitsweep.quantifiers`.

    Args:
        table, parameter, label, within, level, scales, grouping: as of `gaitsweep.quantifiers`.
        amplifications: function from one settled row of each attractor and value, a table (n,), to the
            maximal amplifications (n,); None: they are NaN.

    Raises:
        AnalysisError: the table lacks a column or has no rows, or an argument is not allowed.
    """
    if within is not None and not within > 0.0:
        raise AnalysisError(f"within is {within:g} s, but must be above 0.")
    require(table, "status", "t_end")
    require_numbers(table, parameter)
    require_rows(table)
    if within is not None and _are_inferred(table).any():
        raise AnalysisError(
            f"within is {within:g} s, but this table has inferred rows, which have no time: leave it out, or "
            "run the job without run.refine."
        )
    if label == "attractor" and label not in table:
        refuse_inferred(table, "no state that identifies an attractor")
        column = follow_attractors(table, parameter, **grouping).column
        table = table.assign(**{label: column.astype(object).to_numpy()})
    elif grouping:
        raise AnalysisError(
            f"{next(iter(grouping))} is an option of the search for attractors, but the outcomes are those "
            f"of the column {label}: leave it out."
        )
    require(table, label)
    table, by, axes = panels_and_axes(table, parameter, None)
    scales = scales or {}
    if amplifications is None:  # which need the sizes of starts that do not vary, too
        check_scales(scales, axes)
    shares = {_SHARE: fractions(table, axes, label=label, by=by, level=level)}
    if within is not None:
        in_time = _in_time(table, label, within)
        shares[_SHARE_IN_TIME] = fractions(in_time, axes, label=label, by=by, level=level)
    scales_of_axes = {name: scale for name, scale in scales.items() if name in axes}
    space = Space.of(table, axes, scales_of_axes) if axes else None
    records = _records(_with_outcomes(table, label), parameter, label, shares, space, axes, level)
    quantified = pd.DataFrame(records, columns=[parameter, label, *_COLUMNS])
    if amplifications is not None:
        quantified["amplification"] = _growths(table, quantified, amplifications)
    return quantified


def _growths(
    table: pd.DataFrame, attractors: pd.DataFrame, amplifications: Amplifications
) -> Float[np.ndarray, " attractors"]:
    """The maximal amplification of each attractor, from one of its settled rows; NaN without any.

    Args:
        table: the settle table.
        attractors: one record for each value of the parameter and attractor, its first two columns.
        amplifications: as for `quantifiers`.
    """
    parameter, label = attractors.columns[:2]
    is_settled = (table["status"].astype(str) == Status.settled.name).to_numpy()
    settled = np.flatnonzero(is_settled & (orbit_periods(table) > 0))
    values, names = table[parameter].to_numpy(float)[settled], table[label].astype(str).to_numpy()[settled]
    places, rows = [], []
    for place, (value, name) in enumerate(zip(attractors[parameter], attractors[label], strict=True)):
        of_attractor = settled[(values == value) & (names == str(name))]
        if of_attractor.size:
            places.append(place)
            rows.append(int(of_attractor[0]))
    growths = np.full(len(attractors), np.nan)
    growths[places] = amplifications(table.iloc[rows])
    return growths


def _in_time(table: pd.DataFrame, label: str, within: float) -> pd.DataFrame:
    """The table without the outcomes of rows that took longer than `within` (s)."""
    outcomes = np.array(table[label].astype(object))
    outcomes[~(table["t_end"].to_numpy(float) <= within)] = None
    # the table's own outcomes are those of all rows, whatever their times
    return table.drop(columns="outcome", errors="ignore").assign(**{label: outcomes})


def _with_outcomes(table: pd.DataFrame, label: str) -> pd.DataFrame:
    """The table without the labels of rows that have no outcome, since they failed or did not settle."""
    labels = table[label].astype(object)
    return table.assign(**{label: labels.where(outcome_labels(table, label) == labels.astype(str), None)})


def _records(
    table: pd.DataFrame,
    parameter: str,
    label: str,
    shares: Mapping[tuple[str, str, str], pd.DataFrame],
    space: Space | None,
    axes: Sequence[str],
    level: float,
) -> list[dict[str, Any]]:
    """The quantifiers of each outcome at each value of the parameter.

    Args:
        table: a settle table.
        parameter, label: the columns of the parameter and of the outcomes.
        shares: the `fractions` of the outcomes, by the columns that they fill (`_SHARE`, `_SHARE_IN_TIME`).
        space: the space of the starts; None if no axis is one of starts.
        axes: the axes of the starts.
        level: confidence level of the intervals.
    """
    values = table[parameter].to_numpy(float)
    names = table[label].astype(object).to_numpy()
    records = []
    for value in np.unique(values[np.isfinite(values)]):
        at = values == value
        outcomes = sorted({str(name) for name in names[at & pd.notna(names)]})
        shapes = _boundaries(_rows_of(table, at), axes, names[at].astype(str), outcomes)
        for name in outcomes:
            in_basin = at & (names.astype(str) == name)
            basin = _rows_of(table, in_basin)
            record: dict[str, Any] = {parameter: value, label: name, "rows": len(basin)}
            for columns, of_outcomes in shares.items():
                none = (0.0, *proportion_interval(0, int(np.count_nonzero(at)), level))
                share = _share(of_outcomes, parameter, value, name) or none
                record |= zip(columns, share, strict=True)
            record |= _times(basin)
            if _EXPONENT in table:
                record["resilience"] = -float(pd.Series(basin[_EXPONENT].to_numpy(float)).mean())
            if space is not None:
                record["least_shock"] = _least_shock(space, basin, _rows_of(table, at & ~in_basin), axes)
            record |= shapes.get(name, {})
            records.append(record)
    return records


def _rows_of(table: pd.DataFrame, mask: Bool[np.ndarray, " rows"]) -> pd.DataFrame:
    """The rows of a table where a mask (n,) is true."""
    return table.iloc[np.flatnonzero(mask)]


def _share(shares: pd.DataFrame, parameter: str, value: float, name: str) -> list[float]:
    """The share of an outcome at a value of the parameter, and its interval; [] if it has no record."""
    mask = (shares[parameter].to_numpy(float) == value) & (shares["outcome"].astype(str).to_numpy() == name)
    numbers = _rows_of(shares, mask)[list(_SHARE)].to_numpy(float)
    return numbers[0].tolist() if len(numbers) else []


def _are_inferred(table: pd.DataFrame) -> Bool[np.ndarray, " rows"]:
    """Mask of the rows (n,) that were inferred."""
    return (table["status"].astype(str) == Status.inferred.name).to_numpy(bool)


def _times(basin: pd.DataFrame) -> dict[str, float]:
    """Mean, median, tail and maximum of the times after which rows have settled.

    None where rows were inferred: those that were simulated lie beside boundaries, and settle the latest.
    """
    if _are_inferred(basin).any():
        return {}
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
    table: pd.DataFrame, axes: Sequence[str], labels: Shaped[np.ndarray, " rows"], outcomes: Sequence[str]
) -> dict[str, dict[str, float]]:
    """The exponent of the boundary of each outcome, and the least share of it that another one is near.

    Rows whose label is not among the outcomes, as those that did not settle, belong to no basin.
    """
    grid = find_grid(table, axes)
    if grid is None:
        return {}
    boundaries: dict[str, dict[str, float]] = {}
    for name in outcomes:
        exponent = uncertainty_exponent(uncertainty_fraction(grid, labels == name)).value
        boundaries[name] = {"boundary_exponent": exponent}
    if len(outcomes) > 2:
        for record in boundaries_nearby(grid, labels, RADIUS):
            boundary = boundaries.get(str(record["outcome"]))
            if boundary is not None and record["other"] in boundaries:
                boundary["wada"] = min(boundary.get("wada", 1.0), float(record["within"]))
    return boundaries


def _least_shock(space: Space, basin: pd.DataFrame, others: pd.DataFrame, axes: Sequence[str]) -> float:
    """The distance from the crossings of an attractor to the nearest start with another outcome.

    Args:
        space: the space of the starts.
        basin: the rows that end at the attractor.
        others: the rows with another outcome; those without a start, as of joined tables, do not count.
        axes: the axes of the starts.
    """
    last = [f"{axis.removesuffix('_0')}_end" for axis in axes]
    if not set(last) <= set(basin):
        return float("nan")
    states = np.concatenate([space.points(basin, names) for names in crossing_columns(basin, last)])
    starts = space.points(others, list(axes))
    states, starts = (points[np.isfinite(points).all(axis=1)] for points in (states, starts))
    if not (len(states) and len(starts)):
        return float("nan")
    return float(space.nearest_distance(states, starts).min())
