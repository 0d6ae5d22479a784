"""Test functions of bifurcations along a branch, and where they are zero.

Each test function is smooth along a smooth branch and changes sign at its own bifurcations, so that one step
may hold several.

Sources: Govaerts 2000, Numerical Methods for Bifurcations of Dynamical Equilibria, chapter 3 (test
functions); Kuznetsov 2004, Elements of Applied Bifurcation Theory, chapter 10.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from typing import Generic, NamedTuple, TypeVar

import numpy as np
from jaxtyping import Bool, Complex, Float

from gaitsweep.analysis.continuation.arclength_step import BranchPoints, ContinuationProblem, PerBranch
from gaitsweep.analysis.continuation.branch_points import FLAT, IMPERFECT, Crossing, branch_point, cornered
from gaitsweep.analysis.continuation.critical_points import REAL, located_exactly
from gaitsweep.analysis.continuation.floquet_multipliers import multipliers
from gaitsweep.analysis.continuation.lockstep import Computation, Request, alone, in_lockstep
from gaitsweep.analysis.continuation.normal_forms import PITCHFORKS
from gaitsweep.analysis.continuation.one_sided import both_sides
from gaitsweep.engine.poincare.maps import Points
from gaitsweep.engine.poincare.stationary_map import StationaryMap, eigenvalues

# The search for a zero ends with an interval this short, as a share of the step.
SHORTEST_INTERVAL = 1e-6
MOST_TRIALS = 40
# Two real multipliers cross the unit circle together if they are this close to it, and to each other.
TOGETHER = 1e-3
# Multipliers whose size differs from 1 by less count as on either side of the unit circle. Places that are
# beyond the ends of a step by less of its length count as on it.
EDGE = 1e-6
# The least value of the test function of pairs at which its sign means something.
ROUNDING = 1e-9
# A step is shorter where a test function seems to come this near to zero, as a share of its smaller value at
# the ends.
MARGIN = 0.2
# A test function this small, as a share of its larger value at the step's ends, has a zero and no jump.
SMALL = 1e-3

Test = Callable[[ContinuationProblem, BranchPoints], PerBranch]
TestValues = Float[np.ndarray, "branches tests"]
T = TypeVar("T")


def multipliers_of(
    problem: ContinuationProblem, branch_points: BranchPoints
) -> Complex[np.ndarray, "branches multipliers"]:
    """The multipliers (n, size - k), without those of the constrained conserved quantities.

    The largest is the first, or for stationary points the one whose motion grows fastest.
    """
    factors = multipliers(
        branch_points.images.jacobian, branch_points.images.conserved_jacobian[:, problem.constraints.which]
    )
    if not isinstance(problem.mapping, StationaryMap):
        return factors
    order = np.argsort(-np.real(eigenvalues(factors, 1.0)), axis=1, kind="stable")
    return np.take_along_axis(factors, order, axis=1)


def fold_test(problem: ContinuationProblem, branch_points: BranchPoints) -> PerBranch:
    """The derivative of the parameter over arclength, (n,): zero at a fold."""
    return branch_points.tangent[:, -1]


def branch_test(problem: ContinuationProblem, branch_points: BranchPoints) -> PerBranch:
    """The determinant of [F_x F_p] bordered by the tangent, (n,): zero at a branch point, not at a fold."""
    return np.linalg.det(problem.bordered(branch_points.images, problem.weights * branch_points.tangent))


def flip_test(problem: ContinuationProblem, branch_points: BranchPoints) -> PerBranch:
    """The product of the multipliers plus one, (n,): zero at a flip."""
    return np.prod(1.0 + multipliers_of(problem, branch_points), axis=1).real


def pair_test(problem: ContinuationProblem, branch_points: BranchPoints) -> PerBranch:
    """The product of 1 - m_i m_k over pairs of multipliers, (n,): zero where a pair crosses the unit circle.

    This is the test of Neimark-Sacker points. It is also zero at a neutral saddle: two real multipliers on
    both sides of the circle with product 1.
    """
    factors = multipliers_of(problem, branch_points)
    i, k = np.triu_indices(factors.shape[1], 1)
    return np.prod(1.0 - factors[:, i] * factors[:, k], axis=1).real


TESTS: tuple[Test, ...] = (fold_test, branch_test, flip_test, pair_test)


class ZeroOnStep(NamedTuple, Generic[T]):
    """A point at which a test function is zero, and its arclength from the start of the step."""

    point: T
    arclength: float


def located(
    ends: tuple[float, float],
    length: float,
    point_at: Callable[[float], Computation[T | None]],
    test: Callable[[T], float],
) -> Computation[ZeroOnStep[T] | None]:
    """The zero of a test function on a step; None where the search fails.

    Where no point is found, as beside a point at which several branches meet, the best trial before it counts
    if its value is small.

    Args:
        ends: values of the test function at both ends of the step.
        length: length of the step.
        point_at: point at an arclength from the step's start; None where there is none.
        test: the test function, which may jump over zero, as where the map has a corner.

    Source: Chandrupatla 1997, Advances in Engineering Software 28:145 (inverse parabolas and bisection).
    """
    if ends[0] * ends[1] > 0.0:
        return None
    # the newest end of the interval, the other end and the end before it, each with its value
    (b, fb), (a, fa) = (0.0, ends[0]), (length, ends[1])
    share = fa / (fa - fb) if fa != fb else 0.5
    best, least_value = None, SMALL * max(abs(fa), abs(fb))
    for _ in range(MOST_TRIALS):
        at = a + share * (b - a)
        point = yield from point_at(at)
        value = math.nan if point is None else test(point)
        if point is None or math.isnan(value):
            break
        if abs(value) <= least_value:
            best, least_value = ZeroOnStep(point, at), abs(value)
        (c, fc), (b, fb) = ((a, fa), (b, fb)) if value * fa > 0.0 else ((b, fb), (a, fa))
        a, fa = at, value
        if value == 0.0 or abs(b - a) < SHORTEST_INTERVAL * length:
            return ZeroOnStep(point, at)
        x, y = (a - b) / (c - b), (fa - fb) / (fc - fb)
        share = 0.5
        if y**2 < x and (1.0 - y) ** 2 < 1.0 - x:  # a parabola through the three is monotonic
            share = fa / (fb - fa) * fc / (fb - fc) + (c - a) / (b - a) * fa / (fc - fa) * fb / (fc - fb)
        # so far from the ends that a short interval is left once the zero is near
        least = 0.25 * SHORTEST_INTERVAL * length / abs(b - a)
        share = min(max(share, least), 1.0 - least)
    return best


def located_on_branch(
    problem: ContinuationProblem, before: BranchPoints, length: float, test: Test, ends: tuple[float, float]
) -> ZeroOnStep[BranchPoints] | None:
    """The zero of a test function on a step of one branch from `before`, as by `located`.

    Args:
        problem: the continuation problem, of one branch.
        before: the point (1,) from which the step begins.
        length: the length of the step.
        test: the test function.
        ends: its values at both ends of the step.
    """

    def point_at(arclength: float) -> Computation[BranchPoints | None]:
        point, converged = problem.step(before, np.array([arclength]))
        return point if converged[0] else None
        yield  # a computation of its own, which asks for nothing

    return alone(located(ends, length, point_at, lambda point: test(problem, point)[0]))


def _turns(problem: ContinuationProblem, at: BranchPoints) -> bool:
    """Whether the parameter turns smoothly at a point of one branch."""
    return bool(abs(fold_test(problem, at)[0]) < FLAT * (problem.high - problem.low))


def pair_kind(problem: ContinuationProblem, at_zero: BranchPoints) -> str:
    """The kind of one zero of `pair_test`: neimark_sacker; flip or branch_point of two at once; or ""."""
    factors = multipliers_of(problem, at_zero)[0]
    i, k = np.triu_indices(len(factors), 1)
    nearest = int(np.argmin(np.abs(1.0 - factors[i] * factors[k])))
    pair = factors[[i[nearest], k[nearest]]]
    if np.max(np.abs(pair - 1.0)) < TOGETHER:
        return "branch_point"
    if np.max(np.abs(pair + 1.0)) < TOGETHER:
        return "flip"
    return "neimark_sacker" if abs(pair[0].imag) > REAL * abs(pair[0]) else ""


@dataclasses.dataclass(frozen=True)
class Special:
    """A bifurcation on a step: its `kind`, its `arclength` from the step's start, its `point` (1,).

    `aside` (k,): points on the halves of branches that cross, as in `Crossing`.
    """

    kind: str
    arclength: float
    point: BranchPoints
    aside: BranchPoints | None = None


def test_values(problem: ContinuationProblem, branch_points: BranchPoints) -> TestValues:
    """The values of all test functions (n, tests)."""
    return np.stack([test(problem, branch_points) for test in TESTS], axis=1)


def hides_two_zeros(
    earlier: TestValues, first: TestValues, last: TestValues, before: PerBranch, length: PerBranch
) -> Bool[np.ndarray, " branches"]:
    """Whether a test function may have two zeros on a step, by the parabola through it and the step before.

    Args:
        earlier: the values (n, tests) at the beginning of the step before; NaN where there was none.
        first, last: those at the ends of the step.
        before, length: the lengths (n,) of the step before and of the step.
    """
    a, b = before[:, None], length[:, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        behind, ahead_of = (first - earlier) / a, (last - first) / b
        bend = (ahead_of - behind) / (a + b)
        slope = ahead_of - bend * b  # at the beginning of the step
        turn = -slope / (2.0 * bend)
        least = first + 0.5 * slope * turn
        inside = (turn > 0.0) & (turn < b) & (first * last > 0.0)
        smaller = np.minimum(np.abs(first), np.abs(last))
        return np.any(inside & (least * np.sign(first) < MARGIN * smaller), axis=1)


def bifurcations(
    problem: ContinuationProblem,
    before: BranchPoints,
    after: BranchPoints,
    length: PerBranch,
    first: TestValues,
    last: TestValues,
) -> list[list[Special] | None]:
    """The bifurcations on a step of each of n branches, in order.

    Args:
        problem: the continuation problem.
        before, after: the points at both ends of the steps.
        length: the lengths (n,) of the steps.
        first, last: the values (n, tests) of the test functions at both ends.

    Returns:
        For each branch its bifurcations. None where the step must be shorter: it led from one branch to
        another that passes close by, or the bifurcations do not explain how many multipliers crossed the
        unit circle.
    """
    ends = {test: (first[:, k], last[:, k]) for k, test in enumerate(TESTS)}
    # a test function may be zero at the end of a step: then it changes sign on one of the two steps there
    changed = {test: (below < 0.0) != (above < 0.0) for test, (below, above) in ends.items()}
    # pairs that stay on the unit circle, as those of a map that keeps areas, cross it by rounding alone
    changed[pair_test] &= np.maximum(*np.abs(ends[pair_test])) > ROUNDING
    specials: list[list[Special] | None] = [[] for _ in length]
    steps = np.flatnonzero(np.any(list(changed.values()), axis=0))
    searches = []
    for k in steps:
        signs = {test: (ends[test][0][k], ends[test][1][k]) for test in TESTS if changed[test][k]}
        only = np.array([k])
        searches.append(_BranchStep(problem[only], before[only], after[only], length[k]).specials(signs))
    for k, on_step in zip(steps, in_lockstep(searches), strict=True):
        specials[k] = on_step
    return specials


@dataclasses.dataclass(frozen=True)
class _BranchStep:
    """A step of one branch: its problem, the points `before` and `after` it (1,), and its length."""

    problem: ContinuationProblem
    before: BranchPoints
    after: BranchPoints
    length: float

    def specials(self, changed: dict[Test, tuple[float, float]]) -> Computation[list[Special] | None]:
        """The bifurcations on the step, as in `bifurcations`, by the tests that `changed` sign."""
        specials: list[Special] = []
        tests = [test for test in (fold_test, flip_test, pair_test) if test in changed]
        if branch_test in changed:
            ends = changed[branch_test]
            crossing, beta, zero = self._crossing(ends)
            if crossing is not None:
                if abs(beta) > IMPERFECT:
                    return None
                along = ahead(self.problem, self.before, crossing.point)
                specials.append(Special(crossing.kind, along, crossing.point, crossing.aside))
                # a pitchfork where the branch itself turns is not a fold
                if _turns(self.problem, crossing.point):
                    tests = [test for test in tests if test is not fold_test]
            elif zero is not None and self._vanishes(zero.point, ends):
                at_corner = cornered(self.problem, zero.point, both_sides(self.problem, zero.point))
                if at_corner is None:
                    at_corner = Crossing("branch_point", zero.point, None)
                specials.append(Special(at_corner.kind, zero.arclength, at_corner.point, at_corner.aside))
        for test in tests:
            special = yield from self._zero(test, changed[test])
            if special is not None:
                specials.append(special)
                if special.kind == "corner":  # multipliers jump there
                    return specials
        specials = sorted(specials, key=lambda special: special.arclength)
        return specials if self._explained(specials) else None

    def _crossing(
        self, ends: tuple[float, float]
    ) -> tuple[Crossing | None, float, ZeroOnStep[BranchPoints] | None]:
        """The branch point on a step with these values of `branch_test` at its ends, if there is one.

        Returns:
            The branch point, its scaled beta or that of the branches that pass each other, and the zero of
            the test function, if that had to be located.
        """
        crossing, beta = branch_point(self.problem, self._chord_zero(ends))
        if self._contains(crossing):
            return crossing, beta, None
        zero = located_on_branch(self.problem, self.before, self.length, branch_test, ends)
        if zero is None:
            return None, np.nan, None
        crossing, beta = branch_point(self.problem, zero.point)
        return crossing if self._contains(crossing) else None, beta, zero

    def _zero(self, test: Test, ends: tuple[float, float]) -> Computation[Special | None]:
        """The bifurcation at the zero of a test function, not that of branch points, if it is one.

        `ends` are the values of the test function at both ends of the step.
        """
        direct = yield from self._direct(self._chord_zero(ends), test)
        if direct is not None:
            return direct
        zero = located_on_branch(self.problem, self.before, self.length, test, ends)
        if zero is None:
            return None
        kind = _kind_at_zero(self.problem, zero.point, test)
        if not kind:
            return None
        exact = yield from _exact(self.problem, zero.point, kind)
        return Special(kind, zero.arclength, zero.point if exact is None else exact)

    def _direct(self, near: BranchPoints, test: Test) -> Computation[Special | None]:
        """The bifurcation by its own equations, from a point `near` it (1,).

        None where they lead elsewhere, or where the test function does not tell the kind.
        """
        kind = "fold" if test is fold_test else "flip" if test is flip_test else ""
        exact = yield from _exact(self.problem, near, kind)
        if exact is None:
            return None
        along = ahead(self.problem, self.before, exact)
        inside = self.problem.low <= exact.parameter[0] <= self.problem.high
        if not (0.0 <= along <= self.length and inside):
            return None
        critical = min(abs(multipliers_of(self.problem, exact)[0] - (1.0 if kind == "fold" else -1.0)))
        sound = critical < TOGETHER and (kind == "flip" or _turns(self.problem, exact))
        return Special(kind, along, exact) if sound else None

    def _chord_zero(self, ends: tuple[float, float]) -> BranchPoints:
        """The point of the step's chord where a function with these values at its ends is zero.

        Its tangent is the mean of those at the ends.
        """
        before, after, share = self.before, self.after, ends[0] / (ends[0] - ends[1])
        change = self.problem.mapping.difference(after.points.at, before.points.at)
        return dataclasses.replace(
            before,
            points=Points(before.points.at + share * change, before.points.modes),
            drift=before.drift + share * (after.drift - before.drift),
            parameter=before.parameter + share * (after.parameter - before.parameter),
            tangent=0.5 * (before.tangent + after.tangent),
            corrections=after.corrections,
        )

    def _vanishes(self, at: BranchPoints, ends: tuple[float, float]) -> bool:
        """Whether `branch_test` is zero at a point (1,), where it changes sign, and does not jump there."""
        return abs(branch_test(self.problem, at)[0]) < SMALL * max(map(abs, ends))

    def _contains(self, crossing: Crossing | None) -> bool:
        """Whether a branch point lies on the step."""
        if crossing is None:
            return False
        return -EDGE <= ahead(self.problem, self.before, crossing.point) / self.length <= 1.0 + EDGE

    def _explained(self, specials: list[Special]) -> bool:
        """Whether bifurcations explain the change of the number of multipliers outside the unit circle."""
        kinds = [special.kind for special in specials]
        if "corner" in kinds or "branch_point" in kinds:  # where several may cross, or jump
            return True
        sizes = [np.abs(multipliers_of(self.problem, point)) for point in (self.before, self.after)]
        outside = [[int(np.sum(size > 1.0 + sign * EDGE)) for sign in (1.0, -1.0)] for size in sizes]
        # multipliers at the unit circle count as on either side of it
        least, most = outside[1][0] - outside[0][1], outside[1][1] - outside[0][0]
        crossed = sum(2 if kind == "neimark_sacker" else 1 for kind in kinds)
        # the multiplier of the branch that turns at a pitchfork is 1 there, and on one side before and after
        crossed -= sum(
            special.kind in PITCHFORKS and _turns(self.problem, special.point) for special in specials
        )
        return any(abs(k) <= crossed and (crossed - k) % 2 == 0 for k in range(least, most + 1))


def _kind_at_zero(problem: ContinuationProblem, at_zero: BranchPoints, test: Test) -> str:
    """The kind of bifurcation at a zero of a test function; empty if it is none."""
    if test is fold_test:
        return "fold" if _turns(problem, at_zero) else "corner"  # where the map has a kink
    return "flip" if test is flip_test else pair_kind(problem, at_zero)


def _exact(problem: ContinuationProblem, near: BranchPoints, kind: str) -> Computation[BranchPoints | None]:
    """The bifurcation next to a point (1,), by its own equations; None if they fail."""
    if kind not in ("fold", "flip", "neimark_sacker"):
        return None
    exact = yield from located_exactly(problem, near, kind)
    if exact is None:
        return None
    k, size = len(problem.constraints.which), near.points.at.shape[1]
    parameter = problem.low + (problem.high - problem.low) * exact.unknowns[[size + k]]
    values = problem.values_at(parameter)
    images = yield Request(problem.mapping, problem.parameter, exact.point, values)
    tangent = problem.tangents(images, near.tangent)
    if not (images.sound[0] and np.isfinite(tangent).all()):
        return None
    drift = exact.unknowns[None, size : size + k]
    return dataclasses.replace(
        near, points=exact.point, drift=drift, parameter=parameter, images=images, tangent=tangent
    )


def ahead(problem: ContinuationProblem, before: BranchPoints, after: BranchPoints) -> float:
    """The length from `before` to `after` along the tangent at `before`.

    Args:
        problem: the continuation problem, of one branch.
        before, after: points (1,) of the branch.
    """
    size = before.points.at.shape[1]
    weighted = (problem.weights * before.tangent)[0]
    change = problem.mapping.difference(after.points.at, before.points.at)[0]
    return float(weighted[:size] @ change + weighted[-1] * (after.parameter - before.parameter)[0])
