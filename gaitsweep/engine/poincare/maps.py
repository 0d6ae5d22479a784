"""Maps of points to points, evaluated and differentiated for many points at once."""

from __future__ import annotations

import abc
import dataclasses
from collections.abc import Mapping
from functools import lru_cache, partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from gaitsweep.contract import Quantity
from gaitsweep.engine.poincare.poincare_return import Way

# Points evaluated together: more are taken in turns, fewer are filled up to the next of these numbers by
# repeating the last, which costs kernels nothing; so few sizes are ever compiled.
TOGETHER = (1, 8, 64)
MOST_TOGETHER = TOGETHER[-1]

Values = Mapping[str, Any]  # a parameter's name: a number, or one for each point (n,)


@partial(jax.tree_util.register_dataclass, data_fields=["at", "like"], meta_fields=[])
@dataclasses.dataclass(frozen=True)
class Points:
    """Many points: their coordinates `at` (n, size), and the states `like` whose modes they have."""

    at: np.ndarray
    like: Any

    def __len__(self) -> int:
        return len(self.at)

    def __getitem__(self, which: Any) -> Points:
        return jax.tree.map(lambda leaf: leaf[which], self)

    def merged(self, which: np.ndarray, others: Points) -> Points:
        """These points, with `others` in the places `which`."""
        return jax.tree.map(partial(_put, which), self, others)


@partial(
    jax.tree_util.register_dataclass,
    data_fields=["points", "way", "observed", "kept", "jacobian", "slope", "kept_jacobian", "kept_slope"],
    meta_fields=[],
)
@dataclasses.dataclass(frozen=True)
class Images:
    """What a map makes of n points.

    `points` the images; `way` (n,) how each was reached, a `Way`; `observed` (n,) by name; `kept` (n, k) the
    conserved quantities of the points themselves, and `kept_jacobian` (n, k, size) their derivative over the
    points' coordinates. Where they were asked for, the other derivatives: `jacobian` (n, size, size) of the
    images (else NaN), and over a parameter `slope` (n, size) and `kept_slope` (n, k) (else 0).
    """

    points: Points
    way: np.ndarray
    observed: dict[str, np.ndarray]
    kept: np.ndarray
    jacobian: np.ndarray
    slope: np.ndarray
    kept_jacobian: np.ndarray
    kept_slope: np.ndarray

    def __getitem__(self, which: Any) -> Images:
        return jax.tree.map(lambda leaf: leaf[which], self)

    def merged(self, which: np.ndarray, others: Images) -> Images:
        """These images, with `others` in the places `which`."""
        return jax.tree.map(partial(_put, which), self, others)

    @property
    def sound(self) -> np.ndarray:
        """Where the map is defined, (n,)."""
        return self.way == Way.crossed


class Map(abc.ABC):
    """A map of a space of coordinates into itself, with parameters; hashable, compiled programs are kept."""

    @property
    @abc.abstractmethod
    def coordinates(self) -> tuple[Quantity, ...]:
        """What each coordinate is; angles marked circular."""

    @property
    def conserved(self) -> tuple[Quantity, ...]:
        """What the map leaves as it is."""
        return ()

    @abc.abstractmethod
    def follow(self, values: Values, at: jax.Array, like: Any) -> tuple[jax.Array, Any, Any, dict[str, Any]]:
        """The image of one point, in JAX: its coordinates and state, its `Way`, what is observed there."""

    def kept(self, values: Values, at: jax.Array) -> jax.Array:
        """The `conserved` quantities (k,) at one point, in JAX."""
        return jnp.zeros((len(self.conserved),))

    @abc.abstractmethod
    def complete(self, values: Values, n: int) -> dict[str, np.ndarray]:
        """All values that `follow` reads, (n,) each, from those given."""

    def refined(self) -> Map | None:
        """The same map worked out more finely, or None where there is nothing to make finer."""
        return None

    @property
    def circular(self) -> np.ndarray:
        """Which coordinates are angles, (size,)."""
        return np.array([quantity.circular for quantity in self.coordinates])

    def apart(self, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        """a - b of coordinates (..., size), angles by the shorter way."""
        return shorter(a - b, self.circular)

    def images(self, points: Points, values: Values) -> Images:
        """The images of many points."""
        return self._evaluated(points, values, None, derivatives=False)

    def linearised(self, points: Points, values: Values, over: str | None = None) -> Images:
        """The images with their derivatives, over the points and over the parameter `over`."""
        return self._evaluated(points, values, over, derivatives=True)

    def _evaluated(self, points: Points, values: Values, over: str | None, derivatives: bool) -> Images:
        program = _program(self, over, derivatives)
        held = self.complete(values, len(points))
        found = []
        for first in range(0, len(points), MOST_TOGETHER):
            count = min(MOST_TOGETHER, len(points) - first)
            room = next(size for size in TOGETHER if size >= count)
            order = np.minimum(first + np.arange(room), first + count - 1)
            some = points[order]
            given = program({name: each[order] for name, each in held.items()}, some.at, some.like)
            found.append(jax.tree.map(lambda leaf, n=count: np.asarray(leaf)[:n], given))
        image, state, way, observed, kept, slopes = jax.tree.map(lambda *parts: np.concatenate(parts), *found)
        size = points.at.shape[1]
        return Images(
            points=Points(image, state),
            way=way,
            observed=observed,
            kept=kept,
            jacobian=slopes[:, :size, :size],
            slope=slopes[:, :size, size:].sum(axis=2),
            kept_jacobian=slopes[:, size:, :size],
            kept_slope=slopes[:, size:, size:].sum(axis=2),
        )


@lru_cache(maxsize=64)
def _program(mapping: Map, over: str | None, derivatives: bool) -> Any:
    """The map of many points, compiled for each number of them."""

    def one(values: Any, at: jax.Array, like: Any) -> Any:
        size = at.size

        def moved(x: jax.Array) -> Any:
            here = values if over is None else {**values, over: x[size]}
            image, state, way, observed = mapping.follow(here, x[:size], like)
            kept = mapping.kept(here, x[:size])
            return jnp.concatenate([image, kept]), (image, state, way, observed, kept)

        x = at if over is None else jnp.concatenate([at, values[over][None]])
        if derivatives:
            slopes, found = jax.jacfwd(moved, has_aux=True)(x)
        else:
            _, found = moved(x)
            kept = jax.jacfwd(lambda at: mapping.kept(values, at))(at)
            slopes = jnp.concatenate([jnp.full((size, size), jnp.nan), kept])
        return (*found, slopes)

    return jax.jit(jax.vmap(one))


def _put(which: np.ndarray, mine: np.ndarray, theirs: np.ndarray) -> np.ndarray:
    mine = np.array(mine)
    mine[which] = theirs
    return mine


def shorter(difference: np.ndarray, circular: np.ndarray) -> np.ndarray:
    """Differences, those of angles (rad) brought to the shorter way around."""
    turns = np.round(difference / (2.0 * np.pi))
    return np.where(circular, difference - 2.0 * np.pi * turns, difference)
