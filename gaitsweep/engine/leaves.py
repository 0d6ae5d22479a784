"""The leaves of a pytree: floats, which have derivatives, and modes (bools, integers), which have none.

`dependences` finds which leaves a function reads for each of its results.
"""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import Literal
from jaxtyping import Array, Float

from gaitsweep.contract import Chart, HybridModel, Model, Params, Quantity, State
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


def is_float(array: Any) -> bool:
    """Whether an array has a floating-point dtype."""
    return bool(jnp.issubdtype(jnp.result_type(array), jnp.floating))


def float_leaves(tree: Any) -> list[Any]:
    """The float leaves, in order."""
    return [leaf for leaf in jax.tree.leaves(tree) if is_float(leaf)]


def with_float_leaves(tree: Any, numbers: Iterable[Any]) -> Any:
    """The tree with its float leaves replaced by `numbers`, in order."""
    remaining = iter(numbers)
    return jax.tree.map(lambda leaf: next(remaining) if is_float(leaf) else leaf, tree)


def tangent_of(tree: Any, numbers: Iterable[Any]) -> Any:
    """The tangent of a tree in JAX: `numbers` for its float leaves, float0 for its modes."""
    remaining = iter(numbers)

    def tangent(leaf: Any) -> Any:
        return next(remaining) if is_float(leaf) else np.zeros(np.shape(leaf), jax.dtypes.float0)

    return jax.tree.map(tangent, tree)


def split_like(numbers: Float[Array, " values"], leaves: Sequence[Any]) -> list[Array]:
    """Cut a vector (n,) into arrays with the shapes and dtypes of some leaves, arrays or shapes."""
    ends = np.cumsum([math.prod(leaf.shape) for leaf in leaves])
    pieces = jnp.split(numbers, ends[:-1].tolist())
    return [part.reshape(leaf.shape).astype(leaf.dtype) for part, leaf in zip(pieces, leaves, strict=True)]


def vector(tree: Any) -> Float[Array, " values"]:
    """All leaves as one float64 vector (n,)."""
    leaves = [jnp.ravel(jnp.asarray(leaf)).astype(jnp.float64) for leaf in jax.tree.leaves(tree)]
    return jnp.concatenate([jnp.zeros(0), *leaves])


@functools.lru_cache(maxsize=64)
def extended_type(kind: type, names: tuple[str, ...]) -> type:
    """A type of states with more fields, derived from another one alone."""
    added: list[Any] = [(name, Any) for name in names]
    extended = dataclasses.make_dataclass(kind.__name__, added, bases=(kind,), frozen=True)
    fields = [field.name for field in dataclasses.fields(extended)]
    return jax.tree_util.register_dataclass(extended, fields, [])


def element_names(field: str, shape: tuple[int, ...]) -> list[str]:
    """The names of the elements of a state's field: `angle` of a number, `phi_1`, `phi_2` of an array."""
    return ["_".join([field, *(str(i + 1) for i in place)]) for place in np.ndindex(*shape)]


def dependences(function: Callable[..., Any], *inputs: Any) -> list[frozenset[str]]:
    """The names of the arguments on which each array that a function returns depends.

    A result of an inner function (of `jax.jit`, or a branch) counts as dependent on all arguments of that
    function.

    Args:
        function: of mappings of arrays by name.
        inputs: shapes and dtypes of its arguments, each a mapping.
    """
    program = jax.make_jaxpr(function)(*inputs).jaxpr
    paths = [path for path, _ in jax.tree_util.tree_flatten_with_path(inputs)[0]]
    names = {
        variable: frozenset({path[-1].key}) for variable, path in zip(program.invars, paths, strict=True)
    }

    def names_of(*atoms: Any) -> frozenset[str]:
        variables = (atom for atom in atoms if not isinstance(atom, Literal))
        return frozenset[str]().union(*(names.get(variable, ()) for variable in variables))

    for equation in program.eqns:
        names.update(dict.fromkeys(equation.outvars, names_of(*equation.invars)))
    return [names_of(atom) for atom in program.outvars]


@dataclasses.dataclass(frozen=True)
class AllVariables(Chart):
    """All float variables of a state as coordinates, for models without a chart; `names` are their names."""

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
