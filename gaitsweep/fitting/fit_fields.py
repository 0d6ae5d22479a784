"""Readers of the fields that searches and sensitivity analyses share: constants, measures, settings."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

from gaitsweep import near_miss
from gaitsweep.errors import JobError
from gaitsweep.fitting.free_parameters import FreeParameter
from gaitsweep.fitting.measure import Measure
from gaitsweep.fitting.ramp_measures import GaitSequence, Transition
from gaitsweep.fitting.row_measures import (
    Coexistence,
    Edge,
    Failures,
    FixedPoint,
    Order,
    Prominence,
    Share,
    Value,
)
from gaitsweep.job.load import read_with_overrides
from gaitsweep.kinds.run_kind import RunKind
from gaitsweep.schema.diagnostics import Diagnostic, quoted, unknown_field, wrong_kind
from gaitsweep.schema.diagnostics import Path as FieldPath
from gaitsweep.schema.strict_model import Registry, SchemaSection, StrictModel, kind_of, read_model
from gaitsweep.shipped import job_file

T = TypeVar("T", bound=StrictModel)
R = TypeVar("R")
# Measures of targets and outputs by their kind.
MEASURES: Registry[Measure] = Registry(
    "measure",
    [Value, Edge, Share, Coexistence, Order, Prominence, Failures, FixedPoint, Transition, GaitSequence],
)


def by_name(value: Any, takes: str, path: FieldPath, wrong: list[Diagnostic]) -> Iterator[tuple[str, Any]]:
    """Yield the names and entries of a field that takes entries by name.

    Args:
        value: what is written in the field.
        takes: what the field takes, for the message.
        path: where the field stands.
        wrong: receives an error if the field has no entries by name.
    """
    if isinstance(value, Mapping) and value:
        for name, entry in value.items():
            yield str(name), entry
    else:
        begin = "is missing: it" if value is None else f"is {quoted(value)}, but"
        wrong.append(Diagnostic(path, f"{begin} takes {takes}."))


def read_free(value: Any, path: FieldPath, wrong: list[Diagnostic]) -> dict[str, FreeParameter]:
    """Read the free constants of a search.

    Args:
        value: what is written in the field `free`.
        path: where the field stands.
        wrong: receives an error for each constant that is not read, and for a field without constants.

    Returns:
        Those without errors, by name.
    """
    free = {}
    for name, written in by_name(value, "constants by name, such as kappa: {low: 1, high: 2}", path, wrong):
        if isinstance(written, list) and len(written) == 2:
            fields: Any = {"low": written[0], "high": written[1]}
        else:
            fields = written
        if not isinstance(fields, Mapping):
            allowed = near_miss.allowing(FreeParameter.model_fields)
            text = f"is {quoted(written)}, but takes [low, high], or fields. {allowed}"
            wrong.append(Diagnostic((*path, name), text))
            continue
        if (parameter := read_model(FreeParameter, fields, (*path, name), wrong)) is not None:
            free[name] = parameter
    return free


def read_measure(
    value: Any, path: FieldPath, wrong: list[Diagnostic], beside: type[StrictModel] | None = None
) -> Measure | None:
    """Read the measure of an output or a target.

    Args:
        value: what is written.
        path: where it stands.
        wrong: receives an error for each field that is not read.
        beside: a model whose fields are written beside those of the measure; messages name them as allowed.

    Returns:
        The measure, or None if it has errors of its own.
    """
    if (bad := wrong_kind(path, value, MEASURES)) is not None:
        wrong.append(bad)
        return None
    kind = value["kind"]
    measure = MEASURES[kind]
    own_fields = SchemaSection("", measure).fields
    fields_beside = () if beside is None else SchemaSection("", beside).fields
    allowed = [*own_fields, *fields_beside]
    unknown = [key for key in value if key not in own_fields]
    wrong.extend(unknown_field((*path, str(key)), f"a measure ({kind})", allowed) for key in unknown)
    fields = {key: entry for key, entry in value.items() if key in own_fields}
    if "run" in fields:
        if (run := _read_run(measure, fields["run"], (*path, "run"), wrong)) is None:
            return None
        fields["run"] = run
    return read_model(measure, fields, path, wrong)


def _read_run(measure: type[Measure], value: Any, path: FieldPath, wrong: list[Diagnostic]) -> RunKind | None:
    """Read the run of a measure of this kind; errors are added to `wrong`."""
    kinds = {kind_of(run): run for run in measure.runs}
    if not isinstance(value, Mapping):
        text = f"is {quoted(value)}, but takes fields, kind among them: {' or '.join(kinds)}."
        wrong.append(Diagnostic(path, text))
        return None
    default_kind = next(iter(kinds)) if len(kinds) == 1 else None
    kind = value.get("kind", default_kind)
    if not isinstance(kind, str) or kind not in kinds:
        begin = "is missing" if kind is None else f"is {quoted(kind)}"
        text = f"{begin}, but the run of a measure ({kind_of(measure)}) is {' or '.join(kinds)}."
        wrong.append(Diagnostic((*path, "kind"), text))
        return None
    if value.get("refine") is not None:
        wrong.append(Diagnostic((*path, "refine"), "has no place in the run of a measure: take it out."))
        return None
    return read_model(kinds[kind], value, path, wrong)


def name_errors(name: str, is_taken: bool, path: FieldPath) -> list[Diagnostic]:
    """Check the name of a target or an output, which is a column of the table; return the diagnostics.

    Args:
        name: the name.
        is_taken: whether another column has it.
        path: where it stands.
    """
    if not name.isidentifier():
        return [Diagnostic(path, "is no name of letters, digits and _ that begins with a letter.")]
    return [Diagnostic(path, "is the name of another column of the table: take another.")] if is_taken else []


def read_settings(
    settings: type[T],
    field: str,
    other_fields: Sequence[str],
    written: Mapping[str, Any],
    wrong: list[Diagnostic],
) -> T | None:
    """Read the settings of a search or an analysis, which stand in one field beside others.

    Args:
        settings: the class of the settings.
        field: name of the field.
        other_fields: fields written beside the settings, which others read.
        written: what is written in the field.
        wrong: receives an error for each setting that is not read.

    Returns:
        The settings, or None if one of them is wrong.
    """
    allowed = [*other_fields, *settings.model_fields]
    wrong.extend(unknown_field((field, str(key)), field, allowed) for key in written if key not in allowed)
    own_fields = {key: value for key, value in written.items() if key in settings.model_fields}
    return read_model(settings, own_fields, (field,), wrong)


def read_file(path: str | Path, overrides: Sequence[str], read: Callable[[Any, Path], R]) -> R:
    """Read a search or an analysis from a YAML file.

    Args:
        path: the file, or the name of a job shipped with the package.
        overrides: values that replace those of the file, as `field=value`.
        read: reads the file's data; its second argument is the folder to which paths in them are relative.

    Returns:
        What `read` returns.

    Raises:
        JobError: what `read` refuses, with file and line.
    """
    path = job_file(path)
    with near_miss.limited_effort():
        document = read_with_overrides(path, overrides)
        try:
            return read(document.data, path.parent)
        except JobError as error:
            raise document.located(error) from None
