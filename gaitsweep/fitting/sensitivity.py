"""Execution of a sensitivity analysis: its sets in a result directory, their indices, and a figure."""

from __future__ import annotations

import dataclasses
import math
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from jaxtyping import Int
from matplotlib.figure import Figure

from gaitsweep.angles import wrapped_difference
from gaitsweep.contract import Model
from gaitsweep.engine.sweep.blocks_of_rows import rows_of_a_block
from gaitsweep.engine.sweep.sweep_spec import SweepProgress
from gaitsweep.fitting.figures import sensitivity_figure, write_figure
from gaitsweep.fitting.fit_directory import ClusterRows, describe, open_directory
from gaitsweep.fitting.free_parameters import Sets, number_of_sets
from gaitsweep.fitting.measure import Measure, MeasuredByName, reasons_of_sets
from gaitsweep.fitting.population import Population
from gaitsweep.fitting.sensitivity_job import FAILURES, SensitivityJob
from gaitsweep.fitting.sensitivity_methods import Output, PerSet, indices, unwrapped
from gaitsweep.kinds.columns import quantities_of
from gaitsweep.runs import provenance
from gaitsweep.runs.execute import RESULTS
from gaitsweep.runs.executor import write_blocks
from gaitsweep.runs.progress import Progress
from gaitsweep.status import SetStatus
from gaitsweep.table import ResultDirectory, load, replace_file, writing
from gaitsweep.table.manifest import Layout

if TYPE_CHECKING:
    from gaitsweep.runs.cluster.dispatch import Cluster

INDICES_FILE = "indices.parquet"
FIGURE = "sensitivity.png"
# Rows of a batch on a cluster, at most: its job, which contains each set, is sent to every worker.
_ROWS_OF_A_BATCH = 2**15

# Share of an output's standard deviation by which a set may differ at half the step.
MAX_DIFFERENCE = 0.1
# Share of the sets that may differ without a warning.
_MAX_SHARE = 0.1


@dataclasses.dataclass(frozen=True)
class HalfStep:
    """Values of some sets at half the step, beside the table.

    `sets` is their number; `differ`, by output, the number that differ by more than MAX_DIFFERENCE of
    its standard deviation, or that have a value at one of the steps only; `largest` the largest difference,
    in the output's unit.
    """

    sets: int
    differ: dict[str, int]
    largest: dict[str, float]

    @property
    def many(self) -> bool:
        """Whether more than a tenth of the sets differ in an output."""
        return max(self.differ.values()) > _MAX_SHARE * self.sets

    @property
    def sentence(self) -> str:
        """Number of sets that differ, by output, and the largest difference."""
        outputs = [
            f"{name} in {number} (at most {self.largest[name]:.2g})"
            for name, number in self.differ.items()
            if number
        ]
        limit = "by more than a tenth of the output's standard deviation"
        if not outputs:
            return f"At half the step none of {self.sets} sets differs {limit}."
        return f"At half the step, of {self.sets} sets, these differ {limit}: {', '.join(outputs)}."


@dataclasses.dataclass(frozen=True)
class Sensitivity:
    """Result of a sensitivity analysis.

    `table`: one record a set: `row`, `status` (a `SetStatus`), `why`, the parameters and the outputs.
    `indices`: one record an index, as of `sensitivity_methods.indices`. `half_step` compares some sets with
    half the step; `path` is the result directory, None in memory.
    """

    table: pd.DataFrame
    indices: pd.DataFrame
    half_step: HalfStep | None = None
    path: Path | None = None

    def __repr__(self) -> str:
        complete = int(np.count_nonzero(SetStatus.COMPLETE.among(self.table)))
        outputs = ", ".join(map(str, self.indices["output"].unique()))
        place = "in memory" if self.path is None else f"in {self.path}"
        return f"Sensitivity({number_of_sets(len(self.table))}, {complete} complete: {outputs}; {place})"

    def figure(self) -> Figure:
        """Draw the indices as bars with their intervals, a panel for each output."""
        return sensitivity_figure(self.indices)


def run_sensitivity(
    job: SensitivityJob,
    out: str | Path | None = None,
    *,
    on_progress: Progress | None = None,
    on_message: Callable[[str], None] = lambda _: None,
    figures: bool = True,
    cluster: Cluster | None = None,
) -> Sensitivity:
    """Measure the sets that a directory still lacks, then compute and draw the indices.

    Args:
        job: the analysis.
        out: the result directory, `results/NAME` by default.
        on_progress: progress callback of the sets.
        on_message: called with each note and warning, a sentence.
        figures: draw the indices at the end.
        cluster: computes the rows, if this process does not; it is left open.

    Raises:
        RunError, TableError: the run cannot continue; rows on disk are safe, and the next run continues.
        KeyboardInterrupt: likewise.
    """
    path = RESULTS / job.name if out is None else Path(out)
    on_progress = on_progress or (lambda *_, **__: None)
    population = job.population()
    context = population.prepared({})
    n = job.design.n_rows
    rows_of_a_set = max(1, population.rows_of_a_set)  # a fixed point has no row
    block_size = rows_of_a_block(context.job.engine.block, n * rows_of_a_set)
    block = min(n, max(1, block_size // rows_of_a_set))
    resolved = job.resolved(context.job, context.engine)
    layout = Layout(job.hash(context.job_hash, block), n, block)
    with open_directory(path, resolved, layout, context, on_message) as directory:
        missing = directory.missing_blocks()
        if missing:
            salib = {"SALib": provenance.version_of("SALib")}
            describe(context, directory, _quantities(job, context.model), salib)
            together = 1
            if cluster is not None:
                population.run_elsewhere = ClusterRows(path, cluster)
                together = max(1, _ROWS_OF_A_BATCH // (block * rows_of_a_set))
            write_blocks(directory, _blocks(job, population, directory, missing, together, on_progress))
        if not directory.manifest.get("complete"):
            directory.tidy_digests()
            directory.update_manifest(counts=directory.counts(), complete=True)
        table = load(path)
        half_step = _at_half_the_step(job, population, directory, table, on_progress)
        if half_step is not None and half_step.many:
            on_message(f"Warning: {half_step.sentence}")
        on_progress(n, n, 0.0, 1.0, "indices")
        result = Sensitivity(table, _index_table(job, table, context.model), half_step, path)
        _write(result, path, figures=figures)
    return result


def _blocks(
    job: SensitivityJob,
    population: Population,
    directory: ResultDirectory,
    missing: list[int],
    together: int,
    on_progress: Progress,
) -> Iterator[tuple[int, pd.DataFrame]]:
    """Measure the sets of the missing blocks, and yield the records of each block.

    Args:
        job: the analysis.
        population: measures the sets.
        directory: its result directory.
        missing: numbers of the missing blocks.
        together: number of blocks whose sets are one batched run.
        on_progress: progress callback of the sets.
    """
    n = job.design.n_rows
    began = time.perf_counter()
    sets_before = directory.rows_done
    on_progress(sets_before, n, 0.0, sets_before / n, "compiling")
    for place in range(0, len(missing), together):
        numbers = missing[place : place + together]
        bounds = [directory.layout.rows_of(number) for number in numbers]
        rows = np.concatenate([np.arange(first, stop) for first, stop in bounds])
        done = directory.rows_done

        def on_sweep_progress(now: SweepProgress, done: int = done, size: int = rows.size) -> None:
            done_now = done + now.share * size
            rate = (done_now - sets_before) / max(time.perf_counter() - began, 1e-9)
            on_progress(math.floor(done_now), n, rate, done_now / n, f"{now.done} of {now.rows} rows")

        sets = {name: column[rows] for name, column in job.design.sets.items()}
        records = _records(rows, sets, population.measure(sets, on_sweep_progress))
        for number, (first, stop) in zip(numbers, bounds, strict=True):
            begin = int(np.searchsorted(rows, first))
            yield number, records.iloc[begin : begin + stop - first].reset_index(drop=True)


def _records(rows: Int[np.ndarray, " sets"], sets: Sets, measured: MeasuredByName) -> pd.DataFrame:
    """Return the records of the sets `rows` (n,): their status, and why outputs have no value."""
    why = reasons_of_sets(measured)
    return pd.DataFrame(
        {
            "row": rows.astype(np.int64),
            "status": SetStatus.column(np.array(why) != ""),
            **sets,
            **{name: output.values for name, output in measured.items()},
            "why": why,
        }
    )


def _quantities(job: SensitivityJob, model: Model) -> dict[str, dict[str, Any]]:
    """Return unit, meaning and symbol of the columns, by name."""
    of_model = quantities_of(model)
    quantities: dict[str, dict[str, Any]] = {name: of_model[name] for name in job.parameters}
    for name, measure in job.outputs.items():
        quantities[name] = {
            "unit": measure.unit(model),
            "meaning": _meaning(measure),
            "circular": measure.circular(model),
        }
    return quantities


def _meaning(measure: Measure) -> str:
    """Describe a measure: value of psi_1, at psi_1 1."""
    conditions = []
    for name, values in measure.at.items():
        points = " ".join(f"{value:g}" for value in values)
        conditions.append(f"{name} {points}")
    model_fields = type(measure).model_fields
    fields = {field.alias or name: getattr(measure, name) for name, field in model_fields.items()}
    settings = [f"{name} {value}" for name, value in fields.items() if name not in ("kind", "at")]
    return f"{' '.join([fields['kind'], *settings])}, at {', '.join(conditions)}"


def _at_half_the_step(
    job: SensitivityJob,
    population: Population,
    directory: ResultDirectory,
    table: pd.DataFrame,
    on_progress: Progress,
) -> HalfStep | None:
    """Compare some sets with half the step, or return the stored comparison; None if `verify` is 0.

    Args:
        job: the analysis.
        population: measures the sets.
        directory: its result directory, whose manifest stores the comparison.
        table: the complete table.
        on_progress: progress callback of the sets.
    """
    n = len(table)
    context = population.prepared({})
    count = min(context.job.verify, n)
    stored = directory.manifest.get("half_step")
    names = {field.name for field in dataclasses.fields(HalfStep)}
    if isinstance(stored, dict) and stored.keys() == names and stored["sets"] == count:
        return HalfStep(**stored)
    if count == 0:
        return None

    def on_sweep_progress(now: SweepProgress) -> None:
        on_progress(n, n, 0.0, 1.0, f"at half the step: {now.done} of {now.rows} rows")

    rows = np.unique(np.linspace(0, n - 1, count).round().astype(int))
    sets = {name: column[rows] for name, column in job.design.sets.items()}
    measured = population.measure(sets, on_sweep_progress, 0.5)
    differ: dict[str, int] = {}
    largest: dict[str, float] = {}
    for name, measure in job.outputs.items():
        output = Output(table[name].to_numpy(float), circular=measure.circular(context.model))
        differ[name], largest[name] = _compare(output, rows, measured[name].values)
    half_step = HalfStep(count, differ, largest)
    directory.update_manifest(half_step=dataclasses.asdict(half_step))
    return half_step


def _compare(output: Output, rows: Int[np.ndarray, " some"], at_half: PerSet) -> tuple[int, float]:
    """Return how many of some sets differ at half the step in an output, and the largest difference.

    Args:
        output: the values of all sets.
        rows: the rows (m,) of the sets that were measured again.
        at_half: their values (m,) at half the step.
    """
    values = output.values[rows]
    change = at_half - values
    if output.circular:
        change = wrapped_difference(change)
    has_lost_value = np.isnan(values) != np.isnan(at_half)
    sizes = np.abs(change[np.isfinite(change)])
    has_values = np.isfinite(output.values).any()
    limit = MAX_DIFFERENCE * np.nanstd(unwrapped(output)) if has_values else 0.0
    return int(has_lost_value.sum() + (sizes > limit).sum()), float(sizes.max(initial=0.0))


def _index_table(job: SensitivityJob, table: pd.DataFrame, model: Model) -> pd.DataFrame:
    """Compute the indices of a complete table; failures, if any, are another output."""
    outputs = {
        name: Output(table[name].to_numpy(float), measure.unit(model), measure.circular(model))
        for name, measure in job.outputs.items()
    }
    failed = SetStatus.FAILED.among(table)
    if failed.any():
        outputs[FAILURES] = Output(failed.astype(float))
    index_table = indices(job.design, outputs, job.analysis.seed)
    index_table.attrs["quantities"] = _quantities(job, model)
    return index_table


def _write(result: Sensitivity, path: Path, *, figures: bool) -> None:
    """Write the indices into a result directory, and their figure if asked to."""
    table = path / INDICES_FILE
    with writing(f"{table} could not be written"):
        options: dict[str, Any] = {"index": False, "write_page_checksum": True}
        replace_file(table, lambda file: result.indices.to_parquet(file, **options))
    if figures:
        write_figure(path, FIGURE, result.figure(), dpi=150)
