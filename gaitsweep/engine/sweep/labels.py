"""Labels of a block: the gait of each row at its end, or of each step of a staircase, from observables."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
from jaxtyping import Array, Int, Real

from gaitsweep.contract import Model, names_gait
from gaitsweep.engine.carry import Number, Observed
from gaitsweep.engine.content import cached_by_content
from gaitsweep.engine.kernel.row_functions import over_rows
from gaitsweep.engine.recorders.orbit_period import from_first_crossing
from gaitsweep.engine.recorders.recorder import Readings
from gaitsweep.engine.sweep.blocks_of_rows import Block
from gaitsweep.engine.sweep.lane import RowDrive, Values
from gaitsweep.engine.sweep.sweep_spec import SweepSpec
from gaitsweep.row_outcome import RowOutcome

# The code of a gait that was not read.
NOT_READ = -1


def labelled(spec: SweepSpec, block: Block) -> RowOutcome:
    """The rows of a block with their labels, of each row or sample; `gait` is a code of `gait_codes`.

    Args:
        spec: the sweep.
        block: the block; without readings of its recorder, its rows are not labelled.
    """
    rows = from_first_crossing(spec.model.observables, block.result())
    readings = spec.recorder.readings(rows)
    if readings is None:
        return rows
    # a power of two, so that sweeps with other numbers of rows compile few sizes
    width = readings.batch or min(spec.block, 1 << (spec.n_rows - 1).bit_length())
    labels = {}
    for name, values in _read_labels(spec, block.params, readings, width).items():
        if names_gait(name):
            labels[name] = np.where(readings.readable, gait_codes(values), NOT_READ).astype(np.int32)
        else:
            missing = 0 if np.issubdtype(values.dtype, np.integer) else np.nan
            labels[name] = np.where(readings.readable, values, missing)
    earlier = readings.earlier
    if earlier is not None:
        before = _read_labels(spec, block.params, earlier, width)["gait"]
        labels["gait_before"] = np.where(earlier.readable, gait_codes(before), NOT_READ).astype(np.int32)
    if readings.batch is None:
        return dataclasses.replace(rows, labels=labels)
    return dataclasses.replace(rows, sample_labels=labels)


def _read_labels(
    spec: SweepSpec, params: Values, readings: Readings, width: int
) -> dict[str, Real[np.ndarray, " readings"]]:
    """The results of the model's `label` by name, computed for `width` readings at a time."""
    label = _label(spec.model, spec.drive)
    values = {name: np.asarray(column, np.float64) for name, column in params.items()}
    batches = []
    for first in range(0, max(readings.rows.size, 1), width):
        part = slice(first, first + width)
        count = readings.rows[part].size
        # batches are filled up with the first row, so that their size is constant
        rows = np.zeros(width, np.int64)
        times = np.zeros(width)
        observed = np.zeros((width, readings.observed.shape[1]))
        rows[:count] = readings.rows[part]
        times[:count] = readings.t[part]
        observed[:count] = np.where(readings.readable[part, None], readings.observed[part], 0.0)
        labels = label({name: column[rows] for name, column in values.items()}, times, observed)
        batches.append({name: np.asarray(column)[:count] for name, column in labels.items()})
    return {name: np.concatenate([batch[name] for batch in batches]) for name in batches[0]}


def gait_codes(labels: Real[np.ndarray, " *readings"]) -> Int[np.ndarray, " *readings"]:
    """The codes of gaits from the results of `label`: an index is its own code, a number -n becomes -1 - n.

    So `NOT_READ` is no gait's code, and a label that is not an index of a gait is recognisable.
    """
    labels = np.clip(np.asarray(labels, np.int64), -(2**31) + 1, 2**31 - 1)
    return np.where(labels < 0, labels - 1, labels)


@cached_by_content(maxsize=16)
def _label(model: Model, drive: RowDrive | None) -> Callable[..., dict[str, np.ndarray]]:
    """The function `(values, t, observed) -> labels` of many readings."""
    names = [q.name for q in model.observables]

    def label(values: Any, t: Number, observed: Observed) -> dict[str, Real[Array, ""]]:
        params = model.params(values) if drive is None else drive(values, t)
        return model.label(params, {name: observed[i] for i, name in enumerate(names)})

    return over_rows(label, "label", model if drive is None else None, all_rows=True)
