"""Result directory of a search or a sensitivity analysis, and its rows computed by a cluster."""

from __future__ import annotations

import contextlib
import hashlib
import json
import shutil
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pandas as pd

from gaitsweep.engine.sweep.sweep_spec import SweepProgress
from gaitsweep.fitting.population import OnProgress
from gaitsweep.job import Job
from gaitsweep.runs import provenance
from gaitsweep.runs.execute import run_job
from gaitsweep.runs.prepare import RunContext, naming_the_file
from gaitsweep.runs.provenance import continue_directory
from gaitsweep.table import ResultDirectory, load
from gaitsweep.table.manifest import Layout

if TYPE_CHECKING:
    from gaitsweep.runs.cluster.dispatch import Cluster

# The folder, in a result directory, of the rows that a cluster is computing.
BATCH = "batch"
_MIN_BLOCK = 16  # rows of a block of a batch
_BLOCKS_PER_WORKER = 4
_MIN_WORKERS = 4  # that are counted on while their number is not known


@contextlib.contextmanager
def open_directory(
    path: Path,
    resolved: Mapping[str, Any],
    layout: Layout,
    context: RunContext,
    on_message: Callable[[str], None],
) -> Iterator[ResultDirectory]:
    """Open a result directory of sets of constants to begin or to continue it.

    Args:
        path: the directory.
        resolved: the job as plain values.
        layout: hash of the job, its sets, and the sets of a part.
        context: context of the job of a set.
        on_message: called with each note and warning, a sentence.

    Yields:
        The directory, which is closed at the end of the context.

    Raises:
        RunError, TableError: the directory cannot be continued.
    """
    if context.note is not None:
        on_message(context.note)
    for caveat in context.model.caveats():
        on_message(f"Warning: {caveat}")
    with naming_the_file(), ResultDirectory.open(path, resolved, layout) as directory:
        for note in directory.notes:
            on_message(note)
        continue_directory(context, directory, on_message)
        yield directory


def describe(
    context: RunContext,
    directory: ResultDirectory,
    quantities: Mapping[str, Any],
    versions: Mapping[str, str],
) -> None:
    """Write the units of the columns, the settings of the run and the versions into the manifest.

    Args:
        context: context of the job of a set.
        directory: the directory of the manifest.
        quantities: unit and meaning of the columns, by name.
        versions: versions of packages beside those of every run, by name.
    """
    directory.update_manifest(
        engine=context.engine,
        device=context.device,
        precision=context.spec.numerics.precision,
        method=context.spec.numerics.method,
        quantities=quantities,
        versions=provenance.versions() | dict(versions),
    )


class ClusterRows:
    """Function that computes rows on a cluster, for `Population.run_elsewhere`.

    The table of a batch is removed once it is read. After a run that was stopped, the same batch continues
    from its blocks.

    Args:
        path: the result directory of the search or the analysis.
        cluster: computes the rows; it is left open.
    """

    def __init__(self, path: Path, cluster: Cluster) -> None:
        self._path = path / BATCH
        self._cluster = cluster

    def __call__(self, job: Job, on_progress: OnProgress) -> pd.DataFrame:
        """Compute the rows of a job.

        Args:
            job: the job.
            on_progress: progress callback of its rows.

        Returns:
            The records of the rows.
        """
        began = time.perf_counter()
        blocks = _BLOCKS_PER_WORKER * max(self._cluster.workers.most, _MIN_WORKERS)
        block = max(_MIN_BLOCK, job.design.n_rows // blocks)
        batch = job.model_copy(update={"engine": job.engine.model_copy(update={"block": block})})

        def on_job_progress(done: int, total: int, rate: float, fraction: float, note: str) -> None:
            if on_progress is not None:
                on_progress(SweepProgress(done, total, fraction, 0, time.perf_counter() - began))

        name = hashlib.sha256(json.dumps(batch.resolved(), sort_keys=True).encode()).hexdigest()[:16]
        # folders of other batches, which a killed client may have left
        for folder in self._path.iterdir() if self._path.is_dir() else ():
            if folder.name != name:
                shutil.rmtree(folder, ignore_errors=True)
        path = run_job(
            batch, self._path / name, on_progress=on_job_progress, figures=False, cluster=self._cluster
        )
        table = load(path)
        shutil.rmtree(self._path)
        return table
