"""A continuation's run: the branches of each block of rows, and their records."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

import jax
import numpy as np
import pandas as pd

from gaitsweep.analysis.branches_on_the_way import Steps
from gaitsweep.analysis.continuation import continuation
from gaitsweep.contract import Status
from gaitsweep.engine.return_map import ReturnMap
from gaitsweep.engine.sweep import Timings
from gaitsweep.frames import STATUSES
from gaitsweep.job.figures import table_columns
from gaitsweep.job.runs import Continuation
from gaitsweep.table import ResultDirectory

if TYPE_CHECKING:
    from gaitsweep.runner import Prepared
    from gaitsweep.runner import Progress as RunProgress


def follow_branches(
    ready: Prepared,
    directory: ResultDirectory,
    missing: list[int],
    progress: RunProgress | None,
    timings: Timings,
) -> None:
    """Follow the branches of the blocks that a directory still lacks, and write the parts of its table.

    Args:
        ready: the job made ready.
        directory: its result directory.
        missing: numbers of blocks.
        progress: told when a block is done.
        timings: added to as blocks go.

    Raises:
        TableError: a part cannot be written.
        ValueError: the run fixes what the model does not conserve.
    """
    work, done = ready.work, 0
    for number in missing:
        began = time.perf_counter()
        first = number * work.block
        last = min(first + work.block, work.n_rows)
        directory.write_part(number, branches_of(ready, first, last))
        timings.run_s += time.perf_counter() - began
        done += last - first
        if progress is not None:
            rate = done / max(timings.run_s, 1e-9)
            progress(last, work.n_rows, rate, last / work.n_rows, "branches")


def branches_of(ready: Prepared, first: int, last: int) -> pd.DataFrame:
    """The records of the branches of rows first..last-1."""
    run, plan = ready.job.run, ready.plan
    assert isinstance(run, Continuation)
    parameters, starts = plan.values(first, last)
    following = plan.following(run.parameter)
    mapping = ReturnMap(
        plan.model,
        tuple((name, plan.derived[name]) for name in following),
        ready.work.numerics,
        ready.engine,
    )
    begin, end = run.path
    values = {name: each for name, each in parameters.items() if name not in following}
    points, _ = mapping.settled(starts, {**values, run.parameter: begin}, run.settle)
    del values[run.parameter]
    table = continuation(
        mapping,
        points,
        values,
        parameter=run.parameter,
        within=run.path,
        begin=begin,
        towards=1 if end > begin else -1,
        fix=run.fix,
        steps=Steps(run.step, run.longest, run.shortest, run.most),
        shown=(),
    )
    row = table["row"].to_numpy(np.int64)
    axes = {name: each[row] for name, each in plan.columns(first, last).items()}
    renamed = {q.name: f"{q.name}_n" for q in plan.model.observables}
    found = table["stable"].notna().to_numpy() if "stable" in table else np.zeros(len(table), bool)
    moved = {name: np.broadcast_to(each, (last - first,))[row] for name, each in values.items()}
    moved[run.parameter] = table[run.parameter].to_numpy(float)
    table["gait"] = _gaits(mapping, moved, table, found)
    status = np.where(found, Status.complete.name, Status.no_fixed_point.name)
    table = table.rename(columns=renamed).assign(row=row + first, **axes)
    table["status"] = pd.Categorical(status, categories=STATUSES)
    for name in ("special", "end"):
        table[name] = pd.Categorical(table[name].fillna(""))
    return table.reindex(columns=table_columns(plan.model, plan.names, run))


def _gaits(
    mapping: ReturnMap, values: dict[str, np.ndarray], table: pd.DataFrame, found: np.ndarray
) -> pd.Categorical:
    """The gait of each record, "none" or nothing where there is no fixed point."""
    model = mapping.model
    codes = np.full(len(table), model.gaits.index("none") if "none" in model.gaits else -1)
    if found.any():
        held = mapping.complete({name: each[found] for name, each in values.items()}, int(found.sum()))
        seen = {q.name: table.loc[found, q.name].to_numpy(float) for q in model.observables}
        label = jax.jit(jax.vmap(lambda v, o: model.label(mapping.params(v), o)["gait"]))
        codes[found] = np.asarray(label(held, seen))
    return pd.Categorical.from_codes(codes.tolist(), categories=list(model.gaits))
