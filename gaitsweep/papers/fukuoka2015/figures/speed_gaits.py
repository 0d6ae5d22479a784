"""Gaits over speed: the speeds at which each gait occurs, for each value of a parameter."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Any

import numpy as np
import pandas as pd
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from gaitsweep.papers.fukuoka2015.analysis.gait_tables import gaits_in
from gaitsweep.papers.fukuoka2015.figures.gait_looks import (
    ORDER,
    check_gaits,
    colour_of,
    gait_key,
    label_of,
    marker_of,
)
from gaitsweep.plot import (
    TEXT_COLUMNS,
    Column,
    Observable,
    Panels,
    PlannedTable,
    Refusal,
    Title,
    column,
    described,
    figure_kind,
    require_columns,
    rows_where,
    theme,
    written,
)
from gaitsweep.status import Status

_SPREAD = 0.62  # spread of rows of one speed, as a share of the distance between bands
_HIDING_DISTANCE = (
    0.02  # distance below which points would hide each other, as a share of the range of speeds
)


def _check(figure: Any, table: PlannedTable) -> Iterator[Refusal]:
    yield from check_gaits(figure, table)
    if figure.y != "gait" and figure.y in TEXT_COLUMNS:
        yield ("y",), f"is {figure.y}, which is not numeric: use gait or an axis of the job."


@figure_kind("fixed_time", "settle", check=_check)
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
    values = [None] if panels is None else sorted(table[panels].dropna().unique())
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
        names = [label_of(band) if by_gait else f"{band:.4g}".replace("-", "−") for band in bands]
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
