"""Figures from tables: a kind of figure is one class with its fields in a job and its drawing.

`register` adds a kind from another package, before its jobs are read; it is usable as a decorator.
"""

from __future__ import annotations

from typing import Any

import pandas as pd
from matplotlib.figure import Figure

from gaitsweep import near_miss
from gaitsweep.kinds.part import Registry
from gaitsweep.plot.columns import PlotError
from gaitsweep.plot.figure_kind import FigureKind
from gaitsweep.plot.schemas.basins import (
    Basin,
    BasinMeasures,
    GaitMap,
    Shock,
)
from gaitsweep.plot.schemas.branches import (
    Branches,
    Continuation,
    Cycles,
    Hysteresis,
    ReturnMaps,
    StableRanges,
)
from gaitsweep.plot.schemas.chain import (
    DriftLaw,
    GaitShares,
    SolutionSet,
)
from gaitsweep.plot.schemas.gaits import (
    Footprints,
    GaitRamp,
    GaitSeries,
    LoadingRule,
    NineGaits,
    SpeedGaits,
)

__all__ = [
    "FIGURES",
    "FigureKind",
    "PlotError",
    "basin",
    "basin_measures",
    "branches",
    "continuation",
    "cycles",
    "draw",
    "drift_law",
    "footprints",
    "gait_map",
    "gait_ramp",
    "gait_series",
    "gait_shares",
    "hysteresis",
    "loading_rule",
    "nine_gaits",
    "register",
    "return_map",
    "shock",
    "solution_set",
    "speed_gaits",
    "stable_ranges",
    "unregister",
]

FIGURES: Registry[FigureKind] = Registry(
    "figure",
    [
        Basin,
        SolutionSet,
        Cycles,
        Footprints,
        Hysteresis,
        ReturnMaps,
        Branches,
        Continuation,
        StableRanges,
        GaitMap,
        DriftLaw,
        GaitShares,
        BasinMeasures,
        Shock,
        SpeedGaits,
        GaitSeries,
        GaitRamp,
        NineGaits,
        LoadingRule,
    ],
)
register = FIGURES.register
unregister = FIGURES.unregister

basin = Basin.draw
solution_set = SolutionSet.draw
cycles = Cycles.draw
footprints = Footprints.draw
hysteresis = Hysteresis.draw
return_map = ReturnMaps.draw
branches = Branches.draw
continuation = Continuation.draw
stable_ranges = StableRanges.draw
gait_map = GaitMap.draw
drift_law = DriftLaw.draw
gait_shares = GaitShares.draw
basin_measures = BasinMeasures.draw
shock = Shock.draw
speed_gaits = SpeedGaits.draw
gait_series = GaitSeries.draw
gait_ramp = GaitRamp.draw
nine_gaits = NineGaits.draw
loading_rule = LoadingRule.draw


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
