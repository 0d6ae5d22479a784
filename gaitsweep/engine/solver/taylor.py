"""Taylor's method, of an order that follows from the tolerance.

The program of the flow is evaluated order by order: the coefficient of order k of each operation follows from
those of its arguments up to k by its rule in `recurrences`, and that of the solution of order k + 1 is the
flow's of order k divided by k + 1. All coefficients up to order p cost p^2 / 2 products for each product in
the flow.

A step's solution is a polynomial of time, and so is each guard along it. In the Bernstein basis of the step,
the number of sign changes of a polynomial's coefficients bounds the number of its zeros (Descartes), so that
no event of a smooth guard is missed, however long the step.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import ClosedJaxpr, Literal
from jaxtyping import Float

from gaitsweep.contract import HybridModel, Params, Rates, State
from gaitsweep.engine.carry import Flag, Guards, Number
from gaitsweep.engine.content import cached_by_content
from gaitsweep.engine.solver.recurrences import (
    RULES,
    RULES_OF_GUARDS,
    NoRecurrenceError,
    Rule,
    Series,
    Value,
)
from gaitsweep.engine.stored_traces import stored
from gaitsweep.engine.switches import inner_program

# The ratio of a term to the one before at the step that meets the tolerance and costs least (Jorba, Zou).
TERM_RATIO = math.exp(-2.0)
MIN_ORDER = 4
MAX_ORDER = 20
# Largest error of a guard's polynomial, as a share of its largest value in the step.
MAX_POLYNOMIAL_ERROR = 1e-3
# Steps of Halley's method towards the zero of a guard, each of which cubes the error as a share of the trial;
# where one leaves the bracket, which is the trial at first, it is bisected.
HALLEY_STEPS = 3
# Share of the trial up to which the last of these steps leaves an error of rounding.
_LAST_STEP = 1e-5


def order_of(rtol: float) -> int:
    """The order with which a relative tolerance is met at least cost."""
    return min(max(math.ceil(1.0 - 0.5 * math.log(rtol)), MIN_ORDER), MAX_ORDER)


@dataclasses.dataclass(frozen=True)
class Expansion:
    """The Taylor expansion of a solution about a state.

    Args:
        series: the coefficients by field, in order of rising power.
    """

    series: dict[str, list[Value]]

    @property
    def order(self) -> int:
        """The highest power of time."""
        return len(next(iter(self.series.values()))) - 1

    def at(self, state: State, t: Number) -> State:
        """The state at a time on the solution.

        Args:
            state: the state about which the solution is expanded.
            t: the time after it (s).
        """
        moved = {name: polynomial(coefficients, t) for name, coefficients in self.series.items()}
        return dataclasses.replace(state, **moved)

    def error(self, h: Number, rates: Rates | None = None) -> Rates:
        """An estimate of the error after h seconds, by field.

        Args:
            h: the length of the step (s).
            rates: of a flow that may switch, the rates at its end, in which a switch within the step shows.
        """
        power = h ** (self.order - 1)
        errors = {}
        for name, coefficients in self.series.items():
            last = jnp.abs(coefficients[-1] * (power * h))
            # odd or even solutions lack every other term
            error = jnp.maximum(last, TERM_RATIO * jnp.abs(coefficients[-2] * power))
            if rates is not None:
                defect = jnp.abs(rates[name] - polynomial(_derivative(coefficients), h))
                error = jnp.maximum(error, h * defect)
            errors[name] = error
        return errors

    def along(self, function: Callable[[State], Value], state: State) -> list[Value]:
        """The Taylor coefficients of guards along the solution.

        Args:
            function: the guards of one state.
            state: the state about which the solution is expanded.
        """
        return along(function, state, self.series, self.order)


def taylor(model: HybridModel, order: int) -> Callable[[Params, State, Number], Expansion]:
    """The step of Taylor's method, which returns the expansion of the solution.

    Args:
        model: the model.
        order: the order of the expansion.
    """
    return lambda params, state, h: Expansion(solution(model.flow, params, state, order))


@cached_by_content(maxsize=64)
def lacking_recurrence(model: HybridModel) -> str | None:
    """JAX's operation in the flow or the guards of a model that has no recurrence; None if all have one."""
    return stored("recurrence", model, (), lambda: _lacking_recurrence(model))


def _lacking_recurrence(model: HybridModel) -> str | None:
    """The result of `lacking_recurrence`, for which the model is traced."""
    number = jax.ShapeDtypeStruct((), jnp.float64)

    def expanded(values: dict[str, Value], starts: dict[str, Value]) -> list[Value]:
        params = model.params(values)
        state = model.init(params, starts)
        expansion = taylor(model, 2)(params, state, jnp.ones(()))
        return expansion.along(lambda s: model.guards(params, s), state)

    try:
        jax.eval_shape(
            expanded,
            {q.name: number for q in model.parameters},
            {q.name: number for q in model.initial_conditions},
        )
    except NoRecurrenceError as error:
        return error.operation
    return None


def polynomial(coefficients: list[Value], t: Number) -> Value:
    """The value of a polynomial at `t`, by Horner's scheme; coefficients are in order of rising power."""
    total = coefficients[-1]
    for coefficient in reversed(coefficients[:-1]):
        total = coefficient + t * total
    return total


def _derivative(coefficients: list[Value]) -> list[Value]:
    """The coefficients of a polynomial's derivative."""
    return [coefficient * k for k, coefficient in enumerate(coefficients)][1:]


def bends_back(coefficients: list[Guards], h: Number) -> Flag:
    """Whether a guard that is below zero at a step's beginning may have more zeros within it than it shows.

    A guard shows one zero if it is above zero at the step's end. If its series is not accurate over the step,
    it may have more.

    Args:
        coefficients: those of the guards along the step.
        h: its length (s).
    """
    scaled = []
    power = jnp.ones_like(h)
    for coefficient in coefficients:
        scaled.append(coefficient * power)
        power = power * h
    error = jnp.maximum(jnp.abs(scaled[-1]), TERM_RATIO * jnp.abs(scaled[-2]))
    risen = jnp.zeros(error.shape, bool)
    fallen = jnp.zeros(error.shape, bool)
    size = jnp.zeros_like(error)
    for value in _bernstein(scaled):
        above = value >= -error
        fallen = fallen | (risen & ~above)
        risen = risen | above
        size = jnp.maximum(size, jnp.abs(value))
    return jnp.any((fallen | (error > MAX_POLYNOMIAL_ERROR * size)) & (coefficients[0] < 0.0))


def _bernstein(scaled: list[Guards]) -> list[Guards]:
    """The Bernstein coefficients of polynomials of the share of a step, from their Taylor coefficients."""
    weights = _BERNSTEIN_WEIGHTS[len(scaled) - 1]
    bernstein = []
    for j in range(len(scaled)):
        total = scaled[0]
        for i in range(1, j + 1):
            total = total + float(weights[j, i]) * scaled[i]
        bernstein.append(total)
    return bernstein


def first_zero(coefficients: list[Guards], h: Number) -> Number:
    """The first time (s) within a step at which a guard rises above zero; infinite if none does.

    Of a guard whose zero these steps do not reach, the end of its bracket, where it is above zero.

    Args:
        coefficients: those of the guards along the step.
        h: its length (s).
    """
    near = coefficients[0]
    if near.size == 0:  # a flow without events
        return jnp.full_like(h, jnp.inf)
    end = polynomial(coefficients, h)
    slopes = _derivative(coefficients)
    bends = _derivative(slopes)
    rises = (near < 0.0) & (end >= 0.0)
    low = jnp.zeros_like(near)
    high = jnp.full_like(near, h)
    at = before = h * jnp.where(rises, near / jnp.where(rises, near - end, 1.0), 0.0)
    for _ in range(HALLEY_STEPS):
        value = polynomial(coefficients, at)
        slope = polynomial(slopes, at)
        low = jnp.where(value < 0.0, at, low)
        high = jnp.where(value < 0.0, high, at)
        divisor = slope * slope - 0.5 * value * polynomial(bends, at)
        nearer = at - value * slope / jnp.where(divisor == 0.0, 1.0, divisor)
        before, at = at, jnp.where((nearer >= low) & (nearer <= high), nearer, 0.5 * (low + high))
    at = jnp.where(jnp.abs(at - before) <= _LAST_STEP * h, at, high)
    return jnp.min(jnp.where(rises, at, jnp.inf), initial=jnp.inf)


def _bernstein_weights(order: int) -> Float[np.ndarray, "coefficients coefficients"]:
    """The weights of the Taylor coefficients, scaled by the step, in each Bernstein coefficient."""
    places = range(order + 1)
    return np.array([[math.comb(j, i) / math.comb(order, i) for i in places] for j in places])


_BERNSTEIN_WEIGHTS = {order: _bernstein_weights(order) for order in range(MIN_ORDER, MAX_ORDER + 1)}


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
    program = _Program(closed, RULES)
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
    """The Taylor coefficients of guards along a solution; a part without derivative counts as constant.

    Args:
        function: the guards of one state.
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
    program = _Program(closed, RULES_OF_GUARDS)
    coefficients: list[Value] = []
    for k in range(order + 1):
        (term,) = program(k, [_up_to(series, k) for series in inputs])
        coefficients.append(jnp.zeros_like(coefficients[0]) if term is None else term)
    return coefficients


def _up_to(series: Series, k: int) -> Series:
    """The coefficients up to order k; those that are missing are zero."""
    return [*series[: k + 1], *[None] * (k + 1 - len(series))]


class _Program:
    """A program and the coefficients of its variables so far, by the rules of its operations."""

    def __init__(self, closed: ClosedJaxpr, rules: Mapping[str, Rule]) -> None:
        self.jaxpr = closed.jaxpr
        self.known: dict[Any, Series] = {}
        for variable, value in zip(self.jaxpr.constvars, closed.consts, strict=True):
            self.known[variable] = [jnp.asarray(value)]
        self.operations = [_Operation(equation, rules) for equation in self.jaxpr.eqns]

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

    def __init__(self, equation: Any, rules: Mapping[str, Rule]) -> None:
        self.equation = equation
        self.rules = rules
        self.name: str = equation.primitive.name
        self.results: list[Series] = [[] for _ in equation.outvars]
        self.auxiliary: dict[str, Series] = {}
        inner = inner_program(equation)
        self.inner = None if inner is None else _Program(inner, rules)

    def __call__(self, k: int, args: list[Series]) -> Series:
        """The coefficients of order k of the results."""
        if self.inner is not None:
            terms = self.inner(k, args)
        elif k == 0:
            first = self.equation.primitive.bind(*(a[0] for a in args), **self.equation.params)
            terms = list(first) if self.equation.primitive.multiple_results else [first]
        elif all(term is None for a in args for term in a[1 : k + 1]):
            terms = [None] * len(self.results)
        elif self.name in self.rules:
            terms = self.rules[self.name](self, k, args)
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
