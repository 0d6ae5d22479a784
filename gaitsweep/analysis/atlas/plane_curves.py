"""Curves through the bifurcations and order changes of branches, in the plane of two parameters."""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from gaitsweep.analysis.atlas.branch import ON_BRANCH, Branch, Record
from gaitsweep.analysis.atlas.order_curves import OrderChange
from gaitsweep.analysis.atlas.periodic_orbits import SAME, orbits_of, with_images
from gaitsweep.analysis.continuation.arclength_step import BranchPoints, ContinuationProblem
from gaitsweep.analysis.continuation.bifurcation_curves import CurvePoint, followed, step
from gaitsweep.analysis.continuation.branch_follower import ArclengthSteps
from gaitsweep.analysis.continuation.critical_points import CriticalEquations, CriticalPoint
from gaitsweep.analysis.continuation.exact_points import critical_kind, equations_at
from gaitsweep.analysis.continuation.lockstep import Computation, alone, in_lockstep
from gaitsweep.analysis.continuation.stable_ranges import MARKS
from gaitsweep.engine.poincare.maps import Map, Points

# The largest scaled imperfection at which branches still cross along a curve of branch points.
BROKEN = 1e-7
# Columns that a record may itself have beside those of its curve or branch.
_OF_RECORD = ("coefficient",)


@dataclasses.dataclass(frozen=True)
class BifurcationCurve:
    """A curve of bifurcations of orbits of one period.

    Attributes:
        equations: of the bifurcation.
        points: its points in order.
        first: the index of the point that was found on a branch.
        ends: why it ends, at its first point and at its last.
        row, period: those of the branch.
    """

    equations: CriticalEquations
    points: list[CurvePoint]
    first: int
    ends: tuple[str, str]
    row: int = 0
    period: int = 1

    def passes(self, row: int, special: str, orbit: Points, parameter: float) -> bool:
        """Whether it passes a bifurcation of this kind of an orbit, at the value of the second parameter.

        Args:
            row: the row.
            special: the kind of the bifurcation, as on a branch.
            orbit: all points of the orbit there.
            parameter: the first parameter there; the second is that of the curve's point on a branch.
        """
        equations, m = self.equations, self.equations.m
        if (row, critical_kind(special), len(orbit)) != (self.row, equations.kind, self.period):
            return False
        home = self.points[self.first].point.unknowns[m + 1]
        level = np.array([at.point.unknowns[m + 1] for at in self.points]) - home
        for k in np.flatnonzero(level[:-1] * level[1:] <= 0.0):
            at_level: CriticalPoint | None = self.points[int(k)].point
            if level[k] != 0.0:
                at_level = alone(step(equations, at_level, -float(level[k]), pinned=m + 1))
            if at_level is None:
                continue
            off = abs(equations.parameters(at_level.unknowns)[0] - parameter) / equations.width[0]
            away = equations.mapping.distance(orbit.at, at_level.point.at)
            if off < SAME and np.min(away) < np.sqrt(SAME):
                return True
        return False

    def records(self) -> list[dict[str, Any]]:
        """One record a point."""
        records = [self._record(at, number - self.first) for number, at in enumerate(self.points)]
        records[0]["end"] = self.ends[0]
        records[-1]["end"] = self.ends[1] or records[-1]["end"]
        return records

    def _record(self, at: CurvePoint, number: int) -> dict[str, Any]:
        """The record of the point with this number."""
        equations, point = self.equations, at.point
        parameters = equations.parameters(point.unknowns)
        factors = point.multipliers
        critical = factors[int(np.argmin(np.abs(factors - equations.critical(point.unknowns))))]
        others = equations.other_multipliers(point.unknowns, factors)
        return {
            "point": number,
            **dict(zip(equations.names, map(float, parameters), strict=True)),
            **point.observed,
            "multiplier_re": float(critical.real),
            "multiplier_im": float(critical.imag),
            "unstable": int(np.sum(np.abs(others) > 1.0)),
            "special": at.special,
            "corrections": point.corrections,
            "end": "",
        }


def curve_through(
    problem: ContinuationProblem,
    at: BranchPoints,
    special: str,
    second: tuple[str, float, float, float],
    steps: ArclengthSteps,
) -> Computation[BifurcationCurve | None]:
    """Follow the curve through a bifurcation of one branch (1,) in both directions; None where it has none.

    Args:
        problem: the continuation problem of the branch.
        at: the bifurcation.
        special: its kind on the branch.
        second: name, lowest, highest and present value of the second parameter.
        steps: lengths and number of the steps.
    """
    equations, unknowns = equations_at(problem, at, special, second)
    first = yield from equations.first(at.points, unknowns)
    if first is None or not np.isfinite(first.tangent).all():
        return None
    behind, begin = yield from followed(equations, first, -1.0, steps)
    ahead, end = yield from followed(equations, first, 1.0, steps)
    if begin == "closed":
        behind = behind[:1]
    behind, begin = _unbroken(equations, behind, begin)
    ahead, end = _unbroken(equations, ahead, end)
    if max(len(behind), len(ahead)) < 2:
        return None
    return BifurcationCurve(equations, [*behind[:0:-1], *ahead], len(behind) - 1, (begin, end))


def _unbroken(
    equations: CriticalEquations, curve: list[CurvePoint], end: str
) -> tuple[list[CurvePoint], str]:
    """The part of a curve on which branches do cross, and why it ends.

    Without a symmetry a curve of branch points has one point.
    """
    if equations.kind == "branch_point":
        for number, at in enumerate(curve):
            if abs(at.point.unknowns[-1]) > BROKEN:
                return curve[:number], "broken"
    return curve, end


@dataclasses.dataclass(frozen=True)
class SecondParameter:
    """A second parameter: its name, and its range."""

    name: str
    low: float
    high: float


def plane_curves(
    mapping: Map,
    branches: Sequence[Branch],
    within: Sequence[float],
    second: SecondParameter,
    steps: ArclengthSteps,
    curves_before: Mapping[int, int],
) -> list[Record]:
    """Follow the bifurcations and the order changes of branches over a second parameter.

    Those in records of an earlier run have their curves in that run's table.

    Args:
        mapping: the map, not iterated.
        branches: the branches; their `problem` has the value of the second parameter.
        within: the range of the branches' parameter, two numbers.
        second: the second parameter.
        steps: lengths and number of the steps.
        curves_before: the number of curves of an earlier run, by row.

    Returns:
        One record a point, as of `BranchAtlas.follow_curves`.
    """
    candidates = []
    for branch in branches:
        for place in _new_places(mapping, branches, branch):
            special, end = (branch.records[place][name] for name in ("special", "end"))
            if special in MARKS and special != "corner" and not end:
                candidates.append((branch, place))
    followed = in_lockstep(
        [
            curve_through(
                branch.problem,
                branch.point(place),
                branch.records[place]["special"],
                (second.name, second.low, second.high, _home(branch, second)),
                steps,
            )
            for branch, place in candidates
        ]
    )
    curves: list[BifurcationCurve] = []
    for (branch, place), curve in zip(candidates, followed, strict=True):
        images = [] if curve is None else _images(mapping, branch, place)
        if curve is None or not images:
            continue
        parameter, kind = float(branch.parameter[place]), branch.records[place]["special"]
        if not any(known.passes(branch.row, kind, image, parameter) for known in curves for image in images):
            curves.append(dataclasses.replace(curve, row=branch.row, period=branch.period))
    records: list[Record] = []
    curves_of_row = Counter(curves_before)
    for curve in curves:
        head = {"row": curve.row, "curve": curves_of_row[curve.row], "kind": curve.equations.kind}
        head["period"] = curve.period
        curves_of_row[curve.row] += 1
        records += [{**head, **renamed_apart(record, head)} for record in curve.records()]
    records += _order_curves(mapping, branches, within, second, curves_of_row)
    return records


def _order_curves(
    mapping: Map,
    branches: Sequence[Branch],
    within: Sequence[float],
    second: SecondParameter,
    curves_of_row: Counter[int],
) -> Iterator[Record]:
    """The records of the curves of order changes and of corners, numbered after the `curves_of_row`."""
    known: list[tuple[Branch, float, Points]] = []
    marked = [
        (branch, place)
        for branch in branches
        for place, record in enumerate(branch.records)
        if record["special"] in ("order_change", "corner")
    ]
    marked.sort(key=lambda mark: "earlier" not in mark[0].records[mark[1]])
    for branch, place in marked:
        record, problem, points = branch.records[place], branch.problem, branch.points(place)
        parameter = float(branch.parameter[place])
        if "earlier" in record:
            known.append((branch, parameter, points))
            continue
        images = _images(mapping, branch, place)
        near = [
            point
            for of_point, at, point in known
            if (of_point.row, of_point.period) == (branch.row, branch.period)
            and abs(at - parameter) < ON_BRANCH * (problem.high - problem.low)
        ]
        if _is_among(mapping, images, near):
            continue
        known.append((branch, parameter, points))
        names = [mapping.conserved[k].name for k in problem.constraints.which]
        change = OrderChange(
            mapping=problem.mapping,
            parameter=problem.parameter,
            second=second.name,
            within=(within, (second.low, second.high)),
            values={name: value for name, value in problem.values.items() if name != second.name},
            fix=dict(zip(names, problem.constraints.values.T, strict=True)),
            point=points,
            home=(parameter, _home(branch, second)),
            events=record["events"],
            changes=frozenset(record.get("changes", ())),
            vanishes=record["special"] == "corner",
        )
        head = {"row": branch.row, "kind": record["special"], "period": branch.period}
        head |= {"curve": curves_of_row[branch.row], "change": ", ".join(record.get("changes", ()))}
        curve = change.curve()
        curves_of_row[branch.row] += bool(curve)
        yield from ({**head, **renamed_apart(point, head)} for point in curve)


def _home(branch: Branch, second: SecondParameter) -> float:
    """The value of the second parameter at a branch."""
    return float(np.ravel(branch.problem.values[second.name])[0])


def _new_places(mapping: Map, branches: Sequence[Branch], branch: Branch) -> Iterator[int]:
    """The places of the records of a branch that are not of an earlier run, nor at a bifurcation of one."""
    earlier = [
        (known, k)
        for known in branches
        if (known.row, known.period) == (branch.row, branch.period)
        for k, record in enumerate(known.records)
        if "earlier" in record and record["special"] in MARKS
    ]
    width = branch.problem.high - branch.problem.low
    for place, record in enumerate(branch.records):
        if "earlier" in record:
            continue
        near = [
            known.points(k)
            for known, k in earlier
            if abs(known.parameter[k] - branch.parameter[place]) < ON_BRANCH * width
        ]
        images = _images(mapping, branch, place) if near and record["special"] in MARKS else []
        if not _is_among(mapping, images, near):
            yield place


def _is_among(mapping: Map, images: Sequence[Points], known: Sequence[Points]) -> bool:
    """Whether one of the `known` points (1,) is a point of an orbit or of its `images`."""
    return any(
        np.min(mapping.distance(image.at, point.at)) < ON_BRANCH for image in images for point in known
    )


def _images(mapping: Map, branch: Branch, place: int) -> list[Points]:
    """The orbit at a record of a branch, and its images under the symmetries; empty where there is none."""
    points, values = branch.points(place), branch.problem.values_at(branch.parameter[[place]])
    (orbit,) = orbits_of(mapping, points, values, branch.period)
    return [] if orbit is None else with_images(mapping, orbit, values)


def renamed_apart(record: Record, head: Record) -> Record:
    """A record whose observables with the name of a column of `head` end in _n, as in a job's table."""
    return {f"{k}_n" if k in head and k not in _OF_RECORD else k: v for k, v in record.items()}
