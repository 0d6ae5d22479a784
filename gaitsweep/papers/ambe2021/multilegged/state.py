"""Parameters and state of the chain, and coordinates on its section, leg 1 just landed (Ambe 2021, 3.3)."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from gaitsweep.contract import Chart, Quantity
from gaitsweep.dynamics import TWO_PI, wrapped

if TYPE_CHECKING:
    from gaitsweep.papers.ambe2021.multilegged.reduced import State as ReducedState


STANCE, TAKEOFF, LANDING = 0, 1, 2
# m. Leg 1 is initially compressed by a picometre (1e-7 N), so that it touches in spite of rounding. Another
# leg that is compressed by less is in the air, so that it touches down at once if it is landing.
CONTACT_DEPTH = 1e-12


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Params:
    """Parameters as in the equations; units as in `PARAMETERS`, arrays from head to tail.

    `kappa` (N,) is that of each spring; `masses` and `a` (N+1,) are those of each leg; `m` is the mass of an
    inner leg, with a profile the mass to which those of the inner legs refer.
    """

    beta: jax.Array
    kappa: jax.Array
    sigma: jax.Array
    masses: jax.Array
    m: jax.Array
    a: jax.Array
    L: jax.Array
    K: jax.Array
    D: jax.Array
    omega: jax.Array
    tau: jax.Array
    g: jax.Array
    clamp: jax.Array


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class State:
    """Heights x (m), velocities v (m/s), phases phi (rad), lags y (rad/s), each (N+1,), and the modes.

    `contact` (N+1,) bool; `segment` (N+1,) is the segment of each leg's length: stance, takeoff or landing;
    `landed`: leg 1 has had its landing contact in this cycle.
    """

    x: jax.Array
    v: jax.Array
    phi: jax.Array
    y: jax.Array
    contact: jax.Array
    segment: jax.Array
    landed: jax.Array


def corner_of(p: Params, segment: jax.Array) -> jax.Array:
    """Phase at the end of each leg's segment, rad."""
    takeoff = jnp.where(segment == TAKEOFF, (1.0 + p.beta) * jnp.pi, TWO_PI)
    return jnp.where(segment == STANCE, 2.0 * p.beta * jnp.pi, takeoff)


def first_touchdown(p: Params) -> jax.Array:
    """Touchdown phase of leg 1 with its neighbour in stance, rad, eq. (31); NaN if it has none in landing."""
    b = (1.0 - p.beta) * p.g * jnp.pi / (p.kappa[0] * p.a[0])  # below eq. (17)
    touchdown = TWO_PI - p.masses[0] * b
    # outside the model's conditions (m g/kappa < a) leg 1 has no touchdown in its landing segment
    return jnp.where(touchdown > (1.0 + p.beta) * jnp.pi, touchdown, jnp.nan)


def without_touchdown(phi: jax.Array) -> dict[str, jax.Array]:
    """The result of `Model.without_start` for a start with the phases `phi` (N+1,)."""
    reason = "leg 1 does not touch down in its landing segment with these parameters: give phi_1"
    return {reason: jnp.isnan(phi[0])}


def segment_of(p: Params, phi: jax.Array) -> jax.Array:
    """The segment of each leg's length at phases from 0 to 2 pi, rad."""
    return jnp.where(
        phi <= 2.0 * p.beta * jnp.pi, STANCE, jnp.where(phi < (1.0 + p.beta) * jnp.pi, TAKEOFF, LANDING)
    )


def leg_lengths(p: Params, phi: jax.Array, segment: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Length of each leg (m) and its derivative by the phase (m/rad), eq. (3).

    Each segment is a straight line, `origin + rate * phi`. `origin` and `rate` are selected independently
    of the phase, so once for all stages of a step.

    Args:
        p: parameters.
        phi: phases of the legs, (N+1,) rad.
        segment: segments of the legs, (N+1,).
    """
    slope = p.a / ((1.0 - p.beta) * jnp.pi)
    takeoff = p.L + slope * (2.0 * p.beta * jnp.pi)
    landing = p.L - slope * TWO_PI
    origin = jnp.where(segment == STANCE, p.L, jnp.where(segment == TAKEOFF, takeoff, landing))
    rate = jnp.where(segment == STANCE, 0.0, jnp.where(segment == TAKEOFF, -slope, slope))
    return origin + rate * phi, rate


def lagged_reset(phi: Float[Array, " ..."], tau: Float[Array, " ..."]) -> Float[Array, " ..."]:
    """The jump of the lag variable y (rad/s) that finally moves the phase phi (rad) to 2 pi.

    The lag tau y' = -y + u responds to the impulse u = (2 pi - phi) delta(t) by a jump of y; phi is
    continuous (eq. (5), (6)).

    Args:
        phi: the phase at touchdown, rad.
        tau: the time constant of the lag, s.
    """
    return (TWO_PI - phi) / tau


# A leg farther than this (m) from its touchdown height is not on the section.
SECTION_TOLERANCE = 1e-8


@dataclasses.dataclass(frozen=True)
class _ChainChart(Chart):
    """Coordinates on section 1 of a chain with N springs, of which the first N are the relative phases."""

    N: int

    @property
    def conserved(self) -> tuple[Quantity, ...]:
        return (Quantity("E", "rad", "sum of the relative phases, eq. (29)", circular=True),)

    def conserved_values(
        self, params: Params, at: Float[Array, " coordinates"]
    ) -> Float[Array, " conserved"]:
        return jnp.sum(at[: self.N])[None]

    def _psi(self, when: str = "") -> tuple[Quantity, ...]:
        """The relative phases; `when` ends their meaning."""
        return tuple(
            Quantity(f"psi_{i}", "rad", f"phase of leg {i + 1} less that of leg {i}{when}", circular=True)
            for i in range(1, self.N + 1)
        )


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
        return (
            *self._psi(),
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
        return self._psi(", just after leg 1's reset")

    def to_coordinates(self, params: Params, state: ReducedState) -> Float[Array, " coordinates"]:
        return wrapped(state.phi[1:] - state.phi[:-1])

    def from_coordinates(
        self, params: Params, at: Float[Array, " coordinates"], modes: ReducedState
    ) -> ReducedState:
        phi = jnp.concatenate([jnp.zeros_like(at[:1]), jnp.cumsum(at)])
        return dataclasses.replace(modes, phi=_in_segments(phi, modes))

    def covers(self, params: Params, state: ReducedState) -> Bool[Array, ""]:
        """Whether leg 1 has landed; its phase can also pass 2 pi without a landing."""
        return state.landed & (state.phi[0] == 0.0)


def _in_segments(phi: jax.Array, modes: State | ReducedState) -> jax.Array:
    """The phases, shifted by multiples of 2 pi to those of the legs' segments."""
    return modes.phi + wrapped(phi - modes.phi + jnp.pi) - jnp.pi


def _touching(p: Params, phi: jax.Array) -> jax.Array:
    """Length (m) of leg 1 in its landing segment, eq. (3)."""
    return p.L - p.a[0] * (2.0 * jnp.pi - phi) / ((1.0 - p.beta) * jnp.pi)
