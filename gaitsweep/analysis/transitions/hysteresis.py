"""Hysteresis: where a state is lost as a parameter rises and falls, and the area between the two branches.

Reads ramps (a parameter that moves slowly), staircases (one that is held at each value in turn) and settled
rows. A ramp lags: it jumps after the edge, the later the faster it is. A staircase's interval holds the edge
if its holds are long enough; the intervals from settled rows on each branch need no such proviso.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np
import pandas as pd

from gaitsweep.analysis.circular import is_circular, mean_direction
from gaitsweep.analysis.records import UNDECIDED, axes_of, require, section_column
from gaitsweep.analysis.transitions.jumps import Course, courses, records_of, rising, stretches
from gaitsweep.circular import TURN, wrapped_difference

LEAST = 0.15  # in the observable's unit: a smaller change is no jump


def jumps(table: pd.DataFrame, observable: str, parameter: str, least: float = LEAST) -> pd.DataFrame:
    """The jumps of each row and pass of a ramp or a staircase.

    Args:
        table: a ramp or staircase table; records that are NaN and the last ones before a fall are left out.
        observable: a section observable (delta_13); an angle is followed around the circle.
        parameter: the column of the parameter that moves.
        least: the least change that counts, in the observable's unit: from one hold to the next, or within
            40 crossings of a ramp; besides, four times the lower quartile of such changes along the row.

    Returns:
        One record a jump: row, what varies, pass, direction (rising or falling, the parameter's), `low` and
        `high` (the parameter's interval: from the last value before the jump to the first after it; for a
        ramp, where a tenth and nine tenths of it are done), before, after, size (after - before, signed).

    Raises:
        AnalysisError: a column is not there.
    """
    name = section_column(table, observable)
    circular, axes = is_circular(table, name), axes_of(table)
    found = []
    for course in courses(table, observable, parameter):
        for start, stop in stretches(course, least):
            number = int(course.passes[stop if course.settled is not None else (start + stop) // 2])
            passed = course.parameter[start : stop + 1]
            before, after = course.value[[start, stop]]
            found.append(
                {
                    **_place(course, axes),
                    "pass": number,
                    "direction": "rising" if rising(course, number) else "falling",
                    "low": passed.min(),
                    "high": passed.max(),
                    "before": np.mod(before, TURN) if circular else before,
                    "after": np.mod(after, TURN) if circular else after,
                    "size": after - before,
                }
            )
    columns = ["row", *axes, "pass", "direction", "low", "high", "before", "after", "size"]
    return pd.DataFrame(found, columns=columns)


def largest_jumps(table: pd.DataFrame, observable: str, parameter: str, least: float = LEAST) -> pd.DataFrame:
    """Of each row and pass the largest of its `jumps`, in the same columns; none where it goes to and fro.

    A row that turns back twice or more often within a pass, as an irregular gait does, stands on no branch
    and so loses none.
    """
    found = jumps(table, observable, parameter, least)
    size, one = found["size"].to_numpy(float), found.groupby(["row", "pass"]).ngroup().to_numpy(int)
    back = (size[1:] * size[:-1] < 0.0) & (one[1:] == one[:-1])
    turns = np.bincount(one[1:][back], minlength=int(one.max(initial=0)) + 1)
    steady = found.loc[turns[one] < 2]
    largest = steady.assign(height=steady["size"].abs()).sort_values("height", kind="stable")
    return largest.drop_duplicates(["row", "pass"], keep="last").drop(columns="height").sort_index()


def transition_points(
    table: pd.DataFrame,
    observable: str,
    parameter: str,
    least: float = LEAST,
    by: Sequence[str] = (),
) -> pd.DataFrame:
    """Where the state is lost in each pass, over all rows on a branch: of each its `largest_jumps`.

    Args:
        table, observable, parameter, least: as for `jumps`.
        by: columns of what varies; rows that share them are taken together.

    Returns:
        One record a pass in which any row jumps: by, pass, direction, `low` and `high` (medians over the
        rows; of an even number the outer one), `lowest` and `highest` (over all of them), size (median), rows
        (that jump so), of (all rows).
    """
    by = list(by)
    largest = largest_jumps(table, observable, parameter, least)
    require(largest, *by)
    keys = [*by, "pass", "direction"]
    points = (
        largest.groupby(keys, sort=True, observed=True)
        .agg(
            low=("low", lambda low: low.quantile(0.5, interpolation="lower")),
            high=("high", lambda high: high.quantile(0.5, interpolation="higher")),
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
    table: pd.DataFrame, parameter: str, start: str, gait: str = "gait", by: Sequence[str] = ()
) -> pd.DataFrame:
    """Where each gait is lost, from settled rows at many values of a parameter, started on each branch.

    At one value a gait is kept if a row settles in it, and lost if none of the rows from its own starts does:
    those values of `start` from which it is reached anywhere in the table. Rows that reached their limit of
    cycles or time decide nothing (a ghost of a lost gait holds them for long): a value at which nothing else
    would show that the gait is lost is passed over, and the interval is the wider for it.

    Args:
        table: a settle table.
        parameter: the column of the parameter.
        start: the column of the start that chooses the branch.
        gait: the column of the gait; `none` is not one.
        by: columns of what else varies; each of their combinations has its own edges.

    Returns:
        One record an edge: by, gait, direction (rising where the gait is lost as the parameter rises), kept
        and lost (the last value at which it is kept, the first at which it is lost), low and high (the same
        in order), rows (that settled in it at `kept`).
    """
    by = list(by)
    require(table, "status", parameter, start, gait, *by)
    columns = [*by, "gait", "direction", "kept", "lost", "low", "high", "rows"]
    parts = list(table.groupby(by, sort=True, observed=True)) if by else [((), table)]
    found = []
    for key, part in parts:
        place = dict(zip(by, key if isinstance(key, tuple) else (key,), strict=True))
        labels = part[gait].astype(object)
        names = list(part[gait].cat.categories) if isinstance(part[gait].dtype, pd.CategoricalDtype) else []
        names = names or sorted(str(name) for name in labels.dropna().unique())
        for name in names:
            if str(name) != "none":
                edges = _edges_of(part, parameter, start, (labels == name).to_numpy())
                found += [{**place, "gait": name, **edge} for edge in edges]
    return pd.DataFrame(found, columns=columns)


def loop_area(table: pd.DataFrame, observable: str, parameter: str) -> pd.DataFrame:
    """The area between the branches of each pass up and the pass down beside it (parameter x observable).

    Each branch is the observable over the parameter (mean direction where a value has several records),
    straight between its values; differences of angles go the shorter way. A ramp's lag adds to the area.

    Returns:
        One record a row and pair of passes: row, what varies, loop (0, 1, ...), area (of the absolute
        difference), signed (of rising minus falling), low and high (where both passes are); NaN where a row
        has not both passes. Rows with fewer than two records are left out.

    Raises:
        AnalysisError: a column is not there.
    """
    name = section_column(table, observable)
    circular, axes = is_circular(table, name), axes_of(table)
    found = []
    for course in courses(table, observable, parameter):
        for loop in range(int(course.passes.max()) // 2 + 1):
            found.append({**_place(course, axes), "loop": loop, **_area(course, 2 * loop, circular)})
    return pd.DataFrame(found, columns=["row", *axes, "loop", "area", "signed", "low", "high"])


def _place(course: Course, axes: Sequence[str]) -> dict[str, object]:
    return {name: course.first[name] for name in ("row", *axes)}


def _edges_of(part: pd.DataFrame, parameter: str, start: str, reached: np.ndarray) -> list[dict[str, object]]:
    """The edges of one gait, given which rows ended in it."""
    undecided = part["status"].astype(str).isin(list(UNDECIDED)).to_numpy()
    settled = reached & ~undecided
    own = part[start].isin(part.loc[settled, start].unique()).to_numpy()
    value = part[parameter].to_numpy(float)
    known = []
    for at in np.unique(value[own & np.isfinite(value)]):
        here = own & (value == at)
        rows = int(settled[here].sum())
        if rows or not undecided[here].any():
            known.append((float(at), rows))
    edges = []
    for (low, below), (high, above) in itertools.pairwise(known):
        if bool(below) == bool(above):
            continue
        kept, lost, direction = (low, high, "rising") if below else (high, low, "falling")
        edge = {"direction": direction, "kept": kept, "lost": lost, "low": low, "high": high}
        edges.append({**edge, "rows": max(below, above)})
    return edges


def _area(course: Course, first: int, circular: bool) -> dict[str, float]:
    """The area between passes `first` and `first + 1` of a course."""
    nothing: dict[str, float] = dict.fromkeys(("area", "signed", "low", "high"), float("nan"))
    branches = [_branch(course, number, circular) for number in (first, first + 1)]
    if any(len(at) < 2 for at, _ in branches):
        return nothing
    low, high = max(at[0] for at, _ in branches), min(at[-1] for at, _ in branches)
    if high <= low:
        return nothing
    grid = np.unique(np.clip(np.concatenate([at for at, _ in branches]), low, high))
    here, there = (np.interp(grid, at, value) for at, value in branches)
    difference = (here - there) if rising(course, first) else (there - here)
    difference = wrapped_difference(difference) if circular else difference
    area, signed = np.trapezoid(np.abs(difference), grid), np.trapezoid(difference, grid)
    return {"area": float(area), "signed": float(signed), "low": float(low), "high": float(high)}


def _branch(course: Course, number: int, circular: bool) -> tuple[np.ndarray, np.ndarray]:
    """The parameter's values in a pass, ascending, and the observable at each."""
    mine = records_of(course, number)
    at, which = np.unique(course.parameter[mine], return_inverse=True)
    value = course.value[mine]
    if not circular or not len(at):
        return at, np.bincount(which, value) / np.bincount(which) if len(at) else at
    means = np.array([mean_direction(value[which == i]) for i in range(len(at))])
    return at, np.unwrap(means)
