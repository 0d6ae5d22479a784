"""Ranges of the whole numbers of a program, which float64 represents, and their wrapping around as in JAX."""

from __future__ import annotations

import functools
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax.extend.core import JaxprEqn

from gaitsweep.engine.kernel.program import Node, Program

# Operations whose results wrap around in JAX where the dtype of whole numbers has no room for them.
_WRAPPING = {
    *("add", "add_any", "sub", "neg", "abs", "mul", "div", "square", "integer_pow", "pow", "dot_general"),
    *("reduce_sum", "reduce_prod", "cumsum", "cumprod", "scatter-add", "scatter-sub", "scatter-mul"),
    "convert_element_type",
}
# Float64 represents all whole numbers up to this size.
_EXACT = 2.0**53
# A model is taken to count up to this number at most in int64, and to half the largest in 32 bits.
_COUNTED = 2.0**24
# A constant factor from this on is taken for that of a generator of random numbers, whose state is no count.
_LARGE_FACTOR = 2.0**16


class Range(NamedTuple):
    """The smallest and the largest possible value of a number."""

    low: float
    high: float

    def is_within(self, low: float, high: float) -> bool:
        """Whether all possible values are from `low` to `high`."""
        return low <= self.low and self.high <= high

    @property
    def size(self) -> float:
        """The largest possible absolute value."""
        return max(abs(self.low), abs(self.high))

    @property
    def holds_zero(self) -> bool:
        """Whether 0 is among the possible values."""
        return self.low <= 0.0 <= self.high

    def union(self, other: Range) -> Range:
        """The smallest range with all values of both."""
        return Range(min(self.low, other.low), max(self.high, other.high))


_UNKNOWN = Range(-(2.0**31), 2.0**31)


class WholeNumbers:
    """The ranges of the whole numbers of a program, from those of its inputs."""

    def __init__(self, program: Program) -> None:
        self._program = program
        self._ranges: dict[int, Range] = {}

    def add_inputs(self, nodes: np.ndarray, dtype: Any) -> None:
        """Note the ranges of inputs of a dtype."""
        if jnp.issubdtype(dtype, jnp.integer):
            limits = jnp.iinfo(dtype)
            size = _COUNTED if limits.bits == 64 else float(limits.max) + 1.0
            size = size / 2.0 if limits.bits == 32 else size
            self._set(nodes, Range(-size if limits.min else 0.0, size))

    def fault(self, equation: JaxprEqn, args: list[np.ndarray], outputs: list[np.ndarray]) -> str | None:
        """The reason, in words, why float64 cannot represent the results of an equation; None if it can.

        Args:
            equation: the equation.
            args, outputs: the nodes of its inputs and of its results.
        """
        dtype = _wrapping_dtype(equation)
        if equation.primitive.name == "rem" and outputs[0].size:
            self._set(outputs[0], self._remainders(args[0], args[1]))
        if dtype is None:
            return None
        limits = jnp.iinfo(dtype)
        if equation.primitive.name == "div" and outputs[0].size:
            by_zero = float(-1 if limits.min else limits.max)
            self._set(outputs[0], self._quotients(args[0], args[1], Range(by_zero, by_zero)))
        # of 64 bits without a sign only differences below 0 wrap
        least = 0.0 if limits.bits == 64 and not limits.min else -_EXACT
        for nodes in outputs:
            if not all(self.range_of(int(at)).is_within(least, _EXACT) for at in nodes.flat):
                beyond = "above 2^53" if least else "below 0 or above 2^53"
                return f"the results of '{equation.primitive.name}', {dtype} numbers that may be {beyond}"
        return None

    def _remainders(self, dividends: np.ndarray, divisors: np.ndarray) -> Range:
        """The range of remainders: nearer to zero than the divisor, or the dividend if that is 0."""
        size, divisor = self._of_all(dividends).size, self._of_all(divisors)
        bound = size if divisor.holds_zero else min(size, divisor.size)
        return Range(-bound, bound)

    def _quotients(self, dividends: np.ndarray, divisors: np.ndarray, by_zero: Range) -> Range:
        """The range of quotients, those `by_zero` included where a divisor may be 0."""
        dividend, divisor = self._of_all(dividends), self._of_all(divisors)
        least = 0.0 if dividend.low >= 0.0 and divisor.low >= 0.0 else -dividend.size
        quotients = Range(least, dividend.size)
        return quotients.union(by_zero) if divisor.holds_zero else quotients

    def _of_all(self, nodes: np.ndarray) -> Range:
        """The range of the values of some nodes."""
        return functools.reduce(Range.union, [self.range_of(int(at)) for at in nodes.flat])

    def wrapped(self, equation: JaxprEqn, outputs: list[np.ndarray]) -> list[np.ndarray]:
        """The results of an equation, those of up to 32 bits as JAX wraps them: 3 * 100 is 44 in uint8."""
        dtype = _wrapping_dtype(equation)
        if dtype is None or jnp.iinfo(dtype).bits == 64:
            return outputs
        return [np.vectorize(lambda at: self._wrap(int(at), dtype), otypes=[np.int64])(n) for n in outputs]

    def _wrap(self, at: int, dtype: Any) -> int:
        """The node of a number that is wrapped around, if it may leave the limits of a dtype."""
        limits = jnp.iinfo(dtype)
        low = float(limits.min)
        high = float(limits.max)
        if self.range_of(at).is_within(low, high):
            return at
        program = self._program
        count = program.constant(high - low + 1.0, "f64")
        x = program.apply("to_f64", at)
        turns = program.apply("div", program.apply("sub", x, program.constant(low, "f64")), count)
        x = program.apply("sub", x, program.apply("mul", program.apply("floor", turns), count))
        at = program.apply("to_int", x)
        self._ranges[at] = Range(low, high)
        return at

    def range_of(self, at: int) -> Range:
        """The range of a node."""
        for node in self._program.needed([at], self._ranges):
            if node not in self._ranges:
                self._ranges[node] = self._of_node(self._program.nodes[node])
        return self._ranges[at]

    def _set(self, nodes: np.ndarray, of_nodes: Range) -> None:
        """Note the range of nodes whose value is not known."""
        for at in nodes.flat:
            if self._program.value(int(at)) is None:
                self._ranges[int(at)] = of_nodes

    def _of_node(self, node: Node) -> Range:
        """The range of a node from those of its arguments."""
        if node.op == "constant":
            assert node.value is not None
            return Range(float(node.value), float(node.value))
        if node.kind != "int":
            return _UNKNOWN
        ranges = [self._ranges[a] for a in node.args]
        match node.op, ranges:
            case "add", [a, b]:
                return Range(a.low + b.low, a.high + b.high)
            case "sub", [a, b]:
                return Range(a.low - b.high, a.high - b.low)
            case "mul", [a, b]:
                if any(x.low == x.high and abs(x.low) >= _LARGE_FACTOR for x in ranges):
                    a, b = (x if x.low == x.high else x.union(_UNKNOWN) for x in ranges)
                corners = [x * y for x in a for y in b]
                return Range(min(corners), max(corners))
            case "neg", [a]:
                return Range(-a.high, -a.low)
            case "abs", [a]:
                return Range(0.0, max(-a.low, a.high))
            case "select", [_, a, b]:
                return a.union(b)
        return _UNKNOWN


def _wrapping_dtype(equation: JaxprEqn) -> Any:
    """The dtype of whole numbers that an equation computes from others, and that may wrap; else None."""
    if equation.primitive.name not in _WRAPPING:
        return None
    dtypes: list[Any] = [atom.aval.dtype for atom in (equation.outvars[0], equation.invars[0])]  # pyright: ignore[reportAttributeAccessIssue]
    return dtypes[0] if all(jnp.issubdtype(dtype, jnp.integer) for dtype in dtypes) else None
