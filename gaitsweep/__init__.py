"""Parameter sweeps of legged locomotion models: jobs in YAML, thousands of trajectories at once, tables.

import gaitsweep as gs
result = gs.run("sweeps/quick_basins.yaml")
table = gs.load(result.path)
gs.plot.basin(table, x="psi_1", y="psi_2", panels="psi_3")
"""

from __future__ import annotations

import importlib
import os
import sys
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from gaitsweep import plot
    from gaitsweep.job import Job, JobError, load_job
    from gaitsweep.runs.prepare import RunError
    from gaitsweep.runs.result import Result, run
    from gaitsweep.runs.self_check import SelfCheckError
    from gaitsweep.table import TableError, load

# float64 is the default of every model here; JAX reads this when it is first imported
os.environ.setdefault("JAX_ENABLE_X64", "1")
if "jax" in sys.modules:
    sys.modules["jax"].config.update("jax_enable_x64", os.environ["JAX_ENABLE_X64"] not in ("0", "false"))

# what is imported when it is first used, so that `gaitsweep --help` need not wait for JAX
_ROOMS = {
    "Job": "gaitsweep.job",
    "JobError": "gaitsweep.job",
    "load_job": "gaitsweep.job",
    "Result": "gaitsweep.runs.result",
    "run": "gaitsweep.runs.result",
    "RunError": "gaitsweep.runs.prepare",
    "SelfCheckError": "gaitsweep.runs.self_check",
    "TableError": "gaitsweep.table",
    "load": "gaitsweep.table",
}

__all__ = [
    "Job",
    "JobError",
    "Result",
    "RunError",
    "SelfCheckError",
    "TableError",
    "load",
    "load_job",
    "plot",
    "run",
]


def __getattr__(name: str) -> Any:
    if name == "plot":
        return importlib.import_module("gaitsweep.plot")
    if name in _ROOMS:
        return getattr(importlib.import_module(_ROOMS[name]), name)
    raise AttributeError(f"module 'gaitsweep' has no attribute {name!r}")
