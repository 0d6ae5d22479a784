"""Many sets of constants measured in one batched run: each set has a row for every condition."""

from __future__ import annotations

import dataclasses
import threading
from collections.abc import Callable, Collection, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
import pandas as pd
from jaxtyping import Bool, Int, Shaped

from gaitsweep.contract import Model
from gaitsweep.design.design import inside
from gaitsweep.engine.numerics import STEP_FACTOR
from gaitsweep.engine.poincare.return_map import BatchedReturnMap
from gaitsweep.engine.sweep.engines import default_lanes
from gaitsweep.engine.sweep.sweep import sweep
from gaitsweep.engine.sweep.sweep_spec import SweepProgress
from gaitsweep.fitting.fixed_point_measure import FixedPoint
from gaitsweep.fitting.free_parameters import Sets
from gaitsweep.fitting.measure import Measure, Measured, MeasuredByName, RowMeasure
from gaitsweep.fitting.ramp_measures import RampMeasure, crossings_of
from gaitsweep.job import Job, JobError
from gaitsweep.job.step_lengths import too_long_steps
from gaitsweep.kinds.run_kind import RunKind
from gaitsweep.row_outcome import RowOutcome
from gaitsweep.runs.prepare import RunContext, prepare

# Rows of a block of a batch.
_BLOCK = 1024

Condition = tuple[tuple[str, float], ...]
Values = dict[str, Shaped[np.ndarray, " ..."]]
Reasons = Shaped[np.ndarray, " sets"]  # why a set is refused, or ""
# Progress callback of the rows of a batch, or None.
OnProgress = Callable[[SweepProgress], None] | None


class Population:
    """Sets of constants of one model, and the measures of each.

    Args:
        job_of: returns the job of a choice of structure; constants and conditions replace its own values.
        structure: names of the choices that `job_of` takes.
        measures: the measures by name.
        run: the run of all measures; by default that of the job, and measures may have others.

    `run_elsewhere` may be set to a function that computes the rows of a job elsewhere, such as on a cluster;
    it receives the job and the progress callback of `measure`.
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
        self._context: dict[tuple[Any, ...], RunContext] = {}
        self._preparing = threading.Lock()
        # conditions that several measures share are run once
        places: dict[Condition, int] = {}
        self._rows_of = {
            name: [places.setdefault(tuple(sorted(c.items())), len(places)) for c in measure.conditions]
            for name, measure in measures.items()
            if not measure.on_map and measure.own_run in (None, run)
        }
        self._conditions = list(places)
        self._of_runs = [] if run is not None else self._populations_of_runs()

    def _populations_of_runs(self) -> list[Population]:
        """Create a population for each run kind of the measures, with these measures."""
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
        """Populations that run rows: this one, and one for each run kind of the measures."""
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
        """Return the context of the job of a choice of structure; its program is compiled once."""
        key = tuple(structure[name] for name in self._structure)
        with self._preparing:  # batches side by side would prepare it more than once
            if key not in self._context:
                self._context[key] = prepare(self._job_of(structure))
            return self._context[key]

    def measure(self, sets: Sets, on_progress: OnProgress = None, share: float = 1.0) -> MeasuredByName:
        """Measure each set; return the values by the name of the measure.

        A set with a value or a structure that the model does not allow, or with steps too long for it, has no
        values.

        Args:
            sets: constants and choices of structure, (n,) by name.
            on_progress: progress callback of the rows.
            share: the length of steps as a share of the job's own.
        """
        n = next(iter(sets.values())).size
        measured: MeasuredByName = {}
        before, total = 0, n * self.rows_of_a_set
        for part in self.parts:
            part.run_elsewhere = self.run_elsewhere
            on_part_progress = (
                on_progress if len(self.parts) == 1 else _progress_of_part(before, total, on_progress)
            )
            measured |= part._measure_own(sets, n, on_part_progress, share)
            before += n * part.own_rows_of_a_set
        return {name: measured[name] for name in self.measures}

    def _measure_own(self, sets: Sets, n: int, on_progress: OnProgress, share: float) -> MeasuredByName:
        """Measure sets on the return map, and from rows with this population's own run."""
        measured = {
            name: Measured(np.full(n, np.nan), np.full(n, "", object))
            for name, measure in self.measures.items()
            if measure.on_map or name in self._rows_of
        }
        for structure, places in self._by_structure(sets, n):
            try:
                context = self.prepared(structure)
            except JobError as error:  # choices that the model refuses together
                for result in measured.values():
                    result.why[places] = f"refused: {error.diagnostics[0]}"
                continue
            constants = {name: sets[name][places] for name in sets if name not in self._structure}
            rows, refused = self._rows(context, constants, places.size, on_progress, share)
            good = places[refused == ""]
            for name in measured:
                measure = self.measures[name]
                measured[name].why[places] = refused
                if measure.on_map:
                    at_points = self._on_map(context, constants, measure, places.size, share)
                    measured[name].values[places], measured[name].why[places] = at_points
                elif good.size:
                    result = self._select(measure, self._rows_of[name], rows, context.model)
                    measured[name].values[good], measured[name].why[good] = result
        return measured

    def of(self, names: Collection[str]) -> Population:
        """Return a population with only these measures."""
        chosen = {name: measure for name, measure in self.measures.items() if name in names}
        population = Population(self._job_of, self._structure, chosen)
        population.run_elsewhere = self.run_elsewhere
        for part in population.parts:
            same = next(own for own in self.parts if own._run == part._run)
            part._context, part._preparing = same._context, same._preparing
        return population

    def staged_evaluate(
        self,
        sets: Sets,
        first: Collection[str],
        goes_on: Callable[[MeasuredByName], Bool[np.ndarray, " sets"]],
        on_progress: OnProgress = None,
    ) -> MeasuredByName:
        """Measure each set in two stages: `first` of all sets, the other measures of some of them.

        Args:
            sets: constants and choices of structure, (n,) by name.
            first: names of the measures of the first stage.
            goes_on: returns a mask (n,) of the sets of the second stage, from the results of the first.
            on_progress: progress callback of the rows.
        """
        measured = self.of(first).measure(sets, on_progress)
        goes_on_to_second = goes_on(measured)
        n, others = goes_on_to_second.size, [name for name in self.measures if name not in measured]
        measured |= {
            name: Measured(np.full(n, np.nan), np.full(n, "not measured", object)) for name in others
        }
        if others and goes_on_to_second.any():
            remaining = {name: column[goes_on_to_second] for name, column in sets.items()}
            for name, (values, why) in self.of(others).measure(remaining, on_progress).items():
                measured[name].values[goes_on_to_second] = values
                measured[name].why[goes_on_to_second] = why
        return {name: measured[name] for name in self.measures}

    def _by_structure(self, sets: Sets, n: int) -> list[tuple[dict[str, Any], Int[np.ndarray, " some"]]]:
        """Return the choices of structure that occur, and the places (m,) of the sets with each."""
        if not self._structure:
            return [({}, np.arange(n))]
        keys = list(zip(*(sets[name].tolist() for name in self._structure), strict=True))
        places = {key: np.flatnonzero([other == key for other in keys]) for key in dict.fromkeys(keys)}
        return [(dict(zip(self._structure, key, strict=True)), place) for key, place in places.items()]

    def _rows(
        self, context: RunContext, constants: Values, n: int, on_progress: OnProgress, share: float
    ) -> tuple[Values, Reasons]:
        """Run rows: columns (m, conditions) of the sets that are not refused, and the reasons (n,) or "".

        For a run with many records a row the columns are those of all records, whose `row` counts the rows of
        these sets.
        """
        per_set = self.own_rows_of_a_set
        params, starts, refused = _values(context, constants, self._conditions, n)
        if not per_set:
            return {}, refused
        starts[STEP_FACTOR] = np.full(n * per_set, share)
        good = np.flatnonzero(refused == "")
        if not good.size:
            return {}, refused
        if self.run_elsewhere is not None and share == 1.0:
            not_refused = {name: column[good] for name, column in constants.items()}
            columns = self._rows_elsewhere(context, not_refused, on_progress)
        else:
            rows = (good[:, None] * per_set + np.arange(per_set)).ravel()
            chosen = [{name: column[rows] for name, column in by.items()} for by in (params, starts)]
            columns = self._rows_here(context, chosen, rows.size, frozenset(constants), on_progress)
        if context.job.run.one_a_row:
            columns = {name: column.reshape(good.size, per_set) for name, column in columns.items()}
        return columns, refused

    def _rows_here(
        self,
        context: RunContext,
        chosen: Sequence[Values],
        n_rows: int,
        constants: frozenset[str],
        on_progress: OnProgress,
    ) -> Values:
        """Run rows of parameters and starts `chosen`, (n_rows,) each; return the columns of their records."""

        def values(first: int, last: int) -> tuple[Values, Values]:
            parts = [{name: column[first:last] for name, column in by_name.items()} for by_name in chosen]
            return parts[0], parts[1]

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

    def _rows_elsewhere(self, context: RunContext, constants: Values, on_progress: OnProgress) -> Values:
        """Run rows by `run_elsewhere`, as jobs of their own; return the columns of their records."""
        assert self.run_elsewhere is not None
        per_set, parts = self.own_rows_of_a_set, []
        names = ["row", *(column.name for column in context.job.run.all_columns(context.model))]
        for places in _group_by_names(self._conditions).values():
            table = self.run_elsewhere(self._job_of_rows(context, constants, places), on_progress)
            part = {name: _array(table[name]) for name in names}
            number, place = np.divmod(part["row"], len(places))
            parts.append({**part, "row": number * per_set + np.array(places)[place]})
        columns = {name: np.concatenate([part[name] for part in parts]) for name in names}
        order = np.argsort(columns["row"], kind="stable")
        return {name: column[order] for name, column in columns.items()}

    def _job_of_rows(self, context: RunContext, constants: Values, places: Sequence[int]) -> Job:
        """Return the job whose rows are sets of constants (n,) at conditions that set the same names."""
        conditions = [dict(self._conditions[place]) for place in places]
        written = context.job.resolved()
        set_here = {name: [condition[name] for condition in conditions] for name in conditions[0]}
        # a condition that sets a free constant goes before it
        free = {name: column.tolist() for name, column in constants.items() if name not in set_here}
        n = next((column.size for column in constants.values()), 1)
        groups = [free, set_here] if free else [{name: values * n for name, values in set_here.items()}]
        varied = {name for group in groups for name in group}
        for field in ("params", "start"):
            written[field] = {k: v for k, v in written[field].items() if k not in varied}
        return Job.model_validate({**written, "vary": {"zip": groups}, "verify": 0})

    def _select(self, measure: Measure, places: Sequence[int], rows: Values, model: Model) -> Measured:
        """Select the conditions at `places` from rows, and measure each set."""
        if isinstance(measure, RowMeasure):
            return measure.of_sets({name: column[:, places] for name, column in rows.items()}, model)
        assert isinstance(measure, RampMeasure)
        per_set = self.own_rows_of_a_set
        by_row = crossings_of(rows, per_set * (1 + int(rows["row"][-1]) // per_set))
        sets = [[by_row[first + place] for place in places] for first in range(0, len(by_row), per_set)]
        return measure.of_rows(sets, model)

    def middle_job(self, structure: Mapping[str, Any], constants: Mapping[str, Any], n: int) -> Job | None:
        """Return the job of n sets with the same constants, for an estimate; None if no measure has rows.

        Of conditions that set different names it has the largest group that sets the same names.
        """
        if not self._conditions:
            return None
        places = max(_group_by_names(self._conditions).values(), key=len)
        columns = {name: np.full(n, value) for name, value in constants.items()}
        return self._job_of_rows(self.prepared(structure), columns, places)

    def _on_map(
        self, context: RunContext, constants: Values, measure: Measure, n: int, share: float
    ) -> Measured:
        """Measure each of n sets on the return map."""
        assert isinstance(measure, FixedPoint)
        (condition,) = measure.conditions
        params, starts, refused = _values(context, constants, [tuple(sorted(condition.items()))], n)
        measured = Measured(np.full(n, np.nan), refused)
        good = np.flatnonzero(refused == "")
        if good.size:
            spec = context.spec
            mapping = BatchedReturnMap(spec.model, (), spec.numerics.refined(share), spec.engine)
            params, starts = (
                {k: column[good] for k, column in by_name.items()} for by_name in (params, starts)
            )
            measured.values[good], measured.why[good] = measure.of_starts(mapping, params, starts, good.size)
        return measured


def job_with_run(
    job_of: Callable[[Mapping[str, Any]], Job], run: RunKind, structure: Mapping[str, Any]
) -> Job:
    """Return the job of a choice of structure with another run, without values of what that run moves.

    Raises:
        JobError: the job is not valid.
    """
    written = job_of(structure).resolved()
    written["run"] = run.model_dump(by_alias=True, exclude_none=True)
    for field in ("params", "start"):
        written[field] = {name: value for name, value in written[field].items() if name != run.moved}
    return Job.model_validate(written)


def _progress_of_part(before: int, total: int, on_progress: OnProgress) -> OnProgress:
    """Progress callback of a part of a batch of `total` rows, of which `before` come before this part."""
    if on_progress is None:
        return None

    def on_part_progress(now: SweepProgress) -> None:
        share = (before + now.share * now.rows) / max(total, 1)
        on_progress(dataclasses.replace(now, done=before + now.done, rows=total, share=share))

    return on_part_progress


def _group_by_names(conditions: Sequence[Condition]) -> dict[tuple[str, ...], list[int]]:
    """Group the places of conditions by the names that they set; other names have the job's own value."""
    places_by_names: dict[tuple[str, ...], list[int]] = {}
    for place, condition in enumerate(conditions):
        places_by_names.setdefault(tuple(name for name, _ in condition), []).append(place)
    return places_by_names


def _values(
    context: RunContext, constants: Values, conditions: Sequence[Condition], n: int
) -> tuple[Values, Values, Reasons]:
    """Return parameters and starts of the rows of n sets, set by set, and the reason of a refusal, or ""."""
    per_set = len(conditions)
    model = context.model
    params = {q.name: np.empty(n * per_set) for q in model.parameters}
    starts = {q.name: np.empty(n * per_set) for q in model.initial_conditions}
    refused = np.full(n, "", object)
    for names, places in _group_by_names(conditions).items():
        numbers = np.array([[value for _, value in conditions[place]] for place in places])
        columns = {name: np.repeat(column.astype(float), len(places)) for name, column in constants.items()}
        # a condition that sets a free constant goes before it
        columns |= {name: np.tile(numbers[:, i].astype(float), n) for i, name in enumerate(names)}
        design = context.design.with_columns(columns)
        rows = np.arange(design.n_rows)
        row_values = design.at(rows, [*params, *starts])
        at = (np.arange(n)[:, None] * per_set + np.array(places)).ravel()
        for by_name in (params, starts):
            for name, column in by_name.items():
                column[at] = row_values[name]
        for quantity in (*model.parameters, *model.initial_conditions):
            outside = ~inside(row_values[quantity.name], quantity)
            _note(refused, outside, len(places), f"{quantity.name} out of range")
        too_long = too_long_steps(design, context.job.run, context.spec.numerics)
        _note(refused, too_long, len(places), "steps too long")
    return params, starts, refused


def _lanes(context: RunContext, n_rows: int) -> int:
    """Return the number of lanes for rows, as of a separate job."""
    default = default_lanes(context.engine, n_rows, context.spec.devices[0].platform)
    return min(context.job.engine.lanes or default, max(8, n_rows))


def _array(column: Any) -> Shaped[np.ndarray, " records"]:
    """Convert a column of a table to an array, names as text."""
    if isinstance(column.dtype, pd.CategoricalDtype):
        names = np.array([*map(str, column.cat.categories), ""])
        return names[column.cat.codes.to_numpy()]
    return column.to_numpy() if column.dtype.kind in "fiub" else column.astype(str).to_numpy()


def _note(refused: Reasons, wrong: Bool[np.ndarray, " rows"], per_set: int, why: str) -> None:
    """Set the reason of sets that are refused since a row (n * per_set,) is wrong."""
    for number in np.flatnonzero(wrong.reshape(-1, per_set).any(axis=1)):
        refused[number] = refused[number] or why
