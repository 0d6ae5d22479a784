"""What is kept of a trajectory: what all recorders share.

A recorder looks at a trajectory every `CADENCE` attempts. Where the trajectory waits (at a crossing, at a
stop in time) it takes what it wants and lets it go on; it also ends rows that have failed. Like `advance`
it is a pure function of one trajectory, and all it holds is of fixed size: what does not fit in a buffer
makes the trajectory wait until the host has emptied it.
"""

from __future__ import annotations

import abc
import dataclasses
from functools import partial
from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np

from gaitsweep.contract import HybridModel, Model, Params, State, Status
from gaitsweep.engine.advance import FINISHED, Carry, select, stalled

# Attempts between two looks at a trajectory. It is part of the results (a failed row's end time is a
# multiple of it in attempts), so it is a constant and not a matter of tuning.
CADENCE = 64
# Rows or samples of a trajectory that wait on the device for the host.
BUFFER = 32
# A continuous state variable beyond this has diverged.
DIVERGED = 1.0e9
# Cycles of grace in a row's limit on time.
SPARE_CYCLES = 10
# Attempts for each nominal step of a row's allowed time, beyond which its events have stalled it.
ATTEMPTS_PER_STEP = 8.0


@partial(
    jax.tree_util.register_dataclass,
    data_fields=["status", "cycles", "last", "window", "buffer", "filled", "samples"],
    meta_fields=[],
)
@dataclasses.dataclass(frozen=True)
class Record:
    """What is known of a row so far.

    `status` a `Status`; `cycles` crossings so far, the start being number 0; `last` the
    observables (n,) at the last crossing; `window` those of the last crossings (w, n);
    `buffer` rows that wait for the host (b, width), `filled` their number; `samples` rows given so far.
    """

    status: jax.Array
    cycles: jax.Array
    last: jax.Array
    window: jax.Array
    buffer: jax.Array
    filled: jax.Array
    samples: jax.Array


class Recorder(abc.ABC):
    """What all kinds of runs share: health, the count of cycles, emptying of buffers."""

    model: Model
    labelled: ClassVar[bool] = False  # whether rows end where their gait can be read

    @property
    def window(self) -> int:
        return 0

    @property
    def width(self) -> int:
        """Numbers in a buffered row; 0 where the kind keeps none."""
        return 0

    @abc.abstractmethod
    def stop(self, params: Params) -> jax.Array:
        """The first time (s) at which the trajectory halts."""

    @abc.abstractmethod
    def take(self, params: Params, carry: Carry, record: Record) -> tuple[Carry, Record]:
        """Take what the halted or running trajectory has to give."""

    def max_attempts(self, params: Params, dt: float) -> jax.Array:
        return ATTEMPTS_PER_STEP * (self.stop(params) / dt + 1000.0)

    def observables(self, params: Params, state: State) -> jax.Array:
        observed = self.model.observe(params, state)
        return jnp.stack([observed[q.name] for q in self.model.observables])

    def begin(self, params: Params, carry: Carry) -> Record:
        """The record of a trajectory at its start, which is crossing 0."""
        last = self.observables(params, carry.state)
        count = jnp.zeros((), jnp.int32)
        return Record(
            status=count,
            cycles=count,
            last=last,
            window=jnp.broadcast_to(last, (self.window, *last.shape)),
            buffer=jnp.zeros((BUFFER if self.width else 0, self.width), last.dtype),
            filled=count,
            samples=count,
        )

    @abc.abstractmethod
    def share(self, record: Record, t: np.ndarray, typical_cycles: float) -> np.ndarray:
        """How much of its way each running row has behind it, 0 to 1, for the progress bar.

        `typical_cycles` is the mean over the rows that have ended, 0 where none has.
        """

    def look(self, params: Params, carry: Carry, record: Record, dt: float) -> tuple[Carry, Record]:
        """Health first, then what this kind of run takes; an ended row stays as it is."""
        running = record.status == Status.running
        taken_carry, taken = self.take(params, carry, record)
        ill = self._illness(params, carry, dt)
        status = jnp.where(ill != Status.running, ill, taken.status)
        new = select(running, dataclasses.replace(taken, status=status), record)
        new = dataclasses.replace(new, last=jnp.where(ill != Status.running, record.last, new.last))
        halt = jnp.where(status != Status.running, FINISHED, taken_carry.halt)
        moved = dataclasses.replace(taken_carry, halt=halt.astype(carry.halt.dtype))
        return select(running, moved, carry), new

    def _illness(self, params: Params, carry: Carry, dt: float) -> jax.Array:
        moving = carry.state
        if isinstance(self.model, HybridModel):  # modes may hold what they like, infinity too
            moving = [getattr(carry.state, name) for name in self.model.flow(params, carry.state)]
        leaves = [x for x in jax.tree.leaves(moving) if jnp.issubdtype(x.dtype, jnp.floating)]
        flat = jnp.concatenate([jnp.zeros((1,)), *(jnp.ravel(leaf) for leaf in leaves)])
        endless = stalled(carry) | (carry.attempts > self.max_attempts(params, dt))
        status = jnp.where(endless, Status.event_stall, Status.running)
        status = jnp.where(self.model.failed(params, carry.state), Status.fell, status)
        status = jnp.where(jnp.any(jnp.abs(flat) > DIVERGED), Status.diverged, status)
        return jnp.where(jnp.any(jnp.isnan(flat)), Status.not_a_number, status).astype(jnp.int32)


def append(record: Record, row: jax.Array, when: jax.Array) -> Record:
    """`record` with `row` (width,) in its buffer where `when`; the caller sees to it that there is room."""
    at = (jnp.arange(BUFFER) == record.filled) & when
    return dataclasses.replace(
        record,
        buffer=jnp.where(at[:, None], row, record.buffer),
        filled=record.filled + when.astype(record.filled.dtype),
        samples=record.samples + when.astype(record.samples.dtype),
    )
