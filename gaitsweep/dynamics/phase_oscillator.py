"""A phase oscillator with phase resetting at touchdown through a first-order lag."""

from __future__ import annotations

import jax.numpy as jnp
from jaxtyping import Array, Float

TWO_PI = 2.0 * jnp.pi


def lagged_reset(phi: Float[Array, " ..."], tau: Float[Array, " ..."]) -> Float[Array, " ..."]:
    """The jump of the lag variable y (rad/s) that finally moves the phase phi (rad) to 2 pi.

    The lag tau y' = -y + u responds to the impulse u = (2 pi - phi) delta(t) by a jump of y; phi is
    continuous.

    Args:
        phi: the phase at touchdown, rad.
        tau: the time constant of the lag, s.

    Source: Ambe et al. 2021, eq. (5), (6).
    """
    return (TWO_PI - phi) / tau


def wrapped(phi: Float[Array, " ..."]) -> Float[Array, " ..."]:
    """The angle `phi` (rad) wrapped to [0, 2 pi)."""
    return phi - TWO_PI * jnp.floor(phi / TWO_PI)
