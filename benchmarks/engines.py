"""gaitsweep itself, in the terms of the rivals: the same starts, the same crossings, the same row."""

from __future__ import annotations

import math

import numpy as np

from gaitsweep.engine.advance import Numerics
from gaitsweep.engine.block import BlockResult
from gaitsweep.engine.crossings import Crossings
from gaitsweep.engine.sweep import sweep
from gaitsweep.engine.work import Work
from gaitsweep.engine.xla import local_devices
from gaitsweep.models.multilegged import Multilegged

from .rivals.starts import Row, errors, reference_crossings

# Table 1, complete
TABLE_1 = {
    "beta": 0.8, "kappa": 100.0, "sigma": 20.0, "m": 1.0, "m_B": 0.9, "m_1": 0.9, "m_end": 0.9, "a": 0.4,
    "L": 1.0, "K": 1e5, "D": 2.0 * math.sqrt(1e5), "omega": 0.4, "tau": 0.5, "g": 9.8, "clamp": 0.0,
}  # fmt: skip


def measure(
    lanes: int = 256, crossings: int = 5, dt: float = 2e-3, devices: int | None = None
) -> tuple[Row, float]:
    """Located events, `lanes` starts on each device, every crossing recorded.

    Returns:
        The row, and the seconds that the first call took before the first attempt: compilation.
    """
    chosen = local_devices(devices)
    true = reference_crossings()
    rows = lanes * len(chosen)
    true = true[np.arange(rows) % len(true)]
    model = Multilegged()
    starts = {f"psi_{i + 1}": true[:, 0, i] for i in range(3)} | {"phi_1": np.full(rows, np.nan)}
    params = {name: np.full(rows, value) for name, value in TABLE_1.items()}
    given: list[BlockResult] = []
    work = Work(
        model=model,
        recorder=Crossings(model, crossings=crossings),
        numerics=Numerics(dt=dt),
        n_rows=rows,
        block=rows,
        lanes=lanes,
        devices=chosen,
        values=lambda a, b: ({k: v[a:b] for k, v in params.items()}, {k: v[a:b] for k, v in starts.items()}),
    )
    timings = sweep(work, [0], lambda _, block: given.append(block))
    found = given[0].samples.reshape(rows, crossings + 1, -1)[:, 1:, 2:5]
    error = errors(found, true[:, 1 : crossings + 1])
    device = f"{len(chosen)} x {chosen[0].device_kind}"
    row: Row = {
        "name": f"gaitsweep, XLA, {device}",
        "steps_per_second": timings.attempts / timings.run_s,
        "cycles_per_second": rows * crossings / timings.run_s,
        "error_rad": float(np.quantile(error, 0.95)),
        "note": f"{lanes} lanes a device, dt {dt} s; median error {np.median(error):.1e} rad, "
        f"{timings.attempts / rows / crossings:.0f} attempts a cycle, compiled in {timings.compile_s:.1f} s",
    }
    return row, timings.compile_s
