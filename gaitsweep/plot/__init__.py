"""Figures from tables; each function is a kind of figure that a job may ask for.

`register` adds a kind from another package, before its jobs are read; it is usable as a decorator.
"""

from __future__ import annotations

from typing import Any

import pandas as pd
from matplotlib.figure import Figure

from gaitsweep import near_miss
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
from gaitsweep.plot.chain.drift_law import drift_law as drift_law
from gaitsweep.plot.chain.gait_shares import gait_shares as gait_shares
from gaitsweep.plot.chain.solution_set import solution_set as solution_set
from gaitsweep.plot.chain.source_place import source_place as source_place
from gaitsweep.plot.chain.theory import chain_theory as chain_theory
from gaitsweep.plot.chain.wave_speed import wave_speed as wave_speed
from gaitsweep.plot.columns import PlotError as PlotError
from gaitsweep.plot.figure_kind import FIGURES as FIGURES
from gaitsweep.plot.figure_kind import FigureKind as FigureKind
from gaitsweep.plot.gaits.footprints import footprints as footprints
from gaitsweep.plot.gaits.gait_ramp import gait_ramp as gait_ramp
from gaitsweep.plot.gaits.gait_series import gait_series as gait_series
from gaitsweep.plot.gaits.loading_rule import loading_rule as loading_rule
from gaitsweep.plot.gaits.nine_gaits import nine_gaits as nine_gaits
from gaitsweep.plot.gaits.speed_gaits import speed_gaits as speed_gaits

register = FIGURES.register
unregister = FIGURES.unregister


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
