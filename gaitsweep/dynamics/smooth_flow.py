"""Models of a smooth flow: a right-hand side, and a plane as Poincare section."""

from __future__ import annotations

import abc
import dataclasses
from collections.abc import Mapping
from typing import Any, ClassVar

import jax
import jax.numpy as jnp

from gaitsweep.contract import HybridModel, Quantity, Rates
from gaitsweep.dynamics.plane_section import GUARDS, Plane

Values = Mapping[str, jax.Array]


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class State:
    """The variables (n,), and whether the section is armed (see `Plane`)."""

    x: jax.Array
    armed: jax.Array


@dataclasses.dataclass(frozen=True)
class SmoothFlow(HybridModel):
    """A smooth flow x' = f(x), with or without a plane as Poincare section.

    A model derives from it, defines `name`, `variables`, `parameters`, `rates`, `plane` and `period`, and may
    override the rest. Initial conditions are the variables' names with `_0`, with their defaults; observables
    and signals are the variables. Without a `plane` there are no crossings: such a model runs for a given
    time (`kind: trace`).
    """

    variables: ClassVar[tuple[Quantity, ...]]
    source: ClassVar[str] = ""
    gaits: ClassVar[tuple[str, ...]] = ("none",)

    @abc.abstractmethod
    def rates(self, params: Values, x: jax.Array) -> jax.Array:
        """The time derivatives (n,) of the variables x (n,); `params` has one scalar for each parameter."""

    def plane(self, params: Values) -> Plane | None:
        """The section, or None for a model without one."""
        return None

    @property
    def initial_conditions(self) -> tuple[Quantity, ...]:
        return tuple(
            dataclasses.replace(q, name=f"{q.name}_0", meaning=f"{q.meaning} at the start")
            for q in self.variables
        )

    @property
    def observables(self) -> tuple[Quantity, ...]:
        return self.variables

    @property
    def signals(self) -> tuple[Quantity, ...]:
        return self.variables

    def params(self, values: Values) -> dict[str, jax.Array]:
        return {quantity.name: jnp.asarray(values[quantity.name]) for quantity in self.parameters}

    def init(self, params: Values, start: Values) -> State:
        x = jnp.stack([jnp.asarray(start[f"{q.name}_0"]) for q in self.variables])
        plane = self.plane(params)
        return State(x, jnp.zeros((), bool) if plane is None else plane.armed_at(x))

    def flow(self, params: Values, state: State) -> Rates:
        return {"x": self.rates(params, state.x)}

    def guards(self, params: Values, state: State) -> jax.Array:
        plane = self.plane(params)
        return jnp.zeros((0,), state.x.dtype) if plane is None else plane.guards(state.x, state.armed)

    @property
    def guard_names(self) -> tuple[str, ...]:
        return () if type(self).plane is SmoothFlow.plane else GUARDS

    def jump(self, params: Values, state: State, fired: jax.Array) -> State:
        if fired.size == 0:
            return state
        return dataclasses.replace(state, armed=Plane.armed_after(state.armed, fired))

    def section(self, params: Values, before: State, fired: jax.Array) -> jax.Array:
        return Plane.crossed(fired) if fired.size else jnp.zeros((), bool)

    def observe(self, params: Values, state: State) -> dict[str, jax.Array]:
        return {q.name: state.x[i] for i, q in enumerate(self.variables)}

    signal = observe

    def label(self, params: Values, observations: Values) -> dict[str, Any]:
        return {"gait": jnp.zeros((), jnp.int32)}

    def failed(self, params: Values, state: State) -> jax.Array:
        return jnp.zeros((), bool)
