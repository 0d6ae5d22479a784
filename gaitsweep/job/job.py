"""Job: its fields, its resolved form, and its JSON schema."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import math
from collections.abc import Mapping, Sequence, Set
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import (
    BeforeValidator,
    Field,
    ModelWrapValidatorHandler,
    PlainValidator,
    PrivateAttr,
    ValidationError,
    ValidationInfo,
    WithJsonSchema,
    model_validator,
)

from gaitsweep import near_miss
from gaitsweep.design.design import Design
from gaitsweep.design.vary import vary_schema
from gaitsweep.dynamics.ground import KINDS
from gaitsweep.engine.numerics import ResolvedNumerics
from gaitsweep.engine.sweep.blocks_of_rows import rows_of_a_block
from gaitsweep.errors import JobError
from gaitsweep.expression import names_used
from gaitsweep.job.numerics import EngineChoice, NumericsSpec
from gaitsweep.job.reading import read_job
from gaitsweep.kinds import RUN_KINDS, RunKind
from gaitsweep.plot.figure_style import STYLE_FIELDS, FigureStyle
from gaitsweep.plot.kind import FIGURES, FigureKind
from gaitsweep.schema.diagnostics import Diagnostic
from gaitsweep.schema.numbers import Stem, Text, VerifyCount
from gaitsweep.schema.strict_model import OneOf, SchemaSection, StrictModel, from_pydantic

_KINDS = list(RUN_KINDS)
# no check, since `Config` has read or refused the path before pydantic sees it
_PATH = PlainValidator(lambda path: path)
_SETTINGS = WithJsonSchema(
    {"type": "object", "additionalProperties": {"type": ["integer", "number", "string", "boolean"]}}
)
# `numerics: auto` is short for all of its fields left out
_NUMERICS = BeforeValidator(lambda value: {} if value == "auto" else value)
# short for a field of the structure, where the reading puts it
_GROUND = {
    "anyOf": [
        {"enum": list(KINDS)},
        {
            "type": "object",
            "properties": {"file": {"type": "string", "description": "CSV file of places and heights, in m"}},
            "required": ["file"],
            "additionalProperties": False,
        },
    ]
}
_HASHED_FORM = 4  # raised when the meaning of a resolved job changes, so that no old directory is resumed


class Job(StrictModel):
    """A parameter sweep: a model, the axes that vary, the run of each row, and the figures.

    Build it with `load_job`, or in Python from its fields: `Job(name="quick", model="mine:Hopper",
    vary={...}, run={"kind": "settle"})`. `params` and `start` have the values that are set, formulas as text;
    all other numeric fields are numbers. Raises JobError with a message for each error.
    """

    name: Stem = Field(description="name of the job and of its result directory")
    model: Text = Field(description="name of a registered model, or package.module:attribute of your own")
    structure: Annotated[dict[str, Any], _SETTINGS] = Field(
        default_factory=dict,
        description="fields that decide the size of the model, such as N; each value needs its own job",
    )
    ground: Annotated[None, WithJsonSchema(_GROUND)] = Field(
        default=None,
        description="ground of a model that asks for its height (params.ground): slope, steps, rough, or a "
        "profile as {file: PATH}; its parameters, such as ground_seed, are set under params or vary",
    )
    config: Annotated[str | Path | None, _PATH, WithJsonSchema({"type": "string"})] = Field(
        default=None,
        description="path of a YAML file with model, structure and params, relative to the job's folder; or "
        "builtin:NAME for one that comes with gaitsweep",
    )
    params: Annotated[dict[str, float | str], _SETTINGS] = Field(
        default_factory=dict, description="fixed parameters, by name"
    )
    start: Annotated[dict[str, float | str], _SETTINGS] = Field(
        default_factory=dict, description="fixed start values, by name"
    )
    vary: Annotated[dict[str, Any], WithJsonSchema(vary_schema())] = Field(
        default_factory=dict,
        description="axes by name, and groups of axes under zip and sample; all combinations run, and the "
        "last axis varies fastest",
    )
    run: Annotated[RunKind, OneOf(RUN_KINDS)] = Field(
        description=f"task of each row (kind: {', '.join(_KINDS[:-1])} or {_KINDS[-1]})"
    )
    numerics: Annotated[NumericsSpec, _NUMERICS] = Field(
        default_factory=NumericsSpec,
        description="integration of trajectories; fields that are auto or left out follow the model's "
        "recommendation",
    )
    engine: EngineChoice = Field(
        default_factory=EngineChoice, description="engine and devices that compute the rows"
    )
    verify: VerifyCount = Field(
        default=32,
        description="number of rows that the self-check reruns after the run, once unchanged and once with "
        "finer steps, to see whether the table depends on the steps; 0: no self-check. By default 32, "
        "or fewer in a small run",
    )
    figures: list[Annotated[FigureKind, OneOf(FIGURES)]] = Field(
        default_factory=list, max_length=200, description="figures to draw from the table"
    )
    style: FigureStyle = Field(
        default_factory=FigureStyle,
        description="size, files, colours and labels of all figures; a figure's own fields take precedence",
    )

    if TYPE_CHECKING:

        def __init__(  # type checkers would expect the types of the fields, not of accepted values
            self,
            *,
            name: str,
            model: str,
            structure: Mapping[str, Any] = ...,
            ground: str | Mapping[str, str] | None = ...,
            config: str | Path | None = ...,
            params: Mapping[str, Any] = ...,
            start: Mapping[str, Any] = ...,
            vary: Mapping[str, Any] = ...,
            run: RunKind | Mapping[str, Any],
            numerics: NumericsSpec | Mapping[str, Any] | Literal["auto"] = ...,
            engine: EngineChoice | Mapping[str, Any] = ...,
            verify: int = ...,
            figures: Sequence[FigureKind | Mapping[str, Any]] = ...,
            style: FigureStyle | Mapping[str, Any] = ...,
        ) -> None: ...

    _design: Design = PrivateAttr()
    _integration: ResolvedNumerics = PrivateAttr()
    _evaluated: Mapping[str, Set[str]] = PrivateAttr()
    _folder: Path = PrivateAttr()

    @model_validator(mode="wrap")
    @classmethod
    def _read(cls, data: Any, handler: ModelWrapValidatorHandler[Job], info: ValidationInfo) -> Job:
        """Read a job from its mapping; jobs are returned unchanged."""
        if isinstance(data, Job):
            return data
        with near_miss.limited_effort():
            folder = (info.context or {}).get("folder", Path.cwd())
            job, job._design, job._integration, job._evaluated = read_job(
                data, folder, handler, _sections(data)
            )
            job._folder = Path(folder).absolute()
        return job

    def model_copy(self, *, update: Mapping[str, Any] | None = None, deep: bool = False) -> Job:
        """Return the job with other values of some fields, read anew, so that rows and numerics follow them.

        Args:
            update: the values by field.
            deep: without effect, since all parts of a job are frozen.

        Raises:
            JobError: all errors in the new values.
        """
        update = update or {}
        fields = {name: getattr(self, name) for name in self.model_fields_set}
        job = Job.model_validate({**fields, **update}, context={"folder": self._folder})
        # the numbers of all other fields still come from these expressions
        others = {name: texts for name, texts in self._evaluated.items() if name not in update}
        job._evaluated = {**job._evaluated, **others}
        return job

    @property
    def design(self) -> Design:
        """Rows of the job."""
        return self._design

    @property
    def integration(self) -> ResolvedNumerics:
        """Numerics of its rows, with the model's recommendations filled in."""
        return self._integration

    @property
    def folder(self) -> Path:
        """Folder to which paths in the job are relative."""
        return self._folder

    def expressions_of(self, *names: str) -> list[str]:
        """Return the expressions outside `params`, `start` and `vary` whose value depends on some parameters.

        Their fields have one number for all rows, which the job's own values of these parameters gave.
        """
        sizes = set(self._design.sizes)
        return [
            expression
            for expression in sorted(set().union(*self._evaluated.values()))
            if not self._design.closure(names_used(expression) - sizes).isdisjoint(names)
        ]

    @property
    def block(self) -> int:
        """Number of rows in a part of the table."""
        return rows_of_a_block(self.engine.block, self._design.n_rows)

    def resolved(self, engine: str | None = None) -> dict[str, Any]:
        """Return the job as plain values, with the model's defaults and the config filled in.

        Loading the result gives the same job. Formulas stay formulas, since they may depend on axes; starts
        that the model decides itself, and the parameter of a ramp or staircase, are left out.

        Args:
            engine: the engine that runs, if the job leaves the choice open.
        """
        dumped = self.model_dump(mode="json", exclude={"config", "ground", "params", "start"})
        moving = self.run.moved
        settings = {
            name: setting
            for name, setting in self._design.settings.items()
            if name != moving and not (isinstance(setting, float) and math.isnan(setting))
        }
        parameters = {quantity.name for quantity in self._design.model.parameters}
        dumped["params"] = {name: setting for name, setting in settings.items() if name in parameters}
        dumped["start"] = {name: setting for name, setting in settings.items() if name not in parameters}
        dumped["engine"] |= {"name": engine or self.engine.name, "block": self.block}
        dumped["numerics"] |= {"method": self.integration.method}
        if self.integration.adaptive:
            dumped["numerics"] |= {"rtol": self.integration.rtol, "atol": self.integration.atol}
        else:
            del dumped["numerics"]["rtol"], dumped["numerics"]["atol"]
        dumped["figures"] = [_without_style(figure) for figure in dumped["figures"]]
        dumped["style"] = _without_style(dumped["style"])
        if not dumped["style"]:
            del dumped["style"]
        return {name: dumped[name] for name in type(self).model_fields if name in dumped}

    def hash(
        self,
        *,
        device: str = "cpu",
        engine: str | None = None,
        lanes: int | None = None,
        steps: str | None = None,
    ) -> str:
        """Return the sha256, in hex, of all that decides the job's numbers, which name and figures do not.

        The order of `vary` counts, since it decides the order of rows and columns; no other order counts.

        Args:
            device: class of the device, such as "cpu" or "gpu".
            engine: the engine that runs, if the job leaves the choice open.
            lanes: the lanes that the engine chose, if the job leaves them open.
            steps: digest of the steps that the model recommends, if the job leaves them open.
        """
        runs_on = {
            "name": engine if engine is not None else self.engine.name,
            "lanes": lanes if lanes is not None else self.engine.lanes,
            "block": self.block,
            "device": device,
        }
        if not self.engine.contraction:  # left out by default, so that hashes of older jobs stay valid
            runs_on["contraction"] = False
        resolved = self.resolved()
        deciding = {key: resolved[key] for key in ("model", "structure", "params", "start", "numerics")}
        deciding |= {"vary": _in_order(resolved["vary"]), "run": self.run.hashed(resolved["run"])}
        deciding |= {"engine": runs_on, "form": _HASHED_FORM}
        if steps is not None:
            deciding["steps"] = steps
        text = json.dumps(deciding, sort_keys=True, separators=(",", ":"), allow_nan=False)
        return hashlib.sha256(text.encode()).hexdigest()


def _without_style(fields: dict[str, Any]) -> dict[str, Any]:
    """Return the fields of a figure or a style without those of a style that are left open."""
    return {key: value for key, value in fields.items() if key not in STYLE_FIELDS or value is not None}


def _in_order(vary: dict[str, Any]) -> list[Any]:
    """Return `vary` with its names in lists, so that the hash depends on their order."""
    ordered: list[Any] = []
    for name, value in vary.items():
        groups = value if isinstance(value, list) else [value]
        if name == "zip":
            ordered.append([name, [list(group.items()) for group in groups]])
        elif name == "sample":
            ordered.append([name, [[*group.items(), list(group["of"].items())] for group in groups]])
        else:
            ordered.append([name, value])
    return ordered


def _sections(data: Any) -> dict[str, SchemaSection]:
    """Return the sections of a job by the keys under which pydantic reports them."""
    runs = {kind: SchemaSection(f"run ({kind})", run, "run") for kind, run in RUN_KINDS.items()}
    # kinds of figures take long to import, and are needed for figures alone, or for their fields in `style`
    in_style = data.get("style") if isinstance(data, Mapping) else None
    has_others = isinstance(in_style, Mapping) and not set(in_style) <= set(STYLE_FIELDS)
    has_figures = isinstance(data, Mapping) and bool(data.get("figures"))
    figure_kinds = FIGURES if has_figures or has_others else {}
    # a figure's kind may be a run's too (return_map), hence the prefix
    figures = {
        f"figures.{kind}": SchemaSection(f"a figure ({kind})", figure, "figures")
        for kind, figure in figure_kinds.items()
    }
    others = {
        "": SchemaSection("a job", Job),
        "numerics": SchemaSection("numerics", NumericsSpec),
        "style": SchemaSection("a style", FigureStyle),
    }
    return {**others, **runs, "engine": SchemaSection("engine", EngineChoice), **figures}


class _Figures(StrictModel):
    """Figures of a job and their style, without its other fields."""

    figures: list[Annotated[FigureKind, OneOf(FIGURES)]]
    style: FigureStyle = Field(default_factory=FigureStyle)


def read_figures(job: Mapping[str, Any], file: str) -> tuple[list[dict[str, Any]], FigureStyle]:
    """Read the figures of a table's job and their style from plain values, without its other fields.

    Args:
        job: the job.
        file: the name of its file, for messages.

    Returns:
        The figures as plain values, and their style.

    Raises:
        JobError: all errors in them, each with the name of the file.
    """
    data = {"figures": job.get("figures", []), "style": job.get("style", {})}
    try:
        checked = _Figures.model_validate(data)
    except ValidationError as error:
        wrong = from_pydantic(error, {**_sections(data), "": SchemaSection("a job", _Figures)}, "")
        raise JobError([dataclasses.replace(diagnostic, file=file) for diagnostic in wrong]) from None
    plain = [figure.model_dump(mode="json", exclude_none=True) for figure in checked.figures]
    stems = [figure.get("name") or figure["kind"] for figure in plain]
    repeated = next((stem for stem in stems if stems.count(stem) > 1), None)
    if repeated is not None:
        text = f"has two figures named {repeated}: give each figure its own name."
        raise JobError([Diagnostic(("figures",), text, file=file)])
    return plain, checked.style


def schema() -> dict[str, Any]:
    """Return the JSON schema of job files, for editors; each field has a description."""
    job_schema = Job.model_json_schema()
    job_schema["$schema"] = "https://json-schema.org/draft/2020-12/schema"
    job_schema["title"] = "gaitsweep job"
    job_schema["required"].remove("model")  # a config may name it
    return job_schema
