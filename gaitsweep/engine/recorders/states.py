"""The recorder that keeps whole states beside the records of another one."""

from __future__ import annotations

import dataclasses
from typing import final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from gaitsweep.contract import Model, Params, State
from gaitsweep.engine.carry import Carry, Number
from gaitsweep.engine.recorders.recorder import (
    Beginning,
    LaneRecord,
    PollResult,
    Readings,
    Recorder,
    RunningRows,
    counted,
)
from gaitsweep.row_outcome import RowNumber, RowOutcome
from gaitsweep.status import Status


@final
@dataclasses.dataclass(frozen=True)
class StateRecorder(Recorder):
    """Records what another recorder does, and the state of the trajectory there.

    A recorder without samples gets one where its row ends, if the row did not fail. The trajectory is that
    of the other recorder to the last bit.

    Args:
        model: the model.
        base: the other recorder.
        size: the number of numbers in a state of the model, modes included.
    """

    model: Model
    base: Recorder
    size: int

    @property
    def numbers(self) -> tuple[RowNumber, ...]:  # pyright: ignore[reportIncompatibleVariableOverride]
        return self.base.numbers

    @property
    def exponents(self) -> int:  # pyright: ignore[reportIncompatibleVariableOverride]
        return self.base.exponents

    @property
    def names(self) -> tuple[str, ...]:
        return (*self.base.names, *(f"state {place}" for place in range(self.size)))

    def stop(self, params: Params) -> Number:
        return self.base.stop(params)

    def max_attempts(self, params: Params, dt: Number | float) -> Number:
        return self.base.max_attempts(params, dt)

    def begin(self, params: Params, carry: Carry) -> Beginning:
        record, sample, keep = self.base.begin(params, carry)
        return Beginning(record, self._extended(sample, carry), keep)

    def record(self, params: Params, carry: Carry, record: LaneRecord) -> PollResult:
        polled = self.base.record(params, carry, record)
        recorded = polled.record
        keep = polled.keep
        if not self.base.names:
            keep = recorded.status != Status.running
            recorded = counted(recorded, keep)
        return PollResult(polled.carry, recorded, self._extended(polled.sample, carry), keep)

    def _extended(self, sample: Float[Array, " numbers"], carry: Carry) -> Float[Array, " width"]:
        """A sample with the numbers of the state."""
        leaves = [jnp.ravel(leaf).astype(sample.dtype) for leaf in jax.tree.leaves(carry.state)]
        return jnp.concatenate([sample, *leaves])

    def progress(self, rows: RunningRows, typical: float) -> Float[np.ndarray, " rows"]:
        return self.base.progress(rows, typical)

    def readings(self, rows: RowOutcome) -> Readings | None:
        # a recorder with samples would read its own in ones that are wider
        return None if self.base.names else self.base.readings(rows)


def state_size(shape: State) -> int:
    """The number of numbers in a state, from the shapes of its leaves."""
    return sum(int(np.prod(leaf.shape)) for leaf in jax.tree.leaves(shape))


def states_of(samples: Float[np.ndarray, "samples width"], shape: State) -> State:
    """The states in samples of a `StateRecorder`.

    Args:
        samples: the samples (n, width).
        shape: the shapes of a state's leaves.

    Returns:
        A state whose leaves have the samples as their first axis, (n, ...).
    """
    leaves, structure = jax.tree.flatten(shape)
    sizes = [int(np.prod(leaf.shape)) for leaf in leaves]
    numbers = samples[:, samples.shape[1] - sum(sizes) :]
    arrays = []
    for piece, leaf in zip(np.split(numbers, np.cumsum(sizes)[:-1], axis=1), leaves, strict=True):
        arrays.append(piece.reshape(len(piece), *leaf.shape).astype(leaf.dtype))
    return jax.tree.unflatten(structure, arrays)
