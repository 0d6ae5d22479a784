"""First return maps of one section observable, read from successive crossings of many starts.

The map x_n -> x_{n+1} is read as its drift x_{n+1} - x_n over x_n, smoothed by local fits. Where the drift
is zero the map has a fixed point, stable where its slope (1 + the drift's) is between -1 and 1; where it is
small without being zero, a ghost: rows stay there for long, and leave. Nothing is told of the map where the
data have a gap, and it is not smoothed over a jump. All this holds as far as the state is one-dimensional on
the section: let the faster directions die out first (`run.after_cycles`).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from gaitsweep.analysis.circular import cut, is_circular, on_line
from gaitsweep.analysis.records import axes_of, require, section_column, sound
from gaitsweep.analysis.transitions.drift import NEAR, Drift, drifts_of, ghosts_of, zeros_of
from gaitsweep.circular import TURN, wrapped_difference

BANDWIDTH = 0.05  # rad: half the width of the window of the local lines
_SHARE = 0.05  # of the values' range: the bandwidth of what is no angle
_NEIGHBOURS = 0.25  # rad: fixed points of two neighbouring parameter values farther apart are not one branch
_NEAR_ON_A_LINE = 0.25  # of the values' range: the same for what is no angle

By = str | Sequence[str] | None


def pairs(table: pd.DataFrame, observable: str, by: By = None) -> pd.DataFrame:
    """Successive section values of a table with one record a crossing.

    Rows that failed lose their last ten crossings, and pairs with a crossing missing between are none.

    Args:
        table: a return map's table, or any with row and crossing.
        observable: a section observable (delta_13).
        by: columns to keep beside those that vary.

    Returns:
        One record a pair: row, what varies and `by`, crossing, value (x_n), next (x_{n+1}, angles in
        [0, 2 pi)), change (x_{n+1} - x_n, angles by the shorter way).

    Raises:
        AnalysisError: a column is not there.
    """
    name, kept = section_column(table, observable), dict.fromkeys([*axes_of(table), *_listed(by)])
    require(table, "row", "crossing", *kept)
    table = table.sort_values(["row", "crossing"], kind="stable")
    table = table.loc[sound(table, name)]
    row, crossing = table["row"].to_numpy(), table["crossing"].to_numpy()
    value = table[name].to_numpy(float)
    first = np.flatnonzero((row[1:] == row[:-1]) & (crossing[1:] == crossing[:-1] + 1))
    found = table[["row", *kept, "crossing"]].iloc[first].reset_index(drop=True)
    here, there = value[first], value[first + 1]
    if is_circular(table, name):
        return found.assign(
            value=np.mod(here, TURN), next=np.mod(there, TURN), change=wrapped_difference(there - here)
        )
    return found.assign(value=here, next=there, change=there - here)


def drift(
    table: pd.DataFrame, observable: str, by: By = None, bandwidth: float | None = None
) -> pd.DataFrame:
    """The smoothed drift where there are points enough, along the observable.

    Args:
        table, observable: as for `pairs`.
        by: columns of which each combination has a map of its own.
        bandwidth: half the width of the window in which a line is fitted, in the observable's unit; 0.05 rad
            for an angle and a twentieth of the values' range for others if not given.

    Returns:
        One record a place, five to a bandwidth: by, value (angles on one turn, uncut where the data are),
        drift, slope (of the drift), drift_error and slope_error (standard errors from the scatter), count,
        piece (the number of the piece of the data, between gaps and jumps, that the place lies on).
    """
    found = []
    for place, piece, curve in _drifts(table, observable, by, bandwidth):
        smooth = curve.smooth
        columns = {
            "value": smooth.at,
            "drift": smooth.value,
            "slope": smooth.slope,
            "drift_error": smooth.value_error,
            "slope_error": smooth.slope_error,
            "count": smooth.points,
            "piece": np.full(len(smooth.at), piece),
        }
        part = pd.DataFrame({**{name: [each] * len(smooth.at) for name, each in place.items()}, **columns})
        found.append(part[np.isfinite(smooth.value)])
    columns = [*_listed(by), "value", "drift", "slope", "drift_error", "slope_error", "count", "piece"]
    return pd.concat(found, ignore_index=True) if found else pd.DataFrame(columns=columns)


def fixed_points(
    table: pd.DataFrame, observable: str, by: By = None, bandwidth: float | None = None
) -> pd.DataFrame:
    """The fixed points of the return map: zero crossings of the drift from one sure sign to the other.

    A sign is sure where the drift is two standard errors from zero. There is no fixed point in a gap of the
    data or where the map jumps, and none without points on both sides, the drift's sign turning between them;
    but where rows come to rest at an end of the data there is one. The last fit, at the fixed point, is a
    parabola where the data show that the map bends.

    Args:
        table, observable, by, bandwidth: as for `drift`.

    Returns:
        One record a fixed point: by, value, value_error, slope (of the map), slope_error, stable, count (of
        the pairs in its window). Errors are standard errors from the scatter. Stable means |slope| < 1; that
        it is below 1 is read from the sure signs on both sides, which noise does not turn as it does a slope.
    """
    columns = [*_listed(by), "value", "value_error", "slope", "slope_error", "stable", "count"]
    found = []
    for place, _, curve in _drifts(table, observable, by, bandwidth):
        for value, smooth, falls, within in zeros_of(curve):
            slope, error = float(smooth.slope[0]), float(smooth.value_error[0])
            found.append(
                {
                    **place,
                    "value": np.mod(value, TURN) if curve.circular else value,
                    "value_error": min(error / max(abs(slope), 1e-12), within),
                    "slope": 1.0 + slope,
                    "slope_error": float(smooth.slope_error[0]),
                    "stable": falls and slope > -2.0,
                    "count": int(smooth.points[0]),
                }
            )
    return pd.DataFrame(found, columns=columns)


def ghosts(
    table: pd.DataFrame,
    observable: str,
    by: By = None,
    bandwidth: float | None = None,
    near: float = NEAR,
) -> pd.DataFrame:
    """Where the drift comes close to zero and turns back: what is left of two fixed points that have met.

    Args:
        table, observable, by, bandwidth: as for `drift`.
        near: the largest size of drift that counts, in the observable's unit a crossing.

    Returns:
        One record a ghost: by, value, drift (least in size there, signed), drift_error (standard error).
    """
    found = []
    for place, _, curve in _drifts(table, observable, by, bandwidth):
        for value, least, error in ghosts_of(curve, near):
            where = np.mod(value, TURN) if curve.circular else value
            found.append({**place, "value": where, "drift": least, "drift_error": error})
    return pd.DataFrame(found, columns=[*_listed(by), "value", "drift", "drift_error"])


def branches(
    tables_by_parameter: pd.DataFrame | Mapping[float, pd.DataFrame],
    observable: str,
    parameter: str,
    bandwidth: float | None = None,
) -> pd.DataFrame:
    """The branch diagram: the fixed points at each value of a parameter, joined into branches.

    Args:
        tables_by_parameter: a return map's table with the parameter as a column, or one table for each value.
        observable, bandwidth: as for `drift`.
        parameter: the column of the parameter, and its name in the result.

    Returns:
        As `fixed_points`, and `branch`: a number for the fixed points of one stability that are each other's
        nearest from one value of the parameter to the next, and no farther apart than 0.25 rad (of what is no
        angle: a quarter of the values' range).
    """
    if isinstance(tables_by_parameter, Mapping):
        found = [
            fixed_points(table.assign(**{parameter: value}), observable, parameter, bandwidth)
            for value, table in sorted(tables_by_parameter.items())
        ]
        points = pd.concat(found, ignore_index=True) if found else pd.DataFrame(columns=[parameter])
        tables, tried = list(tables_by_parameter.values()), sorted(tables_by_parameter)
    else:
        points = fixed_points(tables_by_parameter, observable, parameter, bandwidth)
        tables, tried = [tables_by_parameter], sorted(tables_by_parameter[parameter].dropna().unique())
    names = [section_column(table, observable) for table in tables]
    circular = bool(tables) and is_circular(tables[0], names[0])
    spans = [
        np.ptp(table[name].dropna().to_numpy(float))
        for table, name in zip(tables, names, strict=True)
        if np.isfinite(table[name].to_numpy(float)).any()
    ]
    reach = _NEIGHBOURS if circular else _NEAR_ON_A_LINE * float(max(spans, default=np.inf))
    return points.assign(branch=_joined(points, parameter, tried, reach, circular))


def _listed(by: By) -> list[str]:
    return [] if by is None else [by] if isinstance(by, str) else list(by)


def _drifts(
    table: pd.DataFrame, observable: str, by: By, bandwidth: float | None
) -> Iterator[tuple[dict[str, Any], int, Drift]]:
    """The drift of each combination of `by`, piece by piece: its values, the piece's number, the curve."""
    name, names = section_column(table, observable), _listed(by)
    circular = is_circular(table, name)
    found = pairs(table, observable, by)
    if not len(found):
        return
    width = bandwidth or (BANDWIDTH if circular else _SHARE * float(np.ptp(found["value"])) or BANDWIDTH)
    parts = found.groupby(names, sort=True, observed=True) if names else [((), found)]
    for key, part in parts:
        value = part["value"].to_numpy()
        value = on_line(value, cut(value)) if circular else value
        place = dict(zip(names, key if isinstance(key, tuple) else (key,), strict=True))
        change, row = part["change"].to_numpy(), part["row"].to_numpy()
        for piece, curve in enumerate(drifts_of(value, change, row, width, circular)):
            yield place, piece, curve


def _joined(
    points: pd.DataFrame, parameter: str, tried: Sequence[float], reach: float, circular: bool
) -> np.ndarray:
    """The branch of each fixed point; none goes on over a value of the parameter at which it has no point."""
    branch = np.full(len(points), -1)
    if not len(points):
        return branch
    value, stable = points["value"].to_numpy(float), points["stable"].to_numpy(bool)
    at = [np.flatnonzero(points[parameter] == each) for each in tried]
    count = 0
    before = np.zeros(0, int)
    for now in at:
        apart = value[now][:, None] - value[before][None, :]
        apart = np.abs(wrapped_difference(apart) if circular else apart)
        apart = np.where(stable[now][:, None] == stable[before][None, :], apart, np.inf)
        for i, point in enumerate(now):
            j = int(np.argmin(apart[i])) if len(before) else -1
            if j >= 0 and apart[i, j] <= reach and np.argmin(apart[:, j]) == i:
                branch[point] = branch[before[j]]
            else:
                branch[point], count = count, count + 1
        before = now
    return branch
