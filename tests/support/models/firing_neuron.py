"""A nonlinear problem with events in closed form: the quadratic integrate-and-fire neuron.

v' = v^2 + I up to the threshold v_t, then v is reset to v_r. With s = sqrt(I) the solution is
v = s tan(s t + c), so that a neuron that starts at v_0 fires at

    t_n = (atan(v_t/s) - atan(v_0/s))/s + (n - 1) (atan(v_t/s) - atan(v_r/s))/s.
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


@functools.partial(jax.tree_util.register_dataclass, data_fields=["v"], meta_fields=[])
@dataclasses.dataclass(frozen=True)
class State:
    """Potential v, (1,)."""

    v: jax.Array


@dataclasses.dataclass(frozen=True)
class Neuron(HybridModel):
    """The neuron; `reset` at or above the threshold makes it fire without end at one instant."""

    name: ClassVar[str] = "neuron"
    source: ClassVar[str] = "Ermentrout and Kopell 1986"
    gaits: ClassVar[tuple[str, ...]] = ("firing",)

    @property
    def parameters(self) -> tuple[Quantity, ...]:
        return (
            Quantity("current", "1", "input I", 1.0),
            Quantity("threshold", "1", "potential of firing", 2.0),
            Quantity("reset", "1", "potential after firing", -1.0),
            Quantity("floor", "1", "potential below which it counts as fallen", -1e6),
        )

    @property
    def initial_conditions(self) -> tuple[Quantity, ...]:
        return (Quantity("v_0", "1", "potential at the start", 0.0),)

    @property
    def observables(self) -> tuple[Quantity, ...]:
        return (Quantity("v", "1", "potential after firing"),)

    @property
    def signals(self) -> tuple[Quantity, ...]:
        return (Quantity("v", "1", "potential"),)

    def params(self, values: Mapping[str, jax.Array]) -> dict[str, jax.Array]:
        return dict(values)

    def init(self, params: dict[str, jax.Array], start: Mapping[str, jax.Array]) -> State:
        return State(jnp.asarray(start["v_0"])[None])

    def flow(self, params: dict[str, jax.Array], state: State) -> Rates:
        return {"v": state.v**2 + params["current"]}

    def guards(self, params: dict[str, jax.Array], state: State) -> jax.Array:
        return state.v - params["threshold"]

    def jump(self, params: dict[str, jax.Array], state: State, fired: jax.Array) -> State:
        return State(jnp.where(fired, params["reset"], state.v))

    def section(self, params: dict[str, jax.Array], before: State, fired: jax.Array) -> jax.Array:
        return fired[0]

    def observe(self, params: dict[str, jax.Array], state: State) -> dict[str, jax.Array]:
        return {"v": state.v[0]}

    def signal(self, params: dict[str, jax.Array], state: State) -> dict[str, jax.Array]:
        return {"v": state.v[0]}

    def label(
        self, params: dict[str, jax.Array], observations: Mapping[str, jax.Array]
    ) -> dict[str, jax.Array]:
        return {"gait": jnp.zeros((), jnp.int32)}

    def failed(self, params: dict[str, jax.Array], state: State) -> jax.Array:
        return state.v[0] < params["floor"]

    def period(self, params: dict[str, jax.Array]) -> jax.Array:
        return jnp.full_like(params["current"], jnp.pi)


def firing_times(v_0: float, current: float, threshold: float, reset: float, count: int) -> np.ndarray:
    """The first `count` instants of firing, (count,)."""
    s = np.sqrt(current)
    first = (np.arctan(threshold / s) - np.arctan(v_0 / s)) / s
    return first + np.arange(count) * (np.arctan(threshold / s) - np.arctan(reset / s)) / s
