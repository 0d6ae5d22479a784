"""The quadruped's fastest motion, which limits the step."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from gaitsweep.papers.aoi2011.waist_quadruped.state import Params


def fastest_motion(p: Params) -> tuple[jax.Array, jax.Array]:
    """Rate (1/s) and damping ratio of the fastest motion, estimated for the straightest limb.

    A limb is two rods on a hip whose compliance is that of half a body; ground and joints act as springs and
    dampers. Compared with the largest eigenvalue of the Jacobian of the whole body, its error is between -6 %
    and 50 %, for nine of ten parameter sets between 0 and 15 % (`tests/engine/test_flow_spectrum.py`).
    """
    m = p.mechanics
    # the straighter limb's, and the stiffer direction's
    farthest = jnp.max(jnp.hypot(p.H, 0.5 * p.D + jnp.abs(p.x_c)))
    damper, spring = jnp.maximum(m.D_TL, m.D_N), jnp.maximum(m.K_TL, m.K_N)
    reach = jnp.minimum(farthest, 2.0 * m.link_length)
    cosine = reach * reach / (2.0 * m.link_length * m.link_length) - 1.0  # of the knee angle
    free = 1.0 + 0.5 * m.link_mass / jnp.minimum(m.front_mass, m.rear_mass)
    c = free * _fastest(damper, m.sigma_1, m.sigma_2, cosine, m.link_mass, m.link_length)
    k = free * _fastest(spring, m.kappa_1, m.kappa_2, cosine, m.link_mass, m.link_length)
    root = jnp.sqrt(k)
    # stiffness and damping may be largest along different motions
    decays = 0.5 * c + jnp.sqrt(jnp.maximum(0.25 * c * c - 0.5 * k, 0.0))
    return jnp.maximum(root, decays), jnp.minimum(0.5 * c / root, 1.0)


def _fastest(
    ground: jax.Array, hip: jax.Array, knee: jax.Array, cosine: jax.Array, mass: jax.Array, length: jax.Array
) -> jax.Array:
    """The largest eigenvalue of M^-1 K of a limb of two rods, with K its stiffness or damping."""
    square = length * length
    determinant = 4.0 / 9.0 - 0.25 * cosine * cosine
    i11, i12, i22 = (x / (determinant * mass * square) for x in (1.0 / 3.0, -0.5 * cosine, 4.0 / 3.0))
    a11, a12, a22 = ground * square + hip + knee, ground * square * cosine - knee, ground * square + knee
    b11, b12 = i11 * a11 + i12 * a12, i11 * a12 + i12 * a22
    b21, b22 = i12 * a11 + i22 * a12, i12 * a12 + i22 * a22
    half = 0.5 * (b11 + b22)
    return half + jnp.sqrt(jnp.maximum(half * half - (b11 * b22 - b12 * b21), 0.0))
