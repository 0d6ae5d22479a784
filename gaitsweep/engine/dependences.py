"""The arguments on which the results of a function depend, by its traced program."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
from jax.extend.core import Literal


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
