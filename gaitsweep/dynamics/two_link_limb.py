"""A limb of two equal links in the pitch plane."""

from __future__ import annotations

import jax
import jax.numpy as jnp


def joint_angles(
    x: jax.Array, z: jax.Array, length: jax.Array | float, bend: jax.Array | float
) -> tuple[jax.Array, jax.Array]:
    """Hip and knee angles (rad) that put the foot at (x, z) from the hip.

    Angles turn about +y, straight down is zero, the knee's is relative to the upper link. A foot out of
    reach is aimed at with a straight limb.

    Args:
        x, z: of the foot relative to the hip, m.
        length: of each link, m.
        bend: 1 where the knee's angle is positive, -1 where it is negative.
    """
    square = x * x + z * z
    # half the knee's angle, of an isosceles triangle
    half = bend * jnp.arctan2(jnp.sqrt(jnp.maximum(4.0 * length * length - square, 0.0)), jnp.sqrt(square))
    return jnp.arctan2(-x, -z) - half, 2.0 * half
