"""The XLA engine: `advance` and a recorder, vmapped over lanes and jitted for each device.

Every device runs the same program with the same number of lanes, so a row's results do not depend on the
number of devices, on its lane, or on when it runs. (One program partitioned over the devices would not do:
XLA compiles it differently for one and for two devices, which changes the last bits.)
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Shaped

from gaitsweep.contract import Model, Params, Status
from gaitsweep.engine.carry import Carry, select
from gaitsweep.engine.content import cached_by_content
from gaitsweep.engine.devices import Device
from gaitsweep.engine.numerics import ResolvedNumerics
from gaitsweep.engine.recorders.recorder import BUFFER, POLL_INTERVAL, LaneRecord, Recorder
from gaitsweep.engine.shapes import Flag, Integer
from gaitsweep.engine.sweep.lane import ChunkOutput, Lanes, OneLane, RowDrive, Values
from gaitsweep.engine.sweep.sweep_spec import SweepSpec

# Polls of the recorder in one call of the device: 4 096 attempts, a fraction of a second. Between two calls
# the host shows progress, stores ended rows and refills lanes.
POLLS_PER_CHUNK = 64

Scalars = Mapping[str, Float[Array, " ..."]]  # the values of one row by name
Buffer = Float[Array, "buffer width"]  # the samples of one trajectory that wait for the host


@final
class XlaLanes(Lanes):
    """The lanes of one device, as vectorised programs of XLA.

    Args:
        spec: the sweep.
        device: the device.
    """

    def __init__(self, spec: SweepSpec, device: Device) -> None:
        self.size = self.at_a_time = spec.lanes
        self._dtype = np.dtype(spec.numerics.carried)
        self._device = device
        self._open, self._merge, self._chunk = _programs(spec.model, spec.recorder, spec.numerics, spec.drive)
        self._lanes: Any = None

    def fill(self, params: Values, starts: Values, fresh: Bool[np.ndarray, " lanes"]) -> None:
        values = {k: self._put(np.asarray(v, self._dtype)) for k, v in params.items()}
        begin = {k: self._put(np.asarray(v, self._dtype)) for k, v in starts.items()}
        opened = self._open(values, begin)
        if self._lanes is None:
            constants, carry, record, samples = opened
            status = self._put(np.where(fresh, Status.running, Status.complete).astype(np.int32))
            self._lanes = constants, carry, dataclasses.replace(record, status=status), samples
        else:
            self._lanes = self._merge(self._put(fresh), opened, self._lanes)

    def run_chunk(self, polls: int) -> ChunkOutput:
        self._lanes, output = self._chunk(self._put(np.int32(polls)), self._lanes)
        if not np.asarray(output.filled).any():
            # buffers are large and mostly empty: a broadcast zero has the same shape and needs no transfer
            empty = np.broadcast_to(np.zeros((), self._dtype), output.buffers.shape)
            output = output._replace(buffers=empty)
        return jax.device_get(output)

    def _put(self, array: Shaped[np.ndarray, " ..."] | np.generic) -> Shaped[Array, " ..."]:
        return jax.device_put(array, self._device)


# cached for the process, so that a notebook that runs a job again does not compile again
@cached_by_content(maxsize=16)
def _programs(
    model: Model, recorder: Recorder, numerics: ResolvedNumerics, drive: RowDrive | None
) -> tuple[Callable[..., Any], Callable[..., Any], Callable[..., Any]]:
    """The programs that open rows, merge them into lanes and run a chunk; each device compiles its own."""
    one = OneLane(model, recorder, numerics, drive)
    chunk = partial(_chunk, jax.vmap(one.attempt), jax.vmap(partial(_poll, one)))
    return jax.jit(jax.vmap(partial(_open, one))), jax.jit(jax.vmap(select)), jax.jit(chunk)


def _open(one: OneLane, values: Scalars, starts: Scalars) -> tuple[Params, Carry, LaneRecord, Buffer]:
    """A trajectory's constants, carry and record, and its buffer of samples."""
    constants, carry, record, sample, keep = one.open(values, starts)
    buffer = jnp.zeros((BUFFER if sample.size else 0, sample.size), sample.dtype)
    return constants, carry, record, _appended(buffer, jnp.zeros((), jnp.int32), sample, keep)


def _poll(
    one: OneLane, constants: Params, carry: Carry, record: LaneRecord, samples: Buffer
) -> tuple[Carry, LaneRecord, Buffer]:
    """A trajectory's carry, record and buffer after a poll."""
    carry, after, sample, keep = one.poll(constants, carry, record)
    return carry, after, _appended(samples, record.filled, sample, keep)


def _appended(samples: Buffer, place: Integer, sample: Float[Array, " width"], keep: Flag) -> Buffer:
    """A buffer with a sample at `place` if `keep`."""
    at_place = (jnp.arange(samples.shape[0]) == place) & keep
    return jnp.where(at_place[:, None], sample, samples)


def _chunk(
    attempt: Callable[..., Any], poll: Callable[..., Any], polls: Integer, lanes: Any
) -> tuple[Any, ChunkOutput]:
    """The lanes after up to `polls` polls, with empty buffers, and the output for the host."""
    constants, carry, record, samples = lanes

    def goes_on(loop: Any) -> Flag:
        count, _, record, _ = loop
        return (count < polls) & jnp.any(record.status == Status.running)

    def attempts_and_poll(loop: Any) -> Any:
        count, carry, record, samples = loop
        carry = jax.lax.fori_loop(0, POLL_INTERVAL, lambda _, c: attempt(constants, c), carry)
        return count + 1, *poll(constants, carry, record, samples)

    opening = (jnp.zeros((), jnp.int32), carry, record, samples)
    _, carry, record, samples = jax.lax.while_loop(goes_on, attempts_and_poll, opening)
    output = ChunkOutput(record.results(carry), record.filled, record.samples, samples)  # type: ignore[arg-type]
    # the host reads the output, so the buffers are empty again
    record = dataclasses.replace(record, filled=jnp.zeros_like(record.filled))
    return (constants, carry, record, samples), output
