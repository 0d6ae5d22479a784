"""Python modules run in another process, with packages that pip has installed in a folder."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]


def run_module(folder: Path, *command: str, site: str = "") -> str:
    """Run a Python module in a folder, and return its output; `site` is a folder of installed packages."""
    places = os.pathsep.join(filter(None, [str(ROOT), site]))
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
    """Install a package below a folder, to which its path may be relative, and return its site's path."""
    site = str(folder / "site")
    pip = ("pip", "install", "-q", "--no-deps", "--no-build-isolation", "--no-index")
    run_module(folder, *pip, "--target", site, package)
    return site
