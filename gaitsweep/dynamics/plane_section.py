"""A one-sided Poincare section by a plane: its guards, and the mode that arms it."""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp

GUARDS = ("the plane is crossed", "the plane's far side is reached")
# Multiple of the rounding error of a height within which a point counts as on the plane.
_RESOLUTIONS = 16.0


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Plane:
    """The plane `normal` . x = `offset` of points x (n,), crossed in the direction of its normal (n,).

    A model has a mode `armed` (a bool) in its state, initially `Plane.armed_at`. It appends `guards` to its
    own guards, calls `armed_after` in its jump and `crossed` in its section, with the two flags of these
    guards. The section is armed only while the state is below the plane. So a start on the plane is not a
    crossing, every crossing in the direction of the normal is found once, and none in the other direction.
    A state within rounding error of the plane counts as on it.
    """

    normal: jax.Array
    offset: jax.Array

    def height(self, x: jax.Array) -> jax.Array:
        """The signed distance of x from the plane, in units of the normal's length."""
        return jnp.sum(self.normal * x) - self.offset

    def armed_at(self, x: jax.Array) -> jax.Array:
        """Whether a start at x is below the plane, and so arms the section."""
        return self._below(x) >= 0.0

    def guards(self, x: jax.Array, armed: jax.Array) -> jax.Array:
        """The guards (2,): the crossing while armed, else the return below the plane; see `GUARDS`."""
        return jnp.stack([jnp.where(armed, self.height(x), -1.0), jnp.where(armed, -1.0, self._below(x))])

    @staticmethod
    def armed_after(armed: jax.Array, fired: jax.Array) -> jax.Array:
        """The mode `armed` after the guards `fired` (2,)."""
        return (armed | fired[1]) & ~fired[0]

    @staticmethod
    def crossed(fired: jax.Array) -> jax.Array:
        """Whether the guards `fired` (2,) include the crossing."""
        return fired[0]

    def above(self, x: jax.Array) -> jax.Array:
        """The distance of x above the plane, less the rounding error of a point on it."""
        return self.height(x) - self._rounding(x)

    def _below(self, x: jax.Array) -> jax.Array:
        """The distance of x below the plane, less the rounding error of a point on it."""
        return -self.height(x) - self._rounding(x)

    def _rounding(self, x: jax.Array) -> jax.Array:
        size = jnp.sum(jnp.abs(self.normal * x)) + jnp.abs(self.offset)
        # the smallest float: if all terms are zero, x is on the plane
        return _RESOLUTIONS * jnp.finfo(size.dtype).eps * size + jnp.finfo(size.dtype).tiny
