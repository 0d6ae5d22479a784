"""Measures of ramps: transitions between gaits, and the sequence of gaits."""

from __future__ import annotations

import abc
import itertools
from collections.abc import Iterable, Mapping, Sequence
from typing import Annotated, ClassVar, Literal, NamedTuple

import numpy as np
from jaxtyping import Shaped
from pydantic import Field, WithJsonSchema

from gaitsweep.contract import Model
from gaitsweep.fitting.measure import (
    FieldError,
    Gaits,
    Measure,
    Measured,
    column,
    error_of_column,
    error_of_gaits,
)
from gaitsweep.kinds import Ramp, RunKind
from gaitsweep.schema.numbers import Count, CountOrZero, Flag, Text
from gaitsweep.status import Status

Column = Shaped[np.ndarray, " crossings"]
# Codes of the crossings of a transition: the gait that gives way, the one that follows, or another.
_FROM = "from"
_TO = "to"
_NEITHER = "neither"


class Crossings(NamedTuple):
    """Crossings of one row of a ramp, in their order: columns (k,), and the row's status."""

    columns: Mapping[str, Column]
    status: str


class RampMeasure(Measure):
    """A number that is measured of rows in which a parameter moves."""

    runs: ClassVar[tuple[type[RunKind], ...]] = (Ramp,)

    run: Annotated[Ramp, WithJsonSchema(Ramp.model_json_schema())] = Field(
        description="the ramp of its rows, as a job's run: kind, parameter, path, rate, initial_dwell"
    )
    least: Count = Field(default=3, description="successive crossings that make a gait count")

    @property
    def own_run(self) -> Ramp:
        return self.run.model_copy(update={"gaits": True})

    @abc.abstractmethod
    def of_rows(self, rows: Sequence[Sequence[Crossings]], model: Model) -> Measured:
        """Measure n sets.

        Args:
            rows: the rows of each set, one for every condition.
            model: the model.
        """

    @abc.abstractmethod
    def name_error(self, columns: Sequence[str], model: Model) -> FieldError:
        """Check names of gaits and columns and the pass; return as `field_error` does."""

    def _in_pass(self, row: Crossings, number: int | None) -> dict[str, Column]:
        """Return the crossings at which the parameter moves, of one pass or of all."""
        columns = row.columns
        with np.errstate(invalid="ignore"):  # a row without crossings has a record without numbers
            moves = (columns["t"] >= self.run.initial_dwell) & (columns["crossing"] > 0)
        if number is not None:
            moves &= columns["pass"] == number
        return {name: values[moves] for name, values in columns.items()}

    def _pass_error(self, number: int | None) -> FieldError:
        """Check the number of a pass; return as `field_error` does."""
        passes = len(self.run.path) - 1
        if number is None or number < passes:
            return None
        return "pass", f"is {number}, but the path has {passes} passes, of which the first is 0."

    def field_error(self, columns: Sequence[str], model: Model) -> FieldError:
        if self.run.parameter in self.at:
            return "at", f"sets {self.run.parameter}, which the ramp moves: take it out."
        return self.name_error(columns, model)


class Transition(RampMeasure):
    """Value at which one gait first gives way to another in a pass; the mean over the rows.

    A bout of a gait is `least` or more successive crossings with it. The value is the middle between the last
    crossing of a bout of the one gait and the first of the next bout, which is of the other. Shorter runs of
    these gaits may lie between the two bouts, and so may crossings with other gaits.
    """

    unit_field: ClassVar[str | None] = "quantity"

    kind: Literal["transition"] = Field(
        description="transition: where a gait gives way to another while a ramp moves a parameter"
    )
    gait: Gaits = Field(description="the gait that gives way, or a list of which each counts")
    to: Gaits = Field(description="the gait that follows, or a list of which each counts")
    of_: Text | None = Field(
        alias="of",
        default=None,
        description="what is read there: an observable, or a formula of columns; by default the parameter",
    )
    pass_: CountOrZero = Field(
        alias="pass", default=0, description="the pass of the path in which it is looked for, the first is 0"
    )

    def of_rows(self, rows: Sequence[Sequence[Crossings]], model: Model) -> Measured:
        values = np.full(len(rows), np.nan)
        why = np.full(len(rows), "", object)
        for number, rows_of_set in enumerate(rows):
            transitions = [self._transition(row, model) for row in rows_of_set]
            why[number] = next((reason for _, reason in transitions if reason), "")
            if not why[number]:
                values[number] = np.mean([value for value, _ in transitions])
        return Measured(values, why)

    def _transition(self, row: Crossings, model: Model) -> tuple[float, str]:
        """Return the value of the row's transition; NaN and the reason, in a few words, if it has none."""
        if row.status in Status.FAILED:
            return np.nan, row.status
        columns = self._in_pass(row, self.pass_)
        gaits = columns["gait"]
        sides = np.full(gaits.size, _NEITHER, object)
        sides[np.isin(gaits, self.to)] = _TO
        sides[np.isin(gaits, self.gait)] = _FROM
        bouts = [bout for bout in _bouts(sides, self.least) if bout.code != _NEITHER]
        for before, after in itertools.pairwise(bouts):
            if before.code == _FROM and after.code == _TO:
                by_own_name = dict(zip(_own_names(columns, model), columns.values(), strict=True))
                values = column(self.quantity, by_own_name)
                value = float(0.5 * (values[before.last] + values[after.first]))
                return value, "" if np.isfinite(value) else f"{self.quantity} is missing"
        return np.nan, f"no {' or '.join(self.to)} after {' or '.join(self.gait)}"

    @property
    def quantity(self) -> str:
        """Column, formula or parameter that is read at the transition."""
        return self.of_ or self.run.parameter

    def name_error(self, columns: Sequence[str], model: Model) -> FieldError:
        error = self._pass_error(self.pass_)
        error = error or error_of_gaits("gait", self.gait, model) or error_of_gaits("to", self.to, model)
        if error is not None:
            return error
        in_both = [gait for gait in self.to if gait in self.gait]
        if in_both:
            return "to", f"has {in_both[0]}, which is in gait too."
        return None if self.of_ is None else error_of_column(self.of_, _own_names(columns, model), model)


class GaitSequence(RampMeasure):
    """Share of a list of gaits that occurs in its order: 1 where all do; the mean over the rows.

    In a row it is the longest part of the list that occurs in its order, as a share of the list. Other gaits
    may lie between, unless `only` is set: then it is a share of the gaits that the row shows, if these are
    more. The share of a row that fails is 0.
    """

    kind: Literal["sequence"] = Field(
        description="sequence: the share of a list of gaits that comes in its order while a parameter moves"
    )
    gaits: list[Gaits] = Field(min_length=2, description="gaits, or lists of them, in the order wanted")
    pass_: CountOrZero | None = Field(
        alias="pass", default=None, description="the pass of the path that counts; by default all together"
    )
    only: Flag = Field(default=False, description="gaits between those of the list count against it")

    def of_rows(self, rows: Sequence[Sequence[Crossings]], model: Model) -> Measured:
        values = np.array([np.mean([self._share(row) for row in rows_of_set]) for rows_of_set in rows])
        return Measured(values, np.full(values.size, "", object))

    def _share(self, row: Crossings) -> float:
        """Return the share of the list in a row."""
        if row.status in Status.FAILED:
            return 0.0
        gaits = self._in_pass(row, self.pass_)["gait"]
        bouts = [bout.code for bout in _bouts(gaits, self.least)]
        # bouts shorter than `least` do not separate two bouts of a gait
        sequence = [gait for gait, _ in itertools.groupby(bouts)]
        length = len(self.gaits)
        if self.only:
            length = max(length, len(sequence))
        return _count_in_order(sequence, self.gaits) / length

    def name_error(self, columns: Sequence[str], model: Model) -> FieldError:
        gaits = itertools.chain(*self.gaits)
        return self._pass_error(self.pass_) or error_of_gaits("gaits", gaits, model)


def crossings_of(table: Mapping[str, Column], n_rows: int) -> list[Crossings]:
    """Split the table of a ramp by its rows.

    Args:
        table: columns of the records by name, in the order of the rows.
        n_rows: the number of rows, each of which has a record.
    """
    bounds = np.searchsorted(table["row"], np.arange(n_rows + 1)).tolist()
    return [
        Crossings({name: values[first:stop] for name, values in table.items()}, str(table["status"][first]))
        for first, stop in itertools.pairwise(bounds)
    ]


def _own_names(columns: Iterable[str], model: Model) -> list[str]:
    """Names of columns of crossings, in which observables have their names without the suffix `_n`."""
    own_names = {f"{quantity.name}_n": quantity.name for quantity in model.observables}
    return [own_names.get(column, column) for column in columns]


class _Bout(NamedTuple):
    """A run of equal codes, and the positions of its first and its last one."""

    code: str
    first: int
    last: int


def _bouts(codes: Column, least: int) -> list[_Bout]:
    """Find the runs of `least` equal codes (k,) or more."""
    changes = 1 + np.flatnonzero(codes[1:] != codes[:-1])
    bounds = [0, *changes.tolist(), codes.size]
    return [
        _Bout(str(codes[first]), first, stop - 1)
        for first, stop in itertools.pairwise(bounds)
        if stop - first >= least
    ]


def _count_in_order(sequence: Sequence[str], groups: Sequence[Sequence[str]]) -> int:
    """Count the groups that occur in a sequence, in their order: the longest common subsequence."""
    longest = np.zeros((len(sequence) + 1, len(groups) + 1), int)
    for i, gait in enumerate(sequence, start=1):
        for j, group in enumerate(groups, start=1):
            best = max(longest[i - 1, j], longest[i, j - 1])
            longest[i, j] = max(best, longest[i - 1, j - 1] + (gait in group))
    return int(longest[-1, -1])
