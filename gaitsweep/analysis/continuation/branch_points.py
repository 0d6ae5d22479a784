"""Branch points of a branch of fixed points: where two branches cross, and how.

Newton's equations are singular there in two directions. A branch point is therefore found as a regular
solution of a larger system, F + beta w = 0 with a Jacobian [F_x F_p] of rank m - 1 and left null vector w. If
beta is not zero, no branches cross there: they pass each other.

Source: Govaerts 2000, Numerical Methods for Bifurcations of Dynamical Equilibria, chapter 4 (the algebraic
branching equation of the two tangents).
"""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from gaitsweep.analysis.continuation.arclength_step import BranchPoints, ContinuationProblem
from gaitsweep.analysis.continuation.one_sided import (
    ALIKE,
    ALONG,
    Side,
    both_sides,
    crossing_tangents,
    multiplier_rate,
    singular_vectors,
)
from gaitsweep.engine.poincare.maps import Points

Vector = Float[np.ndarray, " unknowns"]  # the unknowns of one branch
Plane = Float[np.ndarray, "2 unknowns"]
# Kinds of branch points.
CROSSINGS = ("transcritical", "supercritical_pitchfork", "subcritical_pitchfork", "branch_point")
# Largest rate of the parameter along a branch, as a share of its range, at which a turn is smooth.
FLAT = 1e-3
# Tolerance of the search for a branch point, and its most steps.
TOLERANCE = 1e-8
MOST_STEPS = 12
# The largest scaled beta at which branches cross, that is a few residuals of Newton's method.
IMPERFECT = 1e-8
# Length of the first step along the branch that crosses.
ASIDE = 0.01
# Factors of longer steps along a branch whose turn is too wide to be seen after that one.
LONGER = (1.0, 3.0, 9.0, 27.0)
# Largest factor by which the turn may grow from one to the next: 9 for one of second order, 81 of fourth.
SECOND_ORDER = 27.0


@dataclasses.dataclass(frozen=True)
class Crossing:
    """A branch point on one branch.

    `kind` is transcritical, supercritical_pitchfork, subcritical_pitchfork, or branch_point where the
    quadratic and cubic terms do not tell; `point` (1,) has the tangent of the branch that came there; `aside`
    (k,) are points close by on the halves of branches that cross, each with the tangent away from there: two,
    or fewer where halves were not found.
    """

    kind: str
    point: BranchPoints
    aside: BranchPoints | None


def branch_point(problem: ContinuationProblem, near: BranchPoints) -> tuple[Crossing | None, float]:
    """The branch point near one point (1,) of a branch.

    The tangents t of both branches satisfy w' F_zz t t = 0 (z: coordinates, drifts, parameter), a quadratic
    form on the two null vectors of [F_x F_p].

    Returns:
        The branch point that was found, if any, and the scaled beta there.
    """
    solution = _solved(problem, near)
    if solution is None:
        return None, np.nan
    branching, z, beta = solution
    size, scale = near.points.at.shape[1], problem.scale()[0]
    unscaled = z * scale
    points, parameter = Points(unscaled[None, :size], near.points.modes), unscaled[-1:]
    images = problem.evaluated(points, parameter)
    at = dataclasses.replace(
        near, points=points, drift=unscaled[None, size:-1], parameter=parameter, images=images
    )
    passing = abs(beta) > IMPERFECT
    sides = [] if passing else both_sides(problem, at)
    tangents = crossing_tangents(branching.null, branching.bent)
    if tangents is None or not (passing or _is_smooth(sides)):
        return cornered(problem, at, sides), beta
    along = near.tangent[0] / scale
    ours = int(np.argmax(np.abs(tangents @ along)))
    at = _directed(at, tangents[ours] * np.sign(tangents[ours] @ along) * scale)
    aside = beside(problem, at, _both_ways(points, tangents[1 - ours] * scale))
    kind = _kind_of_smooth(problem, at, branching, tangents)
    return Crossing(kind, at, aside), beta


class _Solution(NamedTuple):
    """A branch point: its equations one step before it, its scaled unknowns (m + 1,), and beta."""

    branching: _Branching
    z: Vector
    beta: float


def _solved(problem: ContinuationProblem, near: BranchPoints) -> _Solution | None:
    """The branch point near one point (1,); None if Newton's method finds none."""
    z = np.concatenate([near.points.at[0], near.drift[0], near.parameter]) / problem.scale()[0]
    for _ in range(MOST_STEPS):
        branching = _Branching.at(problem, near, z)
        if branching is None:
            return None
        step, beta = branching.step()
        z = z + step
        length = np.max(np.abs(step))
        if not length < 1.0:
            return None
        if length < TOLERANCE:
            return _Solution(branching, z, beta)
    return None


def _kind_of_smooth(
    problem: ContinuationProblem, at: BranchPoints, branching: _Branching, tangents: Plane
) -> str:
    """The kind of a branch point `at` (1,) of a smooth map, from the tangents of both branches.

    At a pitchfork one branch turns to one side of the parameter, which may show only some way from there.
    """
    scale = problem.scale()[0]
    flat, through = sorted(tangents, key=lambda direction: abs(direction[-1]))
    if abs(flat[-1]) > FLAT:
        return "transcritical"
    rate = multiplier_rate(problem, at.points, branching.w, branching.null, branching.bent, through, flat)
    last_bend = 0.0
    for longer in LONGER:
        turning = beside(problem, at, _both_ways(at.points, flat * scale), longer * ASIDE)
        if turning is None or len(turning.parameter) != 2 or rate == 0.0:
            break
        # in the mean of both sides, what is left of the slope cancels
        bend = float(np.mean(turning.parameter) - at.parameter[0]) / (problem.high - problem.low)
        grows = bend * last_bend > 0.0 and abs(bend) < SECOND_ORDER * abs(last_bend)
        of_second_order = longer == LONGER[0] or grows
        if abs(bend) > FLAT * ASIDE**2 and of_second_order:
            return "supercritical_pitchfork" if bend * rate > 0.0 else "subcritical_pitchfork"
        last_bend = bend
    return "branch_point"


def cornered(problem: ContinuationProblem, at: BranchPoints, sides: list[Side]) -> Crossing | None:
    """The branch point `at` (1,) of a map that is smooth only on each side of a corner.

    One branch lies in the corner and goes through; of the other one there is a half on each side. None where
    neither side has a branch point there.

    Args:
        problem: the continuation problem, of one branch.
        at: the branch point.
        sides: the sides of the corner that have a branch point there, as `both_sides` returns them.
    """
    if not sides:
        return None
    scale = problem.scale()[0]
    along = at.tangent[0] / scale
    near = [n for n, side in enumerate(sides) if side.near] or [0]
    throughs = [side.tangents[np.argmax(np.abs(side.tangents @ along))] for side in sides]
    if len(sides) == 2:
        # the branch that lies in the corner is that which both sides have
        alike = _alike(sides)
        throughs = [side.tangents[k] for side, k in zip(sides, alike.closest, strict=True)]
        if not alike.pairs[alike.closest]:
            return Crossing("branch_point", _on_side(at, sides[near[0]]), None)
    halves = [side.half(through) for side, through in zip(sides, throughs, strict=True)]
    ways = [Way(side.points, half * scale) for side, half in zip(sides, halves, strict=True)]
    # where both sides have the coordinates of the point, the branch may have come along the half of one
    ours_side = min(near, key=lambda n: halves[n] @ along)
    side = sides[ours_side]
    at = _on_side(at, side)
    candidates = [throughs[ours_side], halves[ours_side]]
    ours = int(np.argmax(np.abs([candidate @ along for candidate in candidates])))
    if ours:
        # this branch ends in the corner, where the other half and both ways of the one through it begin
        through_corner = _both_ways(side.points, throughs[ours_side] * scale)
        ways = [*ways[:ours_side], *ways[ours_side + 1 :], *through_corner]
    at = _directed(at, candidates[ours] * np.sign(candidates[ours] @ along) * scale)
    aside = beside(problem, at, ways)
    return Crossing(_kind_of_halves(problem, sides, halves, throughs), at, aside)


def _on_side(at: BranchPoints, side: Side) -> BranchPoints:
    """The branch point with the derivatives of one side."""
    return dataclasses.replace(at, images=dataclasses.replace(at.images, jacobian=side.jacobian[None]))


def _kind_of_halves(
    problem: ContinuationProblem, sides: list[Side], halves: list[Vector], throughs: list[Vector]
) -> str:
    """The kind of a branch point by the halves of the second branch on both sides of a corner."""
    rates = [side.rate(problem, through) for side, through in zip(sides, throughs, strict=True)]
    turns = [half[-1] for half in halves]
    clear = min(np.abs([throughs[0][-1], *turns])) > FLAT and min(rates) * max(rates) > 0.0
    if len(sides) < 2 or not clear:
        return "branch_point"
    if turns[0] * turns[1] < 0.0:
        return "transcritical"
    return "supercritical_pitchfork" if turns[0] * rates[0] > 0.0 else "subcritical_pitchfork"


class _Alike(NamedTuple):
    """The pair of tangents of two sides that are closest, and the mask of the pairs that are equal."""

    closest: tuple[int, int]
    pairs: Bool[np.ndarray, "2 2"]


def _alike(sides: list[Side]) -> _Alike:
    """Compare the tangents of two sides."""
    first, last = sides if sides[0].near else sides[::-1]
    # where coordinates are the same on both sides, so are displacements
    pushed = first.tangents if last.near else first.tangents @ last.push.T
    pushed = pushed / np.linalg.norm(pushed, axis=1)[:, None]
    signs = np.sign(pushed @ last.tangents.T)
    apart = np.linalg.norm(pushed[:, None] * signs[:, :, None] - last.tangents, axis=2)
    apart = apart if first is sides[0] else apart.T
    i, k = divmod(int(np.argmin(apart)), 2)
    return _Alike((i, k), apart < ALIKE)


def _is_smooth(sides: list[Side]) -> bool:
    """Whether both sides have the same branches, at the same place."""
    if len(sides) < 2 or not all(side.near for side in sides):
        return False
    pairs = _alike(sides).pairs
    return bool(np.all(np.diag(pairs)) or np.all(np.diag(pairs[::-1])))


def _directed(at: BranchPoints, tangent: Vector) -> BranchPoints:
    """The branch point with this tangent."""
    return dataclasses.replace(at, tangent=tangent[None])


@dataclasses.dataclass(frozen=True)
class _Branching:
    """The equations of a branch point at scaled unknowns z (m + 1,), and their second derivatives.

    `miss` (m,) of F, `J` (m, m + 1); `w` (m,), `smallest`, `null` (2, m + 1), as of `singular_vectors`;
    `bent` (2, m + 1), w' J_z `null`.
    """

    miss: Float[np.ndarray, " equations"]
    J: Float[np.ndarray, "equations unknowns"]
    w: Float[np.ndarray, " equations"]
    smallest: float
    null: Float[np.ndarray, "2 unknowns"]
    bent: Float[np.ndarray, "2 unknowns"]

    @classmethod
    def at(cls, problem: ContinuationProblem, like: BranchPoints, z: Vector) -> _Branching | None:
        """The equations at z; None where the map has no derivatives."""
        miss, J = problem.scaled_equations(like.points, z[None])
        if not (np.isfinite(J).all() and np.isfinite(miss).all()):
            return None
        w, smallest, null = singular_vectors(J[0])
        around = z + ALONG * np.stack([null[0], -null[0], null[1], -null[1]])
        jacobians = problem.scaled_equations(like.points, around)[1]
        if not np.isfinite(jacobians).all():
            return None
        bent = w @ (jacobians[::2] - jacobians[1::2]) / (2.0 * ALONG)
        return cls(miss[0], J[0], w, smallest, null, bent)

    def step(self) -> tuple[Vector, float]:
        """Newton's step (m + 1,) and beta; infinite where the system is singular."""
        m = len(self.w)
        matrix = np.zeros((m + 2, m + 2))
        matrix[:m, :-1], matrix[:m, -1], matrix[m:, :-1] = self.J, self.w, self.bent
        try:
            solution = np.linalg.solve(matrix, -np.concatenate([self.miss, [self.smallest, 0.0]]))
        except np.linalg.LinAlgError:
            return np.full(m + 1, np.inf), np.nan
        return solution[:-1], float(solution[-1])


class Way(NamedTuple):
    """A branch that begins at a branch point: that point (1,), and the tangent (m,) away from it."""

    points: Points
    tangent: Vector


def _both_ways(points: Points, tangent: Vector) -> list[Way]:
    """The branches that begin along a tangent, and opposite to it."""
    return [Way(points, tangent), Way(points, -tangent)]


def beside(
    problem: ContinuationProblem, at: BranchPoints, ways: list[Way], length: float = ASIDE
) -> BranchPoints | None:
    """Points (k,) beside a branch point, one step of `length` ahead on the branches that begin there.

    The equations are singular at the branch point itself, so they are linearised where the step leads.

    Args:
        problem: the continuation problem.
        at: the branch point (1,).
        ways: the branches.
        length: the length of the step.

    Returns:
        The points that were found, or None.
    """
    first = np.zeros(len(ways), int)
    tangents = np.stack([way.tangent for way in ways])
    tangents /= np.sqrt(np.sum(problem.weights * tangents**2, axis=1))[:, None]
    change, size = length * tangents, at.points.at.shape[1]
    starts = Points.joined([way.points for way in ways])
    points = Points(starts.at + change[:, :size], starts.modes)
    parameter = at.parameter + change[:, -1]
    images = problem[first].evaluated(points, parameter)
    drift = at.drift + change[:, size:-1]
    guess = BranchPoints(points, drift, parameter, tangents, images, at.corrections[first])
    corrected, converged = problem[first].step(guess, np.zeros(len(ways)))
    return corrected[np.flatnonzero(converged)] if converged.any() else None
