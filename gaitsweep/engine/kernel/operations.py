"""The scalar operations of a program: result kind, NumPy evaluation, Python source."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from typing import Any

import numpy as np


@dataclasses.dataclass(frozen=True, slots=True)
class Operation:
    """A scalar operation.

    `kind` is that of the result ("same": the kind of the last argument); `evaluate` computes it with NumPy;
    in its `source`, {0}, {1}, ... are the arguments and {bits} is the width of the last one, 32 or 64.
    """

    kind: str
    evaluate: Callable[..., Any]
    source: str
    commutes: bool = False


def _select(condition: Any, yes: Any, no: Any) -> Any:
    return yes if condition else no


def _call(name: str) -> Operation:
    """A library function of NumPy, which is not vectorised over lanes."""
    return Operation("same", getattr(np, name), f"math.{_MATH.get(name, name)}({{0}})")


_MATH = {"arcsinh": "asinh", "arccosh": "acosh", "arctanh": "atanh"}


def _of_math(name: str) -> Operation:
    """A library function that NumPy does not have."""
    return Operation("same", lambda x: type(x)(getattr(math, name)(x)), f"math.{name}({{0}})")


OPERATIONS: dict[str, Operation] = {
    "add": Operation("same", lambda a, b: a + b, "{0} + {1}", commutes=True),
    "sub": Operation("same", lambda a, b: a - b, "{0} - {1}"),
    "mul": Operation("same", lambda a, b: a * b, "{0} * {1}", commutes=True),
    "div": Operation("same", lambda a, b: a / b, "{0} / {1}"),
    "neg": Operation("same", lambda a: -a, "-{0}"),
    "abs": Operation("same", np.abs, "abs({0})"),
    "floor": Operation("same", np.floor, "floor{bits}({0})"),
    "sqrt": Operation("same", np.sqrt, "sqrt{bits}({0})"),
    "lt": Operation("bool", lambda a, b: a < b, "{0} < {1}"),
    "le": Operation("bool", lambda a, b: a <= b, "{0} <= {1}"),
    "eq": Operation("bool", lambda a, b: a == b, "{0} == {1}", commutes=True),
    "ne": Operation("bool", lambda a, b: a != b, "{0} != {1}", commutes=True),
    "and": Operation("bool", lambda a, b: a & b, "{0} & {1}", commutes=True),
    "or": Operation("bool", lambda a, b: a | b, "{0} | {1}", commutes=True),
    "not": Operation("bool", np.logical_not, "not {0}"),
    "select": Operation("same", _select, "{1} if {0} else {2}"),
    "to_f32": Operation("f32", np.float32, "float32({0})"),
    "to_f64": Operation("f64", np.float64, "float64({0})"),
    # integers are represented by float64; only the kind changes
    "to_int": Operation("int", np.float64, "float64({0})"),
    "log": _call("log"),
    "log1p": _call("log1p"),
    "expm1": _call("expm1"),
    "asinh": _call("arcsinh"),
    "acosh": _call("arccosh"),
    "atanh": _call("arctanh"),
    "pow": Operation("same", np.power, "{0} ** {1}"),
    "erf": _of_math("erf"),
    "erfc": _of_math("erfc"),
}
