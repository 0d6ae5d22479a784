"""What is measured of a set of constants: a value, an edge, a share of starts, from rows of its own."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Annotated, Any, ClassVar, Literal, NamedTuple

import numpy as np
from pydantic import Field, PlainValidator, WithJsonSchema

from gaitsweep import near_miss
from gaitsweep.analysis.continuation import floquet
from gaitsweep.analysis.continuation.newton import newton
from gaitsweep.contract import Model, Status, Verdict
from gaitsweep.engine.poincare.poincare_return import ReturnStatus
from gaitsweep.engine.poincare.return_map import BatchedReturnMap
from gaitsweep.kinds.numbers import CountOrZero, InvalidValue, Text, checked, read_real
from gaitsweep.kinds.part import Part, Registry

MOST_CONDITIONS = 10_000  # rows of one measure

_MULTIPLIER, _UNSTABLE = "multiplier", "unstable"
# Columns of names, and the row's number, which have no mean.
_WORDS = ("row", "status", "stalled_by", "slowest", "gait")

SOUND = Status.of(Verdict.sound)
FAILED = Status.of(Verdict.failed)


def _read_at(value: Any) -> dict[str, tuple[float, ...]]:
    if not isinstance(value, Mapping) or not value:
        raise InvalidValue("takes a number, a list, or {linspace: [first, last, number]} by name.")
    points = {str(name): _points(str(name), each) for name, each in value.items()}
    if (rows := math.prod(map(len, points.values()))) > MOST_CONDITIONS:
        raise InvalidValue(f"makes {rows} rows of a set, but a measure takes {MOST_CONDITIONS} at most.")
    return points


def _points(name: str, value: Any) -> tuple[float, ...]:
    try:
        if isinstance(value, Mapping):
            if set(value) != {"linspace"} or not isinstance(value["linspace"], Sequence):
                raise InvalidValue("takes a number, a list, or {linspace: [first, last, number]}.")
            if len(value["linspace"]) != 3:
                raise InvalidValue("has a linspace that is not [first, last, number].")
            first, last, number = (read_real(each) for each in value["linspace"])
            if number != int(number) or not 2 <= number <= MOST_CONDITIONS:
                raise InvalidValue(f"has a linspace of {number:g} points, but takes 2 to {MOST_CONDITIONS}.")
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
    """Values (n,) of a measure, NaN where a set has none, and then why (n,), in a few words."""

    values: np.ndarray
    why: np.ndarray


# Columns of the rows of n sets: (n, conditions) each, names as text.
SetRows = Mapping[str, np.ndarray]


class Measure(Part):
    """A number that is measured of a set of constants."""

    on_map: ClassVar[bool] = False  # whether it is measured on the return map, not of rows

    at: At = Field(description="parameters and starts of its rows by name; lists multiply")

    @property
    def conditions(self) -> list[dict[str, float]]:
        """The parameters and starts of each of its rows."""
        return [dict(zip(self.at, values, strict=True)) for values in itertools.product(*self.at.values())]

    def of_sets(self, rows: SetRows, model: Model) -> Measured:
        """Its values from the last records of the rows of n sets, (n, conditions) each."""
        raise NotImplementedError

    def unit(self, model: Model) -> str:
        """The unit of its value."""
        raise NotImplementedError

    def circular(self, model: Model) -> bool:
        """Whether its value is an angle."""
        return False

    def wrong(self, columns: Sequence[str], model: Model) -> tuple[str, str] | None:
        """A field and what is wrong with it, in view of the table's columns and the model.

        None where all is well.
        """
        return None


class Value(Measure):
    """The mean of a column over rows, that of angles on the circle; no value if one of them is not sound."""

    kind: Literal["value"] = Field(description="value: a column of a row's last record")
    of_: Text = Field(alias="of", description="the column, such as an observable")

    def of_sets(self, rows: SetRows, model: Model) -> Measured:
        status = rows["status"]
        unsound = ~np.isin(status, list(SOUND))
        seen = rows[self._column(rows)].astype(float)
        values = np.angle(np.mean(np.exp(1j * seen), axis=1)) if self.circular(model) else seen.mean(axis=1)
        first = status[np.arange(len(status)), unsound.argmax(axis=1)]
        why = np.where(
            unsound.any(axis=1), first, np.where(np.isfinite(values), "", f"{self.of_} is missing")
        )
        return Measured(np.where(why == "", values, np.nan), why)

    def unit(self, model: Model) -> str:
        units = {q.name: q.unit for q in model.label_fields} | {"t_end": "s"}
        for quantity in model.observables:
            units[quantity.name] = units[f"{quantity.name}_end"] = quantity.unit
        return units.get(self.of_, "1")

    def circular(self, model: Model) -> bool:
        return any(self.of_ in (q.name, f"{q.name}_end") and q.circular for q in model.observables)

    def wrong(self, columns: Sequence[str], model: Model) -> tuple[str, str] | None:
        numbers = [name for name in columns if name not in _WORDS]
        return None if self._column(columns) in numbers else ("of", _unknown(self.of_, numbers))

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

    def of_sets(self, rows: SetRows, model: Model) -> Measured:
        holds = np.asarray(self.at[self.along])
        has = (rows["gait"] == self.gait) & ~np.isin(rows["status"], list(FAILED))
        first = np.where(has.all(axis=1), holds.size, np.argmin(has, axis=1))
        never, always = first == 0, first == holds.size
        after = np.clip(first, 1, holds.size - 1)
        values = np.where(never | always, np.nan, 0.5 * (holds[after - 1] + holds[after]))
        why = np.where(never, f"no {self.gait} at {self.along} = {holds[0]:g}", "")
        why = np.where(always, f"{self.gait} is not lost by {self.along} = {holds[-1]:g}", why)
        return Measured(values, why)

    def unit(self, model: Model) -> str:
        return {q.name: q.unit for q in model.parameters}.get(self.along, "1")

    def wrong(self, columns: Sequence[str], model: Model) -> tuple[str, str] | None:
        if self.along not in self.at:
            return "along", _unknown(self.along, self.at)
        others = [name for name, values in self.at.items() if len(values) > 1 and name != self.along]
        if others:
            return "at", f"has a list of {others[0]} too, but an edge takes one list, that of {self.along}."
        steps = np.sign(np.diff(self.at[self.along]))
        if not steps.size or not (steps == steps[0]).all() or steps[0] == 0:
            text = (
                f"has {self.along}, which an edge takes as a list that rises or falls from the gait's side."
            )
            return "at", text
        return _wrong_gait(self.gait, model.gaits)


class Share(Measure):
    """The share of rows that end in a gait; failed rows have none."""

    kind: Literal["share"] = Field(description="share: of rows that end in a gait, such as a basin's")
    gait: Text = Field(description="the gait")

    def of_sets(self, rows: SetRows, model: Model) -> Measured:
        failed = np.isin(rows["status"], list(FAILED))
        return _always(((rows["gait"] == self.gait) & ~failed).mean(axis=1))

    def unit(self, model: Model) -> str:
        return "1"

    def wrong(self, columns: Sequence[str], model: Model) -> tuple[str, str] | None:
        return _wrong_gait(self.gait, model.gaits)


class Failures(Measure):
    """The share of rows that fail: fall, diverge, stall."""

    kind: Literal["failures"] = Field(description="failures: the share of rows that fall or fail otherwise")

    def of_sets(self, rows: SetRows, model: Model) -> Measured:
        return _always(np.isin(rows["status"], list(FAILED)).mean(axis=1))

    def unit(self, model: Model) -> str:
        return "1"


class FixedPoint(Measure):
    """A fixed point of the return map near where a start leads: its multiplier, or an observable there.

    It is found by Newton's method, so it may be unstable; the map needs located events.
    """

    on_map: ClassVar[bool] = True
    kind: Literal["fixed_point"] = Field(
        description="fixed_point: of the return map, by Newton's method: a multiplier or an observable"
    )
    of_: Text = Field(
        alias="of",
        description="multiplier (the largest modulus), unstable (how many exceed 1), or an observable",
    )
    settle: CountOrZero = Field(default=30, description="cycles before Newton's method begins")
    fix: list[Text] = Field(default=[], description="conserved quantities that stay as they are")

    def of_starts(self, mapping: BatchedReturnMap, values: SetRows, starts: SetRows, n: int) -> Measured:
        """Its values for n sets, whose one condition has these parameters and starts (n,)."""
        points, reached = mapping.settled(starts, values, self.settle)
        fixed = newton(mapping, points, values, fix=self.fix)
        found = np.full(n, np.nan)
        there = np.flatnonzero(fixed.converged & (reached == ReturnStatus.crossed))
        if there.size:
            images = fixed.images
            if self.of_ in images.observed:
                found[there] = np.asarray(images.observed[self.of_], float)[there]
            else:
                names = [quantity.name for quantity in mapping.conserved]
                held = images.conserved_jacobian[there][:, [names.index(name) for name in self.fix]]
                size = np.abs(floquet.multipliers(images.jacobian[there], held))
                found[there] = size[:, 0] if self.of_ == _MULTIPLIER else (size > 1.0).sum(axis=1)
        why = np.where(np.isnan(found), "no fixed point found", "")
        return Measured(found, why)

    def unit(self, model: Model) -> str:
        return {q.name: q.unit for q in model.observables}.get(self.of_, "1")

    def circular(self, model: Model) -> bool:
        return any(q.name == self.of_ and q.circular for q in model.observables)

    def wrong(self, columns: Sequence[str], model: Model) -> tuple[str, str] | None:
        lists = [name for name, values in self.at.items() if len(values) > 1]
        if lists:
            return "at", f"has a list of {lists[0]}, but a fixed point takes one number for each name."
        allowed = [_MULTIPLIER, _UNSTABLE, *(q.name for q in model.observables)]
        if self.of_ not in allowed:
            return "of", _unknown(self.of_, allowed)
        chart = model.chart()
        names = [] if chart is None else [q.name for q in chart.conserved]
        unknown = [name for name in self.fix if name not in names]
        return ("fix", _unknown(unknown[0], names)) if unknown else None


MEASURES: Registry[Measure] = Registry("measure", [Value, Edge, Share, Failures, FixedPoint])


def _unknown(name: str, allowed: Iterable[str]) -> str:
    return f"is {name}, which is none{near_miss.suggestion(name, list(allowed))}"


def _wrong_gait(gait: str, gaits: Sequence[str]) -> tuple[str, str] | None:
    return None if gait in gaits else ("gait", _unknown(gait, gaits))


def _always(values: np.ndarray) -> Measured:
    """Values that every set has."""
    return Measured(values, np.full(values.size, ""))
