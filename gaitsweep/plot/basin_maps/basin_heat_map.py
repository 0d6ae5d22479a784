"""Basins over two swept quantities; recovery from pushes, and the smallest shock with another outcome."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Annotated, Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from gaitsweep.analysis.basins.measures import basins, least_fatal_push, require_one_unit
from gaitsweep.analysis.records import axes_of, in_order
from gaitsweep.column_meanings import COLUMNS
from gaitsweep.engine.pushed_model import PREFIX
from gaitsweep.plot import theme
from gaitsweep.plot.arguments import (
    TEXT_COLUMNS,
    AlongAxis,
    Column,
    Horizontal,
    Hue,
    Panels,
    Shares,
    Title,
    Vertical,
)
from gaitsweep.plot.basin_maps.cells import cell_grid, check_cells, check_hue, colour_cells, hatch_cells
from gaitsweep.plot.column_labels import axis_label, described, unit_of, written
from gaitsweep.plot.columns import (
    HATCHED,
    PlotError,
    by_value,
    is_turn,
    log_axes,
    outcome,
    parameters_of,
    require_columns,
    rows_where,
)
from gaitsweep.plot.figure_style import current
from gaitsweep.plot.kind import PlannedTable, Refusal, figure_kind
from gaitsweep.status import Outcome, Status

_PANELS_A_ROW = 4
_LEAST_IN_ROWS = 1.6  # inches: least width of a panel with its labels, of panels in several rows
_LEAST_IN_A_ROW = 1.0  # inches: of panels that are all beside each other, of which three fit a column
_NARROW_PAD = 0.02  # inches: between narrow panels
_MOST_PANELS = 40
_LETTERS = 15  # of a label, an inch
_NAMES_A_LINE = 3  # of a legend without shares
_Looks = tuple[dict[str, str], ...]  # colour, marker and hatch of each outcome, the same in all panels


def _check_basin(figure: Any, table: PlannedTable) -> Iterator[Refusal]:
    """Refuse several rows in one cell, and a hue that inferred rows do not have."""
    yield from check_hue(figure, table)
    yield from check_cells(figure, table)


@figure_kind("settle", "fixed_time", check=_check_basin)
def basin(
    table: pd.DataFrame,
    *,
    x: Horizontal,
    y: Vertical,
    hue: Hue = "gait",
    panels: Panels = None,
    shares: Shares = True,
    title: Title = None,
) -> Figure:
    """Cells coloured by the outcome of each start, with the share of each outcome in each panel.

    Starts on a grid are drawn as cells; others as points. A numeric `hue` is drawn on a colour scale. Rows
    that failed or did not settle are hatched grey; cells without a row yet are left white. Of one panel the
    shares are in the legend, of several above each. Where no gait has a name, the legend proposes a `hue`.

    Args:
        table: a settle table, complete or partial.

    Raises:
        PlotError: the table lacks a column, or a cell has several rows.
    """
    require_columns(table, x, y, hue, panels)
    parts, title = theme.first_of(by_value(table, panels), _MOST_PANELS, title)
    numeric = pd.api.types.is_numeric_dtype(table[hue])

    rows, columns, width, side = _layout(len(parts), numeric=numeric)
    shown = outcome(table, hue)
    # a row that has not settled may be named twice: by the hue, and by its outcome
    names = list(dict.fromkeys(theme.ordered(in_order(table, hue, shown))))
    key = [name for name in names if not numeric or name in HATCHED]
    headings = [
        _heading(written(table, panels, value), _shares(shown.loc[part.index], key if shares else []), side)
        for value, part in parts
        if panels is not None and value is not None  # else one panel has all rows
    ]
    lines = max((text.count("\n") for text in headings), default=0)
    # without shares the legend has no caption, and more names beside each other
    legend = 0.75 if shares else 0.3 + 0.15 * math.ceil(len(key) / _NAMES_A_LINE)
    height = rows * (side + 0.35 + 0.14 * lines) + (0.35 if numeric else legend)
    with theme.canvas(width, height, title) as figure:
        if not len(table):
            panel = figure.add_subplot()
            theme.message(panel, "no rows yet")
            _label_axes(table, [panel], x, y, 1, int(side * _LETTERS))
            return figure
        if columns * _LEAST_IN_ROWS > theme.width_of(width) and (engine := figure.get_layout_engine()):
            engine.set(w_pad=_NARROW_PAD, wspace=0.0)  # pyright: ignore[reportCallIssue]
        grid = theme.panels(figure, (rows, columns), len(parts), sharex=True, sharey=True)
        # values of a numeric hue have the colours of its scale
        looks = theme.colours(key), theme.markers(key), theme.hatches(key)
        scale = None
        if numeric:
            scale = theme.ColourScale(table.loc[~shown.isin(HATCHED), hue].to_numpy(float))
        drawn = [
            _cells(axes, part, (x, y, hue), shown.loc[part.index], scale, looks, table)
            for axes, (_, part) in zip(grid, parts, strict=True)
        ]
        for axes, text in zip(grid, headings, strict=False):  # without panels there are none
            axes.set_title(text, fontsize=theme.points(7.5))
        _label_axes(table, grid, x, y, columns, int(side * _LETTERS))
        if scale is not None and any(drawn):
            scale.draw_bar(figure, figure.axes, described(table, hue, 36), 0.8)
        if key:
            caption = _caption(table, x, y, above_panels=bool(headings)) if shares else ""
            if hue == "gait" and (advice := _hue_advice(table, names)):
                caption = advice
            _legend(figure, key, shown if shares and not headings else None, looks, caption, table)
        if is_turn(table, x) and is_turn(table, y):
            _square_panels(figure, grid, rows)
    return figure


def _layout(count: int, *, numeric: bool) -> tuple[int, int, float, float]:
    """The rows and columns of `count` panels, the figure's width and the side of a square panel, inches.

    With a `numeric` hue there is a colour bar beside them.
    """

    def width_of(columns: int) -> float:
        return theme.COLUMN + 0.4 if columns == 1 else min(theme.PAGE, 2.4 * columns)

    def side_of(columns: int) -> float:
        return (theme.width_of(width_of(columns)) - (1.3 if numeric else 0.6)) / columns

    # a square panel with headings of one or two lines
    high: dict[str, Any] = {"height_of": lambda columns: side_of(columns) + 0.5, "narrowest": 1.0}
    most_in_a_row = min(_PANELS_A_ROW, int(theme.width_of(theme.PAGE) / _LEAST_IN_A_ROW))
    least = _LEAST_IN_A_ROW if count <= most_in_a_row else _LEAST_IN_ROWS
    rows, columns = theme.shape(count, theme.PAGE, least, _PANELS_A_ROW, **high)
    return rows, columns, width_of(columns), side_of(columns)


def _square_panels(figure: Figure, grid: Sequence[Axes], rows: int) -> None:
    """Make panels square by the figure's height, unless its style has one, which the panels then fill.

    Of panels with an equal aspect the layout would misjudge the room that their labels need.
    """
    from gaitsweep.plot.canvas import OnePanel  # which loads Matplotlib

    if isinstance(figure, OnePanel):
        figure.panel.set_aspect("equal")
        return
    for _ in range(2):  # the layout of one drawing is nearly that of the next
        figure.draw_without_rendering()
        cells = [axes.get_position() for axes in grid]
        width, height = figure.get_size_inches()
        theme.grow(figure, rows * min(cell.width * width - cell.height * height for cell in cells))


def _caption(table: pd.DataFrame, x: str, y: str, *, above_panels: bool) -> str:
    """The line above the legend: shares of pushes, of starts, or of rows where both axes are parameters."""
    rows = "rows" if {x, y} <= parameters_of(table) else "starts"
    counted = f"share of {'pushes' if 'recovery' in table.columns else rows}"
    return f"{counted} above each panel" if above_panels else counted


def _hue_advice(table: pd.DataFrame, names: Sequence[str]) -> str:
    """The proposal of a hue where no gait has a name; empty otherwise."""
    ends = [name for name in map(str, table) if name.endswith("_end") and name not in COLUMNS]
    if ends and set(names) - set(HATCHED) == {"none"}:
        return f"no gait has a name; {ends[0]} as hue tells them apart"
    return ""


def _inferred_share(table: pd.DataFrame) -> float:
    """The share of a table's rows that were inferred from their neighbours; 0 if the style has no marks."""
    if current().marks is False or "status" not in table.columns or not len(table):
        return 0.0
    return float(np.mean(table["status"].astype(str).to_numpy(str) == Status.inferred.name))


def _heading(value: str, shares: Sequence[str], width: float) -> str:
    """The heading of a panel: its value, and the shares of its outcomes in lines of `width` inches."""
    # no break of a line between a name and its share
    above = theme.wrapped(", ".join(text.replace(" ", "\u00a0") for text in shares), width, 7.5)
    return f"{value}\n{above}".replace(",\n", "\n").strip()


def _shares(shown: pd.Series, names: Sequence[str], between: str = " ") -> list[str]:
    """The outcomes that occur, each with its share of the rows: `direct 46 %`."""
    shares = {name: float(np.mean(shown.to_numpy() == name)) for name in names if (shown == name).any()}
    return [f"{theme.named(name)}{between}{theme.percent(share)} %" for name, share in shares.items()]


def _label_axes(
    table: pd.DataFrame, grid: Sequence[Axes], x: str, y: str, columns: int, letters: int
) -> None:
    """Write labels, in lines of `letters`, along the outer edges, and ticks of angles in multiples of pi.

    Of several panels, and in a column of a paper, the label of a column with a symbol is the symbol and the
    unit.
    """
    labels = {name: axis_label(table, name) for name in (x, y)}
    short = len(grid) > 1 or theme.width_of(np.inf) <= theme.COLUMN
    for name in labels:
        if not short or "$" not in labels[name]:
            labels[name] = described(table, name, letters)
    for number, axes in enumerate(grid):
        below = number + columns >= len(grid)
        axes.set_xlabel(labels[x] if below else "")
        axes.set_ylabel(labels[y] if number % columns == 0 else "")
        if is_turn(table, x):
            theme.angle_axis(axes, "x")
        if is_turn(table, y):
            theme.angle_axis(axes, "y")


def _cells(
    axes: Axes,
    part: pd.DataFrame,
    names_of_columns: tuple[str, str, str],
    shown: pd.Series,
    scale: theme.ColourScale | None,
    looks: _Looks,
    table: pd.DataFrame,
) -> bool:
    """Draw one panel of a table; returns whether it has rows.

    Args:
        axes: the panel.
        part: its rows.
        names_of_columns: x, y and hue.
        shown: the outcome of each row of the part.
        scale: that of a numeric hue; None for another.
        looks: colour, marker and hatch of each outcome.
        table: the rows of all panels.
    """
    x, y, hue = names_of_columns
    part = rows_where(part, part[x].notna() & part[y].notna())
    if not len(part):
        theme.message(axes, "no rows yet")
        return False
    log_axes(axes, part, x=x, y=y)
    shown = shown.loc[part.index]
    colour, marker, hatch = looks
    names = [name for name in shown.unique() if scale is None or name in HATCHED]
    values, on_scale = None, {}
    if scale is not None:
        values = scale.on_scale(part[hue].astype(float).where(~shown.isin(HATCHED)).to_numpy(float))
        on_scale: dict[str, Any] = {"cmap": scale.cmap, "norm": scale.norm}
    grid = cell_grid(part, x, y, table)
    if grid is None:
        size = float(np.clip(4e3 / len(part), 2.0, 30.0))
        for name in names:
            starts = rows_where(part, shown == name)
            axes.scatter(starts[x], starts[y], c=colour[name], marker=marker[name], s=size, linewidths=0.6)
        if scale is not None:
            axes.scatter(part[x], part[y], c=values, s=size, **on_scale)
        return True
    if part.duplicated([x, y]).any():
        raise PlotError(_why_repeated(part, x, y))
    if scale is not None:
        axes.pcolormesh(*grid.edges, grid.placed(part, values), rasterized=True, **on_scale)
    marked = rows_where(part, shown.isin(names))
    if len(marked):
        colour_cells(axes, grid, marked, [colour[name] for name in shown.loc[marked.index]])
    for name in names:
        if hatch[name]:
            hatch_cells(axes, grid, part, shown == name, hatch[name], theme.line_on(colour[name]))
    return True


def _why_repeated(part: pd.DataFrame, x: str, y: str) -> str:
    """The sentence about a panel's cells with several rows: the quantities that vary too, if any do."""
    begin = f"Several rows have the same {x} and {y}"
    others = [name for name in axes_of(part) if name not in (x, y) and len(part[name].unique()) > 1]
    if not others and axes_of(part):
        return f"{begin}: the table has the same start more than once, as after joining a table with itself."
    varying = " and ".join(others) or "another quantity"
    verb = "vary" if len(others) > 1 else "varies"
    one = others[0] if others else "its column"
    value = part[others[0]].iloc[0] if others else "VALUE"
    return (
        f"{begin}, since {varying} {verb} too. Name {one} as `panels`, or keep one of its values: "
        f'table[table["{one if others else "NAME"}"] == {value}].'
    )


def _legend(
    figure: Figure,
    names: list[str],
    shown: pd.Series | None,
    looks: _Looks,
    caption: str,
    table: pd.DataFrame,
) -> None:
    """Draw the legend: each outcome, with its share of `shown` if given, below a caption."""
    colour, _, hatch = looks
    texts = [theme.named(name) for name in names] if shown is None else _shares(shown, names, "  ")
    handles = [
        Patch(label=text, **theme.hatched(colour[name], hatch[name]))
        for name, text in zip(names, texts, strict=True)
    ]
    columns = min(len(handles), 2 if shown is not None else _NAMES_A_LINE)
    inferred = _inferred_share(table)
    remark = f"({theme.percent(inferred)} % of cells inferred from their neighbours)" if inferred else ""
    title = f"{caption} {remark}".strip()
    theme.legend(figure, handles, ncols=columns, title=title, in_cell=True)


@figure_kind("perturb", check=check_cells)
def recovery(
    table: pd.DataFrame,
    *,
    x: Horizontal,
    y: Vertical,
    panels: Panels = None,
    shares: Shares = True,
    title: Title = None,
) -> Figure:
    """Cells coloured by whether a row recovers from its push, with the share of each outcome.

    A row that settles in another gait has the colour of that gait, if the gait has a name. Where both axes
    are amounts of one unit, a star marks the least push after which the gait is lost.

    Args:
        table: a table of pushed rows, complete or partial.

    Raises:
        PlotError: the table lacks a column, or a cell has several rows.
    """
    require_columns(table, x, y, panels, "recovery")
    dtype = table["recovery"].dtype
    names = table["recovery"].astype(object)
    if {"gait", "gait_before"} <= set(table.columns):
        gait, before = (table[name].astype(object) for name in ("gait", "gait_before"))
        in_other_gait = (names == "elsewhere") & gait.notna() & (gait != before) & (gait != Outcome.NO_GAIT)
        names = names.where(~in_other_gait, gait)
    categories = list(map(str, dtype.categories)) if isinstance(dtype, pd.CategoricalDtype) else []
    order = [*categories, *sorted(set(names.dropna()) - set(categories))]
    shown = table.assign(recovery=pd.Categorical(names, order), outcome=np.asarray(names, object))
    # the statuses of the rows are in the names already
    shown.attrs = {**table.attrs, "outcome_of": "recovery"}
    figure = basin(shown, x=x, y=y, hue="recovery", panels=panels, shares=shares, title=title)
    are_pushes = x.startswith(PREFIX) and y.startswith(PREFIX)
    if len(table) and are_pushes and unit_of(table, x) == unit_of(table, y) != "":
        _mark_least(figure, table, x, y, panels)
    return figure


def _mark_least(figure: Figure, table: pd.DataFrame, x: str, y: str, panels: str | None) -> None:
    """Draw a star at the least fatal push of each panel, and a line to it from no push."""
    least = least_fatal_push(table, [x, y], panels or ())
    for axes, (value, _) in zip(figure.axes, by_value(table, panels), strict=False):
        of_panel = least if value is None else rows_where(least, least[panels] == value)
        for across, up in of_panel[[x, y]].to_numpy(float):
            axes.plot([0.0, across], [0.0, up], color="black", lw=0.8, zorder=4)
            look: dict[str, Any] = {"marker": "*", "color": "white", "mec": "black", "ms": 9.0, "zorder": 5}
            axes.plot([across], [up], **look)


def _check(figure: Any, table: PlannedTable) -> Iterator[Refusal]:
    """Refuse axes of different units, between which there is no distance."""
    units = {column: table.unit(column) for column in (figure.x, figure.y)}
    if not TEXT_COLUMNS & set(units) and len(set(units.values())) > 1:
        named = " and ".join(f"{column} in {unit or '1'}" for column, unit in units.items())
        yield ("y",), f"is {figure.y}, but a shock is a distance and needs equal units: {named}."
    else:
        yield from _check_basin(figure, table)


@figure_kind("settle", "fixed_time", check=_check, coloured="none")
def shock(
    table: pd.DataFrame,
    *,
    x: Horizontal,
    y: Annotated[AlongAxis, "column along the vertical axis, in the unit of x"],
    hue: Annotated[Column, "column of the outcomes of starts"] = "gait",
    panels: Panels = None,
    title: Title = None,
) -> Figure:
    """Cells coloured by their distance, along x and y, to the nearest start with another outcome.

    Args:
        table: a settle table, refined or not, complete or partial.

    Raises:
        PlotError: the table lacks a column, a cell has several rows, or x and y have different units.
    """
    require_columns(table, x, y, hue, panels)
    require_one_unit(table, [x, y])
    if not len(table):
        return basin(table.assign(shock=np.nan), x=x, y=y, hue="shock", panels=panels, title=title)
    measured = basins(table, [x, y], label=hue, by=panels or ()).rows
    measured.loc[~np.isfinite(measured["shock"].to_numpy(float)), "shock"] = np.nan
    quantity = {"unit": unit_of(table, x), "symbol": r"\mathrm{smallest\ shock}", "circular": False}
    measured.attrs = {**table.attrs, "quantities": {**table.attrs.get("quantities", {}), "shock": quantity}}
    # failed starts have a shock too: the distance to one that does not fail
    measured["status"] = Status.settled.name
    return basin(measured, x=x, y=y, hue="shock", panels=panels, title=title)
