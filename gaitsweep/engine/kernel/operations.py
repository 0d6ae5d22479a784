"""The scalar operations of a program: result kind, NumPy evaluation, source in Python and in C."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from fractions import Fraction
from typing import Any

import numpy as np


@dataclasses.dataclass(frozen=True, slots=True)
class Operation:
    """A scalar operation.

    `kind` is that of the result ("same": the kind of the last argument); `evaluate` computes it with NumPy;
    `python` and `c` are its source: {0}, {1}, ... are the arguments, {bits} is the width of the last one, 32
    or 64, and {f} is the ending of C's functions of float32, f or nothing.
    """

    kind: str
    evaluate: Callable[..., Any]
    python: str
    c: str
    commutes: bool = False


def _select(condition: Any, yes: Any, no: Any) -> Any:
    return yes if condition else no


def _fused(a: Any, b: Any, c: Any) -> Any:
    """The sum a * b + c, rounded once."""
    try:
        return type(c)(float(Fraction(float(a)) * Fraction(float(b)) + Fraction(float(c))))
    except (OverflowError, ValueError):  # infinite or NaN
        return a * b + c


def _sign(kind: str, evaluate: Callable[..., Any], source: str, *, commutes: bool = False) -> Operation:
    """An operation that Python and C write alike."""
    return Operation(kind, evaluate, source, source, commutes)


def _call(name: str, evaluate: Callable[..., Any]) -> Operation:
    """A library function, which is not vectorised over lanes."""
    return Operation("same", evaluate, f"math.{name}({{0}})", f"{name}{{f}}({{0}})")


def _of_math(name: str) -> Operation:
    """A library function that NumPy does not have."""
    return _call(name, lambda x: type(x)(getattr(math, name)(x)))


OPERATIONS: dict[str, Operation] = {
    "add": _sign("same", lambda a, b: a + b, "{0} + {1}", commutes=True),
    "sub": _sign("same", lambda a, b: a - b, "{0} - {1}"),
    "mul": _sign("same", lambda a, b: a * b, "{0} * {1}", commutes=True),
    "div": _sign("same", lambda a, b: a / b, "{0} / {1}"),
    "fma": Operation("same", _fused, "fma({0}, {1}, {2})", "fma{f}({0}, {1}, {2})"),
    "fms": Operation(
        "same", lambda a, b, c: _fused(a, b, -c), "fma({0}, {1}, -{2})", "fma{f}({0}, {1}, -{2})"
    ),
    "fnma": Operation(
        "same", lambda a, b, c: _fused(-a, b, c), "fma(-{0}, {1}, {2})", "fma{f}(-{0}, {1}, {2})"
    ),
    "neg": _sign("same", lambda a: -a, "-{0}"),
    "abs": Operation("same", np.abs, "abs({0})", "fabs{f}({0})"),
    "floor": Operation("same", np.floor, "floor{bits}({0})", "floor{f}({0})"),
    "sqrt": Operation("same", np.sqrt, "sqrt{bits}({0})", "sqrt{f}({0})"),
    "lt": _sign("bool", lambda a, b: a < b, "{0} < {1}"),
    "le": _sign("bool", lambda a, b: a <= b, "{0} <= {1}"),
    "eq": _sign("bool", lambda a, b: a == b, "{0} == {1}", commutes=True),
    "ne": _sign("bool", lambda a, b: a != b, "{0} != {1}", commutes=True),
    "and": _sign("bool", lambda a, b: a & b, "{0} & {1}", commutes=True),
    "or": _sign("bool", lambda a, b: a | b, "{0} | {1}", commutes=True),
    "not": Operation("bool", np.logical_not, "not {0}", "!{0}"),
    "select": Operation("same", _select, "{1} if {0} else {2}", "{0} ? {1} : {2}"),
    "to_f32": Operation("f32", np.float32, "float32({0})", "(float){0}"),
    "to_f64": Operation("f64", np.float64, "float64({0})", "(double){0}"),
    # integers are represented by float64; only the kind changes
    "to_int": Operation("int", np.float64, "float64({0})", "(double){0}"),
    "log": _call("log", np.log),
    "log1p": _call("log1p", np.log1p),
    "expm1": _call("expm1", np.expm1),
    "asinh": _call("asinh", np.arcsinh),
    "acosh": _call("acosh", np.arccosh),
    "atanh": _call("atanh", np.arctanh),
    "pow": Operation("same", np.power, "{0} ** {1}", "pow{f}({0}, {1})"),
    "erf": _of_math("erf"),
    "erfc": _of_math("erfc"),
}
