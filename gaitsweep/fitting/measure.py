"""The measure of a set of constants: the base class of its kinds, and its values."""

from __future__ import annotations

import abc
import itertools
from collections.abc import Mapping, Sequence
from typing import Annotated, ClassVar, NamedTuple

import numpy as np
from pydantic import Field, WithJsonSchema

from gaitsweep.contract import Model
from gaitsweep.fitting.measure_fields import Conditions, FieldError
from gaitsweep.kinds import FixedTime, Settle
from gaitsweep.kinds.run_kind import RunKind
from gaitsweep.schema.strict_model import StrictModel


class Measured(NamedTuple):
    """Values (n,) of a measure, NaN for sets without one, and the reasons `why` (n,), in a few words."""

    values: np.ndarray
    why: np.ndarray


MeasuredByName = dict[str, Measured]
# Columns of the rows of n sets: (n, conditions) each, names as text.
SetRows = Mapping[str, np.ndarray]


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
