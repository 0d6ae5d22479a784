"""One NVIDIA GPU through cuda-core: its memory, copies, kernels."""

from __future__ import annotations

import ctypes
import importlib.util
from typing import Any

import numpy as np
from jaxtyping import Float

from gaitsweep.cache_folder import compiled_once
from gaitsweep.engine.kernel.gpu_program import THREADS

# A number on a card is float64.
_NUMBER = 8


def unavailable() -> str | None:
    """The reason why kernels on the GPU are not available, or None."""
    for module, package in (("cuda.core", "cuda-core"), ("cuda.bindings", "cuda-bindings")):
        if not _is_installed(module):
            return f"the package {package} is not installed"
    try:
        from cuda.bindings import nvrtc  # pyright: ignore[reportMissingImports]
        from cuda.core import Device  # pyright: ignore[reportMissingImports]

        nvrtc.nvrtcVersion()
    except Exception as error:  # its type depends on the package and its version
        return f"NVIDIA's compiler NVRTC cannot be loaded ({_first_line(error)})"
    try:
        return None if Device.get_all_devices() else "cuda-core finds no NVIDIA GPU"
    except Exception as error:
        return f"cuda-core finds no CUDA driver ({_first_line(error)})"


def _is_installed(module: str) -> bool:
    """Whether a module is installed, without importing it."""
    try:
        return importlib.util.find_spec(module) is not None
    except ModuleNotFoundError:  # of the package around it
        return False


def _first_line(error: Exception) -> str:
    return (str(error) or type(error).__name__).splitlines()[0].rstrip(".")


class PinnedMemory:
    """Pinned memory of the host for copies to and from a card, which takes some ms to allocate.

    Args:
        card: the card.
        least: the numbers for which there is room at first.
    """

    def __init__(self, card: CudaDevice, least: int = 0) -> None:
        self.card = card
        self.pinned: Any = None
        self._least = least
        self._host = np.zeros(0)

    def host(self, size: int, most: int) -> Float[np.ndarray, " numbers"]:
        """The memory (size,), the same at each call unless it has to grow, up to `most` numbers."""
        if self._host.size < size:
            # the next size is often a little larger
            room = max(self._least, min(most, max(size, 2 * self._host.size)))
            self.pinned = self.card.allocate_pinned(room)
            memory = (ctypes.c_double * room).from_address(int(self.pinned.handle))
            memory.owner = self.pinned  # a view that outlives this object stays valid
            self._host = np.frombuffer(memory, np.float64)
        return self._host[:size]


class DeviceArray:
    """An array of float64 on a card, and pinned memory of the host for copies to and from its beginning.

    Args:
        card: the card.
        shape: of the array, which is not initialised.
        memory: pinned memory that several arrays use in turn; by default memory of its own.
    """

    def __init__(self, card: CudaDevice, shape: tuple[int, ...], memory: PinnedMemory | None = None) -> None:
        self.card = card
        self.shape = shape
        self.size = int(np.prod(shape))
        self.buffer = card.allocate(self.size)
        self._memory = memory or PinnedMemory(card)

    def host(self, size: int) -> Float[np.ndarray, " numbers"]:
        """Pinned memory of the host (size,)."""
        return self._memory.host(size, self.size)

    def to_card(self, size: int) -> None:
        """Copy the first `size` numbers of `host` to the card."""
        self.card.copy(self._memory.pinned, self.buffer, size)

    def from_card(self, size: int) -> Float[np.ndarray, " numbers"]:
        """The first `size` numbers of the array, a view of `host`."""
        host = self.host(size)
        if size:
            self.card.copy(self.buffer, self._memory.pinned, size)
            self.card.wait()
        return host


class CudaDevice:
    """One GPU, in the context that JAX uses too.

    Args:
        number: the number of the device.
    """

    def __init__(self, number: int) -> None:
        import cuda.core as core  # pyright: ignore[reportMissingImports]

        self._core = core
        self._number = number
        device = self.use()
        self._architecture = f"sm_{device.arch}"
        self._stream = device.create_stream()
        # a thread that waits for a stream keeps a core busy, which other sweeps on this machine need
        self._reached = device.create_event(core.EventOptions(blocking_sync=True))
        self._pinned = core.LegacyPinnedMemoryResource()

    def use(self) -> Any:
        """Make this card the calling thread's; every thread that uses it calls this first."""
        device = self._core.Device(self._number)
        device.set_current()
        return device

    def allocate(self, size: int) -> Any:
        """Memory of the card for `size` numbers."""
        return self.use().allocate(max(size, 1) * _NUMBER, stream=self._stream)

    def allocate_pinned(self, size: int) -> Any:
        """Pinned memory of the host for `size` numbers, which the card copies at full rate."""
        return self._pinned.allocate(size * _NUMBER)

    def copy(self, source: Any, target: Any, size: int) -> None:
        """Copy numbers from one memory to another, after all earlier launches.

        Args:
            source, target: buffers of `allocate` or `allocate_pinned`.
            size: how many numbers are copied, the first ones.

        Raises:
            RuntimeError: the driver refuses the copy.
        """
        self._copy_bytes(source, target, size * _NUMBER)

    def _copy_bytes(self, source: Any, target: Any, size: int) -> None:
        """Copy so many bytes from one memory to another; see `copy`."""
        if not size:
            return
        from cuda.bindings import driver  # pyright: ignore[reportMissingImports]

        # JAX leaves the context of the card that it used last, in which copies of another card are refused
        self.use()
        # cuda-core's own copies between the host and a second card end in CUDA_ERROR_INVALID_VALUE
        places = (int(memory.handle) for memory in (target, source))
        (failed,) = driver.cuMemcpyAsync(*places, size, int(self._stream.handle))
        if failed:
            raise RuntimeError(f"{size} bytes could not be copied to or from a GPU: {failed.name}.")

    def wait(self) -> None:
        """Wait for all that was launched and copied; the thread sleeps meanwhile."""
        self._stream.record(self._reached)
        self._reached.sync()

    def module(self, source: str, *, contraction: bool = True) -> Any:
        """The kernels of a source, compiled by NVRTC now, or loaded from the cache.

        Args:
            source: CUDA C without headers, whose kernels are `extern "C"`.
            contraction: whether a product and a sum may become one instruction, which rounds once.
        """
        from cuda.bindings import nvrtc  # pyright: ignore[reportMissingImports]

        def compile_() -> bytes:
            options = self._core.ProgramOptions(arch=self._architecture, fma=contraction, std="c++17")
            return bytes(self._core.Program(source, "c++", options).compile("cubin").code)

        _, major, minor = nvrtc.nvrtcVersion()
        key = (source, f"NVRTC {major}.{minor}", self._architecture, f"contraction {contraction}")
        return self._core.ObjectCode.from_cubin(compiled_once("cubin", key, compile_))

    def set_constant(self, module: Any, name: str, value: bytes) -> None:
        """Set a variable of a module in the card's constant memory.

        Args:
            module: of `module`.
            name: the variable's name in the source.
            value: its bytes.

        Raises:
            RuntimeError: the module has no such variable, or a smaller one.
        """
        from cuda.bindings import driver  # pyright: ignore[reportMissingImports]

        # cuda-core has no access to variables
        failed, address, size = driver.cuLibraryGetGlobal(module.handle, name.encode())
        if failed:
            raise RuntimeError(f"The variable {name} of a kernel was not found: {failed.name}.")
        if size < len(value):
            raise RuntimeError(f"The variable {name} of a kernel has {size} bytes, not {len(value)}.")
        pinned = self._pinned.allocate(len(value))
        ctypes.memmove(int(pinned.handle), value, len(value))
        variable = self._core.Buffer.from_handle(int(address), len(value), owner=module)
        self._copy_bytes(pinned, variable, len(value))
        self.wait()

    def threads(self, kernel: Any) -> int:
        """The number of threads of a kernel that the card runs at a time."""
        blocks = kernel.occupancy.max_active_blocks_per_multiprocessor(THREADS, 0)
        return THREADS * blocks * self.use().properties.multiprocessor_count

    def launch(self, kernel: Any, threads: int, *args: DeviceArray | int) -> None:
        """Start a kernel with at least `threads` threads and these arguments."""
        config = self._core.LaunchConfig(grid=-(-threads // THREADS), block=THREADS)
        converted = [a.buffer if isinstance(a, DeviceArray) else ctypes.c_longlong(a) for a in args]
        self._core.launch(self._stream, config, kernel, *converted)
