"""Test functions of bifurcations along a branch: folds, flips, and other crossings of the unit circle."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from gaitsweep.analysis.continuation.arclength import BranchPoints, ContinuationProblem
from gaitsweep.analysis.continuation.floquet import multipliers

# A zero is found when the test function is below this share of its larger value at the step's ends.
NEAR = 1e-7
# The search also ends with an interval this short, as a share of the step: where the map has a corner, the
# test function jumps over zero.
SHORTEST_INTERVAL = 1e-6
MOST_TRIALS = 40
# Largest rate of the parameter along a branch, as a share of its range, at which a turn is a smooth fold.
FLAT = 1e-3
# A multiplier is real if its imaginary part is below this share of its modulus.
REAL = 1e-6

Test = Callable[[ContinuationProblem, BranchPoints], np.ndarray]


def multipliers_of(problem: ContinuationProblem, branch_points: BranchPoints) -> np.ndarray:
    """The Floquet multipliers (n, size - k), without those of the constrained conserved quantities."""
    return multipliers(
        branch_points.images.jacobian, branch_points.images.conserved_jacobian[:, problem.held.which]
    )


def fold_test(problem: ContinuationProblem, branch_points: BranchPoints) -> np.ndarray:
    """The derivative of the parameter over arclength, (n,): zero at a fold."""
    return branch_points.tangent[:, -1]


def unit_circle_test(problem: ContinuationProblem, branch_points: BranchPoints) -> np.ndarray:
    """The modulus less one of the multiplier nearest to the unit circle, (n,): zero at a crossing."""
    outside = np.abs(multipliers_of(problem, branch_points)) - 1.0
    nearest = np.argmin(np.abs(outside), axis=1)
    return outside[np.arange(len(outside)), nearest]


def changes(before: np.ndarray, after: np.ndarray, turned: np.ndarray) -> np.ndarray:
    """The bifurcation on a step of each branch: "fold", "crossing" (of the unit circle), or "".

    Args:
        before, after: multipliers at the step's ends, (n, m).
        turned: whether the parameter turned back, (n,).
    """
    count = [np.sum(np.abs(each) > 1.0, axis=1) for each in (before, after)]
    return np.where(turned, "fold", np.where(count[0] != count[1], "crossing", ""))


def located(
    problem: ContinuationProblem,
    before: BranchPoints,
    length: np.ndarray,
    test: Test,
    ends: tuple[np.ndarray, np.ndarray],
) -> tuple[BranchPoints, np.ndarray]:
    """The zero of a test function on a step of each branch, and its arclength (n,); NaN where not found.

    Args:
        problem, before, length: the branches, where their steps begin, and the steps' lengths (n,).
        test: the test function, with its values at both `ends` of the steps, (n,) each.

    Source: the Illinois variant of regula falsi.
    """
    low, high = np.zeros_like(length), length.copy()
    below, above = (each.copy() for each in ends)
    target = NEAR * np.maximum(np.abs(below), np.abs(above))
    best, where = before, np.full(len(length), np.nan)
    going = below * above < 0.0
    for _ in range(MOST_TRIALS):
        rows = np.flatnonzero(going)
        if not rows.size:
            break
        at = low[rows] + (high[rows] - low[rows]) * below[rows] / (below[rows] - above[rows])
        branch_points, found = problem[rows].step(before[rows], at)
        value = np.where(found, test(problem[rows], branch_points), np.nan)
        best = best.merged(rows[found], branch_points[found])
        where[rows[found]] = at[found]
        same = value * below[rows] > 0.0
        # Illinois: the value at the end that stays is halved
        low[rows[same]], below[rows[same]] = at[same], value[same]
        above[rows[same]] *= 0.5
        other = ~same & found
        high[rows[other]], above[rows[other]] = at[other], value[other]
        below[rows[other]] *= 0.5
        short = high[rows] - low[rows] < SHORTEST_INTERVAL * length[rows]
        going[rows] = found & (np.abs(value) > target[rows]) & ~short
    return best, where


def classify_turns(problem: ContinuationProblem, branch_points: BranchPoints) -> list[str]:
    """The kind of each turn of the parameter: "fold" where smooth, "corner" where the map has a kink."""
    smooth = np.abs(fold_test(problem, branch_points)) < FLAT * (problem.high - problem.low)
    return np.where(smooth, "fold", "corner").tolist()


def classify(problem: ContinuationProblem, branch_points: BranchPoints) -> list[str]:
    """The kind of each crossing of the unit circle: neimark_sacker, flip or branch_point."""
    found = multipliers_of(problem, branch_points)
    names = []
    for each in found:
        nearest = each[np.argmin(np.abs(np.abs(each) - 1.0))]
        if abs(nearest.imag) > REAL * abs(nearest):
            names.append("neimark_sacker")
        else:
            names.append("flip" if nearest.real < 0.0 else "branch_point")
    return names
