"""Labels of a block: the gait of each row at its end, or of each step of a staircase, from observables."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any

import jax
import numpy as np
from jaxtyping import Array, Float, Int, Real

from gaitsweep.contract import Model, names_gait
from gaitsweep.engine.content import cached_by_content
from gaitsweep.engine.stored_programs import compiled_on_host
from gaitsweep.engine.sweep.block import Block
from gaitsweep.engine.sweep.sweep_spec import SweepSpec
from gaitsweep.row_outcome import RowOutcome


def labelled(spec: SweepSpec, block: Block) -> RowOutcome:
    """The rows of a block with `gait` (a code of `gait_codes`) and label fields, of each row or sample."""
    rows = block.result()
    readings = spec.recorder.readings(rows)
    if readings is None:
        return rows
    label = _reader(spec.model, spec.drive)
    # a power of two, so that sweeps with other numbers of rows compile few sizes
    width = readings.batch or min(spec.block, 1 << (spec.n_rows - 1).bit_length())
    good = readings.readable
    values = {k: np.asarray(v, np.float64) for k, v in block.params.items()}
    parts = []
    for first in range(0, max(readings.rows.size, 1), width):
        part = slice(first, first + width)
        n = readings.rows[part].size
        # batches are filled up with the first row, so that their size is constant
        padded = np.concatenate([readings.rows[part], np.zeros(width - n, np.int64)])
        times, seen = np.zeros(width), np.zeros((width, readings.observed.shape[1]))
        times[:n], seen[:n] = readings.t[part], np.where(good[part, None], readings.observed[part], 0.0)
        labels_of_batch = label({k: v[padded] for k, v in values.items()}, times, seen)
        parts.append({k: np.asarray(v)[:n] for k, v in labels_of_batch.items()})
    labels = {k: np.concatenate([part[k] for part in parts]) for k in parts[0]}
    labels = {
        k: np.where(good, gait_codes(v), -1).astype(np.int32)
        if names_gait(k)
        else np.where(good, v, 0 if v.dtype.kind in "iu" else np.nan)
        for k, v in labels.items()
    }
    return dataclasses.replace(rows, **{"labels" if readings.batch is None else "sample_labels": labels})


def gait_codes(labels: Real[np.ndarray, " *readings"]) -> Int[np.ndarray, " *readings"]:
    """The codes of gaits from the results of `label`: an index is its own code, a number -n becomes -1 - n.

    So -1 stands for gaits that were not read, and a label that is not an index of a gait is recognisable.
    """
    labels = np.clip(np.asarray(labels, np.int64), -(2**31) + 1, 2**31 - 1)
    return np.where(labels < 0, labels - 1, labels)


# cached for the process like the engine's programs, so that the rounds of a refined run compile it once
@cached_by_content(maxsize=16)
def _reader(model: Model, drive: Callable[..., Any] | None) -> Callable[..., Any]:
    names = [q.name for q in model.observables]

    def one(
        values: Mapping[str, Float[Array, " ..."]],
        t: Float[Array, ""],
        observed: Float[Array, " observables"],
    ) -> dict[str, Real[Array, ""]]:
        params = model.params(values) if drive is None else drive(values, t)
        return model.label(params, {name: observed[i] for i, name in enumerate(names)})

    of_rows, compiled = jax.vmap(one), dict[tuple[Any, ...], Callable[..., Any]]()
    fields = dict.fromkeys(("gait", *(q.name for q in model.label_fields)), 0)

    # on the host, since a card has rows to run, which labels would wait for
    def on_host(*arguments: Any) -> dict[str, Array]:
        shapes = tuple(array.shape for array in jax.tree.leaves(arguments))
        if shapes not in compiled:
            others = () if drive is None else None
            compiled[shapes] = compiled_on_host("label", model, others, of_rows, arguments, fields)
        return compiled[shapes](*arguments)

    return on_host
