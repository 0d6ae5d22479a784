"""`gs.sensitivity`: how much results depend on each constant."""

from __future__ import annotations

import dataclasses
import tempfile
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from gaitsweep.api.keywords import AnyModel, fields_of
from gaitsweep.errors import ArgumentError
from gaitsweep.fitting.sensitivity import Sensitivity, run_sensitivity
from gaitsweep.fitting.sensitivity_job import SensitivityJob, load_sensitivity, read_sensitivity
from gaitsweep.kinds import Settle
from gaitsweep.kinds.part import plain
from gaitsweep.runs.progress import Progress, progress_lines


def sensitivity(
    model: AnyModel | Path,
    *,
    parameters: Mapping[str, Any] | None = None,
    outputs: Mapping[str, Mapping[str, Any]] | None = None,
    method: str = "sobol",
    n: int | None = None,
    seed: int = 0,
    run: BaseModel | Mapping[str, Any] | None = None,
    out: str | Path | None = None,
    params: Mapping[str, Any] | None = None,
    start: Mapping[str, Any] | None = None,
    numerics: Mapping[str, Any] | None = None,
    engine: str | Mapping[str, Any] | None = None,
    verify: int | None = None,
    overrides: Sequence[str] = (),
    progress: Progress | None = None,
    **values: Any,
) -> Sensitivity:
    """Find how much outputs of a model depend on each of some constants.

    Args:
        model: an instance, a class, a registered name, or "package.module:attribute"; or the path of a job
            file with `sensitivity`, which ends in .yaml: then all else but `out`, `overrides` and `progress`
            stands in the file.
        parameters: by name, a range [low, high] or {low, high, log, whole}, or a share of its value: "10%".
        outputs: measures by name, such as {"lag": {"kind": "value", "of": "psi_1", "at": {"psi_1": 1.0}}}.
        method: one_at_a_time, morris or sobol.
        n: trajectories of morris, or base points of sobol, a power of two.
        seed: of all that is drawn.
        run: what is done with each row, `Settle()` by default; `FixedTime` too, or their fields.
        out: the result directory; a stopped analysis goes on there. Without it the result is in memory, but
            that of a job file goes to `results/NAME`.
        params, start, numerics, engine: as for `gaitsweep.sweep`.
        verify: sets that are measured again at half the step; 32 by default, 0: none.
        overrides: settings for a job file, such as "sensitivity.n=64".
        progress: called now and then with sets done, sets in all, sets a second, the share done, a remark; by
            default a line on standard error every half minute.
        values: parameters and start values by name, numbers or formulas.

    Raises:
        ArgumentError: a name that the model does not have, an array, or a package that is not installed.
        JobError: other things that are wrong, a sentence each.
        TableError, RunError: as for `gaitsweep.run`.
    """
    progress = progress_lines("sets") if progress is None else progress
    if isinstance(model, Path) or (isinstance(model, str) and model.endswith((".yaml", ".yml"))):
        given = {"parameters": parameters, "outputs": outputs, "n": n, "run": run, "params": params}
        given |= {"start": start, "numerics": numerics, "engine": engine, "verify": verify, **values}
        stray = next((name for name, value in given.items() if value is not None), None)
        if stray is not None:
            raise ArgumentError(f"{stray} stands in the job file {model}: change it there, or by overrides.")
        return run_sensitivity(load_sensitivity(model, overrides), out, progress=progress, tell=warnings.warn)
    if overrides:
        raise ArgumentError("overrides are for a job file: give the values as keywords.")
    fields = fields_of(
        model,
        values,
        run=Settle() if run is None else run,
        params=params,
        start=start,
        numerics=numerics,
        engine={"name": engine} if isinstance(engine, str) else engine,
        verify=verify,
    )
    axes = fields.pop("vary")
    if axes:
        raise ArgumentError(f"{next(iter(axes))} is an axis, but takes a number: give ranges as parameters=.")
    asked = {"parameters": parameters, "outputs": outputs, "method": method, "n": n, "seed": seed}
    job = read_sensitivity(
        {**fields, "sensitivity": plain({name: value for name, value in asked.items() if value is not None})},
        Path.cwd(),
    )
    return _in_memory(job, progress) if out is None else run_sensitivity(job, out, progress=progress)


def _in_memory(job: SensitivityJob, progress: Progress | None) -> Sensitivity:
    """The result of an analysis whose directory is temporary."""
    with tempfile.TemporaryDirectory(prefix="gaitsweep_") as folder:
        found = run_sensitivity(job, folder, progress=progress, tell=warnings.warn)
    del found.table.attrs["path"]
    return dataclasses.replace(found, path=None)
