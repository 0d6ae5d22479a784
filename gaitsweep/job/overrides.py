"""Overrides of a job file's fields, as by `--set run.max_cycles=10` on the command line."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from gaitsweep.schema.diagnostics import Diagnostic, JobError, clipped, quoted
from gaitsweep.schema.yaml_document import Document, read_document, read_value


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
