"""Bifurcation diagram: the crossings of the attractors that rows reach, with the largest exponent below."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
import pandas as pd
from jaxtyping import Bool, Float, Int
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.markers import MarkerStyle

from gaitsweep.analysis.records import in_order
from gaitsweep.angles import unwrap_from
from gaitsweep.plot import theme
from gaitsweep.plot.arguments import AlongAxis, Observed, Panels, Title
from gaitsweep.plot.column_labels import described, written
from gaitsweep.plot.columns import (
    by_value,
    column,
    is_angle,
    log_axes,
    origin_of,
    outcome,
    require_columns,
    require_one_system,
    rows_where,
)
from gaitsweep.plot.figure_style import current
from gaitsweep.plot.kind import check_one_parameter, figure_kind
from gaitsweep.status import Outcome, Status

_EXPONENT = "lyapunov_1"
# The colour and the words of each status. Settled rows are darkest, so that grey print tells them apart.
_LOOKS = {
    Status.settled.name: ("#222222", "periodic"),
    "quasi_periodic": ("#0072B2", "quasi-periodic"),
    "chaotic": ("#E0862D", "chaotic"),
}
_NOT_SETTLED, _FAILED, _AT_REST = str(Outcome.NOT_SETTLED), str(Outcome.FAILED), "at rest"
_WITHOUT = {_NOT_SETTLED: "#999999", _FAILED: "#B00020", _AT_REST: "#222222"}  # colours of their marks
_ERRORS = 2.0  # standard errors of the exponent that are drawn
_MANY = 2000  # rows from which on points are smaller
_SIZE, _SMALL = 3.0, 0.8  # points: sizes of markers
_PANELS_A_ROW = 3
_MOST_PANELS = 12


@figure_kind("settle", check=check_one_parameter, gaits_by_default=True)
def orbit(
    table: pd.DataFrame,
    *,
    x: Annotated[AlongAxis, "column of the varying parameter"],
    y: Observed,
    hue: Annotated[
        Literal["gait", "status"] | None,
        "gait or status: what colours the points; by default the gait where settled rows have several, or "
        "one with a colour of the style",
    ] = None,
    panels: Panels = None,
    title: Title = None,
) -> Figure:
    """The crossings of the attractors that rows reach over a parameter, with the Lyapunov exponent below.

    Of an orbit all crossings are drawn, of a chaotic or quasi-periodic row as many as the run keeps (the
    larger of 10 and `run.max_period`). Points of settled rows have the colour of their gait, and others that
    of their status. The lower axes show the largest exponent where `run.exponents` asks for it, with two
    standard errors. Parameter values without such a row are marked: at rest, not settled (a limit ended the
    rows, whose attractor is still open) or failed.

    Args:
        table: a settle table over several values of x.

    Raises:
        PlotError: the table lacks a column.
    """
    name = column(table, y, ("_end", ""))
    require_columns(table, x, panels, "status")
    require_one_system(table, x, panels)
    parts, title = theme.first_of(by_value(table, panels), _MOST_PANELS, title)
    down, across = theme.shape(len(parts), theme.PAGE, 2.0, _PANELS_A_ROW)
    exponents = _EXPONENT in table and bool(np.isfinite(table[_EXPONENT].to_numpy(float)).any())
    high, width = 4.6 if exponents else 3.4, theme.COLUMN + 1.6
    if len(parts) > 1:
        high, width = down * (0.75 * high - 0.4) + 0.6, theme.PAGE
    with theme.canvas(width, high, title) as figure:
        layers = theme.stacked_panels(figure, (down, across), len(parts), (2.2, 1.0) if exponents else (1.0,))
        grid, lowest = layers[0], layers[-1]
        for number in range(max(len(parts) - across, 0), len(parts)):
            lowest[number].set_xlabel(described(table, x, min(90 // across, 44)))
            lowest[number].tick_params(labelbottom=True)
        log_axes(grid[0], table, x=x)
        looks = _looks(table, hue)
        crossings = _crossings(table, name)
        crossings = unwrap_from(crossings, origin_of(table, name, crossings.ravel()))
        without: set[str] = set()
        for number, (axes, (value, part)) in enumerate(zip(grid, parts, strict=True)):
            axes.set_title("" if value is None else written(table, str(panels), value))
            if number % across == 0:
                axes.set_ylabel(described(table, name, 36 if len(parts) == 1 else 24))
            without |= _draw_crossings(axes, table, part.index.to_numpy(), x, crossings, looks)
            if exponents:
                _draw_exponent(lowest[number], part, x, labelled=number % across == 0)
        theme.value_axis(grid[0], angle=is_angle(table, name))
        if exponents:  # of a strongly stable orbit the exponent has no lower bound
            exponent = table[_EXPONENT].to_numpy(float)
            exponent = exponent[np.isfinite(exponent)]
            least = min(-2.0 * np.max(exponent, initial=0.0), float(np.quantile(exponent, 0.02)))
            lowest[0].set_ylim(bottom=least if least < 0.0 else None)
        handles = [Line2D([], [], color=of.colour, label=of.words, **_marker(of, 4.5)) for of in looks]
        handles += [
            Line2D([], [], ls="", marker="|", color=colour, ms=6, label=words)
            for words, colour in _WITHOUT.items()
            if words in without
        ]
        theme.legend(figure, handles, ncols=2)
    return figure


def _draw_crossings(
    axes: Axes,
    table: pd.DataFrame,
    rows: Int[np.ndarray, " some"],
    x: str,
    crossings: Float[np.ndarray, "rows crossings"],
    looks: Sequence[_Look],
) -> set[str]:
    """Draw the crossings of some rows, and marks at values without any; returns the words for these.

    Args:
        axes: the panel.
        table: the table.
        rows: the numbers of its records that the panel shows.
        x: the column of the parameter.
        crossings: those of all its records, as from `_crossings`.
        looks: those of all its records.
    """
    size = _SIZE if len(table) < _MANY else _SMALL
    at = table[x].to_numpy(float)
    shown = [rows[look.rows[rows]] for look in looks]
    for look, of_look in zip(looks, shown, strict=True):
        values = crossings[of_look]
        places = np.broadcast_to(at[of_look, None], values.shape)
        axes.plot(places.ravel(), values.ravel(), color=look.colour, rasterized=True, **_marker(look, size))
    if not any(map(len, shown)):
        theme.message(axes, "No row has settled." if len(table) else "no rows yet")
    without = _without_crossings(table.iloc[rows], x)
    for words, values in without.items():
        mark: dict[str, Any] = {"color": _WITHOUT[words], "ms": 5, "clip_on": False}
        axes.plot(values, 0.0 * values, "|", transform=axes.get_xaxis_transform(), **mark)
    return set(without)


class _Look(NamedTuple):
    """The rows (n,) with one look, and its colour, marker and words in the legend."""

    rows: Bool[np.ndarray, " rows"]
    colour: str
    marker: str
    words: str


def _marker(look: _Look, size: float) -> dict[str, Any]:
    """The marker of a look; one without an area, such as an x, is nothing but its edges."""
    width = 0.0 if MarkerStyle(look.marker).is_filled() else 0.3 * size
    return {"ls": "", "marker": look.marker, "ms": size, "mew": width}


def _looks(table: pd.DataFrame, hue: str | None) -> list[_Look]:
    """The looks of the rows whose crossings are drawn: by the gaits of settled rows, or by the statuses."""
    status = table["status"].astype(str).to_numpy(str)
    settled = status == Status.settled.name
    of_status = [
        _Look(status == name, colour, "o", words)
        for name, (colour, words) in _LOOKS.items()
        if (status == name).any()
    ]
    if hue == "gait":
        require_columns(table, "gait")
    if hue == "status" or "gait" not in table.columns:
        return of_status
    gait = outcome(table, "gait").astype(str).to_numpy(str)
    names = theme.ordered(dict.fromkeys(map(str, in_order(table, "gait", pd.Series(gait[settled])))))
    if hue is None and len(names) < 2 and not set(names) & set(current().colours or {}):
        return of_status
    colours, markers = theme.colours(names), theme.markers(names)
    of_gaits = [
        _Look(settled & (gait == name), colours[name], markers[name], theme.named(name)) for name in names
    ]
    return of_gaits + [look for look in of_status if not (look.rows & settled).any()]


def _crossings(table: pd.DataFrame, name: str) -> Float[np.ndarray, "rows crossings"]:
    """All crossings of each row, NaN beyond its last; not of rows that have no attractor, which are NaN."""
    further = (f"{name}_{number}" for number in itertools.count(2))  # the first has no number
    columns = [name, *itertools.takewhile(table.columns.__contains__, further)]
    with_attractor = table["status"].astype(str).isin(list(_LOOKS)).to_numpy(bool)
    return np.where(with_attractor[:, None], table[columns].to_numpy(float), np.nan)


def _draw_exponent(axes: Axes, table: pd.DataFrame, x: str, *, labelled: bool) -> None:
    """Draw the largest exponent over the parameter, with its error, and the line 0."""
    axes.axhline(0.0, color="#777777", lw=0.8, ls=":")
    if labelled:
        axes.set_ylabel(described(table, _EXPONENT, 14))
    rows = rows_where(table, np.isfinite(table[_EXPONENT].to_numpy(float))).sort_values(x, kind="stable")
    at, value = rows[x].to_numpy(float), rows[_EXPONENT].to_numpy(float)
    error = np.nan_to_num(rows[f"{_EXPONENT}_error"].to_numpy(float)) * _ERRORS
    axes.fill_between(at, value - error, value + error, color="#999999", alpha=0.4, lw=0.0)
    for status, (colour, _) in _LOOKS.items():
        of_status = rows["status"].astype(str).to_numpy() == status
        axes.plot(at[of_status], value[of_status], "o", ms=1.6, mew=0.0, color=colour)


def _without_crossings(table: pd.DataFrame, x: str) -> dict[str, Float[np.ndarray, " values"]]:
    """The parameter values without a row whose crossings are drawn, by the words for their rows.

    A value with an undecided row is not settled, whatever its other rows did: their attractor is still open.
    """
    status = table["status"].astype(str).to_numpy(str)
    values = table[x].to_numpy(float)
    drawn = values[np.isin(status, list(_LOOKS))]
    undecided, failed = values[Status.UNDECIDED.among(status)], values[Status.FAILED.among(status)]
    left = np.setdiff1d(values[np.isfinite(values)], drawn)
    open_still = np.isin(left, undecided)
    lost = np.isin(left, failed) & ~open_still
    without = {_NOT_SETTLED: left[open_still], _FAILED: left[lost], _AT_REST: left[~open_still & ~lost]}
    return {words: of_words for words, of_words in without.items() if len(of_words)}
