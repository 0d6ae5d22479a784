"""Execution of a job: its rows through the engine into a result directory, and its figures.

`run_job` is what `gaitsweep run` and `gaitsweep.run(...)` do. Run again, it continues where it stopped.
"""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pandas as pd

from gaitsweep.engine.content import held_contents
from gaitsweep.engine.sweep.sweep import Timings
from gaitsweep.engine.sweep.sweep_spec import SweepProgress
from gaitsweep.job import Job
from gaitsweep.job.row_remarks import remarks_on_rows
from gaitsweep.kinds.run_kind import RunKind
from gaitsweep.row_outcome import RowOutcome
from gaitsweep.runs.concurrent_self_check import ConcurrentSelfCheck
from gaitsweep.runs.executor import Executor, MissingBlocks, ThisProcess, compute_blocks
from gaitsweep.runs.prepare import RunContext, in_memory, naming_the_file, nominal_period, prepare
from gaitsweep.runs.progress import Progress, so_far, steps_per_second
from gaitsweep.runs.provenance import continue_directory
from gaitsweep.runs.refinement import Refinement
from gaitsweep.runs.self_check_result import SelfCheckError
from gaitsweep.runs.sentences import advice, self_check_sentence
from gaitsweep.runs.summary import describe, sum_up, summed_up, tallied_column
from gaitsweep.table import MemoryTable, ResultDirectory, Table, TableError, load
from gaitsweep.table.atomic_files import temporary_folder
from gaitsweep.table.manifest import self_check_warned
from gaitsweep.table.parquet_parts import arrow_part

if TYPE_CHECKING:
    from gaitsweep.runs.cluster.dispatch import Cluster

RESULTS = Path("results")
# Cycles of all rows up to which a kernel is not optimised. The optimised one takes some four times as long to
# compile, and is up to twice as fast: of the hopper 0.4 s, half the time of some 20 000 cycles.
_CYCLES_OF_QUICK_KERNEL = 10_000


@held_contents()
def run_job(
    job: Job,
    out: str | Path | None = None,
    *,
    on_progress: Progress | None = None,
    on_message: Callable[[str], None] = lambda _: None,
    figures: bool = True,
    strict: bool = False,
    cluster: Cluster | None = None,
) -> Path:
    """Run the rows that a job's directory lacks, then draw its figures.

    Args:
        job: the job.
        out: its result directory, `results/NAME` by default.
        on_progress: progress callback.
        on_message: called with each note and warning, a sentence.
        figures: draw the job's figures at the end.
        strict: raise SelfCheckError where the run's self-check warns.
        cluster: computes the blocks, if this process does not; it is left open.

    Returns:
        The result directory.

    Raises:
        RunError, TableError, KeyboardInterrupt: the run ends; rows on disk are safe, and the next run
            continues.
        FigureError: the table is complete, but a figure of it could not be drawn.
        SelfCheckError: with `strict`, the self-check warns.
    """
    path = RESULTS / job.name if out is None else Path(out)
    on_progress = on_progress or (lambda *_, **__: None)
    context = prepare(job)
    resolved = job.resolved(engine=context.engine)
    with naming_the_file(), ResultDirectory.open(path, resolved, context.layout) as directory:
        checked = _run(context, directory, on_progress, on_message, cluster)
        _write_tables(context, directory)
        if figures and resolved["figures"]:
            from gaitsweep.runs.figures import draw_of_complete  # which imports Matplotlib

            draw_of_complete(directory, resolved, on_progress, on_message)
    _judge(context, checked, on_message, strict=strict)
    return path


def _run(
    context: RunContext,
    table: Table,
    on_progress: Progress,
    on_message: Callable[[str], None],
    cluster: Cluster | None = None,
) -> dict[str, Any]:
    """Run the rows that a table lacks, and return the result of the self-check."""
    spec = dataclasses.replace(context.spec, quick=_optimisation_takes_longer(context))
    context = dataclasses.replace(context, spec=spec)
    if context.note is not None:
        on_message(context.note)
    with ConcurrentSelfCheck(context, table) as check:
        for note in table.notes:
            on_message(note)
        continue_directory(context, table, on_message)
        missing = table.missing_blocks()
        if missing:
            if context.job.numerics.method == "auto" and spec.numerics.method == "rodas5p":
                on_message("The flow is stiff, so its rows are integrated by the method rodas5p.")
            if notice := spec.model.caveats_notice:
                on_message(notice)
            for caveat in spec.model.caveats():
                on_message(f"Warning: {caveat}")
            for remark in remarks_on_rows(context.design, context.job.model):
                on_message(f"Warning: {remark}")
            if _rows_leave_the_host_idle(context):
                check.begin()
            _run_missing(context, table, missing, on_progress, cluster or ThisProcess())
        elif not summed_up(context, table):  # killed after its last part
            describe(context, table)
            sum_up(context, table, table.manifest.get("timings", {}))
        return check.result(on_progress)


def _write_tables(context: RunContext, directory: ResultDirectory) -> None:
    """Write those tables of a complete run that its kind keeps in files of their own and that are missing."""
    kind = context.job.run
    if type(kind).tables is RunKind.tables or directory.missing_blocks():
        return
    table = directory.load()
    for name, part in kind.tables(table).items():
        file = f"{name}.parquet"
        if directory.read_beside(file) is None:
            data = arrow_part(part, 0, context.job_hash, {}, context.quantities).encoded().data
            directory.write_beside(file, data)


def _judge(
    context: RunContext, checked: dict[str, Any], on_message: Callable[[str], None], *, strict: bool
) -> None:
    """Report a self-check that warned; raises SelfCheckError with `strict`."""
    if not self_check_warned(checked):
        return
    text = f"{self_check_sentence(checked)} {advice(checked, context.spec.numerics.dt)}"
    if strict:
        raise SelfCheckError(text)
    on_message(f"Warning: {text}")


def table_in_memory(
    job: Job,
    *,
    on_progress: Progress | None = None,
    on_message: Callable[[str], None] = lambda _: None,
    cluster: Cluster | None = None,
) -> pd.DataFrame:
    """Run a job and return its table, with units and manifest in `.attrs`; an interrupt loses all rows.

    Rounds of a refined run and workers of a cluster need a directory, which is temporary.

    Args:
        job: the job.
        on_progress: progress callback.
        on_message: called with each note and warning, a sentence.
        cluster: computes the blocks, if this process does not.

    Raises:
        RunError, TableError: as `run_job`.
    """
    if cluster is None and job.run.refined(job.design) is None:
        with held_contents():
            context = in_memory(prepare(job))
            memory = MemoryTable(job.resolved(engine=context.engine), context.layout)
            checked = _run(context, memory, on_progress or (lambda *_, **__: None), on_message)
            _judge(context, checked, on_message, strict=False)
            return memory.load(last=True)
    with temporary_folder() as folder:
        path = run_job(
            job, folder, on_progress=on_progress, on_message=on_message, figures=False, cluster=cluster
        )
        table = load(path)
    del table.attrs["path"]
    return table


def _optimisation_takes_longer(context: RunContext) -> bool:
    """Return whether optimising a kernel for the CPU is likely to take more time than the rows gain by it."""
    if context.engine != "kernel" or _rows_leave_the_host_idle(context):
        return False
    likely = context.job.run.cost(context.design, 1.0, nominal_period(context.design)).likely
    return context.design.n_rows * likely <= _CYCLES_OF_QUICK_KERNEL


def _rows_leave_the_host_idle(context: RunContext) -> bool:
    """Return whether the rows run on a GPU, where the rows of a self-check take no time from them."""
    return context.spec.devices[0].platform != "cpu"


def _run_missing(
    context: RunContext, table: Table, missing: list[int], on_progress: Progress, executor: Executor
) -> None:
    """Have an executor compute the missing blocks of a table, and sum the table up."""
    before = table.rows_done + table.rows_open
    total = context.spec.n_rows
    describe(context, table)
    earlier_timings = table.manifest.get("timings", {})
    timings = Timings()
    tallied = tallied_column(context)

    def all_timings() -> dict[str, float]:
        fields = dataclasses.asdict(timings).items()
        return {name: value + earlier_timings.get(name, 0) for name, value in fields}

    def on_sweep_progress(now: SweepProgress) -> None:
        note = now.note or steps_per_second(now.attempts / max(now.seconds, 1e-9))
        note += so_far(table.tally(tallied))
        on_progress(before + now.done, total, now.rate, (before + now.share * now.rows) / total, note)

    def on_wait() -> None:
        on_progress(before, total, 0.0, before / total, executor.note)

    on_wait()
    if isinstance(table, MemoryTable):
        compute_blocks(
            context, missing, table.encoded, table.write_encoded, on_sweep_progress, timings=timings
        )
        sum_up(context, table, all_timings())
        return
    try:
        with executor.serve(context, table, on_wait):
            if (grid := context.job.run.refined(context.design)) is not None:
                Refinement(context, grid, table, executor).run(on_progress, timings)
            else:
                stored = _OpenRowsOnDisk(table, all_timings)
                blocks = MissingBlocks(context, table, missing, on_sweep_progress, timings, stored)
                executor.run_blocks(blocks)
        table.update_manifest(**executor.manifest)
    except BaseException:
        # the exception that stopped the run is raised, not a failure to write the manifest
        with contextlib.suppress(TableError):
            sum_up(context, table, all_timings())
        raise
    sum_up(context, table, all_timings())


@dataclasses.dataclass
class _OpenRowsOnDisk:
    """Store of finished rows of open blocks: the directory, with the time that they took."""

    directory: ResultDirectory
    timings: Callable[[], dict[str, float]]

    def restored(self, number: int) -> RowOutcome | None:
        return self.directory.restored(number)

    def keep(self, rows: RowOutcome) -> None:
        self.directory.keep(rows)
        self.directory.update_manifest(timings=self.timings())
