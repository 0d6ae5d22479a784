"""A model whose basins, attractors and shocks are known: an angle that runs to one of two curves.

    theta_1' = -rate sin(2 (theta_1 - c)) / 2,   theta_2' = 0,   c = shift + bend sin(theta_2)

Each theta_2 is as good as any other, so the attractors are two closed lines of neutrally stable states:
theta_1 = c (`near`) and theta_1 = c + pi (`far`). A start goes to `near` where cos(theta_1 - c) > 0. It
counts as fallen where cos(theta_2) > cliff. A cycle lasts one second.
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


@functools.partial(jax.tree_util.register_dataclass, data_fields=["theta", "clock"], meta_fields=[])
@dataclasses.dataclass(frozen=True)
class State:
    """Angles theta (rad), (2,), and the time since the last crossing (s)."""

    theta: jax.Array
    clock: jax.Array


@dataclasses.dataclass(frozen=True)
class Landscape(HybridModel):
    """Two angles on a torus; the section is the end of each second."""

    name: ClassVar[str] = "landscape"
    source: ClassVar[str] = "this file"
    gaits: ClassVar[tuple[str, ...]] = ("near", "far", "none")

    @property
    def parameters(self) -> tuple[Quantity, ...]:
        return (
            Quantity("rate", "1/s", "how fast theta_1 runs", 3.0, low=0.0),
            Quantity("shift", "rad", "where the curves are", 0.0),
            Quantity("bend", "rad", "how far the curves swing", 0.7),
            Quantity("cliff", "1", "cos(theta_2) above which it has fallen", 2.0),
        )

    @property
    def initial_conditions(self) -> tuple[Quantity, ...]:
        return tuple(Quantity(f"theta_{i}", "rad", "angle", circular=True) for i in (1, 2))

    @property
    def observables(self) -> tuple[Quantity, ...]:
        return tuple(Quantity(f"theta_{i}", "rad", "angle", circular=True) for i in (1, 2))

    @property
    def signals(self) -> tuple[Quantity, ...]:
        return tuple(Quantity(f"angle_{i}", "rad", "angle", circular=True) for i in (1, 2))

    @property
    def label_fields(self) -> tuple[Quantity, ...]:
        return (
            Quantity("side", "1", "1 where it is near"),
            Quantity("away", "rad", "sine of it"),
        )

    def params(self, values: Values) -> dict[str, jax.Array]:
        return dict(values)

    def init(self, params: dict[str, jax.Array], start: Values) -> State:
        theta = jnp.stack([jnp.asarray(start["theta_1"]), jnp.asarray(start["theta_2"])])
        return State(theta, jnp.zeros_like(theta[0]))

    def flow(self, params: dict[str, jax.Array], state: State) -> Rates:
        away = state.theta[0] - curve(params, state.theta[1])
        rate = -0.5 * params["rate"] * jnp.sin(2.0 * away)
        return {"theta": jnp.stack([rate, jnp.zeros_like(rate)]), "clock": jnp.ones_like(rate)}

    def guards(self, params: dict[str, jax.Array], state: State) -> jax.Array:
        return (state.clock - 1.0)[None]

    def jump(self, params: dict[str, jax.Array], state: State, fired: jax.Array) -> State:
        return dataclasses.replace(state, clock=jnp.where(fired[0], 0.0, state.clock))

    def section(self, params: dict[str, jax.Array], before: State, fired: jax.Array) -> jax.Array:
        return fired[0]

    def observe(self, params: dict[str, jax.Array], state: State) -> dict[str, jax.Array]:
        turned = jnp.mod(state.theta, 2.0 * jnp.pi)
        return {"theta_1": turned[0], "theta_2": turned[1]}

    def signal(self, params: dict[str, jax.Array], state: State) -> dict[str, jax.Array]:
        return {"angle_1": state.theta[0], "angle_2": state.theta[1]}

    def label(self, params: dict[str, jax.Array], observations: Values) -> dict[str, jax.Array]:
        away = observations["theta_1"] - curve(params, jnp.asarray(observations["theta_2"]))
        near = jnp.cos(away) > 0.0
        return {
            "gait": jnp.where(near, 0, 1).astype(jnp.int32),
            "side": near.astype(jnp.int32),
            "away": jnp.abs(jnp.sin(away)),
        }

    def failed(self, params: dict[str, jax.Array], state: State) -> jax.Array:
        return jnp.cos(state.theta[1]) > params["cliff"]

    def period(self, params: dict[str, jax.Array]) -> jax.Array:
        return 0.0 * params["rate"] + 1.0


@dataclasses.dataclass(frozen=True)
class FasterLandscape(Landscape):
    """The landscape with cycles that are shorter where it is faster."""

    name: ClassVar[str] = "faster_landscape"

    def period(self, params: dict[str, jax.Array]) -> jax.Array:
        return 3.0 / params["rate"]


@dataclasses.dataclass(frozen=True)
class StuckLandscape(Landscape):
    """The landscape in which the jump keeps its event's surface where cos(theta_2) > cliff."""

    name: ClassVar[str] = "stuck_landscape"

    @property
    def guard_names(self) -> tuple[str, ...]:
        return ("a second ends",)

    def jump(self, params: dict[str, jax.Array], state: State, fired: jax.Array) -> State:
        stuck = jnp.cos(state.theta[1]) > params["cliff"]
        return dataclasses.replace(state, clock=jnp.where(fired[0] & ~stuck, 0.0, state.clock))

    def failed(self, params: dict[str, jax.Array], state: State) -> jax.Array:
        return jnp.zeros((), bool)


def curve(params: Mapping[str, jax.Array], theta_2: jax.Array) -> jax.Array:
    """The angle theta_1 (rad) of the near curve."""
    return params["shift"] + params["bend"] * jnp.sin(theta_2)


def is_near(
    theta_1: np.ndarray, theta_2: np.ndarray, shift: float | np.ndarray = 0.0, bend: float | np.ndarray = 0.7
) -> np.ndarray:
    """Whether a start reaches the near curve."""
    return np.cos(theta_1 - shift - bend * np.sin(theta_2)) > 0.0
