"""Opening of rows: the slots of trajectories at their start, by a kernel, or by XLA if a model needs it."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float
from llvmlite import ir

from gaitsweep.engine.kernel import llvm_code
from gaitsweep.engine.kernel.cpu_program import TILE, loaded_once
from gaitsweep.engine.kernel.llvm_code import ARRAY, INDEX, VOID, loop
from gaitsweep.engine.kernel.program import Program
from gaitsweep.engine.kernel.source import PYTHON, statements
from gaitsweep.engine.kernel.trace import Tracer
from gaitsweep.engine.sweep.lane import OneLane, host_device

# Rows that XLA opens in one call: constant, since its last bits depend on it.
_BATCH = 64

Columns = Mapping[str, Float[np.ndarray, " rows"]]


class Opened(NamedTuple):
    """Opened rows (n,): their slots, the first sample of each, and whether to keep that sample."""

    slots: Float[np.ndarray, "rows slots"]
    samples: Float[np.ndarray, "rows width"]
    keeps: Bool[np.ndarray, " rows"]


class Opening(NamedTuple):
    """The opening of rows by a kernel: its source, its inputs and slots, and the width of a sample."""

    source: str
    inputs: int
    slots: int
    width: int

    @property
    def size(self) -> int:
        """The slots of a lane of the kernel."""
        return self.inputs + self.slots + self.width + 1


def _of_one(lane: OneLane) -> Callable[..., tuple[Array, Array, Array]]:
    def of_one(values: Mapping[str, Array], starts: Mapping[str, Array]) -> tuple[Array, Array, Array]:
        constants, carry, record, sample, keep = lane.open(values, starts)
        flat = [jnp.ravel(leaf).astype(jnp.float64) for leaf in jax.tree.leaves((constants, carry, record))]
        return jnp.concatenate(flat), sample.astype(jnp.float64), keep

    return of_one


def opening_of(lane: OneLane, values: Any, starts: Any) -> Opening:
    """The opening of a trajectory.

    Args:
        lane: the engine's functions of one trajectory.
        values, starts: shapes and dtypes of a row's parameters and initial conditions.

    Raises:
        UnsupportedError: the model uses an operation that the scalar kernel does not have.
    """
    program = Program()
    tracer = Tracer(program)
    inputs_of_row = tracer.inputs((values, starts), 0, steady=False)
    slots, samples, keep = tracer.read(jax.make_jaxpr(_of_one(lane))(values, starts), inputs_of_row)
    inputs, outputs = [int(nodes) for nodes in inputs_of_row], [*slots.tolist(), *samples.tolist(), int(keep)]
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
    return Opening(f"def open(s):\n{body}\n", len(inputs), slots.size, samples.size)


def opened_by_kernel(opening: Opening) -> Callable[[Columns, Columns], Opened]:
    """The function `(values, starts) -> (slots, samples, keep)` of rows."""
    source, size = opening.source, opening.size
    run = loaded_once(source, lambda: _module(source, size), ctypes.c_void_p, ctypes.c_int64)

    def open_rows(values: Columns, starts: Columns) -> Opened:
        columns = jax.tree.leaves((dict(values), dict(starts)))
        rows = len(columns[0])
        tiles = -(-rows // TILE)
        room = np.zeros((size, tiles * TILE))
        room[: len(columns), :rows] = columns
        tiled = np.ascontiguousarray(room.reshape(size, tiles, TILE).transpose(1, 0, 2))
        run(tiled.ctypes.data, tiles)
        opened = tiled[:, len(columns) :].transpose(0, 2, 1).reshape(tiles * TILE, -1)[:rows]
        return Opened(opened[:, : opening.slots], opened[:, opening.slots : -1], opened[:, -1] != 0.0)

    return open_rows


def _module(source: str, size: int) -> ir.Module:
    """The opening of tiles in LLVM's language; a lane has `size` slots."""
    module = ir.Module()
    open_tile = llvm_code.add_function(module, source, TILE)
    run = ir.Function(module, ir.FunctionType(VOID, [ARRAY, INDEX]), "run")
    builder = ir.IRBuilder(run.append_basic_block("entry"))
    with loop(builder, run.args[1]) as (tile, _):
        builder.call(open_tile, [builder.gep(run.args[0], [builder.mul(tile, INDEX(size * TILE))])])
    builder.ret_void()
    return module


def opened_by_xla(lane: OneLane) -> Callable[[Columns, Columns], Opened]:
    """As `opened_by_kernel`, of a model with operations that the scalar kernel does not have."""
    compiled = jax.jit(jax.vmap(_of_one(lane)))

    def open_rows(values: Columns, starts: Columns) -> Opened:
        rows, parts = len(next(iter(values.values()))), []
        for first in range(0, rows, _BATCH):
            # the last batch is filled up with its own rows
            batch = np.resize(np.arange(first, min(first + _BATCH, rows)), _BATCH)
            columns = [{k: v[batch] for k, v in by_name.items()} for by_name in (values, starts)]
            with jax.default_device(host_device()):
                parts.append(jax.device_get(compiled(*columns)))
        return Opened(*(np.concatenate(output)[:rows] for output in zip(*parts, strict=True)))

    return open_rows
