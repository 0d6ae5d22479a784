"""The quadruped's posture: indices of its joints, kinematics of its limbs, its tilt, and falls."""

from __future__ import annotations

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp

# Limits of a fall: height as a share of that in stance, and angles of tilt and twist (rad).
FALL_HEIGHT, FALL_TILT, FALL_TWIST = 0.4, 1.2, 1.5
# Indices in q; those in v, which has no quaternion, are one less.
WAIST, HIP, KNEE = 11, (7, 9, 12, 14), (8, 10, 13, 15)


def tilt(q: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Roll and pitch (rad) of the front body at positions q (16,)."""
    ahead, side, up, norm = _rises(q)
    return jnp.arctan2(side, up), jnp.arcsin(-ahead / norm)


def has_fallen(q: jax.Array, standing: jax.Array, ground: jax.Array | None = None) -> jax.Array:
    """Whether the front body is far below its standing height or tilted, or the waist is twisted.

    Args:
        q: positions (16,).
        standing: height of the front body in stance, m.
        ground: height of the ground below the front body, m; None where it is even.
    """
    ahead, side, up, norm = _rises(q)
    rolled = jnp.abs(side) > math.tan(FALL_TILT) * up
    pitched = jnp.abs(ahead) > math.sin(FALL_TILT) * norm
    twisted = jnp.abs(q[WAIST]) > FALL_TWIST
    height = q[2] if ground is None else q[2] - ground
    return (height < FALL_HEIGHT * standing) | rolled | pitched | twisted


class _Rises(NamedTuple):
    """Vertical components of the front body's axes, each times `norm`, the quaternion's squared norm."""

    ahead: jax.Array
    side: jax.Array
    up: jax.Array
    norm: jax.Array


def _rises(q: jax.Array) -> _Rises:
    """The vertical components of the front body's axes at positions q (16,)."""
    w, x, y, z = q[3:7]
    norm = w * w + x * x + y * y + z * z
    ahead, side, up = 2.0 * (x * z - w * y), 2.0 * (y * z + w * x), w * w - x * x - y * y + z * z
    return _Rises(ahead, side, up, norm)


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
