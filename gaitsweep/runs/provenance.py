"""What made a table: versions and the commit of the source."""

from __future__ import annotations

import importlib.metadata
import platform
import subprocess
from pathlib import Path

PACKAGES = (
    *("gaitsweep", "jax", "jaxlib", "numpy", "scipy", "pandas", "pyarrow"),
    *("numba", "llvmlite", "cuda-core", "nvidia-cuda-nvrtc", "mujoco", "mujoco-mjx"),
)


def versions() -> dict[str, str]:
    """Versions of Python and of the packages that decide the numbers."""
    found = {"python": platform.python_version()}
    return found | {package: version_of(package) for package in PACKAGES}


def version_of(package: str) -> str:
    """The version of an installed package."""
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return "not installed"


def git_commit() -> str | None:
    """Commit of the checkout that gaitsweep runs from, `+changes` where files differ; None outside one."""
    folder = Path(__file__).resolve().parent
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
