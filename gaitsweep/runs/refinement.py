"""A settle run that simulates the edges of basins only, in rounds, and its table of all rows.

The rows of a round follow from the labels of the rounds before it. Each round has its own result directory,
`refinement/round-00` and so on, so that an interrupted run continues inside the round in which it was
stopped; `gaitsweep/engine/sweep/boundary_cells.py` chooses its cells. The parts of the job's table are
written once every cell is decided: simulated rows with their results, the others with status `inferred` and
the gait of their box.
"""

from __future__ import annotations

import collections
import dataclasses
import hashlib
from collections.abc import Callable, Sequence

import numpy as np
import pandas as pd
from jaxtyping import Int, Shaped

from gaitsweep.contract import names_gait
from gaitsweep.engine.sweep.boundary_cells import ALONE, UNKNOWN, Grid, inferred, wanted
from gaitsweep.engine.sweep.sweep import Timings
from gaitsweep.engine.sweep.sweep_spec import SweepProgress
from gaitsweep.row_outcome import RowOutcome
from gaitsweep.runs.executor import Executor, MissingBlocks
from gaitsweep.runs.prepare import RunContext, row_values
from gaitsweep.runs.progress import Progress, so_far
from gaitsweep.status import Status
from gaitsweep.table import ResultDirectory, load
from gaitsweep.table.frames import with_same_categories
from gaitsweep.table.manifest import Layout

Rows = Int[np.ndarray, " rows"]  # numbers of rows
Labels = Int[np.ndarray, " rows"]  # the number of each row's gait
FOLDER = "refinement"
_MOST_SHARE = 0.99  # of the work, shown before the end: another round may follow


def some_rows(context: RunContext, n_rows: int, rows_in: Callable[[int, int], Rows]) -> RunContext:
    """Return the context of a run in which only `n_rows` rows are simulated, those of `rows_in`."""
    values = row_values(context.design, context.job.run, context.spec.numerics, context.steps, rows_in)
    spec = dataclasses.replace(context.spec, n_rows=n_rows, values=values)
    return dataclasses.replace(context, spec=spec, rows_in=rows_in)


@dataclasses.dataclass(frozen=True)
class Refinement:
    """The rounds of a refined run, and the parts of its table.

    Args:
        context: the job's context.
        grid: the grid of its rows, and the axes that are refined.
        directory: its result directory.
        executor: computes the blocks.
    """

    context: RunContext
    grid: Grid
    directory: ResultDirectory
    executor: Executor

    def run(self, on_progress: Progress, timings: Timings) -> None:
        """Run the rounds that the directory still lacks, and write the parts of its table.

        Args:
            on_progress: progress callback, in simulated rows.
            timings: added to as rounds go.

        Raises:
            TableError: a round's folder is not this job's, or cannot be written.
        """
        known = np.full(self.grid.lengths, UNKNOWN, np.int32)
        frames: list[pd.DataFrame] = []
        gaits: collections.Counter[str] = collections.Counter()  # of simulated rows
        simulated = 0  # rows of earlier rounds
        reached = 0.0  # the largest share that was reported
        halvings = sum(1 for _ in self.grid.levels())

        def on_sweep_progress(now: SweepProgress) -> None:
            nonlocal reached
            done = simulated + now.share * now.rows
            rounds_left = max(halvings - len(frames), 0)  # each taken to be as long as this one
            share = done / (simulated + (1 + rounds_left) * now.rows)
            reached = max(reached, min(share, _MOST_SHARE))
            place = "between unlike neighbours" if frames else "of a coarse grid"
            note = f"round {len(frames) + 1} simulates {now.rows} rows {place}"
            note += so_far(dict(gaits.most_common()))
            on_progress(simulated + now.done, known.size, now.rate, reached, note)

        while (rows := np.flatnonzero(wanted(known, self.grid))).size:
            frame = self._round(len(frames), rows, on_sweep_progress, timings)
            known.reshape(-1)[rows] = _labels(frame, self.context.model.gaits)
            frames.append(frame)
            gaits.update(str(gait) for gait in frame["gait"].dropna())
            simulated += rows.size
            self.directory.update_manifest(refinement={"rounds": len(frames), "simulated": simulated})
        simulated_rows = pd.concat(with_same_categories(frames)).sort_values("row")
        self._write_parts(simulated_rows, inferred(known, self.grid).reshape(-1))
        on_progress(known.size, known.size, 0.0, 1.0, f"{known.size - simulated} rows are inferred")

    def _round(
        self, number: int, rows: Rows, on_sweep_progress: Callable[[SweepProgress], None], timings: Timings
    ) -> pd.DataFrame:
        """Return the records of `rows` (n,), simulating those that are missing."""
        context = self.context
        round_context = some_rows(context, rows.size, lambda first, stop: rows[first:stop])
        path = self.directory.path / FOLDER / f"round-{number:02d}"
        job = {"round": number, "of": context.job.name}
        round_hash = hashlib.sha256(context.job_hash.encode() + rows.astype("<i8").tobytes()).hexdigest()
        with ResultDirectory.open(path, job, Layout(round_hash, rows.size, context.spec.block)) as part:
            if missing := part.missing_blocks():
                spent = Timings()
                try:
                    blocks = MissingBlocks(round_context, part, missing, on_sweep_progress, spent, part)
                    self.executor.run_blocks(blocks)
                    part.tidy_digests()
                finally:
                    for name, value in dataclasses.asdict(spent).items():
                        setattr(timings, name, getattr(timings, name) + value)
            frame = load(path)
        frame.attrs.clear()
        frame["row"] = rows[frame["row"].to_numpy()]
        return frame

    def _write_parts(self, simulated: pd.DataFrame, labels: Labels) -> None:
        """Write the missing parts from the simulated rows and the labels (n,) of all rows."""
        at = simulated["row"].to_numpy()
        for number in self.directory.missing_blocks():
            start, stop = self.directory.layout.rows_of(number)
            own_rows = simulated.iloc[np.searchsorted(at, start) : np.searchsorted(at, stop)]
            others = np.setdiff1d(np.arange(start, stop, dtype=np.int64), own_rows["row"])
            filled = self._inferred_frame(others, labels[others], simulated)
            parts = [part for part in with_same_categories([own_rows, filled]) if len(part)]
            frame = parts[0] if len(parts) == 1 else pd.concat(parts)
            self.directory.write_part(number, frame.sort_values("row", ignore_index=True))

    def _inferred_frame(self, rows: Rows, gaits: Labels, like: pd.DataFrame) -> pd.DataFrame:
        """Return records of rows (n,) that were not simulated: the gait of their neighbours, no numbers.

        Args:
            rows: the rows.
            gaits: their gaits (n,).
            like: records of simulated rows, which have the types of the label fields.
        """
        model = self.context.model

        def no_values(name: str) -> Shaped[np.ndarray, " rows"]:
            """A label field of rows without a label."""
            if names_gait(name):
                return np.full(rows.size, -1)
            dtype = like[name].to_numpy().dtype
            return np.full(rows.size, np.nan if dtype.kind == "f" else 0, dtype)

        fields = {quantity.name: no_values(quantity.name) for quantity in model.label_fields}
        numbers = self.context.spec.recorder.numbers
        nothing = RowOutcome.empty(rows, numbers, len(model.observables)).take(np.arange(rows.size))
        nothing.status[:] = Status.inferred
        labels = {"gait": gaits, **fields}
        return self.context.table(dataclasses.replace(nothing, labels=labels))


def _labels(frame: pd.DataFrame, gaits: Sequence[str]) -> Labels:
    """Return the label of each row (n,): its gait's number, or ALONE for a row without a fixed point."""
    gait = frame["gait"].cat.set_categories(list(gaits)).cat.codes.to_numpy()
    # the gait of an orbit of several cycles is that of one of its points: nothing to infer others from
    fixed = Status.SOUND.among(frame["status"])
    if "attractor_period" in frame.columns:  # a round may be older than the column
        fixed = fixed & (frame["attractor_period"] == 1).to_numpy()
    return np.where(fixed & (gait >= 0), gait, ALONE)
