"""What a job's run asks of the engine: its recorder and what it moves; and the records that come of it."""

from __future__ import annotations

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import pandas as pd

from gaitsweep.engine.recorders.crossings import CrossingRecorder
from gaitsweep.engine.recorders.fixed_time import Hold
from gaitsweep.engine.recorders.ramp import Path
from gaitsweep.engine.recorders.recorder import Recorder
from gaitsweep.engine.recorders.settle import SettleRecorder, tolerances
from gaitsweep.engine.recorders.staircase import Staircase
from gaitsweep.engine.recorders.stairs import Stairs
from gaitsweep.engine.recorders.trace import TraceRecorder
from gaitsweep.engine.sweep.block import BlockResult
from gaitsweep.expression import evaluate, functions_of
from gaitsweep.job import Job, Plan
from gaitsweep.runs.frames import crossing_frame, settle_frame, stair_frame, trace_frame


@dataclasses.dataclass(frozen=True)
class Moving:
    """The parameter that a run moves, and the path on which it does."""

    parameter: str
    path: Path | Stairs


def recorder_of(job: Job, rows: Plan) -> tuple[Recorder, Moving | None]:
    """What a job keeps of each row, and what moves while it runs."""
    run, model = job.run, rows.model
    if run.kind == "settle":
        return SettleRecorder(model, run.max_cycles, tolerances(model, run.tolerance), run.max_time), None
    if run.kind == "hold":
        return Hold(model, run.duration), None
    if run.kind == "trace":
        recorder = TraceRecorder(model, run.duration, run.every, run.after_cycles)
        if run.parameter is None or run.path is None or run.rate is None:
            return recorder, None
        return recorder, Moving(run.parameter, Path(tuple(run.path), run.rate, run.hold))
    if run.kind == "continuation":
        # `gaitsweep.runs.continuation` follows its branches, from where these rows are
        return CrossingRecorder(model, 1, run.settle), None
    if run.kind == "return_map":
        return CrossingRecorder(model, run.crossings, run.after_cycles), None
    if run.kind == "staircase":
        stairs = Stairs(tuple(run.path), run.step, run.hold, run.first_hold)
        return Staircase(model, stairs, tolerances(model, run.tolerance)), Moving(run.parameter, stairs)
    path = Path(tuple(run.path), run.rate, run.hold)
    return CrossingRecorder(model, duration=path.duration), Moving(run.parameter, path)


class Drive:
    """The parameters at a time, `(values, t) -> params`; formulas that use the moving parameter follow it.

    `times` (s): where its passes begin and end, and some between, by which the length of steps is chosen.
    """

    def __init__(self, rows: Plan, moving: Moving) -> None:
        self._rows, self._moving = rows, moving
        self._following = rows.following(moving.parameter)
        self._functions = functions_of(jnp)
        self.times = moving.path.times

    def __call__(self, values: Any, t: jax.Array) -> Any:
        moved = {**values, self._moving.parameter: self._moving.path.at(t)}
        for name in self._following:
            moved[name] = evaluate(self._rows.derived[name], moved, self._functions)
        return self._rows.model.params(moved)


def frame_of(job: Job, rows: Plan, moving: Moving | None, block: BlockResult) -> pd.DataFrame:
    """The records of a block of rows."""
    axes = rows.columns(block.first, block.first + len(block.status))
    if job.run.kind in ("settle", "hold"):
        return settle_frame(rows.model, axes, block, settles=job.run.kind == "settle")
    ramp: tuple[str, Path] | None = None
    if moving is not None:
        if isinstance(moving.path, Stairs):
            return stair_frame(rows.model, axes, block, moving.parameter, moving.path)
        ramp = moving.parameter, moving.path
    if job.run.kind == "trace":
        return trace_frame(rows.model, axes, block, ramp)
    return crossing_frame(rows.model, axes, block, ramp)
