"""Primitives that move elements about: no arithmetic, only other places for the same nodes."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from gaitsweep.engine.kernel.trace import Nodes, Tracer, kind_of, refuse

# Reads at a place that is only known while running become choices among all places, up to so many.
MOST_PLACES = 64


def _broadcast_in_dim(tracer: Tracer, equation: Any, args: list[Nodes]) -> list[Nodes]:
    shape, dims = equation.params["shape"], equation.params["broadcast_dimensions"]
    spread = [1] * len(shape)
    for axis, to in enumerate(dims):
        spread[to] = args[0].shape[axis]
    return [np.broadcast_to(args[0].reshape(spread), shape)]


def _reshape(tracer: Tracer, equation: Any, args: list[Nodes]) -> list[Nodes]:
    return [args[0].reshape(equation.outvars[0].aval.shape)]


def _transpose(tracer: Tracer, equation: Any, args: list[Nodes]) -> list[Nodes]:
    return [np.transpose(args[0], equation.params["permutation"])]


def _slice(tracer: Tracer, equation: Any, args: list[Nodes]) -> list[Nodes]:
    p = equation.params
    strides = p["strides"] or (1,) * args[0].ndim
    cut = tuple(slice(*each) for each in zip(p["start_indices"], p["limit_indices"], strides, strict=True))
    return [args[0][cut]]


def _concatenate(tracer: Tracer, equation: Any, args: list[Nodes]) -> list[Nodes]:
    return [np.concatenate(args, axis=equation.params["dimension"])]


def _stack(tracer: Tracer, equation: Any, args: list[Nodes]) -> list[Nodes]:
    return [np.stack(args, axis=equation.params.get("axis", 0))]


def _split(tracer: Tracer, equation: Any, args: list[Nodes]) -> list[Nodes]:
    places = np.cumsum(equation.params["sizes"])[:-1]
    return list(np.split(args[0], places, axis=equation.params["axis"]))


def _rev(tracer: Tracer, equation: Any, args: list[Nodes]) -> list[Nodes]:
    return [np.flip(args[0], equation.params["dimensions"])]



def _iota(tracer: Tracer, equation: Any, args: list[Nodes]) -> list[Nodes]:
    p = equation.params
    values = np.arange(p["shape"][p["dimension"]]).astype(p["dtype"])
    spread = [1] * len(p["shape"])
    spread[p["dimension"]] = -1
    return [tracer.constants(np.broadcast_to(values.reshape(spread), p["shape"]))]


def _gather(tracer: Tracer, equation: Any, args: list[Nodes]) -> list[Nodes]:
    operand, indices = args
    known = tracer.known(indices)
    if known is None:
        return [_gather_by_choice(tracer, equation, operand, indices)]
    # what fills the places outside is a number, not a node
    moved = _by_jax(equation, [operand], known.astype(np.int64), mode="clip")
    return [moved]


def _gather_by_choice(tracer: Tracer, equation: Any, operand: Nodes, indices: Nodes) -> Nodes:
    """A read at one place along one axis that only the running program knows: a choice among all."""
    if indices.size != 1:
        raise refuse("the scalar kernel reads one place at a time where places are only known while running")
    (axis,) = equation.params["dimension_numbers"].start_index_map
    places = operand.shape[axis] - equation.params["slice_sizes"][axis] + 1
    return _choice(
        tracer,
        places,
        indices.ravel()[0],
        lambda i: _by_jax(equation, [operand], np.full(indices.shape, i), mode="clip"),
    )


def _choice(tracer: Tracer, places: int, at: int, read: Any) -> Nodes:
    if places > MOST_PLACES:
        raise refuse(
            f"the scalar kernel chooses among {MOST_PLACES} places at most where they are only known while "
            f"running, and here are {places}"
        )
    program = tracer.program
    chosen = read(places - 1)
    for i in range(places - 2, -1, -1):
        here = program.apply("le", at, program.constant(i, "int"))
        chosen = tracer.each(lambda yes, no, c=here: program.apply("select", c, yes, no), read(i), chosen)
    return chosen


def _dynamic_slice(tracer: Tracer, equation: Any, args: list[Nodes]) -> list[Nodes]:
    operand, *starts = args
    sizes = equation.params["slice_sizes"]
    known = [tracer.known(start) for start in starts]
    moving = [axis for axis, value in enumerate(known) if value is None]

    def cut(where: dict[int, int]) -> Nodes:
        place = [where[i] if i in where else int(known[i]) for i in range(operand.ndim)]  # type: ignore[arg-type]
        place = [min(max(a, 0), n - s) for a, n, s in zip(place, operand.shape, sizes, strict=True)]
        return operand[tuple(slice(a, a + s) for a, s in zip(place, sizes, strict=True))]

    if not moving:
        return [cut({})]
    if len(moving) > 1:
        raise refuse("the scalar kernel reads at one place that is only known while running, not at several")
    (axis,) = moving
    places = operand.shape[axis] - sizes[axis] + 1
    return [_choice(tracer, places, int(starts[axis]), lambda i: cut({axis: i}))]


def _dynamic_update_slice(tracer: Tracer, equation: Any, args: list[Nodes]) -> list[Nodes]:
    operand, update, *starts = args
    known = [tracer.known(start) for start in starts]
    moving = [axis for axis, value in enumerate(known) if value is None]

    def put(where: dict[int, int]) -> Nodes:
        place = [where[i] if i in where else int(known[i]) for i in range(operand.ndim)]  # type: ignore[arg-type]
        pairs = zip(place, operand.shape, update.shape, strict=True)
        place = [min(max(a, 0), n - s) for a, n, s in pairs]
        moved = operand.copy()
        moved[tuple(slice(a, a + s) for a, s in zip(place, update.shape, strict=True))] = update
        return moved

    if not moving:
        return [put({})]
    if len(moving) > 1:
        raise refuse("the scalar kernel writes at one place that is only known while running, not at several")
    (axis,) = moving
    places = operand.shape[axis] - update.shape[axis] + 1
    return [_choice(tracer, places, int(starts[axis]), lambda i: put({axis: i}))]


def _scatter(tracer: Tracer, equation: Any, args: list[Nodes]) -> list[Nodes]:
    operand, indices, updates = args
    known = tracer.known(indices)
    if known is None:
        raise refuse("the scalar kernel writes only at places that are known beforehand")
    return [_by_jax(equation, [operand], known.astype(np.int64), updates)]


def _scatter_add(tracer: Tracer, equation: Any, args: list[Nodes]) -> list[Nodes]:
    operand, indices, updates = args
    known = tracer.known(indices)
    if known is None:
        raise refuse("the scalar kernel adds only at places that are known beforehand")
    total = operand.ravel().copy()
    for k in range(updates.size):
        # one update at a time shows where it goes
        single = np.zeros(updates.shape, np.int64)
        single.ravel()[k] = 1
        where = _by_jax(equation, [np.zeros(operand.shape, np.int64)], known.astype(np.int64), single)
        for at in np.flatnonzero(where):
            total[at] = tracer.program.apply("add", int(total[at]), int(updates.ravel()[k]))
    return [total.reshape(operand.shape)]


def _dot_general(tracer: Tracer, equation: Any, args: list[Nodes]) -> list[Nodes]:
    (contract_a, contract_b), (batch_a, batch_b) = equation.params["dimension_numbers"]
    a, b = args
    free_a = [i for i in range(a.ndim) if i not in (*contract_a, *batch_a)]
    free_b = [i for i in range(b.ndim) if i not in (*contract_b, *batch_b)]
    left = np.transpose(a, [*batch_a, *free_a, *contract_a])
    right = np.transpose(b, [*batch_b, *free_b, *contract_b])
    batch = left.shape[: len(batch_a)]
    shape = (*batch, *(a.shape[i] for i in free_a), *(b.shape[i] for i in free_b))
    count = int(np.prod([a.shape[i] for i in contract_a]))
    many = int(np.prod(batch))
    left = left.reshape(many, -1, count)[:, :, None, :]
    right = right.reshape(many, -1, count)[:, None, :, :]
    program = tracer.program
    if count == 0:
        zero = program.constant(0.0, kind_of(equation.outvars[0].aval.dtype))
        return [np.full(shape, zero, np.int64)]
    products = tracer.each(lambda x, y: program.apply("mul", x, y), left, right)
    total = products[..., 0]
    for k in range(1, count):
        total = tracer.each(lambda x, y: program.apply("add", x, y), total, products[..., k])
    return [total.reshape(shape)]


def _sort(tracer: Tracer, equation: Any, args: list[Nodes]) -> list[Nodes]:
    """A network of exchanges between neighbours, stable; the first `num_keys` operands decide."""
    axis, keys = equation.params["dimension"], equation.params["num_keys"]
    program = tracer.program
    columns = [np.moveaxis(a, axis, 0).copy() for a in args]
    for end in range(columns[0].shape[0] - 1, 0, -1):
        for i in range(end):

            def later(*pairs: int) -> int:
                # lexicographic: the first key that differs decides
                decided = program.constant(False, "bool")
                for a, b in reversed(list(zip(pairs[::2], pairs[1::2], strict=True))):
                    equal = program.apply("and", program.apply("eq", a, b), decided)
                    decided = program.apply("or", program.apply("lt", b, a), equal)
                return decided

            swap = tracer.each(later, *(c[j] for c in columns[:keys] for j in (i, i + 1)))
            for c in columns:
                low, high = c[i].copy(), c[i + 1].copy()
                c[i] = tracer.each(lambda s, x, y: program.apply("select", s, x, y), swap, high, low)
                c[i + 1] = tracer.each(lambda s, x, y: program.apply("select", s, x, y), swap, low, high)
    return [np.moveaxis(c, 0, axis) for c in columns]


def _by_jax(equation: Any, operands: list[Nodes], *others: Any, mode: Any = None) -> Nodes:
    """Let JAX itself move the nodes, which are whole numbers to it."""
    params = dict(equation.params)
    if mode is not None:
        params["mode"] = jax.lax.GatherScatterMode.from_any(mode)
        params.pop("fill_value", None)
        params["fill_value"] = None
    arrays = [jnp.asarray(a) for a in (*operands, *others)]
    return np.asarray(equation.primitive.bind(*arrays, **params), np.int64)


RULES = {
    "broadcast_in_dim": _broadcast_in_dim,
    "reshape": _reshape,
    "squeeze": _reshape,
    "expand_dims": _reshape,
    "transpose": _transpose,
    "slice": _slice,
    "concatenate": _concatenate,
    "stack": _stack,
    "split": _split,
    "rev": _rev,
    "pad": lambda tracer, equation, args: [_by_jax(equation, args)],
    "iota": _iota,
    "gather": _gather,
    "dynamic_slice": _dynamic_slice,
    "dynamic_update_slice": _dynamic_update_slice,
    "scatter": _scatter,
    "scatter-add": _scatter_add,
    "scatter_add": _scatter_add,
    "dot_general": _dot_general,
    "sort": _sort,
}
