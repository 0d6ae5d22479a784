"""The table of a paper's claims, read from `configs/claims/PAPER.yaml`, and the verdict on each claim."""

from __future__ import annotations

import enum
import inspect
import itertools
import math
import typing
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, TypeGuard

import numpy as np
import pandas as pd
from pydantic import Field, PlainValidator, PrivateAttr, TypeAdapter, ValidationError

from gaitsweep import near_miss
from gaitsweep.analysis.records import names_in
from gaitsweep.angles import TURN
from gaitsweep.claims.measures import MEASURES, Angle, Value
from gaitsweep.errors import ArgumentError, JobError
from gaitsweep.extension import ExtensionError, folders, import_all
from gaitsweep.schema.diagnostics import Diagnostic, quoted, unknown_name
from gaitsweep.schema.numbers import Flag, InvalidValue, NotNegative, Real, Stem, checked
from gaitsweep.schema.strict_model import SchemaSection, StrictModel, from_pydantic
from gaitsweep.schema.yaml_document import read_document
from gaitsweep.shipped import job_folders

_Words = Annotated[list[str], Field(min_length=1)]
_ROUNDING = 1e-12  # by which a value on a bound may be beyond it, as a share of the largest of them


def _read_paper_value(value: Any) -> float | str | list[float] | list[str]:
    """Read a number, a text, or a list of either; raises InvalidValue."""
    values = value if isinstance(value, list) else [value]
    if values and all(isinstance(item, str) for item in values):
        return value
    if not values or not all(isinstance(item, int | float) and not isinstance(item, bool) for item in values):
        raise InvalidValue(f"is {quoted(value)}, but must be a number or a text, or a list of such.")
    return list(map(float, values)) if isinstance(value, list) else float(value)


_PaperValue = Annotated[
    float | str | list[float] | list[str],
    PlainValidator(checked(_read_paper_value)),
]


class PaperJob(StrictModel):
    """A job from whose table claims are measured."""

    job: Stem = Field(
        description="file of the job, in an extension's folder of jobs or beside the table of claims"
    )
    set_: dict[str, Any] = Field(
        default={},
        alias="set",
        description="fields of the job to replace, with dotted names, such as its config",
    )
    quick: dict[str, Any] | Literal[False] = Field(
        default={},
        description="fields of the job that --quick replaces, with dotted names; verify is 0 unless it is "
        "given here; false leaves the job out",
    )


class Bounds(StrictModel):
    """The values that a claim allows."""

    tolerance: NotNegative | None = Field(default=None, description="absolute tolerance")
    between: tuple[Real, Real] | None = Field(default=None, description="allowed interval")
    above: Real | None = Field(default=None, description="lower bound of the value")
    below: Real | None = Field(default=None, description="upper bound of the value")


class Quick(Bounds):
    """Fields of a claim that `--quick` replaces."""

    because: str | None = Field(default=None, description="reason for this tolerance")


class Claim(Bounds):
    """A figure, table, equation or sentence of a paper, and the rule of its verdict."""

    id: str = Field(pattern=r"^[a-z][a-z0-9_]*$", description="name of the claim in the table")
    where: str = Field(description="figure, table, equation or section of the paper")
    claim: str = Field(description="statement of the paper, in our words")
    measure: str = Field(description="name of the measure")
    of: list[str] = Field(default=[], description="jobs whose tables the measure takes, in this order")
    with_: dict[str, Any] = Field(default={}, alias="with", description="keyword arguments of the measure")
    paper: _PaperValue = Field(description="the paper's value")
    unit: str = Field(
        default="", description="unit of the value; 1 for a number without unit, empty for texts"
    )
    equals: str | _Words | None = Field(
        default=None, description="expected text or texts; by default those of paper"
    )
    because: str = Field(description="reason for this tolerance")
    chosen: str = Field(default="", description="choices made where the paper gives no value")
    asked: Flag = Field(
        default=False,
        description="whether the paper leaves the question open, so that the answer is "
        "ours and not a claim of the paper",
    )
    definition: str = Field(
        default="",
        description="reason why no simulation can change the verdict, such as a value or rule built "
        "into the model",
    )
    step: str = Field(
        default="",
        description="result with finer steps, if it changes the verdict; the claim then "
        "counts as not reproduced",
    )
    open: str = Field(
        default="", description="constants that decide the result and that the paper does not give"
    )
    tried: str = Field(default="", description="attempts to reach the paper's value, if it is not reached")
    figure: Stem | Literal[""] = Field(default="", description="figure of the first job that shows the claim")
    command: str = Field(
        default="", description="command that computes the value; by default the run of the first job"
    )
    quick: Quick | Literal[False] = Field(
        default=Quick(), description="fields that --quick replaces; false: no verdict with --quick"
    )

    @property
    def interval(self) -> tuple[float, float] | None:
        """The interval of `between`, `above` and `below`; None without them."""
        if self.between is None and self.above is None and self.below is None:
            return None
        low, high = self.between or (-math.inf, math.inf)
        above = -math.inf if self.above is None else self.above
        below = math.inf if self.below is None else self.below
        return max(low, above), min(high, below)

    def as_quick(self) -> Claim | None:
        """The claim with the replacements of `--quick`, or None if `--quick` leaves it out."""
        if self.quick is False:
            return None
        replaced = self.quick.model_dump(exclude_none=True)
        if replaced.keys() & Bounds.model_fields.keys():
            replaced = dict.fromkeys(Bounds.model_fields) | replaced
        return self.model_copy(update=replaced)


class Paper(StrictModel):
    """A paper, the jobs that reproduce it, and its claims."""

    paper: str = Field(description="authors, year, journal")
    jobs: dict[Stem, PaperJob] = Field(default={}, description="jobs by name")
    claims: list[Claim] = Field(min_length=1, description="the claims")

    _file: Path = PrivateAttr()

    @property
    def name(self) -> str:
        """The name of the table of claims."""
        return self._file.stem

    def job_file(self, name: str) -> Path:
        """The file of one of the jobs."""
        written = self.jobs[name].job
        beside_claims = self._file.parent / written
        places = (beside_claims, *(folder / written for folder in job_folders()))
        return next((file for file in places if file.is_file()), beside_claims)

    def only(self, names: str | Iterable[str]) -> Paper:
        """The paper with some of its claims.

        Raises:
            ArgumentError: there is no claim of one of the names, or no name.
        """
        wanted = set(names_in(names))
        if not wanted:
            raise ArgumentError(f"names is empty: name a claim of {self.name}.")
        known = [claim.id for claim in self.claims]
        if unknown := sorted(wanted - set(known)):
            near = near_miss.suggestion(unknown[0], known)
            raise ArgumentError(f"{unknown[0]} is not a claim of {self.name}{near}")
        return self.model_copy(update={"claims": [claim for claim in self.claims if claim.id in wanted]})


def known_papers() -> list[str]:
    """The papers whose claims come with gaitsweep and its extensions."""
    return sorted(_tables())


def _tables() -> dict[str, Path]:
    """The tables of claims of all extensions, by the name of their paper.

    Raises:
        ExtensionError: two extensions have tables of the same name.
    """
    tables: dict[str, Path] = {}
    for file in itertools.chain.from_iterable(folder.glob("*.yaml") for folder in folders("claims")):
        if tables.setdefault(file.stem, file) != file:
            raise ExtensionError(
                f"There are two tables of claims named {file.stem}, {tables[file.stem]} and {file}: "
                "uninstall one of their packages."
            )
    return tables


def read_paper(name: str | Path) -> Paper:
    """Read the table of claims of a paper.

    Args:
        name: one of `known_papers()`, or a YAML file.

    Raises:
        ArgumentError: there is no such paper.
        JobError: all errors in the file, each with its line.
    """
    file = Path(name)
    if file.suffix not in (".yaml", ".yml"):
        known = _tables()
        if str(name) not in known:
            raise ArgumentError(
                f"{name} is not a paper with a table of claims{near_miss.suggestion(str(name), known)}"
            )
        file = known[str(name)]
    document = read_document(file, noun="a table of claims", fields=("paper", "jobs", "claims"))
    import_all("measures")
    try:
        paper = Paper.model_validate(document.data)
    except ValidationError as error:
        raise document.located(JobError(from_pydantic(error, _SECTIONS, ""))) from None
    paper._file = file
    if wrong := list(_diagnostics(paper)):
        raise document.located(JobError(wrong))
    return paper


# The parts of a table of claims by the keys under which pydantic reports them.
_SECTIONS = {
    "": SchemaSection("a table of claims", Paper),
    "jobs": SchemaSection("a job of a paper", PaperJob),
    "claims": SchemaSection("a claim", Claim),
    "Quick": SchemaSection("quick", Quick),
}


def _diagnostics(paper: Paper) -> Iterator[Diagnostic]:
    """Diagnostics across fields: unknown names, and claims without a rule for their verdict."""
    index_of_id: dict[str, int] = {}
    for index, claim in enumerate(paper.claims):
        path = ("claims", index)
        if (first := index_of_id.setdefault(claim.id, index)) != index:
            yield Diagnostic((*path, "id"), f"is {claim.id}, like that of claims[{first}]: ids must differ.")
        for number, name in enumerate(claim.of):
            if name not in paper.jobs:
                yield unknown_name((*path, "of", number), name, "under jobs", paper.jobs)
        if claim.measure not in MEASURES:
            yield unknown_name((*path, "measure"), claim.measure, "a measure", MEASURES)
        elif (text := _wrong_arguments(claim)) is not None:
            yield Diagnostic((*path, "with"), text)
        if not claim.of and not claim.command:
            yield Diagnostic((*path, "command"), "is missing: a claim without jobs must name its command.")
        if (text := _wrong_rule(claim)) is not None:
            yield Diagnostic(path, text)
        elif (quick := claim.as_quick()) is not None and (text := _wrong_rule(quick)) is not None:
            yield Diagnostic((*path, "quick"), text)
    for name in paper.jobs:
        if not paper.job_file(name).is_file():
            yield Diagnostic(
                ("jobs", name, "job"),
                f"is {paper.jobs[name].job}, which is neither a job of gaitsweep or of an extension "
                "nor a file beside the table of claims.",
            )


def _wrong_arguments(claim: Claim) -> str | None:
    """The reason why a measure does not accept the tables and arguments of a claim, or None."""
    measure = MEASURES[claim.measure]
    try:
        inspect.signature(measure).bind(*[pd.DataFrame()] * len(claim.of), **claim.with_)
    except TypeError as error:
        return f"does not fit the measure {claim.measure}: {error}."
    hints = typing.get_type_hints(measure, include_extras=True)
    for name, value in claim.with_.items():
        hint = hints.get(name, Any)
        refused = f"has {name}: {quoted(value)}, which the measure {claim.measure} does not accept"
        if typing.get_origin(hint) is Literal and value not in (words := typing.get_args(hint)):
            return refused + near_miss.suggestion(str(value), map(str, words))
        try:
            TypeAdapter(hint).validate_python(value, strict=True)
        except ValidationError as error:
            first = error.errors()[0]
            return f"{refused}: {first.get('ctx', {}).get('error') or first['msg'].rstrip('.') + '.'}"
    return None


def _wrong_rule(claim: Claim) -> str | None:
    """The reason why a claim has no rule for its verdict, or None."""
    first = claim.paper[0] if isinstance(claim.paper, list) else claim.paper
    numeric = isinstance(first, float)
    if numeric and not np.isfinite(claim.paper).all():
        return "has a paper that is not finite, to which no value can be compared."
    if numeric and claim.equals is not None:
        return "has equals, which is for texts, but its paper is a number: remove it."
    if claim.interval is not None:
        low, high = claim.interval
        if not low <= high:
            return f"allows values from {low:g} to {high:g}, which no number can be: exchange the two."
        for rule, written in (("a tolerance", claim.tolerance), ("equals", claim.equals)):
            if written is not None:
                return f"has {rule} beside between, above or below: remove one of the two rules."
    if claim.tolerance is not None and not numeric:
        return "has a tolerance, but its paper is not a number: use between, above or below instead."
    if numeric and claim.tolerance is None and claim.interval is None:
        return "must have a tolerance, or between, above or below."
    return None


class ClaimVerdict(enum.StrEnum):
    """Verdict on a claim: its value in tables, its words in text for readers, and their meaning."""

    words: str
    sentence: str

    def __new__(cls, value: str, words: str, sentence: str) -> ClaimVerdict:
        member = str.__new__(cls, value)
        member._value_ = value
        member.words = words
        member.sentence = sentence
        return member

    reproduced = "reproduced", "reproduced", "our value agrees with the paper's within the tolerance"
    not_reproduced = (
        "not",
        "not reproduced",
        "our value does not agree with the paper's, or not with finer steps",
    )
    open_constants = (
        "open: constants",
        "with open constants",
        "our value does not agree, and the paper lacks constants that decide it",
    )
    definition = (
        "definition",
        "true by definition",
        "the definition of the model or of its labels decides it, and no simulation can change it",
    )
    answered = "answered", "answered", "the paper leaves the question open, and this run confirms our answer"
    not_run = (
        "not run",
        "not run",
        "no verdict: --quick leaves it out, its job did not run, or its measure does not fit its table",
    )


def in_turn_of(claim: Claim, ours: Value) -> Value:
    """A measured angle in the turn in which it is nearest to what a claim allows; other values unchanged."""
    low, high = claim.interval or (claim.paper, claim.paper)
    if not isinstance(ours, Angle) or not isinstance(low, float) or not isinstance(high, float):
        return ours
    turns = round((ours - 0.5 * (low + high)) / TURN) if math.isfinite(low + high + ours) else 0
    return ours - turns * TURN


def verdict(claim: Claim, ours: Value) -> ClaimVerdict:
    """The verdict on a claim from its measured value.

    Args:
        claim: the claim, with its tolerance, bounds or texts.
        ours: the result of its measure.
    """
    if agrees(claim, ours):
        if claim.step:
            return ClaimVerdict.not_reproduced
        if claim.definition:
            return ClaimVerdict.definition
        return ClaimVerdict.answered if claim.asked else ClaimVerdict.reproduced
    return ClaimVerdict.open_constants if claim.open else ClaimVerdict.not_reproduced


def agrees(claim: Claim, ours: Value) -> bool:
    """Return whether a value is within a claim's tolerance or bounds, or equals its text.

    A number that is not finite and an empty list do not agree; a value on a bound does, rounding included.

    Args:
        claim, ours: as for `verdict`.
    """
    values = list(ours) if _is_list(ours) else [ours]
    if claim.interval is not None:
        return bool(values) and all(_is_within(value, *claim.interval) for value in values)
    expected: Any = claim.paper if claim.equals is None else claim.equals
    if _is_list(expected) != _is_list(ours):
        return False
    targets = list(expected) if _is_list(ours) else [expected]
    tolerance = claim.tolerance
    if tolerance is None or len(targets) != len(values):
        return targets == values
    pairs = zip(targets, values, strict=True)
    return all(_is_within(value, target - tolerance, target + tolerance) for target, value in pairs)


def _is_list(value: Value) -> TypeGuard[Sequence[Any]]:
    """Return whether a value is a list; a text is none."""
    return isinstance(value, Sequence) and not isinstance(value, str)


def _is_within(value: object, low: float, high: float) -> bool:
    """Return whether a value is a finite number from `low` to `high`, up to rounding."""
    if not isinstance(value, (int, float)) or not math.isfinite(value):
        return False
    rounding = _ROUNDING * max(abs(number) for number in (value, low, high) if math.isfinite(number))
    return low - rounding <= value <= high + rounding
