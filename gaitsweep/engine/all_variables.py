"""The chart of a model that has none: all float variables of its state."""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from gaitsweep.contract import Chart, Params, Quantity, State
from gaitsweep.engine.leaves import element_names, float_leaves, is_float, split_like, with_float_leaves


@dataclasses.dataclass(frozen=True)
class AllVariables(Chart):
    """All float variables of a state as coordinates; `names` are their names."""

    names: tuple[str, ...]

    @classmethod
    def of(cls, state: State) -> AllVariables:
        """The chart of states like this one."""
        names: list[str] = []
        for path, leaf in jax.tree_util.tree_leaves_with_path(state):
            if is_float(leaf):
                names += element_names(jax.tree_util.keystr(path, simple=True, separator="_"), np.shape(leaf))
        return cls(tuple(names))

    @property
    def coordinates(self) -> tuple[Quantity, ...]:
        return tuple(Quantity(name, "", f"{name} of the state") for name in self.names)

    def to_coordinates(self, params: Params, state: State) -> Float[Array, " coordinates"]:
        return jnp.concatenate([jnp.ravel(leaf).astype(jnp.float64) for leaf in float_leaves(state)])

    def from_coordinates(self, params: Params, at: Float[Array, " coordinates"], modes: State) -> State:
        return with_float_leaves(modes, split_like(at, float_leaves(modes)))
