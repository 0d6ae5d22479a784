"""Curves through the bifurcations and order changes of branches, in the plane of two parameters."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from gaitsweep.analysis.atlas.branch import ON_BRANCH, Branch, Record
from gaitsweep.analysis.atlas.order_changes import OrderChange
from gaitsweep.analysis.atlas.periodic_orbits import SAME, orbits_of, with_images
from gaitsweep.analysis.continuation.bifurcation_curves import BifurcationCurve, bifurcation_curve, step
from gaitsweep.analysis.continuation.branch_follower import ArclengthSteps
from gaitsweep.analysis.continuation.critical_points import CriticalPoint, SecondParameter, critical_kind
from gaitsweep.analysis.continuation.lockstep import alone, in_lockstep
from gaitsweep.analysis.continuation.stable_ranges import MARKS
from gaitsweep.engine.poincare.maps import Map, Points

# Columns of a branch that each of its records may replace.
_REPLACED = ("coefficient",)


class _BranchCurve(NamedTuple):
    """A curve of bifurcations, and the branch on which its first one was found."""

    branch: Branch
    curve: BifurcationCurve


def plane_curves(
    mapping: Map,
    branches: Sequence[Branch],
    within: Sequence[float],
    second: SecondParameter,
    steps: ArclengthSteps,
) -> list[Record]:
    """Follow the bifurcations and the order changes of branches over a second parameter.

    Args:
        mapping: the map, not iterated.
        branches: the branches; their `problem` has the value of the second parameter.
        within: the range of the branches' parameter, two numbers.
        second: the second parameter.
        steps: lengths and number of the steps.

    Returns:
        One record a point, as of `BranchAtlas.follow_curves`.
    """
    records: list[Record] = []
    curves_of_row: Counter[int] = Counter()
    for branch, curve in _bifurcation_curves(mapping, branches, second, steps):
        head = {"row": branch.row, "curve": curves_of_row[branch.row], "kind": curve.equations.kind}
        head["period"] = branch.period
        curves_of_row[branch.row] += 1
        records += [{**head, **with_suffixes(record, head)} for record in curve.records()]
    records += _order_curves(mapping, branches, within, second, curves_of_row)
    return records


def _bifurcation_curves(
    mapping: Map, branches: Sequence[Branch], second: SecondParameter, steps: ArclengthSteps
) -> list[_BranchCurve]:
    """The curves through the bifurcations of all branches, each once."""
    bifurcations = [
        (branch, place)
        for branch in branches
        for place, record in enumerate(branch.records)
        if record["special"] in MARKS and record["special"] != "corner" and not record["end"]
    ]
    computations = [
        bifurcation_curve(
            branch.problem, branch.point(place), branch.records[place]["special"], second, steps
        )
        for branch, place in bifurcations
    ]
    curves: list[_BranchCurve] = []
    for (branch, place), curve in zip(bifurcations, in_lockstep(computations), strict=True):
        orbits = [] if curve is None else _orbit_and_images(mapping, branch, place)
        if curve is None or not orbits:
            continue
        if not any(_passes(known, branch, place, orbit) for known in curves for orbit in orbits):
            curves.append(_BranchCurve(branch, curve))
    return curves


def _passes(known: _BranchCurve, branch: Branch, place: int, orbit: Points) -> bool:
    """Whether a curve passes the bifurcation at a record of a branch, whose `orbit` is that or its image."""
    equations, points = known.curve.equations, known.curve.points
    of_curve = known.branch.row, known.branch.period, equations.kind
    if of_curve != (branch.row, len(orbit), critical_kind(branch.records[place]["special"])):
        return False
    of_second = equations.m + 1  # the place of the second parameter among the unknowns
    at_branch = points[known.curve.first].point.unknowns[of_second]
    away = np.array([at.point.unknowns[of_second] for at in points]) - at_branch
    for k in np.flatnonzero(away[:-1] * away[1:] <= 0.0):
        point: CriticalPoint | None = points[int(k)].point
        if away[k] != 0.0:
            point = alone(step(equations, point, -float(away[k]), pinned=of_second))
        if point is None:
            continue
        miss = abs(equations.parameters(point.unknowns)[0] - branch.parameter[place]) / equations.width[0]
        distance = np.min(equations.mapping.distance(orbit.at, point.point.at))
        if miss < SAME and distance < np.sqrt(SAME):
            return True
    return False


def _order_curves(
    mapping: Map,
    branches: Sequence[Branch],
    within: Sequence[float],
    second: SecondParameter,
    curves_of_row: Counter[int],
) -> Iterator[Record]:
    """The records of the curves of order changes and of corners, numbered after the `curves_of_row`."""
    known: list[tuple[Branch, int]] = []  # the changes that have curves, by branch and place
    changes = [
        (branch, place)
        for branch in branches
        for place, record in enumerate(branch.records)
        if record["special"] in ("order_change", "corner")
    ]
    for branch, place in changes:
        record = branch.records[place]
        if _is_known(mapping, known, branch, place):
            continue
        curve = _order_change(branch, place, within, second).curve()
        head = {"row": branch.row, "kind": record["special"], "period": branch.period}
        head |= {"curve": curves_of_row[branch.row], "change": ", ".join(record.get("changes", ()))}
        curves_of_row[branch.row] += bool(curve)
        yield from ({**head, **with_suffixes(point, head)} for point in curve)
        known.append((branch, place))


def _order_change(
    branch: Branch, place: int, within: Sequence[float], second: SecondParameter
) -> OrderChange:
    """The change of the order of events at a record of a branch."""
    record, problem = branch.records[place], branch.problem
    return OrderChange(
        mapping=problem.mapping,
        parameter=problem.parameter,
        second=second.name,
        within=(within, (second.low, second.high)),
        values={name: value for name, value in problem.values.items() if name != second.name},
        fix=problem.fixed_values(),
        point=branch.point(place).points,
        home=(float(branch.parameter[place]), float(np.ravel(problem.values[second.name])[0])),
        events=record["events"],
        changes=frozenset(record.get("changes", ())),
        vanishes=record["special"] == "corner",
    )


def _is_known(mapping: Map, known: Sequence[tuple[Branch, int]], branch: Branch, place: int) -> bool:
    """Whether the orbit at a record of a branch, or an image of it, is that of a `known` record."""
    width = branch.problem.high - branch.problem.low
    near = [
        other.point(k).points
        for other, k in known
        if (other.row, other.period) == (branch.row, branch.period)
        and abs(other.parameter[k] - branch.parameter[place]) < ON_BRANCH * width
    ]
    images = _orbit_and_images(mapping, branch, place) if near else []
    return any(np.min(mapping.distance(image.at, point.at)) < ON_BRANCH for image in images for point in near)


def _orbit_and_images(mapping: Map, branch: Branch, place: int) -> list[Points]:
    """The orbit at a record of a branch, and its images under the symmetries; empty where there is none."""
    points, values = branch.point(place).points, branch.problem.values_at(branch.parameter[[place]])
    (orbit,) = orbits_of(mapping, points, values, branch.period)
    return [] if orbit is None else with_images(mapping, orbit, values)


def with_suffixes(record: Record, head: Record) -> Record:
    """A record whose observables with the name of a column of `head` end in _n, as in a job's table."""
    return {f"{k}_n" if k in head and k not in _REPLACED else k: v for k, v in record.items()}
