"""Parameter sweeps of legged locomotion models: thousands of trajectories at once, tables and figures.

import numpy as np, gaitsweep as gs
chain = gs.models.MultileggedReduced(N=3)
axis = np.linspace(0.1, 6.2, 33)
result = gs.sweep(chain, psi_1=axis, psi_2=axis, psi_3=3.1, run=gs.Settle(max_cycles=150))
result.plot.basin(x="psi_1", y="psi_2")
stored = gs.run("sweeps/quick_basins.yaml")
"""

from __future__ import annotations

import importlib
import os
import sys
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from gaitsweep import contract, models, plot
    from gaitsweep.analysis.basins.measures import basins
    from gaitsweep.api import analyses, theory
    from gaitsweep.api.analyses import hysteresis
    from gaitsweep.api.maps import PoincareMap, return_map
    from gaitsweep.api.run_kinds import (
        Continuation,
        FixedTime,
        Ramp,
        ReturnMap,
        Settle,
        Staircase,
        Trace,
    )
    from gaitsweep.api.trajectories import simulate, sweep
    from gaitsweep.contract import HybridModel, Quantity, Status, SteppedModel
    from gaitsweep.errors import ArgumentError, UserError
    from gaitsweep.job import Job, JobError, load_job
    from gaitsweep.runs.movie import write_movie, write_still
    from gaitsweep.runs.prepare import RunError
    from gaitsweep.runs.result import Result, run
    from gaitsweep.runs.self_check import SelfCheckError
    from gaitsweep.table import TableError, load

    __version__: str

# float64 is the default of every model here; JAX reads this when it is first imported
os.environ.setdefault("JAX_ENABLE_X64", "1")
if "jax" in sys.modules:
    sys.modules["jax"].config.update("jax_enable_x64", os.environ["JAX_ENABLE_X64"] not in ("0", "false"))

# The names of each module. It is imported when one is first used, so `gaitsweep --help` needs no JAX.
_NAMES = {
    "analysis.basins.measures": ("basins",),
    "api.analyses": ("hysteresis",),
    "api.maps": ("PoincareMap", "return_map"),
    "api.run_kinds": ("Continuation", "FixedTime", "Ramp", "ReturnMap", "Settle", "Staircase", "Trace"),
    "api.trajectories": ("simulate", "sweep"),
    "contract": ("HybridModel", "Quantity", "Status", "SteppedModel"),
    "errors": ("ArgumentError", "UserError"),
    "job": ("Job", "JobError", "load_job"),
    "runs.movie": ("write_movie", "write_still"),
    "runs.prepare": ("RunError",),
    "runs.result": ("Result", "run"),
    "runs.self_check": ("SelfCheckError",),
    "table": ("TableError", "load"),
}
_MODULES = {name: module for module, names in _NAMES.items() for name in names}
# Names that are modules themselves.
_NAMESPACES = {
    **{name: name for name in ("contract", "models", "plot")},
    **{name: f"api.{name}" for name in ("analyses", "theory")},
}

__all__ = [
    "ArgumentError",
    "Continuation",
    "FixedTime",
    "HybridModel",
    "Job",
    "JobError",
    "PoincareMap",
    "Quantity",
    "Ramp",
    "Result",
    "ReturnMap",
    "RunError",
    "SelfCheckError",
    "Settle",
    "Staircase",
    "Status",
    "SteppedModel",
    "TableError",
    "Trace",
    "UserError",
    "__version__",
    "analyses",
    "basins",
    "contract",
    "hysteresis",
    "load",
    "load_job",
    "models",
    "plot",
    "return_map",
    "run",
    "simulate",
    "sweep",
    "theory",
    "write_movie",
    "write_still",
]


if not TYPE_CHECKING:  # a type checker would take any name for one of ours

    def __getattr__(name: str) -> Any:
        if name in _NAMESPACES:
            return importlib.import_module(f"{__name__}.{_NAMESPACES[name]}")
        if name in _MODULES:
            return getattr(importlib.import_module(f"{__name__}.{_MODULES[name]}"), name)
        if name == "__version__":
            return importlib.import_module(f"{__name__}.version").version()
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return list(__all__)
