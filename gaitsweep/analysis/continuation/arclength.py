"""One step along many branches of fixed points at once: predict along the tangent, correct across it.

The unknowns of each branch are a point's coordinates, the drifts of what is held, and the parameter. A branch
is followed by its arclength, so that it goes around folds, where the parameter turns back (Keller 1977).
Coordinates count by their sizes at the branch's start, the parameter by the width of its range.

A derivative costs as much as the images of as many points as there are coordinates. So a step is corrected by
images: with the derivative where it began, brought up to date by what they tell (Broyden 1965, Math. Comp.
19:577); and it is differentiated once, where it ends.
"""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Sequence

import numpy as np

from gaitsweep.analysis.continuation.conserved_constraints import Conditions
from gaitsweep.analysis.continuation.newton import matrices, norms, residuals, sizes
from gaitsweep.engine.poincare.maps import Map, MapEvaluation, Points

# Corrections of one step, beyond which it is tried again with half its length.
MOST_CORRECTIONS = 12
# By how much a correction may raise what is left to correct before the step is given up.
PATIENCE = 5.0
# Of its size, by which a coordinate may not be fixed.
TOLERANCE = 1e-9


@dataclasses.dataclass(frozen=True)
class Places:
    """Where n branches are: points, drifts (n, k), the parameter (n,), and the unit tangents on which they go
    (n, size + k + 1); `images` with derivatives there; `corrections` (n,) that it took to get there."""

    points: Points
    drift: np.ndarray
    parameter: np.ndarray
    tangent: np.ndarray
    images: MapEvaluation
    corrections: np.ndarray

    def __getitem__(self, which: np.ndarray) -> Places:
        return Places(**{f.name: getattr(self, f.name)[which] for f in dataclasses.fields(self)})

    def merged(self, which: np.ndarray, others: Places) -> Places:
        """These places, with `others` where `which` says."""
        found = {}
        for field in dataclasses.fields(self):
            mine, theirs = getattr(self, field.name), getattr(others, field.name)
            if isinstance(mine, np.ndarray):
                mine = mine.copy()
                mine[which] = theirs
                found[field.name] = mine
            else:
                found[field.name] = mine.merged(which, theirs)
        return Places(**found)


@dataclasses.dataclass(frozen=True)
class Track:
    """What branches share: the map, the parameter and its range, the other values (n,) by name, what is held,
    and the `weights` (n, size + k + 1) by which changes count in a length."""

    mapping: Map
    parameter: str
    low: float
    high: float
    values: dict[str, np.ndarray]
    held: Conditions
    weights: np.ndarray

    @classmethod
    def of(
        cls,
        mapping: Map,
        parameter: str,
        within: Sequence[float],
        values: dict[str, np.ndarray],
        held: Conditions,
        at: np.ndarray,
    ) -> Track:
        """With the weights of branches that start at the coordinates `at` (n, size)."""
        low, high = float(min(within)), float(max(within))
        n, size = at.shape
        weights = np.zeros((n, size + len(held.which) + 1))
        weights[:, :size] = 1.0 / (sizes(at) ** 2 * size)
        weights[:, -1] = 1.0 / (high - low) ** 2
        return cls(mapping, parameter, low, high, values, held, weights)

    def __getitem__(self, which: np.ndarray) -> Track:
        values = {name: each[which] for name, each in self.values.items()}
        return dataclasses.replace(self, values=values, held=self.held[which], weights=self.weights[which])

    def evaluated(self, points: Points, parameter: np.ndarray) -> MapEvaluation:
        """The images with their derivatives, at these values (n,) of the parameter."""
        return self.mapping.linearised(points, {**self.values, self.parameter: parameter}, self.parameter)

    def tangents(self, images: MapEvaluation, before: np.ndarray) -> np.ndarray:
        """The unit tangents (n, m) of the branches, on the side of the tangents `before` (n, m)."""
        full = self._bordered(images, self.weights * before)
        last = np.zeros(full.shape[:2])
        last[:, -1] = 1.0
        tangent = _solved(full, last)
        return tangent / np.sqrt(np.sum(self.weights * tangent**2, axis=1))[:, None]

    def first(
        self, points: Points, drift: np.ndarray, parameter: np.ndarray, sign: np.ndarray | float
    ) -> Places:
        """Branches that start at fixed points, where the parameter rises (`sign` 1) or falls (-1)."""
        images = self.evaluated(points, parameter)
        towards = np.zeros_like(self.weights)
        towards[:, -1] = sign
        tangent = self.tangents(images, towards)
        return Places(points, drift, parameter, tangent, images, np.zeros(len(points), int))

    def step(self, places: Places, length: np.ndarray) -> tuple[Places, np.ndarray]:
        """Places a `length` (n,) farther on along their branches, and whether they were found (n,)."""
        goal = length[:, None] * places.tangent
        normal = self.weights * places.tangent
        return self._found(places, goal, normal, np.sum(normal * goal, axis=1))

    def at(self, places: Places, parameter: np.ndarray) -> tuple[Places, np.ndarray]:
        """Places of the branches near these where the parameter has a value (n,), and whether found (n,)."""
        share = (parameter - places.parameter) / places.tangent[:, -1]
        normal = np.zeros_like(self.weights)
        normal[:, -1] = 1.0
        return self._found(places, share[:, None] * places.tangent, normal, parameter - places.parameter)

    def _found(
        self, places: Places, guess: np.ndarray, normal: np.ndarray, goal: np.ndarray
    ) -> tuple[Places, np.ndarray]:
        """Places near `places` + `guess` (n, m) where normal . change = goal, and whether found (n,)."""
        points, change, count = self._corrected(places, guess, normal, goal)
        rows = np.flatnonzero(count)
        if not rows.size:
            return places, count > 0
        size = points.at.shape[1]
        track, before, change = self[rows], places[rows], change[rows]
        parameter, drift = before.parameter + change[:, -1], before.drift + change[:, size:-1]
        images = track.evaluated(points[rows], parameter)
        tangent = track.tangents(images, before.tangent)
        found = Places(points[rows], drift, parameter, tangent, images, count[rows])
        # where the map has no derivative a branch cannot go on, and others beside it can
        count[rows[~np.isfinite(tangent).all(axis=1)]] = 0
        on = np.flatnonzero(count[rows])
        return places.merged(rows[on], found[on]), count > 0

    def _corrected(
        self, places: Places, guess: np.ndarray, normal: np.ndarray, goal: np.ndarray
    ) -> tuple[Points, np.ndarray, np.ndarray]:
        """The points there, how far they are (n, m), and the corrections taken (n,), 0 if not found."""
        n, size = places.points.at.shape
        change, count, going = guess.copy(), np.zeros(n, int), np.ones(n, bool)
        points = Points(places.points.at + change[:, :size], places.points.modes)
        norm, step = np.full(n, np.inf), np.zeros_like(guess)
        matrix = self._bordered(places.images, normal)
        for taken in range(1, MOST_CORRECTIONS + 1):
            rows = np.flatnonzero(going)
            if not rows.size:
                break
            track, some = self[rows], points[rows]
            parameter = places.parameter[rows] + change[rows, -1]
            images = self.mapping.images(some, {**track.values, self.parameter: parameter})
            drift = places.drift[rows] + change[rows, size:-1]
            miss = residuals(self.mapping, some, drift, images, track.held)
            off = np.sum(normal[rows] * change[rows], axis=1) - goal[rows]
            now = norms(miss, some.at)
            good = images.sound & np.isfinite(now) & (now <= PATIENCE * norm[rows])
            fixed = good & (now <= TOLERANCE) & (np.abs(off) <= 1e-9)
            count[rows[fixed]], going[rows[fixed | ~good]] = taken, False
            norm[rows] = now
            rest = np.flatnonzero(good & ~fixed)
            if rest.size:
                mine, miss = rows[rest], np.concatenate([miss, off[:, None]], axis=1)[rest]
                if taken > 1:
                    matrix[mine] += _told(track[rest].weights, step[mine], miss)
                step[mine] = _solved(matrix[mine], -miss)
                change[mine] += step[mine]
                back = self.mapping.difference(some.at[rest], images.points.at[rest])
                moved = images.points.at[rest] + back + step[mine, :size]
                points = points.merged(mine, Points(moved, images.points[rest].modes))
        return points, change, count

    def _bordered(self, images: MapEvaluation, row: np.ndarray) -> np.ndarray:
        """The matrices (n, m, m) of Newton's equations over all unknowns, with a last `row` (n, m)."""
        inner = matrices(images, self.held)
        n, m, _ = inner.shape
        full = np.zeros((n, m + 1, m + 1))
        full[:, :m, :m] = inner
        full[:, : images.d_parameter.shape[1], m] = images.d_parameter
        full[:, images.d_parameter.shape[1] : m, m] = images.conserved_d_parameter[:, self.held.which]
        full[:, m] = row
        return full


def _solved(matrices: np.ndarray, right: np.ndarray) -> np.ndarray:
    """The solutions (n, m) of n systems, NaN of those that have none."""
    found = np.full_like(right, np.nan)
    for k in np.flatnonzero(np.all(np.isfinite(matrices), axis=(1, 2))):
        with contextlib.suppress(np.linalg.LinAlgError):
            found[k] = np.linalg.solve(matrices[k], right[k])
    return found


def _told(weights: np.ndarray, step: np.ndarray, miss: np.ndarray) -> np.ndarray:
    """What steps (n, m) that still miss by so much tell of their matrices, (n, m, m)."""
    row = np.where(weights > 0.0, weights, 1.0) * step
    row /= np.sum(row * step, axis=1)[:, None]
    return miss[:, :, None] * row[:, None, :]
