"""The main loop of a sweep: all rows of a job, block by block."""

from __future__ import annotations

import contextlib
import dataclasses
import time
from collections.abc import Callable, Sequence
from typing import Protocol

import numpy as np

from gaitsweep.engine.sweep.block import BlockResult, EndedRows
from gaitsweep.engine.sweep.labels import labels_of
from gaitsweep.engine.sweep.lane_scheduler import LaneScheduler
from gaitsweep.engine.sweep.sweep_spec import SweepProgress, SweepSpec
from gaitsweep.errors import UserError

# An ended row is stored on disk within this time (s); a kill loses only rows that ended later.
SAFE_WITHIN = 5.0
# Reserve within that time (s), for steps that take longer than they did before.
_SPARE = 1.0


@dataclasses.dataclass
class Timings:
    """Seconds of compiling (the first call of each program) and of running, and the number of attempts."""

    compile_s: float = 0.0
    run_s: float = 0.0
    attempts: int = 0


class OpenRows(Protocol):
    """Storage for ended rows of incomplete blocks: a result directory."""

    def restored(self, number: int) -> EndedRows | None:
        """The rows of a block that an earlier run stored, or None."""

    def keep(self, rows: EndedRows) -> None:
        """Store rows; they are safe when this returns."""


def sweep(
    spec: SweepSpec,
    blocks: Sequence[int],
    write: Callable[[int, BlockResult], None],
    progress: Callable[[SweepProgress], None] | None = None,
    timings: Timings | None = None,
    open_rows: OpenRows | None = None,
) -> Timings:
    """Run the rows of `blocks`, and pass each block to `write(number, result)` when all its rows have ended.

    Args:
        spec: the sweep.
        blocks: the numbers of the blocks to run.
        write: called with each complete block.
        progress: called after each chunk; an exception that it raises stops the sweep.
        timings: updated during the sweep, so that it is right for an interrupted sweep too.
        open_rows: stores the ended rows of incomplete blocks within `SAFE_WITHIN` s, and also when an
            exception stops the sweep; rows that it already has are not run again.

    Returns:
        The timings.
    """
    timings = Timings() if timings is None else timings
    began = time.perf_counter()
    scheduler = LaneScheduler(spec, blocks, None if open_rows is None else open_rows.restored)
    scheduler.refill()
    if scheduler.busy:
        scheduler.collect(scheduler.chunk(0))
        # compiled before any row ends, since ended rows would wait for it
        labels_of(spec, next(iter(scheduler.open.values())))
    timings.compile_s = time.perf_counter() - began
    keeper = _Keeper(scheduler, open_rows)
    try:
        while scheduler.busy or scheduler.complete:
            chunk_began = time.perf_counter()
            if scheduler.busy:
                scheduler.collect(scheduler.chunk())
            keeper.chunk_ended(chunk_began)
            for number in list(scheduler.complete):
                keeper.store_if_due(keeper.close_s)
                close_began = time.perf_counter()
                block = scheduler.open[number]
                write(number, block.result(labels_of(spec, block)))
                scheduler.close(number)
                keeper.close_s = time.perf_counter() - close_began
            keeper.store_if_due(keeper.chunk_s)
            timings.attempts = scheduler.attempts
            timings.run_s = time.perf_counter() - began - timings.compile_s
            if progress is not None:
                progress(scheduler.progress(timings.run_s))
            scheduler.refill()
    except BaseException:
        # the first exception is reported, not a failure to store rows that follows from it
        with contextlib.suppress(UserError):
            keeper.store()
        raise
    return timings


class _Keeper:
    """Stores ended rows of open blocks before the oldest of them has waited `SAFE_WITHIN` s."""

    def __init__(self, scheduler: LaneScheduler, open_rows: OpenRows | None) -> None:
        self._scheduler, self._open_rows = scheduler, open_rows
        self.chunk_s = 0.0
        self.close_s = 1.0  # s of writing a part; the first time it loads libraries
        self._store_s = 0.1
        self._oldest: float | None = None  # begin of the chunk in which the oldest unstored row ended

    def chunk_ended(self, began: float) -> None:
        """Record that the chunk that began at `began` (s) has been collected."""
        self.chunk_s = time.perf_counter() - began
        if self._oldest is None and self._open_rows is not None and self._scheduler.unstored:
            self._oldest = began

    def store_if_due(self, ahead: float) -> None:
        """Store the rows if the oldest would wait too long after the next `ahead` s."""
        if self._oldest is None:
            return
        if not self._scheduler.unstored:  # their parts have been written
            self._oldest = None
            return
        age = time.perf_counter() - self._oldest
        if age + ahead + self._store_s > SAFE_WITHIN - _SPARE:
            began = time.perf_counter()
            self.store()
            self._store_s = time.perf_counter() - began

    def store(self) -> None:
        """Store all ended rows of open blocks that are not on disk."""
        if self._open_rows is None:
            return
        ended = self._scheduler.ended()
        if ended:
            self._open_rows.keep({name: _joined([rows[name] for rows in ended]) for name in ended[0]})
            self._scheduler.mark_stored(ended)
        self._oldest = None


def _joined(parts: list[np.ndarray]) -> np.ndarray:
    # empty arrays have no dtype
    return np.concatenate([part for part in parts if len(part)] or parts)
