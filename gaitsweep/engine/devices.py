"""The devices on which this process computes: its cores, its accelerators, and the systems without any.

`sweep/engine_choice.py` chooses kernel or XLA on them, and the number of rows in a batch.

JAX fixes its devices at its first computation, and a fork of a process that has computed with JAX lacks JAX's
threads, so that a computation there would never end.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import importlib.util
import json
import os
import pkgutil
import resource
import sys
from importlib import metadata
from pathlib import Path
from typing import Any, NamedTuple

import jax

from gaitsweep.cache_folder import cache_folder, load_cached, store_cached
from gaitsweep.errors import ArgumentError, UnsupportedSystem
from gaitsweep.lazy_imports import after_jax, jax_version

Device = Any  # a jax.Device, which type checkers do not accept as a type, or a `KnownDevice`


class KnownDevice(NamedTuple):
    """A device that is known before JAX is imported, with the attributes of a jax.Device that runs need.

    Attributes:
        platform: "cpu" or "gpu".
        device_kind: its kind, as JAX names it.
        local_hardware_id: its place among the local devices.
    """

    platform: str
    device_kind: str
    local_hardware_id: int


# Below this limit of virtual memory LLVM ends the process (measured on two cores), bytes.
MIN_VIRTUAL_MEMORY = 2_300_000_000

_computed_before = False  # whether JAX or CUDA had begun to work when this process was forked
_cards_known = False  # whether CUDA has been asked for cards


def _note_fork() -> None:
    """Note in a new fork whether JAX had computed, or CUDA had begun, in its parent."""
    global _computed_before
    _computed_before |= _cards_known
    if "jax" not in sys.modules:
        return
    try:
        from jax._src.xla_bridge import backends_are_initialized
    except ImportError:  # a version of JAX that does not tell it is assumed to have computed
        _computed_before = True
    else:
        _computed_before |= backends_are_initialized()


os.register_at_fork(after_in_child=_note_fork)


def refuse_fork() -> None:
    """Refuse to compute in a fork of a process that has computed with JAX, whose threads it lacks.

    Raises:
        UnsupportedSystem: this process is such a fork.
    """
    if _computed_before:
        raise UnsupportedSystem(
            "This process is a fork of one that has computed with JAX or a GPU, and lacks their threads, so "
            "the computation would never end. Use one call with all values, which uses all cores; or start "
            "processes by multiprocessing.get_context('spawn'), or pass a Dask client as client=."
        )


def _requested_platforms() -> str | None:
    """The platforms that JAX may use, separated by commas, as JAX or else JAX_PLATFORMS has them."""
    if "jax" in sys.modules:
        return jax.config.jax_platforms  # pyright: ignore[reportAttributeAccessIssue]
    return os.environ.get("JAX_PLATFORMS")


def host_device() -> Device:
    """The device of computations other than rows: the CPU, unless JAX may not use it (JAX_PLATFORMS=cuda)."""
    platforms = _requested_platforms()
    if platforms and "cpu" not in platforms.split(","):
        return jax.local_devices()[0]
    return jax.local_devices(backend="cpu")[0]


def default_platform() -> str:
    """The platform, such as "cpu", of computations that are placed on no device."""
    device = jax.config.jax_default_device  # pyright: ignore[reportAttributeAccessIssue]
    if device is None:
        return jax.default_backend()
    return device if isinstance(device, str) else device.platform


def usable_cores() -> int:
    """The number of CPU cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def see_all_cores() -> None:
    """Make each usable core a JAX device, which is possible only before JAX's first computation.

    Enables float64, gaitsweep's default. Before JAX is imported, it is done as JAX is.
    """
    after_jax(_see_all_cores)


def _see_all_cores() -> None:
    """`see_all_cores` in a process that has imported JAX."""
    jax.config.update("jax_enable_x64", True)
    cores = usable_cores()
    # after the first computation the number of devices is fixed
    with contextlib.suppress(RuntimeError):
        if jax.config.jax_num_cpu_devices < cores:  # pyright: ignore[reportAttributeAccessIssue]
            jax.config.update("jax_num_cpu_devices", cores)


# Beginnings of the environment variables that JAX reads, and of those of them that do not change its devices,
# or whose effect `_known_devices` knows.
_SETTINGS = ("JAX_", "XLA_", "PJRT_", "TPU_LIBRARY_PATH")
_KNOWN_SETTINGS = (
    *("JAX_PLATFORMS", "JAX_DEFAULT_DEVICE", "JAX_ENABLE_X64", "JAX_LOG"),
    *("JAX_COMPILATION_CACHE", "JAX_PERSISTENT_CACHE"),
)


def _known_devices() -> list[KnownDevice] | None:
    """The devices that JAX would have, where they are certain without its import, which takes time.

    They are the cores where no accelerator is installed or allowed, and cards that JAX has found before.
    """
    settings = [name for name in os.environ if name.startswith(_SETTINGS)]
    if "jax" in sys.modules or not all(name.startswith(_KNOWN_SETTINGS) for name in settings):
        return None
    requested = [name for name in os.environ.get("JAX_PLATFORMS", "").split(",") if name]
    if set(requested) == {"cpu"} or not (requested or _accelerators()):
        return [KnownDevice("cpu", "cpu", number) for number in range(usable_cores())]
    confirmed = _file_of_cards() if not requested or requested[0] in ("cuda", "gpu") else None
    cards = None if confirmed is None else load_cached(confirmed)
    return None if cards is None else [KnownDevice(*card) for card in json.loads(cards)]


def _file_of_cards() -> Path | None:
    """The file that has the cards which JAX finds here; None where there is no card, or no cache.

    Its name is a digest of what decides that: the cards with their driver, the versions of JAX and of its
    plugins, and the environment in which CUDA's libraries are found.
    """
    global _cards_known
    folder = cache_folder("programs")
    accelerators = _accelerators()
    if folder is None or not any(name.startswith("xla_cuda") for name in accelerators):
        return None
    _cards_known = True
    try:
        cards = _cards_and_driver()
    except Exception:  # its type depends on the package and its version; JAX then says what is missing
        return None
    variables = {
        name: os.environ.get(name) for name in ("JAX_PLATFORMS", "LD_LIBRARY_PATH", "CUDA_VISIBLE_DEVICES")
    }
    deciding = (*cards, jax_version(), sorted(accelerators.items()), sorted(variables.items()))
    return folder / f"devices_{hashlib.sha256(repr(deciding).encode()).hexdigest()[:32]}"


@functools.cache
def _cards_and_driver() -> tuple[list[str], list[str]]:
    """The names of the cards of this process, and the version of their driver."""
    from cuda.bindings import driver  # pyright: ignore[reportMissingImports]
    from cuda.core import Device as Card  # pyright: ignore[reportMissingImports]

    return [card.name for card in Card.get_all_devices()], [str(n) for n in driver.cuDriverGetVersion()]


@functools.cache
def _accelerators() -> dict[str, str]:
    """The installed plugins with which JAX uses accelerators: the version of each, as far as it has one."""
    package = importlib.util.find_spec("jax_plugins")
    folders = [] if package is None else package.submodule_search_locations
    versions = dict.fromkeys((module.name for module in pkgutil.iter_modules(folders)), "")
    if importlib.util.find_spec("libtpu") is not None:
        versions["libtpu"] = ""
    points = metadata.entry_points(group="jax_plugins")
    return versions | {point.name: "" if point.dist is None else point.dist.version for point in points}


def of_jax(device: Device) -> Device:
    """The jax.Device of a device of `local_devices`.

    Raises:
        UnsupportedSystem: JAX lacks it.
    """
    if not isinstance(device, KnownDevice):
        return device
    with contextlib.suppress(RuntimeError):  # of a platform that does not start
        for found in jax.local_devices()[device.local_hardware_id :][:1]:
            if found.platform == device.platform:
                return found
    raise UnsupportedSystem(
        f"JAX does not find device {device.local_hardware_id} ({device.device_kind}) here. For an NVIDIA GPU "
        "install 'gaitsweep[cuda]' again, or set JAX_PLATFORMS=cpu."
    )


def local_devices(count: int | None = None) -> list[Device]:
    """The devices of a run: all local devices, or the first `count`; on a CPU one for each usable core.

    JAX is not imported where they are known without it.

    Args:
        count: the number of devices, or None for all.

    Raises:
        ArgumentError: more devices are requested than there are.
        UnsupportedSystem: as for `refuse_fork`.
    """
    refuse_fork()
    see_all_cores()
    devices = _known_devices()
    if devices is None:
        imports_jax = "jax" not in sys.modules  # as the next process would, for this alone
        devices = jax.local_devices()
        if imports_jax and devices[0].platform == "gpu" and (file := _file_of_cards()) is not None:
            store_cached(
                file, json.dumps([[d.platform, d.device_kind, d.local_hardware_id] for d in devices]).encode()
            )
    if count is not None and count > len(devices):
        available = "only 1 device" if len(devices) == 1 else f"only {len(devices)} devices"
        raise ArgumentError(f"engine.devices is {count}, but there is {available} here.")
    return devices[:count]


def refuse_missing_platform() -> None:
    """Refuse to compute where JAX cannot.

    Raises:
        UnsupportedSystem: JAX finds no device of JAX_PLATFORMS, this process is a fork of one that has
            computed with JAX, or its limit of virtual memory is too low for compilers.
    """
    refuse_fork()
    limit, _ = resource.getrlimit(resource.RLIMIT_AS)
    if limit != resource.RLIM_INFINITY and limit < MIN_VIRTUAL_MEMORY:
        raise UnsupportedSystem(
            f"This process may use {limit / 1e9:.1f} GB of virtual memory (ulimit -v), but compiling and "
            f"running a model takes at least {MIN_VIRTUAL_MEMORY / 1e9:.1f} GB: raise the limit."
        )
    platforms = _requested_platforms()
    if not platforms or platforms == "cpu":
        return
    try:
        local_devices()
    except (AssertionError, RuntimeError) as error:  # which of them depends on the version of JAX
        raise UnsupportedSystem(
            f"JAX_PLATFORMS is {platforms}, but JAX finds no such device here. On an NVIDIA GPU install "
            "'gaitsweep[cuda]'; without JAX_PLATFORMS, JAX uses the available devices."
        ) from error
