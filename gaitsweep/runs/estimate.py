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
from gaitsweep.engine.sweep.engines import polls_per_chunk
from gaitsweep.engine.sweep.labels import labelled
from gaitsweep.engine.sweep.lane_scheduler import LaneScheduler
from gaitsweep.engine.sweep.sweep_spec import SweepSpec
from gaitsweep.job import Job
from gaitsweep.kinds.run_kind import table_columns
from gaitsweep.runs.prepare import RunContext, nominal_period, prepare
from gaitsweep.status import Status
from gaitsweep.table.parts import part_bytes

# Located events add some attempts to the steps of a cycle; the chain's 33 events a cycle add 2 %.
EVENTS_SHARE = 1.05
# Share of the rows of a refined grid that are simulated; the chain's slices of 99 x 99 need 0.15.
REFINED_SHARE = 0.2
BYTES_A_NUMBER = 8
# Bytes of a part without its records, of each of its columns, and of an entry of a column that repeats itself
# (an axis of a grid, a status, a time that all rows share).
BYTES_A_PART, BYTES_A_COLUMN, BYTES_A_REPEAT = 900, 280, 0.3


@dataclasses.dataclass(frozen=True)
class Estimate:
    """Estimate of a job.

    `simulated` is the number of rows that are likely run, fewer than `rows` if the run refines. `records` and
    `disk_bytes` are those of the table, `steps` the attempts of all rows. `seconds` is the likely time, and
    `seconds_most` the time if all rows run to their limits; both include `compile_s`. `records_longer` and
    `seconds_longer` are those of rows whose branches fold; for other kinds, the likely ones.
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


def estimate(job: Job) -> Estimate:
    """Estimate a job's needs from its first rows, which are run for a few chunks; nothing is written.

    Raises:
        RunError: a device or an engine that the job asks for is not available.
    """
    context = prepare(job)
    spec = context.spec
    pace = _measured(context)
    if job.run.makes_tables:  # the directions of derivatives fill its lanes
        compile_s = job.run.compile_time(context.design, spec)
        pace = dataclasses.replace(pace, at_a_time=1, compile_s=compile_s)
    cost = job.run.cost(context.design, pace.attempts / pace.crossings, 1.0 / pace.crossings)
    slots = pace.at_a_time
    # the last rows of a sweep leave lanes idle, so a sweep takes a whole number of its rows' rounds at least
    share = 1.0 if job.run.refined(context.design) is None else REFINED_SHARE
    simulated = math.ceil(share * spec.n_rows)
    rounds, rounds_most = (max(rows / slots, 1.0) for rows in (simulated, spec.n_rows))
    columns = table_columns(context.design, job.run)
    a_record = _bytes_of_record(context.design, job)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)
    records_longer = cost.records if cost.longer_records is None else cost.longer_records
    block_bytes = min(spec.block, spec.n_rows) * records_longer * len(columns) * BYTES_A_NUMBER
    blocks = math.ceil(spec.n_rows / spec.block)
    skipped = (spec.n_rows - simulated) * BYTES_A_REPEAT * len(columns)
    written = simulated * records_longer * a_record + skipped
    return Estimate(
        rows=spec.n_rows,
        simulated=simulated,
        records=round(spec.n_rows * cost.records),
        records_longer=round(spec.n_rows * records_longer),
        blocks=blocks,
        memory_bytes=int(peak + 2 * block_bytes),
        disk_bytes=int(written + blocks * (BYTES_A_PART + BYTES_A_COLUMN * len(columns))),
        seconds=pace.compile_s + pace.seconds(rounds * slots, cost.likely, spec),
        seconds_longer=pace.compile_s + pace.seconds(rounds * slots, cost.longer or cost.likely, spec),
        seconds_most=pace.compile_s + pace.seconds(rounds_most * slots, cost.most, spec),
        lanes=spec.lanes,
        device=context.device,
        engine=context.engine,
        steps=simulated * cost.likely,
        compile_s=pace.compile_s,
    )


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

    `at_a_time` is the number of rows that run at a time, `host_s` the host's work for a row (s), `rate` the
    attempts of all lanes in a second, `compile_s` the time of compilation (s), `attempts` and `crossings` the
    numbers of a row in a second of simulated time.
    """

    at_a_time: int
    host_s: float
    rate: float
    compile_s: float
    attempts: float
    crossings: float

    def seconds(self, rows: float, attempts: float, spec: SweepSpec) -> float:
        """Return the time (s) that rows take, with a number of attempts each."""
        steps, host = rows * attempts / self.rate, min(rows, spec.n_rows) * self.host_s
        # on a CPU the host's work takes cores from the rows
        shares_cores = spec.devices[0].platform == "cpu"
        return steps + host / len(spec.devices) if shares_cores else max(steps, host)


def _measured(context: RunContext) -> Measured:
    """Run a chunk of the first rows, and measure its speed and the simulated time."""
    spec = context.spec
    began = time.perf_counter()
    pool = LaneScheduler(spec, range(math.ceil(spec.n_rows / spec.block)))
    pool.begin()
    compile_s = time.perf_counter() - began
    began = time.perf_counter()
    outputs = pool.advance_all(polls_per_chunk(spec))
    spent = time.perf_counter() - began
    at_a_time = sum(group.at_a_time for group in pool.groups)
    rate = at_a_time * POLL_INTERVAL * polls_per_chunk(spec) / spent
    host_s = _host_s(context, pool)
    pool.end()
    ran = sum(int(np.count_nonzero(group.block_of >= 0)) for group, _ in outputs)

    def total(number: str) -> float:
        return float(sum(np.sum(output.numbers[number][group.block_of >= 0]) for group, output in outputs))

    simulated, crossings = total("t_end"), total("cycles")
    nominal = 1.0 / nominal_period(context.design)
    if crossings < 2.0 * ran:  # too few for a mean
        crossings = nominal * simulated
    if simulated > 0.0:
        attempts, crossings = total("attempts") / simulated, crossings / simulated
    else:
        attempts, crossings = EVENTS_SHARE / float(np.min(context.steps.dt)), nominal
    return Measured(at_a_time, host_s, rate, compile_s, attempts, crossings)


def _host_s(context: RunContext, pool: LaneScheduler) -> float:
    """Measure the host's work for a row (s): opening it, labelling it and writing its record.

    It is 0 for a kind that makes its own table, where this work is part of the steps.
    """
    if context.job.run.makes_tables:
        return 0.0
    group, block = pool.groups[0], next(iter(pool.open.values()))
    block.ends.status[:] = Status.settled
    spent = []
    for _ in range(2):  # the first time programs are compiled
        began = time.perf_counter()
        group.open_again()
        opened = time.perf_counter()
        frame = context.table(labelled(context.spec, block))
        part_bytes(frame, block.number, context.job_hash, {})
        spent.append((opened - began) / group.size + (time.perf_counter() - opened) / block.rows)
    return spent[-1]
