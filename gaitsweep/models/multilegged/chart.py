"""Coordinates of the chain's section: leg 1 has just touched down (Ambe et al. 2021, sec. 3.3)."""

from __future__ import annotations

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp

from gaitsweep.contract import Chart, Quantity
from gaitsweep.dynamics.phase_oscillator import wrapped

# A leg that stands this far (m) from where it would just touch is not on the section.
CLOSE = 1e-8
# Leg 1 is pressed in by a picometre, so that rounding does not make it leave the ground.
PRESSED = 1e-12


@dataclasses.dataclass(frozen=True)
class MultileggedChart(Chart):
    """4 N + 3 numbers: the height of leg 1's mass follows from its phase, since its leg just touches.

    With equal masses at both ends E = psi_1 + ... + psi_N is conserved but for what the reduced theory
    neglects (eq. 29): fixed points form lines along which E changes.
    """

    N: int

    @property
    def coordinates(self) -> tuple[Quantity, ...]:
        legs, later = range(1, self.N + 2), range(2, self.N + 2)
        pairs = range(1, self.N + 1)
        return (
            *(
                Quantity(f"psi_{i}", "rad", f"relative phase phi_{i + 1} - phi_{i}", circular=True)
                for i in pairs
            ),
            Quantity("phi_1", "rad", "phase of leg 1", circular=True),
            *(Quantity(f"x_{i}", "m", f"height of mass {i}") for i in later),
            *(Quantity(f"v_{i}", "m/s", f"velocity of mass {i}") for i in legs),
            *(Quantity(f"y_{i}", "rad/s", f"lag of oscillator {i}") for i in legs),
        )

    @property
    def conserved(self) -> tuple[Quantity, ...]:
        return (Quantity("E", "rad", "sum of the relative phases, eq. (29)", circular=True),)

    def read(self, params: Any, state: Any) -> jax.Array:
        psi = wrapped(state.phi[1:] - state.phi[:-1])
        return jnp.concatenate([psi, state.phi[:1], state.x[1:], state.v, state.y])

    def place(self, params: Any, at: jax.Array, modes: Any) -> Any:
        n = self.N
        psi, phi_1, x, v, y = jnp.split(at, [n, n + 1, 2 * n + 1, 3 * n + 2])
        phi = jnp.cumsum(jnp.concatenate([phi_1, psi]))
        # the turn of each phase is that of the segment which its leg is in
        phi = modes.phi + wrapped(phi - modes.phi + jnp.pi) - jnp.pi
        touching = _touching(params, phi[:1]) - PRESSED
        return dataclasses.replace(modes, phi=phi, x=jnp.concatenate([touching, x]), v=v, y=y)

    def holds(self, params: Any, state: Any) -> jax.Array:
        """Leg 1 has landed; its phase can also have gone by 2 pi without."""
        gap = state.x[0] - _touching(params, state.phi[0])
        return state.landed & (jnp.abs(gap) < CLOSE)

    def conserved_values(self, params: Any, at: jax.Array) -> jax.Array:
        return jnp.sum(at[: self.N])[None]


def _touching(p: Any, phi: jax.Array) -> jax.Array:
    """Length (m) of leg 1 in its landing segment, eq. (3)."""
    return p.L - p.a[0] * (2.0 * jnp.pi - phi) / ((1.0 - p.beta) * jnp.pi)
