"""Recording of rows for animation by run kind: time windows, and the stretches of a record."""

from __future__ import annotations

import abc
import dataclasses
from collections.abc import Hashable, Sequence
from typing import Any

import numpy as np
import pandas as pd
from jaxtyping import Int

from gaitsweep.analysis.atlas.branch import StoredPoint
from gaitsweep.analysis.continuation.arclength_step import BranchPoints
from gaitsweep.contract import Model
from gaitsweep.kinds.fixed_points import FollowsFixedPoints
from gaitsweep.kinds.run_kind import BlockProgress
from gaitsweep.kinds.staircase import Staircase
from gaitsweep.runs.prepare import RunContext
from gaitsweep.status import Status
from gaitsweep.view.explorer.replays import (
    Crossings,
    PerPoint,
    ReplayedRow,
    Replayer,
    Stretch,
    Windows,
    states_at,
)
from gaitsweep.view.explorer.start_map import CELLS, StartMap, cells_to_trace, spread

FIRST_CYCLES = 3
LAST_CYCLES = 2  # of a row that has no steady gait
_SPARE_CYCLES = 1.5  # cycles may be longer than the nominal period
_MAX_WINDOWS = 60  # of a ramp
_CYCLES_AROUND = 30  # of a record of a ramp
_TIME_TOLERANCE = 1e-9  # s, and relative
_PARAMETER_TOLERANCE = 1e-9  # difference of a parameter on a branch followed again, relative to its largest
_MAX_FOLLOWING_TIME = 600.0  # s of following branches again


def replayer_of(context: RunContext, rows: Int[np.ndarray, " rows"]) -> Replayer:
    """Simulator of some rows (n,) of a job, from their own starts."""
    run = context.job.run
    initial = {run.moved: run.turns[0]} if run.moved and run.turns else {}
    parameters, starts = context.design.values_in(rows)
    return Replayer(context.spec, rows, parameters, starts, initial)


class ReplayGroup(abc.ABC):
    """The animated records of a table, and the recording of their rows.

    Args:
        table: the records of the page, numbered from 0.
        records: the animated records (n,), the most useful first.
        context: their job.
    """

    def __init__(
        self, table: pd.DataFrame, records: Int[np.ndarray, " animated"], context: RunContext
    ) -> None:
        self.table, self.records, self.context = table, records, context
        self.row_of = table["row"].to_numpy(np.int64)
        self.rows = np.array(list(dict.fromkeys(self.row_of[records].tolist())), np.int64)
        # a model, its parameters and states from which the rows begin, if not from those of their job
        self._start: tuple[Model, dict[str, PerPoint], dict[str, PerPoint]] | None = None
        self.records_of: dict[int, list[int]] = {}  # the animated records of each row
        for record in records.tolist():
            self.records_of.setdefault(int(self.row_of[record]), []).append(record)

    def replayer(self) -> Replayer:
        """Simulator of its rows."""
        if self._start is not None:
            model, parameters, starts = self._start
            spec = dataclasses.replace(self.context.spec, model=model, drive=None)
            return Replayer(spec, self.rows, parameters, starts)
        return replayer_of(self.context, self.rows)

    @abc.abstractmethod
    def windows(self, period: float) -> Windows:
        """The time windows in which rows are recorded; `period` is their longest nominal period, s."""

    @abc.abstractmethod
    def stretches(self, record: int, replayed: ReplayedRow, period: float) -> list[Stretch]:
        """The stretches of motion shown for a record; `period` is its row's nominal period, s."""

    @abc.abstractmethod
    def around(self, record: int, replayed: ReplayedRow) -> Crossings:
        """The crossings drawn beside a record."""

    def number(self, record: int, column: str) -> float:
        """A number of a record."""
        return float(self.table[column].iloc[record])


class ReplayStarts(ReplayGroup):
    """Rows of settle and fixed_time that did not fail: their first cycles, and their gait at the end.

    The gait is recorded when the last row ends, so that one window serves all rows.
    """

    def windows(self, period: float) -> Windows:
        end = float(np.nanmax(self.table["t_end"].to_numpy(float)[self.records]))
        length = (max(FIRST_CYCLES, self._longest) + _SPARE_CYCLES) * period
        if end < 2.5 * length:
            return Windows(end)
        return Windows(length, second=end - length, more=1)

    @property
    def _longest(self) -> int:
        """The longest period of an attractor, in crossings."""
        if "attractor_period" not in self.table.columns:
            return 1
        return int(np.asarray(self.table["attractor_period"])[self.records].max(initial=1))

    def stretches(self, record: int, replayed: ReplayedRow, period: float) -> list[Stretch]:
        t = replayed.crossings.t
        t = t[t <= replayed.t[-1] + _TIME_TOLERANCE] if len(replayed.t) else t[:0]
        if len(t) <= 2 * FIRST_CYCLES:
            return [Stretch("the motion", 0.0, float(replayed.t[-1]))] if len(replayed.t) else []
        first = Stretch("the first cycles", 0.0, float(t[FIRST_CYCLES]))
        cycles = int(self.number(record, "attractor_period")) if "attractor_period" in self.table else 0
        if self.table["status"].iloc[record] == Status.settled.name and cycles:
            return [
                first,
                Stretch("the gait", float(t[-1 - min(cycles, len(t) - 1)]), float(t[-1]), loops=True),
            ]
        return [first, Stretch("the last cycles", float(t[-1 - LAST_CYCLES]), float(t[-1]))]

    def around(self, record: int, replayed: ReplayedRow) -> Crossings:
        return replayed.crossings.until(self.number(record, "t_end"))


class ReplayFailures(ReplayGroup):
    """Rows of settle and fixed_time that failed: their first cycles, and the last ones before the failure."""

    def windows(self, period: float) -> Windows:
        return Windows(float(np.nanmax(self.table["t_end"].to_numpy(float)[self.records])))

    def stretches(self, record: int, replayed: ReplayedRow, period: float) -> list[Stretch]:
        end = self.number(record, "t_end")
        name = f"the end: {self.table['status'].iloc[record]}"
        if end <= 2 * FIRST_CYCLES * period:
            return [Stretch(name, 0.0, end)]
        first = Stretch("the first cycles", 0.0, FIRST_CYCLES * period)
        return [first, Stretch(name, end - LAST_CYCLES * period, end)]

    def around(self, record: int, replayed: ReplayedRow) -> Crossings:
        return replayed.crossings.until(self.number(record, "t_end"))


class ReplayMap(ReplayGroup):
    """Rows of a return map: the first and the last cycles of the map."""

    def windows(self, period: float) -> Windows:
        t = np.asarray(self.table["t"], float)
        times = [t[(self.row_of == row) & np.isfinite(t)] for row in self.rows]
        begun = np.array([np.min(times_of_row) for times_of_row in times])
        ended = np.array([np.max(times_of_row) for times_of_row in times])
        # rows reach the first and the last crossing at times of their own
        length = (FIRST_CYCLES + _SPARE_CYCLES) * period + max(float(np.ptp(begun)), float(np.ptp(ended)))
        first = float(begun.min())
        last = float(ended.max()) + period
        if last - first < 2.5 * length:
            return Windows(last - first, first)
        return Windows(length, first, last - length, more=1)

    def stretches(self, record: int, replayed: ReplayedRow, period: float) -> list[Stretch]:
        t = self.around(record, replayed).t
        if len(t) <= 2 * FIRST_CYCLES:
            return [Stretch("the cycles of the map", float(t[0]), float(t[-1]))] if len(t) > 1 else []
        return [
            Stretch("the first cycles", float(t[0]), float(t[FIRST_CYCLES])),
            Stretch("the last cycles", float(t[-1 - LAST_CYCLES]), float(t[-1])),
        ]

    def around(self, record: int, replayed: ReplayedRow) -> Crossings:
        number = replayed.crossings.number
        of_map = np.asarray(self.table["crossing"])[self.row_of == replayed.row]
        return replayed.crossings.where((number >= of_map.min()) & (number <= of_map.max() + 1))


class ReplayRamp(ReplayGroup):
    """Records of a ramp at equal times, `spacing` s: the cycles up to each."""

    def __init__(
        self, table: pd.DataFrame, context: RunContext, rows: Int[np.ndarray, " rows"], count: int
    ) -> None:
        t, of_row = table["t"].to_numpy(float), table["row"].to_numpy(np.int64)
        end = float(np.nanmax(t[np.isin(of_row, rows)]))
        self._spacing, self._count = end / count, count
        records = []
        for row in rows.tolist():
            crossings = np.flatnonzero((of_row == row) & np.isfinite(t))
            places = np.searchsorted(
                t[crossings], self._spacing * np.arange(1, count + 1) * (1.0 + _TIME_TOLERANCE)
            )
            records += [int(crossings[place - 1]) for place in np.unique(places) if place]
        super().__init__(table, np.array(records, np.int64), context)

    def windows(self, period: float) -> Windows:
        spacing = self._spacing
        length = min((LAST_CYCLES + _SPARE_CYCLES) * period, 0.9 * spacing)
        return Windows(length, spacing - length, 2.0 * spacing - length, spacing, self._count - 1)

    def stretches(self, record: int, replayed: ReplayedRow, period: float) -> list[Stretch]:
        return _up_to(self.number(record, "t"), replayed, "up to this crossing", period)

    def around(self, record: int, replayed: ReplayedRow) -> Crossings:
        crossing = self.number(record, "crossing")
        number = replayed.crossings.number
        return replayed.crossings.where((number <= crossing) & (number >= crossing - _CYCLES_AROUND))


class ReplayStairs(ReplayGroup):
    """Records of a staircase: the last cycles of each stair."""

    @property
    def _kind(self) -> Staircase:
        assert isinstance(self.context.job.run, Staircase)
        return self.context.job.run

    def windows(self, period: float) -> Windows:
        schedule = self._kind.schedule()
        length = min((LAST_CYCLES + _SPARE_CYCLES) * period, 0.9 * schedule.dwell, schedule.first)
        second = schedule.first + schedule.dwell - length
        return Windows(length, schedule.first - length, second, schedule.dwell, schedule.count - 1)

    def stretches(self, record: int, replayed: ReplayedRow, period: float) -> list[Stretch]:
        end = float(self._kind.schedule().end(np.asarray(self.number(record, "stair"))))
        return _up_to(end, replayed, "the end of this stair", period)

    def around(self, record: int, replayed: ReplayedRow) -> Crossings:
        schedule = self._kind.schedule()
        stair = np.asarray(self.number(record, "stair"))
        begin = 0.0 if stair == 0.0 else float(schedule.end(stair - 1.0))
        t = replayed.crossings.t
        return replayed.crossings.where((t >= begin) & (t <= float(schedule.end(stair)) + _TIME_TOLERANCE))


class ReplayBranches(ReplayGroup):
    """Points of branches: one cycle of each steady gait, stable or unstable.

    A table of a continuation has the observables of a point and not its state, so its branches are followed
    again; points with other results are left out. An atlas has its points.

    Args:
        table: the records of the page, numbered from 0.
        context: their job.
        rows: the rows (m,) whose branches are followed again.
        most: largest number of animated points.
        on_progress: called before each step.
    """

    def __init__(
        self,
        table: pd.DataFrame,
        context: RunContext,
        rows: Int[np.ndarray, " rows"],
        most: int,
        on_progress: BlockProgress,
    ) -> None:
        run = context.job.run
        assert isinstance(run, FollowsFixedPoints)
        mapped, followed = run.followed_again(context.design, context.spec, rows, table, on_progress)
        assert run.moved is not None
        point_of_record = _points_of_records(table, rows, followed, run.point_names, run.moved)
        records = _spread(np.array(list(point_of_record), np.int64), most)
        points = [point_of_record[record] for record in records.tolist()]
        super().__init__(table, records, context)
        self.rows = self.records  # each point is a trajectory of its own
        self.records_of = {record: [record] for record in self.records.tolist()}
        if not points:
            return
        branch = np.array([point["row"] for point in points], np.int64)
        parameters = {
            name: np.broadcast_to(values, rows.shape)[branch] for name, values in mapped.values.items()
        }
        parameters[run.moved] = np.array([point[run.moved] for point in points], float)
        self._start = states_at(mapped.mapping, [point["at"].points for point in points], parameters)

    def windows(self, period: float) -> Windows:
        longest = float(np.nanmax(np.asarray(self.table["time"], float)[self.records]))
        return Windows(longest + 0.1 * period)

    def stretches(self, record: int, replayed: ReplayedRow, period: float) -> list[Stretch]:
        t = replayed.crossings.t
        cycles = int(self.number(record, "period")) if "period" in self.table else 1
        return [Stretch("the steady gait", 0.0, float(t[cycles]), loops=True)] if len(t) > cycles else []

    def around(self, record: int, replayed: ReplayedRow) -> Crossings:
        return replayed.crossings


def _points_of_records(
    table: pd.DataFrame,
    rows: Int[np.ndarray, " rows"],
    followed: pd.DataFrame,
    point_names: Sequence[str],
    moved: str,
) -> dict[int, dict[Hashable, Any]]:
    """The points of branches that were followed again, by the records that they repeat.

    Args:
        table: the records of the page.
        rows: the rows whose branches were followed again.
        followed: points of these branches; `row` is a place in `rows`.
        point_names: the columns that number the points of a row.
        moved: the parameter along the branches, by which a point is compared with its record.
    """
    numbers = [table[name].to_numpy(np.int64) for name in ("row", *point_names)]
    record_of = {key: record for record, key in enumerate(zip(*numbers, strict=True))}
    parameters = table[moved].to_numpy(float)
    closest = _PARAMETER_TOLERANCE * np.fmax.reduce(np.abs(parameters), initial=0.0)  # NaN without a branch
    points = {}
    for point in followed.to_dict("records"):
        record = record_of.get((int(rows[point["row"]]), *(point[name] for name in point_names)))
        if record is None or not isinstance(point.get("at"), BranchPoints | StoredPoint):
            continue
        if abs(point[moved] - parameters[record]) <= closest:
            points.setdefault(record, point)
    return points


def _up_to(end: float, replayed: ReplayedRow, name: str, period: float) -> list[Stretch]:
    """The last cycles that end by a time, s."""
    t = replayed.crossings.t
    t = t[t <= end + _TIME_TOLERANCE]
    if len(t) > LAST_CYCLES:
        return [Stretch(name, float(t[-1 - LAST_CYCLES]), float(t[-1]))]
    return [Stretch(name, max(0.0, end - LAST_CYCLES * period), end)]


def _branches_in_time(context: RunContext, spent: float, rows: int) -> int:
    """Number of branches to follow again in `_MAX_FOLLOWING_TIME`; the job took `spent` s for all rows."""
    time_per_branch = spent / context.design.n_rows
    if time_per_branch <= 0.0:
        return max(1, rows)
    return max(1, min(rows, int(_MAX_FOLLOWING_TIME / time_per_branch)))


def _spread(values: Int[np.ndarray, " values"], most: int) -> Int[np.ndarray, " some"]:
    """At most `most` of some values (n,), ordered so that each beginning is spread evenly over them."""
    return values[spread(len(values))[:most]] if len(values) else values


def replay_groups(
    shown: StartMap,
    table: pd.DataFrame,
    context: RunContext,
    most: int,
    spent: float,
    on_progress: BlockProgress,
) -> tuple[list[ReplayGroup], int]:
    """The animated records, at most `most`, in groups that are simulated together.

    Args:
        shown: the map.
        table: its records, numbered from 0.
        context: their job.
        most: largest number of animated records.
        spent: duration of the job, s.
        on_progress: called repeatedly while branches are followed again.

    Returns:
        The groups, and the number of records beside a boundary.
    """
    run = context.job.run
    if most <= 0:
        return [], 0
    if isinstance(run, FollowsFixedPoints):
        rows = np.unique(table["row"].to_numpy(np.int64)[np.isfinite(table["multiplier"].to_numpy(float))])
        if run.stationary or not len(rows):  # stationary points do not move
            return [], 0
        if "stored_point" not in table:
            rows = np.sort(_spread(rows, _branches_in_time(context, spent, len(rows))))
        branches = ReplayBranches(table, context, rows, most, on_progress)
        return [branches] if len(branches.records) else [], 0
    if run.one_a_row:
        return _groups_of_starts(shown, table, context, most)
    return _groups_of_records(table, context, most), 0


def _groups_of_starts(
    shown: StartMap, table: pd.DataFrame, context: RunContext, most: int
) -> tuple[list[ReplayGroup], int]:
    """The groups of a table with one record a row, and the number of records beside a boundary."""
    simulated = np.isfinite(table["t_end"].to_numpy(float))  # and not inferred
    beside = 0
    if shown.kind == CELLS:
        records, beside = cells_to_trace(shown, simulated, most)
    else:
        records = _spread(np.flatnonzero(simulated), most)
    failed = Status.FAILED.among(table["status"])[records]
    groups: list[ReplayGroup] = []
    if not failed.all():
        groups.append(ReplayStarts(table, records[~failed], context))
    if failed.any():
        groups.append(ReplayFailures(table, records[failed], context))
    return groups, beside


def _groups_of_records(table: pd.DataFrame, context: RunContext, most: int) -> list[ReplayGroup]:
    """The group of a table with several records a row: a return map, a staircase or a ramp."""
    usable = np.isfinite(table["t"].to_numpy(float))
    of_row = table["row"].to_numpy(np.int64)
    rows = np.unique(of_row[usable])
    if not len(rows):
        return []
    if context.job.run.kind_name == "return_map":
        firsts = np.array([np.argmax(usable & (of_row == row)) for row in rows], np.int64)
        return [ReplayMap(table, _spread(firsts, most), context)]
    if context.job.run.kind_name == "staircase":
        stairs = int(np.asarray(table["stair"]).max()) + 1
        rows = np.sort(_spread(rows, max(1, most // stairs)))
        records = np.flatnonzero(usable & np.isin(of_row, rows))
        return [ReplayStairs(table, records[:most], context)]
    rows = np.sort(_spread(rows, max(1, most // 2)))
    count = int(min(_MAX_WINDOWS, most // len(rows)))
    ramp = ReplayRamp(table, context, rows, count)
    return [ramp] if len(ramp.records) else []  # none has records after its start
