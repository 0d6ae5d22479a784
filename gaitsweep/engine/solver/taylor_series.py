"""Taylor series of a flow's solution, from the recurrences of its operations.

The program of the flow is evaluated order by order: the coefficient of order k of each operation follows
from those of its arguments up to k, and that of the solution of order k + 1 is the flow's of order k divided
by k + 1. All coefficients up to order p cost p^2 / 2 products for each product in the flow.

`recurrences` has the rule of each operation.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
from jax.extend.core import ClosedJaxpr, Literal

from gaitsweep.contract import Params, Rates, State
from gaitsweep.engine.solver.recurrences import RULES, NoRecurrenceError, Series, Value

# The parameters of an equation that hold an inner program.
_INNER = ("jaxpr", "call_jaxpr", "fun_jaxpr")


def solution(
    flow: Callable[[Params, State], Rates], params: Params, state: State, order: int
) -> dict[str, list[Value]]:
    """The Taylor coefficients of a solution about a state, by field, from order 0 to `order`.

    Args:
        flow: the flow.
        params: its parameters.
        state: the state about which the solution is expanded.
        order: the highest order.

    Raises:
        NoRecurrenceError: the flow has an operation without a recurrence.
    """
    with jax.disable_jit():  # the program of a jitted function is then inlined
        closed, rates = jax.make_jaxpr(flow, return_shape=True)(params, state)
    program = _Program(closed)
    names = sorted(rates)  # the order of the leaves of a dict
    values, tree = jax.tree.flatten((params, state))
    places = jax.tree.unflatten(tree, range(len(values)))[1]
    inputs: list[Series] = [[value] for value in values]
    for k in range(order):
        rates_of_order = program(k, [_up_to(series, k) for series in inputs])
        for name, rate in zip(names, rates_of_order, strict=True):
            shape = jnp.shape(getattr(state, name))
            term = None if rate is None else jnp.broadcast_to(rate / (k + 1), shape)
            inputs[getattr(places, name)].append(term)
    solutions: dict[str, list[Value]] = {}
    for name in names:
        zero = jnp.zeros_like(getattr(state, name))
        terms = inputs[getattr(places, name)]
        solutions[name] = [zero if term is None else term for term in terms]
    return solutions


def along(
    function: Callable[[State], Value], state: State, series: dict[str, list[Value]], order: int
) -> list[Value]:
    """The Taylor coefficients of a function of the state along a solution.

    Args:
        function: the function of one state.
        state: the state about which the solution is expanded.
        series: the coefficients of the solution by field, from `solution`.
        order: the highest order.

    Raises:
        NoRecurrenceError: the function has an operation without a recurrence.
    """
    with jax.disable_jit():
        closed = jax.make_jaxpr(function)(state)
    values, tree = jax.tree.flatten(state)
    places = jax.tree.unflatten(tree, range(len(values)))
    inputs: list[Series] = [[value] for value in values]
    for name, terms in series.items():
        inputs[getattr(places, name)] = list(terms)
    program = _Program(closed)
    coefficients: list[Value] = []
    for k in range(order + 1):
        (term,) = program(k, [_up_to(series, k) for series in inputs])
        coefficients.append(jnp.zeros_like(coefficients[0]) if term is None else term)
    return coefficients


def _up_to(series: Series, k: int) -> Series:
    """The coefficients up to order k; those that are missing are zero."""
    return [*series[: k + 1], *[None] * (k + 1 - len(series))]


class _Program:
    """A program and the coefficients of its variables so far."""

    def __init__(self, closed: ClosedJaxpr) -> None:
        self.jaxpr = closed.jaxpr
        self.known: dict[Any, Series] = {}
        for variable, value in zip(self.jaxpr.constvars, closed.consts, strict=True):
            self.known[variable] = [jnp.asarray(value)]
        self.operations = [_Operation(equation) for equation in self.jaxpr.eqns]

    def __call__(self, k: int, inputs: Sequence[Series]) -> Series:
        """The coefficients of order k of the results, after those of all lower orders."""
        self.known.update(zip(self.jaxpr.invars, inputs, strict=True))
        for operation in self.operations:
            args = [self._series(atom, k) for atom in operation.equation.invars]
            for variable, value in zip(operation.equation.outvars, operation(k, args), strict=True):
                self.known.setdefault(variable, []).append(value)
        return [self._series(atom, k)[k] for atom in self.jaxpr.outvars]

    def _series(self, atom: Any, k: int) -> Series:
        """The coefficients of a variable or a number up to order k."""
        series = [jnp.asarray(atom.val)] if isinstance(atom, Literal) else self.known[atom]
        return series if len(series) > k else _up_to(series, k)


class _Operation:
    """An equation of a program, or an inner program, with its results so far; see `recurrences.Operation`."""

    def __init__(self, equation: Any) -> None:
        self.equation = equation
        self.name: str = equation.primitive.name
        self.results: list[Series] = [[] for _ in equation.outvars]
        self.auxiliary: dict[str, Series] = {}
        self.inner: _Program | None = None
        for key in _INNER:
            if key in equation.params:
                inner = equation.params[key]
                self.inner = _Program(inner if isinstance(inner, ClosedJaxpr) else ClosedJaxpr(inner, []))
                break

    def __call__(self, k: int, args: list[Series]) -> Series:
        """The coefficients of order k of the results."""
        if self.inner is not None:
            terms = self.inner(k, args)
        elif k == 0:
            first = self.equation.primitive.bind(*(a[0] for a in args), **self.equation.params)
            terms = list(first) if self.equation.primitive.multiple_results else [first]
        elif all(term is None for a in args for term in a[1 : k + 1]):
            terms = [None] * len(self.results)
        elif self.name in RULES:
            terms = RULES[self.name](self, k, args)
        else:
            raise NoRecurrenceError(f"JAX's operation {self.name}")
        for series, term in zip(self.results, terms, strict=True):
            # where an array is constant and a number moves, the term of their sum is a number
            if k > 0 and term is not None:
                term = jnp.broadcast_to(term, jnp.shape(series[0]))
            series.append(term)
        return [series[k] for series in self.results]

    def bind(self, *args: Value) -> Value:
        """The result of JAX's operation for these arguments."""
        return self.equation.primitive.bind(*args, **self.equation.params)
