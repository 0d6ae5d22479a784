"""`gs.run`: runs of jobs, in a result directory or in memory."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from gaitsweep.api.result import Result
from gaitsweep.errors import ArgumentError, warn
from gaitsweep.job import Job, load_job
from gaitsweep.models import importable
from gaitsweep.runs.execute import run_job, table_in_memory
from gaitsweep.runs.progress import Progress, progress_lines
from gaitsweep.runs.sentences import remarks

if TYPE_CHECKING:
    from distributed import Client  # pyright: ignore[reportMissingImports]

    from gaitsweep.runs.cluster.dispatch import Cluster


def run(
    job: Job | str | Path,
    out: str | Path | None = None,
    *,
    overrides: Sequence[str] = (),
    on_progress: Progress | None = None,
    strict: bool = False,
    client: Client | None = None,
) -> Result:
    """Run a job in its result directory, or the rest of it, and draw its figures.

    Args:
        job: a job, or the path of its YAML file.
        out: the result directory, `results/NAME` by default.
        overrides: settings for a job from a file, such as "run.max_cycles=50".
        on_progress: progress callback: rows done, rows in all, rows a second, the share done, a remark; by
            default it prints a line on standard error every half minute.
        strict: raise SelfCheckError if the self-check warns.
        client: a `distributed.Client`, whose workers compute the rows; they share the result directory.

    Raises:
        SelfCheckError: the self-check warns, with `strict`; the table is complete.
        JobError: the job is not valid, with a sentence for each error.
        ArgumentError: neither a job nor a path; overrides of a job that is not read from a file; a
            directory for a model whose class belongs to this session, which no later run could compare.
        TableError, RunError: the directory is another job's, the disk is full, a device is missing.
    """
    if isinstance(job, Job) and overrides:
        raise ArgumentError(
            "overrides are for a job that is read from a file: build the Job with them instead."
        )
    if not isinstance(job, (Job, str, Path)):
        raise ArgumentError(
            f"job is a {type(job).__name__}, but takes a Job or the path of its YAML file: of fields in a "
            "dictionary make one by Job(**fields)."
        )
    loaded = job if isinstance(job, Job) else load_job(job, overrides)
    refuse_of_session(loaded.model)
    cluster = None if client is None else cluster_of(client)
    on_progress = progress_lines() if on_progress is None else on_progress
    path = run_job(loaded, out, on_progress=on_progress, on_message=warn, strict=strict, cluster=cluster)
    return _remarked(Result(path))


def refuse_of_session(model: str) -> None:
    """Refuse a result directory for a model, by its name, whose class belongs to this session.

    Raises:
        ArgumentError: the class belongs to this session, so no later run could compare it.
    """
    if not importable(model):
        raise ArgumentError(
            f"{model.partition(':')[2]} is a class of this session, and a result directory needs a "
            "model that a file gives: leave out= away, or write the class into a module and import it."
        )


def cluster_of(client: Client, *, collect: bool = False) -> Cluster:
    """Return the workers of a `distributed.Client`.

    Args:
        client: the client, which stays open.
        collect: send rows here through the scheduler, without a directory that the workers share.
    """
    from gaitsweep.runs.cluster.connection import UserClient
    from gaitsweep.runs.cluster.dispatch import Cluster

    return Cluster(UserClient(client), collect=collect, on_message=warn)


def run_in_memory(job: Job, client: Client | None = None) -> Result:
    """Run a job and keep its table in memory.

    Args:
        job: the job.
        client: a `distributed.Client`, whose workers compute the rows and send them here.

    Raises:
        TableError, RunError: the temporary disk is full, a device is missing.
    """
    cluster = None if client is None else cluster_of(client, collect=True)
    table = table_in_memory(job, on_progress=progress_lines(), on_message=warn, cluster=cluster)
    return _remarked(Result(table=table))


def _remarked(result: Result) -> Result:
    """Issue the remarks on a result as warnings, and return it."""
    for remark in remarks(result.manifest):
        warn(remark)
    return result
