"""A model with a cusp in closed form: x' = r + a x - x^3, the section the end of each second.

The fixed points of its return map are the equilibria. They meet in pairs where 27 r^2 = 4 a^3, x^2 = a/3; the
cusp is at r = a = 0. Between both curves `left` (x < 0) and `right` (x > 0) are stable.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Mapping
from typing import ClassVar

import jax
import jax.numpy as jnp

from gaitsweep.contract import HybridModel, Quantity, Rates

Values = Mapping[str, jax.Array]


@functools.partial(jax.tree_util.register_dataclass, data_fields=["x", "clock"], meta_fields=[])
@dataclasses.dataclass(frozen=True)
class State:
    """The place x (m), and the time since the last crossing (s)."""

    x: jax.Array
    clock: jax.Array


@dataclasses.dataclass(frozen=True)
class CuspFlow(HybridModel):
    """A particle on a line."""

    name: ClassVar[str] = "cusp_flow"
    source: ClassVar[str] = "this file: folds in closed form"
    gaits: ClassVar[tuple[str, ...]] = ("left", "right")

    @property
    def parameters(self) -> tuple[Quantity, ...]:
        return (
            Quantity("r", "m/s", "push", 0.0),
            Quantity("a", "1/s", "growth", 1.0, low=-10.0, high=10.0),
        )

    @property
    def initial_conditions(self) -> tuple[Quantity, ...]:
        return (Quantity("x_0", "m", "where it starts", 1.0),)

    @property
    def observables(self) -> tuple[Quantity, ...]:
        return (Quantity("x", "m", "place"),)

    @property
    def signals(self) -> tuple[Quantity, ...]:
        return self.observables

    @property
    def label_fields(self) -> tuple[Quantity, ...]:
        return ()

    def params(self, values: Values) -> dict[str, jax.Array]:
        return {name: jnp.asarray(values[name]) for name in ("r", "a")}

    def init(self, params: dict[str, jax.Array], start: Values) -> State:
        x = jnp.asarray(start["x_0"])
        return State(x, jnp.zeros_like(x))

    def flow(self, params: dict[str, jax.Array], state: State) -> Rates:
        rate = params["r"] + params["a"] * state.x - state.x**3
        return {"x": rate, "clock": jnp.ones_like(rate)}

    def guards(self, params: dict[str, jax.Array], state: State) -> jax.Array:
        return (state.clock - 1.0)[None]

    def jump(self, params: dict[str, jax.Array], state: State, fired: jax.Array) -> State:
        return dataclasses.replace(state, clock=jnp.where(fired[0], 0.0, state.clock))

    def section(self, params: dict[str, jax.Array], before: State, fired: jax.Array) -> jax.Array:
        return fired[0]

    def observe(self, params: dict[str, jax.Array], state: State) -> dict[str, jax.Array]:
        return {"x": state.x}

    def signal(self, params: dict[str, jax.Array], state: State) -> dict[str, jax.Array]:
        return self.observe(params, state)

    def label(self, params: dict[str, jax.Array], observations: Values) -> dict[str, jax.Array]:
        return {"gait": (jnp.asarray(observations["x"]) > 0.0).astype(jnp.int32)}

    def failed(self, params: dict[str, jax.Array], state: State) -> jax.Array:
        return jnp.abs(state.x) > 1e3

    def period(self, params: dict[str, jax.Array]) -> jax.Array:
        return 0.0 * params["a"] + 1.0
