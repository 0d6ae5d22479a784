"""Base classes of the measures of sets of constants, the fields they share, and the columns they read."""

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
from gaitsweep.angles import TURN
from gaitsweep.column_meanings import COLUMNS
from gaitsweep.contract import Model, Quantity, names_gait
from gaitsweep.expression import ExpressionError, evaluate, functions_of, names_used, terms_of
from gaitsweep.kinds import FixedTime, Settle
from gaitsweep.kinds.run_kind import RunKind
from gaitsweep.schema.numbers import InvalidValue, checked, read_real, read_text
from gaitsweep.schema.strict_model import StrictModel

MOST_CONDITIONS = 10_000  # rows of one measure

# A field and the end of a sentence that says what is wrong with it; None if all is valid.
FieldError = tuple[str, str] | None

# Columns of names, and the row's number, which have no mean.
_NOT_NUMERIC = {"row", *(name for name, (unit, _) in COLUMNS.items() if not unit)}


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
    if set(value) != {"linspace"} or not isinstance(value["linspace"], list | tuple):
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
    WithJsonSchema(
        {"type": "object", "additionalProperties": {"type": ["number", "string", "array", "object"]}}
    ),
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


def error_of_column(formula: str, columns: Sequence[str], ordered: Model | None = None) -> FieldError:
    """Check a numeric column or a formula of such columns; return as `Measure.field_error` does.

    Args:
        formula: the column or formula.
        columns: the columns of the table.
        ordered: the model, for a measure that compares values, so that its observables that are angles, and
            angles of its labels, are refused; a parameter may be an angle.
    """
    numeric_columns = _numeric_columns(columns)
    try:
        names = {formula} if formula in numeric_columns else names_used(formula)
    except ExpressionError as error:
        return "of", f"is neither a column nor a formula: {error}"
    if ordered is not None and _gives_angle(formula, ordered):
        parameters = {quantity.name for quantity in ordered.parameters}
        if any(name not in parameters and _is_angle(name, ordered) for name in names):
            return "of", f"is {formula}, an angle, and angles on the circle have no order and no middle."
    if formula in numeric_columns:
        return None
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


class Measured(NamedTuple):
    """Values (n,) of a measure, NaN for sets without one, and `why` (n,) they have none, in a few words."""

    values: Float[np.ndarray, " sets"]
    why: Shaped[np.ndarray, " sets"]


MeasuredByName = dict[str, Measured]


def reasons_of_sets(measured: MeasuredByName) -> list[str]:
    """Return, for each set (n,), the measures without a value and why they have none; "" without any."""
    return [
        "; ".join(f"{name}: {why}" for name, why in zip(measured, of_set, strict=True) if why)
        for of_set in zip(*(result.why for result in measured.values()), strict=True)
    ]


# Columns of the rows of n sets: (n, conditions) each, names as text.
SetRows = Mapping[str, Shaped[np.ndarray, "sets conditions"]]


class Measure(StrictModel):
    """A number that is measured of a set of constants."""

    on_map: ClassVar[bool] = False  # whether it is measured on the return map, not of rows
    angle_field: ClassVar[str | None] = None  # its field for a column, whose value is an angle if that is one
    unit_field: ClassVar[str | None] = None  # its field for a column, formula or parameter, for the unit
    runs: ClassVar[tuple[type[RunKind], ...]] = ()  # run kinds that its field `run` may name
    # raised when rows that may not settle give another value, so that no older search is continued
    rule_of_settling: ClassVar[int] = 1

    at: Conditions = Field(description="parameters and starts of its rows by name; lists multiply")

    @property
    def conditions(self) -> list[dict[str, float]]:
        """Parameters and starts of each of its rows."""
        return [dict(zip(self.at, values, strict=True)) for values in itertools.product(*self.at.values())]

    def circular(self, model: Model) -> bool:
        """Return whether its value is an angle."""
        return self.angle_field is not None and _gives_angle(getattr(self, self.angle_field), model)

    def unit(self, model: Model) -> str:
        """Return the unit of its value; "" for a formula."""
        if self.unit_field is None:
            return "1"
        name = getattr(self, self.unit_field)
        units = {"t": "s", "t_end": "s"} | {key: q.unit for key, q in _quantities(model).items()}
        return units.get(name, "1" if name.isidentifier() else "")

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
        """Measure n sets from the last records of their rows.

        Args:
            rows: columns (n, conditions) by name.
            model: the model.
        """


def column(formula: str, rows: SetRows) -> Float[np.ndarray, "sets conditions"]:
    """Evaluate a column or a formula of columns for the rows of n sets: (n, conditions), NaN without a value.

    The column at the rows' end is preferred, since the name of an observable may be that of a start.

    Args:
        formula: the column or formula.
        rows: columns (n, conditions) by name.
    """
    name_at_end = _end(formula, rows)
    if name_at_end in rows:
        return rows[name_at_end].astype(float)
    used = {name: rows[_end(name, rows)].astype(float) for name in names_used(formula)}
    with np.errstate(all="ignore"):
        values = evaluate(formula, used, functions_of(np))
    return np.broadcast_to(values, rows["status"].shape)


def within(
    among: Mapping[str, tuple[float, float]], rows: SetRows, model: Model
) -> Bool[np.ndarray, "sets conditions"]:
    """Return a mask of the rows (n, conditions) that are within all ranges, ends included.

    Args:
        among: ranges (low, high) of columns by name; those of angles are arcs from low upwards to high.
        rows: columns (n, conditions) by name.
        model: the model.
    """
    inside = np.ones(rows["status"].shape, bool)
    for name, (low, high) in among.items():
        values = column(name, rows)
        if _is_angle(name, model):
            values = low + np.mod(values - low, TURN)
        inside &= (values >= low) & (values <= high)
    return inside


def _end(name: str, columns: Iterable[str]) -> str:
    """Return the name of the column at the rows' end, if there is one, else the name itself."""
    name_at_end = f"{name}_end"
    return name_at_end if name_at_end in columns else name


def _is_angle(name: str, model: Model) -> bool:
    """Return whether a column is an angle of the model."""
    quantity = _quantities(model).get(name)
    return quantity is not None and quantity.circular


def _gives_angle(formula: str, model: Model) -> bool:
    """Return whether a formula is an angle: a column that is one, or a sum or difference with such ones."""
    if _is_angle(formula, model):
        return True
    angles = {name for name in names_used(formula) if _is_angle(name, model)}
    terms = terms_of(formula) if angles else []
    return all(names_used(term).isdisjoint(angles) or term in angles for term in terms) and bool(terms)


def _quantities(model: Model) -> dict[str, Quantity]:
    """Return the quantities of columns, parameters and starts by name; observables come first."""
    known = {q.name: q for q in (*model.parameters, *model.initial_conditions, *model.label_fields)}
    return known | {name: q for q in model.observables for name in (q.name, f"{q.name}_end")}
