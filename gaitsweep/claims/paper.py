"""The table of a paper's claims: what `configs/claims/PAPER.yaml` holds."""

from __future__ import annotations

import inspect
import typing
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, Literal

import pandas as pd
from pydantic import Field, TypeAdapter, ValidationError

from gaitsweep import near_miss
from gaitsweep.claims.measures import MEASURES
from gaitsweep.errors import ArgumentError
from gaitsweep.extension import folders, import_all
from gaitsweep.schema.diagnostics import Diagnostic, JobError, SchemaSection, found, from_pydantic
from gaitsweep.schema.numbers import InvalidValue, Stem, read_stem
from gaitsweep.schema.strict_model import StrictModel
from gaitsweep.schema.yaml_document import Document, read_document
from gaitsweep.shipped import job_folders

_Numbers = list[float]
_Words = list[str]


class PaperJob(StrictModel):
    """A sweep that claims are measured from."""

    job: Stem = Field(
        description="file of the job, among those of an extension or beside the table of claims"
    )
    set_: dict[str, Any] = Field(
        default={}, alias="set", description="fields of the job that are replaced, dotted, such as its config"
    )
    quick: dict[str, Any] | Literal[False] = Field(
        default={},
        description="fields of the job that --quick replaces, dotted; verify is 0 unless it is among them; "
        "false leaves the job out",
    )


class Quick(StrictModel):
    """Fields of a claim that `--quick` replaces."""

    tolerance: float | None = Field(default=None, ge=0, description="absolute tolerance")
    between: tuple[float, float] | None = Field(default=None, description="allowed interval")
    above: float | None = Field(default=None, description="lower bound")
    below: float | None = Field(default=None, description="upper bound")
    because: str | None = Field(default=None, description="why this tolerance")


class Claim(StrictModel):
    """A figure, table, equation or sentence of a paper, and how it is judged."""

    id: str = Field(pattern=r"^[a-z][a-z0-9_]*$", description="name of the claim in the table")
    where: str = Field(description="figure, table, equation or section of the paper")
    claim: str = Field(description="what the paper says, in our words")
    measure: str = Field(description="name of the measure")
    of: list[str] = Field(default=[], description="jobs whose tables the measure takes, in this order")
    with_: dict[str, Any] = Field(default={}, alias="with", description="keyword arguments of the measure")
    paper: float | str | _Numbers | _Words = Field(description="the paper's value")
    unit: str = Field(default="", description="unit of the value; 1 for a number without, empty for texts")
    tolerance: float | None = Field(default=None, ge=0, description="absolute tolerance")
    between: tuple[float, float] | None = Field(default=None, description="allowed interval")
    above: float | None = Field(default=None, description="lower bound of the value")
    below: float | None = Field(default=None, description="upper bound of the value")
    equals: str | _Words | None = Field(
        default=None, description="the text or texts; those of paper if left out"
    )
    because: str = Field(description="why this tolerance")
    chosen: str = Field(default="", description="what was chosen where the paper is silent")
    asked: bool = Field(
        default=False, description="whether the paper leaves it open: the answer is ours, not a claim of it"
    )
    definition: str = Field(
        default="",
        description="why no simulation can turn the verdict: a value or a rule that the model is given",
    )
    step: str = Field(
        default="", description="what finer steps give, where these turn the verdict: it is `not` then"
    )
    open: str = Field(default="", description="constants that the paper does not give, where these decide")
    tried: str = Field(default="", description="what was tried where the paper's value is not reached")
    figure: Stem | Literal[""] = Field(default="", description="figure of the first job that shows it")
    command: str = Field(default="", description="the command; the run of the first job if left out")
    quick: Quick | Literal[False] = Field(
        default=Quick(), description="what --quick replaces; false: not judged"
    )

    def as_quick(self) -> Claim | None:
        """The claim as `--quick` judges it, None where it does not."""
        if self.quick is False:
            return None
        replaced = self.quick.model_dump(exclude_none=True)
        if replaced.keys() & {"tolerance", "between", "above", "below"}:
            replaced = {"tolerance": None, "between": None, "above": None, "below": None} | replaced
        return self.model_copy(update=replaced)


class Paper(StrictModel):
    """A paper, the jobs that reproduce it, and its claims."""

    name: str = Field(description="name of the table of claims")
    paper: str = Field(description="authors, year, journal")
    file: Path = Field(description="the table's file")
    jobs: dict[str, PaperJob] = Field(description="jobs by name")
    claims: list[Claim] = Field(description="the claims")

    def job_file(self, name: str) -> Path:
        """The file of one of the jobs."""
        written = self.jobs[name].job
        beside = self.file.parent / written
        places = (beside, *(folder / written for folder in job_folders()))
        return next((file for file in places if file.is_file()), beside)

    def only(self, names: Iterable[str]) -> Paper:
        """The paper with some of its claims.

        Raises:
            ArgumentError: it has no claim of a name.
        """
        wanted, known = set(names), [claim.id for claim in self.claims]
        for name in sorted(wanted - set(known)):
            raise ArgumentError(f"{name} is no claim of {self.name}{near_miss.suggestion(name, known)}")
        return self.model_copy(update={"claims": [claim for claim in self.claims if claim.id in wanted]})


def known_papers() -> list[str]:
    """The papers whose claims come with gaitsweep and its extensions."""
    return sorted(_tables())


def _tables() -> dict[str, Path]:
    """The tables of claims of all extensions, by the name of their paper."""
    return {file.stem: file for folder in folders("claims") for file in folder.glob("*.yaml")}


def read_paper(name: str | Path) -> Paper:
    """The table of claims of a paper.

    Args:
        name: one of `known_papers()`, or a YAML file.

    Raises:
        ArgumentError: there is no such paper.
        JobError: all that is wrong in the file, with its line.
    """
    file = Path(name)
    if file.suffix not in (".yaml", ".yml"):
        known = _tables()
        if str(name) not in known:
            raise ArgumentError(
                f"{name} is no paper with a table of claims{near_miss.suggestion(str(name), known)}"
            )
        file = known[str(name)]
    document = read_document(file)
    import_all("measures")
    wrong: list[Diagnostic] = []
    data = document.data
    for key in data:
        if key not in ("paper", "jobs", "claims"):
            wrong.append(Diagnostic((key,), "is not a field of a table of claims: paper, jobs, claims are."))
    jobs = {
        str(key).strip(): read
        for key, each in _mapping(data.get("jobs"), "jobs", wrong).items()
        if (read := _read(PaperJob, each, ("jobs", str(key)), wrong)) is not None
    }
    claims = [
        read
        for at, each in enumerate(_list(data.get("claims"), wrong))
        if (read := _read(Claim, each, ("claims", at), wrong)) is not None
    ]
    if not isinstance(data.get("paper"), str):
        wrong.append(Diagnostic(("paper",), "is missing: authors, year, journal."))
    if not wrong:
        paper = Paper(name=file.stem, paper=data["paper"], file=file, jobs=jobs, claims=claims)
        wrong += _checked(paper)
        if not wrong:
            return paper
    raise _located(document, wrong)


def _located(document: Document, wrong: Iterable[Diagnostic]) -> JobError:
    return JobError([document.locate(each) for each in wrong])


def _mapping(value: Any, field: str, wrong: list[Diagnostic]) -> Mapping[str, Any]:
    if value is None or isinstance(value, Mapping):
        return value or {}
    wrong.append(Diagnostic((field,), "takes fields (key: value)."))
    return {}


def _list(value: Any, wrong: list[Diagnostic]) -> list[Any]:
    if isinstance(value, list) and value:
        return value
    wrong.append(Diagnostic(("claims",), "is missing: a list of claims."))
    return []


def _read(part: type[Any], value: Any, path: tuple[str | int, ...], wrong: list[Diagnostic]) -> Any:
    try:
        return part.model_validate(value)
    except ValidationError as error:
        noun = "a claim" if part is Claim else "a job of a paper"
        sections = {"": SchemaSection(noun, part), "quick": SchemaSection("quick", Quick)}
        wrong.extend(from_pydantic(error, sections, "", path))
        return None


def _checked(paper: Paper) -> Iterator[Diagnostic]:
    """Check across fields: names must exist, and each claim needs one way to be judged."""
    before: dict[str, int] = {}
    for at, claim in enumerate(paper.claims):
        path = ("claims", at)
        if before.setdefault(claim.id, at) != at:
            yield Diagnostic((*path, "id"), f"is {claim.id}, the name of claims[{before[claim.id]}] too.")
        for number, name in enumerate(claim.of):
            if name not in paper.jobs:
                near = near_miss.suggestion(name, paper.jobs)
                yield Diagnostic((*path, "of", number), f"is {name}, which is no job here{near}")
        if claim.measure not in MEASURES:
            near = near_miss.suggestion(claim.measure, MEASURES)
            yield Diagnostic((*path, "measure"), f"is {claim.measure}, which is no measure{near}")
        elif (text := _misfit(claim)) is not None:
            yield Diagnostic((*path, "with"), text)
        if not claim.of and not claim.command:
            yield Diagnostic((*path, "command"), "is missing: a claim without jobs names its command.")
        text = _unjudged(claim)
        if text is not None:
            yield Diagnostic(path, text)
    for name in paper.jobs:
        try:
            read_stem(name)
        except InvalidValue as error:
            yield Diagnostic(("jobs", name), str(error))
        if not paper.job_file(name).is_file():
            yield Diagnostic(
                ("jobs", name, "job"),
                f"is {paper.jobs[name].job}, which is no job of gaitsweep or of an extension, and no file "
                "beside the table of claims.",
            )


def _misfit(claim: Claim) -> str | None:
    """Return why a measure does not take the tables and arguments of a claim."""
    measure = MEASURES[claim.measure]
    try:
        inspect.signature(measure).bind(*[pd.DataFrame()] * len(claim.of), **claim.with_)
    except TypeError as error:
        return f"does not fit the measure {claim.measure}: {error}."
    hints = typing.get_type_hints(measure, include_extras=True)
    for name, value in claim.with_.items():
        try:
            TypeAdapter(hints.get(name, Any)).validate_python(value, strict=True)
        except ValidationError as error:
            first = error.errors()[0]
            reason = first.get("ctx", {}).get("error") or f"{first['msg'].rstrip('.')}."
            return f"has {name}: {found(value)}, which the measure {claim.measure} does not take: {reason}"
    return None


def _unjudged(claim: Claim) -> str | None:
    """Return why no verdict can follow from a claim's fields."""
    first = claim.paper[0] if isinstance(claim.paper, list) else claim.paper
    numeric = isinstance(first, float)
    bounds = [claim.between, claim.above, claim.below]
    if claim.tolerance is not None:
        return None if numeric else "has a tolerance, but paper is no number: give between, above or below."
    if any(bound is not None for bound in bounds):
        return None
    if numeric:
        return "needs a tolerance, or between, above or below."
    return None
