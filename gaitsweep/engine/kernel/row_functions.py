"""A function of one row for many rows at once, by NumPy or by a kernel.

A run calls several functions only once or twice, on few rows: XLA takes much longer to compile such a
function than NumPy takes to compute it. A function of all rows is a kernel, which is compiled once for a
machine. Results may differ from those of XLA in the last place.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from typing import Any

import jax
import numpy as np
from jaxtyping import Float

from gaitsweep.contract import Model
from gaitsweep.engine.content import content_of
from gaitsweep.engine.devices import host_device
from gaitsweep.engine.kernel.operations import OPERATIONS
from gaitsweep.engine.kernel.trace import TracedFunction, UnsupportedError, traced_function
from gaitsweep.engine.stored_traces import stored

# Rows that are computed at a time, since the values of all nodes are in memory.
_ROWS_AT_A_TIME = 4096
# Options of XLA for few rows, on which an optimised program saves less time than its optimisation takes.
UNOPTIMISED = {"xla_backend_optimization_level": 0}
# NumPy's forms of operations whose own form takes one number at a time.
_OF_ARRAYS: dict[str, Callable[..., Any]] = {
    "select": np.where,
    **{name: np.vectorize(OPERATIONS[name].evaluate, otypes=[float]) for name in ("erf", "erfc")},
}


def over_rows(
    function: Callable[..., Any],
    name: str = "",
    source: Model | Callable[..., Any] | None = None,
    *others: Any,
    all_rows: bool = False,
    simplify: bool = False,
    by_xla: Callable[[], Callable[..., Any]] | None = None,
) -> Callable[..., Any]:
    """The function of many rows: arguments and results have the rows as their first axis.

    Args:
        function: a JAX function of one row, from pytrees to a pytree of arrays; XLA computes it where it has
            operations that a scalar program lacks.
        name, source, others: what a program is stored by (`stored_traces.stored`): all that decides
            `function`. Its results are then mappings and lists of arrays. Without a source it is traced in
            each process.
        all_rows: compute by a kernel, for a function that a run calls with all its rows.
        simplify: as of `Program`; by default a product with 0 is NaN where the other factor is.
        by_xla: makes the function of rows that XLA computes, in place of `function`.
    """
    if all_rows:
        from gaitsweep.engine.kernel.cpu_program import TILE  # which imports LLVM

        trace = _traced_kernel
        computed_by = _by_kernel
        others = *others, TILE  # part of a kernel's source
    else:
        trace = _traced_operations
        computed_by = _by_numpy
    if simplify:
        others = *others, "simplified"
    programs: dict[tuple[str, str], Callable[..., Any]] = {}
    lock = threading.Lock()

    def compiled(row: Any, key: str) -> Callable[..., Any]:
        """The function of rows, each with arguments like those of `row`."""

        def trace_row() -> tuple[Any, ...]:
            shapes = _mapped(lambda leaf: jax.ShapeDtypeStruct(leaf.shape, leaf.dtype), row)
            return trace(traced_function(function, shapes, simplify=simplify))

        try:
            if source is None:
                return computed_by(*trace_row())
            return computed_by(*stored(name, source, (*others, key), trace_row))
        except UnsupportedError:
            return _by_xla(function, all_rows=all_rows) if by_xla is None else by_xla()

    def of_rows(*trees: Any) -> Any:
        columns = _mapped(np.asarray, trees)
        row = _mapped(lambda column: np.empty(column.shape[1:], column.dtype), columns)
        key = f"{_structure(row)} {[(leaf.shape, leaf.dtype.str) for leaf in _leaves(row)]}"
        # who asks for a function of a model keeps it by the model's content
        known = key, "" if source is None or isinstance(source, Model) else content_of(source)
        with lock:  # groups of lanes open their first rows at the same time
            if known not in programs:
                programs[known] = compiled(row, key)
        return programs[known](*columns)

    return of_rows


def stored_function(function: Callable[..., Any]) -> Callable[..., Any]:
    """Make the function of many rows from a function in JAX of one row; its program is stored.

    A later session neither traces nor compiles it, as long as nothing has changed that the function reads.

    Args:
        function: a function of a module, from mappings, lists and numbers to arrays. One that is written at a
            prompt, or reads files, the environment or a clock, is traced in each session.

    Returns:
        The function, whose arguments and results have the rows as their first axis; results are mappings and
        lists of arrays.

    Example:
        >>> import numpy as np, gaitsweep as gs
        >>> def area(sides): return sides["a"] * sides["b"]
        >>> gs.analyses.stored_function(area)({"a": np.arange(3.0), "b": np.full(3, 2.0)})
        array([0., 2., 4.])
    """
    return over_rows(function, function.__name__, function)


def _by_xla(function: Callable[..., Any], *, all_rows: bool) -> Callable[..., Any]:
    """The function of rows that XLA computes."""
    compiled = jax.jit(jax.vmap(function), compiler_options={} if all_rows else UNOPTIMISED)

    def of_rows(*trees: Any) -> Any:
        outputs = []
        for first in range(0, max(len(_leaves(trees)[0]), 1), _ROWS_AT_A_TIME):
            rows = slice(first, first + _ROWS_AT_A_TIME)
            with jax.default_device(host_device()):
                outputs.append(
                    jax.device_get(compiled(*jax.tree.map(lambda leaf, rows=rows: leaf[rows], trees)))
                )
        return jax.tree.map(lambda *leaves: np.concatenate(leaves), *outputs)

    return of_rows


def _traced_operations(traced: TracedFunction) -> tuple[list[Any], list[int], Any, Any]:
    """The operations of a function of one row, each with its arguments or its value, and its results."""
    order = traced.program.needed(traced.outputs)
    place = {at: i for i, at in enumerate(order)}
    operations = []
    for node in (traced.program.nodes[at] for at in order):
        operands = [place[argument] for argument in node.args] if node.args else node.value
        operations.append((node.op, operands))
    return operations, [place[at] for at in traced.outputs], traced.arrays, traced.results


def _traced_kernel(traced: TracedFunction) -> tuple[Any, Any, Any]:
    """The kernel of a function of one row, and its results."""
    from gaitsweep.engine.kernel.row_kernel import row_kernel

    return row_kernel(traced), traced.arrays, traced.results


def _by_numpy(operations: list[Any], outputs: list[int], arrays: Any, results: Any) -> Callable[..., Any]:
    """The function of rows that a program of `_traced_operations` computes."""

    def of_rows(columns: list[np.ndarray], numbers: Float[np.ndarray, "rows numbers"]) -> None:
        values: list[Any] = []
        with np.errstate(all="ignore"):
            for op, operands in operations:
                if op == "input":
                    values.append(columns[int(operands)])
                elif op == "constant":
                    values.append(operands)
                else:
                    evaluate = _OF_ARRAYS.get(op, OPERATIONS[op].evaluate)
                    values.append(evaluate(*(values[argument] for argument in operands)))
        for i, at in enumerate(outputs):
            numbers[:, i] = values[at]

    return lambda *trees: _arrays(_in_parts(of_rows, _columns(trees), len(outputs)), arrays, results)


def _by_kernel(kernel: Any, arrays: Any, results: Any) -> Callable[..., Any]:
    """The function of rows that a kernel of `_traced_kernel` computes."""
    from gaitsweep.engine.kernel.row_kernel import RowKernel, running

    kernel = RowKernel(*kernel)
    run = running(kernel)

    def of_rows(*trees: Any) -> Any:
        columns = _columns(trees)
        if kernel.read:
            return _arrays(_in_parts(run, columns, kernel.outputs), arrays, results)
        one = _in_parts(run, [column[:1] for column in columns], kernel.outputs)  # the same for all rows
        return _arrays(np.repeat(one, len(columns[0]), axis=0), arrays, results)

    return of_rows


def _in_parts(
    of_rows: Callable[[list[np.ndarray], np.ndarray], None], columns: list[np.ndarray], outputs: int
) -> Float[np.ndarray, "rows outputs"]:
    """The outputs of rows, of which `of_rows(columns, numbers)` computes some at a time."""
    numbers = np.empty((len(columns[0]), outputs))
    for first in range(0, len(numbers), _ROWS_AT_A_TIME):
        rows = slice(first, first + _ROWS_AT_A_TIME)
        of_rows([column[rows] for column in columns], numbers[rows])
    return numbers


def _columns(trees: Any) -> list[np.ndarray]:
    """A column (rows,) for each number of a row."""
    return [
        column
        for leaf in _leaves(trees)
        for column in np.reshape(leaf, (len(leaf), math.prod(leaf.shape[1:]))).T
    ]


def _arrays(numbers: Float[np.ndarray, "rows numbers"], arrays: Any, results: Any) -> Any:
    """The results of rows from the numbers of their arrays."""
    firsts = np.cumsum([0, *(size for size, _, _ in arrays)])

    def array(place: int) -> np.ndarray:
        size, shape, dtype = arrays[place]
        of_array = numbers[:, firsts[place] : firsts[place] + size]
        with np.errstate(invalid="ignore"):  # a whole number of a row that failed
            return of_array.astype(dtype, copy=False).reshape(len(numbers), *shape)

    return _mapped(array, results)


def _mapped(function: Callable[..., Any], tree: Any) -> Any:
    """`jax.tree.map`, which does not import JAX for a tree of dictionaries, lists, tuples and numbers."""
    if type(tree) is dict:
        return {name: _mapped(function, tree[name]) for name in sorted(tree)}
    if type(tree) in (list, tuple):
        return type(tree)(_mapped(function, branch) for branch in tree)
    if isinstance(tree, np.ndarray | np.generic | int | float):
        return function(tree)
    return jax.tree.map(function, tree)


def _leaves(tree: Any) -> list[Any]:
    """The leaves of a tree, in JAX's order."""
    leaves: list[Any] = []
    _mapped(leaves.append, tree)
    return leaves


def _structure(tree: Any) -> str:
    """The structure of a tree, with the names of its parts."""
    if type(tree) is dict:
        return "{" + ", ".join(f"{name!r}: {_structure(tree[name])}" for name in sorted(tree)) + "}"
    if type(tree) in (list, tuple):
        return f"{type(tree).__name__}({', '.join(map(_structure, tree))})"
    return "*" if isinstance(tree, np.ndarray) else str(jax.tree.structure(tree))
