"""The engine's functions of one trajectory, which every engine runs in its own way."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from gaitsweep.contract import Model, Params
from gaitsweep.engine.advance import Carry, advance, start
from gaitsweep.engine.numerics import SHARE, Numerics, step_of
from gaitsweep.engine.recorders.recorder import Record, Recorder

# The parameters at a time, from the raw values of a row: a ramp, a staircase. Its attribute `times`, where it
# has one, lists times (s) between which nothing lies that the step's length has to be known for.
RowDrive = Callable[[Any, jax.Array], Params]


class ChunkOutput(NamedTuple):
    """What a chunk of attempts gives to the host, one element of each array for each lane.

    `record` (its window and its moves are left out), `kept` the rows in the buffers (lanes, BUFFER, width),
    of which `record.filled` are new, `t` (s), `attempts`.
    """

    record: Record
    kept: np.ndarray
    t: np.ndarray
    attempts: np.ndarray


class OneLane:
    """Opening a trajectory, an attempt, and a poll at it; pure functions of scalars and small arrays."""

    def __init__(
        self, model: Model, recorder: Recorder, numerics: Numerics, drive: RowDrive | None = None
    ) -> None:
        self.model, self.recorder, self.numerics = model, recorder, numerics.of(model)
        self.driven = drive is not None
        self.at = drive if drive is not None else lambda values, t: model.params(values)
        self._advance = advance(model, numerics, drive=drive)

    def open(self, values: Any, starts: Any) -> tuple[Any, Carry, Record, jax.Array, jax.Array]:
        """What is held along the trajectory, its carry and record, and the row to keep of its start."""
        zero = jnp.zeros((), self.numerics.carried)
        params = self.at(values, zero)
        state = self.model.init(params, starts)
        share = jnp.asarray(starts.get(SHARE, 1.0), zero.dtype)
        dt = share * self._longest_step(values, params)
        carry = start(self.model, params, state, dt=dt, stop=self.recorder.stop(params), share=share)
        # what does not change along a trajectory is worked out once
        held = values if self.driven else params
        return held, carry, *self.recorder.begin(params, carry)

    def _longest_step(self, values: Any, params: Params) -> jax.Array:
        """Of a row (s); of a parameter that moves, the shortest that any of its values asks for."""
        dt = step_of(self.model, self.numerics, params)
        for t in getattr(self.at, "times", ()) if self.driven else ():
            moved = self.at(values, jnp.asarray(t, dt.dtype))
            dt = jnp.minimum(dt, step_of(self.model, self.numerics, moved))
        return dt

    def attempt(self, held: Any, carry: Carry) -> Carry:
        return self._advance(held, carry)

    def poll(self, held: Any, carry: Carry, record: Record) -> tuple[Carry, Record, jax.Array, jax.Array]:
        """The recorder's poll: carry and record after it, a row (width,), and whether to keep the row."""
        params = self.at(held, carry.t) if self.driven else held
        return self.recorder.poll(params, carry, record, carry.dt / self.numerics.steps_in_longest)
