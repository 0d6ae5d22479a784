"""Conversion of a model and keywords to a job: arrays are axes, which multiply; numbers are constants."""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeGuard

import numpy as np
from pydantic import BaseModel

from gaitsweep import models, near_miss
from gaitsweep.contract import Model, Quantity
from gaitsweep.errors import ArgumentError
from gaitsweep.expression import VARY_GROUPS
from gaitsweep.job import Job
from gaitsweep.job.model_spec import ModelSpec, read_model_spec
from gaitsweep.schema.strict_model import plain
from gaitsweep.shipped import BUILTIN

AnyModel = Model | type[Model] | str
# Keywords of the API's functions. A quantity with such a name is set by `params={}` or `start={}`.
RESERVED = ("out", "engine", "numerics", "params", "start", "verify", "client", "run")


def job_of(model: AnyModel, values: Mapping[str, Any], **fields: Any) -> Job:
    """Return the job that runs a model with these keywords; the arguments are those of `fields_of`.

    Raises:
        ArgumentError: a name that the model does not have, or an array of several dimensions.
        JobError: all other errors of the job.
    """
    return Job.model_validate(fields_of(model, values, **fields))


def fields_of(
    model: AnyModel,
    values: Mapping[str, Any],
    *,
    run: BaseModel | Mapping[str, Any],
    params: Mapping[str, Any] | None = None,
    start: Mapping[str, Any] | None = None,
    any_start: bool = False,
    **fields: Any,
) -> dict[str, Any]:
    """Return the fields of the job that runs a model with these keywords.

    Args:
        model: an instance, a class, a registered name, or "package.module:attribute".
        values: by the name of a parameter or start value: a constant (number or formula), an axis (a list, a
            one-dimensional array, or a mapping as under `vary` of a job file), or one of `zip` and `sample`
            with a group as in a job file.
        run: a run kind, or its fields.
        params, start: constants and axes by name, whatever the names are.
        any_start: give a value within its bounds to each start that has neither a value nor a default.
        fields: other fields of the job; `engine` may be its name alone.

    Raises:
        ArgumentError: a name that the model does not have, or an array of several dimensions.
    """
    if isinstance(fields.get("engine"), str):
        fields["engine"] = {"name": fields["engine"]}
    settings = _merged(values, params=params, start=start)
    name, structure = _name_and_structure(model, settings)
    spec, diagnostics = read_model_spec(name, structure, None, [], run)
    if spec is None or diagnostics:
        raise ArgumentError("\n".join(map(str, diagnostics)))
    vary: dict[str, Any] = {}
    constants: dict[str, dict[str, Any]] = {"params": {}, "start": {}}
    for key, value in settings.items():
        if key in structure:
            continue
        if key not in VARY_GROUPS:
            _check_name(key, spec)
        if key in VARY_GROUPS or _is_axis(key, value):
            vary[key] = plain(value)
        else:
            constants["params" if key in spec.parameters else "start"][key] = plain(value)
    if any_start:
        for key, quantity in spec.starts.items():
            if key not in settings and quantity.default is None:
                constants["start"][key] = _allowed(quantity)
    return {
        "name": re.sub(r"\W", "_", spec.model.name) or "model",
        "model": name,
        "structure": structure,
        **constants,
        "vary": vary,
        "run": run,
        **{key: value for key, value in fields.items() if value is not None},
    }


def _merged(values: Mapping[str, Any], **sections: Mapping[str, Any] | None) -> dict[str, Any]:
    """The keywords with those of `params` and `start`; refuses a name that is given twice."""
    settings = dict(values)
    for section, more in sections.items():
        if not isinstance(more, Mapping | None):
            raise ArgumentError(
                f"{section} is a {type(more).__name__}, but must be a mapping of names to values."
            )
        for name, value in (more or {}).items():
            if name in settings:
                raise ArgumentError(f"{name} is given twice, once in {section}.")
            settings[name] = value
    return settings


def is_job(model: object) -> TypeGuard[str | Path | Mapping[str, Any]]:
    """Return whether this is a job (its file, the name of a shipped one or its fields), not a model."""
    if isinstance(model, Path | Mapping):
        return True
    return isinstance(model, str) and (model.endswith((".yaml", ".yml")) or model.startswith(BUILTIN))


def refuse_beside_a_job(job: str | Path | Mapping[str, Any], keywords: Mapping[str, Any]) -> None:
    """Refuse keywords that are not None beside a job, which has them as fields.

    Args:
        job: the job's file, or its fields.
        keywords: the keywords.

    Raises:
        ArgumentError: a keyword is not None.
    """
    stray = next((name for name, value in keywords.items() if value is not None), None)
    if stray is None:
        return
    if isinstance(job, Mapping):
        raise ArgumentError(f"{stray} is one of the job's fields: change it there.")
    raise ArgumentError(f"{stray} is a field of the job file {job}: change it there, or by overrides.")


def fields_without_axes(
    model: AnyModel, values: Mapping[str, Any], ranges: str, **fields: Any
) -> dict[str, Any]:
    """Return the fields of a job as `fields_of` does, where only the keyword `ranges` may vary.

    Raises:
        ArgumentError: as `fields_of`, or an axis.
    """
    job_fields = fields_of(model, values, **fields)
    axes = job_fields.pop("vary")
    if axes:
        raise ArgumentError(f"{next(iter(axes))} is an axis, but takes a number: give ranges as {ranges}=.")
    return job_fields


def _name_and_structure(model: AnyModel, settings: Mapping[str, Any]) -> tuple[str, dict[str, Any]]:
    """Return the name of a model, and its structure: that of an instance, else that among the keywords."""
    if isinstance(model, str):
        name = model
    elif isinstance(model, Model):
        name = models.name_of(type(model))
    elif isinstance(model, type) and issubclass(model, Model):
        name = models.name_of(model)
    else:
        raise ArgumentError(f"A model is an instance, a class or a name, not {type(model).__name__}.")
    fields = _structure_names(name)
    among_keywords = {field: value for field, value in settings.items() if field in fields}
    if not isinstance(model, Model):
        return name, among_keywords
    for field in among_keywords:
        raise ArgumentError(f"{field} shapes the model: give it to {type(model).__name__}, not here.")
    return name, {field: getattr(model, field) for field in fields}


def _structure_names(name: str) -> list[str]:
    """Return the names of the structure of a model; refuses one that is not found or no dataclass."""
    try:
        model_class = models.find(name)
    except models.ModelError as error:
        raise ArgumentError(error.sentence) from None
    if not dataclasses.is_dataclass(model_class):
        raise ArgumentError(
            f"The model {model_class.__name__} is not a dataclass: write @dataclass(frozen=True)."
        )
    return [field.name for field in dataclasses.fields(model_class) if field.init]


def _check_name(name: str, spec: ModelSpec) -> None:
    """Refuse a name that is neither a parameter nor a start value of a model."""
    if name in spec.quantities:
        return
    if name in RESERVED:
        raise ArgumentError(f"{name} is a reserved keyword, which this function does not take.")
    near = near_miss.suggestion(name, spec.quantities)
    raise ArgumentError(f"{name} is neither a parameter nor a start value of {spec.model.name}{near}")


def _allowed(quantity: Quantity) -> float:
    """Return a value within the bounds of a quantity."""
    low, high = quantity.low, quantity.high
    if math.isfinite(low):
        return 0.5 * (low + high) if math.isfinite(high) else low + 1.0
    return high - 1.0 if math.isfinite(high) else 0.0


def _is_axis(name: str, value: Any) -> bool:
    """Return whether a value is an axis and not a constant; refuses arrays of several dimensions."""
    if isinstance(value, Mapping | list | tuple | range):
        return True
    dimensions = np.ndim(value)
    if dimensions > 1:
        raise ArgumentError(f"{name} has {dimensions} dimensions, but an axis is a list of numbers.")
    return dimensions == 1
