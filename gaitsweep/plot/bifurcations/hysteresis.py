"""Hysteresis: a section observable while a parameter rises and falls again, its gaits named beside it."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import Annotated, Any, cast

import numpy as np
import pandas as pd
from jaxtyping import Float, Shaped
from matplotlib.axes import Axes
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.transforms import Bbox, ScaledTranslation

from gaitsweep.analysis.records import is_true
from gaitsweep.angles import unwrap_from
from gaitsweep.plot import theme
from gaitsweep.plot.arguments import Observable, Observed, Panels, TableOrName, Title
from gaitsweep.plot.bifurcations.passes import (
    DOWN,
    LINES,
    UP,
    Columns,
    Panel,
    draw_passes,
    draw_strip,
    in_column,
    irregular_parted,
    marker_look,
    order_of,
    panels_of,
    panels_of_second,
    while_moving,
)
from gaitsweep.plot.column_labels import described, least_digits, symbol, written
from gaitsweep.plot.columns import (
    MOST_PANELS,
    PlotError,
    column,
    is_compared,
    moved_parameter,
    origin_of,
    require_columns,
    rows_where,
    too_many_panels,
)
from gaitsweep.plot.figure_style import current
from gaitsweep.plot.kind import PlannedTable, Refusal, figure_kind
from gaitsweep.plot.provenance_marks import STRIP
from gaitsweep.schema.numbers import Positive, Real, Text
from gaitsweep.status import Outcome

_LEAST_SHARE = 0.02  # of all records: a gait with fewer has no name
_PLACES = 15  # records of a branch beside which room is looked for
_OFFSET = 4.0  # points: least distance of a name from its branch
_CLEARANCE = 2.0  # points: least distance of a name from other lines
_STEP = 2.0  # pixels: distance of the points by which lines are represented


def named_gaits(table: pd.DataFrame, without: Sequence[str] = ()) -> list[str]:
    """The gaits that more than a few of a table's records have, `without` some."""
    if "gait" not in table.columns:
        return []
    shares = table["gait"].astype(str).value_counts(normalize=True)
    names = [str(name) for name, share in shares.items() if share >= _LEAST_SHARE]
    return theme.ordered(name for name in names if name not in (Outcome.NO_GAIT, *without))


def name_branches(
    axes: Axes,
    at: Float[np.ndarray, " records"],
    value: Float[np.ndarray, " records"],
    gaits: Shaped[np.ndarray, " records"],
) -> list[str]:
    """Write the name of each gait beside its records; returns those for which there is no room.

    Args:
        axes: a panel with a layout and all of its lines.
        at, value: places of the records, (n,).
        gaits: the gait of each record, (n,).
    """
    ink = _ink(axes)
    boxes = [patch.get_window_extent() for patch in axes.patches if patch.get_alpha() is None]
    with_markers = (line for line in axes.lines if line.get_marker() not in (None, "None", ""))
    clearance = max([_CLEARANCE, *(0.5 * float(line.get_markersize()) + 0.5 for line in with_markers)])
    middle_first = sorted(np.linspace(0.0, 1.0, _PLACES), key=lambda share: abs(share - 0.5))
    without_room = []
    for gait in dict.fromkeys(gaits.tolist()):
        records = np.flatnonzero(gaits == gait)
        records = records[np.argsort(at[records], kind="stable")]
        for share, above in itertools.product(middle_first, (True, False)):
            record = records[round(share * (len(records) - 1))]
            point = (float(at[record]), float(value[record]))
            box = _write_name(axes, gait, point, clearance, ink, boxes, above=above)
            if box is not None:
                boxes.append(box)
                break
        else:
            without_room.append(gait)
    return without_room


def _write_name(
    axes: Axes,
    gait: str,
    point: tuple[float, float],
    clearance: float,
    ink: Float[np.ndarray, "points 2"],
    boxes: Sequence[Bbox],
    *,
    above: bool,
) -> Bbox | None:
    """Write a name above or below a point; returns its box, or None, and writes no name, without room.

    Args:
        axes: the panel.
        gait: the gait that is named.
        point: coordinates of a record of the gait.
        clearance: least distance of the name from `ink` (pixels) and `boxes`, in points.
        ink: points of all lines.
        boxes: boxes of other names and of patches.
        above: whether the name is above the point.
    """
    offset = max(_OFFSET, clearance + 1.5)
    look: dict[str, Any] = {"ha": "center", "va": "bottom" if above else "top", "color": "#333333"}
    text = axes.annotate(
        theme.named(gait),
        point,
        (0.0, offset if above else -offset),
        textcoords="offset points",
        fontsize=theme.points(7),
        **look,
    )
    box, panel = text.get_window_extent(), axes.get_window_extent()
    inside = panel.x0 <= box.x0 and box.x1 <= panel.x1 and panel.y0 <= box.y0 and box.y1 <= panel.y1
    around = box.padded(clearance * axes.figure.dpi / 72)
    over_ink = ((ink >= around.min) & (ink <= around.max)).all(axis=1).any()
    if inside and not over_ink and not any(map(around.overlaps, boxes)):
        return box
    text.remove()
    return None


def _ink(axes: Axes) -> Float[np.ndarray, "points 2"]:
    """Points (n, 2) along all lines and markers of a panel, in pixels."""
    points = [np.empty((0, 2))]
    for line in axes.lines:
        ends = line.get_transform().transform(np.asarray(line.get_xydata(), float))
        points.append(ends)
        if line.get_linestyle() != "None":
            for begin, end in itertools.pairwise(ends):
                length = float(np.hypot(*(end - begin)))
                if np.isfinite(length) and length > _STEP:
                    points.append(np.linspace(begin, end, int(length / _STEP) + 1))
    return np.concatenate(points)


_PANELS_A_ROW = 3
_JUMPS_BELOW = 0.5  # inches: height of the legend of two jumps below a panel
_LETTER = 0.035  # inches; width of a letter of a name at the right side


def _check(figure: Any, table: PlannedTable) -> Iterator[Refusal]:
    """Refuse a parameter that the run does not move, and more panels than a figure has."""
    if figure.parameter not in (None, table.run.moved):
        yield (
            ("parameter",),
            f"is {figure.parameter}, but this run moves {table.run.moved}: remove parameter.",
        )
    parameters = [quantity.name for quantity in table.model.parameters]
    groups = [
        group
        for group in table.rows.groups
        if group.length > 1 and any(is_compared(name, parameters) for name in group.names)
    ]
    names = [name for group in groups for name in group.names]
    # of a zip some points may have the same parameters, which the table shows
    count = math.prod(group.length for group in groups if len(group.names) == 1)
    if count > MOST_PANELS and set(names) != {figure.panels}:
        yield ("panels",), too_many_panels(names, count, "VALUE")


@figure_kind("ramp", "staircase", check=_check, coloured="none")
def hysteresis(
    table: pd.DataFrame,
    *,
    y: Observed,
    parameter: Annotated[Text | None, "the parameter that the run moves; it can be left out"] = None,
    panels: Panels = None,
    with_table: Annotated[
        TableOrName | None,
        "a second result directory to show beside the first, by its path or its job's name",
    ] = None,
    x: Annotated[
        Observable | None, "observable along the horizontal axis, such as speed; by default the parameter"
    ] = None,
    ticks: Annotated[
        Mapping[Text, Real], "values of y to mark at the right side, by name, such as those of a paper"
    ] = MappingProxyType({}),
    least: Annotated[
        Positive | None,
        "change of y that counts as a jump, in its unit; by default a step of a staircase that is four times "
        "as large as those beside it and changes the gait, or is a twentieth of the range of all rows, "
        "of a ramp 0.15",
    ] = None,
    title: Title = None,
) -> Figure:
    """An observable over the moving parameter, with distinct rising and falling passes and marked jumps.

    A ramp is a thin line through its crossings, solid as the parameter rises and dashed as it falls; a
    staircase has a marker at the end of each stair, open if the stair had not settled. Bars at the top mark
    the intervals of the rising pass's jumps, medians over the rows, and bars at the bottom those of the
    falling one; a legend gives them. Arrows mark where the two passes differ most. Passes that jump to and
    fro, as with an irregular gait, belong to no branch and have their own panel below. Rows that differ in a
    parameter have a panel for each of its values; of rows that differ in starts or seeds one panel shows all.
    Gaits of the table are named beside their branches, or in the legend where there is no room.

    Args:
        table: a ramp or staircase table.
        with_table: a table, or a path relative to the working directory or to the parent of the first table's
            directory.

    Raises:
        PlotError: the table lacks a column, or no parameter moves.
    """
    parameter = parameter or moved_parameter(table)
    if parameter is None:
        raise PlotError(
            "The table's job moves no parameter: hysteresis is drawn from a ramp or a staircase; "
            "for another table name the column as `parameter`."
        )
    shown = panels_of(table, panels, beside=with_table is not None)
    shown, title = theme.first_of([*shown, *panels_of_second(table, with_table, panels)], MOST_PANELS, title)
    if title == "" and len(shown) == 1:
        shown = [shown[0]._replace(heading="")]
    name = column(table, y, ("_n", ""))
    along = parameter if x is None else column(table, x, ("_n", ""))
    for number, panel in enumerate(shown):
        if panel.table is not None:
            order = order_of(panel.table)
            require_columns(panel.table, parameter, "pass", "row", name, along, order)
            shown[number] = panel._replace(table=panel.table.sort_values(["row", order], kind="stable"))
    if x is not None:
        shown = [panel._replace(table=while_moving(panel.table, parameter)) for panel in shown]
    tables = [panel.table for panel in shown if panel.table is not None]
    values = np.concatenate([of_panel[name].to_numpy(float) for of_panel in tables])
    columns = Columns(table, name, along, origin_of(table, name, values))
    parted = [irregular_parted(panel.table, name, along, least) for panel in shown]
    strips = any(len(irregular) for _, irregular in parted)
    down, across = theme.shape(len(shown), theme.PAGE, 2.0, _PANELS_A_ROW)
    # inches, of a row of panels, which are lower where a page would have no room for them
    highest, lowest = (3.5, 2.3) if strips else (2.5, 1.7)
    high = min(highest, max(lowest, theme.PAGE_HEIGHT / down))
    width = theme.PAGE if len(shown) > 1 else theme.COLUMN + 1.2
    room = theme.width_of(width) / across - 0.8
    with theme.canvas(width, high * down + 1.0, title) as figure:
        heights = (2.5, 1.0) if strips else (1.0,)
        layers = theme.stacked_panels(figure, (down, across), len(shown), heights)
        grid, below = layers[0], layers[-1]
        jumps = []
        for number, (panel, (branches, irregular)) in enumerate(zip(shown, parted, strict=True)):
            jumps.append(draw_passes(grid[number], panel, branches, columns, least))
            strip = below[number] if strips else None
            if strip is not None:
                draw_strip(strip, irregular, panel.table, columns)
                strip.set_label(STRIP)
            last = number % across == across - 1 or number == len(shown) - 1
            _mark(grid[number], strip, ticks, columns.origin, named=last)
        in_key = _single_jumps(jumps) if in_column() else {}
        broken = _label(grid, below, columns, across, ticks, [[]] if in_key else jumps, room)
        theme.grow(figure, 0.12 * broken - (_JUMPS_BELOW if in_key else 0.0))
        for axes in {grid[0], below[0]}:
            theme.value_axis(axes, angle=columns.origin is not None)
        colours = {str(line.get_color()) for axes in (*grid, *below) for line in axes.lines}
        key = _key(shown, columns, colours, in_key)
        key += _name_gaits(grid, [branches for branches, _ in parted], columns, [*ticks])
        theme.legend(figure, key, ncols=3)
    return figure


def _label(
    grid: Sequence[Axes],
    below: Sequence[Axes],
    columns: Columns,
    across: int,
    ticks: Mapping[str, float],
    jumps: Sequence[list[Patch]],
    room: float,
) -> int:
    """Label the outer axes, and write the jumps of each panel below it.

    Args:
        grid, below: the panels, and the lowest axes of each: the strip below it, or itself.
        columns: the columns along the axes.
        across: panels in a row.
        ticks: marked values of y, which the last panel of a row names at its right side.
        jumps: the jumps of each panel.
        room: width of a panel, inches.

    Returns:
        The largest number of broken lines below a panel.
    """
    broken = []
    for number, (axes, lowest) in enumerate(zip(grid, below, strict=True)):
        if number % across == 0:
            axes.set_ylabel(described(columns.table, columns.name, 30))
        else:
            axes.tick_params(labelleft=False)
            lowest.tick_params(labelleft=False)
        if number + across >= len(grid):
            last = number % across == across - 1 or number == len(grid) - 1
            of_ticks = _LETTER * max(map(len, ticks), default=0) if last else 0.0
            label = described(columns.table, columns.x, 66, named=True)  # as the legend does
            lowest.set_xlabel(theme.wrapped(label, room - of_ticks, 8.5))
            lowest.tick_params(labelbottom=True)
        broken.append(_below(lowest, jumps[number], room + 0.4))
    return max(broken)


def _name_gaits(
    grid: Sequence[Axes], tables: Sequence[pd.DataFrame | None], columns: Columns, without: Sequence[str]
) -> list[Line2D]:
    """Name the gaits of tables beside their branches; returns the legend of those without room."""
    _, name, x, origin = columns
    texts = []
    with_names = [
        (axes, table, named)
        for axes, table in zip(grid, tables, strict=True)
        if table is not None and (named := named_gaits(table, without))
    ]
    if with_names:  # room is looked for in the figure's layout
        cast(Figure, grid[0].get_figure(root=True)).draw_without_rendering()
    for axes, table, named in with_names:
        records = rows_where(table, table["gait"].isin(named))
        gaits = records["gait"].to_numpy(str)
        value = unwrap_from(records[name].to_numpy(float), origin)
        for gait in name_branches(axes, records[x].to_numpy(float), value, gaits):
            median = float(np.median(value[gaits == gait]))
            middle = written(table, name, median, least_digits(table, name))
            texts.append(f"{theme.named(gait)} about {middle}")
    return [Line2D([], [], ls="", label=text) for text in dict.fromkeys(texts)]


def _mark(
    axes: Axes, strip: Axes | None, ticks: Mapping[str, float], origin: float | None, *, named: bool
) -> None:
    """Draw thin lines at values of y, named at the right side; in the strip if nearer to its data."""
    values = unwrap_from(np.array(list(ticks.values()), float), origin)
    names = np.array(list(ticks), object)
    below = np.zeros(len(values), bool)
    if strip is not None:
        below = _distance(strip, values) < 0.5 * _distance(axes, values)
    for panel, marked in ((axes, ~below), (strip, below)):
        if panel is None or not marked.any():
            continue
        for value in values[marked]:
            panel.axhline(float(value), color="#999999", lw=0.6, ls=(0, (1, 2)), zorder=0.5)
        if named:
            right = panel.secondary_yaxis("right")
            right.set_yticks(values[marked], names[marked].tolist())
            right.tick_params(length=0, labelsize=7.0, colors="#555555")


def _distance(axes: Axes, values: Float[np.ndarray, " values"]) -> Float[np.ndarray, " values"]:
    """Distances of values from the bulk of the data of axes, (n,)."""
    data = np.concatenate([[], *(np.asarray(line.get_ydata(), float) for line in axes.lines)])
    data = data[np.isfinite(data)]
    if not len(data):
        return np.full(len(values), np.inf)
    low, high = np.quantile(data, (0.02, 0.98))  # a row that falls may leave single points far away
    return np.maximum(np.maximum(low - values, values - high), 0.0)


def _below(axes: Axes, handles: list[Patch], room: float) -> int:
    """Write the jumps of a panel below its axis, in lines of `room` inches; returns those broken."""
    if not handles:
        return 0
    for handle in handles:
        handle.set_label(theme.wrapped(str(handle.get_label()), room, 7.0))
    label = axes.get_xlabel()
    depth = 18.0 + 12.0 * (label.count("\n") + 1) if label else 4.0  # points
    below_axis = axes.transAxes + ScaledTranslation(0.0, -depth / 72, axes.figure.dpi_scale_trans)
    look: dict[str, Any] = {"title_fontsize": 7.0, "fontsize": theme.points(7), "borderaxespad": 0.0}
    look |= {"loc": "upper center", "bbox_to_anchor": (0.5, 0.0), "bbox_transform": below_axis}
    look["title"] = None if current().caption is False else "jumps at (bars at the edges)"
    axes.legend(handles=handles, **look)
    return sum(str(handle.get_label()).count("\n") for handle in handles)


def _single_jumps(jumps: Sequence[list[Patch]]) -> dict[str, str]:
    """The interval of the only jump of each direction, by its colour; empty for several panels or jumps."""
    of_panel = jumps[0] if len(jumps) == 1 else []
    intervals = {to_hex(jump.get_facecolor()).upper(): str(jump.get_label()) for jump in of_panel}
    if len(intervals) < len(of_panel):
        return {}
    return {colour: words.rpartition(": ")[2] for colour, words in intervals.items()}


def _key(shown: list[Panel], columns: Columns, colours: set[str], jumps: Mapping[str, str]) -> list[Line2D]:
    """The legend of the colours and markers that are drawn, with the interval of the jump of each colour."""
    parameter = symbol(columns.table, columns.x)
    stairs = [panel.table for panel in shown if panel.table is not None and "stair" in panel.table.columns]
    handles = []
    for colour, marker, words in ((UP, "^", "rises →"), (DOWN, "v", "falls ←")):
        if colour not in colours:
            continue
        look: dict[str, Any] = {"color": colour, "ls": LINES[colour], "marker": marker if stairs else ""}
        jump = f", jumps at {jumps[colour]}" if colour in jumps else ""
        handles.append(Line2D([], [], label=f"{parameter} {words}{jump}", **marker_look(), **look))
    if any("settled" in stair.columns and not is_true(stair, "settled").all() for stair in stairs):
        look = {"ls": "", "marker": "^", "mfc": "white", "color": "#555555"}
        handles.append(Line2D([], [], label="hold not settled", **marker_look(), **look))
    return handles
