"""The main loop of a sweep: all rows of a job, block by block.

Complete blocks are written while other rows run, and the ended rows of other blocks are stored, so that a
killed run loses few of them.
"""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import sys
import time
from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextvars import copy_context
from typing import Any, Protocol

from gaitsweep.engine.sweep.blocks_of_rows import Block, labelled
from gaitsweep.engine.sweep.lane_scheduler import LaneScheduler
from gaitsweep.engine.sweep.sweep_spec import SweepProgress, SweepSpec
from gaitsweep.row_outcome import RowOutcome


class BlockWriter:
    """A thread that writes blocks one after the other while rows continue, and threads that encode them.

    Args:
        spec: the sweep.
        encode: as of `sweep`.
        write: as of `sweep`.
        written: called with the number of each written block, by the waiting thread.
    """

    # Blocks that may wait, for each GPU.
    MAX_WAITING = 8
    # Threads that label and encode, for each GPU, since that takes as long as the rows do on a GPU.
    ENCODING = 3

    def __init__(
        self,
        spec: SweepSpec,
        encode: Callable[[int, RowOutcome], Any] | None,
        write: Callable[[int, Any], None],
        written: Callable[[int], None],
    ) -> None:
        gpus = len(spec.devices) if spec.devices[0].platform == "gpu" else 1
        self._spec = spec
        self._encode = encode
        self._write = write
        self._written = written
        self._thread = ThreadPoolExecutor(1)
        self._most = self.MAX_WAITING * gpus
        self._encoding = ThreadPoolExecutor(self.ENCODING * gpus)
        # writes in progress, each with the function to call when it is on disk
        self._pending: deque[tuple[Future[None], Callable[[], None]]] = deque()
        self._latest_s = 1.0  # s of writing the latest block; the first one loads libraries

    def write(self, block: Block, *, last: bool) -> None:
        """Queue a block for encoding and writing; an error of an earlier block is raised.

        Args:
            block: the block.
            last: whether no row is left that could run meanwhile; the block is then written at once.
        """
        self.take_done(self._most)
        if last and not self._pending:
            self._write(block.number, self._encoded(block))
            self._written(block.number)
            return
        encoded = self._encoding.submit(copy_context().run, self._encoded, block)
        job = self._thread.submit(self._write_timed, block.number, encoded)
        # a block that could not be written stays open, so that its rows are stored
        self._pending.append((job, functools.partial(self._written, block.number)))

    def _encoded(self, block: Block) -> Any:
        """The labelled rows of a block, converted by `encode` if the sweep has one."""
        rows = labelled(self._spec, block)
        return rows if self._encode is None else self._encode(block.number, rows)

    def _write_timed(self, number: int, encoded: Future[Any]) -> None:
        """Write a block when it is encoded, and record the time that it takes."""
        began = time.perf_counter()
        self._write(number, encoded.result())
        self._latest_s = time.perf_counter() - began

    def store(self, keep: Callable[[], None], stored: Callable[[], None]) -> None:
        """Queue a store of rows.

        Args:
            keep: stores the rows, in the writing thread.
            stored: called afterwards, by the waiting thread.
        """
        self._pending.append((self._thread.submit(keep), stored))

    def take_done(self, most: int) -> None:
        """Record finished writes, and wait until fewer than `most` writes are pending."""
        while self._pending and (len(self._pending) >= most or self._pending[0][0].done()):
            self._take()

    def _take(self) -> None:
        """Wait for the first pending write, and record it."""
        future, done = self._pending.popleft()
        future.result()
        done()

    @property
    def ahead_s(self) -> float:
        """The estimated time (s) until one more block would be written."""
        waiting = sum(not future.done() for future, _ in self._pending)
        return (1 + waiting) * self._latest_s

    def end(self) -> None:
        """Finish all pending writes; the error of the first one that failed is raised."""
        failures: list[BaseException] = []
        try:
            while self._pending:
                try:
                    self._take()
                except BaseException as failure:
                    failures.append(failure)
        finally:
            self._thread.shutdown()
            self._encoding.shutdown()
        if failures:
            raise failures[0]


# An ended row is stored on disk within this time (s); a kill loses only rows that ended later.
SAFE_WITHIN = 5.0
# Reserve within that time (s), for steps that take longer than they did before.
_SPARE = 1.0


class OpenRows(Protocol):
    """Storage for ended rows of incomplete blocks: a result directory."""

    def restored(self, number: int) -> RowOutcome | None:
        """The rows of a block that an earlier run stored, or None."""

    def keep(self, rows: RowOutcome) -> None:
        """Store rows; they are safe when this returns."""


class OpenRowsKeeper:
    """Stores ended rows of open blocks before the oldest of them has waited `SAFE_WITHIN` s.

    `chunk_s` is the duration of the latest chunk (s).

    Args:
        scheduler: has the open blocks.
        open_rows: the storage; None: rows of incomplete blocks are not stored.
        writer: the writer of complete blocks, which stores rows as well.
    """

    def __init__(self, scheduler: LaneScheduler, open_rows: OpenRows | None, writer: BlockWriter) -> None:
        self._scheduler = scheduler
        self._open_rows = open_rows
        self._writer = writer
        self.chunk_s = 0.0
        self._store_s = 0.1
        self._storing = False  # at most one store at a time
        # start of the chunk in which the oldest row ended that is neither stored nor being stored
        self._oldest: float | None = None

    def chunk_ended(self, began: float) -> None:
        """Record that the chunk that began at `began` (s) has been collected."""
        self.chunk_s = time.perf_counter() - began
        if self._oldest is None and self._open_rows is not None and self._scheduler.has_unstored_rows:
            self._oldest = began

    def store_if_due(self, ahead: float = 0.0) -> None:
        """Store the rows if the oldest would wait longer than `SAFE_WITHIN`.

        Args:
            ahead: the time until the next call (s).
        """
        self._writer.take_done(sys.maxsize)
        if self._oldest is None or self._storing:
            return
        if not self._scheduler.has_unstored_rows:  # their parts have been written
            self._oldest = None
            return
        age = time.perf_counter() - self._oldest
        if age + ahead + self._writer.ahead_s + self._store_s > SAFE_WITHIN - _SPARE:
            # the rows of blocks that are being written are safe before these
            ended = self._scheduler.unstored_rows(self._scheduler.being_written)
            self._oldest = None
            if ended:
                self._storing = True
                self._writer.store(lambda: self._keep(ended), lambda: self._stored(ended))

    def store(self) -> None:
        """Store all ended rows of open blocks that are not on disk; no other write is pending."""
        ended = self._scheduler.unstored_rows()
        if self._open_rows is not None and ended:
            self._keep(ended)
            self._stored(ended)
        self._oldest = None

    def _stored(self, ended: Sequence[RowOutcome]) -> None:
        """Mark rows as stored."""
        self._scheduler.mark_stored(ended)
        self._storing = False

    def _keep(self, ended: Sequence[RowOutcome]) -> None:
        """Store rows, and record the time that it takes."""
        assert self._open_rows is not None
        began = time.perf_counter()
        self._open_rows.keep(RowOutcome.concat(ended))
        self._store_s = time.perf_counter() - began


@dataclasses.dataclass
class Timings:
    """Seconds of compilation (the first call of each program) and of running, and the number of attempts."""

    compile_s: float = 0.0
    run_s: float = 0.0
    attempts: int = 0


def sweep(
    spec: SweepSpec,
    blocks: Sequence[int],
    write: Callable[[int, Any], None],
    on_progress: Callable[[SweepProgress], None] | None = None,
    timings: Timings | None = None,
    open_rows: OpenRows | None = None,
    encode: Callable[[int, RowOutcome], Any] | None = None,
) -> Timings:
    """Run the rows of blocks, and write each block when all of its rows have ended.

    An exception of `write`, `on_progress`, `open_rows` or `encode` stops the sweep and is raised.

    Args:
        spec: the sweep.
        blocks: the numbers of the blocks to run.
        write: called as `write(number, result)` with each complete block.
        on_progress: called after each chunk.
        timings: updated during the sweep, so that it is also correct for an interrupted sweep.
        open_rows: stores the ended rows of incomplete blocks within 5 s (`SAFE_WITHIN`), and also when an
            exception stops the sweep; rows that it already has are not run again.
        encode: converts a complete block for `write`, in several threads at a time; by default `write`
            receives the block itself.

    Returns:
        The timings.
    """
    timings = Timings() if timings is None else timings
    began = time.perf_counter()
    scheduler = LaneScheduler(spec, blocks, None if open_rows is None else open_rows.restored)
    writer = BlockWriter(spec, encode, write, written=scheduler.close)
    keeper = OpenRowsKeeper(scheduler, open_rows, writer)
    try:
        scheduler.open_first_rows()
        if scheduler.busy:
            # compiled before any row ends, since ended rows would wait for it
            labelled(spec, next(iter(scheduler.open.values())))
        timings.compile_s = time.perf_counter() - began
        scheduler.start()
        while scheduler.busy or scheduler.complete:
            _run_chunk(scheduler, writer, keeper)
            timings.attempts = scheduler.attempts
            timings.run_s = time.perf_counter() - began - timings.compile_s
            if on_progress is not None:
                on_progress(scheduler.progress(timings.run_s))
        writer.end()
        timings.run_s = time.perf_counter() - began - timings.compile_s
    except BaseException:
        # the first exception is reported, not a failure to write or store rows that follows from it
        with contextlib.suppress(Exception):
            writer.end()
        with contextlib.suppress(Exception):
            keeper.store()
        raise
    finally:
        scheduler.shut_down()
    return timings


def _run_chunk(scheduler: LaneScheduler, writer: BlockWriter, keeper: OpenRowsKeeper) -> None:
    """Run a chunk of one group of lanes, write complete blocks, and store the ended rows of others."""
    if scheduler.busy:
        keeper.chunk_ended(scheduler.collect_next())
    for number in list(scheduler.complete):
        keeper.store_if_due()
        writer.write(scheduler.take(number), last=not scheduler.busy)
    keeper.store_if_due(keeper.chunk_s)
