"""The functions of one trajectory; each engine vectorises them differently."""

from __future__ import annotations

import abc
import dataclasses
from collections.abc import Mapping, Sequence
from typing import NamedTuple, Protocol, final

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, Real

from gaitsweep.contract import Model, Params, State
from gaitsweep.engine.advance import Advance, advance
from gaitsweep.engine.carry import Carry, Flag, Number, start
from gaitsweep.engine.numerics import STEP_FACTOR, ResolvedNumerics, step_of
from gaitsweep.engine.recorders.recorder import LaneRecord, PollResult, Recorder
from gaitsweep.engine.tangents import coordinate_count, first_directions, from_section, with_tangents

Values = Mapping[str, Real[np.ndarray, "rows ..."]]


class RowDrive(Protocol):
    """The parameters of a row at a time, for a ramp or a staircase."""

    @property
    def times(self) -> Sequence[float]:
        """Times (s) at which the step length has to be evaluated."""
        ...

    def __call__(self, values: Mapping[str, Float[Array, " ..."]], t: Number, /) -> Params:
        """The model's parameters at a time `t` (s), from the values of the row by name."""
        ...


class Opened(NamedTuple):
    """A trajectory at its start.

    Attributes:
        constants: what does not change along it: its parameters, or its values if a drive moves one.
        carry: its state of integration.
        record: its record.
        sample: its first sample (width,).
        keep: whether to keep that sample.
    """

    constants: Params
    carry: Carry
    record: LaneRecord
    sample: Float[Array, " width"]
    keep: Flag


class ChunkOutput(NamedTuple):
    """The output of a chunk of attempts for the host; the first axis of each array is the lane.

    Attributes:
        numbers: those of `RowOutcome` by name, final where a row has ended; no later chunk changes those that
            are declared (`RowNumber`).
        filled: the number of new samples (lanes,).
        samples: the number of samples of the whole row (lanes,).
        buffers: the new samples (lanes, BUFFER, width), at the first `filled` places of each.
    """

    numbers: dict[str, Real[np.ndarray, "lanes ..."]]
    filled: Int[np.ndarray, " lanes"]
    samples: Int[np.ndarray, " lanes"]
    buffers: Float[np.ndarray, "lanes buffer width"]


class Lanes(abc.ABC):
    """The trajectories of a sweep that one device runs at a time.

    `size` counts the lanes, `at_a_time` those of them that run at a time; the others wait.
    """

    size: int
    at_a_time: int

    @abc.abstractmethod
    def fill(self, params: Values, starts: Values, lanes: Int[np.ndarray, " opened"]) -> None:
        """Start new trajectories.

        Args:
            params: their parameters, (opened,) each, by name.
            starts: their initial conditions, (opened,) each, by name.
            lanes: the lanes in which they start, (opened,).
        """

    @abc.abstractmethod
    def run_chunk(self, polls: int) -> ChunkOutput:
        """Advance all running lanes by up to `polls * POLL_INTERVAL` attempts, without waiting lanes."""


def started_row(
    model: Model,
    dtype: str,
    drive: RowDrive | None,
    values: Mapping[str, Float[Array, " ..."]],
    starts: Mapping[str, Number],
) -> tuple[Params, State]:
    """The parameters and the state of a trajectory at its start, which no recorder and no method decides.

    Args:
        model, drive: as of `OneLane`.
        dtype: the dtype of the time.
        values, starts: as of `OneLane.open`.
    """
    params = model.params(values) if drive is None else drive(values, jnp.zeros((), dtype))
    return params, model.init(params, starts)


def row_attempt(model: Model, numerics: ResolvedNumerics, drive: RowDrive | None, tangents: int) -> Advance:
    """The function `(constants, carry) -> carry` of one more attempt of a row.

    Args:
        model: the model.
        numerics: the numerics.
        drive: the parameters at a time, for a ramp or a staircase.
        tangents: the number of tangents that are advanced with the trajectory.
    """
    attempt = advance(model, numerics, drive=drive, sensitivities=tangents > 0)
    return with_tangents(attempt) if tangents else attempt


@final
class OneLane:
    """Opening, an attempt and a poll of one trajectory: pure functions of scalars and small arrays.

    `attempt` is its `row_attempt`.

    Args:
        model: the model.
        recorder: the recorder.
        numerics: the numerics.
        drive: the parameters at a time, for a ramp or a staircase.
    """

    def __init__(
        self, model: Model, recorder: Recorder, numerics: ResolvedNumerics, drive: RowDrive | None = None
    ) -> None:
        self.model = model
        self.recorder = recorder
        self.numerics = numerics
        self.drive = drive
        self.attempt = row_attempt(*self.deciding)

    @property
    def deciding(self) -> tuple[Model, ResolvedNumerics, RowDrive | None, int]:
        """The arguments of `row_attempt` for this trajectory."""
        return self.model, self.numerics, self.drive, self.recorder.exponents

    def open(self, values: Mapping[str, Float[Array, " ..."]], starts: Mapping[str, Number]) -> Opened:
        """Open a trajectory.

        Args:
            values: the parameters of its row, by name.
            starts: its initial conditions, by name; `STEP_FACTOR` is by default that of the numerics.
        """
        started = started_row(self.model, self.numerics.dtype, self.drive, values, starts)
        return self.open_at(values, starts, *started)

    def open_at(
        self,
        values: Mapping[str, Float[Array, " ..."]],
        starts: Mapping[str, Number],
        params: Params,
        state: State,
    ) -> Opened:
        """Open a trajectory at the results of `started_row`; other arguments as of `open`."""
        zero = jnp.zeros((), self.numerics.dtype)
        factor = jnp.asarray(starts.get(STEP_FACTOR, self.numerics.factor), zero.dtype)
        dt = factor * self._longest_step(values, params)
        stop = self.recorder.stop(params)
        carry = start(self.model, params, state, dt=dt, stop=stop, step_factor=factor)
        if self.recorder.exponents:
            directions = first_directions(coordinate_count(self.model), self.recorder.exponents)
            tangents = from_section(self.model, params, state, directions)
            carry = dataclasses.replace(carry, tangents=tangents)
        # constants of a trajectory are computed once
        constants = params if self.drive is None else values
        return Opened(constants, carry, *self.recorder.begin(params, carry))

    def _longest_step(self, values: Mapping[str, Float[Array, " ..."]], params: Params) -> Number:
        """The longest step of a row (s); for a moving parameter, the smallest over its values."""
        dt = jnp.asarray(step_of(self.model, self.numerics, params))  # a model's period may be a plain number
        if self.drive is None:
            return dt
        for t in self.drive.times:
            moved = self.drive(values, jnp.asarray(t, dt.dtype))
            dt = jnp.minimum(dt, step_of(self.model, self.numerics, moved))
        return dt

    def poll(self, constants: Params, carry: Carry, record: LaneRecord) -> PollResult:
        """Poll the recorder.

        Args:
            constants: as of `Opened`.
            carry: the trajectory; a moving parameter has its value at `carry.t`.
            record: the record before the poll.
        """
        params = constants if self.drive is None else self.drive(constants, carry.t)
        return self.recorder.poll(params, carry, record, carry.dt / self.numerics.steps_in_longest)
