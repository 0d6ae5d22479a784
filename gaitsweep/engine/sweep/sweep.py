"""The main loop of a sweep: all rows of a job, block by block."""

from __future__ import annotations

import contextlib
import dataclasses
import time
from collections.abc import Callable, Sequence
from typing import Any

from gaitsweep.engine.sweep.block_writer import BlockWriter
from gaitsweep.engine.sweep.labels import labelled
from gaitsweep.engine.sweep.lane_scheduler import LaneScheduler
from gaitsweep.engine.sweep.open_rows import OpenRows, OpenRowsKeeper
from gaitsweep.engine.sweep.sweep_spec import SweepProgress, SweepSpec
from gaitsweep.errors import UserError
from gaitsweep.row_outcome import RowOutcome


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
    scheduler.open_first_rows()
    if scheduler.busy:
        # compiled before any row ends, since ended rows would wait for it
        labelled(spec, next(iter(scheduler.open.values())))
    timings.compile_s = time.perf_counter() - began
    scheduler.start()
    writer = BlockWriter(spec, encode, write, written=scheduler.close)
    keeper = OpenRowsKeeper(scheduler, open_rows, writer)
    try:
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
        with contextlib.suppress(UserError):
            writer.end()
        with contextlib.suppress(UserError):
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
