"""Measures of gait transitions: hysteresis, return maps, and branches of fixed points."""

from __future__ import annotations

import functools
from collections.abc import Sequence

import numpy as np
import pandas as pd

from gaitsweep.analyses import (
    AnalysisError,
    fixed_points,
    stable_ranges,
    transition_points,
    transition_points_by_gait,
    wrapped_difference,
)
from gaitsweep.claims import masked, measure


@measure
def transition_at(
    table: pd.DataFrame, *, observable: str, parameter: str, direction: str, least: float = 0.15
) -> float:
    """Middle of the interval in which a ramp or staircase jumps as the parameter moves one way.

    Args:
        table: a ramp's or a staircase's table.
        observable: the observable that jumps.
        parameter: the parameter that moves.
        direction: rising or falling.
        least: the smallest change of the observable that is a jump.

    Raises:
        AnalysisError: no row jumps.
    """
    points = transition_points(table, observable, parameter, least)
    points_of_direction = masked(points, points["direction"] == direction)
    return _first_middle(points_of_direction, f"No row jumps as {parameter} is {direction}.")


@measure
def hysteresis_widths(
    table: pd.DataFrame, *, observable: str, parameter: str, by: str | None = None
) -> list[float]:
    """Transition point of the rising pass less that of the falling one, for each value of `by`.

    Args:
        table, observable, parameter: as for `transition_at`.
        by: the column of the groups; by default all rows are one.

    Raises:
        AnalysisError: the observable does not jump in each direction.
    """
    points = transition_points(table, observable, parameter, by=[] if by is None else [by])
    points = points.assign(middle=(points["low"] + points["high"]) / 2.0)
    groups = sorted(table[by].dropna().unique()) if by is not None else [None]
    widths = []
    for group in groups:
        part = points if group is None else masked(points, points[by] == group)
        rising = masked(part, part["direction"] == "rising")["middle"]
        falling = masked(part, part["direction"] == "falling")["middle"]
        if rising.empty or falling.empty:
            place = "" if group is None else f" at {by} = {group:g}"
            raise AnalysisError(f"The observable does not jump in each direction{place}.")
        widths.append(float(rising.iloc[0] - falling.iloc[0]))
    return widths


@measure
def ranges_of_both(
    table: pd.DataFrame, *, observable: str, parameter: str, apart: float, by: str
) -> list[float]:
    """Length of the parameter's range in which settled holds are apart, for each value of `by`.

    Args:
        table: a staircase's table.
        observable: an angle, whose two values at one parameter differ by more than `apart` (rad).
        parameter: the parameter that moves; each of its values stands for one stair.
        by: the column of the groups.
    """
    settled = table.loc[table["settled"].astype(bool)]
    stairs = settled[parameter].round(9)
    stair = float(np.diff(np.unique(stairs.to_numpy())).min())
    lengths = dict.fromkeys(sorted(table[by].unique()), 0.0)
    for place, holds in settled.groupby([settled[by], stairs]):
        angles = holds[f"{observable}_n"].to_numpy(float)
        if np.ptp(wrapped_difference(angles - angles[0])) > apart:
            lengths[place[0]] += stair
    return list(lengths.values())


@measure
def gait_lost_at(
    table: pd.DataFrame, *, parameter: str, gait: str, direction: str, start: str = "delta_13"
) -> float:
    """Middle of the interval of the parameter in which settled rows lose a gait.

    Args:
        table: a settle table over the parameter.
        parameter: its name.
        gait: the gait that is lost.
        direction: rising or falling.
        start: the column of the start by which rows are followed.

    Raises:
        AnalysisError: the gait is not lost.
    """
    points = transition_points_by_gait(table, parameter, start)
    losses = masked(points, (points["gait"] == gait) & (points["direction"] == direction))
    return _first_middle(losses, f"The gait {gait} is not lost as {parameter} is {direction}.")


def _first_middle(points: pd.DataFrame, without: str) -> float:
    """The middle of the first interval; an AnalysisError with the sentence `without` if there is none."""
    if points.empty:
        raise AnalysisError(without)
    return float((points["low"].iloc[0] + points["high"].iloc[0]) / 2.0)


@measure
def gap_of_edges(
    table: pd.DataFrame, *, parameter: str, upper: str, lower: str, start: str = "delta_13"
) -> float:
    """Width of the range in which both gaits persist.

    Args:
        table, parameter, start: as for `gait_lost_at`.
        upper: the gait that is lost as the parameter rises.
        lower: the gait that is lost as it falls.
    """
    edge = functools.partial(gait_lost_at, table, parameter=parameter, start=start)
    return edge(gait=upper, direction="rising") - edge(gait=lower, direction="falling")


@measure
def directions_of_loss(*tables: pd.DataFrame, observable: str, parameters: Sequence[str]) -> list[str]:
    """Direction of each table's parameter in which the observable jumps down."""
    directions = []
    for table, parameter in zip(tables, parameters, strict=True):
        points = transition_points(table, observable, parameter)
        down = points.loc[points["size"] < 0.0, "direction"]
        if down.empty:
            raise AnalysisError(f"{observable} does not jump down as {parameter} moves.")
        directions.append(str(down.iloc[0]))
    return directions


@measure
def least_change_of_transition(
    *tables: pd.DataFrame, observable: str, parameter: str, by: Sequence[str]
) -> float:
    """Smallest, over the tables and both directions, of the range of transition points within a table.

    Args:
        tables: ramps' or staircases' tables.
        observable, parameter: as for `transition_at`.
        by: for each table, the column of the groups.
    """
    ranges = []
    for table, column in zip(tables, by, strict=True):
        points = transition_points(table, observable, parameter, by=[column])
        middle = (points["low"] + points["high"]) / 2.0
        ranges += [float(np.ptp(middle[points["direction"] == way])) for way in ("rising", "falling")]
    return min(ranges)


@measure
def kinds_of_fixed_points(
    table: pd.DataFrame, *, observable: str, parameter: str, at: float, bandwidth: float | None = None
) -> list[str]:
    """Kinds of the fixed points of the return map at a value of the parameter, in order of the observable.

    Args:
        table: a return map's table.
        observable: the observable of the map.
        parameter: the parameter that varies.
        at: its value.
        bandwidth: as for `fixed_points`.
    """
    points = fixed_points(table, observable, parameter, bandwidth)
    at_value = np.flatnonzero(np.isclose(points[parameter].to_numpy(float), at))
    order = at_value[np.argsort(points["value"].to_numpy(float)[at_value])]
    return ["stable" if points["stable"].iloc[k] else "unstable" for k in order]


@measure
def stable_until(
    table: pd.DataFrame,
    *,
    observable: str,
    parameter: str,
    between: Sequence[float],
    take: str,
    bandwidth: float | None = None,
) -> float:
    """Largest or smallest parameter at which the return map has a stable point in a range.

    Args:
        table, observable, parameter, bandwidth: as for `kinds_of_fixed_points`.
        between: the range of the observable, low and high.
        take: max or min.

    Raises:
        AnalysisError: no stable fixed point is in the range.
    """
    points = fixed_points(table, observable, parameter, bandwidth)
    low, high = between
    value, stable = points["value"].to_numpy(float), points["stable"].to_numpy(bool)
    stable_values = points[parameter].to_numpy(float)[stable & (value >= low) & (value <= high)]
    if not stable_values.size:
        raise AnalysisError(f"No stable fixed point has {observable} between {low:g} and {high:g}.")
    largest_or_smallest = np.max if take == "max" else np.min
    return float(largest_or_smallest(stable_values))


@measure
def share_with_unstable_between(
    table: pd.DataFrame, *, observable: str, parameter: str, bandwidth: float | None = None
) -> float:
    """Share of the parameter values with two stable fixed points that have an unstable one between (1).

    Args:
        table, observable, parameter, bandwidth: as for `kinds_of_fixed_points`.

    Raises:
        AnalysisError: no value of the parameter has two stable fixed points.
    """
    points = fixed_points(table, observable, parameter, bandwidth)
    separated = []
    for _, points_at_value in points.groupby(parameter):
        stable = points_at_value.sort_values("value")["stable"].to_numpy(bool)
        lowest_and_highest = np.flatnonzero(stable)[[0, -1]] if stable.any() else np.zeros(2, int)
        if lowest_and_highest[0] < lowest_and_highest[1]:
            separated.append(not stable[slice(*lowest_and_highest)].all())
    if not separated:
        raise AnalysisError("No value of the parameter has two stable fixed points.")
    return sum(separated) / len(separated)


@measure
def gaits_of_branch(table: pd.DataFrame, *, parameter: str) -> list[str]:
    """Gaits of the stable pieces of the first branch of a continuation, in the order in which they follow."""
    pieces = stable_ranges(table, parameter)
    return list(dict.fromkeys(pieces.loc[pieces["row"] == pieces["row"].min(), "gait"].astype(str)))
