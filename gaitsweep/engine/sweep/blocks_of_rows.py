"""Blocks of rows: how many rows one has, its rows while they run, and their labels."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from typing import Any, Literal, NamedTuple

import numpy as np
from jaxtyping import Array, Bool, Float, Int, Num, Real

from gaitsweep.contract import Model, names_gait
from gaitsweep.engine.carry import Number, Observed
from gaitsweep.engine.content import cached_by_content
from gaitsweep.engine.kernel.row_functions import over_rows
from gaitsweep.engine.numerics import STEP_FACTOR
from gaitsweep.engine.recorders.orbit_period import from_first_crossing, with_orbits
from gaitsweep.engine.recorders.recorder import Readings
from gaitsweep.engine.sweep.lane import ChunkOutput, RowDrive, Values
from gaitsweep.engine.sweep.sweep_spec import SweepSpec
from gaitsweep.row_outcome import RowOutcome

# Each block takes some milliseconds, however few its rows, which add up on a GPU. But an unfinished block of
# more than _LARGE_BLOCK rows takes much memory, and a worker of a cluster loses it as a whole. A table in
# memory is lost as a whole anyway, so it has fewer blocks.
_SMALL_BLOCK = 1024
_LARGE_BLOCK = 32_768
_LARGE_IN_MEMORY = 262_144
_USUAL_BLOCKS = 64
_USUAL_IN_MEMORY = 8
_MAX_BLOCKS = 500


def rows_of_a_block(block: int | Literal["auto"], n_rows: int, *, in_memory: bool = False) -> int:
    """Return the number of rows of a block: the chosen one, or 1024 times a power of two.

    A table has about 64 blocks, or more (up to 500) to keep each block within 32 768 rows. One in memory,
    where an interrupt loses all blocks anyway, has about 8, or more to keep each within 262 144 rows.

    Args:
        block: the chosen number, or "auto".
        n_rows: the number of rows of the table.
        in_memory: whether the table is in memory.
    """
    if block != "auto":
        return block
    usual, large = (_USUAL_IN_MEMORY, _LARGE_IN_MEMORY) if in_memory else (_USUAL_BLOCKS, _LARGE_BLOCK)
    least = max(min(n_rows / usual, large), n_rows / _MAX_BLOCKS, _SMALL_BLOCK)
    return _SMALL_BLOCK * 2 ** math.ceil(math.log2(least / _SMALL_BLOCK))


# Places in an array: their numbers (n,), or the slice that they are.
Places = Int[np.ndarray, " places"] | slice


def as_slice(places: Int[np.ndarray, " places"]) -> Places:
    """The slice of places (n,) that rise evenly, with which arrays are copied faster; else the places."""
    if not places.size:
        return slice(0, 0, 1)
    step = int(places[1] - places[0]) if places.size > 1 else 1
    first, last = int(places[0]), int(places[-1])
    if step < 1 or last - first != step * (places.size - 1) or np.any(places[1:] - places[:-1] != step):
        return places
    return slice(first, last + 1, step)


class BlockPart(NamedTuple):
    """New samples of rows of a block, and the numbers of rows that have ended.

    Attributes:
        number: the number of the block.
        owner: the row (m,) of each sample in the block.
        samples: the samples (m, width).
        ended: the number n of ended rows.
        rows: their places in the block.
        numbers: their numbers by name, (n, ...) each.
    """

    number: int
    owner: Int[np.ndarray, " records"]
    samples: Float[np.ndarray, "records width"]
    ended: int
    rows: Places
    numbers: dict[str, Num[np.ndarray, "ended ..."]]

    @classmethod
    def of(
        cls,
        number: int,
        output: ChunkOutput,
        lanes: Places,
        rows: Places,
        ended: Bool[np.ndarray, " changed"] | None = None,
    ) -> BlockPart:
        """The part of a chunk's output that belongs to a block; later chunks change no declared number of it.

        Args:
            number: the number of the block.
            output: the output of the chunk.
            lanes: lanes of this block (n,).
            rows: their rows (n,).
            ended: mask (n,) of the rows that have ended; by default all have.
        """
        filled = output.filled[lanes]
        least, most = (int(filled.min()), int(filled.max())) if filled.size else (0, 0)
        owner, samples = np.zeros(0, np.int64), np.zeros((0, output.buffers.shape[2]))
        if most > 1:
            place = np.arange(filled.sum()) - np.repeat(np.cumsum(filled) - filled, filled)
            owner = np.repeat(_numbers(rows), filled)
            samples = output.buffers[np.repeat(_numbers(lanes), filled), place]
        elif most > least:
            sampled = filled == 1
            owner = _numbers(rows)[sampled]
            samples = output.buffers[_numbers(lanes)[sampled], 0]
        elif most:
            owner, samples = _numbers(rows), np.array(output.buffers[lanes, 0])
        if ended is not None:
            lanes, rows = as_slice(_numbers(lanes)[ended]), as_slice(_numbers(rows)[ended])
        numbers = with_orbits({name: values[lanes] for name, values in output.numbers.items()})
        return cls(number, owner, samples, numbers["status"].size, rows, numbers)


def _numbers(places: Places) -> Int[np.ndarray, " places"]:
    """The numbers of places (n,)."""
    return np.arange(places.start, places.stop, places.step) if isinstance(places, slice) else places


class Block:
    """The rows of one block while they run.

    Outside the command line a KeyboardInterrupt may be raised between any two statements. So a row's values
    are set before its `ended`, and `_samples` is replaced as a pair: a row is always complete or absent.
    `waiting` are the rows that have to be run, of which the first `opened` have a lane already.

    Args:
        spec: the sweep.
        number: the number of the block.
        restored: rows of the block that an earlier run has ended.
    """

    def __init__(self, spec: SweepSpec, number: int, restored: RowOutcome | None = None) -> None:
        self.number = number
        self.first = number * spec.block
        self.rows = min(spec.block, spec.n_rows - self.first)
        params, starts = spec.values(self.first, self.first + self.rows)
        # the initial conditions of a row may have a factor of its own
        self.starts = {STEP_FACTOR: np.full(self.rows, spec.numerics.factor), **starts}
        self.params = spec.model.on_host(params)
        self.opened = 0
        recorder = spec.recorder
        self.ends = RowOutcome.empty(
            self.first + np.arange(self.rows), recorder.numbers, len(spec.model.observables), recorder.width
        )
        self.ended = np.zeros(self.rows, bool)
        self.stored = np.zeros(self.rows, bool)  # ended and on disk, in a part or in a file of open rows
        # the samples of stored rows, then those of all other rows
        self._samples: tuple[list[_Samples], list[_Samples]] = ([], [])
        if restored is not None:
            places = restored.row - self.first
            self.ends.put(places, restored.numbers)
            if len(restored.samples):
                self._samples[0].append((np.repeat(places, restored.record_counts), restored.samples))
            self.ended[places] = self.stored[places] = True
        self.waiting = np.flatnonzero(~self.ended)
        self._ended_count = self._stored_count = self.rows - self.waiting.size

    @property
    def missing(self) -> int:
        """The number of rows that have not ended."""
        return self.rows - self._ended_count

    @property
    def has_unstored_rows(self) -> bool:
        """Whether rows have ended that are not on disk."""
        return self._ended_count > self._stored_count

    def add(self, part: BlockPart) -> None:
        """Append the new samples of rows, and store the final values of those that have ended."""
        if part.owner.size:
            self._samples[1].append((part.owner, part.samples))
        if part.ended:
            self.ends.put(part.rows, part.numbers)
            self.ended[part.rows] = True
            self._ended_count += part.ended

    def unstored(self) -> RowOutcome:
        """The rows that have ended but are not on disk."""
        return self._with(self._samples[1]).take(np.flatnonzero(self.ended & ~self.stored))

    def mark_stored(self, rows: Int[np.ndarray, " stored"]) -> None:
        """Mark rows (n,), by their numbers in the table, as stored on disk."""
        stored = self.stored.copy()
        stored[rows - self.first] = True
        width = self.ends.samples.shape[1]
        owner, samples = _in_order(self._samples[1], width)
        done = stored[owner]
        stored_samples = [*self._samples[0], (owner[done], samples[done])]
        self.stored = stored  # first, since the samples of a row that is not stored are in the second list
        self._samples = stored_samples, [(owner[~done], samples[~done])]
        self._stored_count = int(np.count_nonzero(stored))

    def result(self) -> RowOutcome:
        """All rows with all of their samples."""
        return self._with([*self._samples[0], *self._samples[1]])

    def _with(self, parts: Sequence[_Samples]) -> RowOutcome:
        """The rows with some of their samples."""
        owner, samples = _in_order(parts, self.ends.samples.shape[1])
        counts = np.bincount(owner, minlength=self.rows)
        return dataclasses.replace(self.ends, record_counts=counts, samples=samples)


# The rows (n,) of samples (n, width) in their block, and the samples.
_Samples = tuple[Int[np.ndarray, " _records"], Float[np.ndarray, "_records _width"]]


def _in_order(parts: Sequence[_Samples], width: int) -> _Samples:
    """Samples in the order of their rows; the samples of one row keep their order."""
    filled = [part for part in parts if part[0].size]  # an empty part has no dtype
    if not filled:
        return np.zeros(0, np.int64), np.zeros((0, width))
    owners, samples = zip(*filled, strict=True)
    owner, sample = (
        arrays[0] if len(arrays) == 1 else np.concatenate(arrays) for arrays in (owners, samples)
    )
    if np.all(owner[:-1] <= owner[1:]):
        return owner, sample
    order = np.argsort(owner, kind="stable")
    return owner[order], sample[order]


# The code of a gait that was not read.
NOT_READ = -1


def labelled(spec: SweepSpec, block: Block) -> RowOutcome:
    """The rows of a block with their labels, of each row or sample; `gait` is a code of `gait_codes`.

    Args:
        spec: the sweep.
        block: the block; without readings of its recorder, its rows are not labelled.
    """
    rows = from_first_crossing(spec.model.observables, block.result())
    readings = spec.recorder.readings(rows)
    if readings is None:
        return rows
    # a power of two, so that sweeps with other numbers of rows compile few sizes
    width = readings.batch or min(spec.block, 1 << (spec.n_rows - 1).bit_length())
    labels = {}
    for name, values in _read_labels(spec, block.params, readings, width).items():
        if names_gait(name):
            labels[name] = np.where(readings.readable, gait_codes(values), NOT_READ).astype(np.int32)
        else:
            missing = 0 if np.issubdtype(values.dtype, np.integer) else np.nan
            labels[name] = np.where(readings.readable, values, missing)
    earlier = readings.earlier
    if earlier is not None:
        before = _read_labels(spec, block.params, earlier, width)["gait"]
        labels["gait_before"] = np.where(earlier.readable, gait_codes(before), NOT_READ).astype(np.int32)
    if readings.batch is None:
        return dataclasses.replace(rows, labels=labels)
    return dataclasses.replace(rows, sample_labels=labels)


def _read_labels(
    spec: SweepSpec, params: Values, readings: Readings, width: int
) -> dict[str, Real[np.ndarray, " readings"]]:
    """The results of the model's `label` by name, computed for `width` readings at a time."""
    label = _label(spec.model, spec.drive)
    values = {name: np.asarray(column, np.float64) for name, column in params.items()}
    batches = []
    for first in range(0, max(readings.rows.size, 1), width):
        part = slice(first, first + width)
        rows, times = readings.rows[part], np.asarray(readings.t[part], np.float64)
        count = rows.size
        observed = np.zeros((readings.observed.shape[1], count)).T
        np.copyto(observed, readings.observed[part], where=readings.readable[part, None])
        # filled up with the first row, so that the size of batches is constant
        rows, times, observed = (_filled_up(column, width) for column in (rows, times, observed))
        of_rows = as_slice(rows)
        labels = label({name: column[of_rows] for name, column in values.items()}, times, observed)
        batches.append({name: np.asarray(column)[:count] for name, column in labels.items()})
    if len(batches) == 1:
        return batches[0]
    return {name: np.concatenate([batch[name] for batch in batches]) for name in batches[0]}


def _filled_up(column: Real[np.ndarray, "rows ..."], width: int) -> Real[np.ndarray, "width ..."]:
    """A column with zeros after its rows."""
    lacking = width - len(column)
    return (
        np.concatenate([column, np.zeros((lacking, *column.shape[1:]), column.dtype)]) if lacking else column
    )


def gait_codes(labels: Real[np.ndarray, " *readings"]) -> Int[np.ndarray, " *readings"]:
    """The codes of gaits from the results of `label`: an index is its own code, a number -n becomes -1 - n.

    So `NOT_READ` is no gait's code, and a label that is not an index of a gait is recognisable.
    """
    labels = np.clip(np.asarray(labels, np.int64), -(2**31) + 1, 2**31 - 1)
    return labels - (labels < 0)


@cached_by_content(maxsize=16)
def _label(model: Model, drive: RowDrive | None) -> Callable[..., dict[str, np.ndarray]]:
    """The function `(values, t, observed) -> labels` of many readings."""
    names = [q.name for q in model.observables]

    def label(values: Any, t: Number, observed: Observed) -> dict[str, Real[Array, ""]]:
        params = model.params(values) if drive is None else drive(values, t)
        return model.label(params, {name: observed[i] for i, name in enumerate(names)})

    return over_rows(label, "label", model if drive is None else None, all_rows=True)
