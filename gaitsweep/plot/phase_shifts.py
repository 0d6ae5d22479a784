"""Phase response: the phase that a gait gains by a push, over the phase of the push."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any

import numpy as np
import pandas as pd
from jaxtyping import Bool, Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from gaitsweep.plot import theme
from gaitsweep.plot.arguments import AlongAxis, Column, Horizontal, Title
from gaitsweep.plot.column_labels import described, written
from gaitsweep.plot.columns import PlotError, by_value, require_columns, rows_where
from gaitsweep.plot.kind import figure_kind

# A jump is this large (a share of the period), and as many times larger than the changes beside it; or it is
# larger than half a period, which a continuous shift between -1/2 and 1/2 exceeds only where it wraps.
LEAST_JUMP = 0.1
STEEPER = 4.0
WRAPPED = 0.5
_BESIDE = 3  # changes on each side of one, to which it is compared


@figure_kind("perturb", coloured="none")
def phase_response(
    table: pd.DataFrame,
    *,
    x: Horizontal = "push_phase",
    y: Annotated[AlongAxis, "column along the vertical axis"] = "phase_shift",
    hue: Annotated[Column | None, "column with one line for each value, such as the amount of a push"] = None,
    title: Title = None,
) -> Figure:
    """The phase shift that stays over the phase of the push, one line for each amount.

    Lines are interrupted where rows do not return to their gait, and where a phase shift jumps.

    Args:
        table: a table of pushed rows, or that of `PoincareMap.phase_response` with its `response_NAME` as y.

    Raises:
        PlotError: the table lacks a column, or a line has several rows at one place.
    """
    require_columns(table, x, y, hue)
    rows = rows_where(table, table[x].notna())
    lines = by_value(rows, hue)
    numeric = hue is not None and pd.api.types.is_numeric_dtype(rows[hue])
    few = len(lines) <= theme.MOST_NAMED_LINES or not numeric
    with theme.canvas(theme.COLUMN + (0.0 if few else 0.7), 2.6, title) as figure:
        axes = figure.subplots()
        if not len(rows):
            theme.message(axes, "no rows yet")
            return figure
        colours: Sequence[Any] = theme.LINE_COLOURS
        if not few:
            amounts = np.array([value for value, _ in lines], float)
            scale = theme.ColourScale(amounts)
            colours = list(scale.to_rgba(scale.on_scale(amounts)))
            scale.draw_bar(figure, axes, described(table, str(hue), 30))
        handles = []
        for number, (value, of_line) in enumerate(lines):
            look: dict[str, Any] = {"lw": 1.1, "marker": ".", "ms": 3.0}
            look["color"] = colours[number % len(colours)]
            look["ls"] = theme.DASHES[number % len(theme.DASHES)] if few else "-"
            _draw_line(axes, of_line, x, y, look)
            label = "" if value is None else written(table, str(hue), value)
            handles.append(Line2D([], [], label=label, **look))
        axes.axhline(0.0, color="#888888", lw=0.6, zorder=0)
        axes.set_xlabel(described(table, x, 40))
        axes.set_ylabel(described(table, y, 30))
        if hue and few:
            theme.legend(figure, handles, ncols=min(3, len(handles)), in_cell=True)
    return figure


def _draw_line(axes: Axes, rows: pd.DataFrame, x: str, y: str, look: dict[str, Any]) -> None:
    """Draw the line of one amount of a push, interrupted where a phase shift jumps."""
    if rows[x].duplicated().any():
        raise PlotError(
            f"Several rows have the same {x}, since another quantity varies too. Name it as `hue`, or keep "
            "one of its values in the table."
        )
    rows = rows.sort_values(x)
    across, up = rows[x].to_numpy(float), rows[y].to_numpy(float)
    jumps = _jumps(up) if y == "phase_shift" else np.zeros(max(len(up) - 1, 0), bool)
    axes.plot(*theme.interrupted(jumps, across, up), **look)


def _jumps(shift: Float[np.ndarray, " pushes"]) -> Bool[np.ndarray, " gaps"]:
    """Whether a phase shift jumps between pushes that follow each other.

    A shift jumps from half a period ahead to half a period behind, and where a gait of several alike
    crossings returns to another of them: by a change far larger than those beside it, or above half a period.
    """
    change = np.abs(np.diff(shift))
    beside = [
        np.r_[change[max(k - _BESIDE, 0) : k], change[k + 1 : k + 1 + _BESIDE]] for k in range(change.size)
    ]
    usual = np.array([np.nanmedian(near) if np.isfinite(near).any() else np.inf for near in beside])
    return (change > WRAPPED) | ((change > LEAST_JUMP) & (change > STEEPER * usual))
