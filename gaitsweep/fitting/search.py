"""Execution of a search: an optimiser chooses sets of constants, which are measured batch by batch.

Each batch is a part of the table, so a search that is stopped loses the running batches and continues from
the rest: the optimiser receives the same scores again, and has to ask for the same sets. Batches that do not
depend on each other are measured concurrently, each in a thread.
"""

from __future__ import annotations

import contextlib
import dataclasses
import io
import threading
import time
import warnings
from collections import deque
from collections.abc import Callable, Generator, Iterator
from concurrent.futures import Future, ThreadPoolExecutor, wait
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from jaxtyping import Bool, Shaped
from matplotlib.figure import Figure

from gaitsweep.angles import wrapped_difference
from gaitsweep.contract import Model
from gaitsweep.engine.sweep.sweep_spec import SweepProgress
from gaitsweep.fitting.figures import draw_search, search_figure
from gaitsweep.fitting.fit_directory import ClusterRows, describe, open_directory
from gaitsweep.fitting.free_parameters import Sets, number_of_sets, sets_at
from gaitsweep.fitting.identifiability import Identifiability, identifiability
from gaitsweep.fitting.measure import Measured, MeasuredByName, reasons_of_sets
from gaitsweep.fitting.optimisers import Optimiser, optimiser
from gaitsweep.fitting.population import Population
from gaitsweep.fitting.robustness import ROBUST, share_kept
from gaitsweep.fitting.search_job import SearchJob, read_search_field
from gaitsweep.fitting.targets import MISS, PerSet, scores
from gaitsweep.kinds.columns import quantities_of
from gaitsweep.runs import provenance
from gaitsweep.runs.execute import RESULTS
from gaitsweep.runs.executor import write_blocks
from gaitsweep.runs.progress import Progress, steps_per_second
from gaitsweep.schema.diagnostics import Diagnostic, refuse
from gaitsweep.status import SetStatus
from gaitsweep.table import ResultDirectory, TableError, load, load_with_snapshot
from gaitsweep.table.manifest import Layout

if TYPE_CHECKING:
    from gaitsweep.runs.cluster.dispatch import Cluster


_POLL_SECONDS = 0.1  # between two looks at the running batches
# The measures of a batch by name; None of a batch that is on disk.
Batch = MeasuredByName | None


class ConcurrentBatches:
    """Batches of sets that are measured side by side, each in a thread, and returned in the order of `begin`.

    A batch lasts as long as its slowest row. Near its end most lanes of a GPU would be idle, so other batches
    run meanwhile.

    Args:
        threads: batches that run at a time; others wait.
        on_progress: progress callback, called about ten times a second during `oldest` with the progress of
            each running batch; an exception that it raises is raised by `oldest`.
    """

    def __init__(self, threads: int, on_progress: Callable[[list[SweepProgress]], None]) -> None:
        self._threads = ThreadPoolExecutor(threads)
        self._on_progress = on_progress
        # each batch with a list of its latest progress, empty at first
        self._running: deque[tuple[Future[Batch], list[SweepProgress]]] = deque()
        self._stopped = threading.Event()

    def __enter__(self) -> ConcurrentBatches:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stopped.set()
        self._threads.shutdown(cancel_futures=True)

    def begin(self, measure: Callable[[Callable[[SweepProgress], None]], Batch]) -> None:
        """Measure a batch in a thread; `measure` receives a progress callback."""
        latest: list[SweepProgress] = []

        def on_progress(now: SweepProgress) -> None:
            if self._stopped.is_set():  # ends a thread whose result is no longer needed
                raise InterruptedError
            latest[:] = [now]

        self._running.append((self._threads.submit(measure, on_progress), latest))

    def oldest(self) -> Batch:
        """Wait for the batch that began first, of one or more that run, and return its result.

        Raises:
            Exception: what `measure` or the progress callback raised.
        """
        future, _ = self._running[0]
        while not future.done():
            wait([future], timeout=_POLL_SECONDS)
            self._on_progress([latest[0] for _, latest in self._running if latest])
        self._running.popleft()
        return future.result()


FINALISTS = "finalists.parquet"
# Packages whose versions decide which sets are chosen.
_DECIDING = ("numpy", "scipy", "cma", "pymoo")


@dataclasses.dataclass(frozen=True)
class SearchResult:
    """Result of a search.

    `path` is its directory; `table` has a row for each set; `identifiability` tells which constants the
    targets pin; `finalists` has the best sets at half the step; `figures` are the files drawn. In memory
    there is no path and no file.
    """

    job: SearchJob
    path: Path | None
    table: pd.DataFrame
    identifiability: Identifiability
    finalists: pd.DataFrame | None
    figures: tuple[Path, ...]

    def __repr__(self) -> str:
        best = self.identifiability.summary()["best_score"]
        score = "none complete" if best is None else f"least score {best:.4g}"
        place = "in memory" if self.path is None else f"in {self.path}"
        fitting = self.identifiability.fitting
        fit = f"{fitting} fit{'s' * (fitting == 1)} all targets"
        return f"SearchResult({number_of_sets(len(self.table))}: {score}, {fit}; {place})"

    def figure(self, name: str) -> Figure:
        """Draw a figure of the search.

        Args:
            name: convergence, constants or misses.

        Raises:
            ArgumentError: there is no figure of this name.
        """
        return search_figure(name, self.job, self.table, self.identifiability)


def run_search(
    job: SearchJob,
    out: str | Path | None = None,
    *,
    on_progress: Progress | None = None,
    on_message: Callable[[str], None] = lambda _: None,
    figures: bool = True,
    cluster: Cluster | None = None,
) -> SearchResult:
    """Measure the sets that a search's directory still lacks, and find which constants they pin.

    Args:
        job: the search.
        out: its result directory, `results/NAME` by default.
        on_progress: progress callback.
        on_message: called with each note and warning, a sentence.
        figures: draw the figures at the end.
        cluster: computes the rows, if this process does not; it is left open.

    Raises:
        RunError, TableError: the search cannot continue; measured sets are safe, and the next run continues.
        KeyboardInterrupt: likewise.
    """
    path = RESULTS / job.name if out is None else Path(out)
    on_progress = on_progress or (lambda *_, **__: None)
    population = job.fit.population()
    context = population.prepared(job.fit.structures[0])
    versions = {name: provenance.version_of(name) for name in _DECIDING}
    together = job.sets_together(context, population.rows_of_a_set)
    side_by_side = job.batches_side_by_side(context)
    job_hash = job.hash(
        device=context.spec.devices[0].platform,
        engine=context.engine,
        population=together,
        side_by_side=side_by_side,
        versions=versions,
    )
    layout = Layout(job_hash, job.options.budget, together)
    with open_directory(path, job.written, layout, context, on_message) as directory:
        describe(context, directory, _quantities(job, context.model), versions)
        if cluster is not None:
            population.run_elsewhere = ClusterRows(path, cluster)
        search = _Search(job, population, context.model, directory, on_progress, side_by_side)
        with contextlib.closing(search.blocks()) as blocks:  # an error while writing ends its threads, too
            write_blocks(directory, blocks)
        table = load(path)
        near_best = identifiability(table, job)
        notes_before = len(directory.notes)
        finalists = search.finalists(near_best.best)
        for note in directory.notes[notes_before:]:
            on_message(note)
        if (warning := _depends_on_the_step(job, context.model, finalists)) is not None:
            on_message(f"Warning: {warning}")
        directory.update_manifest(complete=True, counts=directory.counts(), search=near_best.summary())
        drawn = draw_search(path, job, table, near_best) if figures else []
    return SearchResult(job, path, table, near_best, finalists, tuple(drawn))


def draw_again(path: Path) -> list[Path]:
    """Draw the figures of a search again from its table, which need not be complete.

    Args:
        path: its result directory.

    Raises:
        JobError, TableError: the directory is not that of a search, or its table cannot be read.
    """
    snapshot, table = load_with_snapshot(path)
    wrong: list[Diagnostic] = []
    search = read_search_field(snapshot.job, wrong)
    refuse(wrong)
    return draw_search(path, search, table, identifiability(table, search))


@dataclasses.dataclass
class _Search:
    """Execution of a search in its open directory: its batches, on disk and to come, and its finalists.

    Args:
        job: the search.
        population: measures the sets.
        model: the model.
        directory: its result directory.
        on_progress: progress callback.
        side_by_side: number of batches that run at a time.
    """

    job: SearchJob
    population: Population
    model: Model
    directory: ResultDirectory
    on_progress: Progress
    side_by_side: int

    def __post_init__(self) -> None:
        options = self.job.options
        self.optimiser: Optimiser = optimiser(
            options.method,
            dimension=len(self.job.free),
            targets=len(self.job.counted),
            start=self.job.start,
            together=self.directory.manifest["block"],
            seed=options.seed,
            known_points=self.job.known_points(),
            width=options.width,
        )
        self.stored = pd.DataFrame()  # the sets that were on disk when this run began
        self.sets_before = self.directory.rows_done  # their number
        self.began = time.perf_counter()
        self.best = np.inf  # the least score so far

    def blocks(self) -> Generator[tuple[int, pd.DataFrame]]:
        """Give the scores of the stored sets to the optimiser, and yield the batches that are not on disk.

        A batch is chosen when all but the `side_by_side - 1` before it are known, on disk or not, so the sets
        do not depend on where a search was stopped.
        """
        missing = set(self.directory.missing_blocks())
        if len(missing) < len(self.directory.layout.blocks):
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", UserWarning)  # about missing rows
                self.stored = load(self.directory.path)
        chosen: deque[tuple[int, Sets]] = deque()
        # a cluster takes one batch at a time
        threads = 1 if self.population.run_elsewhere is not None else self.side_by_side
        with ConcurrentBatches(threads, self._report) as batches:
            for number in self.directory.layout.blocks:
                if len(chosen) == self.side_by_side:
                    yield from self._end(batches, *chosen.popleft())
                first, stop = self.directory.layout.rows_of(number)
                sets = sets_at(self.job.free, self.optimiser.ask(stop - first))
                chosen.append((number, sets))
                batches.begin(partial(self._measure_batch, sets) if number in missing else _on_disk)
            while chosen:
                yield from self._end(batches, *chosen.popleft())

    def _measure_batch(self, sets: Sets, on_progress: Callable[[SweepProgress], None]) -> MeasuredByName:
        """Measure the sets of a batch."""
        first = self.job.options.first
        if first:
            measured = self.population.staged_evaluate(sets, first, self._is_measured_further, on_progress)
        else:
            measured = self.population.measure(sets, on_progress)
        return measured | self._robustness(sets, measured, on_progress)

    def _is_measured_further(self, first: MeasuredByName) -> Bool[np.ndarray, " sets"]:
        """Return a mask of the sets (n,) whose first targets have values that are near enough."""
        within = self.job.options.first_within
        has_value = np.all([measured.why == "" for measured in first.values()], axis=0)
        return has_value & self._misses_at_most(np.inf if within is None else within, first)

    def _misses_at_most(self, most: float, measured: MeasuredByName) -> Bool[np.ndarray, " sets"]:
        """Return a mask of the sets (n,) that miss none of the measured targets by more than `most`."""
        misses = [self.job.targets[name].misses(result, self.model) for name, result in measured.items()]
        return np.all(np.abs(misses) <= most, axis=0)

    def _end(self, batches: ConcurrentBatches, number: int, sets: Sets) -> Iterator[tuple[int, pd.DataFrame]]:
        """Yield a batch that is not on disk, and give its scores to the optimiser."""
        measured = batches.oldest()
        first, stop = self.directory.layout.rows_of(number)
        if measured is None:
            frame = self._stored_batch(first, stop, sets)
        else:
            frame = self._frame(number, first, sets, measured)
            yield number, frame
        misses = frame[[f"{MISS}{name}" for name in self.job.counted]].to_numpy()
        batch_scores = frame["score"].to_numpy()
        self.optimiser.tell(batch_scores, misses)
        self.best = min(self.best, float(batch_scores.min()))

    def _report(self, batches: list[SweepProgress]) -> None:
        """Report an upper estimate of the progress, since rows that are not needed are left out."""
        total = self.directory.layout.rows
        rows_per_set = self.population.rows_of_a_set
        new = self.directory.rows_done - self.sets_before
        new += sum(int(now.share * now.rows / rows_per_set) for now in batches)
        rate = new / max(time.perf_counter() - self.began, 1e-9)
        best = f"best score {self.best:.3g}, " if np.isfinite(self.best) else ""
        rate_of_steps = sum(now.attempts / max(now.seconds, 1e-9) for now in batches)
        done = min(self.sets_before + new, total)
        note = f"{best}{steps_per_second(rate_of_steps)}"
        self.on_progress(done, total, rate, done / total, note)

    def _frame(self, generation: int, first: int, sets: Sets, measured: MeasuredByName) -> pd.DataFrame:
        """Return the records of a batch."""
        targets = self.job.targets
        misses = self._misses(measured)
        n = next(iter(misses.values())).size
        failed = np.any([measured[name].why != "" for name in self.job.counted], axis=0)
        frame: dict[str, Any] = {
            "row": np.arange(first, first + n, dtype=np.int64),
            "generation": np.full(n, generation),
            **{name: _plain(column) for name, column in sets.items()},
            **{name: target.shown(measured[name].values, self.model) for name, target in targets.items()},
            **{f"{MISS}{name}": miss for name, miss in misses.items()},
            "score": scores(misses, targets),
            "status": SetStatus.column(failed),
            "why": pd.Series(reasons_of_sets(measured), dtype="str"),
        }
        return pd.DataFrame(frame)

    def _misses(self, measured: MeasuredByName) -> dict[str, PerSet]:
        """Return the misses (n,) of each target."""
        return {name: target.misses(measured[name], self.model) for name, target in self.job.targets.items()}

    def _stored_batch(self, first: int, stop: int, sets: Sets) -> pd.DataFrame:
        """Return the records of a batch on disk, whose sets have to be those of the optimiser."""
        frame = self.stored.iloc[np.searchsorted(self.stored["row"], np.arange(first, stop))]
        for name, column in sets.items():
            if not np.array_equal(np.asarray(frame[name]), np.asarray(_plain(column))):
                raise TableError(
                    f"The sets in {self.directory.path} differ from this search's from row {first} on: "
                    "it was begun on another machine or by another version. Continue it there, or start again"
                    " with --out."
                )
        return frame

    def _robustness(
        self,
        sets: Sets,
        measured: MeasuredByName,
        on_progress: Callable[[SweepProgress], None] | None = None,
        share: float = 1.0,
    ) -> MeasuredByName:
        """Measure the share of neighbours that keep targets, of sets that keep them; empty without `robust`.

        Args:
            sets: the sets.
            measured: their results.
            on_progress: progress callback of the rows.
            share: the length of steps as a share of the job's own.
        """
        robust = self.job.options.robust
        if robust is None:
            return {}

        def keep_targets(results: MeasuredByName) -> Bool[np.ndarray, " sets"]:
            return self._misses_at_most(1.0, {name: results[name] for name in robust.targets})

        def on_neighbours(now: SweepProgress) -> None:
            if on_progress is not None:  # rows of neighbours are not those of the batch's own sets
                on_progress(dataclasses.replace(now, rows=0))

        keeps = keep_targets(measured)
        values = np.full(keeps.size, np.nan)
        if keeps.any():
            population = self.population.of(robust.targets)
            values[keeps] = share_kept(
                robust,
                {name: column[keeps] for name, column in sets.items()},
                own=self.job.changing,
                free=self.job.free,
                quantities=self.job.fit.spec.quantities,
                keeps=lambda neighbours: keep_targets(population.measure(neighbours, on_neighbours, share)),
            )
        return {ROBUST: Measured(values, np.where(keeps, "", "the set itself does not keep the targets"))}

    def finalists(self, best: pd.DataFrame) -> pd.DataFrame | None:
        """Measure the best sets again at half the step, and write the result beside the table.

        Args:
            best: records of the near-best sets, the best first.

        Returns:
            The finalists, or None without any; those of an earlier run if they are the same sets.
        """
        job = self.job
        count = min(job.options.finalists, len(best))
        if not count:
            return None
        frame = best.iloc[:count][["row", *job.free, "score", *job.targets]].reset_index(drop=True)
        stored = self.directory.read_beside(FINALISTS)
        if stored is not None:
            stored_frame = pd.read_parquet(io.BytesIO(stored))
            if np.array_equal(stored_frame["row"], frame["row"]):
                return stored_frame
        total = job.options.budget
        self.on_progress(total, total, 0.0, 1.0, f"{count} finalists at half the step")
        sets = {name: free.column(frame[name].tolist()) for name, free in job.free.items()}
        measured = self.population.measure(sets, share=0.5)
        measured |= self._robustness(sets, measured, share=0.5)
        frame["score_half"] = scores(self._misses(measured), job.targets)
        for name, target in job.targets.items():
            frame[f"{name}_half"] = target.shown(measured[name].values, self.model)
        file = io.BytesIO()
        frame.to_parquet(file, index=False, write_page_checksum=True)
        self.directory.write_beside(FINALISTS, file.getvalue())
        return frame


def _on_disk(on_progress: Callable[[SweepProgress], None]) -> None:
    """Measure nothing, for a batch that is on disk and keeps its place among the others."""


def _depends_on_the_step(job: SearchJob, model: Model, finalists: pd.DataFrame | None) -> str | None:
    """Return a warning if half the step moves a finalist by more than a reading error, else None."""
    if finalists is None:
        return None
    moved = {}
    for name in job.counted:
        target = job.targets[name]
        change = (finalists[f"{name}_half"] - finalists[name]).to_numpy(float)
        if target.measure.circular(model):
            change = wrapped_difference(change)
        # NaN, where one of the steps gives no value, counts as moved
        moved[name] = int(np.sum(~(np.abs(change) <= target.value.error)))
    counts = ", ".join(f"{name} of {number}" for name, number in moved.items() if number)
    if not counts:
        return None
    return (
        f"half the step moves targets by more than their reading errors ({counts}, of {len(finalists)} "
        f"finalists, {FINALISTS}): search again with a smaller numerics.dt, or with located events."
    )


def _quantities(job: SearchJob, model: Model) -> dict[str, dict[str, Any]]:
    """Return unit and meaning of the columns, by name."""
    of_model = quantities_of(model)
    quantities: dict[str, dict[str, Any]] = {name: of_model[name] for name in job.free if name in of_model}
    for name, target in job.targets.items():
        measure = target.measure
        quantities[name] = {
            "unit": measure.unit(model),
            "meaning": type(measure).model_fields["kind"].description,
            "circular": measure.circular(model),
        }
        quantities[f"{MISS}{name}"] = {"unit": "1", "meaning": f"miss of {name}, in reading errors"}
    quantities["score"] = {"unit": "1", "meaning": "root mean square of the misses, in reading errors"}
    return quantities


def _plain(column: Shaped[np.ndarray, " sets"]) -> Any:
    """Convert a column for a table: choices of structure that are words become text."""
    return column if column.dtype.kind in "fi" else np.array([str(value) for value in column], object)
