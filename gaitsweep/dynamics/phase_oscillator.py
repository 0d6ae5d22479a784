"""A leg's phase oscillator whose phase is reset through a first-order lag when the leg touches down."""

from __future__ import annotations

import jax
import jax.numpy as jnp

TWO_PI = 2.0 * jnp.pi


def lagged_reset(phi: jax.Array, tau: jax.Array) -> jax.Array:
    """The kick to the lag variable y (rad/s) that moves the phase phi (rad) to 2 pi in the long run.

    The lag tau y' = -y + u answers the impulse u = (2 pi - phi) delta(t) by a jump of y; phi is continuous.
    Source: Ambe et al. 2021, eq. (5), (6).
    """
    return (TWO_PI - phi) / tau


def wrapped(phi: jax.Array) -> jax.Array:
    """`phi` (rad) in [0, 2 pi)."""
    return phi - TWO_PI * jnp.floor(phi / TWO_PI)
