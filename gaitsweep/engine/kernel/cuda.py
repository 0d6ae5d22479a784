"""The lanes of an NVIDIA GPU, one thread for each; `gpu_program` has their program."""

from __future__ import annotations

import importlib
import importlib.util
import warnings
from collections.abc import Callable
from typing import Any

import numpy as np

from gaitsweep.contract import Status
from gaitsweep.engine.kernel import gpu_program
from gaitsweep.engine.kernel.cache import module_of
from gaitsweep.engine.kernel.chunk import Chunk
from gaitsweep.engine.kernel.lanes import KernelLanes
from gaitsweep.engine.recorders.recorder import BUFFER
from gaitsweep.engine.sweep.lane import ChunkOutput, Device, Values
from gaitsweep.engine.sweep.sweep_spec import SweepSpec

# Threads of a block; 64, 128 and 256 are equally fast.
THREADS = 128


def missing() -> str | None:
    """The reason why kernels on the GPU are not available, in words, or None."""
    if importlib.util.find_spec("numba_cuda") is None:
        return "the package numba-cuda is not installed"
    try:
        _load_numba_cuda()
    except ImportError as error:
        return f"numba-cuda cannot be loaded ({error})"
    from numba import cuda

    return None if cuda.is_available() else "numba-cuda finds no CUDA driver"


def _load_numba_cuda() -> None:
    """Import numba-cuda, whose releases up to 0.30 use a name that NumPy 2.5 has removed."""
    lacking = not hasattr(np, "row_stack")
    if lacking:
        np.row_stack = np.vstack  # type: ignore[attr-defined]
    try:
        importlib.import_module("numba.cuda.np.arrayobj")
    finally:
        if lacking:
            del np.row_stack  # type: ignore[attr-defined]


class CudaLanes(KernelLanes):
    """Lanes on one GPU, one thread for each."""

    batch = 4096

    def __init__(self, spec: SweepSpec, device: Device) -> None:
        super().__init__(spec)
        _load_numba_cuda()
        from numba import cuda

        self._cuda = cuda
        self._number = getattr(device, "local_hardware_id", None) or 0
        self._placing = module_of(gpu_program.placing(self.chunk, self.kernel.title))
        self._steady = Steady(self.chunk)
        slots = np.zeros((self.chunk.n_slots, self.size))
        slots[self.chunk.record.status.first] = Status.complete
        with cuda.gpus[self._number]:
            self._slots = cuda.to_device(slots)
            self._kept = cuda.to_device(np.zeros((BUFFER, self.chunk.width, self.size)))
            self._none_filled = cuda.to_device(np.zeros(self.size))

    def fill(self, params: Values, starts: Values, fresh: np.ndarray) -> None:
        """Start new trajectories; all batches are copied to the device together."""
        self._staged: list[tuple[np.ndarray, ...]] = []
        super().fill(params, starts, fresh)
        lanes, opened, rows, kept = (np.concatenate(part) for part in zip(*self._staged, strict=True))
        with self._cuda.gpus[self._number]:
            place = self._placing.put, self._slots.reshape(-1), self.size
            self._launch(*place, lanes, np.ascontiguousarray(opened.T), threads=lanes.size)
            if self.chunk.width and kept.any():
                self._launch(
                    self._placing.put_rows, self._kept, lanes[kept], rows[kept], threads=int(kept.sum())
                )
            if self._steady.differs(opened):
                one = int(lanes[0])
                self._same = self._steady.values(lambda slot: float(self._slots[slot, one]))
                source = gpu_program.running(self.chunk, self._steady.varying, self.kernel.title)
                self._running = module_of(source)

    def put(self, lanes: np.ndarray, opened: np.ndarray, rows: np.ndarray, kept: np.ndarray) -> None:
        self._staged.append((lanes, opened, rows, kept))

    def run_chunk(self, polls: int) -> ChunkOutput:
        """Advance all running lanes by up to `polls * POLL_INTERVAL` attempts."""
        with self._cuda.gpus[self._number]:
            flat = self._slots.reshape(-1), self._kept.reshape(-1), self.size
            self._launch(self._running.run, *flat, polls, self._same, threads=self.size)
            output = self.output(lambda slot: self._slots[slot].copy_to_host())
            new = int(output.record.filled.max())
            if new:
                kept = self._kept[:new].copy_to_host()
                self._slots[self.chunk.record.filled.first].copy_to_device(self._none_filled)
                output = output._replace(kept=kept.transpose(2, 0, 1))
        return output

    def _launch(self, kernel: Any, *args: Any, threads: int) -> None:
        blocks = -(-threads // THREADS)
        with warnings.catch_warnings():
            # Numba warns of small grids, but the number of lanes is the user's choice
            warnings.simplefilter("ignore")
            kernel[blocks, THREADS](*args)


class Steady:
    """Detects which constants of trajectories are equal in all rows."""

    def __init__(self, chunk: Chunk) -> None:
        self.chunk = chunk
        self.varying: frozenset[int] = frozenset()
        self._first: np.ndarray | None = None

    def differs(self, opened: np.ndarray) -> bool:
        """Whether the slots `opened` (rows, slots) of new rows change the set of varying constants.

        A late row can differ from all rows before it, so this is called for every row.
        """
        held = np.ascontiguousarray(opened[:, : self.chunk.first_of_carry]).view(np.int64)
        begun = self._first is not None
        if self._first is None:
            self._first = held[0].copy()
        varying = self.varying | {int(slot) for slot in np.flatnonzero((held != self._first).any(axis=0))}
        changed = varying != self.varying or not begun
        self.varying = varying
        return changed

    def values(self, read: Callable[[int], float]) -> tuple[Any, ...]:
        """The values that are equal in all rows, in the order and with the types of the kernel's argument."""
        same, nodes = gpu_program.same(self.chunk, self.varying), self.chunk.program.nodes
        kinds: dict[str, Callable[[float], Any]] = {"bool": bool, "f32": np.float32}
        return tuple(kinds.get(nodes[at].kind, float)(read(slot)) for at, slot in same.items()) or (0.0,)
