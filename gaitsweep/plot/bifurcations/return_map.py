"""First return maps: how a section observable changes from one crossing to the next."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any, Literal, get_args

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from gaitsweep.analysis.transitions.return_map import drift, fixed_points, ghosts, pairs
from gaitsweep.angles import unwrap_from
from gaitsweep.plot import theme
from gaitsweep.plot.arguments import Bandwidth, Observed, Panels, Title
from gaitsweep.plot.column_labels import described, symbol, unit_of, written
from gaitsweep.plot.columns import PlotError, by_value, column, origin_of, require_columns, require_one_system
from gaitsweep.plot.kind import check_one_system, figure_kind
from gaitsweep.schema.numbers import Word

_PANELS_A_ROW = 3
_MOST_PANELS = 24
_POINTS, _CURVE, _POINT, _GHOST = "#B8B8B8", "#0072B2", "#D55E00", "#009E73"
_GHOST_WORDS = "ghost: slow passage, with its change"
_FAST = 2.0  # steps larger than so many ranges of the others are left out of the axis limits
_NEAR = 0.1  # ranges of the values: a smaller change is near the diagonal
_MOST = 0.98  # the least share of changes near the diagonal of a map that is near it
Form = Literal["change", "next"]
FORMS: tuple[Form, ...] = get_args(Form)


@figure_kind("return_map", check=check_one_system, coloured="none")
def return_map(
    table: pd.DataFrame,
    *,
    y: Observed,
    panels: Panels = None,
    form: Annotated[
        Annotated[Form, Word()] | None,
        "change: y's change over y; next: the next y over y; by default next, but change where nearly "
        "all points (98 %) lie near the diagonal",
    ] = None,
    bandwidth: Bandwidth = None,
    title: Title = None,
) -> Figure:
    """The change from crossing to crossing over the value, or the next value over the value and the diagonal.

    A grey point is one step of one start; the line is their local linear regression with two standard errors
    on either side, interrupted where the points have a gap, a jump or two branches. Stable fixed points are
    filled, unstable ones open; a triangle marks a ghost, where the change nearly reaches zero.

    Args:
        table: a return map's table.

    Raises:
        PlotError: the table lacks a column, the form is unknown, or the bandwidth is not above 0.
    """
    if form not in (None, *FORMS):
        raise PlotError(f"form is {form}, but must be {' or '.join(FORMS)}.")
    name = column(table, y, ("_n", ""))
    require_columns(table, "row", "crossing", panels)
    require_one_system(table, panels)
    parts, title = theme.first_of(by_value(table, panels), _MOST_PANELS, title)
    form = form or ("change" if _near_the_diagonal(table, name) else "next")
    down, across = theme.shape(len(parts), theme.PAGE, 2.0, _PANELS_A_ROW, height_of=lambda _: 2.0)
    width, height = theme.PAGE, 2.3 if across > 1 else 1.7
    if len(parts) == 1:
        width, height = theme.COLUMN + 1.2, 2.8
    with theme.canvas(width, height * down + 0.9, title) as figure:
        grid = theme.panels(figure, (down, across), len(parts), sharex=True, sharey=True)
        origin = origin_of(table, name, table[name].to_numpy(float))
        marks: set[str] = set()
        for axes, (value, part) in zip(grid, parts, strict=True):
            marks |= _panel(axes, part, name, form, bandwidth, origin)
            axes.set_title("" if value is None else written(table, str(panels), value))
        x = described(table, name, min(90 // across, 44))
        theme.label_panels(figure, grid, across, x=x, y=_label(table, name, form))
        _scale(grid, form, origin)
        if marks:
            theme.legend(figure, _key(marks), ncols=min(across + 1, 3), in_cell=True)
    return figure


def _label(table: pd.DataFrame, name: str, form: Form) -> str:
    """The label of the vertical axis: the change to the next crossing, or the next value."""
    value = symbol(table, name)
    label = f"change of {value} to" if form == "change" else f"{value} at"
    unit = unit_of(table, name)
    return f"{label}\nthe next crossing" + (f" ({unit})" if unit else "")


def _near_the_diagonal(table: pd.DataFrame, name: str) -> bool:
    """Whether nearly all changes (`_MOST`) are small beside the range of the values."""
    steps = pairs(table, name)
    if not len(steps):
        return True
    values = steps["value"].to_numpy(float)
    values = unwrap_from(values, origin_of(table, name, values))
    return bool(np.quantile(np.abs(steps["change"].to_numpy(float)), _MOST) < _NEAR * np.ptp(values))


def _panel(
    axes: Axes, part: pd.DataFrame, name: str, form: Form, bandwidth: float | None, origin: float | None
) -> set[str]:
    """Draw one map: points, curve, fixed points and ghosts; returns which of them occur."""
    steps = pairs(part, name)
    if not len(steps):
        theme.message(axes, "No start has two crossings in succession with a value.")
        return set()
    value, change = unwrap_from(steps["value"].to_numpy(), origin), steps["change"].to_numpy(float)
    marks = {"points"}
    size = float(np.clip(2e3 / len(steps), 1.0, 6.0))
    up = change + value if form == "next" else change
    axes.scatter(value, up, s=size, color=_POINTS, lw=0, rasterized=True, zorder=1)
    if form == "change":
        axes.axhline(0.0, color="black", lw=0.6, zorder=2)
    else:
        axes.axline((value.min(), value.min()), slope=1.0, color="black", lw=0.6, zorder=2)
        marks.add("diagonal")
    curve = drift(part, name, bandwidth=bandwidth)
    if len(curve):
        _curve(axes, curve, form, origin)
        marks.add("curve")
    fixed = fixed_points(part, name, bandwidth=bandwidth)
    for at, stable in zip(unwrap_from(fixed["value"].to_numpy(), origin), fixed["stable"], strict=True):
        look: dict[str, Any] = {"marker": "o", "ms": 6.0, "mew": 1.3, "color": _POINT, "zorder": 6}
        axes.plot(at, at if form == "next" else 0.0, mfc=_POINT if stable else "white", **look)
        marks.add("stable" if stable else "unstable")
    ghost = ghosts(part, name, bandwidth=bandwidth)
    for at, least in zip(unwrap_from(ghost["value"].to_numpy(), origin), ghost["drift"], strict=True):
        _mark_ghost(axes, float(at), float(least), form)
        marks.add("ghost")
    return marks


def _mark_ghost(axes: Axes, at: float, least: float, form: Form) -> None:
    """Mark a value at which the change is nearly zero, with its `least` change."""
    point = (at, at + least if form == "next" else least)
    axes.plot(*point, "^" if least > 0 else "v", ms=5, color=_GHOST, zorder=6)
    if form == "next":  # beside the diagonal
        offset, side = ((8, -9), "left") if least > 0 else ((-8, 3), "right")
    else:  # beyond zero, where fewer points are
        offset, side = ((0, -14), "center") if least > 0 else ((0, 8), "center")
    look: dict[str, Any] = {"textcoords": "offset points", "fontsize": theme.points(7), "color": _GHOST}
    axes.annotate(f"{least:+.2g}".replace("-", "−"), point, offset, ha=side, **look)


def _curve(axes: Axes, curve: pd.DataFrame, form: Form, origin: float | None) -> None:
    """Draw the smoothed change and two standard errors on either side, with gaps as those of `drift`."""
    at = unwrap_from(curve["value"].to_numpy(), origin)
    order = np.argsort(at)
    at, mean, piece = at[order], curve["drift"].to_numpy(float)[order], curve["piece"].to_numpy()[order]
    error = 2.0 * curve["drift_error"].to_numpy(float)[order]
    step = np.diff(at)
    parted = np.diff(piece) != 0
    if len(step):
        parted |= step > 1.5 * np.median(step)
    at, mean, error = theme.interrupted(parted, at, mean, error)
    line = mean + at if form == "next" else mean
    axes.fill_between(at, line - error, line + error, color=_CURVE, alpha=0.25, lw=0, zorder=3)
    axes.plot(at, line, color=_CURVE, lw=1.2, zorder=4)


def _scale(grid: Sequence[Axes], form: Form, origin: float | None) -> None:
    """Set axis limits by the steps, without the few that are far larger than the others; ticks in pi."""
    if form == "change":
        lines = [np.asarray(line.get_ydata(), float) for axes in grid for line in axes.lines]
        steps = [np.asarray(points.get_offsets())[:, 1] for axes in grid for points in axes.collections[:1]]
        spread = [np.quantile(changes, (0.05, 0.95)) for changes in steps if len(changes)]
        heights = np.concatenate([[0.0], *lines, *spread])
        low, high = float(np.nanmin(heights)), float(np.nanmax(heights))
        all_steps = np.concatenate([[0.0], *steps])
        if np.ptp(all_steps) <= _FAST * (high - low):
            low, high = min(low, float(all_steps.min())), max(high, float(all_steps.max()))
        if high > low:
            grid[0].set_ylim(low - 0.1 * (high - low), high + 0.1 * (high - low))
    if origin is not None:
        theme.angle_ticks(grid[0], "x")
        if form == "next":
            theme.angle_ticks(grid[0], "y")


def _key(marks: set[str]) -> list[Line2D]:
    """The legend of the marks that occur."""
    point: dict[str, Any] = {"ls": "", "marker": "o", "ms": 6.0, "mew": 1.3, "color": _POINT}
    handles = {
        "points": Line2D([], [], ls="", marker=".", color=_POINTS, label="one step of one start"),
        "curve": Line2D([], [], color=_CURVE, lw=1.2, label="smoothed, ± 2 standard errors"),
        "diagonal": Line2D([], [], color="black", lw=0.6, label="no change"),
        "stable": Line2D([], [], label="stable", **point),
        "unstable": Line2D([], [], mfc="white", label="unstable", **point),
        "ghost": Line2D([], [], ls="", marker="^", ms=5, color=_GHOST, label=_GHOST_WORDS),
    }
    return [handle for name, handle in handles.items() if name in marks]
