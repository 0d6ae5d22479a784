"""Contact of legs with flat ground, by a spring and a damper."""

from __future__ import annotations

import jax
import jax.numpy as jnp


def ground_force(
    gap: jax.Array,
    gap_rate: jax.Array,
    contact: jax.Array,
    K: jax.Array,
    D: jax.Array,
    clamp: jax.Array,
) -> jax.Array:
    """The force of the ground on each leg, N, shape (n,); zero without contact.

    Args:
        gap, gap_rate: height of the body over the leg's length, x - l (m), and its rate (m/s), shape (n,).
        contact: the leg's contact flag, shape (n,).
        K, D: spring (N/m) and damper (N s/m) of the ground.
        clamp: if above zero, the ground cannot pull; else eq. (1) exactly, by which the ground pulls for
            less than a millisecond at the takeoff corner.

    Source: Ambe et al. 2021, eq. (1), (2).
    """
    # stiffness and damping are selected independently of the motion, so once for all stages of a step
    force = -(jnp.where(contact, K, 0.0) * gap + jnp.where(contact, D, 0.0) * gap_rate)
    least = jnp.where(clamp > 0.0, 0.0, -jnp.inf)
    return jnp.where(force < least, least, force)
