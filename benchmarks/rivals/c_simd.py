"""Rival: C by hand, eight trajectories to a vector register, threads over the starts (multilegged_simd.c)."""

from __future__ import annotations

import ctypes
from pathlib import Path

from .by_hand import PATIENCE, Found, Starts, Table, missing, timed
from .c_library import compiler, library
from .starts import Parameters, Row

NAME = "C by hand, omp simd over 8 lanes"
SOURCE = Path(__file__).with_name("multilegged_simd.c")


class Sweep(ctypes.Structure):
    """Arguments and results of the C function; `next` is the first start that no lane has taken."""

    _fields_ = (
        *((name, ctypes.c_int64) for name in ("rows", "crossings", "limit", "next")),
        *((name, ctypes.c_void_p) for name in ("starts", "modes", "found", "attempts")),
    )


def run(starts: Starts, crossings: int, dt: float = 4e-3) -> Found:
    """All starts on all cores (OMP_NUM_THREADS: on so many)."""
    rows = len(starts.z)
    result = Found.empty(rows, crossings)
    arrays = (starts.z, starts.modes, result.crossings, result.attempts)
    task = Sweep(rows, crossings, PATIENCE * crossings, 0, *(array.ctypes.data for array in arrays))
    library(SOURCE)[0].run(ctypes.byref(Table.of(Parameters(), dt)), ctypes.byref(task))
    return result


def measure(lanes: int = 1024, crossings: int = 5, dt: float = 4e-3) -> Row:
    if compiler() is None:
        return missing(NAME, "not measured: no compiler")
    try:
        _, compilation = library(SOURCE)
    except (RuntimeError, OSError) as error:
        return missing(NAME, f"not measured: the compiler failed: {error}")
    return timed(NAME, run, lanes, crossings, dt, f", compiled in {compilation:.1f} s")


if __name__ == "__main__":
    print(measure())
