"""Contact of a foot: a spring and a damper between it and the point where it touched down."""

from __future__ import annotations

import jax
import jax.numpy as jnp


def anchored_force(
    position: jax.Array,
    velocity: jax.Array,
    anchor: jax.Array,
    contact: jax.Array,
    K: jax.Array,
    D: jax.Array,
    clamp: jax.Array | float = 0.0,
) -> jax.Array:
    """Force of level ground at z = 0 on a foot (3,), N (Aoi et al. 2011, eq. A8).

    Args:
        position, velocity: of the foot in the world, (3,), m and m/s.
        anchor: x and y at touchdown, (2,), m.
        contact: whether the foot is on the ground, scalar bool.
        K, D: spring, N/m, and damper, N s/m, equal in all directions.
        clamp: if above zero, the ground cannot pull.
    """
    sunk = position - jnp.concatenate([anchor, jnp.zeros(1)])
    force = -K * sunk - D * velocity
    least = jnp.where(clamp > 0.0, 0.0, -jnp.inf)
    force = jnp.stack([force[0], force[1], jnp.maximum(force[2], least)])
    return jnp.where(contact, force, 0.0)
