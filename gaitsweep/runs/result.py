"""What a notebook holds of a job that was run: its directory, table and figures."""

from __future__ import annotations

import dataclasses
import json
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from gaitsweep.errors import ArgumentError
from gaitsweep.job import Job, load_job
from gaitsweep.runs.execute import run_job
from gaitsweep.runs.figures import Progress
from gaitsweep.table import load


@dataclasses.dataclass(frozen=True)
class Result:
    """A result directory."""

    path: Path

    @property
    def table(self) -> pd.DataFrame:
        """The table, read anew each time."""
        return load(self.path)

    @property
    def manifest(self) -> dict[str, Any]:
        """Hash, versions, device, timings, counts by status."""
        return json.loads((self.path / "manifest.json").read_text(encoding="utf-8"))

    @property
    def figures(self) -> list[Path]:
        """The figures' files."""
        return sorted((self.path / "figures").glob("*.png"))


def run(
    job: Job | str | Path,
    out: str | Path | None = None,
    *,
    overrides: Sequence[str] = (),
    progress: Progress | None = None,
    strict: bool = False,
) -> Result:
    """Run a job, or what is left of it, and draw its figures.

    Args:
        job: a job, or the path of its YAML file.
        out: the result directory, `results/NAME` by default.
        overrides: settings for a job from a file, such as "run.max_cycles=50".
        progress: called now and then with rows done, rows in all, rows a second, the share done, a remark.
        strict: raise SelfCheckError where a sample of the rows comes out otherwise at half the step.

    Raises:
        SelfCheckError: as above; the table is complete.
        JobError: the job is bad, with a sentence for each thing that is wrong.
        ValueError: overrides of a job that is not read from a file.
        TableError, RunError: the directory is another job's, the disk is full, a device is missing.
    """
    if isinstance(job, Job) and overrides:
        raise ArgumentError(
            "overrides are for a job that is read from a file: build the Job with them instead."
        )
    loaded = job if isinstance(job, Job) else load_job(job, overrides)
    return Result(run_job(loaded, out, progress=progress, tell=warnings.warn, strict=strict))
