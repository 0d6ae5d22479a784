"""Computation of the rows of sets of constants by the workers of a cluster."""

from __future__ import annotations

import hashlib
import json
import shutil
import time
from pathlib import Path
from typing import TYPE_CHECKING

import pandas as pd

from gaitsweep.engine.sweep.sweep_spec import SweepProgress
from gaitsweep.fitting.population import OnProgress
from gaitsweep.job import Job
from gaitsweep.runs.execute import run_job
from gaitsweep.table import load

if TYPE_CHECKING:
    from gaitsweep.runs.cluster.dispatch import Cluster

# The folder, in a result directory, of the rows that a cluster is computing.
BATCH = "batch"
# Rows of a block of a batch, at least, and the workers that are counted on while their number is not known.
_FEWEST_ROWS, _WORKERS = 16, 4


class ClusterRows:
    """Function that computes rows on a cluster, for `Population.run_elsewhere`.

    The table of a batch is removed once it is read. After a run that was stopped, the same batch continues
    from its blocks.

    Args:
        path: the result directory of the search or the analysis.
        cluster: computes the rows; it is left open.
    """

    def __init__(self, path: Path, cluster: Cluster) -> None:
        self._path, self._cluster = path / BATCH, cluster

    def __call__(self, job: Job, on_progress: OnProgress) -> pd.DataFrame:
        began = time.perf_counter()
        block = max(_FEWEST_ROWS, job.design.n_rows // (4 * max(self._cluster.workers.most, _WORKERS)))
        one = job.model_copy(update={"engine": job.engine.model_copy(update={"block": block})})

        def on_job_progress(done: int, total: int, rate: float, fraction: float, note: str) -> None:
            if on_progress is not None:
                on_progress(SweepProgress(done, total, fraction, 0, time.perf_counter() - began))

        name = hashlib.sha256(json.dumps(one.resolved(), sort_keys=True).encode()).hexdigest()[:16]
        # a client that was killed may have left another batch
        for left in self._path.iterdir() if self._path.is_dir() else ():
            if left.name != name:
                shutil.rmtree(left, ignore_errors=True)
        table = load(
            run_job(one, self._path / name, on_progress=on_job_progress, figures=False, cluster=self._cluster)
        )
        shutil.rmtree(self._path)
        return table
