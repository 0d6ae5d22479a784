"""Footprint diagrams: the contacts of each leg over time."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from typing import Annotated, Any, NamedTuple

import numpy as np
import pandas as pd
from jaxtyping import Bool, Float, Real
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MultipleLocator

from gaitsweep.plot import theme
from gaitsweep.plot.arguments import Panels, Title, Window
from gaitsweep.plot.column_labels import row_names, written
from gaitsweep.plot.columns import PlotError, column, rows_where
from gaitsweep.plot.kind import PlannedTable, Refusal, check_window, figure_kind
from gaitsweep.plot.limbs import limb_colours, limbs_of_model, model_of, name_limbs
from gaitsweep.schema.numbers import Flag, Text
from gaitsweep.skeleton import Limb, LimbLook, contact_signals

_NEAR = 0.3  # cycles: largest distance between swings of neighbours in one wave
_EQUALLY_FAR = 1e-6  # cycles: of two swings as far as that from a third neither is the nearer one
_NEAR_FREE = 0.55  # cycles: the same at a link whose lag is free
_OF_SWING = 0.5  # least duration of a swing, as a share of the leg's longest one
_OF_CYCLE = 1.0 / 8.0  # longest loss of contact within a stance, as a share of the cycle
_REGULAR = 0.75  # least share of the times between touchdowns near their median, if no leg stumbles
_NEAR_MEDIAN = 0.2  # relative difference of such a time from the median
_BAR = 0.62  # height of a bar, as a share of its row
_FORWARDS, _BACKWARDS, _FREE = "forwards", "backwards", "free"
_COLOURS = {_FORWARDS: "#E69F00", _BACKWARDS: "#0072B2", _FREE: "#CC79A7"}
_WORDS = {
    _FORWARDS: "swings pass forwards, as in a direct wave",
    _BACKWARDS: "swings pass backwards, as in a retrograde wave",
    _FREE: "the lag of this link is free",
}
_MOST_PANELS = 24

Stances = tuple[Float[np.ndarray, " stances"], Float[np.ndarray, " stances"]]  # their starts and ends, s


def _check(figure: Any, table: PlannedTable) -> Iterator[Refusal]:
    """Refuse a model without contacts, a panel with several rows, and a window that is not one."""
    if "contact_1" not in table.columns:
        yield figure.needs(table, "the signals contact_1, contact_2, ...")
    if figure.panels is None or figure.panels in table.varied:
        others = [
            group for group in table.rows.groups if group.length > 1 and figure.panels not in group.axes
        ]
        if others:
            differ = " and ".join(name for group in others for name in group.axes)
            text = f"would show rows that differ in {differ} in one panel, but a panel shows one row"
            yield ("panels",), f"{text}: write panels: row, or leave panels out."
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

    A panel shows one row. Limbs have the names and colours of `gaitsweep animate`. Cycles count from the
    beginning of the window.

    A loss of contact within a stance is filled if it is at most an eighth of the cycle and half of its leg's
    longest swing; all longer ones are swings. The legend gives the number of filled losses, and the longest.
    The cycle is the time between touchdowns after swings: of all these times, the one that halves their sum.
    If no leg has two such touchdowns, nothing is filled.

    In a chain of legs the link whose lag is free along the analytic solutions has its own colour.

    Args:
        table: a trace table with columns t (s) and contact_1, contact_2, ... (1 on the ground).

    Raises:
        PlotError: the table lacks t, panels or the contacts, or a panel would show several rows.
    """
    column(table, "t")
    legs = [int(name.removeprefix("contact_")) for name in contact_signals(table.columns)]
    if not legs:
        raise PlotError("The table has no columns contact_1, contact_2, ...: footprints need a trace.")
    parts: list[tuple[Any, pd.DataFrame]] = [(None, table)]
    if panels is not None:
        parts = list(table.groupby(column(table, panels), sort=True, observed=True))
    parts = parts or [(None, table)]
    rows = [part["row"].unique() for _, part in parts if "row" in part]
    shared = [together for together in rows if len(together) > 1]
    if shared:
        raise PlotError(
            f"Rows {shared[0][0]} and {shared[0][1]} would share a panel of footprints, which shows one row: "
            "give each row its own by panels: row, or give the table of one row."
        )
    parts, title = theme.first_of(parts, _MOST_PANELS, title)
    height = len(parts) * (0.85 + 0.17 * len(legs)) + 0.15 + (0.25 if title else 0.0)
    limbs = limbs_of_model(model_of(table), len(legs))
    with theme.canvas(theme.PAGE, height, title) as figure:
        grid = figure.subplots(len(parts), 1, squeeze=False)[:, 0]
        waves: set[str] = set()
        hops: list[float] = []
        for number, (axes, (value, part)) in enumerate(zip(grid, parts, strict=True)):
            alone = panels == "row" and len(parts) == 1  # its row's number would tell nothing
            heading = _heading(table, panels, None if alone else value, number, titles or ())
            axes.set_title(heading or "", loc="left")
            drawn = _draw_panel(axes, part.sort_values("t"), legs, limbs, window, guides=guides)
            waves |= drawn.waves
            hops += drawn.hops
        grid[-1].set_xlabel("time (s)")
        if waves or hops:
            theme.legend(figure, _key(waves), ncols=2, title=_filled(hops))
        figure.set_figheight(height + 0.25 * (bool(waves) + bool(hops)))
    return figure


def _key(waves: set[str]) -> list[Line2D]:
    """The legend of the directions of waves that occur."""
    return [
        Line2D([], [], color=_COLOURS[wave], lw=1.4, ls=":" if wave == _FREE else "-", label=label)
        for wave, label in _WORDS.items()
        if wave in waves
    ]


def _filled(hops: Sequence[float]) -> str | None:
    """The line of the legend about losses of contact that are filled; None without any."""
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


class _Drawn(NamedTuple):
    """The directions in which a panel joins swings, and the durations (s) of losses of contact it fills."""

    waves: set[str]
    hops: list[float]


def _draw_panel(
    axes: Axes,
    samples: pd.DataFrame,
    legs: Sequence[int],
    limbs: Sequence[LimbLook],
    window: Sequence[float] | None,
    *,
    guides: bool,
) -> _Drawn:
    """Draw the contacts of one row, or the reason why there are none to draw."""
    samples = rows_where(samples, samples["t"].notna())
    name_limbs(axes, limbs)
    if len(samples) < 2:
        theme.message(axes, "No sample of this row was recorded.")
        return _Drawn(set(), [])
    t = samples["t"].to_numpy(float)
    first, last = float(t[0]), float(t[-1])
    low, high = (max(window[0], first), min(window[1], last)) if window else (first, last)
    if high <= low:
        theme.message(axes, f"This row was recorded from {first:.4g} to {last:.4g} s only.")
        return _Drawn(set(), [])
    contacts = [contact_intervals(t, samples[f"contact_{leg}"].to_numpy(float)) for leg in legs]
    swings = _swings(contacts)
    hops = [
        float(gap)
        for (starts, stops), swing in zip(contacts, swings, strict=True)
        for gap in (starts[1:] - stops[:-1])[~swing & (stops[:-1] >= low) & (starts[1:] <= high)]
    ]
    stances = [joined_stances(*contact, swing) for contact, swing in zip(contacts, swings, strict=True)]
    draw_stances(axes, stances, limbs, _BAR)
    axes.set_xlim(low, high)
    period = _period(stances, first)
    if period is None:
        return _Drawn(set(), hops)
    _count_cycles(axes, low, high, period)
    if not guides:
        return _Drawn(set(), hops)
    middles = [0.5 * (stops[:-1] + starts[1:]) for starts, stops in stances]
    model = model_of(samples)
    free_link = None if model is None else model.free_link(samples, len(legs))
    return _Drawn(_guides(axes, middles, period, free_link), hops)


def draw_stances(
    axes: Axes, stances: Sequence[Stances], limbs: Sequence[Limb | LimbLook], height: float
) -> None:
    """Draw the stances of limbs as rows of bars in their colours.

    Args:
        axes: the panel, in which the rows are at 0, 1, ...
        stances: those of each limb.
        limbs: the limbs.
        height: of a bar, as a share of its row.
    """
    for row, ((starts, stops), colour) in enumerate(zip(stances, limb_colours(limbs), strict=True)):
        bars = list(zip(starts, stops - starts, strict=True))
        axes.broken_barh(bars, (row - height / 2, height), facecolors=colour, linewidth=0)


def _count_cycles(axes: Axes, low: float, high: float, period: float) -> None:
    """Add an upper axis with the number of cycles since `low`; times are in s."""
    to_and_from_cycles: Any = (lambda t: (t - low) / period, lambda cycles: low + cycles * period)
    above = axes.secondary_xaxis("top", functions=to_and_from_cycles)
    above.set_xlabel(f"cycles of {period:.2f} s", labelpad=2, loc="right")
    # ticks at whole cycles, at most ten
    above.xaxis.set_major_locator(MultipleLocator(max(1, int(np.ceil((high - low) / period / 10)))))
    # level with the label of the upper axis, not above it
    axes.set_title(axes.get_title(loc="left"), loc="left", y=1.0, pad=17)


def contact_intervals(
    t: Float[np.ndarray, " samples"], contact: Real[np.ndarray, " samples"] | Bool[np.ndarray, " samples"]
) -> Stances:
    """Start and end times of the contacts; a sample extends half way to its neighbours."""
    down = np.nan_to_num(contact) > 0.5
    edges = np.r_[t[0], 0.5 * (t[1:] + t[:-1]), t[-1]]
    turns = np.flatnonzero(np.diff(np.r_[False, down, False]))
    return edges[turns[::2]], edges[turns[1::2]]


def _swings(contacts: Sequence[Stances]) -> list[Bool[np.ndarray, " gaps"]]:
    """Whether each loss of contact of each leg is a swing; the others are short ones within a stance."""
    gaps = [starts[1:] - stops[:-1] for starts, stops in contacts]
    # touchdowns after losses that are long beside the leg's usual one, whatever its longest one is
    landed = [
        starts[1:][of_leg > _OF_SWING * _usual(of_leg)]
        for (starts, _), of_leg in zip(contacts, gaps, strict=True)
    ]
    cycle = _usual(np.concatenate([np.diff(times) for times in landed]))
    return [of_leg > min(_OF_CYCLE * cycle, _OF_SWING * of_leg.max(initial=0.0)) for of_leg in gaps]


def _usual(durations: Float[np.ndarray, " durations"]) -> float:
    """The duration (s) that halves their sum, which many short ones hardly change; 0 of none."""
    if not len(durations):
        return 0.0
    durations = np.sort(durations)
    return float(durations[np.searchsorted(durations.cumsum(), 0.5 * durations.sum())])


def joined_stances(
    starts: Float[np.ndarray, " contacts"],
    stops: Float[np.ndarray, " contacts"],
    swings: Bool[np.ndarray, " gaps"],
) -> Stances:
    """The stances of a leg, with the losses of contact between them filled that are no `swings`."""
    return (starts[np.r_[True, swings]], stops[np.r_[swings, True]]) if len(starts) else (starts, stops)


def _period(stances: Sequence[Stances], beginning: float) -> float | None:
    """The mean time between touchdowns of a leg without stumbles; None if there is no such leg."""
    of_legs = [np.diff(starts[starts > beginning]) for starts, _ in stances]
    gaps = np.concatenate(of_legs)
    if not len(gaps):
        return None
    if not _is_regular(gaps):  # legs stumble: the most regular one has the period
        several = [leg_gaps for leg_gaps in of_legs if len(leg_gaps) > 1]
        gaps = min(several, key=lambda leg_gaps: leg_gaps.std() / leg_gaps.mean(), default=gaps)
        if not _is_regular(gaps):
            return None
    return float(gaps[_near_median(gaps)].mean())


def _near_median(gaps: Float[np.ndarray, " gaps"]) -> Bool[np.ndarray, " gaps"]:
    """Whether each time between touchdowns is near their median."""
    return np.abs(gaps / np.median(gaps) - 1.0) < _NEAR_MEDIAN


def _is_regular(gaps: Float[np.ndarray, " gaps"]) -> bool:
    """Whether most of the times between touchdowns are near their median."""
    return bool(_near_median(gaps).mean() >= _REGULAR)


def _nearest(times: Float[np.ndarray, " times"], time: float, equal: float) -> float:
    """The time that is nearest to another one, the last of those that are so up to `equal`."""
    apart = np.abs(times - time)
    return float(times[np.flatnonzero(apart <= apart.min() + equal)[-1]])


def _guides(
    axes: Axes, middles: Sequence[Float[np.ndarray, " swings"]], period: float, free: int | None
) -> set[str]:
    """Join each swing to the next leg's nearest one; returns the directions of the waves that occur.

    Two swings are joined if none is nearer to either, so that those of a leg that stumbles are left out. The
    swings of the link `free` (from 1; None if the model leaves no link free) are joined whatever their lag;
    `middles` (s) are those of the swings of each leg.
    """
    waves = set()
    for row, (swings, next_swings) in enumerate(itertools.pairwise(middles)):
        if not len(next_swings):
            continue
        is_free = row + 1 == free
        reach = (_NEAR_FREE if is_free else _NEAR) * period
        for middle in swings:
            nearest = _nearest(next_swings, middle, _EQUALLY_FAR * period)
            nearer = np.abs(swings - nearest).min() < abs(middle - nearest) - _EQUALLY_FAR * period
            if abs(nearest - middle) > reach or nearer:
                continue
            direction = _BACKWARDS if nearest > middle else _FORWARDS
            wave = _FREE if is_free else direction
            line = {"color": _COLOURS[wave], "ls": ":" if is_free else "-", "lw": 1.4, "zorder": 4}
            axes.plot([middle, nearest], [row, row + 1], **line)
            waves.add(wave)
    return waves
