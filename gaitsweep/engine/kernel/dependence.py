"""Which results of a function depend on which of its arguments, read off its program."""

from __future__ import annotations

from collections.abc import Callable, Collection
from typing import Any

import jax
from jax.extend.core import Literal


def dependent(function: Callable[..., Any], given: tuple[Any, ...], names: Collection[str]) -> list[bool]:
    """Whether each array that a function returns depends on an argument with one of these names.

    A result that passes through a function that is compiled by itself, or through a branch, counts as
    dependent where any argument of that is.

    Args:
        function: of mappings of arrays by name.
        given: shapes and dtypes of its arguments, each a mapping.
        names: keys of the mappings.
    """
    closed = jax.make_jaxpr(function)(*given)
    paths = [path for path, _ in jax.tree_util.tree_flatten_with_path(given)[0]]
    found = {
        variable
        for variable, path in zip(closed.jaxpr.invars, paths, strict=True)
        if getattr(path[-1], "key", None) in names
    }
    for equation in closed.jaxpr.eqns:
        if any(not isinstance(each, Literal) and each in found for each in equation.invars):
            found.update(equation.outvars)
    return [not isinstance(each, Literal) and each in found for each in closed.jaxpr.outvars]
