"""The multi-legged chain reduced to its phases: rigid legs, no inertia, no lag (Ambe 2021, 3.1 and 3.2).

The heights are those of the chain in static equilibrium on its legs (eq. 8), and a phase is reset immediately
at touchdown (eq. 9), so only the phases move, at constant speed. The touchdown of a leg depends on the
heights of the others: with z the chain's shape less that of the freely hanging chain, leg i bears the load
kappa times (least slope to a leg before it - greatest slope to a leg behind it), slopes of z between leg
tips, and is in the air if that number is negative. This is the obstacle problem, solved for each leg with a
sign.

Two ways to run it. With events located (`method: propagator`) times are exact and derivatives can be had.
In steps of its own (`method: semi_implicit`) every step goes to the next event at most, found without search.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from typing import ClassVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Real

from gaitsweep.contract import Chart, FixedStepDynamics, Quantity, Rates, Recommended, Simultaneous
from gaitsweep.dynamics import TWO_PI, wrapped
from gaitsweep.papers.ambe2021.multilegged.forces import balance, balance_and_rate, obstacle_problem
from gaitsweep.papers.ambe2021.multilegged.model import ChainModel
from gaitsweep.papers.ambe2021.multilegged.parameters import chain_parameters
from gaitsweep.papers.ambe2021.multilegged.state import (
    LANDING,
    STANCE,
    Params,
    ReducedChart,
    corner_of,
    first_touchdown,
    leg_lengths,
    segment_of,
    without_touchdown,
)

# A leg closer than this to the ground (m) touches it, so that simultaneous touchdowns stay simultaneous in
# spite of rounding.
CONTACT_TOLERANCE = 1e-13


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class State:
    """Phases phi (N+1,), rad, and the modes.

    `segment` (N+1,) is the segment of each leg's length: stance, takeoff or landing; `held` (N+1,): the leg
    has been on the ground since before its landing segment, and so cannot touch down; `psi` (N,), rad, are
    the relative phases at the last crossing of section 1; `landed`: leg 1 touched down there; `late` (s) is
    the time by which fixed steps are ahead of this state.
    """

    phi: jax.Array
    segment: jax.Array
    held: jax.Array
    psi: jax.Array
    landed: jax.Array
    late: jax.Array


def after_events(s: State, corner: jax.Array, touches: jax.Array, lifts: jax.Array) -> State:
    """The state after legs (N+1,) reach the end of a segment (`corner`), touch down (`touches`), or lift off.

    A leg begins its landing segment as held; if it is not, it lifts off at the same instant.

    Args:
        s: the state before the events.
        corner, touches, lifts: whether each leg does so, (N+1,) bool.
    """
    landing = s.segment == LANDING
    resets = touches & landing
    wraps = corner & landing & ~resets
    ends = resets | wraps
    segment = jnp.where(ends, STANCE, jnp.where(corner, s.segment + 1, s.segment))
    crosses = ends[0]
    psi = wrapped(s.phi[1:] - s.phi[:-1])  # eq. (7), before the reset
    return dataclasses.replace(
        s,
        phi=jnp.where(resets, 0.0, jnp.where(wraps, s.phi - TWO_PI, s.phi)),
        segment=segment,
        held=jnp.where(corner | ends, (segment == LANDING), s.held & ~lifts),
        psi=jnp.where(crosses, psi, s.psi),
        landed=jnp.where(crosses, resets[0], s.landed),
    )


def with_legs_reversed(params: Params, s: State) -> State:
    """The state of the chain with its legs in reversed order."""
    phi = s.phi[::-1]
    psi = wrapped(phi[1:] - phi[:-1])
    return dataclasses.replace(s, phi=phi, segment=s.segment[::-1], held=s.held[::-1], psi=psi)


# The fewest steps of a cycle for each spring; with fewer, crossings are detected ever later.
STEPS_PER_SPRING = 6.25


@dataclasses.dataclass(frozen=True)
class NextEventSteps(FixedStepDynamics):
    """Steps that end at the next event at the latest; later steps catch up with the time.

    The balance of a landing leg is rising and concave: extrapolation at its current rate never overshoots the
    touchdown and reaches it in a few steps, without a search. Results do not depend on dt, except the times
    of crossings: they are late by `late`, some steps if a cycle has `STEPS_PER_SPRING` steps or more for each
    of the N springs. With fewer steps the delay grows.
    """

    N: int

    def step(self, params: Params, state: State, dt: Float[Array, ""]) -> State:
        p, s = params, state
        landing = s.segment == LANDING
        length, rate = leg_lengths(p, s.phi, s.segment)
        load, rise = balance_and_rate(length, p.masses, p.kappa, p.g, rate)
        lifts = s.held & (load < -CONTACT_TOLERANCE)
        armed = landing & ~(s.held & ~lifts)
        due = armed & (load >= -CONTACT_TOLERANCE)

        corner_at = corner_of(p, s.segment)
        to_corner = corner_at - s.phi
        approaching = armed & (rise > 0.0)
        to_touch = jnp.where(approaching, -load / jnp.where(approaching, rise, 1.0), jnp.inf)
        room = (s.late + dt) * p.omega
        ahead = jnp.minimum(room, jnp.min(jnp.minimum(to_corner, to_touch)))
        ahead = jnp.where(jnp.any(due), 0.0, ahead)
        corner = to_corner <= ahead
        moved = dataclasses.replace(
            s, phi=jnp.where(corner, corner_at, s.phi + ahead), late=s.late + dt - ahead / p.omega
        )
        return after_events(moved, corner, due, lifts)

    def longest_step(self, params: Params) -> Float[Array, ""]:
        """The longest step (s) with which steps catch up with `late`, about a sixth of a cycle over N."""
        return 2.0 * jnp.pi / params.omega / (STEPS_PER_SPRING * self.N)

    def events(self, params: Params, before: State, after: State) -> Bool[Array, " events"]:
        """Whether leg 1 has ended its cycle; the step itself has applied the jump."""
        return ((before.segment[0] == LANDING) & (after.segment[0] == STANCE))[None]

    def jump(self, params: Params, state: State, fired: Bool[Array, " events"]) -> State:
        return state

    def section(self, params: Params, before: State, fired: Bool[Array, " events"]) -> Bool[Array, ""]:
        return fired[0]


# A leg leaves the ground if its load is negative; with this offset 0 is still contact.
SMALLEST_LOAD = 1e-300
# Parameters of the full model alone, which stay among those of the reduced one so that jobs suit both.
_UNUSED = ("sigma", "K", "D", "tau", "clamp")


@dataclasses.dataclass(frozen=True)
class MultileggedReduced(ChainModel):
    """The reduced chain of N + 1 legs, with the parameters, observables and gaits of the full model."""

    name: ClassVar[str] = "multilegged_reduced"
    linear: ClassVar[bool] = True
    # neighbours that touch down at one instant are both reset: the first reset would take the other's load
    # away
    simultaneous: ClassVar[Simultaneous] = "together"

    @property
    def parameters(self) -> tuple[Quantity, ...]:
        parameters = {quantity.name: quantity for quantity in chain_parameters(self.N, profile=self.profile)}
        for name in _UNUSED:
            meaning = f"{parameters[name].meaning}; without effect here"
            parameters[name] = dataclasses.replace(parameters[name], meaning=meaning)
        return tuple(parameters.values())

    @property
    def signals(self) -> tuple[Quantity, ...]:
        legs = range(1, self.N + 2)
        return (*self._signals_of_legs(), *(Quantity(f"load_{i}", "N", f"load on leg {i}") for i in legs))

    def chart(self) -> Chart | None:
        return ReducedChart(self.N)

    def symmetries(self) -> Mapping[str, Callable[[Params, State], State]]:
        # of a chain whose masses and lifts are the same from either end (eq. 23)
        return {"legs in reversed order": with_legs_reversed}

    def fixed_step_scheme(self) -> FixedStepDynamics:
        return NextEventSteps(self.N)

    def init(self, params: Params, start: Mapping[str, Float[Array, ""]]) -> State:
        p = params
        touching = jnp.isnan(start["phi_1"])
        touchdown = first_touchdown(p)
        psi = jnp.stack([start[f"psi_{i}"] for i in range(1, self.N + 1)])
        first = jnp.where(touching, touchdown, start["phi_1"])
        phi = wrapped(jnp.concatenate([first[None], first + jnp.cumsum(psi)]))
        leg_1 = touching & ~jnp.isnan(touchdown) & (jnp.arange(self.N + 1) == 0)
        segment = jnp.where(leg_1, STANCE, segment_of(p, phi))
        # as in the full model, a leg with a load before the reset of leg 1 is on the ground
        length, _ = leg_lengths(p, phi, jnp.where(leg_1, LANDING, segment))
        return State(
            phi=jnp.where(leg_1, 0.0, phi),
            segment=segment,
            held=(segment == LANDING) & (balance(length, p.masses, p.kappa, p.g) > CONTACT_TOLERANCE),
            psi=wrapped(psi),
            landed=touching,
            late=jnp.zeros_like(touchdown),
        )

    def without_start(self, params: Params, state: State) -> dict[str, jax.Array]:
        return without_touchdown(state.phi)

    def flow(self, params: Params, state: State) -> Rates:
        return {"phi": jnp.broadcast_to(params.omega, state.phi.shape)}  # eq. (9)

    @property
    def recommended(self) -> Recommended:
        return Recommended("semi_implicit")

    def fast_modes(self, params: Params) -> tuple[Float[Array, " motions"], Float[Array, " motions"]]:
        """Phases move at constant speed; this rate limits a step to the time between touchdowns."""
        rate = 20.0 / NextEventSteps(self.N).longest_step(params)
        return rate[None], jnp.ones((1,), rate.dtype)

    def guards(self, params: Params, state: State) -> Float[Array, " guards"]:
        """Each leg's phase relative to the end of its segment, then its touchdown, or lift-off if held."""
        p, s = params, state
        length, _ = leg_lengths(p, s.phi, s.segment)
        load = balance(length, p.masses, p.kappa, p.g)
        touch = jnp.where(s.held, -load - SMALLEST_LOAD, load)
        return jnp.concatenate(
            [s.phi - corner_of(p, s.segment), jnp.where(s.segment == LANDING, touch, -1.0)]
        )

    def jump(self, params: Params, state: State, fired: Bool[Array, " events"]) -> State:
        corner, switched = fired[: self.N + 1], fired[self.N + 1 :]
        return after_events(state, corner, switched & ~state.held, switched & state.held)

    def section(self, params: Params, before: State, fired: Bool[Array, " events"]) -> Bool[Array, ""]:
        """Leg 1's touchdown, or the wrap of its phase if there was none."""
        resets = fired[self.N + 1] & ~before.held[0]
        return (before.segment[0] == LANDING) & (resets | fired[0])

    def observe(self, params: Params, state: State) -> dict[str, Real[Array, ""]]:
        return self._observed(state.psi, state.landed)

    def signal(self, params: Params, state: State) -> dict[str, Real[Array, ""]]:
        length, _ = leg_lengths(params, state.phi, state.segment)
        x, load = obstacle_problem(length, params.masses, params.kappa, params.g)
        contact = (load > 0.0).astype(x.dtype)
        return self._signalled({"phase": state.phi, "x": x, "l": length, "contact": contact, "load": load})

    def failed(self, params: Params, state: State) -> Bool[Array, ""]:
        """Never: a mass cannot be below the tip of its leg.

        Legs of zero length (a >= L) are allowed, unlike in the full model, since no equation depends on them.
        """
        return jnp.asarray(False)
