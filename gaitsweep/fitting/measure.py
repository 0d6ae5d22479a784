"""Base classes of the measures of sets of constants, and the columns of rows that they read."""

from __future__ import annotations

import abc
import itertools
from collections.abc import Iterable, Mapping, Sequence
from typing import Annotated, ClassVar, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Shaped
from pydantic import Field, WithJsonSchema

from gaitsweep.contract import Model
from gaitsweep.expression import evaluate, functions_of, names_used
from gaitsweep.fitting.measure_fields import Conditions, FieldError
from gaitsweep.kinds import FixedTime, Settle
from gaitsweep.kinds.run_kind import RunKind
from gaitsweep.schema.strict_model import StrictModel


class Measured(NamedTuple):
    """Values (n,) of a measure, NaN for sets without one, and `why` (n,) they have none, in a few words."""

    values: Float[np.ndarray, " sets"]
    why: Shaped[np.ndarray, " sets"]


MeasuredByName = dict[str, Measured]
# Columns of the rows of n sets: (n, conditions) each, names as text.
SetRows = Mapping[str, Shaped[np.ndarray, "sets conditions"]]


class Measure(StrictModel):
    """A number that is measured of a set of constants."""

    on_map: ClassVar[bool] = False  # whether it is measured on the return map, not of rows
    angle_field: ClassVar[str | None] = None  # its field for a column, whose value is an angle if that is one
    runs: ClassVar[tuple[type[RunKind], ...]] = ()  # run kinds that its field `run` may name

    at: Conditions = Field(description="parameters and starts of its rows by name; lists multiply")

    @property
    def conditions(self) -> list[dict[str, float]]:
        """Parameters and starts of each of its rows."""
        return [dict(zip(self.at, values, strict=True)) for values in itertools.product(*self.at.values())]

    def circular(self, model: Model) -> bool:
        """Return whether its value is an angle."""
        if self.angle_field is None:
            return False
        column_name = getattr(self, self.angle_field)
        angles = (quantity.name for quantity in model.observables if quantity.circular)
        return any(column_name in (name, f"{name}_end") for name in angles)

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


def within(among: Mapping[str, tuple[float, float]], rows: SetRows) -> Bool[np.ndarray, "sets conditions"]:
    """Return a mask of the rows (n, conditions) that are within all ranges, ends included.

    Args:
        among: ranges (low, high) of columns by name.
        rows: columns (n, conditions) by name.
    """
    inside = np.ones(rows["status"].shape, bool)
    for name, (low, high) in among.items():
        values = column(name, rows)
        inside &= (values >= low) & (values <= high)
    return inside


def _end(name: str, columns: Iterable[str]) -> str:
    """Return the name of the column at the rows' end, if there is one, else the name itself."""
    name_at_end = f"{name}_end"
    return name_at_end if name_at_end in columns else name


def unit_of_parameter(name: str, model: Model) -> str:
    """Return the unit of a parameter, "1" if the model has none of this name."""
    return {quantity.name: quantity.unit for quantity in model.parameters}.get(name, "1")


def unit_of(formula: str, model: Model) -> str:
    """Return the unit of a column, "" for a formula."""
    units = {quantity.name: quantity.unit for quantity in model.label_fields} | {"t_end": "s"}
    for quantity in model.observables:
        units[quantity.name] = units[f"{quantity.name}_end"] = quantity.unit
    return units.get(formula, "1" if formula.isidentifier() else "")
