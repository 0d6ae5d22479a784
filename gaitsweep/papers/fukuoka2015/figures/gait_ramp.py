"""The gaits over a moving parameter (Fukuoka 2015, Fig. 2 and 4), and the speeds at which they occur."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from typing import Annotated, Any, Literal

import numpy as np
import pandas as pd
import scipy
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.patheffects import withStroke

from gaitsweep.papers.fukuoka2015.analysis.gait_bouts import gaits_along
from gaitsweep.papers.fukuoka2015.analysis.gait_tables import REPEATS, gaits_in
from gaitsweep.papers.fukuoka2015.figures.gait_looks import (
    ORDER,
    areas_of,
    check_gaits,
    colour_of,
    gait_key,
    label_of,
    marker_of,
)
from gaitsweep.papers.fukuoka2015.planar_quadruped.nine_gaits import family
from gaitsweep.plot import (
    TEXT_COLUMNS,
    Column,
    Count,
    Observable,
    Panels,
    PlannedTable,
    PlotError,
    Refusal,
    Title,
    Word,
    column,
    described,
    digits_of,
    figure_kind,
    moved_parameter,
    require_columns,
    row_names,
    rows_where,
    theme,
    written,
)
from gaitsweep.status import Status

Windows = Float[np.ndarray, " windows"]
Areas = Mapping[str, dict[str, Any]]

_BAR, _BETWEEN_BARS = 0.36, 0.44  # height of a bar and distance of two, in rows of two passes
_LEAST_PASSES = 2  # for whose bars a row has room
_LABEL_ROOM = 1.4  # inches; of rows' names beside the bars
_LETTER_WIDTH = 0.065  # inches; width of a letter of a gait's name


def _check(figure: Any, table: PlannedTable) -> Iterator[Refusal]:
    if table.run.moved is None:
        text = "is gait_ramp, but no parameter moves in this run: set run.parameter, run.path and run.rate."
        yield ("kind",), text
    else:
        yield from check_gaits(figure, table)


@figure_kind("ramp", "trace", check=_check)
def gait_ramp(
    table: pd.DataFrame,
    *,
    panels: Panels = None,
    x: Annotated[
        Literal["parameter", "speed"],
        Word(),
        "quantity along the axis: the moving parameter, or the measured speed",
    ] = "parameter",
    cycles: Annotated[Count, "number of cycles for one reading of the gait"] = 3,
    title: Title = None,
) -> Figure:
    """A bar for each pass of each row, the first one above the others, with the gait in each window.

    Rows are named by the swept quantities that differ between those of a panel. A measured speed goes to and
    fro a little from cycle to cycle; windows stand at its nearest monotone course (isotonic regression).

    Args:
        table: a ramp, or a trace with a moving parameter, of a model with the nine gaits.

    Raises:
        PlotError: the table does not have a column, no parameter moves, or no row has a gait.
    """
    parameter = moved_parameter(table)
    if parameter is None or parameter not in table.columns or "pass" not in table.columns:
        raise PlotError("No parameter moves in the table's job: use a ramp, or a trace with run.parameter.")
    if panels is not None:
        column(table, panels)
    values = _values(table, panels)
    along = gaits_along(table, cycles=cycles)
    if x == "speed" and "speed" not in along.columns:
        raise PlotError("x is speed, but the table has neither speed_n nor the signal x: use another x.")
    horizontal = "speed" if x == "speed" else parameter
    along = along.loc[np.isfinite(along[horizontal])]
    if not len(along):
        raise PlotError(f"No row has {cycles} successive cycles, in which its gait could be read.")
    parts = [table if value is None else rows_where(table, table[str(panels)] == value) for value in values]
    rows = [np.unique(part["row"].to_numpy(int)) for part in parts]
    heights = [max(len(rows_of_panel), 1) for rows_of_panel in rows]
    areas = areas_of(along["gait"].astype(str))
    passes = max(int(along["pass"].max()) + 1, _LEAST_PASSES)
    height = 0.42 * sum(heights) * passes / _LEAST_PASSES
    with theme.canvas(theme.PAGE, height + 0.35 * len(parts) + 0.9, title) as figure:
        grid = figure.subplots(len(parts), 1, sharex=True, squeeze=False, height_ratios=heights)[:, 0]
        if np.ptp(along[horizontal]) > 0.0:
            grid[0].set_xlim(along[horizontal].min(), along[horizontal].max())
        drawn: set[str] = set()
        for axes, value, part in zip(grid, values, parts, strict=True):
            axes.set_title("" if value is None else written(table, str(panels), value), loc="left")
            names = _names(part.sort_values("row", kind="stable"), panels)
            drawn |= _panel(axes, along, list(names.items()), passes, parameter, horizontal, areas)
        grid[-1].set_xlabel("measured speed (m/s)" if x == "speed" else described(table, parameter))
        theme.legend(figure, _key({gait: area for gait, area in areas.items() if gait in drawn}), ncols=6)
    return figure


def _values(table: pd.DataFrame, panels: str | None) -> list[Any]:
    """The value of each panel; None for a single one of all rows, also where no row has a value."""
    return [None] if panels is None else sorted(table[panels].dropna().unique()) or [None]


def _key(areas: Areas) -> list[Patch]:
    """The legend: one area for each colour, since both sides of a gait share it."""
    handles = [Patch(label=_kind(gait), **areas[gait]) for gait in theme.ordered(ORDER) if gait in areas]
    return list({handle.get_facecolor(): handle for handle in handles}.values())


def _names(part: pd.DataFrame, panels: str | None) -> dict[Any, str]:
    """The name of each row of a panel; rows that differ by their perturbed start alone are numbered."""
    names = row_names(part, [*REPEATS, *([] if panels is None else [panels])])
    rows_by_name: dict[str, list[Any]] = {}
    for row, name in names.items():
        # a name without a value is the row's number, which says nothing of its parameters
        rows_by_name.setdefault(f"{name}, " if "=" in name else "", []).append(row)
    for name, rows in rows_by_name.items():
        if len(rows) > 1:
            names |= {row: f"{name}start {number}" for number, row in enumerate(rows, start=1)}
    return names


def _kind(gait: str) -> str:
    """A gait's label without its side, since both sides have one colour."""
    label = label_of(gait)
    if label != gait:
        return label
    if gait in ("uR-canter", "uL-canter"):
        return "unusual canter"
    return family(gait) if family(gait) in ("canter", "gallop") else gait


def _panel(
    axes: Axes,
    along: pd.DataFrame,
    rows: Sequence[tuple[Any, str]],
    passes: int,
    parameter: str,
    horizontal: str,
    areas: Areas,
) -> set[str]:
    """Draw the bars of named rows over the column `horizontal`, and the direction of each of their passes.

    Returns:
        The gaits that have a bar.
    """
    drawn: set[str] = set()
    style: dict[str, Any] = {"fontsize": theme.points(11), "va": "center", "ha": "right", "weight": "bold"}
    share = _LEAST_PASSES / passes
    for place, (row, _) in enumerate(rows):
        for number in range(passes):
            part = along.loc[(along["row"] == row) & (along["pass"] == number)]
            height = place + share * _BETWEEN_BARS * (number - 0.5 * (passes - 1))
            falls = len(part) > 1 and part[parameter].iloc[-1] < part[parameter].iloc[0]
            at = part[horizontal].to_numpy(float)
            if horizontal == "speed" and len(at):
                at = scipy.optimize.isotonic_regression(at, increasing=not falls).x
            gaits = part["gait"].astype(str).tolist()
            drawn |= _bar(axes, at, part["t"].to_numpy(float), gaits, (height, share * _BAR), areas)
            if len(part) > 1:
                arrow = "\u2190" if falls else "\u2192"
                side = axes.get_yaxis_transform()
                axes.annotate(arrow, (0.0, height), (-3, 0), side, "offset points", **style)
    axes.set_yticks(range(len(rows)), [name for _, name in rows])
    axes.tick_params(axis="y", length=0, pad=16)
    axes.set_ylim(len(rows) - 0.45, -0.55)
    axes.spines["left"].set_visible(False)
    return drawn


def _bar(
    axes: Axes, at: Windows, t: Windows, gaits: Sequence[str], place: tuple[float, float], areas: Areas
) -> set[str]:
    """Draw one pass: its windows reach half way to their neighbours, but not over missing windows.

    A gait has its name where its bar has room for it. `place` is the middle of the bar, and its height.

    Returns:
        The gaits that have a bar; those of a parameter that is held have no width.
    """
    drawn: set[str] = set()
    if len(at) < 2:
        return drawn
    inches = theme.width_of(theme.PAGE) - _LABEL_ROOM
    letters = inches / np.ptp(axes.get_xlim()) / _LETTER_WIDTH  # in a unit of x
    middle = 0.5 * (at[1:] + at[:-1])
    step = np.diff(t)
    missing = step > 2.0 * np.median(step)
    begins = np.r_[at[0], np.where(missing, at[1:], middle)]
    ends = np.r_[np.where(missing, at[:-1], middle), at[-1]]
    kinds = [_kind(gait) for gait in gaits]
    turns = missing | [one != other for one, other in itertools.pairwise(kinds)]
    firsts = [0, *(np.flatnonzero(turns) + 1).tolist(), len(at)]
    for first, last in itertools.pairwise(firsts):
        low, colour = begins[first], areas[gaits[first]]["facecolor"]
        if ends[last - 1] == low:
            continue
        drawn.add(gaits[first])
        middle_of_bar, height = place
        bar = axes.barh(middle_of_bar, ends[last - 1] - low, height, left=low, **areas[gaits[first]])
        if abs(ends[last - 1] - low) * letters > len(kinds[first]):
            style: dict[str, Any] = {"fontsize": theme.points(7), "color": theme.ink_on(colour)}
            style["path_effects"] = [withStroke(linewidth=2.5, foreground=colour)]  # read over a hatch
            axes.bar_label(bar, [kinds[first]], label_type="center", **style)
    return drawn


_SPREAD = 0.62  # spread of rows of one speed, as a share of the distance between bands
# Distance below which points would hide each other, as a share of the range of speeds.
_HIDING_DISTANCE = 0.02


def _check_bands(figure: Any, table: PlannedTable) -> Iterator[Refusal]:
    yield from check_gaits(figure, table)
    if figure.y != "gait" and figure.y in TEXT_COLUMNS:
        yield ("y",), f"is {figure.y}, which is not numeric: use gait or an axis of the job."


@figure_kind("fixed_time", "settle", check=_check_bands)
def speed_gaits(
    table: pd.DataFrame,
    *,
    y: Annotated[Column, "column whose values are the bands: gait, or a parameter"] = "gait",
    panels: Panels = None,
    speed: Annotated[Observable, "observable along the horizontal axis"] = "speed",
    title: Title = None,
) -> Figure:
    """A point for each row at its speed, in the band of its gait or of a parameter's value.

    Rows of nearly the same speed are stacked, so that the number of starts with a gait is visible.

    Args:
        table: a settle table of a model with the nine gaits; rows that fell are left out, and rows that had
            not settled have open markers.

    Raises:
        PlotError: the table does not have a column.
    """
    speed = column(table, speed, ("_end", ""))
    require_columns(table, y, "status", panels)
    shown = _with_gaits(table, speed)
    present = [gait for gait in theme.ordered(ORDER) if gait in set(shown["gait"])]
    by_gait = y == "gait"
    bands: list[Any] = present if by_gait else sorted(table[y].dropna().unique())
    values = _values(table, panels)
    band_height = 0.23 if len(bands) > 12 else 0.26
    height = band_height * max(len(bands), 3) + 0.9
    legend_height = 0.0 if by_gait else 0.35
    down, across = theme.shape(len(values), theme.PAGE, 1.2)
    with theme.canvas(theme.PAGE, height * down + legend_height, title) as figure:
        grid = theme.panels(figure, (down, across), len(values), sharex=True, sharey=True)
        extent = float(np.ptp(shown[speed].to_numpy(float))) if len(shown) else 1.0
        for axes, value in zip(grid, values, strict=True):
            part = shown if value is None else rows_where(shown, shown[str(panels)] == value)
            axes.set_title("" if value is None else written(table, str(panels), value))
            _bands(axes, part, y, bands, speed, extent)
            if not len(part):
                theme.message(axes, "no row with a gait" if len(table) else "no rows yet")
        for axes in grid[-across:]:
            axes.set_xlabel(described(table, speed, 60 // across))
        numbers = f".{digits_of(table, y)}g"
        names = [
            label_of(band) if isinstance(band, str) else f"{band:{numbers}}".replace("-", "−")
            for band in bands
        ]
        grid[0].set_yticks(range(len(bands)), names)
        grid[0].set_ylim(-0.6, len(bands) - 0.4)
        if not by_gait:
            for axes in grid[::across]:
                axes.set_ylabel(described(table, y, 36))
            theme.legend(figure, gait_key(present), ncols=6)
    return figure


def _with_gaits(table: pd.DataFrame, speed: str) -> pd.DataFrame:
    """The rows with a gait and a speed, their gait by `gaits_in`."""
    gaits = gaits_in(table).set_index("row")["gait"].astype(str)
    rows = table.assign(gait=gaits.loc[table["row"]].to_numpy())
    return rows_where(rows, np.isfinite(rows[speed].to_numpy(float)) & (rows["gait"] != "none"))


def _bands(axes: Axes, part: pd.DataFrame, y: str, bands: list[Any], speed: str, extent: float) -> None:
    """The rows of one panel, spread vertically around the middle of each band."""
    axes.grid(axis="y", color="#EEEEEE", lw=0.6)
    axes.set_axisbelow(True)
    for place, band in enumerate(bands):
        rows = rows_where(part, part[y] == band)
        at = rows[speed].to_numpy(float)
        moving = Status.UNDECIDED.among(rows["status"])
        offset = _stacked(at, _HIDING_DISTANCE * extent) * _SPREAD
        for gait in theme.ordered(ORDER):
            which = (rows["gait"] == gait).to_numpy()
            style = {"color": colour_of(gait), "marker": marker_of(gait), "ms": 3.2, "mew": 0.6, "ls": ""}
            for some, face in ((which & ~moving, colour_of(gait)), (which & moving, "white")):
                if some.any():
                    axes.plot(at[some], place + offset[some], mfc=face, **style)


def _stacked(at: Float[np.ndarray, " points"], same: float) -> Float[np.ndarray, " points"]:
    """Offsets in [-0.5, 0.5] that separate points at nearly the same position."""
    order = np.argsort(at, kind="stable")
    offset = np.zeros(len(at))
    groups = np.split(order, np.flatnonzero(np.diff(at[order]) > same) + 1) if len(at) else []
    most = max((len(group) for group in groups), default=1)
    for group in groups:
        offset[group] = (np.arange(len(group)) - 0.5 * (len(group) - 1)) / max(most, 4)
    return offset
