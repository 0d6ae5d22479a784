"""The abstract recorder: it selects the records of a trajectory and ends its row.

A recorder polls a trajectory every `POLL_INTERVAL` attempts. A trajectory that waits (at a crossing, at a
stop in time) gives its record and continues; the recorder also ends rows that have failed. Like `advance` it
is a pure function of one trajectory with arrays of fixed size: records go to a buffer of the engine, and a
trajectory whose buffer is full waits until the host has emptied it.
"""

from __future__ import annotations

import abc
import dataclasses
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, Real

from gaitsweep.contract import HybridModel, Model, Params, State
from gaitsweep.dynamics.declarations import Variable
from gaitsweep.dynamics.declared import Declared
from gaitsweep.engine.carry import (
    Carry,
    Flag,
    Halt,
    Integer,
    Number,
    Observed,
    fired_guards,
    is_stalled,
    select,
)
from gaitsweep.engine.leaves import float_leaves
from gaitsweep.row_outcome import RowNumber, RowOutcome
from gaitsweep.status import Status

# Attempts between two polls of a trajectory. A constant and not a tuning parameter, since results depend on
# it: a failed row ends at a multiple of it.
POLL_INTERVAL = 64
# Records of a trajectory that can wait on the device for the host.
BUFFER = 32
# Absolute value beyond which a continuous state variable has diverged.
DIVERGED = 1.0e9
# Additional cycles in the time limit of a row.
SPARE_CYCLES = 10
# The allowed attempts of a row for each longest step in its allowed time.
ATTEMPTS_PER_STEP = 8.0


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class LaneRecord:
    """The progress and the results of the row in a lane.

    Attributes:
        status: a `Status`.
        cycles: the number of crossings without the start.
        last: the observables (n,) at the last crossing.
        memory: the recorder's own state, a pytree or a `ResultMemory`.
        filled: the samples in the buffer that wait for the host, at most `BUFFER`.
        samples: all samples so far.
        numbers: those that the recorder declares, by name.
        fired: a bit for each guard whose jumps stalled the row.
    """

    status: Integer
    cycles: Integer
    last: Observed
    memory: Any
    filled: Integer
    samples: Integer
    numbers: dict[str, Real[Array, ""]]
    fired: Int[Array, " words"]

    def results(self, carry: Carry) -> dict[str, Array]:
        """The numbers of `RowOutcome` by name, final once the row has ended."""
        remembered = self.memory.results if isinstance(self.memory, ResultMemory) else {}
        return {
            "status": self.status,
            "cycles": self.cycles,
            "attempts": carry.attempts,
            "t_end": carry.t,
            "last": self.last,
            "fired": self.fired,
            **self.numbers,
            **remembered,
        }


class ResultMemory(abc.ABC):
    """A recorder's own state along a row that holds numbers of the ended row."""

    @property
    @abc.abstractmethod
    def results(self) -> dict[str, Array]:
        """Numbers of a row that has ended, by name."""


class PollResult(NamedTuple):
    """The carry and the record after a poll, a sample (width,) of numbers, and whether to keep it."""

    carry: Carry
    record: LaneRecord
    sample: Float[Array, " width"]
    keep: Flag


@dataclasses.dataclass(frozen=True)
class Readings:
    """Points of rows at which the model labels gaits.

    Attributes:
        rows: the places (n,) of the rows in their block.
        t: the times (n,) s.
        observed: the observables (n, k).
        readable: mask (n,) of the points that have a gait to read.
        batch: the number of readings in one call of the model's `label`, if samples are read; None for one
            reading of each row.
        earlier: readings of the same rows before a push, for their label `gait_before`.
    """

    rows: Int[np.ndarray, " readings"]
    t: Float[np.ndarray, " readings"]
    observed: Float[np.ndarray, "readings observables"]
    readable: Bool[np.ndarray, " readings"]
    batch: int | None = None
    earlier: Readings | None = None


class RunningRows(NamedTuple):
    """The progress of running rows (n,): crossings, samples, and times in s."""

    cycles: Real[np.ndarray, " rows"]
    samples: Real[np.ndarray, " rows"]
    t: Float[np.ndarray, " rows"]


class Beginning(NamedTuple):
    """The record of a trajectory at its start (crossing 0), its first sample, and whether to keep it."""

    record: LaneRecord
    sample: Float[Array, " width"]
    keep: Flag


class Recorder(abc.ABC):
    """The base class of recorders: tests of failure, the count of crossings, buffers.

    A recorder defines the abstract members; it overrides no other one.
    """

    # Numbers of each row in addition to the engine's, which `record` may set: the period of the attractor in
    # crossings, 0 if unknown, and the place of the observable that moved most.
    numbers: tuple[RowNumber, ...] = (
        RowNumber("period", np.int8),
        RowNumber("slowest", np.int64, absent=-1),
    )
    # Tangents of each trajectory, whose growth gives as many Lyapunov exponents.
    exponents: int = 0
    model: Model

    @property
    @abc.abstractmethod
    def names(self) -> tuple[str, ...]:
        """The names of the numbers in a sample, in their order; none where the recorder keeps no samples."""

    @abc.abstractmethod
    def stop(self, params: Params) -> Number:
        """The first time (s) at which the trajectory halts."""

    @abc.abstractmethod
    def record(self, params: Params, carry: Carry, record: LaneRecord) -> PollResult:
        """Record the halted or running trajectory.

        Args:
            params: the parameters of the row, at its present time if they move.
            carry: the trajectory.
            record: the record before this poll.

        Returns:
            The carry, the record and a sample. Where the sample is kept, the record counts it already
            (`counted`), and the buffer has room for it.
        """

    @abc.abstractmethod
    def max_attempts(self, params: Params, dt: Number | float) -> Number:
        """The attempts beyond which a row ends, for a longest step of `dt` (s); see `attempts_until`."""

    @abc.abstractmethod
    def begin(self, params: Params, carry: Carry) -> Beginning:
        """The beginning of a trajectory; see `unsampled`."""

    @abc.abstractmethod
    def readings(self, rows: RowOutcome) -> Readings | None:
        """Places at which the gaits of ended rows are read; None where this recorder keeps no gaits."""

    @abc.abstractmethod
    def progress(self, rows: RunningRows, typical: float) -> Float[np.ndarray, " rows"]:
        """The progress of running rows (n,), 0 to 1, for the progress bar.

        Args:
            rows: their crossings, samples and times so far.
            typical: the mean number of cycles of the ended rows, 0 if there are none.
        """

    @property
    def width(self) -> int:
        """The number of numbers in a sample."""
        return len(self.names)

    def observables(self, params: Params, state: State) -> Observed:
        """The model's observables (n,) of a state."""
        observed = self.model.observe(params, state)
        return jnp.stack([observed[q.name] for q in self.model.observables])

    def crossed(self, params: Params, carry: Carry, record: LaneRecord, crosses: Flag) -> LaneRecord:
        """The record with one more crossing, and its observables.

        Args:
            params: the parameters of the row, at its present time if they move.
            carry: the trajectory.
            record: the record before this poll.
            crosses: whether the trajectory is at a crossing; else the record is unchanged.
        """
        cycles = jnp.where(crosses, record.cycles + 1, record.cycles)
        last = jnp.where(crosses, self.observables(params, carry.state), record.last)
        return dataclasses.replace(record, cycles=cycles, last=last)

    def unsampled(self, params: Params, carry: Carry) -> Beginning:
        """The beginning of a trajectory whose start is not a sample, with a record without memory."""
        last = self.observables(params, carry.state)
        count = jnp.zeros((), jnp.int32)
        record = LaneRecord(
            status=count,
            cycles=count,
            last=last,
            memory=(),
            filled=count,
            samples=count,
            numbers={number.name: _absent(number, last) for number in self.numbers if not number.crossings},
            fired=jnp.zeros_like(fired_guards(carry)),
        )
        return Beginning(record, jnp.zeros((self.width,), last.dtype), jnp.asarray(False))

    def poll(self, params: Params, carry: Carry, record: LaneRecord, dt: Number | float) -> PollResult:
        """Record, and end a row that has failed; an ended row is unchanged.

        Args:
            params: the parameters of the row, at its present time if they move.
            carry: the trajectory.
            record: the record before this poll.
            dt: the step (s) for which the attempts of a row are limited, see `max_attempts`.
        """
        is_running = record.status == Status.running
        recorded_carry, recorded, sample, keep = self.record(params, carry, record)
        failure = self._failure_status(params, carry, dt)
        status = jnp.where(failure != Status.running, failure, recorded.status)
        fired = jnp.where(failure == Status.event_stall, fired_guards(carry), record.fired)
        later = select(is_running, dataclasses.replace(recorded, status=status, fired=fired), record)
        # the state of a failed row is not recorded
        last = jnp.where(failure != Status.running, record.last, later.last)
        halt = jnp.where(status != Status.running, Halt.FINISHED, recorded_carry.halt)
        moved = dataclasses.replace(recorded_carry, halt=halt.astype(carry.halt.dtype))
        return PollResult(
            carry=select(is_running, moved, carry),
            record=dataclasses.replace(later, last=last),
            sample=sample,
            keep=keep & is_running,
        )

    def _failure_status(self, params: Params, carry: Carry, dt: Number | float) -> Integer:
        """The status of a row that cannot continue, `running` otherwise."""
        leaves = [jnp.ravel(leaf) for leaf in variables_of(self.model, params, carry.state)]
        values = jnp.concatenate([jnp.zeros((1,)), *leaves])
        limit = self.max_attempts(params, dt)
        # a comparison with NaN is never true, so a row with such a limit would not end
        unknown = jnp.isnan(limit) | jnp.isnan(self.model.free_after(params))
        unknown = unknown | ~(jnp.abs(carry.unit) < jnp.inf)
        endless = (carry.attempts > limit) | (limit == jnp.inf)
        status = jnp.where(endless, Status.step_limit, Status.running)
        status = jnp.where(is_stalled(self.model, carry), Status.event_stall, status)
        status = jnp.where(self.model.failed(params, carry.state), Status.fell, status)
        status = jnp.where(jnp.any(jnp.abs(values) > DIVERGED), Status.diverged, status)
        unknown = unknown | jnp.any(jnp.isnan(values))
        return jnp.where(unknown, Status.not_a_number, status).astype(jnp.int32)


def _absent(number: RowNumber, like: Observed) -> Real[Array, ""]:
    """The value of a number at the start of a trajectory; floats have the dtype of the observables."""
    return jnp.asarray(number.absent, like.dtype if issubclass(number.dtype, np.floating) else jnp.int32)


def attempts_until(time: Number, dt: Number | float) -> Number:
    """The allowed attempts of a row until a time (s), with longest steps of `dt` (s)."""
    return ATTEMPTS_PER_STEP * (time / dt + 1000.0)


def readings_at_the_end(rows: RowOutcome) -> Readings:
    """The readings of rows that are labelled where they end."""
    crossed = (rows.cycles > 0) | (rows.status == Status.at_rest)
    readable = ~Status.FAILED.among(rows.status) & (rows.status != Status.running) & crossed
    return Readings(np.arange(rows.row.size), rows.t_end, rows.last, readable)


def variables_of(model: Model, params: Params, state: State) -> list[Array]:
    """The float arrays of a state that have to be finite, without modes, which may have any value.

    Args:
        model: the model.
        params: its parameters.
        state: the state.
    """
    if not isinstance(model, HybridModel):
        return float_leaves(state)
    original = model.original
    declarations = original.declarations if isinstance(original, Declared) else {}
    # declared variables that only jumps change are not in the flow
    declared = [name for name, declaration in declarations.items() if isinstance(declaration, Variable)]
    names = dict.fromkeys([*jax.eval_shape(model.flow, params, state), *declared])
    return float_leaves([getattr(state, name) for name in names])


def counted(record: LaneRecord, keep: Flag) -> LaneRecord:
    """The record with one more sample in its buffer if `keep`."""
    more = keep.astype(record.filled.dtype)
    return dataclasses.replace(record, filled=record.filled + more, samples=record.samples + more)
