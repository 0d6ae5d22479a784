"""Marks on branches where the order of events of their orbits changes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gaitsweep.analysis.atlas.branch import Branch, record_of
from gaitsweep.analysis.atlas.event_orders import change_of_order
from gaitsweep.analysis.continuation.arclength import BranchPoints, ContinuationProblem
from gaitsweep.analysis.continuation.bifurcation_tests import ahead
from gaitsweep.engine.poincare.maps import Events, Points, sizes

# Halvings of a step on which the order of events changes, and the most changes on one step.
BISECTIONS, MOST_CHANGES = 40, 8
# Distances beyond the end of a lost branch, relative to the coordinates, at which its events are read.
BEYOND_END = (1e-4, 1e-3, 1e-2)


def events_of_branches(branches: Sequence[Branch]) -> list[list[Events]]:
    """The events of the orbit at each point of each branch; those of one period are evaluated together."""
    events: list[list[Events]] = [[] for _ in branches]
    for period in {branch.period for branch in branches}:
        places = [k for k, branch in enumerate(branches) if branch.period == period]
        points = [(branches[k].problem, record["at"]) for k in places for record in branches[k].records]
        problem = ContinuationProblem.joined([problem for problem, _ in points])
        of_points = iter(_events(problem, BranchPoints.joined([at for _, at in points])))
        for k in places:
            events[k] = [next(of_points) for _ in branches[k].records]
    return events


def mark_order_changes(branch: Branch, events: list[Events]) -> None:
    """Add a record to a branch where its order of events changes, and its events to those of its records."""
    for place, inner in ((0, 1), (-1, -2)):
        if branch.records[place]["end"] == "lost" and len(events) > 1:
            branch.records[place]["change"] = _change_beyond(branch, place, inner, events[place])
    for place in range(len(events) - 1, 0, -1):
        change = change_of_order(events[place - 1], events[place])
        if not change:
            continue
        step_ends = branch.records[place - 1], branch.records[place]
        corner = next((record for record in step_ends if record["special"] == "corner"), None)
        if corner is None:
            _mark_on_step(branch, events, place)
        else:
            corner["change"] = change


def _mark_on_step(branch: Branch, events: list[Events], place: int) -> None:
    """Add a record for each of the changes on the step that leads to the record `place`."""
    after = branch.records[place]
    begin, events_at_begin = branch.records[place - 1]["at"], events[place - 1]
    target = events[place]
    for added in range(MOST_CHANGES):
        if not change_of_order(events_at_begin, target):
            return
        located = _last_before(branch.problem, begin, after["at"], events_at_begin)
        if located is None:
            after["change"] = change_of_order(events_at_begin, target)
            return
        (at, last), (begin, events_at_begin) = located
        mark = {"special": "order_change", "change": change_of_order(last, events_at_begin)}
        branch.insert(place - 1 + added, record_of(branch.problem, at) | mark)
        events.insert(place + added, last)


def _change_beyond(branch: Branch, place: int, inner: int, events: Events) -> str:
    """The change in the order of events just beyond an end at which a branch is lost, if anything.

    The points beyond it lie on the line through the record `place` at the end and the record `inner`.
    """
    end, before = branch.records[place]["at"], branch.records[inner]["at"]
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
