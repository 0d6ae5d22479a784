"""Batched measurement of sets of constants, each of which has a row for every condition of its measures."""

from __future__ import annotations

import dataclasses
import threading
from collections.abc import Callable, Collection, Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from jaxtyping import Bool, Int, Shaped

from gaitsweep.contract import Model
from gaitsweep.design.design import inside
from gaitsweep.engine.numerics import STEP_FACTOR
from gaitsweep.engine.poincare.return_map import BatchedReturnMap
from gaitsweep.engine.sweep.engine_choice import default_lanes
from gaitsweep.engine.sweep.sweep import sweep
from gaitsweep.engine.sweep.sweep_spec import SweepProgress
from gaitsweep.expression import ExpressionError
from gaitsweep.fitting.free_parameters import Sets
from gaitsweep.fitting.measure import Measure, Measured, MeasuredByName, RowMeasure
from gaitsweep.fitting.ramp_measures import RampMeasure, crossings_of
from gaitsweep.fitting.row_measures import FixedPoint
from gaitsweep.job import Job, JobError
from gaitsweep.job.step_lengths import too_long_steps
from gaitsweep.kinds.run_kind import RunKind
from gaitsweep.row_outcome import RowOutcome
from gaitsweep.runs.prepare import RunContext, prepare

# Parameters and starts that a row sets, by name, in the order of their names.
Condition = tuple[tuple[str, float], ...]
Values = dict[str, Shaped[np.ndarray, " ..."]]
Reasons = Shaped[np.ndarray, " sets"]  # why a set is refused, or ""


def condition_of(values: Mapping[str, float]) -> Condition:
    """Return the condition that sets these values."""
    return tuple(sorted(values.items()))


def take(columns: Mapping[str, Shaped[np.ndarray, " n"]], index: Int[np.ndarray, " some"] | slice) -> Values:
    """Return the entries of columns (n,) at some places."""
    return {name: column[index] for name, column in columns.items()}


def group_by_names(conditions: Sequence[Condition]) -> dict[tuple[str, ...], list[int]]:
    """Group the numbers of conditions by the names that they set; other names have the job's own value."""
    numbers_by_names: dict[tuple[str, ...], list[int]] = {}
    for number, condition in enumerate(conditions):
        numbers_by_names.setdefault(tuple(name for name, _ in condition), []).append(number)
    return numbers_by_names


class RowsOfSets(NamedTuple):
    """Parameters and starts of the rows of sets, set by set, and the reasons why sets are refused, or ""."""

    params: Values
    starts: Values
    refused: Reasons


def row_values_of(
    context: RunContext, constants: Values, conditions: Sequence[Condition], n: int
) -> RowsOfSets:
    """Return parameters and starts of the rows of n sets.

    Args:
        context: context of the job of a set.
        constants: constants (n,) of the sets by name.
        conditions: the conditions, each a row of every set.
        n: the number of sets.
    """
    try:
        return _row_values_of(context, constants, conditions, n)
    except ExpressionError:
        if n == 1:
            groups = context.model.parameters, context.model.initial_conditions
            params, starts = ({q.name: np.full(len(conditions), np.nan) for q in group} for group in groups)
            return RowsOfSets(params, starts, np.array(["a formula has no value"], object))
    # the sets in which a formula has no value are found by halves
    middle = n // 2
    first, second = (
        row_values_of(context, take(constants, part), conditions, size)
        for part, size in ((slice(middle), middle), (slice(middle, n), n - middle))
    )
    params, starts = (
        {name: np.append(column, after[name]) for name, column in before.items()}
        for before, after in ((first.params, second.params), (first.starts, second.starts))
    )
    return RowsOfSets(params, starts, np.append(first.refused, second.refused))


def _row_values_of(
    context: RunContext, constants: Values, conditions: Sequence[Condition], n: int
) -> RowsOfSets:
    """`row_values_of` of sets in all of which the formulas have values."""
    per_set = len(conditions)
    model = context.model
    params = {quantity.name: np.empty(n * per_set) for quantity in model.parameters}
    starts = {quantity.name: np.empty(n * per_set) for quantity in model.initial_conditions}
    refused = np.full(n, "", object)
    for names, numbers in group_by_names(conditions).items():
        columns = {name: np.repeat(column.astype(float), len(numbers)) for name, column in constants.items()}
        # a condition that sets a free constant takes precedence
        for name in names:
            of_conditions = np.array([dict(conditions[number])[name] for number in numbers], float)
            columns[name] = np.tile(of_conditions, n)
        design = context.design.with_columns(columns)
        row_values = design.at(np.arange(design.n_rows), [*params, *starts])
        rows = (np.arange(n)[:, None] * per_set + np.array(numbers)).ravel()
        for by_name in (params, starts):
            for name, column in by_name.items():
                column[rows] = row_values[name]
        for quantity in (*model.parameters, *model.initial_conditions):
            is_outside = ~inside(row_values[quantity.name], quantity)
            _refuse_sets(refused, is_outside, len(numbers), f"{quantity.name} out of range")
        too_long = too_long_steps(design, context.job.run, context.spec.numerics)
        _refuse_sets(refused, too_long, len(numbers), "steps too long")
    return RowsOfSets(params, starts, refused)


def _refuse_sets(refused: Reasons, wrong: Bool[np.ndarray, " rows"], per_set: int, why: str) -> None:
    """Set the reason of sets with a wrong row (n * per_set,), if they have no reason yet."""
    is_refused = wrong.reshape(-1, per_set).any(axis=1)
    refused[is_refused & (refused == "")] = why


# Rows of a block of a batch.
_BLOCK = 1024
_MIN_LANES = 8

# Progress callback of the rows of a batch, or None.
OnProgress = Callable[[SweepProgress], None] | None


class Population:
    """Sets of constants of one model, and the measures of each.

    Args:
        job_of: returns the job of a choice of structure; constants and conditions replace its own values.
        structure: names of the choices that `job_of` takes.
        measures: the measures by name.
        run: the run of all measures; by default that of the job, and measures may have others.

    If `run_elsewhere` is set, it computes the rows of a job elsewhere, such as on a cluster; it receives the
    job and the progress callback of `measure`.
    """

    def __init__(
        self,
        job_of: Callable[[Mapping[str, Any]], Job],
        structure: Sequence[str],
        measures: Mapping[str, Measure],
        run: RunKind | None = None,
    ) -> None:
        self._job_of = job_of
        self._structure = tuple(structure)
        self.measures = measures
        self._run = run
        self.run_elsewhere: Callable[[Job, OnProgress], pd.DataFrame] | None = None
        self._contexts: dict[tuple[Any, ...], RunContext] = {}  # by choice of structure
        self._preparing = threading.Lock()
        # conditions that several measures share are run once
        numbers: dict[Condition, int] = {}
        self._condition_numbers: dict[str, list[int]] = {}  # those of each measure
        for name, measure in measures.items():
            if not measure.on_map and measure.own_run in (None, run):
                conditions = [condition_of(values) for values in measure.conditions]
                self._condition_numbers[name] = [
                    numbers.setdefault(condition, len(numbers)) for condition in conditions
                ]
        self._conditions = list(numbers)
        self._of_runs = [] if run is not None else self._populations_of_runs()

    def _populations_of_runs(self) -> list[Population]:
        """Create a population for each run that measures have of their own, with these measures."""
        runs: list[RunKind] = []
        for measure in self.measures.values():
            if measure.own_run is not None and measure.own_run not in runs:
                runs.append(measure.own_run)
        return [
            Population(
                partial(job_with_run, self._job_of, run),
                self._structure,
                {name: measure for name, measure in self.measures.items() if measure.own_run == run},
                run,
            )
            for run in runs
        ]

    @property
    def parts(self) -> list[Population]:
        """Populations that run rows: this one, and one for each other run of the measures."""
        return [self, *self._of_runs]

    @property
    def rows_of_a_set(self) -> int:
        """Number of rows of each set."""
        return sum(part.own_rows_of_a_set for part in self.parts)

    @property
    def own_rows_of_a_set(self) -> int:
        """Number of rows of each set with this population's own run."""
        return len(self._conditions)

    def prepared(self, structure: Mapping[str, Any]) -> RunContext:
        """Return the context of the job of a choice of structure; its program is compiled once.

        Raises:
            JobError: the model does not allow the choices together.
        """
        key = tuple(structure[name] for name in self._structure)
        with self._preparing:  # batches side by side would prepare it more than once
            if key not in self._contexts:
                self._contexts[key] = prepare(self._job_of(structure))
            return self._contexts[key]

    def measure(self, sets: Sets, on_progress: OnProgress = None, share: float = 1.0) -> MeasuredByName:
        """Measure each set.

        A set with a value or a structure that the model does not allow, or with steps too long for it, has no
        values.

        Args:
            sets: constants and choices of structure, (n,) by name.
            on_progress: progress callback of the rows.
            share: the length of steps as a share of the job's own.

        Returns:
            The results (n,) by the name of the measure.
        """
        n = next(iter(sets.values())).size
        measured: MeasuredByName = {}
        rows_before = 0
        total = n * self.rows_of_a_set
        for part in self.parts:
            part.run_elsewhere = self.run_elsewhere
            on_part_progress = on_progress
            if len(self.parts) > 1:
                on_part_progress = _progress_of_part(rows_before, total, on_progress)
            measured |= part._measure_own(sets, n, on_part_progress, share)
            rows_before += n * part.own_rows_of_a_set
        return {name: measured[name] for name in self.measures}

    def _measure_own(self, sets: Sets, n: int, on_progress: OnProgress, share: float) -> MeasuredByName:
        """Measure sets on the return map, and from rows with this population's own run."""
        measured = {
            name: Measured(np.full(n, np.nan), np.full(n, "", object))
            for name, measure in self.measures.items()
            if measure.on_map or name in self._condition_numbers
        }
        for structure, numbers in self._by_structure(sets, n):
            try:
                context = self.prepared(structure)
            except JobError as error:
                for result in measured.values():
                    result.why[numbers] = f"refused: {error.diagnostics[0]}"
                continue
            constants = {name: sets[name][numbers] for name in sets if name not in self._structure}
            rows, refused = self._rows(context, constants, numbers.size, on_progress, share)
            allowed = numbers[refused == ""]
            for name, result in measured.items():
                measure = self.measures[name]
                result.why[numbers] = refused
                if measure.on_map:
                    on_map = self._on_map(context, constants, measure, numbers.size, share)
                    result.values[numbers], result.why[numbers] = on_map
                elif allowed.size:
                    of_rows = self._of_rows(measure, self._condition_numbers[name], rows, context.model)
                    result.values[allowed], result.why[allowed] = of_rows
        return measured

    def of(self, names: Collection[str]) -> Population:
        """Return a population with only these measures."""
        chosen = {name: measure for name, measure in self.measures.items() if name in names}
        population = Population(self._job_of, self._structure, chosen)
        population.run_elsewhere = self.run_elsewhere
        for part in population.parts:
            same_run = next(own for own in self.parts if own._run == part._run)
            part._contexts = same_run._contexts
            part._preparing = same_run._preparing
        return population

    def staged_evaluate(
        self,
        sets: Sets,
        first: Collection[str],
        is_measured_further: Callable[[MeasuredByName], Bool[np.ndarray, " sets"]],
        on_progress: OnProgress = None,
    ) -> MeasuredByName:
        """Measure each set in two stages: `first` of all sets, the other measures of some of them.

        Args:
            sets: constants and choices of structure, (n,) by name.
            first: names of the measures of the first stage.
            is_measured_further: returns a mask (n,) of the sets of the second stage, from the results of the
                first.
            on_progress: progress callback of the rows.

        Returns:
            The results (n,) by the name of the measure.
        """
        measured = self.of(first).measure(sets, on_progress)
        in_second = is_measured_further(measured)
        n = in_second.size
        others = [name for name in self.measures if name not in measured]
        for name in others:
            measured[name] = Measured(np.full(n, np.nan), np.full(n, "not measured", object))
        if others and in_second.any():
            remaining = {name: column[in_second] for name, column in sets.items()}
            for name, (values, why) in self.of(others).measure(remaining, on_progress).items():
                measured[name].values[in_second] = values
                measured[name].why[in_second] = why
        return {name: measured[name] for name in self.measures}

    def _by_structure(self, sets: Sets, n: int) -> list[tuple[dict[str, Any], Int[np.ndarray, " some"]]]:
        """Return the choices of structure that occur, and the numbers (m,) of the sets with each."""
        if not self._structure:
            return [({}, np.arange(n))]
        numbers: dict[tuple[Any, ...], list[int]] = {}
        for number, choices in enumerate(
            zip(*(sets[name].tolist() for name in self._structure), strict=True)
        ):
            numbers.setdefault(choices, []).append(number)
        return [
            (dict(zip(self._structure, choices, strict=True)), np.array(of_choices))
            for choices, of_choices in numbers.items()
        ]

    def _rows(
        self, context: RunContext, constants: Values, n: int, on_progress: OnProgress, share: float
    ) -> tuple[Values, Reasons]:
        """Run rows: columns (m, conditions) of the sets that are not refused, and the reasons (n,) or "".

        For a run with many records a row the columns are those of all records, whose `row` counts the rows of
        these sets.
        """
        per_set = self.own_rows_of_a_set
        params, starts, refused = row_values_of(context, constants, self._conditions, n)
        if not per_set:
            return {}, refused
        starts[STEP_FACTOR] = np.full(n * per_set, share)
        allowed = np.flatnonzero(refused == "")
        if not allowed.size:
            return {}, refused
        if self.run_elsewhere is not None and share == 1.0:
            columns = self._rows_elsewhere(context, take(constants, allowed), allowed.size, on_progress)
        else:
            rows = (allowed[:, None] * per_set + np.arange(per_set)).ravel()
            varied = frozenset(constants)
            columns = self._run_rows(context, take(params, rows), take(starts, rows), varied, on_progress)
        if context.job.run.one_a_row:
            columns = {name: column.reshape(allowed.size, per_set) for name, column in columns.items()}
        return columns, refused

    def _run_rows(
        self,
        context: RunContext,
        params: Values,
        starts: Values,
        constants: frozenset[str],
        on_progress: OnProgress,
    ) -> Values:
        """Run rows in this process; return the columns of their records.

        Args:
            context: the context of their job.
            params: parameters (n_rows,) by name.
            starts: start values (n_rows,) by name, with the factor of their steps.
            constants: names of the constants that differ between sets.
            on_progress: progress callback of the rows.
        """
        n_rows = starts[STEP_FACTOR].size

        def values(first: int, stop: int) -> tuple[Values, Values]:
            block = slice(first, stop)
            return take(params, block), take(starts, block)

        spec = dataclasses.replace(
            context.spec,
            n_rows=n_rows,
            # one size, since labels are compiled for a size and batches differ in size
            block=_BLOCK,
            lanes=_lanes(context, n_rows),
            values=values,
            # batches differ in which values are equal in all of their rows
            varied=constants.union(*(dict(condition) for condition in self._conditions)),
        )
        blocks: dict[int, RowOutcome] = {}
        sweep(spec, range(-(-n_rows // _BLOCK)), blocks.__setitem__, on_progress)
        outcome = RowOutcome.concat([blocks[number] for number in sorted(blocks)])
        table = context.job.run.table(context.model, {}, outcome)
        return {str(name): _array(table[name]) for name in table.columns}

    def _rows_elsewhere(
        self, context: RunContext, constants: Values, n: int, on_progress: OnProgress
    ) -> Values:
        """Run the rows of n sets by `run_elsewhere`, as jobs; return the columns of their records."""
        assert self.run_elsewhere is not None
        per_set = self.own_rows_of_a_set
        names = ["row", *(column.name for column in context.job.run.all_columns(context.model))]
        parts = []
        for conditions in group_by_names(self._conditions).values():
            table = self.run_elsewhere(self._job_of_rows(context, constants, conditions, n), on_progress)
            part = {name: _array(table[name]) for name in names}
            set_number, place = np.divmod(part["row"], len(conditions))
            parts.append({**part, "row": set_number * per_set + np.array(conditions)[place]})
        columns = {name: np.concatenate([part[name] for part in parts]) for name in names}
        order = np.argsort(columns["row"], kind="stable")
        return {name: column[order] for name, column in columns.items()}

    def _job_of_rows(self, context: RunContext, constants: Values, numbers: Sequence[int], n: int) -> Job:
        """Return the job whose rows are n sets at some conditions.

        Args:
            context: context of the job of a set.
            constants: constants (n,) of the sets by name; none where choices of structure alone are free.
            numbers: numbers of the conditions, which set the same names.
            n: the number of sets.
        """
        conditions = [dict(self._conditions[number]) for number in numbers]
        written = context.job.resolved()
        of_conditions = {name: [condition[name] for condition in conditions] for name in conditions[0]}
        # a condition that sets a free constant takes precedence
        of_sets = {name: column.tolist() for name, column in constants.items() if name not in of_conditions}
        if of_sets:
            groups = [of_sets, of_conditions]
        else:
            groups = [{name: values * n for name, values in of_conditions.items()}]
        varied = {name for group in groups for name in group}
        for field in ("params", "start"):
            written[field] = {name: value for name, value in written[field].items() if name not in varied}
        fields = {**written, "vary": {"zip": groups}, "verify": 0}
        return Job.model_validate(fields, context={"folder": context.job.folder})

    def _of_rows(self, measure: Measure, numbers: Sequence[int], rows: Values, model: Model) -> Measured:
        """Measure each set from the rows of the conditions with these numbers."""
        if isinstance(measure, RowMeasure):
            return measure.of_sets({name: column[:, numbers] for name, column in rows.items()}, model)
        assert isinstance(measure, RampMeasure)
        per_set = self.own_rows_of_a_set
        by_row = crossings_of(rows, per_set * (1 + int(rows["row"][-1]) // per_set))
        sets = [[by_row[first + number] for number in numbers] for first in range(0, len(by_row), per_set)]
        return measure.of_rows(sets, model)

    def middle_job(self, structure: Mapping[str, Any], constants: Mapping[str, Any], n: int) -> Job | None:
        """Return the job of n sets with the same constants, for an estimate; None if no measure has rows.

        Of conditions that set different names it has the largest group that sets the same names.

        Args:
            structure: the choice of structure.
            constants: the constants of each set by name.
            n: the number of sets.
        """
        if not self._conditions:
            return None
        largest_group = max(group_by_names(self._conditions).values(), key=len)
        columns = {name: np.full(n, value) for name, value in constants.items()}
        return self._job_of_rows(self.prepared(structure), columns, largest_group, n)

    def _on_map(
        self, context: RunContext, constants: Values, measure: Measure, n: int, share: float
    ) -> Measured:
        """Measure each of n sets on the return map."""
        assert isinstance(measure, FixedPoint)
        (values,) = measure.conditions
        params, starts, refused = row_values_of(context, constants, [condition_of(values)], n)
        measured = Measured(np.full(n, np.nan), refused)
        allowed = np.flatnonzero(refused == "")
        if allowed.size:
            spec = context.spec
            mapping = BatchedReturnMap(spec.model, (), spec.numerics.refined(share), spec.engine)
            result = measure.of_starts(mapping, take(params, allowed), take(starts, allowed), allowed.size)
            measured.values[allowed], measured.why[allowed] = result
        return measured


def job_with_run(
    job_of: Callable[[Mapping[str, Any]], Job], run: RunKind, structure: Mapping[str, Any]
) -> Job:
    """Return the job of a choice of structure with another run, without a value of what that run moves.

    Args:
        job_of: returns the job of a choice of structure.
        run: the run.
        structure: the choice of structure.

    Raises:
        JobError: the job is not valid.
    """
    job = job_of(structure)
    written = job.resolved()
    written["run"] = run.model_dump(by_alias=True, exclude_none=True)
    for field in ("params", "start"):
        written[field] = {name: value for name, value in written[field].items() if name != run.moved}
    return Job.model_validate(written, context={"folder": job.folder})


def _progress_of_part(rows_before: int, total: int, on_progress: OnProgress) -> OnProgress:
    """Return the progress callback of a part of `total` rows, before which `rows_before` are computed."""
    if on_progress is None:
        return None

    def on_part_progress(now: SweepProgress) -> None:
        share = (rows_before + now.share * now.rows) / max(total, 1)
        on_progress(dataclasses.replace(now, done=rows_before + now.done, rows=total, share=share))

    return on_part_progress


def _lanes(context: RunContext, n_rows: int) -> int:
    """Return the number of lanes for rows, as of a separate job."""
    default = default_lanes(context.engine, n_rows, context.spec.devices[0].platform)
    return min(context.job.engine.lanes or default, max(_MIN_LANES, n_rows))


def _array(column: Any) -> Shaped[np.ndarray, " records"]:
    """Convert a column of a table to an array, names as text."""
    if isinstance(column.dtype, pd.CategoricalDtype):
        names = np.array([*map(str, column.cat.categories), ""])
        return names[column.cat.codes.to_numpy()]
    return column.to_numpy() if column.dtype.kind in "fiub" else column.astype(str).to_numpy()
