"""The XLA engine: `advance` and a recorder, vmapped over lanes and jitted for each device.

Every device runs the same program with the same number of lanes, so a row's results do not depend on the
number of devices, on its lane, or on when it runs. (One program partitioned over the devices would not do:
XLA compiles it differently for one and for two devices, which changes the last bits.)
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, NamedTuple, final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, Real, Shaped

from gaitsweep.contract import Model, Params
from gaitsweep.engine.carry import Carry, Flag, Integer, select
from gaitsweep.engine.content import cached_by_content
from gaitsweep.engine.devices import Device, of_jax
from gaitsweep.engine.numerics import ResolvedNumerics
from gaitsweep.engine.recorders.recorder import BUFFER, POLL_INTERVAL, LaneRecord, Recorder
from gaitsweep.engine.sweep.lane import ChunkOutput, Lanes, OneLane, RowDrive, Values
from gaitsweep.engine.sweep.sweep_spec import SweepSpec
from gaitsweep.status import Status

# Polls of the recorder in one call of the device: 4 096 attempts, a fraction of a second. Between two calls
# the host shows progress, stores ended rows and refills lanes.
POLLS_PER_CHUNK = 64

Scalars = Mapping[str, Float[Array, " ..."]]  # the values of one row by name
Buffer = Float[Array, "buffer width"]  # the samples of one trajectory that wait for the host


class _Programs(NamedTuple):
    """The programs that open rows, merge them into lanes, and run a chunk."""

    open: Callable[..., Any]
    merge: Callable[..., Any]
    chunk: Callable[..., Any]


@final
class XlaLanes(Lanes):
    """The lanes of one device, as vectorised programs of XLA.

    Args:
        spec: the sweep.
        device: the device.
    """

    def __init__(self, spec: SweepSpec, device: Device) -> None:
        self.size = spec.lanes
        self.at_a_time = spec.lanes
        self._dtype = np.dtype(spec.numerics.dtype)
        self._device = of_jax(device)
        self._programs = _compiled(spec.model, spec.recorder, spec.numerics, spec.drive)
        self._lanes: Any = None  # constants, carry, record and samples of all lanes, once filled
        self._values: list[dict[str, Real[np.ndarray, "lanes ..."]]] = [{}, {}]

    def fill(self, params: Values, starts: Values, lanes: Int[np.ndarray, " opened"]) -> None:
        for of_lanes, columns in zip(self._values, (params, starts), strict=True):
            if not of_lanes:  # idle lanes are computed as well, with the values of the first row
                of_lanes |= {
                    name: np.repeat(values[:1], self.size, axis=0) for name, values in columns.items()
                }
            for name, values in columns.items():
                of_lanes[name][lanes] = values
        fresh = np.zeros(self.size, bool)
        fresh[lanes] = True
        opened = self._programs.open(*map(self._columns, self._values))
        if self._lanes is None:
            constants, carry, record, samples = opened
            status = self._put(np.where(fresh, Status.running, Status.complete).astype(np.int32))
            self._lanes = constants, carry, dataclasses.replace(record, status=status), samples
        else:
            self._lanes = self._programs.merge(self._put(fresh), opened, self._lanes)

    def run_chunk(self, polls: int) -> ChunkOutput:
        self._lanes, output = self._programs.chunk(self._put(np.int32(polls)), self._lanes)
        if not np.asarray(output.filled).any():
            # buffers are large and mostly empty: a broadcast zero has the same shape and needs no transfer
            empty = np.broadcast_to(np.zeros((), self._dtype), output.buffers.shape)
            output = output._replace(buffers=empty)
        return jax.device_get(output)

    def _columns(self, columns: Values) -> dict[str, Shaped[Array, " ..."]]:
        """The values of all lanes on the device."""
        return {name: self._put(np.asarray(column, self._dtype)) for name, column in columns.items()}

    def _put(self, array: Shaped[np.ndarray, " ..."] | np.generic) -> Shaped[Array, " ..."]:
        """The array on the device."""
        return jax.device_put(array, self._device)


# cached for the process, so that a notebook that runs a job again does not compile again
@cached_by_content(maxsize=16)
def _compiled(
    model: Model, recorder: Recorder, numerics: ResolvedNumerics, drive: RowDrive | None
) -> _Programs:
    """The programs of a sweep; each device compiles its own."""
    lane = OneLane(model, recorder, numerics, drive)
    chunk = partial(_chunk, jax.vmap(lane.attempt), jax.vmap(partial(_poll, lane)))
    return _Programs(
        open=jax.jit(jax.vmap(partial(_open, lane))),
        merge=jax.jit(jax.vmap(select)),
        chunk=jax.jit(chunk),
    )


def _open(lane: OneLane, values: Scalars, starts: Scalars) -> tuple[Params, Carry, LaneRecord, Buffer]:
    """A trajectory's constants, carry and record, and its buffer of samples."""
    constants, carry, record, sample, keep = lane.open(values, starts)
    buffer = jnp.zeros((BUFFER if sample.size else 0, sample.size), sample.dtype)
    return constants, carry, record, _appended(buffer, jnp.zeros((), jnp.int32), sample, keep)


def _poll(
    lane: OneLane, constants: Params, carry: Carry, record: LaneRecord, samples: Buffer
) -> tuple[Carry, LaneRecord, Buffer]:
    """A trajectory's carry, record and buffer after a poll."""
    carry, polled, sample, keep = lane.poll(constants, carry, record)
    return carry, polled, _appended(samples, record.filled, sample, keep)


def _appended(samples: Buffer, place: Integer, sample: Float[Array, " width"], keep: Flag) -> Buffer:
    """A buffer with a sample at `place` if `keep`."""
    at_place = (jnp.arange(samples.shape[0]) == place) & keep
    return jnp.where(at_place[:, None], sample, samples)


def _chunk(
    attempt: Callable[..., Any], poll: Callable[..., Any], polls: Integer, lanes: Any
) -> tuple[Any, ChunkOutput]:
    """The lanes after up to `polls` polls, with empty buffers, and the output for the host.

    Args:
        attempt: the attempt of all lanes.
        poll: the poll of all lanes.
        polls: the number of polls.
        lanes: constants, carry, record and samples of all lanes.
    """
    constants, carry, record, samples = lanes

    def goes_on(progress: Any) -> Flag:
        count, _, record, _ = progress
        return (count < polls) & jnp.any(record.status == Status.running)

    def attempts_and_poll(progress: Any) -> Any:
        count, carry, record, samples = progress
        carry = jax.lax.fori_loop(0, POLL_INTERVAL, lambda _, carry: attempt(constants, carry), carry)
        return count + 1, *poll(constants, carry, record, samples)

    beginning = (jnp.zeros((), jnp.int32), carry, record, samples)
    _, carry, record, samples = jax.lax.while_loop(goes_on, attempts_and_poll, beginning)
    output = ChunkOutput(record.results(carry), record.filled, record.samples, samples)  # type: ignore[arg-type]
    # the host reads the output, so the buffers are empty again
    record = dataclasses.replace(record, filled=jnp.zeros_like(record.filled))
    return (constants, carry, record, samples), output
