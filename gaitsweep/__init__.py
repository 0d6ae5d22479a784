"""Parameter sweeps of legged locomotion models: thousands of trajectories at once, tables and figures.

import numpy as np, gaitsweep as gs
from gaitsweep.examples.hopper import Hopper
launch, phase = np.linspace(0.1, 8.0, 64), np.linspace(0.0, 6.2, 64)
result = gs.sweep(Hopper(), launch_0=launch, phase_0=phase, run=gs.Settle(max_cycles=400))
result.plot.basin(x="phase_0", y="launch_0")
stored = gs.run("sweeps/quick_basins.yaml")
"""

from __future__ import annotations

import importlib
import os
import sys
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:  # the names of this package; `as` says to type checkers that they are public
    from gaitsweep import contract as contract
    from gaitsweep import models as models
    from gaitsweep import plot as plot
    from gaitsweep.analysis.basins.measures import basins as basins
    from gaitsweep.api import analyses as analyses
    from gaitsweep.api.analyses import hysteresis as hysteresis
    from gaitsweep.api.fitting import search as search
    from gaitsweep.api.maps import PoincareMap as PoincareMap
    from gaitsweep.api.maps import return_map as return_map
    from gaitsweep.api.result import Result as Result
    from gaitsweep.api.result import run as run
    from gaitsweep.api.sensitivity import sensitivity as sensitivity
    from gaitsweep.api.trajectories import simulate as simulate
    from gaitsweep.api.trajectories import sweep as sweep
    from gaitsweep.contract import HybridModel as HybridModel
    from gaitsweep.contract import Quantity as Quantity
    from gaitsweep.contract import Status as Status
    from gaitsweep.contract import SteppedModel as SteppedModel
    from gaitsweep.dynamics.declarations import energy as energy
    from gaitsweep.dynamics.declarations import event as event
    from gaitsweep.dynamics.declarations import mode as mode
    from gaitsweep.dynamics.declarations import observable as observable
    from gaitsweep.dynamics.declarations import parameter as parameter
    from gaitsweep.dynamics.declarations import signal as signal
    from gaitsweep.dynamics.declarations import variable as variable
    from gaitsweep.dynamics.declared_model import DeclaredModel as DeclaredModel
    from gaitsweep.dynamics.mjx.mjcf_model import MjcfModel as MjcfModel
    from gaitsweep.errors import ArgumentError as ArgumentError
    from gaitsweep.errors import UserError as UserError
    from gaitsweep.extension import Extension as Extension
    from gaitsweep.job import Job as Job
    from gaitsweep.job import JobError as JobError
    from gaitsweep.job import load_job as load_job
    from gaitsweep.kinds import Continuation as Continuation
    from gaitsweep.kinds import FixedTime as FixedTime
    from gaitsweep.kinds import Folds as Folds
    from gaitsweep.kinds import Ramp as Ramp
    from gaitsweep.kinds import ReturnMap as ReturnMap
    from gaitsweep.kinds import Settle as Settle
    from gaitsweep.kinds import Staircase as Staircase
    from gaitsweep.kinds import Trace as Trace
    from gaitsweep.runs.prepare import RunError as RunError
    from gaitsweep.runs.self_check import SelfCheckError as SelfCheckError
    from gaitsweep.table import TableError as TableError
    from gaitsweep.table import load as load
    from gaitsweep.view.movie.row_movie import write_movie as write_movie
    from gaitsweep.view.movie.row_movie import write_still as write_still

    __version__: str

# float64 is the default of every model here; JAX reads this when it is first imported
os.environ.setdefault("JAX_ENABLE_X64", "1")
if "jax" in sys.modules:
    sys.modules["jax"].config.update("jax_enable_x64", os.environ["JAX_ENABLE_X64"] not in ("0", "false"))

if not TYPE_CHECKING:  # a type checker would take any name for one of ours
    # The names above by module, imported when one is first used, so that `gaitsweep --help` needs no JAX.
    _NAMES = {
        "": ("contract", "models", "plot"),
        "analysis.basins.measures": ("basins",),
        "api": ("analyses",),
        "api.analyses": ("hysteresis",),
        "api.fitting": ("search",),
        "api.maps": ("PoincareMap", "return_map"),
        "api.sensitivity": ("sensitivity",),
        "api.trajectories": ("simulate", "sweep"),
        "contract": ("HybridModel", "Quantity", "Status", "SteppedModel"),
        "dynamics.declarations": (
            *("energy", "event", "mode", "observable", "parameter", "signal", "variable"),
        ),
        "dynamics.declared_model": ("DeclaredModel",),
        "dynamics.mjx.mjcf_model": ("MjcfModel",),
        "errors": ("ArgumentError", "UserError"),
        "extension": ("Extension",),
        "job": ("Job", "JobError", "load_job"),
        "kinds": ("Continuation", "FixedTime", "Folds", "Ramp", "ReturnMap", "Settle", "Staircase", "Trace"),
        "view.movie.row_movie": ("write_movie", "write_still"),
        "runs.prepare": ("RunError",),
        "api.result": ("Result", "run"),
        "runs.self_check": ("SelfCheckError",),
        "table": ("TableError", "load"),
    }
    _MODULES = {name: f"gaitsweep.{room}".rstrip(".") for room, names in _NAMES.items() for name in names}
    __all__ = sorted([*_MODULES, "__version__"])

    def __getattr__(name: str) -> Any:
        if name == "__version__":
            return importlib.import_module(f"{__name__}.version").version()
        if name not in _MODULES:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        importlib.import_module(f"{__name__}.errors").refuse_windows()
        module = _MODULES[name]
        if module in ("gaitsweep", "gaitsweep.api"):  # the name is itself a module's
            return importlib.import_module(f"{module}.{name}")
        return getattr(importlib.import_module(module), name)

    def __dir__() -> list[str]:
        return list(__all__)
