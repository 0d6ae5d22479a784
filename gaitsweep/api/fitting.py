"""`gs.search`: constants of a model that meet targets."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from gaitsweep.fitting.search import Found, run_search
from gaitsweep.fitting.search_job import load_search, read_search
from gaitsweep.runs.progress import progress_lines


def search(job: str | Path | Mapping[str, Any], out: str | Path | None = None) -> Found:
    """Search constants that meet targets, or go on with a search that was stopped.

    Args:
        job: a YAML file, or its fields: those of a job without `vary`, and `search` with `free`, `targets`,
            `method`, `budget`, `seed`.
        out: the result directory; `results/NAME` by default.

    Returns:
        The table of all sets, the near-best ones, and which constants the targets pin.

    Raises:
        JobError: all that is wrong with the job.
        RunError, TableError: it cannot run here, or the directory cannot be used.
    """
    read = load_search(job) if isinstance(job, str | Path) else read_search(job, Path.cwd())
    return run_search(read, out, progress=progress_lines("sets"))
