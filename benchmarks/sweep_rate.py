"""Speed of whole sweeps of a model: opening rows, advancing them, keeping their crossings."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np

from gaitsweep.contract import HybridModel, SteppedModel
from gaitsweep.engine.devices import local_devices
from gaitsweep.engine.numerics import Numerics
from gaitsweep.engine.recorders.recordings import CrossingRecorder
from gaitsweep.engine.sweep.engine_choice import default_lanes
from gaitsweep.engine.sweep.sweep import Timings, sweep
from gaitsweep.engine.sweep.sweep_spec import EngineName, SweepSpec
from gaitsweep.expression import evaluate

Values = Mapping[str, np.ndarray]


class Rate(NamedTuple):
    """Steps and simulated seconds of all rows together a second, and the seconds until it was ready."""

    steps: float
    simulated: float
    ready: float


def sweep_rate(
    model: HybridModel | SteppedModel,
    numerics: Numerics,
    engine: EngineName,
    cycles: int,
    rows_of: Callable[[int], tuple[Values, Values]],
    *,
    seconds: float,
    lanes: int | None,
) -> Rate:
    """The rate of sweeps that last about so many seconds.

    Args:
        model, numerics, engine: what is run and how.
        cycles: of each row, every crossing kept.
        rows_of: parameters and starts, (n,) by name, of n rows; others have their defaults.
        seconds: of the measurement.
        lanes: rows at once on each device; by default, the engine's own, or for XLA what runs fast.
    """
    devices = local_devices(None)
    platform = devices[0].platform
    if engine == "xla":  # fewer rows, which run long enough
        lanes = 2**14 if platform == "gpu" else 64
    lanes = lanes or default_lanes(engine, 2**17, platform)
    simulated: list[float] = []

    def run(n: int) -> Timings:
        varied, starts = rows_of(n)
        params: dict[str, np.ndarray] = dict(varied)
        for quantity in (*model.parameters, *model.initial_conditions):
            if quantity.name not in {**params, **starts} and quantity in model.parameters:
                result = evaluate(quantity.default, params)  # type: ignore[arg-type]
                params[quantity.name] = np.broadcast_to(np.asarray(result, float), (n,))
        begin = {
            q.name: np.asarray(starts.get(q.name, np.full(n, q.default)), float)
            for q in model.initial_conditions
        }
        work = SweepSpec(
            model=model, recorder=CrossingRecorder(model, crossings=cycles), n_rows=n, block=n, lanes=lanes,
            numerics=numerics.resolve(model), devices=devices,
            values=lambda a, b: (params, begin), engine=engine,
        )  # fmt: skip
        return sweep(work, [0], lambda _, block: simulated.append(float(np.sum(block.t_end))))

    rows = lanes * len(devices)
    first = run(rows)
    repeats = int(np.clip(seconds / first.run_s, 1, 64))
    again = run(rows * repeats) if repeats > 1 else first
    return Rate(again.attempts / again.run_s, simulated[-1] / again.run_s, first.compile_s)
