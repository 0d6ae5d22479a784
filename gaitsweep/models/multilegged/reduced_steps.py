"""The reduced multi-legged chain in steps that end at its next event, found without a search."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING

import jax
import jax.numpy as jnp

from gaitsweep.contract import FixedStepDynamics
from gaitsweep.models.multilegged.model import LANDING, STANCE, Params
from gaitsweep.models.multilegged.reduced_state import TOUCHING, State, after_events, corner_of
from gaitsweep.models.multilegged.theory.obstacle import balance_and_rate

if TYPE_CHECKING:
    from gaitsweep.models.multilegged.reduced import MultileggedReduced

# Steps of a cycle for each spring; with fewer, crossings are seen later and later.
STEPS_A_LEG = 6.25


@dataclasses.dataclass(frozen=True)
class ToTheNextEvent(FixedStepDynamics):
    """Steps that end at the next event at the latest; the rest of a step is made up for by later ones.

    While a leg lands its balance rises, and is concave: the secant of its momentary rate never overshoots
    the touchdown and reaches it in a few steps, without a search. Results do not depend on dt; only the times
    of crossings do, which are late by `late` and right to a step while steps are shorter than a sixteenth of
    a cycle over N.
    """

    model: MultileggedReduced

    def step(self, params: Params, state: State, dt: jax.Array) -> State:
        p, s = params, state
        landing = s.segment == LANDING
        length, rate = self.model._leg(p, s.phi, s.segment)
        balance, rise = balance_and_rate(length, p.masses, p.kappa, p.g, rate)
        lifts = s.held & (balance < -TOUCHING)
        armed = landing & ~(s.held & ~lifts)
        due = armed & (balance >= -TOUCHING)

        corner_at = corner_of(p, s)
        to_corner = corner_at - s.phi
        approaching = armed & (rise > 0.0)
        to_touch = jnp.where(approaching, -balance / jnp.where(approaching, rise, 1.0), jnp.inf)
        room = (s.late + dt) * p.omega
        ahead = jnp.minimum(room, jnp.min(jnp.minimum(to_corner, to_touch)))
        ahead = jnp.where(jnp.any(due), 0.0, ahead)
        corner = to_corner <= ahead
        moved = dataclasses.replace(
            s,
            phi=jnp.where(corner, corner_at, s.phi + ahead),
            late=s.late + dt - ahead / p.omega,
        )
        return after_events(moved, corner, due, lifts)

    def longest_step(self, params: Params) -> jax.Array:
        """A sixth of the time between two legs' touchdowns, so that `late` is soon made up for."""
        return 2.0 * jnp.pi / params.omega / (STEPS_A_LEG * self.model.N)

    def events(self, params: Params, before: State, after: State) -> jax.Array:
        """Whether leg 1 ended its cycle, which the step has worked in already."""
        return ((before.segment[0] == LANDING) & (after.segment[0] == STANCE))[None]

    def jump(self, params: Params, state: State, fired: jax.Array) -> State:
        return state

    def section(self, params: Params, before: State, fired: jax.Array) -> jax.Array:
        return fired[0]
