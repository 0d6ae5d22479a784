"""Figures of a result's table: `result.plot.basin(x="psi_1", y="psi_2")`."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Concatenate, ParamSpec

import pandas as pd
from matplotlib.figure import Figure

from gaitsweep import near_miss, plot

Spec = ParamSpec("Spec")


def _method(
    figure_of: Callable[Concatenate[pd.DataFrame, Spec], Figure],
) -> Callable[Concatenate[FiguresOfTable, Spec], Figure]:
    """Convert a figure's function of a table to a method of `FiguresOfTable`."""

    @functools.wraps(figure_of)
    def draw(self: FiguresOfTable, *args: Spec.args, **spec: Spec.kwargs) -> Figure:
        return figure_of(self.table, *args, **spec)

    return draw


class FiguresOfTable:
    """Figures of one table: each function of `gaitsweep.plot` without its first argument."""

    def __init__(self, table: pd.DataFrame) -> None:
        self.table = table

    def __getattr__(self, name: str) -> Callable[..., Figure]:
        """Return the function of a kind of figure of an extension."""
        if name not in plot.FIGURES:
            raise AttributeError(f"{name} is not a kind of figure{near_miss.suggestion(name, plot.FIGURES)}")
        return functools.partial(plot.drawing_function(plot.FIGURES[name]), self.table)

    def __dir__(self) -> list[str]:
        return sorted({*super().__dir__(), *plot.FIGURES})

    basin = _method(plot.basin)
    cycles = _method(plot.cycles)
    footprints = _method(plot.footprints)
    hysteresis = _method(plot.hysteresis)
    return_map = _method(plot.return_map)
    branches = _method(plot.branches)
    continuation = _method(plot.continuation)
    stable_ranges = _method(plot.stable_ranges)
    orbit = _method(plot.orbit)
    orbit_family = _method(plot.orbit_family)
    road_map = _method(plot.road_map)
    atlas = _method(plot.atlas)
    gait_map = _method(plot.gait_map)
    gait_transitions = _method(plot.gait_transitions)
    basin_measures = _method(plot.basin_measures)
    shock = _method(plot.shock)
    recovery = _method(plot.recovery)
    phase_response = _method(plot.phase_response)
    survival = _method(plot.survival)
