"""Coordinates on the section of the chain and of its reduced form, leg 1 just landed (Ambe 2021, 3.3)."""

from __future__ import annotations

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from gaitsweep.contract import Chart, Quantity
from gaitsweep.dynamics import wrapped
from gaitsweep.papers.ambe2021.multilegged.state import CONTACT_DEPTH, Params, State

# A leg farther than this (m) from its touchdown height is not on the section.
SECTION_TOLERANCE = 1e-8


@dataclasses.dataclass(frozen=True)
class _ChainChart(Chart):
    """Coordinates on section 1 of a chain with N springs, of which the first N are the relative phases."""

    N: int

    @property
    def conserved(self) -> tuple[Quantity, ...]:
        return (Quantity("E", "rad", "sum of the relative phases, eq. (29)", circular=True),)

    def conserved_values(self, params: Any, at: Float[Array, " coordinates"]) -> Float[Array, " conserved"]:
        return jnp.sum(at[: self.N])[None]


@dataclasses.dataclass(frozen=True)
class MultileggedChart(_ChainChart):
    """4 N + 3 coordinates; the height of mass 1 follows from its phase, since its leg just touches.

    If both ends have the same touchdown phase, E = psi_1 + ... + psi_N is conserved up to terms that the
    reduced theory neglects (eq. 29), also if the inner legs have a profile: fixed points form lines along
    which E varies.
    """

    @property
    def coordinates(self) -> tuple[Quantity, ...]:
        legs, later = range(1, self.N + 2), range(2, self.N + 2)
        pairs = range(1, self.N + 1)
        return (
            *(
                Quantity(f"psi_{i}", "rad", f"phase of leg {i + 1} less that of leg {i}", circular=True)
                for i in pairs
            ),
            Quantity("phi_1", "rad", "phase of leg 1", circular=True),
            *(Quantity(f"x_{i}", "m", f"height of mass {i}") for i in later),
            *(Quantity(f"v_{i}", "m/s", f"velocity of mass {i}") for i in legs),
            *(Quantity(f"y_{i}", "rad/s", f"lag of oscillator {i}") for i in legs),
        )

    def to_coordinates(self, params: Params, state: State) -> Float[Array, " coordinates"]:
        psi = wrapped(state.phi[1:] - state.phi[:-1])
        return jnp.concatenate([psi, state.phi[:1], state.x[1:], state.v, state.y])

    def from_coordinates(self, params: Params, at: Float[Array, " coordinates"], modes: State) -> State:
        n = self.N
        psi, phi_1, x, v, y = jnp.split(at, [n, n + 1, 2 * n + 1, 3 * n + 2])
        phi = _in_segments(jnp.cumsum(jnp.concatenate([phi_1, psi])), modes)
        touching = _touching(params, phi[:1]) - CONTACT_DEPTH
        return dataclasses.replace(modes, phi=phi, x=jnp.concatenate([touching, x]), v=v, y=y)

    def covers(self, params: Params, state: State) -> Bool[Array, ""]:
        """Whether leg 1 has landed; its phase can also pass 2 pi without a landing."""
        gap = state.x[0] - _touching(params, state.phi[0])
        return state.landed & (jnp.abs(gap) < SECTION_TOLERANCE)


@dataclasses.dataclass(frozen=True)
class ReducedChart(_ChainChart):
    """The N relative phases just after the reset of leg 1, whose phase is 0.

    psi_1 is its value on section 1 before the reset plus leg 1's touchdown phase; the others are the same.
    E is conserved if both ends have the same touchdown phase (eqs. 29, 30), also if the inner legs have a
    profile, as long as the neighbours of both ends stand when these touch; then fixed points form lines.
    """

    @property
    def coordinates(self) -> tuple[Quantity, ...]:
        return tuple(
            Quantity(
                f"psi_{i}",
                "rad",
                f"phase of leg {i + 1} less that of leg {i}, just after leg 1's reset",
                circular=True,
            )
            for i in range(1, self.N + 1)
        )

    def to_coordinates(self, params: Any, state: Any) -> Float[Array, " coordinates"]:
        return wrapped(state.phi[1:] - state.phi[:-1])

    def from_coordinates(self, params: Any, at: Float[Array, " coordinates"], modes: Any) -> Any:
        phi = jnp.concatenate([jnp.zeros_like(at[:1]), jnp.cumsum(at)])
        return dataclasses.replace(modes, phi=_in_segments(phi, modes))

    def covers(self, params: Any, state: Any) -> Bool[Array, ""]:
        """Whether leg 1 has landed; its phase can also pass 2 pi without a landing."""
        return state.landed & (state.phi[0] == 0.0)


def _in_segments(phi: jax.Array, modes: Any) -> jax.Array:
    """The phases, shifted by multiples of 2 pi to those of the legs' segments."""
    return modes.phi + wrapped(phi - modes.phi + jnp.pi) - jnp.pi


def _touching(p: Params, phi: jax.Array) -> jax.Array:
    """Length (m) of leg 1 in its landing segment, eq. (3)."""
    return p.L - p.a[0] * (2.0 * jnp.pi - phi) / ((1.0 - p.beta) * jnp.pi)
