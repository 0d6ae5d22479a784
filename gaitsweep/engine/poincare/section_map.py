"""One return to the Poincare section as a JAX function with forward-mode derivatives, by XLA or a kernel."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from functools import lru_cache
from typing import Any

import jax
import jax.numpy as jnp

from gaitsweep.contract import Model, Params, State
from gaitsweep.engine.numerics import Numerics
from gaitsweep.engine.poincare.poincare_return import PoincareReturn
from gaitsweep.errors import ArgumentError

Crossing = Callable[[Params, State], tuple[jax.Array, State, jax.Array]]


def returns_by_xla(crossing: PoincareReturn) -> Crossing:
    """The function `(params, state) -> (t, state, status)` of one return by XLA, a loop over its attempts.

    `status` is a `gaitsweep.engine.poincare.poincare_return.ReturnStatus`.
    """

    def run(params: Params, state: State) -> tuple[jax.Array, State, jax.Array]:
        end = jax.lax.while_loop(
            lambda trajectory: ~crossing.ended(trajectory),
            lambda trajectory: crossing.attempt(params, trajectory),
            crossing.begin(params, state),
        )
        return end.carry.t, end.carry.state, crossing.status(end)

    return run


@lru_cache(maxsize=16)
def crossing_of(model: Model, numerics: Numerics, engine: str = "auto", share: float = 1.0) -> Crossing:
    """The function `(params, state) -> (t, state, status)` up to the next crossing.

    `t` is the time that it takes (s), `state` the state just after the crossing's jump, `status` the
    `ReturnStatus`. The function has forward-mode derivatives (`jax.jvp`, `jax.jacfwd`).

    Args:
        model: the model.
        numerics: the method and its tolerances. With fixed steps no event is located: the state is a
            discontinuous function of its start, and derivatives are refused.
        engine: kernel, xla, or auto: kernel where the model and the machine allow it.
        share: factor on the step lengths, at most 1.

    Raises:
        ArgumentError: the engine is unknown.
        UnsupportedError: a kernel is required, but the model uses operations that no kernel has.
    """
    if engine not in ("auto", "kernel", "xla"):
        raise ArgumentError(f"engine is {engine}. Allowed: auto, kernel, xla.")
    crossing = PoincareReturn(model, numerics, share)
    numerics = crossing.numerics
    by_xla = returns_by_xla(crossing)
    if not crossing.differentiable:
        return _without_derivative(by_xla, numerics.method)
    kernels = jax.default_backend() == "cpu" and importlib.util.find_spec("numba") is not None
    if engine == "xla" or (engine == "auto" and not kernels):
        return by_xla
    made: dict[Any, Crossing] = {}

    def by_kernel(params: Params, state: State) -> tuple[jax.Array, State, jax.Array]:
        from gaitsweep.engine.kernel.poincare_returns import KernelReturns
        from gaitsweep.engine.kernel.trace import UnsupportedError

        shapes = jax.tree.map(
            lambda x: jax.ShapeDtypeStruct(jnp.shape(x), jnp.result_type(x)), (params, state)
        )
        key = (jax.tree.structure(shapes), tuple((x.shape, x.dtype) for x in jax.tree.leaves(shapes)))
        if key not in made:
            try:
                made[key] = KernelReturns(crossing, *shapes)
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
            f"{method} takes fixed steps and does not locate the crossing inside a step: its return map is a "
            "step function without a derivative. Use rk4."
        )

    return run
