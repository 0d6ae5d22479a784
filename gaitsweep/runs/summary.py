"""What the manifest of a run says: how the rows were run, how they ended, and what the columns hold."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd

from gaitsweep.analysis.chain.largest_distance import largest_distance
from gaitsweep.contract import Model, Status
from gaitsweep.kinds.columns import Column
from gaitsweep.kinds.run_kind import table_columns
from gaitsweep.runs import provenance
from gaitsweep.runs.prepare import Prepared
from gaitsweep.table import ResultDirectory, load


def describe(ready: Prepared, directory: ResultDirectory) -> None:
    """Say in the manifest with what the rows are run."""
    directory.update_manifest(
        engine=ready.engine,
        device=ready.device,
        lanes=ready.work.lanes,
        precision=ready.work.numerics.precision,
        method=ready.work.numerics.method,
        dt=[float(np.min(ready.steps.dt)), float(np.max(ready.steps.dt))],
        quantities=quantities_of(ready.work.model, ready.job.run.columns(ready.work.model)),
        versions=provenance.versions(),
        git_commit=provenance.git_commit(),
    )


def sum_up(ready: Prepared, directory: ResultDirectory, timings: dict[str, float]) -> None:
    """Write what is known of the rows so far into the manifest, all of it at once."""
    complete, counts = not directory.missing_blocks(), directory.counts()
    fields: dict[str, Any] = {"timings": timings, "counts": counts, "complete": complete}
    if complete:
        directory.tidy_digests()
        if counts.get(Status.event_stall.name):
            fields["stalls"] = stalls(load(directory.path))
        if _counts_gaits(ready):
            gaits = load(directory.path)["gait"].value_counts()
            fields["gaits"] = {str(gait): int(n) for gait, n in gaits.items() if n}
        if _has_distance(ready):
            far = largest_distance(load(directory.path))
            fields["largest_distance"] = {} if far is None else {"rad": far[0], "row": far[1]}
    directory.update_manifest(**fields)


def summed_up(ready: Prepared, directory: ResultDirectory) -> bool:
    """Whether the manifest of a table that has all its parts says so, and all else that a run adds."""
    known = directory.manifest
    return (
        known.get("complete") is True
        and known.get("counts") == directory.counts()
        and ("gaits" in known or not _counts_gaits(ready))
        and ("largest_distance" in known or not _has_distance(ready))
        and ("stalls" in known or not directory.counts().get(Status.event_stall.name))
        and "quantities" in known
    )


def _counts_gaits(ready: Prepared) -> bool:
    return ready.job.run.one_a_row and "gait" in table_columns(ready.plan, ready.job.run)


def _has_distance(ready: Prepared) -> bool:
    """Whether rows say how far they settle from analytic solutions, as the multi-legged chain's do."""
    known = table_columns(ready.plan, ready.job.run)
    return ready.job.run.one_a_row and {"distance", "gait"} <= set(known)


def stalls(table: pd.DataFrame) -> dict[str, dict[str, Any]]:
    """What stalled the rows that ended as `event_stall`: for each set of guards, how many rows and when.

    `rows`, and `t` the earliest and the latest time (s) at which one of them stalled; of tables that have no
    `t_end`, those of the rows' last records, `after` which they did.
    """
    if "stalled_by" not in table.columns:
        return {}
    stalled = table[table["stalled_by"].notna()]
    time = "t_end" if "t_end" in table.columns else "t"
    last = stalled.groupby("row").agg(by=("stalled_by", "last"), t=(time, "max"))
    by, at = np.asarray(last["by"].astype(str)), np.asarray(last["t"], np.float64)
    found: dict[str, dict[str, Any]] = {}
    for names in np.unique(by):
        when = at[(by == names) & np.isfinite(at)]
        span = [float(when.min()), float(when.max())] if when.size else []
        found[str(names)] = {
            "rows": int(np.count_nonzero(by == names)),
            "t" if time == "t_end" else "after": span,
        }
    return found


def quantities_of(model: Model, columns: Sequence[Column] = ()) -> dict[str, dict[str, Any]]:
    """Unit, meaning and symbol of what the table's columns hold, for whoever reads it and for its figures."""
    named = {
        **{column.name: column.quantity for column in columns if column.quantity is not None},
        # a start stands in the table by its own name, an observable with _end or _n
        **{f"{q.name}_{end}": q for q in model.observables for end in ("end", "n")},
        **{q.name: q for q in (*model.parameters, *model.observables, *model.signals, *model.label_fields)},
        **{q.name: q for q in model.initial_conditions},
    }
    return {
        name: {"unit": q.unit, "meaning": q.meaning, "symbol": q.symbol, "circular": q.circular}
        for name, q in named.items()
    }
