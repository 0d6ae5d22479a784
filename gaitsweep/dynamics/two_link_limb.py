"""Inverse kinematics of a limb of two equal links in the pitch plane."""

from __future__ import annotations

import jax
import jax.numpy as jnp


def joint_angles(
    x: jax.Array, z: jax.Array, length: jax.Array | float, bend: jax.Array | float
) -> tuple[jax.Array, jax.Array]:
    """Hip and knee angles (rad) at which the foot is at (x, z) from the hip.

    Rotations are about +y, zero is straight down, and the knee angle is relative to the upper link. For a
    target out of reach the straight limb points at it.

    Args:
        x, z: position of the foot relative to the hip, m.
        length: length of each link, m.
        bend: sign of the knee angle, 1 or -1.
    """
    square = x * x + z * z
    # half the knee angle, from an isosceles triangle
    half = bend * jnp.arctan2(jnp.sqrt(jnp.maximum(4.0 * length * length - square, 0.0)), jnp.sqrt(square))
    return jnp.arctan2(-x, -z) - half, 2.0 * half
