"""Fixed steps of the reduced chain that end at the next event, found without a search."""

from __future__ import annotations

import dataclasses

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from gaitsweep.contract import FixedStepDynamics
from gaitsweep.papers.ambe2021.multilegged.mechanics import balance_and_rate
from gaitsweep.papers.ambe2021.multilegged.reduced_state import TOUCHING, State, after_events
from gaitsweep.papers.ambe2021.multilegged.state import LANDING, STANCE, Params, corner_of, leg_lengths

# Steps of a cycle for each spring; with fewer, crossings are detected ever later.
STEPS_A_LEG = 6.25


@dataclasses.dataclass(frozen=True)
class NextEventSteps(FixedStepDynamics):
    """Steps that end at the next event at the latest; later steps catch up with the time.

    The balance of a landing leg is rising and concave: extrapolation at its current rate never overshoots the
    touchdown and reaches it in a few steps, without a search. Results do not depend on dt, except the times
    of crossings: they are late by `late`, less than a step if steps are shorter than a sixteenth of a cycle
    divided by N, the number of springs.
    """

    N: int

    def step(self, params: Params, state: State, dt: Float[Array, ""]) -> State:
        p, s = params, state
        landing = s.segment == LANDING
        length, rate = leg_lengths(p, s.phi, s.segment)
        balance, rise = balance_and_rate(length, p.masses, p.kappa, p.g, rate)
        lifts = s.held & (balance < -TOUCHING)
        armed = landing & ~(s.held & ~lifts)
        due = armed & (balance >= -TOUCHING)

        corner_at = corner_of(p, s.segment)
        to_corner = corner_at - s.phi
        approaching = armed & (rise > 0.0)
        to_touch = jnp.where(approaching, -balance / jnp.where(approaching, rise, 1.0), jnp.inf)
        room = (s.late + dt) * p.omega
        ahead = jnp.minimum(room, jnp.min(jnp.minimum(to_corner, to_touch)))
        ahead = jnp.where(jnp.any(due), 0.0, ahead)
        corner = to_corner <= ahead
        moved = dataclasses.replace(
            s, phi=jnp.where(corner, corner_at, s.phi + ahead), late=s.late + dt - ahead / p.omega
        )
        return after_events(moved, corner, due, lifts)

    def longest_step(self, params: Params) -> Float[Array, ""]:
        """A sixth of the time between two touchdowns, so that steps soon catch up with `late`."""
        return 2.0 * jnp.pi / params.omega / (STEPS_A_LEG * self.N)

    def events(self, params: Params, before: State, after: State) -> Bool[Array, " events"]:
        """Whether leg 1 has ended its cycle; the step itself has applied the jump."""
        return ((before.segment[0] == LANDING) & (after.segment[0] == STANCE))[None]

    def jump(self, params: Params, state: State, fired: Bool[Array, " events"]) -> State:
        return state

    def section(self, params: Params, before: State, fired: Bool[Array, " events"]) -> Bool[Array, ""]:
        return fired[0]
