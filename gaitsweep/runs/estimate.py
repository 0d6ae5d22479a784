"""What a job would need, before it runs: rows, memory, disk and time."""

from __future__ import annotations

import dataclasses
import math
import resource
import sys
import time
from collections.abc import Sequence
from typing import Any

import jax
import numpy as np

from gaitsweep.engine.recorders.crossings import CrossingRecorder
from gaitsweep.engine.recorders.fixed_time import Hold
from gaitsweep.engine.recorders.recorder import POLL_INTERVAL
from gaitsweep.engine.recorders.settle import SettleRecorder
from gaitsweep.engine.recorders.staircase import Staircase
from gaitsweep.engine.recorders.trace import TraceRecorder
from gaitsweep.engine.sweep.engines import polls_per_chunk
from gaitsweep.engine.sweep.lane_scheduler import LaneScheduler
from gaitsweep.engine.sweep.sweep_spec import SweepSpec
from gaitsweep.job import Job, Plan
from gaitsweep.job.axes import Drawn, Spread
from gaitsweep.job.figures import table_columns
from gaitsweep.kinds.runs import Continuation, Ramp
from gaitsweep.runs.execute import prepare
from gaitsweep.runs.refined import refines

# Of the cycles that a settling row may take, the share that one takes on the whole; the chain's own is 0.37.
LIKELY_SHARE = 0.4
# Located events add some attempts to the steps of a cycle; the chain's 33 events a cycle add 2 %.
EVENTS_SHARE = 1.05
# Of a grid that refines, the share of rows that are simulated; the chain's slices of 99 x 99 need 0.15.
REFINED_SHARE = 0.2
BYTES_A_NUMBER = 8
# A part of a table has this much beside its records, and this much more for each column; an entry of a column
# that repeats itself (what varies on a grid, a status, a time that all rows share) takes this.
BYTES_A_PART, BYTES_A_COLUMN, BYTES_A_REPEAT = 900, 280, 0.3
# Points of a branch are this many times as many as the longest steps over its range: steps begin short, are
# cut where a branch bends, and a fold turns it round.
POINTS_SHARE = 1.5
# Cycles flown for each number of a point: to predict it, to correct it, and to see whether it is stable.
CYCLES_A_NUMBER = 5


@dataclasses.dataclass(frozen=True)
class Estimate:
    """What a job would need. `seconds` is the likely time, `seconds_most` that of rows at their limits.

    `simulated`: the rows that are likely run; fewer than `rows` where a run refines. `records`: those of the
    table, several for a row where a run records its way; `disk_bytes` are the table's.
    """

    rows: int
    simulated: int
    records: int
    blocks: int
    memory_bytes: int
    disk_bytes: int
    seconds: float
    seconds_most: float
    lanes: int
    device: str
    engine: str


def estimate(job: Job) -> Estimate:
    """Estimate a job's needs from its first rows, which are run for a few chunks; nothing is written.

    Raises:
        RunError: the job asks for what is not here.
    """
    ready = prepare(job)
    work = ready.work
    pace = _measured(work, float(np.min(ready.steps.dt)))
    likely, most, records = _row_needs(work, job, pace)
    slots = work.lanes * len(work.devices)
    # the last rows of a sweep leave lanes idle, so a sweep takes a whole number of its rows' rounds at least
    simulated = math.ceil(REFINED_SHARE * work.n_rows) if refines(job.run) else work.n_rows
    rounds, rounds_most = (max(rows / slots, 1.0) for rows in (simulated, work.n_rows))
    columns = table_columns(work.model, ready.plan.names, job.run)
    a_record = _bytes_of_record(ready.plan, job, columns)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)
    kept = min(work.block, work.n_rows) * records * len(columns) * BYTES_A_NUMBER
    blocks = math.ceil(work.n_rows / work.block)
    written = simulated * records * a_record + (work.n_rows - simulated) * BYTES_A_REPEAT * len(columns)
    return Estimate(
        rows=work.n_rows,
        simulated=simulated,
        records=round(work.n_rows * records),
        blocks=blocks,
        memory_bytes=int(peak + 2 * kept),
        disk_bytes=int(written + blocks * (BYTES_A_PART + BYTES_A_COLUMN * len(columns))),
        seconds=pace.compile_s + rounds * slots * likely / pace.rate,
        seconds_most=pace.compile_s + rounds_most * slots * most / pace.rate,
        lanes=work.lanes,
        device=ready.device,
        engine=ready.engine,
    )


def _bytes_of_record(plan: Plan, job: Job, columns: Sequence[str]) -> float:
    """What a record takes in a table: eight bytes for each number that no other record has."""
    model, run = plan.model, job.run
    own = {q.name for q in (*model.signals, *model.label_fields) if not q.name.startswith("contact_")}
    own |= {f"{q.name}_{end}" for q in model.observables for end in ("end", "n")}
    if run.kind not in ("trace", "staircase"):  # where all rows have the same times and values
        own |= {"t", "t_end", *([run.parameter] if isinstance(run, Ramp | Continuation) else [])}
    if isinstance(run, Continuation):
        own |= {"time", "multiplier", "multiplier_re", *(name for name in columns if "drift" in name)}
    drawn = {
        name
        for group in plan.groups
        for name, points in group.points.items()
        if group.length == plan.n_rows and isinstance(points, Spread) and isinstance(points.fraction, Drawn)
    }
    if run.kind in ("settle", "hold"):  # one record a row, so that each has its own point of a sample
        own |= drawn
    numbers = sum(name in own for name in columns)
    return numbers * BYTES_A_NUMBER + (len(columns) - numbers) * BYTES_A_REPEAT


@dataclasses.dataclass(frozen=True)
class Measured:
    """What the first rows tell: attempts of all lanes a second, and attempts and crossings of one simulated.

    `rate` is the first, `attempts` and `crossings` the others; `compile_s` was spent before.
    """

    rate: float
    compile_s: float
    attempts: float
    crossings: float


def _measured(work: SweepSpec, dt: float) -> Measured:
    """Run a chunk of the first rows, for how fast it goes and how far it comes."""
    began = time.perf_counter()
    pool = LaneScheduler(work, range(math.ceil(work.n_rows / work.block)))
    pool.refill()
    for lanes in pool.groups:
        lanes.run_chunk(0)
    compile_s = time.perf_counter() - began
    began = time.perf_counter()
    given = pool.chunk(polls_per_chunk(work))
    spent = time.perf_counter() - began
    slots = work.lanes * len(work.devices)
    rate = slots * POLL_INTERVAL * polls_per_chunk(work) / spent
    ran = pool.block_of >= 0
    simulated = float(np.sum(given.t[ran]))
    crossings = float(np.sum(given.record.cycles[ran]))
    nominal = 1.0 / _nominal_period(work)
    if crossings < 2.0 * np.count_nonzero(ran):  # too few to tell
        crossings = nominal * simulated
    if not simulated > 0.0:
        return Measured(rate, compile_s, EVENTS_SHARE / dt, nominal)
    attempts = float(np.sum(given.attempts[ran])) / simulated
    return Measured(rate, compile_s, attempts, crossings / simulated)


def _nominal_period(work: SweepSpec) -> float:
    """The first row's, in s, as its model says."""
    params, _ = work.values(0, 1)
    one = {name: np.asarray(column[0]) for name, column in params.items()}
    return float(jax.jit(lambda values: work.model.period(work.model.params(values)))(one))


def _row_needs(work: SweepSpec, job: Job, pace: Measured) -> tuple[float, float, float]:
    """Attempts that a row likely makes, those it makes at most, and the records that it leaves."""
    cycle, period = pace.attempts / pace.crossings, 1.0 / pace.crossings
    recorder = work.recorder
    if isinstance(job.run, Continuation):
        return _branch_needs(job.run, work, cycle)
    if isinstance(recorder, SettleRecorder):
        cycles = recorder.max_cycles
        if recorder.max_time is not None:
            cycles = min(cycles, recorder.max_time / period)
        return LIKELY_SHARE * cycles * cycle, cycles * cycle, 1.0
    if isinstance(recorder, Hold):
        attempts = recorder.duration / period * cycle
        return attempts, attempts, 1.0
    if isinstance(recorder, TraceRecorder):
        attempts = (recorder.after_cycles + recorder.duration / period) * cycle + recorder.samples
        return attempts, attempts, float(recorder.samples)
    if isinstance(recorder, Staircase):
        stairs = recorder.stairs
        attempts = stairs.duration / period * cycle + stairs.count
        return attempts, attempts, float(stairs.count)
    assert isinstance(recorder, CrossingRecorder)
    if recorder.duration is not None:
        crossings = recorder.duration / period
    else:
        crossings = float(recorder.after_cycles + (recorder.crossings or 0))
    return crossings * cycle, crossings * cycle, max(crossings - recorder.after_cycles, 1.0)


def _branch_needs(run: Continuation, work: SweepSpec, cycle: float) -> tuple[float, float, float]:
    """The same for a row whose branch is followed: likely along its whole range, at most to `run.most`."""
    chart = work.model.chart()
    state = sum(int(np.size(each)) for each in jax.tree.leaves(_start_of(work))) if chart is None else 0
    size = len(chart.coordinates) if chart is not None else state
    points = min(POINTS_SHARE / run.longest + math.log2(run.longest / run.step), float(run.most))
    needs = [run.settle + count * CYCLES_A_NUMBER * (size + 1) for count in (points, float(run.most))]
    return needs[0] * cycle, needs[1] * cycle, max(points, 1.0)


def _start_of(work: SweepSpec) -> Any:
    """The shapes of a row's state."""
    params, starts = work.values(0, 1)

    def begin(values: Any, start: Any) -> Any:
        return work.model.init(work.model.params(values), start)

    first = [{name: np.asarray(column[0]) for name, column in each.items()} for each in (params, starts)]
    return jax.eval_shape(begin, *first)
