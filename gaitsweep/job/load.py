"""Loading of a job from its file, with the overrides of `--set key=value`, or from the table of its run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import jax.numpy as jnp

from gaitsweep import effort, models
from gaitsweep.design.design import Design
from gaitsweep.errors import ArgumentError
from gaitsweep.job.job import Job
from gaitsweep.schema.diagnostics import Diagnostic, JobError, found
from gaitsweep.schema.diagnostics import Path as FieldPath
from gaitsweep.schema.yaml_document import Document, read_document, read_value
from gaitsweep.shipped import job_file


def load_job(path: str | Path, overrides: Sequence[str] = ()) -> Job:
    """Load the job in a YAML file.

    Args:
        path: the file, or `builtin:NAME` for one that comes with gaitsweep; `config` and the user's modules
            are found relative to its folder.
        overrides: texts "key=value" with a dotted key and a YAML value (`run.max_cycles=10`), which override
            fields of the file or add fields to it.

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
    with effort.limited():
        document = laid_over(path, overrides)
        try:
            return Job.model_validate(document.data, context={"folder": path.parent})
        except JobError as error:
            raise document.located(error) from None


def laid_over(path: Path, overrides: Sequence[str]) -> Document:
    """Read a YAML file and apply the overrides `key=value`; raises JobError."""
    document = read_document(path)
    for override in overrides:
        _lay_over(document, override)
    return document


def _lay_over(document: Document, override: str) -> None:
    origin = f"--set {override if len(override) <= 60 else f'{override[:57]}...'}"
    key, equals, text = override.partition("=")
    parts = tuple(part.strip() for part in key.split("."))
    if not equals or not all(parts):
        raise JobError(
            [
                Diagnostic(
                    (), "is not valid: write --set key=value, such as --set run.max_cycles=10.", place=origin
                )
            ]
        )
    value = read_value(text, origin)
    inside = document.data
    for depth, part in enumerate(parts[:-1]):
        if inside.get(part) is None:
            inside[part] = {}
        inside = inside[part]
        if not isinstance(inside, dict):
            text = f"is {found(inside)} and has no fields to set."
            raise JobError([Diagnostic(parts[: depth + 1], text, place=origin)])
    inside[parts[-1]] = value
    _mark(document, parts, origin)


def _mark(document: Document, parts: FieldPath, origin: str) -> None:
    """Note the override as the place of this field and of those that it created."""
    inner = [place for place in document.places if place[: len(parts)] == parts]
    for place in inner:
        del document.places[place]
    for length in range(1, len(parts) + 1):
        if document.places.setdefault(parts[:length], origin) == origin:
            document.overridden.append(parts[:length])


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
