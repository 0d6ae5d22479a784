"""Wavelength and speed of the swing legs' wave."""

from __future__ import annotations

from typing import NamedTuple

import jax

from gaitsweep.models.multilegged.theory.chain import TWO_PI, Chain, Scalar, lag, touchdown_phase


class Speeds(NamedTuple):
    """The speed of the wave, leg intervals per second: as printed (eq. 28), and with the reset period."""

    printed: jax.Array
    exact: jax.Array


def wavelength(chain: Chain | None = None) -> jax.Array:
    """The wavelength, in leg intervals: C / delta, eq. (27)."""
    chain = Chain() if chain is None else chain
    return touchdown_phase(chain) / lag(chain)


def wave_speed(omega: Scalar, chain: Chain | None = None) -> Speeds:
    """The speeds of the wave for the basic frequency omega (rad/s).

    Eq. (28) uses the period 2 pi / omega; with the reset it is (2 pi - m_B b) / omega.
    """
    chain = Chain() if chain is None else chain
    waves = wavelength(chain)
    return Speeds(printed=waves * omega / TWO_PI, exact=waves * omega / touchdown_phase(chain))
