"""Jumps of a section observable from one branch to another along a row.

A course is the ordered records of one row, with the observable unwrapped. A jump of a staircase is between
two holds; a jump of a ramp is a stretch of crossings in which the smoothed observable changes faster than on
a branch.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
import pandas as pd
import scipy
from jaxtyping import Bool, Float, Int, Shaped
from numpy.typing import ArrayLike

from gaitsweep.analysis.records import (
    AnalysisError,
    axes_of,
    is_true,
    require,
    require_numbers,
    require_single_records,
    section_column,
    sound,
)
from gaitsweep.angles import TURN, branch_cut, is_circular, unwrap_from

SMOOTH = 5  # crossings of a ramp over which the observable is averaged
SPAN = 40  # crossings of a ramp within which a jump changes the observable by `least`
# Shares of a jump in its slow ends, which are cut off. A ramp has many crossings on the bent end of a branch;
# of a staircase only the small change of a hold just beyond the edge is cut off.
CROSSING_FOOT, HOLD_FOOT = 0.1, 0.02
STEEPER = 4.0  # least ratio of a jump to the row's slower changes; else it is a steep branch or noise
# Without a least size, a jump between holds is as much steeper than the median of so many changes on each
# side, and changes the gait or has this share of the range of all rows.
BESIDE, LEAST_SHARE = 3, 0.05
# Changes of a staircase below this share of the observable's largest value, or below `NOISE_FLOOR` in its
# unit, are what settling to a tolerance and rounding leave.
NOISE_SHARE, NOISE_FLOOR = 1e-6, 1e-9
LEAST_JUMP = 0.15  # least change of a ramp's jump, in the observable's unit


class Course(NamedTuple):
    """One row of a ramp or a staircase, (n,) each; the observable is unwrapped, and smoothed for a ramp.

    `settled` marks the records on a branch (None for a ramp); `first` is the row's first record; `gait` holds
    the labels of the records (all the same in a table without gaits); `large` is a change that is large
    among the values of all rows.
    """

    first: pd.Series
    parameter: Float[np.ndarray, " records"]
    passes: Int[np.ndarray, " records"]
    value: Float[np.ndarray, " records"]
    settled: Bool[np.ndarray, " records"] | None
    gait: Shaped[np.ndarray, " records"]
    large: float


class Stretch(NamedTuple):
    """A jump of a course: the indices of the last record before it and of the first after it."""

    start: int
    stop: int


def jumps(
    table: pd.DataFrame, observable: str, parameter: str, least: float | None = LEAST_JUMP
) -> pd.DataFrame:
    """The jumps of each row and pass of a ramp or a staircase.

    Args:
        table: a ramp or staircase table; NaN records and the last ones before a fall are left out.
        observable: a section observable (delta_13); angles are unwrapped.
        parameter: the column of the moving parameter.
        least: the least change of a jump, in the observable's unit: between two holds, or within 40 crossings
            of a ramp. A jump is also larger than four times the lower quartile of such changes in the row, or
            than four times the other change of three holds. None: of a staircase, the changes that are four
            times as large as those beside them, and change the gait or are a twentieth of the range of all
            rows; of two holds, those that change the gait.

    Returns:
        One record a jump: row, swept axes, pass, direction (rising or falling, the parameter's), `low` and
        `high` (the parameter's interval: from the last value before the jump to the first after it; for a
        ramp, where a tenth and nine tenths of it are completed), before, after, size (after - before; of
        about half a turn, with the sign that figures show).

    Raises:
        AnalysisError: the table does not have a column, its values are not numbers, or `least` is not above
            0.
    """
    if least is not None and not least > 0.0:
        raise AnalysisError(f"least is {least:g}, but must be above 0.")
    name = section_column(table, observable)
    require_numbers(table, name)
    circular, axes = is_circular(table, name), axes_of(table)
    cut = branch_cut(table[name].to_numpy(float)) if circular else 0.0
    records = []
    for course in courses(table, observable, parameter):
        for start, stop in stretches(course, least):
            number = int(course.passes[stop if course.settled is not None else (start + stop) // 2])
            passed = course.parameter[start : stop + 1]
            before, after = course.value[[start, stop]]
            direction = "rising" if rising(course, number) else "falling"
            size = after - before
            # of about half a turn both ways are alike: that of figures is used
            if circular and abs(abs(size) - TURN / 2) < LEAST_JUMP:
                size = float(unwrap_from(after, cut) - unwrap_from(before, cut))
            if circular:
                before, after = np.mod(before, TURN), np.mod(after, TURN)
            record = {**row_and_axes(course, axes), "pass": number, "direction": direction}
            record |= {"low": passed.min(), "high": passed.max()}
            records.append(record | {"before": before, "after": after, "size": size})
    columns = ["row", *axes, "pass", "direction", "low", "high", "before", "after", "size"]
    return pd.DataFrame(records, columns=columns)


def largest_jumps(
    table: pd.DataFrame, observable: str, parameter: str, least: float | None = LEAST_JUMP
) -> pd.DataFrame:
    """The largest of the `jumps` of each row and pass, in the same columns, without `irregular_passes`.

    Args:
        table, observable, parameter, least: as for `jumps`.

    Raises:
        AnalysisError: the table does not have a column.
    """
    steady = _on_branches(table, observable, parameter, least)
    largest = steady.assign(height=steady["size"].abs()).sort_values("height", kind="stable")
    return largest.drop_duplicates(["row", "pass"], keep="last").drop(columns="height").sort_index()


def jump_intervals(
    table: pd.DataFrame, observable: str, parameter: str, least: float | None = None
) -> pd.DataFrame:
    """The intervals of the parameter in which rows jump, all of each pass, without `irregular_passes`.

    Args:
        table, observable, parameter, least: as for `jumps`.

    Returns:
        One record for the jumps of a pass whose intervals overlap: pass, direction, `low` and `high` (medians
        over the rows), rows (that jump there), of (all rows).

    Raises:
        AnalysisError: the table does not have a column.
    """
    steady = _on_branches(table, observable, parameter, least)
    records = []
    for _, part in steady.sort_values("low").groupby(["pass", "direction"]):
        number, direction = part["pass"].iloc[0], part["direction"].iloc[0]
        reach = part["high"].cummax().shift(fill_value=-np.inf)
        for _, together in part.groupby((part["low"] >= reach).cumsum()):
            low, high = lower_median(together["low"]), upper_median(together["high"])
            record = {"pass": number, "direction": direction, "low": low, "high": high}
            records.append(record | {"rows": together["row"].nunique(), "of": table["row"].nunique()})
    return pd.DataFrame(records, columns=["pass", "direction", "low", "high", "rows", "of"])


def irregular_passes(
    table: pd.DataFrame, observable: str, parameter: str, least: float | None = None
) -> pd.DataFrame:
    """The passes on no branch (row, pass), which reverse direction at least twice, by `least` or more.

    Either their jumps do, or the observable without its jumps, which is smoothed for a ramp: a branch may
    slope against a jump.

    Args:
        table, observable, parameter: as for `jumps`.
        least: the least change of a jump, in the observable's unit; by default `LEAST_JUMP`, and of a
            staircase whose observable is no angle this share of the range of all rows.

    Raises:
        AnalysisError: the table does not have a column.
    """
    if least is None:
        large = large_change(table, observable, parameter)
        least = LEAST_JUMP if large is None else LEAST_JUMP * large / LEAST_SHARE
    all_jumps = jumps(table, observable, parameter, least)
    oscillating = all_jumps.loc[_oscillating(all_jumps), ["row", "pass"]].to_numpy()
    passes = {(row, int(number)) for row, number in oscillating}
    for course in courses(table, observable, parameter):
        slopes = _without_jumps(course, least)
        for number in np.unique(course.passes):
            if _reversals(slopes[records_of(course, int(number))], least) >= 2:
                passes.add((course.first["row"], int(number)))
    return pd.DataFrame(sorted(passes), columns=["row", "pass"]).astype(int)


def large_change(table: pd.DataFrame, observable: str, parameter: str) -> float | None:
    """The change that is large for all rows of a staircase, `Course.large`; None where there is none.

    Angles have none, ramps neither, nor an observable that does not change.

    Args:
        table, observable, parameter: as for `jumps`.
    """
    if "stair" not in table.columns or is_circular(table, section_column(table, observable)):
        return None
    first = next(courses(table, observable, parameter), None)
    return None if first is None else first.large or None


def courses(table: pd.DataFrame, observable: str, parameter: str) -> Iterator[Course]:
    """The rows of a ramp or staircase table with at least two records; NaN and falls are left out.

    Args:
        table, observable, parameter: as for `jumps`.

    Raises:
        AnalysisError: the table does not have a column, its values are not numbers, or rows of several tables
            have the same number.
    """
    name = section_column(table, observable)
    stairs = "stair" in table.columns
    order = "stair" if stairs else "crossing"
    require(table, "row", "pass", order)
    require_numbers(table, name, parameter)
    require_single_records(table, order)
    table = table.sort_values(["row", order], kind="stable")
    circular = is_circular(table, name)
    table = table.loc[sound(table, name, parameter, "pass")]
    values = table[name].to_numpy(float)
    values = unwrap_from(values, branch_cut(values)) if circular and len(values) else values
    large = LEAST_SHARE * float(np.ptp(values)) if len(values) else 0.0
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
            settled = is_true(part, "settled")[begin:]
        else:
            settled = np.ones(len(value), bool)
        parameters, passes = part[parameter].to_numpy(float)[begin:], part["pass"].to_numpy(int)[begin:]
        gait = part["gait"].astype(str).to_numpy()[begin:] if "gait" in part.columns else passes * 0
        yield Course(part.iloc[0], parameters, passes, value, settled, gait, large)


def stretches(course: Course, least: float | None) -> list[Stretch]:
    """The jumps of a course, in order.

    Args:
        course: the course.
        least: the least change of a jump, in the observable's unit; a jump is also larger than four times the
            lower quartile of the course's changes, or than four times the other change of three holds. None:
            of a staircase, the changes that are four times as large as those beside them, and change the gait
            or are `Course.large`; of two holds, those that change the gait.
    """
    if course.settled is None:
        return _along_crossings(course.value, LEAST_JUMP if least is None else least)
    if least is not None:
        return _between_holds(course.value, course.settled, least)
    change = np.abs(np.diff(course.value))
    noise = max(NOISE_SHARE * float(np.max(np.abs(course.value))), NOISE_FLOOR)
    jumps = []
    for start, stop in _between_holds(course.value, course.settled, 0.0):
        size = abs(course.value[stop] - course.value[start])
        beside = np.concatenate([change[max(start - BESIDE, 0) : start], change[stop : stop + BESIDE]])
        other_gait = course.gait[start] != course.gait[stop]
        steepest = float(np.max(change[start:stop], initial=0.0))
        # of two holds no other change shows what is usual, so the gait decides
        steep = steepest > STEEPER * float(np.median(beside)) if beside.size else other_gait
        if steep and size > noise and (size >= course.large or other_gait):
            jumps.append(Stretch(start, stop))
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
) -> list[Stretch]:
    """The jumps between holds; changes in one direction across unsettled holds are one jump."""
    change = np.diff(value)
    sizes = np.sort(np.abs(change))
    # the quartile of one or two changes is made of the largest one itself
    usual = np.quantile(sizes, 0.25) if len(sizes) > 2 else sizes[:-1].sum()
    steep = STEEPER * float(usual)
    moves = []
    begin = 0
    while begin < len(change):
        end = begin + 1
        while end < len(change) and not settled[end] and change[end] * change[begin] > 0:
            end += 1
        move = _without_feet(value, begin, end, HOLD_FOOT)
        # the steepest step decides: a slope over many unsettled holds adds up to a large change, too
        steepest = float(np.max(np.abs(change[move.start : move.stop]), initial=0.0))
        if abs(value[move.stop] - value[move.start]) >= least and steepest >= steep:
            moves.append(move)
        begin = end
    return moves


def _without_feet(value: Float[np.ndarray, " records"], start: int, stop: int, foot: float) -> Stretch:
    """A stretch without its slow ends, each of which holds less than the share `foot` of the change."""
    change = value[stop] - value[start]
    share = (value[start : stop + 1] - value[start]) / (change if change != 0.0 else 1.0)
    after = int(np.argmax(share >= 1.0 - foot))
    before = int(np.flatnonzero(share[: after + 1] <= foot)[-1])
    return Stretch(start + before, start + after)


def _along_crossings(value: Float[np.ndarray, " records"], least: float) -> list[Stretch]:
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


def _on_branches(table: pd.DataFrame, observable: str, parameter: str, least: float | None) -> pd.DataFrame:
    """The `jumps` without those of `irregular_passes`."""
    all_jumps = jumps(table, observable, parameter, least)
    irregular = pd.MultiIndex.from_frame(irregular_passes(table, observable, parameter, least))
    of_jumps = pd.MultiIndex.from_arrays([all_jumps["row"], all_jumps["pass"]])
    return all_jumps.iloc[np.flatnonzero(~of_jumps.isin(irregular))]


def lower_median(values: ArrayLike) -> float:
    """The median, of an even number of values the lower of the two in the middle."""
    return float(np.quantile(np.asarray(values, float), 0.5, method="lower"))


def upper_median(values: ArrayLike) -> float:
    """The median, of an even number of values the higher of the two in the middle."""
    return float(np.quantile(np.asarray(values, float), 0.5, method="higher"))


def _oscillating(all_jumps: pd.DataFrame) -> Bool[np.ndarray, " jumps"]:
    """Whether each of the `jumps` is of a pass whose jumps reverse direction at least twice, (n,)."""
    size = all_jumps["size"].to_numpy(float)
    pass_number = all_jumps.groupby(["row", "pass"]).ngroup().to_numpy(int)
    reverses = (size[1:] * size[:-1] < 0.0) & (pass_number[1:] == pass_number[:-1])
    turns = np.bincount(pass_number[1:][reverses], minlength=int(pass_number.max(initial=0)) + 1)
    return turns[pass_number] >= 2


def _without_jumps(course: Course, least: float) -> Float[np.ndarray, " records"]:
    """The values of a course less those before them that its jumps, with their slow ends, have added."""
    change = np.diff(course.value)
    for start, stop in stretches(course, least):
        size = course.value[stop] - course.value[start]
        while start > 0 and change[start - 1] * size > 0.0:
            start -= 1
        while stop < len(change) and change[stop] * size > 0.0:
            stop += 1
        change[start:stop] = 0.0
    return np.concatenate([[0.0], np.cumsum(change)])


def _reversals(value: Float[np.ndarray, " records"], least: float) -> int:
    """The number of times that a course turns back, having moved by `least` or more since the last turn."""
    turns = 0
    direction = 0  # of the last move: 1 or -1, 0 before the first
    low = high = value[0]  # the extremes since the last turn
    for x in value:
        low, high = min(low, x), max(high, x)
        if direction <= 0 and x - low >= least:
            turns += direction < 0
            direction = 1
            high = x
        elif direction >= 0 and high - x >= least:
            turns += direction > 0
            direction = -1
            low = x
    return turns


def row_and_axes(course: Course, axes: Sequence[str]) -> dict[str, object]:
    """The row of a course, and its values of the swept axes."""
    return {name: course.first[name] for name in ("row", *axes)}
