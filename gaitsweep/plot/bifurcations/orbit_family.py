"""Figure of a family of gaits along a branch of an atlas: when its events take place, and its duration."""

from __future__ import annotations

import itertools
from typing import Annotated, Any

import numpy as np
import pandas as pd
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from gaitsweep.plot import theme
from gaitsweep.plot.arguments import Title
from gaitsweep.plot.bifurcations.branch_lines import pieces, stretches
from gaitsweep.plot.column_labels import described
from gaitsweep.plot.columns import PlotError, moved_parameter, require_columns, rows_where
from gaitsweep.plot.kind import figure_kind

_LINES = ("-", (0, (5, 1.5)), (0, (1, 1)), (0, (5, 1.5, 1, 1.5)))
_MEANING = "first time in the cycle: "


@figure_kind("atlas", coloured="none")
def orbit_family(
    table: pd.DataFrame,
    *,
    branch: Annotated[int, "number of the branch"] = 0,
    row: Annotated[int, "row of the job"] = 0,
    title: Title = None,
) -> Figure:
    """Draw the times of the events of the gaits along a branch, as shares of the cycle, and its duration.

    Stable gaits have thick lines. A dotted line marks where the order of events changes.

    Args:
        table: the table of an atlas.
        branch: the number of the branch.
        row: the row of the job.

    Raises:
        PlotError: the table lacks a column or the branch, or the model has no events.
    """
    x = moved_parameter(table) or "parameter"
    require_columns(table, x, "row", "part", "number", "point", "time", "stable", "special")
    branches = rows_where(table, (table["row"] == row) & (table["part"] == "branch"))
    family = rows_where(branches, branches["number"] == branch).sort_values("point")
    if not len(family):
        numbers = ", ".join(map(str, np.unique(branches["number"].to_numpy(int))))
        raise PlotError(f"branch is {branch}, but row {row} has the branches {numbers or '(none)'}.")
    names = _events(table, family)
    if not names:
        raise PlotError("The gaits of this branch have no events.")
    with theme.canvas(theme.COLUMN + 1.6, 4.4, title) as figure:
        above, below = figure.subplots(2, 1, sharex=True, height_ratios=[2.2, 1.0])
        duration = family["time"].to_numpy(float)
        colours = theme.colours(names.values())
        lines = dict(zip(names.values(), itertools.cycle(_LINES)))
        for column, name in names.items():
            share = family[column].to_numpy(float) / duration
            _draw(above, family, x, share, colours[name], lines[name])
        _draw(below, family, x, duration, "#333333", "-")
        for at in family.loc[family["special"] == "order_change", x]:
            for axes in (above, below):
                axes.axvline(float(at), color="#777777", ls=":", lw=0.9, zorder=0)
        above.set_ylabel("share of the cycle")
        above.set_ylim(-0.02, 1.02)
        below.set_ylabel("duration (s)")
        below.set_xlabel(described(table, x))
        handles = [
            Line2D([], [], color=colours[name], ls=line, lw=1.8, label=name) for name, line in lines.items()
        ]
        if not family["stable"].to_numpy(bool).all():
            handles.append(Line2D([], [], color="#333333", lw=0.8, label="thin: unstable"))
        theme.legend(figure, handles, ncols=2)
    return figure


def _events(table: pd.DataFrame, family: pd.DataFrame) -> dict[str, str]:
    """The columns of the times of events that occur along a branch, with the name of each event."""
    quantities = table.attrs.get("quantities", {})
    return {
        str(name): str(quantities.get(name, {}).get("meaning", name)).removeprefix(_MEANING)
        for name in family
        if str(name).startswith("t_") and np.isfinite(family[name].to_numpy(float)).any()
    }


def _draw(
    axes: Axes, family: pd.DataFrame, x: str, values: Float[np.ndarray, " points"], colour: str, line: Any
) -> None:
    """Draw a number along the branch, thick where its gaits are stable."""
    at = family[x].to_numpy(float)
    for piece, part in stretches(pieces(family)):
        style = ":" if piece == "kink" else line
        axes.plot(at[part], values[part], color=colour, ls=style, lw=0.8 if piece == "unstable" else 1.8)
