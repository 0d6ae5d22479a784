"""The on-disk cache of kernels, so that a kernel is compiled once for a machine and not once for a run.

A file is named by the digest of the kernel's source and of the versions that compile it, and carries the
digest of its own content: the machine code of one function for a CPU, or of a kernel for an NVIDIA GPU. What
is damaged is compiled again.
"""

from __future__ import annotations

import hashlib
import linecache
import pickle
import sys
import threading
from collections.abc import Callable, Sequence
from importlib.metadata import version
from pathlib import Path
from types import FunctionType, ModuleType
from typing import Any

from gaitsweep.cache_folder import cache_folder, keep, kept

# batches of a search are measured by threads: one that asks for a module waits until it is made
_MODULES = threading.Lock()


def module_of(source: str) -> ModuleType:
    """The Python module with this source, whose functions Numba compiles or takes from the cache."""
    from gaitsweep.engine.kernel import llvm_code

    # `llvm_code` determines the instructions as well as the source does
    own = Path(llvm_code.__file__).read_text()
    name = _name(source, own, f"numba {version('numba')}", f"llvmlite {version('llvmlite')}", sys.version)
    with _MODULES:
        return sys.modules.get(name) or _made(name, source)


def _made(name: str, source: str) -> ModuleType:
    """A module, which is not read from a file: what is compiled is what was printed."""
    module = ModuleType(name)
    file = f"<{name}>"
    linecache.cache[file] = len(source), None, source.splitlines(keepends=True), file
    sys.modules[name] = module  # Numba finds the module of a function by its name
    try:
        exec(compile(source, file, "exec"), vars(module))
    except BaseException:
        del sys.modules[name]  # half a module is none
        raise
    return module


def compiled(function: FunctionType) -> Any:
    """A function of a kernel, compiled by Numba when it is first called."""
    from numba import njit

    dispatcher: Any = njit(nogil=True, error_model="numpy", boundscheck=False)(function)
    dispatcher._cache = _MachineCode(function)
    return dispatcher


class _MachineCode:
    """The machine code of a function in the cache, as Numba's dispatcher asks for it.

    Numba's own cache loads what it finds, and fails where the disk is full.
    """

    cache_path = ""

    def __init__(self, function: FunctionType) -> None:
        self._name = f"{function.__module__}-{function.__name__}"

    def load_overload(self, signature: Any, target: Any) -> Any:
        """The function compiled for a signature, or None."""
        from numba.core.compiler import CompileResult

        target.refresh()
        file = self._file(signature, target.codegen())
        content = None if file is None else kept(file)
        if content is None:
            return None
        return CompileResult._rebuild(target, *pickle.loads(content))

    def save_overload(self, signature: Any, result: Any) -> None:
        """Store a function compiled for a signature."""
        from numba.core.serialize import dumps

        file = self._file(signature, result.codegen)
        if file is not None and not result.library.has_dynamic_globals:
            keep(file, dumps(result._reduce()))

    def _file(self, signature: Any, codegen: Any) -> Path | None:
        """The file for a signature and a processor."""
        folder = cache_folder("kernels")
        key = f"{signature} {codegen.magic_tuple()}"
        return None if folder is None else folder / f"{self._name}-{_digest(key)[:16]}.code"


def binary_of(suffix: str, key: Sequence[str], compile_: Callable[[], bytes]) -> bytes:
    """The machine code that `compile_` makes, or that it has made before with the same key.

    Args:
        suffix: the ending of the file's name, without the dot.
        key: all that determines the code: the source, the options, the compiler's version.
        compile_: compiles the source.
    """
    folder = cache_folder("kernels")
    if folder is None:
        return compile_()
    file = folder / f"{_name(*key)}.{suffix}"
    code = kept(file)
    if code is None:
        code = compile_()
        keep(file, code)
    return code


def _name(*key: str) -> str:
    return f"gaitsweep_kernel_{_digest(*key)[:24]}"


def _digest(*key: str) -> str:
    return hashlib.sha256("\n".join(key).encode()).hexdigest()
