"""A job from its file, with `--set key=value` laid over it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from gaitsweep import effort
from gaitsweep.errors import ArgumentError
from gaitsweep.job.schema import Job
from gaitsweep.schema.diagnostics import Diagnostic, JobError, found
from gaitsweep.schema.diagnostics import Path as FieldPath
from gaitsweep.schema.yaml_document import Document, read_document, read_value
from gaitsweep.shipped import job_file


def load_job(path: str | Path, overrides: Sequence[str] = ()) -> Job:
    """The job in a YAML file.

    Args:
        path: the file, or `builtin:NAME` of one that comes with gaitsweep; `config` and the user's own
            modules are found from its folder.
        overrides: "key=value" each, the key dotted (`run.max_cycles=10`), the value YAML; they override the
            file and may add fields that it does not have.

    Raises:
        JobError: all that is wrong, with file and line, or the override, of each.
        ArgumentError: not a path.
    """
    if not isinstance(path, (str, Path)):
        raise ArgumentError(
            f"path is a {type(path).__name__}, but takes the path of a YAML file: of fields in a dictionary "
            "make a job by Job(**fields)."
        )
    path = job_file(path)
    with effort.limited():
        document = laid_over(path, overrides)
        try:
            return Job.model_validate(document.data, context={"folder": path.parent})
        except JobError as error:
            raise document.located(error) from None


def laid_over(path: Path, overrides: Sequence[str]) -> Document:
    """Read a YAML file, with `--set key=value` laid over it; raises JobError."""
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
            [Diagnostic((), "is not read: write --set key=value, such as run.max_cycles=10.", place=origin)]
        )
    value = read_value(text, origin)
    inside = document.data
    for depth, part in enumerate(parts[:-1]):
        if inside.get(part) is None:
            inside[part] = {}
        inside = inside[part]
        if not isinstance(inside, dict):
            text = f"is {found(inside)}, which has no fields to set."
            raise JobError([Diagnostic(parts[: depth + 1], text, place=origin)])
    inside[parts[-1]] = value
    _mark(document, parts, origin)


def _mark(document: Document, parts: FieldPath, origin: str) -> None:
    """From now on the override is where this field, and what it made on the way, is written."""
    inner = [place for place in document.places if place[: len(parts)] == parts]
    for place in inner:
        del document.places[place]
    for length in range(1, len(parts) + 1):
        if document.places.setdefault(parts[:length], origin) == origin:
            document.overridden.append(parts[:length])
