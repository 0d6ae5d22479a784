"""The on-disk cache of kernels, so that a kernel is compiled once for a machine and not once for a run.

A file is named by the digest of the kernel's source and of the versions that compile it. For a CPU it is a
Python module, beside which Numba stores the compiled code; for an NVIDIA GPU it is the machine code itself.
"""

from __future__ import annotations

import hashlib
import importlib.util
import sys
import tempfile
import threading
from collections.abc import Callable, Sequence
from importlib.metadata import version
from pathlib import Path
from types import ModuleType

from gaitsweep.cache_folder import cache_folder, write_whole

# batches of a search are measured by threads: one that asks for a module waits until its import has ended
_IMPORT = threading.Lock()


def module_of(source: str) -> ModuleType:
    """The Python module with this source, imported from the cache of kernels; Numba compiles it."""
    from gaitsweep.engine.kernel import llvm_code

    # `llvm_code` determines the instructions as well as the source does
    own = Path(llvm_code.__file__).read_text()
    name = _name(source, own, f"numba {version('numba')}", f"llvmlite {version('llvmlite')}", sys.version)
    with _IMPORT:
        return sys.modules.get(name) or _imported(name, source)


def _imported(name: str, source: str) -> ModuleType:
    file = _folder() / f"{name}.py"
    if not file.exists():
        write_whole(file, source.encode())
    spec = importlib.util.spec_from_file_location(name, file)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # Numba finds the module of a function by its name
    try:
        spec.loader.exec_module(module)
    except BaseException:
        del sys.modules[name]  # half a module is none
        raise
    return module


def binary_of(suffix: str, key: Sequence[str], compile_: Callable[[], bytes]) -> bytes:
    """The machine code that `compile_` makes, or that it has made before with the same key.

    Args:
        suffix: the ending of the file's name, without the dot.
        key: all that determines the code: the source, the options, the compiler's version.
        compile_: compiles the source.
    """
    file = _folder() / f"{_name(*key)}.{suffix}"
    try:
        return file.read_bytes()
    except FileNotFoundError:
        pass
    code = compile_()
    write_whole(file, code)
    return code


def _name(*key: str) -> str:
    digest = hashlib.sha256("\n".join(key).encode()).hexdigest()
    return f"gaitsweep_kernel_{digest[:24]}"


def _folder() -> Path:
    # without a writable folder the kernel is compiled again, but the run goes on
    return cache_folder("kernels") or Path(tempfile.mkdtemp(prefix="gaitsweep-kernels-"))
