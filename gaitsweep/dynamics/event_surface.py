"""The surface on which an event happens in one direction: its guards, and the mode that arms it."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

# Multiple of the rounding error of a height within which a point counts as on the surface.
_RESOLUTIONS = 16.0


@dataclasses.dataclass(frozen=True)
class EventSurface:
    """The surface where a function of the state is zero, seen from a point, and crossed where it rises.

    A model has a mode `armed` (a bool) in its state, initially `armed_at_start`. It appends `guards` to its
    own guards, and calls `armed_after` in its jump and `crossed` in its section with the two flags of these
    guards. The surface is armed only while the state is below it. So a start on the surface is not a
    crossing, every crossing in the direction of the function's gradient is found once, and none in the other
    direction. A state within rounding error of the surface counts as on it.

    `height` is the function at the point, `rounding` the error of this number, `normal` (n,) its gradient.
    """

    height: jax.Array
    rounding: jax.Array
    normal: jax.Array

    @classmethod
    def seen_from(cls, point: Any, function: Callable[[Any], jax.Array]) -> EventSurface:
        """The surface of a function of points that are pytrees of n numbers, seen from a point.

        The tangent plane says how large the terms of the function are, and so what rounding may do to its
        sign.
        """
        height, gradient = jax.value_and_grad(function)(point)
        normal = flat(gradient)
        terms = normal * flat(point)
        size = jnp.sum(jnp.abs(terms)) + jnp.abs(jnp.sum(terms) - height)
        # the smallest float: if all terms are zero, the point is on the surface
        rounding = _RESOLUTIONS * jnp.finfo(size.dtype).eps * size + jnp.finfo(size.dtype).tiny
        return cls(height, rounding, normal)

    @property
    def armed_at_start(self) -> jax.Array:
        """Whether a start at the point is below the surface, and so arms it."""
        return self.below >= 0.0

    def guards(self, armed: jax.Array) -> jax.Array:
        """The guards (2,): the crossing while armed, else the return below the surface."""
        return jnp.stack([jnp.where(armed, self.height, -1.0), jnp.where(armed, -1.0, self.below)])

    @staticmethod
    def armed_after(armed: jax.Array, fired: jax.Array) -> jax.Array:
        """The mode `armed` after the guards `fired` (2,)."""
        return (armed | fired[1]) & ~fired[0]

    @staticmethod
    def crossed(fired: jax.Array) -> jax.Array:
        """Whether the guards `fired` (2,) include the crossing."""
        return fired[0]

    @property
    def above(self) -> jax.Array:
        """The height above the surface, less its rounding error."""
        return self.height - self.rounding

    @property
    def below(self) -> jax.Array:
        """The depth below the surface, less its rounding error."""
        return -self.height - self.rounding

    def turns_back(self, rates: jax.Array) -> jax.Array:
        """Whether a point on the surface that moves with the rates (n,) does not go on through it."""
        return (self.above <= 0.0) & (jnp.sum(self.normal * rates) <= 0.0)


def flat(point: Any) -> jax.Array:
    """The numbers of a pytree in one array (n,)."""
    return jnp.concatenate([jnp.ravel(leaf) for leaf in jax.tree.leaves(point)])
