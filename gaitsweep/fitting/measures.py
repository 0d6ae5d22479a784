"""What is measured of a set of constants: a value, an edge, a share of starts, from rows of its own."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
import pandas as pd
from pydantic import Field, PlainValidator, WithJsonSchema

from gaitsweep.circular import wrapped_difference
from gaitsweep.contract import Model, Status, Verdict
from gaitsweep.kinds.numbers import InvalidValue, Text, checked, read_real
from gaitsweep.kinds.part import Part, Registry

MOST_CONDITIONS = 10_000  # rows of one measure

SOUND = Status.of(Verdict.sound)
FAILED = Status.of(Verdict.failed)


def _read_at(value: Any) -> dict[str, tuple[float, ...]]:
    if not isinstance(value, Mapping) or not value:
        raise InvalidValue("takes a number, a list, or {linspace: [first, last, number]} by name.")
    return {str(name): _points(str(name), each) for name, each in value.items()}


def _points(name: str, value: Any) -> tuple[float, ...]:
    try:
        if isinstance(value, Mapping):
            if set(value) != {"linspace"} or not isinstance(value["linspace"], Sequence):
                raise InvalidValue("takes a number, a list, or {linspace: [first, last, number]}.")
            if len(value["linspace"]) != 3:
                raise InvalidValue("has a linspace that is not [first, last, number].")
            first, last, number = (read_real(each) for each in value["linspace"])
            if number != int(number) or not 2 <= number <= MOST_CONDITIONS:
                raise InvalidValue(f"has a linspace of {number:g} points.")
            return tuple(np.linspace(first, last, int(number)).tolist())
        if isinstance(value, list | tuple):
            if not value:
                raise InvalidValue("is an empty list.")
            return tuple(read_real(each) for each in value)
        return (read_real(value),)
    except InvalidValue as error:
        raise InvalidValue(f"has {name}, which {error}") from None


At = Annotated[
    dict[str, tuple[float, ...]],
    PlainValidator(checked(_read_at)),
    WithJsonSchema({"type": "object", "additionalProperties": {"type": ["number", "array", "object"]}}),
]


class Measured(NamedTuple):
    """The value of a measure; NaN where it has none, and then why, in a few words."""

    value: float
    why: str = ""


class Measure(Part):
    """A number that is measured of a set of constants."""

    at: At = Field(description="parameters and starts of its rows by name; lists multiply")

    @property
    def names(self) -> tuple[str, ...]:
        """The parameters and starts that it sets."""
        return tuple(self.at)

    @property
    def conditions(self) -> list[dict[str, float]]:
        """The parameters and starts of each of its rows."""
        return [dict(zip(self.at, values, strict=True)) for values in itertools.product(*self.at.values())]

    def value(self, rows: pd.DataFrame, model: Model) -> Measured:
        """Its value from the last records of its rows, in the order of `conditions`."""
        raise NotImplementedError

    def unit(self, model: Model) -> str:
        """The unit of its value."""
        raise NotImplementedError

    def circular(self, model: Model) -> bool:
        """Whether its value is an angle."""
        return False

    def wrong(self, columns: Sequence[str], gaits: Sequence[str]) -> tuple[str, str, Sequence[str]] | None:
        """A field, the name in it that does not exist, and those that do; None where all is well."""
        return None


class Value(Measure):
    """The mean of a column over rows, that of angles on the circle; no value if one of them is not sound."""

    kind: Literal["value"] = Field(description="value: a column of a row's last record")
    of_: Text = Field(alias="of", description="the column, such as an observable")

    def value(self, rows: pd.DataFrame, model: Model) -> Measured:
        status = rows["status"].astype(str)
        unsound = [each for each in status if each not in SOUND]
        if unsound:
            return Measured(math.nan, unsound[0])
        values = rows[self._column(rows.columns)].to_numpy(float)
        if self.circular(model):
            mean = float(np.angle(np.mean(np.exp(1j * values))))
        else:
            mean = float(np.mean(values))
        return Measured(mean) if math.isfinite(mean) else Measured(math.nan, f"{self.of_} is missing")

    def unit(self, model: Model) -> str:
        return {q.name: q.unit for q in (*model.observables, *model.label_fields)}.get(self.of_, "1")

    def circular(self, model: Model) -> bool:
        return any(q.name == self.of_ and q.circular for q in model.observables)

    def wrong(self, columns: Sequence[str], gaits: Sequence[str]) -> tuple[str, str, Sequence[str]] | None:
        return None if self._column(columns) in columns else ("of", self.of_, columns)

    def _column(self, columns: Iterable[str]) -> str:
        """The column with its last value: an observable's own name may be a start's."""
        last = f"{self.of_}_end"
        return last if last in columns else self.of_


class Edge(Measure):
    """Where rows leave a gait: the middle between the last hold that has it and the first that has not.

    Holds are read in the order written; the first has to have the gait.
    """

    kind: Literal["edge"] = Field(description="edge: where a gait is lost along a parameter, by holds")
    along: Text = Field(description="the parameter, whose list stands in `at`, from the gait's side")
    gait: Text = Field(description="the gait that is lost")

    def value(self, rows: pd.DataFrame, model: Model) -> Measured:
        holds = np.asarray(self.at[self.along])
        has = (rows["gait"].astype(str) == self.gait) & ~rows["status"].astype(str).isin(list(FAILED))
        there = has.to_numpy()
        first = holds.size if there.all() else int(np.argmin(there))
        if first == 0:
            return Measured(math.nan, f"no {self.gait} at {self.along} = {holds[0]:g}")
        if first == holds.size:
            return Measured(math.nan, f"{self.gait} is not lost by {self.along} = {holds[-1]:g}")
        return Measured(float(0.5 * (holds[first - 1] + holds[first])))

    def unit(self, model: Model) -> str:
        return {q.name: q.unit for q in model.parameters}.get(self.along, "1")

    def wrong(self, columns: Sequence[str], gaits: Sequence[str]) -> tuple[str, str, Sequence[str]] | None:
        lists = [name for name, values in self.at.items() if len(values) > 1]
        if lists != [self.along]:
            return "along", self.along, lists
        return None if self.gait in gaits else ("gait", self.gait, gaits)


class Share(Measure):
    """The share of rows that end in a gait; failed rows have none."""

    kind: Literal["share"] = Field(description="share: of rows that end in a gait, such as a basin's")
    gait: Text = Field(description="the gait")

    def value(self, rows: pd.DataFrame, model: Model) -> Measured:
        failed = rows["status"].astype(str).isin(list(FAILED)).to_numpy()
        return Measured(float(np.mean((rows["gait"].astype(str) == self.gait).to_numpy() & ~failed)))

    def unit(self, model: Model) -> str:
        return "1"

    def wrong(self, columns: Sequence[str], gaits: Sequence[str]) -> tuple[str, str, Sequence[str]] | None:
        return None if self.gait in gaits else ("gait", self.gait, gaits)


class Failures(Measure):
    """The share of rows that fail: fall, diverge, stall."""

    kind: Literal["failures"] = Field(description="failures: the share of rows that fall or fail otherwise")

    def value(self, rows: pd.DataFrame, model: Model) -> Measured:
        return Measured(float(np.mean(rows["status"].astype(str).isin(list(FAILED)))))

    def unit(self, model: Model) -> str:
        return "1"


MEASURES: Registry[Measure] = Registry("measure", [Value, Edge, Share, Failures])


def difference(ours: float, wanted: float, circular: bool) -> float:
    """How far a value is from another, angles by the shorter way."""
    return float(wrapped_difference(ours - wanted)) if circular else ours - wanted
