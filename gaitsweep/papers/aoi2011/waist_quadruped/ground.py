"""The force of the ground on a foot: springs and dampers at its touchdown point, and friction."""

from __future__ import annotations

import jax
import jax.numpy as jnp

# Height above the ground (m) at which a foot lifts off, 1/2000 of its depth in stance. At zero, contact could
# chatter without end: the damper lifts a foot on the ground, and in the air it falls at once.
RELEASE = 1e-7


def anchored_force(
    position: jax.Array,
    velocity: jax.Array,
    anchor: jax.Array,
    contact: jax.Array,
    K: jax.Array,
    D: jax.Array,
    rising: jax.Array | float = 1.0,
    clamp: jax.Array | float = 0.0,
) -> jax.Array:
    """Force of level ground at z = 0 on a foot (3,), N (Aoi et al. 2011, eq. A8).

    Args:
        position, velocity: of the foot in the world, (3,), m and m/s.
        anchor: x and y at touchdown, (2,), m.
        contact: whether the foot is on the ground, scalar bool.
        K, D: springs, N/m, and dampers, N s/m, along x, y and z, (3,).
        rising: share of the vertical damper that acts while the foot rises.
        clamp: if above zero, the ground cannot pull.
    """
    sunk = position - jnp.concatenate([anchor, jnp.zeros(1)])
    damper = jnp.stack([D[0], D[1], jnp.where(velocity[2] > 0.0, D[2] * rising, D[2])])
    force = -K * sunk - damper * velocity
    least = jnp.where(clamp > 0.0, 0.0, -jnp.inf)
    force = jnp.stack([force[0], force[1], jnp.maximum(force[2], least)])
    return jnp.where(contact, force, 0.0)


def carried(force: jax.Array, mu: jax.Array | float) -> jax.Array:
    """The share of the force along the ground that friction `mu` carries, 1 within the cone.

    A force (3,), N, that pulls the foot down has no load, so that it carries none.
    """
    along, limit = jnp.hypot(force[0], force[1]), mu * jnp.maximum(force[2], 0.0)
    return jnp.where(along > limit, limit / jnp.where(along > 0.0, along, 1.0), 1.0)
