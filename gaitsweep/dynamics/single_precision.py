"""Functions worked out in single precision whose arguments and results stay in double.

State that is added to step by step needs float64: a step of 0.2 ms moves a body by 4e-5 m, a tenth of what
float32 resolves at a kilometre. What it is moved by, forces and accelerations, does not. A function written
for float64, with constants of NumPy's in it, is traced and its arithmetic repeated in float32.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend import core

_DOUBLE, _SINGLE = np.dtype("float64"), np.dtype("float32")


def worked_in(dtype: Any, function: Callable[..., Any]) -> Callable[..., Any]:
    """A function with all its floating-point arithmetic in `dtype`; what it gives is float64 again.

    Args:
        dtype: float64 (the function itself) or float32.
        function: pure, of trees of arrays, without loops or branches of JAX's.

    Raises:
        ValueError: the function has a loop or a branch; when it is called.
    """
    if np.dtype(dtype) != _SINGLE:
        return function

    def worked(*args: Any) -> Any:
        closed, shape = jax.make_jaxpr(function, return_shape=True)(*args)
        given = [_single(jnp.asarray(leaf)) for leaf in jax.tree.leaves(args)]
        found = _evaluated(closed, given)
        return jax.tree.unflatten(jax.tree.structure(shape), [_double(value) for value in found])

    return worked


def _evaluated(closed: core.ClosedJaxpr, given: Sequence[Any]) -> list[Any]:
    """What a program gives, each of its operations done in float32 where it says float64."""
    program = closed.jaxpr
    known: dict[Any, Any] = dict(zip(program.invars, given, strict=True))
    known |= dict(zip(program.constvars, [_single(constant) for constant in closed.consts], strict=True))

    def read(atom: Any) -> Any:
        return _single(atom.val) if isinstance(atom, core.Literal) else known[atom]

    for equation in program.eqns:
        values = [read(atom) for atom in equation.invars]
        params = equation.params
        inner = params.get("jaxpr", params.get("call_jaxpr"))
        if equation.primitive.name in ("pjit", "jit", "closed_call", "custom_jvp_call"):
            found = _evaluated(inner, values)
        elif any(isinstance(p, core.Jaxpr | core.ClosedJaxpr) for p in jax.tree.leaves(params)):
            raise ValueError(
                f"{equation.primitive.name} cannot be worked out in float32 inside a float64 program. "
                "Allowed: arithmetic without loops and branches (jnp.where chooses)."
            )
        else:
            typed = {name: _single_dtype(value) for name, value in params.items()}
            found = equation.primitive.bind(*values, **typed)
            found = found if equation.primitive.multiple_results else [found]
        known |= dict(zip(equation.outvars, found, strict=True))
    return [read(atom) for atom in program.outvars]


def _single(value: Any) -> Any:
    """A float64 array, scalar or constant as float32."""
    if isinstance(value, float):
        return np.float32(value)
    return value.astype(_SINGLE) if getattr(value, "dtype", np.dtype(bool)) == _DOUBLE else value


def _double(value: Any) -> Any:
    return jnp.asarray(value, _DOUBLE) if getattr(value, "dtype", np.dtype(bool)) == _SINGLE else value


def _single_dtype(param: Any) -> Any:
    return _SINGLE if isinstance(param, np.dtype | type) and param == _DOUBLE else param
