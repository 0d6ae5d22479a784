"""Executors of a run: the blocks of a table, computed by this process or by the workers of a cluster."""

from __future__ import annotations

import abc
import contextlib
import dataclasses
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, TypeVar

import pandas as pd

from gaitsweep.engine.sweep.sweep import OpenRows, Timings, sweep
from gaitsweep.engine.sweep.sweep_spec import SweepProgress
from gaitsweep.kinds.run_kind import TableRunKind
from gaitsweep.runs.prepare import RunContext
from gaitsweep.runs.progress import COMPILING
from gaitsweep.table import ResultDirectory

Part = TypeVar("Part")  # an encoded block


def compute_blocks(
    context: RunContext,
    blocks: Sequence[int],
    encode: Callable[[int, pd.DataFrame], Part],
    write: Callable[[int, Part], None],
    on_progress: Callable[[SweepProgress], None],
    *,
    timings: Timings | None = None,
    open_rows: OpenRows | None = None,
) -> None:
    """Compute blocks in this process, and write each when all its rows have ended.

    Args:
        context: the job's context.
        blocks: the numbers of the blocks.
        encode: converts the records of a block for `write`, in several threads at a time.
        write: called with each block.
        on_progress: progress callback; an exception that it raises stops the run.
        timings: updated during the run.
        open_rows: stores the ended rows of incomplete blocks. It is not used for a `TableRunKind`, whose
            rows of a block end together: a kill loses at most one such block.
    """
    timings = Timings() if timings is None else timings
    if isinstance(kind := context.job.run, TableRunKind):
        for number, frame in _tables_of_kind(kind, context, blocks, on_progress, timings):
            write(number, encode(number, frame))
        return
    sweep(
        context.spec,
        blocks,
        write,
        on_progress,
        timings,
        open_rows,
        lambda number, outcome: encode(number, context.table(outcome)),
    )


def _tables_of_kind(
    kind: TableRunKind,
    context: RunContext,
    blocks: Sequence[int],
    on_progress: Callable[[SweepProgress], None],
    timings: Timings,
) -> Iterator[tuple[int, pd.DataFrame]]:
    """The numbers and the records of blocks whose run kind makes its tables itself."""
    total = context.layout.rows_in(blocks)
    done = 0  # rows
    rows_of_block = 0
    began = time.perf_counter()

    def report(note: str = "", share: float = 0.0) -> None:
        timings.run_s = time.perf_counter() - began
        done_share = (done + share * rows_of_block) / total
        text = note or kind.kind_name
        text = text if done_share else f"{COMPILING}, {text}"
        on_progress(SweepProgress(done, total, done_share, 0, timings.run_s, text))

    for number in blocks:
        first, last = context.layout.rows_of(number)
        rows_of_block = last - first
        # reports each step too, so that Ctrl-C need not wait for the block's end
        yield number, kind.block_table(context.design, context.spec, first, last, report)
        done += rows_of_block
        report()


def write_blocks(directory: ResultDirectory, blocks: Iterable[tuple[int, pd.DataFrame]]) -> None:
    """Write each block of a source, with the counts of rows and the time spent so far.

    Args:
        directory: the result directory.
        blocks: the numbers and the records of blocks; the source continues once a block is on disk.
    """
    earlier_s = directory.manifest.get("timings", {}).get("run_s", 0.0)
    began = time.perf_counter()
    for number, frame in blocks:
        directory.write_part(number, frame)
        seconds = earlier_s + time.perf_counter() - began
        directory.update_manifest(timings={"run_s": seconds}, counts=directory.counts(), complete=False)


@dataclasses.dataclass(frozen=True)
class MissingBlocks:
    """Blocks of a table that are to be computed and written.

    Args:
        context: the job's context; its `rows_in` chooses the rows of a round of a refined run.
        directory: the result directory of the job, or of the round.
        numbers: the numbers of the blocks.
        on_progress: progress callback; an exception that it raises stops the run.
        timings: updated during the run.
        open_rows: stores the ended rows of incomplete blocks, where this process computes them.
    """

    context: RunContext
    directory: ResultDirectory
    numbers: Sequence[int]
    on_progress: Callable[[SweepProgress], None]
    timings: Timings
    open_rows: OpenRows


class Executor(abc.ABC):
    """Computes blocks of tables, and has their parts written into a result directory."""

    @property
    @abc.abstractmethod
    def note(self) -> str:
        """A remark for a line of progress before the first rows end."""

    @property
    @abc.abstractmethod
    def manifest(self) -> dict[str, Any]:
        """Fields that a run with this executor adds to the manifest at its end: its number of workers."""

    @abc.abstractmethod
    def serve(
        self, context: RunContext, directory: ResultDirectory, on_wait: Callable[[], None]
    ) -> contextlib.AbstractContextManager[None]:
        """Context in which `run_blocks` may be called, for tables of one job.

        Args:
            context: the job's context.
            directory: its result directory.
            on_wait: called while the client waits for others; an exception that it raises ends the wait.

        Raises:
            RunError: the job cannot be computed there.
        """

    @abc.abstractmethod
    def run_blocks(self, missing: MissingBlocks) -> None:
        """Compute blocks, and return when their parts exist.

        Raises:
            UserError: some blocks could not be computed or written; the others are.
        """


class ThisProcess(Executor):
    """Computes blocks with the devices of this process."""

    @property
    def note(self) -> str:
        return COMPILING

    @property
    def manifest(self) -> dict[str, Any]:
        return {}

    def serve(
        self, context: RunContext, directory: ResultDirectory, on_wait: Callable[[], None]
    ) -> contextlib.AbstractContextManager[None]:
        return contextlib.nullcontext()

    def run_blocks(self, missing: MissingBlocks) -> None:
        compute_blocks(
            missing.context,
            missing.numbers,
            missing.directory.encoded,
            missing.directory.write_encoded,
            missing.on_progress,
            timings=missing.timings,
            open_rows=missing.open_rows,
        )
