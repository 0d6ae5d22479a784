"""Pseudo-arclength continuation: one step along many branches of fixed points at once.

A step predicts along the tangent and corrects normal to it. The unknowns of each branch are a point's
coordinates, the drifts of the constrained quantities, and the parameter. A branch is parametrised by its
arclength, so that it can go around folds, where the parameter turns back. In a length,
coordinates are scaled by their magnitudes at the branch's start, the parameter by the width of its range.

A derivative costs as much as the images of as many points as there are coordinates. So the corrector uses
the derivative from the start of the step with Broyden updates (Broyden 1965, Math. Comp. 19:577), and the map
is differentiated once, at the end of the step.

Source: H. B. Keller, "Numerical solution of bifurcation and nonlinear eigenvalue problems", in Applications
of Bifurcation Theory (1977), 359-384.
"""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Sequence

import jax
import numpy as np
from jaxtyping import Bool, Float, Int

from gaitsweep.analysis.continuation.newton import ConservedConstraints, matrices, norms, residuals, scales
from gaitsweep.engine.poincare.maps import Batch, Map, MapEvaluation, Points

PerBranch = Float[np.ndarray, " branches"]  # a number for each branch
Unknowns = Float[np.ndarray, "branches unknowns"]  # coordinates, drifts and the parameter
Converged = Bool[np.ndarray, " branches"]
# Most corrections of one step; a step that needs more is tried again with half its length.
MOST_CORRECTIONS = 12
# Factor by which a correction may raise the residual before the step is given up.
PATIENCE = 5.0
# Relative tolerance on the residual.
TOLERANCE = 1e-9


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class BranchPoints(Batch):
    """One point on each of n branches of fixed points.

    Attributes:
        points: the fixed points.
        drift: the drifts of the constrained quantities, (n, k).
        parameter: the continuation parameter, (n,).
        tangent: the unit tangents of the branches, (n, size + k + 1).
        images: the images of the points, with derivatives.
        corrections: the number of corrections of the step that led there, (n,).
    """

    points: Points
    drift: Float[np.ndarray, "branches constrained"]
    parameter: PerBranch
    tangent: Unknowns
    images: MapEvaluation
    corrections: Int[np.ndarray, " branches"]


@dataclasses.dataclass(frozen=True)
class ContinuationProblem:
    """The equations of n branches of fixed points, and the norm of their steps.

    Attributes:
        mapping: the map.
        parameter, low, high: the continuation parameter and its range.
        values: the other parameters, (n,) by name.
        constraints: those of conserved quantities.
        weights: the weights of the unknowns in the norm of a step, (n, size + k + 1); those of drifts are 0.
        scales: the scales of the coordinates and of the constrained quantities at the start, (n, size + k).
    """

    mapping: Map
    parameter: str
    low: float
    high: float
    values: dict[str, PerBranch]
    constraints: ConservedConstraints
    weights: Unknowns
    scales: Float[np.ndarray, "branches equations"]

    @classmethod
    def of(
        cls,
        mapping: Map,
        parameter: str,
        within: Sequence[float],
        values: dict[str, PerBranch],
        constraints: ConservedConstraints,
        points: Points,
        images: MapEvaluation,
    ) -> ContinuationProblem:
        """The problem with the weights of branches that start at some points (n,) with their images."""
        low, high = float(min(within)), float(max(within))
        size, of_start = points.at.shape[1], scales(mapping, points, images, constraints)
        weights = np.zeros((len(points), of_start.shape[1] + 1))
        weights[:, :size] = 1.0 / (of_start[:, :size] ** 2 * size)
        weights[:, -1] = 1.0 / (high - low) ** 2
        return cls(mapping, parameter, low, high, values, constraints, weights, of_start)

    def __getitem__(
        self, which: Bool[np.ndarray, " rows"] | Int[np.ndarray, " chosen"]
    ) -> ContinuationProblem:
        values = {name: column[which] for name, column in self.values.items()}
        return dataclasses.replace(
            self,
            values=values,
            constraints=self.constraints[which],
            weights=self.weights[which],
            scales=self.scales[which],
        )

    @classmethod
    def joined(cls, problems: Sequence[ContinuationProblem]) -> ContinuationProblem:
        """The problem of the branches of several problems, one after the other, with the map of the first."""
        first = problems[0]
        constrained = [problem.constraints.values for problem in problems]
        return dataclasses.replace(
            first,
            values={name: np.concatenate([p.values[name] for p in problems]) for name in first.values},
            constraints=dataclasses.replace(first.constraints, values=np.concatenate(constrained)),
            weights=np.concatenate([problem.weights for problem in problems]),
            scales=np.concatenate([problem.scales for problem in problems]),
        )

    def values_at(self, parameter: PerBranch) -> dict[str, PerBranch]:
        """All parameters (n,) by name, at these values (n,) of the continuation parameter."""
        return {**self.values, self.parameter: parameter}

    def change(
        self,
        begin: Float[np.ndarray, "changes coordinates"],
        begin_parameter: PerBranch,
        end: Float[np.ndarray, "*changes coordinates"],
        end_parameter: PerBranch | float,
    ) -> Float[np.ndarray, "changes unknowns"]:
        """The changes (n, m) of the unknowns between coordinates and parameters; those of drifts are 0."""
        change = np.zeros((len(begin), self.weights.shape[1]))
        change[:, : begin.shape[1]] = self.mapping.difference(end, begin)
        change[:, -1] = end_parameter - begin_parameter
        return change

    def fixed_values(self) -> dict[str, PerBranch]:
        """The values (n,) of the constrained quantities by name, as `newton` takes them."""
        names = [self.mapping.conserved[k].name for k in self.constraints.which]
        return dict(zip(names, self.constraints.values.T, strict=True))

    def evaluated(self, points: Points, parameter: PerBranch) -> MapEvaluation:
        """The images with their derivatives at these values (n,) of the parameter."""
        return self.mapping.linearised(points, self.values_at(parameter), self.parameter)

    def tangents(self, images: MapEvaluation, before: Unknowns) -> Unknowns:
        """The unit tangents (n, m) of the branches, oriented along the tangents `before` (n, m)."""
        full = self.bordered(images, self.weights * before)
        last = np.zeros(full.shape[:2])
        last[:, -1] = 1.0
        tangent = _solved(full, last)
        return tangent / np.sqrt(np.sum(self.weights * tangent**2, axis=1))[:, None]

    def first(
        self,
        points: Points,
        drift: Float[np.ndarray, "branches constrained"],
        parameter: PerBranch,
        sign: PerBranch | float,
    ) -> BranchPoints:
        """Branches from fixed points, along which the parameter first rises (`sign` 1) or falls (-1)."""
        images = self.evaluated(points, parameter)
        towards = np.zeros_like(self.weights)
        towards[:, -1] = sign
        tangent = self.tangents(images, towards)
        return BranchPoints(points, drift, parameter, tangent, images, np.zeros(len(points), int))

    def step(self, branch_points: BranchPoints, length: PerBranch) -> tuple[BranchPoints, Converged]:
        """The branch points one arclength step of `length` (n,) ahead, and whether each converged (n,)."""
        goal = length[:, None] * branch_points.tangent
        normal = self.weights * branch_points.tangent
        return self._solve(branch_points, goal, normal, np.sum(normal * goal, axis=1))

    def at(self, branch_points: BranchPoints, parameter: PerBranch) -> tuple[BranchPoints, Converged]:
        """The branch points near these at a value (n,) of the parameter, and whether each converged (n,)."""
        share = (parameter - branch_points.parameter) / branch_points.tangent[:, -1]
        normal = np.zeros_like(self.weights)
        normal[:, -1] = 1.0
        after, converged = self._solve(
            branch_points, share[:, None] * branch_points.tangent, normal, parameter - branch_points.parameter
        )
        # the sum of the former value and the change may be another number, by rounding
        exactly = np.where(converged, parameter, after.parameter)
        return dataclasses.replace(after, parameter=exactly), converged

    def _solve(
        self, branch_points: BranchPoints, guess: Unknowns, normal: Unknowns, goal: PerBranch
    ) -> tuple[BranchPoints, Converged]:
        """Branch points near these + `guess` (n, m) with normal . change = goal; which converged (n,)."""
        points, change, count = self._correct(branch_points, guess, normal, goal)
        rows = np.flatnonzero(count)
        if not rows.size:
            return branch_points, count > 0
        size = points.at.shape[1]
        problem, before, change = self[rows], branch_points[rows], change[rows]
        parameter, drift = before.parameter + change[:, -1], before.drift + change[:, size:-1]
        images = problem.evaluated(points[rows], parameter)
        tangent = problem.tangents(images, before.tangent)
        followed = BranchPoints(points[rows], drift, parameter, tangent, images, count[rows])
        # a branch cannot continue where the map has no derivative; the other branches can
        count[rows[~np.isfinite(tangent).all(axis=1)]] = 0
        converged = np.flatnonzero(count[rows])
        return branch_points.merged(rows[converged], followed[converged]), count > 0

    def _correct(
        self, branch_points: BranchPoints, guess: Unknowns, normal: Unknowns, goal: PerBranch
    ) -> tuple[Points, Unknowns, Int[np.ndarray, " branches"]]:
        """Correct the guesses by Newton steps with one Jacobian and Broyden's updates of it.

        Returns:
            The corrected points, their changes (n, m), and the number of corrections (n,), 0 if lost.
        """
        n, size = branch_points.points.at.shape
        change = guess.copy()
        count = np.zeros(n, int)
        corrects = np.ones(n, bool)
        points = Points(branch_points.points.at + change[:, :size], branch_points.points.modes)
        last_norm, step = np.full(n, np.inf), np.zeros_like(guess)
        matrix = self.bordered(branch_points.images, normal)
        for number in range(1, MOST_CORRECTIONS + 1):
            rows = np.flatnonzero(corrects)
            if not rows.size:
                break
            problem, trial = self[rows], points[rows]
            parameter = branch_points.parameter[rows] + change[rows, -1]
            images = self.mapping.images(trial, problem.values_at(parameter))
            drift = branch_points.drift[rows] + change[rows, size:-1]
            miss = residuals(self.mapping, trial, drift, images, problem.constraints)
            beside = np.sum(normal[rows] * change[rows], axis=1) - goal[rows]
            norm = norms(miss, scales(self.mapping, trial, images, problem.constraints))
            sound = images.sound & np.isfinite(norm) & (norm <= PATIENCE * last_norm[rows])
            converged = sound & (norm <= TOLERANCE) & (np.abs(beside) <= 1e-9)
            count[rows[converged]] = number
            corrects[rows[converged | ~sound]] = False
            last_norm[rows] = norm
            goes_on = np.flatnonzero(sound & ~converged)
            if goes_on.size:
                active = rows[goes_on]
                miss = np.concatenate([miss, beside[:, None]], axis=1)[goes_on]
                if number > 1:
                    matrix[active] += _broyden_update(problem[goes_on]._squares(), step[active], miss)
                step[active] = _solved(matrix[active], -miss)
                change[active] += step[active]
                # computed from the image, so that the next points have its discrete modes
                back = self.mapping.difference(trial.at[goes_on], images.points.at[goes_on])
                moved = images.points.at[goes_on] + back + step[active, :size]
                points = points.merged(active, Points(moved, images.points[goes_on].modes))
        return points, change, count

    def scale(self) -> Unknowns:
        """The scales (n, m) of the unknowns, in which a length is the norm of a step."""
        return self._squares() ** -0.5

    def _squares(self) -> Unknowns:
        """The squares (n, m) of the inverse scales of the unknowns: the weights, and those of drifts."""
        squares = self.weights.copy()
        squares[:, self._drifts] = self.scales[:, self._drifts] ** -2
        return squares

    @property
    def _drifts(self) -> slice:
        """The places of the drifts among the unknowns."""
        k = len(self.constraints.which)
        return slice(self.scales.shape[1] - k, self.scales.shape[1])

    def scaled_equations(
        self, like: Points, unknowns: Unknowns
    ) -> tuple[Float[np.ndarray, "several equations"], Float[np.ndarray, "several equations unknowns"]]:
        """Newton's equations of one branch at scaled `unknowns` (n, m), with the modes of `like` (1,).

        Returns:
            Scaled residuals (n, m - 1), NaN where the map is undefined, and their Jacobians (n, m - 1, m).
        """
        scale, size, row_scale = self.scale()[0], like.at.shape[1], self.scales[0].copy()
        row_scale[:size] = self.mapping.sizes(like.at)[0]
        same_branch = np.zeros(len(unknowns), int)
        problem, unscaled = self[same_branch], unknowns * scale
        points = Points(unscaled[:, :size], like[same_branch].modes)
        images = problem.evaluated(points, unscaled[:, -1])
        miss = residuals(self.mapping, points, unscaled[:, size:-1], images, problem.constraints) / row_scale
        miss[~images.sound] = np.nan
        return miss, problem.bordered(images, unscaled)[:, :-1] * scale / row_scale[:, None]

    def bordered(
        self, images: MapEvaluation, row: Unknowns
    ) -> Float[np.ndarray, "branches unknowns unknowns"]:
        """The Jacobians (n, m, m) of Newton's equations, bordered by a last `row` (n, m)."""
        inner = matrices(images, self.constraints)
        n, m, _ = inner.shape
        full = np.zeros((n, m + 1, m + 1))
        full[:, :m, :m] = inner
        full[:, : images.d_parameter.shape[1], m] = images.d_parameter
        full[:, images.d_parameter.shape[1] : m, m] = images.conserved_d_parameter[:, self.constraints.which]
        full[:, m] = row
        return full


def _solved(
    matrices: Float[np.ndarray, "systems unknowns unknowns"], right: Float[np.ndarray, "systems unknowns"]
) -> Float[np.ndarray, "systems unknowns"]:
    """The solutions (n, m) of n linear systems; NaN where a matrix is singular or not finite."""
    solutions = np.full_like(right, np.nan)
    finite = np.flatnonzero(np.all(np.isfinite(matrices), axis=(1, 2)))
    try:
        solutions[finite] = np.linalg.solve(matrices[finite], right[finite, :, None])[:, :, 0]
    except np.linalg.LinAlgError:  # one of them is singular
        for k in finite:
            with contextlib.suppress(np.linalg.LinAlgError):
                solutions[k] = np.linalg.solve(matrices[k], right[k])
    return solutions


def _broyden_update(
    squares: Unknowns, step: Unknowns, miss: Unknowns
) -> Float[np.ndarray, "branches unknowns unknowns"]:
    """Broyden's rank-one update (n, m, m) of Jacobians, from steps (n, m) and the residuals after them.

    `squares` (n, m) are those of the inverse scales of the unknowns.
    """
    row = squares * step
    row /= np.sum(row * step, axis=1)[:, None]
    return miss[:, :, None] * row[:, None, :]
