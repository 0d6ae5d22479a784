"""Maps as stepped models, for tests of settling: each step of 1 s is a crossing of the section."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Mapping
from typing import ClassVar

import jax
import jax.numpy as jnp

from gaitsweep.contract import Quantity, SteppedModel


@functools.partial(jax.tree_util.register_dataclass, data_fields=["r", "ratio", "angle"], meta_fields=[])
@dataclasses.dataclass(frozen=True)
class Params:
    r: jax.Array
    ratio: jax.Array
    angle: jax.Array


@functools.partial(jax.tree_util.register_dataclass, data_fields=["x", "y"], meta_fields=[])
@dataclasses.dataclass(frozen=True)
class State:
    x: jax.Array
    y: jax.Array


@dataclasses.dataclass(frozen=True)
class Map(SteppedModel):
    """A map of the plane; its observables are `size` times x and y."""

    size: float = 1.0

    name: ClassVar[str] = "map"
    source: ClassVar[str] = "this file"
    gaits: ClassVar[tuple[str, ...]] = ("low", "high")

    @property
    def parameters(self) -> tuple[Quantity, ...]:
        return (
            Quantity("r", "1", "growth", 3.2),
            Quantity("ratio", "1", "by which a step shortens", 0.9),
            Quantity("angle", "rad", "by which a step turns", 0.0),
        )

    @property
    def initial_conditions(self) -> tuple[Quantity, ...]:
        return Quantity("x_0", "1", "first x", 0.3), Quantity("y_0", "1", "first y", 0.0)

    @property
    def observables(self) -> tuple[Quantity, ...]:
        return Quantity("x", "N", "size times x"), Quantity("y", "N", "size times y")

    @property
    def signals(self) -> tuple[Quantity, ...]:
        return self.observables

    def params(self, values: Mapping[str, jax.Array]) -> Params:
        return Params(**{field.name: jnp.asarray(values[field.name]) for field in dataclasses.fields(Params)})

    def init(self, params: Params, start: Mapping[str, jax.Array]) -> State:
        return State(jnp.asarray(start["x_0"]), jnp.asarray(start["y_0"]))

    def events(self, params: Params, before: State, after: State) -> jax.Array:
        return jnp.ones((1,), bool)

    def jump(self, params: Params, state: State, fired: jax.Array) -> State:
        return state

    def section(self, params: Params, before: State, fired: jax.Array) -> jax.Array:
        return fired[0]

    def observe(self, params: Params, state: State) -> dict[str, jax.Array]:
        return {"x": self.size * state.x, "y": self.size * state.y}

    def signal(self, params: Params, state: State) -> dict[str, jax.Array]:
        return self.observe(params, state)

    def label(self, params: Params, observations: Mapping[str, jax.Array]) -> dict[str, jax.Array]:
        return {"gait": (observations["x"] > 0.6 * self.size).astype(jnp.int32)}

    def failed(self, params: Params, state: State) -> jax.Array:
        return jnp.zeros((), bool)

    def period(self, params: Params) -> jax.Array:
        return jnp.ones_like(params.r)


class Logistic(Map):
    """x -> r x (1 - x); y copies x."""

    def step(self, params: Params, state: State, dt: jax.Array) -> State:
        x = params.r * state.x * (1.0 - state.x)
        return State(x, x)


@dataclasses.dataclass(frozen=True)
class Spiral(Map):
    """Each step turns by `angle` and shortens by `ratio` about (1, 1)."""

    def step(self, params: Params, state: State, dt: jax.Array) -> State:
        x, y = state.x - 1.0, state.y - 1.0
        c, s = params.ratio * jnp.cos(params.angle), params.ratio * jnp.sin(params.angle)
        return State(1.0 + c * x - s * y, 1.0 + s * x + c * y)


class MirrorCycles(Map):
    """x -> x^3 - r x; y shows 1 for all |x| > 1.

    Two stable mirror cycles of period 2 for 2 < r < sqrt(5): x takes two values with product -1, whose
    squares have the sum r. They are equal in y at one crossing.
    """

    def step(self, params: Params, state: State, dt: jax.Array) -> State:
        x = state.x**3 - params.r * state.x
        return State(x, jnp.where(jnp.abs(x) > 1.0, 1.0, x))
