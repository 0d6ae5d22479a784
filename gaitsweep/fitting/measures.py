"""Measures of a set of constants: a value, an edge, a share of starts, from rows of its own."""

from __future__ import annotations

import abc
import itertools
import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Annotated, Any, ClassVar, Literal, NamedTuple

import numpy as np
from pydantic import Field, PlainValidator, WithJsonSchema

from gaitsweep import near_miss
from gaitsweep.analysis.continuation.multipliers import multipliers
from gaitsweep.analysis.continuation.newton import newton
from gaitsweep.contract import Model, Status, names_gait
from gaitsweep.engine.poincare.poincare_return import ReturnStatus
from gaitsweep.engine.poincare.return_map import BatchedReturnMap
from gaitsweep.expression import ExpressionError, evaluate, functions_of, names_in
from gaitsweep.kinds import FixedTime, Settle
from gaitsweep.kinds.run_kind import RunKind
from gaitsweep.schema.numbers import CountOrZero, InvalidValue, Text, checked, read_real, read_text
from gaitsweep.schema.strict_model import StrictModel

MOST_CONDITIONS = 10_000  # rows of one measure

_MULTIPLIER, _UNSTABLE = "multiplier", "unstable"
# Columns of names, and the row's number, which have no mean.
_WORDS = ("row", "status", "stalled_by", "slowest")


def _read_at(value: Any) -> dict[str, tuple[float, ...]]:
    if not isinstance(value, Mapping) or not value:
        raise InvalidValue("takes a number, a list, or {linspace: [first, last, number]} by name.")
    points = {str(name): _points(str(name), written) for name, written in value.items()}
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


At = Annotated[
    dict[str, tuple[float, ...]],
    PlainValidator(checked(_read_at)),
    WithJsonSchema({"type": "object", "additionalProperties": {"type": ["number", "array", "object"]}}),
]


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
    runs: ClassVar[tuple[type[RunKind], ...]] = ()  # what may be done with its rows, if it says so itself

    at: At = Field(description="parameters and starts of its rows by name; lists multiply")

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
    def wrong(self, columns: Sequence[str], model: Model) -> tuple[str, str] | None:
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


def _read_gaits(value: Any) -> tuple[str, ...]:
    items = value if isinstance(value, list | tuple) else [value]
    if not items:
        raise InvalidValue("is an empty list, but takes a gait or several.")
    return tuple(read_text(item) for item in items)


def _read_among(value: Any) -> dict[str, tuple[float, float]]:
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


Gaits = Annotated[
    tuple[str, ...],
    PlainValidator(checked(_read_gaits)),
    WithJsonSchema({"type": ["string", "array"], "items": {"type": "string"}}),
]
Among = Annotated[
    dict[str, tuple[float, float]],
    PlainValidator(checked(_read_among)),
    WithJsonSchema({"type": "object", "additionalProperties": {"type": "array"}}),
]
# A field `among`, which the measures of several rows share.
_AMONG: Any = Field(
    default=None, description="ranges [low, high] of columns by name: only rows within all of them count"
)


class Value(RowMeasure):
    """The mean of a column over rows, that of angles on the circle; no value if one of them is not sound."""

    reads_angles: ClassVar[bool] = True

    kind: Literal["value"] = Field(description="value: a column of a row's last record")
    of_: Text = Field(alias="of", description="the column, such as an observable, or a formula of columns")
    among: Among | None = _AMONG

    def of_sets(self, rows: SetRows, model: Model) -> Measured:
        unsound = ~Status.SOUND.among(rows["status"])
        seen = column(self.of_, rows)
        if self.among is None:
            turning = self.circular(model)
            values = np.angle(np.mean(np.exp(1j * seen), axis=1)) if turning else seen.mean(axis=1)
            nothing = np.zeros(len(values), bool)
        else:
            counts = within(self.among, rows)
            unsound, nothing = unsound & counts, ~counts.any(axis=1)
            values = _mean(seen, counts, self.circular(model))
        why = _why_none(self.of_, rows["status"], unsound, np.isfinite(values))
        why = np.where(nothing, _no_row(self.among), why)
        return Measured(np.where(why == "", values, np.nan), why)

    def unit(self, model: Model) -> str:
        return unit_of(self.of_, model)

    def wrong(self, columns: Sequence[str], model: Model) -> tuple[str, str] | None:
        return wrong_column(self.of_, columns) or _wrong_ranges(self.among, columns)


class Edge(RowMeasure):
    """Value at which rows leave a gait: midway between the last hold that has it and the next.

    Holds are read in the order written; the first has to have the gait.
    """

    kind: Literal["edge"] = Field(description="edge: where a gait is lost along a parameter, by holds")
    along: Text = Field(description="the parameter, whose list stands in `at`, from the gait's side")
    gait: Text = Field(description="the gait that is lost")

    def of_sets(self, rows: SetRows, model: Model) -> Measured:
        holds = np.asarray(self.at[self.along])
        has = (rows["gait"] == self.gait) & ~Status.FAILED.among(rows["status"])
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
        wrong = _wrong_list(self.along, self.at, "an edge", " from the gait's side")
        return wrong or wrong_gaits("gait", [self.gait], model)


class Share(RowMeasure):
    """The share of rows that end in a gait; failed rows have none."""

    kind: Literal["share"] = Field(description="share: of rows that end in a gait, such as a basin's")
    gait: Gaits = Field(description="the gait, or a list of which each counts")
    among: Among | None = _AMONG

    def of_sets(self, rows: SetRows, model: Model) -> Measured:
        has = np.isin(rows["gait"], self.gait) & ~Status.FAILED.among(rows["status"])
        if self.among is None:
            return _always(has.mean(axis=1))
        counts = within(self.among, rows)
        values = _mean(has.astype(float), counts)
        return Measured(values, np.where(np.isnan(values), _no_row(self.among), ""))

    def unit(self, model: Model) -> str:
        return "1"

    def wrong(self, columns: Sequence[str], model: Model) -> tuple[str, str] | None:
        return wrong_gaits("gait", self.gait, model) or _wrong_ranges(self.among, columns)


class Coexistence(RowMeasure):
    """The length of a parameter's range in which holds keep each of several gaits, from some start.

    Each value of the list stands for half of the way to its neighbours.
    """

    kind: Literal["coexistence"] = Field(
        description="coexistence: the length of a parameter's range in which holds keep each of several gaits"
    )
    gaits: list[Gaits] = Field(min_length=2, description="gaits, or lists of which one is enough")
    along: Text = Field(description="the parameter, whose list stands in `at` beside those of starts")

    def of_sets(self, rows: SetRows, model: Model) -> Measured:
        stands = ~Status.FAILED.among(rows["status"])
        lengths, axis = [len(values) for values in self.at.values()], list(self.at).index(self.along)
        together = np.ones((len(stands), lengths[axis]), bool)
        for group in self.gaits:
            has = (np.isin(rows["gait"], group) & stands).reshape(-1, *lengths)
            together &= np.moveaxis(has, axis + 1, 1).reshape(*together.shape, -1).any(axis=2)
        return _always(np.abs(np.trapezoid(together.astype(float), self.at[self.along])))

    def unit(self, model: Model) -> str:
        return {q.name: q.unit for q in model.parameters}.get(self.along, "1")

    def wrong(self, columns: Sequence[str], model: Model) -> tuple[str, str] | None:
        alone = {name: values for name, values in self.at.items() if name == self.along}
        wrong = wrong_gaits("gaits", itertools.chain(*self.gaits), model)
        return wrong or _wrong_list(self.along, alone, "a coexistence")


class Order(RowMeasure):
    """The least step between the medians of a column in successive groups of gaits: above 0 in their order.

    A group that no sound row shows leaves it without a value.
    """

    kind: Literal["order"] = Field(
        description="order: the least step of a column's median from one group of gaits to the next"
    )
    of_: Text = Field(alias="of", description="the column that rises, such as speed, or a formula of columns")
    gaits: list[Gaits] = Field(min_length=2, description="gaits, or lists of them, in the order wanted")

    def of_sets(self, rows: SetRows, model: Model) -> Measured:
        sound = Status.SOUND.among(rows["status"])
        seen = column(self.of_, rows)
        medians = np.full((len(sound), len(self.gaits)), np.nan)
        why = np.full(len(sound), "", object)
        for place, group in enumerate(self.gaits):
            in_group = np.isin(rows["gait"], group) & sound & np.isfinite(seen)
            has_group = in_group.any(axis=1)
            medians[has_group, place] = np.nanmedian(np.where(in_group, seen, np.nan)[has_group], axis=1)
            why = np.where((why == "") & ~has_group, f"no {' or '.join(group)}", why)
        return Measured(np.diff(medians, axis=1).min(axis=1), why)

    def unit(self, model: Model) -> str:
        return unit_of(self.of_, model)

    def wrong(self, columns: Sequence[str], model: Model) -> tuple[str, str] | None:
        every = list(itertools.chain(*self.gaits))
        if (wrong := wrong_gaits("gaits", every, model)) is not None:
            return wrong
        if twice := [gait for gait in every if every.count(gait) > 1]:
            return "gaits", f"has {twice[0]} twice."
        return wrong_column(self.of_, columns)


class Prominence(RowMeasure):
    """Depth by which a column falls between both ends of a list and rises again: its minimum's prominence.

    It is the smaller of the largest values on the two sides of the least inner value, less that value:
    positive where the curve is large, small, large.
    """

    kind: Literal["prominence"] = Field(
        description="prominence: of the minimum of a column along a parameter; below 0 where there is none"
    )
    of_: Text = Field(alias="of", description="the column, or a formula of columns, such as log(speed)")
    along: Text = Field(description="the parameter, whose list stands in `at`")

    def of_sets(self, rows: SetRows, model: Model) -> Measured:
        unsound = ~Status.SOUND.among(rows["status"])
        curve = column(self.of_, rows)
        least = 1 + curve[:, 1:-1].argmin(axis=1)
        places = np.arange(curve.shape[1])
        sides = [places < least[:, None], places > least[:, None]]
        peaks = [np.where(side, curve, -np.inf).max(axis=1) for side in sides]
        with np.errstate(invalid="ignore"):  # of curves that are not finite
            values = np.minimum(*peaks) - curve[np.arange(len(curve)), least]
        finite = np.asarray(np.isfinite(curve).all(axis=1))
        why = _why_none(self.of_, rows["status"], unsound, finite)
        return Measured(np.where(why == "", values, np.nan), why)

    def unit(self, model: Model) -> str:
        return unit_of(self.of_, model)

    def wrong(self, columns: Sequence[str], model: Model) -> tuple[str, str] | None:
        if (wrong := _wrong_list(self.along, self.at, "a prominence")) is not None:
            return wrong
        if len(self.at[self.along]) < 3:
            return "at", f"has fewer than three values of {self.along}, which a prominence takes."
        return wrong_column(self.of_, columns)


class Failures(RowMeasure):
    """The share of rows that fail: fall, diverge, stall."""

    kind: Literal["failures"] = Field(description="failures: the share of rows that fall or fail otherwise")

    def of_sets(self, rows: SetRows, model: Model) -> Measured:
        return _always(Status.FAILED.among(rows["status"]).mean(axis=1))

    def unit(self, model: Model) -> str:
        return "1"

    def wrong(self, columns: Sequence[str], model: Model) -> tuple[str, str] | None:
        return None


class FixedPoint(Measure):
    """A fixed point of the return map near where a start leads: its multiplier, or an observable there.

    It is found by Newton's method, so it may be unstable; the map needs located events.
    """

    on_map: ClassVar[bool] = True
    reads_angles: ClassVar[bool] = True

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
        """Measure n sets, whose one condition has these parameters and starts (n,)."""
        points, reached = mapping.settled(starts, values, self.settle)
        fixed = newton(mapping, points, values, fix=self.fix)
        measured = np.full(n, np.nan)
        known = np.flatnonzero(fixed.converged & (reached == ReturnStatus.crossed))
        if known.size:
            images = fixed.images
            if self.of_ in images.observed:
                measured[known] = np.asarray(images.observed[self.of_], float)[known]
            else:
                names = [quantity.name for quantity in mapping.conserved]
                conserved = images.conserved_jacobian[known][:, [names.index(name) for name in self.fix]]
                size = np.abs(multipliers(images.jacobian[known], conserved))
                measured[known] = size[:, 0] if self.of_ == _MULTIPLIER else (size > 1.0).sum(axis=1)
        why = np.where(np.isnan(measured), "no fixed point found", "")
        return Measured(measured, why)

    def unit(self, model: Model) -> str:
        return {q.name: q.unit for q in model.observables}.get(self.of_, "1")

    @property
    def own_run(self) -> RunKind | None:
        return None

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


def column(formula: str, rows: SetRows) -> np.ndarray:
    """Evaluate a column or a formula of columns for the rows of n sets: (n, conditions), NaN without a value.

    The column at the rows' end is preferred, since the name of an observable may be that of a start.
    """
    if (name := _end(formula, rows)) in rows:
        return rows[name].astype(float)
    names = {name: rows[_end(name, rows)].astype(float) for name in names_in(formula)}
    with np.errstate(all="ignore"):
        values = evaluate(formula, names, functions_of(np))
    return np.broadcast_to(values, rows["status"].shape)


def within(among: Mapping[str, tuple[float, float]], rows: SetRows) -> np.ndarray:
    """Return whether each row (n, conditions) is within all ranges, ends included."""
    inside = np.ones(rows["status"].shape, bool)
    for name, (low, high) in among.items():
        seen = column(name, rows)
        inside &= (seen >= low) & (seen <= high)
    return inside


def _end(name: str, columns: Iterable[str]) -> str:
    """Return the column with the last value of a name."""
    last = f"{name}_end"
    return last if last in columns else name


def _numbers(columns: Sequence[str]) -> list[str]:
    """Return the names of numeric columns, those at the rows' end also without suffix."""
    numbers = [name for name in columns if name not in _WORDS and not names_gait(name)]
    return [*numbers, *(name.removesuffix("_end") for name in numbers if name.endswith("_end"))]


def _mean(seen: np.ndarray, counts: np.ndarray, circular: bool = False) -> np.ndarray:
    """Average the values (n, conditions) that count, on the circle or not; NaN without any."""
    number = counts.sum(axis=1)
    per_row = np.where(number > 0, 1.0 / np.maximum(number, 1), np.nan)
    if circular:
        return np.angle(per_row * np.where(counts, np.exp(1j * seen), 0.0).sum(axis=1))
    return per_row * np.where(counts, seen, 0.0).sum(axis=1)


def _why_none(of: str, status: np.ndarray, unsound: np.ndarray, known: np.ndarray) -> np.ndarray:
    """Return why sets (n,) have no value of `of`: a row that is not sound, or a missing number; else ""."""
    first = status[np.arange(len(status)), unsound.argmax(axis=1)]
    return np.where(unsound.any(axis=1), first, np.where(known, "", f"{of} is missing"))


def unit_of(formula: str, model: Model) -> str:
    """Return the unit of a column, "" for a formula."""
    units = {q.name: q.unit for q in model.label_fields} | {"t_end": "s"}
    for quantity in model.observables:
        units[quantity.name] = units[f"{quantity.name}_end"] = quantity.unit
    return units.get(formula, "1" if formula.isidentifier() else "")


def _no_row(among: Mapping[str, tuple[float, float]] | None) -> str:
    ranges = (f"{name} in {low:g} to {high:g}" for name, (low, high) in (among or {}).items())
    return f"no row has {' and '.join(ranges)}"


def wrong_column(formula: str, columns: Sequence[str]) -> tuple[str, str] | None:
    """Check a numeric column or a formula of such columns; return as `Measure.wrong` does."""
    numbers = _numbers(columns)
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
    return "of", _unknown(formula, numbers) if unknown == [
        formula
    ] else f"has {_unknown(unknown[0], numbers)[3:]}"


def _wrong_ranges(
    among: Mapping[str, tuple[float, float]] | None, columns: Sequence[str]
) -> tuple[str, str] | None:
    numbers = _numbers(columns)
    unknown = [name for name in among or {} if name not in numbers]
    return ("among", f"has {_unknown(unknown[0], numbers)[3:]}") if unknown else None


def _wrong_list(
    along: str, at: Mapping[str, Sequence[float]], measure: str, begins: str = ""
) -> tuple[str, str] | None:
    """Check the list along which a measure goes; return as `Measure.wrong` does."""
    if along not in at:
        return "along", _unknown(along, at)
    if others := [name for name, values in at.items() if len(values) > 1 and name != along]:
        return "at", f"has a list of {others[0]} too, but {measure} takes one list, that of {along}."
    steps = np.sign(np.diff(at[along]))
    if not steps.size or not (steps == steps[0]).all() or steps[0] == 0:
        return "at", f"has {along}, which {measure} takes as a list that rises or falls{begins}."
    return None


def _unknown(name: str, allowed: Iterable[str]) -> str:
    return f"is {name}, which is unknown{near_miss.suggestion(name, list(allowed))}"


def wrong_gaits(field: str, gaits: Iterable[str], model: Model) -> tuple[str, str] | None:
    """Check the names of gaits in a field; return as `Measure.wrong` does."""
    unknown = [gait for gait in gaits if gait not in model.gaits]
    return (field, _unknown(unknown[0], model.gaits)) if unknown else None


def _always(values: np.ndarray) -> Measured:
    """Return values of sets that all have one."""
    return Measured(values, np.full(values.size, ""))
