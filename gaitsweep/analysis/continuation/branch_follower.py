"""Branches of fixed points followed to their ends, many at once, each with its own step lengths.

Bifurcations on a step are located, and jumps of the map are crossed.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Int

from gaitsweep.analysis.continuation.arclength_step import (
    BranchPoints,
    ContinuationProblem,
    Converged,
    PerBranch,
)
from gaitsweep.analysis.continuation.bifurcation_tests import (
    TESTS,
    TOGETHER,
    Special,
    ahead,
    bifurcations,
    hides_two_zeros,
    test_values,
)
from gaitsweep.analysis.continuation.branch_points import CROSSINGS, IMPERFECT, branch_point
from gaitsweep.analysis.continuation.branch_table import BranchTable
from gaitsweep.analysis.continuation.newton import newton
from gaitsweep.engine.poincare.maps import Points

# Least cosine of the angle by which a branch turns in a step.
STRAIGHT = 0.95
# Largest distance from the beginning of a step to its end, as a multiple of its length. A longer one leads to
# another branch; where the length is below so many shortest ones, the branch may have a corner.
FARTHEST = 2.0
CORNER_STEPS = 10.0
# Most corrections of a step after which the next one is longer.
FEW_CORRECTIONS = 6
# Factors of longer and of shorter steps.
LONGER = 1.4
SHORTER = 0.5
# A branch is closed where it passes its start within this share of a step.
CLOSED_WITHIN = 0.75
# Least points of a closed branch, less one.
POINTS_BEFORE_CLOSED = 4
# A branch that no shortest step leads on ends at a branch point that is within so many of these steps.
STEPS_TO_END = 4.0
# Largest share of its way that a branch counts as done while it is followed.
LARGEST_PROGRESS = 0.95
# Shares of the longest step that are tried to jump over a discontinuity, where no short step converges.
JUMPS = (1 / 16, 1 / 8, 1 / 4, 1 / 2, 1.0)
# Largest distance from the end of a branch to the tangent behind it, as a share of the way over, at a bend.
MISSED = 0.05
# Halvings of the interval that holds a bend.
BISECTIONS = 20


@dataclasses.dataclass(frozen=True)
class ArclengthSteps:
    """Lengths and number of the steps along branches.

    In a length, the parameter is a share of its range, and coordinates are relative to their magnitudes.

    Attributes:
        first, longest, shortest: lengths of the first, the longest and the shortest step.
        most: the most points of a branch.
        on_progress: called before each step with the number of points of each branch (n,), and the share of
            the parameter's range along which it was followed (n,), 1 at its end; an exception that it raises
            stops the continuation.
        through: values of the parameter at which each branch that passes them has a point.
    """

    first: float = 0.02
    longest: float = 0.08
    shortest: float = 1e-4
    most: int = 300
    on_progress: Callable[[Any, Any], None] = lambda points, shares: None
    through: tuple[float, ...] = ()


class BranchCrossing(NamedTuple):
    """A branch point (1,) with the index of its branch, and points on the halves of the one that crosses."""

    branch: int
    point: BranchPoints
    aside: BranchPoints | None


class BranchFollower:
    """Follows n branches from their first fixed points to their ends.

    Args:
        problem: the continuation problem.
        branch_points: the first fixed point of each branch.
        numbers: (n,) the number of each branch in the table.
        table: the table that collects the points.
        steps: the step lengths.

    `crossings` has the branch points that were found.
    """

    def __init__(
        self,
        problem: ContinuationProblem,
        branch_points: BranchPoints,
        numbers: Int[np.ndarray, " branches"],
        table: BranchTable,
        steps: ArclengthSteps,
    ) -> None:
        self.problem, self.numbers, self.table, self.steps = problem, numbers, table, steps
        self.home = self.branch_points = branch_points
        self.length = np.full(len(numbers), steps.first)
        self.going = np.ones(len(numbers), bool)
        # the test functions at the beginning of the last step of each branch, and its length
        self.tests_before = np.full((len(numbers), len(TESTS)), np.nan)
        self.length_before = np.ones(len(numbers))
        self.crossings: list[BranchCrossing] = []
        table.write(numbers, problem, branch_points, [""] * len(numbers))

    def follow(self) -> None:
        """Follow each branch to its end."""
        while self.going.any():
            moved = np.abs(self.branch_points.parameter - self.home.parameter)
            shares = np.minimum(moved / (self.problem.high - self.problem.low), LARGEST_PROGRESS)
            self.steps.on_progress(self.table.counts(self.numbers), np.where(self.going, shares, 1.0))
            rows = np.flatnonzero(self.going)
            problem, before = self.problem[rows], self.branch_points[rows]
            after, converged = problem.step(before, self.length[rows])
            straight = np.sum(problem.weights * before.tangent * after.tangent, axis=1) > STRAIGHT
            accepted = converged & (straight | (self.length[rows] <= self.steps.shortest))
            farthest = FARTHEST * np.maximum(self.length[rows], CORNER_STEPS * self.steps.shortest)
            accepted &= _distance(problem, before, after) < farthest
            specials = self._specials(rows, before, after, accepted)
            accepted = np.array([special is not None for special in specials], bool)
            self._reject(rows[~accepted])
            if accepted.any():
                their_specials = [special for special in specials if special is not None]
                self._accept(rows[accepted], after[accepted], their_specials)

    def _specials(
        self,
        rows: Int[np.ndarray, " rows"],
        before: BranchPoints,
        after: BranchPoints,
        accepted: Bool[np.ndarray, " rows"],
    ) -> list[list[Special] | None]:
        """The bifurcations on each of some steps; None where it is not `accepted`, or has to be shorter.

        Where a step cannot be shortened, several multipliers cross at one place: it is a branch point.
        """
        specials: list[list[Special] | None] = [None] * rows.size
        on = np.flatnonzero(accepted)
        if not on.size:
            return specials
        first, last = (test_values(self.problem[rows[on]], points[on]) for points in (before, after))
        length = self.length[rows]
        shortest = length * SHORTER < self.steps.shortest
        hidden = hides_two_zeros(
            self.tests_before[rows[on]], first, last, self.length_before[rows[on]], length[on]
        )
        searched = np.flatnonzero(~hidden | shortest[on])
        on, first, last = on[searched], first[searched], last[searched]
        located = bifurcations(self.problem[rows[on]], before[on], after[on], length[on], first, last)
        for k, on_step, values in zip(on, located, first, strict=True):
            specials[k] = on_step
            if on_step is None and shortest[k]:
                specials[k] = [Special("branch_point", float(length[k]), after[[k]])]
            if specials[k] is not None:
                self.tests_before[rows[k]] = values
                self.length_before[rows[k]] = length[k]
        return specials

    def crossing(self) -> BranchFollower | None:
        """A follower of both halves of each branch that crosses at a branch point; None if there is none.

        A half that was not found has the branch point as its only point.
        """
        rows, numbers, asides = [], [], []
        for row, point, aside in self.crossings:
            halves = 0
            if aside is not None:
                halves = len(aside.parameter)
                asides.append(aside)
            rows += [row] * halves
            numbers += [self.table.add_branch(int(self.numbers[row])) for _ in range(halves)]
            for _ in range(2 - halves):
                number = np.array([self.table.add_branch(int(self.numbers[row]))])
                problem = self.problem[np.array([row])]
                self.table.write(number, problem, point, [""], tolerance=TOGETHER)
                self.table.end(number, "not_found")
        if not rows:
            return None
        first = BranchPoints.joined(asides)
        return BranchFollower(self.problem[np.array(rows)], first, np.array(numbers), self.table, self.steps)

    def _passed(
        self, problem: ContinuationProblem, before: BranchPoints, after: BranchPoints
    ) -> list[list[Special]]:
        """The points of steps at the values of the parameter that each branch has to have."""
        passed: list[list[Special]] = [[] for _ in before.parameter]
        for value in self.steps.through:
            rows = np.flatnonzero((before.parameter - value) * (after.parameter - value) < 0.0)
            if not rows.size:
                continue
            at_value, converged = problem[rows].at(before[rows], np.full(rows.size, value))
            for k in np.flatnonzero(converged):
                row, point = rows[[k]], at_value[[k]]
                passed[rows[k]].append(Special("", ahead(problem[row], before[row], point), point))
        return passed

    def _end(self, rows: Int[np.ndarray, " rows"], reason: str) -> None:
        """End the branches `rows`."""
        self.table.end(self.numbers[rows], reason)
        self.going[rows] = False

    def _reject(self, rows: Int[np.ndarray, " rows"]) -> None:
        """Halve rejected steps; where they become too short, try to jump over a discontinuity of the map."""
        self.length[rows] *= SHORTER
        rows = rows[self.length[rows] < self.steps.shortest]
        if not rows.size:
            return
        problem = self.problem[rows]
        for row in rows:
            self._mark_corner(np.array([row]))
        over, crossed = _jump_over(problem, self.branch_points[rows], self.steps.longest)
        landed = np.flatnonzero(crossed)
        self._write_corners(rows[landed], over[landed])
        self.branch_points = self.branch_points.merged(rows[landed], over[landed])
        self.tests_before[rows] = np.nan
        self.length[rows] = self.steps.first
        self.table.write(self.numbers[rows[landed]], problem[landed], over[landed], ["kink"] * landed.size)
        self._end(rows[~crossed], "lost")

    def _mark_corner(self, row: Int[np.ndarray, " 1"]) -> None:
        """Record the branch point in a corner of the map at which one branch (1,) ends, if there is one."""
        problem, before = self.problem[row], self.branch_points[row]
        crossing, beta = branch_point(problem, before)
        if crossing is None or not abs(beta) <= IMPERFECT:
            return
        if 0.0 <= ahead(problem, before, crossing.point) <= STEPS_TO_END * self.steps.shortest:
            self.table.write(self.numbers[row], problem, crossing.point, [crossing.kind], tolerance=TOGETHER)
            self.crossings.append(BranchCrossing(int(row[0]), crossing.point, crossing.aside))

    def _write_corners(self, rows: Int[np.ndarray, " rows"], over: BranchPoints) -> None:
        """Record the corners where the parameter turns on the way to points `over` a bend of the map."""
        for k in np.flatnonzero(self.branch_points.tangent[rows, -1] * over.tangent[:, -1] < 0.0):
            row = rows[[k]]
            problem, before = self.problem[row], self.branch_points[row]
            if _meets(problem, before, over[[k]]):
                corner = _last_before(problem, before, self.steps.shortest)
                self.table.write(self.numbers[row], problem, corner, ["corner"], tolerance=TOGETHER)

    def _accept(
        self, rows: Int[np.ndarray, " rows"], after: BranchPoints, specials: list[list[Special]]
    ) -> None:
        """Record accepted steps and their bifurcations, and end branches that are complete."""
        self._write_specials(rows, after, specials)
        inside = (after.parameter >= self.problem.low) & (after.parameter <= self.problem.high)
        self._leave_range(rows[~inside], after[~inside])
        if not inside.any():
            return
        rows, after = rows[inside], after[inside]
        problem, numbers = self.problem[rows], self.numbers[rows]
        self.table.write(numbers, problem, after, _jumps(self.branch_points[rows], after))
        self.branch_points = self.branch_points.merged(rows, after)
        home = self.home[rows]
        closed = _distance(problem, after, home) < CLOSED_WITHIN * self.length[rows]
        closed &= np.sum(problem.weights * after.tangent * home.tangent, axis=1) > 0.0
        closed &= self.table.counts(numbers) > POINTS_BEFORE_CLOSED
        self._end(rows[closed], "closed")
        self._end(rows[~closed & (self.table.counts(numbers) >= self.steps.most)], "most")
        easy = rows[after.corrections <= FEW_CORRECTIONS]
        self.length[easy] = np.minimum(LONGER * self.length[easy], self.steps.longest)

    def _write_specials(
        self, rows: Int[np.ndarray, " rows"], after: BranchPoints, specials: list[list[Special]]
    ) -> None:
        """Record the bifurcations on steps, and the points at the values that branches have to pass."""
        passed = self._passed(self.problem[rows], self.branch_points[rows], after)
        for row, on_step, at_values in zip(rows, specials, passed, strict=True):
            problem = self.problem[np.array([row])]
            for special in sorted([*on_step, *at_values], key=lambda special: special.arclength):
                if not problem.low <= special.point.parameter[0] <= problem.high:
                    continue
                number = self.numbers[[row]]
                self.table.write(number, problem, special.point, [special.kind], tolerance=TOGETHER)
                if special.kind in CROSSINGS:
                    self.crossings.append(BranchCrossing(int(row), special.point, special.aside))

    def _leave_range(self, rows: Int[np.ndarray, " rows"], beyond: BranchPoints) -> None:
        """Record where the branches `rows` leave the range of the parameter, and end them."""
        if not rows.size:
            return
        problem = self.problem[rows]
        at_end, converged = problem.at(beyond, np.clip(beyond.parameter, problem.low, problem.high))
        reached = np.flatnonzero(converged)
        numbers = self.numbers[rows[reached]]
        self.table.write(numbers, problem[reached], at_end[reached], [""] * reached.size)
        self._end(rows, "range")


def _jumps(before: BranchPoints, after: BranchPoints) -> list[str]:
    """For each step "kink" where the parameter moved against the tangents at both of its ends, else ""."""
    change = after.parameter - before.parameter
    against = (change * before.tangent[:, -1] < 0.0) & (change * after.tangent[:, -1] < 0.0)
    return np.where(against, "kink", "").tolist()


def _jump_over(
    problem: ContinuationProblem, before: BranchPoints, longest: float
) -> tuple[BranchPoints, Converged]:
    """Branch points beyond a discontinuity of the map or of its derivative, and whether found (n,).

    Where a trajectory grazes an event the map has no derivative, and may jump. No short step converges there,
    but a longer one may cross it, either by arclength or at a given value of the parameter.
    """
    best, landed = before, np.zeros(len(before.parameter), bool)
    for share in JUMPS:
        for across in (True, False):
            rows = np.flatnonzero(~landed)
            if not rows.size:
                return best, landed
            active, start = problem[rows], before[rows]
            length = share * longest
            if across:
                after, converged = active.step(start, np.full(rows.size, length))
            else:
                after, converged = _beyond(active, start, length)
            ahead_of_start = np.sum(active.weights * start.tangent * after.tangent, axis=1) > 0.0
            inside = (after.parameter >= problem.low) & (after.parameter <= problem.high)
            near = _distance(active, start, after) < 2.0 * longest
            accepted = converged & ahead_of_start & inside & near
            best = best.merged(rows[accepted], after[accepted])
            landed[rows[accepted]] = True
    return best, landed


def _meets(problem: ContinuationProblem, before: BranchPoints, over: BranchPoints) -> bool:
    """Whether the tangent at `over` (1,) leads back to the branch's end `before` (1,): a bend, no jump."""
    scale = np.sqrt(problem.weights[0])
    way = scale * problem.change(before.points.at, before.parameter, over.points.at, over.parameter)[0]
    tangent = scale * over.tangent[0]
    back = way @ tangent
    return bool(back > 0.0 and np.linalg.norm(way - back * tangent) < MISSED * np.linalg.norm(way))


def _last_before(problem: ContinuationProblem, before: BranchPoints, length: float) -> BranchPoints:
    """The last point (1,) of a branch before a bend of the map within a `length`, by bisection."""
    low, high, last = 0.0, 2.0 * length, before
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        near, converged = problem.step(before, np.array([middle]))
        is_before = converged[0] and near.tangent[0, -1] * before.tangent[0, -1] > 0.0
        low, high, last = (middle, high, near) if is_before else (low, middle, last)
    return last


def _beyond(
    problem: ContinuationProblem, before: BranchPoints, length: float
) -> tuple[BranchPoints, Converged]:
    """Fixed points by damped Newton steps where the parameter is a `length` ahead; which converged (n,)."""
    change = length * before.tangent
    parameter = before.parameter + change[:, -1]
    size = before.points.at.shape[1]
    starts = Points(before.points.at + change[:, :size], before.points.modes)
    fix, values = problem.fixed_values(), problem.values_at(parameter)
    fixed = newton(problem.mapping, starts, values, fix=fix, most=10)
    rows = np.flatnonzero(fixed.converged)
    if not rows.size:
        return before, fixed.converged
    sign = np.sign(before.tangent[rows, -1])
    branch_points = problem[rows].first(fixed.points[rows], fixed.drift[rows], parameter[rows], sign)
    return before.merged(rows, branch_points), fixed.converged


def _distance(problem: ContinuationProblem, a: BranchPoints, b: BranchPoints) -> PerBranch:
    """The weighted distance between branch points, (n,)."""
    change = problem.change(b.points.at, b.parameter, a.points.at, a.parameter)
    return np.sqrt(np.sum(problem.weights * change**2, axis=1))
