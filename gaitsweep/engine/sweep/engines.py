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
from gaitsweep.engine.sweep.sweep_spec import SweepSpec
from gaitsweep.errors import UserError

# Initial polls in a chunk of a kernel, by kind of device. On a CPU chunks are short, since an ended row waits
# for the end of its chunk; on a GPU the host's work after each chunk costs more.
KERNEL_POLLS_PER_CHUNK = {"cpu": 16, "gpu": 128}


class EngineError(UserError):
    """The requested engine cannot run the job on this machine; the message is a sentence."""


def choose(
    wanted: str,
    device: Device,
    model: Model,
    recorder: Recorder,
    numerics: ResolvedNumerics,
    drive: RowDrive | None,
) -> tuple[str, str | None]:
    """The name of the engine, and the reason if `auto` cannot use its first choice, the kernel.

    Args:
        wanted: auto, xla or kernel.
        device: the first device of the run.
        model, recorder, numerics, drive: the program that the engine runs.

    Raises:
        EngineError: `kernel` is requested but not available.
    """
    if wanted == "xla":
        return "xla", None
    reason = _obstacle(device, model, recorder, numerics, drive)
    if reason is None:
        return "kernel", None
    if wanted == "kernel":
        raise EngineError(f"engine.name is kernel, but {reason}. Allowed here: auto, xla.")
    return "xla", f"engine: xla, because {reason}."


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

        if (reason := unavailable()) is not None:
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

    A card has two, so that one runs while the host collects the other's results.
    """
    if spec.engine == "xla":
        return [xla.XlaLanes(spec, device)]
    if device.platform == "gpu":
        from gaitsweep.engine.kernel.cuda_lanes import CudaLanes

        halves = (spec.lanes + 1) // 2, spec.lanes // 2
        return [CudaLanes(dataclasses.replace(spec, lanes=half), device) for half in halves if half]
    from gaitsweep.engine.kernel.lanes import CpuLanes

    return [CpuLanes(spec)]


def polls_per_chunk(spec: SweepSpec) -> int:
    """Initial polls of the recorder between two returns to the host."""
    platform = spec.devices[0].platform
    return KERNEL_POLLS_PER_CHUNK[platform] if spec.engine == "kernel" else xla.POLLS_PER_CHUNK


def default_lanes(engine: str, n_rows: int, platform: str) -> int:
    """The default number of lanes on each device.

    XLA on a CPU reaches its full rate at about 256 lanes, and an attempt on a GPU costs about the same for 1
    lane and for 16 384. With fewer lanes than rows, lanes are refilled and devices end almost together.

    Args:
        engine: xla or kernel.
        n_rows: the number of rows.
        platform: the kind of device, such as cpu or gpu.
    """
    if platform != "cpu":
        least = 256
        most = 131072
        share = 1.0
    elif engine == "kernel":
        # many lanes make the host's work between chunks small, few lanes end at the same time
        least = 16
        most = 512
        share = 8.0
    else:
        least = 8
        most = 256
        share = 4.0
    return min(most, max(least, 2 ** math.ceil(math.log2(max(n_rows / share, 1.0)))))
