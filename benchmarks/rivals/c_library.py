"""C sources of the benchmarks, compiled on the spot for this very processor."""

from __future__ import annotations

import ctypes
import os
import platform
import shutil
import subprocess
import tempfile
import time
from functools import lru_cache
from pathlib import Path

FLAGS = ["-O3", "-march=native", "-ffp-contract=fast", "-fno-trapping-math", "-fno-math-errno"]


def compiler() -> str | None:
    """The C compiler that CC names, or `cc`; None where there is none."""
    return shutil.which(os.environ.get("CC", "cc"))


@lru_cache
def library(source: Path) -> tuple[ctypes.CDLL, float]:
    """A compiled source, and the seconds that the compiler took.

    Raises:
        RuntimeError: the compiler failed; the last line of what it said.
    """
    flags = [*FLAGS, "-fopenmp", "-fopenmp-simd", "-shared", "-fPIC"]
    if platform.machine() == "x86_64":
        flags.append("-mprefer-vector-width=512")  # gcc would rather use half a register on most machines
    begun = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder) / f"{source.stem}.so"
        command = [compiler() or "cc", *flags, str(source), "-o", str(target), "-lm"]
        done = subprocess.run(command, capture_output=True, text=True)
        if done.returncode:
            raise RuntimeError((done.stderr.strip().splitlines() or ["no message"])[-1])
        return ctypes.CDLL(str(target)), time.perf_counter() - begun
