"""Job whose rows follow from sets of constants: the common part of search and sensitivity."""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np

from gaitsweep import near_miss
from gaitsweep.contract import Quantity
from gaitsweep.design.design import inside, requirement
from gaitsweep.engine.solver.methods import derivative_refusal
from gaitsweep.errors import JobError
from gaitsweep.fitting.free_parameters import FreeParameter
from gaitsweep.fitting.measure import Measure
from gaitsweep.fitting.population import Population, job_with_run
from gaitsweep.job import Job
from gaitsweep.job.model_spec import ModelSpec, read_model_spec
from gaitsweep.job.reading import Config
from gaitsweep.kinds import RUN_KINDS, Settle
from gaitsweep.kinds.run_kind import RunKind, table_columns
from gaitsweep.schema.diagnostics import Diagnostic, quoted, refuse
from gaitsweep.schema.diagnostics import Path as FieldPath

# Fields of a job that have no place beside sets of constants.
_EXCLUDED_FIELDS = ("vary", "figures")

FitField = Literal["search", "sensitivity"]


@dataclasses.dataclass(frozen=True)
class FitJob:
    """A job without `vary`, its free constants, and the measures of each set of them.

    `field` is the field of the job that holds constants and measures; `written` is the job as written without
    it, and `config` the same with the fields of its config.
    """

    field: FitField
    written: dict[str, Any]
    folder: Path
    free: dict[str, FreeParameter]
    measures: dict[str, Measure]
    spec: ModelSpec
    config: Mapping[str, Any]

    @property
    def name(self) -> str:
        """Name of the job."""
        return str(self.written.get("name"))

    def path_of(self, measure: str) -> tuple[str, str, str]:
        """Return the path of a measure in the job."""
        measures_field = "targets" if self.field == "search" else "outputs"
        return self.field, measures_field, measure

    @property
    def free_path(self) -> tuple[str, str]:
        """Path of the free constants in the job."""
        return self.field, "free" if self.field == "search" else "parameters"

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
        most_choices = max(map(len, choices.values()), default=1)
        # a name with fewer choices repeats its last one
        return [
            {name: ends[min(number, len(ends) - 1)] for name, ends in choices.items()}
            for number in range(most_choices)
        ]

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
                the model's default. The structure is that of the job and not of the config, unless it is
                free.

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
            # a constant of the job's structure need not exist in that of the config
            data["structure"] = {
                name: value for name, value in self.spec.structure.items() if name not in self.free
            }
        # a job needs values of these, which every measure replaces by its own
        placeholders = {
            name: points[0]
            for measure in self.measures.values()
            for name, points in measure.at.items()
            if name in self.without_default
        }
        all_values = {**placeholders, **values}
        names_by_field = {
            "params": self.spec.parameters,
            "start": self.spec.starts,
            "structure": self.structure,
        }
        for field, names in names_by_field.items():
            settings = {name: value for name, value in all_values.items() if name in names}
            if settings:
                data[field] = {**(data.get(field) or {}), **settings}
        return Job.model_validate(data, context={"folder": self.folder})

    def deciding_rules(self) -> dict[str, Any]:
        """Return the rules of measures that differ from those of older versions; {} without any."""
        run = self.job_of(self.structures[0]).run
        rules = {
            name: measure.rule_of_settling
            for name, measure in self.measures.items()
            if measure.rule_of_settling > 1 and isinstance(measure.own_run or run, Settle)
        }
        return {"rules": rules} if rules else {}

    def population(self) -> Population:
        """Create the population that measures sets of constants."""
        return Population(self.job_of, self.structure, self.measures)


def read_fit_job(
    field: FitField,
    data: Mapping[str, Any],
    folder: Path,
    free: dict[str, FreeParameter],
    measures: dict[str, Measure],
    wrong: list[Diagnostic],
) -> FitJob:
    """Read a job whose free constants and measures have been read.

    Args:
        field: the field that contains them.
        data: the job as written.
        folder: folder to which its paths are relative.
        free: the free constants by name.
        measures: the measures by name.
        wrong: the errors so far.

    Raises:
        JobError: all errors.
    """
    written = {str(key): value for key, value in data.items() if key != field and value is not None}
    for key in _EXCLUDED_FIELDS:
        if key in written:
            text = f"has no place beside {field}, whose sets of constants vary: take it out."
            wrong.append(Diagnostic((key,), text))
            del written[key]
    fields = Config(written, folder).raw
    spec = None
    if "model" in fields:
        spec, _ = read_model_spec(fields["model"], fields.get("structure"), fields.get("params"), [folder])
    constants = [fields.get(key) or {} for key in ("params", "start")]
    if spec is None or not all(isinstance(values, Mapping) for values in constants):
        refuse(wrong)
        Job.model_validate(written, context={"folder": folder})  # raises the errors of these fields
        raise JobError([Diagnostic(("model",), "is missing.")])
    fit = FitJob(field, written, folder, free, measures, spec, fields)
    refuse([*wrong, *_check_run(fit), *check_constants(fit), *check_measures(fit)])
    for structure in fit.structures:
        _check_structure(fit, structure)
    return fit


def _check_structure(fit: FitJob, structure: Mapping[str, Any]) -> None:
    """Check the job and the fields of its measures with a choice of structure.

    Raises:
        JobError: all errors.
    """
    try:
        job = fit.job_of(structure)
    except JobError as error:
        raise _at_the_choices(error, fit) from None
    model = job.design.model
    method = job.integration.method
    columns_of_job = table_columns(job.design, job.run)
    wrong = expressions_left_behind(job, _paths_of_differing(fit, job))
    for name, measure in fit.measures.items():
        path = fit.path_of(name)
        run = measure.own_run
        columns = columns_of_job
        if run is not None:
            columns = _columns_of_run(fit, structure, run, (*path, "run"), wrong)
        if measure.on_map and (refusal := derivative_refusal(method, model)) is not None:
            text = f"is fixed_point, but by {method} a return map has no derivative: {refusal}"
            wrong.append(Diagnostic((*path, "kind"), text))
        if (field_error := measure.field_error(columns, model)) is not None:
            key, text = field_error
            wrong.append(Diagnostic((*path, key), text))
    refuse(wrong)


def _paths_of_differing(fit: FitJob, job: Job) -> dict[str, FieldPath]:
    """Return the paths of names that differ between rows, or from the job's own values."""
    own_values = job.design.row(0)
    paths: dict[str, FieldPath] = {
        name: (*fit.path_of(key), "at", name)
        for key, measure in fit.measures.items()
        for name, values in measure.at.items()
        if set(values) != {own_values.get(name)}
    }
    return paths | {name: (*fit.free_path, name) for name in fit.free}


def expressions_left_behind(job: Job, paths: Mapping[str, FieldPath]) -> list[Diagnostic]:
    """Return errors about expressions with one value for all rows that follow names which differ.

    Args:
        job: the job.
        paths: the paths of the names that differ between rows.
    """
    return [
        Diagnostic(
            path,
            f'differs between rows, but the job has the expression "{expression}" under run, numerics or '
            "figures, which has one value for all rows: write a number there.",
        )
        for name, path in paths.items()
        for expression in job.expressions_of(name)[:1]
    ]


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
    """Check the free constants of a job; return the diagnostics."""
    wrong = []
    for name, parameter in fit.free.items():
        path = (*fit.free_path, name)
        # a search takes the job's value or a range of a constant; a sensitivity needs both
        if fit.field == "search":
            wrong.extend(_fixed_and_free(fit, name))
        if name in fit.spec.structure:
            if parameter.choices is None:
                wrong.append(Diagnostic(path, "shapes the model: give its choices, not a range."))
        elif (unknown := fit.spec.unknown(name, "vary")) is not None:
            wrong.append(Diagnostic(path, unknown))
        else:
            wrong.extend(Diagnostic(path, text) for text in _end_errors(parameter, fit.spec.quantities[name]))
    return wrong


def _fixed_and_free(fit: FitJob, name: str) -> list[Diagnostic]:
    """Return errors of a free constant that the job fixes too."""
    return [
        Diagnostic((*fit.free_path, name), f"is free, but {field}.{name} fixes it: take one of the two out.")
        for field in ("params", "start", "structure")
        if name in (fit.written.get(field) or {})
    ]


def _end_errors(parameter: FreeParameter, quantity: Quantity) -> list[str]:
    """Return the ends of sentences about ends or choices that a quantity does not allow."""
    errors = []
    for end in parameter.ends:
        if not isinstance(end, int | float) or isinstance(end, bool):
            errors.append(f"has the choice {quoted(end)}, but takes numbers.")
        elif not inside(np.array([float(end)]), quantity)[0]:
            errors.append(f"goes to {end:g}, but {requirement(quantity)}.")
    if quantity.whole and parameter.choices is None and not (parameter.whole or errors):
        low, high = parameter.ends
        form = f"{{low: {low:g}, high: {high:g}, whole: true}}"
        errors.append(f"is a range of all numbers, but {requirement(quantity)}: write {form}.")
    return errors


def _check_run(fit: FitJob) -> list[Diagnostic]:
    """Check that the rows of a job's run end in one record each; return the diagnostics."""
    run = fit.config.get("run")
    kind = run.get("kind") if isinstance(run, Mapping) else None
    if not isinstance(run, Mapping) or not isinstance(kind, str) or kind not in RUN_KINDS:
        return []  # the job reports it
    allowed = [name for name, run_kind in RUN_KINDS.items() if run_kind.one_a_row]
    if kind not in allowed:
        text = f"is {kind}, but {fit.field} takes {' or '.join(allowed)}: a record for each row."
        return [Diagnostic(("run", "kind"), text)]
    if run.get("refine") is not None:
        return [Diagnostic(("run", "refine"), f"has no place beside {fit.field}: take it out.")]
    return []


def _at_the_choices(error: JobError, fit: FitJob) -> JobError:
    """Return the error of a job with the paths of the choices and ranges that caused it."""
    diagnostics = [
        dataclasses.replace(diagnostic, path=(*fit.free_path, str(diagnostic.path[1])))
        if len(diagnostic.path) > 1 and diagnostic.path[1] in fit.free
        else diagnostic
        for diagnostic in error.diagnostics
    ]
    return JobError(diagnostics)


def check_measures(fit: FitJob) -> list[Diagnostic]:
    """Check the conditions of measures; return the diagnostics."""
    wrong = []
    for name, measure in fit.measures.items():
        path = (*fit.path_of(name), "at")
        lacking = sorted(fit.without_default - set(measure.at))
        if lacking:
            names = " and ".join(lacking)
            text = f"does not set {names}, which the job does not fix and which has no default."
            wrong.append(Diagnostic(path, text))
        for condition, values in measure.at.items():
            if (text := _condition_error(fit, condition, values)) is not None:
                wrong.append(Diagnostic((*path, condition), text))
    return wrong


def _condition_error(fit: FitJob, name: str, values: Sequence[float]) -> str | None:
    """Return the end of a sentence why a measure cannot set a name to some values; None if it can."""
    if (unknown := fit.spec.unknown(name, "vary")) is not None:
        return unknown
    if name in fit.structure:
        return "is free and shapes the model: a measure cannot set it."
    if name in fit.free and all(name in measure.at for measure in fit.measures.values()):
        return "is free, but every measure sets it: leave it to one of them."
    quantity = fit.spec.quantities[name]
    points = np.array(values)
    outside = points[~inside(points, quantity)]
    return f"is {outside[0]:g}, but {requirement(quantity)}." if outside.size else None
