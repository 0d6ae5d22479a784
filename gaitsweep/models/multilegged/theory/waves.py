"""Wavelength and speed of the swing legs' wave."""

from __future__ import annotations

from typing import NamedTuple

import jax

from gaitsweep.models.multilegged.theory.chain import TWO_PI, Chain, Scalar, lag, touchdown_phase


class Speeds(NamedTuple):
    """Speed of the wave, in leg intervals a second: as printed (eq. 28), and with the reset in the period."""

    printed: jax.Array
    exact: jax.Array


def wavelength(chain: Chain | None = None) -> jax.Array:
    """Legs in one wave, in units of the interval between legs; eq. (27), which is C / delta."""
    chain = Chain() if chain is None else chain
    return touchdown_phase(chain) / lag(chain)


def wave_speed(omega: Scalar, chain: Chain | None = None) -> Speeds:
    """Speeds of the wave for the basic frequency omega (rad/s).

    Eq. (28) takes a cycle to last 2 pi / omega; the reset cuts it to (2 pi - m_B b) / omega.
    """
    chain = Chain() if chain is None else chain
    waves = wavelength(chain)
    return Speeds(printed=waves * omega / TWO_PI, exact=waves * omega / touchdown_phase(chain))
