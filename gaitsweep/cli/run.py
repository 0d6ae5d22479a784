"""The commands `run` and `atlas`, and what every command that runs a job does.

That is: show progress, connect to workers, stop at Ctrl-C, and print the outcome.
"""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from typer import Argument, Option

from gaitsweep.cli import stored_output
from gaitsweep.cli.options import DryRun, Open, Out, Settings, Trust, print_links, print_message
from gaitsweep.errors import EXIT_STRICT, exit_code_of_stop
from gaitsweep.extension import model_paths
from gaitsweep.shipped import config_file
from gaitsweep.shipped import job_file as shipped_or_own

if TYPE_CHECKING:
    from gaitsweep.job import Job
    from gaitsweep.runs.cluster.dispatch import Cluster
    from gaitsweep.runs.progress import Progress

JobFile = Annotated[
    Path,
    Argument(
        metavar="JOB.yaml",
        parser=shipped_or_own,
        help="Job file, or builtin:NAME of a shipped job (see `gaitsweep examples`).",
    ),
]
Engine = Annotated[
    str | None, Option("--engine", metavar="NAME", help="auto, xla or kernel; by default the job's.")
]
Strict = Annotated[
    bool,
    Option(
        "--strict",
        help=f"Exit with code {EXIT_STRICT} if the self-check warns; `--set verify=0` switches it off.",
    ),
]
RowRange = Annotated[
    str | None,
    Option(
        "--rows",
        metavar="A:B",
        help="Run only rows A to B-1, which must be whole blocks, while other processes run other "
        "rows in the same directory; the last process completes the table.",
    ),
]
Workers = Annotated[
    str | None,
    Option(
        "--cluster",
        metavar="WHERE",
        help="Dask workers that compute the rows: local:N (N processes on this machine), the scheduler "
        "tcp://HOST:PORT, or its file FILE.json.",
    ),
]
Collect = Annotated[
    bool, Option("--collect", help="Return parts through the scheduler, without a shared directory.")
]
BlockLimit = Annotated[
    float | None,
    Option(
        "--block-limit",
        metavar="S",
        min=1.0,
        help="Seconds after which a block is taken from a hanging worker; by default ten times the "
        "longest block so far.",
    ),
]


def run(
    job_file: JobFile,
    out: Out = None,
    settings: Settings = None,
    engine: Engine = None,
    dry_run: DryRun = False,
    strict: Strict = False,
    rows: RowRange = None,
    cluster: Workers = None,
    collect: Collect = False,
    block_limit: BlockLimit = None,
    open_it: Open = False,
) -> None:
    """Run a job, or continue it, and write its table and figures."""
    _refuse_options(rows=rows, cluster=cluster, collect=collect, block_limit=block_limit)
    command = [str(argument) for argument in (job_file, out, settings, engine, strict)]
    # rows and workers are checked by the run itself
    if not dry_run and rows is None and cluster is None and _print_stored(command, open_them=open_it):
        return
    from gaitsweep.cli import show
    from gaitsweep.job import load_job
    from gaitsweep.own_modules import data_files
    from gaitsweep.table import Snapshot

    overrides = list(settings or ())
    if engine is not None:
        overrides.append(f"engine.name={engine}")
    with data_files() as files_of_job:
        job = load_job(job_file, overrides)
    if dry_run:
        from gaitsweep.runs.estimate import estimate  # after a bad job has been refused

        print(show.estimate(estimate(job)))
        return
    sources = {job_file.absolute(), *files_of_job}
    if job.config is not None:
        sources.add(config_file(job.config, job_file.parent).absolute())
    digests = stored_output.digests_of(sources)  # before the run, during which they may be edited
    from gaitsweep.runs.execute import run_job
    from gaitsweep.runs.job_array import run_rows

    messages: list[str] = []

    def on_message(sentence: str) -> None:
        messages.append(sentence)
        print_message(sentence)

    with running(
        job.name, out, cluster=cluster, collect=collect, limit=block_limit, on_message=on_message
    ) as (on_progress, workers):
        if rows is not None:
            path = run_rows(job, rows, out, on_progress=on_progress, on_message=on_message, strict=strict)
        else:
            path = run_job(
                job, out, on_progress=on_progress, on_message=on_message, strict=strict, cluster=workers
            )
    snapshot = Snapshot.of(path)
    outcome = show.outcome(snapshot)
    print_outcome(outcome, open_them=open_it)
    # a share of the rows is not complete, and other processes complete its table
    if snapshot.complete and _is_repeatable(job, messages):
        errors = "".join(f"{sentence}\n" for sentence in messages)
        stored_output.store_output(command, digests, path, outcome, errors)


def _refuse_options(
    *, rows: str | None, cluster: str | None, collect: bool, block_limit: float | None
) -> None:
    """Refuse options that contradict each other, whether or not the job is complete."""
    if cluster is None and (collect or block_limit is not None):
        raise typer.BadParameter("--collect and --block-limit are options of --cluster.")
    if cluster is not None and rows is not None:
        raise typer.BadParameter("--rows and --cluster cannot be combined: remove one of the two.")


def _print_stored(command: Sequence[str], *, open_them: bool) -> bool:
    """Print the stored output of a command, if there is any that still holds; return whether there is."""
    stored = stored_output.load_output(command)
    if stored is None:
        return False
    print(stored.errors, end="", file=sys.stderr)
    print_outcome(stored.printed, open_them=open_them)
    return True


def _is_repeatable(job: Job, messages: Sequence[str]) -> bool:
    """Return whether the same command prints the same while the files of the job and its results stay.

    It would not where a message was about a repair, or where the job depends on more than the files that
    were read with it: the modules or the MJCF of a user's model, or another table that a figure shows.
    """
    module = model_paths().get(job.model, job.model).rpartition(":")[0]  # empty for a model file
    shipped = module.startswith("gaitsweep.")
    with_table = any(figure.model_dump().get("with_table") is not None for figure in job.figures)
    lasting = all(sentence.startswith(("Warning: ", "engine: ")) for sentence in messages)
    return shipped and not with_table and lasting


def atlas(
    target: Annotated[
        Path,
        Argument(
            metavar="JOB.yaml|DIR",
            parser=shipped_or_own,
            help="Job with `run: {kind: atlas}`, or, with --more, the result directory of one.",
        ),
    ],
    out: Annotated[
        Path | None,
        Option(
            "--out", metavar="DIR", help="Result directory; by default results/NAME, or DIR_more with --more."
        ),
    ] = None,
    settings: Settings = None,
    more: Annotated[
        bool,
        Option("--more", help="Make the atlas in DIR again: twice the starts, and one bifurcation more."),
    ] = False,
    trust: Trust = False,
    open_it: Open = False,
) -> None:
    """Find all gaits, stable or not, and their bifurcations."""
    from gaitsweep.cli import show
    from gaitsweep.job import load_job
    from gaitsweep.job.load import wider_job
    from gaitsweep.kinds import Atlas
    from gaitsweep.runs.execute import run_job
    from gaitsweep.table import Snapshot, load

    if more != target.is_dir():
        text = "--more takes the result directory of an atlas." if more else "a directory needs --more."
        raise typer.BadParameter(f"{target}: {text}")
    if not more:
        kind = load_job(target, list(settings or ())).run
        if not isinstance(kind, Atlas):
            raise typer.BadParameter(f"{target}: run.kind is {kind.kind_name}, but must be atlas.")
        run(target, out, settings, open_it=open_it)
        return
    if settings:
        raise typer.BadParameter("--set is for a job: --more takes the job of the result directory as it is.")
    job = wider_job(load(target).attrs, trust=trust)
    place = target if target.name not in ("", "..") else target.resolve()
    out = out or place.with_name(f"{place.name}_more")
    with running(job.name, out, cluster=None) as (on_progress, _):
        path = run_job(job, out, on_progress=on_progress, on_message=print_message)
    wider = Snapshot.of(path)
    print_outcome(show.outcome(wider), open_them=open_it)
    if wider.manifest.get("findings") == Snapshot.of(target).manifest.get("findings"):
        print(f"Nothing was found that {target} does not have.")


@contextlib.contextmanager
def running(
    name: str,
    out: Path | None,
    unit: str = "rows",
    *,
    cluster: str | None,
    collect: bool = False,
    limit: float | None = None,
    on_message: Callable[[str], None] = print_message,
) -> Iterator[tuple[Progress, Cluster | None]]:
    """A context with the progress callback and the workers of a run; a run that is stopped says so.

    Args:
        name: name of the job.
        out: its result directory, by default that of its name.
        unit: the unit of the progress.
        cluster: the option `--cluster`; None: this process computes the rows.
        collect, limit: the options `--collect` and `--block-limit` (s).
        on_message: called with each note and warning, a sentence.
    """
    from gaitsweep.cli.progress import stoppable_progress

    try:
        # the processes of workers would outlive this one
        stopped = (lambda: _stopped(name, out)) if cluster is None else None
        with stoppable_progress(unit, stopped) as on_progress, contextlib.ExitStack() as stack:
            workers = None
            if cluster is not None:
                from gaitsweep.runs.cluster.connection import connection_to
                from gaitsweep.runs.cluster.dispatch import Cluster

                connection = connection_to(cluster)
                workers = stack.enter_context(
                    Cluster(connection, collect=collect, limit=limit, on_message=on_message)
                )
            yield on_progress, workers
    except KeyboardInterrupt as stop:
        print_message(_stopped(name, out))
        raise typer.Exit(exit_code_of_stop(stop)) from None


def _stopped(name: str, out: Path | None) -> str:
    """The sentence at the end of a run that was stopped."""
    from gaitsweep.runs.execute import RESULTS
    from gaitsweep.table import Snapshot, TableError

    path = out or RESULTS / name
    try:
        snapshot = Snapshot.of(path)
    except TableError:
        return "Stopped before anything was written. Run the same command to start again."
    safe = f"{snapshot.rows_safe} of {snapshot.manifest['rows']} rows are safe in {path}"
    return f"Stopped: {safe}. Run the same command to continue."


def print_outcome(outcome: str, *, open_them: bool) -> None:
    """Print the outcome of a run, and links to the figures that it names; open these if asked to."""
    print(outcome)
    figures = [line for line in outcome.splitlines() if line.startswith("Figure: ")]
    print_links([line.removeprefix("Figure: ") for line in figures], open_them=open_them)
