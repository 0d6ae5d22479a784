"""Periodic states on the section of any leg, and their transport from one leg's section to another's.

Section j is read just before leg j touches the ground. Along a periodic solution every leg touches at the
same phase C (eq. 15), where it is set back to 0: the phases then turn on circles of circumference C, not
2 pi, and a solution is nothing but the legs' places theta_i on that circle. The touchdown order, and with it
the sets T_1 and T_2 of eq. (18), follows from the places; so does psi on any section, exactly.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp

TWO_PI = 2.0 * jnp.pi
Leg = int | jax.Array  # 1 .. N+1


def phases_on_section(theta: jax.Array, touchdown: jax.Array, leg: Leg) -> jax.Array:
    """Phase of each leg (rad, in (0, touchdown]) just before `leg` touches, from places on the circle.

    Args:
        theta: places of the legs, rad, shape (N+1,), up to a common shift and to whole turns of `touchdown`.
        touchdown: phase at which legs touch the ground, rad.
        leg: 1 .. N+1.
    """
    behind = jnp.mod(theta[leg - 1] - theta, touchdown)
    return touchdown - behind


def relative(phi: jax.Array) -> jax.Array:
    """psi_i = phi_{i+1} - phi_i in [0, 2 pi), rad, shape (N,), from phases of shape (N+1,); eq. (7)."""
    return jnp.mod(phi[1:] - phi[:-1], TWO_PI)


def phases_from_relative(psi: jax.Array, touchdown: jax.Array, leg: Leg) -> jax.Array:
    """Phase of each leg in [0, 2 pi), rad, shape (N+1,), when `leg` is at `touchdown` with psi as given."""
    phi = jnp.concatenate([jnp.zeros_like(psi[:1]), jnp.cumsum(psi)])
    return jnp.mod(phi - phi[leg - 1] + touchdown, TWO_PI).at[leg - 1].set(touchdown)


def transport(psi: jax.Array, touchdown: jax.Array, source: Leg, target: Leg) -> jax.Array:
    """psi on the section of leg `target`, from psi on that of leg `source`, each leg touching at `touchdown`.

    A leg that touches between the two sections gains 2 pi - touchdown: one with a phase beyond the target's.

    Args:
        psi: relative phases on section `source`, rad, shape (N,).
        touchdown: phase at which legs touch the ground, rad; eq. (16).
        source, target: legs, 1 .. N+1.
    """
    phi = phases_from_relative(psi, touchdown, source)
    resets = phi > phi[target - 1]
    return relative(phi + jnp.where(resets, TWO_PI - touchdown, 0.0))


def touches_early(psi: jax.Array, touchdown: jax.Array, threshold: jax.Array, leg: Leg) -> jax.Array:
    """The sets T_1 and T_2 together: True for legs (N+1,) at least two from `leg` that touch in its wake.

    Args:
        psi: relative phases on the section of the boundary leg `leg`, rad, shape (N,).
        touchdown, threshold: 2 pi - m_B b and 2 beta pi + (2 m_B - m) b, rad.

    Source: eq. (18): T_1 are those up to leg k-2, T_2 those from leg k+2.
    """
    phi = phases_from_relative(psi, touchdown, leg)
    number = jnp.arange(1, phi.shape[0] + 1)
    outside = (number <= leg - 2) | (number >= leg + 2)
    return outside & (threshold < phi) & (phi <= touchdown)
