"""The order of events of orbits, and marks on branches where it changes.

In two parameters it changes along a curve: two events at once, or a grazing. At a corner two gaits, one of
each order, meet and vanish.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections import Counter
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from gaitsweep.analysis.atlas.branch import Branch, Record, record_of
from gaitsweep.analysis.continuation.arclength_step import BranchPoints, ContinuationProblem
from gaitsweep.analysis.continuation.bifurcation_tests import ahead
from gaitsweep.analysis.continuation.floquet_multipliers import multipliers
from gaitsweep.analysis.continuation.newton import FixedPoints, newton
from gaitsweep.column_meanings import time_column
from gaitsweep.engine.poincare.maps import Events, Map, Points, Values

# Steps of the second parameter over its range.
STEPS = 32
# Half-widths of the interval that is searched at each step, as shares of the first parameter's range: each is
# tried where the order does not change in the one before.
HALF_WIDTHS = (0.01, 0.04, 0.16, 0.64)
# Values of the first parameter in an interval.
VALUES = 33
# Rounds of ever smaller intervals.
ROUNDS = 8


@dataclasses.dataclass(frozen=True)
class _CurvePoint:
    """A point of a curve of order changes.

    Attributes:
        parameter, second: the values of the two parameters.
        columns: these, the observables of the gait there, and how many multipliers are outside the unit
            circle, by name.
        point: the gait's point (1,).
    """

    parameter: float
    second: float
    columns: dict[str, float]
    point: Points


@dataclasses.dataclass(frozen=True)
class OrderChange:
    """A change of the order of events on a branch.

    Attributes:
        mapping: the map, iterated to the period of the gait.
        parameter, second: names of the two parameters.
        within: the ranges of both.
        values: the other parameters, (1,) each.
        fix: conserved quantities that are held, and their values (1,).
        point: a point of the gait.
        home: the values of both parameters there.
        events: the events on one side of the change.
        changes: the changes of the order there, as of `changes_of_order`.
        vanishes: whether it is a corner, on one side of which there is no gait.
    """

    mapping: Map
    parameter: str
    second: str
    within: tuple[Sequence[float], Sequence[float]]
    values: Values
    fix: dict[str, Any]
    point: Points
    home: tuple[float, float]
    events: Events
    changes: frozenset[str]
    vanishes: bool = False

    def curve(self) -> list[dict[str, Any]]:
        """Follow the curve as a function of the second parameter, until the change is no longer found.

        Returns:
            One record a point, in order; 0 is the change on the branch, and points below 0 are behind it.
        """
        first = self._located(self.home[1], self.home[0], self.point)
        if first is None:
            return []
        behind, begin = self._side(first, -1)
        ahead, end = self._side(first, 1)
        points = [*behind[::-1], first, *ahead]
        if len(points) == 1:
            return []
        ends = [begin, *[""] * (len(points) - 2), end]
        return [
            {**point.columns, "point": number, "special": "", "end": end, "corrections": 0}
            for number, (point, end) in enumerate(zip(points, ends, strict=True), start=-len(behind))
        ]

    def _side(self, first: _CurvePoint, direction: int) -> tuple[list[_CurvePoint], str]:
        """The points after `first` in one direction of the second parameter, and why they end."""
        low, high = self.within[1]
        border = high if direction > 0 else low
        if self.home[1] == border:
            return [], "range"
        steps = np.arange(1, STEPS) * (high - low) / STEPS * direction + self.home[1]
        levels = [*steps[(steps > low) & (steps < high)], border]
        points = [first]
        for level in levels:
            last = points[-1]
            before = points[-2] if len(points) > 1 else last
            run = last.second - before.second
            slope = (last.parameter - before.parameter) / run if run else 0.0
            guess = last.parameter + slope * (level - last.second)
            point = self._located(float(level), guess, last.point)
            if point is None:
                is_inside = self.within[0][0] <= guess <= self.within[0][1]
                return points[1:], "lost" if is_inside else "range"
            points.append(point)
        return points[1:], "range"

    def _located(self, level: float, guess: float, near: Points) -> _CurvePoint | None:
        """The point of the curve at a value of the second parameter; None if it is not found."""
        low, high = self.within[0]
        for share in HALF_WIDTHS:
            half = share * (high - low)
            interval = max(low, guess - half), min(high, guess + half)
            point = self._within(level, interval, near) if interval[0] < interval[1] else None
            if point is not None:
                return point
        return None

    def _within(self, level: float, interval: tuple[float, float], near: Points) -> _CurvePoint | None:
        """The change in an interval of the first parameter, by intervals of it that get smaller."""
        point = None
        for _ in range(ROUNDS):
            at = np.linspace(*interval, VALUES)
            gaits, values = self._gaits(at, level, near)
            is_on_side, is_beyond = self._sides(gaits.points, values, gaits.converged)
            leaves = is_on_side[:-1] & is_beyond[1:]
            enters = is_beyond[:-1] & is_on_side[1:]
            changes = np.flatnonzero(leaves | enters)
            if not changes.size:
                break
            before = int(changes[np.argmin(np.abs(changes - 0.5 * (VALUES - 2)))])
            interval = float(at[before]), float(at[before + 1])
            side = before if is_on_side[before] else before + 1
            near, parameter = gaits.points[[side]], 0.5 * (interval[0] + interval[1])
            columns = {self.parameter: parameter, self.second: level}
            columns |= {name: float(column[side]) for name, column in gaits.images.observed.items()}
            columns |= {"unstable": self._unstable(gaits, side)}
            point = _CurvePoint(parameter, level, columns, near)
        return point

    def _gaits(
        self, at: Float[np.ndarray, " values"], level: float, near: Points
    ) -> tuple[FixedPoints, Values]:
        """The gaits near a point (1,) at values of the first parameter, with all parameters there.

        Args:
            at: the values of the first parameter.
            level: the value of the second one.
            near: the point.
        """
        starts = Points.joined([near] * VALUES)
        values = {name: np.repeat(np.ravel(v), VALUES) for name, v in self.values.items()}
        values |= {self.parameter: at, self.second: np.full(VALUES, level)}
        fix = {name: np.repeat(np.ravel(v), VALUES) for name, v in self.fix.items()}
        return newton(self.mapping, starts, values, fix=fix), values

    def _unstable(self, gaits: FixedPoints, index: int) -> int:
        """The number of multipliers of one gait outside the unit circle."""
        constrained = [quantity.name in self.fix for quantity in self.mapping.conserved]
        gradients = gaits.images.conserved_jacobian[[index]][:, constrained]
        factors = multipliers(gaits.images.jacobian[[index]], gradients)[0]
        return int(np.sum(np.abs(factors) > 1.0))

    def _sides(
        self, points: Points, values: Values, converged: Bool[np.ndarray, " values"]
    ) -> tuple[Bool[np.ndarray, " values"], Bool[np.ndarray, " values"]]:
        """Masks of the gaits on the one side of this change, and of those on the other.

        Other changes of the order, which this curve may cross, do not count. At a corner, there is a gait on
        the one side, and none on the other.
        """
        if self.vanishes:
            return converged, ~converged
        orders = self.mapping.events(points, values)
        is_same = np.array(
            [self.changes.isdisjoint(changes_of_order(self.events, order)) for order in orders]
        )
        return converged & is_same, converged & ~is_same


# Halvings of a step on which the order of events changes.
BISECTIONS = 40
# Most changes of the order on one step.
MOST_CHANGES = 8
# Distances beyond the end of a lost branch, relative to the coordinates, at which its events are read.
BEYOND_END = (1e-4, 1e-3, 1e-2)
# The change where trajectories beyond the end have only the first events, or none: they fall, or do not come
# back to the section.
NO_RETURN = "no return to the section"


def event_columns(events: Events) -> dict[str, Any]:
    """The columns of a gait's events: their order in words, and the time (s) of each event's first time."""
    times: dict[str, Any] = {}
    for at, name in events:
        times.setdefault(time_column(name), at)
    return {"events": ", ".join(name for _, name in events), **times}


def changes_of_order(before: Events, after: Events) -> tuple[str, ...]:
    """The changes between the orders of events of two gaits, each in words; empty if there is none.

    Args:
        before, after: the events of the gaits in their order, each with its time (s) and name.

    Example:
        >>> from gaitsweep.analysis.atlas.order_changes import changes_of_order
        >>> changes_of_order([(0.1, "foot 1 lands"), (0.2, "foot 2 lifts")], [(0.1, "foot 2 lifts")])
        ('without foot 1 lands',)
    """
    first, second = ([name for _, name in events] for events in (before, after))
    if first == second:
        return ()
    moved = _past_the_section(first, second)
    if moved is not None:
        return (f"{moved} passes the section",)
    index = {event: k for k, event in enumerate(_numbered(second))}
    in_both = [event for event in _numbered(first) if event in index]
    changes = [
        f"{earlier[0]} and {later[0]} change places"
        for earlier, later in itertools.combinations(in_both, 2)
        if index[later] < index[earlier]
    ]
    changes += [f"without {name}" for name in Counter(first) - Counter(second)]
    changes += [f"with {name}" for name in Counter(second) - Counter(first)]
    return tuple(dict.fromkeys(changes))


def _past_the_section(before: list[str], after: list[str]) -> str | None:
    """The event that alone moved from one end of the cycle to the other, over the section; None if none did.

    The last event of a cycle is that of the section itself.
    """
    for moved in dict.fromkeys(before[:-1]):
        others = [name for name in before[:-1] if name != moved]
        orders = [moved, *others], [*others, moved]
        if len(others) > 1 and before[:-1] in orders and after[:-1] in orders:
            return moved
    return None


def _numbered(names: list[str]) -> list[tuple[str, int]]:
    """Names with the number of times that each came before."""
    return [(name, names[:k].count(name)) for k, name in enumerate(names)]


def with_order_changes(branches: Sequence[Branch]) -> list[Branch]:
    """Branches whose records have their `events`, with a record for each change of the order of events.

    Records that have `events` already stay as they are.
    """
    marked = list(branches)
    for number, events in _events_of_new_records(branches).items():
        records = [dict(record) for record in branches[number].records]
        for index, events_of_record in events.items():
            records[index]["events"] = events_of_record
        branch = dataclasses.replace(branches[number], records=records)
        marked[number] = _marked(branch) if len(events) == len(records) else branch
    return marked


def _events_of_new_records(branches: Sequence[Branch]) -> dict[int, dict[int, Events]]:
    """The events of the records that have none yet, by the number of the branch and the record's index.

    The branches of one period are evaluated together.
    """
    without_events = [
        (number, index)
        for number, branch in enumerate(branches)
        for index, record in enumerate(branch.records)
        if "events" not in record
    ]
    events: dict[int, dict[int, Events]] = {}
    for period in {branches[number].period for number, _ in without_events}:
        of_period = [(k, index) for k, index in without_events if branches[k].period == period]
        problem = ContinuationProblem.joined([branches[k].problem for k, _ in of_period])
        points = BranchPoints.joined([branches[k].point(index) for k, index in of_period])
        for (k, index), events_of_record in zip(of_period, _events(problem, points), strict=True):
            events.setdefault(k, {})[index] = events_of_record
    return events


def _marked(branch: Branch) -> Branch:
    """A branch with a record for each change of the order of its events."""
    records = [dict(record) for record in branch.records]
    for end, inner in ((0, 1), (-1, -2)):
        if records[end]["end"] == "lost" and len(records) > 1:
            records[end]["changes"] = _changes_beyond(branch, end, inner, records[end]["events"])
    marks: dict[int, list[Record]] = {}  # by the index of the record behind them
    for index, (before, after) in enumerate(itertools.pairwise(records), start=1):
        changes = changes_of_order(before["events"], after["events"])
        if not changes:
            continue
        corner = next((record for record in (before, after) if record["special"] == "corner"), None)
        if corner is None:
            marks[index] = list(_marks_on_step(branch.problem, before, after))
        else:
            corner["changes"] = changes
    with_marks: list[Record] = []
    asides: dict[int, BranchPoints] = {}
    for index, record in enumerate(records):
        with_marks += marks.get(index, [])
        if index in branch.asides:
            asides[len(with_marks)] = branch.asides[index]
        with_marks.append(record)
    return dataclasses.replace(branch, records=with_marks, asides=asides)


def _marks_on_step(problem: ContinuationProblem, before: Record, after: Record) -> Iterator[Record]:
    """A record for each change on the step between two records; `after` notes those that are not located."""
    begin, events_at_begin = before["at"], before["events"]
    for _ in range(MOST_CHANGES):
        if not changes_of_order(events_at_begin, after["events"]):
            return
        located = _located_change(problem, begin, after["at"], events_at_begin)
        if located is None:
            break
        last, (begin, events_at_begin) = located
        changes = changes_of_order(last.events, events_at_begin)
        mark = {"special": "order_change", "changes": changes, "events": last.events}
        yield record_of(problem, last.point) | mark
    after["changes"] = changes_of_order(events_at_begin, after["events"])


def _changes_beyond(branch: Branch, at_end: int, inner: int, events: Events) -> tuple[str, ...]:
    """The changes of the order of events just beyond an end at which a branch is lost; empty without any.

    Where trajectories have only the first of the events there, and then do not come back, this is the change.
    The points beyond the end lie on the line through the records `inner` and `at_end`.
    """
    end, before = branch.point(at_end), branch.point(inner)
    problem, mapping = branch.problem, branch.problem.mapping
    ahead_of_end = mapping.difference(end.points.at, before.points.at)
    length = np.linalg.norm(ahead_of_end / mapping.sizes(end.points.at))
    for step in BEYOND_END:
        share = step / length if length > 0.0 else 0.0
        points = Points(end.points.at + share * ahead_of_end, end.points.modes)
        parameter = end.parameter + share * (end.parameter - before.parameter)
        beyond = mapping.events(points, problem.values_at(parameter))[0]
        names, names_beyond = ([name for _, name in of_orbit] for of_orbit in (events, beyond))
        if len(names_beyond) < len(names) and names_beyond == names[: len(names_beyond)]:
            return (NO_RETURN,)
        if changes := changes_of_order(events, beyond):
            return changes
    return ()


class _PointWithEvents(NamedTuple):
    """A point (1,) of a branch, and the events of its orbit."""

    point: BranchPoints
    events: Events


def _located_change(
    problem: ContinuationProblem, begin: BranchPoints, end: BranchPoints, events: Events
) -> tuple[_PointWithEvents, _PointWithEvents] | None:
    """The change of the order of events on a step by bisection; None if no point beyond it was found.

    Returns:
        The last point with the order of events of the first one, and the first point beyond it.
    """
    low, high = 0.0, float(ahead(problem, begin, end))
    last = _PointWithEvents(begin, events)
    beyond = None
    for _ in range(BISECTIONS):
        length = 0.5 * (low + high)
        near, converged = problem.step(begin, np.array([length]))
        events_near = _events(problem, near)[0] if converged[0] else []
        if events_near and not changes_of_order(events, events_near):
            low, last = length, _PointWithEvents(near, events_near)
        else:
            high = length
            beyond = _PointWithEvents(near, events_near) if events_near else None
    return None if beyond is None else (last, beyond)


def _events(problem: ContinuationProblem, at: BranchPoints) -> list[Events]:
    """The events of the orbits through branch points (n,)."""
    return problem.mapping.events(at.points, problem.values_at(at.parameter))
