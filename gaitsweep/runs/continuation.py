"""A continuation's run: the branches of each block of rows, and their records."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import jax
import numpy as np
import pandas as pd

from gaitsweep.analysis.continuation.branch_follower import Steps
from gaitsweep.analysis.continuation.continuation import continuation
from gaitsweep.analysis.continuation.newton import FixedPoints, newton
from gaitsweep.contract import Status
from gaitsweep.engine.poincare.maps import Values
from gaitsweep.engine.poincare.return_map import ReturnMap
from gaitsweep.engine.sweep.sweep import Timings
from gaitsweep.engine.sweep.sweep_spec import SweepProgress
from gaitsweep.job.figures import table_columns
from gaitsweep.kinds.runs import Continuation
from gaitsweep.runs.frames import STATUSES
from gaitsweep.runs.self_check import OFF, TOLERANCE, SelfCheck, changes, circular, sample_rows
from gaitsweep.runs.self_check_report import TOLERANCES
from gaitsweep.table import ResultDirectory

if TYPE_CHECKING:
    from gaitsweep.runs.execute import Prepared
    from gaitsweep.runs.execute import Progress as RunProgress


def follow_branches(
    ready: Prepared,
    directory: ResultDirectory,
    missing: list[int],
    progress: RunProgress | None,
    timings: Timings,
) -> None:
    """Follow the branches of the blocks that a directory still lacks, and write the parts of its table.

    The rows of a block are followed together, and their branches stand in the table when all have ended: a
    block is what a kill can lose.

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
    work, done, first_done = ready.work, 0, directory.rows_done
    for number in missing:
        began = time.perf_counter()
        first = number * work.block
        last = min(first + work.block, work.n_rows)

        def between(done: int = done) -> None:  # so that Ctrl-C need not wait for the block's end
            if progress is not None:
                progress(first_done + done, work.n_rows, 0.0, (first_done + done) / work.n_rows, "branches")

        directory.write_part(number, branches_of(ready, first, last, between))
        timings.run_s += time.perf_counter() - began
        done += last - first
        if progress is not None:
            rate = done / max(timings.run_s, 1e-9)
            share = (first_done + done) / work.n_rows
            progress(first_done + done, work.n_rows, rate, share, "branches")


def check_branch_starts(
    ready: Prepared, count: int, progress: Callable[[SweepProgress], None] | None = None
) -> dict[str, Any]:
    """Look for the fixed points with which branches begin again, at half the step, and compare.

    Args:
        ready: the job made ready.
        count: rows of the sample; 0 turns it off.
        progress: not told, since rows are worked out together.

    Returns:
        The fields of a `SelfCheck`.
    """
    if count == 0:
        return dict(OFF)
    run, plan = ready.job.run, ready.plan
    assert isinstance(run, Continuation)
    check = SelfCheck(rows=min(count, plan.n_rows))
    mapping, values, starts = _map_of(ready, sample_rows(plan, count))
    values = {**values, run.parameter: run.path[0]}
    once, half = (_first_points(each, starts, values, run) for each in (mapping, mapping.refined()))
    both = once.converged & half.converged
    check.status_differs = int(np.sum(once.converged != half.converged))
    model = plan.model
    seen = [
        np.stack([each.images.observed[q.name] for q in model.observables], axis=1) for each in (once, half)
    ]
    change = changes(model, *seen)
    check.take_largest(model, change[both])
    angles = change[:, circular(model)]
    check.moved = int(np.sum(both & np.any(angles > TOLERANCES * TOLERANCE, axis=1)))
    return dataclasses.asdict(check.judged())


def _first_points(mapping: ReturnMap, starts: Values, values: Values, run: Continuation) -> FixedPoints:
    points, _ = mapping.settled(starts, values, run.settle)
    return newton(mapping, points, values, fix=run.fix)


def _map_of(ready: Prepared, rows: np.ndarray) -> tuple[ReturnMap, Values, Values]:
    """The return map of a job's rows (n,), with their parameters but for the one that moves, and starts."""
    run, plan = ready.job.run, ready.plan
    assert isinstance(run, Continuation)
    parameters, starts = plan.values_in(rows)
    following = plan.following(run.parameter)
    derived = tuple((name, plan.derived[name]) for name in following)
    mapping = ReturnMap(plan.model, derived, ready.work.numerics, ready.engine)
    away = {*following, run.parameter}
    return mapping, {name: each for name, each in parameters.items() if name not in away}, starts


def branches_of(
    ready: Prepared, first: int, last: int, between: Callable[[], None] | None = None
) -> pd.DataFrame:
    """The records of the branches of rows first..last-1; `between` is called before each of their steps."""
    run, plan = ready.job.run, ready.plan
    assert isinstance(run, Continuation)
    mapping, values, starts = _map_of(ready, np.arange(first, last))
    begin, end = run.path
    points, _ = mapping.settled(starts, {**values, run.parameter: begin}, run.settle)
    table = continuation(
        mapping,
        points,
        values,
        parameter=run.parameter,
        within=run.path,
        begin=begin,
        towards=1 if end > begin else -1,
        fix=run.fix,
        steps=Steps(run.step, run.longest, run.shortest, run.most, between),
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
