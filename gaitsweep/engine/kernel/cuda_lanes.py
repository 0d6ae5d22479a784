"""The lanes of an NVIDIA GPU; `gpu_program` has their program."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import lru_cache, partial
from typing import final

import jax
import numpy as np
from jaxtyping import Array, Float, Int

from gaitsweep.contract import Params
from gaitsweep.engine.devices import Device
from gaitsweep.engine.kernel import gpu_program
from gaitsweep.engine.kernel.cuda_device import CudaDevice, DeviceArray, PinnedMemory
from gaitsweep.engine.kernel.gpu_program import LaneKernels, RunKernel
from gaitsweep.engine.kernel.lanes import Kernel, KernelLanes
from gaitsweep.engine.recorders.recorder import BUFFER
from gaitsweep.engine.stored_traces import dependences
from gaitsweep.engine.sweep.lane import ChunkOutput, Values
from gaitsweep.engine.sweep.sweep_spec import SweepSpec
from gaitsweep.status import Status

# Numbers of all lanes of a group on the card (512 MiB), unless they are few: cards of laptops have some GB.
_MOST_NUMBERS = 2**26
_FEW_LANES = 65_536


# Cached, since each group of lanes, and those of a self-check, would print them again.
@lru_cache(maxsize=16)
def _lane_kernels(kernel: Kernel, read_slots: tuple[int, ...]) -> LaneKernels:
    """The kernels that fill lanes and collect their slots `read_slots`."""

    def lane_kernels() -> LaneKernels:
        opening, from_row = kernel.opening()
        return gpu_program.lane_kernels(kernel.chunk, opening, read_slots, kernel.title, from_row=from_row)

    return LaneKernels(*kernel.stored("lanes_on_card", lane_kernels))


@lru_cache(maxsize=16)
def _run_kernel(kernel: Kernel, varying: frozenset[int]) -> RunKernel:
    """The kernel that advances trajectories, some of whose slots vary between rows."""

    def run_kernel() -> RunKernel:
        return gpu_program.run_kernel(kernel.chunk, varying, kernel.title)

    return RunKernel(*kernel.stored("run_on_card", run_kernel, tuple(sorted(varying))))


@lru_cache(maxsize=16)
def varying_slots(kernel: Kernel, names: frozenset[str]) -> frozenset[int]:
    """The slots of a trajectory's constants that depend on parameters with these names."""
    if not names:
        return frozenset()
    compute = partial(_varying_slots, kernel, names)
    return frozenset(kernel.stored("varying_slots", compute, tuple(sorted(names))))


def _varying_slots(kernel: Kernel, names: frozenset[str]) -> list[int]:
    """The slots of `varying_slots`, traced."""

    def constants(
        values: Mapping[str, Float[Array, " ..."]], starts: Mapping[str, Float[Array, ""]]
    ) -> Params:
        return kernel.lane.open(values, starts)[0]

    leaves = jax.tree.leaves(kernel.chunk.constants)
    dependent = dependences(constants, *kernel.shapes)
    return [
        leaf.first + i
        for leaf, names_of_leaf in zip(leaves, dependent, strict=True)
        if names_of_leaf & names
        for i in range(leaf.size)
    ]


@final
class CudaLanes(KernelLanes):
    """Lanes on one GPU, more than it has threads; `run` is the kernel that advances them, once filled.

    Args:
        spec: the sweep.
        device: the GPU.
    """

    def __init__(self, spec: SweepSpec, device: Device) -> None:
        super().__init__(spec)
        self.card = CudaDevice(getattr(device, "local_hardware_id", None) or 0)
        self._contraction = spec.numerics.contraction
        self._read_slots = [leaf.first + i for leaf in self.kernel.leaves.values() for i in range(leaf.size)]
        self._lane_kernels = _lane_kernels(self.kernel, tuple(self._read_slots))
        module = self.card.module(self._lane_kernels.source, contraction=self._contraction)
        self._put = module.get_kernel("put")
        self._collect = module.get_kernel("collect")
        self._trajectory = module.get_kernel("trajectory")
        self._uniform = UniformConstants(self._lane_kernels.read, varying_slots(self.kernel, spec.varied))
        n_slots = self._lane_kernels.slots
        width = self.kernel.width
        n_entries = 1 + self._lane_kernels.inputs
        numbers_of_lane = n_slots + BUFFER * width + len(self._read_slots) + n_entries
        size = min(self.size, max(_FEW_LANES, _MOST_NUMBERS // numbers_of_lane))
        self.size = self.at_a_time = size
        n_output = max(len(self._read_slots) * size, n_slots)
        # rows are opened before a chunk, whose output is copied before the next ones are opened
        in_turn = PinnedMemory(self.card, max(n_output, n_entries * size))
        self._slots = DeviceArray(self.card, (n_slots, size))
        self._samples = DeviceArray(self.card, (BUFFER, size, width))
        self._output = DeviceArray(self.card, (n_output,), in_turn)
        self._queue = DeviceArray(self.card, (2,))
        self._entries = DeviceArray(self.card, (n_entries, size), in_turn)
        self._under_way = np.zeros(size, bool)  # lanes whose trajectory has not ended
        self.card.launch(module.get_kernel("clear"), size, self._slots, size, self._queue)
        self.card.wait()

    def fill(self, params: Values, starts: Values, lanes: Int[np.ndarray, " opened"]) -> None:
        """Start new trajectories; all of them are copied to the card together."""
        self.card.use()
        count = lanes.size
        entries = self._entries.host(self._entries.shape[0] * count).reshape(-1, count)
        entries[0] = lanes
        for place, column in enumerate(self._inputs(params, starts), start=1):
            entries[place] = column
        self._entries.to_card(entries.size)
        self.card.launch(self._put, count, self._slots, self._samples, self.size, self._entries, count)
        self._under_way[lanes] = True
        if self._uniform.differs(entries[1:]):
            n_slots = self._lane_kernels.slots
            self.card.launch(self._trajectory, n_slots, self._slots, self.size, int(lanes[0]), self._output)
            slots = self._output.from_card(n_slots)
            kernel = _run_kernel(self.kernel, self._uniform.varying)
            module = self.card.module(kernel.source, contraction=self._contraction)
            if kernel.uniform:
                uniform = gpu_program.uniform_bytes(kernel.uniform, slots)
                self.card.set_constant(module, "uniform", uniform)
            self.run = module.get_kernel("run")
            self.at_a_time = min(self.size, self.card.threads(self.run))
        self.card.wait()

    def _inputs(self, params: Values, starts: Values) -> Iterator[np.ndarray]:
        """The inputs (opened,) of the function that opens trajectories, in order."""
        if self._lane_kernels.from_row:
            for names, columns in zip(self.kernel.names, (params, starts), strict=True):
                yield from (columns[name] for name in names)
        else:
            opened = self.opened(params, starts)
            yield from (*opened.slots.T, *opened.samples.T, opened.keeps)

    def advance(self, polls: int) -> None:
        """Start to advance running lanes; `card.wait` waits for the end.

        There is a thread for each lane that runs. With more threads, lanes would be spread over more warps,
        and a warp takes as long for one lane as for 32.
        """
        threads = min(self.at_a_time, max(1, int(np.count_nonzero(self._under_way))))
        self.card.launch(
            self.run, threads, self._slots, self._samples, self.size, self._queue, polls, threads
        )

    def run_chunk(self, polls: int) -> ChunkOutput:
        """Let each thread make up to `polls * POLL_INTERVAL` attempts, of running lanes in turn."""
        self.card.use()
        size = self.size
        width = self.kernel.width
        self.advance(polls)
        self.card.launch(self._collect, size, self._slots, size, self._queue, self._output)
        values = self._output.from_card(len(self._read_slots) * size).reshape(-1, size)
        places = {slot: place for place, slot in enumerate(self._read_slots)}

        def read(slots: slice) -> Float[np.ndarray, "slots lanes"]:
            first = places.get(slots.start, 0)  # a leaf without slots has no place
            return values[first : first + slots.stop - slots.start]

        output = self.output(read)
        self._under_way = output.numbers["status"] == Status.running
        # the levels of the buffers that have new samples in some lane
        new = int(output.filled.max()) if width else 0
        if new:
            samples = self._samples.from_card(new * size * width).reshape(new, size, width)
            output = output._replace(buffers=samples.transpose(1, 0, 2))
        return output


class UniformConstants:
    """Detects which constants of trajectories may differ between rows: those that a differing input decides.

    Args:
        read: for each slot of the constants, the inputs that decide it.
        varying: slots that count as different from the start.
    """

    def __init__(self, read: Sequence[Sequence[int]], varying: frozenset[int] = frozenset()) -> None:
        self.varying = varying
        self._read = read
        self._first: np.ndarray | None = None

    def differs(self, inputs: Float[np.ndarray, "inputs rows"]) -> bool:
        """Whether the inputs (k, rows) of new rows change the set of varying constants.

        A late row can differ from all rows before it, so this is called for every row.
        """
        bits = inputs.view(np.int64)
        begun = self._first is not None
        if self._first is None:
            self._first = bits[:, :1].copy()
        different = {int(number) for number in np.flatnonzero((bits != self._first).any(axis=1))}
        varying = self.varying | {
            s for s, numbers in enumerate(self._read) if different.intersection(numbers)
        }
        changed = varying != self.varying or not begun
        self.varying = varying
        return changed
