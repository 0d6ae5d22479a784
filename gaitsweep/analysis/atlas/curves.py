"""One curve of bifurcations in two parameters, through a bifurcation of a branch and in both directions."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from gaitsweep.analysis.atlas.periodic_orbits import SAME
from gaitsweep.analysis.continuation.arclength_step import BranchPoints, ContinuationProblem
from gaitsweep.analysis.continuation.bifurcation_curves import CurvePoint, followed, step
from gaitsweep.analysis.continuation.branch_follower import ArclengthSteps
from gaitsweep.analysis.continuation.critical_points import CriticalEquations, CriticalPoint
from gaitsweep.analysis.continuation.exact_points import critical_kind, equations_at
from gaitsweep.analysis.continuation.lockstep import Computation, alone
from gaitsweep.engine.poincare.maps import Points

# The largest scaled imperfection at which branches still cross along a curve of branch points.
BROKEN = 1e-7


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
