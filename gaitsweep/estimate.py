"""What a job would need, before it runs: rows, memory, disk and time."""

from __future__ import annotations

import dataclasses
import math
import resource
import sys
import time

import jax
import numpy as np

from gaitsweep.engine.crossings import Crossings
from gaitsweep.engine.engines import looks_of
from gaitsweep.engine.hold import Hold
from gaitsweep.engine.pool import Pool
from gaitsweep.engine.record import CADENCE
from gaitsweep.engine.settle import Settle
from gaitsweep.engine.staircase import Staircase
from gaitsweep.engine.trace import Trace
from gaitsweep.engine.work import Work
from gaitsweep.job import Job
from gaitsweep.refinement import refines
from gaitsweep.runner import prepare

# Of the cycles that a settling row may take, the share that one takes on the whole; the chain's own is 0.37.
LIKELY_SHARE = 0.4
# Located events add some attempts to the steps of a cycle; the chain's 33 events a cycle add 2 %.
EVENTS_SHARE = 1.05
# Of a grid that refines, the share of rows that are simulated; the chain's slices of 99 x 99 need 0.15.
REFINED_SHARE = 0.2
BYTES_A_NUMBER = 8


@dataclasses.dataclass(frozen=True)
class Estimate:
    """What a job would need. `seconds` is the likely time, `seconds_most` that of rows at their limits.

    `simulated`: the rows that are likely run; fewer than `rows` where a run refines.
    """

    rows: int
    simulated: int
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
    rate, compile_s = _measured_rate(work)
    likely, most, records = _row_needs(work)
    slots = work.lanes * len(work.devices)
    # the last rows of a sweep leave lanes idle, so a sweep takes a whole number of its rows' rounds at least
    simulated = math.ceil(REFINED_SHARE * work.n_rows) if refines(job.run) else work.n_rows
    rounds, rounds_most = (max(rows / slots, 1.0) for rows in (simulated, work.n_rows))
    numbers = len(work.model.observables) + len(ready.plan.names) + len(work.model.traits) + 4
    if not isinstance(work.recorder, Settle | Hold):
        numbers = work.recorder.width + len(ready.plan.names) + 3
    if isinstance(work.recorder, Staircase):
        numbers += len(work.model.traits) + 3
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)
    kept = min(work.block, work.n_rows) * records * numbers * BYTES_A_NUMBER
    return Estimate(
        rows=work.n_rows,
        simulated=simulated,
        blocks=math.ceil(work.n_rows / work.block),
        memory_bytes=int(peak + 2 * kept),
        disk_bytes=int(work.n_rows * records * numbers * BYTES_A_NUMBER),
        seconds=compile_s + rounds * slots * likely / rate,
        seconds_most=compile_s + rounds_most * slots * most / rate,
        lanes=work.lanes,
        device=ready.device,
        engine=ready.engine,
    )


def _measured_rate(work: Work) -> tuple[float, float]:
    """Attempts a second with all lanes running, and seconds of compilation."""
    began = time.perf_counter()
    pool = Pool(work, range(math.ceil(work.n_rows / work.block)))
    pool.refill()
    for lanes in pool.groups:
        lanes.run_chunk(0)
    compile_s = time.perf_counter() - began
    began = time.perf_counter()
    pool.chunk()
    spent = time.perf_counter() - began
    slots = work.lanes * len(work.devices)
    return slots * CADENCE * looks_of(work) / spent, compile_s


def _row_needs(work: Work) -> tuple[float, float, float]:
    """Attempts that a row likely makes, those it makes at most, and the records that it leaves."""
    params, _ = work.values(0, 1)
    one = {name: np.asarray(column[0]) for name, column in params.items()}
    period = float(jax.jit(lambda values: work.model.period(work.model.params(values)))(one))
    cycle = period / work.numerics.dt * EVENTS_SHARE
    recorder = work.recorder
    if isinstance(recorder, Settle):
        cycles = recorder.max_cycles
        if recorder.max_time is not None:
            cycles = min(cycles, recorder.max_time / period)
        return LIKELY_SHARE * cycles * cycle, cycles * cycle, 1.0
    if isinstance(recorder, Hold):
        attempts = recorder.duration / period * cycle
        return attempts, attempts, 1.0
    if isinstance(recorder, Trace):
        attempts = (recorder.after_cycles + recorder.duration / period) * cycle + recorder.samples
        return attempts, attempts, float(recorder.samples)
    if isinstance(recorder, Staircase):
        stairs = recorder.stairs
        attempts = stairs.duration / period * cycle + stairs.count
        return attempts, attempts, float(stairs.count)
    assert isinstance(recorder, Crossings)
    if recorder.duration is not None:
        crossings = recorder.duration / period
    else:
        crossings = float(recorder.after_cycles + (recorder.crossings or 0))
    return crossings * cycle, crossings * cycle, max(crossings - recorder.after_cycles, 1.0)
