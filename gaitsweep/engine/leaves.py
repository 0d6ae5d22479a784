"""The float leaves of a pytree, which have derivatives; its other leaves (bools, integers) are modes."""

from __future__ import annotations

from collections.abc import Iterable
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
    """The tree with its float leaves replaced by `numbers`."""
    remaining = iter(numbers)
    return jax.tree.map(lambda leaf: next(remaining) if is_float(leaf) else leaf, tree)


def tangent_of(tree: Any, numbers: Iterable[Any]) -> Any:
    """The tangent of a tree in JAX: `numbers` for its float leaves, float0 for its modes."""
    remaining = iter(numbers)
    return jax.tree.map(
        lambda leaf: next(remaining) if is_float(leaf) else np.zeros(np.shape(leaf), jax.dtypes.float0), tree
    )


def vector(tree: Any) -> Float[Array, " values"]:
    """All leaves as one float64 vector (n,)."""
    leaves = [jnp.ravel(jnp.asarray(leaf)).astype(jnp.float64) for leaf in jax.tree.leaves(tree)]
    return jnp.concatenate([jnp.zeros(0), *leaves])
