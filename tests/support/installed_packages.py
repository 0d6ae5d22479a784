"""Modules of Python that run in another process, beside packages which pip has installed in a folder."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]


def at(folder: Path, *command: str, also: str = "") -> str:
    """What a module of Python prints in a folder; `also` is one more folder of installed packages."""
    places = os.pathsep.join(filter(None, [str(ROOT), also]))
    done = subprocess.run(
        [sys.executable, "-m", *command],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": places},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def install(folder: Path, package: str) -> str:
    """Install a package, whose path may be relative to a folder, below that folder; the place as text."""
    site = str(folder / "site")
    pip = ("pip", "install", "-q", "--no-deps", "--no-build-isolation", "--no-index")
    at(folder, *pip, "--target", site, package)
    return site
