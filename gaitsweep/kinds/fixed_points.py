"""Fields and checks shared by the run kinds that follow fixed points of each row's return map."""

from __future__ import annotations

import abc
import dataclasses
import time
from collections.abc import Callable, Collection, Iterator, Mapping
from typing import Any, ClassVar

import jax
import numpy as np
import pandas as pd
from jaxtyping import Bool, Float, Int
from pydantic import Field

from gaitsweep import near_miss
from gaitsweep.analysis.continuation.branch_follower import ArclengthSteps
from gaitsweep.analysis.continuation.branch_table import OF_FLOW, OF_MAP
from gaitsweep.analysis.continuation.newton import newton
from gaitsweep.analysis.continuation.stable_ranges import MARKS
from gaitsweep.contract import Model, Quantity
from gaitsweep.design import Design
from gaitsweep.engine.poincare.maps import Points, Values
from gaitsweep.engine.poincare.maps import column as column_of
from gaitsweep.engine.poincare.model_map import ModelMap
from gaitsweep.engine.poincare.return_map import BatchedReturnMap
from gaitsweep.engine.poincare.stationary_map import StationaryMap
from gaitsweep.engine.recorders.recordings import CrossingRecorder
from gaitsweep.engine.sweep.blocks_of_rows import gait_codes
from gaitsweep.engine.sweep.sweep_spec import SweepSpec
from gaitsweep.errors import ArgumentError, JobError
from gaitsweep.expression import ExpressionError, resolve
from gaitsweep.kinds.columns import AT_REST, STATUSES, Column, drifts, gaits
from gaitsweep.kinds.run_kind import (
    BlockProgress,
    StartingPoints,
    TableRunKind,
    check_derivative,
    table_columns,
)
from gaitsweep.schema.diagnostics import Diagnostic
from gaitsweep.schema.numbers import Count, CountOrZero, Flag, Positive, Text
from gaitsweep.status import Status

# Values of a kind of bifurcation that a sentence lists.
LISTED = 6


@dataclasses.dataclass(frozen=True)
class MappedRows:
    """Some rows of a job with their return map.

    Attributes:
        mapping: the map.
        values: its parameters, (n,) by name.
        starts: the start values, (n,) by name.
        numbers: the rows of the job, (n,).
        design: the rows of the job.
    """

    mapping: ModelMap
    values: dict[str, Any]
    starts: Values
    numbers: Int[np.ndarray, " rows"]
    design: Design

    def settled(self, cycles: int) -> Points:
        """The points (n,) of the rows after so many cycles."""
        return self.mapping.settled(self.starts, self.values, cycles)[0]

    def with_values(self, **values: Any) -> MappedRows:
        """The rows with these values (n,) of parameters in place of their own."""
        return dataclasses.replace(self, values={**self.values, **values})

    def without(self, *names: str) -> MappedRows:
        """The rows without the values of these parameters."""
        others = {name: column for name, column in self.values.items() if name not in names}
        return dataclasses.replace(self, values=others)


def starts_with(
    mapping: ModelMap, design: Design, given: Collection[str], starts: Values, values: Values
) -> dict[str, Any]:
    """Return starts with those evaluated anew whose formulas use some of the `given` quantities.

    Args:
        mapping: a map of the model's states.
        design: the rows of its job, which has the formulas.
        given: names of parameters and starts; the formula of a given start is not evaluated.
        starts: all starts by name, numbers or (n,).
        values: parameters of the map by name, numbers or (n,).

    Raises:
        ArgumentError: columns have different lengths.
    """
    formulas = {
        name: formula
        for name in design.order
        if name in starts and name not in given and isinstance(formula := design.settings.get(name), str)
        if not design.closure([name]).isdisjoint(given)
    }
    if not formulas:
        return dict(starts)
    known = {**mapping.resolved(values), **starts}
    used = [name for name in design.closure(formulas) if name in known and name not in formulas]
    n = max([np.size(known[name]) for name in used], default=1)
    columns = {name: column_of(name, known[name], n) for name in used}
    evaluated = resolve(formulas, {**design.sizes, **columns})
    return {**starts, **{name: evaluated[name] for name in formulas}}


class FollowsFixedPoints(TableRunKind):
    """A run kind that begins at a fixed point of each row's return map and follows it by its arclength."""

    # time in which all programs of a return map are compiled, as a multiple of that of its settling
    programs: ClassVar[float] = 4.0
    # columns that an observable of the same name does not disturb
    beside_observables: ClassVar[frozenset[str]] = frozenset()
    # columns that tell the points of a row's branches apart
    point_names: ClassVar[tuple[str, ...]] = ("point",)
    idle_without: ClassVar = {"stationary": ("stationary", "without")}

    stationary: Flag = Field(
        default=False,
        description="whether to follow stationary points of the flow, where it rests, and not cycles",
    )
    without: list[Text] = Field(
        default=[],
        description="variables of the flow that need not rest at a stationary point, such as a clock",
    )
    settle: CountOrZero = Field(
        default=100,
        description="cycles simulated before the search for the first fixed point, or implicit steps of the "
        "flow before that for the first stationary point",
    )
    fix: list[Text] = Field(
        default=[], description="conserved quantities that are held at their values after `settle` cycles"
    )
    step: Positive = Field(
        default=0.02,
        description="length of the first step, as a fraction of the parameter's range if only the "
        "parameter moves",
    )
    longest: Positive = Field(default=0.08, description="length of the longest step")
    shortest: Positive = Field(
        default=1e-4, description="shortest length of a step; below it a leap is tried"
    )
    most: Count = Field(default=300, description="largest number of points of a branch")

    @property
    def integrates(self) -> bool:
        return not self.stationary

    def recorder(self, model: Model) -> CrossingRecorder:
        # the rows are followed to where their branches begin; `block_table` does the rest
        return CrossingRecorder(model, 1, self.settle)

    @abc.abstractmethod
    def followed_again(
        self,
        rows: Design,
        spec: SweepSpec,
        numbers: Int[np.ndarray, " sampled"],
        table: pd.DataFrame,
        on_progress: BlockProgress,
    ) -> tuple[MappedRows, pd.DataFrame]:
        """The branches of some rows with their points, for the explorer.

        Args:
            rows: the job's rows.
            spec: how they are simulated.
            numbers: the rows (n,).
            table: the job's table; branches whose points it has are not followed again.
            on_progress: progress callback.

        Returns:
            The rows, without the values of the parameters that move; and a record for each point: `row`,
            counted from 0, the columns `point_names`, the parameter, and its `BranchPoints` or `StoredPoint`
            as `at`.
        """

    def check(self, rows: Design, method: str) -> list[Diagnostic]:
        of_map = self._check_flow(rows) if self.stationary else self._check_map(rows.model, method)
        return [*self.check_ranges(rows), *self._check_steps(), *of_map]

    @abc.abstractmethod
    def check_ranges(self, rows: Design) -> list[Diagnostic]:
        """Diagnostics about the ranges of the parameters."""

    def _check_steps(self) -> list[Diagnostic]:
        """Diagnostics about the lengths of the steps."""
        if not self.shortest <= self.step <= self.longest:
            limits = f"run.shortest, {self.shortest:g}, and run.longest, {self.longest:g}"
            return [Diagnostic(("run", "step"), f"is {self.step:g}, but must lie between {limits}.")]
        return []

    def _check_map(self, model: Model, method: str) -> list[Diagnostic]:
        """Diagnostics about a map without derivative, and about quantities that it does not conserve."""
        wrong = []
        if self.without:
            text = "names variables that need not rest, but cycles are followed: give run.stationary, too."
            wrong.append(Diagnostic(("run", "without"), text))
        names = [quantity.name for quantity in _conserved(model)]
        for index, name in enumerate(self.fix):
            if name not in names:
                near = near_miss.suggestion(name, names) if names else "."
                text = f"is {name}, which {model.name} does not conserve{near}"
                wrong.append(Diagnostic(("run", "fix", index), text))
        return [*wrong, *check_derivative(model, method)]

    def _check_flow(self, rows: Design) -> Iterator[Diagnostic]:
        """Diagnostics about a flow without isolated stationary points."""
        if self.fix:
            yield Diagnostic(("run", "fix"), "is for cycles: leave it out where run.stationary is true.")
        try:
            settings, values, starts = self._parameters(rows, np.zeros(1, np.int64))
            mapping = StationaryMap(rows.model, settings, tuple(self.without))
            points, _ = mapping.settled(starts, values, 0)
            refusal = mapping.refusal(points, values)
        except ArgumentError as error:
            refusal = str(error)
        except (ExpressionError, JobError):  # which the checks of formulas report
            return
        if refusal is not None:
            yield Diagnostic(("run", "stationary"), f": {refusal}")

    def starting_points(
        self, rows: Design, spec: SweepSpec, sample: Int[np.ndarray, " sampled"], *shares: float
    ) -> list[StartingPoints]:
        mapped = self.mapped_rows(rows, spec, sample)
        return_map = mapped.mapping
        assert isinstance(return_map, BatchedReturnMap)
        refined = [return_map.refined(share) or return_map for share in shares]

        def fixed_points(of_rows: MappedRows) -> StartingPoints:
            points, values = self.near_fixed_points(of_rows)
            fixed = newton(of_rows.mapping, points, values, fix=self.fix)
            observed = [fixed.images.observed[q.name] for q in rows.model.observables]
            return StartingPoints(fixed.converged, np.stack(observed, axis=1))

        return [fixed_points(dataclasses.replace(mapped, mapping=mapping)) for mapping in refined]

    @abc.abstractmethod
    def near_fixed_points(self, mapped: MappedRows) -> tuple[Points, Values]:
        """A point (n,) near the first fixed point of each row, and the parameters (n,) there."""

    def compile_time(self, rows: Design, spec: SweepSpec) -> float:
        """A multiple of the time in which one of the programs is compiled."""
        began = time.perf_counter()
        self.mapped_rows(rows, spec, np.zeros(1, np.int64)).settled(1)
        return self.programs * (time.perf_counter() - began)

    def mapped_rows(self, rows: Design, spec: SweepSpec, numbers: Int[np.ndarray, " sampled"]) -> MappedRows:
        """The rows `numbers` (n,) with their return map and their parameters at the start."""
        settings, values, starts = self._parameters(rows, numbers)
        mapping: ModelMap
        if self.stationary:
            mapping = StationaryMap(rows.model, settings, tuple(self.without))
        else:
            mapping = BatchedReturnMap(rows.model, settings, spec.numerics, spec.engine)
        return MappedRows(mapping, values, starts, numbers, rows)

    def _parameters(
        self, rows: Design, numbers: Int[np.ndarray, " sampled"]
    ) -> tuple[tuple[tuple[str, str], ...], dict[str, Any], Values]:
        """The parameters that follow others by a formula, the values of the others, and the starts."""
        parameters, starts = rows.values_in(numbers)
        following = rows.following(*(column.parameter for column in self.movements))
        values = {name: column for name, column in parameters.items() if name not in following}
        return tuple(following.items()), values, starts

    def drifts(self, model: Model) -> list[Column]:
        """The columns of the drifts of the quantities in `fix`."""
        return drifts(self.fix, _conserved(model) if self.fix else ())

    def own_columns(self, columns: list[Column]) -> list[Column]:
        """The columns of a table of cycles; where stationary points are followed, those of their table."""
        if not self.stationary:
            return columns
        of_flow: list[Column] = []
        for column in columns:
            if column.name == "multiplier":
                of_flow += [Column(name, repeats=False) for name in OF_FLOW]
            elif column.name not in (*OF_MAP, *OF_FLOW):
                of_flow.append(column)
        return of_flow

    def steps(self, on_step: Callable[[Any, Any], None]) -> ArclengthSteps:
        """The lengths of the steps; `on_step` is called before each, as in `ArclengthSteps`."""
        return ArclengthSteps(self.step, self.longest, self.shortest, self.most, on_step)

    def records(
        self,
        rows: Design,
        mapped: MappedRows,
        table: pd.DataFrame,
        has_point: Bool[np.ndarray, " records"],
    ) -> pd.DataFrame:
        """The records of a block, from the branches of its rows.

        Args:
            rows: the job's rows.
            mapped: the rows of the block.
            table: the branches; its `row` counts from 0.
            has_point: mask of the records that have a point, whose status is `complete`.
        """
        model, row, values = rows.model, table["row"].to_numpy(np.int64), mapped.values
        # observables have their names, or those of their columns where another column has the same name
        names = {q.name: f"{q.name}_n" for q in model.observables}
        present = {name: column if column in table else name for name, column in names.items()}
        codes = np.full(len(table), -1)
        if has_point.any() and not self.stationary:
            moving = {column.parameter for column in self.movements}
            at = {name: column[row[has_point]] for name, column in values.items() if name not in moving}
            at |= {name: table.loc[has_point, name].to_numpy(float) for name in moving}
            points: pd.DataFrame = table.loc[has_point]
            observed = {name: points[column].to_numpy(float) for name, column in present.items()}
            codes[has_point] = gait_numbers(mapped.mapping, at, observed, len(points))
        status = np.where(has_point, Status.complete.name, Status.no_fixed_point.name)
        plain = {name: names[name] for name, column in present.items() if column == name}
        table = table.rename(columns=plain)
        table = table.assign(
            row=mapped.numbers[row],
            gait=pd.Categorical([AT_REST] * len(table)) if self.stationary else gaits(model, codes),
            status=pd.Categorical(status, categories=STATUSES),
            **rows.at(mapped.numbers[row], rows.names),
        )
        table = table.reindex(columns=table_columns(rows, self))
        texts = {name: table[name].astype(object).fillna("") for name in ("special", "end")}
        return table.assign(**{name: pd.Categorical(text) for name, text in texts.items()})


def _conserved(model: Model) -> tuple[Quantity, ...]:
    """The quantities that the return map of a model conserves."""
    chart = model.chart()
    return () if chart is None else chart.conserved


def bifurcations_found(table: pd.DataFrame, parameter: str) -> str:
    """A sentence that lists the bifurcations on the branches of a table, by kind."""
    values = table[parameter].to_numpy(float)
    # a doubled gait that meets its parent again ends at the parent's flip
    special = table["special"].astype(str).where(table["end"].astype(str) != "flip", "")
    kinds = [kind for kind in (*MARKS, "order_change") if np.any(special == kind)]
    texts = [f"{kind.replace('_', ' ')} at {listed(values[special == kind])}" for kind in kinds]
    return f"Along {parameter}: {'; '.join(texts) or 'no bifurcation'}."


def listed(values: Float[np.ndarray, " values"]) -> str:
    """Some values, to 7 digits, each once, or their range if they are many."""
    texts = list(dict.fromkeys(f"{value:.7g}" for value in np.sort(values)))
    if len(texts) > LISTED:
        return f"{len(texts)} values from {texts[0]} to {texts[-1]}"
    return ", ".join(texts)


def gait_numbers(
    mapping: ModelMap, values: Values, observed: Mapping[str, Any], n: int
) -> Int[np.ndarray, " points"]:
    """The code of the gait of each of n fixed points, (n,), from parameters and observables (n,)."""
    model = mapping.model
    label = jax.jit(jax.vmap(lambda v, o: model.label(mapping.params(v), o)["gait"]))
    return gait_codes(np.asarray(label(mapping.complete(values, n), dict(observed))))


def unknowns(rows: Design) -> int:
    """The number of coordinates of the rows' return map."""
    chart = rows.model.chart()
    if chart is not None:
        return len(chart.coordinates)

    def initial_state(values: Any, start: Any) -> Any:
        return rows.model.init(rows.model.params(values), start)

    parameters_and_starts = rows.values_in(np.zeros(1, np.int64))
    first = [{name: column[0] for name, column in columns.items()} for columns in parameters_and_starts]
    return sum(int(np.size(leaf)) for leaf in jax.tree.leaves(jax.eval_shape(initial_state, *first)))
