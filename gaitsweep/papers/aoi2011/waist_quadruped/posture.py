"""The quadruped's posture: indices of its joints, roll and pitch, and falls."""

from __future__ import annotations

import math

import jax
import jax.numpy as jnp

# Limits of a fall: height as a share of that in stance, and angles of tilt and twist (rad).
LOW, TILTED, TWISTED = 0.4, 1.2, 1.5
# Indices in q; those in v, which has no quaternion, are one less.
WAIST, HIP, KNEE = 11, (7, 9, 12, 14), (8, 10, 13, 15)


def tilt(q: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Roll and pitch (rad) of the front body."""
    ahead, side, up, norm = _rises(q)
    return jnp.arctan2(side, up), jnp.arcsin(-ahead / norm)


def fallen(q: jax.Array, standing: jax.Array) -> jax.Array:
    """Whether the front body is far below its height `standing` (m) or tilted, or the waist is twisted."""
    ahead, side, up, norm = _rises(q)
    rolled = jnp.abs(side) > math.tan(TILTED) * up
    pitched = jnp.abs(ahead) > math.sin(TILTED) * norm
    twisted = jnp.abs(q[WAIST]) > TWISTED
    return (q[2] < LOW * standing) | rolled | pitched | twisted


def _rises(q: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array, jax.Array]:
    """Vertical components of the body's axes times `norm`, the quaternion's squared norm, and `norm`."""
    w, x, y, z = q[3:7]
    norm = w * w + x * x + y * y + z * z
    ahead, side, up = 2.0 * (x * z - w * y), 2.0 * (y * z + w * x), w * w - x * x - y * y + z * z
    return ahead, side, up, norm
