"""Footprint diagrams: the contacts of each leg over time (Ambe 2021, Fig. 6 and 7)."""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterator, Sequence
from typing import Annotated, Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MultipleLocator

from gaitsweep.kinds.numbers import Flag, Text
from gaitsweep.plot import style
from gaitsweep.plot.columns import PlotError, column, rows_where, written
from gaitsweep.plot.figure_kind import Panels, PlannedTable, Refusal, Title, figure_kind

_NEAR = 0.3  # cycles; largest distance between swings of neighbours in one wave
_HOP = 0.5  # least duration of a swing, as a share of the leg's longest one
_BAR = 0.62
_MOST_PANELS = 24


def _check(figure: Any, table: PlannedTable) -> Iterator[Refusal]:
    if "contact_1" not in table.columns:
        yield figure.needs(table, "the signals contact_1, contact_2, ...")


@figure_kind("trace", check=_check)
def footprints(
    table: pd.DataFrame,
    *,
    panels: Panels = "row",
    titles: Annotated[Sequence[Text] | None, "titles of the panels, in order"] = None,
    guides: Annotated[
        Flag, "whether swings of neighbouring legs that follow each other are joined, in their wave's colour"
    ] = True,
    title: Title = None,
) -> Figure:
    """A black bar for each leg while it is on the ground, leg 1 on top; time in s below, in cycles above.

    Args:
        table: a trace table with columns t (s) and contact_1, contact_2, ... (1 on the ground).

    Raises:
        PlotError: t, panels or the contacts are not in the table.
    """
    column(table, "t")
    found = (re.fullmatch(r"contact_(\d+)", str(name)) for name in table.columns)
    legs = sorted(int(match[1]) for match in found if match)
    if not legs:
        raise PlotError(
            "The table has no columns contact_1, contact_2, ...: footprints are made from a trace."
        )
    parts: list[tuple[Any, pd.DataFrame]] = [(None, table)]
    if panels is not None:
        parts = list(table.groupby(column(table, panels), sort=True, observed=True))
    if len(parts) > _MOST_PANELS:
        title = f"{title or ''} (the first {_MOST_PANELS} of {len(parts)} panels)".strip()
    parts = parts[:_MOST_PANELS] or [(None, table)]
    height = len(parts) * (0.85 + 0.17 * len(legs)) + (0.45 if guides else 0.15)
    with style.canvas(style.PAGE, height, title) as figure:
        grid = figure.subplots(len(parts), 1, squeeze=False)[:, 0]
        joined: set[str] = set()
        for number, (axes, (value, part)) in enumerate(zip(grid, parts, strict=True)):
            heading = _heading(table, panels, value, number, titles or ())
            joined |= _panel(axes, part.sort_values("t"), legs, heading, guides)
        grid[-1].set_xlabel("time (s)")
        if joined:
            names = {
                "direct": "forwards, as in a direct wave",
                "retrograde": "backwards, as in a retrograde wave",
            }
            there = [gait for gait in names if gait in joined]
            look = [(style.COLOURS[gait], f"swings pass {names[gait]}") for gait in there]
            handles = [Line2D([], [], color=colour, lw=1.4, label=label) for colour, label in look]
            figure.legend(handles=handles, loc="outside lower center", ncols=2)
    return figure


def _heading(
    table: pd.DataFrame, panels: str | None, value: Any, number: int, titles: Sequence[str]
) -> str | None:
    """A panel's title: the one given for its row or position, else the value of its column."""
    if value is None:
        return titles[0] if titles else None
    place = int(value) if panels == "row" else number  # rows of a partial table keep their own titles
    if place < len(titles):
        return titles[place]
    return f"row {value}" if panels == "row" else written(table, str(panels), value)


def _panel(
    axes: Axes, part: pd.DataFrame, legs: Sequence[int], heading: str | None, guides: bool
) -> set[str]:
    """Draw one panel; returns the directions in which its swings are joined."""
    part = rows_where(part, part["t"].notna())
    axes.set_yticks(range(len(legs)), [f"Leg {leg}" for leg in legs])
    axes.tick_params(axis="y", length=0)
    axes.set_ylim(len(legs) - 0.4, -0.6)
    title = axes.set_title(heading or "", loc="left")
    if len(part) < 2:
        style.message(axes, "nothing was recorded")
        return set()
    t = part["t"].to_numpy(float)
    stances = [contact_intervals(t, part[f"contact_{leg}"].to_numpy(float)) for leg in legs]
    for row, (starts, stops) in enumerate(stances):
        bars = list(zip(starts, stops - starts, strict=True))
        axes.broken_barh(bars, (row - _BAR / 2, _BAR), facecolors="black", linewidth=0)
    axes.set_xlim(t[0], t[-1])
    stances = [_without_hops(*one) for one in stances]
    period = _period(stances, t[0])
    if period is None:
        return set()
    begin = float(t[0])
    there_and_back: Any = (lambda seconds: (seconds - begin) / period, lambda count: begin + count * period)
    above = axes.secondary_xaxis("top", functions=there_and_back)
    above.set_xlabel(f"cycles of {period:.2f} s", labelpad=2, loc="right")
    above.xaxis.set_major_locator(_whole(t[-1] - t[0], period))
    axes.set_title(
        title.get_text(), loc="left", y=1.0, pad=17
    )  # level with the label of the upper axis, not above it
    return _guides(axes, [_swings(*one) for one in stances], period) if guides else set()


def _whole(duration: float, period: float) -> MultipleLocator:
    """Ticks at whole cycles, at most ten."""
    return MultipleLocator(max(1, int(np.ceil(duration / period / 10))))


def contact_intervals(t: np.ndarray, contact: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Start and end times of the contacts; a sample extends half way to its neighbours."""
    down = np.nan_to_num(contact) > 0.5
    edges = np.r_[t[0], 0.5 * (t[1:] + t[:-1]), t[-1]]
    turns = np.flatnonzero(np.diff(np.r_[False, down, False]))
    return edges[turns[::2]], edges[turns[1::2]]


def _without_hops(starts: np.ndarray, stops: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The stances of a leg, with short losses of contact filled, as where the leg stops extending."""
    gaps = starts[1:] - stops[:-1]
    if not len(gaps):
        return starts, stops
    swing = gaps > _HOP * gaps.max()
    return starts[np.r_[True, swing]], stops[np.r_[swing, True]]


def _swings(starts: np.ndarray, stops: np.ndarray) -> np.ndarray:
    """The middles of the swings between two stances."""
    return 0.5 * (stops[:-1] + starts[1:])


def _period(stances: Sequence[tuple[np.ndarray, np.ndarray]], beginning: float) -> float | None:
    """The mean time between touchdowns of a leg without stumbles; None if no leg has two touchdowns."""
    gaps = np.concatenate([np.diff(starts[starts > beginning]) for starts, _ in stances])
    if not len(gaps):
        return None
    return float(gaps[np.abs(gaps / np.median(gaps) - 1.0) < 0.2].mean())


def _guides(axes: Axes, swings: Sequence[np.ndarray], period: float) -> set[str]:
    """Join each swing to the next leg's nearest one; returns the directions of the waves that occur."""
    drawn = set()
    for row, (here, there) in enumerate(itertools.pairwise(swings)):
        if not len(there):
            continue
        for middle in here:
            other = there[np.abs(there - middle).argmin()]
            if abs(other - middle) > _NEAR * period:
                continue
            gait = "retrograde" if other > middle else "direct"
            axes.plot([middle, other], [row, row + 1], color=style.COLOURS[gait], lw=1.4, zorder=4)
            drawn.add(gait)
    return drawn
