"""Shared code of `gs.search` and `gs.sensitivity`: reading of whole jobs, and their directories."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from gaitsweep.api.result import cluster_of, warn
from gaitsweep.errors import ArgumentError
from gaitsweep.fitting.search import SearchResult
from gaitsweep.fitting.sensitivity import Sensitivity
from gaitsweep.runs.progress import Progress

if TYPE_CHECKING:
    from distributed import Client

JobT = TypeVar("JobT")
FitT = TypeVar("FitT", SearchResult, Sensitivity)


def given_job(
    job: str | Path | Mapping[str, Any],
    overrides: Sequence[str],
    load: Callable[[str | Path, Sequence[str]], JobT],
    read: Callable[[Mapping[str, Any], Path], JobT],
) -> JobT:
    """Load a job from a file by `load`, or read it from a mapping of its fields by `read`.

    Raises:
        ArgumentError: overrides of a mapping.
        JobError: the job is not valid.
    """
    if not isinstance(job, Mapping):
        return load(job, overrides)
    if overrides:
        raise ArgumentError("overrides are for a job file: change the mapping instead.")
    return read(job, Path.cwd())


def in_directory(
    run: Callable[..., FitT], job: Any, out: str | Path | None, on_progress: Progress, client: Client | None
) -> FitT:
    """Run a job by `run`, with its table in a directory, `results/NAME` by default."""
    cluster = None if client is None else cluster_of(client)
    return run(job, out, on_progress=on_progress, on_message=warn, cluster=cluster)


def in_memory(run: Callable[..., FitT], job: Any, on_progress: Progress, client: Client | None) -> FitT:
    """Run a job by `run`, with its table in memory; the folder of its `path` no longer exists."""
    cluster = None if client is None else cluster_of(client, collect=True)
    with tempfile.TemporaryDirectory(prefix="gaitsweep_") as folder:
        result = run(job, folder, on_progress=on_progress, on_message=warn, cluster=cluster)
    del result.table.attrs["path"]
    return result
