"""Footprint diagrams: the contacts of each leg over time."""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterator, Sequence
from typing import Annotated, Any

import numpy as np
import pandas as pd
from jaxtyping import Bool, Float, Real
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MultipleLocator

from gaitsweep.plot import theme
from gaitsweep.plot.arguments import Panels, Title, Window
from gaitsweep.plot.columns import PlotError, column, row_names, rows_where, written
from gaitsweep.plot.kind import check_window, figure_kind
from gaitsweep.plot.limbs import limb_colours, limbs_of, model_of, name_limbs
from gaitsweep.plot.planned_table import PlannedTable, Refusal
from gaitsweep.schema.numbers import Flag, Text
from gaitsweep.skeleton import LimbLook

_NEAR = 0.3  # cycles; largest distance between swings of neighbours in one wave
_HOP = 0.5  # least duration of a swing, as a share of the leg's longest one
_REGULAR = 0.75  # least share of the times between touchdowns near their median, if no leg stumbles
_BAR = 0.62
_FORWARDS, _BACKWARDS, _FREE = "forwards", "backwards", "free"
_COLOURS = {_FORWARDS: "#E69F00", _BACKWARDS: "#0072B2", _FREE: "#CC79A7"}
_MOST_PANELS = 24


def _check(figure: Any, table: PlannedTable) -> Iterator[Refusal]:
    """Refuse a model without contacts, and a window that is not one."""
    if "contact_1" not in table.columns:
        yield figure.needs(table, "the signals contact_1, contact_2, ...")
    yield from check_window(figure)


@figure_kind("trace", check=_check, coloured="none")
def footprints(
    table: pd.DataFrame,
    *,
    panels: Panels = "row",
    titles: Annotated[Sequence[Text] | None, "titles of the panels, in order"] = None,
    guides: Annotated[
        Flag, "whether to join successive swings of neighbouring legs, in the colour of their wave"
    ] = True,
    window: Window = None,
    title: Title = None,
) -> Figure:
    """A bar for each limb on the ground, the first limb on top; time in s below, in cycles above.

    Limbs have the names and colours of `gaitsweep animate`. Cycles count from the beginning of the window.

    Losses of contact shorter than half a swing are filled; the legend gives their number and the longest one.
    In a chain of legs the link whose lag is free along the analytic solutions has its own colour.

    Args:
        table: a trace table with columns t (s) and contact_1, contact_2, ... (1 on the ground).

    Raises:
        PlotError: the table lacks t, panels or the contacts.
    """
    column(table, "t")
    matches = (re.fullmatch(r"contact_(\d+)", str(name)) for name in table.columns)
    legs = sorted(int(match[1]) for match in matches if match)
    if not legs:
        raise PlotError("The table has no columns contact_1, contact_2, ...: footprints need a trace.")
    parts: list[tuple[Any, pd.DataFrame]] = [(None, table)]
    if panels is not None:
        parts = list(table.groupby(column(table, panels), sort=True, observed=True))
    parts, title = theme.first_of(parts or [(None, table)], _MOST_PANELS, title)
    height = len(parts) * (0.85 + 0.17 * len(legs)) + 0.15 + (0.25 if title else 0.0)
    limbs = limbs_of(table, len(legs))
    with theme.canvas(theme.PAGE, height, title) as figure:
        grid = figure.subplots(len(parts), 1, squeeze=False)[:, 0]
        joined: set[str] = set()
        hops: list[float] = []
        for number, (axes, (value, part)) in enumerate(zip(grid, parts, strict=True)):
            alone = panels == "row" and len(parts) == 1  # its row's number would tell nothing
            heading = _heading(table, panels, None if alone else value, number, titles or ())
            joined |= _panel(axes, part.sort_values("t"), legs, limbs, heading, guides, window, hops)
        grid[-1].set_xlabel("time (s)")
        if joined:
            names = {
                _FORWARDS: "swings pass forwards, as in a direct wave",
                _BACKWARDS: "swings pass backwards, as in a retrograde wave",
                _FREE: "the lag of this link is free",
            }
            handles = [
                Line2D([], [], color=_COLOURS[way], lw=1.4, ls=":" if way == _FREE else "-", label=label)
                for way, label in names.items()
                if way in joined
            ]
            theme.legend(figure, handles, ncols=2, title=_filled(hops))
        elif hops:
            theme.legend(figure, [], title=_filled(hops))
        figure.set_figheight(height + 0.25 * (bool(joined) + bool(hops)))
    return figure


def _filled(hops: Sequence[float]) -> str | None:
    """Legend entry for losses of contact that are filled; None without any."""
    if not hops:
        return None
    losses = f"{len(hops)} loss{'es' * (len(hops) > 1)} of contact"
    return f"{losses} within a stance filled, of {max(hops):.2g} s at most"


def _heading(
    table: pd.DataFrame, panels: str | None, value: Any, number: int, titles: Sequence[str]
) -> str | None:
    """A panel's title: the given one, else the value of its column."""
    if value is None:
        return titles[0] if titles else None
    place = int(value) if panels == "row" else number  # rows of a partial table keep their own titles
    if place < len(titles):
        return titles[place]
    return row_names(table)[value] if panels == "row" else written(table, str(panels), value)


def _panel(
    axes: Axes,
    part: pd.DataFrame,
    legs: Sequence[int],
    limbs: Sequence[LimbLook],
    heading: str | None,
    guides: bool,
    window: Sequence[float] | None,
    hops: list[float],
) -> set[str]:
    """Draw one panel; returns the directions in which its swings are joined.

    The durations of filled losses of contact, s, are added to `hops`.
    """
    part = rows_where(part, part["t"].notna())
    name_limbs(axes, limbs)
    colours = limb_colours(limbs)
    title = axes.set_title(heading or "", loc="left")
    if len(part) < 2:
        theme.message(axes, "No sample of this row was recorded.")
        return set()
    t = part["t"].to_numpy(float)
    low, high = window or (float(t[0]), float(t[-1]))
    low, high = max(low, float(t[0])), min(high, float(t[-1]))
    if high <= low:
        theme.message(axes, f"This row was recorded from {t[0]:.4g} to {t[-1]:.4g} s only.")
        return set()
    stances = [contact_intervals(t, part[f"contact_{leg}"].to_numpy(float)) for leg in legs]
    hops += [gap for starts, stops in stances for gap in _hops(starts, stops, low, high)]
    stances = [_without_hops(starts, stops) for starts, stops in stances]
    for row, (starts, stops) in enumerate(stances):
        bars = list(zip(starts, stops - starts, strict=True))
        axes.broken_barh(bars, (row - _BAR / 2, _BAR), facecolors=colours[row], linewidth=0)
    axes.set_xlim(low, high)
    period = _period(stances, t[0])
    if period is None:
        return set()
    to_and_from_cycles: Any = (lambda t: (t - low) / period, lambda cycles: low + cycles * period)
    above = axes.secondary_xaxis("top", functions=to_and_from_cycles)
    above.set_xlabel(f"cycles of {period:.2f} s", labelpad=2, loc="right")
    # ticks at whole cycles, at most ten
    above.xaxis.set_major_locator(MultipleLocator(max(1, int(np.ceil((high - low) / period / 10)))))
    # level with the label of the upper axis, not above it
    axes.set_title(title.get_text(), loc="left", y=1.0, pad=17)
    if not guides:
        return set()
    middles = [0.5 * (stops[:-1] + starts[1:]) for starts, stops in stances]
    model = model_of(part)
    return _guides(axes, middles, period, None if model is None else model.free_link(part, len(legs)))


def contact_intervals(
    t: Float[np.ndarray, " samples"], contact: Real[np.ndarray, " samples"] | Bool[np.ndarray, " samples"]
) -> tuple[Float[np.ndarray, " stances"], Float[np.ndarray, " stances"]]:
    """Start and end times of the contacts; a sample extends half way to its neighbours."""
    down = np.nan_to_num(contact) > 0.5
    edges = np.r_[t[0], 0.5 * (t[1:] + t[:-1]), t[-1]]
    turns = np.flatnonzero(np.diff(np.r_[False, down, False]))
    return edges[turns[::2]], edges[turns[1::2]]


def _without_hops(
    starts: Float[np.ndarray, " stances"], stops: Float[np.ndarray, " stances"]
) -> tuple[Float[np.ndarray, " kept"], Float[np.ndarray, " kept"]]:
    """The stances of a leg, with short losses of contact filled, as where the leg stops extending."""
    gaps = starts[1:] - stops[:-1]
    if not len(gaps):
        return starts, stops
    swing = gaps > _HOP * gaps.max()
    return starts[np.r_[True, swing]], stops[np.r_[swing, True]]


def _hops(
    starts: Float[np.ndarray, " stances"], stops: Float[np.ndarray, " stances"], low: float, high: float
) -> Float[np.ndarray, " hops"]:
    """The durations, s, of the losses of contact from `low` to `high` that `_without_hops` fills."""
    gaps = starts[1:] - stops[:-1]
    if not len(gaps):
        return gaps
    return gaps[(gaps <= _HOP * gaps.max()) & (stops[:-1] >= low) & (starts[1:] <= high)]


def _period(
    stances: Sequence[tuple[Float[np.ndarray, " stances"], Float[np.ndarray, " stances"]]], beginning: float
) -> float | None:
    """The mean time between touchdowns of a leg without stumbles; None if there is no such leg."""
    of_legs = [np.diff(starts[starts > beginning]) for starts, _ in stances]
    gaps = np.concatenate(of_legs)
    if not len(gaps):
        return None
    usual = np.abs(gaps / np.median(gaps) - 1.0) < 0.2
    if usual.mean() < _REGULAR:  # legs stumble: the most regular one has the period
        several = [leg_gaps for leg_gaps in of_legs if len(leg_gaps) > 1]
        gaps = min(several, key=lambda leg_gaps: leg_gaps.std() / leg_gaps.mean(), default=gaps)
        usual = np.abs(gaps / np.median(gaps) - 1.0) < 0.2
        if usual.mean() < _REGULAR:
            return None
    return float(gaps[usual].mean())


def _guides(
    axes: Axes, middles: Sequence[Float[np.ndarray, " swings"]], period: float, free: int | None
) -> set[str]:
    """Join each swing to the next leg's nearest one; returns the directions of the waves that occur.

    The swings of the link `free` (from 1; None if the model leaves no link free) are joined whatever their
    lag; `middles` (s) are those of the swings of each leg.
    """
    ways = set()
    for row, (swings, next_swings) in enumerate(itertools.pairwise(middles)):
        if not len(next_swings):
            continue
        for middle in swings:
            nearest = next_swings[np.abs(next_swings - middle).argmin()]
            is_free = row + 1 == free
            if abs(nearest - middle) > (0.55 if is_free else _NEAR) * period:
                continue
            way = _FREE if is_free else _BACKWARDS if nearest > middle else _FORWARDS
            line = {"color": _COLOURS[way], "ls": ":" if is_free else "-", "lw": 1.4, "zorder": 4}
            axes.plot([middle, nearest], [row, row + 1], **line)
            ways.add(way)
    return ways
