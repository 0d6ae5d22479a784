"""Marks on branches where the order of events of their orbits changes."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence

import numpy as np

from gaitsweep.analysis.atlas.branch import Branch, Record, record_of
from gaitsweep.analysis.atlas.event_orders import change_of_order
from gaitsweep.analysis.continuation.arclength import BranchPoints, ContinuationProblem
from gaitsweep.analysis.continuation.bifurcation_tests import ahead
from gaitsweep.engine.poincare.maps import Events, Points, sizes

# Halvings of a step on which the order of events changes.
BISECTIONS = 40
# Most changes of the order on one step.
MOST_CHANGES = 8
# Distances beyond the end of a lost branch, relative to the coordinates, at which its events are read.
BEYOND_END = (1e-4, 1e-3, 1e-2)


def with_order_changes(branches: Sequence[Branch]) -> list[Branch]:
    """Branches whose records have their `events`, with a record for each change of the order of events.

    Records of an earlier run and those that have `events` stay as they are.
    """
    places = [
        (k, place)
        for k, branch in enumerate(branches)
        for place, record in enumerate(branch.records)
        if not {"events", "earlier"} & record.keys()
    ]
    marked = list(branches)
    events: dict[int, dict[int, Events]] = {}
    for period in {branches[k].period for k, _ in places}:
        of_period = [(k, place) for k, place in places if branches[k].period == period]
        problem = ContinuationProblem.joined([branches[k].problem for k, _ in of_period])
        at = BranchPoints.joined([branches[k].point(place) for k, place in of_period])
        for (k, place), own in zip(of_period, _events(problem, at), strict=True):
            events.setdefault(k, {})[place] = own
    for k, own in events.items():
        records = [
            record | ({"events": own[place]} if place in own else {})
            for place, record in enumerate(branches[k].records)
        ]
        branch = dataclasses.replace(branches[k], records=records)
        marked[k] = _marked(branch) if len(own) == len(records) else branch
    return marked


def _marked(branch: Branch) -> Branch:
    """A branch with a record for each change of the order of its events."""
    records = [dict(record) for record in branch.records]
    for place, inner in ((0, 1), (-1, -2)):
        if records[place]["end"] == "lost" and len(records) > 1:
            records[place]["change"] = _change_beyond(branch, place, inner, records[place]["events"])
    marks: dict[int, list[Record]] = {}
    for place in range(1, len(records)):
        before, after = records[place - 1], records[place]
        change = change_of_order(before["events"], after["events"])
        if not change:
            continue
        corner = next((record for record in (before, after) if record["special"] == "corner"), None)
        if corner is None:
            marks[place] = list(_marks_on_step(branch.problem, before, after))
        else:
            corner["change"] = change
    asides = {
        place + sum(len(marks[k]) for k in marks if k <= place): aside
        for place, aside in branch.asides.items()
    }
    with_marks = [record for place, own in enumerate(records) for record in (*marks.get(place, []), own)]
    return dataclasses.replace(branch, records=with_marks, asides=asides)


def _marks_on_step(problem: ContinuationProblem, before: Record, after: Record) -> Iterator[Record]:
    """A record for each change on the step between two records; `after` notes one that is not located."""
    begin, events_at_begin = before["at"], before["events"]
    for _ in range(MOST_CHANGES):
        if not change_of_order(events_at_begin, after["events"]):
            return
        located = _last_before(problem, begin, after["at"], events_at_begin)
        if located is None:
            after["change"] = change_of_order(events_at_begin, after["events"])
            return
        (at, last), (begin, events_at_begin) = located
        change = change_of_order(last, events_at_begin)
        yield record_of(problem, at) | {"special": "order_change", "change": change, "events": last}


def _change_beyond(branch: Branch, place: int, inner: int, events: Events) -> str:
    """The change in the order of events just beyond an end at which a branch is lost, if anything.

    The points beyond it lie on the line through the record `place` at the end and the record `inner`.
    """
    end, before = branch.point(place), branch.point(inner)
    problem, mapping = branch.problem, branch.problem.mapping
    ahead_of_end = mapping.difference(end.points.at, before.points.at)
    length = np.linalg.norm(ahead_of_end / sizes(end.points.at))
    for step in BEYOND_END:
        share = step / length if length > 0.0 else 0.0
        points = Points(end.points.at + share * ahead_of_end, end.points.modes)
        parameter = end.parameter + share * (end.parameter - before.parameter)
        beyond = mapping.events(points, problem.values_at(parameter))[0]
        if beyond and (change := change_of_order(events, beyond)):
            return change
    return ""


def _last_before(
    problem: ContinuationProblem, begin: BranchPoints, end: BranchPoints, events: Events
) -> tuple[tuple[BranchPoints, Events], tuple[BranchPoints, Events]] | None:
    """The last point (1,) of a step with the order of events of its first, and the first point beyond it.

    Each has its events; None if no point beyond it was found.
    """
    low, high = 0.0, float(ahead(problem, begin, end))
    last, beyond = (begin, events), None
    for _ in range(BISECTIONS):
        length = 0.5 * (low + high)
        near, converged = problem.step(begin, np.array([length]))
        events_near = _events(problem, near)[0] if converged[0] else []
        if events_near and not change_of_order(events, events_near):
            low, last = length, (near, events_near)
        else:
            high, beyond = length, (near, events_near) if events_near else None
    return None if beyond is None else (last, beyond)


def _events(problem: ContinuationProblem, at: BranchPoints) -> list[Events]:
    """The events of the orbits through branch points (n,)."""
    return problem.mapping.events(at.points, problem.values_at(at.parameter))
