"""One step along many branches of fixed points at once: predict along the tangent, correct across it.

The unknowns of each branch are a point's coordinates, the drifts of what is held, and the parameter. A branch
is followed by its arclength, so that it goes around folds, where the parameter turns back (Keller 1977).
Coordinates count by their sizes at the branch's start, the parameter by the width of its range.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from gaitsweep.analysis.newton import Conditions, matrices, residuals, sizes
from gaitsweep.engine.maps import Images, Map, Points

# Corrections of one step, beyond which it is tried again with half its length.
MOST_CORRECTIONS = 8
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
    images: Images
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

    def evaluated(self, points: Points, parameter: np.ndarray) -> Images:
        """The images with their derivatives, at these values (n,) of the parameter."""
        return self.mapping.linearised(points, {**self.values, self.parameter: parameter}, self.parameter)

    def tangents(self, images: Images, before: np.ndarray) -> np.ndarray:
        """The unit tangents (n, m) of the branches, on the side of the tangents `before` (n, m)."""
        full = self._bordered(images, self.weights * before)
        last = np.zeros(full.shape[:2])
        last[:, -1] = 1.0
        tangent = np.linalg.solve(full, last[:, :, None])[:, :, 0]
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
        return self._corrected(places, goal, normal, np.sum(normal * goal, axis=1))

    def at(self, places: Places, parameter: np.ndarray) -> tuple[Places, np.ndarray]:
        """Places of the branches near these where the parameter has a value (n,), and whether found (n,)."""
        share = (parameter - places.parameter) / places.tangent[:, -1]
        normal = np.zeros_like(self.weights)
        normal[:, -1] = 1.0
        return self._corrected(places, share[:, None] * places.tangent, normal, parameter - places.parameter)

    def _corrected(
        self, places: Places, guess: np.ndarray, normal: np.ndarray, goal: np.ndarray
    ) -> tuple[Places, np.ndarray]:
        """Newton's method from `places` + `guess` (n, m) in the plane normal . change = goal."""
        n, size = places.points.at.shape
        change = guess.copy()
        found, done = places, np.zeros(n, bool)
        going, before_it = np.ones(n, bool), np.full(n, np.inf)
        points = Points(places.points.at + change[:, :size], places.points.like)
        for count in range(1, MOST_CORRECTIONS + 1):
            rows = np.flatnonzero(going)
            if not rows.size:
                break
            track, before = self[rows], places[rows]
            drift = before.drift + change[rows, size:-1]
            parameter = before.parameter + change[rows, -1]
            images = track.evaluated(points[rows], parameter)
            miss = residuals(self.mapping, points[rows], drift, images, track.held)
            off = np.sum(normal[rows] * change[rows], axis=1) - goal[rows]
            scale = np.ones_like(miss)
            scale[:, :size] = sizes(points.at[rows])
            with np.errstate(invalid="ignore"):
                norm = np.max(np.abs(miss) / scale, axis=1)
            sound = images.sound & np.isfinite(norm) & (norm <= PATIENCE * before_it[rows])
            before_it[rows] = norm
            fixed = sound & (norm <= TOLERANCE) & (np.abs(off) <= 1e-9)
            if fixed.any():
                mine, some = rows[fixed], track[np.flatnonzero(fixed)]
                tangent = some.tangents(images[fixed], before.tangent[fixed])
                corrections = np.full(mine.size, count)
                place = Places(
                    points[mine], drift[fixed], parameter[fixed], tangent, images[fixed], corrections
                )
                found, done[mine], going[mine] = found.merged(mine, place), True, False
            going[rows[~sound]] = False
            rest = np.flatnonzero(sound & ~fixed)
            if rest.size:
                mine, some = rows[rest], track[rest]
                full = some._bordered(images[rest], normal[mine])
                right = -np.concatenate([miss[rest], off[rest, None]], axis=1)
                step = np.linalg.solve(full, right[:, :, None])[:, :, 0]
                change[mine] += step
                back = self.mapping.apart(points.at[mine], images.points.at[rest])
                moved = images.points.at[rest] + back + step[:, :size]
                points = points.merged(mine, Points(moved, images[rest].points.like))
        return found, done

    def _bordered(self, images: Images, row: np.ndarray) -> np.ndarray:
        """The matrices (n, m, m) of Newton's equations over all unknowns, with a last `row` (n, m)."""
        inner = matrices(images, self.held)
        n, m, _ = inner.shape
        full = np.zeros((n, m + 1, m + 1))
        full[:, :m, :m] = inner
        full[:, : images.slope.shape[1], m] = images.slope
        full[:, images.slope.shape[1] : m, m] = images.kept_slope[:, self.held.which]
        full[:, m] = row
        return full
