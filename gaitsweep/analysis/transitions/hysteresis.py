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
from jaxtyping import Float, Shaped

from gaitsweep.analysis.records import (
    AnalysisError,
    axes_of,
    names_in,
    panels_of,
    require,
    require_numbers,
    section_column,
)
from gaitsweep.analysis.transitions.jumps import (
    LEAST_JUMP,
    Course,
    courses,
    irregular_passes,
    largest_jumps,
    lower_median,
    records_of,
    rising,
    row_and_axes,
    upper_median,
)
from gaitsweep.angles import TURN, is_circular, mean_direction, shorter_way, unwrapped
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
    least: float | None = None,
    by: str | Sequence[str] = (),
) -> Hysteresis:
    """Measure the hysteresis of a ramp, of a staircase, or of settled rows.

    Args:
        table: a table of one of these runs.
        observable: of ramps and staircases, the section observable that jumps; each of the table's in turn by
            default.
        parameter: the parameter's column; the one that the run moved by default.
        start: of settled rows, the column of the start value that selects the branch.
        least: of ramps and staircases, the smallest change that counts as a jump, in the observable's unit.
            By default as in the figure `hysteresis`: 0.15 of a ramp, and of a staircase a step that is four
            times as large as those beside it and changes the gait, or is a twentieth of the range of all
            rows.
        by: swept axes; the transition points of each of their combinations are separate. `loops` are always
            of single rows, so `by` does not change them.

    Raises:
        AnalysisError: a column is not there, has to be named or not to be, or is no swept axis; or `least`
            is not above 0, or is given for settled rows.

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
        for name, value in {"observable": observable, "least": least}.items():
            if value is not None:
                raise AnalysisError(f"{name} is {value}, but of settled rows gaits count: leave it out.")
        return Hysteresis(transition_points_by_gait(table, parameter, start, by=by), pd.DataFrame())
    if start is not None:
        raise AnalysisError(f"start is {start}, but passes select the branch here: leave it out.")
    names = [observable] if observable is not None else _observables(table)
    points = [transition_points(table, name, parameter, least, by).assign(observable=name) for name in names]
    loops = [loop_area(table, name, parameter).assign(observable=name) for name in names]
    return Hysteresis(_joined(points), _joined(loops))


def transition_points(
    table: pd.DataFrame,
    observable: str,
    parameter: str,
    least: float | None = LEAST_JUMP,
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
        largest.groupby(keys, sort=True, observed=True, dropna=False)
        .agg(
            low=("low", lower_median),
            high=("high", upper_median),
            lowest=("low", "min"),
            highest=("high", "max"),
            size=("size", "median"),
            rows=("row", "nunique"),
        )
        .reset_index()
    )
    if by:
        rows = table.groupby(by, observed=True, dropna=False).agg(of=("row", "nunique")).reset_index()
        return points.merge(rows, on=by, how="left")
    return points.assign(of=table["row"].nunique())


def why_no_jump(table: pd.DataFrame, observable: str, parameter: str, least: float | None = None) -> str:
    """The sentence about a table without a transition point.

    Args:
        table, observable, parameter, least: as for `jumps`.

    Raises:
        AnalysisError: the table does not have a column.
    """
    all_courses = list(courses(table, observable, parameter))
    passes = sum(len(np.unique(course.passes)) for course in all_courses)
    if not passes:
        return f"No row has two records with a value of {observable}."
    irregular = len(irregular_passes(table, observable, parameter, least))
    if irregular == passes:
        return f"No pass follows a branch of {observable}: all {passes} jump to and fro."
    if least is None and "stair" in table.columns:
        rule = "is four times as large as those beside it and changes the gait or a twentieth of the range"
    else:
        size = LEAST_JUMP if least is None else least
        rule = f"is {size:g} or more, and four times as large as usual"
        if 0.0 < (spread := max(float(np.ptp(course.value)) for course in all_courses)) < size:
            rule += f" (in a row it changes by {spread:.2g} at most: give a smaller least)"
    left_out = f" {irregular} of {passes} passes jump to and fro, and are left out." if irregular else ""
    return f"No pass jumps: no change of {observable} {rule}.{left_out}"


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
        AnalysisError: the table does not have a column, or `start` is the parameter.
    """
    by = names_in(by)
    require(table, "status", start, gait, *by)
    require_numbers(table, parameter)
    if start == parameter:
        raise AnalysisError(f"start is {start}, the parameter itself: name the column of a start.")
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
    between its values; angles differ by the shorter way, half a turn is -pi. The area has the unit parameter
    x observable. The lag of a ramp adds to it.

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
                {**row_and_axes(course, axes), "loop": loop, **_area(course, first, circular=circular)}
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


def _edges_of(
    part: pd.DataFrame, parameter: str, start: str, reached: Shaped[np.ndarray, " rows"]
) -> list[dict[str, object]]:
    """The transition points of one gait, given the rows that ended in it."""
    undecided = Status.UNDECIDED.among(part["status"])
    settled = reached & Status.SOUND.among(part["status"])
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
    difference = shorter_way(difference) if circular else difference
    left, right = difference[:-1], difference[1:]
    size = np.abs(left) + np.abs(right)
    # angles that change sign by more than half a turn pass half a turn, not zero
    crosses = (left * right < 0.0) & ((size < TURN / 2) if circular else True)
    height = np.divide(left**2 + right**2, size, out=size.copy(), where=crosses)
    area, signed = np.sum(np.diff(grid) * height / 2.0), np.trapezoid(difference, grid)
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
        means = np.array([mean_direction(value[which == i]) for i in range(len(at))])
        known = ~np.isnan(means)  # opposite angles at one value have no mean
        return at[known], unwrapped(means[known])
    return at, np.bincount(which, value) / np.bincount(which)
