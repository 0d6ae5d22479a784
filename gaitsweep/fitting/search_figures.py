"""Figures of a search: how the score fell, the profile of each constant, and which targets are missed."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from gaitsweep.fitting.free import Free
from gaitsweep.fitting.near_best import PARTS, Constant, NearBest
from gaitsweep.fitting.search_job import Search
from gaitsweep.fitting.targets import FAILED_MISS
from gaitsweep.plot.style import PAGE, canvas
from gaitsweep.table import own_folder, replace_file

_BLUE, _ORANGE, _GREY = "#0072B2", "#E69F00", "#BBBBBB"
# Sets whose misses are drawn, at most.
_MOST_LINES = 200


def draw_search(path: Path, search: Search, table: pd.DataFrame, near: NearBest) -> list[Path]:
    """Draw the figures of a search into its directory; returns their files.

    Args:
        path: the result directory.
        search: what was asked.
        table: its sets.
        near: what they say of the constants.
    """
    quantities = table.attrs.get("quantities", {})
    folder = path / "figures"
    own_folder(folder)
    drawn = []
    for name, draw in (
        ("convergence", lambda: _convergence(table)),
        ("constants", lambda: _constants(search.free, table, near, quantities)),
        ("misses", lambda: _misses(search, table, near)),
    ):
        file = folder / f"{name}.png"
        figure = draw()
        replace_file(file, lambda handle, figure=figure: figure.savefig(handle, format="png"))
        drawn.append(file)
    return drawn


def _convergence(table: pd.DataFrame) -> Figure:
    """The score of each set, and the least so far."""
    scores = table["score"].to_numpy()
    with canvas(PAGE / 2, 2.4) as figure:
        axes = figure.add_subplot()
        axes.plot(table["row"] + 1, scores, ".", color=_GREY, ms=2.0, label="a set", rasterized=True)
        axes.plot(table["row"] + 1, np.minimum.accumulate(scores), color=_BLUE, lw=1.4, label="best so far")
        axes.axhline(1.0, color="black", lw=0.6, ls=":")
        axes.set_yscale("log")
        axes.set_xlabel("sets measured")
        axes.set_ylabel("score: root mean square miss,\nin reading errors")
        axes.legend(loc="upper right")
    return figure


def _constants(
    free: Mapping[str, Free], table: pd.DataFrame, near: NearBest, quantities: Mapping[str, Mapping[str, str]]
) -> Figure:
    """The least score over each constant's range, and where the near-best sets have it."""
    columns = min(len(free), 4)
    rows = math.ceil(len(free) / columns)
    with canvas(PAGE, 0.4 + 1.5 * rows) as figure:
        panels = figure.subplots(rows, columns, sharey=True, squeeze=False).ravel()
        for axes, each in zip(panels, near.constants, strict=False):
            _profile(axes, free[each.name], each, near.best, quantities.get(each.name, {}))
        for axes in panels[len(free) :]:
            axes.set_visible(False)
        for axes in panels[::columns]:
            axes.set_ylabel("least score")
        fits = (
            f"{near.fitting} sets that fit all targets"
            if near.fitting
            else f"{len(near.best)} near-best sets"
        )
        figure.suptitle(f"Least score in each twentieth of a range; orange: {fits}", fontsize=8.5)
    return figure


def _profile(axes: Axes, free: Free, each: Constant, best: pd.DataFrame, known: Mapping[str, str]) -> None:
    edges = np.linspace(0.0, 1.0, PARTS + 1)
    axes.stairs(each.profile, edges, color=_BLUE, lw=1.2, baseline=None)
    shares = free.share(free.written(best[each.name].tolist())) if len(best) else np.zeros(0)
    axes.plot(shares, best["score"], "o", color=_ORANGE, ms=2.5, rasterized=True)
    axes.set_yscale("log")
    axes.set_xlim(0.0, 1.0)
    ticks = [0.0, 0.5, 1.0]
    if free.choices is not None:
        n = len(free.choices)
        axes.set_xticks((np.arange(n) + 0.5) / n, [str(choice) for choice in free.choices])
    else:
        axes.set_xticks(ticks, [f"{value:.3g}" for value in free.at(np.array(ticks))])
    unit = known.get("unit", "")
    axes.set_xlabel(each.name + (f" ({unit})" if unit not in ("", "1") else ""))
    axes.set_title(each.verdict, fontsize=7.5)


def _misses(search: Search, table: pd.DataFrame, near: NearBest) -> Figure:
    """The misses of the near-best sets, a line each, and of the sets that miss each target least."""
    names = list(search.targets)
    with canvas(PAGE, 2.6) as figure:
        axes = figure.add_subplot()
        axes.axhspan(-1.0, 1.0, color="#E4E4E4", lw=0)
        place = np.arange(len(names))
        trades = _least_of_each(search, table)
        for number, (_, line) in enumerate(trades.iterrows()):
            values = [line[f"miss_{name}"] for name in names]
            axes.plot(place, values, color=_GREY, lw=0.8, label="least miss of one target" * (not number))
        for number, (_, line) in enumerate(near.best.iloc[1:_MOST_LINES].iterrows()):
            values = [line[f"miss_{name}"] for name in names]
            axes.plot(place, values, color=_ORANGE, lw=0.5, alpha=0.5, label="near-best sets" * (not number))
        if len(near.best):
            values = [near.best.iloc[0][f"miss_{name}"] for name in names]
            axes.plot(place, values, "o-", color=_BLUE, lw=1.4, ms=3, label="best set")
        labels = [f"{name}\n(held back)" if search.targets[name].aim.held_back else name for name in names]
        axes.set_xticks(place, labels)
        axes.set_yscale("symlog", linthresh=1.0)
        axes.set_ylim(-1.2 * FAILED_MISS, 1.2 * FAILED_MISS)
        axes.set_ylabel("miss, in reading errors")
        axes.legend(loc="upper right", ncols=3)
    return figure


def _least_of_each(search: Search, table: pd.DataFrame) -> pd.DataFrame:
    """For each target that counts, the set that misses it least, of those that miss the others least."""
    rows = []
    for name in search.counted:
        order = table.assign(_miss=table[f"miss_{name}"].abs()).sort_values(["_miss", "score"])
        rows.append(order.index[0])
    return table.loc[list(dict.fromkeys(rows))]
