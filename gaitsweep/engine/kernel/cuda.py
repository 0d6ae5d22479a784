"""A chunk's program for an NVIDIA GPU: a thread for each trajectory, compiled by numba-cuda.

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
from gaitsweep.engine.kernel.emit import loaded, statements, stored, used_inputs
from gaitsweep.engine.kernel.lanes import KernelLanes
from gaitsweep.engine.lane import Given
from gaitsweep.engine.record import BUFFER, CADENCE
from gaitsweep.engine.xla import Device, Values

# Threads of a block; 64, 128 and 256 ran equally fast.
THREADS = 128
# Registers of a thread: all that it may have. With fewer, more threads fit on the card at once, but what no
# longer fits goes to memory, and that costs more.
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
    status = chunk.record.status.first
    head = _PREAMBLE.format(title=title, status=status, registers=REGISTERS)
    return head + "\n".join(f"    {line}" for line in _Thread(chunk).lines()) + "\n"


class _Thread:
    """The lines of one thread: held slots and the carry live in registers `c`, the record in memory."""

    def __init__(self, chunk: Chunk) -> None:
        self.chunk = chunk
        program = chunk.program
        self.attempted = list(chunk.attempt.values())
        self.looked = [*chunk.look.values(), *chunk.row, chunk.keep]
        inputs = set(used_inputs(program, [*self.attempted, *self.looked, *chunk.steady.values()]))
        # what an attempt changes goes round the loop even where nothing reads it
        inputs |= {
            at
            for at, node in enumerate(program.nodes)
            if node.op == "input" and chunk.slot_of(at) in chunk.attempt
        }
        self.inputs = sorted(inputs)
        self.names = {
            at: f"{'r' if self._of_record(chunk.slot_of(at)) else 'c'}{chunk.slot_of(at)}"
            for at in self.inputs
        }

    def lines(self) -> list[str]:
        chunk = self.chunk
        status, halt = chunk.record.status.first, chunk.carry.halt.first
        return [
            *self._opening(),
            "for _ in range(looks):",
            f"    for _ in range({CADENCE}):",
            f"        if c{halt} != 0.0:",
            "            break",
            *(f"        {line}" for line in self._attempt()),
            *(f"    {line}" for line in self._look()),
            f"    if S[{status}, i] != 0.0:",
            "        break",
            *self._closing(),
        ]

    def _of_record(self, slot: int) -> bool:
        return slot >= self.chunk.first_of_record

    def _opening(self) -> list[str]:
        """Registers are loaded, and what stays the same along a trajectory is worked out."""
        lines = [f"{self.names[at]} = {self._loaded(at)}" for at in self.inputs if self.names[at][0] == "c"]
        nodes = list(self.chunk.steady.values())
        more, results = statements(self.chunk.program, nodes, self.names, "h")
        self.names |= dict(zip(nodes, results, strict=True))
        return lines + more

    def _attempt(self) -> list[str]:
        lines, results = statements(self.chunk.program, self.attempted, self.names, "v")
        changed = {f"c{slot}": result for slot, result in zip(self.chunk.attempt, results, strict=True)}
        return lines + _assigned(changed)

    def _look(self) -> list[str]:
        chunk = self.chunk
        lines = [f"{name} = {self._loaded(at)}" for at, name in self.names.items() if name[0] == "r"]
        more, results = statements(chunk.program, self.looked, self.names, "w")
        lines += more
        if chunk.width:
            lines += [f"if {results[-1]}:", f"    place = int(S[{chunk.record.filled.first}, i])"]
            row = results[len(chunk.look) : -1]
            lines += [f"    kept[place, {k}, i] = {value}" for k, value in enumerate(row)]
        carried: dict[str, str] = {}
        for (slot, at), result in zip(chunk.look.items(), results, strict=False):
            if self._of_record(slot):
                lines.append(f"S[{slot}, i] = {self._stored(at, result)}")
            else:
                carried[f"c{slot}"] = result
        return lines + _assigned(carried)

    def _closing(self) -> list[str]:
        chunk = self.chunk
        changing = {slot for slot in (*chunk.attempt, *chunk.look) if not self._of_record(slot)}
        return [
            f"S[{chunk.slot_of(at)}, i] = {self._stored(at, self.names[at])}"
            for at in self.inputs
            if chunk.slot_of(at) in changing
        ]

    def _loaded(self, at: int) -> str:
        return loaded(self.chunk.program.nodes[at].kind, f"S[{self.chunk.slot_of(at)}, i]")

    def _stored(self, at: int, value: str) -> str:
        return stored(self.chunk.program.nodes[at].kind, value)


def _assigned(values: dict[str, str]) -> list[str]:
    """Assignments that all read what was before any of them."""
    early = {name: f"n{name}" for name, value in values.items() if value in values and value != name}
    lines = [f"{temporary} = {values[name]}" for name, temporary in early.items()]
    return lines + [f"{name} = {early.get(name, value)}" for name, value in values.items() if value != name]


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
            given = self.given(lambda slot: self._slots[slot].copy_to_host())
            new = int(given.record.filled.max())
            if new:
                kept = self._kept[:new].copy_to_host()
                self._slots[self.chunk.record.filled.first].copy_to_device(self._none_filled)
                given = given._replace(kept=kept.transpose(2, 0, 1))
        return given

    def _launch(self, name: str, threads: int, *args: Any) -> None:
        blocks = -(-threads // THREADS)
        with warnings.catch_warnings():
            # a few lanes on a large card leave it idle, as Numba warns, but they are what was asked for
            warnings.simplefilter("ignore")
            getattr(self._program, name)[blocks, THREADS](*args)
