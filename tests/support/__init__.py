"""Parts that tests share: tables, directories, references, processes; `models/` is on the path."""

from __future__ import annotations

import os
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
MODELS = ROOT / "tests" / "support" / "models"
REFERENCE = ROOT / "tests" / "reference"


def environment(**more: str) -> dict[str, str]:
    """Return the environment in which other processes import this repository and the tests' models."""
    path = os.pathsep.join([str(ROOT), str(MODELS), *filter(None, [os.environ.get("PYTHONPATH")])])
    return {**os.environ, "PYTHONPATH": path, "JAX_PLATFORMS": "cpu", **more}
