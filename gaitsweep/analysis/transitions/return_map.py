"""First return maps of one section observable, from successive crossings of many starts.

The map x_n -> x_{n+1} is represented by its drift x_{n+1} - x_n over x_n, smoothed by local fits. The map has
a fixed point where the drift is zero, stable if its slope (1 + the drift's) is between -1 and 1. Where the
drift is small without a zero, the map has a ghost: rows stay there for long, then leave. The map has no value
in gaps of the data, and is not smoothed over jumps. The method assumes a one-dimensional state on the
section: let the faster directions decay first (`run.after_cycles`).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import pandas as pd
from jaxtyping import Int

from gaitsweep.analysis.records import (
    AnalysisError,
    axes_of,
    names_in,
    panels_of,
    require,
    require_numbers,
    require_single_records,
    section_column,
    sound,
)
from gaitsweep.analysis.transitions.drift import NEAR, Drift, drifts_of, ghosts_of, zeros_of
from gaitsweep.angles import TURN, branch_cut, is_circular, unwrap_from, wrapped_difference

BANDWIDTH = 0.05  # rad; half the width of the window of the local lines
_SHARE = 0.05  # bandwidth of an observable that is not an angle, as a share of its range
_NEIGHBOURS = 0.25  # rad; largest distance between points of one branch at neighbouring parameter values
_NEAR_ON_A_LINE = 0.25  # the same for an observable that is not an angle, as a share of its range
_SLOW_ON_A_LINE = 0.01  # largest drift of a ghost of such an observable, likewise

By = str | Sequence[str] | None


def pairs(table: pd.DataFrame, observable: str, by: By = None) -> pd.DataFrame:
    """Pair the successive section values of each row of a table with one record a crossing.

    Failed rows lose their last ten crossings; there is no pair across a missing crossing.

    Args:
        table: a return map's table, or any with row and crossing.
        observable: a section observable (delta_13).
        by: columns to keep besides the swept axes.

    Returns:
        One record a pair: row, swept axes and `by`, crossing, value (x_n), next (x_{n+1}, angles in
        [0, 2 pi)), change (x_{n+1} - x_n, angles by the shorter way).

    Raises:
        AnalysisError: the table does not have a column, the observable's values are not numbers, or rows of
            several tables have the same number.
    """
    name, columns = section_column(table, observable), dict.fromkeys([*axes_of(table), *names_in(by or ())])
    require(table, "row", "crossing", *columns)
    require_numbers(table, name)
    require_single_records(table, "crossing")
    table = table.sort_values(["row", "crossing"], kind="stable")
    table = table.loc[sound(table, name)]
    row, crossing = table["row"].to_numpy(), table["crossing"].to_numpy()
    value = table[name].to_numpy(float)
    first = np.flatnonzero((row[1:] == row[:-1]) & (crossing[1:] == crossing[:-1] + 1))
    # `by` may name row or crossing itself
    kept = list(dict.fromkeys(["row", *columns, "crossing"]))
    records = table[kept].iloc[first].reset_index(drop=True)
    before, after = value[first], value[first + 1]
    change = after - before
    if is_circular(table, name):
        before, after, change = np.mod(before, TURN), np.mod(after, TURN), wrapped_difference(change)
    return records.assign(value=before, next=after, change=change)


def drift(
    table: pd.DataFrame, observable: str, by: By = None, bandwidth: float | None = None
) -> pd.DataFrame:
    """The smoothed drift along the observable, where there are enough points.

    Args:
        table, observable: as for `pairs`.
        by: columns; each combination of their values has its own map.
        bandwidth: half the width of the window in which a line is fitted, in the observable's unit; by
            default 0.05 rad for an angle and a twentieth of the values' range for others.

    Returns:
        One record for each of five points in a bandwidth: by, value (angles on one turn, cut where no data
        are), drift, slope (of the drift), drift_error and slope_error (standard errors from the scatter),
        count, piece (the number of the piece of the data, between gaps and jumps).

    Raises:
        AnalysisError: the table does not have a column, or `bandwidth` is not above 0.
    """
    names = ("value", "drift", "slope", "drift_error", "slope_error", "count")  # of the fields of Smooth
    parts = []
    for panel, piece, curve in _drifts(table, observable, by, bandwidth):
        part = pd.DataFrame(dict(zip(names, curve.smooth, strict=True))).assign(piece=piece)
        for number, (name, value) in enumerate(panel.items()):
            part.insert(number, name, [value] * len(part))
        parts.append(part[np.isfinite(curve.smooth.value)])
    if not parts:
        return pd.DataFrame(columns=[*names_in(by or ()), *names, "piece"])
    return pd.concat(parts, ignore_index=True)


def fixed_points(
    table: pd.DataFrame, observable: str, by: By = None, bandwidth: float | None = None
) -> pd.DataFrame:
    """The fixed points of the return map: zeros of the drift between significant values of opposite sign.

    A value is significant if it is two standard errors from zero. There is no fixed point in a gap or at a
    jump, and none without points of both signs on its two sides, except where rows come to rest at an end of
    the data. The final fit at the fixed point is a parabola if the data show curvature.

    Args:
        table, observable, by, bandwidth: as for `drift`.

    Returns:
        One record a fixed point: by, value, value_error, slope (of the map), slope_error, stable, count (of
        the pairs in its window). Errors are standard errors from the scatter. Stable means a slope between
        -1 and 1. Whether the slope is below 1 follows from the signs on both sides, which are more robust to
        noise.

    Raises:
        AnalysisError: as for `drift`.
    """
    columns = [*names_in(by or ()), "value", "value_error", "slope", "slope_error", "stable", "count"]
    records = []
    for panel, _, curve in _drifts(table, observable, by, bandwidth):
        for value, error, smooth, falls in zeros_of(curve):
            slope = float(smooth.slope[0])
            records.append(
                {
                    **panel,
                    "value": np.mod(value, TURN) if curve.circular else value,
                    "value_error": error,
                    "slope": 1.0 + slope,
                    "slope_error": float(smooth.slope_error[0]),
                    "stable": falls and slope > -2.0,
                    "count": int(smooth.points[0]),
                }
            )
    return pd.DataFrame(records, columns=columns)


def ghosts(
    table: pd.DataFrame,
    observable: str,
    by: By = None,
    bandwidth: float | None = None,
    near: float | None = None,
) -> pd.DataFrame:
    """The ghosts: minima of the size of the drift near zero, left behind by a saddle-node bifurcation.

    Args:
        table, observable, by, bandwidth: as for `drift`.
        near: the largest drift of a ghost, in the observable's unit a crossing; by default 0.01 rad for an
            angle and a hundredth of the values' range for others.

    Returns:
        One record a ghost: by, value, drift (signed), drift_error (standard error).

    Raises:
        AnalysisError: the table does not have a column, or `bandwidth` or `near` is not above 0.
    """
    if near is not None and not near > 0.0:
        raise AnalysisError(f"near is {near:g}, but must be above 0.")
    if near is None:
        near = _small(table, observable, NEAR, _SLOW_ON_A_LINE)
    records = []
    for panel, _, curve in _drifts(table, observable, by, bandwidth):
        for value, least, error in ghosts_of(curve, near):
            on_turn = np.mod(value, TURN) if curve.circular else value
            records.append({**panel, "value": on_turn, "drift": least, "drift_error": error})
    return pd.DataFrame(records, columns=[*names_in(by or ()), "value", "drift", "drift_error"])


def branches(
    table: pd.DataFrame, observable: str, parameter: str, bandwidth: float | None = None
) -> pd.DataFrame:
    """The bifurcation diagram: the fixed points at each value of a parameter, joined into branches.

    Args:
        table, observable, bandwidth: as for `drift`.
        parameter: the column of the parameter.

    Returns:
        As `fixed_points`, with `branch`: a number for the fixed points of one stability that are mutually
        nearest at neighbouring values of the parameter, at most 0.25 rad apart (a quarter of the values'
        range if the observable is not an angle).

    Raises:
        AnalysisError: as for `drift`.
    """
    points = fixed_points(table, observable, parameter, bandwidth)
    circular = is_circular(table, section_column(table, observable))
    reach = _small(table, observable, _NEIGHBOURS, _NEAR_ON_A_LINE)
    tried = sorted(table[parameter].dropna().unique())
    return points.assign(branch=_joined(points, parameter, tried, reach, circular))


def _small(table: pd.DataFrame, observable: str, angle: float, share: float) -> float:
    """A small distance of values: `angle` (rad) of angles, a share of the range of the pairs' values else."""
    value = pairs(table, observable)["value"].to_numpy(float)
    is_angle = is_circular(table, section_column(table, observable)) or not value.size
    return angle if is_angle else share * float(np.ptp(value))


def _drifts(
    table: pd.DataFrame, observable: str, by: By, bandwidth: float | None
) -> Iterator[tuple[dict[str, Any], int, Drift]]:
    """The drift of each combination of `by` and piece: the values of `by`, the piece's number, the curve."""
    name, names = section_column(table, observable), names_in(by or ())
    circular = is_circular(table, name)
    all_pairs = pairs(table, observable, by)
    if not len(all_pairs):
        return
    extent = float(np.ptp(all_pairs["value"]))
    if bandwidth is None:
        bandwidth = BANDWIDTH if circular or extent == 0.0 else _SHARE * extent
    if not bandwidth > 0.0:
        raise AnalysisError(f"bandwidth is {bandwidth:g}, but must be above 0.")
    for panel, rows in panels_of(all_pairs, names):
        part = all_pairs.iloc[rows]
        value = part["value"].to_numpy()
        value = unwrap_from(value, branch_cut(value) if circular else None)
        change, row = part["change"].to_numpy(), part["row"].to_numpy()
        for piece, curve in enumerate(drifts_of(value, change, row, bandwidth, circular)):
            yield panel, piece, curve


def _joined(
    points: pd.DataFrame, parameter: str, tried: Sequence[float], reach: float, circular: bool
) -> Int[np.ndarray, " points"]:
    """The branch number of each fixed point; a branch ends at a parameter value without a point of it."""
    branch = np.full(len(points), -1)
    if not len(points):
        return branch
    value, stable = points["value"].to_numpy(float), points["stable"].to_numpy(bool)
    count = 0
    before = np.zeros(0, int)
    for value_of_parameter in tried:
        at_value = np.flatnonzero(points[parameter] == value_of_parameter)
        distance = value[at_value][:, None] - value[before][None, :]
        distance = np.abs(wrapped_difference(distance) if circular else distance)
        distance = np.where(stable[at_value][:, None] == stable[before][None, :], distance, np.inf)
        for i, point in enumerate(at_value):
            j = int(np.argmin(distance[i])) if len(before) else -1
            if j >= 0 and distance[i, j] <= reach and np.argmin(distance[:, j]) == i:
                branch[point] = branch[before[j]]
            else:
                branch[point] = count
                count += 1
        before = at_value
    return branch
