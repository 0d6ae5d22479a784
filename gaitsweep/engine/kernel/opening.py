"""The opening of rows, by a kernel, or by XLA if a model has operations that no kernel has."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from gaitsweep.engine.devices import host_device
from gaitsweep.engine.kernel.row_kernel import RowKernel, row_kernel, running
from gaitsweep.engine.kernel.trace import traced_function
from gaitsweep.engine.sweep.lane import OneLane

# Rows that XLA opens in one call: constant, since its last bits depend on it.
_BATCH = 64

Columns = Mapping[str, Float[np.ndarray, " rows"]]


class OpenedRows(NamedTuple):
    """Opened rows (n,): their slots, the first sample of each, and whether to keep that sample."""

    slots: Float[np.ndarray, "rows slots"]
    samples: Float[np.ndarray, "rows width"]
    keeps: Bool[np.ndarray, " rows"]


class Opening(NamedTuple):
    """The opening of rows by a kernel, and the number of a row's slots."""

    kernel: RowKernel
    slots: int


def _opening_of_one(lane: OneLane) -> Callable[..., tuple[Array, Array, Array]]:
    """The function of one row that gives the numbers of `OpenedRows`, with the slots in one vector."""

    def of_one(values: Mapping[str, Array], starts: Mapping[str, Array]) -> tuple[Array, Array, Array]:
        constants, carry, record, sample, keep = lane.open(values, starts)
        flat = [jnp.ravel(leaf).astype(jnp.float64) for leaf in jax.tree.leaves((constants, carry, record))]
        return jnp.concatenate(flat), sample.astype(jnp.float64), keep

    return of_one


def opening_of(lane: OneLane, values: Any, starts: Any) -> Opening:
    """The opening of a trajectory.

    Args:
        lane: the engine's functions of one trajectory.
        values, starts: shapes and dtypes of a row's parameters and initial conditions.

    Raises:
        UnsupportedError: the model uses an operation that the scalar kernel does not have.
    """
    traced = traced_function(_opening_of_one(lane), (values, starts))
    slots, *_ = traced.arrays
    return Opening(row_kernel(traced), slots.size)


def opened_by_kernel(opening: Opening) -> Callable[[Columns, Columns], OpenedRows]:
    """The function `(values, starts) -> (slots, samples, keep)` of rows."""
    of_rows = running(opening.kernel)
    slots = opening.slots

    def open_rows(values: Columns, starts: Columns) -> OpenedRows:
        opened = of_rows(jax.tree.leaves((dict(values), dict(starts))))
        return OpenedRows(opened[:, :slots], opened[:, slots:-1], opened[:, -1] != 0.0)

    return open_rows


def opened_by_xla(lane: OneLane) -> Callable[[Columns, Columns], OpenedRows]:
    """As `opened_by_kernel`, of a model with operations that the scalar kernel does not have."""
    compiled = jax.jit(jax.vmap(_opening_of_one(lane)))

    def open_rows(values: Columns, starts: Columns) -> OpenedRows:
        rows = len(next(iter(values.values())))
        parts = []
        for first in range(0, rows, _BATCH):
            # the last batch is filled up with its own rows
            batch = np.resize(np.arange(first, min(first + _BATCH, rows)), _BATCH)
            values_of_batch = {name: column[batch] for name, column in values.items()}
            starts_of_batch = {name: column[batch] for name, column in starts.items()}
            with jax.default_device(host_device()):
                parts.append(jax.device_get(compiled(values_of_batch, starts_of_batch)))
        slots, samples, keeps = (np.concatenate(outputs)[:rows] for outputs in zip(*parts, strict=True))
        return OpenedRows(slots, samples, keeps)

    return open_rows
