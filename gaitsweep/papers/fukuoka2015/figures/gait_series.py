"""Walks in time: footfalls, loads and pitch; the nine gaits by their footfalls (Fukuoka 2015, Fig. 2-6)."""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import Annotated, Any

import numpy as np
import pandas as pd
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from gaitsweep import LimbLook, Trace
from gaitsweep.papers.fukuoka2015.analysis.gait_bouts import MIN_WINDOWS, gait_bouts, gaits_along
from gaitsweep.papers.fukuoka2015.analysis.gait_tables import gaits_in
from gaitsweep.papers.fukuoka2015.analysis.swing_onsets import FLEXORS
from gaitsweep.papers.fukuoka2015.figures.gait_looks import ORDER, areas_of, colour_of, in_words, label_of
from gaitsweep.papers.fukuoka2015.planar_quadruped.drawing import LIMBS as DRAWN_LIMBS
from gaitsweep.papers.fukuoka2015.planar_quadruped.nine_gaits import CHART, LEGS
from gaitsweep.plot import (
    Count,
    CountOrZero,
    Flag,
    PlannedTable,
    Positive,
    Refusal,
    Text,
    Title,
    Window,
    check_window,
    contact_intervals,
    figure_kind,
    limb_colours,
    name_limbs,
    require_columns,
    rows_where,
    theme,
)

LIMBS: Mapping[str, LimbLook] = MappingProxyType(dict(zip(LEGS, DRAWN_LIMBS, strict=True)))
CONTACTS = MappingProxyType({leg: f"contact_{i + 1}" for i, leg in enumerate(LEGS)})
FLIGHT = "#E6E6E6"
_BAR = 0.62


@functools.cache
def leg_colours() -> Mapping[str, str]:
    """The colour of each leg, as in all figures of its limbs."""
    return MappingProxyType(dict(zip(LEGS, limb_colours(DRAWN_LIMBS), strict=True)))


def footfalls(axes: Axes, samples: pd.DataFrame) -> None:
    """A bar for each leg while it is on the ground, the first leg on top; flight phases in light grey.

    Args:
        axes: the axes, over time in s.
        samples: a part of one row of a trace: t and contact_1, ... in the order of `LEGS`.

    Raises:
        PlotError: a contact is not in the table.
    """
    require_columns(samples, *CONTACTS.values())
    t = samples["t"].to_numpy(float)
    down = samples[list(CONTACTS.values())].to_numpy(float)
    for row, leg in enumerate(LEGS):
        starts, stops = contact_intervals(t, down[:, row])
        bars = list(zip(starts, stops - starts, strict=True))
        axes.broken_barh(bars, (row - _BAR / 2, _BAR), facecolors=leg_colours()[leg], linewidth=0)
    shade_flights(axes, t, down)
    name_limbs(axes, list(LIMBS.values()))


def shade_flights(
    axes: Axes, t: Float[np.ndarray, " samples"], down: Float[np.ndarray, "samples legs"]
) -> None:
    """Light grey flight phases: times `t` (s) at which no leg is `down` (1)."""
    for start, stop in zip(*contact_intervals(t, (down.max(axis=1) < 0.5).astype(float)), strict=True):
        axes.axvspan(float(start), float(stop), facecolor=FLIGHT, linewidth=0, zorder=0)


_MAX_STRIPS = 12
_MAX_COLUMNS, _ONE_COLUMN_STRIPS = 2, 4  # more strips than _ONE_COLUMN_STRIPS are in two columns
_LABEL_ROOM = 1.0  # inches; of names and labels beside a strip
_HEIGHTS = {"gait": 0.4, "flexor": 0.75, "load": 0.75, "feet": 0.8, "pitch": 0.7}  # inches
_LETTER_WIDTH = 0.075  # inches; width of a letter of a gait's name


def _check(figure: Any, table: PlannedTable) -> Iterator[Refusal]:
    needed = ["pitch", *FLEXORS.values(), *CONTACTS.values(), *(f"F_{leg}" for leg in LEGS if figure.loads)]
    if (name := table.missing(needed)) is not None:
        yield figure.needs(table, f"the signal {name}")
    if figure.row is not None and figure.row >= table.rows.n_rows:
        yield ("row",), f"is {figure.row}, but the job has rows 0 to {table.rows.n_rows - 1}."
    yield from check_window(figure)
    if figure.strip_columns is not None and figure.strip_columns > _MAX_COLUMNS:
        yield ("strip_columns",), f"is {figure.strip_columns}, but must be 1 or {_MAX_COLUMNS}."
    if figure.strip is not None and isinstance(table.run, Trace):
        strips = table.run.duration / figure.strip
        if strips > 10_000 or math.isinf(strips):
            count = f"{strips:.3g} strips in {table.run.duration:g} s"
            yield ("strip",), f"is {figure.strip:g} s, which gives {count}, too many to draw."


@figure_kind("trace", check=_check)
def gait_series(
    table: pd.DataFrame,
    *,
    row: Annotated[CountOrZero | None, "the row to show; by default all rows"] = None,
    window: Window = None,
    strip: Annotated[Positive | None, "length of a strip, in s; gaits are then named along time"] = None,
    loads: Annotated[Flag, "whether to draw the loads on the feet"] = False,
    titles: Annotated[Sequence[Text] | None, "titles of the strips, in order"] = None,
    strip_columns: Annotated[
        Count | None, "columns of strips, 1 or 2, read downwards; by default 2 for more than four strips"
    ] = None,
    title: Title = None,
) -> Figure:
    """The output of each flexor, footfalls and pitch over time; flight phases in grey.

    Each row is a strip; the peaks of loads at touchdown are cut off. A single row may extend over several
    strips of a given length, with a bar for each gait bout, named where there is room: for a walk whose speed
    changes. Strips in two columns are read downwards, the left column first.

    Args:
        table: a trace of a model with u_f_LF, ..., contact_1, ... and pitch (F_LF, ... for loads).

    Raises:
        PlotError: the table does not have a column.
    """
    require_columns(table, "row", "t", "pitch", *FLEXORS.values(), *(f"F_{leg}" for leg in LEGS if loads))
    table = table if row is None else rows_where(table, table["row"] == row)
    parts, title = theme.first_of(_strips(table, window, strip), _MAX_STRIPS, title, "strips")
    most = strip_columns or (_MAX_COLUMNS if len(parts) > _ONE_COLUMN_STRIPS else 1)
    down, columns = theme.shape(len(parts), theme.PAGE, 3.0, most)
    kinds = [kind for kind in _HEIGHTS if (kind != "gait" or strip) and (kind != "load" or loads)]
    heights = [_HEIGHTS[kind] for kind in kinds]
    height = down * (sum(heights) + 0.35) + 0.5
    along = gaits_along(table) if strip and len(table) else None
    with theme.canvas(theme.PAGE, height, title) as figure:
        outer = figure.subfigures(down, columns, squeeze=False).ravel(order="F")
        gaits: set[str] = set()
        for number, (place, part) in enumerate(zip(outer, parts, strict=False)):
            grid = place.subplots(len(kinds), 1, sharex=True, squeeze=False, height_ratios=heights)[:, 0]
            heading = _heading(table, part, number, titles) if strip is None or titles else ""
            wide = theme.width_of(theme.PAGE) / columns
            gaits |= _draw(dict(zip(kinds, grid, strict=True)), part, along, heading, wide)
        if not parts:
            theme.message(outer[0].subplots(), "No sample of these rows was recorded in this time.")
        areas = {} if along is None else areas_of(along["gait"].astype(str))
        bouts = [Patch(label=label_of(gait), **areas[gait]) for gait in ORDER if gait in gaits]
        theme.legend(figure, [*_handles_of_samples(parts), *bouts], ncols=5)
    return figure


def _handles_of_samples(parts: Sequence[pd.DataFrame]) -> list[Line2D | Patch]:
    """The legend's entries for the legs, and for flight phases if there are any."""
    handles: list[Line2D | Patch] = []
    for leg in LEGS:
        handles.append(Line2D([], [], color=leg_colours()[leg], ls=_line(leg), lw=1.6, label=LIMBS[leg].name))
    if any((part[list(CONTACTS.values())].max(axis=1) < 0.5).any() for part in parts):
        handles.append(Patch(color=FLIGHT, label="flight: no foot on the ground"))
    return handles


def _strips(table: pd.DataFrame, window: Sequence[float] | None, strip: float | None) -> list[pd.DataFrame]:
    """The samples of each strip, in order."""
    parts = []
    for _, samples in table.groupby("row", sort=True):
        samples = rows_where(samples, samples["t"].notna()).sort_values("t", kind="stable")
        t = samples["t"].to_numpy(float)
        if len(t) < 2:
            continue
        begin, end = (t[0], t[-1]) if window is None else window
        edges = [begin, end] if strip is None else [*np.arange(begin, end - 1e-9, strip), end]
        for low, high in itertools.pairwise(edges):
            part = rows_where(samples, (t >= low - 1e-9) & (t <= high + 1e-9))
            if len(part) > 1:
                parts.append(part)
    return parts


def _line(leg: str) -> str | tuple[int, tuple[int, int]]:
    """The line style of a leg: dashed for hind legs, whose colours are like those of fore legs in grey."""
    return (0, (4, 1)) if LIMBS[leg].pair else "-"


def _heading(table: pd.DataFrame, part: pd.DataFrame, number: int, titles: Sequence[str] | None) -> str:
    """The given title, or the gait, its speed and the swept axes."""
    if titles is not None:
        return titles[number] if number < len(titles) else ""
    row = part["row"].iloc[0]
    record = gaits_in(rows_where(table, table["row"] == row)).iloc[0]
    return ", ".join([str(record["gait"]), *in_words(table, record, part)])


def _draw(
    grid: dict[str, Axes], part: pd.DataFrame, along: pd.DataFrame | None, heading: str, wide: float
) -> set[str]:
    """One strip, in `wide` inches; returns the gaits of its bouts."""
    t = part["t"].to_numpy(float)
    down = part[[name for name in CONTACTS.values() if name in part.columns]].to_numpy(float)
    footfalls(grid["feet"], part)
    for leg in LEGS:
        out = np.maximum(part[FLEXORS[leg]].to_numpy(float), 0.0)
        grid["flexor"].plot(t, out, color=leg_colours()[leg], ls=_line(leg), lw=0.9)
        if "load" in grid:
            load = part[f"F_{leg}"].to_numpy(float)
            grid["load"].plot(t, load, color=leg_colours()[leg], ls=_line(leg), lw=0.8)
    grid["flexor"].set_ylabel("flexor\noutput")
    grid["pitch"].plot(t, part["pitch"].to_numpy(float), color="black", lw=0.9)
    grid["pitch"].axhline(0.0, color="#AAAAAA", lw=0.5, zorder=0)
    grid["pitch"].set_ylabel("pitch,\ndown (rad)")
    grid["pitch"].set_xlabel("time (s)")
    if "load" in grid:
        grid["load"].set_ylabel("load (N)")
        loads = part[[f"F_{leg}" for leg in LEGS]].to_numpy(float)
        # peaks at touchdown are far higher
        grid["load"].set_ylim(0.0, 1.6 * np.percentile(loads.max(axis=1), 90.0))
    for kind in ("flexor", "load", "pitch"):
        if kind in grid:
            shade_flights(grid[kind], t, down)
    grid["pitch"].set_xlim(t[0], t[-1])
    top = next(iter(grid.values()))
    top.set_title(heading, loc="left")
    return set() if along is None else _bouts(grid["gait"], part, along, wide)


def _bouts(axes: Axes, part: pd.DataFrame, along: pd.DataFrame, wide: float) -> set[str]:
    """The gait bouts as bars with their names, and the speed at both ends; returns the gaits."""
    axes.set_axis_off()
    axes.set_ylim(0.0, 1.0)
    of_row = rows_where(along, along["row"] == part["row"].iloc[0])
    low, high = float(part["t"].iloc[0]), float(part["t"].iloc[-1])
    axes.set_xlim(low, high)
    width = (wide - _LABEL_ROOM) / (high - low)  # inches a second
    areas = areas_of(along["gait"].astype(str))
    drawn = set()
    for bout in gait_bouts(of_row, "gait", MIN_WINDOWS).to_dict("records"):
        begin, end = max(float(bout["begin"]), low), min(float(bout["end"]), high)
        if end <= begin:
            continue
        name = str(bout["gait"])
        drawn.add(name)
        axes.barh(0.15, end - begin, 0.26, left=begin, **areas[name])
        if (end - begin) * width > _LETTER_WIDTH * len(name):
            style: dict[str, Any] = {"ha": "center", "va": "bottom", "fontsize": theme.points(7)}
            axes.text(0.5 * (begin + end), 0.3, name, **style)
    if "speed" in of_row.columns and len(of_row):
        style = {"va": "top", "fontsize": theme.points(7), "color": "#444444"}
        for at, side in ((low, "left"), (high, "right")):
            speed = np.interp(at, of_row["t"].to_numpy(float), of_row["speed"].to_numpy(float))
            axes.text(at, 1.0, f"{speed:.2f} m/s", ha=side, **style)
    return drawn


_NOTE_WIDTH = 1.5  # inches; width of the description of a cell
_NARROW_WIDTH = 5.0  # inches; below, cells have their speed alone, and the first column names the legs
_TILTS = ("hind leg first\n(tilted down)", "together\n(level)", "fore leg first\n(tilted up)")
_PAIRS = ("left fore and right hind leg", "right fore and left hind leg")  # of the columns and of the rows


def _check_signals(figure: Any, table: PlannedTable) -> Iterator[Refusal]:
    if (name := table.missing([*FLEXORS.values(), *CONTACTS.values()])) is not None:
        yield figure.needs(table, f"the signal {name}")


@figure_kind("trace", check=_check_signals)
def nine_gaits(
    table: pd.DataFrame,
    *,
    cycles: Annotated[Positive, "cycles that an example shows"] = 2.5,
    title: Title = None,
) -> Figure:
    """A cell for each gait: which leg of each diagonal pair swings first, with the footfalls of one row.

    The row shown is the one of its gait with the largest margin to another gait; the cell of a gait without
    rows stays empty.

    Args:
        table: a trace of a model with the nine gaits.

    Raises:
        PlotError: the table does not have a column.
    """
    require_columns(table, "row", "t", *FLEXORS.values())
    gaits = gaits_in(table)
    narrow = theme.width_of(theme.PAGE) < _NARROW_WIDTH
    with theme.canvas(theme.PAGE, 4.9, title) as figure:
        grid = figure.subplots(3, 3)
        for place, gait in enumerate(CHART):
            down, across = divmod(place, 3)
            axes = grid[down, across]
            candidates = gaits.loc[gaits["gait"] == gait]
            if len(candidates):
                clearest = candidates.loc[candidates["margin"].idxmax()]
                _example(axes, table, gait, clearest, cycles, narrow=narrow)
            else:
                _name(axes, gait)
                _empty(axes, "no row" if narrow else "no row has it")
            if across > 0 and narrow:
                axes.tick_params(labelleft=False)
        for across, axes in enumerate(grid[0]):
            _head_column(axes, across, 32 if narrow else 42)
        for down, axes in enumerate(grid[:, 0]):
            axes.set_ylabel(_TILTS[down], fontsize=theme.points(7.5), labelpad=4)
        for axes in grid[2]:
            axes.set_xlabel("time (s)")
        figure.supylabel(_PAIRS[1], fontsize=theme.points(7.5))
    return figure


def _head_column(axes: Axes, across: int, above: float) -> None:
    """The heading of a column of cells, `above` points over it; over all three what they have in common."""
    style: dict[str, Any] = {"ha": "center", "fontsize": theme.points(7.5)}
    style |= {"xycoords": "axes fraction", "textcoords": "offset points"}
    axes.annotate(_TILTS[across], (0.5, 1.0), (0, above), **style)
    if across == 1:  # a line that is wider than its column
        axes.annotate(_PAIRS[0], (0.5, 1.0), (0, above + 22), in_layout=False, **style)
        axes.annotate(" ", (0.5, 1.0), (0, above + 22), **style)


def _example(
    axes: Axes, table: pd.DataFrame, gait: str, record: pd.Series, cycles: float, *, narrow: bool
) -> None:
    """The footfalls of a row, whose entry of `gaits_in` is `record`, with its description."""
    samples = rows_where(table, table["row"] == record["row"]).sort_values("t", kind="stable")
    samples = samples.assign(t=samples["t"] - samples["t"].min())
    end = cycles * float(np.asarray(record["period"], float))
    samples = rows_where(samples, samples["t"] <= end)
    footfalls(axes, samples)
    axes.set_xlim(0.0, end)
    words = in_words(table, record, samples)
    note = words[0] if narrow else theme.wrapped(", ".join(words), _NOTE_WIDTH, 7.0)
    _name(axes, gait, note)
    last = float(f"{0.8 * end:.1g}")
    axes.set_xticks([0.0, last], ["0", f"{last:g}"])


def _empty(axes: Axes, text: str) -> None:
    """The cell of a gait without rows."""
    axes.set_xticks([])
    axes.set_yticks([])
    for spine in axes.spines.values():
        spine.set_visible(False)
    theme.message(axes, text)


def _name(axes: Axes, gait: str, note: str = "") -> None:
    """The name of the gait above its cell, and below it a description of the example."""
    style: dict[str, Any] = {"xycoords": "axes fraction", "textcoords": "offset points"}
    above = 3 + 9 * (note.count("\n") + 1)
    style |= {"fontsize": theme.points(8.5), "weight": "bold"}
    axes.annotate(label_of(gait), (0.0, 1.0), (0, above), color=colour_of(gait), **style)
    style |= {"fontsize": theme.points(7), "weight": "normal"}
    axes.annotate(note, (0.0, 1.0), (0, 3), color="#444444", **style)
