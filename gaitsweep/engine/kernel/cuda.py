"""A chunk's program for an NVIDIA GPU: one thread a trajectory, its state in registers, compiled by numba-cuda.

Slots lie lane by lane, so that neighbouring threads read neighbouring numbers. What is worked out once is
worked out by each thread as it starts; the recorder's look reads and writes the record where it lies.
"""

from __future__ import annotations

import importlib
import importlib.util
import warnings
from typing import Any

import numpy as np

from gaitsweep.contract import Status
from gaitsweep.engine.kernel.cache import module_of
from gaitsweep.engine.kernel.chunk import Chunk
from gaitsweep.engine.kernel.emit import statements, used_inputs
from gaitsweep.engine.kernel.lanes import KernelLanes
from gaitsweep.engine.lane import Given
from gaitsweep.engine.record import BUFFER, CADENCE
from gaitsweep.engine.xla import Device, Values

# Threads of a block: few, since a trajectory's state fills many registers.
THREADS = 128
# Registers of a thread at most.
REGISTERS = 255

_PREAMBLE = '''"""Written by gaitsweep: {title}."""
import math

import numpy as np
from numba import cuda
from numba.cuda import libdevice

inf, nan = np.inf, np.nan
float32, float64 = np.float32, np.float64
floor64, floor32 = libdevice.floor, libdevice.floorf
sqrt64, sqrt32 = libdevice.sqrt, libdevice.sqrtf


@cuda.jit(cache=True)
def put(S, lanes, opened):
    k = cuda.grid(1)
    if k < lanes.size:
        for slot in range(opened.shape[0]):
            S[slot, lanes[k]] = opened[slot, k]


@cuda.jit(cache=True)
def put_rows(kept, lanes, rows):
    k = cuda.grid(1)
    if k < lanes.size:
        for number in range(rows.shape[1]):
            kept[0, number, lanes[k]] = rows[k, number]


@cuda.jit(cache=True, max_registers={registers})
def run(S, kept, lanes, looks):
    i = cuda.grid(1)
    if i >= lanes:
        return
    if S[{status}, i] != 0.0:
        return
'''


def missing() -> str | None:
    """What stands in the way of kernels on the GPU, in words, or None."""
    if importlib.util.find_spec("numba_cuda") is None:
        return "the package numba-cuda is not installed"
    _load_numba_cuda()
    from numba import cuda

    return None if cuda.is_available() else "numba-cuda finds no CUDA driver"


def _load_numba_cuda() -> None:
    """Import numba-cuda, whose releases up to 0.30 ask for a name that NumPy 2.5 has dropped."""
    lacking = not hasattr(np, "row_stack")
    if lacking:
        np.row_stack = np.vstack  # type: ignore[attr-defined]
    try:
        importlib.import_module("numba.cuda.np.arrayobj")
    finally:
        if lacking:
            del np.row_stack  # type: ignore[attr-defined]


def source(chunk: Chunk, title: str) -> str:
    """The module whose kernel `run(S, kept, lanes, looks)` advances each lane by up to `looks` looks.

    `S` (slots, lanes) float64; `kept` (BUFFER, width, lanes) gets the rows that are kept.
    """
    program = chunk.program
    status, halt = chunk.record.status.first, chunk.carry.halt.first
    attempted = list(chunk.attempt.values())
    looked = [*chunk.look.values(), *chunk.row, chunk.keep]
    first_of_record = min(leaf.first for leaf in _leaves(chunk.record))
    given = {at: f"h{at}" for at in chunk.steady.values()}
    lines: list[str] = []

    # held slots and the carry live in registers, the record in memory
    inputs = {*used_inputs(program, [*attempted, *looked, *chunk.steady.values()])}
    inputs |= {at for at, node in enumerate(program.nodes) if node.op == "input" and node.value in chunk.attempt}
    names: dict[int, str] = {}
    for at in sorted(inputs):
        slot = int(program.nodes[at].value or 0)
        names[at] = f"r{slot}" if slot >= first_of_record else f"c{slot}"
        if slot < first_of_record:
            lines.append(f"c{slot} = {_loaded(chunk, at)}")
    steady_lines, steady = statements(program, list(chunk.steady.values()), names, "h")
    lines += steady_lines
    lines += [f"{given[at]} = {name}" for at, name in zip(given, steady, strict=True) if given[at] != name]
    names |= given

    halted = f"c{halt}"
    lines += ["for _ in range(looks):", f"    for _ in range({CADENCE}):", f"        if {halted} != 0.0:"]
    lines += ["            break"]
    steps, results = statements(program, attempted, names, "v")
    lines += [f"        {line}" for line in steps]
    lines += _assigned("        ", {f"c{slot}": r for slot, r in zip(chunk.attempt, results, strict=True)})

    records = [at for at in used_inputs(program, looked, names) if int(program.nodes[at].value or 0) >= first_of_record]
    records += [at for at in inputs if int(program.nodes[at].value or 0) >= first_of_record and at not in records]
    lines += [f"    {names[at]} = {_loaded(chunk, at)}" for at in records]
    steps, results = statements(program, looked, names, "w")
    lines += [f"    {line}" for line in steps]
    n = len(chunk.look)
    if chunk.width:
        filled = chunk.record.filled.first
        lines += [f"    if {results[-1]}:", f"        place = int(S[{filled}, i])"]
        row = results[n:-1]
        lines += [f"        kept[place, {k}, i] = {value}" for k, value in enumerate(row)]
    carried: dict[str, str] = {}
    for slot, at, result in zip(chunk.look, looked, results, strict=False):
        if slot >= first_of_record:
            stored = f"1.0 if {result} else 0.0" if program.nodes[at].kind == "bool" else result
            lines.append(f"    S[{slot}, i] = {stored}")
        else:
            carried[f"c{slot}"] = result
    lines += _assigned("    ", carried)
    lines += [f"    if S[{status}, i] != 0.0:", "        break"]
    changing = sorted({slot for slot in [*chunk.attempt, *chunk.look] if slot < first_of_record})
    kinds = {int(program.nodes[at].value or 0): program.nodes[at].kind for at in inputs}
    for slot in changing:
        stored = f"1.0 if c{slot} else 0.0" if kinds[slot] == "bool" else f"c{slot}"
        lines.append(f"S[{slot}, i] = {stored}")
    return _PREAMBLE.format(title=title, status=status, registers=REGISTERS) + "\n".join(f"    {line}" for line in lines) + "\n"


def _leaves(tree: Any) -> list[Any]:
    import jax

    return jax.tree.leaves(tree)


def _loaded(chunk: Chunk, at: int) -> str:
    node = chunk.program.nodes[at]
    place = f"S[{node.value}, i]"
    if node.kind == "bool":
        return f"{place} != 0.0"
    return f"float32({place})" if node.kind == "f32" else place


def _assigned(indent: str, values: dict[str, str]) -> list[str]:
    """Assignments that all read what was before any of them."""
    targets = set(values)
    held = {name: f"n{name}" for name, value in values.items() if value in targets and value != name}
    lines = [f"{indent}{temporary} = {values[name]}" for name, temporary in held.items()]
    lines += [f"{indent}{name} = {held.get(name, value)}" for name, value in values.items() if value != name]
    return lines


class CudaLanes(KernelLanes):
    """Lanes on one GPU, a thread each."""

    batch = 4096

    def __init__(self, *args: Any, device: Device, **options: Any) -> None:
        super().__init__(*args, **options)
        _load_numba_cuda()
        from numba import cuda

        self._cuda = cuda
        self._number = getattr(device, "local_hardware_id", None) or 0
        self._program = module_of(source(self.chunk, self.kernel.title))
        slots = np.zeros((self.chunk.n_slots, self.size))
        slots[self.chunk.record.status.first] = Status.complete
        with cuda.gpus[self._number]:
            self._slots = cuda.to_device(slots)
            self._kept = cuda.to_device(np.zeros((BUFFER, self.chunk.width, self.size)))
            self._none_filled = cuda.to_device(np.zeros(self.size))
        # the rows of `_slots` that the host reads after each chunk
        carry, record = self.chunk.carry, self.chunk.record
        read = [carry.t, carry.attempts, *(leaf for leaf in _leaves(record) if leaf is not record.window)]
        self._read = sorted(leaf.first + i for leaf in read for i in range(leaf.size))

    def fill(self, params: Values, starts: Values, fresh: np.ndarray) -> None:
        """Start new trajectories; those of all batches go to the device together."""
        self._staged: list[tuple[np.ndarray, ...]] = []
        super().fill(params, starts, fresh)
        lanes, opened, rows, kept = (np.concatenate(part) for part in zip(*self._staged, strict=True))
        with self._cuda.gpus[self._number]:
            self._launch("put", lanes.size, self._slots, lanes, np.ascontiguousarray(opened.T))
            if self.chunk.width and kept.any():
                self._launch("put_rows", int(kept.sum()), self._kept, lanes[kept], rows[kept])

    def put(self, lanes: np.ndarray, opened: np.ndarray, rows: np.ndarray, kept: np.ndarray) -> None:
        self._staged.append((lanes, opened, rows, kept))

    def run_chunk(self, looks: int) -> Given:
        """Advance all running lanes by up to `looks * CADENCE` attempts."""
        with self._cuda.gpus[self._number]:
            self._launch("run", self.size, self._slots, self._kept, self.size, looks)
            slots = np.zeros((self.chunk.n_slots, self.size))
            for slot in self._read:
                self._slots[slot].copy_to_host(slots[slot])
            filled = self.chunk.record.filled.first
            new = int(slots[filled].max())
            kept = np.zeros((0, self.chunk.width, self.size))
            if new:
                kept = self._kept[:new].copy_to_host()
                self._slots[filled].copy_to_device(self._none_filled)
        return self.given(slots, kept.transpose(2, 0, 1))

    def _launch(self, name: str, threads: int, *args: Any) -> None:
        blocks = -(-threads // THREADS)
        with warnings.catch_warnings():
            # a few lanes on a large card leave it idle, as Numba warns, but they are what was asked for
            warnings.simplefilter("ignore")
            getattr(self._program, name)[blocks, THREADS](*args)
