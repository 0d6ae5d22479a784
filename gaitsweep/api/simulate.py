"""`gs.simulate`: one trajectory from keywords."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from typing import Any

import pandas as pd

from gaitsweep.api.keywords import AnyModel, job_of
from gaitsweep.api.run import run_in_memory
from gaitsweep.design.design import row_params
from gaitsweep.engine.content import held_contents
from gaitsweep.errors import ArgumentError
from gaitsweep.job import Job
from gaitsweep.kinds import Trace
from gaitsweep.runs.sentences import WITHOUT_START
from gaitsweep.status import Status

SAMPLES_PER_CYCLE = 100


@held_contents()
def simulate(
    model: AnyModel,
    *,
    duration: float,
    every: float | None = None,
    after_cycles: int = 0,
    params: Mapping[str, Any] | None = None,
    start: Mapping[str, Any] | None = None,
    numerics: Mapping[str, Any] | None = None,
    engine: str | Mapping[str, Any] | None = None,
    **values: Any,
) -> pd.DataFrame:
    """Simulate one trajectory and record its signals.

    Args:
        model: an instance, a class, a registered name, or "package.module:attribute".
        duration: length of the recording, s.
        every: interval between samples, s; a hundredth of the model's nominal cycle by default.
        after_cycles: section crossings before the recording, whose time then begins at 0.
        params, start, numerics, engine: as for `sweep`.
        values: parameters and start values by name, numbers or formulas.

    Returns:
        One record a sample: t (s) and the model's signals. `.attrs` has `units` by column, `status` (how the
        trajectory ended), `job`, `manifest` and `quantities`.

    Raises:
        ArgumentError: a name that the model does not have, or an array; or the model cannot make a start.
        JobError: all other errors.

    Example:
        The hopper's flight, with a height of launch t - g t^2 / 2:

        >>> import gaitsweep as gs
        >>> from gaitsweep.examples.hopper import Hopper
        >>> flight = gs.simulate(Hopper(), launch_0=2.0, duration=0.2, every=0.1)
        >>> list(flight.columns)
        ['t', 'phase', 'launch', 'height']
        >>> flight["height"].round(3).tolist()
        [0.0, 0.151, 0.204]
        >>> flight.attrs["units"]["height"]
        'm'
    """
    fields = {"numerics": numerics, "engine": engine, "verify": 0}

    def job_with(interval: float) -> Job:
        trace = Trace(duration=duration, every=interval, after_cycles=after_cycles)
        return job_of(model, values, run=trace, params=params, start=start, **fields)

    job = job_with(duration if every is None else every)
    if job.design.groups:
        raise ArgumentError(
            f"{job.design.names[0]} is an axis, but one trajectory takes a number: use sweep."
        )
    if every is None:
        cycle = float(job.design.model.period(row_params(job.design, 0)))
        job = job_with(min(cycle / SAMPLES_PER_CYCLE, duration))
    recorded = run_in_memory(job).table
    status = Status[str(recorded["status"].iloc[-1])]
    if status.name in Status.FAILED:
        _, _, fall = recorded.attrs["quantities"]["status"]["meaning"].partition("; fell: ")
        for reason in recorded.attrs["manifest"].get(WITHOUT_START) or {}:
            raise ArgumentError(f"The trajectory cannot begin: {reason}.")
        why = f" It tests {fall}." if fall and status is Status.fell else ""
        warnings.warn(f"The trajectory ended as {status.name}: {status.sentence}{why}", stacklevel=2)
    signals = recorded.drop(columns=["row", "gait", "status", "stalled_by"])
    quantities = recorded.attrs["quantities"]
    units = {name: "s" if name == "t" else quantities[name]["unit"] for name in map(str, signals.columns)}
    signals.attrs = {**recorded.attrs, "units": units, "status": status.name}
    return signals
