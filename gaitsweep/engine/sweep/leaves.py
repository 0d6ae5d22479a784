"""The numbers of a tree of arrays, which have derivatives; its modes (bools, integers) have none."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np


def is_number(array: Any) -> bool:
    """Whether a leaf is of floats."""
    return bool(jnp.issubdtype(jnp.result_type(array), jnp.floating))


def numbers_of(tree: Any) -> list[Any]:
    """The leaves of floats, in their order."""
    return [leaf for leaf in jax.tree.leaves(tree) if is_number(leaf)]


def with_numbers(tree: Any, numbers: Iterable[Any]) -> Any:
    """The tree with these in place of its leaves of floats."""
    given = iter(numbers)
    return jax.tree.map(lambda leaf: next(given) if is_number(leaf) else leaf, tree)


def tangent_of(tree: Any, numbers: Iterable[Any]) -> Any:
    """A tangent of the tree, as JAX has them: these for its leaves of floats, nothing for its modes."""
    given = iter(numbers)
    return jax.tree.map(
        lambda leaf: next(given) if is_number(leaf) else np.zeros(np.shape(leaf), jax.dtypes.float0), tree
    )


def vector(tree: Any) -> jax.Array:
    """All leaves as one vector of float64."""
    leaves = [jnp.ravel(jnp.asarray(leaf)).astype(jnp.float64) for leaf in jax.tree.leaves(tree)]
    return jnp.concatenate([jnp.zeros(0), *leaves])
