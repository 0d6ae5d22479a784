"""A range of a job's rows, computed beside other processes that compute other ranges: an array of jobs.

Each process writes the parts of its rows into the same result directory; the process that finds all parts
present completes the table.
"""

from __future__ import annotations

import functools
import re
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TypeVar

from gaitsweep.engine.sweep.sweep_spec import SweepProgress
from gaitsweep.job import Job
from gaitsweep.runs.execute import RESULTS, run_job
from gaitsweep.runs.executor import compute_blocks
from gaitsweep.runs.prepare import RunContext, RunError, naming_the_file, prepare
from gaitsweep.runs.progress import COMPILING, Progress
from gaitsweep.runs.provenance import check_program, continue_directory, differing
from gaitsweep.runs.summary import describe
from gaitsweep.table import ResultDirectory
from gaitsweep.table.atomic_files import TableError
from gaitsweep.table.directory import SharedWriter
from gaitsweep.table.locks import BlockLocks, BusyDirectory, Lock, this_process
from gaitsweep.table.manifest import MANIFEST, TABLE, Layout, claim
from gaitsweep.table.parquet_parts import PARTS

# Others hold a directory for a moment when they make it, and while the last of them completes it (s).
PATIENCE = 20.0
Returned = TypeVar("Returned")


def run_rows(
    job: Job,
    rows: str,
    out: str | Path | None = None,
    *,
    on_progress: Progress | None = None,
    on_message: Callable[[str], None] = lambda _: None,
    strict: bool = False,
) -> Path:
    """Run a range of a job's rows; if all parts of its table exist then, complete the table.

    Args:
        job: the job; every process has the same.
        rows: the first row and the row after the last, "A:B", multiples of the block.
        out: the result directory, the same for every process; `results/NAME` by default.
        on_progress, on_message, strict: as for `run_job`.

    Returns:
        The result directory.

    Raises:
        RunError: the rows are not in this job, or are not whole blocks.
        TableError: the directory is another job's, or another process runs some of these rows.
    """
    path = RESULTS / job.name if out is None else Path(out)
    context = prepare(job)
    if job.run.refined(context.design) is not None:
        raise RunError(
            "run.refine is boundary, so which rows are simulated follows from others: use --cluster."
        )
    blocks = blocks_of(rows, context.layout)
    with naming_the_file():
        _create(path, context, on_message)
        writer = SharedWriter(path, context.layout)
        missing = writer.missing_blocks(blocks)
        if missing:
            lock = _patiently(lambda: Lock(path, shared=True))
            try:
                _run_missing(context, writer, missing, on_progress or (lambda *_, **__: None))
            finally:
                lock.release()
        if not all((path / TABLE / PARTS.name(n)).exists() for n in context.layout.blocks):
            return path
        # several processes may find the last part there: one of them completes the table, the others wait
        try:
            return _patiently(
                lambda: run_job(job, path, on_progress=on_progress, on_message=on_message, strict=strict)
            )
        except BusyDirectory:  # one that takes longer to complete it, and does not need this process
            return path


def blocks_of(rows: str, layout: Layout) -> Sequence[int]:
    """Return the blocks of rows "A:B".

    Raises:
        RunError: the rows are not whole blocks of the job.
    """
    n_rows, block = layout.rows, layout.block
    option = f"--rows {rows}"
    match = re.fullmatch(r"\s*(\d{1,18})\s*:\s*(\d{1,18})\s*", rows)
    if match is None:
        raise RunError(
            f"{option} is not valid: write the first row and the row after the last, --rows 0:{block}."
        )
    first, stop = int(match[1]), int(match[2])
    if not first < min(stop, n_rows):
        raise RunError(f"{option} names no row: this job has the rows 0 to {n_rows - 1}.")
    if first % block or (stop % block and stop < n_rows):
        near = f"{first // block * block}:{-(-stop // block) * block}"
        raise RunError(
            f"{option} are not whole blocks: both numbers must be multiples of engine.block, which is "
            f"{block}; did you mean --rows {near}?"
        )
    return range(first // block, -(-min(stop, n_rows) // block))


def _create(path: Path, context: RunContext, on_message: Callable[[str], None]) -> None:
    """Create the directory, unless another process has created it for the same job."""

    def create() -> None:
        if (path / MANIFEST).exists():
            if manifest := claim(path, context.layout):
                for warning in check_program(context, path, manifest):
                    on_message(warning)
                if differences := differing(manifest):
                    on_message(
                        f"Warning: {path} was begun with {'; '.join(differences)}: rows that are made "
                        "here may differ from its others in the last digits."
                    )
            return
        resolved = context.job.resolved(engine=context.engine)
        with ResultDirectory.open(path, resolved, context.layout) as directory:
            continue_directory(context, directory, on_message)
            describe(context, directory)

    _patiently(create)


def _patiently(action: Callable[[], Returned]) -> Returned:
    """Return the result of an action, which is tried again while another process holds the directory."""
    deadline = time.monotonic() + PATIENCE
    while True:
        try:
            return action()
        except BusyDirectory:
            if time.monotonic() > deadline:
                raise
            time.sleep(0.2)


def _run_missing(
    context: RunContext, writer: SharedWriter, missing: list[int], on_progress: Progress
) -> None:
    """Compute the missing blocks, each of which this process locks."""
    total = context.spec.n_rows
    with BlockLocks(writer.path) as locks:
        for number in missing:
            if not locks.take(number, this_process()):
                first, stop = writer.layout.rows_of(number)
                raise TableError(
                    f"Rows {first} to {stop - 1} of {writer.path} are being run by "
                    f"{locks.unfinished_starts(number).process}: wait until it ends, or stop it."
                )

        encode = functools.partial(writer.encoded, quantities=context.quantities)

        def write(number: int, part: bytes) -> None:
            writer.write(number, part)
            locks.end(number)
            locks.free(number)

        rows = writer.layout.rows_in(missing)

        def on_sweep_progress(now: SweepProgress) -> None:
            rate = now.share * rows / max(now.seconds, 1e-9)
            on_progress(now.done, rows, rate, now.share, f"of {total} rows")

        on_progress(0, rows, 0.0, 0.0, COMPILING)
        compute_blocks(context, missing, encode, write, on_sweep_progress)
