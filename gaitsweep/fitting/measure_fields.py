"""Fields that measures of sets of constants share, and the checks of their names."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Annotated, Any

import numpy as np
from pydantic import Field, PlainValidator, WithJsonSchema

from gaitsweep import near_miss
from gaitsweep.contract import Model, names_gait
from gaitsweep.expression import ExpressionError, names_used
from gaitsweep.schema.numbers import InvalidValue, checked, read_real, read_text

MOST_CONDITIONS = 10_000  # rows of one measure

# A field and the end of a sentence that says what is wrong with it; None if all is valid.
FieldError = tuple[str, str] | None

# Columns of names, and the row's number, which have no mean.
_NOT_NUMERIC = ("row", "status", "stalled_by", "slowest")


def _read_conditions(value: Any) -> dict[str, tuple[float, ...]]:
    """Read the values of each condition by name; raises InvalidValue."""
    if not isinstance(value, Mapping) or not value:
        raise InvalidValue("takes a number, a list, or {linspace: [first, last, number]} by name.")
    values = {str(name): _values_of_condition(str(name), written) for name, written in value.items()}
    rows = math.prod(map(len, values.values()))
    if rows > MOST_CONDITIONS:
        raise InvalidValue(f"makes {rows} rows of a set, but a measure takes {MOST_CONDITIONS} at most.")
    return values


def _values_of_condition(name: str, value: Any) -> tuple[float, ...]:
    """Read a number, a list or a linspace; raises InvalidValue."""
    try:
        if isinstance(value, Mapping):
            return _read_linspace(value)
        if isinstance(value, list | tuple):
            if not value:
                raise InvalidValue("is an empty list.")
            return tuple(read_real(item) for item in value)
        return (read_real(value),)
    except InvalidValue as error:
        raise InvalidValue(f"has {name}, which {error}") from None


def _read_linspace(value: Mapping[Any, Any]) -> tuple[float, ...]:
    """Read the points of {linspace: [first, last, number]}; raises InvalidValue."""
    if set(value) != {"linspace"} or not isinstance(value["linspace"], Sequence):
        raise InvalidValue("takes a number, a list, or {linspace: [first, last, number]}.")
    if len(value["linspace"]) != 3:
        raise InvalidValue("has a linspace that is not [first, last, number].")
    first, last, number = (read_real(item) for item in value["linspace"])
    if number != int(number) or not 2 <= number <= MOST_CONDITIONS:
        raise InvalidValue(f"has a linspace of {number:g} points, but takes 2 to {MOST_CONDITIONS}.")
    return tuple(np.linspace(first, last, int(number)).tolist())


Conditions = Annotated[
    dict[str, tuple[float, ...]],
    PlainValidator(checked(_read_conditions)),
    WithJsonSchema({"type": "object", "additionalProperties": {"type": ["number", "array", "object"]}}),
]


def _read_gaits(value: Any) -> tuple[str, ...]:
    """Read a gait or a list of gaits; raises InvalidValue."""
    items = value if isinstance(value, list | tuple) else [value]
    if not items:
        raise InvalidValue("is an empty list, but takes a gait or several.")
    return tuple(read_text(item) for item in items)


Gaits = Annotated[
    tuple[str, ...],
    PlainValidator(checked(_read_gaits)),
    WithJsonSchema({"type": ["string", "array"], "items": {"type": "string"}}),
]


def _read_ranges(value: Any) -> dict[str, tuple[float, float]]:
    """Read the range [low, high] of each column by name; raises InvalidValue."""
    if not isinstance(value, Mapping) or not value:
        raise InvalidValue("takes a range [low, high] of columns by name, such as speed: [0, 1].")
    ranges = {}
    for name, limits in value.items():
        if not isinstance(limits, list | tuple) or len(limits) != 2:
            raise InvalidValue(f"has {name}, which takes [low, high].")
        try:
            low, high = (read_real(end) for end in limits)
        except InvalidValue as error:
            raise InvalidValue(f"has {name}, which {error}") from None
        if not low < high:
            raise InvalidValue(f"has {name} from {low:g} to {high:g}: low is below high.")
        ranges[str(name)] = (low, high)
    return ranges


Ranges = Annotated[
    dict[str, tuple[float, float]],
    PlainValidator(checked(_read_ranges)),
    WithJsonSchema({"type": "object", "additionalProperties": {"type": "array"}}),
]
# A field `among`, which the measures of several rows share.
AMONG: Any = Field(
    default=None, description="ranges [low, high] of columns by name: only rows within all of them count"
)


def unknown_name(name: str, allowed: Iterable[str]) -> str:
    """Return the end of an error about a name, with the near miss and the allowed names."""
    return f"{name}, which is unknown{near_miss.suggestion(name, list(allowed))}"


def error_of_gaits(field: str, gaits: Iterable[str], model: Model) -> FieldError:
    """Check the names of gaits in a field; return as `Measure.field_error` does.

    Args:
        field: the field, for the error.
        gaits: the names.
        model: the model, which has the allowed names.
    """
    for gait in gaits:
        if gait not in model.gaits:
            return field, f"is {unknown_name(gait, model.gaits)}"
    return None


def error_of_column(formula: str, columns: Sequence[str]) -> FieldError:
    """Check a numeric column or a formula of such columns; return as `Measure.field_error` does."""
    numeric_columns = _numeric_columns(columns)
    if formula in numeric_columns:
        return None
    try:
        names = names_used(formula)
    except ExpressionError as error:
        return "of", f"is neither a column nor a formula: {error}"
    if not names:
        return "of", "has no column: it takes one, or a formula of columns."
    unknown = sorted(names - set(numeric_columns))
    if not unknown:
        return None
    verb = "is" if unknown == [formula] else "has"
    return "of", f"{verb} {unknown_name(unknown[0], numeric_columns)}"


def error_of_ranges(among: Mapping[str, tuple[float, float]] | None, columns: Sequence[str]) -> FieldError:
    """Check the columns of a field `among`; return as `Measure.field_error` does."""
    numeric_columns = _numeric_columns(columns)
    for name in among or {}:
        if name not in numeric_columns:
            return "among", f"has {unknown_name(name, numeric_columns)}"
    return None


def error_of_list(
    along: str, at: Mapping[str, Sequence[float]], measure: str, begins: str = ""
) -> FieldError:
    """Check the list along which a measure goes; return as `Measure.field_error` does.

    Args:
        along: name of the parameter whose list it is.
        at: the values of all conditions by name.
        measure: the measure in words, with its article.
        begins: the end of a sentence that says where the list begins.
    """
    if along not in at:
        return "along", f"is {unknown_name(along, at)}"
    other_lists = [name for name, values in at.items() if len(values) > 1 and name != along]
    if other_lists:
        return "at", f"has a list of {other_lists[0]} too, but {measure} takes one list, that of {along}."
    steps = np.sign(np.diff(at[along]))
    if not steps.size or not (steps == steps[0]).all() or steps[0] == 0:
        return "at", f"has {along}, which {measure} takes as a list that rises or falls{begins}."
    return None


def _numeric_columns(columns: Sequence[str]) -> list[str]:
    """Return the names of numeric columns, those at the rows' end also without suffix."""
    numeric = [name for name in columns if name not in _NOT_NUMERIC and not names_gait(name)]
    return [*numeric, *(name.removesuffix("_end") for name in numeric if name.endswith("_end"))]
