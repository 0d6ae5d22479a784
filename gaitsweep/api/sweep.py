"""`gs.sweep` and `gs.perturb`, a grid of trajectories from keywords, and `gs.simulate`, one trajectory."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from pydantic import BaseModel

from gaitsweep.analysis.records import names_in
from gaitsweep.api.keywords import AnyModel, job_of
from gaitsweep.api.result import Result
from gaitsweep.api.run import run as run_job
from gaitsweep.api.run import run_in_memory
from gaitsweep.design.design import row_params
from gaitsweep.engine.content import held_contents
from gaitsweep.errors import ArgumentError, warn
from gaitsweep.job import Job
from gaitsweep.kinds import Perturb, Settle, Trace
from gaitsweep.runs.sentences import WITHOUT_START, status_sentence
from gaitsweep.status import Status

if TYPE_CHECKING:
    from distributed import Client  # pyright: ignore[reportMissingImports]


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
    if status is not Status.complete:
        for reason in recorded.attrs["manifest"].get(WITHOUT_START) or {}:
            raise ArgumentError(f"The trajectory cannot begin: {reason}.")
        about = {"quantities": recorded.attrs["quantities"]}
        sentence = status_sentence(status.name, recorded.attrs["job"], about)
        if np.isnan(recorded["t"].to_numpy(float)).all():
            sentence += f" Nothing was recorded: that begins after {after_cycles} section crossings."
        warn(f"The trajectory ended as {status.name}: {sentence}")
    signals = recorded.drop(columns=["row", "gait", "status", "stalled_by"])
    quantities = recorded.attrs["quantities"]
    units = {name: "s" if name == "t" else quantities[name]["unit"] for name in map(str, signals.columns)}
    signals.attrs = {**recorded.attrs, "units": units, "status": status.name}
    return signals


@held_contents()
def sweep(
    model: AnyModel,
    *,
    run: BaseModel | Mapping[str, Any] | None = None,
    out: str | Path | None = None,
    params: Mapping[str, Any] | None = None,
    start: Mapping[str, Any] | None = None,
    numerics: Mapping[str, Any] | None = None,
    engine: str | Mapping[str, Any] | None = None,
    verify: int | None = None,
    client: Client | None = None,
    **values: Any,
) -> Result:
    """Run a model over the grid that the keywords span.

    Args:
        model: an instance, a class, a registered name, or "package.module:attribute".
        run: the run kind, `Settle()` by default, or its fields as in a job file.
        out: the result directory. Without it the table is in memory, and Ctrl-C loses all its rows; with it
            the same call continues where it was stopped.
        params, start: parameters and start values by name, for names that are keywords here.
        numerics: method, dt and the other fields of a job's `numerics`; by default as the model recommends.
        engine: auto, kernel or xla, or the fields of a job's `engine`.
        verify: rows that are repeated when the run is complete; at most 32 by default, 0: none.
        client: a `distributed.Client`, whose workers compute the rows; with `out` they share that directory.
        values: parameters and start values by name. A number or a formula is a constant; a list or an array
            (n,) is an axis, and axes multiply, the last varying fastest. `zip` and `sample` take groups as in
            a job file.

    Raises:
        ArgumentError: a name that the model does not have; `out` for a class of this session.
        JobError: all other errors.
        TableError, RunError: as for `gaitsweep.run`.

    Example:
        The hopper settles on hops that last one, two or three turns of its oscillator:

        >>> import numpy as np, gaitsweep as gs
        >>> from gaitsweep.examples.hopper import Hopper
        >>> table = gs.sweep(Hopper(), launch_0=[2.5, 5.0, 7.0], phase_0=2.0).table
        >>> table["gait"].tolist()
        ['1:1', '2:1', '3:1']
        >>> flight = 2.0 * table["launch_end"] / 9.81  # s
        >>> (12.0 * flight / (2.0 * np.pi)).round(1).tolist()  # the oscillator has 12 rad/s
        [1.0, 2.0, 3.0]
    """
    fields = {"numerics": numerics, "engine": engine, "verify": verify}
    job = job_of(model, values, run=Settle() if run is None else run, params=params, start=start, **fields)
    return run_in_memory(job, client) if out is None else run_job(job, out, client=client)


@held_contents()
def perturb(
    model: AnyModel,
    push: str | Sequence[str] = (),
    *,
    after: Result | pd.DataFrame | str | Path | None = None,
    run: Perturb | Mapping[str, Any] | None = None,
    **keywords: Any,
) -> Result:
    """Settle a model over a grid, push each row once, and settle it again.

    Args:
        model: an instance, a class, a registered name, or "package.module:attribute".
        push: variables of the flow that are pushed, one or several, by amounts `push_NAME` and at a
            `push_phase`.
        after: a result of a run of kind `Settle` with `states`, its table or some records of that, or its
            directory: the settled rows are pushed, with their parameters, and the push's axes multiply them.
        run: other fields of the run kind `Perturb`: `force`, `step`, `at`, `within`, `max_cycles`, ...; or
            the run kind itself, which has `push` among its fields.
        keywords: as for `sweep`: amounts, phases, parameters and start values by name, `out`, `numerics`, ...

    Raises:
        ArgumentError: a name that the model does not have; `out` for a class of this session; `push` is given
            twice, here and in `run`.
        JobError, TableError, RunError: as for `sweep`.

    Example:
        A rimless wheel that is slowed down just after an impact recovers if it passes the vertical, where
        its energy has to be positive. It falls back from a rate below 2 sin((0.3 - slope) / 2):

        >>> import numpy as np, jax.numpy as jnp, gaitsweep as gs
        >>> class Wheel(gs.DeclaredModel):
        ...     slope = gs.parameter("rad", "slope of the ground, downwards", 0.08)
        ...     angle = gs.variable("rad", "angle of the spoke on the ground from the vertical")
        ...     rate = gs.variable("1", "rate of the angle, in sqrt(g / l)", 0.5)
        ...
        ...     def complete(self, p, s):
        ...         return s.replace(angle=p.slope - 0.3)
        ...
        ...     def flow(self, p, s):
        ...         return {"angle": s.rate, "rate": jnp.sin(s.angle)}
        ...
        ...     @gs.event("spoke lands", section=True)
        ...     def landing(self, p, s):
        ...         return s.angle - p.slope - 0.3
        ...
        ...     @landing.jump
        ...     def impact(self, p, s):
        ...         return s.replace(angle=p.slope - 0.3, rate=jnp.cos(0.6) * s.rate)
        ...
        ...     def failed(self, p, s):
        ...         return s.rate < 0.0
        ...
        ...     def period(self, p):
        ...         return 2.0
        >>> gait = 2.0 / np.tan(0.6) * np.sqrt(np.sin(0.3) * np.sin(0.08))
        >>> least = 2.0 * np.sin((0.3 - 0.08) / 2.0) - gait
        >>> pushes = [least - 0.001, least + 0.001, 0.5]
        >>> gs.perturb(Wheel(), ["rate"], push_rate=pushes).table["recovery"].tolist()
        ['fell', 'recovered', 'recovered']
    """
    pushes = _pushes(names_in(push), run)
    if after is None:
        return sweep(model, run=pushes, **keywords)
    if isinstance(after, Result):
        after = after.table
    elif not isinstance(after, pd.DataFrame):
        after = str(after)
    fields = pushes.model_dump(exclude_unset=True)
    return sweep(model, run={**fields, "kind": "perturb", "after": after}, **keywords)


def _pushes(push: list[str], run: Perturb | Mapping[str, Any] | None) -> Perturb:
    """The run kind that pushes variables, from its other fields or as it is."""
    if run is not None and not isinstance(run, Perturb | Mapping):
        raise ArgumentError(f"run is a {type(run).__name__}, but must be a Perturb or its fields.")
    of_run = run.push if isinstance(run, Perturb) else (run or {}).get("push")
    if push and of_run:
        raise ArgumentError("push is given twice, once in run: remove one of the two.")
    if isinstance(run, Perturb):
        return run.model_copy(update={"push": push}) if push else run
    fields: dict[str, Any] = {**(run or {}), "push": push or of_run or []}
    return Perturb(**fields)
