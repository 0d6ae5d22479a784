"""Rival: CUDA C++ by hand, a thread for each trajectory (multilegged.cu).

Needs no package: the driver (libcuda) is called through ctypes, and the source is compiled on the spot by
NVRTC, of JAX's CUDA wheels or of the system, or by nvcc. The kernel is compiled for several numbers of
blocks that share an SM (more threads, fewer registers for each) and measured with the best of them.
"""

from __future__ import annotations

import ctypes
import shutil
import site
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from ctypes import byref, c_char_p, c_int, c_size_t, c_uint, c_void_p
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .by_hand import LEGS, PATIENCE, Found, Starts, Table, missing, timed
from .starts import Parameters, Row, reference_crossings

NAME = "CUDA C++ by hand, a thread a trajectory"
SOURCE = Path(__file__).with_name("multilegged.cu")
BLOCK = 128
BLOCKS_AN_SM = (2, 3, 4)
MAJOR, MINOR = 75, 76  # the driver's numbers for a device's compute capability


class Failed(RuntimeError):
    """A call of the driver or of NVRTC failed, or there is nothing to call."""


def checked(code: int, call: str) -> None:
    if code:
        raise Failed(f"{call} failed with {code}")


@lru_cache(maxsize=1)
def driver() -> ctypes.CDLL | None:
    """Libcuda with the first device's context current; None where there is no device."""
    try:
        cuda = ctypes.CDLL("libcuda.so.1")
    except OSError:
        return None
    count = c_int()
    if cuda.cuInit(0) or cuda.cuDeviceGetCount(byref(count)) or count.value == 0:
        return None
    context = c_void_p()
    checked(cuda.cuDevicePrimaryCtxRetain(byref(context), c_int(0)), "cuDevicePrimaryCtxRetain")
    checked(cuda.cuCtxSetCurrent(context), "cuCtxSetCurrent")
    return cuda


def device(cuda: ctypes.CDLL) -> tuple[str, str]:
    """The first device's name and architecture (sm_90)."""
    name, numbers = ctypes.create_string_buffer(100), (c_int(), c_int())
    checked(cuda.cuDeviceGetName(name, 100, c_int(0)), "cuDeviceGetName")
    for number, attribute in zip(numbers, (MAJOR, MINOR), strict=True):
        checked(cuda.cuDeviceGetAttribute(byref(number), attribute, c_int(0)), "cuDeviceGetAttribute")
    return name.value.decode(), f"sm_{numbers[0].value}{numbers[1].value}"


def runtime_compilers() -> Iterator[Path]:
    """Every libnvrtc of the wheels, then of the system."""
    wheels = dict.fromkeys([*site.getsitepackages(), *sys.path])
    for root in wheels:
        yield from sorted(Path(root or ".").glob("nvidia/**/libnvrtc.so.*"), reverse=True)
    for folder in (
        "/usr/local/cuda/lib64",
        "/usr/local/cuda/targets/x86_64-linux/lib",
        "/usr/lib/x86_64-linux-gnu",
    ):
        yield from sorted(Path(folder).glob("libnvrtc.so.*"), reverse=True)


def by_nvrtc(library: Path, options: list[str]) -> bytes:
    """The cubin of the kernel, by this libnvrtc."""
    for part in library.parent.glob("libnvrtc-builtins.so*"):
        ctypes.CDLL(str(part), mode=ctypes.RTLD_GLOBAL)
    nvrtc = ctypes.CDLL(str(library))
    program, size = c_void_p(), c_size_t()
    source = SOURCE.read_bytes()
    made = nvrtc.nvrtcCreateProgram(byref(program), c_char_p(source), b"multilegged.cu", 0, None, None)
    checked(made, "nvrtcCreateProgram")
    arguments = (c_char_p * len(options))(*(option.encode() for option in options))
    if nvrtc.nvrtcCompileProgram(program, len(options), arguments):
        nvrtc.nvrtcGetProgramLogSize(program, byref(size))
        log = ctypes.create_string_buffer(size.value)
        nvrtc.nvrtcGetProgramLog(program, log)
        raise Failed(f"{library.name}: {(log.value.decode().strip().splitlines() or ['no log'])[0]}")
    checked(nvrtc.nvrtcGetCUBINSize(program, byref(size)), "nvrtcGetCUBINSize")
    image = ctypes.create_string_buffer(size.value)
    checked(nvrtc.nvrtcGetCUBIN(program, image), "nvrtcGetCUBIN")
    nvrtc.nvrtcDestroyProgram(byref(program))
    return image.raw


def by_nvcc(nvcc: str, options: list[str]) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder) / "multilegged.cubin"
        command = [nvcc, *options, "--cubin", "--output-file", str(target), str(SOURCE)]
        done = subprocess.run(command, capture_output=True, text=True)
        if done.returncode:
            raise Failed(f"nvcc: {(done.stderr.strip().splitlines() or ['no message'])[-1]}")
        return target.read_bytes()


def kernel(cuda: ctypes.CDLL, architecture: str, blocks: int) -> c_void_p:
    """The compiled and loaded kernel, by the first compiler whose result this driver takes."""
    options = [f"--gpu-architecture={architecture}", f"-DBLOCK={BLOCK}", f"-DBLOCKS_AN_SM={blocks}"]
    ways: list[Callable[[], bytes]] = [partial(by_nvrtc, path, options) for path in runtime_compilers()]
    nvcc = shutil.which("nvcc") or shutil.which("/usr/local/cuda/bin/nvcc")
    if nvcc:
        ways.append(partial(by_nvcc, nvcc, options))
    reasons = ["no NVRTC and no nvcc"]
    for way in ways:
        module, function = c_void_p(), c_void_p()
        try:
            checked(cuda.cuModuleLoadData(byref(module), way()), "cuModuleLoadData")
            checked(cuda.cuModuleGetFunction(byref(function), module, b"sweep"), "cuModuleGetFunction")
            return function
        except (Failed, OSError, AttributeError) as error:
            reasons.append(str(error))
    raise Failed("; ".join(reasons[1:] or reasons))


class Card:
    """Run a kernel on the device; `kernel_s` is the shortest that its launches took, without the copies."""

    def __init__(self, cuda: ctypes.CDLL, function: c_void_p) -> None:
        self.cuda, self.function, self.kernel_s = cuda, function, np.inf

    def run(self, starts: Starts, crossings: int, dt: float = 4e-3) -> Found:
        cuda, rows = self.cuda, len(starts.z)
        # filled with NaN (all bits set) by the device
        result = Found(np.empty((rows, crossings, LEGS)), np.empty(rows, np.int64))
        arrays: list[NDArray[Any]] = [starts.z, starts.modes, result.crossings, result.attempts]
        pointers = [c_void_p() for _ in arrays]
        try:
            for pointer, array in zip(pointers, arrays, strict=True):
                checked(cuda.cuMemAlloc_v2(byref(pointer), c_size_t(array.nbytes)), "cuMemAlloc")
            for pointer, array in zip(pointers[:2], arrays[:2], strict=True):
                copied = cuda.cuMemcpyHtoD_v2(pointer, c_void_p(array.ctypes.data), c_size_t(array.nbytes))
                checked(copied, "cuMemcpyHtoD")
            words = c_size_t(result.crossings.nbytes // 4)
            checked(cuda.cuMemsetD32_v2(pointers[2], c_uint(0xFFFFFFFF), words), "cuMemsetD32")
            checked(cuda.cuCtxSynchronize(), "cuMemsetD32")
            self._launch(Table.of(Parameters(), dt), rows, crossings, pointers)
            for pointer, array in zip(pointers[2:], arrays[2:], strict=True):
                copied = cuda.cuMemcpyDtoH_v2(c_void_p(array.ctypes.data), pointer, c_size_t(array.nbytes))
                checked(copied, "cuMemcpyDtoH")
        finally:
            for pointer in pointers:
                cuda.cuMemFree_v2(pointer)
        return result

    def _launch(self, table: Table, rows: int, crossings: int, pointers: list[c_void_p]) -> None:
        arguments = [table, c_int(rows), c_int(crossings), c_int(PATIENCE * crossings), *pointers]
        addresses = (c_void_p * len(arguments))(*(ctypes.addressof(argument) for argument in arguments))
        grid = (-(-rows // BLOCK), 1, 1)
        begun = time.perf_counter()
        launched = self.cuda.cuLaunchKernel(self.function, *grid, BLOCK, 1, 1, 0, None, addresses, None)
        checked(launched, "cuLaunchKernel")
        checked(self.cuda.cuCtxSynchronize(), "the kernel")
        self.kernel_s = min(self.kernel_s, time.perf_counter() - begun)


def measure(lanes: int = 131072, crossings: int = 5, dt: float = 4e-3) -> Row:
    cuda = driver()
    if cuda is None:
        return missing(NAME, "no CUDA device")
    try:
        name, architecture = device(cuda)
        begun = time.perf_counter()
        cards = {blocks: Card(cuda, kernel(cuda, architecture, blocks)) for blocks in BLOCKS_AN_SM}
        compilation = (time.perf_counter() - begun) / len(cards)
        true = reference_crossings()
        base = Starts.of(Parameters(), true[:, 0])
        chosen = np.arange(lanes) % len(true)
        trial = Starts(base.z[chosen], base.modes[chosen])
        for card in cards.values():
            card.run(trial, 1, dt)
        blocks = min(cards, key=lambda number: cards[number].kernel_s)
        card = cards[blocks]
        card.kernel_s = np.inf
        note = f", {name}, {blocks} blocks of {BLOCK} an SM, compiled in {compilation:.1f} s"
        row = timed(NAME, card.run, lanes, crossings, dt, note)
    except (Failed, OSError) as error:
        return missing(NAME, f"not measured: {error}")
    seconds = lanes * crossings / row["cycles_per_second"]
    row["note"] += f", the kernel alone {card.kernel_s / seconds:.0%} of the time"
    return row


if __name__ == "__main__":
    print(measure())
