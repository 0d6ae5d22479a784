"""A Poincare section by a plane that is crossed in one direction: its guards, and the mode that arms it."""

from __future__ import annotations

import dataclasses
from functools import partial

import jax
import jax.numpy as jnp

GUARDS = ("the plane is crossed", "the plane's far side is reached")
# Of the rounding of a height: what lies nearer to the plane lies on it.
_RESOLUTIONS = 16.0


@partial(jax.tree_util.register_dataclass, data_fields=["normal", "offset"], meta_fields=[])
@dataclasses.dataclass(frozen=True)
class Plane:
    """The plane `normal` . x = `offset` of points x (n,), crossed in the direction of its normal (n,).

    A model keeps a mode `armed` (a bool) in its state, `Plane.armed_at` at its start; it appends `guards` to
    its own, and takes `armed_after` in its jump and `crossed` as its section, of the two guards that are
    these. The section is armed only while the state is on the far side, from which it crosses. So a start on
    the plane is no crossing, whichever way it moves, every crossing in the direction of the normal is met
    once, and none in the other direction; a state that rounding cannot tell from one on the plane counts as
    on it.
    """

    normal: jax.Array
    offset: jax.Array

    def height(self, x: jax.Array) -> jax.Array:
        """How far x is beyond the plane, in units of the normal's length."""
        return jnp.sum(self.normal * x) - self.offset

    def armed_at(self, x: jax.Array) -> jax.Array:
        """Whether a state that starts at x is on the far side, off the plane."""
        return self._below(x) >= 0.0

    def guards(self, x: jax.Array, armed: jax.Array) -> jax.Array:
        """The crossing while armed, else the coming to the far side, shape (2,); see `GUARDS`."""
        return jnp.stack([jnp.where(armed, self.height(x), -1.0), jnp.where(armed, -1.0, self._below(x))])

    @staticmethod
    def armed_after(armed: jax.Array, fired: jax.Array) -> jax.Array:
        """The mode after those of the guards (2,) that `fired`."""
        return (armed | fired[1]) & ~fired[0]

    @staticmethod
    def crossed(fired: jax.Array) -> jax.Array:
        """Whether the guards (2,) that `fired` are a crossing."""
        return fired[0]

    def _below(self, x: jax.Array) -> jax.Array:
        """How far x is below the plane, less what rounding may make of a point on it."""
        size = jnp.sum(jnp.abs(self.normal * x)) + jnp.abs(self.offset)
        # the smallest number: a height of zero is on the plane, where all is zero too
        return -self.height(x) - _RESOLUTIONS * jnp.finfo(size.dtype).eps * size - jnp.finfo(size.dtype).tiny
