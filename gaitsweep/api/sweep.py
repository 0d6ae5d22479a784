"""`gs.sweep` and `gs.perturb`: a grid of trajectories from keywords."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pandas as pd
from pydantic import BaseModel

from gaitsweep.analysis.records import names_in
from gaitsweep.api.keywords import AnyModel, job_of
from gaitsweep.api.result import Result
from gaitsweep.api.run import run as run_job
from gaitsweep.api.run import run_in_memory
from gaitsweep.engine.content import held_contents
from gaitsweep.errors import ArgumentError
from gaitsweep.kinds import Perturb, Settle

if TYPE_CHECKING:
    from distributed import Client  # pyright: ignore[reportMissingImports]


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
