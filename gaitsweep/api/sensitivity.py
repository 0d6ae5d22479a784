"""`gs.sensitivity`: dependence of results on each constant."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pydantic import BaseModel

from gaitsweep.api.fits import given_job, in_directory, in_memory
from gaitsweep.api.keywords import AnyModel, fields_without_axes, is_job, refuse_beside_a_job
from gaitsweep.api.result import refuse_of_session
from gaitsweep.errors import ArgumentError
from gaitsweep.fitting.sensitivity import Sensitivity, run_sensitivity
from gaitsweep.fitting.sensitivity_job import load_sensitivity, read_sensitivity
from gaitsweep.kinds import Settle
from gaitsweep.runs.progress import Progress, progress_lines
from gaitsweep.schema.strict_model import plain

if TYPE_CHECKING:
    from distributed import Client


def sensitivity(
    model: AnyModel | Path | Mapping[str, Any],
    *,
    parameters: Mapping[str, Any] | None = None,
    outputs: Mapping[str, Mapping[str, Any]] | None = None,
    method: str | None = None,
    n: int | None = None,
    seed: int | None = None,
    run: BaseModel | Mapping[str, Any] | None = None,
    out: str | Path | None = None,
    params: Mapping[str, Any] | None = None,
    start: Mapping[str, Any] | None = None,
    numerics: Mapping[str, Any] | None = None,
    engine: str | Mapping[str, Any] | None = None,
    verify: int | None = None,
    overrides: Sequence[str] = (),
    on_progress: Progress | None = None,
    client: Client | None = None,
    **values: Any,
) -> Sensitivity:
    """Find how much outputs of a model depend on each of some constants.

    Args:
        model: an instance, a class, a registered name, or "package.module:attribute". Or a job with
            `sensitivity`, as the path of its file, which ends in .yaml, as "builtin:NAME" or as a mapping of
            its fields: then only `out`, `overrides`, `on_progress` and `client` are allowed beside it.
        parameters: by name, a range [low, high] or {low, high, log, whole}, or a share of its value: "10%".
        outputs: measures by name, such as {"lag": {"kind": "value", "of": "psi_1", "at": {"psi_1": 1.0}}}.
        method: one_at_a_time, morris or sobol, the default.
        n: trajectories of morris, or base points of sobol, a power of two.
        seed: seed of all random numbers, 0 by default.
        run: the run kind, `Settle()` by default, or `FixedTime`, or their fields.
        out: the result directory, in which a stopped analysis continues. Without it the result is in memory,
            but that of a job is in `results/NAME`.
        params, start, numerics, engine: as for `gaitsweep.sweep`.
        verify: sets that are measured again at half the step; 32 by default, 0: none.
        overrides: settings for a job file, such as "sensitivity.n=64".
        on_progress: progress callback: sets done, sets in all, sets a second, the share done, a remark; by
            default it prints a line on standard error every half minute.
        client: a `distributed.Client`, whose workers compute the rows; with a directory they share it.
        values: parameters and start values by name, numbers or formulas.

    Raises:
        ArgumentError: a name that the model does not have, an array, a package that is not installed, or
            `out` for a model whose class belongs to this session.
        JobError: all other errors.
        TableError, RunError: as for `gaitsweep.run`.
    """
    on_progress = progress_lines("sets") if on_progress is None else on_progress
    if is_job(model):
        keywords = {"parameters": parameters, "outputs": outputs, "method": method, "n": n, "seed": seed}
        keywords |= {"run": run, "params": params, "start": start, "numerics": numerics, "engine": engine}
        refuse_beside_a_job(model, {**keywords, "verify": verify, **values})
        job = given_job(model, overrides, load_sensitivity, read_sensitivity)
        return in_directory(run_sensitivity, job, out, on_progress, client)
    if overrides:
        raise ArgumentError("overrides are for a job file: give the values as keywords.")
    assert not isinstance(model, Path | Mapping)  # it was read
    fields = fields_without_axes(
        model,
        values,
        "parameters",
        run=Settle() if run is None else run,
        params=params,
        start=start,
        numerics=numerics,
        engine={"name": engine} if isinstance(engine, str) else engine,
        verify=verify,
    )
    asked = {"parameters": parameters, "outputs": outputs, "method": method or "sobol", "n": n, "seed": seed}
    job = read_sensitivity(
        {**fields, "sensitivity": plain({name: value for name, value in asked.items() if value is not None})},
        Path.cwd(),
    )
    if out is not None:
        refuse_of_session(fields["model"])
        return in_directory(run_sensitivity, job, out, on_progress, client)
    return dataclasses.replace(in_memory(run_sensitivity, job, on_progress, client), path=None)
