"""Estimate of the rows, memory, disk space and time of a job, before it runs."""

from __future__ import annotations

import dataclasses
import math
import resource
import sys
import time

import numpy as np

from gaitsweep.design import Design
from gaitsweep.engine.recorders.recorder import POLL_INTERVAL
from gaitsweep.engine.sweep.blocks_of_rows import labelled
from gaitsweep.engine.sweep.engine_choice import polls_per_chunk
from gaitsweep.engine.sweep.lane_scheduler import LaneScheduler
from gaitsweep.engine.sweep.sweep_spec import SweepSpec
from gaitsweep.job import Job
from gaitsweep.kinds.run_kind import TableRunKind, table_columns
from gaitsweep.runs.prepare import RunContext, nominal_period, prepare
from gaitsweep.runs.repeating_rows import most_reruns
from gaitsweep.runs.self_check_result import finer_share, is_checked, most_added, rows_to_repeat
from gaitsweep.status import Status
from gaitsweep.table.parquet_parts import arrow_part

# Attempts for each step: those at located events are more; the chain's 33 events a cycle add 2 %.
ATTEMPTS_A_STEP = 1.05
# Share of the rows of a refined grid that are simulated; the chain's slices of 99 x 99 need 0.15.
REFINED_SHARE = 0.2
BYTES_A_NUMBER = 8
BYTES_A_PART = 900  # without its records and columns
BYTES_A_COLUMN = 280  # of a part, without its entries
BYTES_A_REPEAT = 0.3  # an entry of a column that repeats itself: an axis of a grid, a status


@dataclasses.dataclass(frozen=True)
class Estimate:
    """Estimate of a job.

    Args:
        rows: the number of rows.
        simulated: the number of rows that are likely run, fewer than `rows` if the run refines.
        records: those of the table.
        records_longer: those of a table whose branches fold; for other kinds, the likely ones.
        blocks: the number of parts.
        memory_bytes: the largest memory of this process.
        disk_bytes: the size of the table.
        seconds: the likely time, as all times with `compile_s` and `self_check_s`.
        seconds_longer: that of rows whose branches fold.
        seconds_most: the time if all rows run to their limits.
        lanes: trajectories at a time.
        device: the devices, in words.
        engine: the engine's name.
        steps: the attempts of all rows.
        compile_s: the time of compilation (s).
        self_check_s: the time of the self-check (s), which the others include.
        self_check_rows: the rows that it reruns.
        added_rows: the most rows that it reruns, too, if none of these has a comparable end.
        unsettled_reruns: the most rows that it reruns, too, if they end as `cycle_limit`; `seconds_most`
            alone includes the time of both.
    """

    rows: int
    simulated: int
    records: int
    records_longer: int
    blocks: int
    memory_bytes: int
    disk_bytes: int
    seconds: float
    seconds_longer: float
    seconds_most: float
    lanes: int
    device: str
    engine: str
    steps: float
    compile_s: float
    self_check_s: float
    self_check_rows: int
    added_rows: int
    unsettled_reruns: int


def estimate(job: Job) -> Estimate:
    """Estimate a job's needs from its first rows, which are run for a few chunks; nothing is written.

    Raises:
        RunError: a device or an engine that the job asks for is not available.
    """
    began = time.perf_counter()
    context = prepare(job)  # which traces the model
    traced_s = time.perf_counter() - began
    spec = context.spec
    pool = LaneScheduler(spec, range(math.ceil(spec.n_rows / spec.block)))
    try:
        pace = _measured(context, pool)
    finally:
        pool.shut_down()
    pace = dataclasses.replace(pace, compile_s=pace.compile_s + traced_s)
    if isinstance(job.run, TableRunKind):  # the directions of derivatives fill its lanes
        compile_s = job.run.compile_time(context.design, spec)
        pace = dataclasses.replace(pace, at_a_time=1, compile_s=compile_s)
    cost = job.run.cost(context.design, pace.attempts / pace.crossings, 1.0 / pace.crossings)
    share = 1.0 if job.run.refined(context.design) is None else REFINED_SHARE
    simulated = math.ceil(share * spec.n_rows)
    # fewer rows than run at a time leave lanes idle, and take as long as these
    timed_rows = max(simulated, pace.at_a_time)
    timed_rows_most = max(spec.n_rows, pace.at_a_time)
    self_check_rows = rows_to_repeat(context) if is_checked(context) else 0
    self_check_s = _rerun_seconds(context, pace, cost.likely, self_check_rows)
    added_rows = most_added(context, self_check_rows)
    unsettled_reruns = most_reruns(context) if self_check_rows else 0
    further_s = _rerun_seconds(context, pace, cost.likely, added_rows)
    further_s += _rerun_seconds(context, pace, cost.most, unsettled_reruns)
    fixed_s = pace.compile_s + self_check_s
    columns = len(table_columns(context.design, job.run))
    records_longer = cost.records if cost.longer_records is None else cost.longer_records
    block_bytes = min(spec.block, spec.n_rows) * records_longer * columns * BYTES_A_NUMBER
    blocks = math.ceil(spec.n_rows / spec.block)
    simulated_bytes = simulated * records_longer * _bytes_of_record(context.design, job)
    inferred_bytes = (spec.n_rows - simulated) * BYTES_A_REPEAT * columns
    part_headers = blocks * (BYTES_A_PART + BYTES_A_COLUMN * columns)
    return Estimate(
        rows=spec.n_rows,
        simulated=simulated,
        records=round(spec.n_rows * cost.records),
        records_longer=round(spec.n_rows * records_longer),
        blocks=blocks,
        memory_bytes=int(_peak_memory() + 2 * block_bytes),
        disk_bytes=int(simulated_bytes + inferred_bytes + part_headers),
        seconds=fixed_s + pace.seconds(timed_rows, cost.likely, spec),
        seconds_longer=fixed_s + pace.seconds(timed_rows, cost.longer or cost.likely, spec),
        seconds_most=fixed_s + further_s + pace.seconds(timed_rows_most, cost.most, spec),
        lanes=spec.lanes,
        device=context.device,
        engine=context.engine,
        steps=simulated * cost.likely,
        compile_s=pace.compile_s,
        self_check_s=self_check_s,
        self_check_rows=self_check_rows,
        added_rows=added_rows,
        unsettled_reruns=unsettled_reruns,
    )


def _rerun_seconds(context: RunContext, pace: Measured, attempts: float, rows: int) -> float:
    """Return the time (s) in which some rows of so many attempts are rerun, and rerun with finer steps."""
    if not rows:
        return 0.0
    # programs for the states and the crossings of rows take about as long to compile as the run's own
    both = attempts * (1.0 + 1.0 / finer_share(context))
    return pace.compile_s + pace.seconds(max(rows, pace.at_a_time), both, context.spec)


def _peak_memory() -> int:
    """The largest memory of this process so far, bytes."""
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak if sys.platform == "darwin" else 1024 * peak


def _bytes_of_record(design: Design, job: Job) -> float:
    """Return the bytes of a record in a table: eight for each number that differs between records."""
    columns = job.run.all_columns(design.model)
    own = sum(not column.repeats for column in columns)
    if job.run.one_a_row:  # so that each has its own point of a sample
        own += sum(
            group.length == design.n_rows and axis.drawn
            for group in design.groups
            for axis in group.axes.values()
        )
    repeated = 1 + len(design.names) + len(columns) - own  # the row's number too
    return own * BYTES_A_NUMBER + repeated * BYTES_A_REPEAT


@dataclasses.dataclass(frozen=True)
class Measured:
    """Measurements on the first rows.

    Args:
        at_a_time: the number of rows that run at a time.
        host_s: the host's work for a row (s).
        rate: attempts of all lanes in a second.
        compile_s: the time of compilation (s).
        attempts: those of a row in a second of simulated time.
        crossings: those of a row in a second of simulated time.
    """

    at_a_time: int
    host_s: float
    rate: float
    compile_s: float
    attempts: float
    crossings: float

    def seconds(self, rows: float, attempts: float, spec: SweepSpec) -> float:
        """Return the time (s) that rows take, with a number of attempts each."""
        steps_s = rows * attempts / self.rate
        host_s = min(rows, spec.n_rows) * self.host_s
        if spec.devices[0].platform == "cpu":  # whose cores do the host's work too
            return steps_s + host_s / len(spec.devices)
        return max(steps_s, host_s)


def _measured(context: RunContext, pool: LaneScheduler) -> Measured:
    """Run a chunk of the first rows, and measure its speed and the simulated time."""
    spec = context.spec
    began = time.perf_counter()
    pool.open_first_rows()
    compile_s = time.perf_counter() - began
    chunks = [chunk for _, chunk in pool.advance_all(polls_per_chunk(spec))]
    seconds = max((chunk.seconds for chunk in chunks), default=1e-6)  # rows may all have ended at once
    at_a_time = sum(group.lanes.at_a_time for group in pool.groups)
    rate = at_a_time * POLL_INTERVAL * polls_per_chunk(spec) / seconds
    host_s = _host_s(context, pool)
    lanes_in_use = sum(chunk.ended + chunk.running.t.size for chunk in chunks)
    simulated = sum(
        float(chunk.running.t.sum() + sum(part.numbers["t_end"].sum() for part in chunk.parts))
        for chunk in chunks
    )
    crossings = sum(float(chunk.cycles + chunk.running.cycles.sum()) for chunk in chunks)
    period = nominal_period(context.design)
    nominal = 1.0 if math.isnan(period) else 1.0 / period  # rows without a period end at once
    if crossings < 2.0 * lanes_in_use:  # too few for a mean
        crossings = nominal * simulated
    if simulated > 0.0:
        attempts = sum(float(chunk.attempts + chunk.running_attempts.sum()) for chunk in chunks) / simulated
        crossings = crossings / simulated
    else:
        attempts = ATTEMPTS_A_STEP / float(np.nanmin(context.steps.dt, initial=1.0 / nominal))
        crossings = nominal
    return Measured(at_a_time, host_s, rate, compile_s, attempts, crossings)


def _host_s(context: RunContext, pool: LaneScheduler) -> float:
    """Measure the host's work for a row (s): opening it, labelling it and writing its record.

    It is 0 for a kind that makes its own table, where this work is part of the steps.
    """
    if isinstance(context.job.run, TableRunKind):
        return 0.0
    lanes = pool.groups[0].lanes
    block = next(iter(pool.open.values()))
    rows = min(lanes.size, block.rows)
    params, starts = (
        {name: values[:rows] for name, values in columns.items()} for columns in (block.params, block.starts)
    )
    block.ends.numbers["status"] = np.full_like(block.ends.status, Status.settled)
    seconds_a_row = 0.0
    for _ in range(2):  # the first time programs are compiled
        began = time.perf_counter()
        lanes.fill(params, starts, np.arange(rows))
        opened = time.perf_counter()
        frame = context.table(labelled(context.spec, block))
        arrow_part(frame, block.number, context.job_hash, {}).encoded()
        written = time.perf_counter()
        seconds_a_row = (opened - began) / rows + (written - opened) / block.rows
    return seconds_a_row
