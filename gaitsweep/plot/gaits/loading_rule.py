"""The rule of leg loading: each pair's shift over loads and pitch in its stance (Fukuoka 2015, Fig. 5)."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from gaitsweep.analysis.gaits import loading_rule as rule
from gaitsweep.models.planar_quadruped.nine_gaits import THRESHOLD
from gaitsweep.plot import style
from gaitsweep.plot.columns import PlotError, column, rows_where, written
from gaitsweep.plot.gaits.gait_looks import COLOURS, MARKERS, ORDER, gait_key
from gaitsweep.plot.provenance_marks import marked

_ACROSS = 3


@marked
def loading_rule(
    table: pd.DataFrame,
    *,
    measures: Sequence[str] | None = None,
    only: str | None = None,
    value: float | None = None,
    title: str | None = None,
) -> Figure:
    """A panel for each measure: delta over it, a point for each diagonal pair of each steady row.

    The two quadrants where a pair's shift has the sign of the rule are light grey. Above each panel are r and
    the share of shifted pairs in these quadrants.

    Args:
        table: a trace or a settle table of `planar_quadruped`.
        measures: those of `analysis.loading_rule.MEASURES` to show; by default all that the table gives.
        only, value: a column and its value in the rows to show; by default all rows.
        title: text above the figure.

    Raises:
        PlotError: a column or a measure is not there.
    """
    if only is not None:
        column(table, only)
        table = rows_where(table, table[only] == value)
    pairs = rule.pairs_in(table)
    told = {str(record["measure"]): record for record in rule.loading_rule(pairs).to_dict("records")}
    names = list(measures or told)
    missing = [name for name in names if name not in told]
    if missing:
        raise PlotError(f"{missing[0]} is no measure that this table tells; it tells {', '.join(told)}.")
    down = -(-len(names) // _ACROSS)
    across = min(len(names), _ACROSS)
    present = set(pairs["gait"].astype(str))
    heading = title if only is None else f"{title or ''} {written(table, only, value)}".strip()
    with style.canvas(style.PAGE, 2.25 * down + 0.6, heading) as figure:
        grid = figure.subplots(down, across, sharey=True, squeeze=False).ravel()
        for number, (axes, name) in enumerate(zip(grid, names, strict=False)):
            _panel(axes, pairs, name, told[name])
            if number % across == 0:
                axes.set_ylabel("shift of the pair, $\\delta$ (cycles)\nhind leg late: positive")
        for axes in grid[len(names) :]:
            axes.set_visible(False)
        figure.legend(handles=gait_key(present), loc="outside lower center", ncols=6)
    return figure


def _panel(axes: Axes, pairs: pd.DataFrame, name: str, told: Mapping[Any, Any]) -> None:
    for gait in ORDER:
        part = rows_where(pairs, pairs["gait"].astype(str) == gait)
        if len(part):
            look: dict[str, Any] = {"color": COLOURS[gait], "marker": MARKERS[gait], "ms": 3.4, "ls": ""}
            axes.plot(part[name], part["delta"], mew=0.5, alpha=0.8, **look)
    x, delta = np.abs(pairs[name].to_numpy(float)), np.abs(pairs["delta"].to_numpy(float))
    reach, height = 1.08 * np.nanmax(x, initial=1e-9), max(0.3, 1.1 * np.nanmax(delta, initial=0.0))
    axes.set_xlim(-reach, reach)
    axes.set_ylim(-height, height)
    for x, low in ((-reach, THRESHOLD), (0.0, -height)):
        look = {"facecolor": "#F0F0F0", "linewidth": 0, "zorder": 0}
        axes.fill_between([x, x + reach], low, low + height - THRESHOLD, **look)
    axes.axhline(0.0, color="#AAAAAA", lw=0.5, zorder=1)
    axes.axvline(0.0, color="#AAAAAA", lw=0.5, zorder=1)
    measure = rule.MEASURES[name]
    axes.set_xlabel("\n".join(textwrap.wrap(f"{measure.meaning} ({measure.unit})", 30)))
    share = f"sign right {style.percent(told['right'])} %" if told["shifted"] else "no pair shifted"
    axes.set_title(f"r = {told['r']:.2f}, {share}".replace("-", "\u2212"))
