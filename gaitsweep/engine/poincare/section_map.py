"""One trajectory from one section crossing to the next, as a function that JAX can differentiate."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from functools import lru_cache
from typing import Any

import jax
import jax.numpy as jnp

from gaitsweep.contract import Model, Params, State
from gaitsweep.engine.advance import CROSSING, GOING, advance, stalled, start
from gaitsweep.engine.numerics import Numerics, step_of
from gaitsweep.engine.poincare.poincare_return import LATEST, Flight
from gaitsweep.engine.recorders.recorder import ATTEMPTS_PER_STEP
from gaitsweep.errors import ArgumentError

Crossing = Callable[[Params, State], tuple[jax.Array, State, jax.Array]]


def next_crossing(
    model: Model, numerics: Numerics, *, events: bool = False, sensitivities: bool = True
) -> Crossing:
    """The function `(params, state) -> (t, state, found)` up to the next section crossing.

    `t` is the time that it takes (s), `state` the one just after the crossing's jump, `found` False where
    no crossing came within four nominal periods, or events stalled the trajectory. Forward-mode derivatives
    (`jax.jvp`, `jax.jacfwd`) are right through all events where `sensitivities` is set; the events' own times
    are among them.

    Args:
        model, numerics: what is integrated and how.
        events: stop after the first jump of any kind, not only at the section.
        sensitivities: see `gaitsweep.engine.advance.advance`.
    """
    numerics = numerics.of(model)
    attempt = advance(model, numerics, sensitivities=sensitivities)

    def run(params: Params, state: State) -> tuple[jax.Array, State, jax.Array]:
        dt = step_of(model, numerics, params)
        carry = start(model, params, state, dt=dt, stop=LATEST * model.period(params))
        limit = ATTEMPTS_PER_STEP * (carry.stop / dt * numerics.steps_in_longest + 1000.0)

        def goes_on(carry):
            jumped = events & (carry.chain > 0)
            return (carry.halt == GOING) & ~jumped & ~stalled(carry) & (carry.attempts <= limit)

        carry = jax.lax.while_loop(goes_on, lambda c: attempt(params, c), carry)
        found = (carry.halt == CROSSING) | (events & (carry.chain > 0))
        return carry.t, carry.state, jnp.asarray(found)

    return run


def flown(flight: Flight) -> Crossing:
    """The function `(params, state) -> (t, state, way)` of a flight by XLA, a loop over its attempts.

    `way` is a `gaitsweep.engine.poincare.poincare_return.Way`.
    """

    def run(params: Params, state: State) -> tuple[jax.Array, State, jax.Array]:
        aloft = jax.lax.while_loop(
            lambda aloft: ~flight.ended(aloft),
            lambda aloft: flight.attempt(params, aloft),
            flight.begin(params, state),
        )
        return aloft.carry.t, aloft.carry.state, flight.way(aloft)

    return run


@lru_cache(maxsize=16)
def crossing_of(model: Model, numerics: Numerics, engine: str = "auto", share: float = 1.0) -> Crossing:
    """The function `(params, state) -> (t, state, way)` up to the next crossing, differentiable forward.

    Args:
        model, numerics: what is integrated and how. In steps of fixed length nothing is located: states
            jump as the step in which the crossing falls changes, and derivatives are refused.
        engine: kernel, xla, or auto: kernel where the model and the machine allow it.
        share: by which steps are shorter than the numerics say.

    Raises:
        ValueError: an engine that is not known.
        UnsupportedError: a kernel is asked for, and the model computes with what it cannot express.
    """
    if engine not in ("auto", "kernel", "xla"):
        raise ArgumentError(f"engine is {engine}. Allowed: auto, kernel, xla.")
    flight = Flight(model, numerics, share)
    numerics = flight.numerics
    by_xla = flown(flight)
    if not flight.differentiable:
        return _without_derivative(by_xla, numerics.method)
    kernels = jax.default_backend() == "cpu" and importlib.util.find_spec("numba") is not None
    if engine == "xla" or (engine == "auto" and not kernels):
        return by_xla
    made: dict[Any, Crossing] = {}

    def by_kernel(params: Params, state: State) -> tuple[jax.Array, State, jax.Array]:
        from gaitsweep.engine.kernel.poincare_returns import KernelFlights
        from gaitsweep.engine.kernel.trace import UnsupportedError

        shapes = jax.tree.map(
            lambda x: jax.ShapeDtypeStruct(jnp.shape(x), jnp.result_type(x)), (params, state)
        )
        key = (jax.tree.structure(shapes), tuple((x.shape, x.dtype) for x in jax.tree.leaves(shapes)))
        if key not in made:
            try:
                made[key] = KernelFlights(flight, *shapes)
            except UnsupportedError:
                if engine == "kernel":
                    raise
                made[key] = by_xla
        return made[key](params, state)

    return by_kernel


def _without_derivative(crossing: Crossing, method: str) -> Crossing:
    @jax.custom_jvp
    def run(params: Params, state: State) -> tuple[jax.Array, State, jax.Array]:
        return crossing(params, state)

    @run.defjvp
    def _refused(primals: Any, tangents: Any) -> Any:
        raise ArgumentError(
            f"{method} takes steps of fixed length, at whose end the section is met: its return map is a "
            "staircase of that step's size, which has no derivative. Use rk4."
        )

    return run
