"""The lanes of a scalar kernel: the base class for all devices, and the lanes of a CPU."""

from __future__ import annotations

import abc
import dataclasses
import math
from collections.abc import Callable, Mapping
from functools import lru_cache, partial
from typing import Any, ClassVar, final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, Real

from gaitsweep.contract import Model, Status
from gaitsweep.engine.content import cached_by_content
from gaitsweep.engine.kernel.chunk import Chunk, Leaf, chunk_of
from gaitsweep.engine.numerics import STEP_FACTOR, ResolvedNumerics
from gaitsweep.engine.recorders.recorder import BUFFER, Recorder
from gaitsweep.engine.sweep.lane import ChunkOutput, Lanes, OneLane, RowDrive, Values, host_device
from gaitsweep.engine.sweep.sweep_spec import SweepSpec

CACHE_LINE = 64  # bytes, also the size of the widest vector


@dataclasses.dataclass(frozen=True, eq=False)
class Kernel:
    """The scalar program of a chunk, and the function that opens rows; equal to none but itself.

    `given` are the shapes of a row's parameters and initial conditions.
    """

    chunk: Chunk
    open: Any
    title: str
    lane: OneLane
    given: tuple[Any, Any]


@cached_by_content(maxsize=16)
def kernel_of(model: Model, recorder: Recorder, numerics: ResolvedNumerics, drive: RowDrive | None) -> Kernel:
    """Translate a run to a scalar program.

    Raises:
        UnsupportedError: the model uses an operation that the scalar kernel does not have.
    """
    lane = OneLane(model, recorder, numerics, drive)
    scalar = jax.ShapeDtypeStruct((), jnp.dtype(numerics.carried))
    values = {q.name: scalar for q in model.parameters}
    starts = {q.name: scalar for q in model.initial_conditions} | {STEP_FACTOR: scalar}
    chunk = chunk_of(lane, values, starts)
    title = f"{model.name}, {type(recorder).__name__}, {lane.numerics.method}"
    return Kernel(chunk, jax.jit(jax.vmap(partial(_open, lane))), title, lane, (values, starts))


def _open(
    lane: OneLane, values: Mapping[str, Float[Array, " ..."]], starts: Mapping[str, Float[Array, ""]]
) -> tuple[Float[Array, " slots"], Float[Array, " width"], Bool[Array, ""]]:
    held, carry, record, sample, keep = lane.open(values, starts)
    flat = [jnp.ravel(leaf).astype(jnp.float64) for leaf in jax.tree.leaves((held, carry, record))]
    return jnp.concatenate(flat), sample, keep


class KernelLanes(Lanes):
    """The trajectories of a sweep that one device runs at a time."""

    # rows opened in one call: constant, since the last bits of XLA depend on it
    batch: ClassVar[int] = 64

    def __init__(self, spec: SweepSpec) -> None:
        self.size = spec.lanes
        self.at_a_time = self.size  # lanes that run at a time, the others wait
        self.kernel = kernel_of(spec.model, spec.recorder, spec.numerics, spec.drive)
        self.chunk = self.kernel.chunk
        self._dtype = np.dtype(spec.numerics.carried)
        record, carry = self.chunk.record, self.chunk.carry
        # slots that the host reads after each chunk
        counts = {"filled": record.filled, "samples": record.samples}
        self.seen: dict[str, Leaf] = {**record.results(carry), **counts}

    @abc.abstractmethod
    def put(
        self,
        lanes: Int[np.ndarray, " opened"],
        opened: Float[np.ndarray, "opened slots"],
        samples: Float[np.ndarray, "opened width"],
        kept: Bool[np.ndarray, " opened"],
    ) -> None:
        """Write `opened` (n, slots) to `lanes` (n,), `samples` (n, width) to buffers where `kept` (n,)."""

    def open_rows(self, params: Values, starts: Values, fresh: Bool[np.ndarray, " lanes"]) -> None:
        """Open the rows in the lanes marked `fresh`, and `put` them there; values are (size,) each."""
        lanes = np.flatnonzero(fresh)
        for first in range(0, lanes.size, self.batch):
            some = lanes[first : first + self.batch]
            # the last batch is filled up, since the last bits of XLA depend on the batch size
            rows = np.concatenate([some, np.repeat(some[:1], self.batch - some.size)])
            given = [
                {name: np.asarray(column[rows], self._dtype) for name, column in values.items()}
                for values in (params, starts)
            ]
            with jax.default_device(host_device()):
                opened, samples, keep = jax.device_get(self.kernel.open(*given))
            n = some.size
            self.put(some, opened[:n], samples[:n], keep[:n])

    def output(self, read_slot: Callable[[int], Real[np.ndarray, " lanes"]]) -> ChunkOutput:
        """The output of a chunk without its buffers; `read_slot` returns the values (size,) of a slot."""

        def read(leaf: Leaf) -> Real[np.ndarray, "lanes ..."]:
            columns = [read_slot(leaf.first + i) for i in range(leaf.size)] or [np.zeros((self.size, 0))]
            return np.stack(columns, axis=-1).reshape(self.size, *leaf.shape)

        numbers = {name: read(leaf) for name, leaf in self.seen.items()}
        filled, samples = (numbers.pop(name).astype(np.int32) for name in ("filled", "samples"))
        return ChunkOutput(numbers, filled, samples, np.zeros((self.size, 0, self.chunk.width)))


def _aligned(shape: tuple[int, ...]) -> Float[np.ndarray, " ..."]:
    """Zeros aligned to cache lines, so that no vector crosses two of them."""
    size = math.prod(shape)
    room = np.zeros(size + CACHE_LINE // 8)
    first = -room.ctypes.data % CACHE_LINE // 8
    return room[first : first + size].reshape(shape)


# cached, since its source is printed for each core, and for each sweep of a self-check, else
@lru_cache(maxsize=16)
def _compiled(kernel: Kernel, contraction: bool) -> tuple[Callable[[Any, Any, int], None], int]:
    """The kernel on a CPU, and the slots of its lanes."""
    from gaitsweep.engine.kernel import cpu_program

    return cpu_program.compiled(kernel.chunk, kernel.title, contraction=contraction)


@final
class CpuLanes(KernelLanes):
    """Lanes on one core, in tiles that fill vector registers; each core has its own lanes."""

    def __init__(self, spec: SweepSpec) -> None:
        super().__init__(spec)
        from gaitsweep.engine.kernel import cpu_program

        self._run, slots = _compiled(self.kernel, spec.numerics.contraction)
        self._tile = cpu_program.TILE
        tiles = -(-self.size // self._tile)
        self._slots = _aligned((tiles, slots, self._tile))
        self._slots[:, self.chunk.record.status.first] = Status.complete
        self._kept = np.zeros((tiles * self._tile, BUFFER if self.chunk.width else 0, self.chunk.width))

    def fill(self, params: Values, starts: Values, fresh: Bool[np.ndarray, " lanes"]) -> None:
        self.open_rows(params, starts, fresh)

    def put(
        self,
        lanes: Int[np.ndarray, " opened"],
        opened: Float[np.ndarray, "opened slots"],
        samples: Float[np.ndarray, "opened width"],
        kept: Bool[np.ndarray, " opened"],
    ) -> None:
        tile, lane = np.divmod(lanes, self._tile)
        self._slots[tile, : opened.shape[1], lane] = opened
        if self.chunk.width:
            self._kept[lanes[kept], 0] = samples[kept]

    def run_chunk(self, polls: int) -> ChunkOutput:
        """Advance all running lanes by up to `polls * POLL_INTERVAL` attempts."""
        tiles = self._slots.shape[0]
        self._run(self._slots.reshape(tiles, -1), self._kept, polls)
        output = self.output(lambda slot: self._slots[:, slot].ravel()[: self.size])
        self._slots[:, self.chunk.record.filled.first] = 0.0
        return output._replace(kept=self._kept[: self.size])
