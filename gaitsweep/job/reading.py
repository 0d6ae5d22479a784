"""Reading of a job: its sections in order, with all diagnostics collected, then its rows."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ValidationError

from gaitsweep.design.design import Design
from gaitsweep.design.vary import Group, read_vary
from gaitsweep.engine.numerics import ResolvedNumerics
from gaitsweep.expression import ExpressionError, evaluate, names_in
from gaitsweep.job.checks import check_figures, check_names, check_ranges
from gaitsweep.job.config import Config
from gaitsweep.job.model_spec import ModelSpec, read_model_spec, read_settings
from gaitsweep.job.step_lengths import check_numerics, check_steps
from gaitsweep.kinds import parameter_written
from gaitsweep.kinds.run_kind import RunKind, table_columns
from gaitsweep.schema.diagnostics import Diagnostic, JobError, SchemaSection, from_pydantic, quoted
from gaitsweep.schema.numbers import SCOPE, Scope

FITS = ("search", "sensitivity")  # fields of jobs that a command of the same name reads
_READ_HERE = ("params", "start", "vary", "structure")  # parts of a job that pydantic gets as they were read


def read_job(
    data: Any, folder: Path, handler: Callable[[Any], Any], sections: dict[str, SchemaSection]
) -> tuple[Any, Design, ResolvedNumerics]:
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
    if others := [key for key in FITS if data.get(key) is not None]:
        text = f"belongs to another command: run this job with `gaitsweep {others[0]}`."
        raise JobError([Diagnostic((others[0],), text)])
    config = Config({str(key): _plain(value) for key, value in data.items() if value is not None}, folder)
    raw, diagnostics = config.raw, list(config.diagnostics)
    ready = {key: value for key, value in raw.items() if key not in _READ_HERE}
    spec = None
    if "model" in raw:
        spec, wrong = read_model_spec(raw["model"], raw.get("structure"), raw.get("params"), [folder])
        diagnostics.extend(wrong)
    settings: dict[str, float | str] = {}
    if spec is not None:
        ready["structure"] = spec.resolved_structure
        for field in ("params", "start"):
            ready[field], wrong = read_settings(raw.get(field), field, spec)
            settings |= ready[field]
            diagnostics.extend(wrong)
    moved = _moved(raw, spec)

    def reason(name: str) -> str | None:
        if spec is None:
            return None
        if name in settings:
            field = "params" if name in spec.parameters else "start"
            return f"varies, but {field}.{name} fixes it: remove one of the two."
        if name == moved:
            return "varies, but run.parameter moves it: remove one of the two."
        return spec.unknown(name, "vary")

    vary = read_vary(raw.get("vary"), spec.quantities if spec else {}, reason)
    ready["vary"] = vary.plain
    diagnostics.extend(vary.diagnostics)
    design = None
    if spec is not None and not vary.diagnostics:
        design = _laid_out(spec, vary.groups, settings, moved, diagnostics)
    token = SCOPE.set(_scope(design, spec, moved))
    job = None
    try:
        job = handler(ready)
    except ValidationError as error:
        diagnostics.extend(from_pydantic(error, sections, ""))
    finally:
        SCOPE.reset(token)
    config.refuse(diagnostics)
    assert job is not None
    assert design is not None
    assert spec is not None
    for movement in job.run.movements:
        if movement.parameter not in spec.parameters:
            why = spec.unknown(movement.parameter, "params") or ""
            config.refuse([Diagnostic(movement.named, f"is {movement.parameter}, which {why}")])
    moving = job.run.moved
    if moving is not None:
        # a trace may lack it, which its check reports
        first = {moving: job.run.turns[0]} if job.run.turns else {}
        design = dataclasses.replace(design, settings={**design.settings, **first})
    numerics = job.numerics.resolve(spec.model, job.engine.contraction)
    config.refuse(_check_whole(design, spec, job, numerics))
    config.refuse(check_steps(design, job.run, numerics))
    return job, design, numerics


def _plain(value: Any) -> Any:
    return value.model_dump() if isinstance(value, BaseModel) else value


def _moved(raw: Mapping[str, Any], spec: ModelSpec | None) -> str | None:
    name = parameter_written(raw.get("run"))
    return name if spec is not None and isinstance(name, str) and name in spec.parameters else None


def _laid_out(
    spec: ModelSpec,
    groups: list[Group],
    given: Mapping[str, float | str],
    moved: str | None,
    diagnostics: list[Diagnostic],
) -> Design | None:
    """The design with the model's defaults; a moving parameter has the value 1 until its path is read."""
    varied = {name for group in groups for name in group.axes}
    settings: dict[str, float | str] = {}
    for name, quantity in spec.quantities.items():
        field = "params" if name in spec.parameters else "start"
        if name in varied:
            continue
        if name == moved and name in given:
            text = "is fixed, but run.parameter moves it: remove one of the two."
            diagnostics.append(Diagnostic((field, name), text))
        if name in given:
            settings[name] = given[name]
        elif name == moved:
            settings[name] = 1.0
        elif quantity.default is not None:
            settings[name] = (
                quantity.default if isinstance(quantity.default, str) else float(quantity.default)
            )
        elif (field, name) not in {diagnostic.path[:2] for diagnostic in diagnostics}:
            text = (
                f"is missing: {quantity.meaning} ({quantity.unit}) has no default. Set it here or under vary."
            )
            diagnostics.append(Diagnostic((field, name), text))
            settings[name] = 1.0
    for name, (other, why) in spec.model.given_with.items():
        if name in {*varied, *given, moved} and other not in {*varied, *given, moved}:
            paths = [group.paths[name] for group in groups if name in group.paths]
            text = f"is set without {other}: {why}"
            diagnostics.append(Diagnostic((*paths, ("params", name))[0], text))
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


def _check_whole(design: Design, spec: ModelSpec, job: Any, numerics: ResolvedNumerics) -> list[Diagnostic]:
    """Diagnostics about sections that are valid by themselves but do not fit together."""
    run: RunKind = job.run
    moving = run.moved
    diagnostics: list[Diagnostic] = []
    for movement in run.movements:
        parameter = movement.parameter
        for name in (parameter, *design.following(parameter)):
            if name in spec.model.host_parameters:
                moves = "" if name == parameter else f", with which {name} moves"
                text = f"is {parameter}{moves}: {name} is compiled into the body of a row"
                text += " and cannot move while the row runs."
                diagnostics.append(Diagnostic(movement.named, text))
    diagnostics.extend(run.check(design, numerics.method))
    diagnostics.extend(check_numerics(spec.model, job.numerics, numerics))
    columns = table_columns(design, run)
    places = [(name, path, "varies") for group in design.groups for name, path in group.paths.items()]
    if moving is not None:
        places.append((moving, ("run", "parameter"), "is"))
    for name, path, does in places:
        if columns.count(name) > 1:
            text = (
                f"{does} {name}, but the table has another column of this name: rename the model's quantity."
            )
            diagnostics.append(Diagnostic(path, text))
    named = {name for name, _, _ in places}
    for name in dict.fromkeys(name for name in columns if columns.count(name) > 1 and name not in named):
        text = f"is {spec.model.name}, which has a quantity {name}, but the table of {run.kind_name}"
        diagnostics.append(
            Diagnostic(("model",), f"{text} has another column of this name: rename the quantity.")
        )
    diagnostics.extend(check_ranges(design, spec, run))
    diagnostics.extend(check_figures(job.figures, design, run))
    return diagnostics
