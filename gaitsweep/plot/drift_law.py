"""How long a multi-legged chain with unequal ends takes to its one gait, against the law of the drift."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullLocator, StrMethodFormatter

from gaitsweep.analysis.multilegged.chain_of_table import chain_of
from gaitsweep.analysis.multilegged.conserved import drift, worst_case_cycles
from gaitsweep.plot import style
from gaitsweep.plot.columns import FAILED, NOT_SETTLED, PlotError, column, outcome, rows_where

EQUAL = 1e-9  # in the unit of what differs
ENDS = {
    "m": ("m_1", "m_end", "difference of head's and tail's mass |m$_{N+1}$ − m$_1$|, kg"),
    "kappa": ("kappa_1", "kappa_end", "drift of E, unequal end springs, rad a cycle"),
    "a": ("a_1", "a_end", "drift of E, unequal end amplitudes, rad a cycle"),
}


def drift_law(table: pd.DataFrame, *, of: str = "m", hue: str = "gait", title: str | None = None) -> Figure:
    """Cycles until settled over the asymmetry of the ends, and the worst case of eqs. (30)-(32).

    For each pair of ends and each gait the most and the median number of cycles of its starts. Pairs of equal
    ends, which keep all their gaits, are left out, and so are starts that come to none of them. Unequal
    masses are drawn over their difference, which the drift is proportional to; others over the drift itself.

    Args:
        table: a settle table of the multi-legged chain with the columns of the head's and the tail's value.
        of: what differs: m, kappa or a.
        hue: the column of the gait.
        title: text above the figure.

    Raises:
        PlotError: a column is not there, or `of` is not one of those.
    """
    if of not in ENDS:
        raise PlotError(f"of is {of}, but what can differ between the ends is one of {', '.join(ENDS)}.")
    head, tail, text = ENDS[of]
    for name in (head, tail, "cycles", hue):
        column(table, name)
    shown = outcome(table, hue)
    unlike = np.abs(table[tail] - table[head]) > EQUAL
    kept = rows_where(table, unlike & ~shown.isin([NOT_SETTLED, FAILED, "none"]))
    with style.canvas(style.COLUMN + 0.9, 3.1, title) as figure:
        axes = figure.subplots()
        axes.set_xlabel(text)
        axes.set_ylabel("cycles until settled")
        if not len(kept):
            style.message(axes, "no row with unequal ends has settled")
            return figure
        pairs = _pairs(table, kept, head, tail, hue)
        names = sorted(pairs[hue].unique())
        colour, marker = style.colours(names), style.markers(names)
        for name in names:
            mine = pairs[pairs[hue] == name]
            look = {"color": colour[name], "marker": marker[name], "s": 16, "linewidths": 0.8}
            axes.scatter(mine["apart"], mine["max"], label=f"{name}: most cycles", **look)
            axes.scatter(
                mine["apart"], mine["median"], facecolors="none", label=f"{name}: median",
                **{**look, "color": None, "edgecolors": colour[name]},
            )  # fmt: skip
        law = pairs.groupby("apart")["law"].first().sort_index()
        axes.plot(law.index, law, color="black", lw=0.9, label="drift along all of the line")
        for axis, scale in ((axes.xaxis, axes.set_xscale), (axes.yaxis, axes.set_yscale)):
            scale("log")
            axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
            axis.set_minor_locator(NullLocator())
            axis.set_major_formatter(StrMethodFormatter("{x:g}"))
        figure.legend(loc="outside lower center", ncols=2)
    return figure


def _pairs(table: pd.DataFrame, kept: pd.DataFrame, head: str, tail: str, hue: str) -> pd.DataFrame:
    """For each pair of ends and gait: the median and most cycles, how far apart the ends are, and the law's
    cycles."""
    springs = sum(f"psi_{i}_end" in table for i in range(1, table.shape[1]))
    chain = chain_of(table)
    groups = kept.groupby([head, tail, kept[hue].astype(str)])["cycles"].agg(["median", "max"])
    pairs = groups.reset_index()
    chains = [
        chain._replace(**{head: one, tail: other}) for one, other in pairs[[head, tail]].to_numpy(float)
    ]
    pairs["law"] = [float(worst_case_cycles(springs, each)) for each in chains]
    by_mass = head == "m_1"
    drifts = [abs(float(drift(each))) for each in chains]
    pairs["apart"] = np.abs(pairs[tail] - pairs[head]).round(9) if by_mass else np.round(drifts, 9)
    return rows_where(pairs, pairs["apart"] > EQUAL)
