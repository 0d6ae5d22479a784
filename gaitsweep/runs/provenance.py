"""Provenance of a table: versions, the commit of the source, and the machine."""

from __future__ import annotations

import functools
import importlib.metadata
import os
import platform
import subprocess
from pathlib import Path

PACKAGES = (
    *("gaitsweep", "jax", "jaxlib", "numpy", "scipy", "pandas", "pyarrow"),
    *("llvmlite", "cuda-core", "nvidia-cuda-nvrtc", "mujoco", "mujoco-mjx"),
)


@functools.cache
def versions() -> dict[str, str]:
    """Versions of Python and of the packages that decide the numbers."""
    python = {"python": platform.python_version()}
    return python | {package: version_of(package) for package in PACKAGES}


def version_of(package: str) -> str:
    """Return the version of an installed package."""
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return "not installed"


@functools.cache
def machine() -> str:
    """System, processor and number of cores of the machine that runs the rows or dispatches them."""
    processor = platform.processor() or platform.machine()
    try:  # Linux, whose own name of the processor says only x86_64
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines()
        named = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
        processor = next(named, processor)
    except OSError:
        pass
    return f"{platform.system()} {platform.release()}, {processor}, {os.cpu_count()} cores"


@functools.cache
def git_commit() -> str | None:
    """Commit of the checkout that gaitsweep runs from, `+changes` where files differ; None outside one."""
    folder = Path(__file__).resolve().parents[1]  # of the package
    try:
        # a package installed somewhere inside another project's checkout has no commit of its own
        if Path(_git(folder, "rev-parse", "--show-toplevel")) != folder.parent:
            return None
        commit = _git(folder, "rev-parse", "HEAD")
        changed = _git(folder, "status", "--porcelain", "--", str(folder))
    except (OSError, subprocess.SubprocessError):
        return None
    return f"{commit}+changes" if changed else commit


def _git(folder: Path, *arguments: str) -> str:
    command = ["git", "-C", str(folder), *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=10, check=True).stdout.strip()
