"""Curves of bifurcations in the plane of two parameters, by pseudo-arclength.

A curve is followed in the space of the coordinates and both parameters, where it is smooth also at a cusp.
Functions that change sign along it locate the bifurcations of codimension 2 on it. It ends at the border of
the ranges, or as lost where the map has a corner or a jump.

Source: Kuznetsov 2004, Elements of Applied Bifurcation Theory, chapter 9 (bifurcations of codimension 2).
"""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from gaitsweep.analysis.continuation.arclength_step import BranchPoints, ContinuationProblem
from gaitsweep.analysis.continuation.bifurcation_tests import ZeroOnStep, located
from gaitsweep.analysis.continuation.branch_follower import JUMPS, ArclengthSteps
from gaitsweep.analysis.continuation.critical_points import (
    Border,
    CriticalEquations,
    CriticalPoint,
    SecondParameter,
    Vector,
    equations_at,
)
from gaitsweep.analysis.continuation.lockstep import Computation
from gaitsweep.engine.poincare.maps import Points

# Largest scaled residuals of F and of g at a point.
TOLERANCE = 1e-9
CRITICAL_TOLERANCE = 1e-7
# Most corrections of a step.
MOST_CORRECTIONS = 12
# Corrections go on while they halve the residual of g, to this one.
EXACT = 1e-11
# Least cosine of the angle by which a curve turns in a step.
STRAIGHT = 0.9
# Corrections after which the next step is longer.
FEW_CORRECTIONS = 5
# Factor of longer steps.
LONGER = 1.4
# Least points of a closed curve, less one.
POINTS_BEFORE_CLOSED = 4
# A curve is closed where it passes its first point within this share of a step.
BESIDE = 0.1
# The largest scaled imperfection at which branches still cross along a curve of branch points.
BROKEN = 1e-7
# Angle of a critical pair, rad, below which a curve ends where both multipliers are 1 or -1.
MEETING = 0.02


@dataclasses.dataclass(frozen=True)
class CurvePoint:
    """A point of a curve: its `point`, and `special`, the bifurcation of codimension 2 there or a kink."""

    point: CriticalPoint
    special: str = ""


@dataclasses.dataclass(frozen=True)
class BifurcationCurve:
    """A curve of bifurcations.

    Attributes:
        equations: of the bifurcation.
        points: its points in order.
        first: the index of the point that was found on a branch.
        ends: why it ends, at its first point and at its last.
    """

    equations: CriticalEquations
    points: list[CurvePoint]
    first: int
    ends: tuple[str, str]

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


def bifurcation_curve(
    problem: ContinuationProblem,
    at: BranchPoints,
    special: str,
    second: SecondParameter,
    steps: ArclengthSteps,
) -> Computation[BifurcationCurve | None]:
    """Follow the curve through a bifurcation of one branch (1,) in both directions; None where it has none.

    Args:
        problem: the continuation problem of the branch.
        at: the bifurcation.
        special: its kind on the branch.
        second: the second parameter, one of the problem's other parameters.
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


def followed(
    equations: CriticalEquations, first: CriticalPoint, sign: float, steps: ArclengthSteps
) -> Computation[tuple[list[CurvePoint], str]]:
    """A curve from its first point, and why it ends: range, closed, most, lost, or resonance_1_1 or 1_2.

    Args:
        equations: of the bifurcation, in two parameters.
        first: its first point.
        sign: the direction of the second parameter in which the curve is followed.
        steps: lengths and number of the steps, in which parameters count as shares of their ranges.
    """
    m = equations.m
    if not np.isfinite(first.tangent).all():
        return [CurvePoint(first)], "lost"
    if sign * first.tangent[m + 1] < 0.0:
        first = dataclasses.replace(first, tangent=-first.tangent)
    curve, before, length = [CurvePoint(first)], first, steps.first
    while len(curve) < steps.most:
        steps.on_progress([len(curve)], [len(curve) / steps.most])
        after = yield from step(equations, before, length)
        straight = after is not None and after.tangent @ before.tangent >= STRAIGHT
        if after is None or not straight or _steps_over(equations, before, after):
            length *= 0.5
            if length >= steps.shortest:
                continue
            if equations.kind == "neimark_sacker" and _meeting(before):
                return curve, _meeting(before)
            leap = yield from _leap(equations, before, steps.longest)
            if leap is None:
                return curve, "lost"
            curve.append(CurvePoint(leap, "kink"))
            before, length = leap, steps.first
            continue
        home = _share_at(before, after, first) if len(curve) >= POINTS_BEFORE_CLOSED else None
        # beyond its first point a closed curve repeats itself
        covered = length * (1.0 if home is None else home)
        zeros = yield from _degenerate(equations, before, after, length)
        within = (zero.point for zero in zeros if zero.arclength <= covered)
        curve += [at for at in within if not _outside(at.point, m)]
        if outside := _outside(after, m):
            edge = yield from _at_edge(equations, before, after, outside)
            return curve + ([] if edge is None else [CurvePoint(edge)]), "range"
        if home is not None:
            return [*curve, CurvePoint(first)], "closed"
        curve.append(CurvePoint(after))
        if equations.kind == "neimark_sacker" and _meeting(after):
            return curve, _meeting(after)
        if after.corrections <= FEW_CORRECTIONS:
            length = min(LONGER * length, steps.longest)
        before = after
    return curve, "most"


def step(
    equations: CriticalEquations, before: CriticalPoint, length: float, pinned: int | None = None
) -> Computation[CriticalPoint | None]:
    """The point of a curve one arclength step ahead; None where the corrections do not converge.

    Args:
        equations: of the bifurcation, in two parameters.
        before: the point from which the step begins.
        length: the arclength, or the change of the unknown `pinned`.
        pinned: number of an unknown that is moved by `length` in place of the arclength.
    """
    normal = before.tangent
    if pinned is not None:
        normal = np.eye(len(before.tangent))[pinned]
    guess = before.tangent * (length / (normal @ before.tangent))
    matrix = np.concatenate([before.matrix, normal[None]])
    change, moved, like = guess.copy(), np.zeros_like(guess), before.point
    border, norm, m = Border(before.v, before.w), np.inf, equations.m
    for number in range(1, MOST_CORRECTIONS + 1):
        unknowns = before.unknowns + change
        miss, full, images = yield from equations.evaluated(like, unknowns[None])
        if not np.isfinite(full).all():
            return None
        residual, _, _ = equations.residual(unknowns, miss[0], full[0], border)
        if not np.isfinite(residual).all():
            return None
        off = normal @ change - length
        of_map, of_g = float(np.max(np.abs(residual[:m]))), float(np.max(np.abs(residual[m:])))
        close = of_map <= TOLERANCE and of_g <= CRITICAL_TOLERANCE and abs(off) <= 1e-9
        if close and (of_g <= EXACT or of_g > 0.5 * norm or number == MOST_CORRECTIONS):
            after = yield from equations.at(like, unknowns, border, before.tangent, number)
            return after if after is not None and np.isfinite(after.tangent).all() else None
        if max(of_map, of_g) > 10.0 * norm + 1e-3:
            return None
        norm = max(of_map, of_g)
        wrong = np.append(residual, off)
        if number > 1:  # Broyden's update: what the last step did not foresee
            matrix += np.outer(wrong, moved) / (moved @ moved)
        try:
            moved = np.linalg.solve(matrix, -wrong)
        except np.linalg.LinAlgError:
            return None
        change = change + moved
        like = Points(like.at, images.points.modes)
    return None


def _degenerate(
    equations: CriticalEquations, before: CriticalPoint, after: CriticalPoint, length: float
) -> Computation[list[ZeroOnStep[CurvePoint]]]:
    """The bifurcations of codimension 2 on a step, in order."""
    points: list[ZeroOnStep[CurvePoint]] = []
    for name, value in before.tests.items():
        later = after.tests.get(name, np.nan)
        if not value * later < 0.0:
            continue
        zero = yield from located(
            (value, later),
            length,
            lambda arclength: step(equations, before, arclength),
            lambda point, name=name: point.tests[name],
        )
        # where the test jumps, there is no such point
        is_zero = zero is not None and abs(zero.point.tests[name]) < 1e-3 * max(abs(value), abs(later))
        if zero is not None and is_zero and equations.is_critical(name, zero.point):
            points.append(ZeroOnStep(CurvePoint(zero.point, name), zero.arclength))
    return sorted(points, key=lambda zero: zero.arclength)


def _outside(at: CriticalPoint, m: int) -> list[int]:
    """Those of the two parameters, by their places from `m` on, that are outside of their ranges."""
    return [k for k in (m, m + 1) if not 0.0 <= at.unknowns[k] <= 1.0]


def _at_edge(
    equations: CriticalEquations, before: CriticalPoint, after: CriticalPoint, outside: list[int]
) -> Computation[CriticalPoint | None]:
    """The point at which a curve leaves the ranges of the parameters; None if its last point is there."""
    change = after.unknowns - before.unknowns
    to_edge = np.clip(after.unknowns, 0.0, 1.0) - before.unknowns
    shares = [to_edge[k] / change[k] if change[k] else np.inf for k in outside]
    first = outside[int(np.argmin(shares))]
    if not before.tangent[first] or not to_edge[first]:
        return None
    return (yield from step(equations, before, float(to_edge[first]), pinned=first))


def _leap(
    equations: CriticalEquations, before: CriticalPoint, longest: float
) -> Computation[CriticalPoint | None]:
    """The point behind a corner or a jump of the map, where no short step leads over it; else None."""
    for share in JUMPS:
        after = yield from step(equations, before, share * longest)
        if after is None or _steps_over(equations, before, after):
            continue
        if after.tangent @ before.tangent > 0.0:
            return after
    return None


def _share_at(before: CriticalPoint, after: CriticalPoint, home: CriticalPoint) -> float | None:
    """The share of a step at which it passes the first point of its curve, if it does."""
    change: Vector = after.unknowns - before.unknowns
    away = home.unknowns - before.unknowns
    share = float(away @ change / (change @ change))
    near = 0.0 < share <= 1.0 and np.linalg.norm(away - share * change) < BESIDE * np.linalg.norm(change)
    return share if near and after.tangent @ home.tangent > 0.0 else None


def _steps_over(equations: CriticalEquations, before: CriticalPoint, after: CriticalPoint) -> bool:
    """Whether a pair of multipliers meets in a step, behind which the curve leads back along itself."""
    is_pair = equations.kind == "neimark_sacker"
    return is_pair and bool(np.sin(before.unknowns[-1]) * np.sin(after.unknowns[-1]) < 0.0)


def _meeting(point: CriticalPoint) -> str:
    """The resonance that a pair of multipliers is near by: both are 1, or -1; else empty."""
    angle = float(point.unknowns[-1])
    if abs(angle) < MEETING:
        return "resonance_1_1"
    return "resonance_1_2" if abs(angle - np.pi) < MEETING else ""
