"""Coordinates of the reduced chain's section: leg 1 has just been reset."""

from __future__ import annotations

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp

from gaitsweep.contract import Chart, Quantity
from gaitsweep.dynamics.phase_oscillator import wrapped


@dataclasses.dataclass(frozen=True)
class ReducedChart(Chart):
    """The relative phases just after leg 1's reset, N numbers: leg 1 stands at phase 0.

    psi_1 is that of section 1, read before the reset, plus leg 1's touchdown phase; the others are the same.
    E is conserved as long as both ends touch at one phase (eqs. 29, 30), so fixed points form lines.
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
        # the turn of each phase is that of the segment which its leg is in
        phi = modes.phi + wrapped(phi - modes.phi + jnp.pi) - jnp.pi
        return dataclasses.replace(modes, phi=phi)

    def holds(self, params: Any, state: Any) -> jax.Array:
        """Leg 1 has landed; its phase can also have gone by 2 pi without."""
        return state.landed & (state.phi[0] == 0.0)

    def conserved_values(self, params: Any, at: jax.Array) -> jax.Array:
        return jnp.sum(at)[None]
