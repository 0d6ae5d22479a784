"""Measures of single rows: values, edges, orders and shares at their last records, and fixed points."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from typing import ClassVar, Literal

import numpy as np
from jaxtyping import Bool, Float, Shaped
from pydantic import Field

from gaitsweep.analysis.continuation.bifurcation_tests import EDGE
from gaitsweep.analysis.continuation.floquet_multipliers import multipliers
from gaitsweep.analysis.continuation.newton import NewtonOutcome, newton
from gaitsweep.angles import direction
from gaitsweep.contract import Model
from gaitsweep.engine.poincare.poincare_return import ReturnStatus
from gaitsweep.engine.poincare.return_map import BatchedReturnMap
from gaitsweep.fitting.measure import (
    AMONG,
    FieldError,
    Gaits,
    Measure,
    Measured,
    Ranges,
    RowMeasure,
    SetRows,
    column,
    error_of_column,
    error_of_gaits,
    error_of_list,
    error_of_ranges,
    unknown_name,
    within,
)
from gaitsweep.kinds.run_kind import RunKind
from gaitsweep.schema.numbers import CountOrZero, Text
from gaitsweep.status import Status


class Value(RowMeasure):
    """Mean of a column over rows, of angles on the circle; no value if one of the rows is not sound."""

    angle_field: ClassVar[str | None] = "of_"
    unit_field: ClassVar[str | None] = "of_"

    kind: Literal["value"] = Field(description="value: a column of a row's last record")
    of_: Text = Field(alias="of", description="the column, such as an observable, or a formula of columns")
    among: Ranges | None = AMONG

    def of_sets(self, rows: SetRows, model: Model) -> Measured:
        unsound = ~Status.SOUND.among(rows["status"])
        of_rows = column(self.of_, rows)
        circular = self.circular(model)
        known = np.isfinite(of_rows)
        if self.among is None:
            values = direction(np.mean(np.exp(1j * of_rows), axis=1)) if circular else of_rows.mean(axis=1)
            without_rows = np.zeros(len(values), bool)
        else:
            is_counted = within(self.among, rows, model)
            unsound = unsound & is_counted
            without_rows = ~is_counted.any(axis=1)
            known |= ~is_counted
            values = _mean(of_rows, is_counted, circular=circular)
        why = _why_none(self.of_, rows["status"], unsound, np.asarray(known.all(axis=1)))
        why = np.where((why == "") & np.isnan(values), f"the angles {self.of_} cancel: no mean", why)
        why = np.where(without_rows, _no_row(self.among), why)
        return Measured(np.where(why == "", values, np.nan), why)

    def field_error(self, columns: Sequence[str], model: Model) -> FieldError:
        return error_of_column(self.of_, columns) or error_of_ranges(self.among, columns)


class Edge(RowMeasure):
    """Value at which rows leave a gait: midway between the last hold that has it and the next.

    Holds are read in the order written; the first has to have the gait. A hold that failed or did not settle
    has no gait.
    """

    unit_field: ClassVar[str | None] = "along"
    rule_of_settling: ClassVar[int] = 2

    kind: Literal["edge"] = Field(description="edge: where a gait is lost along a parameter, by holds")
    along: Text = Field(description="the parameter, whose list stands in `at`, from the gait's side")
    gait: Text = Field(description="the gait that is lost")

    def of_sets(self, rows: SetRows, model: Model) -> Measured:
        holds = np.asarray(self.at[self.along])
        has_gait = (rows["gait"] == self.gait) & Status.SOUND.among(rows["status"])
        first_lost = np.where(has_gait.all(axis=1), holds.size, np.argmin(has_gait, axis=1))
        never = first_lost == 0
        always = first_lost == holds.size
        after = np.clip(first_lost, 1, holds.size - 1)
        values = np.where(never | always, np.nan, 0.5 * (holds[after - 1] + holds[after]))
        why = np.where(never, f"no {self.gait} at {self.along} = {holds[0]:g}", "")
        why = np.where(always, f"{self.gait} is not lost by {self.along} = {holds[-1]:g}", why)
        return Measured(values, why)

    def field_error(self, columns: Sequence[str], model: Model) -> FieldError:
        error = error_of_list(self.along, self.at, "an edge", " from the gait's side")
        return error or error_of_gaits("gait", [self.gait], model)


class Share(RowMeasure):
    """Share of rows that end in a gait; rows that failed or did not settle have no gait."""

    rule_of_settling: ClassVar[int] = 2

    kind: Literal["share"] = Field(description="share: of rows that end in a gait, such as a basin's")
    gait: Gaits = Field(description="the gait, or a list of which each counts")
    among: Ranges | None = AMONG

    def of_sets(self, rows: SetRows, model: Model) -> Measured:
        has_gait = np.isin(rows["gait"], self.gait) & Status.SOUND.among(rows["status"])
        if self.among is None:
            return _without_missing(has_gait.mean(axis=1))
        values = _mean(has_gait.astype(float), within(self.among, rows, model))
        return Measured(values, np.where(np.isnan(values), _no_row(self.among), ""))

    def field_error(self, columns: Sequence[str], model: Model) -> FieldError:
        return error_of_gaits("gait", self.gait, model) or error_of_ranges(self.among, columns)


class Coexistence(RowMeasure):
    """Length of a parameter's range in which holds keep each of several gaits, from some start.

    Each value of the list represents half of the distance to its neighbours (trapezoidal rule). Holds that
    failed or did not settle have no gait.
    """

    unit_field: ClassVar[str | None] = "along"
    rule_of_settling: ClassVar[int] = 2

    kind: Literal["coexistence"] = Field(
        description="coexistence: the length of a parameter's range in which holds keep each of several gaits"
    )
    gaits: list[Gaits] = Field(min_length=2, description="gaits, or lists of which one is enough")
    along: Text = Field(description="the parameter, whose list stands in `at` beside those of starts")

    def of_sets(self, rows: SetRows, model: Model) -> Measured:
        sound = Status.SOUND.among(rows["status"])
        lengths = [len(values) for values in self.at.values()]
        axis = list(self.at).index(self.along)
        coexist = np.ones((len(sound), lengths[axis]), bool)
        for group in self.gaits:
            has_gait = (np.isin(rows["gait"], group) & sound).reshape(-1, *lengths)
            # values of the parameter, then all starts
            by_value = np.moveaxis(has_gait, axis + 1, 1).reshape(*coexist.shape, -1)
            coexist &= by_value.any(axis=2)
        return _without_missing(np.abs(np.trapezoid(coexist.astype(float), self.at[self.along])))

    def field_error(self, columns: Sequence[str], model: Model) -> FieldError:
        only_along = {name: values for name, values in self.at.items() if name == self.along}
        error = error_of_gaits("gaits", itertools.chain(*self.gaits), model)
        return error or error_of_list(self.along, only_along, "a coexistence")


class Order(RowMeasure):
    """Least step between the medians of a column in successive groups of gaits: above 0 in their order.

    It has no value if no sound row shows one of the groups.
    """

    unit_field: ClassVar[str | None] = "of_"

    kind: Literal["order"] = Field(
        description="order: the least step of a column's median from one group of gaits to the next"
    )
    of_: Text = Field(alias="of", description="the column that rises, such as speed, or a formula of columns")
    gaits: list[Gaits] = Field(min_length=2, description="gaits, or lists of them, in the order wanted")

    def of_sets(self, rows: SetRows, model: Model) -> Measured:
        sound = Status.SOUND.among(rows["status"])
        values = column(self.of_, rows)
        medians = np.full((len(sound), len(self.gaits)), np.nan)
        why = np.full(len(sound), "", object)
        for number, group in enumerate(self.gaits):
            in_group = np.isin(rows["gait"], group) & sound & np.isfinite(values)
            has_group = in_group.any(axis=1)
            medians[has_group, number] = np.nanmedian(np.where(in_group, values, np.nan)[has_group], axis=1)
            why = np.where((why == "") & ~has_group, f"no {' or '.join(group)}", why)
        return Measured(np.diff(medians, axis=1).min(axis=1), why)

    def field_error(self, columns: Sequence[str], model: Model) -> FieldError:
        gaits = list(itertools.chain(*self.gaits))
        if (error := error_of_gaits("gaits", gaits, model)) is not None:
            return error
        repeated = [gait for gait in gaits if gaits.count(gait) > 1]
        if repeated:
            return "gaits", f"has {repeated[0]} twice."
        return error_of_column(self.of_, columns, model)


class Prominence(RowMeasure):
    """Prominence of the minimum of a column along a list: the depth by which it falls and rises again.

    It is the smaller of the largest values on the two sides of the least inner value, less that value: it is
    positive if the column falls and rises again between the ends.
    """

    unit_field: ClassVar[str | None] = "of_"

    kind: Literal["prominence"] = Field(
        description="prominence: of the minimum of a column along a parameter; below 0 where there is none"
    )
    of_: Text = Field(alias="of", description="the column, or a formula of columns, such as log(speed)")
    along: Text = Field(description="the parameter, whose list stands in `at`")

    def of_sets(self, rows: SetRows, model: Model) -> Measured:
        unsound = ~Status.SOUND.among(rows["status"])
        curve = column(self.of_, rows)
        minimum = 1 + curve[:, 1:-1].argmin(axis=1)
        points = np.arange(curve.shape[1])
        peak_before = np.where(points < minimum[:, None], curve, -np.inf).max(axis=1)
        peak_after = np.where(points > minimum[:, None], curve, -np.inf).max(axis=1)
        with np.errstate(invalid="ignore"):  # of curves that are not finite
            values = np.minimum(peak_before, peak_after) - curve[np.arange(len(curve)), minimum]
        finite = np.asarray(np.isfinite(curve).all(axis=1))
        why = _why_none(self.of_, rows["status"], unsound, finite)
        return Measured(np.where(why == "", values, np.nan), why)

    def field_error(self, columns: Sequence[str], model: Model) -> FieldError:
        if (error := error_of_list(self.along, self.at, "a prominence")) is not None:
            return error
        if len(self.at[self.along]) < 3:
            return "at", f"has fewer than three values of {self.along}, which a prominence takes."
        return error_of_column(self.of_, columns, model)


class Failures(RowMeasure):
    """Share of rows that fail: fall, diverge or stall."""

    kind: Literal["failures"] = Field(description="failures: the share of rows that fall or fail otherwise")

    def of_sets(self, rows: SetRows, model: Model) -> Measured:
        return _without_missing(Status.FAILED.among(rows["status"]).mean(axis=1))

    def field_error(self, columns: Sequence[str], model: Model) -> FieldError:
        return None


def _mean(
    values: Float[np.ndarray, "sets conditions"],
    is_counted: Bool[np.ndarray, "sets conditions"],
    *,
    circular: bool = False,
) -> Float[np.ndarray, " sets"]:
    """Average the values that are counted, on the circle or not; NaN without any, or if angles cancel."""
    number = is_counted.sum(axis=1)
    weight = np.where(number > 0, 1.0 / np.maximum(number, 1), np.nan)
    if circular:
        return direction(weight * np.where(is_counted, np.exp(1j * values), 0.0).sum(axis=1))
    return weight * np.where(is_counted, values, 0.0).sum(axis=1)


def _why_none(
    name: str,
    status: Shaped[np.ndarray, "sets conditions"],
    unsound: Bool[np.ndarray, "sets conditions"],
    finite: Bool[np.ndarray, " sets"],
) -> Shaped[np.ndarray, " sets"]:
    """Return why sets (n,) have no value of a column: a row is not sound, or a number is missing; else ""."""
    first_unsound = status[np.arange(len(status)), unsound.argmax(axis=1)]
    return np.where(unsound.any(axis=1), first_unsound, np.where(finite, "", f"{name} is missing"))


def _no_row(among: Mapping[str, tuple[float, float]] | None) -> str:
    """Return the reason for a set of which no row is in the ranges."""
    ranges = (f"{name} in {low:g} to {high:g}" for name, (low, high) in (among or {}).items())
    return f"no row has {' and '.join(ranges)}"


def _without_missing(values: Float[np.ndarray, " sets"]) -> Measured:
    """Return the results of sets that all have a value."""
    return Measured(values, np.full(values.size, ""))


# Values of the field `of` beside the names of observables.
_MULTIPLIER = "multiplier"
_UNSTABLE = "unstable"


class FixedPoint(Measure):
    """Multiplier of a fixed point of the return map, or an observable there.

    Newton's method begins at the point that a start reaches after `settle` cycles, so the fixed point may be
    unstable; the map needs located events. A fixed point on a line of them counts, too.
    Multipliers that exceed 1 by less than 1e-6 are neutral, not unstable.
    """

    on_map: ClassVar[bool] = True
    angle_field: ClassVar[str | None] = "of_"
    unit_field: ClassVar[str | None] = "of_"

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
        """Measure n sets at their one condition.

        Args:
            mapping: the return map.
            values: parameters (n,) by name.
            starts: start values (n,) by name.
            n: the number of sets.
        """
        points, statuses = mapping.settled(starts, values, self.settle)
        fixed_points = newton(mapping, points, values, fix=self.fix)
        measured = np.full(n, np.nan)
        has_crossed = statuses == ReturnStatus.crossed
        fixed = np.flatnonzero(fixed_points.fixed & has_crossed)
        if fixed.size:
            images = fixed_points.images
            if self.of_ in images.observed:
                measured[fixed] = np.asarray(images.observed[self.of_], float)[fixed]
            else:
                names = [quantity.name for quantity in mapping.conserved]
                constrained = [names.index(name) for name in self.fix]
                conserved = images.conserved_jacobian[fixed][:, constrained]
                moduli = np.abs(multipliers(images.jacobian[fixed], conserved))
                numbers = moduli[:, 0] if self.of_ == _MULTIPLIER else (moduli > 1.0 + EDGE).sum(axis=1)
                # NaN where the map has no derivative
                measured[fixed] = np.where(np.isnan(moduli).any(axis=1), np.nan, numbers)
        why = np.full(n, "", object)
        for k in np.flatnonzero(np.isnan(measured)):
            outcome = NewtonOutcome(fixed_points.outcome[k]).sentence.removesuffix(".")
            reason = outcome if has_crossed[k] else ReturnStatus(statuses[k]).name
            is_fixed = has_crossed[k] and fixed_points.fixed[k]
            why[k] = f"no {self.of_} at the fixed point" if is_fixed else f"no fixed point found ({reason})"
        return Measured(measured, why)

    @property
    def own_run(self) -> RunKind | None:
        return None

    def field_error(self, columns: Sequence[str], model: Model) -> FieldError:
        lists = [name for name, values in self.at.items() if len(values) > 1]
        if lists:
            return "at", f"has a list of {lists[0]}, but a fixed point takes one number for each name."
        allowed = [_MULTIPLIER, _UNSTABLE, *(quantity.name for quantity in model.observables)]
        if self.of_ not in allowed:
            return "of", f"is {unknown_name(self.of_, allowed)}"
        chart = model.chart()
        conserved = [] if chart is None else [quantity.name for quantity in chart.conserved]
        for name in self.fix:
            if name not in conserved:
                return "fix", f"is {unknown_name(name, conserved)}"
        return None
