"""The job of a table, as stored by its run, and the parameters of its rows."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import jax.numpy as jnp

from gaitsweep import models
from gaitsweep.design.design import Design
from gaitsweep.job.schema import Job
from gaitsweep.schema.diagnostics import Diagnostic, JobError


def stored_job(attrs: Mapping[Any, Any], trust: bool = False) -> Job:
    """The job that made a table, even if `job.yaml` was edited since.

    Args:
        attrs: the table's `.attrs`.
        trust: whether to import a user's model from the table's directory or the folder named there; see
            `gaitsweep.models.find_of_table`.

    Raises:
        JobError: the job cannot be read, or its model is not found.
    """
    try:
        models.find_of_table(attrs, trust)
    except models.ModelError as error:
        raise JobError([Diagnostic(("model",), str(error))]) from error
    return Job.model_validate(attrs["job"])


def row_params(design: Design, row: int) -> Any:
    """The frozen pytree of parameters of a row.

    Args:
        design: the job's rows.
        row: its number.

    Raises:
        IndexError: the job does not have this row.
    """
    values, _ = design.values(row, row + 1)
    return design.model.params(
        {name: jnp.asarray(value[0]) for name, value in design.model.on_host(values).items()}
    )
