"""Trajectories that begin at points of the section, in any state of a model."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Real

from gaitsweep.contract import Model, Quantity
from gaitsweep.engine.poincare.maps import Points
from gaitsweep.engine.poincare.model_map import ModelMap

PerPoint = Real[np.ndarray, " points"]  # a number for each point


def states_at(
    mapping: ModelMap, points: Sequence[Points], values: Mapping[str, PerPoint]
) -> tuple[Model, dict[str, PerPoint], dict[str, PerPoint]]:
    """Use points of the section as starts of trajectories.

    Args:
        mapping: a map of the model's states.
        points: n points.
        values: parameters (n,) by name.

    Returns:
        A model that can begin in any of its states, and its parameters and starts (n,) by name.
    """
    n = len(points)
    joined = jax.tree.map(lambda *leaves: np.concatenate(leaves), *points)
    complete = mapping.complete(values, n)

    def placed(values: Any, at: jax.Array, modes: Any) -> tuple[Any, Any]:
        return mapping.chart.from_coordinates(mapping.params(values), at, modes), mapping.resolved(values)

    states, parameters = jax.jit(jax.vmap(placed))(complete, joined.at, joined.modes)
    leaves = [np.asarray(leaf) for leaf in jax.tree.leaves(states)]
    columns = np.concatenate([leaf.reshape(n, -1).astype(np.float64) for leaf in leaves], axis=1)
    model = _in_state(mapping.model, jax.tree.map(lambda leaf: leaf[0], states))
    names = [quantity.name for quantity in model.initial_conditions]
    starts = dict(zip(names, columns.T, strict=True))
    return model, {name: np.asarray(v) for name, v in parameters.items()}, starts


def _in_state(model: Model, state: Any) -> Model:
    """The model with all numbers of a state as initial conditions; `state` is one of its states."""
    leaves, tree = jax.tree.flatten(state)
    shapes = [(np.shape(leaf), np.asarray(leaf).dtype) for leaf in leaves]
    cuts = np.cumsum([int(np.prod(shape)) for shape, _ in shapes])
    quantities = tuple(Quantity(f"state_{i}", "1", "number of a state") for i in range(int(cuts[-1])))

    def init(self: Model, params: Any, start: Mapping[str, jax.Array]) -> Any:
        numbers = jnp.stack([jnp.asarray(start[quantity.name]) for quantity in quantities])
        parts = jnp.split(numbers, cuts[:-1].tolist())
        shaped = [
            part.reshape(shape).astype(dtype) for part, (shape, dtype) in zip(parts, shapes, strict=True)
        ]
        return jax.tree.unflatten(tree, shaped)

    members = {"init": init, "initial_conditions": property(lambda self: quantities)}
    of_any_state = type(f"{type(model).__name__}InState", (type(model),), members)
    fields = dataclasses.fields(model)  # pyright: ignore[reportArgumentType] (each is a dataclass)
    return of_any_state(**{field.name: getattr(model, field.name) for field in fields if field.init})
