"""Rules of primitives that rearrange and index arrays; only dot_general, sort and scatters compute.

An index that is computed at run time becomes a selection among all possible indices.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from jax.lax import GatherScatterMode

from gaitsweep.engine.kernel import arithmetic
from gaitsweep.engine.kernel.program import Kind
from gaitsweep.engine.kernel.trace import Build, Nodes, Rule, RuleError, Tracer, Writer, kind_of

# A selection among more indices than this would be too expensive for a model's step.
MAX_INDICES = 64

# The value that JAX reads outside of an array, by NumPy's letter for the kind of dtype.
_FILLING: dict[str, Callable[[np.dtype], float]] = {
    "f": lambda dtype: np.nan,
    "i": lambda dtype: np.iinfo(dtype).min,
    "u": lambda dtype: np.iinfo(dtype).max,
    "b": lambda dtype: True,
}


def _rearranged(rearrange: Callable[[list[Nodes], dict[str, Any]], Sequence[Nodes]]) -> Rule:
    """A rule that moves elements: from the arguments and the parameters of an equation to its results."""
    return lambda tracer, equation, args: list(rearrange(args, equation.params))


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


def _gather(tracer: Tracer, equation: Any, args: list[Nodes]) -> list[Nodes]:
    operand, indices = args
    p = equation.params
    numbers = p["dimension_numbers"]
    sizes = p["slice_sizes"]
    single = {*numbers.collapsed_slice_dims, *numbers.operand_batching_dims}
    window = [size for axis, size in enumerate(sizes) if axis not in single]
    batch = indices.shape[:-1]
    windows = []
    batched = numbers.operand_batching_dims, numbers.start_indices_batching_dims
    for where in np.ndindex(batch):
        starts = _starts(tracer, operand, indices, where, numbers.start_index_map, batched)
        cut = _selected(tracer, operand, sizes, starts, lambda index: operand[index])
        if p["mode"] == GatherScatterMode.FILL_OR_DROP:
            cut = _filled(tracer, equation, operand, starts, cut)
        windows.append(cut.reshape(window))
    out = np.array(windows, np.int64).reshape((*batch, *window))
    return [np.moveaxis(out, range(len(batch), out.ndim), numbers.offset_dims)]


def _filled(tracer: Tracer, equation: Any, operand: Nodes, starts: list[int], cut: Nodes) -> Nodes:
    """The window that was read, or JAX's fill value where it is outside of the array."""
    program = tracer.program
    dtype = np.dtype(equation.outvars[0].aval.dtype)
    value = equation.params["fill_value"]
    fill = program.constant(_FILLING[dtype.kind](dtype) if value is None else value, kind_of(dtype))
    inside = program.constant(True, "bool")
    for at, size, many in zip(starts, equation.params["slice_sizes"], operand.shape, strict=True):
        least = program.constant(0, "int")
        most = program.constant(many - size, "int")
        inside = program.apply("and", inside, program.apply("le", least, at))
        inside = program.apply("and", inside, program.apply("le", at, most))
    return tracer.apply("select", np.asarray(inside), cut, np.asarray(fill))


def _dynamic_slice(tracer: Tracer, equation: Any, args: list[Nodes]) -> list[Nodes]:
    operand, *starts = args
    at = [int(start) for start in starts]
    return [_selected(tracer, operand, equation.params["slice_sizes"], at, lambda index: operand[index])]


def _dynamic_update_slice(tracer: Tracer, equation: Any, args: list[Nodes]) -> list[Nodes]:
    operand, update, *starts = args

    def put(index: tuple[slice, ...]) -> Nodes:
        moved = operand.copy()
        moved[index] = update
        return moved

    return [_selected(tracer, operand, update.shape, [int(start) for start in starts], put)]


def _starts(
    tracer: Tracer,
    operand: Nodes,
    indices: Nodes,
    where: tuple[int, ...],
    axes: Sequence[int],
    batched: tuple[Sequence[int], Sequence[int]],
) -> list[int]:
    """The node of the start index of a window along each axis of an operand.

    Args:
        tracer: of the program.
        operand: the array that has the window.
        indices: the start indices of all windows, those of one window along the last axis.
        where: the place of the window among them.
        axes: the axes along which its start indices are those of `indices`; along others they are 0.
        batched: axes of the operand, and the axes of `indices` by whose place they are indexed.
    """
    starts = [tracer.program.constant(0, "int")] * operand.ndim
    for axis, at in zip(axes, indices[where].tolist(), strict=True):
        starts[axis] = at
    for axis, along in zip(*batched, strict=True):
        starts[axis] = tracer.program.constant(where[along], "int")
    return starts


def _selected(
    tracer: Tracer,
    operand: Nodes,
    sizes: Sequence[int],
    starts: list[int],
    read: Callable[[tuple[slice, ...]], Nodes],
) -> Nodes:
    """`read` of the window that begins at `starts`, clamped so that the window is inside."""
    program = tracer.program
    last = [many - size for many, size in zip(operand.shape, sizes, strict=True)]
    _refuse_many(tracer, starts, last)

    def along(axis: int, index: tuple[slice, ...]) -> Nodes:
        if axis == operand.ndim:
            return read(index)

        def beginning_at(i: int) -> Nodes:
            return along(axis + 1, (*index, slice(i, i + sizes[axis])))

        at = starts[axis]
        known = program.value(at)
        if known is not None:
            return beginning_at(min(max(int(known), 0), last[axis]))
        chosen = beginning_at(last[axis])
        for i in range(last[axis] - 1, -1, -1):
            up_to = program.apply("le", at, program.constant(i, "int"))
            chosen = tracer.apply("select", np.asarray(up_to), beginning_at(i), chosen)
        return chosen

    return along(0, ())


def _refuse_many(tracer: Tracer, starts: list[int], last: Sequence[int]) -> None:
    """Refuse a selection among more than `MAX_INDICES` indices that are computed at run time."""
    moving = [many + 1 for at, many in zip(starts, last, strict=True) if tracer.program.value(at) is None]
    if (count := int(np.prod(moving))) > MAX_INDICES:
        most = f"at most {MAX_INDICES} indices computed at run time"
        raise RuleError(f"the scalar kernel selects among {most}, not {count}")


def _scatter(combine: Build) -> Rule:
    """Updates in sequence, each combined with the current element at its index."""

    def rule(tracer: Tracer, equation: Any, args: list[Nodes]) -> list[Nodes]:
        operand, indices, updates = args
        numbers = equation.params["dimension_numbers"]
        combined = _applied(tracer, equation) or combine
        single = {*numbers.inserted_window_dims, *numbers.operand_batching_dims}
        wide = [axis for axis in range(operand.ndim) if axis not in single]
        # window axes last, in the order of the operand's axes
        ordered = [axis for axis in range(updates.ndim) if axis not in numbers.update_window_dims]
        moved = np.transpose(updates, [*ordered, *numbers.update_window_dims])
        sizes = [1] * operand.ndim
        for axis, size in zip(wide, moved.shape[len(ordered) :], strict=True):
            sizes[axis] = size
        last = [many - size for many, size in zip(operand.shape, sizes, strict=True)]
        total = operand.copy()
        batched = numbers.operand_batching_dims, numbers.scatter_indices_batching_dims
        for where in np.ndindex(indices.shape[:-1]):
            axes = numbers.scatter_dims_to_operand_dims
            starts = _starts(tracer, operand, indices, where, axes, batched)
            if equation.params["mode"] == GatherScatterMode.CLIP:
                starts = [_clipped(tracer, at, most) for at, most in zip(starts, last, strict=True)]
            _refuse_many(tracer, starts, last)
            new = moved[where].reshape(sizes)
            possible = [_possible_indices(tracer, at, most) for at, most in zip(starts, last, strict=True)]
            for index in itertools.product(*possible):
                cut = tuple(slice(i, i + size) for i, size in zip(index, sizes, strict=True))
                total[cut] = _updated(tracer, combined, _is_at(tracer, starts, index), total[cut], new)
        return [total]

    return rule


def _applied(tracer: Tracer, equation: Any) -> Build | None:
    """The function of old elements that `.at[].apply` has in place of new ones; None without one."""
    function = equation.params["update_jaxpr"]
    if equation.primitive.name != "scatter" or function is None:
        return None
    consts = [tracer.constants(np.asarray(value)) for value in equation.params["update_consts"]]

    def applied(w: Writer, old: int, new: int) -> int:
        (result,) = tracer.read_open(function, consts, [np.asarray(old), np.asarray(new)])
        return int(result)

    return applied


def _is_at(tracer: Tracer, starts: list[int], index: Sequence[int]) -> int:
    """The node of the flag whether the start indices are those of `index`."""
    program = tracer.program
    in_place = program.constant(True, "bool")
    for at, i in zip(starts, index, strict=True):
        in_place = program.apply("and", in_place, program.apply("eq", at, program.constant(i, "int")))
    return in_place


def _updated(tracer: Tracer, combine: Build, in_place: int, old: Nodes, new: Nodes) -> Nodes:
    """The old elements combined with new ones where the flag `in_place` is true."""

    def update(w: Writer, old: int, new: int) -> int:
        return w("select", in_place, combine(w, old, new), old)

    return tracer.write(update, old, new)


def _clipped(tracer: Tracer, at: int, last: int) -> int:
    """A start index within 0 and the last possible one."""
    least = tracer.program.constant(0, "int")
    most = tracer.program.constant(last, "int")
    w = Writer(tracer.program, at)
    return arithmetic.minimum(w, arithmetic.maximum(w, at, least), most)


def _possible_indices(tracer: Tracer, at: int, last: int) -> Sequence[int]:
    """The possible values of a start index; none if it is a constant outside, since JAX drops that update."""
    known = tracer.program.value(at)
    if known is None:
        return range(last + 1)
    return [int(known)] if 0 <= known <= last else []


RULES: dict[str, Rule] = {
    "broadcast_in_dim": _broadcast_in_dim,
    **dict.fromkeys(("reshape", "squeeze", "expand_dims"), _reshape),
    "transpose": _rearranged(lambda args, p: [np.transpose(args[0], p["permutation"])]),
    "slice": _slice,
    "concatenate": _rearranged(lambda args, p: [np.concatenate(args, p["dimension"])]),
    "stack": _rearranged(lambda args, p: [np.stack(args, p.get("axis", 0))]),
    "unstack": _rearranged(lambda args, p: list(np.moveaxis(args[0], p["axis"], 0))),
    "split": _rearranged(lambda args, p: np.split(args[0], np.cumsum(p["sizes"])[:-1], p["axis"])),
    "tile": _rearranged(lambda args, p: [np.tile(args[0], p["reps"])]),
    "rev": _rearranged(lambda args, p: [np.flip(args[0], p["dimensions"])]),
    "pad": _pad,
    "iota": _iota,
    "dot_general": _dot_general,
    "sort": _sort,
    "gather": _gather,
    "dynamic_slice": _dynamic_slice,
    "dynamic_update_slice": _dynamic_update_slice,
    "scatter": _scatter(lambda w, old, new: new),
    "scatter-add": _scatter(lambda w, old, new: w("add", old, new)),
    "scatter-sub": _scatter(lambda w, old, new: w("sub", old, new)),
    "scatter-mul": _scatter(lambda w, old, new: w("mul", old, new)),
    "scatter-min": _scatter(arithmetic.minimum),
    "scatter-max": _scatter(arithmetic.maximum),
}
