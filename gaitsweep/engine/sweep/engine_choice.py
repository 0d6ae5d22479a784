"""The choice of the engine of a job, and its lanes on each device."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

from gaitsweep.contract import Model
from gaitsweep.engine.devices import Device
from gaitsweep.engine.numerics import ResolvedNumerics
from gaitsweep.engine.recorders.recorder import Recorder
from gaitsweep.engine.sweep import xla
from gaitsweep.engine.sweep.lane import Lanes, RowDrive
from gaitsweep.engine.sweep.sweep_spec import EngineName, RequestedEngine, SweepSpec
from gaitsweep.errors import UserError

# Initial polls in a chunk of a kernel, by kind of device. On a CPU chunks are short, since an ended row waits
# for the end of its chunk; on a GPU the host's work after each chunk costs more.
KERNEL_POLLS_PER_CHUNK = {"cpu": 16, "gpu": 128}
# The most lanes of a kernel on a core by default.
MOST_LANES = 512
MOST_LANES_IN_MEMORY = 4096


class EngineError(UserError):
    """The requested engine cannot run the job on this machine; the message is a sentence."""


def choose(
    requested: RequestedEngine,
    device: Device,
    model: Model,
    recorder: Recorder,
    numerics: ResolvedNumerics,
    drive: RowDrive | None,
) -> tuple[EngineName, str | None]:
    """The name of the engine, and the reason why `auto` cannot use its first choice, the kernel, or None.

    Args:
        requested: the engine that the job asks for.
        device: the first device of the run.
        model: the model.
        recorder: the recorder.
        numerics: the numerics.
        drive: the parameters at a time, for a ramp or a staircase.

    Raises:
        EngineError: `kernel` is requested but not available.
    """
    if requested == "xla":
        return "xla", None
    reason = _obstacle(device, model, recorder, numerics, drive)
    if reason is None:
        return "kernel", None
    if requested == "kernel":
        raise EngineError(f"engine.name is kernel, but {reason}. Allowed here: auto, xla.")
    return "xla", reason


def _obstacle(
    device: Device, model: Model, recorder: Recorder, numerics: ResolvedNumerics, drive: RowDrive | None
) -> str | None:
    """The reason why a scalar kernel is not available, or None."""
    if model.host_parameters:
        return f"{model.name} computes on the host with {', '.join(model.host_parameters)}"
    if device.platform not in KERNEL_POLLS_PER_CHUNK:
        return f"there are no kernels for {device.platform}"
    if device.platform == "gpu":
        from gaitsweep.engine.kernel.cuda_device import unavailable

        reason = unavailable()
        if reason is not None:
            return reason
    from gaitsweep.engine.kernel.lanes import kernel_of
    from gaitsweep.engine.kernel.trace import UnsupportedError

    try:
        kernel_of(model, recorder, numerics, drive)
    except UnsupportedError as error:
        return str(error)
    return None


def groups_on(device: Device, spec: SweepSpec) -> Sequence[Lanes]:
    """The lanes of a sweep on one device, in groups that run independently of each other.

    A GPU has two, so that one runs while the host collects the results of the other.

    Args:
        device: the device.
        spec: the sweep.
    """
    if spec.engine == "xla":
        return [xla.XlaLanes(spec, device)]
    if device.platform == "gpu":
        from gaitsweep.engine.kernel.cuda_lanes import CudaLanes

        sizes = [size for size in ((spec.lanes + 1) // 2, spec.lanes // 2) if size]
        return [CudaLanes(dataclasses.replace(spec, lanes=size), device) for size in sizes]
    from gaitsweep.engine.kernel.lanes import CpuLanes

    return [CpuLanes(spec)]


def polls_per_chunk(spec: SweepSpec) -> int:
    """Initial polls of the recorder between two returns to the host."""
    if spec.engine != "kernel":
        return xla.POLLS_PER_CHUNK
    platform = spec.devices[0].platform
    polls = KERNEL_POLLS_PER_CHUNK[platform]
    # a core takes as long for its first chunk with many lanes as with few
    return polls if platform != "cpu" else max(1, polls * MOST_LANES // max(spec.lanes, MOST_LANES))


def default_lanes(engine: EngineName, n_rows: int, platform: str, *, in_memory: bool = False) -> int:
    """The default number of lanes on each device.

    Enough that a device reaches its full rate (`python -m benchmarks.engines`). With fewer lanes than rows,
    lanes are refilled and devices end almost together.

    Args:
        engine: xla or kernel.
        n_rows: the number of rows.
        platform: the kind of device, such as cpu or gpu.
        in_memory: whether the table is in memory, so that rows which are open are lost no more than others.
    """
    if platform != "cpu":
        # in memory, large groups of lanes keep the host's work for each group small
        fewest = 256
        most = 524_288 if in_memory else 131_072
        rows_per_lane = 8.0 if in_memory else 1.0
    elif engine == "kernel":
        # many lanes make the host's work between chunks small, few lanes end at the same time
        fewest = 16
        most = MOST_LANES_IN_MEMORY if in_memory else MOST_LANES
        rows_per_lane = 8.0
    else:
        fewest = 8
        most = 256
        rows_per_lane = 4.0
    power_of_two = 2 ** math.ceil(math.log2(max(n_rows / rows_per_lane, 1.0)))
    return min(most, max(fewest, power_of_two))
