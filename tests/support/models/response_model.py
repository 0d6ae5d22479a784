"""A model whose settled state is a known function of its parameters: indices of sensitivity in closed form.

Two numbers y run to their targets, y' = 30 (target - y) per second. The section is the end of each second, so
that they are there to e^-30 at the first crossing. The targets are Ishigami's function and a linear one:

    sin x_1 + 7 sin^2 x_2 + 0.1 x_3^4 sin x_1,        x_1 + 2 x_2 - 0.5 x_3

An angle is a third of the linear one, which goes through 0. A row counts as fallen where x_1 > limit.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Mapping
from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np

from gaitsweep.contract import HybridModel, Quantity, Rates

Values = Mapping[str, jax.Array]
A, B = 7.0, 0.1
COEFFICIENTS = (1.0, 2.0, -0.5)


@functools.partial(jax.tree_util.register_dataclass, data_fields=["y", "clock"], meta_fields=[])
@dataclasses.dataclass(frozen=True)
class State:
    """The two numbers y (2,), and the time since the last crossing (s)."""

    y: jax.Array
    clock: jax.Array


@dataclasses.dataclass(frozen=True)
class Response(HybridModel):
    """Two numbers that run to known functions of the parameters."""

    name: ClassVar[str] = "response"
    source: ClassVar[str] = "Ishigami and Homma 1990"
    gaits: ClassVar[tuple[str, ...]] = ("high", "low")

    @property
    def parameters(self) -> tuple[Quantity, ...]:
        return (
            *(Quantity(f"x_{i}", "m", f"input {i}", 1.0, low=-4.0, high=4.0) for i in (1, 2, 3)),
            Quantity("limit", "m", "x_1 above which it has fallen", 10.0),
            Quantity("twice", "m", "follows x_1", "2*x_1"),
            Quantity("nothing", "m", "of no effect", 0.0),
        )

    @property
    def initial_conditions(self) -> tuple[Quantity, ...]:
        return (Quantity("y_0", "1", "both numbers at the start"),)

    @property
    def observables(self) -> tuple[Quantity, ...]:
        return (
            Quantity("ishigami", "1", "Ishigami's function"),
            Quantity("linear", "N", "the linear function"),
            Quantity("angle", "rad", "a third of it", circular=True),
        )

    @property
    def signals(self) -> tuple[Quantity, ...]:
        return self.observables

    def params(self, values: Values) -> dict[str, jax.Array]:
        return dict(values)

    def init(self, params: dict[str, jax.Array], start: Values) -> State:
        y = jnp.stack([jnp.asarray(start["y_0"])] * 2)
        return State(y, jnp.zeros_like(y[0]))

    def flow(self, params: dict[str, jax.Array], state: State) -> Rates:
        x = [params[f"x_{i}"] for i in (1, 2, 3)]
        curved = jnp.sin(x[0]) * (1.0 + B * x[2] ** 4) + A * jnp.sin(x[1]) ** 2
        straight = sum(c * each for c, each in zip(COEFFICIENTS, x, strict=True))
        target = jnp.stack([curved, straight])
        return {"y": 30.0 * (target - state.y), "clock": jnp.ones_like(state.clock)}

    def guards(self, params: dict[str, jax.Array], state: State) -> jax.Array:
        return (state.clock - 1.0)[None]

    def jump(self, params: dict[str, jax.Array], state: State, fired: jax.Array) -> State:
        return dataclasses.replace(state, clock=jnp.where(fired[0], 0.0, state.clock))

    def section(self, params: dict[str, jax.Array], before: State, fired: jax.Array) -> jax.Array:
        return fired[0]

    def observe(self, params: dict[str, jax.Array], state: State) -> dict[str, jax.Array]:
        angle = jnp.mod(state.y[1] / 3.0, 2.0 * jnp.pi)
        return {"ishigami": state.y[0], "linear": state.y[1], "angle": angle}

    def signal(self, params: dict[str, jax.Array], state: State) -> dict[str, jax.Array]:
        return self.observe(params, state)

    def label(self, params: dict[str, jax.Array], observations: Values) -> dict[str, jax.Array]:
        return {"gait": jnp.where(jnp.asarray(observations["linear"]) > 0.0, 0, 1).astype(jnp.int32)}

    def failed(self, params: dict[str, jax.Array], state: State) -> jax.Array:
        return params["x_1"] > params["limit"]

    def period(self, params: dict[str, jax.Array]) -> jax.Array:
        return 0.0 * params["x_1"] + 1.0


def ishigami(x: np.ndarray) -> np.ndarray:
    """Ishigami's function of inputs (n, 3)."""
    return np.sin(x[:, 0]) * (1.0 + B * x[:, 2] ** 4) + A * np.sin(x[:, 1]) ** 2


def ishigami_indices() -> tuple[np.ndarray, np.ndarray]:
    """Its indices S1 and ST (3,) each, for inputs from -pi to pi."""
    first = 0.5 * (1.0 + B * np.pi**4 / 5.0) ** 2
    second = A**2 / 8.0
    together = B**2 * np.pi**8 * (1.0 / 18.0 - 1.0 / 50.0)
    total = first + second + together
    return np.array([first, second, 0.0]) / total, np.array([first + together, second, together]) / total
