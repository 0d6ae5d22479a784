"""Periodic states on the section of any leg.

Section j is just before the touchdown of leg j. Along a periodic solution every leg touches down at the same
phase C (eq. 15) and is reset to 0: the phases move on circles of circumference C instead of 2 pi, and a
solution is given by the legs' places theta_i on that circle. The touchdown order, with the sets T_1 and T_2
of eq. (18), and psi on any section follow from the places exactly.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp

TWO_PI = 2.0 * jnp.pi
Leg = int | jax.Array  # 1 .. N+1


def phases_on_section(theta: jax.Array, touchdown: jax.Array, leg: Leg) -> jax.Array:
    """Phases of the legs (rad, in (0, touchdown]) just before `leg` touches down, from their places.

    Args:
        theta: places of the legs, rad, shape (N+1,), up to a common shift and multiples of `touchdown`.
        touchdown: touchdown phase, rad.
        leg: 1 .. N+1.
    """
    behind = jnp.mod(theta[leg - 1] - theta, touchdown)
    return touchdown - behind


def relative(phi: jax.Array) -> jax.Array:
    """psi_i = phi_{i+1} - phi_i in [0, 2 pi), rad, shape (N,), from phases of shape (N+1,); eq. (7)."""
    return jnp.mod(phi[1:] - phi[:-1], TWO_PI)


def phases_from_relative(psi: jax.Array, touchdown: jax.Array, leg: Leg) -> jax.Array:
    """The phase of each leg in [0, 2 pi), rad, shape (N+1,), from psi, with `leg` at `touchdown`."""
    phi = jnp.concatenate([jnp.zeros_like(psi[:1]), jnp.cumsum(psi)])
    return jnp.mod(phi - phi[leg - 1] + touchdown, TWO_PI).at[leg - 1].set(touchdown)


def touches_early(psi: jax.Array, touchdown: jax.Array, threshold: jax.Array, leg: Leg) -> jax.Array:
    """The union of the sets T_1 and T_2, a bool for each leg (N+1,).

    Args:
        psi: relative phases on the section of the boundary leg `leg`, rad, shape (N,).
        touchdown, threshold: 2 pi - m_B b and 2 beta pi + (2 m_B - m) b, rad.

    Source: eq. (18); T_1 are legs up to k-2, T_2 legs from k+2.
    """
    phi = phases_from_relative(psi, touchdown, leg)
    number = jnp.arange(1, phi.shape[0] + 1)
    outside = (number <= leg - 2) | (number >= leg + 2)
    return outside & (threshold < phi) & (phi <= touchdown)
