"""The self-check of a run, after its rows or while they run."""

from __future__ import annotations

import threading
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait
from typing import Any, Self

import numpy as np
import pandas as pd
from jaxtyping import Int

from gaitsweep.compiling_threads import purpose_of_compiling
from gaitsweep.engine.sweep.sweep_spec import SweepProgress
from gaitsweep.kinds.perturb import NOT_PUSHED, Perturb
from gaitsweep.row_outcome import RowOutcome
from gaitsweep.runs.prepare import RunContext
from gaitsweep.runs.progress import Progress
from gaitsweep.runs.self_check import RerunRows, add_rows, compare_stored, look_at_unsettled, self_check
from gaitsweep.runs.self_check_result import SelfCheck, most_added, rows_to_repeat
from gaitsweep.runs.sentences import SELF_CHECK_SECONDS
from gaitsweep.status import RECURRENT, Status, StatusNames
from gaitsweep.table import Table

# Rows whose ends finer steps should reproduce.
_COMPARABLE = StatusNames(Status.SOUND - RECURRENT - {Status.inferred.name})
_PURPOSE = "the self-check (`verify: 0` turns it off)"  # of compilations, in the progress


class ConcurrentSelfCheck:
    """The self-check of a run: after its rows, or at the same time in a thread once `begin` was called.

    Its exceptions are raised by `result`. Its rows have their own lanes; the table is read at the end.

    Args:
        context: the job's context.
        table: its table.
    """

    def __init__(self, context: RunContext, table: Table) -> None:
        self._context = context
        self._table = table
        self._rows = rows_to_repeat(context)
        self._thread = ThreadPoolExecutor(1)
        self._begun: Future[tuple[SelfCheck | None, RerunRows | None]] | None = None
        self._abandoned = threading.Event()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self._abandoned.set()
        self._thread.shutdown()

    def begin(self) -> None:
        """Begin the self-check now, in a thread."""

        def stop_if_abandoned(_: SweepProgress) -> None:
            if self._abandoned.is_set():  # the rows have been stopped, and nobody reads its result
                raise InterruptedError

        if self._known is None:
            self._begun = self._thread.submit(self_check, self._context, self._rows, stop_if_abandoned)

    def result(self, on_progress: Progress) -> dict[str, Any]:
        """Return the result for a complete table: the stored one, or that of a new self-check."""
        if self._known is not None:
            return self._known
        total = self._context.spec.n_rows
        began = time.perf_counter()

        def on_sweep_progress(now: SweepProgress) -> None:
            task = now.note or f"{now.rows} reruns of rows"
            seconds = time.perf_counter() - began
            note = f"self-check for {seconds:.0f} s (`verify: 0` turns it off): {now.share:.0%} of {task}"
            on_progress(total, total, 0.0, 1.0, note)

        if self._begun is None:
            with purpose_of_compiling(_PURPOSE):
                check, rerun = self_check(self._context, self._rows, on_sweep_progress)
        else:
            while not self._begun.done():
                # a call at which Ctrl-C is obeyed
                on_progress(total, total, 0.0, 1.0, "self-check (`verify: 0` turns it off)")
                wait([self._begun], timeout=0.1)
            check, rerun = self._begun.result()
        if check is not None and rerun is not None:
            with purpose_of_compiling(_PURPOSE):
                if (more := self._comparable_rows(rerun)).size:
                    rerun = add_rows(self._context, check, rerun, more, on_sweep_progress)
                compare_stored(self._context, check, rerun, self._stored, on_sweep_progress)
                look_at_unsettled(self._context, check, self._at_cycle_limit(), on_sweep_progress)
        timings = dict(self._table.manifest.get("timings", {}))
        if check is None:
            judged: dict[str, Any] = {"rows": 0, "verdict": "off"}
        else:
            judged = check.judged()
            timings[SELF_CHECK_SECONDS] = time.perf_counter() - began
        self._table.update_manifest(self_check=judged, timings=timings)
        return judged

    def _stored(self, rows: Int[np.ndarray, " rows"]) -> pd.DataFrame:
        """The stored records of rows."""
        return self._table.load(rows)

    def _comparable_rows(self, rerun: RerunRows) -> Int[np.ndarray, " rows"]:
        """Evenly spread rows that ended soundly, if none of the rerun rows did; no more than those."""
        result, most = rerun.result, most_added(self._context, self._rows)
        if not (most and isinstance(result, RowOutcome)) or _COMPARABLE.among(result.status).any():
            return np.zeros(0, np.int64)
        rows = np.setdiff1d(self._rows_with({"status": sorted(_COMPARABLE)}), rerun.rows)
        return rows[np.linspace(0, rows.size - 1, min(most, rows.size)).astype(int)]

    def _at_cycle_limit(self) -> Int[np.ndarray, " rows"]:
        """The rows that ended as `cycle_limit`, none of them pushed."""
        wanted = {"status": [Status.cycle_limit.name]}
        if isinstance(self._context.job.run, Perturb):  # a rerun of crossings makes no push
            wanted["recovery"] = [NOT_PUSHED]
        return self._rows_with(wanted)

    def _rows_with(self, wanted: Mapping[str, Sequence[str]]) -> Int[np.ndarray, " rows"]:
        """The rows with one of the given names in each of some columns, `status` among them."""
        if not any(map(self._table.counts().get, wanted["status"])):
            return np.zeros(0, np.int64)
        numbers = []
        for part in self._table.load_parts(["row", *wanted]):
            chosen = np.logical_and.reduce([part[name].isin(names) for name, names in wanted.items()])
            numbers.append(part.loc[chosen, "row"].unique())
        return np.concatenate(numbers).astype(np.int64)

    @property
    def _known(self) -> dict[str, Any] | None:
        """Result of an earlier self-check with the same number of rows, or None."""
        before = self._table.manifest.get("self_check")
        if not isinstance(before, dict) or "rows" not in before:
            return None
        return before if before["rows"] - before.get("added", 0) == self._rows else None
