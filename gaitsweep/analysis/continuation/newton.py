"""Fixed points of a map by Newton's method, for many starts at once, stable and unstable ones alike.

Where the map conserves something, fixed points are not alone: they form lines, on which Newton's equations
have no one solution. Then what is conserved is held at a value, and for each such condition there is an
unknown more, the `drift`: how much of it a cycle adds. It is zero where the quantity is conserved exactly,
and measures by how much it is not where that is only nearly so (Munoz-Almaraz et al. 2003, Physica D 181).
"""

from __future__ import annotations

import dataclasses
import enum
from collections.abc import Mapping, Sequence
from typing import Self

import numpy as np

from gaitsweep.analysis.continuation.conserved_constraints import Conditions
from gaitsweep.engine.poincare.maps import Map, MapEvaluation, Points, Values

# Halvings of a step that leads to where the map is not defined, or the residual larger.
HALVINGS = 6
# Condition of Newton's equations, coordinates in proportion to their sizes, from which they are singular.
SINGULAR = 1e11
# By how much a step may raise the residual and still be taken.
PATIENCE = 4.0
# Numbers count in proportion to their size, but not below this (in their unit).
FLOOR = 0.1


class Outcome(enum.IntEnum):
    """How a search for a fixed point ended, with a sentence each."""

    converged = 0, "A fixed point was found."
    not_converged = 1, "The steps allowed were not enough."
    left = 2, "The search left the points whose trajectories come back to the section."
    singular = 3, "The equations have no one solution: hold what the map conserves."

    sentence: str

    def __new__(cls, number: int, sentence: str) -> Self:
        outcome = int.__new__(cls, number)
        outcome._value_, outcome.sentence = number, sentence
        return outcome


@dataclasses.dataclass(frozen=True)
class FixedPoints:
    """What a search gave for each start (n,).

    `points` where it ended; `drift` (n, k) per map of what is held; `residual` (n,) the largest share, of its
    size, by which a coordinate is not fixed; `iterations` (n,); `outcome` (n,) an `Outcome`; `images` with
    derivatives there.
    """

    points: Points
    drift: np.ndarray
    residual: np.ndarray
    iterations: np.ndarray
    outcome: np.ndarray
    images: MapEvaluation

    @property
    def converged(self) -> np.ndarray:
        """Which searches found a fixed point, (n,)."""
        return self.outcome == Outcome.converged


def sizes(at: np.ndarray) -> np.ndarray:
    """The size by which each coordinate (n, size) counts."""
    return FLOOR + np.abs(at)


def residuals(
    mapping: Map, points: Points, drift: np.ndarray, images: MapEvaluation, held: Conditions
) -> np.ndarray:
    """Newton's equations at these points, (n, size + k): zero at a fixed point."""
    moved = mapping.difference(images.points.at, points.at)
    spread = along(images.conserved_jacobian[:, held.which])
    return np.concatenate(
        [moved - np.einsum("nsk,nk->ns", spread, drift), held.missed(images.conserved_values)], axis=1
    )


def matrices(images: MapEvaluation, held: Conditions) -> np.ndarray:
    """The derivative (n, size + k, size + k) of `residuals` over the coordinates and the drifts."""
    gradients = images.conserved_jacobian[:, held.which]
    n, size, _ = images.jacobian.shape
    k = gradients.shape[1]
    matrix = np.zeros((n, size + k, size + k))
    matrix[:, :size, :size] = images.jacobian - np.eye(size)
    matrix[:, :size, size:] = -along(gradients)
    matrix[:, size:, :size] = gradients
    return matrix


def along(gradients: np.ndarray) -> np.ndarray:
    """Directions (n, size, k) that add one to each quantity and nothing to the others, from (n, k, size)."""
    if not gradients.shape[1]:
        return np.swapaxes(gradients, 1, 2)
    return np.linalg.pinv(gradients)


def newton(
    mapping: Map,
    starts: Points,
    values: Values,
    *,
    fix: Sequence[str] | Mapping[str, object] = (),
    tolerance: float = 1e-9,
    most: int = 20,
) -> FixedPoints:
    """Fixed points near many starts.

    Args:
        mapping: the map.
        starts: n points.
        values: parameters, numbers or one for each start (n,).
        fix: names of conserved quantities to hold as they are at the start, or at values given by name.
        tolerance: residual at which a point counts as fixed, as a share of each coordinate's size.
        most: Newton steps.

    Raises:
        ValueError: `fix` names what the map does not conserve.
    """
    search = _Search(mapping, starts, mapping.complete(values, len(starts)), fix, tolerance)
    for _ in range(most):
        rows = np.flatnonzero(search.outcome == Outcome.not_converged)
        if not rows.size:
            break
        search.step(rows)
    search.give_up()
    return FixedPoints(
        search.points, search.drift, search.residual, search.iterations, search.outcome, search.images
    )


class _Search:
    """Where the searches of n starts are."""

    def __init__(
        self,
        mapping: Map,
        starts: Points,
        values: dict[str, np.ndarray],
        fix: Sequence[str] | Mapping[str, object],
        tolerance: float,
    ) -> None:
        self.mapping, self.values, self.tolerance = mapping, values, tolerance
        self.points, self.images = starts, mapping.linearised(starts, values)
        self.held = Conditions.of(mapping, fix, self.images.conserved_values)
        n = len(starts)
        self.drift, self.iterations = np.zeros((n, len(self.held.which))), np.zeros(n, int)
        self.residual = norms(residuals(mapping, starts, self.drift, self.images, self.held), starts.at)
        self.outcome = np.where(self.images.sound, Outcome.not_converged, Outcome.left)
        self._found()

    def step(self, rows: np.ndarray) -> None:
        """One step of the searches `rows`, each shortened until the map is defined where it leads."""
        self.iterations[rows] += 1
        step, _ = _steps(
            self.mapping, self.points[rows], self.drift[rows], self.images[rows], self.held[rows]
        )
        for halvings in range(HALVINGS + 1):
            if not rows.size:
                break
            taken = self._tried(rows, 0.5**halvings * step, last=halvings == HALVINGS)
            rows, step = rows[~taken], step[~taken]
        self.outcome[rows] = Outcome.left
        self._found()

    def give_up(self) -> None:
        """Tell which searches, of those that found nothing, have equations without one solution.

        So it is near a line of points that are fixed but for a drift above the tolerance.
        """
        rows = np.flatnonzero(self.outcome == Outcome.not_converged)
        self.outcome[rows[~self._alone(rows)]] = Outcome.singular

    def _found(self) -> None:
        """Tell which searches are at a fixed point, and at one that stands alone."""
        rows = np.flatnonzero((self.outcome == Outcome.not_converged) & (self.residual <= self.tolerance))
        self.outcome[rows] = np.where(self._alone(rows), Outcome.converged, Outcome.singular)

    def _alone(self, rows: np.ndarray) -> np.ndarray:
        """Where the equations have one solution, for the searches `rows`."""
        if not rows.size:
            return np.zeros(0, bool)
        return _steps(self.mapping, self.points[rows], self.drift[rows], self.images[rows], self.held[rows])[
            1
        ]

    def _tried(self, rows: np.ndarray, step: np.ndarray, last: bool) -> np.ndarray:
        """Which of these steps are taken: those that lead to a smaller residual; the last wherever it can.

        Images decide: a derivative costs as much as the images of as many points as there are coordinates.
        """
        trial, drift = _moved(self.mapping, self.points[rows], self.drift[rows], self.images[rows], step)
        values = {name: each[rows] for name, each in self.values.items()}
        images = self.mapping.images(trial, values)
        norm = norms(residuals(self.mapping, trial, drift, images, self.held[rows]), trial.at)
        taken = images.sound & (last | (norm < PATIENCE * self.residual[rows]) | (norm <= self.tolerance))
        kept = np.flatnonzero(taken)
        if kept.size:
            done, trial = rows[kept], trial[kept]
            images = self.mapping.linearised(trial, {name: each[kept] for name, each in values.items()})
            self.points, self.images = self.points.merged(done, trial), self.images.merged(done, images)
            self.drift[done], self.residual[done] = drift[kept], norm[kept]
        return taken


def _steps(
    mapping: Map, points: Points, drift: np.ndarray, images: MapEvaluation, held: Conditions
) -> tuple[np.ndarray, np.ndarray]:
    """The next step (n, size + k) of each search, and whether its equations have one solution.

    Where they have not, which also happens far from any fixed point, the step is a cycle of the map.
    """
    matrix, miss = matrices(images, held), residuals(mapping, points, drift, images, held)
    size = points.at.shape[1]
    scale = np.ones_like(miss)
    scale[:, :size] = sizes(points.at)
    scaled = matrix * scale[:, None, :] / scale[:, :, None]
    finite = np.all(np.isfinite(scaled), axis=(1, 2))
    solved = np.linalg.cond(np.where(finite[:, None, None], scaled, 0.0)) < SINGULAR
    step = np.zeros_like(miss)
    step[:, :size] = mapping.difference(images.points.at, points.at)
    step[solved] = np.linalg.solve(matrix[solved], -miss[solved, :, None])[:, :, 0]
    return step, solved


def _moved(
    mapping: Map, points: Points, drift: np.ndarray, images: MapEvaluation, step: np.ndarray
) -> tuple[Points, np.ndarray]:
    """Points and drifts a step on; near the image, so that they have the modes that it has."""
    size = points.at.shape[1]
    back = mapping.difference(points.at, images.points.at)
    return Points(images.points.at + back + step[:, :size], images.points.modes), drift + step[:, size:]


def norms(miss: np.ndarray, at: np.ndarray) -> np.ndarray:
    """The largest share, of its size, by which a coordinate is not fixed, (n,); infinite where it is NaN."""
    scale = np.ones_like(miss)
    scale[:, : at.shape[1]] = sizes(at)
    with np.errstate(invalid="ignore"):
        return np.nan_to_num(np.max(np.abs(miss) / scale, axis=1), nan=np.inf)
