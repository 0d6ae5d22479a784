"""Reading of a job: its sections in order, with all diagnostics collected, and its rows.

A job may name a config, a parameter set in a separate file, whose values its own values override: by its path
(`config: ../configs/mine.yaml`) or as `builtin:NAME`.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Iterator, Mapping, Sequence, Set
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from pydantic import BaseModel, ValidationError

from gaitsweep.design.design import Design
from gaitsweep.design.vary import Group, read_vary, written_names
from gaitsweep.engine.numerics import ResolvedNumerics
from gaitsweep.errors import JobError
from gaitsweep.expression import ExpressionError, evaluate, names_used
from gaitsweep.job.checks import check_figures, check_names, check_ranges
from gaitsweep.job.model_spec import ModelSpec, read_model_spec, read_settings
from gaitsweep.job.numerics import check_numerics, suited_to_stiffness
from gaitsweep.job.step_lengths import check_steps
from gaitsweep.kinds import kind_written, parameter_written
from gaitsweep.kinds.fixed_points import FollowsFixedPoints
from gaitsweep.kinds.run_kind import RunKind, table_columns
from gaitsweep.plot.kind import FigureKind
from gaitsweep.schema.diagnostics import Diagnostic, quoted, unknown_field
from gaitsweep.schema.diagnostics import Path as FieldPath
from gaitsweep.schema.numbers import SCOPE, Scope
from gaitsweep.schema.strict_model import SchemaSection, from_pydantic
from gaitsweep.schema.yaml_document import Document, read_document
from gaitsweep.shipped import config_file

if TYPE_CHECKING:
    from gaitsweep.job.job import Job


_FIELDS = ("model", "structure", "params", "source")


class Config:
    """A job's mapping merged with its config.

    `raw` is the merged mapping, `diagnostics` are the errors of the config.

    Args:
        raw: the job's mapping as written.
        folder: the folder to which the path of the config is relative.
    """

    def __init__(self, raw: dict[str, Any], folder: Path) -> None:
        self.raw = raw
        self.diagnostics: list[Diagnostic] = []
        self._document: Document | None = None
        self._from_config: set[FieldPath] = set()
        path = raw.get("config")
        if path is None:
            return
        if not isinstance(path, (str, Path)) or not str(path).strip():
            text = f"is {quoted(path)}, but must be the path of a YAML file or builtin:NAME."
            self.diagnostics.append(Diagnostic(("config",), text))
            return
        try:
            file = config_file(path, folder)
            self._document = read_document(file, noun="a config", fields=("model", "params"))
        except JobError as error:
            self.diagnostics.extend(map(_at_the_job, error.diagnostics))
            return
        self._merge(self._document)

    def locate(self, diagnostic: Diagnostic) -> Diagnostic:
        """Return the diagnostic with the config's file and line if the field comes from the config."""
        if self._document is None or diagnostic.file or diagnostic.path[:2] not in self._from_config:
            return diagnostic
        return self._document.locate(diagnostic)

    def error(self, diagnostics: list[Diagnostic]) -> JobError:
        """Return the error with these diagnostics, each with its place in the config if it has one."""
        return JobError([self.locate(diagnostic) for diagnostic in diagnostics])

    def refuse(self, diagnostics: list[Diagnostic]) -> None:
        """Refuse a job that has errors.

        Raises:
            JobError: there are diagnostics.
        """
        if diagnostics:
            raise self.error(diagnostics)

    def _merge(self, document: Document) -> None:
        """Add the fields of the config that the job leaves out."""
        others = [str(key) for key in document.data if key not in _FIELDS]
        unknown = [unknown_field((key,), "a config", _FIELDS) for key in others]
        self.diagnostics.extend(map(document.locate, unknown))
        merged = dict(self.raw)
        if "model" in document.data and self.raw.get("model") is None:
            merged["model"] = document.data["model"]
            self._from_config.add(("model",))
        for section in ("structure", "params"):
            of_config = document.data.get(section)
            if of_config is not None and not isinstance(of_config, Mapping):
                text = f"is {quoted(of_config)}, but must be a mapping of names to numbers (name: number)."
                self.diagnostics.append(document.locate(Diagnostic((section,), text)))
                continue
            of_job = {} if self.raw.get(section) is None else self.raw[section]
            if of_config and isinstance(of_job, Mapping):
                merged[section] = self._without_overridden(of_config, section) | dict(of_job)
                self._from_config |= {(section, str(key)) for key in of_config if key not in of_job}
        self.raw = merged

    def _without_overridden(self, of_config: Mapping[str, Any], section: str) -> dict[str, Any]:
        """Return values of the config, without those that the job varies, moves, or sets elsewhere."""
        overridden = {name for names in written_names(self.raw.get("vary")) for name in names}
        overridden.add(str(parameter_written(self.raw.get("run"))))
        other = self.raw.get("structure" if section == "params" else "params")
        if isinstance(other, Mapping):
            overridden |= {str(key) for key in other}
        return {str(key): value for key, value in of_config.items() if key not in overridden}


def _at_the_job(diagnostic: Diagnostic) -> Diagnostic:
    """Return a diagnostic of a config, at the job's field if it has no line in the config."""
    if diagnostic.line:
        return diagnostic
    return Diagnostic(("config",), f"names {diagnostic.file}, which {diagnostic.text}")


# Fields of jobs that a command of the same name reads.
FITTING_FIELDS = ("search", "sensitivity")
# Fields that decide a row's values.
_DECIDING_VALUES = ("config", "model", "structure", "ground", "params", "start", "vary")
# Fields that are read here, so that pydantic gets their normal form.
_READ_HERE = ("params", "start", "vary", "structure", "ground")


class ReadJob(NamedTuple):
    """A job with its rows, its numerics, and by field the expressions that became numbers."""

    job: Job
    design: Design
    numerics: ResolvedNumerics
    evaluated: Mapping[str, Set[str]]


def read_job(
    data: Any, folder: Path, handler: Callable[[Any], Job], sections: dict[str, SchemaSection]
) -> ReadJob:
    """Read a job, its rows and its numerics.

    Model, structure, params, start and vary come first, since expressions in the other parts use them.

    Args:
        data: the job's mapping as written.
        folder: the folder to which paths are relative and which has the user's modules.
        handler: pydantic's validator of the whole mapping.
        sections: the parts of a job by the keys under which pydantic reports them.

    Raises:
        JobError: all errors in the job.
    """
    config = Config(_written_fields(data), folder)
    rows = _read_rows(config, folder)
    diagnostics = list(rows.diagnostics)
    scope = _scope(rows.design, rows.spec, rows.moved)
    token = SCOPE.set(scope)
    try:
        job = handler(rows.fields)
        figure_numbers = list(range(len(job.figures)))
    except ValidationError as error:
        errors = from_pydantic(error, sections, "")
        wrong = [_named_by_section(diagnostic, rows.spec, sections) for diagnostic in errors]
        diagnostics.extend(wrong)
        job, figure_numbers = _without_refused(rows.fields, wrong, handler)
    finally:
        SCOPE.reset(token)
    if job is None or rows.design is None or rows.spec is None:
        raise config.error(diagnostics)
    spec = rows.spec
    design = rows.design
    diagnostics.extend(_unknown_movements(job.run, spec))
    if job.run.moved is not None and job.run.turns:  # a trace may lack its path, which its check reports
        settings = {**design.settings, job.run.moved: job.run.turns[0]}
        design = dataclasses.replace(design, settings=settings)
    if diagnostics:
        figures = dict(zip(figure_numbers, job.figures, strict=True))
        raise config.error([*diagnostics, *_further_diagnostics(diagnostics, design, spec, job, figures)])
    numerics = job.numerics.resolve(spec.model, contraction=job.engine.contraction)
    config.refuse(_check_whole(design, spec, job, numerics))
    if job.numerics.method == "auto":
        numerics = suited_to_stiffness(design, job.run, numerics)
    config.refuse(check_steps(design, job.run, numerics))
    evaluated = {
        name: scope.evaluated & set(_texts(value))
        for name, value in rows.fields.items()
        if name not in _READ_HERE
    }
    return ReadJob(job, design, numerics, evaluated)


def _texts(value: Any) -> Iterator[str]:
    """Yield all texts in a field as written, without spaces, as expressions are evaluated."""
    if isinstance(value, str):
        yield "".join(value.split())
    elif isinstance(value, Mapping | list | tuple):
        for item in value.values() if isinstance(value, Mapping) else value:
            yield from _texts(item)


def _named_by_section(
    diagnostic: Diagnostic, spec: ModelSpec | None, sections: Mapping[str, SchemaSection]
) -> Diagnostic:
    """Return the diagnostic of a field that no job has; of a quantity of the model with its section."""
    name = str(diagnostic.path[0]) if len(diagnostic.path) == 1 else ""
    if spec is None or name in sections[""].fields or name not in spec.quantities:
        return diagnostic
    noun, section = ("parameter", "params") if name in spec.parameters else ("start value", "start")
    text = f"is a {noun} of {spec.model.name}: write it under {section}, in --set as {section}.{name}=VALUE."
    return Diagnostic(diagnostic.path, text)


def _written_fields(data: Any) -> dict[str, Any]:
    """Return the fields of a job's mapping as plain values, without empty ones.

    Raises:
        JobError: it is not a mapping, or is a job of another command.
    """
    if not isinstance(data, Mapping):
        raise JobError([Diagnostic((), f"is {quoted(data)}, but a job must be a mapping (key: value).")])
    for key in FITTING_FIELDS:
        if data.get(key) is not None:
            text = f"belongs to another command: run this job with `gaitsweep {key}`."
            raise JobError([Diagnostic((key,), text)])
    return {
        str(key): value.model_dump() if isinstance(value, BaseModel) else value
        for key, value in data.items()
        if value is not None
    }


@dataclasses.dataclass
class _Rows:
    """Model and rows of a job, as far as they could be read.

    `moved` is the parameter that the run moves; `fields` are the job's fields for pydantic, in which those
    that were read have their normal form; `diagnostics` are the errors so far.
    """

    spec: ModelSpec | None
    design: Design | None
    moved: str | None
    fields: dict[str, Any]
    diagnostics: list[Diagnostic]


def _read_rows(config: Config, folder: Path) -> _Rows:
    """Read the model, its settings and `vary`, from the fields of a job and its config."""
    raw = config.raw
    diagnostics = list(config.diagnostics)
    spec = None
    if "model" in raw:
        structure, params, run, ground = map(raw.get, ("structure", "params", "run", "ground"))
        spec, wrong = read_model_spec(raw["model"], structure, params, [folder], run, ground)
        diagnostics += wrong
    kind = kind_written(raw.get("run"))
    if spec is not None and kind is not None:
        raw, wrong = kind.filled(raw, spec.model, folder)
        config.refuse(wrong)  # without the values of the table others would be missing
    fields = {key: value for key, value in raw.items() if key not in _READ_HERE}
    settings: dict[str, float | str] = {}
    if spec is not None:
        fields["structure"] = spec.resolved_structure
        fields["params"], wrong_params = read_settings(raw.get("params"), "params", spec)
        fields["start"], wrong_starts = read_settings(raw.get("start"), "start", spec)
        diagnostics += [*wrong_params, *wrong_starts]
        settings = {**fields["params"], **fields["start"]}
    moving = parameter_written(raw.get("run"))
    moved = moving if isinstance(moving, str) and spec is not None and moving in spec.parameters else None
    refusal = functools.partial(_refusal_to_vary, spec, settings, moved)
    vary = read_vary(raw.get("vary"), spec.quantities if spec else {}, refusal)
    fields["vary"] = vary.plain
    diagnostics += vary.diagnostics
    design = None
    if spec is not None and not vary.diagnostics:
        design = _design(spec, vary.groups, settings, moved, diagnostics)
    return _Rows(spec, design, moved, fields, diagnostics)


def _refusal_to_vary(
    spec: ModelSpec | None, settings: Mapping[str, float | str], moved: str | None, name: str
) -> str | None:
    """Return the reason why a name cannot vary in this job, or None."""
    if spec is None:
        return None
    if name in settings:
        section = "params" if name in spec.parameters else "start"
        return f"varies, but {section}.{name} fixes it: remove one of the two."
    if name == moved:
        return "varies, but run.parameter moves it: remove one of the two."
    return spec.unknown(name, "vary")


def _unknown_movements(run: RunKind, spec: ModelSpec) -> list[Diagnostic]:
    """Return errors about parameters that a run moves and the model does not have."""
    return [
        Diagnostic(movement.name_path, f"is {movement.parameter}, which {reason}")
        for movement in run.movements
        if (reason := spec.unknown(movement.parameter, "params")) is not None
    ]


def _further_diagnostics(
    diagnostics: Sequence[Diagnostic],
    design: Design,
    spec: ModelSpec,
    job: Job,
    figures: Mapping[int, FigureKind],
) -> list[Diagnostic]:
    """Return errors of figures and values that do not follow from the errors found so far.

    Args:
        diagnostics: the errors found so far.
        design: the job's rows.
        spec: its model.
        job: the job without wrong fields.
        figures: its figures by their numbers in the job as written.
    """
    further = check_figures(figures, job.style, design, job.run)
    wrong_fields = {str(diagnostic.path[0]) if diagnostic.path else "" for diagnostic in diagnostics}
    if wrong_fields.isdisjoint(("", "run", *_DECIDING_VALUES)):
        further += check_ranges(design, spec, job.run)
    return further


def _without_refused(
    fields: Mapping[str, Any], wrong: Sequence[Diagnostic], handler: Callable[[Any], Job]
) -> tuple[Job | None, list[int]]:
    """Read the job without its refused fields; a wrong figure is left out alone.

    Returns:
        The job, None where it must have a refused field, and the numbers of its figures.
    """
    refused = {diagnostic.path[:2] for diagnostic in wrong}
    names = {path[0] for path in refused if path and (len(path) == 1 or path[0] != "figures")}
    sound_fields = {"name": "job", **{name: value for name, value in fields.items() if name not in names}}
    figures = fields.get("figures")
    numbers: list[int] = []
    if figures is not None:
        if isinstance(figures, list | tuple):
            numbers = [number for number in range(len(figures)) if ("figures", number) not in refused]
        sound_fields["figures"] = [figures[number] for number in numbers]
    try:
        return handler(sound_fields), numbers
    except ValidationError:
        return None, []


def _design(
    spec: ModelSpec,
    groups: list[Group],
    written: Mapping[str, float | str],
    moved: str | None,
    diagnostics: list[Diagnostic],
) -> Design | None:
    """Return the design with the model's defaults; a moving parameter is 1 until its path is read.

    Args:
        spec: the model.
        groups: the groups of `vary`.
        written: the settings under `params` and `start`.
        moved: the parameter that the run moves, or None.
        diagnostics: those of the job, to which errors are added.

    Returns:
        The design; None if its formulas have errors.
    """
    varied = {name for group in groups for name in group.axes}
    reported = {diagnostic.path[:2] for diagnostic in diagnostics}
    settings: dict[str, float | str] = {}
    for name, quantity in spec.quantities.items():
        if name in varied:
            continue
        path: FieldPath = ("params" if name in spec.parameters else "start", name)
        default = quantity.default
        if name in written:
            settings[name] = written[name]
            if name == moved:
                text = "is fixed, but run.parameter moves it: remove one of the two."
                diagnostics.append(Diagnostic(path, text))
        elif name == moved:
            settings[name] = 1.0
        elif default is not None:
            settings[name] = default_setting(default)
        elif path not in reported:
            text = f"is missing: {quantity.meaning} ({quantity.unit}) has no default."
            diagnostics.append(Diagnostic(path, f"{text} Set it here or under vary."))
            settings[name] = 1.0
    design = Design(spec.model, tuple(groups), settings, spec.sizes)
    wrong = check_names(design, spec)
    diagnostics.extend(wrong)
    return None if wrong else design


def default_setting(default: float | str) -> float | str:
    """Return a default as `read_settings` gives it: text if it uses names, else a number."""
    if isinstance(default, str):
        try:
            return default if names_used(default) else evaluate(default, {}) + 0.0
        except ExpressionError:  # which `check_ranges` reports
            return default
    return float(default) + 0.0  # -0.0 is 0.0, as in a job


def _scope(design: Design | None, spec: ModelSpec | None, moved: str | None) -> Scope:
    """Return the names for expressions under `run`, `numerics` and `figures`: parameters that stay fixed."""
    if design is None or spec is None:
        return Scope(known=False)
    fixed: dict[str, float] = dict(spec.sizes)
    moving = dict.fromkeys(design.names, "varies in this job")
    if moved is not None:
        moving[moved] = "moves in this run"
    for name in design.order:
        if name in moving or name not in spec.parameters:
            continue
        setting = design.settings[name]
        if any(used in moving for used in names_used(setting)):
            moving[name] = "depends on a parameter that varies or moves"
            continue
        try:
            fixed[name] = evaluate(setting, {used: fixed[used] for used in names_used(setting)})
        except ExpressionError:  # which `check_ranges` reports
            moving[name] = "has no value"
    return Scope(fixed, moving)


def _check_whole(design: Design, spec: ModelSpec, job: Job, numerics: ResolvedNumerics) -> list[Diagnostic]:
    """Check whether sections that are valid by themselves fit together; return the diagnostics."""
    run = job.run
    diagnostics: list[Diagnostic] = []
    for movement in run.movements:
        parameter = movement.parameter
        for name in (parameter, *design.following(parameter)):
            if name in spec.model.host_parameters:
                follows = "" if name == parameter else f", with which {name} moves"
                text = f"is {parameter}{follows}: {name} is compiled into the body of a row and cannot move "
                diagnostics.append(Diagnostic(movement.name_path, f"{text}while the row runs."))
    diagnostics += run.check(design, numerics.method)
    diagnostics += check_numerics(spec.model, job.numerics, numerics)
    diagnostics += _check_columns(design, run)
    diagnostics += check_ranges(design, spec, run)
    diagnostics += check_figures(dict(enumerate(job.figures)), job.style, design, run)
    return diagnostics


def _check_columns(design: Design, run: RunKind) -> list[Diagnostic]:
    """Return errors about names that two columns of the table would have."""
    columns = table_columns(design, run)
    repeated = dict.fromkeys(name for name in columns if columns.count(name) > 1)
    if isinstance(run, FollowsFixedPoints):  # whose branches have some observables by their own names
        used_names = {column.name for column in run.all_columns(design.model)} - run.beside_observables
        observables = [quantity.name for quantity in design.model.observables]
        repeated |= dict.fromkeys(name for name in observables if name in used_names)
    diagnostics = []
    # a moved parameter is reported at the run, an axis at its place in `vary`, other names at the model
    paths = {name: path for group in design.groups for name, path in group.paths.items()}
    moved = {movement.parameter: ".".join(map(str, movement.name_path)) for movement in run.movements}
    for name in repeated:
        reason = "has another column of this name: rename the model's quantity."
        if name == run.moved:
            diagnostics.append(Diagnostic(("run", "parameter"), f"is {name}, but the table {reason}"))
        elif name in paths and name in moved:
            diagnostics.append(
                Diagnostic(paths[name], f"varies, but {moved[name]} moves it: remove one of the two.")
            )
        elif name in paths:
            diagnostics.append(Diagnostic(paths[name], f"varies {name}, but the table {reason}"))
        else:
            text = f"is {design.model.name}, which has a quantity {name}, but the table of {run.kind_name} "
            diagnostics.append(Diagnostic(("model",), text + reason))
    return diagnostics
