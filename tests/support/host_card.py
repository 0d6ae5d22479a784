"""A card for tests without one: its kernels are compiled for the host, and its threads run one by one."""

from __future__ import annotations

import ctypes
import functools
import itertools
import shutil
import subprocess
import tempfile
import types
from pathlib import Path
from typing import Any

import numpy as np

from gaitsweep.engine.kernel.cuda_device import DeviceArray
from gaitsweep.engine.kernel.gpu_program import HEAD

# What `gpu_program.HEAD` defines, for a compiler of a host.
HOST_HEAD = """#include <cmath>
#define INFINITE HUGE_VAL
#define NOT_A_NUMBER NAN
#define CONSTANT
#define PART static
#define KERNEL extern "C"
#define THREAD thread
#define NEXT(counter) (index)((*(counter))++)
#define ANY(flag) (flag)
typedef long long index;
"""
BLOCK = 4  # threads
_numbers = itertools.count()


def compiler() -> str | None:
    """The C++ compiler of this machine; None where there is none."""
    return shutil.which("c++")


def library(source: str, folder: Path, *, contraction: bool = False) -> ctypes.CDLL:
    """A source with `HOST_HEAD`, compiled."""
    # a file of its own for each, whose variables no other library shares
    target = folder / f"kernel_{next(_numbers)}.so"
    target.write_bytes(_code(source, contraction))
    return ctypes.CDLL(str(target))


@functools.cache
def _code(source: str, contraction: bool) -> bytes:
    """The code of a shared library."""
    contract = f"-ffp-contract={'fast' if contraction else 'off'}"
    command = [str(compiler()), "-O1", "-march=native", contract, "-shared", "-fPIC", "-x", "c++", "-"]
    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder) / "kernel.so"
        done = subprocess.run([*command, "-o", str(target)], input=source, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        return target.read_bytes()


class _Module:
    def __init__(self, code: ctypes.CDLL) -> None:
        self.code = code

    def get_kernel(self, name: str) -> Any:
        attributes = types.SimpleNamespace(num_regs=0, local_size_bytes=0)
        return types.SimpleNamespace(
            function=getattr(self.code, name), thread=self.code, attributes=attributes
        )


class HostCard:
    """The interface of `CudaDevice`."""

    folder: Path

    def __init__(self, number: int) -> None:
        pass

    def use(self) -> None:
        pass

    def wait(self) -> None:
        pass

    def allocate(self, size: int) -> Any:
        # what is not written yet is no number, so that nothing can depend on it
        memory = np.full(max(size, 1), np.nan)
        return types.SimpleNamespace(memory=memory, handle=memory.ctypes.data)

    allocate_pinned = allocate

    def copy(self, source: Any, target: Any, size: int) -> None:
        assert size <= min(source.memory.size, target.memory.size)
        target.memory[:size] = source.memory[:size]

    def module(self, source: str, *, contraction: bool = True) -> Any:
        assert HEAD in source
        threads = 'static index thread;\nextern "C" void go_to(index number) { thread = number; }\n'
        body = source.replace(HEAD, HOST_HEAD + threads)
        return _Module(library(body, self.folder, contraction=contraction))

    def set_constant(self, module: Any, name: str, value: bytes) -> None:
        ctypes.memmove((ctypes.c_char * len(value)).in_dll(module.code, name), value, len(value))

    def threads(self, kernel: Any) -> int:
        """So few that threads go on with a second lane."""
        return 3

    def launch(self, kernel: Any, threads: int, *args: DeviceArray | int) -> None:
        given = [
            ctypes.c_void_p(a.buffer.handle) if isinstance(a, DeviceArray) else ctypes.c_longlong(a)
            for a in args
        ]
        # whole blocks, as on a card
        for number in range(-(-threads // BLOCK) * BLOCK):
            kernel.thread.go_to(ctypes.c_longlong(number))
            kernel.function(*given)
