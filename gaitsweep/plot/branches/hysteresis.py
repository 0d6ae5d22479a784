"""Hysteresis: a section observable while one parameter rises and falls again (Aoi 2011, Fig. 5, 6 and 8)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.transforms import ScaledTranslation

from gaitsweep.analysis.circular import cut
from gaitsweep.analysis.records import sound
from gaitsweep.analysis.transitions.transition_points import LEAST, largest_jumps, transition_points
from gaitsweep.kinds.numbers import Positive, Text
from gaitsweep.plot import style
from gaitsweep.plot.branches.passes import DOWN, UP, draw_arrows, draw_row
from gaitsweep.plot.columns import (
    PlotError,
    column,
    described,
    is_angle,
    moved_parameter,
    rows_where,
    symbol,
    unit_of,
    written,
)
from gaitsweep.plot.figure_kind import Observed, Panels, PlannedTable, Refusal, Title, figure_kind
from gaitsweep.plot.provenance_marks import remarks
from gaitsweep.table import TableError, load

_PANELS_A_ROW = 3
_MOST_PANELS = 12
_FAINT = 4  # with more rows each is drawn fainter


class _Panel(NamedTuple):
    heading: str
    table: (
        pd.DataFrame | None
    )  # None if the table does not exist yet; the heading names it, the note gives the reason
    note: str = ""


def _check(figure: Any, table: PlannedTable) -> Iterator[Refusal]:
    if figure.parameter not in (None, table.run.moved):
        yield ("parameter",), f"is {figure.parameter}, but this run moves {table.run.moved}: leave it out."


@figure_kind("ramp", "staircase", check=_check)
def hysteresis(
    table: pd.DataFrame,
    *,
    y: Observed,
    parameter: Annotated[Text | None, "the parameter that the run moves; it need not be said"] = None,
    panels: Panels = None,
    with_table: Annotated[
        Text | pd.DataFrame | None,
        "a second result directory to show beside, by its path or its job's name",
    ] = None,
    least: Annotated[Positive, "change of y that counts as a jump, in its unit"] = LEAST,
    title: Title = None,
) -> Figure:
    """An observable over the moving parameter, rising and falling passes distinguished, jumps shaded.

    A ramp is a thin line through its crossings; a staircase has a marker at the end of each hold, open where
    the hold had not settled, and a faint line between holds of one branch. The legend gives the interval of
    each pass's jump, the median over the rows.

    Args:
        table: a ramp or staircase table.
        with_table: a table, or a path relative to here or to the parent of the first table's directory.

    Raises:
        PlotError: the table does not have a column, or no parameter moves.
    """
    parameter = parameter or moved_parameter(table)
    if parameter is None:
        raise PlotError(
            "The table's job moves no parameter: hysteresis is drawn from a ramp or a staircase; "
            "for another table name the column as `parameter`."
        )
    shown = [*_split(table, panels, with_table is not None), *_second(table, with_table, panels)]
    if len(shown) > _MOST_PANELS:
        title = f"{title or ''} (the first {_MOST_PANELS} of {len(shown)} panels)".strip()
        shown = shown[:_MOST_PANELS]
    for panel in shown:
        for name in (y, parameter, "pass", "row"):
            if panel.table is not None:
                column(panel.table, name, ("_n", "") if name == y else ("",))
    name = column(table, y, ("_n", ""))
    across = min(len(shown), _PANELS_A_ROW)
    down = -(-len(shown) // across)
    width = style.PAGE if across > 1 else style.COLUMN + 1.2
    with style.canvas(width, 2.5 * down + 1.0, title) as figure:
        grid = figure.subplots(down, across, sharex=True, sharey=True, squeeze=False).ravel()
        origin = _origin([panel.table for panel in shown if panel.table is not None], name)
        for number, (axes, panel) in enumerate(zip(grid, shown, strict=False)):
            handles = _draw(axes, panel, name, parameter, least, origin)
            if number % across == 0:
                axes.set_ylabel(described(table, name, 30))
            if number + across >= len(shown):
                axes.set_xlabel(described(table, parameter, 66 // across))
                axes.tick_params(labelbottom=True)
            _below(axes, handles)
        for axes in grid[len(shown) :]:
            axes.set_visible(False)
        if origin is not None:
            style.angle_ticks(grid[0], "y")
        drawn = {str(line.get_color()) for axes in grid for line in axes.lines}
        figure.legend(handles=_key(shown, table, parameter, drawn), loc="outside lower center", ncols=3)
    return figure


def _split(table: pd.DataFrame, panels: str | None, beside: bool) -> list[_Panel]:
    """A table's panels; with a second table, their headings describe how the parameter moves."""
    if panels is None:
        return [_Panel(_pace(table), table)]
    pace = f", {_pace(table)}" if beside else ""
    column(table, panels)
    values = sorted(table[panels].dropna().unique())
    parts = [
        (written(table, panels, value) + pace, rows_where(table, table[panels] == value)) for value in values
    ]
    return [_Panel(heading, part) for heading, part in parts] or [_Panel("", table)]


def _second(table: pd.DataFrame, other: str | pd.DataFrame | None, panels: str | None) -> list[_Panel]:
    if other is None:
        return []
    if isinstance(other, pd.DataFrame):
        return _remarked(_split(other, panels, True), other)
    beside = Path(str(table.attrs.get("path", "."))).parent / other
    path = next((path for path in (Path(other), beside) if path.is_dir()), beside)
    try:
        found = load(path)
        return _remarked(_split(found, panels, True), found)
    except TableError:
        return [_Panel(path.name, None, f"{path.name}\nhas no table yet:\nrun its job, then\ngaitsweep plot")]


def _remarked(shown: list[_Panel], table: pd.DataFrame) -> list[_Panel]:
    """The panels of a second table, with the remarks on it in their headings."""
    told = "\n".join(remarks(table))
    return [panel._replace(heading=f"{panel.heading}\n{told}") for panel in shown] if told else shown


def _pace(table: pd.DataFrame) -> str:
    """How a table's parameter moves, in words, with its speed if the job gives it."""
    run = table.attrs.get("job", {}).get("run", {})
    unit = unit_of(table, str(run.get("parameter", "")))
    if "stair" in table.columns:
        return f"held {run['dwell']:g} s at each value" if "dwell" in run else "held at each value"
    rate = f" ({run['rate']:g} {unit}/s)".replace(" /s", "/s") if "rate" in run else ""
    return f"moved slowly{rate}"


def _origin(tables: list[pd.DataFrame], name: str) -> float | None:
    """The angle at which the circle is cut for the axis; None if the observable is no angle."""
    tables = [table for table in tables if name in table.columns]
    if not tables or not is_angle(tables[0], name):
        return None
    return cut(np.concatenate([table[name].to_numpy(float) for table in tables]))


def _draw(
    axes: Axes, panel: _Panel, name: str, parameter: str, least: float, origin: float | None
) -> list[Patch]:
    """One panel: each row's passes, and the jumps' intervals shaded; returns the jumps' legend."""
    axes.set_title(panel.heading if panel.table is not None else "")
    if panel.table is None:
        style.message(axes, panel.note)
        return []
    order = "stair" if "stair" in panel.table.columns else "crossing"
    table = panel.table.sort_values(["row", order], kind="stable")
    table = rows_where(table, sound(table, name, parameter))
    if not len(table):
        style.message(axes, "no numbers yet")
        return []
    rows = table["row"].unique()
    alpha = 1.0 if len(rows) <= _FAINT else max(0.15, _FAINT / len(rows))
    axes.margins(y=0.1)  # room for the arrows
    jumping = largest_jumps(panel.table, name, parameter, least)["row"]
    with_arrows = jumping.mode().min() if len(jumping) else rows[0]  # the first row that jumps on each pass
    for row, part in table.groupby("row", sort=True):
        passes = draw_row(axes, part, name, parameter, origin, alpha, least)
        if row == with_arrows:
            draw_arrows(axes, passes)
    found = transition_points(panel.table, name, parameter, least)
    handles = []
    for edge in found.to_dict("records"):
        colour = UP if edge["direction"] == "rising" else DOWN
        axes.axvspan(edge["low"], edge["high"], color=colour, alpha=0.18, lw=0.8, zorder=0)
        handles.append(Patch(color=colour, alpha=0.35, lw=0, label=_in_words(edge, table, parameter)))
    return handles


def _below(axes: Axes, handles: list[Patch]) -> None:
    """The jumps of a panel, in a legend below its axis."""
    if not handles:
        return
    label = axes.get_xlabel()
    depth = 18.0 + 12.0 * (label.count("\n") + 1) if label else 4.0  # points
    place = axes.transAxes + ScaledTranslation(0.0, -depth / 72, axes.figure.dpi_scale_trans)
    look: dict[str, Any] = {"title_fontsize": 7.0, "fontsize": 7.0, "borderaxespad": 0.0}
    axes.legend(
        handles=handles,
        title="jumps at",
        loc="upper center",
        bbox_to_anchor=(0.5, 0.0),
        bbox_transform=place,
        **look,
    )


def _in_words(edge: Mapping[Any, Any], table: pd.DataFrame, parameter: str) -> str:
    """A transition point in words: `f rises: 2.86 to 2.9 Hz`."""
    verb = "rises" if edge["direction"] == "rising" else "falls"
    interval = f"{edge['low']:.4g} to {edge['high']:.4g} {unit_of(table, parameter)}".rstrip()
    rows = "" if edge["of"] == 1 else f", {edge['rows']} of {edge['of']} rows"
    return f"{symbol(table, parameter)} {verb}: {interval}{rows}".replace("-", "−")


def _key(shown: list[_Panel], table: pd.DataFrame, parameter: str, drawn: set[str]) -> list[Line2D]:
    """The legend of the colours and markers that are drawn."""
    stairs = [panel.table for panel in shown if panel.table is not None and "stair" in panel.table.columns]
    handles = []
    for colour, marker, words in ((UP, "^", "rises"), (DOWN, "v", "falls")):
        if colour not in drawn:
            continue
        look: dict[str, Any] = {"color": colour, "lw": 1.0, "marker": marker if stairs else "", "ms": 4}
        handles.append(Line2D([], [], label=f"{symbol(table, parameter)} {words}", **look))
    if any("settled" in each.columns and not each["settled"].to_numpy(bool).all() for each in stairs):
        handles.append(
            Line2D([], [], ls="", marker="^", ms=4, mfc="white", color="#555555", label="hold not settled")
        )
    return handles
