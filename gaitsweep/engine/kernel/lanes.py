"""The lanes of a scalar kernel, as of all devices and of a CPU, and the opening of rows in them."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Mapping
from functools import cached_property, lru_cache, partial
from typing import Any, NamedTuple, TypeAlias, final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, Real

from gaitsweep.contract import Model, Params, State
from gaitsweep.engine.content import cached_by_content
from gaitsweep.engine.devices import host_device
from gaitsweep.engine.kernel import cpu_program
from gaitsweep.engine.kernel.chunk import Chunk, Leaf, chunk_of
from gaitsweep.engine.kernel.row_functions import UNOPTIMISED, over_rows
from gaitsweep.engine.kernel.trace import TracedFunction, UnsupportedError, traced_function
from gaitsweep.engine.numerics import STEP_FACTOR, ResolvedNumerics
from gaitsweep.engine.recorders.recorder import BUFFER, Recorder
from gaitsweep.engine.stored_traces import stored
from gaitsweep.engine.sweep.blocks_of_rows import as_slice
from gaitsweep.engine.sweep.lane import ChunkOutput, Lanes, OneLane, Opened, RowDrive, Values, started_row
from gaitsweep.engine.sweep.sweep_spec import SweepSpec
from gaitsweep.row_outcome import ENGINE_NUMBERS
from gaitsweep.status import Status

# Operations beyond which the host opens rows for a card too: NVRTC takes 5 s to compile 4 000 operations and
# 26 s for the 14 000 of the chain of ten legs, LLVM 4 and 10 s.
_LONG_OPENING = 5000
# Rows that XLA opens in one call: constant, since its last bits depend on it.
_BATCH = 64

Columns = Mapping[str, Float[np.ndarray, " rows"]]


class OpenedRows(NamedTuple):
    """Opened rows (n,): their slots, the first sample of each, and whether to keep that sample."""

    slots: Float[np.ndarray, "rows slots"]
    samples: Float[np.ndarray, "rows width"]
    keeps: Bool[np.ndarray, " rows"]


def _opening_of_one(open_row: Callable[..., Opened]) -> Callable[..., tuple[Array, Array, Array]]:
    """The function of one row that gives the numbers of `OpenedRows`, with the slots in one vector."""

    def of_one(*row: Any) -> tuple[Array, Array, Array]:
        constants, carry, record, sample, keep = open_row(*row)
        flat = [jnp.ravel(leaf).astype(jnp.float64) for leaf in jax.tree.leaves((constants, carry, record))]
        return jnp.concatenate(flat), sample.astype(jnp.float64), keep

    return of_one


def opened_by_kernel(lane: OneLane) -> Callable[[Columns, Columns], OpenedRows]:
    """The function `(values, starts) -> OpenedRows` of rows; XLA computes what no kernel has.

    Args:
        lane: the engine's functions of one trajectory.
    """
    deciding = lane.recorder, lane.numerics, lane.drive
    of_rows = over_rows(
        _opening_of_one(lane.open),
        "opening",
        lane.model,
        *deciding,
        all_rows=True,
        simplify=True,
        by_xla=lambda: opened_by_xla(lane),
    )
    return lambda values, starts: OpenedRows(*of_rows(dict(values), dict(starts)))


def opened_by_xla(lane: OneLane) -> Callable[[Columns, Columns], OpenedRows]:
    """As `opened_by_kernel`, of a model with operations that the scalar kernel does not have."""
    started = _started_by_xla(lane.model, lane.numerics.dtype, lane.drive)
    compiled = jax.jit(jax.vmap(_opening_of_one(lane.open_at)))
    of_rows = _in_batches(lambda *rows: compiled(*rows, *started(*rows)))
    return lambda values, starts: OpenedRows(*of_rows(values, starts))


def over_started_rows(
    function: Callable[[Params, State], Any], name: str, model: Model, dtype: str, drive: RowDrive | None
) -> Callable[[Columns, Columns], Any]:
    """The function `(values, starts)` of rows that gives `function(params, state)` at their starts.

    Where XLA computes it, it shares the program that starts the rows of a run.

    Args:
        function: a JAX function of one row.
        name: as of `over_rows`.
        model, dtype, drive: as of `started_row`.
    """

    def of_one(values: Any, starts: Any) -> Any:
        return function(*started_row(model, dtype, drive, values, starts))

    def by_xla() -> Callable[[Columns, Columns], Any]:
        started = _started_by_xla(model, dtype, drive)
        compiled = jax.jit(jax.vmap(function), compiler_options=UNOPTIMISED)

        def of_batch(values: Columns, starts: Columns) -> Any:
            rows = {name: column.astype(dtype) for name, column in values.items()}
            own = {name: column.astype(dtype) for name, column in starts.items()}
            # lanes start their rows with it
            return compiled(*started(rows, {STEP_FACTOR: np.ones(_BATCH, dtype), **own}))

        return _in_batches(of_batch)

    return over_rows(of_one, name, model, dtype, drive, by_xla=by_xla)


def _in_batches(of_batch: Callable[[Columns, Columns], Any]) -> Callable[[Columns, Columns], Any]:
    """The function of rows, from a JAX function of `_BATCH` rows."""

    def of_rows(values: Columns, starts: Columns) -> Any:
        rows = len(next(iter(values.values())))
        parts = []
        for first in range(0, max(rows, 1), _BATCH):
            with jax.default_device(host_device()):
                columns = jax.tree.map(partial(_batch, first=first), (dict(values), dict(starts)))
                parts.append(jax.device_get(of_batch(*columns)))
        return jax.tree.map(lambda *arrays: np.concatenate(arrays)[:rows], *parts)

    return of_rows


def _batch(column: Real[np.ndarray, "rows ..."], *, first: int) -> Real[np.ndarray, "batch ..."]:
    """The rows of a column from `first` on; the last ones are repeated, and none is filled up with zeros."""
    return np.resize(column[first : first + _BATCH], (_BATCH, *column.shape[1:]))


# one program for all recorders: the rest of a body on the ground compiles for longer than all the others
@cached_by_content(maxsize=16)
def _started_by_xla(model: Model, dtype: str, drive: RowDrive | None) -> Callable[..., Any]:
    """The function of a batch of rows that gives the results of `started_row`."""
    return jax.jit(jax.vmap(partial(started_row, model, dtype, drive)))


CACHE_LINE = 64  # bytes, also the size of the widest vector

Shapes: TypeAlias = "Mapping[str, jax.ShapeDtypeStruct]"


class Kernel:
    """The scalar program of a run, and the function that opens rows; equal only to itself.

    `chunk` is the program of the trajectory `lane`, traced when it is first read; `title` names the run in
    the printed source. `names` are those of a row's parameters and of its initial conditions, in the order of
    JAX's trees, and `shapes` their shapes. `leaves` are the numbers that the host reads after each chunk,
    `width` is that of a sample.
    """

    def __init__(
        self, model: Model, recorder: Recorder, numerics: ResolvedNumerics, drive: RowDrive | None
    ) -> None:
        self.lane = OneLane(model, recorder, numerics, drive)
        starts = [STEP_FACTOR, *(q.name for q in model.initial_conditions)]
        self.names = sorted(q.name for q in model.parameters), sorted(starts)
        self.title = f"{model.name}, {type(recorder).__name__}, {numerics.method}"
        leaves, self.width = self.stored("leaves", self._read_leaves)
        self.leaves = {name: Leaf(first, tuple(shape)) for name, (first, shape) in leaves.items()}
        self.open = opened_by_kernel(self.lane)

    @cached_property
    def shapes(self) -> tuple[Shapes, Shapes]:
        """The shapes of a row's parameters and of its initial conditions."""
        scalar = jax.ShapeDtypeStruct((), jnp.dtype(self.lane.numerics.dtype))
        values, starts = (dict.fromkeys(names, scalar) for names in self.names)
        return values, starts

    @cached_property
    def chunk(self) -> Chunk:
        """The program.

        Raises:
            UnsupportedError: the model uses an operation that the scalar kernel does not have.
        """
        return chunk_of(self.lane, *self.shapes)

    def opening(self) -> tuple[TracedFunction, bool]:
        """The function that opens a row of `shapes`, and true.

        If the scalar kernel lacks an operation of it, or it is long: a function that returns its arguments,
        the numbers of `OpenedRows`, and false.
        """
        of_one = _opening_of_one(self.lane.open)
        with contextlib.suppress(UnsupportedError):
            opening = traced_function(of_one, self.shapes)
            if len(opening.program.needed(opening.outputs)) <= _LONG_OPENING:
                return opening, True
        return traced_function(lambda *opened: opened, jax.eval_shape(of_one, *self.shapes)), False

    def stored(self, name: str, compute: Callable[[], Any], *others: Any) -> Any:
        """As `stored_traces.stored`, for this run."""
        lane = self.lane
        return stored(name, lane.model, (lane.recorder, lane.numerics, lane.drive, *others), compute)

    def _read_leaves(self) -> tuple[dict[str, tuple[int, tuple[int, ...]]], int]:
        """The first slot and the shape of each number that the host reads, and the width of a sample."""
        record = self.chunk.record
        carry = self.chunk.carry
        leaves = {**record.results(carry), "filled": record.filled, "samples": record.samples}
        return {name: (leaf.first, leaf.shape) for name, leaf in leaves.items()}, self.chunk.width


@cached_by_content(maxsize=16)
def kernel_of(model: Model, recorder: Recorder, numerics: ResolvedNumerics, drive: RowDrive | None) -> Kernel:
    """Translate a run to a scalar program.

    Args:
        model, recorder, numerics: those of the run.
        drive: the parameters at a time, for a ramp or a staircase.

    Raises:
        UnsupportedError: the model uses an operation that the scalar kernel does not have.
    """
    return Kernel(model, recorder, numerics, drive)


class KernelLanes(Lanes):
    """The lanes of a scalar kernel on one device.

    Args:
        spec: the sweep.
    """

    def __init__(self, spec: SweepSpec) -> None:
        self.size = spec.lanes
        self.at_a_time = spec.lanes
        self.kernel = kernel_of(spec.model, spec.recorder, spec.numerics, spec.drive)
        self._dtype = np.dtype(spec.numerics.dtype)
        self._dtypes = {n.name: np.dtype(n.dtype) for n in (*ENGINE_NUMBERS, *spec.recorder.numbers)}

    def opened(self, params: Values, starts: Values) -> OpenedRows:
        """The opened rows with these parameters and initial conditions, (opened,) each."""
        values = {name: np.asarray(column, self._dtype) for name, column in params.items()}
        initial = {name: np.asarray(column, self._dtype) for name, column in starts.items()}
        return self.kernel.open(values, initial)

    def output(self, read_slots: Callable[[slice], Real[np.ndarray, "slots lanes"]]) -> ChunkOutput:
        """The output of a chunk without its buffers; `read_slots` returns the values of successive slots."""

        def read(name: str, leaf: Leaf) -> Real[np.ndarray, "lanes ..."]:
            values = read_slots(slice(leaf.first, leaf.first + leaf.size))
            of_lanes = np.moveaxis(values.reshape(*leaf.shape, self.size), -1, 0)
            dtype = self._dtypes.get(name)
            # copied here, in the thread of the device, since blocks keep these numbers
            return of_lanes if dtype is None else np.array(of_lanes, dtype)

        numbers = {name: read(name, leaf) for name, leaf in self.kernel.leaves.items()}
        filled = numbers.pop("filled").astype(np.int32)
        samples = numbers.pop("samples").astype(np.int32)
        return ChunkOutput(numbers, filled, samples, np.zeros((self.size, 0, self.kernel.width)))


def _aligned(shape: tuple[int, ...]) -> Float[np.ndarray, " ..."]:
    """Zeros aligned to cache lines, so that no vector crosses two of them."""
    size = math.prod(shape)
    room = np.zeros(size + CACHE_LINE // 8)
    first = -room.ctypes.data % CACHE_LINE // 8
    return room[first : first + size].reshape(shape)


# cached, since each core and each sweep of a self-check would print the source again
@lru_cache(maxsize=16)
def _compiled(
    kernel: Kernel, *, contraction: bool, quick: bool
) -> tuple[Callable[[Any, Any, int], None], int]:
    """The kernel on a CPU, and the slots of its lanes."""
    return cpu_program.compiled(lambda: kernel.chunk, kernel.stored, contraction=contraction, quick=quick)


@final
class CpuLanes(KernelLanes):
    """Lanes on one core, in tiles that fill vector registers; each core has its own lanes."""

    def __init__(self, spec: SweepSpec) -> None:
        super().__init__(spec)
        self._run, slots = _compiled(self.kernel, contraction=spec.numerics.contraction, quick=spec.quick)
        tiles = -(-self.size // cpu_program.TILE)
        self._slots = _aligned((tiles, slots, cpu_program.TILE))
        leaves = self.kernel.leaves
        width = self.kernel.width
        self._filled = leaves["filled"].first
        self._slots[:, leaves["status"].first] = Status.complete
        self._buffers = np.zeros((tiles * cpu_program.TILE, BUFFER if width else 0, width))

    def fill(self, params: Values, starts: Values, lanes: Int[np.ndarray, " opened"]) -> None:
        opened = self.opened(params, starts)
        tiles, used, size = len(self._slots), opened.slots.shape[1], cpu_program.TILE
        # all of them in order, which a copy takes less time for than a selection
        if lanes.size == tiles * size and as_slice(lanes) == slice(0, lanes.size, 1):
            self._slots[:, :used] = opened.slots.reshape(tiles, size, used).transpose(0, 2, 1)
        else:
            tile, lane = np.divmod(lanes, size)
            self._slots[tile, :used, lane] = opened.slots
        if self.kernel.width:
            self._buffers[lanes[opened.keeps], 0] = opened.samples[opened.keeps]

    def run_chunk(self, polls: int) -> ChunkOutput:
        tiles = self._slots.shape[0]
        self._run(self._slots.reshape(tiles, -1), self._buffers, polls)
        slots = self._slots.transpose(1, 0, 2)

        def read(successive: slice) -> Real[np.ndarray, "slots lanes"]:
            # the count of lanes is given, since a model without events has leaves without slots
            count = successive.stop - successive.start
            return slots[successive].reshape(count, tiles * cpu_program.TILE)[:, : self.size]

        output = self.output(read)
        self._slots[:, self._filled] = 0.0
        return output._replace(buffers=self._buffers[: self.size])
