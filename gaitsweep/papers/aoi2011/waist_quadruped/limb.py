"""The inverse kinematics of a limb of two equal links."""

from __future__ import annotations

import jax
import jax.numpy as jnp


def joint_angles(
    x: jax.Array, z: jax.Array, length: jax.Array | float, bend: jax.Array | float
) -> tuple[jax.Array, jax.Array]:
    """Hip and knee angles (rad) of a limb of two equal links whose foot is at (x, z) from the hip.

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


def joint_rates(
    x: jax.Array,
    z: jax.Array,
    x_rate: jax.Array,
    z_rate: jax.Array,
    length: jax.Array | float,
    bend: jax.Array | float,
) -> tuple[jax.Array, jax.Array]:
    """Time derivatives (rad/s) of the hip and knee angles of `joint_angles`; x, z, length, bend as there.

    The knee of a target out of reach does not turn.

    Args:
        x_rate, z_rate: velocity of the foot relative to the hip, m/s.
    """
    square = x * x + z * z
    reach = 4.0 * length * length - square
    # the half knee angle a has cos a = r / (2 length), at the foot's distance r from the hip
    slope = square * jnp.where(reach > 0.0, reach, jnp.inf)
    half = -bend * (x * x_rate + z * z_rate) / jnp.sqrt(slope)
    return (z * x_rate - x * z_rate) / square - half, 2.0 * half
