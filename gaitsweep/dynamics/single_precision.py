"""Evaluation of a float64 function in single precision, with arguments and results in float64.

State that is accumulated over many steps needs float64: a step of 0.2 ms moves a body by 4e-5 m, a tenth of
the resolution of float32 at a kilometre. Forces and accelerations do not. A function written for float64,
with NumPy constants in it, is traced, and its operations are repeated in float32.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend import core

from gaitsweep.errors import ArgumentError

_DOUBLE = np.dtype("float64")
_SINGLE = np.dtype("float32")


def evaluated_in(dtype: Any, function: Callable[..., Any]) -> Callable[..., Any]:
    """A function with its floating-point arithmetic in `dtype` and its results in float64.

    Args:
        dtype: float64 (the function itself) or float32.
        function: a pure function of pytrees of arrays, without JAX loops or branches.

    Raises:
        ArgumentError: `dtype` is another one.
        ValueError: at the call, if the function has a loop or a branch.
    """
    if np.dtype(dtype) not in (_SINGLE, _DOUBLE):
        raise ArgumentError(f"dtype is {np.dtype(dtype)}, but must be float32 or float64.")
    if np.dtype(dtype) == _DOUBLE:
        return function

    def in_single_precision(*args: Any) -> Any:
        program, shapes = jax.make_jaxpr(function, return_shape=True)(*args)
        inputs = [_single(jnp.asarray(leaf)) for leaf in jax.tree.leaves(args)]
        outputs = [_double(value) for value in _evaluated(program, inputs)]
        return jax.tree.unflatten(jax.tree.structure(shapes), outputs)

    return in_single_precision


def _evaluated(closed: core.ClosedJaxpr, inputs: Sequence[Any]) -> list[Any]:
    """The outputs of a jaxpr whose float64 operations are done in float32."""
    program = closed.jaxpr
    values_of: dict[Any, Any] = dict(zip(program.invars, inputs, strict=True))
    values_of |= dict(zip(program.constvars, [_single(constant) for constant in closed.consts], strict=True))

    def read(atom: Any) -> Any:
        return _single(atom.val) if isinstance(atom, core.Literal) else values_of[atom]

    for equation in program.eqns:
        operands = [read(atom) for atom in equation.invars]
        params = equation.params
        inner = params.get("jaxpr", params.get("call_jaxpr"))
        if equation.primitive.name in ("pjit", "jit", "closed_call", "custom_jvp_call"):
            outputs = _evaluated(inner, operands)
        elif any(isinstance(p, core.Jaxpr | core.ClosedJaxpr) for p in jax.tree.leaves(params)):
            raise ValueError(
                f"{equation.primitive.name} cannot be evaluated in float32 inside a float64 program. "
                "Allowed: arithmetic without loops and branches (use jnp.where)."
            )
        else:
            typed = {name: _single_dtype(value) for name, value in params.items()}
            outputs = equation.primitive.bind(*operands, **typed)
            outputs = outputs if equation.primitive.multiple_results else [outputs]
        values_of |= dict(zip(equation.outvars, outputs, strict=True))
    return [read(atom) for atom in program.outvars]


def _single(value: Any) -> Any:
    """A float64 array, scalar or constant as float32."""
    if isinstance(value, float):
        return np.float32(value)
    return value.astype(_SINGLE) if getattr(value, "dtype", np.dtype(bool)) == _DOUBLE else value


def _double(value: Any) -> Any:
    """A float32 array or scalar as float64."""
    return jnp.asarray(value, _DOUBLE) if getattr(value, "dtype", np.dtype(bool)) == _SINGLE else value


def _single_dtype(param: Any) -> Any:
    """A parameter of an operation, with float32 in place of the type float64."""
    return _SINGLE if isinstance(param, np.dtype | type) and param == _DOUBLE else param
