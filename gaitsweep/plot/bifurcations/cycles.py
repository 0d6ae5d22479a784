"""Section observables over the number of the crossing, one line for each start."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from pydantic import Field

from gaitsweep.analysis.records import names_in
from gaitsweep.plot import theme
from gaitsweep.plot.arguments import Horizontal, Hue, Observable, Title
from gaitsweep.plot.column_labels import described, symbol
from gaitsweep.plot.columns import PlotError, column, is_angle, log_axes
from gaitsweep.plot.kind import figure_kind
from gaitsweep.status import Outcome, Status


@figure_kind("return_map", "ramp")
def cycles(
    table: pd.DataFrame,
    *,
    y: Annotated[Sequence[Observable], Field(min_length=1), "observables of the model, one panel each"],
    x: Horizontal = "crossing",
    hue: Hue = "row",
    title: Title = None,
) -> Figure:
    """One panel for each observable, one line for each row.

    Lines are interrupted where crossings are missing or an angle wraps.

    Args:
        table: a crossing table (return map or ramp).

    Raises:
        PlotError: the table lacks a column, or y names no observable.
    """
    if not y:
        raise PlotError("y is empty: name at least one observable.")
    names = [column(table, name, ("_n", "")) for name in names_in(y)]
    x = column(table, x, ("", "_n"))
    column(table, hue)
    lines: list[tuple[Any, pd.DataFrame]] = []
    for part in _rows(table):
        value = part[hue].iloc[0]
        line = part.sort_values("crossing") if "crossing" in part else part
        lines.append((Outcome.NO_GAIT.value if pd.isna(value) else value, line))
    values = list(dict.fromkeys(value for value, _ in lines))
    looks = _looks(values)
    down, across = theme.shape(len(names), theme.PAGE, 1.6)
    with theme.canvas(theme.PAGE, 2.4 * down + (0.45 if len(values) > 1 else 0.0), title) as figure:
        panels = theme.panels(figure, (down, across), len(names), sharex=True)
        for number, (axes, name) in enumerate(zip(panels, names, strict=True)):
            for value, line in lines:
                _line(axes, line, x, name, looks[value], is_angle(table, name))
            axes.set_xlabel(described(table, x, 24) if number + across >= len(names) else "")
            log_axes(axes, table, x=x)
            axes.set_ylabel(described(table, name, 24))
            theme.value_axis(axes, angle=is_angle(table, name))
            if is_angle(table, name):
                theme.angle_axis(axes, "y")
            if not lines:
                theme.message(axes, "The run has stored no row yet.")
        if 1 < len(values) <= theme.MOST_NAMED_LINES:
            labels, heading = _labels(table, lines, names, hue)
            handles = [Line2D([], [], label=labels[value], **looks[value]) for value in values]
            theme.legend(figure, handles, ncols=min(4, len(handles)), title=heading, in_cell=True)
    return figure


def _rows(table: pd.DataFrame) -> list[pd.DataFrame]:
    """The records of each row; a table without a column of rows is one."""
    return [part for _, part in table.groupby("row", sort=True)] if "row" in table.columns else [table]


def _looks(values: Sequence[Any]) -> dict[Any, dict[str, Any]]:
    """A colour for each value, that of a gait or one of a palette, and dashes if the values are few."""
    of_gaits = theme.colours(map(str, values)) if all(isinstance(value, str) for value in values) else {}
    palette = theme.LINE_COLOURS
    looks: dict[Any, dict[str, Any]] = {}
    for number, value in enumerate(values):
        dashes = theme.DASHES[number % len(theme.DASHES)] if len(values) <= theme.MOST_NAMED_LINES else "-"
        colour = of_gaits.get(value, palette[number % len(palette)])
        looks[value] = {"color": colour, "ls": dashes, "lw": 1.0}
    return looks


def _line(axes: Axes, part: pd.DataFrame, x: str, name: str, look: dict[str, Any], angle: bool) -> None:
    """Draw one row's line, and a cross where the row failed."""
    across, up = part[x].to_numpy(float), part[name].to_numpy(float)
    colour = look["color"]
    parted = np.zeros(max(len(up) - 1, 0), bool)
    if "crossing" in part.columns:
        parted |= np.diff(part["crossing"].to_numpy(int)) > 1  # crossings that the table lacks
    up = np.mod(up, 2 * np.pi) if angle else up
    if angle:
        parted |= np.abs(np.diff(up)) > np.pi
    across, up = theme.interrupted(parted, across, up)
    lone = np.isfinite(up) & ~np.isfinite(np.r_[np.nan, up[:-1]]) & ~np.isfinite(np.r_[up[1:], np.nan])
    axes.plot(across, up, **look)
    axes.plot(across[lone], up[lone], ".", color=colour, ms=2.5)
    finite = np.flatnonzero(np.isfinite(up))
    status = str(part["status"].iloc[-1]) if "status" in part.columns else Status.complete.name
    if len(finite) and status not in Status.SOUND | Status.UNDECIDED:
        axes.plot(across[finite[-1]], up[finite[-1]], "x", color=colour, ms=5, mew=1.2, clip_on=False)


def _labels(
    table: pd.DataFrame, lines: Sequence[tuple[Any, pd.DataFrame]], names: Sequence[str], hue: str
) -> tuple[dict[Any, str], str]:
    """The name of each line's hue, or its start if lines are rows with one, and the legend's title."""
    starts = [name[:-2] for name in names if name.endswith("_n") and name[:-2] in table.columns]
    if hue != "row" or len(starts) < len(names):
        return {value: str(value) for value, _ in lines}, symbol(table, hue)
    labels = {
        row: "(" + ", ".join(f"{line[name].iloc[0]:.2f}" for name in starts) + ")" for row, line in lines
    }
    unit = ", rad" if all(is_angle(table, name) for name in starts) else ""
    return labels, "start (" + ", ".join(symbol(table, name) for name in starts) + ")" + unit
