"""The records of a table, from what the engine gave for a block of rows."""

from __future__ import annotations

from collections.abc import Mapping

import jax.numpy as jnp
import numpy as np
import pandas as pd

from gaitsweep.contract import Model, Status
from gaitsweep.engine.block import BlockResult
from gaitsweep.engine.ramp import Path as RampPath

Columns = Mapping[str, np.ndarray]
STATUSES = [status.name for status in Status if status is not Status.running]


def settle_frame(model: Model, axes: Columns, block: BlockResult) -> pd.DataFrame:
    """One record a row: how it ended, where on the section, and its gait.

    Args:
        model: whose observables and gaits these are.
        axes: what varies, (n,) each.
        block: the rows' results.
    """
    gaits = list(model.gaits)
    unread = gaits.index("none") if "none" in gaits else -1
    labels = dict(block.labels)
    gait = np.where(labels["gait"] < 0, unread, labels.pop("gait"))
    columns: dict[str, object] = {"row": block.first + np.arange(len(block.status), dtype=np.int64)}
    columns |= dict(axes)
    columns |= {"status": _status(block.status), "cycles": block.cycles, "t_end": block.t_end}
    columns |= {f"{q.name}_end": block.last[:, i] for i, q in enumerate(model.observables)}
    columns["gait"] = pd.Categorical.from_codes(gait.tolist(), categories=gaits)
    columns |= {q.name: labels[q.name] for q in model.traits}
    return pd.DataFrame(columns)


def crossing_frame(
    model: Model, axes: Columns, block: BlockResult, ramp: tuple[str, RampPath] | None = None
) -> pd.DataFrame:
    """One record a crossing; for a ramp also the pass and the parameter at that time.

    A row that ended before its first crossing keeps one record, with the cycles that it had and no numbers.
    """
    owner, samples = _at_least_one(block, 2 + len(model.observables))
    crossing = np.where(np.isnan(samples[:, 0]), block.cycles[owner - block.first], samples[:, 0])
    t = samples[:, 1]
    columns: dict[str, object] = {"row": owner}
    columns |= {name: column[owner - block.first] for name, column in axes.items()}
    columns["crossing"] = crossing.astype(np.int64)
    if ramp is not None:
        name, path = ramp
        known = np.nan_to_num(t)
        columns["pass"] = path.passes(known)
        columns[name] = np.where(np.isnan(t), np.nan, np.asarray(path.at(jnp.asarray(known))))
    columns |= {"t": t, "status": _status(block.status[owner - block.first])}
    columns |= {f"{q.name}_n": samples[:, 2 + i] for i, q in enumerate(model.observables)}
    return pd.DataFrame(columns)


def trace_frame(model: Model, axes: Columns, block: BlockResult) -> pd.DataFrame:
    """One record a sample; a row without any keeps one, with no numbers."""
    owner, samples = _at_least_one(block, 1 + len(model.signals))
    columns: dict[str, object] = {"row": owner}
    columns |= {name: column[owner - block.first] for name, column in axes.items()}
    columns["t"] = samples[:, 0]
    columns |= {q.name: samples[:, 1 + i] for i, q in enumerate(model.signals)}
    columns["status"] = _status(block.status[owner - block.first])
    return pd.DataFrame(columns)


def _at_least_one(block: BlockResult, width: int) -> tuple[np.ndarray, np.ndarray]:
    rows = block.first + np.arange(len(block.status), dtype=np.int64)
    without = np.setdiff1d(rows, block.owner)
    samples = block.samples.reshape(-1, width)
    owner = np.concatenate([block.owner, without]).astype(np.int64)
    samples = np.concatenate([samples, np.full((without.size, width), np.nan)])
    order = np.argsort(owner, kind="stable")
    return owner[order], samples[order]


def _status(codes: np.ndarray) -> pd.Categorical:
    return pd.Categorical([Status(code).name for code in codes], categories=STATUSES)
