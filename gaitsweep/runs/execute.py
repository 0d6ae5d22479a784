"""A job carried out: its rows through the engine into a result directory, and its figures.

`carry_out` is what `gaitsweep run` and `gaitsweep.run(...)` do. Run again, it continues where it stopped.
"""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import hashlib
import inspect
import json
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import pandas as pd

from gaitsweep.contract import Model, Status
from gaitsweep.engine.sweep.block import BlockResult, EndedRows
from gaitsweep.engine.sweep.engines import EngineError, choose, default_lanes
from gaitsweep.engine.sweep.sweep import Timings, sweep
from gaitsweep.engine.sweep.sweep_spec import SweepProgress, SweepSpec
from gaitsweep.engine.sweep.xla import local_devices
from gaitsweep.errors import FAILED, UserError
from gaitsweep.job import Job, JobError, Plan, plan, read_figures
from gaitsweep.job.document import read_document
from gaitsweep.job.steps import RowSteps, row_steps, values_with_right_steps
from gaitsweep.models.own_modules import modules_beside
from gaitsweep.plot import draw
from gaitsweep.runs import provenance
from gaitsweep.runs.continuation import check_branch_starts, follow_branches
from gaitsweep.runs.frames import stalls
from gaitsweep.runs.recording import Drive, frame_of, recorder_of
from gaitsweep.runs.refined import refine, refines
from gaitsweep.runs.self_check import SelfCheckError, self_check
from gaitsweep.runs.self_check_report import advice, sentence
from gaitsweep.table import (
    ResultDirectory,
    Snapshot,
    TableError,
    WriteError,
    load,
    load_with_snapshot,
    not_written,
    own_folder,
    read_file,
    reason,
    replace_file,
)
from gaitsweep.table.manifest import FIGURES, JOB
from gaitsweep.version import version

RESULTS = Path("results")


class RunError(UserError):
    """A job cannot run here; the message is a sentence that says why and what to do."""


class FigureError(UserError):
    """Some of a table's figures could not be drawn; `drawn` has the files of the others."""

    exit_code = FAILED

    def __init__(self, message: str, drawn: Sequence[Path]) -> None:
        self.drawn = tuple(drawn)
        super().__init__(message)

    def __reduce__(self) -> tuple[type[FigureError], tuple[str, tuple[Path, ...]]]:
        return FigureError, (str(self), self.drawn)


class Progress(Protocol):
    """Told now and then how far a run is."""

    def __call__(self, done: int, total: int, rate: float, fraction: float, note: str) -> None:
        """Rows done and in all, rows a second, the share done (running rows count in part), a remark."""


@dataclasses.dataclass(frozen=True)
class Prepared:
    """A job made ready: its rows, the engine's work, and the hash that its directory carries.

    `note` says why the engine is another than the one preferred, if it is.
    """

    job: Job
    plan: Plan
    work: SweepSpec
    note: str | None
    job_hash: str
    frame: Callable[[BlockResult], pd.DataFrame]
    steps: RowSteps

    @property
    def engine(self) -> str:
        return self.work.engine

    @property
    def device(self) -> str:
        first = self.work.devices[0]
        return f"{len(self.work.devices)} x {first.platform} ({first.device_kind})"


def prepare(job: Job) -> Prepared:
    """Choose engine, devices and lanes for a job.

    Raises:
        RunError: the job asks for what is not here.
    """
    try:
        devices = local_devices(job.engine.devices)
    except ValueError as error:
        raise RunError(str(error)) from error
    rows = plan(job)
    numerics = job.integration
    recorder, moving = recorder_of(job, rows)
    drive = None if moving is None else Drive(rows, moving)
    try:
        engine, note = choose(job.engine.name, devices[0], rows.model, recorder, numerics, drive)
    except EngineError as error:
        raise RunError(str(error)) from error
    lanes = job.engine.lanes or default_lanes(engine, rows.n_rows, devices[0].platform)
    lanes = min(lanes, max(8, rows.n_rows))  # more would be idle from the start
    steps = row_steps(rows, job.run, numerics)
    work = SweepSpec(
        model=rows.model,
        recorder=recorder,
        numerics=numerics,
        n_rows=rows.n_rows,
        block=job.engine.block,
        lanes=lanes,
        devices=devices,
        values=values_with_right_steps(rows, job.run, numerics, steps),
        drive=drive,
        engine=engine,
    )
    digest = steps.digest if numerics.dt is None else None
    job_hash = _hash(job, rows.model, device=devices[0].platform, engine=engine, lanes=lanes, steps=digest)
    return Prepared(job, rows, work, note, job_hash, functools.partial(frame_of, job, rows, moving), steps)


def carry_out(
    job: Job,
    out: str | Path | None = None,
    *,
    progress: Progress | None = None,
    tell: Callable[[str], None] | None = None,
    figures: bool = True,
    strict: bool = False,
) -> Path:
    """Run what a job's directory still lacks, then draw its figures.

    Args:
        job: the job.
        out: its result directory, `results/NAME` by default.
        progress: told how far the run is.
        tell: told, in a sentence each, what was found and mended in the directory.
        figures: draw the job's figures at the end.
        strict: raise SelfCheckError where the run's self-check warns.

    Returns:
        The result directory.

    Raises:
        RunError, TableError: a sentence each; what was written before stays, and the next run continues.
        KeyboardInterrupt: likewise.
        FigureError: the table is complete, but a figure of it could not be drawn.
    """
    path = RESULTS / job.name if out is None else Path(out)
    ready = prepare(job)
    work = ready.work
    if ready.note is not None and tell is not None:
        tell(ready.note)
    resolved = job.resolved(engine=ready.engine)
    with (
        _told_by_file(),
        ResultDirectory.open(path, resolved, ready.job_hash, work.n_rows, work.block) as directory,
    ):
        for note in directory.notes:
            if tell is not None:
                tell(note)
        missing = directory.missing_blocks()
        if missing:
            _run_missing(ready, directory, missing, progress)
        elif not _summed_up(ready, directory):  # killed after its last part
            _describe(ready, directory)
            _sum_up(ready, directory, directory.manifest.get("timings", {}))
        checked = _self_checked(ready, directory, progress)
        if figures:
            _draw_of_complete(directory, resolved["figures"], progress, tell)
    _tell_of_self_check(checked, work.numerics.dt, tell, strict)
    return path


def _self_checked(ready: Prepared, directory: ResultDirectory, progress: Progress | None) -> dict[str, Any]:
    """What the self-check of a complete table found, now or when it was made."""
    before = directory.manifest.get("self_check")
    asked = min(ready.job.verify, ready.work.n_rows)
    if isinstance(before, dict) and before.get("rows") == asked:
        return before
    total = ready.work.n_rows

    def tell(now: SweepProgress) -> None:
        if progress is not None:
            progress(total, total, 0.0, 1.0, f"self-check: {now.done} of {now.rows} rows")

    check = check_branch_starts if ready.job.run.kind == "continuation" else self_check
    found = check(ready, asked, tell)
    directory.update_manifest(self_check=found)
    return found


def _tell_of_self_check(
    found: dict[str, Any], dt: float | None, tell: Callable[[str], None] | None, strict: bool
) -> None:
    """Warn where a self-check did; its own line is shown with the outcome."""
    if found.get("verdict") != "warned":
        return
    text = f"{sentence(found)} {advice(found, dt)}"
    if strict:
        raise SelfCheckError(text)
    if tell is not None:
        tell(f"Warning: {text}")


@contextlib.contextmanager
def _told_by_file() -> Iterator[None]:
    """What the operating system refuses, as a sentence that names the file."""
    try:
        yield
    except OSError as error:
        if error.filename is None:
            raise
        raise WriteError(f"{error.filename} cannot be used: {reason(error)}.") from error


def _draw_of_complete(
    directory: ResultDirectory,
    specs: list[dict[str, Any]],
    progress: Progress | None,
    tell: Callable[[str], None] | None,
) -> None:
    """Draw the figures that a complete table lacks, none of which may hide by failing that it is complete."""
    rows = directory.n_rows
    safe = f"The run is complete ({rows} row{'s' * (rows != 1)} in {directory.path})"
    try:
        _draw_missing_figures(directory, specs, progress)
    except FigureError as error:
        raise FigureError(f"{safe}, but a figure is not drawn. {error}", error.drawn) from error
    except UserError as error:
        raise FigureError(f"{safe}, but its figures are not drawn. {error}", ()) from error
    except Exception:
        if tell is not None:
            tell(f"{safe}. What follows is a fault in drawing its figures.")
        raise


def _describe(ready: Prepared, directory: ResultDirectory) -> None:
    """Say in the manifest with what the rows are run."""
    directory.update_manifest(
        engine=ready.engine,
        device=ready.device,
        lanes=ready.work.lanes,
        precision=ready.work.numerics.precision,
        method=ready.work.numerics.method,
        dt=[float(np.min(ready.steps.dt)), float(np.max(ready.steps.dt))],
        quantities=_quantities(ready.work.model),
        versions=provenance.versions(),
        git_commit=provenance.git_commit(),
    )


def _run_missing(
    ready: Prepared, directory: ResultDirectory, missing: list[int], progress: Progress | None
) -> None:
    before = directory.rows_done + directory.rows_open
    _describe(ready, directory)
    spent = directory.manifest.get("timings", {})
    timings = Timings()

    def spent_so_far() -> dict[str, float]:
        return {name: value + spent.get(name, 0) for name, value in dataclasses.asdict(timings).items()}

    def write(number: int, block: BlockResult) -> None:
        frame = ready.frame(block)
        directory.write_part(number, frame)

    def tell(now: SweepProgress) -> None:
        if progress is not None:
            done, total = before + now.done, ready.work.n_rows
            rate = now.share * now.rows / now.seconds if now.seconds > 0 else 0.0
            note = f"{now.attempts / max(now.seconds, 1e-9) / 1e6:.1f} M attempts/s"
            progress(done, total, rate, (before + now.share * now.rows) / total, note)

    if progress is not None:
        progress(before, ready.work.n_rows, 0.0, before / ready.work.n_rows, "compiling")
    try:
        if refines(ready.job.run):
            refine(ready, directory, progress, timings)
        elif ready.job.run.kind == "continuation":
            follow_branches(ready, directory, missing, progress, timings)
        else:
            sweep(ready.work, missing, write, tell, timings, _Open(directory, spent_so_far))
    except BaseException:
        # what stopped the run is the news, not that the manifest cannot be written either
        with contextlib.suppress(TableError):
            _sum_up(ready, directory, spent_so_far())
        raise
    _sum_up(ready, directory, spent_so_far())


@dataclasses.dataclass
class _Open:
    """Where a sweep stores finished rows of open blocks: the directory, with the time that they took."""

    directory: ResultDirectory
    spent: Callable[[], dict[str, float]]

    def restored(self, number: int) -> EndedRows | None:
        return self.directory.restored(number)

    def keep(self, rows: EndedRows) -> None:
        self.directory.keep(rows)
        self.directory.update_manifest(timings=self.spent())


def _sum_up(ready: Prepared, directory: ResultDirectory, timings: dict[str, float]) -> None:
    """Write what is known of the rows so far into the manifest, all of it at once."""
    complete, counts = not directory.missing_blocks(), directory.counts()
    fields: dict[str, Any] = {"timings": timings, "counts": counts, "complete": complete}
    if complete:
        directory.tidy_digests()
        if counts.get(Status.event_stall.name):
            fields["stalls"] = stalls(load(directory.path))
        if _has_gaits(ready):
            gaits = load(directory.path)["gait"].value_counts()
            fields["gaits"] = {str(gait): int(n) for gait, n in gaits.items() if n}
    directory.update_manifest(**fields)


def _has_gaits(ready: Prepared) -> bool:
    return ready.job.run.kind in ("settle", "hold")


def _summed_up(ready: Prepared, directory: ResultDirectory) -> bool:
    """Whether the manifest of a table that has all its parts says so, and all else that a run adds."""
    known = directory.manifest
    return (
        known.get("complete") is True
        and known.get("counts") == directory.counts()
        and ("gaits" in known or not _has_gaits(ready))
        and ("stalls" in known or not directory.counts().get(Status.event_stall.name))
        and "quantities" in known
    )


def _draw_missing_figures(
    directory: ResultDirectory, specs: list[dict[str, Any]], progress: Progress | None
) -> None:
    """Draw the figures that a complete directory lacks; those that stand were drawn of the same rows."""
    drawn = directory.manifest.get("figures_drawn", {})
    by_name = {f"{spec.get('name') or spec['kind']}.png": spec for spec in specs}
    wanted = {
        name
        for name, spec in by_name.items()
        # one that shows another table too may have changed with that
        if spec.get("with_table")
        or name not in drawn
        or drawn[name] != _figure_digest(directory.path / FIGURES / name, spec)
    }
    if not wanted:
        return

    def between(number: int) -> None:
        if progress is not None:
            progress(directory.n_rows, directory.n_rows, 0.0, 1.0, f"figure {number} of {len(wanted)}")

    _draw(directory.path, wanted, between)
    now = {name: _figure_digest(directory.path / FIGURES / name, spec) for name, spec in by_name.items()}
    directory.update_manifest(figures_drawn={name: digest for name, digest in now.items() if digest})


def _figure_digest(file: Path, spec: dict[str, Any]) -> str | None:
    """What tells a figure that was drawn as asked from another, None where there is none."""
    try:
        drawn = read_file(file)
    except OSError:
        return None
    return hashlib.sha256(json.dumps([spec, version()], sort_keys=True).encode() + drawn).hexdigest()


def draw_figures(path: str | Path) -> list[Path]:
    """Draw the figures of a result directory from its table, without simulating.

    They are those of its `job.yaml`, where their titles and columns may be edited.

    Returns:
        The files, in the job's order.

    Raises:
        TableError: there is no table yet, or what `job.yaml` asks for is no figure.
        WriteError: a figure cannot be written; the old one stands.
        FigureError: the table does not give what some of them show; the others are drawn.
    """
    return _draw(Path(path))


def _draw(
    path: Path, names: set[str] | None = None, between: Callable[[int], None] | None = None
) -> list[Path]:
    """Draw the figures of a directory, or those with these file names; `between` is called before each."""
    snapshot, table = load_with_snapshot(path)
    specs = _figures_of(snapshot)
    if not specs:
        return []
    folder = path / FIGURES
    try:
        own_folder(folder)
    except OSError as error:
        raise not_written(f"{folder} cannot be made: {reason(error)}.", error) from error
    files, refused = [], []
    for number, spec in enumerate(specs):
        file = folder / f"{spec.get('name') or spec['kind']}.png"
        if names is not None and file.name not in names:
            continue
        if between is not None:
            between(len(files) + 1)
        given = {key: value for key, value in spec.items() if key not in ("kind", "name")}
        try:
            figure = draw(spec["kind"], table, **given)
        except UserError as error:
            refused.append(f"figures[{number}] ({spec['kind']}): {error}")
            continue
        try:
            replace_file(file, lambda stream, figure=figure: figure.savefig(stream, format="png", dpi=150))
        except OSError as error:
            raise not_written(f"{file} could not be written: {reason(error)}.", error) from error
        files.append(file)
    if refused:
        raise FigureError("\n".join(refused), files)
    return files


def _figures_of(snapshot: Snapshot) -> list[dict[str, Any]]:
    file = snapshot.path / JOB
    try:
        asked = snapshot.job.get("figures", [])
        if snapshot.job_edited or "job" not in snapshot.manifest:
            asked = read_document(file).data.get("figures", []) if file.exists() else []
        return read_figures(asked, str(file))
    except JobError as error:
        raise TableError(str(error)) from None


def _hash(job: Job, model: Model, **chosen: Any) -> str:
    """The job's hash, with the sources of a user's own model in it: edited, it is another job.

    The modules beside the user's that it imports are sources of the model too.
    """
    job_hash = job.hash(**chosen)
    module = inspect.getmodule(type(model))
    if module is None or module.__name__.startswith("gaitsweep."):
        return job_hash
    try:
        source = inspect.getsource(module)
    except (OSError, TypeError):
        return job_hash
    beside = modules_beside(module)
    beside.pop(module.__name__, None)
    found = hashlib.sha256((job_hash + source).encode(errors="replace"))
    with _told_by_file():
        for name in sorted(beside):
            found.update(f"\n# {name}\n".encode() + beside[name].read_bytes())
    return found.hexdigest()


def _quantities(model: Model) -> dict[str, dict[str, Any]]:
    """Unit, meaning and symbol of what the table's columns hold, for whoever reads it and for its figures."""
    named = {
        # a start stands in the table by its own name, an observable with _end or _n
        **{f"{q.name}_{end}": q for q in model.observables for end in ("end", "n")},
        **{q.name: q for q in (*model.parameters, *model.observables, *model.signals, *model.label_fields)},
        **{q.name: q for q in model.initial_conditions},
    }
    return {
        name: {"unit": q.unit, "meaning": q.meaning, "symbol": q.symbol, "circular": q.circular}
        for name, q in named.items()
    }
