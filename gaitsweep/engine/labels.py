"""Gaits of the rows of a block, from the observables where they ended."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from gaitsweep.contract import Status
from gaitsweep.engine.block import Block
from gaitsweep.engine.work import Work

# How a row may end and still stand on the section, where its gait can be read.
LABELLED = (Status.settled, Status.cycle_limit, Status.time_limit)


class Labels:
    """Gaits and traits of a block's rows, in one call of fixed width."""

    def __init__(self, work: Work) -> None:
        self.work = work
        model = work.model
        names = [q.name for q in model.observables]

        def one(values: Any, observed: jax.Array) -> dict[str, jax.Array]:
            params = model.params(values)
            return model.label(params, {name: observed[i] for i, name in enumerate(names)})

        self._label = jax.jit(jax.vmap(one))

    def __call__(self, block: Block) -> dict[str, np.ndarray]:
        if not self.work.recorder.labelled:
            return {}
        readable = np.isin(block.status, LABELLED) & (block.cycles > 0)
        n, width = block.rows, min(self.work.block, self.work.n_rows)
        # rows that cannot be read take the first row's place, so that the width never changes
        rows = np.concatenate([np.arange(n), np.zeros(width - n, np.int64)])
        values = {k: np.asarray(v, np.float64)[rows] for k, v in block.params.items()}
        observed = np.where(readable[:, None], block.last, 0.0)[rows]
        given = {k: np.asarray(v)[:n] for k, v in self._label(values, jnp.asarray(observed)).items()}
        gait = np.where(readable, given.pop("gait"), -1).astype(np.int32)
        traits = {k: np.where(readable, v, 0 if v.dtype.kind in "iu" else np.nan) for k, v in given.items()}
        return {"gait": gait, **traits}
