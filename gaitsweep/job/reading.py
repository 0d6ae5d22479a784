"""How a job is read: each part in its turn, all diagnostics gathered, then its rows laid out and checked."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ValidationError

from gaitsweep.expression import ExpressionError, evaluate, names_in
from gaitsweep.job.checks import check_names, check_ranges
from gaitsweep.job.config import Config
from gaitsweep.job.figures import check_figures
from gaitsweep.job.model_spec import ModelSpec, read_model_spec, read_settings
from gaitsweep.job.numerics import Numerics
from gaitsweep.job.plan import Plan
from gaitsweep.job.steps import check_numerics, check_steps
from gaitsweep.job.vary import Vary, read_vary
from gaitsweep.kinds import RunKind, parameter_written
from gaitsweep.kinds.diagnostics import Diagnostic, JobError, Owner, found, from_pydantic
from gaitsweep.kinds.numbers import SCOPE, Scope
from gaitsweep.kinds.run_kind import table_columns
from gaitsweep.plot.figure_kind import FigureKind


@dataclasses.dataclass
class Reading:
    """What was read of a job before its `run`, `numerics`, `engine` and `figures`."""

    raw: dict[str, Any]
    config: Config
    spec: ModelSpec | None
    vary: Vary
    settings: dict[str, float | str]
    diagnostics: list[Diagnostic]
    moved: str | None
    plan: Plan | None = None

    def refuse(self, diagnostics: list[Diagnostic]) -> None:
        """Raise JobError if there is anything to complain about."""
        if diagnostics:
            raise JobError([self.config.locate(diagnostic) for diagnostic in diagnostics])


def read_parts(data: Any, folder: Path) -> Reading:
    """The model, structure, params, start and vary of a job.

    Args:
        data: the job's mapping as written.
        folder: the folder to which `config` is relative and where the user's own modules are.

    Raises:
        JobError: data that is not a mapping; other diagnostics are gathered in the result.
    """
    if not isinstance(data, Mapping):
        raise JobError([Diagnostic((), f"holds {found(data)}, but a job is a mapping (key: value).")])
    given = {str(key): _plain(value) for key, value in data.items() if value is not None}
    config = Config(given, folder)
    raw = config.raw
    diagnostics = list(config.diagnostics)
    spec = None
    if "model" in raw:
        spec, wrong = read_model_spec(raw["model"], raw.get("structure"), raw.get("params"), [folder])
        diagnostics.extend(wrong)
    settings: dict[str, float | str] = {}
    if spec is not None:
        for field in ("params", "start"):
            read, wrong = read_settings(raw.get(field), field, spec)
            settings |= read
            diagnostics.extend(wrong)
    moved = _moved(raw, spec)
    written = dict(settings)

    def reason(name: str) -> str | None:
        if spec is None:
            return None
        if name in written:
            field = "params" if name in spec.parameters else "start"
            return f"varies, but {field}.{name} fixes it: take one of the two out."
        if name == moved:
            return "varies, but run.parameter moves it: take one of the two out."
        return spec.unknown(name, "vary")

    vary = read_vary(raw.get("vary"), spec.quantities if spec else {}, reason)
    diagnostics.extend(vary.diagnostics)
    reading = Reading(raw, config, spec, vary, settings, diagnostics, moved)
    if spec is not None and not vary.diagnostics:
        _lay_out(reading, spec)
    return reading


def _plain(value: Any) -> Any:
    return value.model_dump() if isinstance(value, BaseModel) else value


def _moved(raw: Mapping[str, Any], spec: ModelSpec | None) -> str | None:
    """The parameter that the run moves, where there is one."""
    name = parameter_written(raw.get("run"))
    return name if spec is not None and isinstance(name, str) and name in spec.parameters else None


def _lay_out(reading: Reading, spec: ModelSpec) -> None:
    """The plan, with the model's defaults; a parameter that moves has 1 until its path is read."""
    varied = {name for group in reading.vary.groups for name in group.points}
    settings: dict[str, float | str] = {}
    for name, quantity in spec.quantities.items():
        field = "params" if name in spec.parameters else "start"
        if name in varied:
            continue
        if name == reading.moved and name in reading.settings:
            text = "is fixed, but run.parameter moves it: take one of the two out."
            reading.diagnostics.append(Diagnostic((field, name), text))
        if name in reading.settings:
            settings[name] = reading.settings[name]
        elif name == reading.moved:
            settings[name] = 1.0
        elif quantity.default is not None:
            settings[name] = (
                quantity.default if isinstance(quantity.default, str) else float(quantity.default)
            )
        elif (field, name) not in {diagnostic.path[:2] for diagnostic in reading.diagnostics}:
            text = (
                f"is missing: {quantity.meaning} ({quantity.unit}) has no default; set it here or under vary."
            )
            reading.diagnostics.append(Diagnostic((field, name), text))
            settings[name] = 1.0
    plan = Plan(spec.model, tuple(reading.vary.groups), settings, spec.sizes)
    wrong = check_names(plan, spec)
    reading.diagnostics.extend(wrong)
    if not wrong:
        reading.plan = plan


def scope_of(reading: Reading) -> Scope:
    """What expressions under `run`, `numerics` and `figures` may use: the parameters that stay fixed."""
    plan, spec = reading.plan, reading.spec
    if plan is None or spec is None:
        return Scope(known=False)
    fixed: dict[str, float] = dict(spec.sizes)
    moving = dict.fromkeys(plan.names, "varies in this job")
    if reading.moved is not None:
        moving[reading.moved] = "moves in this run"
    for name in plan.order:
        if name in moving or name not in spec.parameters:
            continue
        setting = plan.settings[name]
        if any(used in moving for used in names_in(setting)):
            moving[name] = "follows what has no one value in this job"
            continue
        try:
            fixed[name] = evaluate(setting, {used: fixed[used] for used in names_in(setting)})
        except ExpressionError:  # `check_ranges` says so
            moving[name] = "has no value"
    return Scope(fixed, moving)


def read_rest(reading: Reading, handler: Callable[[Any], Any], owners: dict[str, Owner]) -> Any:
    """The job as pydantic makes it, after the parts that `read_parts` read.

    Raises:
        JobError: everything that is wrong with the job, these parts included.
    """
    ready = {
        key: value
        for key, value in reading.raw.items()
        if key not in ("params", "start", "vary", "structure")
    }
    if reading.spec is not None:
        parameters = reading.spec.parameters
        ready["structure"] = reading.spec.structure
        ready["params"] = {name: value for name, value in reading.settings.items() if name in parameters}
        ready["start"] = {name: value for name, value in reading.settings.items() if name not in parameters}
    ready["vary"] = reading.vary.plain
    token = SCOPE.set(scope_of(reading))
    job = None
    try:
        job = handler(ready)
    except ValidationError as error:
        reading.diagnostics.extend(from_pydantic(error, owners, ""))
    finally:
        SCOPE.reset(token)
    reading.refuse(reading.diagnostics)
    return job


def finish(reading: Reading, run: RunKind, numerics: Numerics, figures: list[FigureKind]) -> Plan:
    """The plan of a job whose parts are all well formed, checked as a whole.

    Raises:
        JobError: values out of range, a run that does not fit its model, figures that name what is not there.
    """
    plan, spec = reading.plan, reading.spec
    assert plan is not None
    assert spec is not None
    diagnostics: list[Diagnostic] = []
    moving = run.moved
    if moving is not None:
        if moving not in spec.parameters:
            reason = spec.unknown(moving, "params") or ""
            reading.refuse([Diagnostic(("run", "parameter"), f"is {moving}, which {reason}")])
        first = {moving: run.turns[0]} if run.turns else {}  # a trace may lack it, which its check says
        plan = dataclasses.replace(plan, settings={**plan.settings, **first})
        for name in (moving, *plan.following(moving)):
            if name not in spec.model.host_parameters:
                continue
            moves = "" if name == moving else f", with which {name} moves"
            text = f"is {moving}{moves}: {name} is compiled into a row's body"
            text += " and cannot move while it runs."
            diagnostics.append(Diagnostic(("run", "parameter"), text))
    diagnostics.extend(run.check(plan, numerics.engine(spec.model).method))
    diagnostics.extend(check_numerics(spec.model, numerics))
    columns = table_columns(plan, run)
    for group in plan.groups:
        for name, path in group.paths.items():
            if columns.count(name) > 1:
                text = f"varies {name}, but the table has a column of that name: rename the model's quantity."
                diagnostics.append(Diagnostic(path, text))
    if moving is not None and columns.count(moving) > 1:
        text = f"is {moving}, but the table has a column of that name: rename the model's quantity."
        diagnostics.append(Diagnostic(("run", "parameter"), text))
    diagnostics.extend(check_ranges(plan, spec, run))
    diagnostics.extend(check_figures(figures, plan, run))
    reading.refuse(diagnostics)
    reading.refuse(check_steps(plan, run, numerics.engine(spec.model)))
    return plan
