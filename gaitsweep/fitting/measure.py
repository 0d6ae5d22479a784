"""The measure of a set of constants: base classes of its kinds, their shared fields, and columns of rows."""

from __future__ import annotations

import abc
import itertools
import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Annotated, Any, ClassVar, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Shaped
from pydantic import Field, PlainValidator, WithJsonSchema

from gaitsweep import near_miss
from gaitsweep.contract import Model, names_gait
from gaitsweep.expression import ExpressionError, evaluate, functions_of, names_in
from gaitsweep.kinds import FixedTime, Settle
from gaitsweep.kinds.run_kind import RunKind
from gaitsweep.schema.numbers import InvalidValue, checked, read_real, read_text
from gaitsweep.schema.strict_model import StrictModel

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
    if (rows := math.prod(map(len, values.values()))) > MOST_CONDITIONS:
        raise InvalidValue(f"makes {rows} rows of a set, but a measure takes {MOST_CONDITIONS} at most.")
    return values


def _values_of_condition(name: str, value: Any) -> tuple[float, ...]:
    """Read a number, a list or a linspace; raises InvalidValue."""
    try:
        if isinstance(value, Mapping):
            if set(value) != {"linspace"} or not isinstance(value["linspace"], Sequence):
                raise InvalidValue("takes a number, a list, or {linspace: [first, last, number]}.")
            if len(value["linspace"]) != 3:
                raise InvalidValue("has a linspace that is not [first, last, number].")
            first, last, number = (read_real(item) for item in value["linspace"])
            if number != int(number) or not 2 <= number <= MOST_CONDITIONS:
                raise InvalidValue(f"has a linspace of {number:g} points, but takes 2 to {MOST_CONDITIONS}.")
            return tuple(np.linspace(first, last, int(number)).tolist())
        if isinstance(value, list | tuple):
            if not value:
                raise InvalidValue("is an empty list.")
            return tuple(read_real(item) for item in value)
        return (read_real(value),)
    except InvalidValue as error:
        raise InvalidValue(f"has {name}, which {error}") from None


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
    """Check the names of gaits in a field; return as `Measure.field_error` does."""
    unknown = [gait for gait in gaits if gait not in model.gaits]
    return (field, f"is {unknown_name(unknown[0], model.gaits)}") if unknown else None


def error_of_column(formula: str, columns: Sequence[str]) -> FieldError:
    """Check a numeric column or a formula of such columns; return as `Measure.field_error` does."""
    numbers = _numeric_columns(columns)
    if formula in numbers:
        return None
    try:
        names = names_in(formula)
    except ExpressionError as error:
        return "of", f"is neither a column nor a formula: {error}"
    if not names:
        return "of", "has no column: it takes one, or a formula of columns."
    unknown = sorted(names - set(numbers))
    if not unknown:
        return None
    verb = "is" if unknown == [formula] else "has"
    return "of", f"{verb} {unknown_name(unknown[0], numbers)}"


def error_of_ranges(among: Mapping[str, tuple[float, float]] | None, columns: Sequence[str]) -> FieldError:
    """Check the columns of a field `among`; return as `Measure.field_error` does."""
    numbers = _numeric_columns(columns)
    unknown = [name for name in among or {} if name not in numbers]
    return ("among", f"has {unknown_name(unknown[0], numbers)}") if unknown else None


def error_of_list(
    along: str, at: Mapping[str, Sequence[float]], measure: str, begins: str = ""
) -> FieldError:
    """Check the list along which a measure goes; return as `Measure.field_error` does."""
    if along not in at:
        return "along", f"is {unknown_name(along, at)}"
    if others := [name for name, values in at.items() if len(values) > 1 and name != along]:
        return "at", f"has a list of {others[0]} too, but {measure} takes one list, that of {along}."
    steps = np.sign(np.diff(at[along]))
    if not steps.size or not (steps == steps[0]).all() or steps[0] == 0:
        return "at", f"has {along}, which {measure} takes as a list that rises or falls{begins}."
    return None


def _numeric_columns(columns: Sequence[str]) -> list[str]:
    """Return the names of numeric columns, those at the rows' end also without suffix."""
    numbers = [name for name in columns if name not in _NOT_NUMERIC and not names_gait(name)]
    return [*numbers, *(name.removesuffix("_end") for name in numbers if name.endswith("_end"))]


class Measured(NamedTuple):
    """Values (n,) of a measure, NaN for sets without one, and the reasons `why` (n,), in a few words."""

    values: Float[np.ndarray, " sets"]
    why: Shaped[np.ndarray, " sets"]


MeasuredByName = dict[str, Measured]
# Columns of the rows of n sets: (n, conditions) each, names as text.
SetRows = Mapping[str, Shaped[np.ndarray, "sets conditions"]]


class Measure(StrictModel):
    """A number that is measured of a set of constants."""

    on_map: ClassVar[bool] = False  # whether it is measured on the return map, not of rows
    reads_angles: ClassVar[bool] = False  # whether its value is an angle where `of` is one
    runs: ClassVar[tuple[type[RunKind], ...]] = ()  # run kinds that its field `run` may name

    at: Conditions = Field(description="parameters and starts of its rows by name; lists multiply")

    @property
    def conditions(self) -> list[dict[str, float]]:
        """Parameters and starts of each of its rows."""
        return [dict(zip(self.at, values, strict=True)) for values in itertools.product(*self.at.values())]

    def circular(self, model: Model) -> bool:
        """Return whether its value is an angle."""
        read = getattr(self, "of_", "")
        angles = (q.name for q in model.observables if q.circular)
        return self.reads_angles and any(read in (name, f"{name}_end") for name in angles)

    @abc.abstractmethod
    def unit(self, model: Model) -> str:
        """Return the unit of its value."""

    @property
    @abc.abstractmethod
    def own_run(self) -> RunKind | None:
        """Run kind of its rows; None where it is the job's own run."""

    @abc.abstractmethod
    def field_error(self, columns: Sequence[str], model: Model) -> FieldError:
        """Return a field and its error, for the table's columns and the model; None if it is valid."""


class RowMeasure(Measure):
    """A number that is measured of the last records of rows."""

    runs: ClassVar[tuple[type[RunKind], ...]] = (Settle, FixedTime)

    run: Annotated[
        Settle | FixedTime | None,
        WithJsonSchema({"anyOf": [Settle.model_json_schema(), FixedTime.model_json_schema()]}),
    ] = Field(default=None, description="settle or fixed_time with its fields; by default the job's own run")

    @property
    def own_run(self) -> RunKind | None:
        return self.run

    @abc.abstractmethod
    def of_sets(self, rows: SetRows, model: Model) -> Measured:
        """Measure n sets from the last records of their rows, (n, conditions) each."""


def column(formula: str, rows: SetRows) -> Float[np.ndarray, "sets conditions"]:
    """Evaluate a column or a formula of columns for the rows of n sets: (n, conditions), NaN without a value.

    The column at the rows' end is preferred, since the name of an observable may be that of a start.
    """
    if (name := _end(formula, rows)) in rows:
        return rows[name].astype(float)
    names = {name: rows[_end(name, rows)].astype(float) for name in names_in(formula)}
    with np.errstate(all="ignore"):
        values = evaluate(formula, names, functions_of(np))
    return np.broadcast_to(values, rows["status"].shape)


def within(among: Mapping[str, tuple[float, float]], rows: SetRows) -> Bool[np.ndarray, "sets conditions"]:
    """Return whether each row (n, conditions) is within all ranges, ends included."""
    inside = np.ones(rows["status"].shape, bool)
    for name, (low, high) in among.items():
        values = column(name, rows)
        inside &= (values >= low) & (values <= high)
    return inside


def _end(name: str, columns: Iterable[str]) -> str:
    """Return the column with the last value of a name."""
    last = f"{name}_end"
    return last if last in columns else name


def unit_of_parameter(name: str, model: Model) -> str:
    """Return the unit of a parameter, "1" if the model has none of this name."""
    return {q.name: q.unit for q in model.parameters}.get(name, "1")


def unit_of(formula: str, model: Model) -> str:
    """Return the unit of a column, "" for a formula."""
    units = {q.name: q.unit for q in model.label_fields} | {"t_end": "s"}
    for quantity in model.observables:
        units[quantity.name] = units[f"{quantity.name}_end"] = quantity.unit
    return units.get(formula, "1" if formula.isidentifier() else "")
