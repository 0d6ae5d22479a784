"""Figures from tables: each kind of figure is a function from a table to a matplotlib figure."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

import pandas as pd
from matplotlib.figure import Figure

from gaitsweep import near_miss
from gaitsweep.plot.basins.basin import basin
from gaitsweep.plot.basins.basin_measures import basin_measures
from gaitsweep.plot.basins.gait_map import gait_map
from gaitsweep.plot.basins.shock import shock
from gaitsweep.plot.branches.branches import branches
from gaitsweep.plot.branches.continuation import continuation
from gaitsweep.plot.branches.cycles import cycles
from gaitsweep.plot.branches.hysteresis import hysteresis
from gaitsweep.plot.branches.return_map import return_map
from gaitsweep.plot.branches.stable_ranges import stable_ranges
from gaitsweep.plot.chain.drift_law import drift_law
from gaitsweep.plot.chain.gait_shares import gait_shares_figure as gait_shares
from gaitsweep.plot.chain.solution_set import solution_set
from gaitsweep.plot.columns import PlotError
from gaitsweep.plot.gaits.footprints import footprints
from gaitsweep.plot.gaits.gait_ramp import gait_ramp
from gaitsweep.plot.gaits.gait_series import gait_series
from gaitsweep.plot.gaits.loading_rule import loading_rule
from gaitsweep.plot.gaits.nine_gaits import nine_gaits
from gaitsweep.plot.gaits.speed_gaits import speed_gaits
from gaitsweep.plot.provenance_marks import marked

__all__ = [
    "KINDS",
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
    "return_map",
    "shock",
    "solution_set",
    "speed_gaits",
    "stable_ranges",
]

# every figure carries the remarks on its table (incomplete, warned), however it is called
basin = marked(basin)
solution_set = marked(solution_set)
cycles = marked(cycles)
footprints = marked(footprints)
hysteresis = marked(hysteresis)
return_map = marked(return_map)
branches = marked(branches)
continuation = marked(continuation)
stable_ranges = marked(stable_ranges)
gait_map = marked(gait_map)
drift_law = marked(drift_law)
gait_shares = marked(gait_shares)
basin_measures = marked(basin_measures)
shock = marked(shock)
speed_gaits = marked(speed_gaits)
gait_series = marked(gait_series)
gait_ramp = marked(gait_ramp)
nine_gaits = marked(nine_gaits)
loading_rule = marked(loading_rule)

KINDS: Mapping[str, Callable[..., Figure]] = MappingProxyType(
    {
        "basin": basin,
        "solution_set": solution_set,
        "cycles": cycles,
        "footprints": footprints,
        "hysteresis": hysteresis,
        "return_map": return_map,
        "branches": branches,
        "continuation": continuation,
        "stable_ranges": stable_ranges,
        "gait_map": gait_map,
        "drift_law": drift_law,
        "gait_shares": gait_shares,
        "basin_measures": basin_measures,
        "shock": shock,
        "speed_gaits": speed_gaits,
        "gait_series": gait_series,
        "gait_ramp": gait_ramp,
        "nine_gaits": nine_gaits,
        "loading_rule": loading_rule,
    }
)


def draw(kind: str, table: pd.DataFrame, **spec: Any) -> Figure:
    """The figure of one kind from a table.

    Args:
        kind: a key of KINDS.
        table: a result table, as `gaitsweep.load` gives it.
        spec: the figure's own arguments.

    Raises:
        PlotError: the kind is not known, or the table lacks a column of the figure.
    """
    if kind not in KINDS:
        raise PlotError(f"{kind} is not a kind of figure{near_miss.suggestion(kind, KINDS)}")
    return KINDS[kind](table, **spec)
