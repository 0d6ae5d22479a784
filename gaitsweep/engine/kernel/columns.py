"""A function of one row for many rows at once, by NumPy.

A run calls several functions only once or twice, on few rows: XLA takes much longer to compile such a
function than NumPy takes to compute it. Results may differ from those of XLA in the last place.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable
from functools import partial
from typing import Any

import jax
import numpy as np

from gaitsweep.contract import Model
from gaitsweep.engine.kernel.operations import OPERATIONS
from gaitsweep.engine.kernel.program import Program
from gaitsweep.engine.kernel.trace import Tracer, UnsupportedError
from gaitsweep.engine.stored_programs import stored
from gaitsweep.engine.sweep.lane import host_device

# Rows that are computed at a time, since the values of all nodes are in memory.
_AT_A_TIME = 4096
# NumPy's forms of operations whose own form takes one number at a time.
_OF_ARRAYS: dict[str, Callable[..., Any]] = {
    "select": np.where,
    **{name: np.vectorize(OPERATIONS[name].evaluate, otypes=[float]) for name in ("erf", "erfc")},
}


def over_rows(
    function: Callable[..., Any], name: str = "", model: Model | None = None, *others: Any
) -> Callable[..., Any]:
    """The function of many rows: arguments and results have the rows as their first axis.

    Args:
        function: a JAX function of one row, from pytrees to a pytree of arrays; XLA computes it where it has
            operations that a scalar program lacks.
        name, model, others: what a program is stored by (`stored_programs.stored`). Its results are then
            mappings and lists of arrays. Without a model it is traced in each process.
    """
    programs: dict[Hashable, Callable[..., Any]] = {}

    def of_rows(*trees: Any) -> Any:
        columns, structure = jax.tree.flatten(jax.tree.map(np.asarray, trees))
        shapes = [jax.ShapeDtypeStruct(column.shape[1:], column.dtype) for column in columns]
        key = structure, tuple((shape.shape, shape.dtype) for shape in shapes)
        if key not in programs:
            of_row = partial(_program, function, jax.tree.unflatten(structure, shapes))
            try:
                program = of_row() if model is None else stored(name, model, (*others, repr(key)), of_row)
                programs[key] = partial(_by_numpy, *program)
            except UnsupportedError:
                programs[key] = _by_xla(function)
        outputs = []
        for first in range(0, max(len(columns[0]), 1), _AT_A_TIME):
            part = [column[first : first + _AT_A_TIME] for column in columns]
            outputs.append(programs[key](*jax.tree.unflatten(structure, part)))
        if len(outputs) == 1:
            return outputs[0]
        return jax.tree.map(lambda *leaves: np.concatenate(leaves), *outputs)

    return of_rows


def _by_xla(function: Callable[..., Any]) -> Callable[..., Any]:
    # on few rows an optimised program saves less time than its optimisation takes
    compiled = jax.jit(jax.vmap(function), compiler_options={"xla_backend_optimization_level": 0})

    def of_rows(*trees: Any) -> Any:
        with jax.default_device(host_device()):
            return jax.device_get(compiled(*trees))

    return of_rows


def _program(function: Callable[..., Any], shapes: Any) -> tuple[list[Any], list[Any], Any]:
    """The operations of a function of one row, each with its arguments or its value, and its results."""
    jaxpr, out = jax.make_jaxpr(function, return_shape=True)(*shapes)
    program = Program(simplify=False)  # a product with 0 is NaN where the other factor is
    tracer = Tracer(program)
    outputs = tracer.read(jaxpr, tracer.inputs(shapes, 0, steady=False))
    results, structure = jax.tree.flatten(out)
    order = program.needed([at for nodes in outputs for at in nodes.ravel().tolist()])
    place = {at: i for i, at in enumerate(order)}
    operations = [
        (node.op, [place[argument] for argument in node.args] if node.args else node.value)
        for node in (program.nodes[at] for at in order)
    ]
    arrays = [
        ([place[at] for at in nodes.ravel().tolist()], like.shape, str(like.dtype))
        for nodes, like in zip(outputs, results, strict=True)
    ]
    return operations, arrays, jax.tree.unflatten(structure, range(len(arrays)))


def _by_numpy(operations: list[Any], arrays: list[Any], results: Any, *trees: Any) -> Any:
    """The results of rows, by a program of `_program`."""
    columns = [column for leaf in jax.tree.leaves(trees) for column in np.reshape(leaf, (len(leaf), -1)).T]
    rows = len(columns[0])
    values: list[Any] = []
    with np.errstate(all="ignore"):
        for op, of in operations:
            if op == "input":
                values.append(columns[int(of)])
            elif op == "constant":
                values.append(of)
            else:
                evaluate = _OF_ARRAYS.get(op, OPERATIONS[op].evaluate)
                values.append(evaluate(*(values[argument] for argument in of)))

    def array(place: int) -> np.ndarray:
        elements, shape, dtype = arrays[place]
        outputs_of_rows = np.empty((rows, math.prod(shape)), dtype)
        for i, at in enumerate(elements):
            outputs_of_rows[:, i] = values[at]
        return outputs_of_rows.reshape(rows, *shape)

    return jax.tree.map(array, results)
