"""Recurrences of JAX's operations: the Taylor coefficients of results from those of arguments.

A. Jorba and M. Zou, A software package for the numerical integration of ODEs by means of high-order Taylor
methods, Exp. Math. 14 (2005) 99-117.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Protocol

import jax.numpy as jnp
from jax.extend.core import Literal
from jaxtyping import Array, Num

from gaitsweep.errors import ArgumentError

Value = Num[Array, " ..."]
# A coefficient: an array, or None for zero.
Coefficient = Any
# Coefficients in order of rising power.
Series = list[Coefficient]


class Operation(Protocol):
    """An equation of a program: its results so far, and the auxiliary series that its recurrence needs."""

    equation: Any
    name: str
    results: list[Series]
    auxiliary: dict[str, Series]

    def bind(self, *args: Value) -> Value:
        """The result of JAX's operation for these arguments."""
        ...


# The coefficient of order k >= 1 of the results of an operation, from the series of its arguments.
Rule = Callable[[Operation, int, list[Series]], Series]


class NoRecurrenceError(ArgumentError):
    """A flow has an operation without a recurrence; `operation` is its description."""

    def __init__(self, operation: str) -> None:
        super().__init__(f"The method taylor has no recurrence for {operation}: use tsit5.")
        self.operation = operation


def _sum(pairs: Sequence[tuple[Coefficient, Coefficient]]) -> Coefficient:
    """The sum of the products a b of pairs."""
    total = None
    for a, b in pairs:
        if a is not None and b is not None:
            total = _plus(total, a * b)
    return total


def _product(k: int, a: Series, b: Series) -> Coefficient:
    """The coefficient of order k of a product."""
    if a is b:  # each pair once
        half = _sum([(a[j], a[k - j]) for j in range((k + 1) // 2)])
        half = None if half is None else 2.0 * half
        return half if k % 2 else _plus(half, _sum([(a[k // 2], a[k // 2])]))
    return _sum([(a[j], b[k - j]) for j in range(k + 1)])


def _moment(k: int, a: Series, b: Series, *, last: bool = True) -> Coefficient:
    """(1/k) times the sum of j a_j b_(k-j) over j = 1..k (`last`) or 1..k-1."""
    # j a_j is shared by all orders
    slopes = [None if term is None else j * term for j, term in enumerate(a)]
    total = _sum([(slopes[j], b[k - j]) for j in range(1, k + 1 if last else k)])
    return None if total is None else total * (1.0 / k)


def _plus(a: Coefficient, b: Coefficient) -> Coefficient:
    """The sum of two coefficients."""
    if a is None:
        return b
    return a if b is None else a + b


def _minus(a: Coefficient, b: Coefficient) -> Coefficient:
    """The difference of two coefficients."""
    if b is None:
        return a
    return -b if a is None else a - b


def _filled(value: Coefficient, like: Value) -> Value:
    """A coefficient as an array: zeros for None."""
    return jnp.zeros_like(like) if value is None else value


def _linear(operation: Operation, k: int, args: list[Series]) -> Series:
    """An operation that is linear in all its arguments, such as a concatenation."""
    return [operation.bind(*(_filled(a[k], a[0]) for a in args))]


def _first_moves(operation: Operation, k: int, args: list[Series]) -> Series:
    """An operation that is linear in its first argument; the others are indices or shapes."""
    first, *others = args
    _refuse_moving(operation, k, others)
    if first[k] is None:
        return [None] * len(operation.results)
    moved = operation.bind(first[k], *(a[0] for a in others))
    return list(moved) if operation.equation.primitive.multiple_results else [moved]


def _remainder(operation: Operation, k: int, args: list[Series]) -> Series:
    """A remainder a - n b: between switches n is constant, and here b too."""
    dividend, divisor = args
    _refuse_moving(operation, k, [divisor])
    return [dividend[k]]


def _refuse_moving(operation: Operation, k: int, args: list[Series]) -> None:
    """Refuse arguments of an operation that move."""
    if any(term is not None for arg in args for term in arg[1 : k + 1]):
        raise NoRecurrenceError(f"JAX's operation {operation.name} with a moving argument after the first")


def _of_arguments(coefficient: Callable[..., Coefficient]) -> Rule:
    """An operation of one result, whose `coefficient(k, *args)` follows from its arguments alone."""
    return lambda operation, k, args: [coefficient(k, *args)]


def _div(operation: Operation, k: int, args: list[Series]) -> Series:
    """A quotient c = a / b: b_0 c_k = a_k - sum of b_j c_(k-j) over j = 1..k."""
    a, b = args
    lower_terms = _sum([(b[j], operation.results[0][k - j]) for j in range(1, k + 1)])
    numerator = _minus(a[k], lower_terms)
    return [None if numerator is None else numerator / b[0]]


def _dot(operation: Operation, k: int, args: list[Series]) -> Series:
    """A product of matrices or vectors."""
    total = None
    for j in range(k + 1):
        a = args[0][j]
        b = args[1][k - j]
        if a is not None and b is not None:
            total = _plus(total, operation.bind(a, b))
    return [total]


# The exponents of powers that are computed by products.
_WHOLE = range(-16, 17)


def _power(exponent: float) -> Rule:
    """A power with a constant exponent."""
    return lambda operation, k, args: [_of_power(operation, exponent, k, args[0])]


def _of_power(operation: Operation, exponent: Any, k: int, a: Series) -> Coefficient:
    """The coefficient of order k of c = a^r, where a does not move through zero: a c' = r c a'."""
    total = None
    c = operation.results[0]
    for j in range(1, k + 1):
        if a[j] is not None and c[k - j] is not None:
            total = _plus(total, ((exponent + 1.0) * j / k - 1.0) * a[j] * c[k - j])
    return None if total is None else total / jnp.where(_stays_zero(operation, k, a), 1.0, a[0])


def _stays_zero(operation: Operation, k: int, a: Series) -> Value:
    """Whether a is zero up to order k, as max(x, 0) is for x < 0; powers of it are zero then, not 0/0."""
    zero = operation.auxiliary.setdefault("zero", [a[0] == 0.0])
    while len(zero) <= k:
        term = a[len(zero)]
        zero.append(zero[-1] if term is None else zero[-1] & (term == 0.0))
    return zero[k]


def _sqrt(operation: Operation, k: int, args: list[Series]) -> Series:
    """A square root c: 2 c_0 c_k = a_k - sum of c_j c_(k-j) over j = 1..k-1."""
    c = operation.results[0]
    numerator = _minus(args[0][k], _sum([(c[j], c[k - j]) for j in range(1, k)]))
    if numerator is None:
        return [None]
    return [numerator / jnp.where(_stays_zero(operation, k, args[0]), 1.0, 2.0 * c[0])]


def _pow(operation: Operation, k: int, args: list[Series]) -> Series:
    base, exponent = args
    written = operation.equation.invars[1]
    # a whole power by products, which hold at zero too
    if isinstance(written, Literal) and written.val in _WHOLE:
        return [_whole_power(operation, int(written.val), k, base)]
    if all(term is None for term in exponent[1:]):
        return [_of_power(operation, exponent[0], k, base)]
    # a^b = exp(b log a)
    logarithm = operation.auxiliary.setdefault("logarithm", [jnp.log(base[0])])
    while len(logarithm) <= k:
        logarithm.append(_of_log(len(logarithm), base, logarithm))
    argument = _grown(operation, "argument", k, lambda n: _product(n, exponent, logarithm))
    return [_moment(k, argument, operation.results[0])]


def _whole_power(operation: Operation, exponent: int, k: int, series: Series) -> Coefficient:
    """The coefficient of order k of a whole power, by products, which hold at zero too."""
    if exponent == 0:
        return None
    powers = operation.auxiliary
    for n in range(2, abs(exponent) + 1):
        below = series if n == 2 else powers[str(n - 1)]
        own = powers.setdefault(str(n), [series[0] ** n])
        if len(own) == k:
            own.append(_product(k, series, below))
    power = series if abs(exponent) == 1 else powers[str(abs(exponent))]
    if exponent > 0:
        return power[k]
    lower_terms = _sum([(power[j], operation.results[0][k - j]) for j in range(1, k + 1)])
    return None if lower_terms is None else -lower_terms / power[0]


def _derivative(slope: Callable[[Operation, int], Series]) -> Rule:
    """A function with c' = v a', where `slope(operation, k)` is the series of v up to order k - 1."""
    return lambda operation, k, args: [_moment(k, args[0], slope(operation, k))]


def _grown(operation: Operation, name: str, k: int, coefficient: Callable[[int], Coefficient]) -> Series:
    """An auxiliary series of an operation, extended to order k."""
    series = operation.auxiliary.setdefault(name, [])
    while len(series) <= k:
        series.append(coefficient(len(series)))
    return series


def _one_minus_square(operation: Operation, k: int) -> Series:
    """The slope 1 - c^2 of the hyperbolic tangent."""
    c = operation.results[0]

    def coefficient(n: int) -> Coefficient:
        return 1.0 - c[0] * c[0] if n == 0 else _minus(None, _product(n, c, c))

    return _grown(operation, "slope", k - 1, coefficient)


def _own_times_complement(operation: Operation, k: int) -> Series:
    """The slope c (1 - c) of the logistic function."""
    c = operation.results[0]

    def coefficient(n: int) -> Coefficient:
        return c[0] * (1.0 - c[0]) if n == 0 else _minus(c[n], _product(n, c, c))

    return _grown(operation, "slope", k - 1, coefficient)


def _arctangent(operation: Operation, k: int, args: list[Series]) -> Series:
    """The arctangent: (1 + a^2) c' = a'."""
    a = args[0]
    c = operation.results[0]

    def coefficient(n: int) -> Coefficient:
        return 1.0 + a[0] * a[0] if n == 0 else _product(n, a, a)

    d = _grown(operation, "slope", k - 1, coefficient)
    numerator = _minus(a[k], _moment(k, c, d, last=False) if k > 1 else None)
    return [None if numerator is None else numerator / d[0]]


def _circular(other: str, own_sign: float, other_sign: float) -> Rule:
    """A function f with f' = own_sign g, g' = other_sign f, and g as an auxiliary series.

    They are sine and cosine, and their hyperbolic forms.

    Args:
        other: the name of the function g.
        own_sign, other_sign: 1 or -1.
    """

    def rule(operation: Operation, k: int, args: list[Series]) -> Series:
        a = args[0]
        own = operation.results[0]
        of_other = operation.auxiliary.setdefault("other", [])
        if not of_other:
            of_other.append(getattr(jnp, other)(a[0]))
        while len(of_other) < k:
            term = _moment(len(of_other), a, own)
            of_other.append(_minus(None, term) if other_sign < 0.0 else term)
        term = _moment(k, a, of_other)
        return [_minus(None, term) if own_sign < 0.0 else term]

    return rule


def _plus_one(a: Series) -> Series:
    """The series of 1 + a."""
    return [1.0 + a[0], *a[1:]]


def _of_log(k: int, a: Series, c: Series) -> Coefficient:
    """The coefficient of order k of c = log a."""
    numerator = _minus(a[k], _moment(k, c, a, last=False) if k > 1 else None)
    return None if numerator is None else numerator / a[0]


def _chosen(operation: Operation, k: int, args: list[Series]) -> Series:
    """A choice between cases by a condition, which is constant between switches."""
    which, *cases = args
    return [operation.bind(which[0], *(_filled(case[k], case[0]) for case in cases))]


def _extreme(operation: Operation, k: int, args: list[Series]) -> Series:
    """The larger or the smaller of two arguments, which is the same one between switches."""
    a, b = args
    first = a[0] >= b[0] if operation.name == "max" else a[0] <= b[0]
    shape = jnp.broadcast_shapes(jnp.shape(a[0]), jnp.shape(b[0]))
    of_a = jnp.broadcast_to(_filled(a[k], a[0]), shape)
    of_b = jnp.broadcast_to(_filled(b[k], b[0]), shape)
    return [jnp.where(first, of_a, of_b)]


def _clamped(operation: Operation, k: int, args: list[Series]) -> Series:
    """A number between two bounds, which is itself or the same bound between switches."""
    lowest, value, highest = args
    low, inside, high = (_filled(series[k], series[0]) for series in args)
    above = jnp.where(value[0] > highest[0], high, inside)
    return [jnp.where(value[0] < lowest[0], low, above)]


def _extreme_of(operation: Operation, k: int, args: list[Series]) -> Series:
    """The largest or the smallest element over some axes, which is the same one between switches."""
    a = args[0]
    if a[k] is None:
        return [None]
    axes = operation.equation.params["axes"]
    shape = (-1, *operation.results[0][0].shape)
    values = jnp.reshape(jnp.moveaxis(a[0], axes, range(len(axes))), shape)
    coefficients = jnp.reshape(jnp.moveaxis(a[k], axes, range(len(axes))), shape)
    best = values[0]
    of_best = coefficients[0]
    for value, coefficient in zip(values[1:], coefficients[1:], strict=True):
        better = value > best if operation.name == "reduce_max" else value < best
        best = jnp.where(better, value, best)
        of_best = jnp.where(better, coefficient, of_best)
    return [of_best]


def _absolute(k: int, a: Series) -> Coefficient:
    """The coefficient of order k of an absolute value, of a number that keeps its sign between switches."""
    return None if a[k] is None else jnp.where(a[0] < 0.0, -a[k], a[k])


def _constant(operation: Operation, k: int, args: list[Series]) -> Series:
    """A result that is constant between switches."""
    return [None] * len(operation.results)


def _converted(operation: Operation, k: int, args: list[Series]) -> Series:
    """A conversion of the dtype; to integers or flags it is constant between switches."""
    floating = jnp.issubdtype(operation.equation.outvars[0].aval.dtype, jnp.floating)
    return _first_moves(operation, k, args) if floating else [None]


def _scattered(operation: Operation, k: int, args: list[Series]) -> Series:
    """An array with elements set, or increased, at constant indices."""
    into, indices, values = args
    if operation.name == "scatter" and operation.equation.params["update_jaxpr"] is not None:
        raise NoRecurrenceError("elements changed by a function, as by .at[].apply")
    return [operation.bind(_filled(into[k], into[0]), indices[0], _filled(values[k], values[0]))]


def _updated(operation: Operation, k: int, args: list[Series]) -> Series:
    """An array with a slice set at constant indices."""
    into, values, *indices = args
    updated = _filled(into[k], into[0])
    return [operation.bind(updated, _filled(values[k], values[0]), *(index[0] for index in indices))]


RULES: dict[str, Rule] = {
    **dict.fromkeys(("add", "add_any"), _of_arguments(lambda k, a, b: _plus(a[k], b[k]))),
    "sub": _of_arguments(lambda k, a, b: _minus(a[k], b[k])),
    "neg": _of_arguments(lambda k, a: _minus(None, a[k])),
    "mul": _of_arguments(_product),
    "square": _of_arguments(lambda k, a: _product(k, a, a)),
    "div": _div,
    "dot_general": _dot,
    "sqrt": _sqrt,
    "rsqrt": _power(-0.5),
    "cbrt": _power(1.0 / 3.0),
    "pow": _pow,
    "integer_pow": lambda operation, k, args: [
        _whole_power(operation, operation.equation.params["y"], k, args[0])
    ],
    "exp": _derivative(lambda operation, k: operation.results[0]),
    "expm1": _derivative(lambda operation, k: _plus_one(operation.results[0])),
    "tanh": _derivative(_one_minus_square),
    "logistic": _derivative(_own_times_complement),
    "atan": _arctangent,
    "log": lambda operation, k, args: [_of_log(k, args[0], operation.results[0])],
    "log1p": lambda operation, k, args: [_of_log(k, _plus_one(args[0]), operation.results[0])],
    "sin": _circular("cos", 1.0, -1.0),
    "cos": _circular("sin", -1.0, 1.0),
    "sinh": _circular("cosh", 1.0, 1.0),
    "cosh": _circular("sinh", 1.0, 1.0),
    "select_n": _chosen,
    "max": _extreme,
    "min": _extreme,
    "clamp": _clamped,
    "reduce_max": _extreme_of,
    "reduce_min": _extreme_of,
    "abs": _of_arguments(_absolute),
    "convert_element_type": _converted,
    "rem": _remainder,
    "scatter": _scattered,
    "scatter-add": _scattered,
    "dynamic_update_slice": _updated,
    **dict.fromkeys(("concatenate", "stack", "pad"), _linear),
    **dict.fromkeys(
        (
            "broadcast_in_dim", "reshape", "squeeze", "slice", "transpose", "rev", "copy", "reduce_sum",
            "cumsum", "gather", "dynamic_slice", "expand_dims", "split", "unstack", "name", "stop_gradient",
        ),
        _first_moves,
    ),
    **dict.fromkeys(
        ("sign", "floor", "ceil", "round", "lt", "le", "gt", "ge", "eq", "ne",
         "is_finite", "argmax", "argmin", "lt_to", "le_to", "eq_to"),
        _constant,
    ),
}  # fmt: skip
# In guards, a part without derivative, such as a margin for rounding, counts as constant.
RULES_OF_GUARDS: dict[str, Rule] = {**RULES, "stop_gradient": _constant}
