"""The leaves of a state: floats, which have derivatives, and modes (bools, integers), which have none."""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float


def is_float(array: Any) -> bool:
    """Whether an array has a floating-point dtype."""
    return bool(jnp.issubdtype(jnp.result_type(array), jnp.floating))


def float_leaves(tree: Any) -> list[Any]:
    """The float leaves, in order."""
    return [leaf for leaf in jax.tree.leaves(tree) if is_float(leaf)]


def with_float_leaves(tree: Any, numbers: Iterable[Any]) -> Any:
    """The tree with its float leaves replaced by `numbers`, in order, one for each."""
    return _replaced(tree, numbers, lambda mode: mode)


def tangent_of(tree: Any, numbers: Iterable[Any]) -> Any:
    """The tangent of a tree in JAX: `numbers` for its float leaves, one for each, float0 for its modes."""
    return _replaced(tree, numbers, lambda mode: np.zeros(np.shape(mode), jax.dtypes.float0))


def _replaced(tree: Any, numbers: Iterable[Any], of_mode: Callable[[Any], Any]) -> Any:
    """The tree with `numbers` for its float leaves, and a function of each mode for its modes."""
    leaves, structure = jax.tree.flatten(tree)
    floats = [place for place, leaf in enumerate(leaves) if is_float(leaf)]
    replaced = [of_mode(leaf) for leaf in leaves]
    for place, number in zip(floats, numbers, strict=True):
        replaced[place] = number
    return jax.tree.unflatten(structure, replaced)


def split_like(numbers: Float[Array, " values"], leaves: Sequence[Any]) -> list[Array]:
    """Cut a vector (n,) into arrays with the shapes and dtypes of some leaves, arrays or shapes."""
    ends = np.cumsum([math.prod(leaf.shape) for leaf in leaves])
    pieces = jnp.split(numbers, ends[:-1].tolist())
    return [part.reshape(leaf.shape).astype(leaf.dtype) for part, leaf in zip(pieces, leaves, strict=True)]


def vector(tree: Any) -> Float[Array, " values"]:
    """All leaves as one float64 vector (n,)."""
    leaves = [jnp.ravel(jnp.asarray(leaf)).astype(jnp.float64) for leaf in jax.tree.leaves(tree)]
    return jnp.concatenate([jnp.zeros(0), *leaves])


def extended(state: Any, names: tuple[str, ...], values: Iterable[Any]) -> Any:
    """A state with these values in fields of these names, which are added unless it has them."""
    fields = {field.name: getattr(state, field.name) for field in dataclasses.fields(state)}
    kind = type(state) if set(names) <= fields.keys() else extended_type(type(state), names)
    return kind(**{**fields, **dict(zip(names, values, strict=True))})


@functools.lru_cache(maxsize=64)
def extended_type(kind: type, names: tuple[str, ...]) -> type:
    """A type of states with more fields, which are keywords, since fields of the other may have defaults."""
    added: list[Any] = [(name, Any) for name in names]
    extended = dataclasses.make_dataclass(kind.__name__, added, bases=(kind,), frozen=True, kw_only=True)
    fields = [field.name for field in dataclasses.fields(extended)]
    return jax.tree_util.register_dataclass(extended, fields, [])


def element_names(field: str, shape: tuple[int, ...]) -> list[str]:
    """The names of the elements of a state's field: `angle` of a number, `phi_1`, `phi_2` of an array."""
    return ["_".join([field, *(str(i + 1) for i in place)]) for place in np.ndindex(*shape)]


def names_of_numbers(tree: Any) -> list[str]:
    """The names of all numbers of a tree, of arrays or of their shapes, in the order of its leaves."""
    names: list[str] = []
    for path, leaf in jax.tree_util.tree_leaves_with_path(tree):
        names += element_names(jax.tree_util.keystr(path, simple=True, separator="_"), np.shape(leaf))
    return names
