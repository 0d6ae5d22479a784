"""Reproduction of a paper: runs its missing jobs, measures its claims and gives their verdicts."""

from __future__ import annotations

import dataclasses
import functools
import os
import shlex
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import BinaryIO, NamedTuple

import pandas as pd
import yaml

from gaitsweep.analysis.records import ColumnError
from gaitsweep.claims.claims_and_verdicts import (
    Claim,
    ClaimVerdict,
    Paper,
    PaperJob,
    in_turn_of,
    verdict,
)
from gaitsweep.claims.measures import MEASURES, Value, plain_value
from gaitsweep.claims.page import page
from gaitsweep.errors import ArgumentError, ModelError, UserError
from gaitsweep.expression import ExpressionError
from gaitsweep.job import load_job
from gaitsweep.runs.execute import RESULTS, run_job
from gaitsweep.runs.figures import FigureError
from gaitsweep.runs.progress import Progress
from gaitsweep.runs.sentences import self_check_sentence
from gaitsweep.schema.yaml_document import read_document
from gaitsweep.shipped import config_file, shipped
from gaitsweep.table import Snapshot, load, replace_file, writing

TABLE = "claims.parquet"
PAGE = "index.html"


@dataclasses.dataclass(frozen=True)
class JobRun:
    """A job of a paper after its run: its directory, or the reason why it has no table."""

    name: str
    command: str
    path: Path | None
    failure: str = ""
    seconds: float = 0.0

    @property
    def notes(self) -> str:
        """Sentences with the rows by status and the self-check."""
        if self.path is None:
            return self.failure
        snapshot = Snapshot.of(self.path)
        counts = ", ".join(f"{number} {status}" for status, number in snapshot.counts.items())
        check = snapshot.manifest.get("self_check")
        text = f"{counts}. {self_check_sentence(check)}" if isinstance(check, dict) else f"{counts}."
        return f"{text} {self.failure}".strip()

    def figure(self, stem: str) -> Path | None:
        """The file of one of its figures, or None if it was not drawn."""
        if self.path is None or not (file := self.path / "figures" / f"{stem}.png").is_file():
            return None
        return file


@dataclasses.dataclass(frozen=True)
class Reproduction:
    """Verdicts on a paper's claims.

    Args:
        table: a row for each claim.
        folder: the folder of the files of `reproduce`.
        failed: whether a job failed, or a claim asks for what its jobs do not have.
    """

    table: pd.DataFrame
    folder: Path
    failed: bool

    @property
    def counts(self) -> dict[str, int]:
        """The number of claims with each verdict."""
        verdicts = list(self.table["verdict"])
        return {verdict.value: verdicts.count(verdict.value) for verdict in ClaimVerdict}

    @property
    def by_constants(self) -> dict[str, int]:
        """The number of claims that simulations reproduce with each set of constants, the largest first."""
        reproduced = self.table["simulated"] & (self.table["verdict"] == ClaimVerdict.reproduced.value)
        return dict(Counter(self.table.loc[reproduced, "constants"].tolist()).most_common())

    @property
    def page(self) -> Path:
        """The file that shows the verdicts."""
        return self.folder / PAGE


def reproduce(
    paper: Paper,
    out: str | Path | None = None,
    *,
    quick: bool = False,
    on_progress: Progress | None = None,
    on_message: Callable[[str], None] | None = None,
) -> Reproduction:
    """Run a paper's jobs whose tables are missing, and compare its claims with the results.

    Args:
        paper: its table of claims.
        out: the folder of `claims.parquet`, `index.html` and the jobs' directories;
            `results/reproduce_PAPER` by default.
        quick: use the table's settings for `--quick`: fewer rows and wider tolerances.
        on_progress: callback with the progress of the current job.
        on_message: callback with sentences about the jobs that run and about errors.

    Returns:
        The verdicts. If a job fails, its claims are `not run`, and the other jobs still run.

    Raises:
        TableError: the folder cannot be written.
    """
    folder = RESULTS / f"reproduce_{paper.name}" if out is None else Path(out)
    return _PaperRun(paper, folder, quick, on_progress, on_message or (lambda sentence: None)).result()


class _Judgement(NamedTuple):
    """The value and the verdict of a claim, and a reason if it has no value or is not reproduced."""

    value: Value | None
    verdict: ClaimVerdict
    reason: str


class _JobSource(NamedTuple):
    """The model of a job, and the file of its constants by name; empty texts if its file cannot be read."""

    model: str
    constants: str


@dataclasses.dataclass
class _PaperRun:
    """The jobs of a paper that have run, their tables, and the verdicts on its claims."""

    paper: Paper
    folder: Path
    quick: bool
    on_progress: Progress | None
    on_message: Callable[[str], None]
    runs: dict[str, JobRun] = dataclasses.field(default_factory=dict)
    _tables: dict[str, pd.DataFrame] = dataclasses.field(default_factory=dict)
    _has_wrong_question: bool = False

    @functools.cached_property
    def sources(self) -> dict[str, _JobSource]:
        """The model and the constants of each job by name."""
        return {name: _source(self.paper.job_file(name), job) for name, job in self.paper.jobs.items()}

    def result(self) -> Reproduction:
        """Run the jobs, judge the claims, and write the table and the page."""
        paper = self.paper
        folder = self.folder
        claims = [(claim, claim.as_quick() if self.quick else claim) for claim in paper.claims]
        used = {name for _, judged in claims if judged for name in judged.of}
        needed = [name for name in paper.jobs if name in used]
        for number, name in enumerate(needed, 1):
            if not self.quick or paper.jobs[name].quick is not False:
                self.on_message(f"{paper.name}: job {number} of {len(needed)}, {name}")
                self.runs[name] = self._run(name)
        table = pd.DataFrame([self._row(written_claim, judged) for written_claim, judged in claims])
        # a folder that is passed on does not tell where it was made
        stored = table.assign(
            figure=[os.path.relpath(figure, folder) if figure else "" for figure in table["figure"]]
        )
        _write(folder, TABLE, lambda file: stored.to_parquet(file, index=False, write_page_checksum=True))
        text = page(paper.paper, table, list(self.runs.values()), quick=self.quick)
        _write(folder, PAGE, lambda file: file.write(text.encode()))
        failed = self._has_wrong_question or any(run.path is None for run in self.runs.values())
        return Reproduction(table, folder, failed=failed)

    def _run(self, name: str) -> JobRun:
        """Run one job, or continue it; errors are stored as sentences."""
        job = self.paper.jobs[name]
        file = self.paper.job_file(name)
        path = self.folder / ("quick" if self.quick else "jobs") / name
        fields = job.set_
        if self.quick:  # a quick job is small, so that its self-check would take longer than its rows
            fields = fields | {"verify": 0} | (job.quick or {})
        overrides = [f"{key}={_inline(value)}" for key, value in fields.items()]
        settings = [word for override in overrides for word in ("--set", override)]
        command = f"{_command(file)} {shlex.join(settings)}".strip()
        began = time.perf_counter()
        try:
            run_job(load_job(file, overrides), path, on_progress=self.on_progress, on_message=self.on_message)
        except FigureError as error:  # the table is complete
            self.on_message(error.sentence)
            return JobRun(name, command, path, error.sentence, time.perf_counter() - began)
        except UserError as error:
            self.on_message(f"{name} failed: {error.sentence}")
            return JobRun(name, command, None, error.sentence)
        return JobRun(name, command, path, seconds=time.perf_counter() - began)

    def _table(self, name: str) -> pd.DataFrame:
        """The table of a job that has run."""
        if name not in self._tables:
            path = self.runs[name].path
            assert path is not None
            self._tables[name] = load(path)
        return self._tables[name].copy(deep=False)  # which a measure may change

    def _judge(self, claim: Claim | None) -> _Judgement:
        """Measure a claim, and compare its value with the paper's."""
        if claim is None:
            return _Judgement(None, ClaimVerdict.not_run, "--quick leaves this claim out")
        for name in claim.of:
            if name not in self.runs:
                return _Judgement(None, ClaimVerdict.not_run, f"--quick leaves the job {name} out")
            if self.runs[name].path is None:
                reason = f"the job {name} failed: {self.runs[name].failure}"
                return _Judgement(None, ClaimVerdict.not_run, reason)
        try:
            ours = plain_value(MEASURES[claim.measure](*map(self._table, claim.of), **claim.with_))
        except (ArgumentError, ColumnError, ExpressionError, ModelError) as error:
            # the question is wrong, not the answer
            self._has_wrong_question = True
            return _Judgement(None, ClaimVerdict.not_run, f"it cannot be measured: {error.sentence}")
        except (UserError, ArithmeticError, LookupError, TypeError, ValueError) as error:
            # the tables exist but lack the value: rows that fell have no cycles for a mean
            missed = ClaimVerdict.open_constants if claim.open else ClaimVerdict.not_reproduced
            reason = error.sentence if isinstance(error, UserError) else f"{type(error).__name__}: {error}"
            return _Judgement(None, missed, reason)
        ours = in_turn_of(claim, ours)
        reason = f"finer steps change the verdict: {claim.step}" if claim.step else ""
        return _Judgement(ours, verdict(claim, ours), reason)

    def _row(self, written_claim: Claim, judged: Claim | None) -> dict[str, object]:
        """The verdict on a claim as a record; `judged` is the claim as `--quick` asks for it, if it does."""
        began = time.perf_counter()
        ours, verdict, reason = self._judge(judged)
        if judged is not None and reason and verdict is ClaimVerdict.not_run:
            self.on_message(f"{judged.id} has no verdict: {reason}")
        seconds = time.perf_counter() - began
        claim = judged or written_claim
        run = next((self.runs.get(name) for name in claim.of[:1]), None)
        figure = run.figure(claim.figure) if run is not None and claim.figure else None
        command = claim.command or (run.command if run else _command(self.paper.job_file(claim.of[0])))
        return {
            "id": claim.id,
            "where": claim.where,
            "claim": claim.claim,
            "paper": written(claim.paper),
            "ours": "" if ours is None else written(ours),
            "value": float(ours) if isinstance(ours, (int, float)) else float("nan"),
            "unit": claim.unit,
            "allowed": allowed(claim),
            "verdict": verdict.value,
            "why": reason,
            "because": claim.because,
            "chosen": claim.chosen,
            "definition": claim.definition,
            "open": claim.open,
            "tried": claim.tried,
            "measure": claim.measure,
            "jobs": ", ".join(claim.of),
            "simulated": bool(claim.of),
            "model": ", ".join(dict.fromkeys(self.sources[name].model for name in claim.of)),
            "constants": ", ".join(dict.fromkeys(self.sources[name].constants for name in claim.of)),
            "figure": "" if figure is None else str(figure),
            "command": command,
            "seconds": seconds,
        }


def _inline(value: object) -> str:
    """A value as YAML on one line, for `--set`."""
    return yaml.safe_dump(value, default_flow_style=True, width=10**6).removesuffix("...\n").strip()


def _command(file: Path) -> str:
    """The command that runs a job; a shipped one's path is that in a checkout, which readers can type."""
    is_shipped = file.parent == shipped("sweeps")
    return shlex.join(["gaitsweep", "run", f"sweeps/{file.name}" if is_shipped else str(file)])


def _source(file: Path, job: PaperJob) -> _JobSource:
    """The model and the constants that a job's file names."""
    try:
        data = {**read_document(file).data, **job.set_}
        if (name := data.get("config")) is None:
            return _JobSource(str(data.get("model", "")), "defaults")
        config = config_file(str(name), file.parent)
        return _JobSource(str({**read_document(config).data, **data}.get("model", "")), config.stem)
    except UserError:  # its run reports the error, and fails alone
        return _JobSource("", "")


def written(value: Value) -> str:
    """Format a value for readers: numbers with six digits, lists with commas."""
    if isinstance(value, str):
        return value
    if isinstance(value, (int, float)):
        return f"{value:.6g}"
    return ", ".join(written(item) for item in value)


def allowed(claim: Claim) -> str:
    """Format the values that a claim allows."""
    if claim.tolerance is not None:
        return f"± {claim.tolerance:g}"
    parts = []
    if claim.between is not None:
        parts.append(f"{claim.between[0]:g} to {claim.between[1]:g}")
    if claim.above is not None:
        parts.append(f"at least {claim.above:g}")
    if claim.below is not None:
        parts.append(f"at most {claim.below:g}")
    if parts:
        return ", ".join(parts)
    return "equal" if claim.equals is None else f"equal to {written(claim.equals)}"


def _write(folder: Path, name: str, write: Callable[[BinaryIO], object]) -> None:
    """Write a file of the folder of a reproduction."""
    target = folder / name
    with writing(f"{target} could not be written"):
        folder.mkdir(parents=True, exist_ok=True)
        replace_file(target, write)
