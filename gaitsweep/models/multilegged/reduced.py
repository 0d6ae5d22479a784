"""The multi-legged chain reduced to its phases: rigid legs, no inertia, no lag (Ambe 2021, 3.1 and 3.2).

The heights are those of the chain at rest on its legs (eq. 8), and a phase is reset at once where its leg
touches (eq. 9), so nothing moves but the phases, at constant speed. A leg touches where the heights of the
other legs say so: with z the chain's shape less that of the chain hanging free, leg i bears the load kappa
times (least slope to a leg before it - greatest slope to a leg behind it), slopes of z between leg tips, and
is in the air where that number is negative. That is the obstacle problem, leg by leg and with a sign.

Two ways to run it. With events located (`method: exact`) times are exact and derivatives can be had. In steps
of its own (`method: semi_implicit`) every step goes to the next event at most, found without search.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import ClassVar

import jax
import jax.numpy as jnp

from gaitsweep.contract import Chart, FixedStepDynamics, Quantity, Rates, Recommended
from gaitsweep.dynamics.phase_oscillator import TWO_PI, wrapped
from gaitsweep.models.multilegged.model import LANDING, STANCE, STRICTLY, TAKEOFF, Multilegged, Params
from gaitsweep.models.multilegged.reduced_chart import ReducedChart
from gaitsweep.models.multilegged.reduced_state import TOUCHING, State, after_events, corner_of
from gaitsweep.models.multilegged.reduced_steps import ToTheNextEvent
from gaitsweep.models.multilegged.theory.obstacle import balance, obstacle_problem

_UNREAD = ("sigma", "K", "D", "tau", "clamp")


@dataclasses.dataclass(frozen=True)
class MultileggedReduced(Multilegged):
    """The reduced chain of N + 1 legs; parameters, starts, observables and gaits are the full model's."""

    name: ClassVar[str] = "multilegged_reduced"
    linear: ClassVar[bool] = True

    @property
    def parameters(self) -> tuple[Quantity, ...]:
        return tuple(
            dataclasses.replace(quantity, meaning=f"{quantity.meaning}; without effect here")
            if quantity.name in _UNREAD
            else quantity
            for quantity in super().parameters
        )

    @property
    def signals(self) -> tuple[Quantity, ...]:
        legs = range(1, self.N + 2)
        return (*super().signals, *(Quantity(f"load_{i}", "N", f"load on leg {i}") for i in legs))

    def chart(self) -> Chart | None:
        return ReducedChart(self.N)

    def in_steps(self) -> FixedStepDynamics:
        return ToTheNextEvent(self)

    def init(self, params: Params, start: Mapping[str, jax.Array]) -> State:  # type: ignore[override]
        p = params
        touching = jnp.isnan(start["phi_1"])
        b = (1.0 - p.beta) * p.g * jnp.pi / (p.kappa[0] * p.a[0])  # below eq. (17)
        touchdown = TWO_PI - p.masses[0] * b  # eq. (31)
        # outside the model's conditions (m g/kappa < a) leg 1 has no touchdown in its landing segment
        touchdown = jnp.where(touchdown > (1.0 + p.beta) * jnp.pi, touchdown, jnp.nan)
        psi = jnp.stack([start[f"psi_{i}"] for i in range(1, self.N + 1)])
        first = jnp.where(touching, touchdown, start["phi_1"])
        phi = wrapped(jnp.concatenate([first[None], first + jnp.cumsum(psi)]))
        leg_1 = touching & ~jnp.isnan(touchdown) & (jnp.arange(self.N + 1) == 0)
        segment = jnp.where(
            (phi <= 2.0 * p.beta * jnp.pi) | leg_1,
            STANCE,
            jnp.where(phi < (1.0 + p.beta) * jnp.pi, TAKEOFF, LANDING),
        )
        # as in the full model, a leg is on the ground that bears a load before leg 1 is reset
        length, _ = self._leg(p, phi, jnp.where(leg_1, LANDING, segment))
        return State(
            phi=jnp.where(leg_1, 0.0, phi),
            segment=segment,
            held=(segment == LANDING) & (balance(length, p.masses, p.kappa, p.g) > TOUCHING),
            psi=wrapped(psi),
            landed=touching,
            late=jnp.zeros_like(touchdown),
        )

    def flow(self, params: Params, state: State) -> Rates:  # type: ignore[override]
        return {"phi": jnp.broadcast_to(params.omega, state.phi.shape)}  # eq. (9)

    @property
    def recommended(self) -> Recommended:
        return Recommended("semi_implicit")

    def fast_modes(self, params: Params) -> tuple[jax.Array, jax.Array]:
        """The phases turn evenly, at a rate of zero; steps of 1 over this rate are the legs' time apart."""
        rate = 20.0 / ToTheNextEvent(self).longest_step(params)
        return rate[None], jnp.ones((1,), rate.dtype)

    def guards(self, params: Params, state: State) -> jax.Array:  # type: ignore[override]
        """Each leg's phase against the end of its segment, then its touchdown, or its lift-off if held."""
        p, s = params, state
        length, _ = self._leg(p, s.phi, s.segment)
        load = balance(length, p.masses, p.kappa, p.g)
        touch = jnp.where(s.held, -load - STRICTLY, load)
        return jnp.concatenate([s.phi - corner_of(p, s), jnp.where(s.segment == LANDING, touch, -1.0)])

    def jump(self, params: Params, state: State, fired: jax.Array) -> State:  # type: ignore[override]
        corner, switched = fired[: self.N + 1], fired[self.N + 1 :]
        return after_events(state, corner, switched & ~state.held, switched & state.held)

    def section(self, params: Params, before: State, fired: jax.Array) -> jax.Array:  # type: ignore[override]
        """Leg 1's touchdown, or its wrap where it has had none."""
        resets = fired[self.N + 1] & ~before.held[0]
        return (before.segment[0] == LANDING) & (resets | fired[0])

    def observe(self, params: Params, state: State) -> dict[str, jax.Array]:  # type: ignore[override]
        observed = {f"psi_{i + 1}": state.psi[i] for i in range(self.N)}
        return {**observed, "landed": state.landed.astype(state.psi.dtype)}

    def signal(self, params: Params, state: State) -> dict[str, jax.Array]:  # type: ignore[override]
        length, _ = self._leg(params, state.phi, state.segment)
        x, load = obstacle_problem(length, params.masses, params.kappa, params.g)
        contact = (load > 0.0).astype(x.dtype)
        rows = {"phase": state.phi, "x": x, "l": length, "contact": contact, "load": load}
        return {f"{name}_{i + 1}": row[i] for name, row in rows.items() for i in range(self.N + 1)}

    def failed(self, params: Params, state: State) -> jax.Array:  # type: ignore[override]
        """Never: masses come down to their legs' tips at most. Legs without length (a >= L) walk on, as in
        the full model: no equation knows of them."""
        return jnp.asarray(False)
