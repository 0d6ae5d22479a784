"""The shapes of a model's parameters and of its state, without values."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np

from gaitsweep.contract import HybridModel, Model, Params, State
from gaitsweep.engine.content import cached_by_content
from gaitsweep.engine.stored_traces import stored


def shapes_of(model: Model) -> tuple[Params, State]:
    """The shapes of a model's parameters and of its state, traced without values."""
    number = jax.ShapeDtypeStruct((), jnp.float64)
    values = {q.name: number for q in model.parameters}
    if model.host_parameters:
        values = _shapes_on_host(model)
    params = jax.eval_shape(model.params, values)
    return params, jax.eval_shape(model.init, params, {q.name: number for q in model.initial_conditions})


def _shapes_on_host(model: Model) -> dict[str, jax.ShapeDtypeStruct]:
    """The shapes of what the host computes from a model's parameters, here from their defaults."""
    row: dict[str, np.ndarray] = {}
    for quantity in model.parameters:
        default = quantity.default if isinstance(quantity.default, int | float) else 1.0
        row[quantity.name] = np.full(1, default)
    columns = model.on_host(row)
    return {name: jax.ShapeDtypeStruct(np.shape(column)[1:], jnp.float64) for name, column in columns.items()}


@cached_by_content(maxsize=64)
def counts_of_state(model: HybridModel) -> tuple[int, int]:
    """The number of numbers that the flow of a model moves, and that of the flags of its state."""

    def counts() -> tuple[int, int]:
        params, state = shapes_of(model)
        moving = [getattr(state, name) for name in jax.eval_shape(model.flow, params, state)]
        leaves = jax.tree.leaves(state)
        flags = [leaf for leaf in leaves if jnp.issubdtype(leaf.dtype, jnp.bool_)]
        return sum(leaf.size for leaf in moving), sum(leaf.size for leaf in flags)

    # stored, since every job that leaves the method open asks for them
    variables, flags = stored("counts_of_state", model, (), counts)
    return variables, flags
