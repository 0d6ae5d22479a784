"""How long a multi-legged chain with unequal ends takes to its one gait, against the law of the drift."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullLocator, StrMethodFormatter

from gaitsweep.analysis.multilegged.conserved import worst_case_cycles
from gaitsweep.plot import style
from gaitsweep.plot.columns import FAILED, NOT_SETTLED, column, outcome, rows_where
from gaitsweep.plot.solution_set import chain_of

EQUAL = 1e-9  # kg


def drift_law(table: pd.DataFrame, *, hue: str = "gait", title: str | None = None) -> Figure:
    """Cycles until settled over the difference of the end masses, and the worst case of eqs. (30)-(32).

    For each pair of masses and each gait the most and the median number of cycles of its starts; pairs of
    equal masses, which keep all their gaits, are left out.

    Args:
        table: a settle table of the multi-legged chain with columns m_1 and m_end, kg.
        hue: the column of the gait.
        title: text above the figure.

    Raises:
        PlotError: a column is not there.
    """
    for name in ("m_1", "m_end", "cycles", hue):
        column(table, name)
    springs = sum(f"psi_{i}_end" in table for i in range(1, table.shape[1]))
    shown = outcome(table, hue)
    apart = np.abs(table["m_end"] - table["m_1"])
    kept = rows_where(table, (apart > EQUAL) & ~shown.isin([NOT_SETTLED, FAILED]))
    with style.canvas(style.COLUMN + 0.9, 3.1, title) as figure:
        axes = figure.subplots()
        axes.set_xlabel("difference of head's and tail's mass |m$_{N+1}$ − m$_1$|, kg")
        axes.set_ylabel("cycles until settled")
        if not len(kept):
            style.message(axes, "no row with unequal ends has settled")
            return figure
        groups = kept.groupby(["m_1", "m_end", kept[hue].astype(str)])["cycles"].agg(["median", "max"])
        pairs = groups.reset_index()
        pairs["apart"] = np.abs(pairs["m_end"] - pairs["m_1"])
        names = sorted(pairs[hue].unique())
        colour, marker = style.colours(names), style.markers(names)
        for name in names:
            mine = pairs[pairs[hue] == name]
            look = {"color": colour[name], "marker": marker[name], "s": 16, "linewidths": 0.8}
            axes.scatter(mine["apart"], mine["max"], label=f"{name}: most of its starts' cycles", **look)
            axes.scatter(
                mine["apart"], mine["median"], facecolors="none", label=f"{name}: median",
                **{**look, "color": None, "edgecolors": colour[name]},
            )  # fmt: skip
        chain = chain_of(table)
        law = pairs.groupby("apart")[["m_1", "m_end"]].first().reset_index()
        worst = [
            float(worst_case_cycles(springs, chain._replace(m_1=m_1, m_end=m_end)))
            for m_1, m_end in law[["m_1", "m_end"]].to_numpy(float)
        ]
        axes.plot(law["apart"], worst, color="black", lw=0.9, label="drift along all of the line")
        for axis, scale in ((axes.xaxis, axes.set_xscale), (axes.yaxis, axes.set_yscale)):
            scale("log")
            axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
            axis.set_minor_locator(NullLocator())
            axis.set_major_formatter(StrMethodFormatter("{x:g}"))
        figure.legend(loc="outside lower center", ncols=2)
    return figure
