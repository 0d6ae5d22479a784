"""Figures from tables; each function is a kind of figure that a job may ask for.

`register` adds a kind from another package, before its jobs are read; it is usable as a decorator.
"""

from __future__ import annotations

from typing import Any

import pandas as pd
from matplotlib.figure import Figure

from gaitsweep import near_miss
from gaitsweep.extension import extensions, import_all
from gaitsweep.plot.basins.basin import basin as basin
from gaitsweep.plot.basins.basin_measures import basin_measures as basin_measures
from gaitsweep.plot.basins.gait_map import gait_map as gait_map
from gaitsweep.plot.basins.shock import shock as shock
from gaitsweep.plot.branches.branches import branches as branches
from gaitsweep.plot.branches.continuation import continuation as continuation
from gaitsweep.plot.branches.cycles import cycles as cycles
from gaitsweep.plot.branches.folds import folds as folds
from gaitsweep.plot.branches.gait_transitions import gait_transitions as gait_transitions
from gaitsweep.plot.branches.hysteresis import hysteresis as hysteresis
from gaitsweep.plot.branches.return_map import return_map as return_map
from gaitsweep.plot.branches.stable_ranges import stable_ranges as stable_ranges
from gaitsweep.plot.columns import PlotError as PlotError
from gaitsweep.plot.figure_kind import FIGURES as FIGURES
from gaitsweep.plot.figure_kind import FigureKind as FigureKind
from gaitsweep.plot.footprints import footprints as footprints

register = FIGURES.register
unregister = FIGURES.unregister
for _extension in extensions().values():
    import_all(_extension.figures)


def __getattr__(name: str) -> Any:
    """The function of a kind of figure that an extension brings."""
    if name in FIGURES:
        return FIGURES[name].draw
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def draw(kind: str, table: pd.DataFrame, **spec: Any) -> Figure:
    """The figure of one kind from a table.

    Args:
        kind: a key of FIGURES.
        table: a result table, as `gaitsweep.load` gives it.
        spec: the figure's own arguments.

    Raises:
        PlotError: the kind is not known, or the table lacks a column of the figure.
    """
    if kind not in FIGURES:
        raise PlotError(f"{kind} is not a kind of figure{near_miss.suggestion(kind, FIGURES)}")
    return FIGURES[kind].draw(table, **spec)
