"""Self-check of a run: a sample of its rows is rerun, with the same steps and with finer ones.

The rerun with the same steps has to reproduce the stored rows. The finer steps (or tolerances) are no simple
share of the run's own, so that events which all of its steps miss are detected as well. A row that differs
is rerun from starts moved by 1e-9: if these differ as much, the row lies on a boundary between basins, or is
sensitive, and does not test the numerics.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import jax
import numpy as np
import pandas as pd
from jaxtyping import Bool, Float, Int

from gaitsweep.contract import HybridModel, Model, Quantity
from gaitsweep.engine.content import cached_by_content
from gaitsweep.engine.kernel.lanes import over_started_rows
from gaitsweep.engine.numerics import STEP_FACTOR, tolerance_scale
from gaitsweep.engine.poincare.maps import wrap_difference
from gaitsweep.engine.poincare.return_map import REFINED
from gaitsweep.engine.recorders.bounds import unscaled
from gaitsweep.engine.recorders.perturb import PerturbRecorder
from gaitsweep.engine.recorders.recorder import Recorder
from gaitsweep.engine.recorders.recordings import (
    CrossingRecorder,
    FixedTimeRecorder,
    TraceRecorder,
    end_values,
)
from gaitsweep.engine.recorders.settle import SettleRecorder
from gaitsweep.engine.recorders.staircase import StepRecorder
from gaitsweep.engine.recorders.states import StateRecorder
from gaitsweep.engine.solver.methods import fixed_step_scheme
from gaitsweep.engine.solver.runge_kutta import euler_update
from gaitsweep.engine.sweep.lane import RowDrive
from gaitsweep.engine.sweep.sweep import sweep
from gaitsweep.engine.sweep.sweep_spec import SweepProgress
from gaitsweep.kinds.columns import gaits
from gaitsweep.kinds.run_kind import StartingPoints, TableRunKind
from gaitsweep.kinds.settle import SettlesRows
from gaitsweep.row_outcome import RowOutcome
from gaitsweep.runs.prepare import RunContext, nominal_period
from gaitsweep.runs.repeating_rows import most_reruns, repeating_rows
from gaitsweep.runs.self_check_result import (
    CROSSINGS,
    LEAST_ROWS,
    SelfCheck,
    changes,
    counted,
    finer_share,
    is_checked,
    sample_rows,
    sizes,
)
from gaitsweep.runs.unstable_rests import unstable_rests
from gaitsweep.status import RECURRENT, Status
from gaitsweep.table.manifest import TOLERANCES

Rows = Int[np.ndarray, " rows"]  # numbers of rows
RowMask = Bool[np.ndarray, " rows"]
PerRow = Float[np.ndarray, " rows"]  # a number for each row
Observed = Float[np.ndarray, "rows observables"]
# A run that records its crossings is compared as it is, if it has no more than these.
MOST_CROSSINGS = 100
# The distance by which starts are moved (in their unit, or as a share where they are larger than 1).
MOVED = 1e-9
# The tolerance of kinds that have none, as a share of an observable's size (rad for angles).
TOLERANCE = 1e-3
# The change by the step of a model that defines it, from which a row is marked; as `TOLERANCE`.
STEP_TOLERANCE = 0.1
# Errors of a start that explain a difference: their effect is extrapolated from that of MOVED.
LOCAL_ERROR = 1e-6  # by the steps of the integration
ROUNDING_ERROR = 1e-12
# Numbers of stored rows may differ by this share of their size from those of the same rows run again.
ROUNDING = 1e-6


@dataclasses.dataclass(frozen=True)
class RerunRows:
    """Rows (n,) that were rerun with the same steps, with their recorder and their results."""

    rows: Rows
    recorder: Recorder
    result: RowOutcome | StartingPoints


def self_check(
    context: RunContext, count: int, on_progress: Callable[[SweepProgress], None]
) -> tuple[SelfCheck | None, RerunRows | None]:
    """Rerun a sample of a job's rows, and compare its results with those of finer steps.

    Args:
        context: the job's context.
        count: rows of the sample; 0 turns it off.
        on_progress: progress callback.

    Returns:
        The result, None if the self-check is off or nothing is integrated; and the rows rerun with the same
        steps, for `compare_stored`.
    """
    if count == 0 or not is_checked(context):
        return None, None
    rows = sample_rows(context.design, count)
    finer = finer_share(context)
    words = f"{finer:.2g} of the step"
    if context.spec.numerics.adaptive:
        words = f"tolerances {1.0 / tolerance_scale(finer):.0f} times finer"
    check = SelfCheck(rows.size, context.design.n_rows, words)
    comparison = _Comparison(context, on_progress)
    if isinstance(run := context.job.run, TableRunKind):
        once, refined = run.starting_points(context.design, context.spec, rows, 1.0, finer)
        return check, comparison.compare_starting_points(rows, once, refined, check)
    rerun = None
    if run.compared in ("settled", "ends"):
        rerun, resting = comparison.compare_ends(rows, check)
        rows = rows[~resting]
    if rows.size:
        crossings = comparison.compare_crossings(rows, check)
        rerun = rerun or crossings
    return check, rerun


def add_rows(
    context: RunContext,
    check: SelfCheck,
    rerun: RerunRows,
    rows: Rows,
    on_progress: Callable[[SweepProgress], None],
) -> RerunRows:
    """Compare further rows of a run that compares the ends of its rows.

    Args:
        context: the job's context.
        check: the result of a self-check, to which they are added.
        rerun: the rows that it reran with the same steps.
        rows: the further rows (n,).
        on_progress: progress callback.

    Returns:
        All rows that were rerun with the same steps.
    """
    more, _ = _Comparison(context, on_progress).compare_ends(rows, check)
    assert isinstance(rerun.result, RowOutcome)
    assert isinstance(more.result, RowOutcome)
    check.rows += rows.size
    check.added = rows.size
    joined = np.concatenate([rerun.rows, rows])
    order = np.argsort(joined)
    outcome = RowOutcome.concat([rerun.result, more.result]).take(order)
    return RerunRows(joined[order], rerun.recorder, outcome)


def compare_stored(
    context: RunContext,
    check: SelfCheck,
    rerun: RerunRows,
    stored: Callable[[Rows], pd.DataFrame],
    on_progress: Callable[[SweepProgress], None],
) -> None:
    """Count in `check` the rows whose stored records differ from those of the rerun.

    Args:
        context: the job's context.
        check: the result of a self-check.
        rerun: the rows that it reran with the same steps.
        stored: returns the stored records of rows (n,).
        on_progress: progress callback.
    """
    run = context.job.run
    comparison = _Comparison(context, on_progress)
    if isinstance(rerun.result, StartingPoints):
        assert isinstance(run, TableRunKind)
        records = stored(rerun.rows)
        differs = _other_beginnings(context.model, run, rerun.result, rerun.rows, records)
        if differs.any():
            # a branch that was lost or has a kink was followed again from the fixed point of the refined map
            rows = rerun.rows[differs]
            (refined,) = run.starting_points(context.design, context.spec, rows, REFINED)
            differs[differs] = _other_beginnings(context.model, run, refined, rows, records)
    elif run.one_a_row:
        records = stored(rerun.rows)
        differs = comparison.other_ends(rerun, records)
    else:
        few = rerun.rows[:LEAST_ROWS]
        if context.spec.recorder != rerun.recorder:
            rerun = RerunRows(few, context.spec.recorder, comparison.beginnings([(few, 1.0, 0.0)])[0])
        records = stored(rerun.rows)
        differs = _other_records(context.model, rerun, records)
        records = records.loc[np.isin(records["row"].to_numpy(), few)]
    check.stored_differs = int(differs.sum())
    unstable = comparison.unstable(records)
    check.unstable = len(unstable)
    if check.unstable:
        check.unstable_first = _place_of(context, unstable.iloc[:1].to_dict("records")[0])


def look_at_unsettled(
    context: RunContext, check: SelfCheck, unsettled: Rows, on_progress: Callable[[SweepProgress], None]
) -> None:
    """Describe in `check` the rows that errors of the integration keep from settling.

    Args:
        context: the job's context.
        check: the result of a self-check.
        unsettled: the rows (n,) that ended as `cycle_limit`, before a push if there is one.
        on_progress: progress callback.
    """
    run = context.job.run
    if unsettled.size and isinstance(run, SettlesRows) and most_reruns(context):
        comparison = _Comparison(context, on_progress)
        check.repeating = repeating_rows(
            context,
            run.settling(context.model),
            unsettled,
            lambda recorder, rows, share: comparison.repeated(recorder, [(rows, share, 0.0)])[0],
        )


def _place_of(context: RunContext, record: Mapping[Any, Any]) -> dict[str, float]:
    """The row of a record, with the moving parameter there, or the row's values of the axes."""
    row = int(record["row"])
    moved = context.job.run.moved
    if moved is not None:
        return {"row": row, moved: float(record[moved])}
    parameters, starts = context.design.values_in(np.array([row]))
    values = {**starts, **parameters}
    return {"row": row} | {name: float(values[name][0]) for name in context.design.names if name in values}


@cached_by_content(maxsize=16)
def _observed(model: Model, dtype: str, drive: RowDrive | None) -> Callable[..., Observed]:
    """The function `(values, starts) -> observables (n, k)` of rows at their starts."""
    return over_started_rows(_stacked(model), "observed", model, dtype, drive)


@cached_by_content(maxsize=16)
def _motion(model: HybridModel, dtype: str, drive: RowDrive | None) -> Callable[..., Observed]:
    """The function `(values, starts) -> motion (n, k)` of observables in a period, at the starts' rates."""

    def motion(params: Any, state: Any) -> jax.Array:
        rates = model.flow(params, state)
        along = jax.jvp(lambda t: _stacked(model)(params, euler_update(state, rates, t)), (0.0,), (1.0,))[1]
        return jax.numpy.abs(along) * model.period(params)

    return over_started_rows(motion, "motion", model, dtype, drive)


def _stacked(model: Model) -> Callable[[Any, Any], jax.Array]:
    """The function `(params, state) -> observables (k,)` of a model."""

    def observed(params: Any, state: Any) -> jax.Array:
        observables = model.observe(params, state)
        return jax.numpy.stack([observables[q.name] for q in model.observables])

    return observed


@dataclasses.dataclass(frozen=True)
class _DifferingEnds:
    """Rows (n,) whose ends differ with finer steps.

    Args:
        once: their results with the same steps.
        other_status, other_gait, other_count: masks of what differs.
        off: a mask (n, k) of observables that change by more than is allowed.
        change: the changes (n, k) of observables.
    """

    once: RowOutcome
    other_status: RowMask
    other_gait: RowMask
    other_count: RowMask
    off: Bool[np.ndarray, "rows observables"]
    change: Observed


def _tolerance(recorder: Recorder) -> Float[np.ndarray, ...]:
    """The tolerance on a change, a share of an observable's size: that of settling, if rows settle."""
    match recorder:
        case StateRecorder(base=SettleRecorder() as settle) | PerturbRecorder(settle=settle):
            return np.asarray(settle.tolerance)
        case SettleRecorder():
            return np.asarray(recorder.tolerance)
        case _:
            return np.asarray(TOLERANCE)


@dataclasses.dataclass(frozen=True)
class _Comparison:
    """Comparison of reruns of some rows of a run with each other and with stored records."""

    context: RunContext
    on_progress: Callable[[SweepProgress], None]

    def unstable(self, records: pd.DataFrame) -> pd.DataFrame:
        """Return the first record of each row on an unstable gait, from all records of some rows."""
        run = self.context.job.run
        rests = run.rests(self.context.model, records)
        if rests is None:
            return records.iloc[:0]
        rests["row"] = records["row"]
        if run.moved is not None:
            rests[run.moved] = records[run.moved]

        def on_following(share: float) -> None:
            self.on_progress(SweepProgress(0, 0, share, 0, 0.0, "the following of displaced states"))

        return unstable_rests(
            self.context,
            rests,
            self.observed_at_starts(np.unique(records["row"].to_numpy(np.int64))),
            lambda rows, recorder: self.repeated(recorder, [(rows, 1.0, 0.0)])[0],
            on_following,
        )

    def repeated(
        self, recorder: Recorder, lanes: list[tuple[Rows, float, float]], most_samples: int | None = None
    ) -> list[RowOutcome]:
        """Return the results of rerun rows for each item of `lanes`.

        Args:
            recorder: their recorder.
            lanes: items of rows (n,), the share of their step, and by how much their starts are moved.
            most_samples: the samples after which rows are not followed any more; they are complete.
        """
        spec, design = self.context.spec, self.context.design
        rows = np.concatenate([lane[0] for lane in lanes])
        shares = np.concatenate([np.full(lane[0].size, lane[1]) for lane in lanes])
        moves = np.concatenate([np.full(lane[0].size, lane[2]) for lane in lanes])

        def values(first: int, last: int) -> tuple[dict[str, PerRow], dict[str, PerRow]]:
            part = slice(first, last)
            parameters, starts = design.values_in(rows[part])
            moved = {
                name: start + np.where(np.isnan(start), 0.0, moves[part] * np.maximum(np.abs(start), 1.0))
                for name, start in starts.items()
            }
            return parameters, {**moved, STEP_FACTOR: shares[part]}

        # programs of XLA are compiled for the width of the run that is checked
        width = spec.lanes if spec.engine == "xla" else min(spec.lanes, max(8, rows.size))
        sample = dataclasses.replace(
            spec,
            recorder=recorder,
            n_rows=rows.size,
            block=rows.size,
            lanes=width,
            values=values,
            most_samples=most_samples,
            # the run's program is compiled already; another one would take longer to optimise than to run
            quick=spec.quick or recorder != spec.recorder,
        )
        outcomes: list[RowOutcome] = []
        sweep(sample, [0], lambda _, result: outcomes.append(result), self.on_progress)
        outcome = outcomes[0] if most_samples is None else _with_first(outcomes[0], most_samples)
        cuts = np.cumsum([lane[0].size for lane in lanes])[:-1]
        return [outcome.take(part) for part in np.split(np.arange(rows.size), cuts)]

    def beginnings(self, lanes: list[tuple[Rows, float, float]]) -> list[RowOutcome]:
        """As `repeated` by the run's own program, with the first samples alone of rows that have many."""
        recorder = self.context.spec.recorder
        most = None
        if isinstance(recorder, CrossingRecorder) and (recorder.crossings or math.inf) > MOST_CROSSINGS:
            most = max(1, CROSSINGS - recorder.after_cycles) + 1
        elif isinstance(recorder, TraceRecorder):
            most = MOST_CROSSINGS
        elif isinstance(recorder, StepRecorder):
            most = 2  # stairs
        return self.repeated(recorder, lanes, most)

    def compare_ends(self, rows: Rows, check: SelfCheck) -> tuple[RerunRows, RowMask]:
        """Compare the ends of rows (n,); return the rerun, and a mask of those that settled in both runs."""
        recorder, model = self.context.spec.recorder, self.context.model
        once, finer = self.repeated(recorder, [(rows, 1.0, 0.0), (rows, finer_share(self.context), 0.0)])
        at_times = self.context.job.run.compared == "ends"
        ends, finer_ends = (end_values_of(recorder, outcome) for outcome in (once, finer))
        sound = Status.SOUND.among(once.status)
        other_status = once.status != finer.status
        other_gait = ~other_status & _others(recorder, once, finer)
        fixed_steps = fixed_step_scheme(self.context.spec.numerics.method, model) is not None
        other_count = ~other_status & at_times & (not fixed_steps) & (once.cycles != finer.cycles)
        # an orbit of several cycles may have been read at another of its points, and rows without a period
        # do not end at one point
        comparable = sound & ~other_status & ~other_gait & (once.numbers["period"] <= 1)
        comparable &= ~RECURRENT.among(once.status)
        change = _changes_or_losses(model, ends, finer_ends)
        size = self._sizes(rows, change, np.concatenate([self.observed_at_starts(rows), ends]))
        check.record_changes(model.observables, change[comparable], size)
        off = np.zeros_like(change, bool)
        if not fixed_steps or not at_times:
            counts = counted(model, ends[comparable], finer_ends[comparable])
            bound = np.where(counts, 0.0, TOLERANCES * _tolerance(recorder) * size)
            off = comparable[:, None] & (change > bound)
            other_count |= np.any(off & counts, axis=1)
        differs = other_status | other_gait | other_count | off.any(axis=1)
        if fixed_steps and at_times:
            check.by_step += int(np.sum(comparable & np.any(change > STEP_TOLERANCE * size, axis=1)))
        if differs.any():
            differing = _DifferingEnds(
                once.take(np.flatnonzero(differs)),
                other_status[differs],
                other_gait[differs],
                other_count[differs],
                off[differs],
                change[differs],
            )
            chaotic = (once.status == Status.chaotic) | (finer.status == Status.chaotic)
            self._explain(differing, rows[differs], chaotic[differs], check)
        resting = at_times | sound | other_status | Status.FAILED.among(once.status)
        return RerunRows(rows, recorder, once), np.broadcast_to(resting, rows.shape)

    def _explain(self, differing: _DifferingEnds, rows: Rows, chaotic: RowMask, check: SelfCheck) -> None:
        """Count rows that differ with finer steps, as sensitive if moved starts change them as much.

        Args:
            differing: the differences.
            rows: the rows (n,).
            chaotic: a mask (n,) of those with a chaotic end; the smallest of its errors decides whether such
                a row falls after many cycles.
            check: the result that counts them.
        """
        recorder, model = self.context.spec.recorder, self.context.model
        at_times = self.context.job.run.compared == "ends"
        once = differing.once
        ends = end_values_of(recorder, once)
        flips = chaotic.copy()
        spread = np.zeros(ends.shape)
        for moved in self.repeated(recorder, [(rows, 1.0, MOVED), (rows, 1.0, -MOVED)]):
            flips |= moved.status != once.status
            flips |= _others(recorder, moved, once)
            flips |= at_times & (moved.cycles != once.cycles)
            spread = np.fmax(spread, _changes_or_losses(model, end_values_of(recorder, moved), ends))
        unexplained = differing.change > spread / MOVED * LOCAL_ERROR
        wrong = np.any(differing.off & unexplained, axis=1)
        discrete = differing.other_status | differing.other_gait | differing.other_count
        sensitive = np.where(discrete, flips | (differing.other_count & ~wrong), ~wrong)
        check.record_rows(rows[sensitive], rows[~sensitive])
        check.status_differs += int((differing.other_status & ~sensitive).sum())
        check.gait_differs += int((differing.other_gait & ~sensitive).sum())
        check.count_differs += int((differing.other_count & ~sensitive).sum())
        check.moved += int((wrong & ~discrete).sum())

    def compare_crossings(self, rows: Rows, check: SelfCheck) -> RerunRows:
        """Compare the first crossings of rows (n,) and their times; return the rerun.

        Rows that do not cross the section are compared after as many nominal periods.
        """
        model, recorder = self.context.model, self.context.spec.recorder
        lanes = [(rows, 1.0, 0.0), (rows, finer_share(self.context), 0.0), (rows, 1.0, MOVED)]
        if isinstance(recorder, CrossingRecorder):
            outcomes = self.beginnings(lanes)
        else:
            recorder = CrossingRecorder(model, crossings=CROSSINGS)
            outcomes = self.repeated(recorder, lanes)
        samples = [_crossings(outcome, rows.size, recorder.after_cycles) for outcome in outcomes]
        stays = ~np.isfinite(samples[0][:, 1:]).any(axis=(1, 2)) & (outcomes[0].status == outcomes[1].status)
        if not stays.any() or not math.isfinite(end := self.comparable_time):
            self._compare_samples(rows, outcomes, samples, check)
            return RerunRows(rows, recorder, outcomes[0])
        if not stays.all():
            crossing = [outcome.take(np.flatnonzero(~stays)) for outcome in outcomes]
            self._compare_samples(rows[~stays], crossing, [of_run[~stays] for of_run in samples], check)
        at_end = FixedTimeRecorder(model, end)
        ends = self.repeated(at_end, [(rows[stays], share, move) for _, share, move in lanes])
        starts = self.observed_at_starts(rows[stays])
        observed = [np.stack([starts, end_values(outcome)], axis=1) for outcome in ends]
        samples = [np.concatenate([np.zeros((*at.shape[:2], 1)), at], axis=2) for at in observed]
        self._compare_samples(rows[stays], ends, samples, check)
        return RerunRows(rows, at_end, ends[0]) if stays.all() else RerunRows(rows, recorder, outcomes[0])

    def _compare_samples(
        self,
        rows: Rows,
        outcomes: Sequence[RowOutcome],
        samples: Sequence[Float[np.ndarray, "rows crossings columns"]],
        check: SelfCheck,
    ) -> None:
        """Compare rows (n,) by samples of three runs: with the same steps, finer ones, and moved starts.

        Args:
            rows: the rows.
            outcomes: their results, one for each run.
            samples: times (s) and observables (n, samples, 1 + k), one array for each run.
            check: the result that counts the rows that differ.
        """
        model = self.context.model
        once, finer, moved = outcomes
        differs = once.status != finer.status
        boundary = differs & (once.status != moved.status)
        check.record_rows(rows[boundary], rows[differs & ~boundary])
        check.status_differs += int((differs & ~boundary).sum())
        observed, times = [run[..., 1:] for run in samples], [run[..., 0] for run in samples]
        most, spread = (_largest_change(model, samples[0], other) for other in samples[1:])
        size = self._sizes(rows, most, observed[0])
        check.record_changes(model.observables, most, size)
        if fixed_step_scheme(self.context.spec.numerics.method, model) is not None:
            # the step is part of such a model: changes with it are marked, but are no fault of the run
            check.by_step += int(np.sum(~differs & np.any(most > STEP_TOLERANCE * size, axis=1)))
            return
        counts = counted(model, observed[0], observed[1])
        off = most > np.where(counts, 0.0, TOLERANCES * TOLERANCE * size)
        # a change that a start moved by 1e-9 also causes is due to the sensitivity of the motion
        wrong = off & (most > spread / MOVED * LOCAL_ERROR)
        late = np.nanmax(np.abs(times[0] - times[1]), axis=1, initial=0.0)
        late_if_moved = np.nanmax(np.abs(times[0] - times[2]), axis=1, initial=0.0) / MOVED * LOCAL_ERROR
        interval = np.fmin(_mean_interval(times[0]), _mean_interval(times[1]))
        off_time = late > TOLERANCES * TOLERANCE * interval
        check.record_changes((Quantity("t", "s", "time"),), late[:, None], interval[:, None])
        other_count = ~differs & np.any(wrong & counts, axis=1)
        off_row = ~differs & ~other_count & (wrong.any(axis=1) | (off_time & (late > late_if_moved)))
        check.count_differs += int(other_count.sum())
        check.moved += int(off_row.sum())
        unsure = (off.any(axis=1) | off_time) & ~differs & ~other_count & ~off_row
        check.record_rows(rows[unsure], rows[other_count | off_row])

    def compare_starting_points(
        self, rows: Rows, once: StartingPoints, finer: StartingPoints, check: SelfCheck
    ) -> RerunRows:
        """Compare the fixed points at which the branches of rows (n,) begin; return the rerun."""
        model = self.context.model
        both = once.exists & finer.exists
        check.status_differs = int(np.sum(once.exists != finer.exists))
        change = changes(model, once.observed, finer.observed)
        size = self._sizes(rows, change[both], once.observed[once.exists])
        check.record_changes(model.observables, change[both], size)
        check.moved = int(np.sum(both & np.any(change > TOLERANCES * TOLERANCE * size, axis=1)))
        return RerunRows(rows, self.context.spec.recorder, once)

    def other_ends(self, rerun: RerunRows, stored: pd.DataFrame) -> RowMask:
        """Return a mask of the rows (n,) that end differently in the rerun."""
        model, result = self.context.model, rerun.result
        assert isinstance(result, RowOutcome)
        status = stored["status"].astype(str).to_numpy()
        simulated = status != Status.inferred.name
        differs = simulated & (status != np.array([Status(code).name for code in result.status]))
        sound = simulated & ~differs & Status.SOUND.among(status)
        gait = np.asarray(gaits(model, result.labels["gait"]).astype(object))
        differs |= sound & (stored["gait"].astype(object).to_numpy() != gait)
        names = [f"{q.name}_end" for q in model.observables]
        now = end_values_of(rerun.recorder, result)
        before = stored[names].to_numpy(float)
        change = _changes_or_losses(model, now, before)
        off = sound[:, None] & (change > ROUNDING * sizes(model.observables, now))
        if off.any():
            places = np.flatnonzero(off.any(axis=1))
            lanes = [(rerun.rows[places], 1.0, MOVED)]
            moved = end_values_of(rerun.recorder, self.repeated(rerun.recorder, lanes)[0])
            by_rounding = _changes_or_losses(model, moved, now[places]) / MOVED * ROUNDING_ERROR
            off[places] &= ~(change[places] <= by_rounding)
        return differs | off.any(axis=1)

    def _sizes(
        self, rows: Rows, change: Observed, observed: Float[np.ndarray, "... observables"]
    ) -> Float[np.ndarray, " observables"]:
        """Return the sizes (k,) of observables, from their values (..., k) in some rows (n,).

        Where the section keeps an observable at 0, its values there are rounding, relative to its motion
        between crossings. So `ROUNDING` of that is its least size, if a change (n, k) is beyond tolerance.
        """
        model = self.context.model
        size, own = sizes(model.observables, observed), unscaled(model)
        if isinstance(model, HybridModel) and np.any(change[:, own] > TOLERANCE * size[own]):
            motion = self._at_starts(_motion, rows)[:, own]
            of_rounding = ROUNDING * np.max(np.where(np.isfinite(motion), motion, 0.0), axis=0)
            size[own] = np.maximum(size[own], of_rounding)
        return size

    def observed_at_starts(self, rows: Rows) -> Observed:
        """Return the observables (n, k) of rows at their starts."""
        return self._at_starts(_observed, rows)

    def _at_starts(self, function: Callable[..., Callable[..., Observed]], rows: Rows) -> Observed:
        """Return the values (n, k) of `_observed` or `_motion` for some rows."""
        model, spec = self.context.model, self.context.spec
        values, starts = self.context.design.values_in(rows)
        return function(model, spec.numerics.dtype, spec.drive)(model.on_host(values), starts)

    @property
    def comparable_time(self) -> float:
        """Time (s) after which rows without a section are compared: `CROSSINGS` periods, or the run's end.

        Infinite if no row has a period and the run has no end.
        """
        period = nominal_period(self.context.design)
        recorder = self.context.spec.recorder
        ends = isinstance(recorder, CrossingRecorder | FixedTimeRecorder | TraceRecorder)
        longest = (recorder.duration if ends else None) or math.inf
        return longest if math.isnan(period) else min(CROSSINGS * period, longest)


def _changes_or_losses(
    model: Model, once: Float[np.ndarray, "*rows observables"], again: Float[np.ndarray, "*rows observables"]
) -> Float[np.ndarray, "*rows observables"]:
    """Return the changes (..., k) of observables, infinite where only one of the two has a value."""
    return np.where(np.isnan(once) != np.isnan(again), np.inf, changes(model, once, again))


def _largest_change(
    model: Model,
    once: Float[np.ndarray, "rows crossings columns"],
    again: Float[np.ndarray, "rows crossings columns"],
) -> Observed:
    """Return the largest changes (n, k) of observables over the `_crossings` that both results have."""
    both = np.isfinite(once[..., :1]) & np.isfinite(again[..., :1])
    change = np.where(both, _changes_or_losses(model, once[..., 1:], again[..., 1:]), np.nan)
    return np.nanmax(change, axis=1, initial=0.0)


def _other_beginnings(
    model: Model, run: TableRunKind, once: StartingPoints, rows: Rows, stored: pd.DataFrame
) -> RowMask:
    """Return a mask of the rows (n,) whose branches begin at another fixed point, or at none."""
    first = stored.drop_duplicates("row").set_index("row").reindex(rows)
    sound = (first["status"] == Status.complete.name).to_numpy(bool)
    differs = sound != once.exists
    if run.stores_starting_points and once.exists.any():
        before = first[[f"{q.name}_n" for q in model.observables]].to_numpy(float)
        size = sizes(model.observables, once.observed[once.exists])
        off = changes(model, once.observed, before) > ROUNDING * size
        differs |= sound & off.any(axis=1)
    return differs


def _other_records(model: Model, rerun: RerunRows, stored: pd.DataFrame) -> RowMask:
    """Return a mask of the rows (n,) whose first records differ in the rerun."""
    recorder, result = rerun.recorder, rerun.result
    assert isinstance(result, RowOutcome)
    quantities = {f"{q.name}_n": q for q in model.observables} | {q.name: q for q in model.signals}
    names = [name for name in recorder.names if name in stored.columns and name not in ("settled", "slowest")]
    samples = result.samples.reshape(-1, recorder.width)
    records = pd.DataFrame(samples, columns=list(recorder.names)).assign(place=result.place)
    if isinstance(recorder, StepRecorder):
        # rounding may have grown on stairs that did not settle
        records = records[records["settled"] == 1.0]
    records["nth"] = records.groupby("place").cumcount()
    number = {int(row): place for place, row in enumerate(rerun.rows)}
    known = stored.assign(
        place=[number[int(row)] for row in stored["row"]], nth=stored.groupby("row").cumcount()
    )
    if isinstance(recorder, StepRecorder):
        records["nth"] = records["stair"].astype(int)
        known["nth"] = known["stair"].astype(int)
    both = records.merge(known[["place", "nth", *names]], on=["place", "nth"], suffixes=("", " stored"))
    described = tuple(quantities.get(name, Quantity(name, "1", "")) for name in names)
    now = both[names].to_numpy(float)
    before = both[[f"{name} stored" for name in names]].to_numpy(float)
    angles = np.array([q.circular for q in described])
    off = np.abs(wrap_difference(now - before, angles)) > ROUNDING * sizes(described, now)
    off |= np.isnan(now) != np.isnan(before)
    differs = np.zeros(rerun.rows.size, bool)
    differs[both["place"].to_numpy(int)[off.any(axis=1)]] = True
    return differs


def _with_first(outcome: RowOutcome, most: int) -> RowOutcome:
    """The rows of an outcome with their first `most` samples; rows with so many are complete."""
    begins = np.cumsum(outcome.record_counts) - outcome.record_counts
    nth = np.arange(len(outcome.samples)) - np.repeat(begins, outcome.record_counts)
    status = np.where(
        outcome.record_counts >= most, outcome.status.dtype.type(Status.complete), outcome.status
    )
    return dataclasses.replace(
        outcome,
        numbers={**outcome.numbers, "status": status},
        record_counts=np.minimum(outcome.record_counts, most),
        samples=outcome.samples[nth < most],
        sample_labels={name: values[nth < most] for name, values in outcome.sample_labels.items()},
    )


def _others(recorder: Recorder, once: RowOutcome, again: RowOutcome) -> Bool[np.ndarray, " rows"]:
    """Mask of rows (n,) of two results that differ in their gait, or in a number that counts as it does."""
    differs = once.labels["gait"] != again.labels["gait"]
    for number in recorder.numbers:
        if number.compared:
            differs = differs | (once.numbers[number.name] != again.numbers[number.name])
    return differs


def end_values_of(recorder: Recorder, result: RowOutcome) -> Observed:
    """Return the observables (n, k) at the end of rows."""
    return end_values(result) if isinstance(recorder, FixedTimeRecorder) else result.last


def _mean_interval(times: Float[np.ndarray, "rows crossings"]) -> PerRow:
    """The mean time (s) between the crossings (n, m) of each row; NaN where there are fewer than two."""
    first = np.nanmin(times, axis=1, initial=np.inf)
    last = np.nanmax(times, axis=1, initial=-np.inf)
    intervals = np.isfinite(times).sum(axis=1) - 1
    return np.where(intervals > 0, (last - first) / np.maximum(intervals, 1), np.nan)


def _crossings(result: RowOutcome, n: int, after: int) -> Float[np.ndarray, "rows crossings columns"]:
    """Return times (s) and observables (n, crossings, 1 + k), NaN after the end of a row."""
    width = 1 + result.last.shape[1]
    crossings = np.full((n, CROSSINGS + 1, width), np.nan)
    samples = result.samples.reshape(-1, 1 + width)
    at = samples[:, 0].astype(int) - after
    early = at <= CROSSINGS
    crossings[result.place[early], at[early]] = samples[early, 1:]
    return crossings
