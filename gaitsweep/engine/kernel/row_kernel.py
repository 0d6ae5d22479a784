"""A function of one row as a kernel for a CPU, which computes a vector of rows at a time."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from llvmlite import ir

from gaitsweep.engine.kernel import llvm_code
from gaitsweep.engine.kernel.cpu_program import TILE, loaded_once
from gaitsweep.engine.kernel.llvm_code import ARRAY, INDEX, VOID, loop
from gaitsweep.engine.kernel.source import PYTHON, statements
from gaitsweep.engine.kernel.trace import TracedFunction

Columns = Sequence[Float[np.ndarray, " rows"]]
Outputs = Float[np.ndarray, "rows outputs"]


class RowKernel(NamedTuple):
    """A function of one row: the source for a tile of rows, the inputs it reads, the number of outputs."""

    source: str
    read: Sequence[int]
    outputs: int


def row_kernel(traced: TracedFunction) -> RowKernel:
    """The kernel of a traced function of one row."""
    program = traced.program
    outputs = traced.outputs
    needed = set(program.needed(outputs))
    read = [number for number, at in enumerate(traced.inputs) if at in needed]
    inputs = [traced.inputs[number] for number in read]
    names = {at: f"x{i}" for i, at in enumerate(inputs)}
    lines, results = statements(PYTHON, program, outputs, names)
    loads = [
        f"x{i} = {PYTHON.loaded(program.nodes[at].kind, f's[{i * TILE}]')}" for i, at in enumerate(inputs)
    ]
    stores = [
        f"s[{(len(inputs) + k) * TILE}] = {PYTHON.stored(program.nodes[at].kind, result)}"
        for k, (at, result) in enumerate(zip(outputs, results, strict=True))
    ]
    body = "\n".join(f"    {line}" for line in [*loads, *lines, *stores])
    return RowKernel(f"def of_tile(s):\n{body}\n", read, len(outputs))


def running(kernel: RowKernel) -> Callable[[Columns, Outputs], None]:
    """The function `(columns, numbers)` of some rows: from a column for each input it sets their outputs."""
    source = kernel.source
    inputs = len(kernel.read)
    size = inputs + kernel.outputs
    run = loaded_once(source, lambda: _module(source, size), ctypes.c_void_p, ctypes.c_int64)

    def of_rows(columns: Columns, numbers: Outputs) -> None:
        rows = len(numbers)
        tiles = -(-rows // TILE)
        of_tiles = np.zeros((inputs, tiles * TILE))
        for place, number in enumerate(kernel.read):
            of_tiles[place, :rows] = columns[number]
        tiled = np.empty((tiles, size, TILE))
        tiled[:, :inputs] = of_tiles.reshape(inputs, tiles, TILE).transpose(1, 0, 2)
        run(tiled.ctypes.data, tiles)
        outputs = tiled[:, inputs:].transpose(0, 2, 1)
        in_full_tiles = rows // TILE * TILE
        numbers[:in_full_tiles].reshape(-1, TILE, kernel.outputs)[:] = outputs[: rows // TILE]
        numbers[in_full_tiles:] = outputs[-1, : rows - in_full_tiles]

    return of_rows


def _module(source: str, size: int) -> ir.Module:
    """The function of tiles in LLVM's language; a row has `size` inputs and outputs."""
    module = ir.Module()
    of_tile = llvm_code.add_function(module, source, TILE)
    run = ir.Function(module, ir.FunctionType(VOID, [ARRAY, INDEX]), "run")
    builder = ir.IRBuilder(run.append_basic_block("entry"))
    with loop(builder, run.args[1]) as (tile, _):
        builder.call(of_tile, [builder.gep(run.args[0], [builder.mul(tile, INDEX(size * TILE))])])
    builder.ret_void()
    return module
