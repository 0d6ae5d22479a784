"""The records of a table, from what the engine gave for a block of rows."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import jax.numpy as jnp
import numpy as np
import pandas as pd

from gaitsweep.contract import HybridModel, Model, Status
from gaitsweep.engine.recorders.ramp import Path as RampPath
from gaitsweep.engine.recorders.recorder import unpacked
from gaitsweep.engine.recorders.staircase import Staircase
from gaitsweep.engine.recorders.stairs import Stairs
from gaitsweep.engine.sweep.block import BlockResult

Columns = Mapping[str, np.ndarray]
STATUSES = [status.name for status in Status if status is not Status.running]


def settle_frame(model: Model, axes: Columns, block: BlockResult, *, settles: bool = True) -> pd.DataFrame:
    """One record a row: how it ended, where on the section, and its gait.

    Args:
        model: whose observables and gaits these are.
        axes: what varies, (n,) each.
        block: the rows' results.
        settles: whether the rows were to settle: then what kept them from it and the attractor's period are
            told, too.
    """
    columns: dict[str, object] = {"row": block.first + np.arange(len(block.status), dtype=np.int64)}
    columns |= dict(axes)
    columns |= {"status": _status(block.status), "cycles": block.cycles, "t_end": block.t_end}
    if settles:
        columns["slowest"] = _slowest(model, block.slowest)
    columns["stalled_by"] = _stalled_by(model, block.fired)
    columns |= {f"{q.name}_end": block.last[:, i] for i, q in enumerate(model.observables)}
    columns["gait"] = _gait(model, block.labels["gait"])
    if settles:
        columns["attractor_period"] = block.period.astype(np.int8)
    columns |= {q.name: block.labels[q.name] for q in model.label_fields}
    return pd.DataFrame(columns)


def crossing_frame(
    model: Model, axes: Columns, block: BlockResult, ramp: tuple[str, RampPath] | None = None
) -> pd.DataFrame:
    """One record a crossing; for a ramp also the pass and the parameter at that time.

    A row that ended before its first crossing keeps one record, with the cycles that it had and no numbers.
    """
    owner, place = _at_least_one(block)
    samples = _placed(block.samples.reshape(-1, 2 + len(model.observables)), place)
    crossing = np.where(np.isnan(samples[:, 0]), block.cycles[owner - block.first], samples[:, 0])
    t = samples[:, 1]
    columns: dict[str, object] = {"row": owner}
    columns |= {name: column[owner - block.first] for name, column in axes.items()}
    columns["crossing"] = crossing.astype(np.int64)
    columns |= _moved(ramp, t)
    columns |= {"t": t, "status": _status(block.status[owner - block.first])}
    columns["stalled_by"] = _stalled_by(model, block.fired[owner - block.first])
    columns |= {f"{q.name}_n": samples[:, 2 + i] for i, q in enumerate(model.observables)}
    return pd.DataFrame(columns)


def stair_frame(
    model: Model, axes: Columns, block: BlockResult, parameter: str, stairs: Stairs
) -> pd.DataFrame:
    """One record a stair that the row came to the end of, with the gait there.

    A row that ended on its first stair keeps one record, with the cycles that it had and no numbers.
    """
    owner, place = _at_least_one(block)
    samples = _placed(block.samples.reshape(-1, Staircase.HEAD + len(model.observables)), place)
    kept = place >= 0
    stair = np.where(kept, samples[:, 0], 0.0).astype(np.float64)
    columns: dict[str, object] = {"row": owner}
    columns |= {name: column[owner - block.first] for name, column in axes.items()}
    columns |= {"stair": stair.astype(np.int64), "pass": stairs.passes(stair)}
    columns[parameter] = np.where(kept, np.asarray(stairs.value(jnp.asarray(stair))), np.nan)
    columns["t"] = samples[:, 2]
    columns["crossing"] = np.where(kept, samples[:, 1], block.cycles[owner - block.first]).astype(np.int64)
    columns["settled"] = samples[:, 3] == 1.0
    columns["slowest"] = _slowest(model, np.where(kept, samples[:, 4], -1.0))
    columns["status"] = _status(block.status[owner - block.first])
    columns["stalled_by"] = _stalled_by(model, block.fired[owner - block.first])
    observed = samples[:, Staircase.HEAD :]
    columns |= {f"{q.name}_n": observed[:, i] for i, q in enumerate(model.observables)}
    columns["gait"] = _gait(model, _placed(block.labels["gait"], place, absent=-1))
    for q in model.label_fields:
        trait = block.labels[q.name]
        columns[q.name] = _placed(trait, place, absent=0 if trait.dtype.kind in "iu" else np.nan)
    return pd.DataFrame(columns)


def trace_frame(
    model: Model, axes: Columns, block: BlockResult, ramp: tuple[str, RampPath] | None = None
) -> pd.DataFrame:
    """One record a sample, with the parameter that moves; a row without any keeps one, with no numbers."""
    owner, place = _at_least_one(block)
    samples = _placed(block.samples.reshape(-1, 1 + len(model.signals)), place)
    columns: dict[str, object] = {"row": owner}
    columns |= {name: column[owner - block.first] for name, column in axes.items()}
    t = samples[:, 0]
    columns |= _moved(ramp, t) | {"t": t}
    columns |= {q.name: samples[:, 1 + i] for i, q in enumerate(model.signals)}
    columns["status"] = _status(block.status[owner - block.first])
    columns["stalled_by"] = _stalled_by(model, block.fired[owner - block.first])
    return pd.DataFrame(columns)


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


def _moved(ramp: tuple[str, RampPath] | None, t: np.ndarray) -> dict[str, object]:
    """The pass and the parameter that moves at times (n,) s, where there is one."""
    if ramp is None:
        return {}
    name, path = ramp
    known = np.nan_to_num(t)
    value = np.where(np.isnan(t), np.nan, np.asarray(path.at(jnp.asarray(known))))
    return {"pass": path.passes(known), name: value}


def _at_least_one(block: BlockResult) -> tuple[np.ndarray, np.ndarray]:
    """The row of each record (n,), and where its numbers stand in the block; -1 where a row kept none."""
    rows = block.first + np.arange(len(block.status), dtype=np.int64)
    without = np.setdiff1d(rows, block.owner)
    owner = np.concatenate([block.owner, without]).astype(np.int64)
    place = np.concatenate([np.arange(block.owner.size), np.full(without.size, -1)])
    order = np.argsort(owner, kind="stable")
    return owner[order], place[order]


def _placed(column: np.ndarray, place: np.ndarray, absent: float = np.nan) -> np.ndarray:
    """What stands at each place of a column, `absent` where the place is -1."""
    last = np.full((1, *column.shape[1:]), absent, column.dtype)
    return np.concatenate([column, last])[place]


def _gait(model: Model, codes: np.ndarray) -> pd.Categorical:
    """Gaits by their number; what was not read is "none" where the model has that."""
    gaits = list(model.gaits)
    unread = gaits.index("none") if "none" in gaits else -1
    return pd.Categorical.from_codes(np.where(codes < 0, unread, codes).tolist(), categories=gaits)


def _status(codes: np.ndarray) -> pd.Categorical:
    return pd.Categorical([Status(code).name for code in codes], categories=STATUSES)


def _slowest(model: Model, numbers: np.ndarray) -> pd.Categorical:
    """The observables by their numbers, missing where the number is below zero."""
    names = [q.name for q in model.observables]
    return pd.Categorical.from_codes(numbers.astype(int).tolist(), categories=names)


def _stalled_by(model: Model, fired: np.ndarray) -> pd.Categorical:
    """The guards that stalled each row (n, words), by their names; missing where none did."""
    names = model.guard_names if isinstance(model, HybridModel) else ()
    told = [
        " and ".join(names[i] if i < len(names) else f"guard {i + 1}" for i in np.flatnonzero(row)) or None
        for row in unpacked(fired)
    ]
    return pd.Categorical(told, categories=sorted({each for each in told if each is not None}))
