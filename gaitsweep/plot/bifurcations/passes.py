"""The panels of a hysteresis figure, and the passes in them: rise and fall, with arrows and bars at jumps."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.patches import FancyArrowPatch, Patch
from matplotlib.transforms import ScaledTranslation

from gaitsweep.analysis.records import is_true, sound
from gaitsweep.analysis.transitions.jumps import (
    LEAST_JUMP,
    STEEPER,
    irregular_passes,
    jump_intervals,
    large_change,
    largest_jumps,
    where_it_moves,
)
from gaitsweep.angles import unwrap_from
from gaitsweep.plot import theme
from gaitsweep.plot.column_labels import symbol, unit_of, written
from gaitsweep.plot.columns import (
    MOST_PANELS,
    PlotError,
    column,
    rows_where,
    too_many_panels,
    varying_parameters,
)
from gaitsweep.plot.provenance_marks import remarks
from gaitsweep.table import TableError, load

UP, DOWN = "#E69F00", "#0072B2"  # distinct for colour-blind readers, and in lightness
LINES: dict[str, Any] = {UP: "-", DOWN: (0, (4, 2))}
_MARKER: dict[str, Any] = {"ms": 5.0, "mew": 0.9}  # points
_SMALL_MARKER: dict[str, Any] = {"ms": 3.4, "mew": 0.7}  # points: just large enough to be seen as hollow
_GRID = 201  # values of the parameter at which two passes are compared
_MOST_NAMED = 5  # jumps of one direction in the legend
_FAINT = 4  # rows: more are drawn fainter
# The colour of the intervals in which rows jump, and the ends of their bars as shares of the panel's height.
_JUMPS = {"rising": (UP, 0.97, 1.0), "falling": (DOWN, 0.0, 0.03)}


class Panel(NamedTuple):
    """A panel of the figure: its heading, its table, and a note in place of a missing table."""

    heading: str
    table: pd.DataFrame | None  # None if the table does not exist yet; the heading names it
    note: str = ""


class Columns(NamedTuple):
    """The columns along the axes that all panels share.

    `table` is the first table; `name` and `x` are along axis y and axis x; `origin` is the angle
    (rad) at which axis y cuts the circle, None if it is no angle.
    """

    table: pd.DataFrame
    name: str
    x: str
    origin: float | None


def in_column() -> bool:
    """Whether the style asks for the width of a column of a paper, or less."""
    return theme.width_of(math.inf) <= theme.COLUMN


def marker_look() -> dict[str, Any]:
    """The size and edge of markers, smaller in a column of a paper, where they would be a band."""
    return _SMALL_MARKER if in_column() else _MARKER


def panels_of(table: pd.DataFrame, panels: str | None, *, beside: bool) -> list[Panel]:
    """A table's panels: one for each value of a column, and of the parameters that differ between rows.

    With a second table, their headings describe how the parameter moves.

    Raises:
        PlotError: the table lacks the column, or its parameters have too many combinations.
    """
    if panels is not None:
        column(table, panels)
    parameters = varying_parameters(table)
    names = [*([] if panels is None else [panels]), *(name for name in parameters if name != panels)]
    if not names:
        return [Panel(_pace(table), table)]
    pace = f", {_pace(table)}" if beside else ""
    combinations = table.drop_duplicates(names).dropna(subset=names).sort_values(names)
    values = [{name: record[name] for name in names} for record in combinations.to_dict("records")]
    if len(values) > MOST_PANELS and names != [panels]:
        raise PlotError(too_many_panels(names, len(values), values[-1][names[-1]]))
    several = []
    for of_panel in values:
        of_values = (table[names] == pd.Series(of_panel)).all(axis=1)
        heading = ", ".join(written(table, name, value) for name, value in of_panel.items())
        several.append(Panel(heading + pace, rows_where(table, of_values)))
    return several or [Panel("", table)]


def panels_of_second(
    table: pd.DataFrame, other: str | pd.DataFrame | None, panels: str | None
) -> list[Panel]:
    """The panels of a second table, or of its path relative to `table`, with remarks in their headings."""
    if other is None:
        return []
    if not isinstance(other, pd.DataFrame):
        path = Path(other)
        if not path.is_dir():  # beside the first one
            path = Path(str(table.attrs.get("path", "."))).parent / other
        try:
            other = load(path)
        except TableError as error:
            text = f"{path.name} has no table yet: run its job, then gaitsweep plot."
            return [Panel(path.name, None, str(error) if path.exists() else text)]
    notes = "".join(f"\n{note}" for note in remarks(other))
    return [panel._replace(heading=panel.heading + notes) for panel in panels_of(other, panels, beside=True)]


def _pace(table: pd.DataFrame) -> str:
    """Describe how a table's parameter moves, with its speed if the job gives it."""
    run = table.attrs.get("job", {}).get("run", {})
    unit = unit_of(table, str(run.get("parameter", "")))
    if "stair" in table.columns:
        return f"held {run['dwell']:g} s at each value" if run.get("dwell") else "held at each value"
    rate = f" ({run['rate']:g} {unit}/s)".replace(" /s", "/s") if run.get("rate") else ""
    return f"moved slowly{rate}"


def order_of(table: pd.DataFrame) -> str:
    """The column in whose order the records of a row follow each other."""
    return "stair" if "stair" in table.columns else "crossing"


def while_moving(table: pd.DataFrame | None, parameter: str) -> pd.DataFrame | None:
    """A table in order without the records of a ramp before its parameter moves."""
    if table is None or "stair" in table.columns:
        return table
    first = table.groupby("row")[parameter].transform(lambda values: where_it_moves(values.to_numpy(float)))
    return rows_where(table, table.groupby("row").cumcount() >= first)


def irregular_parted(
    table: pd.DataFrame | None, name: str, parameter: str, least: float | None
) -> tuple[pd.DataFrame | None, pd.DataFrame]:
    """The valid records on branches, and those of irregular passes, of a table in order."""
    if table is None:
        return None, pd.DataFrame()
    keys = pd.MultiIndex.from_arrays([table["row"], table["pass"]])
    irregular = keys.isin(pd.MultiIndex.from_frame(irregular_passes(table, name, parameter, least)))
    is_sound = sound(table, name, parameter)
    return rows_where(table, is_sound & ~irregular), rows_where(table, is_sound & irregular)


class Pass(NamedTuple):
    """A drawn pass: the parameter and the observable, (n,) each, and its colour."""

    at: Float[np.ndarray, " records"]
    value: Float[np.ndarray, " records"]
    colour: str


def draw_passes(
    axes: Axes, panel: Panel, branches: pd.DataFrame | None, columns: Columns, least: float | None
) -> list[Patch]:
    """Draw a panel: each row's passes on branches, and bars at jumps.

    Args:
        axes: its axes.
        panel: its heading and its table, or the reason why there is none.
        branches: the valid records of the table that are on branches, in order.
        columns: the columns along the axes.
        least: change of y that counts as a jump, in its unit; by default as for `jump_intervals`.

    Returns:
        The legend of the jumps.
    """
    _, name, parameter, origin = columns
    axes.set_title(panel.heading if panel.table is not None else "")
    if panel.table is None or branches is None:
        theme.message(axes, panel.note)
        return []
    if not len(branches):
        theme.message(axes, _why_empty(panel.table, name))
        return []
    rows = branches["row"].unique()
    alpha = 1.0 if len(rows) <= _FAINT else max(0.15, _FAINT / len(rows))
    axes.margins(y=0.1)  # room for the arrows
    # the least change that parts two holds; half of it has arrows
    size = least or large_change(panel.table, name, parameter) or LEAST_JUMP
    jumping = largest_jumps(panel.table, name, parameter, size)["row"]
    with_arrows = jumping.mode().min() if len(jumping) else rows[0]  # the first row that jumps on each pass
    for row, records in branches.groupby("row", sort=True):
        passes = _draw_row(axes, records, name, parameter, origin, alpha, size)
        if row == with_arrows:
            _draw_arrows(axes, passes, size)
    return _draw_jumps(axes, jump_intervals(panel.table, name, parameter, least), branches, parameter)


def _why_empty(table: pd.DataFrame, name: str) -> str:
    """The reason for a panel without a pass."""
    if not len(table):
        return "The run has stored no record yet."
    if not np.isfinite(table[name].to_numpy(float)).any():
        return f"No record has a value of {symbol(table, name)}."
    return "No pass follows a branch: all rows fell, or jump to and fro."


def _draw_jumps(axes: Axes, edges: pd.DataFrame, table: pd.DataFrame, parameter: str) -> list[Patch]:
    """Draw bars at the intervals of the jumps, and a tint below the points; returns their legend."""
    handles: dict[str, list[Patch]] = {}
    for edge in edges.to_dict("records"):
        colour, *ends = _JUMPS[edge["direction"]]
        axes.axvspan(edge["low"], edge["high"], zorder=0, color=colour, alpha=0.1, lw=0)
        axes.axvspan(edge["low"], edge["high"], *ends, color=colour, lw=0)
        words = _jump_words(edge, table, parameter)
        of_direction = handles.setdefault(edge["direction"], [])
        # passes over the same range jump at the same place
        if words not in (patch.get_label() for patch in of_direction):
            of_direction.append(Patch(label=words, color=colour, lw=0))
    for of_direction in handles.values():
        unnamed = of_direction[_MOST_NAMED - 1 :]
        if len(unnamed) > 1:
            others = Patch(label=f"and {len(unnamed)} more", color=unnamed[0].get_facecolor())
            of_direction[_MOST_NAMED - 1 :] = [others]
    return [handle for of_direction in handles.values() for handle in of_direction]


def _jump_words(edge: Mapping[Any, Any], table: pd.DataFrame, parameter: str) -> str:
    """Format the interval of a jump: `f rises: 2.86 to 2.9 Hz`."""
    verb = "rises" if edge["direction"] == "rising" else "falls"
    interval = f"{edge['low']:.4g} to {edge['high']:.4g} {unit_of(table, parameter)}".rstrip()
    rows = "" if edge["of"] == 1 else f", {edge['rows']} of {edge['of']} rows"
    return f"{symbol(table, parameter)} {verb}: {interval}{rows}".replace("-", "−")


def draw_strip(axes: Axes, irregular: pd.DataFrame, table: pd.DataFrame | None, columns: Columns) -> None:
    """Draw the valid records of irregular passes as points."""
    if table is None or not len(irregular):
        theme.message(axes, "Each pass follows a branch.")
        return
    _, name, x, origin = columns
    size = float(np.clip(60.0 / np.sqrt(len(irregular)), 0.8, 3.0))
    for number, of_pass in irregular.groupby("pass", sort=True):
        value = unwrap_from(of_pass[name].to_numpy(float), origin)
        colour = _colour_of(of_pass, x, int(str(number)))
        axes.plot(of_pass[x].to_numpy(float), value, ".", ms=size, color=colour, rasterized=True)
    axes.margins(y=0.1)
    rows = f"{irregular['row'].nunique()} of {table['row'].nunique()} rows"
    axes.set_title(f"irregular, on no branch: {rows}", loc="left", fontsize=theme.points(7), pad=2.0)


def _colour_of(records: pd.DataFrame, x: str, number: int) -> str:
    """The colour of a pass, by whether x rises along most of its rows; else by its number."""
    first, last = (records.groupby("row")[x].nth(end).to_numpy(float) for end in (0, -1))
    return _direction(float(np.median(last - first)), number)


def _direction(change: float, number: int) -> str:
    """The colour of a pass with this change of x; by its number where x does not change."""
    rises = change > 0.0 if change else number % 2 == 0
    return UP if rises else DOWN


def _draw_row(
    axes: Axes,
    records: pd.DataFrame,
    name: str,
    parameter: str,
    origin: float | None,
    alpha: float,
    least: float,
) -> list[Pass]:
    """Draw one row: each pass as a line (of a ramp) or markers (of a staircase).

    Lines are interrupted at missing records, where an angle wraps, and, between stairs, at jumps.

    Args:
        axes: the panel.
        records: the row's records in their order.
        name, parameter: columns along axis y and axis x.
        origin: the angle (rad) at which axis y cuts the circle; None if y is no angle.
        alpha: opacity of lines and markers, from 0 to 1.
        least: change of y that counts as a jump, in its unit.

    Returns:
        The passes.
    """
    stairs = "stair" in records.columns
    if not stairs:
        records = records.iloc[where_it_moves(records[parameter].to_numpy(float)) :]
    at = records[parameter].to_numpy(float)
    value = unwrap_from(records[name].to_numpy(float), origin)
    pass_numbers = records["pass"].to_numpy(int)
    order = records[order_of(records)].to_numpy(int)
    settled = np.ones(len(records), bool)
    if "settled" in records.columns:
        settled = is_true(records, "settled")
    passes = []
    for number in np.unique(pass_numbers):
        of_pass = np.flatnonzero(pass_numbers == number)
        before = of_pass[0] - 1
        turning = before >= 0 and pass_numbers[before] == number - 1  # False after a pass that is not drawn
        line = np.arange(before if turning else of_pass[0], of_pass[-1] + 1)
        colour = _direction(float(at[line[-1]] - at[line[0]]), int(number))
        marker = "^" if colour == UP else "v"
        passes.append(Pass(at[line], value[line], colour))
        change = np.abs(np.diff(value[line]))
        parted = np.diff(order[line]) > 1
        if origin is not None:
            parted |= change > np.pi
        if stairs and len(change):
            parted |= change >= max(least, STEEPER * float(np.quantile(change, 0.25)))
        pieces = theme.interrupted(parted, at[line], value[line])
        axes.plot(*pieces, color=colour, ls=LINES[colour], lw=0.8, alpha=alpha)
        if stairs:
            look: dict[str, Any] = {"ls": "", "marker": marker, "alpha": alpha, "color": colour}
            look |= marker_look()
            closed, hollow = of_pass[settled[of_pass]], of_pass[~settled[of_pass]]
            axes.plot(at[closed], value[closed], mfc=colour, **look)
            axes.plot(at[hollow], value[hollow], mfc="white", **look)
    return passes


def _draw_arrows(axes: Axes, passes: list[Pass], least: float) -> None:
    """Draw an arrow along the first pass up and the first pass down, where the two differ most.

    No arrow is drawn if they never differ by half of `least` (in the observable's unit).
    """
    first_passes = {drawn.colour: drawn for drawn in reversed(passes)}
    if set(first_passes) != {UP, DOWN}:
        return
    low = max(float(drawn.at.min()) for drawn in first_passes.values())
    high = min(float(drawn.at.max()) for drawn in first_passes.values())
    if not high > low:
        return
    grid = np.linspace(low, high, _GRID)
    curves = {}
    for colour, drawn in first_passes.items():
        order = np.argsort(drawn.at, kind="stable")
        curves[colour] = np.interp(grid, drawn.at[order], drawn.value[order])
    differ = np.abs(curves[UP] - curves[DOWN])
    if differ.max() < 0.5 * least:
        return
    turns = np.flatnonzero(np.diff(np.r_[False, differ >= 0.5 * differ.max(), False]))
    longest = int(np.argmax(turns[1::2] - turns[::2]))
    begin, end = int(turns[2 * longest]), int(turns[2 * longest + 1]) - 1
    half_length = min(0.06 * (high - low), 0.4 * (grid[end] - grid[begin]))
    middle = (begin + end) // 2
    for colour, curve in curves.items():
        above = curve[middle] >= curves[DOWN if colour == UP else UP][middle]
        offset = ScaledTranslation(0.0, (9 if above else -9) / 72, axes.figure.dpi_scale_trans)
        ahead = half_length if colour == UP else -half_length
        look: dict[str, Any] = {"arrowstyle": "-|>", "mutation_scale": 9, "shrinkA": 0, "shrinkB": 0}
        ends = (grid[middle] - ahead, curve[middle]), (grid[middle] + ahead, curve[middle])
        arrow = FancyArrowPatch(*ends, color=colour, lw=1.0, zorder=5, **look)
        arrow.set_transform(axes.transData + offset)
        axes.add_patch(arrow)
