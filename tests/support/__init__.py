"""Parts that tests share: tables, directories, references, processes; `models/` is on the path."""

from __future__ import annotations

import os
from pathlib import Path

import jax

ROOT = Path(__file__).resolve().parents[2]
MODELS = ROOT / "tests" / "support" / "models"
REFERENCE = ROOT / "tests" / "reference"

# Options of XLA with which a program is compiled in a fifth of the time; its results differ by rounding.
UNOPTIMISED: dict[str, int | bool] = {"xla_backend_optimization_level": 0}
if jax.__version_info__ < (0, 11):
    UNOPTIMISED["xla_cpu_use_fusion_emitters"] = False


def unoptimised_flags() -> str:
    """The value of XLA_FLAGS for a process on a CPU that runs its programs for a few rows only."""
    return " ".join(f"--{name}={str(value).lower()}" for name, value in UNOPTIMISED.items())


def environment(**more: str) -> dict[str, str]:
    """Return the environment in which other processes import this repository and the tests' models."""
    path = os.pathsep.join([str(ROOT), str(MODELS), *filter(None, [os.environ.get("PYTHONPATH")])])
    return {**os.environ, "PYTHONPATH": path, "JAX_PLATFORMS": "cpu", **more}
