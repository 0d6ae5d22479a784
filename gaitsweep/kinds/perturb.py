"""Run kind `perturb`: each row settles, is pushed once, and settles again."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar, Literal, cast

import numpy as np
import pandas as pd
from pydantic import Field

from gaitsweep import near_miss
from gaitsweep.contract import HybridModel, Model
from gaitsweep.design import Design
from gaitsweep.design.design import MAX_CHECKED, inside, requirement
from gaitsweep.design.vary import written_names
from gaitsweep.dynamics.declared_model import surfaces_of
from gaitsweep.engine.pushed_model import (
    CYCLES,
    DURATION,
    PREFIX,
    STATE,
    PushedModel,
    flow_places,
    state_quantities,
)
from gaitsweep.engine.recorders.perturb import MEASURED, PerturbRecorder, Stage
from gaitsweep.engine.solver.methods import METHODS
from gaitsweep.errors import ArgumentError
from gaitsweep.kinds.columns import (
    GAIT,
    OUTCOME,
    SLOWEST,
    STALLED_BY,
    STATUS,
    Column,
    ColumnValues,
    Records,
    changing,
    gaits,
    label_fields,
    observed_at_end,
)
from gaitsweep.kinds.run_kind import Cost
from gaitsweep.kinds.settle import SettlesRows, tolerance_field
from gaitsweep.schema.diagnostics import Diagnostic
from gaitsweep.schema.numbers import Flag, Positive, PositiveOrEach, Text
from gaitsweep.status import Status
from gaitsweep.table import TableError, load
from gaitsweep.table.frames import categorical
from gaitsweep.table.manifest import read_manifest

# Values of the column `recovery`, in the order of figures.
NOT_PUSHED = "not pushed"
RECOVERIES = ("recovered", "elsewhere", "fell", "failed", "not settled", NOT_PUSHED)

IN_MEMORY = "a table in memory"
MOST_ROWS = 10_000  # of an earlier table, whose numbers the job and the manifest hold


class Perturb(SettlesRows):
    """Settle each row, push it once, and settle it again, to see whether, when and how it recovers."""

    kind: Literal["perturb"] = Field(
        init=False, description="perturb: settle, push once, and simulate until the row has settled again"
    )
    push: list[Text] = Field(
        default=[],
        description="variables of the flow that are pushed; the amount by which NAME changes is the "
        "parameter push_NAME, under params or vary",
    )
    force: Flag = Field(
        default=False,
        description="whether the push is a constant force for push_duration s; by default it is at once",
    )
    step: Text | None = Field(
        default=None,
        description="parameter NAME of the model that is larger by push_NAME for push_cycles crossings",
    )
    at: Text | None = Field(
        default=None,
        description="event just after which the push comes; by default at push_phase, a share of the gait's "
        "period after a section crossing",
    )
    within: Positive = Field(
        default=0.01,
        description="largest distance from its gait at which a row is back: of angles in rad, of other "
        "observables as a fraction of their size",
    )
    tolerance: PositiveOrEach = tolerance_field("row", 1e-6)
    after: Text | None = Field(
        default=None,
        description="result directory of a run of kind settle with `states`, relative to the job's folder, "
        "whose settled rows are pushed, with their parameters, instead of rows that settle from start values",
    )

    unhashed: ClassVar[tuple[str, ...]] = ("after",)  # the rows of the table become part of the job
    figures: ClassVar[tuple[str, ...]] = ("basin",)

    @classmethod
    def model_of(cls, model: Model, written: Mapping[str, Any]) -> tuple[Model, list[Diagnostic]]:
        if not (isinstance(model, HybridModel) and model.locates_events):
            text = f"is perturb, which pushes variables of a flow, but {model.name} moves in steps."
            return model, [Diagnostic(("run", "kind"), text)]
        wrong: list[Diagnostic] = []

        def known(path: tuple[str | int, ...], name: Any, noun: str, names: list[str]) -> str | None:
            """The name if it is one of `names`; else None, and a diagnostic of a text."""
            if not isinstance(name, str):
                return None
            if name not in names:
                text = f"is {name}, which is not {noun} of {model.name}{near_miss.suggestion(name, names)}"
                wrong.append(Diagnostic(path, text))
                return None
            return name

        push = written.get("push")
        variables = list(flow_places(model))
        pushed = [
            known(("run", "push", k), name, "a variable of the flow", variables)
            for k, name in enumerate(push if isinstance(push, list | tuple) else ())
        ]
        parameters = [q.name for q in model.parameters]
        stepped = known(("run", "step"), written.get("step"), "a parameter", parameters)
        event = known(("run", "at"), written.get("at"), "an event", list(dict.fromkeys(model.guard_names)))
        chosen = dict.fromkeys(name for name in pushed if name is not None)
        resumes = isinstance(written.get("after"), str | pd.DataFrame)
        extended = PushedModel(model, tuple(chosen), written.get("force") is True, stepped, event, resumes)
        of_model = {q.name for q in (*model.parameters, *model.initial_conditions)}
        added = [q.name for q in (*extended.added, *(extended.initial_conditions if resumes else ()))]
        for name in dict.fromkeys(added):
            text = None
            if name in of_model:
                text = f"a quantity {name}, but {model.name} has another one of this name: rename that."
            elif added.count(name) > 1:
                pushed_name = name.removeprefix(PREFIX)
                text = f"two quantities {name}, one of them for {pushed_name} of {model.name}: rename that."
            if text is not None:
                wrong.append(Diagnostic(("run", "kind"), f"is perturb, which adds {text}"))
        clash = any(diagnostic.path == ("run", "kind") for diagnostic in wrong)
        return (model if clash else extended), wrong

    @classmethod
    def filled(
        cls, fields: Mapping[str, Any], model: Model, folder: Path
    ) -> tuple[dict[str, Any], list[Diagnostic]]:
        """The fields with the settled rows of the table `after` as the first group of `vary`.

        A job that has them already, as that of a result directory, is returned as it is.
        """
        vary = {} if fields.get("vary") is None else fields["vary"]
        written = [name for names in written_names(vary) for name in names]
        start = fields.get("start")
        written += map(str, start) if isinstance(start, Mapping) else ()
        if not (isinstance(model, PushedModel) and model.resumes and isinstance(vary, Mapping)):
            return dict(fields), []
        if any(q.name in written for q in model.initial_conditions):
            return dict(fields), []
        after = fields["run"]["after"]
        path = after.attrs.get("path", IN_MEMORY) if isinstance(after, pd.DataFrame) else after
        try:
            table = after if isinstance(after, pd.DataFrame) else _loaded(folder / after)
            constants, rows = _settled_rows(table, str(fields.get("model")), model.model)
        except (ArgumentError, TableError) as error:
            return dict(fields), [Diagnostic(("run", "after"), f"is {path}: {error}")]
        params = fields["params"] if isinstance(fields.get("params"), Mapping) else {}
        advice = f"but {path} has its values: remove it here."
        wrong = [
            Diagnostic(("params", str(name)), f"is {value}, {advice}")
            for name, value in params.items()
            if name in rows or constants.get(name, value) != value
        ]
        wrong += [
            Diagnostic(("vary",), f"varies {name}, {advice}")
            for name in written
            if name in {**rows, **constants}
        ]
        if wrong:
            return dict(fields), wrong
        zipped = vary.get("zip", [])
        others = {key: axis for key, axis in vary.items() if key != "zip"}
        filled = {
            "run": {**fields["run"], "after": path},
            "params": {**constants, **params},
            "vary": {"zip": [rows, *(zipped if isinstance(zipped, list) else [zipped])], **others},
        }
        return {**fields, **filled}, []

    def recorder(self, model: Model) -> PerturbRecorder:
        # where the model was refused, a recorder of it only names its columns
        return PerturbRecorder(cast(PushedModel, model), self.settling(model), self.within)

    def columns(self, model: Model) -> list[Column]:
        return [
            Column("recovery", _recovery),
            STATUS,
            *changing(*MEASURED),
            Column("cycles"),
            *changing("t_end"),
            SLOWEST,
            STALLED_BY,
            *observed_at_end(model),
            GAIT,
            Column("gait_before", lambda records: gaits(model, records.label("gait_before", -1))),
            OUTCOME,
            Column("attractor_period", lambda records: records["period"]),
            *label_fields(model),
        ]

    def check(self, rows: Design, method: str) -> list[Diagnostic]:
        if not isinstance(rows.model, PushedModel):
            return []
        wrong = self.check_settling(rows.model)
        if not self.push and self.step is None:
            text = "is missing: name a variable that is pushed, or a parameter as run.step."
            wrong.append(Diagnostic(("run", "push"), text))
        for k, name in enumerate(self.push):
            if name in self.push[:k]:
                wrong.append(Diagnostic(("run", "push", k), f"is {name}, which is named twice."))
        if self.force and not self.push:
            wrong.append(Diagnostic(("run", "force"), "has no effect without run.push: remove it."))
        if self.force and (surfaces := surfaces_of(rows.model.model)):
            text = (
                f"is true, but a state that slides along the surface of {next(iter(surfaces))} does not feel "
                "the force: add it to flow, as a parameter."
            )
            wrong.append(Diagnostic(("run", "force"), text))
        if self.force and self.step is not None:
            text = f"is {self.step}, which lasts for {CYCLES}, but the force of run.push for {DURATION}: "
            wrong.append(Diagnostic(("run", "step"), f"{text}use one run for each, or a push at once."))
        if METHODS[method].step is None:
            text = f"is {method}, whose steps have a fixed length, but a push needs located events."
            wrong.append(Diagnostic(("numerics", "method"), text))
        return wrong if wrong or self.step is None else self._check_step(rows, self.step)

    def _check_step(self, rows: Design, stepped: str) -> list[Diagnostic]:
        """Diagnostics about a parameter's step: whether it can move alone, and its values."""
        model = rows.model
        if stepped in model.host_parameters:
            text = f"is {stepped}, which is compiled into the body of a row and cannot move while it runs."
            return [Diagnostic(("run", "step"), text)]
        if following := rows.following(stepped):
            name, formula = next(iter(following.items()))
            text = f"is {stepped}, but {name} = {formula} follows it: give {name} as a number under params."
            return [Diagnostic(("run", "step"), text)]
        amount = f"{PREFIX}{stepped}"
        checked_rows, _ = rows.combinations([stepped, amount], MAX_CHECKED)
        values = rows.at(checked_rows, [stepped, amount])
        reached = values[stepped] + values[amount]
        quantity = next(q for q in model.parameters if q.name == stepped)
        outside = np.flatnonzero(~inside(reached, quantity))
        if outside.size:
            text = f"makes {stepped} {reached[outside[0]]:g} in row {checked_rows[outside[0]]}, but it "
            paths = (group.paths[amount] for group in rows.groups if amount in group.paths)
            path = next(paths, ("params", amount))
            return [Diagnostic(path, f"{text}{requirement(quantity)}.")]
        return []

    def cost(self, rows: Design, cycle: float, period: float) -> Cost:
        likely, most = self.likely_cycles(period)
        return Cost(2.0 * likely * cycle, 2.0 * most * cycle)


def _loaded(path: Path) -> pd.DataFrame:
    """The table of a result directory, which has to be complete."""
    if not read_manifest(path).get("complete"):
        raise TableError("it is not complete: run its job first.")
    return load(path)


def _settled_rows(
    table: pd.DataFrame, name: str, model: HybridModel
) -> tuple[dict[str, float | str], dict[str, list[float]]]:
    """The constants and the varied parameters with the states of the settled rows of an earlier table.

    Args:
        table: the table, with its `.attrs`.
        name: the name of the model in the job.
        model: the model.

    Raises:
        ArgumentError: the table has no states, is joined of several, or is that of another model.
    """
    if "joined" in table.attrs:  # whose rows differ in constants that its job has not
        raise ArgumentError("it is joined of several results by gs.concat: use one of the results.")
    job = table.attrs.get("job", {})
    if job.get("run", {}).get("kind") != "settle" or not job["run"].get("states"):
        raise ArgumentError("it has no states of its rows: run its job as {kind: settle, states: true}.")
    if job["model"] != name:
        raise ArgumentError(f"its model is {job['model']}, but that of this job is {name}.")
    for field in dataclasses.fields(model):  # pyright: ignore[reportArgumentType]
        before, now = job["structure"].get(field.name, field.default), getattr(model, field.name)
        if field.init and before != now:
            raise ArgumentError(f"its structure.{field.name} is {before}, but that of this job is {now}.")
    parameters = {q.name: q.default for q in model.parameters}
    varied = [axis for axes in written_names(job["vary"]) for axis in axes]
    known = {*parameters, *(q.name for q in model.initial_conditions)}
    if other := [axis for axis in (*job["params"], *varied) if axis not in known]:
        raise ArgumentError(f"it has a parameter {other[0]}, which {model.name} lacks: run its job again.")
    if lacking := [q for q in parameters if q not in job["params"] and q not in varied]:
        raise ArgumentError(f"it lacks the parameter {lacking[0]} of {model.name}: run its job again.")
    states = [quantity.name for quantity in state_quantities(model)]
    columns = [*(axis for axis in varied if axis in parameters), *states]
    if lacking := [column for column in columns if column not in table]:
        raise ArgumentError(f"it lacks the column {lacking[0]} of {model.name}: run its job again.")
    if other := [column for column in table if str(column).startswith(STATE) and column not in columns]:
        raise ArgumentError(f"it has a column {other[0]}, which {model.name} lacks: run its job again.")
    settled = table.loc[table["status"].astype(str) == Status.settled.name, columns]
    if not 0 < len(settled) <= MOST_ROWS:
        text = f"it has {len(settled)} settled rows, but must have from 1 to {MOST_ROWS}"
        raise ArgumentError(f"{text}, since they become part of the job.")
    return job["params"], {str(column): settled[column].astype(float).tolist() for column in columns}


def _recovery(records: Records) -> ColumnValues:
    """Whether each row recovered from its push, or why not."""
    status, stage = records.block.status, records["stage"]
    fell, failed = status == Status.fell, Status.FAILED.among(status)
    cases = [stage < Stage.ACTS, fell, failed, records["recovered"] == 1, Status.SOUND.among(status)]
    names = [NOT_PUSHED, "fell", "failed", "recovered", "elsewhere"]
    codes = np.select(cases, [RECOVERIES.index(name) for name in names], RECOVERIES.index("not settled"))
    return categorical(codes, list(RECOVERIES))
