"""Shares of the multi-legged chain's gaits over parameters, with the edges of the paper's conditions."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from gaitsweep.analysis.multilegged.chain_of_table import parameters_of
from gaitsweep.analysis.multilegged.gait_shares import GAITS, gait_shares
from gaitsweep.plot import style
from gaitsweep.plot.cells import cell_edges, on_grid
from gaitsweep.plot.columns import axis_label, column, described

_SHARES = (*GAITS, "elsewhere")
_EDGE: dict[str, Any] = {"color": "black", "lw": 0.9, "ls": "--"}


def gait_shares_figure(
    table: pd.DataFrame, *, x: str, y: str | None = None, title: str | None = None
) -> Figure:
    """The share of starts that come to each gait: curves over x, or a map over x and y for each gait.

    Curves have their 95 % intervals. Broken lines are the edges of m/2 < m_B < m and of m g/kappa < a < L.

    Args:
        table: a settle table of the multi-legged chain, several starts for each set of parameters.
        x, y: columns along the axes; without y the shares are drawn as curves.
        title: text above the figure.

    Raises:
        PlotError: a column is not there.
    """
    for name in (x, y):
        if name is not None:
            column(table, name)
    if y is None:
        return _curves(table, x, title)
    with style.canvas(style.PAGE, 2.5, title) as figure:
        panels = figure.subplots(1, len(_SHARES), sharex=True, sharey=True)
        if not len(table):
            style.message(panels[0], "no rows yet")
            return figure
        shares = gait_shares(table)
        drawn = None
        for axes, gait in zip(panels, _SHARES, strict=True):
            drawn = _map(axes, shares, x, y, gait)
            axes.set_title(gait if gait in GAITS else "none of these")
            axes.set_xlabel(axis_label(table, x))
            _edges(axes, table, x, y)
        panels[0].set_ylabel(described(table, y, 24))
        assert drawn is not None
        figure.colorbar(drawn, ax=panels, label="share of starts", shrink=0.9)
    return figure


def _map(axes: Axes, shares: pd.DataFrame, x: str, y: str, gait: str) -> Any:
    """Cells where the sets lie on a grid, else a point for each set; sets that share a cell are averaged."""
    look = {"cmap": "viridis", "vmin": 0.0, "vmax": 1.0, "rasterized": True}
    across, up = np.unique(shares[x]), np.unique(shares[y])
    full = len(shares) >= 0.5 * len(across) * len(up)
    if not (full and on_grid(across) and on_grid(up)):
        size = float(np.clip(4e3 / len(shares), 3.0, 20.0))
        return axes.scatter(shares[x], shares[y], c=shares[gait], s=size, linewidths=0, **look)
    cells = shares.pivot_table(index=y, columns=x, values=gait, aggfunc="mean").to_numpy(float)
    return axes.pcolormesh(cell_edges(across), cell_edges(up), cells, **look)


def _curves(table: pd.DataFrame, x: str, title: str | None) -> Figure:
    with style.canvas(style.COLUMN + 0.9, 3.1, title) as figure:
        axes = figure.subplots()
        axes.set_xlabel(described(table, x))
        axes.set_ylabel("share of starts")
        if not len(table):
            style.message(axes, "no rows yet")
            return figure
        shares = gait_shares(table).sort_values(x)
        colour = {**style.colours(GAITS), "elsewhere": style.COLOURS["none"]}
        marker = {**style.markers(GAITS), "elsewhere": "x"}
        for gait in _SHARES:
            label = gait if gait in GAITS else "none of these"
            look = {"color": colour[gait], "marker": marker[gait], "ms": 3.5}
            axes.plot(shares[x], shares[gait], label=label, **look)
            if gait in GAITS:
                band = (shares[x], shares[f"{gait}_low"], shares[f"{gait}_high"])
                axes.fill_between(*band, color=colour[gait], alpha=0.18, lw=0)
        axes.set_ylim(-0.02, 1.02)
        _edges(axes, table, x, None)
        figure.legend(loc="outside lower center", ncols=4)
    return figure


def _edges(axes: Axes, table: pd.DataFrame, x: str, y: str | None) -> None:
    """Lines on which a condition turns, where it depends on what the axes show, all else as in the job."""
    low, high = axes.get_xlim(), axes.get_ylim()
    along = np.linspace(*low, 401)
    sets = pd.DataFrame({x: along})
    values = parameters_of(table, sets)
    for name, draw in ((x, axes.axvline), *(((y, axes.axhline),) if y else ())):
        if name == "m_B":
            draw(0.5 * float(np.ravel(values["m"])[0]), **_EDGE)
            draw(float(np.ravel(values["m"])[0]), **_EDGE)
    sag = values["m"] * values["g"] / values["kappa"]
    if y == "a":
        axes.plot(along, np.broadcast_to(sag, along.shape), **_EDGE)
        axes.axhline(float(np.ravel(values["L"])[0]), **_EDGE)
    elif y == "kappa":
        stiff = values["m"] * values["g"] / values["a"]
        axes.plot(along, np.broadcast_to(stiff, along.shape), **_EDGE)
    elif x == "kappa":
        axes.axvline(float(np.ravel(values["m"] * values["g"] / values["a"])[0]), **_EDGE)
    elif x == "a":
        axes.axvline(float(np.ravel(sag)[0]), **_EDGE)
        axes.axvline(float(np.ravel(values["L"])[0]), **_EDGE)
    axes.set_xlim(low)
    axes.set_ylim(high)
