"""Peak of the machine: double-precision operations a second, two to a fused multiply-add."""

from __future__ import annotations

import ctypes
import os
import platform
import time
from ctypes import byref, c_int
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from .rivals.c_library import compiler, library

SOURCE = Path(__file__).with_name("peak.c")
TURNS, REPEATS = 10_000_000, 5  # a tenth of a second each on a core of 2.5 GHz
# Double-precision multiply-adds that an SM starts in each clock, by the device's compute capability, as
# NVIDIA's CUDA C++ Programming Guide has them: P100, V100, A100, H100 and H200.
FMA_LANES = {(6, 0): 32, (7, 0): 32, (8, 0): 32, (9, 0): 64}
SMS, CLOCK_KHZ, MAJOR, MINOR = 16, 13, 75, 76  # the driver's numbers of these attributes


@dataclass(frozen=True)
class Peak:
    """`per_second` operations a second, NaN where unknown; `basis` how they were found."""

    per_second: float
    basis: str


def of_cpu() -> Peak:
    """Measured: independent multiply-adds in the widest registers, on all cores that this process may use."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    name = f"{cores} cores of {cpu_name()}"
    if compiler() is None:
        return Peak(float("nan"), f"{name}: unknown without a C compiler")
    try:
        multiply_add = library(SOURCE)[0].multiply_add
    except (RuntimeError, OSError) as error:
        return Peak(float("nan"), f"{name}: unknown, {error}")
    multiply_add.restype = ctypes.c_double
    results = np.zeros(cores)
    best = 0.0
    for _ in range(REPEATS):
        begun = time.perf_counter()
        count = multiply_add(ctypes.c_long(TURNS), c_int(cores), ctypes.c_void_p(results.ctypes.data))
        best = max(best, count / (time.perf_counter() - begun))
    return Peak(best, f"{name}: measured with independent multiply-adds")


def of_gpu() -> Peak | None:
    """Worked out from the first CUDA device's attributes; None where there is no device."""
    from .rivals.cuda_by_hand import device, driver

    cuda = driver()
    if cuda is None:
        return None
    sms, clock, major, minor = (_attribute(cuda, number) for number in (SMS, CLOCK_KHZ, MAJOR, MINOR))
    name = device(cuda)[0]
    lanes = FMA_LANES.get((major, minor))
    if lanes is None:
        return Peak(float("nan"), f"{name}: unknown for compute capability {major}.{minor}")
    basis = f"{name}: taken for {sms} SMs x {clock / 1e6:.3f} GHz x {lanes} FP64 multiply-adds x 2"
    return Peak(sms * clock * 1e3 * lanes * 2.0, basis)


def _attribute(cuda: ctypes.CDLL, number: int) -> int:
    value = c_int()
    failed = cuda.cuDeviceGetAttribute(byref(value), number, c_int(0))
    return 0 if failed else value.value


def cpu_name() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    names = (line.split(":", 1)[1].strip() for line in lines if line.startswith("model name"))
    return next(names, platform.machine())
