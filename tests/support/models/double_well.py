"""A simulator whose result depends on its step: a particle in a double well, by a wrong explicit Euler.

x' = x - x^3 in steps x + dt (x - x^3) + lean dt^2: where the wells part and where they lie is off by lean dt,
to first order: the boundary at x = -lean dt, the wells' bottoms at 1 + lean dt / 2 and -1 + lean dt / 2.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Mapping
from typing import ClassVar

import jax
import jax.numpy as jnp

from gaitsweep.contract import Quantity, SteppedModel


@functools.partial(jax.tree_util.register_dataclass, data_fields=["x"], meta_fields=[])
@dataclasses.dataclass(frozen=True)
class State:
    """Position of the particle, x (m)."""

    x: jax.Array


@dataclasses.dataclass(frozen=True)
class DoubleWell(SteppedModel):
    """The particle; every step ends on the section."""

    name: ClassVar[str] = "double_well"
    source: ClassVar[str] = "this file"
    gaits: ClassVar[tuple[str, ...]] = ("left", "right")

    @property
    def parameters(self) -> tuple[Quantity, ...]:
        return (Quantity("lean", "m/s2", "error of a step, over dt^2", 0.0),)

    @property
    def initial_conditions(self) -> tuple[Quantity, ...]:
        return (Quantity("x_0", "m", "where it starts", 0.5),)

    @property
    def observables(self) -> tuple[Quantity, ...]:
        return (Quantity("x", "m", "where it is"),)

    @property
    def signals(self) -> tuple[Quantity, ...]:
        return self.observables

    def params(self, values: Mapping[str, jax.Array]) -> dict[str, jax.Array]:
        return dict(values)

    def init(self, params: dict[str, jax.Array], start: Mapping[str, jax.Array]) -> State:
        return State(jnp.asarray(start["x_0"]))

    def step(self, params: dict[str, jax.Array], state: State, dt: jax.Array) -> State:
        x = state.x
        return State(x + dt * (x - x * x * x) + params["lean"] * dt * dt)

    def events(self, params: dict[str, jax.Array], before: State, after: State) -> jax.Array:
        return jnp.ones((1,), bool)

    def jump(self, params: dict[str, jax.Array], state: State, fired: jax.Array) -> State:
        return state

    def section(self, params: dict[str, jax.Array], before: State, fired: jax.Array) -> jax.Array:
        return fired[0]

    def observe(self, params: dict[str, jax.Array], state: State) -> dict[str, jax.Array]:
        return {"x": state.x}

    def signal(self, params: dict[str, jax.Array], state: State) -> dict[str, jax.Array]:
        return {"x": state.x}

    def label(
        self, params: dict[str, jax.Array], observations: Mapping[str, jax.Array]
    ) -> dict[str, jax.Array]:
        return {"gait": jnp.where(observations["x"] > 0.0, 1, 0)}

    def failed(self, params: dict[str, jax.Array], state: State) -> jax.Array:
        return jnp.asarray(False)

    def period(self, params: dict[str, jax.Array]) -> jax.Array:
        return jnp.ones_like(params["lean"])

    def longest_step(self, params: dict[str, jax.Array]) -> jax.Array:
        return jnp.full_like(params["lean"], 0.05)
