"""The abstract recorder: it selects the records of a trajectory and ends its row.

A recorder polls a trajectory every `POLL_INTERVAL` attempts. A trajectory that waits (at a crossing, at a
stop in time) gives its record and continues; the recorder also ends rows that have failed. Like `advance` it
is a pure function of one trajectory with arrays of fixed size: records go to a buffer of the engine, and a
trajectory whose buffer is full waits until the host has emptied it.
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
from gaitsweep.engine.advance import FINISHED, Carry, fired_last, select, stalled

# Attempts between two polls at a trajectory. It is part of the results (a failed row's end time is a
# multiple of it in attempts), so it is a constant and not a matter of tuning.
POLL_INTERVAL = 64
# Rows or samples of a trajectory that wait on the device for the host.
BUFFER = 32
# A continuous state variable beyond this has diverged.
DIVERGED = 1.0e9
# Cycles of grace in a row's limit on time.
SPARE_CYCLES = 10
# Attempts for each nominal step of a row's allowed time, beyond which it is given up.
ATTEMPTS_PER_STEP = 8.0
# Guards in one number of `Record.fired`: a slot of a kernel is a float64, which holds 53 bits.
GUARDS_A_WORD = 32
# What of a record stays on the device.
UNSEEN = ("window", "moves")


@partial(
    jax.tree_util.register_dataclass,
    data_fields=[
        "status",
        "cycles",
        "last",
        "window",
        "moves",
        "filled",
        "samples",
        "period",
        "slowest",
        "fired",
    ],
    meta_fields=[],
)
@dataclasses.dataclass(frozen=True)
class Record:
    """What is known of a row so far.

    `status` a `Status`; `cycles` crossings so far, the start being number 0; `last` the
    observables (n,) at the last crossing; `window` those of the last crossings (w, n); `moves` how far apart
    crossings were lately, as a kind of run needs it; `filled` rows that wait in the trajectory's buffer for
    the host, at most `BUFFER`; `samples` rows kept so far; `period` of the attractor in crossings, 0 while it
    is not known; `slowest` the observable (its number, else -1) that kept the row from settling; `fired` the
    guards whose jumps stalled the row, a bit each.
    """

    status: jax.Array
    cycles: jax.Array
    last: jax.Array
    window: jax.Array
    moves: jax.Array
    filled: jax.Array
    samples: jax.Array
    period: jax.Array
    slowest: jax.Array
    fired: jax.Array


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
    def take(
        self, params: Params, carry: Carry, record: Record
    ) -> tuple[Carry, Record, jax.Array, jax.Array]:
        """Take what the halted or running trajectory has to give.

        Returns:
            Carry and record after it, a row (width,) of numbers, and whether that row is to be kept; the
            record counts it already (`counted`), and there is room for it in the buffer.
        """

    def max_attempts(self, params: Params, dt: jax.Array | float) -> jax.Array:
        return ATTEMPTS_PER_STEP * (self.stop(params) / dt + 1000.0)

    def observables(self, params: Params, state: State) -> jax.Array:
        observed = self.model.observe(params, state)
        return jnp.stack([observed[q.name] for q in self.model.observables])

    def begin(self, params: Params, carry: Carry) -> tuple[Record, jax.Array, jax.Array]:
        """The record of a trajectory at its start, which is crossing 0, a row, and whether to keep it."""
        last = self.observables(params, carry.state)
        count = jnp.zeros((), jnp.int32)
        record = Record(
            status=count,
            cycles=count,
            last=last,
            window=jnp.broadcast_to(last, (self.window, *last.shape)),
            moves=jnp.zeros((0,), last.dtype),
            filled=count,
            samples=count,
            period=count,
            slowest=count - 1,
            fired=jnp.zeros_like(_packed(fired_last(carry))),
        )
        return record, jnp.zeros((self.width,), last.dtype), jnp.asarray(False)

    @abc.abstractmethod
    def share(self, record: Record, t: np.ndarray, typical_cycles: float) -> np.ndarray:
        """How much of its way each running row has behind it, 0 to 1, for the progress bar.

        `typical_cycles` is the mean over the rows that have ended, 0 where none has.
        """

    def poll(
        self, params: Params, carry: Carry, record: Record, dt: jax.Array | float
    ) -> tuple[Carry, Record, jax.Array, jax.Array]:
        """Health first, then what this kind of run takes; an ended row stays as it is."""
        running = record.status == Status.running
        taken_carry, taken, row, keep = self.take(params, carry, record)
        ill = self._illness(params, carry, dt)
        status = jnp.where(ill != Status.running, ill, taken.status)
        fired = jnp.where(ill == Status.event_stall, _packed(fired_last(carry)), record.fired)
        new = select(running, dataclasses.replace(taken, status=status, fired=fired), record)
        new = dataclasses.replace(new, last=jnp.where(ill != Status.running, record.last, new.last))
        halt = jnp.where(status != Status.running, FINISHED, taken_carry.halt)
        moved = dataclasses.replace(taken_carry, halt=halt.astype(carry.halt.dtype))
        return select(running, moved, carry), new, row, keep & running

    def _illness(self, params: Params, carry: Carry, dt: jax.Array | float) -> jax.Array:
        moving = carry.state
        if isinstance(self.model, HybridModel):  # modes may hold what they like, infinity too
            moving = [getattr(carry.state, name) for name in self.model.flow(params, carry.state)]
        leaves = [x for x in jax.tree.leaves(moving) if jnp.issubdtype(x.dtype, jnp.floating)]
        flat = jnp.concatenate([jnp.zeros((1,)), *(jnp.ravel(leaf) for leaf in leaves)])
        endless = carry.attempts > self.max_attempts(params, dt)
        status = jnp.where(endless, Status.step_limit, Status.running)
        status = jnp.where(stalled(carry), Status.event_stall, status)
        status = jnp.where(self.model.failed(params, carry.state), Status.fell, status)
        status = jnp.where(jnp.any(jnp.abs(flat) > DIVERGED), Status.diverged, status)
        return jnp.where(jnp.any(jnp.isnan(flat)), Status.not_a_number, status).astype(jnp.int32)


def counted(record: Record, keep: jax.Array) -> Record:
    """`record` with one more row in its buffer where `keep`."""
    more = keep.astype(record.filled.dtype)
    return dataclasses.replace(record, filled=record.filled + more, samples=record.samples + more)


def _packed(fired: jax.Array) -> jax.Array:
    """Which guards (n,) fired, in whole numbers of `GUARDS_A_WORD` bits; none where there are no guards."""
    bits = jnp.asarray([1 << (i % GUARDS_A_WORD) for i in range(fired.size)], jnp.int64)
    words = [
        jnp.sum(jnp.where(fired[i : i + GUARDS_A_WORD], bits[i : i + GUARDS_A_WORD], 0))
        for i in range(0, fired.size, GUARDS_A_WORD)
    ]
    return jnp.stack(words) if words else jnp.zeros((0,), jnp.int64)


def unpacked(words: np.ndarray) -> np.ndarray:
    """Which guards fired (rows, guards) from `Record.fired` (rows, words), those past the last one False."""
    bits = np.arange(GUARDS_A_WORD)
    return ((words[:, :, None].astype(np.int64) >> bits) & 1).astype(bool).reshape(len(words), -1)
