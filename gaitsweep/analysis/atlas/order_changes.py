"""The order of events of orbits, and marks on branches where it changes."""

from __future__ import annotations

import dataclasses
import itertools
from collections import Counter
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np

from gaitsweep.analysis.atlas.branch import Branch, Record, record_of
from gaitsweep.analysis.continuation.arclength_step import BranchPoints, ContinuationProblem
from gaitsweep.analysis.continuation.bifurcation_tests import ahead
from gaitsweep.column_meanings import time_column
from gaitsweep.engine.poincare.maps import Events, Points, sizes

# Halvings of a step on which the order of events changes.
BISECTIONS = 40
# Most changes of the order on one step.
MOST_CHANGES = 8
# Distances beyond the end of a lost branch, relative to the coordinates, at which its events are read.
BEYOND_END = (1e-4, 1e-3, 1e-2)


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
    seen: Counter[str] = Counter()
    numbered = []
    for name in names:
        numbered.append((name, seen[name]))
        seen[name] += 1
    return numbered


def with_order_changes(branches: Sequence[Branch]) -> list[Branch]:
    """Branches whose records have their `events`, with a record for each change of the order of events.

    Records of an earlier run and those that have `events` stay as they are.
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
        if not {"events", "earlier"} & record.keys()
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
    """A record for each change on the step between two records; `after` notes one that is not located."""
    begin, events_at_begin = before["at"], before["events"]
    for _ in range(MOST_CHANGES):
        if not changes_of_order(events_at_begin, after["events"]):
            return
        located = _located_change(problem, begin, after["at"], events_at_begin)
        if located is None:
            after["changes"] = changes_of_order(events_at_begin, after["events"])
            return
        last, (begin, events_at_begin) = located
        changes = changes_of_order(last.events, events_at_begin)
        mark = {"special": "order_change", "changes": changes, "events": last.events}
        yield record_of(problem, last.point) | mark


def _changes_beyond(branch: Branch, at_end: int, inner: int, events: Events) -> tuple[str, ...]:
    """The changes of the order of events just beyond an end at which a branch is lost; empty without any.

    The points beyond it lie on the line through the records `inner` and `at_end`.
    """
    end, before = branch.point(at_end), branch.point(inner)
    problem, mapping = branch.problem, branch.problem.mapping
    ahead_of_end = mapping.difference(end.points.at, before.points.at)
    length = np.linalg.norm(ahead_of_end / sizes(end.points.at))
    for step in BEYOND_END:
        share = step / length if length > 0.0 else 0.0
        points = Points(end.points.at + share * ahead_of_end, end.points.modes)
        parameter = end.parameter + share * (end.parameter - before.parameter)
        beyond = mapping.events(points, problem.values_at(parameter))[0]
        if beyond and (changes := changes_of_order(events, beyond)):
            return changes
    return ()


class _PointWithEvents(NamedTuple):
    """A point (1,) of a branch, and the events of its orbit."""

    point: BranchPoints
    events: Events


class _LocatedChange(NamedTuple):
    """The last point of a step with the order of events of its first, and the first point beyond it."""

    last: _PointWithEvents
    beyond: _PointWithEvents


def _located_change(
    problem: ContinuationProblem, begin: BranchPoints, end: BranchPoints, events: Events
) -> _LocatedChange | None:
    """The change of the order of events on a step by bisection; None if no point beyond it was found."""
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
    return None if beyond is None else _LocatedChange(last, beyond)


def _events(problem: ContinuationProblem, at: BranchPoints) -> list[Events]:
    """The events of the orbits through branch points (n,)."""
    return problem.mapping.events(at.points, problem.values_at(at.parameter))
