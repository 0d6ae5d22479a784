"""Model of a job, its structure, and the parameters and starts that the job sets."""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Mapping, Sequence
from pathlib import Path as FilePath
from typing import Any, Literal

from pydantic import BaseModel

from gaitsweep import models, near_miss
from gaitsweep.contract import Model, Quantity, SteppedModel
from gaitsweep.dynamics.ground import KINDS, asks_for_ground, check_ground, ground_profile
from gaitsweep.engine.devices import refuse_missing_platform
from gaitsweep.errors import ArgumentError
from gaitsweep.expression import RESERVED
from gaitsweep.kinds import kind_written
from gaitsweep.models.conformity import fault
from gaitsweep.schema.diagnostics import Diagnostic, Path, quoted
from gaitsweep.schema.numbers import (
    InvalidValue,
    read_flag,
    read_number,
    read_real,
    read_text,
    read_whole,
    read_word,
)

Section = Literal["params", "start", "vary"]
_LARGEST_SIZE = 10**6  # a whole number of the structure whose field has no limits is from 1 to this


@dataclasses.dataclass(frozen=True)
class ModelSpec:
    """An instance of a model with its structure, and the quantities that a job may set, by name."""

    model: Model
    structure: dict[str, Any]

    @functools.cached_property
    def parameters(self) -> dict[str, Quantity]:
        """Parameters by name."""
        return {quantity.name: quantity for quantity in self.model.parameters}

    @functools.cached_property
    def starts(self) -> dict[str, Quantity]:
        """Start values by name."""
        return {quantity.name: quantity for quantity in self.model.initial_conditions}

    @property
    def quantities(self) -> dict[str, Quantity]:
        """Parameters, then starts, by name."""
        return {**self.parameters, **self.starts}

    @property
    def sizes(self) -> dict[str, float]:
        """Numbers of the structure, which expressions may use: {"N": 3.0}."""
        items = self.structure.items()
        return {name: float(value) for name, value in items if isinstance(value, (int, float))}

    @property
    def resolved_structure(self) -> dict[str, Any]:
        """Structure in a resolved job, without fields marked `later` that have their default.

        Fields that were added to a model later thus change neither the hash nor the manifest of older jobs.
        """
        left_out = {
            field.name
            for field in dataclasses.fields(self.model.original)  # type: ignore[arg-type]
            if field.metadata.get("later") and self.structure.get(field.name) == _default(field)
        }
        return {name: value for name, value in self.structure.items() if name not in left_out}

    def unknown(self, name: str, field: Section) -> str | None:
        """Return the reason why a name is not allowed in a section, or None.

        Args:
            name: the name.
            field: the section.
        """
        allowed = {"params": self.parameters, "start": self.starts, "vary": self.quantities}[field]
        if name in allowed:
            return None
        if name in self.structure:
            cannot = "cannot vary" if field == "vary" else "cannot be a start value"
            place = "as ground: KIND" if name == "ground" else "under structure or params"
            return f"is part of the structure and {cannot}: set it {place}, in one job for each value."
        if name in self.quantities:
            noun, other = ("start value", "start") if field == "params" else ("parameter", "params")
            return f"is a {noun} of {self.model.name}: write it under {other}."
        nouns = {"params": "a parameter", "start": "a start value", "vary": "a parameter or start value"}
        return f"is not {nouns[field]} of {self.model.name}{near_miss.suggestion(name, allowed)}"


def read_model_spec(
    name: Any, structure: Any, params: Any, folders: Sequence[FilePath], run: Any = None, ground: Any = None
) -> tuple[ModelSpec | None, list[Diagnostic]]:
    """Read the model that a job names, with the structure that `structure` and `params` set.

    Args:
        name, structure, params: these fields of the job as written.
        folders: folders with the user's modules.
        run: the run as written, or a run kind; it may add parameters to the model.
        ground: the ground as written: a kind, or {"file": a path relative to the first of `folders`}.

    Returns:
        The spec, or None if there are errors; and the diagnostics.
    """
    try:
        model_class = models.find(read_text(name), folders)
    except (models.ModelError, InvalidValue) as error:
        return None, [Diagnostic(("model",), str(error))]
    if structure is not None and not isinstance(structure, Mapping):
        text = f"is {quoted(structure)}, but must be a mapping of names to values (name: value)."
        return None, [Diagnostic(("structure",), text)]
    fields = {field.name: field for field in dataclasses.fields(model_class) if field.init}  # type: ignore[arg-type]
    # the values of structural fields with their paths, in the order in which they take effect
    written: list[tuple[Path, str, Any]] = []
    written += [(("structure", key), key, value) for key, value in _items(structure)]
    written += [(("params", key), key, value) for key, value in _items(params) if key in fields]
    diagnostics: list[Diagnostic] = []
    if ground is not None:
        if "ground" in fields:
            written.append((("ground",), "ground", ground))
        else:
            lacks = "does not ask for the height of the ground: remove it."
            if issubclass(model_class, SteppedModel):
                lacks = (
                    "moves in steps, which meet the ground of their own: remove it, or take located contacts "
                    "(dynamics: located in a model file, BodyModel in Python)."
                )
            text = f"is {quoted(ground)}, but {name} {lacks}"
            diagnostics.append(Diagnostic(("ground",), text))
    shape = _read_structure(str(name), model_class, fields, written, folders, diagnostics)
    if diagnostics:
        return None, diagnostics
    spec, diagnostics = _instance(str(name), model_class, shape)
    return (None, diagnostics) if spec is None else _with_run(spec, run)


def _read_structure(
    name: str,
    model_class: type[Model],
    fields: Mapping[str, dataclasses.Field],
    written: Sequence[tuple[Path, str, Any]],
    folders: Sequence[FilePath],
    diagnostics: list[Diagnostic],
) -> dict[str, Any]:
    """Read the structure of a model.

    Args:
        name: name of the model.
        model_class: its class.
        fields: the fields of its structure.
        written: path, field and value of what the job sets.
        folders: as for `read_model_spec`.
        diagnostics: those of the job, to which errors are added.

    Returns:
        The values of all fields, including the defaults.
    """
    shape: dict[str, Any] = {key: _default(field) for key, field in fields.items()}
    first_values: dict[str, Any] = {}
    for path, key, value in written:
        if key not in fields:
            text = f"is not part of the structure of {name}{near_miss.suggestion(str(key), fields)}"
            diagnostics.append(Diagnostic(path, text))
            continue
        try:
            if key == "ground" and asks_for_ground(model_class):
                shape[key] = _read_ground(value, folders)
            else:
                shape[key] = _read_size(value, fields[key])
        except InvalidValue as error:
            diagnostics.append(Diagnostic(path, str(error)))
            continue
        first = first_values.setdefault(key, shape[key])
        if first != shape[key]:
            text = f"is {quoted(value)}, but structure.{key} is {quoted(first)}: remove one of the two."
            diagnostics.append(Diagnostic(path, text))
    for key, value in shape.items():
        if value is dataclasses.MISSING:
            text = f"is missing: {name} has no default for {key}."
            diagnostics.append(Diagnostic(("structure", key), text))
    return shape


def _with_run(spec: ModelSpec, run: Any) -> tuple[ModelSpec, list[Diagnostic]]:
    """Return the model with the parameters that a run adds, and the diagnostics."""
    written = run.model_dump() if isinstance(run, BaseModel) else run
    kind = kind_written(written)
    if kind is None:
        return spec, []
    model, diagnostics = kind.model_of(spec.model, written)
    return dataclasses.replace(spec, model=model), diagnostics


def _items(mapping: Any) -> list[tuple[str, Any]]:
    """Return the items of a section as written; none if it is not a mapping."""
    if not isinstance(mapping, Mapping):
        return []
    return [(str(key), value) for key, value in mapping.items()]


def _default(field: dataclasses.Field) -> Any:
    """Return the default of a field of the structure, or `dataclasses.MISSING`."""
    if field.default_factory is not dataclasses.MISSING:
        return field.default_factory()
    return field.default


def _read_size(value: Any, field: dataclasses.Field) -> bool | str | float:
    """Read the value of a field of the structure, by its type; raises InvalidValue."""
    # annotations may be text, whose other names need not exist while a program runs (TYPE_CHECKING)
    hint = str(getattr(field.type, "__name__", field.type)).removesuffix(" | None")
    low = field.metadata.get("low")
    high = field.metadata.get("high")
    match hint:
        case "bool":
            return read_flag(value)
        case "str":
            text = read_text(value)
            allowed = field.metadata.get("allowed")
            return text if allowed is None else read_word(text, allowed)
        case "float":
            return read_real(value, -math.inf if low is None else low, math.inf if high is None else high)
        case "int":
            return read_whole(value, 1 if low is None else low, _LARGEST_SIZE if high is None else high)
    raise InvalidValue(f"has the type {hint}, but a job can set only fields of type bool, int, float or str.")


def _read_ground(value: Any, folders: Sequence[FilePath]) -> str:
    """Read a kind of ground, or the profile in a file; raises InvalidValue."""
    allowed = f"must be {', '.join(KINDS)}, or {{file: PATH}} with the path of a CSV file"
    if isinstance(value, Mapping):
        if list(value) != ["file"] or not isinstance(value["file"], str):
            raise InvalidValue(f"is {quoted(value)}, but {allowed}.")
        try:
            return ground_profile((folders[0] if folders else FilePath()) / value["file"])
        except ArgumentError as error:
            raise InvalidValue(f"names a file: {error}") from None
    if not isinstance(value, str):
        raise InvalidValue(f"is {quoted(value)}, but {allowed}.")
    try:
        return check_ground(value)
    except ArgumentError as error:
        raise InvalidValue(str(error).removeprefix("ground ")) from None


def _instance(
    name: str, model_class: type[Model], shape: dict[str, Any]
) -> tuple[ModelSpec | None, list[Diagnostic]]:
    """Return the spec of a model with this structure, or None, and the diagnostics."""
    refuse_missing_platform()  # a model's constants are arrays of JAX
    try:
        spec = ModelSpec(model_class(**shape), shape)
        names = [*spec.parameters, *spec.starts, *shape]
    except Exception as error:  # a user's model may refuse its structure in any way
        return None, [Diagnostic(("structure",), f"is not accepted by {name}: {str(error).rstrip('.')}.")]
    for quantity in names:
        if quantity in RESERVED:
            text = f"is {name}, which has a quantity named {quantity}, which is reserved: rename it."
            return None, [Diagnostic(("model",), text)]
        if names.count(quantity) > 1:
            return None, [Diagnostic(("model",), f"is {name}, which has {quantity} twice: rename it.")]
    if name not in models.names() and (wrong := fault(spec.model)) is not None:
        return None, [Diagnostic(("model",), f"is {name}, {wrong}")]
    return spec, []


def read_settings(
    raw: Any, field: Literal["params", "start"], spec: ModelSpec
) -> tuple[dict[str, float | str], list[Diagnostic]]:
    """Read the numbers and formulas of a section, without the structure.

    Args:
        raw: the section as written.
        field: the section.
        spec: the model.

    Returns:
        The settings by name, and the diagnostics.
    """
    if raw is None:
        return {}, []
    if not isinstance(raw, Mapping):
        text = f"is {quoted(raw)}, but must be a mapping of names to numbers (name: number)."
        return {}, [Diagnostic((field,), text)]
    settings: dict[str, float | str] = {}
    diagnostics: list[Diagnostic] = []
    for key, value in raw.items():
        name = str(key)
        path: Path = (field, name)
        if field == "params" and name in spec.structure:
            continue
        if (reason := spec.unknown(name, field)) is not None:
            diagnostics.append(Diagnostic(path, reason))
            continue
        try:
            settings[name] = _read_setting(value, spec.quantities[name])
        except InvalidValue as error:
            diagnostics.append(Diagnostic(path, str(error)))
    return settings, diagnostics


def _read_setting(value: Any, quantity: Quantity) -> float | str:
    """Read the number or the formula that a job sets for a quantity; raises InvalidValue."""
    is_switch = quantity.low == 0.0 and quantity.high == 1.0 and not quantity.open_ends
    if is_switch and isinstance(value, bool):
        return float(value)
    if is_switch and isinstance(value, str) and value.lower() in ("yes", "no", "on", "off"):
        raise InvalidValue(f"is {quoted(value)}, but must be true, false or a number from 0 to 1.")
    if isinstance(value, (list, tuple, Mapping)):
        raise InvalidValue(f"is {quoted(value)}, but must be one number; lists and axes belong under vary.")
    setting = read_number(value)
    default = quantity.default
    # the model's own formula keeps its text, of which the job's hash is made
    if isinstance(setting, str) and isinstance(default, str) and setting == read_number(default):
        return default
    return setting
