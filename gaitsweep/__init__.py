"""Parameter sweeps of legged locomotion models: thousands of trajectories at once, tables and figures.

Example:
    import numpy as np, gaitsweep as gs
    from gaitsweep.examples.hopper import Hopper
    launch, phase = np.linspace(0.1, 8.0, 64), np.linspace(0.0, 6.2, 64)
    result = gs.sweep(Hopper(), launch_0=launch, phase_0=phase, run=gs.Settle(max_cycles=400))
    result.plot.basin(x="phase_0", y="launch_0")
    stored = gs.run("sweeps/quick_basins.yaml")
"""

from __future__ import annotations

import os
import sys
from typing import Any

from gaitsweep.errors import refuse_windows
from gaitsweep.lazy_imports import attach_stub

# float64 is the default of every model here; JAX reads this when it is first imported
os.environ.setdefault("JAX_ENABLE_X64", "1")
if "jax" in sys.modules:
    sys.modules["jax"].config.update("jax_enable_x64", os.environ["JAX_ENABLE_X64"] not in ("0", "false"))

_public, _, __all__ = attach_stub(__name__, __file__)
__all__ += ["__version__"]


def _version() -> str:
    """The version of the installed package; "unknown" where it runs from a folder without installation."""
    from importlib import metadata  # which most commands do not need

    try:
        return metadata.version("gaitsweep")
    except metadata.PackageNotFoundError:
        return "unknown"


def __getattr__(name: str) -> Any:
    """A public name, imported when it is first used."""
    if name == "__version__":
        globals()[name] = _version()
        return globals()[name]
    refuse_windows()
    return _public(name)


def __dir__() -> list[str]:
    return sorted(__all__)
