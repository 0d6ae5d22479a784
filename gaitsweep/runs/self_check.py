"""Whether a run's rows would have come out otherwise at half the step: a sample of them, repeated.

The sample runs once more as it ran, and beside that with half the step, or a tolerance 32 times finer. A row
whose status or gait differs is tried again from starts moved by 1e-9: where these differ too, the row lies on
a boundary between basins, and says nothing of the numerics.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Callable
from typing import Any

import jax
import numpy as np

from gaitsweep.contract import Model, Status, Verdict
from gaitsweep.engine.numerics import SHARE
from gaitsweep.engine.poincare.maps import wrap_difference
from gaitsweep.engine.propose import own_steps
from gaitsweep.engine.recorders.crossings import CrossingRecorder
from gaitsweep.engine.recorders.settle import SETTLE_WINDOW, SettleRecorder
from gaitsweep.engine.sweep.block import BlockResult
from gaitsweep.engine.sweep.sweep import sweep
from gaitsweep.engine.sweep.sweep_spec import SweepProgress, SweepSpec
from gaitsweep.errors import UserError
from gaitsweep.job import Plan
from gaitsweep.runs.prepare import Prepared
from gaitsweep.runs.self_check_report import HALF_THE_STEP, TOLERANCES

# The sample's steps, as a share of the run's own.
HALF = 0.5
# Crossings over which rows are compared that do not come to rest, and those of kinds that do not ask for it.
CROSSINGS = 10
# A run that records its crossings is compared as it is, if it has no more than these.
MOST_CROSSINGS = 100
# By how much starts are moved (in their unit, or as a share where they are larger than 1).
MOVED = 1e-9
# The tolerance of kinds that have none (rad).
TOLERANCE = 1e-3
# A difference that starts moved by MOVED would explain if each had been off by less than this.
LOCAL_ERROR = 1e-6


class SelfCheckError(UserError):
    """A sample of a run's rows came out otherwise at half the step, and the run is strict about it."""

    exit_code = 3


@dataclasses.dataclass
class SelfCheck:
    """What a self-check found.

    `rows` repeated; of those how many came to another status (`status_differs`) or gait (`gait_differs`),
    those aside that lie on a boundary (`sensitive`); `largest` change of each observable, of settled rows
    where they ended and of others over their first crossings; `moved`, the rows that changed by more than is
    allowed; `half`: what was made finer. `verdict`: passed, warned, or off.
    """

    rows: int
    status_differs: int = 0
    gait_differs: int = 0
    sensitive: int = 0
    moved: int = 0
    largest: dict[str, float] = dataclasses.field(default_factory=dict)
    half: str = HALF_THE_STEP
    verdict: str = "passed"

    def take_largest(self, model: Model, change: np.ndarray) -> None:
        """Take the largest changes (n, observables), where they are known."""
        for i, quantity in enumerate(model.observables):
            column = change[:, i][np.isfinite(change[:, i])]
            if column.size:
                most = max(float(column.max()), self.largest.get(quantity.name, 0.0))
                self.largest[quantity.name] = most

    def judged(self) -> dict[str, Any]:
        """Its fields, with its verdict."""
        wrong = self.status_differs or self.gait_differs or self.moved
        return dataclasses.asdict(self) | {"verdict": "warned" if wrong else "passed"}


def circular(model: Model) -> np.ndarray:
    """Which observables are angles, (observables,)."""
    return np.array([quantity.circular for quantity in model.observables])


def changes(model: Model, once: np.ndarray, again: np.ndarray) -> np.ndarray:
    """How far observables (..., observables) are from each other, angles by the shorter way."""
    return np.abs(wrap_difference(once - again, circular(model)))


def sample_rows(plan: Plan, count: int) -> np.ndarray:
    """Rows (n,) that stand for all: both ends of each axis, and points that fill the others evenly.

    Args:
        plan: the job's rows.
        count: how many at most; all rows where there are no more.
    """
    if plan.n_rows <= count:
        return np.arange(plan.n_rows, dtype=np.int64)
    lengths = np.array([axis.length for axis in plan.axes], dtype=np.int64)
    strides = np.array([plan.stride(place) for place in range(lengths.size)], dtype=np.int64)
    # the additive recurrence of Roberts (2018): powers of the root of x^(d+1) = x + 1
    root = 1.5
    for _ in range(64):
        root = (1.0 + root) ** (1.0 / (lengths.size + 1))
    slopes = root ** -np.arange(1.0, lengths.size + 1.0)
    ends = [(axis, end) for axis in range(lengths.size) for end in (0, lengths[axis] - 1)]
    chosen: dict[int, None] = {}
    for k in range(64 * count):
        point = np.floor(np.mod(0.5 + k * slopes, 1.0) * lengths).astype(np.int64)
        if k < len(ends):
            axis, end = ends[k]
            point[axis] = end
        chosen.setdefault(int(np.sum(np.minimum(point, lengths - 1) * strides)))
        if len(chosen) == count:
            break
    return np.array(sorted(chosen), dtype=np.int64)


def self_check(
    ready: Prepared, count: int, progress: Callable[[SweepProgress], None] | None = None
) -> dict[str, Any]:
    """Repeat a sample of a job's rows, and compare.

    Args:
        ready: the job made ready.
        count: rows of the sample; 0 turns it off.
        progress: told how far it is.

    Returns:
        The fields of a `SelfCheck`, as the manifest has them.
    """
    if count == 0:
        return {"rows": 0, "verdict": "off"}
    rows, compared = sample_rows(ready.plan, count), ready.job.run.compared
    check = SelfCheck(rows=rows.size)
    if compared == "starting_points":
        _compare_starting_points(ready, rows, check)
        return check.judged()
    if ready.work.numerics.adaptive:
        check.half = "tolerances 32 times finer"
    if compared in ("settled", "ends"):
        resting = _compare_ends(ready, rows, check, progress)
        rows = rows[~resting]
    if rows.size:
        _compare_crossings(ready, rows, check, progress)
    return check.judged()


def _repeated(
    work: SweepSpec,
    plan: Plan,
    lanes: list[tuple[np.ndarray, float, float]],
    progress: Callable[[SweepProgress], None] | None,
) -> list[BlockResult]:
    """The results of rows that run once more, for each (rows, share, move) of the list."""
    rows = np.concatenate([each[0] for each in lanes])
    shares = np.concatenate([np.full(each[0].size, each[1]) for each in lanes])
    moves = np.concatenate([np.full(each[0].size, each[2]) for each in lanes])

    def values(first: int, last: int) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
        part = slice(first, last)
        parameters, starts = plan.values_in(rows[part])
        moved = {
            name: start + np.where(np.isnan(start), 0.0, moves[part] * np.maximum(np.abs(start), 1.0))
            for name, start in starts.items()
        }
        return parameters, {**moved, SHARE: shares[part]}

    # programs of XLA are compiled for the width of the run that is checked
    width = work.lanes if work.engine == "xla" else min(work.lanes, max(8, rows.size))
    again = dataclasses.replace(work, n_rows=rows.size, block=rows.size, lanes=width, values=values)
    found: list[BlockResult] = []
    sweep(again, [0], lambda _, result: found.append(result), progress)
    cuts = np.cumsum([0, *(each[0].size for each in lanes)])
    return [_part(found[0], int(a), int(b)) for a, b in itertools.pairwise(cuts)]


def _part(result: BlockResult, first: int, last: int) -> BlockResult:
    """The rows first..last-1 of a block, numbered from 0."""
    mine = (result.owner >= first) & (result.owner < last)
    of_rows = ("status", "cycles", "attempts", "t_end", "last", "period", "slowest", "fired")
    fields = {name: getattr(result, name)[first:last] for name in of_rows}
    labels = {name: each[first:last] for name, each in result.labels.items()}
    kept = {"owner": result.owner[mine] - first, "samples": result.samples[mine]}
    return dataclasses.replace(result, **{**fields, "first": 0, "labels": labels, **kept})


def _compare_ends(
    ready: Prepared, rows: np.ndarray, check: SelfCheck, progress: Callable[[SweepProgress], None] | None
) -> np.ndarray:
    """Compare how rows (n,) end; gives which of them came to rest, both times."""
    work, plan = ready.work, ready.plan
    once, half = _repeated(work, plan, [(rows, 1.0, 0.0), (rows, HALF, 0.0)], progress)
    other_status = once.status != half.status
    other_gait = ~other_status & (once.labels["gait"] != half.labels["gait"])
    differs = np.flatnonzero(other_status | other_gait)
    if differs.size:
        some = rows[differs]
        tried = _repeated(work, plan, [(some, 1.0, MOVED), (some, 1.0, -MOVED)], progress)
        flips = np.zeros(some.size, bool)
        for moved in tried:
            flips |= moved.status != once.status[differs]
            flips |= moved.labels["gait"] != once.labels["gait"][differs]
        check.sensitive += int(flips.sum())
        check.status_differs += int((other_status[differs] & ~flips).sum())
        check.gait_differs += int((other_gait[differs] & ~flips).sum())
    settled = (once.status == Status.settled) & (half.status == Status.settled)
    resting = settled | (once.status != half.status) | _failed(once.status)
    # an orbit of several cycles may have been read at another of its points
    same = settled & ~other_gait & (once.period <= 1)
    if ready.job.run.compared == "ends":
        same = ~other_status & ~other_gait & ~_failed(once.status)
        resting = np.ones(rows.size, bool)
    change = changes(plan.model, once.last, half.last)
    check.take_largest(plan.model, change[same])
    recorder = work.recorder
    if isinstance(recorder, SettleRecorder):
        # SETTLE_WINDOW tolerances, in each observable's unit
        bound = np.asarray(jax.jit(jax.vmap(lambda last: recorder.bound(last[None, :])))(once.last[same]))
        check.moved += int(np.sum(np.any(change[same] > TOLERANCES / SETTLE_WINDOW * bound, axis=1)))
    return resting


def _compare_starting_points(ready: Prepared, rows: np.ndarray, check: SelfCheck) -> None:
    model = ready.plan.model
    once, half = ready.job.run.starting_points(ready.plan, ready.work, rows)
    both = once.found & half.found
    check.status_differs = int(np.sum(once.found != half.found))
    change = changes(model, once.observed, half.observed)
    check.take_largest(model, change[both])
    angles = change[:, circular(model)]
    check.moved = int(np.sum(both & np.any(angles > TOLERANCES * TOLERANCE, axis=1)))


def _failed(status: np.ndarray) -> np.ndarray:
    return np.isin(status, [each for each in Status if each.verdict is Verdict.failed])


def _compare_crossings(
    ready: Prepared, rows: np.ndarray, check: SelfCheck, progress: Callable[[SweepProgress], None] | None
) -> None:
    plan, model = ready.plan, ready.plan.model
    recorder = ready.work.recorder
    if not (isinstance(recorder, CrossingRecorder) and (recorder.crossings or math.inf) <= MOST_CROSSINGS):
        recorder = CrossingRecorder(model, crossings=CROSSINGS)
    work = dataclasses.replace(ready.work, recorder=recorder)
    lanes = [(rows, 1.0, 0.0), (rows, HALF, 0.0), (rows, 1.0, MOVED)]
    once, half, moved = repeated = _repeated(work, plan, lanes, progress)
    observed = [_crossings(each, rows.size, recorder.after_cycles) for each in repeated]
    differs = once.status != half.status
    boundary = differs & (once.status != moved.status)
    check.sensitive += int(boundary.sum())
    check.status_differs += int((differs & ~boundary).sum())
    change = changes(model, observed[0], observed[1])
    spread = np.nanmax(changes(model, observed[0], observed[2]), axis=1, initial=0.0)
    most = np.nanmax(change, axis=1, initial=0.0)
    check.take_largest(model, most)
    if own_steps(ready.work.numerics.method, model) is not None:
        # its step is part of such a model: what changes with it is told, and is no fault of the run
        return
    off = np.where(circular(model), most, 0.0)
    # what a start moved by 1e-9 changes as much is the motion's own sensitivity
    own = spread / MOVED * LOCAL_ERROR
    wrong = np.any((off > TOLERANCES * TOLERANCE) & (off > own), axis=1)
    check.sensitive += int(np.sum(np.any(off > TOLERANCES * TOLERANCE, axis=1) & ~wrong))
    check.moved += int(wrong.sum())


def _crossings(result: BlockResult, n: int, after: int) -> np.ndarray:
    """The observables (n, crossings, observables), NaN where a row did not get so far."""
    observed = np.full((n, CROSSINGS + 1, result.last.shape[1]), np.nan)
    samples = result.samples.reshape(-1, 2 + result.last.shape[1])
    at = samples[:, 0].astype(int) - after
    kept = at <= CROSSINGS
    observed[result.owner[kept], at[kept]] = samples[kept, 2:]
    return observed
