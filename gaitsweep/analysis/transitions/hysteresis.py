"""Hysteresis: the transition points as a parameter rises and falls, and the area of the loop.

The functions read ramps (a slowly moving parameter), staircases (a parameter held at each value in turn) and
settled rows. A ramp lags: it jumps after the transition point, and the faster it is, the later. The interval
of a staircase contains the point if its holds are long enough; those of settled rows always do.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Sequence

import numpy as np
import pandas as pd
from jaxtyping import Bool, Float, Shaped
from numpy.typing import ArrayLike

from gaitsweep.analysis.records import (
    AnalysisError,
    axes_of,
    names_in,
    panels_of,
    require,
    require_numbers,
    section_column,
)
from gaitsweep.analysis.transitions.jumps import LEAST_JUMP, Course, courses, records_of, rising, stretches
from gaitsweep.angles import TURN, branch_cut, is_circular, mean_direction, unwrap_from, wrapped_difference
from gaitsweep.near_miss import suggestion
from gaitsweep.status import Outcome, Status


@dataclasses.dataclass(frozen=True)
class Hysteresis:
    """The parameter values at which states are lost, and the areas between the branches of both directions.

    Of ramps and staircases both tables have the column `observable`.

    Attributes:
        transition_points: one record a pass (direction, low, high, size, rows, ...), or a gait for settled
            rows.
        loops: one record a row and pair of passes (area, signed, low, high); areas are in the parameter's
            unit times the observable's.
    """

    transition_points: pd.DataFrame
    loops: pd.DataFrame


def hysteresis(
    table: pd.DataFrame,
    observable: str | None = None,
    parameter: str | None = None,
    *,
    start: str | None = None,
    least: float = LEAST_JUMP,
    by: str | Sequence[str] = (),
) -> Hysteresis:
    """Measure the hysteresis of a ramp, of a staircase, or of settled rows.

    Args:
        table: a table of one of these runs.
        observable: the section observable that jumps; each of the table's in turn by default.
        parameter: the parameter's column; the one that the run moved by default.
        start: of settled rows, the column of the start value that selects the branch.
        least: smallest change that counts as a jump, in the observable's unit.
        by: swept axes; the transition points of each of their combinations are separate. `loops` are always
            of single rows, so `by` does not change them.

    Raises:
        AnalysisError: a column is not there, has to be named, or is no swept axis.

    Example:
        A speed rises in four stairs and falls again; x jumps from 0 to 1 between 3 and 4, and back between
        2 and 1:

        >>> import pandas as pd, gaitsweep as gs
        >>> table = pd.DataFrame({"row": 0, "pass": [0, 0, 0, 0, 1, 1, 1, 1], "stair": range(8)})
        >>> table["speed"], table["x_n"] = [1, 2, 3, 4, 4, 3, 2, 1], [0, 0, 0, 1, 1, 1, 1, 0]
        >>> measured = gs.hysteresis(table, "x", "speed")
        >>> measured.transition_points[["direction", "low", "high"]].to_numpy().tolist()
        [['rising', 3.0, 4.0], ['falling', 1.0, 2.0]]
        >>> measured.loops["area"].tolist()
        [2.0]
    """
    run = table.attrs.get("job", {}).get("run", {})
    parameter = parameter or run.get("parameter")
    if parameter is None:
        raise AnalysisError("No parameter moves in this run: name the column as parameter=.")
    if "pass" not in table.columns:
        if start is None:
            raise AnalysisError(
                "These rows have no passes up and down: name the column of the start value that selects the "
                "branch as start=."
            )
        return Hysteresis(transition_points_by_gait(table, parameter, start, by=by), pd.DataFrame())
    names = [observable] if observable is not None else _observables(table)
    points = [transition_points(table, name, parameter, least, by).assign(observable=name) for name in names]
    loops = [loop_area(table, name, parameter).assign(observable=name) for name in names]
    return Hysteresis(_joined(points), _joined(loops))


def jumps(
    table: pd.DataFrame, observable: str, parameter: str, least: float | None = LEAST_JUMP
) -> pd.DataFrame:
    """The jumps of each row and pass of a ramp or a staircase.

    Args:
        table: a ramp or staircase table; NaN records and the last ones before a fall are left out.
        observable: a section observable (delta_13); angles are unwrapped.
        parameter: the column of the moving parameter.
        least: the least change of a jump, in the observable's unit: between two holds, or within 40 crossings
            of a ramp. A jump is also larger than four times the lower quartile of such changes in the row.
            None: of a staircase, the changes that are four times as large as those beside them, and change
            the gait or are a twentieth of the row's range.

    Returns:
        One record a jump: row, swept axes, pass, direction (rising or falling, the parameter's), `low` and
        `high` (the parameter's interval: from the last value before the jump to the first after it; for a
        ramp, where a tenth and nine tenths of it are completed), before, after, size (after - before; of
        about half a turn, with the sign that figures show).

    Raises:
        AnalysisError: the table does not have a column.
    """
    name = section_column(table, observable)
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
            if (
                circular and abs(abs(size) - TURN / 2) < LEAST_JUMP
            ):  # both ways are alike: take that of figures
                size = float(unwrap_from(after, cut) - unwrap_from(before, cut))
            if circular:
                before, after = np.mod(before, TURN), np.mod(after, TURN)
            record = {**_row_and_axes(course, axes), "pass": number, "direction": direction}
            record |= {"low": passed.min(), "high": passed.max()}
            records.append(record | {"before": before, "after": after, "size": size})
    columns = ["row", *axes, "pass", "direction", "low", "high", "before", "after", "size"]
    return pd.DataFrame(records, columns=columns)


def largest_jumps(
    table: pd.DataFrame, observable: str, parameter: str, least: float = LEAST_JUMP
) -> pd.DataFrame:
    """The largest of the `jumps` of each row and pass, in the same columns, without `irregular_passes`.

    Args:
        table, observable, parameter, least: as for `jumps`.

    Raises:
        AnalysisError: the table does not have a column.
    """
    all_jumps = jumps(table, observable, parameter, least)
    irregular = _irregular(all_jumps, table, observable, parameter, least)
    steady = _without_passes(all_jumps, irregular)
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
    irregular = irregular_passes(table, observable, parameter, LEAST_JUMP if least is None else least)
    steady = _without_passes(jumps(table, observable, parameter, least), irregular)
    records = []
    for _, part in steady.sort_values("low").groupby(["pass", "direction"]):
        number, direction = part["pass"].iloc[0], part["direction"].iloc[0]
        reach = part["high"].cummax().shift(fill_value=-np.inf)
        for _, together in part.groupby((part["low"] >= reach).cumsum()):
            low, high = _lower_median(together["low"]), _upper_median(together["high"])
            record = {"pass": number, "direction": direction, "low": low, "high": high}
            records.append(record | {"rows": together["row"].nunique(), "of": table["row"].nunique()})
    return pd.DataFrame(records, columns=["pass", "direction", "low", "high", "rows", "of"])


def irregular_passes(
    table: pd.DataFrame, observable: str, parameter: str, least: float = LEAST_JUMP
) -> pd.DataFrame:
    """The passes on no branch (row, pass), which reverse direction at least twice, by `least` or more.

    Either their jumps do, or the observable without its jumps, which is smoothed for a ramp: a branch may
    slope against a jump.

    Args:
        table, observable, parameter, least: as for `jumps`.

    Raises:
        AnalysisError: the table does not have a column.
    """
    return _irregular(jumps(table, observable, parameter, least), table, observable, parameter, least)


def _irregular(
    all_jumps: pd.DataFrame, table: pd.DataFrame, observable: str, parameter: str, least: float
) -> pd.DataFrame:
    """The `irregular_passes` of a table whose `jumps` are found."""
    oscillating = all_jumps.loc[_oscillating(all_jumps), ["row", "pass"]].to_numpy()
    passes = {(row, int(number)) for row, number in oscillating}
    for course in courses(table, observable, parameter):
        slopes = _without_jumps(course, least)
        for number in np.unique(course.passes):
            if _reversals(slopes[records_of(course, int(number))], least) >= 2:
                passes.add((course.first["row"], int(number)))
    return pd.DataFrame(sorted(passes), columns=["row", "pass"]).astype(int)


def _without_passes(all_jumps: pd.DataFrame, passes: pd.DataFrame) -> pd.DataFrame:
    """The `jumps` without those of some passes (row, pass)."""
    of_jumps = pd.MultiIndex.from_arrays([all_jumps["row"], all_jumps["pass"]])
    return all_jumps.iloc[np.flatnonzero(~of_jumps.isin(pd.MultiIndex.from_frame(passes)))]


def _lower_median(values: ArrayLike) -> float:
    """The median, of an even number of values the lower of the two in the middle."""
    return float(np.quantile(np.asarray(values, float), 0.5, method="lower"))


def _upper_median(values: ArrayLike) -> float:
    """The median, of an even number of values the higher of the two in the middle."""
    return float(np.quantile(np.asarray(values, float), 0.5, method="higher"))


def transition_points(
    table: pd.DataFrame,
    observable: str,
    parameter: str,
    least: float = LEAST_JUMP,
    by: str | Sequence[str] = (),
) -> pd.DataFrame:
    """The transition point of each pass, over all rows on a branch: their `largest_jumps`.

    Args:
        table, observable, parameter, least: as for `jumps`.
        by: swept axes; rows with equal values are pooled.

    Returns:
        One record for each pass with a jump: by, pass, direction, `low` and `high` (medians over the rows;
        the outer one for an even number), `lowest` and `highest` (over all rows), size (median), rows (that
        jump), of (all rows).

    Raises:
        AnalysisError: the table does not have a column, or `by` has a name that is no swept axis.
    """
    by = names_in(by)
    _require_axes(table, by)
    largest = largest_jumps(table, observable, parameter, least)
    keys = [*by, "pass", "direction"]
    points = (
        largest.groupby(keys, sort=True, observed=True)
        .agg(
            low=("low", _lower_median),
            high=("high", _upper_median),
            lowest=("low", "min"),
            highest=("high", "max"),
            size=("size", "median"),
            rows=("row", "nunique"),
        )
        .reset_index()
    )
    if by:
        rows = table.groupby(by, observed=True).agg(of=("row", "nunique")).reset_index()
        return points.merge(rows, on=by, how="left")
    return points.assign(of=table["row"].nunique())


def transition_points_by_gait(
    table: pd.DataFrame, parameter: str, start: str, gait: str = "gait", by: str | Sequence[str] = ()
) -> pd.DataFrame:
    """The transition points of each gait, from settled rows at many values of a parameter on each branch.

    At one value a gait is kept if a row settles in it, and lost if no row from its own starts does. Its own
    starts are the values of `start` from which it is reached anywhere in the table. Rows that reached their
    limit of cycles or time are not used, since a ghost of a lost gait may hold them for long. A value without
    other rows from the gait's own starts is skipped, which widens the interval.

    Args:
        table: a settle table.
        parameter: the column of the parameter.
        start: the column of the start that selects the branch.
        gait: the column of the gait, of names or of numbers; `none` is not a gait.
        by: other swept axes; each of their combinations has its own transition points.

    Returns:
        One record a point: by, gait, direction (rising if the gait is lost as the parameter rises), kept and
        lost (the last value at which it is kept, the first at which it is lost), low and high (the same in
        order), rows (that settled in it at `kept`).

    Raises:
        AnalysisError: the table does not have a column.
    """
    by = names_in(by)
    require(table, "status", start, gait, *by)
    require_numbers(table, parameter)
    columns = [*by, "gait", "direction", "kept", "lost", "low", "high", "rows"]
    records = []
    for panel, rows in panels_of(table, by):
        part = table.iloc[rows]
        for label in _gaits_of(part[gait]):
            reached = (part[gait].astype(object) == label).to_numpy()
            edges = _edges_of(part, parameter, start, reached)
            records += [{**panel, "gait": str(label), **edge} for edge in edges]
    return pd.DataFrame(records, columns=columns)


def _gaits_of(column: pd.Series) -> list[object]:
    """The labels of a column of gaits without `none`: in the order of its categories, else sorted."""
    if isinstance(column.dtype, pd.CategoricalDtype):
        labels = list(column.cat.categories)
    elif pd.api.types.is_numeric_dtype(column.dtype):
        labels = sorted(column.dropna().unique())
    else:
        labels = sorted(column.dropna().unique(), key=str)
    return [label for label in labels if str(label) != Outcome.NO_GAIT]


def _require_axes(table: pd.DataFrame, names: Sequence[str]) -> None:
    """Refuse names that are no columns of a table, and columns that are no swept axes."""
    require(table, *names)
    axes = axes_of(table)
    for name in names:
        if name not in axes:
            raise AnalysisError(f"{name} is not a swept axis of this table{suggestion(name, axes)}")


def loop_area(table: pd.DataFrame, observable: str, parameter: str) -> pd.DataFrame:
    """The area of each hysteresis loop, between a pass and the next one, which goes the other way.

    Passes are taken in pairs from the first one on; a last one that is left over, with the pass before it.

    A branch is the observable over the parameter (the circular mean of several records at one value), linear
    between its values; angles differ by the shorter way. The area has the unit parameter x observable. The
    lag of a ramp adds to it.

    Args:
        table, observable, parameter: as for `jumps`.

    Returns:
        One record a row and pair of passes: row, swept axes, loop (0, 1, ...), area (of the absolute
        difference), signed (rising minus falling), low and high (the common range of both passes); NaN if a
        row lacks one of the passes. Rows with fewer than two records are left out.

    Raises:
        AnalysisError: the table does not have a column.
    """
    name = section_column(table, observable)
    circular, axes = is_circular(table, name), axes_of(table)
    records = []
    for course in courses(table, observable, parameter):
        last = int(course.passes.max())
        for loop in range(last // 2 + 1):
            # a last pass without another after it closes its loop with the one before
            first = 2 * loop if 2 * loop < last or last == 0 else last - 1
            records.append(
                {**_row_and_axes(course, axes), "loop": loop, **_area(course, first, circular=circular)}
            )
    return pd.DataFrame(records, columns=["row", *axes, "loop", "area", "signed", "low", "high"])


def _observables(table: pd.DataFrame) -> list[str]:
    """The section observables of a table, by their own names."""
    columns = table.columns[table.columns.str.endswith("_n")]
    return [str(name).removesuffix("_n") for name in columns if pd.api.types.is_numeric_dtype(table[name])]


def _joined(parts: list[pd.DataFrame]) -> pd.DataFrame:
    """The frames under each other, `observable` first; of empty ones only the columns."""
    full = [part for part in parts if len(part)] or parts[:1]
    joined = pd.concat(full, ignore_index=True) if full else pd.DataFrame({"observable": []})
    joined.insert(0, "observable", joined.pop("observable"))
    return joined


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


def _row_and_axes(course: Course, axes: Sequence[str]) -> dict[str, object]:
    """The row of a course, and its values of the swept axes."""
    return {name: course.first[name] for name in ("row", *axes)}


def _edges_of(
    part: pd.DataFrame, parameter: str, start: str, reached: Shaped[np.ndarray, " rows"]
) -> list[dict[str, object]]:
    """The transition points of one gait, given the rows that ended in it."""
    undecided = Status.UNDECIDED.among(part["status"])
    settled = reached & ~undecided
    from_own_starts = part[start].isin(part.loc[settled, start].unique()).to_numpy()
    value = part[parameter].to_numpy(float)
    counts = []
    for at in np.unique(value[from_own_starts & np.isfinite(value)]):
        at_value = from_own_starts & (value == at)
        rows = int(settled[at_value].sum())
        if rows or not undecided[at_value].any():
            counts.append((float(at), rows))
    edges = []
    for (low, below), (high, above) in itertools.pairwise(counts):
        if bool(below) == bool(above):
            continue
        if below:
            edge: dict[str, object] = {"direction": "rising", "kept": low, "lost": high}
        else:
            edge = {"direction": "falling", "kept": high, "lost": low}
        edges.append({**edge, "low": low, "high": high, "rows": max(below, above)})
    return edges


def _area(course: Course, first: int, *, circular: bool) -> dict[str, float]:
    """The area between passes `first` and `first + 1` of a course."""
    no_area: dict[str, float] = dict.fromkeys(("area", "signed", "low", "high"), float("nan"))
    branches = [_branch(course, number, circular=circular) for number in (first, first + 1)]
    if any(len(at) < 2 for at, _ in branches):
        return no_area
    low, high = max(at[0] for at, _ in branches), min(at[-1] for at, _ in branches)
    if high <= low:
        return no_area
    grid = np.unique(np.clip(np.concatenate([at for at, _ in branches]), low, high))
    first_branch, second_branch = (np.interp(grid, at, value) for at, value in branches)
    difference = (first_branch - second_branch) if rising(course, first) else (second_branch - first_branch)
    difference = wrapped_difference(difference) if circular else difference
    area, signed = np.trapezoid(np.abs(difference), grid), np.trapezoid(difference, grid)
    return {"area": float(area), "signed": float(signed), "low": float(low), "high": float(high)}


def _branch(
    course: Course, number: int, *, circular: bool
) -> tuple[Float[np.ndarray, " records"], Float[np.ndarray, " records"]]:
    """The parameter's values in a pass, ascending, and the observable at each."""
    records = records_of(course, number)
    at, which = np.unique(course.parameter[records], return_inverse=True)
    value = course.value[records]
    if not len(at):
        return at, value
    if circular:
        return at, np.unwrap([mean_direction(value[which == i]) for i in range(len(at))])
    return at, np.bincount(which, value) / np.bincount(which)
