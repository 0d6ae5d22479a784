"""Fixed points of a map by Newton's method, for many starts at once.

If the map conserves a quantity, fixed points are not isolated: they form lines, on which Newton's equations
are singular. The quantity is then constrained to a value, and each constraint adds one unknown, the `drift`:
the change of the quantity over a cycle. The drift is zero where the quantity is conserved exactly, and it
measures the error where it is conserved only approximately (Munoz-Almaraz et al. 2003, Physica D 181).

The Jacobian of a map at its points is `Map.linearised(...).jacobian` (`engine/poincare/map_derivatives.py`).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Bool, Float, Int

from gaitsweep import near_miss
from gaitsweep.engine.poincare.maps import (
    Map,
    MapEvaluation,
    Points,
    Values,
    format_points,
    wrap_difference,
)
from gaitsweep.errors import ArgumentError
from gaitsweep.status import ResultCode

Unknowns = Float[np.ndarray, "points unknowns"]  # coordinates and drifts
Drifts = Float[np.ndarray, "points constrained"]
Searches = Int[np.ndarray, " searches"]  # numbers of searches
# Most halvings of a step that leaves the domain of the map, or multiplies the residual by `PATIENCE` or more,
# by default.
HALVINGS = 6
# Condition number of the scaled Jacobian from which Newton's equations count as singular.
SINGULAR = 1e11
# Factor by which an accepted step may raise the residual.
PATIENCE = 4.0


class NewtonOutcome(ResultCode):
    """Outcomes of the search for a fixed point, with a sentence each."""

    converged = 0, "A fixed point was found."
    not_converged = 1, "The search did not converge in the steps allowed."
    left = 2, "The search left the points whose trajectories return to the section."
    singular = 3, "Newton's equations are singular: constrain what the map conserves."


@dataclasses.dataclass(frozen=True)
class ConservedConstraints:
    """The conserved quantities that a search holds constant: their indices in the map, and values (n, k)."""

    which: tuple[int, ...]
    values: Drifts
    circular: Bool[np.ndarray, " constrained"]

    @classmethod
    def of(
        cls,
        mapping: Map,
        fix: Sequence[str] | Mapping[str, object],
        conserved: Float[np.ndarray, "points conserved"],
    ) -> ConservedConstraints:
        """Constrain the quantities named by `fix` to its values, or to those in `conserved`.

        Raises:
            ArgumentError: the map conserves no quantity of that name.
        """
        names = [quantity.name for quantity in mapping.conserved]
        for name in fix:
            if name not in names:
                raise ArgumentError(f"{name} is not conserved by this map{near_miss.suggestion(name, names)}")
        which = tuple(names.index(name) for name in fix)
        values = conserved[:, which].copy()
        if isinstance(fix, Mapping):
            for column, value in enumerate(fix.values()):
                if value is not None:
                    values[:, column] = np.asarray(value, np.float64)
        return cls(which, values, np.array([mapping.conserved[k].circular for k in which], bool))

    def __getitem__(
        self, rows: Bool[np.ndarray, " points"] | Int[np.ndarray, " chosen"]
    ) -> ConservedConstraints:
        return dataclasses.replace(self, values=self.values[rows])

    def residuals(self, conserved: Float[np.ndarray, "points conserved"]) -> Drifts:
        """The residuals of the constraints, (n, k)."""
        return wrap_difference(conserved[:, self.which] - self.values, self.circular)


@dataclasses.dataclass(frozen=True)
class FixedPoints:
    """The results of the searches from n starts.

    `points` the last points; `drift` (n, k) of the constrained quantities over a cycle; `residual` (n,) the
    largest relative residual of a coordinate, and its `tolerance`; `iterations` (n,); `outcome` (n,) a
    `NewtonOutcome`; `images` of the last points, with derivatives.
    """

    points: Points
    drift: Drifts
    residual: Float[np.ndarray, " points"]
    iterations: Int[np.ndarray, " points"]
    outcome: Int[np.ndarray, " points"]
    images: MapEvaluation
    tolerance: float

    @property
    def fixed(self) -> Bool[np.ndarray, " points"]:
        """Mask of the points that are fixed points to the tolerance, isolated or not, (n,)."""
        at_singular = (self.outcome == NewtonOutcome.singular) & (self.residual <= self.tolerance)
        return self.converged | at_singular

    @property
    def converged(self) -> Bool[np.ndarray, " points"]:
        """Mask of the searches that converged to an isolated fixed point, (n,)."""
        return self.outcome == NewtonOutcome.converged

    def __repr__(self) -> str:
        counts = zip(*np.unique(self.outcome, return_counts=True), strict=True)
        outcomes = ", ".join(f"{number} {NewtonOutcome(outcome).name}" for outcome, number in counts)
        return f"FixedPoints({outcomes}: {format_points(self.points.at[self.converged])})"


def residuals(
    mapping: Map, points: Points, drift: Drifts, images: MapEvaluation, constraints: ConservedConstraints
) -> Unknowns:
    """The residuals of Newton's equations, (n, size + k): zero at a fixed point.

    Args:
        mapping: the map.
        points: the points (n,).
        drift: the drifts (n, k) of the constrained quantities.
        images: the images of the points, with derivatives.
        constraints: those of conserved quantities.
    """
    moved = mapping.difference(images.points.at, points.at)
    spread = along(images.conserved_jacobian[:, constraints.which])
    return np.concatenate(
        [moved - np.einsum("nsk,nk->ns", spread, drift), constraints.residuals(images.conserved_values)],
        axis=1,
    )


def matrices(
    images: MapEvaluation, constraints: ConservedConstraints
) -> Float[np.ndarray, "points unknowns unknowns"]:
    """The Jacobians (n, size + k, size + k) of `residuals` over the coordinates and the drifts."""
    gradients = images.conserved_jacobian[:, constraints.which]
    n, size, _ = images.jacobian.shape
    k = gradients.shape[1]
    matrix = np.zeros((n, size + k, size + k))
    matrix[:, :size, :size] = images.jacobian - np.eye(size)
    matrix[:, :size, size:] = -along(gradients)
    matrix[:, size:, :size] = gradients
    return matrix


def along(
    gradients: Float[np.ndarray, "points constrained coordinates"],
) -> Float[np.ndarray, "points coordinates constrained"]:
    """Directions (n, size, k) that change one quantity by one and no other, from gradients (n, k, size).

    They are NaN where a gradient is not finite.
    """
    n, k, size = gradients.shape
    directions = np.full((n, size, k), np.nan)
    if k:
        finite = np.isfinite(gradients).all(axis=(1, 2))
        directions[finite] = np.linalg.pinv(gradients[finite])
    return directions


def newton(
    mapping: Map,
    starts: Points,
    values: Values,
    *,
    fix: Sequence[str] | Mapping[str, object] = (),
    tolerance: float = 1e-9,
    most: int = 20,
    halvings: int = HALVINGS,
) -> FixedPoints:
    """Find fixed points near n starts.

    Args:
        mapping: the map.
        starts: n points.
        values: parameters, numbers or one for each start (n,).
        fix: names of conserved quantities to constrain to their values at the start, or values by name.
        tolerance: relative tolerance on the residual.
        most: largest number of Newton steps.
        halvings: most halvings of a step that leaves the domain of the map or multiplies the residual by
            `PATIENCE`.

    Raises:
        ArgumentError: `fix` names a quantity that the map does not conserve.
    """
    # searches that leave every bound end as such
    with np.errstate(over="ignore", invalid="ignore"):
        search = _Search(mapping, starts, mapping.complete(values, len(starts)), fix, tolerance, halvings)
        for _ in range(most):
            rows = np.flatnonzero(search.outcome == NewtonOutcome.not_converged)
            if not rows.size:
                break
            search.step(rows)
        search.mark_singular()
    return FixedPoints(
        search.points,
        search.drift,
        search.residual,
        search.iterations,
        search.outcome,
        search.images,
        tolerance,
    )


class _Search:
    """The state of the searches from n starts."""

    def __init__(
        self,
        mapping: Map,
        starts: Points,
        values: dict[str, Float[np.ndarray, " points"]],
        fix: Sequence[str] | Mapping[str, object],
        tolerance: float,
        halvings: int,
    ) -> None:
        self.mapping, self.values, self.tolerance = mapping, values, tolerance
        self.halvings = halvings
        self.points, self.images = starts, mapping.linearised(starts, values)
        self.constraints = ConservedConstraints.of(mapping, fix, self.images.conserved_values)
        n = len(starts)
        self.drift, self.iterations = np.zeros((n, len(self.constraints.which))), np.zeros(n, int)
        miss = residuals(mapping, starts, self.drift, self.images, self.constraints)
        self.residual = norms(miss, scales(mapping, starts, self.images, self.constraints))
        self.outcome = np.where(self.images.sound, NewtonOutcome.not_converged, NewtonOutcome.left)
        self._mark_converged()

    def step(self, rows: Searches) -> None:
        """One Newton step of the searches `rows`, each shortened until it is accepted (`_accept`)."""
        self.iterations[rows] += 1
        step, _ = self._next_steps(rows)
        for halvings in range(self.halvings + 1):
            if not rows.size:
                break
            accepted = self._accept(rows, 0.5**halvings * step, last=halvings == self.halvings)
            rows, step = rows[~accepted], step[~accepted]
        self.outcome[rows] = NewtonOutcome.left
        self._mark_converged()

    def mark_singular(self) -> None:
        """Mark unconverged searches with singular equations, as near points fixed but for a drift."""
        rows = np.flatnonzero(self.outcome == NewtonOutcome.not_converged)
        self.outcome[rows[~self._regular(rows)]] = NewtonOutcome.singular

    def _mark_converged(self) -> None:
        """Mark searches at a fixed point as converged, or as singular where it is not isolated."""
        rows = np.flatnonzero(
            (self.outcome == NewtonOutcome.not_converged) & (self.residual <= self.tolerance)
        )
        self.outcome[rows] = np.where(self._regular(rows), NewtonOutcome.converged, NewtonOutcome.singular)

    def _regular(self, rows: Searches) -> Bool[np.ndarray, " searches"]:
        """Whether the equations of the searches `rows` are regular."""
        return self._next_steps(rows)[1] if rows.size else np.zeros(0, bool)

    def _next_steps(self, rows: Searches) -> tuple[Unknowns, Bool[np.ndarray, " searches"]]:
        """The next steps of the searches `rows`, and whether their equations are regular."""
        state = self.points[rows], self.drift[rows], self.images[rows], self.constraints[rows]
        return _steps(self.mapping, *state)

    def _accept(
        self, rows: Searches, step: Float[np.ndarray, "searches unknowns"], last: bool
    ) -> Bool[np.ndarray, " searches"]:
        """Take steps that multiply the residual by less than `PATIENCE`; the last where the map is defined.

        Returns:
            The mask of accepted steps.
        """
        trial, drift = _moved(self.mapping, self.points[rows], self.drift[rows], self.images[rows], step)
        values = {name: column[rows] for name, column in self.values.items()}
        images = self.mapping.images(trial, values)
        constraints = self.constraints[rows]
        miss = residuals(self.mapping, trial, drift, images, constraints)
        norm = norms(miss, scales(self.mapping, trial, images, constraints))
        accepted = images.sound & (last | (norm < PATIENCE * self.residual[rows]) | (norm <= self.tolerance))
        if accepted.any():
            advanced, trial = rows[accepted], trial[accepted]
            values = {name: column[accepted] for name, column in values.items()}
            images = self.mapping.linearised(trial, values)
            self.points = self.points.merged(advanced, trial)
            self.images = self.images.merged(advanced, images)
            self.drift[advanced], self.residual[advanced] = drift[accepted], norm[accepted]
        return accepted


def _steps(
    mapping: Map, points: Points, drift: Drifts, images: MapEvaluation, constraints: ConservedConstraints
) -> tuple[Unknowns, Bool[np.ndarray, " points"]]:
    """The next step (n, size + k), an iterate of the map where singular, and whether it is regular."""
    matrix, miss = matrices(images, constraints), residuals(mapping, points, drift, images, constraints)
    size, scale = points.at.shape[1], scales(mapping, points, images, constraints)
    scaled = matrix * scale[:, None, :] / scale[:, :, None]
    finite = np.all(np.isfinite(scaled), axis=(1, 2))
    solved = np.linalg.cond(np.where(finite[:, None, None], scaled, 0.0)) < SINGULAR
    step = np.zeros_like(miss)
    step[:, :size] = mapping.difference(images.points.at, points.at)
    step[solved] = np.linalg.solve(matrix[solved], -miss[solved, :, None])[:, :, 0]
    return step, solved


def _moved(
    mapping: Map, points: Points, drift: Drifts, images: MapEvaluation, step: Unknowns
) -> tuple[Points, Drifts]:
    """Points and drifts after a step; computed from the image, so that they have its discrete modes."""
    size = points.at.shape[1]
    back = mapping.difference(points.at, images.points.at)
    return Points(images.points.at + back + step[:, :size], images.points.modes), drift + step[:, size:]


def scales(
    mapping: Map, points: Points, images: MapEvaluation, constraints: ConservedConstraints
) -> Unknowns:
    """The scales (n, size + k) of coordinates, and those of constrained quantities, by their gradients."""
    of_coordinates = mapping.sizes(points.at)
    changes = images.conserved_jacobian[:, constraints.which] * of_coordinates[:, None]
    steepness = np.linalg.norm(changes, axis=2)
    return np.concatenate([of_coordinates, np.where(steepness > 0.0, steepness, 1.0)], axis=1)


def norms(miss: Unknowns, scale: Unknowns) -> Float[np.ndarray, " points"]:
    """The largest residual of each row relative to its scale, (n,); infinite where it is NaN."""
    with np.errstate(invalid="ignore"):
        return np.nan_to_num(np.max(np.abs(miss) / scale, axis=1), nan=np.inf)
