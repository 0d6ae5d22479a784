"""Job of a sensitivity analysis: parameters with ranges, outputs, and the method."""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import importlib.util
import json
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from gaitsweep.contract import Quantity
from gaitsweep.errors import ArgumentError, JobError
from gaitsweep.fitting.fit_fields import (
    by_name,
    name_errors,
    read_file,
    read_free,
    read_measure,
    read_settings,
)
from gaitsweep.fitting.free_parameters import FreeParameter
from gaitsweep.fitting.measure import Measure
from gaitsweep.fitting.population import Population
from gaitsweep.fitting.search_and_sensitivity_job import FitJob, check_constants, check_measures, read_fit_job
from gaitsweep.fitting.sensitivity_methods import Method, SensitivityDesign, design_of
from gaitsweep.job import Job
from gaitsweep.schema.diagnostics import Diagnostic, quoted, refuse
from gaitsweep.schema.diagnostics import Path as FieldPath
from gaitsweep.schema.numbers import Count, Seed, Word
from gaitsweep.schema.strict_model import StrictModel, plain

# The output that is 1 for sets that fail.
FAILURES = "failures"
# Columns of the table of sets, beside parameters and outputs.
COLUMNS = ("row", "status", "why")
_PER_CENT = re.compile(r"\s*([0-9]*\.?[0-9]+)\s*%\s*")
MOST_SETS = 10**7
_MIN_N = {"morris": 4, "sobol": 8}  # trajectories, base points
# Points of a trajectory or of a base point beside one for each parameter.
_POINTS_BESIDE = {"morris": 1, "sobol": 2}


class Analysis(StrictModel):
    """Settings of a sensitivity analysis."""

    method: Annotated[Method, Word()] = Field(
        description="one_at_a_time: each parameter at the ends and the middle of its range; morris: "
        "elementary effects along trajectories; sobol: shares of the variance"
    )
    n: Count | None = Field(
        default=None, description="trajectories (morris), or base points, a power of two (sobol)"
    )
    seed: Seed = Field(default=0, description="seed of all that is drawn")


@dataclasses.dataclass(frozen=True)
class SensitivityJob:
    """Sensitivity analysis of a job file.

    `fit` has the job with the ranges of its parameters, `base` the job's own values of them; `written` is the
    field `sensitivity` of the file.
    """

    fit: FitJob
    base: dict[str, float]
    analysis: Analysis
    written: dict[str, Any]

    @property
    def name(self) -> str:
        """Name of the job."""
        return self.fit.name

    @property
    def parameters(self) -> dict[str, FreeParameter]:
        """Ranges by parameter."""
        return self.fit.free

    @property
    def outputs(self) -> dict[str, Measure]:
        """Measures by name."""
        return self.fit.measures

    @functools.cached_property
    def design(self) -> SensitivityDesign:
        """Sets of parameters, a row of the table each."""
        analysis = self.analysis
        return design_of(analysis.method, analysis.n, analysis.seed, self.parameters, self.base)

    def population(self) -> Population:
        """Create the population that measures the sets; other parameters keep the job's values."""
        return _own_values(self.fit).population()

    def resolved(self, job: Job, engine: str) -> dict[str, Any]:
        """Return the analysis as plain values, which the result directory stores and which can be run again.

        Args:
            job: the job of a set.
            engine: the engine that runs.
        """
        resolved = job.resolved(engine=engine)
        fields = {name: value for name, value in resolved.items() if name not in ("vary", "figures")}
        return {**fields, "sensitivity": self.written}

    def hash(self, job_hash: str, block: int) -> str:
        """Return the sha256, in hex, of all that determines the sets and their measures.

        Args:
            job_hash: hash of the job with its own values.
            block: number of sets of a part.
        """
        deciding = {
            "job": job_hash,
            "block": block,
            "sets": {name: column.tolist() for name, column in self.design.sets.items()},
            "outputs": {name: _plain_fields(measure) for name, measure in self.outputs.items()},
            **self.fit.deciding_rules(),
        }
        return hashlib.sha256(json.dumps(deciding, sort_keys=True).encode()).hexdigest()


def load_sensitivity(path: str | Path, overrides: Sequence[str] = ()) -> SensitivityJob:
    """Load a sensitivity analysis from a YAML file.

    Args:
        path: the file.
        overrides: "key=value" each, laid over it as `gaitsweep.load_job` does.

    Raises:
        JobError: all errors, with file and line of each.
    """
    return read_file(path, overrides, read_sensitivity)


def read_sensitivity(data: Mapping[str, Any], folder: Path) -> SensitivityJob:
    """Read a sensitivity analysis from its mapping.

    Args:
        data: the mapping.
        folder: folder to which its paths are relative.

    Raises:
        JobError: all errors.
        ArgumentError: the package of the method is not installed.
    """
    data = plain(data)
    wrong: list[Diagnostic] = []
    written = data.get("sensitivity")
    if not isinstance(written, Mapping):
        text = "is missing" if written is None else f"is {quoted(written)}"
        raise JobError([Diagnostic(("sensitivity",), f"{text}: it has parameters, outputs, method, and n.")])
    ranges, shares = _read_parameters(written.get("parameters"), wrong)
    outputs = _read_outputs(written.get("outputs"), {*ranges, *shares}, wrong)
    analysis = _read_analysis(written, ranges, len(ranges) + len(shares), wrong)
    fit = read_fit_job("sensitivity", data, folder, ranges, outputs, wrong)
    assert analysis is not None  # `read_fit_job` has refused `wrong`
    own_job = _own_values(fit).job_of({})
    refused = {
        name: fit.spec.unknown(name, "vary") or _no_share(fit.spec.quantities[name]) for name in shares
    }
    refuse([Diagnostic((*fit.free_path, name), text) for name, text in refused.items() if text is not None])
    own_values = own_job.design.row(0)
    # parameters of which the analysis needs the job's own value
    with_own_value = [*ranges, *shares] if analysis.method == "one_at_a_time" else list(shares)
    wrong.extend(_follow_conditions(own_job, with_own_value, outputs))
    around = {name: _range_around(name, own_values[name], share, wrong) for name, share in shares.items()}
    refuse(wrong)
    all_ranges = ranges | {name: parameter for name, parameter in around.items() if parameter is not None}
    free = {str(name): all_ranges[str(name)] for name in written["parameters"]}  # in the order of the job
    fit = dataclasses.replace(fit, free=free)
    refuse([*check_constants(fit), *check_measures(fit)])
    if analysis.method != "one_at_a_time" and importlib.util.find_spec("SALib") is None:
        raise ArgumentError(
            f"sensitivity.method {analysis.method} needs the package SALib: pip install 'gaitsweep[search]'."
        )
    return SensitivityJob(fit, {name: own_values[name] for name in free}, analysis, dict(written))


def _read_parameters(
    value: Any, wrong: list[Diagnostic]
) -> tuple[dict[str, FreeParameter], dict[str, float]]:
    """Read the parameters with a range, and those with a share of the job's value."""
    path = ("sensitivity", "parameters")
    ranges: dict[str, FreeParameter] = {}
    shares: dict[str, float] = {}
    takes = "ranges by name, such as kappa: 10% or kappa: [1, 2]"
    for name, written in by_name(value, takes, path, wrong):
        if isinstance(written, list | Mapping):
            parameters = read_free({name: written}, path, wrong)
            if name in parameters and parameters[name].choices is not None:
                wrong.append(Diagnostic((*path, name), "has choices, but takes a range of numbers."))
            else:
                ranges |= parameters
        elif (share := _read_share(written, (*path, name), wrong)) is not None:
            shares[name] = share
    return ranges, shares


def _read_share(value: Any, path: FieldPath, wrong: list[Diagnostic]) -> float | None:
    """Read a share of the job's value, such as 10%; None, with an error in `wrong`, for other values."""
    match = _PER_CENT.fullmatch(value) if isinstance(value, str) else None
    if match is None:
        text = f"is {quoted(value)}, but takes [low, high], or a share of the job's value such as 10%."
        wrong.append(Diagnostic(path, text))
        return None
    share = float(match[1]) / 100.0
    if not 0.0 < share <= 1.0:
        wrong.append(Diagnostic(path, f"is {quoted(value)}, but must be above 0% and at most 100%."))
        return None
    return share


def _read_outputs(value: Any, parameters: Iterable[str], wrong: list[Diagnostic]) -> dict[str, Measure]:
    """Read the outputs by name; errors are added to `wrong`."""
    path = ("sensitivity", "outputs")
    columns = {*COLUMNS, FAILURES, *parameters}
    outputs = {}
    for name, fields in by_name(value, "measures by name", path, wrong):
        output_path = (*path, name)
        wrong.extend(name_errors(name, name in columns, output_path))
        if (measure := read_measure(fields, output_path, wrong)) is not None:
            outputs[name] = measure
    return outputs


def _read_analysis(
    written: Mapping[str, Any], ranges: Mapping[str, FreeParameter], k: int, wrong: list[Diagnostic]
) -> Analysis | None:
    """Read the settings of an analysis of k parameters, some with ranges; errors are added to `wrong`."""
    analysis = read_settings(Analysis, "sensitivity", ("parameters", "outputs"), written, wrong)
    if analysis is None:
        return None
    method = analysis.method
    n = analysis.n
    path = ("sensitivity", "n")
    if method == "one_at_a_time":
        if n is not None:
            text = "has no place with one_at_a_time, whose sets follow from the ranges: take it out."
            wrong.append(Diagnostic(path, text))
        return analysis
    if (text := _number_error(method, n, k)) is not None:
        wrong.append(Diagnostic(path, text))
    for name, parameter in ranges.items():
        if method == "morris" and parameter.whole:
            text = "is whole, but the steps of morris are shares of a range: take sobol or one_at_a_time."
            wrong.append(Diagnostic(("sensitivity", "parameters", name), text))
    return analysis


def _number_error(method: Method, n: int | None, k: int) -> str | None:
    """Return the end of a sentence why n is not allowed for k parameters; None if it is allowed."""
    points = "trajectories" if method == "morris" else "base points"
    if n is None:
        return f"is missing: the number of {points}."
    if n < _MIN_N[method]:
        return f"is {n}, but {method} takes at least {_MIN_N[method]} {points}."
    if method == "sobol" and n.bit_count() != 1:
        below = 2 ** (n.bit_length() - 1)
        return f"is {n}, but sobol takes a power of two, which keeps its points even: {below} or {2 * below}."
    sets = n * (k + _POINTS_BESIDE[method])
    return f"is {n}, which makes {sets} sets; there are at most {MOST_SETS}." if sets > MOST_SETS else None


def _plain_fields(measure: Measure) -> dict[str, Any]:
    """Return the fields of a measure as plain values, its run included."""
    return {name: value.model_dump() if isinstance(value, StrictModel) else value for name, value in measure}


def _own_values(fit: FitJob) -> FitJob:
    """Return the job with its own values; a start without a value is in the middle of its range."""
    written_starts = fit.written.get("start") or {}
    without_value = {
        name: parameter
        for name, parameter in fit.free.items()
        if name in fit.spec.starts and fit.spec.starts[name].default is None and name not in written_starts
    }
    return dataclasses.replace(fit, free=without_value)


def _follow_conditions(job: Job, names: Iterable[str], outputs: Mapping[str, Measure]) -> list[Diagnostic]:
    """Return errors of parameters whose value is a formula of what outputs set, so it is not unique."""
    set_by_outputs = {name for measure in outputs.values() for name in measure.at}
    wrong = []
    for name in names:
        followed = sorted((job.design.closure([name]) - {name}) & set_by_outputs)
        if followed:
            text = f"follows {followed[0]}, which outputs set: give it a number under params."
            wrong.append(Diagnostic(("sensitivity", "parameters", name), text))
    return wrong


def _no_share(quantity: Quantity) -> str | None:
    """Return the end of a sentence why a quantity cannot change by a share of itself, or None."""
    if not quantity.whole:
        return None
    return "takes whole numbers only and cannot change by a share of itself: give low, high and whole: true."


def _range_around(name: str, value: float, share: float, wrong: list[Diagnostic]) -> FreeParameter | None:
    """Return the range from `share` below a value to `share` above it; None, with an error, without width."""
    if not np.isfinite(value) or value == 0.0:
        reason = "is 0 in this job" if value == 0.0 else "has no value in this job"
        text = f"{reason}, so a share of it has no width: give [low, high]."
        wrong.append(Diagnostic(("sensitivity", "parameters", name), text))
        return None
    low, high = sorted((value * (1.0 - share), value * (1.0 + share)))
    return FreeParameter(low=low, high=high)
