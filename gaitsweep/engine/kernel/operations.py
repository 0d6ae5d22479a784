"""The scalar operations of a program: result kind, NumPy evaluation, source in Python and in C."""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Callable
from fractions import Fraction
from typing import Any, Literal

import numpy as np

from gaitsweep.dynamics.random_numbers import fraction

Kind = Literal["f64", "f32", "int", "bool"]


@dataclasses.dataclass(frozen=True, slots=True)
class Operation:
    """A scalar operation.

    Attributes:
        kind: kind of the result; "same" is the kind of the last argument.
        evaluate: the operation with NumPy.
        python, c: its source. {0}, {1}, ... are the arguments, {bits} is the width of the last one (32 or
            64), and {f} the suffix of C's functions of float32, "f" or "".
        commutes: whether the two arguments may be exchanged.
    """

    kind: Kind | Literal["same"]
    evaluate: Callable[..., Any]
    python: str
    c: str
    commutes: bool = False


def _select(condition: Any, yes: Any, no: Any) -> Any:
    """The second argument if the first is true, else the third."""
    return yes if condition else no


def _fused(a: Any, b: Any, c: Any) -> Any:
    """The sum a * b + c, rounded once."""
    try:
        exact = Fraction(float(a)) * Fraction(float(b)) + Fraction(float(c))
        if exact:
            return type(c)(float(exact))
    except (OverflowError, ValueError):  # infinite or NaN
        pass
    return a * b + c  # of a sum that is 0, too, since a fraction has no sign of zero


def _infix(
    kind: Literal["same", "bool"], evaluate: Callable[..., Any], source: str, *, commutes: bool = False
) -> Operation:
    """An operator that Python and C write alike."""
    return Operation(kind, evaluate, source, source, commutes)


def _function(name: str, evaluate: Callable[..., Any]) -> Operation:
    """A function of the mathematical library, which is not vectorised over lanes."""
    return Operation("same", evaluate, f"math.{name}({{0}})", f"{name}{{f}}({{0}})")


def _from_math(name: str) -> Operation:
    """A function of the mathematical library that NumPy lacks."""
    return _function(name, lambda x: type(x)(getattr(math, name)(x)))


def _random(half: int) -> Operation:
    """A random number between 0 and 1 of a seed, a counter and a stream, by two of the generator's words."""
    arguments = "{0}, {1}, {2}"
    return Operation(
        "f64",
        functools.partial(fraction, half=half),
        f"philox{half}({arguments})",
        f"philox({arguments}, {half})",
    )


OPERATIONS: dict[str, Operation] = {
    "add": _infix("same", lambda a, b: a + b, "{0} + {1}", commutes=True),
    "sub": _infix("same", lambda a, b: a - b, "{0} - {1}"),
    "mul": _infix("same", lambda a, b: a * b, "{0} * {1}", commutes=True),
    "div": _infix("same", lambda a, b: a / b, "{0} / {1}"),
    "fma": Operation("same", _fused, "fma({0}, {1}, {2})", "fma{f}({0}, {1}, {2})"),
    "fms": Operation(
        "same", lambda a, b, c: _fused(a, b, -c), "fma({0}, {1}, -{2})", "fma{f}({0}, {1}, -{2})"
    ),
    "fnma": Operation(
        "same", lambda a, b, c: _fused(-a, b, c), "fma(-{0}, {1}, {2})", "fma{f}(-{0}, {1}, {2})"
    ),
    "neg": _infix("same", lambda a: -a, "-{0}"),
    "abs": Operation("same", np.abs, "abs({0})", "fabs{f}({0})"),
    "floor": Operation("same", np.floor, "floor{bits}({0})", "floor{f}({0})"),
    "sqrt": Operation("same", np.sqrt, "sqrt{bits}({0})", "sqrt{f}({0})"),
    "lt": _infix("bool", lambda a, b: a < b, "{0} < {1}"),
    "le": _infix("bool", lambda a, b: a <= b, "{0} <= {1}"),
    "eq": _infix("bool", lambda a, b: a == b, "{0} == {1}", commutes=True),
    "ne": _infix("bool", lambda a, b: a != b, "{0} != {1}", commutes=True),
    "and": _infix("bool", lambda a, b: a & b, "{0} & {1}", commutes=True),
    "or": _infix("bool", lambda a, b: a | b, "{0} | {1}", commutes=True),
    "not": Operation("bool", np.logical_not, "not {0}", "!{0}"),
    "select": Operation("same", _select, "{1} if {0} else {2}", "{0} ? {1} : {2}"),
    "to_f32": Operation("f32", np.float32, "float32({0})", "(float){0}"),
    "to_f64": Operation("f64", np.float64, "float64({0})", "(double){0}"),
    # integers are represented by float64; only the kind changes
    "to_int": Operation("int", np.float64, "float64({0})", "(double){0}"),
    "log": _function("log", np.log),
    "log1p": _function("log1p", np.log1p),
    "expm1": _function("expm1", np.expm1),
    "asinh": _function("asinh", np.arcsinh),
    "acosh": _function("acosh", np.arccosh),
    "atanh": _function("atanh", np.arctanh),
    "pow": Operation("same", np.power, "{0} ** {1}", "pow{f}({0}, {1})"),
    "erf": _from_math("erf"),
    "erfc": _from_math("erfc"),
    **{f"philox{half}": _random(half) for half in (0, 1)},
}
