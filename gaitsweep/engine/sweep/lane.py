"""The functions of one trajectory; each engine vectorises them differently."""

from __future__ import annotations

import abc
import dataclasses
from collections.abc import Callable, Mapping
from typing import NamedTuple, final

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, Real

from gaitsweep.contract import Model, Params
from gaitsweep.engine.advance import advance
from gaitsweep.engine.carry import Carry, Flag, Number, start
from gaitsweep.engine.numerics import STEP_FACTOR, ResolvedNumerics, step_of
from gaitsweep.engine.recorders.recorder import LaneRecord, PollResult, Recorder
from gaitsweep.engine.tangents import coordinate_count, first_directions, from_section, with_tangents

# The parameters at a time (s), from the values of a row: a ramp or a staircase. Its optional attribute
# `times` lists the times (s) at which the step length has to be evaluated.
RowDrive = Callable[[Mapping[str, Float[Array, " ..."]], Number], Params]

Values = Mapping[str, Real[np.ndarray, "rows ..."]]


class Opened(NamedTuple):
    """A trajectory at its start.

    `constants` are what does not change along it, `sample` (width,) is its first sample, and `keep` whether
    to keep that sample.
    """

    constants: Params
    carry: Carry
    record: LaneRecord
    sample: Float[Array, " width"]
    keep: Flag


class ChunkOutput(NamedTuple):
    """The output of a chunk of attempts for the host; the first axis of each array is the lane.

    `numbers` are those of `RowOutcome` by name, final where a row has ended; `buffers` (lanes, BUFFER, width)
    have new samples, the first `filled` (lanes,) of each; `samples` (lanes,) counts those of the whole row.
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
    def fill(self, params: Values, starts: Values, fresh: Bool[np.ndarray, " lanes"]) -> None:
        """Start new trajectories.

        Args:
            params, starts: the parameters and the initial conditions of all lanes, (size,) each, by name.
            fresh: mask of the lanes in which a trajectory starts, (size,).
        """

    @abc.abstractmethod
    def run_chunk(self, polls: int) -> ChunkOutput:
        """Advance all running lanes by up to `polls * POLL_INTERVAL` attempts, without waiting lanes."""


@final
class OneLane:
    """Opening, an attempt and a poll of one trajectory: pure functions of scalars and small arrays.

    Args:
        model, recorder, numerics: those of the sweep.
        drive: the parameters at a time, for a ramp or a staircase.
    """

    def __init__(
        self, model: Model, recorder: Recorder, numerics: ResolvedNumerics, drive: RowDrive | None = None
    ) -> None:
        self.model = model
        self.recorder = recorder
        self.numerics = numerics
        self.driven = drive is not None
        self._drive = drive
        attempt = advance(model, numerics, drive=drive, sensitivities=recorder.exponents > 0)
        self._advance = with_tangents(attempt) if recorder.exponents else attempt

    def params_at(self, values: Mapping[str, Float[Array, " ..."]], t: Number) -> Params:
        """The model's parameters at a time (s), from the values of a row; constant without a drive."""
        return self.model.params(values) if self._drive is None else self._drive(values, t)

    def open(self, values: Mapping[str, Float[Array, " ..."]], starts: Mapping[str, Number]) -> Opened:
        """Open a trajectory.

        Args:
            values: the parameters of its row, by name.
            starts: its initial conditions, by name; `STEP_FACTOR` is by default that of the numerics.
        """
        zero = jnp.zeros((), self.numerics.dtype)
        params = self.params_at(values, zero)
        state = self.model.init(params, starts)
        factor = jnp.asarray(starts.get(STEP_FACTOR, self.numerics.factor), zero.dtype)
        dt = factor * self._longest_step(values, params)
        stop = self.recorder.stop(params)
        carry = start(self.model, params, state, dt=dt, stop=stop, step_factor=factor)
        if count := self.recorder.exponents:
            directions = first_directions(coordinate_count(self.model), count)
            tangents = from_section(self.model, params, state, directions)
            carry = dataclasses.replace(carry, tangents=tangents)
        # constants of a trajectory are computed once
        constants = values if self.driven else params
        return Opened(constants, carry, *self.recorder.begin(params, carry))

    def _longest_step(self, values: Mapping[str, Float[Array, " ..."]], params: Params) -> Number:
        """The longest step of a row (s); for a moving parameter, the smallest over its values."""
        dt = jnp.asarray(step_of(self.model, self.numerics, params))  # a model's period may be a plain number
        for t in getattr(self._drive, "times", ()) if self.driven else ():
            moved = self.params_at(values, jnp.asarray(t, dt.dtype))
            dt = jnp.minimum(dt, step_of(self.model, self.numerics, moved))
        return dt

    def attempt(self, constants: Params, carry: Carry) -> Carry:
        """The trajectory after one more attempt."""
        return self._advance(constants, carry)

    def poll(self, constants: Params, carry: Carry, record: LaneRecord) -> PollResult:
        """Poll the recorder; a moving parameter has its present value."""
        params = self.params_at(constants, carry.t) if self.driven else constants
        return self.recorder.poll(params, carry, record, carry.dt / self.numerics.steps_in_longest)
