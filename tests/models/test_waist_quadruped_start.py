"""The end of the quadruped's start: delta_13 is released at T_hold, anywhere inside a step."""

from __future__ import annotations

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from gaitsweep.engine.advance import advance
from gaitsweep.engine.carry import start
from gaitsweep.engine.numerics import Numerics
from gaitsweep.engine.recorders.recordings import TraceRecorder
from gaitsweep.papers.aoi2011.waist_quadruped import WaistQuadruped
from gaitsweep.papers.aoi2011.waist_quadruped.bodies import WaistTreeBody
from gaitsweep.papers.aoi2011.waist_quadruped.rhythm import phase_rates
from gaitsweep.papers.aoi2011.waist_quadruped.semi_implicit import SemiImplicit
from tests.support.sweeping import run_rows, scalars

# How far delta_13 is from what is wanted (rad), the pull (rad/s), when it ends, and when to look (s).
AWAY, K_HOLD, T_HOLD, END = 0.6, 20.0, np.array([0.02137, 0.0249, 0.0301]), 0.04


class Hung(WaistQuadruped):
    """The quadruped with its body held where it is: its phases alone move."""

    def flow(self, params: Any, state: Any) -> Any:
        held = jnp.where(state.held, params.K_hold, 0.0)
        still = {"q": jnp.zeros_like(state.q), "v": jnp.zeros_like(state.v)}
        return {**still, "phi": phase_rates(params, state, held), "clock": jnp.ones_like(state.clock)}


class HungBody(WaistTreeBody):
    """The same for steps of fixed length."""

    def moved(self, m: Any, s: Any, tau: Any, forces: Any, dt: Any) -> Any:
        return s.q, s.v


MODEL = Hung()
PARAMS = scalars(MODEL, K_hold=K_HOLD, resetting=0.0)


def begun(T_hold: jax.Array) -> tuple[Any, Any]:
    params = dataclasses.replace(PARAMS, T_hold=T_hold)
    state = MODEL.init(params, {"delta_13": jnp.asarray(2.2)})
    return params, dataclasses.replace(state, held_lead=state.held_lead - AWAY)


def left(state: Any) -> jax.Array:
    return state.phi[0] - state.phi[2] - state.held_lead


def located(T_hold: jax.Array, dt: jax.Array) -> tuple[jax.Array, jax.Array]:
    attempt = advance(MODEL, Numerics(method="rk4").resolve(MODEL))

    def tried(_: Any, carry: Any) -> Any:
        return attempt(params, dataclasses.replace(carry, halt=jnp.zeros_like(carry.halt)))

    params, state = begun(T_hold)
    end = jax.lax.fori_loop(0, 300, tried, start(MODEL, params, state, dt=dt, stop=END))
    return left(end.state), end.state.held


def in_steps(T_hold: jax.Array, dt: jax.Array) -> tuple[jax.Array, jax.Array]:
    steps = SemiImplicit(HungBody())
    params, state = begun(T_hold)
    end = jax.lax.fori_loop(0, jnp.round(END / dt).astype(int), lambda _, s: steps.step(params, s, dt), state)
    return left(end), end.held


@pytest.mark.slow
@pytest.mark.parametrize(
    ("found", "dt", "order"), [(located, [1e-3, 5e-4], 4), (in_steps, [5e-4, 2.5e-4], 1)]
)
def test_the_order_of_convergence_across_T_hold(found: Any, dt: list[float], order: int) -> None:
    """Until T_hold x' = -2 K_hold sin x, x = delta_13 - wanted, so tan(x/2) decays; then x is constant.

    An order within 0.3 at every T_hold: none of them lies at a step's end, where alone a switch in the flow
    would leave it.
    """
    exact = 2.0 * np.arctan(np.tan(0.5 * AWAY) * np.exp(-2.0 * K_HOLD * T_HOLD))
    grid = jax.jit(jax.vmap(jax.vmap(found, in_axes=(0, None)), in_axes=(None, 0)))
    x, held = grid(jnp.array(T_HOLD), jnp.array(dt))
    errors = np.abs(np.asarray(x) - exact)
    assert not held.any()
    np.testing.assert_allclose(np.log2(errors[0] / errors[1]), order, atol=0.3)
    assert errors[1].max() < (1e-9 if order == 4 else 1e-2)


@pytest.mark.slow
def test_the_start_ends_at_an_instant() -> None:
    """Phases in steps of 0.2 and 0.1 ms agree to 1e-8 rad past T_grow and T_hold, before a foot lands.

    The pull as a switch inside the flow leaves 4e-5 there.
    """
    model, found = WaistQuadruped(), []
    for dt in (2e-4, 1e-4):
        rows = run_rows(
            model,
            TraceRecorder(model, 0.225, 0.225),
            {"delta_13": np.array([2.2])},
            params={"T_grow": 0.12345, "T_hold": 0.21337},
            numerics=Numerics(dt=dt),
            engine="kernel",
        )
        found.append(rows.samples[-1, 1:5])
    np.testing.assert_allclose(*found, rtol=0.0, atol=1e-8)
