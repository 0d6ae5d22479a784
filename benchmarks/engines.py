"""gaitsweep itself, in the terms of the rivals: the same starts, the same crossings, the same row."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from gaitsweep.engine.devices import local_devices
from gaitsweep.engine.kernel.lanes import kernel_of
from gaitsweep.engine.numerics import Numerics
from gaitsweep.engine.recorders.recordings import CrossingRecorder
from gaitsweep.engine.sweep.engine_choice import EngineError, choose, default_lanes
from gaitsweep.engine.sweep.sweep import Timings, sweep
from gaitsweep.engine.sweep.sweep_spec import EngineName, SweepSpec
from gaitsweep.papers.ambe2021.multilegged.model import Multilegged
from gaitsweep.row_outcome import RowOutcome

from .rivals.by_hand import missing
from .rivals.starts import Array, Row, errors, reference_crossings

# Table 1, complete
TABLE_1 = {
    "beta": 0.8, "kappa": 100.0, "kappa_1": 100.0, "kappa_end": 100.0, "sigma": 20.0,
    "m": 1.0, "m_B": 0.9, "m_1": 0.9, "m_end": 0.9, "a": 0.4, "a_1": 0.4, "a_end": 0.4,
    "L": 1.0, "K": 1e5, "D": 2.0 * math.sqrt(1e5), "omega": 0.4, "tau": 0.5, "g": 9.8, "clamp": 0.0,
}  # fmt: skip

# The step (s) of each method: for the model's stiffest rate, 503/s, near the longest that it takes.
STEPS = {"rk4": 4e-3, "propagator6": 32e-3, "propagator": 32e-3}
# Whatever the machine, no more rows than this: the host keeps all their crossings.
MOST_ROWS = 2**19


def measure(
    engine: EngineName = "kernel",
    method: str = "rk4",
    *,
    lanes: int | None = None,
    crossings: int = 20,
    dt: float | None = None,
    devices: int | None = None,
    seconds: float = 5.0,
    repeats: int = 2,
) -> Row:
    """Located events, every crossing recorded, rows following each other in the lanes of all devices.

    A first run compiles and says how many rows fill `seconds`; of `repeats` runs of that length the fastest
    counts, or the first run where it was long enough. The reference's starts repeat over the rows, and all
    rows count for the error.

    Args:
        engine: xla or kernel.
        method: rk4, propagator6 or propagator.
        lanes: trajectories at once on each device; by default the engine's own number for a big job.
        crossings: gait cycles of each row; the reference has 10, so no more than 10 count for the error.
        dt: the longest step (s); by default the method's in `STEPS`.
        devices: how many to use; by default all.
        seconds: length of a timed run.
        repeats: timed runs.
    """
    chosen = local_devices(devices)
    model, dt = Multilegged(), dt or STEPS[method]
    numerics = Numerics(dt=dt, method=method).resolve(model)
    recorder = CrossingRecorder(model, crossings=crossings)
    name = f"gaitsweep, {engine}, {method}, dt {1e3 * dt:g} ms"
    try:
        choose(engine, chosen[0], model, recorder, numerics, None)
    except EngineError as error:
        return missing(name, f"not measured: {error}")
    lanes = lanes or default_lanes(engine, MOST_ROWS, chosen[0].platform)
    true = reference_crossings()

    def run(rows: int) -> tuple[Timings, RowOutcome]:
        outcomes: list[RowOutcome] = []
        spec = SweepSpec(
            model=model,
            recorder=recorder,
            numerics=numerics,
            n_rows=rows,
            block=rows,
            lanes=lanes,
            devices=chosen,
            values=lambda first, last: _values(true[np.arange(first, last) % len(true), 0]),
            engine=engine,
        )
        return sweep(spec, [0], lambda _, block: outcomes.append(block)), outcomes[0]

    at_once = lanes * len(chosen)
    rows = at_once
    timings, block = first = run(rows)
    if timings.run_s < seconds:
        rows *= max(1, min(math.ceil(seconds / timings.run_s), MOST_ROWS // at_once))
        timings, block = min((run(rows) for _ in range(repeats)), key=lambda pair: pair[0].run_s)
    if len(block.samples) != rows * (crossings + 1):
        return missing(name, f"{rows - np.unique(block.owner).size} rows or some crossings are missing")
    result = block.samples.reshape(rows, crossings + 1, -1)[:, 1:, 2:5]
    error = errors(result, true[np.arange(rows) % len(true), 1 : crossings + 1])
    return {
        "name": name,
        "steps_per_second": timings.attempts / timings.run_s,
        "cycles_per_second": rows * crossings / timings.run_s,
        "error_rad": float(np.quantile(error, 0.95)),
        "note": f"{len(chosen)} x {chosen[0].device_kind}, {lanes} lanes on each, {rows} rows of {crossings} "
        f"cycles in {timings.run_s:.1f} s; median error {np.median(error):.1e} rad, "
        f"{timings.attempts / rows / crossings:.0f} attempts a cycle, ready in {first[0].compile_s:.1f} s",
    }


def measure_all(
    engines: list[EngineName], lanes: list[int | None], crossings: int
) -> Iterator[tuple[tuple[str, str], Row]]:
    """Yields engine and method, and the row: rk4 alone in XLA, every method in the kernel."""
    for engine in engines:
        for method in STEPS if engine == "kernel" else ["rk4"]:
            for size in lanes:
                yield (engine, method), measure(engine, method, lanes=size, crossings=crossings)


def operations(method: str) -> int:
    """Arithmetic operations of an attempt: those of the kernel's program, one for each of its nodes.

    Additions, products, comparisons and selects count as one each; what is worked out once for a trajectory,
    constants and what is read count as none.
    """
    model = Multilegged()
    numerics = Numerics(dt=STEPS[method], method=method)
    local_devices()  # sets float64 on
    chunk = kernel_of(model, CrossingRecorder(model, crossings=1), numerics.resolve(model), None).chunk
    program = chunk.program
    return sum(
        not program.steady[at] and program.nodes[at].op not in ("input", "constant")
        for at in program.needed(chunk.attempt.values())
    )


def _values(psi: Array) -> tuple[dict[str, Array], dict[str, Array]]:
    """Parameters and starts of rows that start at these relative phases (rad), (rows, 3)."""
    rows = len(psi)
    starts = {f"psi_{i + 1}": psi[:, i] for i in range(3)} | {"phi_1": np.full(rows, np.nan)}
    return {name: np.full(rows, value) for name, value in TABLE_1.items()}, starts
