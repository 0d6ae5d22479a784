"""Jumps of a section observable from one branch to another along a row.

A course is the ordered records of one row, with the observable unwrapped. A jump of a staircase is between
two holds; a jump of a ramp is a stretch of crossings in which the smoothed observable changes faster than on
a branch.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import pandas as pd
import scipy
from jaxtyping import Bool, Float, Int, Shaped

from gaitsweep.analysis.records import require, require_numbers, section_column, sound
from gaitsweep.angles import is_circular

SMOOTH = 5  # crossings of a ramp over which the observable is averaged
SPAN = 40  # crossings of a ramp within which a jump changes the observable by `least`
# Shares of a jump in its slow ends, which are cut off. A ramp has many crossings on the bent end of a branch;
# of a staircase only the small change of a hold just beyond the edge is cut off.
CROSSING_FOOT, HOLD_FOOT = 0.1, 0.02
STEEPER = 4.0  # least ratio of a jump to the row's slower changes; else it is a steep branch or noise
# Without a least size, a jump between holds is as much steeper than the median of so many changes on each
# side, and has this share of the range of its row or changes the gait.
BESIDE, LEAST_SHARE = 3, 0.05
# Changes of a staircase below this share of the observable's largest value, or below `NOISE_FLOOR` in its
# unit, are what settling to a tolerance and rounding leave.
NOISE_SHARE, NOISE_FLOOR = 1e-6, 1e-9
LEAST_JUMP = 0.15  # least change of a ramp's jump, in the observable's unit


class Course(NamedTuple):
    """One row of a ramp or a staircase, (n,) each; the observable is unwrapped, and smoothed for a ramp.

    `settled` marks the records on a branch (None for a ramp); `first` is the row's first record; `gait` holds
    the labels of the records (all the same in a table without gaits).
    """

    first: pd.Series
    parameter: Float[np.ndarray, " records"]
    passes: Int[np.ndarray, " records"]
    value: Float[np.ndarray, " records"]
    settled: Bool[np.ndarray, " records"] | None
    gait: Shaped[np.ndarray, " records"]


def courses(table: pd.DataFrame, observable: str, parameter: str) -> Iterator[Course]:
    """The rows of a ramp or staircase table with at least two records; NaN and falls are left out."""
    name = section_column(table, observable)
    stairs = "stair" in table.columns
    order = "stair" if stairs else "crossing"
    require(table, "row", "pass", order)
    require_numbers(table, parameter)
    table = table.sort_values(["row", order], kind="stable")
    circular = is_circular(table, name)
    table = table.loc[sound(table, name, parameter)]
    for _, part in table.groupby("row", sort=True):
        begin = 0 if stairs else where_it_moves(part[parameter].to_numpy(float))
        if len(part) - begin < 2:
            continue
        value = part[name].to_numpy(float)[begin:]
        value = np.unwrap(value) if circular else value
        settled = None
        if not stairs:
            value = scipy.ndimage.uniform_filter1d(value, SMOOTH, mode="nearest")
        elif "settled" in part.columns:
            settled = part["settled"].to_numpy(bool)[begin:]
        else:
            settled = np.ones(len(value), bool)
        parameters, passes = part[parameter].to_numpy(float)[begin:], part["pass"].to_numpy(int)[begin:]
        gait = part["gait"].astype(str).to_numpy()[begin:] if "gait" in part.columns else passes * 0
        yield Course(part.iloc[0], parameters, passes, value, settled, gait)


def stretches(course: Course, least: float | None) -> list[tuple[int, int]]:
    """The jumps of a course, in order: each is the last record before it and the first after it.

    Args:
        course: the course.
        least: the least change of a jump, in the observable's unit; a jump is also larger than four times the
            lower quartile of the course's changes. None: of a staircase, the changes that are four times as
            large as those beside them, and change the gait or are a twentieth of the range.
    """
    if course.settled is None:
        return _along_crossings(course.value, LEAST_JUMP if least is None else least)
    if least is not None:
        return _between_holds(course.value, course.settled, least)
    change = np.abs(np.diff(course.value))
    noise = max(NOISE_SHARE * float(np.max(np.abs(course.value))), NOISE_FLOOR)
    floor = LEAST_SHARE * float(np.ptp(course.value))
    jumps = []
    for start, stop in _between_holds(course.value, course.settled, 0.0):
        size = abs(course.value[stop] - course.value[start])
        beside = np.concatenate([change[max(start - BESIDE, 0) : start], change[stop : stop + BESIDE]])
        other_gait = course.gait[start] != course.gait[stop]
        steep = not beside.size or size > STEEPER * float(np.median(beside))
        if steep and size > noise and (size >= floor or other_gait):
            jumps.append((start, stop))
    return jumps


def where_it_moves(parameter: Float[np.ndarray, " records"]) -> int:
    """The index of the last record before a ramp moves; earlier ones are a transient of the start."""
    moved = np.flatnonzero(parameter != parameter[0]) if len(parameter) else np.zeros(0, int)
    return max(int(moved[0]) - 1, 0) if len(moved) else 0


def records_of(course: Course, number: int) -> Int[np.ndarray, " of_pass"]:
    """The indices (k,) of a pass's records with the turning point before it; empty without such a pass."""
    members = np.flatnonzero(course.passes == number)
    return np.arange(max(members[0] - 1, 0), members[-1] + 1) if len(members) else members


def rising(course: Course, number: int) -> bool:
    """Whether the parameter rises in a pass of a course."""
    members = records_of(course, number)
    return bool(course.parameter[members[-1]] >= course.parameter[members[0]])


def _between_holds(
    value: Float[np.ndarray, " records"], settled: Bool[np.ndarray, " records"], least: float
) -> list[tuple[int, int]]:
    """The jumps between holds; changes in one direction across unsettled holds are one jump."""
    change = np.diff(value)
    least = max(least, STEEPER * float(np.quantile(np.abs(change), 0.25)))
    moves = []
    begin = 0
    while begin < len(change):
        end = begin + 1
        while end < len(change) and not settled[end] and change[end] * change[begin] > 0:
            end += 1
        start, stop = _without_feet(value, begin, end, HOLD_FOOT)
        if abs(value[stop] - value[start]) >= least:
            moves.append((start, stop))
        begin = end
    return moves


def _without_feet(
    value: Float[np.ndarray, " records"], start: int, stop: int, foot: float
) -> tuple[int, int]:
    """A stretch without its slow ends, each of which holds less than the share `foot` of the change."""
    change = value[stop] - value[start]
    share = (value[start : stop + 1] - value[start]) / (change if change != 0.0 else 1.0)
    after = int(np.argmax(share >= 1.0 - foot))
    before = int(np.flatnonzero(share[: after + 1] <= foot)[-1])
    return start + before, start + after


def _along_crossings(value: Float[np.ndarray, " records"], least: float) -> list[tuple[int, int]]:
    """The jumps of a ramp: stretches of crossings in which the observable changes fast."""
    span = min(SPAN, len(value) - 1)
    change = value[span:] - value[:-span]
    least = max(least, STEEPER * float(np.quantile(np.abs(change), 0.25)))
    sign = np.sign(change) * (np.abs(change) >= least)
    turns = np.flatnonzero(np.diff(np.concatenate([[0.0], sign, [0.0]])))
    return [
        _without_feet(value, int(begin), int(end) - 1 + span, CROSSING_FOOT)
        for begin, end in itertools.pairwise(turns)
        if sign[begin] != 0
    ]
