"""A job whose rows follow from sets of constants: the common part of search and sensitivity."""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from gaitsweep import near_miss
from gaitsweep.design.design import inside, requirement
from gaitsweep.engine.solver import derivative_refusal
from gaitsweep.fitting.free_parameters import FreeParameter
from gaitsweep.fitting.measure import Measure
from gaitsweep.fitting.population import Population, job_with_run
from gaitsweep.job import Job
from gaitsweep.job.config import Config
from gaitsweep.job.model_spec import ModelSpec, read_model_spec
from gaitsweep.kinds import RUN_KINDS
from gaitsweep.kinds.run_kind import RunKind, table_columns
from gaitsweep.schema.diagnostics import Diagnostic, JobError, quoted, refuse
from gaitsweep.schema.diagnostics import Path as FieldPath

# Fields of a job that have no place beside sets of constants.
_WITHOUT = ("vary", "figures")


@dataclasses.dataclass(frozen=True)
class FitJob:
    """A job without `vary`, its free constants, and the measures of each set of them.

    `written` is the job as written, without the field `field` (search or sensitivity) that holds the rest;
    `config` is the same with the fields of its config.
    """

    field: str
    written: dict[str, Any]
    folder: Path
    free: dict[str, FreeParameter]
    measures: dict[str, Measure]
    spec: ModelSpec
    config: Mapping[str, Any]

    @property
    def name(self) -> str:
        return str(self.written.get("name"))

    def path_of(self, measure: str) -> tuple[str, str, str]:
        """Return the path of a measure in the job."""
        return self.field, "targets" if self.field == "search" else "outputs", measure

    @property
    def structure(self) -> tuple[str, ...]:
        """Names of the free constants that shape the model."""
        return tuple(name for name in self.free if name not in self.spec.quantities)

    @property
    def without_default(self) -> set[str]:
        """Parameters and starts without a default that the job neither fixes nor frees."""
        fixed = {*(self.config.get("params") or {}), *(self.config.get("start") or {}), *self.free}
        return {name for name, quantity in self.spec.quantities.items() if quantity.default is None} - fixed

    @property
    def structures(self) -> list[dict[str, Any]]:
        """Choices of structure such that each choice of each name is among them."""
        choices = {name: self.free[name].ends for name in self.structure}
        longest = max(map(len, choices.values()), default=1)
        return [{name: ends[min(i, len(ends) - 1)] for name, ends in choices.items()} for i in range(longest)]

    def job_of(self, structure: Mapping[str, Any]) -> Job:
        """Return the job with a choice of structure, and with free constants in the middle of their ranges.

        Raises:
            JobError: the job is not valid.
        """
        middle = {
            name: parameter.at(np.array([0.5])).tolist()[0]
            for name, parameter in self.free.items()
            if name in self.spec.quantities
        }
        return self._job_with({**middle, **structure})

    def own_values(self, constants: Mapping[str, Any] | str) -> dict[str, Any]:
        """Return the value of each free constant in a set of which some are known.

        Args:
            constants: the known ones by name, or a config that has them; others have the job's own value, or
                the model's default. What shapes the model is the job's, whatever the config says, unless it
                is free.

        Raises:
            JobError: the model does not allow a name or a value, or a value without default is missing.
        """
        if isinstance(constants, str):
            job = self._job_with({}, config=constants)
        else:
            unknown = [name for name in constants if name not in self.free]
            hints = {name: near_miss.suggestion(name, self.free) for name in unknown}
            refuse([Diagnostic((name,), f"is not free here{hint}") for name, hint in hints.items()])
            job = self._job_with(constants)
        values = job.design.row(0)
        return {
            name: values[name] if name in values else getattr(job.design.model, name) for name in self.free
        }

    def _job_with(self, values: Mapping[str, Any], config: str | None = None) -> Job:
        """Return the job with values of constants, starts and structure, and with `config` if given."""
        data = copy.deepcopy(self.written)
        if config is not None:
            data["config"] = config
            # a constant of this structure may be none of the config's
            data["structure"] = {
                name: value for name, value in self.spec.structure.items() if name not in self.free
            }
        # a job needs values of these, which every measure replaces by its own
        needed = {
            name: points[0]
            for measure in self.measures.values()
            for name, points in measure.at.items()
            if name in self.without_default
        }
        for field, names in (
            ("params", self.spec.parameters),
            ("start", self.spec.starts),
            ("structure", self.structure),
        ):
            if settings := {name: value for name, value in {**needed, **values}.items() if name in names}:
                data[field] = {**(data.get(field) or {}), **settings}
        return Job.model_validate(data, context={"folder": self.folder})

    def population(self) -> Population:
        """Population that measures sets of constants."""
        return Population(self.job_of, self.structure, self.measures)


def read_fit_job(
    field: str,
    data: Mapping[str, Any],
    folder: Path,
    free: dict[str, FreeParameter],
    measures: dict[str, Measure],
    wrong: list[Diagnostic],
) -> FitJob:
    """Read a job whose free constants and measures have been read.

    Args:
        field: search or sensitivity, the field that contains them.
        data: the job as written.
        folder: folder to which its paths are relative.
        free: the free constants by name.
        measures: the measures by name.
        wrong: the errors so far.

    Raises:
        JobError: all errors.
    """
    written = {str(key): value for key, value in data.items() if key != field and value is not None}
    for key in _WITHOUT:
        if key in written:
            text = f"has no place beside {field}, whose sets of constants vary: take it out."
            wrong.append(Diagnostic((key,), text))
            del written[key]
    config = Config(written, folder)
    spec = None
    if "model" in config.raw:
        params = config.raw.get("params")
        spec, _ = read_model_spec(config.raw["model"], config.raw.get("structure"), params, [folder])
    if spec is None:
        refuse(wrong)
        Job.model_validate(written, context={"folder": folder})  # raises the errors of the model
        raise JobError([Diagnostic(("model",), "is missing.")])
    fit = FitJob(field, written, folder, free, measures, spec, config.raw)
    wrong.extend(_check_run(fit))
    wrong.extend(check_constants(fit))
    wrong.extend(check_measures(fit))
    refuse(wrong)
    for structure in fit.structures:
        try:
            job = fit.job_of(structure)
        except JobError as error:
            raise _at_the_choices(error, fit) from None
        columns_of_job = table_columns(job.design, job.run)
        for name, measure in measures.items():
            path = fit.path_of(name)
            columns = columns_of_job
            if (run := measure.own_run) is not None:
                columns = _columns_of_run(fit, structure, run, (*path, "run"), wrong)
            method = job.integration.method
            if measure.on_map and (refusal := derivative_refusal(method, job.design.model)) is not None:
                text = f"is fixed_point, but by {method} a return map has no derivative: {refusal}"
                wrong.append(Diagnostic((*path, "kind"), text))
            if (error := measure.field_error(columns, job.design.model)) is not None:
                key, text = error
                wrong.append(Diagnostic((*path, key), text))
        refuse(wrong)
    return fit


def _columns_of_run(
    fit: FitJob, structure: Mapping[str, Any], run: RunKind, path: FieldPath, wrong: list[Diagnostic]
) -> list[str]:
    """Return the columns of the run of a measure at `path`; errors are added to `wrong`."""
    if run.moved in fit.free:
        text = f"is {run.moved}, which is free, but a ramp cannot move a free constant."
        wrong.append(Diagnostic((*path, "parameter"), text))
        return []
    try:
        job = job_with_run(fit.job_of, run, structure)
    except JobError as error:
        wrong.extend(
            dataclasses.replace(diagnostic, path=(*path, *diagnostic.path[1:]))
            for diagnostic in error.diagnostics
            if diagnostic.path[:1] == ("run",)
        )
        refuse(wrong)
        raise
    return table_columns(job.design, job.run)


def check_constants(fit: FitJob) -> list[Diagnostic]:
    """Diagnostics of the free constants of a job."""
    wrong = []
    for name, parameter in fit.free.items():
        path = (fit.field, _free_field(fit), name)
        if name in fit.spec.structure:
            if parameter.choices is None:
                wrong.append(Diagnostic(path, "shapes the model: give its choices, not a range."))
            continue
        if (unknown := fit.spec.unknown(name, "vary")) is not None:
            wrong.append(Diagnostic(path, unknown))
            continue
        for field in ("params", "start"):
            # a search takes the job's value or a range of a constant; a sensitivity needs both
            if fit.field == "search" and name in (fit.written.get(field) or {}):
                text = f"is free, but {field}.{name} fixes it: take one of the two out."
                wrong.append(Diagnostic(path, text))
        quantity = fit.spec.quantities[name]
        for end in parameter.ends:
            if not isinstance(end, int | float) or isinstance(end, bool):
                wrong.append(Diagnostic(path, f"has the choice {quoted(end)}, but takes numbers."))
            elif not inside(np.array([float(end)]), quantity)[0]:
                wrong.append(Diagnostic(path, f"goes to {end:g}, but {requirement(quantity)}."))
    return wrong


def _check_run(fit: FitJob) -> list[Diagnostic]:
    """Diagnostics of the run kind of a job whose rows have to end in one record each."""
    run = fit.config.get("run")
    kind = run.get("kind") if isinstance(run, Mapping) else None
    if not isinstance(run, Mapping) or not isinstance(kind, str) or kind not in RUN_KINDS:
        return []  # the job reports it
    allowed = [name for name, part in RUN_KINDS.items() if part.one_a_row]
    if kind not in allowed:
        text = f"is {kind}, but {fit.field} takes {' or '.join(allowed)}: a record for each row."
        return [Diagnostic(("run", "kind"), text)]
    if run.get("refine") is not None:
        return [Diagnostic(("run", "refine"), f"has no place beside {fit.field}: take it out.")]
    return []


def _at_the_choices(error: JobError, fit: FitJob) -> JobError:
    """Return the error of a job with the paths of the choices and ranges that caused it."""
    diagnostics = [
        dataclasses.replace(diagnostic, path=(fit.field, _free_field(fit), str(diagnostic.path[1])))
        if len(diagnostic.path) > 1 and diagnostic.path[1] in fit.free
        else diagnostic
        for diagnostic in error.diagnostics
    ]
    return JobError(diagnostics)


def _free_field(fit: FitJob) -> str:
    """The field of a job that contains the free constants."""
    return "free" if fit.field == "search" else "parameters"


def check_measures(fit: FitJob) -> list[Diagnostic]:
    """Diagnostics of the conditions of measures."""
    wrong = []
    for name, measure in fit.measures.items():
        lacking = sorted(fit.without_default - set(measure.at))
        if lacking:
            names = " and ".join(lacking)
            text = f"does not set {names}, which the job does not fix and which has no default."
            wrong.append(Diagnostic((*fit.path_of(name), "at"), text))
        for condition, values in measure.at.items():
            path = (*fit.path_of(name), "at", condition)
            if (unknown := fit.spec.unknown(condition, "vary")) is not None:
                wrong.append(Diagnostic(path, unknown))
            elif condition in fit.structure:
                wrong.append(Diagnostic(path, "is free and shapes the model: a measure cannot set it."))
            elif condition in fit.free and all(condition in other.at for other in fit.measures.values()):
                wrong.append(Diagnostic(path, "is free, but every measure sets it: leave it to one of them."))
            else:
                quantity = fit.spec.quantities[condition]
                outside = np.array(values)[~inside(np.array(values), quantity)]
                if outside.size:
                    wrong.append(Diagnostic(path, f"is {outside[0]:g}, but {requirement(quantity)}."))
    return wrong
