"""A flat ground that pushes a leg's foot through a spring and a damper."""

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
    """Force of the ground on each leg, N, shape (n,): zero out of contact.

    Args:
        gap, gap_rate: height of the body over the leg's length, x - l (m), and its rate (m/s), shape (n,).
        contact: the leg's contact flag, shape (n,).
        K, D: spring (N/m) and damper (N s/m) of the ground.
        clamp: where above zero the ground cannot pull; else eq. (1) to the letter, which pulls for under
            a millisecond at the takeoff corner.

    Source: Ambe et al. 2021, eq. (1), (2).
    """
    # stiffness and damping out of contact are zero: chosen apart from the motion, once for all stages
    force = -(jnp.where(contact, K, 0.0) * gap + jnp.where(contact, D, 0.0) * gap_rate)
    least = jnp.where(clamp > 0.0, 0.0, -jnp.inf)
    return jnp.where(force < least, least, force)
