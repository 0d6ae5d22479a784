"""The job that made a table, as its run wrote it, and the parameters of its rows."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jax.numpy as jnp

from gaitsweep.job.plan import Plan
from gaitsweep.job.schema import Job

# The field of a manifest with the folder from which a user's model was imported.
MODEL_FOLDER = "model_folder"


def stored_job(attrs: Mapping[Any, Any]) -> Job:
    """The job that made a table, whatever `job.yaml` says by now.

    A user's model is looked for where its run found it, then in the table's directory and where Python runs.

    Args:
        attrs: the table's `.attrs`.

    Raises:
        JobError: the job cannot be read, or its model is not found.
    """
    given = attrs.get("manifest", {}).get(MODEL_FOLDER)
    folder = given if isinstance(given, str) and Path(given).is_dir() else attrs.get("path", ".")
    return Job.model_validate(attrs["job"], context={"folder": Path(folder)})


def row_params(plan: Plan, row: int) -> Any:
    """The frozen pytree of parameters that a row of a job ran with.

    Args:
        plan: the job's rows.
        row: its number.

    Raises:
        IndexError: the job does not have this row.
    """
    values, _ = plan.values(row, row + 1)
    return plan.model.params(
        {name: jnp.asarray(value[0]) for name, value in plan.model.on_host(values).items()}
    )
