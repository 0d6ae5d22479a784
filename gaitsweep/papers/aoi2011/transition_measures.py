"""Measures of gait transitions: hysteresis, return maps, and branches of fixed points."""

from __future__ import annotations

import math
from collections.abc import Hashable, Sequence
from typing import Literal, get_args

import numpy as np
import pandas as pd

from gaitsweep.analyses import (
    LEAST_JUMP,
    AnalysisError,
    fixed_points,
    require,
    stable_ranges,
    transition_points,
    transition_points_by_gait,
    wrapped_difference,
)
from gaitsweep.claims import masked, measure, numbers, value

Direction = Literal["rising", "falling"]


@measure
def transition_at(
    table: pd.DataFrame, *, observable: str, parameter: str, direction: Direction, least: float = LEAST_JUMP
) -> float:
    """Middle of the interval in which a ramp or staircase jumps as the parameter moves one way.

    Args:
        table: a ramp's or a staircase's table.
        observable: the observable that jumps.
        parameter: the parameter that moves.
        direction: whether it rises or falls.
        least: the smallest change of the observable that is a jump.

    Raises:
        AnalysisError: no row jumps.
    """
    points = transition_points(table, observable, parameter, least)
    return _middles(points, direction, f"No row jumps as {parameter} is {direction}.")[0]


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

    def width(group: pd.DataFrame, place: str) -> float:
        otherwise = f"{observable} does not jump in each direction{place}."
        rising, falling = (_middles(group, direction, otherwise)[0] for direction in get_args(Direction))
        return rising - falling

    if by is None:
        return [width(points, "")]
    values = sorted(table[by].dropna().unique())
    return [width(masked(points, points[by] == value), f" at {by} = {value}") for value in values]


@measure
def bistable_ranges(
    table: pd.DataFrame, *, observable: str, parameter: str, apart: float, by: str
) -> list[float]:
    """Length of the parameter's range with two different settled holds at each stair, per value of `by`.

    Args:
        table: a staircase's table.
        observable: an angle; two of its values are different if they are more than `apart` (rad) apart.
        parameter: the parameter that moves. Each stair stands for the range up to the middles between it and
            its neighbours; the range of the first and the last stair is symmetric about it.
        apart: rad.
        by: the column of the groups.

    Raises:
        AnalysisError: the table does not have a column or has a single stair, or no hold of a group settled.
    """
    require(table, "settled", parameter, f"{observable}_n", by)
    table = table.assign(**{parameter: _stairs(pd.Series(table[parameter]))})
    width_of_stair = _widths_of_stairs(table, parameter)

    def differ(holds: pd.DataFrame) -> bool:
        angles = numbers(holds, f"{observable}_n")
        return bool(np.ptp(wrapped_difference(angles - angles[0])) > apart)

    lengths = []
    for group, holds in table.groupby(by, sort=True, observed=True):
        settled = masked(holds, holds["settled"].eq(True))
        if settled.empty:
            raise AnalysisError(f"No hold settled at {by} = {group}.")
        stairs = settled.groupby(parameter)
        lengths.append(float(sum(width_of_stair[stair] for stair, part in stairs if differ(part))))
    return lengths


def _stairs(values: pd.Series) -> pd.Series:
    """The parameter's value of each record's stair, without the rounding by which passes differ."""
    largest = float(values.abs().max())
    smaller = max(0, -math.floor(math.log10(largest))) if largest > 0.0 else 0
    return values.round(9 + smaller)


def _widths_of_stairs(table: pd.DataFrame, parameter: str) -> dict[Hashable, float]:
    """The width of the range that each stair stands for, by its value.

    Raises:
        AnalysisError: the table has a single stair.
    """
    stairs = np.unique(table[parameter].dropna().to_numpy(float))
    if len(stairs) < 2:
        raise AnalysisError(f"{parameter} has a single stair, whose width is unknown.")
    steps = np.diff(stairs)
    widths = 0.5 * (np.append(steps[0], steps) + np.append(steps, steps[-1]))
    return dict(zip(stairs.tolist(), widths.tolist(), strict=True))


@measure
def gait_lost_at(
    table: pd.DataFrame, *, parameter: str, gait: str, direction: Direction, start: str = "delta_13"
) -> float:
    """Middle of the interval of the parameter in which settled rows lose a gait.

    Args:
        table: a settle table over the parameter.
        parameter: its name.
        gait: the gait that is lost.
        direction: whether the parameter rises or falls.
        start: the column of the start by which rows are followed.

    Raises:
        AnalysisError: the gait is not lost.
    """
    points = transition_points_by_gait(table, parameter, start)
    losses = masked(points, points["gait"] == gait)
    return _middles(losses, direction, f"The gait {gait} is not lost as {parameter} is {direction}.")[0]


def _middles(points: pd.DataFrame, direction: Direction, otherwise: str) -> list[float]:
    """The middles of the intervals in a direction.

    Raises:
        AnalysisError: there is none; `otherwise` is its sentence.
    """
    intervals = masked(points, points["direction"] == direction)
    if intervals.empty:
        raise AnalysisError(otherwise)
    return ((numbers(intervals, "low") + numbers(intervals, "high")) / 2.0).tolist()


@measure
def gap_of_edges(table: pd.DataFrame, *, parameter: str, upper: str, lower: str) -> float:
    """Width of the range in which both gaits persist.

    Args:
        table, parameter: as for `gait_lost_at`.
        upper: the gait that is lost as the parameter rises.
        lower: the gait that is lost as it falls.

    Raises:
        AnalysisError: one of the gaits is not lost.
    """
    highest = gait_lost_at(table, parameter=parameter, gait=upper, direction="rising")
    return highest - gait_lost_at(table, parameter=parameter, gait=lower, direction="falling")


@measure
def directions_of_loss(*tables: pd.DataFrame, observable: str, parameters: Sequence[str]) -> list[str]:
    """Direction of each table's parameter in which the observable jumps down.

    Args:
        tables: ramps' or staircases' tables.
        observable: the observable that jumps.
        parameters: for each table, the parameter that moves.

    Raises:
        AnalysisError: the observable does not jump down in a table.
    """
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

    Raises:
        AnalysisError: the observable does not jump in each direction in a table.
    """
    ranges = []
    for table, column in zip(tables, by, strict=True):
        points = transition_points(table, observable, parameter, by=[column])
        for direction in get_args(Direction):
            otherwise = f"{observable} does not jump as {parameter} is {direction}."
            ranges.append(float(np.ptp(_middles(points, direction, otherwise))))
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
    points = masked(points, np.isclose(points[parameter].to_numpy(float), at)).sort_values("value")
    return ["stable" if stable else "unstable" for stable in points["stable"]]


@measure
def stable_until(
    table: pd.DataFrame,
    *,
    observable: str,
    parameter: str,
    between: Sequence[float],
    take: Literal["min", "max"],
    bandwidth: float | None = None,
) -> float:
    """Largest or smallest parameter at which the return map has a stable point in a range.

    Args:
        table, observable, parameter, bandwidth: as for `kinds_of_fixed_points`.
        between: the range of the observable, low and high.
        take: whether the smallest or the largest parameter counts.

    Raises:
        AnalysisError: no stable fixed point is in the range.
    """
    points = fixed_points(table, observable, parameter, bandwidth)
    low, high = between
    points = masked(points, points["stable"].astype(bool) & points["value"].between(low, high))
    if points.empty:
        raise AnalysisError(f"No stable fixed point has {observable} between {low:g} and {high:g}.")
    return value(points, column=parameter, take=take)


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
        places = np.flatnonzero(stable)
        if len(places) > 1:
            separated.append(not stable[places[0] : places[-1]].all())
    if not separated:
        raise AnalysisError("No value of the parameter has two stable fixed points.")
    return sum(separated) / len(separated)


@measure
def gaits_of_branch(table: pd.DataFrame, *, parameter: str) -> list[str]:
    """Gaits of the stable pieces of the first branch of a continuation, in their order along it."""
    pieces = stable_ranges(table, parameter)
    return list(dict.fromkeys(pieces.loc[pieces["row"] == pieces["row"].min(), "gait"].astype(str)))
