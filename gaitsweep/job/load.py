"""Loading of a job from its file, or from the table of its run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from gaitsweep import models, near_miss
from gaitsweep.errors import ArgumentError
from gaitsweep.job.job import Job
from gaitsweep.job.overrides import read_with_overrides
from gaitsweep.kinds.atlas import Atlas
from gaitsweep.schema.diagnostics import Diagnostic, JobError
from gaitsweep.shipped import job_file


def load_job(path: str | Path, overrides: Sequence[str] = ()) -> Job:
    """Load the job in a YAML file.

    Args:
        path: the file, or `builtin:NAME` for one that comes with gaitsweep; `config` and the user's modules
            are found relative to its folder.
        overrides: texts "key=value" with a dotted key and a YAML value, such as "run.max_cycles=10", which
            override fields of the file or add fields to it.

    Raises:
        JobError: all errors, each with its file and line or its override.
        ArgumentError: `path` is not a path.
    """
    if not isinstance(path, (str, Path)):
        raise ArgumentError(
            f"path is a {type(path).__name__}, but must be the path of a YAML file; use Job(**fields) to "
            "create a job from a dictionary."
        )
    path = job_file(path)
    with near_miss.limited_effort():
        document = read_with_overrides(path, overrides)
        try:
            return Job.model_validate(document.data, context={"folder": path.parent})
        except JobError as error:
            raise document.located(error) from None


def stored_job(attrs: Mapping[Any, Any], *, trust: bool = False) -> Job:
    """Return the job that made a table, even if `job.yaml` was edited since.

    Args:
        attrs: the table's `.attrs`.
        trust: whether to import a user's model from the table's directory or the folder named there; see
            `gaitsweep.models.find_of_table`.

    Raises:
        ArgumentError: the table is joined of several.
        JobError: the job cannot be read, or its model is not found.
    """
    if "joined" in attrs:
        raise ArgumentError(
            f"This table is joined of {attrs['joined']} results by gs.concat, so no single job makes its "
            "rows again: use one of the results."
        )
    try:
        models.find_of_table(attrs, trust=trust)
    except models.ModelError as error:
        raise JobError([Diagnostic(("model",), str(error))]) from error
    return Job.model_validate(attrs["job"])


def wider_job(table: pd.DataFrame, *, trust: bool = False) -> Job:
    """Return the job of an atlas that continues the one that made a table.

    Args:
        table: the table, with its `.attrs`.
        trust: as for `stored_job`.

    Raises:
        ArgumentError: another kind of run made the table, or it is not complete.
        JobError: as for `stored_job`.
    """
    job = stored_job(table.attrs, trust=trust)
    if not isinstance(job.run, Atlas):
        raise ArgumentError(f"This table is of a run of the kind {job.run.kind_name}, but must be an atlas.")
    if missing := table.attrs.get("rows_missing"):
        raise ArgumentError(f"This table lacks {missing} rows: run its job again before you continue it.")
    return job.model_copy(update={"run": job.run.wider(table)})
