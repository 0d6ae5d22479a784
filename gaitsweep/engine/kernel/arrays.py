"""Rules of primitives that rearrange arrays, without arithmetic but for dot_general and sort."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from gaitsweep.engine.kernel import arithmetic
from gaitsweep.engine.kernel.program import Kind
from gaitsweep.engine.kernel.trace import Nodes, Rule, Tracer, Writer, kind_of


def _broadcast_in_dim(tracer: Tracer, equation: Any, args: list[Nodes]) -> list[Nodes]:
    shape = equation.params["shape"]
    dims = equation.params["broadcast_dimensions"]
    spread = [1] * len(shape)
    for axis, to in enumerate(dims):
        spread[to] = args[0].shape[axis]
    return [np.broadcast_to(args[0].reshape(spread), shape)]


def _reshape(tracer: Tracer, equation: Any, args: list[Nodes]) -> list[Nodes]:
    return [args[0].reshape(equation.outvars[0].aval.shape)]


def _slice(tracer: Tracer, equation: Any, args: list[Nodes]) -> list[Nodes]:
    p = equation.params
    strides = p["strides"] or (1,) * args[0].ndim
    cut = tuple(
        slice(*limits) for limits in zip(p["start_indices"], p["limit_indices"], strides, strict=True)
    )
    return [args[0][cut]]


def _transpose(tracer: Tracer, equation: Any, args: list[Nodes]) -> list[Nodes]:
    return [np.transpose(args[0], equation.params["permutation"])]


def _concatenate(tracer: Tracer, equation: Any, args: list[Nodes]) -> list[Nodes]:
    return [np.concatenate(args, axis=equation.params["dimension"])]


def _stack(tracer: Tracer, equation: Any, args: list[Nodes]) -> list[Nodes]:
    return [np.stack(args, axis=equation.params.get("axis", 0))]


def _unstack(tracer: Tracer, equation: Any, args: list[Nodes]) -> list[Nodes]:
    return list(np.moveaxis(args[0], equation.params["axis"], 0))


def _tile(tracer: Tracer, equation: Any, args: list[Nodes]) -> list[Nodes]:
    return [np.tile(args[0], equation.params["reps"])]


def _rev(tracer: Tracer, equation: Any, args: list[Nodes]) -> list[Nodes]:
    return [np.flip(args[0], equation.params["dimensions"])]


def _split(tracer: Tracer, equation: Any, args: list[Nodes]) -> list[Nodes]:
    places = np.cumsum(equation.params["sizes"])[:-1]
    return list(np.split(args[0], places, axis=equation.params["axis"]))


def _iota(tracer: Tracer, equation: Any, args: list[Nodes]) -> list[Nodes]:
    p = equation.params
    values = np.arange(p["shape"][p["dimension"]]).astype(p["dtype"])
    spread = [1] * len(p["shape"])
    spread[p["dimension"]] = -1
    return [tracer.constants(np.broadcast_to(values.reshape(spread), p["shape"]))]


def _pad(tracer: Tracer, equation: Any, args: list[Nodes]) -> list[Nodes]:
    array, value = args
    for axis, (low, high, between) in enumerate(equation.params["padding_config"]):
        rows = np.moveaxis(array, axis, 0)
        size = max(rows.shape[0] + between * (rows.shape[0] - 1), 0)
        padded = np.full((max(low, 0) + size + max(high, 0), *rows.shape[1:]), value, np.int64)
        padded[max(low, 0) : max(low, 0) + size : between + 1] = rows
        # negative padding removes elements
        padded = padded[max(-low, 0) : padded.shape[0] - max(-high, 0)]
        array = np.moveaxis(padded, 0, axis)
    return [array]


def _dot_general(tracer: Tracer, equation: Any, args: list[Nodes]) -> list[Nodes]:
    """Products summed over the contracted axes in order; axes of the result: batch, free of a, free of b."""
    (contract_a, contract_b), (batch_a, batch_b) = equation.params["dimension_numbers"]
    a, b = args
    free_a = [i for i in range(a.ndim) if i not in (*contract_a, *batch_a)]
    free_b = [i for i in range(b.ndim) if i not in (*contract_b, *batch_b)]
    left = np.transpose(a, [*batch_a, *free_a, *contract_a])
    right = np.transpose(b, [*batch_b, *free_b, *contract_b])
    batch = left.shape[: len(batch_a)]
    rows = [a.shape[i] for i in free_a]
    columns = [b.shape[i] for i in free_b]
    shape = (*batch, *rows, *columns)
    count = math.prod(a.shape[i] for i in contract_a)
    program = tracer.program
    kind: Kind = kind_of(equation.outvars[0].aval.dtype)
    if count == 0:
        return [np.full(shape, program.constant(0.0, kind), np.int64)]
    # a product of float32 arrays may accumulate in float64
    left = tracer.write(lambda w, x: arithmetic.converted(w, x, kind), left)
    right = tracer.write(lambda w, x: arithmetic.converted(w, x, kind), right)
    left = left.reshape(math.prod(batch), math.prod(rows), 1, count)
    right = right.reshape(math.prod(batch), 1, math.prod(columns), count)
    products = tracer.apply("mul", left, right)
    total = products[..., 0]
    for k in range(1, count):
        total = tracer.apply("add", total, products[..., k])
    return [total.reshape(shape)]


def _sort(tracer: Tracer, equation: Any, args: list[Nodes]) -> list[Nodes]:
    """A stable sorting network of neighbour exchanges; the first `num_keys` operands are the keys."""
    axis = equation.params["dimension"]
    keys = equation.params["num_keys"]
    program = tracer.program
    columns = [np.moveaxis(a, axis, 0).copy() for a in args]

    def comes_later(*keys_of_pair: int) -> int:
        """Whether the first of two rows comes after the second, by the first of their keys that differs."""
        decided = program.constant(False, "bool")
        pairs = list(zip(keys_of_pair[::2], keys_of_pair[1::2], strict=True))
        for a, b in reversed(pairs):
            w = Writer(program, a)
            equal = w("and", arithmetic.same_rank(w, a, b), decided)
            decided = w("or", arithmetic.before(w, b, a), equal)
        return decided

    for end in range(columns[0].shape[0] - 1, 0, -1):
        for i in range(end):
            neighbours = [column[j] for column in columns[:keys] for j in (i, i + 1)]
            swap = tracer.each(comes_later, *neighbours)
            for column in columns:
                low = column[i].copy()
                high = column[i + 1].copy()
                column[i] = tracer.apply("select", swap, high, low)
                column[i + 1] = tracer.apply("select", swap, low, high)
    return [np.moveaxis(column, 0, axis) for column in columns]


RULES: dict[str, Rule] = {
    "broadcast_in_dim": _broadcast_in_dim,
    **dict.fromkeys(("reshape", "squeeze", "expand_dims"), _reshape),
    "transpose": _transpose,
    "slice": _slice,
    "concatenate": _concatenate,
    "stack": _stack,
    "unstack": _unstack,
    "split": _split,
    "tile": _tile,
    "rev": _rev,
    "pad": _pad,
    "iota": _iota,
    "dot_general": _dot_general,
    "sort": _sort,
}
