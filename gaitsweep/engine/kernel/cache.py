"""The on-disk cache of kernels, so that a kernel is compiled once for a machine and not once for a run.

A module is named by the digest of its source and of the versions that compile it. Numba stores the compiled
code beside it. GAITSWEEP_CACHE names the folder; the default is ~/.cache/gaitsweep (XDG_CACHE_HOME).
"""

from __future__ import annotations

import hashlib
import importlib.util
import os
import sys
import tempfile
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from types import ModuleType

from gaitsweep.engine.kernel import llvm_code


def module_of(source: str) -> ModuleType:
    """The module with this source, imported from the cache of kernels."""
    versions = [f"{name} {_version(name)}" for name in ("numba", "llvmlite", "numba-cuda")]
    # `llvm_code` determines the instructions as well as the source does
    own = Path(llvm_code.__file__).read_text()
    digest = hashlib.sha256("\n".join([source, own, *versions, sys.version]).encode()).hexdigest()
    name = f"gaitsweep_kernel_{digest[:24]}"
    if name in sys.modules:
        return sys.modules[name]
    file = _folder() / f"{name}.py"
    if not file.exists():
        with tempfile.NamedTemporaryFile("w", dir=file.parent, suffix=".tmp", delete=False) as draft:
            draft.write(source)
        os.replace(draft.name, file)
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


def _folder() -> Path:
    base = os.environ.get("GAITSWEEP_CACHE")
    if base is None:
        base = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "gaitsweep"
    folder = Path(base) / "kernels"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return folder
    except OSError:
        # without a writable folder the kernel is compiled again, but the run goes on
        return Path(tempfile.mkdtemp(prefix="gaitsweep-kernels-"))


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "none"
