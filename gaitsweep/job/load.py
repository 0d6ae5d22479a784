"""Loading of a job from its file, with overrides (`--set run.max_cycles=10`), or from its run's table."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from gaitsweep import models, near_miss
from gaitsweep.errors import ArgumentError, JobError
from gaitsweep.job.job import Job
from gaitsweep.kinds import RUN_KINDS
from gaitsweep.kinds.atlas import Atlas
from gaitsweep.schema.diagnostics import Diagnostic, clipped, quoted
from gaitsweep.schema.yaml_document import Document, read_document, read_value
from gaitsweep.shipped import job_file


def read_with_overrides(path: Path, overrides: str | Sequence[str]) -> Document:
    """Read a YAML file and apply overrides.

    Args:
        path: the file.
        overrides: texts "key=value" with a dotted key and a YAML value, which override fields of the file or
            add fields to it.

    Raises:
        JobError: the file is not YAML, or an override is not valid.
    """
    document = read_document(path)
    for override in [overrides] if isinstance(overrides, str) else overrides:
        _override(document, override)
    return document


def _override(document: Document, override: str) -> None:
    """Set the field of an override "key=value"; fields that contain it are created as needed."""
    origin = f"--set {clipped(override)}"
    key, equals, written = override.partition("=")
    path = tuple(part.strip() for part in key.split("."))
    if not equals or not all(path):
        text = "is not valid: write --set key=value, such as --set run.max_cycles=10."
        raise JobError([Diagnostic((), text, place=origin)])
    value = read_value(written, origin)
    section = document.data
    for depth, name in enumerate(path[:-1], start=1):
        if section.get(name) is None:
            section[name] = {}
        section = section[name]
        if not isinstance(section, dict):
            text = f"is {quoted(section)} and has no fields to set"
            if isinstance(section, list):
                text += f": write the whole list, {'.'.join(path[:depth])}=[...]"
            raise JobError([Diagnostic(path[:depth], f"{text}.", place=origin)])
    section[path[-1]] = value
    _record_origin(document, path, origin)


def _record_origin(document: Document, path: tuple[str, ...], origin: str) -> None:
    """Make error messages name an override as the place of its field, and of the fields that it created."""
    inner_paths = [inner for inner in document.places if inner[: len(path)] == path]
    for inner in inner_paths:
        del document.places[inner]
    for length in range(1, len(path) + 1):
        if document.places.setdefault(path[:length], origin) == origin:
            document.overridden.append(path[:length])


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


def job_fields(attrs: Mapping[Any, Any]) -> dict[str, Any]:
    """Return the fields of the job that made a table, as stored in its `.attrs`.

    Raises:
        ArgumentError: the table has no job, since it is not read by gs.load or has lost its `.attrs`.
    """
    if not isinstance(fields := attrs.get("job"), dict):
        raise ArgumentError(
            "The table has no job in its .attrs: read it from its directory by gs.load(DIR), or take it from "
            "the result of a run."
        )
    return fields


def stored_job(attrs: Mapping[Any, Any], *, trust: bool = False) -> Job:
    """Return the job that made a table, even if `job.yaml` was edited since.

    Args:
        attrs: the table's `.attrs`.
        trust: whether to import a user's model from the table's directory or the folder named there; see
            `gaitsweep.models.find_of_table`.

    Raises:
        ArgumentError: the table has no job, or is joined of several.
        JobError: the job cannot be read, or its model is not found.
    """
    if "joined" in attrs:
        raise ArgumentError(
            "This table is joined of several results by gs.concat, so no single job makes its rows again: "
            "use one of the results."
        )
    fields = job_fields(attrs)
    try:
        models.find_of_table(attrs, trust=trust)
    except models.ModelError as error:
        raise JobError([Diagnostic(("model",), str(error))]) from error
    run = dict(fields["run"])
    # a field that is refused beside the others now was allowed when the table was made, and had no effect
    idle = RUN_KINDS[run["kind"]].idle(run) if run.get("kind") in RUN_KINDS else set()
    fields = {**fields, "run": {name: value for name, value in run.items() if name not in idle}}
    return Job.model_validate(fields)


def wider_job(attrs: Mapping[Any, Any], *, trust: bool = False) -> Job:
    """Return the job of an atlas with twice the starts and one bifurcation more than that of a table.

    Args:
        attrs, trust: as for `stored_job`, whose errors it raises.

    Raises:
        ArgumentError: another kind of run made the table.
    """
    job = stored_job(attrs, trust=trust)
    if not isinstance(job.run, Atlas):
        raise ArgumentError(f"This table is of a run of the kind {job.run.kind_name}, but must be an atlas.")
    return job.model_copy(update={"run": job.run.wider()})
