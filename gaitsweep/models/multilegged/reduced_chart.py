"""Coordinates on the reduced chain's section, just after the phase reset of leg 1."""

from __future__ import annotations

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp

from gaitsweep.contract import Chart, Quantity
from gaitsweep.dynamics.phase_oscillator import wrapped


@dataclasses.dataclass(frozen=True)
class ReducedChart(Chart):
    """The N relative phases just after the reset of leg 1, whose phase is 0.

    psi_1 is its value on section 1 before the reset plus leg 1's touchdown phase; the others are the same.
    E is conserved if both ends have the same touchdown phase (eqs. 29, 30); then fixed points form lines.
    """

    N: int

    @property
    def coordinates(self) -> tuple[Quantity, ...]:
        return tuple(
            Quantity(f"psi_{i}", "rad", f"phi_{i + 1} - phi_{i} just after leg 1's reset", circular=True)
            for i in range(1, self.N + 1)
        )

    @property
    def conserved(self) -> tuple[Quantity, ...]:
        return (Quantity("E", "rad", "sum of the relative phases, eq. (29)", circular=True),)

    def read(self, params: Any, state: Any) -> jax.Array:
        return wrapped(state.phi[1:] - state.phi[:-1])

    def place(self, params: Any, at: jax.Array, modes: Any) -> Any:
        phi = jnp.concatenate([jnp.zeros_like(at[:1]), jnp.cumsum(at)])
        # multiples of 2 pi are those of the leg's segment
        phi = modes.phi + wrapped(phi - modes.phi + jnp.pi) - jnp.pi
        return dataclasses.replace(modes, phi=phi)

    def holds(self, params: Any, state: Any) -> jax.Array:
        """Whether leg 1 has landed; its phase can also pass 2 pi without a landing."""
        return state.landed & (state.phi[0] == 0.0)

    def conserved_values(self, params: Any, at: jax.Array) -> jax.Array:
        return jnp.sum(at)[None]
