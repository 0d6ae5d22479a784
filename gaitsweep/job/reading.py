"""Reading of a job: its sections in order, with all diagnostics collected, then its rows."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pydantic import BaseModel, ValidationError

from gaitsweep.design.design import Design
from gaitsweep.design.vary import Group, read_vary
from gaitsweep.engine.numerics import ResolvedNumerics
from gaitsweep.expression import ExpressionError, evaluate, names_in
from gaitsweep.job.checks import check_figures, check_names, check_ranges
from gaitsweep.job.config import Config
from gaitsweep.job.model_spec import ModelSpec, read_model_spec, read_settings
from gaitsweep.job.step_lengths import check_numerics, check_steps, suited_to_stiffness
from gaitsweep.kinds import parameter_written
from gaitsweep.kinds.fixed_points import FollowsFixedPoints
from gaitsweep.kinds.run_kind import RunKind, table_columns
from gaitsweep.schema.diagnostics import Diagnostic, JobError, SchemaSection, from_pydantic, quoted
from gaitsweep.schema.numbers import SCOPE, Scope

if TYPE_CHECKING:
    from gaitsweep.job.job import Job

# Fields of jobs that a command of the same name reads.
FITTING_FIELDS = ("search", "sensitivity")
# Fields that decide a row's values.
_DECIDING_VALUES = ("config", "model", "structure", "ground", "params", "start", "vary")
# Fields that are read here, so that pydantic gets their normal form.
_READ_HERE = ("params", "start", "vary", "structure", "ground")


def read_job(
    data: Any, folder: Path, handler: Callable[[Any], Job], sections: dict[str, SchemaSection]
) -> tuple[Job, Design, ResolvedNumerics]:
    """The job built by pydantic, its rows, and its numerics.

    Model, structure, params, start and vary come first, since expressions in the other parts use them.

    Args:
        data: the job's mapping as written.
        folder: the folder to which `config` is relative and which has the user's modules.
        handler: pydantic's validator of the whole mapping.
        sections: the parts of a job by the keys under which pydantic reports them.

    Raises:
        JobError: all errors in the job.
    """
    if not isinstance(data, Mapping):
        raise JobError([Diagnostic((), f"is {quoted(data)}, but a job must be a mapping (key: value).")])
    if others := [key for key in FITTING_FIELDS if data.get(key) is not None]:
        text = f"belongs to another command: run this job with `gaitsweep {others[0]}`."
        raise JobError([Diagnostic((others[0],), text)])
    config = Config({str(key): _plain(value) for key, value in data.items() if value is not None}, folder)
    raw = config.raw
    diagnostics = list(config.diagnostics)
    spec = None
    if "model" in raw:
        of_model = (raw["model"], raw.get("structure"), raw.get("params"))
        spec, wrong = read_model_spec(*of_model, [folder], raw.get("run"), raw.get("ground"))
        diagnostics.extend(wrong)
    fields = {key: value for key, value in raw.items() if key not in _READ_HERE}
    settings = {} if spec is None else _read_values(raw, spec, fields, diagnostics)
    moved = _moved(raw, spec)
    refusal = functools.partial(_refusal_to_vary, spec, settings, moved)
    vary = read_vary(raw.get("vary"), spec.quantities if spec else {}, refusal)
    fields["vary"] = vary.plain
    diagnostics.extend(vary.diagnostics)
    design = None
    if spec is not None and not vary.diagnostics:
        design = _design(spec, vary.groups, settings, moved, diagnostics)
    token = SCOPE.set(_scope(design, spec, moved))
    try:
        job = handler(fields)
        places = None
    except ValidationError as error:
        wrong = from_pydantic(error, sections, "")
        diagnostics.extend(wrong)
        job, places = _without(fields, wrong, handler)
    finally:
        SCOPE.reset(token)
    if job is None or design is None or spec is None:
        config.refuse(diagnostics)
    assert job is not None
    assert design is not None
    assert spec is not None
    diagnostics.extend(_unknown_movements(job.run, spec))
    if job.run.moved is not None and job.run.turns:  # a trace may lack its path, which its check reports
        first = {job.run.moved: job.run.turns[0]}
        design = dataclasses.replace(design, settings={**design.settings, **first})
    if diagnostics:
        config.refuse([*diagnostics, *_beside(diagnostics, design, spec, job, places)])
    numerics = job.numerics.resolve(spec.model, contraction=job.engine.contraction)
    config.refuse(_check_whole(design, spec, job, numerics))
    if job.numerics.method == "auto":
        numerics = suited_to_stiffness(design, job.run, numerics)
    config.refuse(check_steps(design, job.run, numerics))
    return job, design, numerics


def _read_values(
    raw: Mapping[str, Any], spec: ModelSpec, fields: dict[str, Any], diagnostics: list[Diagnostic]
) -> dict[str, float | str]:
    """The settings under `params` and `start` together; `fields` gets both sections and the structure."""
    fields["structure"] = spec.resolved_structure
    for section in ("params", "start"):
        fields[section], wrong = read_settings(raw.get(section), section, spec)
        diagnostics.extend(wrong)
    return {**fields["params"], **fields["start"]}


def _refusal_to_vary(
    spec: ModelSpec | None, settings: Mapping[str, float | str], moved: str | None, name: str
) -> str | None:
    """The reason why a name cannot vary in this job, or None."""
    if spec is None:
        return None
    if name in settings:
        section = "params" if name in spec.parameters else "start"
        return f"varies, but {section}.{name} fixes it: remove one of the two."
    if name == moved:
        return "varies, but run.parameter moves it: remove one of the two."
    return spec.unknown(name, "vary")


def _unknown_movements(run: RunKind, spec: ModelSpec) -> list[Diagnostic]:
    """Diagnostics about parameters that a run moves and the model does not have."""
    return [
        Diagnostic(movement.named, f"is {name}, which {spec.unknown(name, 'params') or ''}")
        for movement in run.movements
        if (name := movement.parameter) not in spec.parameters
    ]


def _beside(
    diagnostics: Sequence[Diagnostic], design: Design, spec: ModelSpec, job: Job, places: list[int] | None
) -> list[Diagnostic]:
    """Diagnostics that do not follow from those already found; `places` are those of the job's figures."""
    figures = dict(zip(range(len(job.figures)) if places is None else places, job.figures, strict=True))
    later = check_figures(figures, job.style, design, job.run)
    wrong_fields = {str(diagnostic.path[0]) if diagnostic.path else "" for diagnostic in diagnostics}
    if wrong_fields.isdisjoint(("", "run", *_DECIDING_VALUES)):
        later += check_ranges(design, spec, job.run)
    return later


def _without(
    fields: Mapping[str, Any], wrong: Sequence[Diagnostic], handler: Callable[[Any], Any]
) -> tuple[Any, list[int]]:
    """The job without the fields that pydantic refused, and the places of its figures.

    The job is None where it must have such a field.
    """
    refused = {diagnostic.path[:2] for diagnostic in wrong}
    figures = fields.get("figures")
    places = range(len(figures)) if isinstance(figures, list | tuple) else ()
    places = [place for place in places if ("figures", place) not in refused]
    names = {path[0] for path in refused if path[1:] == () or path[0] != "figures"}
    rest = {"name": "job", **{name: value for name, value in fields.items() if name not in names}}
    if figures is not None:
        rest["figures"] = [figures[place] for place in places]
    try:
        return handler(rest), places
    except ValidationError:
        return None, []


def _plain(value: Any) -> Any:
    """The fields of a model of pydantic, such as a run kind; other values unchanged."""
    return value.model_dump() if isinstance(value, BaseModel) else value


def _moved(raw: Mapping[str, Any], spec: ModelSpec | None) -> str | None:
    """The parameter that the run moves, if it is one of the model's."""
    name = parameter_written(raw.get("run"))
    return name if spec is not None and isinstance(name, str) and name in spec.parameters else None


def _design(
    spec: ModelSpec,
    groups: list[Group],
    written: Mapping[str, float | str],
    moved: str | None,
    diagnostics: list[Diagnostic],
) -> Design | None:
    """The design with the model's defaults; a moving parameter has the value 1 until its path is read.

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
    settings: dict[str, float | str] = {}
    for name, quantity in spec.quantities.items():
        field = "params" if name in spec.parameters else "start"
        if name in varied:
            continue
        if name == moved and name in written:
            text = "is fixed, but run.parameter moves it: remove one of the two."
            diagnostics.append(Diagnostic((field, name), text))
        if name in written:
            settings[name] = written[name]
        elif name == moved:
            settings[name] = 1.0
        elif quantity.default is not None:
            default = quantity.default
            settings[name] = default if isinstance(default, str) else float(default)
        elif (field, name) not in {diagnostic.path[:2] for diagnostic in diagnostics}:
            text = f"is missing: {quantity.meaning} ({quantity.unit}) has no default."
            diagnostics.append(Diagnostic((field, name), f"{text} Set it here or under vary."))
            settings[name] = 1.0
    named = {*varied, *written, moved}
    for name, (other, reason) in spec.model.given_with.items():
        if name in named and other not in named:
            paths = [group.paths[name] for group in groups if name in group.paths]
            text = f"is set without {other}: {reason}"
            diagnostics.append(Diagnostic(paths[0] if paths else ("params", name), text))
    design = Design(spec.model, tuple(groups), settings, spec.sizes)
    wrong = check_names(design, spec)
    diagnostics.extend(wrong)
    return None if wrong else design


def _scope(design: Design | None, spec: ModelSpec | None, moved: str | None) -> Scope:
    """Names for expressions under `run`, `numerics` and `figures`: the parameters that stay fixed."""
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
        if any(used in moving for used in names_in(setting)):
            moving[name] = "depends on a parameter that varies or moves"
            continue
        try:
            fixed[name] = evaluate(setting, {used: fixed[used] for used in names_in(setting)})
        except ExpressionError:  # which `check_ranges` reports
            moving[name] = "has no value"
    return Scope(fixed, moving)


def _check_whole(design: Design, spec: ModelSpec, job: Job, numerics: ResolvedNumerics) -> list[Diagnostic]:
    """Diagnostics about sections that are valid by themselves but do not fit together."""
    run = job.run
    diagnostics: list[Diagnostic] = []
    for movement in run.movements:
        parameter = movement.parameter
        for name in (parameter, *design.following(parameter)):
            if name in spec.model.host_parameters:
                moves = "" if name == parameter else f", with which {name} moves"
                text = f"is {parameter}{moves}: {name} is compiled into the body of a row"
                text += " and cannot move while the row runs."
                diagnostics.append(Diagnostic(movement.named, text))
    diagnostics += run.check(design, numerics.method)
    diagnostics += check_numerics(spec.model, job.numerics, numerics)
    diagnostics += _check_columns(design, run)
    diagnostics += check_ranges(design, spec, run)
    diagnostics += check_figures(dict(enumerate(job.figures)), job.style, design, run)
    return diagnostics


def _check_columns(design: Design, run: RunKind) -> list[Diagnostic]:
    """Diagnostics about names that two columns of the table would have."""
    columns = table_columns(design, run)
    repeated = dict.fromkeys(name for name in columns if columns.count(name) > 1)
    if isinstance(run, FollowsFixedPoints):  # whose branches have some observables by their own names
        disturbed = {column.name for column in run.all_columns(design.model)} - run.beside_observables
        repeated |= dict.fromkeys(q.name for q in design.model.observables if q.name in disturbed)
    places = {name: (path, "varies") for group in design.groups for name, path in group.paths.items()}
    if run.moved is not None:
        places[run.moved] = ("run", "parameter"), "is"
    diagnostics = [
        Diagnostic(
            path,
            f"{does} {name}, but the table has another column of this name: rename the model's quantity.",
        )
        for name, (path, does) in places.items()
        if name in repeated
    ]
    for name in repeated:
        if name not in places:
            text = f"is {design.model.name}, which has a quantity {name}, but the table of {run.kind_name}"
            text += " has another column of this name: rename the quantity."
            diagnostics.append(Diagnostic(("model",), text))
    return diagnostics
