"""A chain's parameters, the touchdown phases of its legs, and their waves (Ambe et al. 2021, sec. 3.2, 3.3).

All results follow from one force balance. A leg in its landing segment touches down at the height at which
its two springs alone carry its mass (eq. 12). With D = 2 pi - (its phase there), and t_j the phase of
neighbour j relative to the beginning of its takeoff segment (0 in stance),

    D = sum of (w_j t_j) + (1 - beta) pi m_i g / (a_i sum of kappa_j),

where w_j = kappa_j a_j / (a_i sum of kappa_j), with sums over the neighbours j and kappa_j the spring to j.
In a uniform chain w_j is 1/2, or 1 at an end.

Along a solution D is that of the ends for all legs, whatever the inner legs are. A profile of these changes
the phases t_j, so the lags of neighbours, and no touchdown phase.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from gaitsweep import ArgumentError
from gaitsweep.dynamics import TWO_PI

Scalar = jax.Array | np.ndarray | float


class Chain(NamedTuple):
    """Parameters of the theory, numbers or traced scalars; the defaults are those of Table 1.

    `beta` is the duty factor; `kappa` the spring between neighbours, N/m; `m`, `m_1`, `m_end` the masses
    inside, at the head and at the tail, kg (the paper's m_B is m_1 = m_end); `a` the amplitude of a leg, m;
    `g` gravity, m/s2; `kappa_1`, `kappa_end` the first and the last spring and `a_1`, `a_end` the amplitudes
    of the first and the last leg, if they differ from the others.

    With a profile, `m` (N-1,), `kappa` (N-2,) and `a` (N-1,) are those of legs 2 .. N and of springs
    2 .. N-1, and the values of the ends are given. Functions for equal inner legs refuse it.
    """

    beta: Scalar = 0.8
    kappa: Scalar = 100.0
    m: Scalar = 1.0
    m_1: Scalar = 0.9
    m_end: Scalar = 0.9
    a: Scalar = 0.4
    g: Scalar = 9.8
    kappa_1: Scalar | None = None
    kappa_end: Scalar | None = None
    a_1: Scalar | None = None
    a_end: Scalar | None = None

    @property
    def by_name(self) -> dict[str, Any]:
        """The fields that are not None, by name."""
        return {name: value for name, value in self._asdict().items() if value is not None}

    @property
    def has_profile(self) -> bool:
        """Whether inner legs have values of their own."""
        return any(jnp.ndim(values) > 0 for values in (self.m, self.kappa, self.a))

    def require_equal_inner_legs(self, result: str) -> None:
        """Raise an ArgumentError if the chain has a profile, for which `result` is unknown."""
        if self.has_profile:
            raise ArgumentError(f"{result} requires equal inner legs, but this chain has a profile.")

    def require_uniform(self, result: str) -> None:
        """Raise an ArgumentError if springs or amplitudes differ, for which `result` is unknown."""
        self.require_equal_inner_legs(result)
        for name in ("kappa_1", "kappa_end", "a_1", "a_end"):
            inner = name.partition("_")[0]
            end, others = getattr(self, name), getattr(self, inner)
            if end is not None and end != others:
                text = f"but {name} is {end:g} and {inner} {others:g}."
                raise ArgumentError(f"{result} requires uniform springs and amplitudes, {text}")


TABLE_1 = Chain()


def springs(N: int, chain: Chain) -> jax.Array:
    """Stiffness of each spring, N/m, shape (N,), N >= 2."""
    return _along(N, chain.kappa, chain.kappa_1, chain.kappa_end)


def amplitudes(N: int, chain: Chain) -> jax.Array:
    """Amplitude of each leg, m, shape (N+1,)."""
    return _along(N + 1, chain.a, chain.a_1, chain.a_end)


def masses(N: int, chain: Chain) -> jax.Array:
    """Mass of each leg's segment, kg, shape (N+1,)."""
    return _along(N + 1, chain.m, chain.m_1, chain.m_end)


def _along(n: int, inner: Scalar, first: Scalar | None, last: Scalar | None) -> jax.Array:
    """The values (n,): `inner`, a number or (n-2,), with different ends if given."""
    if jnp.ndim(inner) > 0:
        if first is None or last is None or jnp.shape(inner) != (n - 2,):
            raise ArgumentError(
                f"A profile must have {n - 2} inner values and both ends, not values of shape "
                f"{jnp.shape(inner)}."
            )
        return jnp.concatenate([jnp.asarray(part, float).reshape(-1) for part in (first, inner, last)])
    values = jnp.full(n, jnp.asarray(inner, float))
    values = values if first is None else values.at[0].set(first)
    return values if last is None else values.at[-1].set(last)


def shift(chain: Chain) -> jax.Array:
    """b, rad/kg: the advance of an inner leg's touchdown phase by mass; below eq. (17).

    Raises:
        ArgumentError: the chain has a profile.
    """
    chain.require_equal_inner_legs("b")
    return _shift(chain, chain.kappa, chain.a)


def _shift(chain: Chain, kappa: Scalar, a: Scalar) -> jax.Array:
    """`shift` with another spring (N/m) and another amplitude (m)."""
    return jnp.asarray((1.0 - chain.beta) * chain.g * jnp.pi / (kappa * a))


def end_resets(chain: Chain) -> tuple[jax.Array, jax.Array]:
    """D of the first and of the last leg with neighbours in stance, rad, eqs. (31), (32).

    It is m b with the spring and the amplitude of each end; a profile of the inner legs has no part in it.
    """
    head = _shift(chain, _or(chain.kappa_1, chain.kappa), _or(chain.a_1, chain.a))
    tail = _shift(chain, _or(chain.kappa_end, chain.kappa), _or(chain.a_end, chain.a))
    return jnp.asarray(chain.m_1 * head), jnp.asarray(chain.m_end * tail)


def _or(value: Scalar | None, otherwise: Scalar) -> Scalar:
    """A value of an end, or that of the inner legs if it is not given."""
    if value is None and jnp.ndim(otherwise) > 0:
        raise ArgumentError("A chain with a profile must have kappa_1, kappa_end, a_1 and a_end.")
    return otherwise if value is None else value


def reset(chain: Chain) -> jax.Array:
    """D of every leg along a solution, rad, the paper's m_B b: the larger D of the two ends.

    The other end then touches down with its neighbour in takeoff.
    """
    return jnp.maximum(*end_resets(chain))


def touchdown_phase(chain: Chain) -> jax.Array:
    """The touchdown phase of every leg along a solution, rad; eq. (16)."""
    return TWO_PI - reset(chain)


def lag(chain: Chain) -> jax.Array:
    """delta, rad: the lag between inner neighbours of a wave, without the reset; eq. (17), second row.

    Raises:
        ArgumentError: the chain has a profile, with a lag for each pair (`lag_rules`).
    """
    chain.require_equal_inner_legs("The lag of eq. (17)")
    return jnp.asarray(2.0 * (1.0 - chain.beta) * jnp.pi - 3.0 * reset(chain) + chain.m * shift(chain))


def wavelength(chain: Chain = TABLE_1) -> jax.Array:
    """The wavelength of the swing legs' wave, in leg intervals: C / delta, eq. (27)."""
    return touchdown_phase(chain) / lag(chain)


class Speeds(NamedTuple):
    """The speed of the wave, leg intervals per second: as printed (eq. 28), and with the reset period."""

    printed: jax.Array
    exact: jax.Array


def wave_speed(omega: Scalar, chain: Chain = TABLE_1) -> Speeds:
    """The speeds of the wave for the basic frequency omega (rad/s).

    Eq. (28) uses the period 2 pi / omega; with the reset it is (2 pi - m_B b) / omega.

    Raises:
        ArgumentError: the chain has a profile.
    """
    waves = wavelength(chain)
    return Speeds(printed=waves * omega / TWO_PI, exact=waves * omega / touchdown_phase(chain))


def leg_length(phi: Float[np.ndarray, "*legs"], chain: Chain) -> Float[np.ndarray, "*legs"]:
    """Length of a leg less the longest (m) at phases from 0 to 2 pi (rad); eq. (3)."""
    beta, a = float(chain.beta), float(chain.a)
    past = np.where(phi < (1.0 + beta) * np.pi, phi - 2.0 * beta * np.pi, 2.0 * np.pi - phi)
    return -a * np.maximum(past, 0.0) / ((1.0 - beta) * np.pi)


class Takeoffs(NamedTuple):
    """Phases (rad) of neighbours in takeoff, relative to its beginning, when a leg touches down with D.

    The other neighbour is in stance. `front`, `rear` (N-1,) are for legs 2 .. N, with the neighbour towards
    the head and towards the tail; `first`, `last` are for the ends, with their only neighbour.
    """

    front: jax.Array
    rear: jax.Array
    first: jax.Array
    last: jax.Array


def takeoffs(N: int, chain: Chain) -> Takeoffs:
    """The phases of neighbours in takeoff that follow from eq. (12) for each leg."""
    k = springs(N, chain)
    a = amplitudes(N, chain)
    D = reset(chain)
    head, tail = end_resets(chain)
    weight = (1.0 - chain.beta) * jnp.pi * chain.m * chain.g  # a number, or (N-1,) with a profile
    needed = (k[:-1] + k[1:]) * a[1:-1] * D - weight
    return Takeoffs(
        front=needed / (k[:-1] * a[:-2]),
        rear=needed / (k[1:] * a[2:]),
        first=a[0] * (D - head) / a[1],
        last=a[-1] * (D - tail) / a[-2],
    )
