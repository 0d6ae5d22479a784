"""Basin measures: fractions with intervals, basin entropies, uncertainty fraction over eps."""

from __future__ import annotations

import functools
from collections.abc import Iterator, Sequence
from typing import Annotated, Any

import matplotlib as mpl
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, MaxNLocator, NullFormatter, ScalarFormatter
from pydantic import Field

from gaitsweep.analysis.basins.attractor_matching import follow_attractors
from gaitsweep.analysis.basins.attractors import with_attractors
from gaitsweep.analysis.basins.basin_boundaries import ENTROPY_BOX
from gaitsweep.analysis.basins.measures import Basins, basins
from gaitsweep.analysis.records import axes_of, refuse_inferred
from gaitsweep.plot import theme
from gaitsweep.plot.arguments import TEXT_COLUMNS, Column, Title
from gaitsweep.plot.basin_maps.cells import check_hue
from gaitsweep.plot.column_labels import axis_label, digits_of, unit_of, written
from gaitsweep.plot.columns import column, is_angle, rows_where
from gaitsweep.plot.figure_style import current
from gaitsweep.plot.kind import PlannedTable, Refusal, figure_kind

_MOST_NAMED = 6  # most lines in a legend; more lines have a colour bar


@functools.cache
def _shades() -> ListedColormap:
    """The colours of the lines of panels, without the lightest."""
    return ListedColormap(mpl.colormaps["viridis"](np.linspace(0.0, 0.85, 256)))


def _check(figure: Any, table: PlannedTable) -> Iterator[Refusal]:
    """Refuse axes that are not numeric or are named twice, and inferred states."""
    if figure.panels == "attractor":
        yield ("panels",), "is attractor, which is computed and not a column of this job's table."
    axes = figure.axes
    if axes is None:
        axes = [name for name in table.varied if name != figure.panels]
        if not axes:
            yield ("axes",), "is missing: besides panels, the job has no axis that could be the starts."
    for number, name in enumerate(axes):
        if name in TEXT_COLUMNS:
            yield ("axes", number), f"is {name}, which is not numeric: use axes of the job."
        elif name in axes[:number] or name == figure.panels:
            yield ("axes", number), f"is {name}, which is named twice."
    yield from check_hue(figure, table)
    if figure.hue == "attractor" and table.run.refined(table.rows) is not None:
        text = "is attractor, but run.refine infers rows, which have no state that identifies an attractor."
        yield ("hue",), text
    if figure.hue == "attractor" and table.run.kind_name == "fixed_time":
        text = "is attractor, but a run of kind fixed_time does not test whether rows settle: use settle."
        yield ("hue",), text


@figure_kind("settle", "fixed_time", check=_check, added_columns=("attractor",))
def basin_measures(
    table: pd.DataFrame,
    *,
    axes: Annotated[
        Sequence[Column] | None,
        Field(min_length=1),
        "columns of the starts; by default all axes besides panels",
    ] = None,
    hue: Annotated[
        Column, "column of the outcomes of starts; attractor groups the settled states, matched along panels"
    ] = "gait",
    panels: Annotated[Column | None, "column whose values are measured separately"] = None,
    title: Title = None,
) -> Figure:
    """Three panels: the fraction of each outcome with its interval, entropies, uncertainty fraction over eps.

    Args:
        table: a settle table, refined or not, complete or partial. Rows without a value of `panels` are left
            out.

    Raises:
        PlotError: the table lacks a column, or no axis is left.
    """
    if panels:
        table = rows_where(table, table[column(table, panels)].notna())
    down, across = theme.shape(3, theme.PAGE, 2.0)
    with theme.canvas(theme.PAGE, 2.7 * down, title) as figure:
        if not len(table):
            theme.message(figure.add_subplot(), "no rows yet")
            return figure
        if hue == "attractor" and hue not in table.columns:
            table = _with_attractors(table, panels)
        column(table, hue)
        measured = basins(table, axes, label=hue, by=panels or ())
        of_shares, of_entropies, of_uncertain = theme.panels(figure, (down, across), 3)
        _draw_shares(of_shares, table, measured, panels)
        _draw_entropies(of_entropies, table, measured, panels)
        starts = axes or [name for name in axes_of(table) if name != panels]
        units = {unit_of(table, name) for name in starts}
        _draw_uncertain(of_uncertain, table, measured, panels, units.pop() if len(units) == 1 else None)
    return figure


def _with_attractors(table: pd.DataFrame, panels: str | None) -> pd.DataFrame:
    """The table with the attractor of each row, matched along numeric panels."""
    if panels is None or not pd.api.types.is_numeric_dtype(table[panels]):
        return with_attractors(table)
    refuse_inferred(table, "no state that identifies an attractor")
    followed = table.assign(attractor=follow_attractors(table, panels).column)
    followed.attrs = table.attrs
    return followed


def _label_panels(
    axes: Axes, table: pd.DataFrame, panels: str | None, measured: Basins
) -> dict[object, float]:
    """Label the horizontal axis with the panels' values; returns their positions along it."""
    if panels is None:
        axes.set_xticks([])
        axes.set_xlim(-1.0, 1.0)
        return {None: 0.0}
    values = list(measured.panels[panels])
    axes.set_xlabel(axis_label(table, panels))
    if not pd.api.types.is_numeric_dtype(measured.panels[panels]):
        axes.set_xticks(range(len(values)), [str(value) for value in values])
        return {value: float(position) for position, value in enumerate(values)}
    if is_angle(table, panels):
        theme.angle_axis(axes, "x")
    return dict(zip(values, measured.panels[panels].to_numpy(float).tolist(), strict=True))


def _with_value(records: pd.DataFrame, name: str | None, value: object) -> pd.DataFrame:
    """The records with a value in a column; all of them if the column is None."""
    return records if name is None else rows_where(records, records[name] == value)


def _draw_shares(axes: Axes, table: pd.DataFrame, measured: Basins, panels: str | None) -> None:
    """Draw the fraction of each outcome over the panels' values, with its interval."""
    positions = _label_panels(axes, table, panels, measured)
    records = measured.fractions
    names = theme.ordered(dict.fromkeys(records["outcome"]))
    colour, marker = theme.colours(names), theme.markers(names)
    for name in names:
        fractions = _with_value(records, "outcome", name)
        values = fractions[panels] if panels else [None] * len(fractions)
        at = [positions[value] for value in values]
        share = fractions["fraction"].to_numpy()
        errors = np.abs(fractions[["low", "high"]].to_numpy().T - share)
        look = {"color": colour[name], "marker": marker[name], "markersize": 3.5, "capsize": 2.0}
        axes.errorbar(at, share, errors, label=theme.named(name), linewidth=0.7, elinewidth=1.0, **look)
    axes.set_ylim(-0.02, max(1.02 * float(np.max(records["high"].to_numpy(float))), 0.1))
    axes.set_ylabel("share of starts")
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.22), ncols=2 if len(names) > 2 else 1)


def _draw_entropies(axes: Axes, table: pd.DataFrame, measured: Basins, panels: str | None) -> None:
    """Draw both basin entropies over the panels' values."""
    positions = _label_panels(axes, table, panels, measured)
    axes.set_ylabel("entropy (nats)")
    if np.isnan(measured.panels["basin_entropy"].to_numpy(float)).all():
        _explain(axes, measured, f"is narrower than the boxes of {ENTROPY_BOX} cells a side")
        return
    at = [positions[value] for value in (measured.panels[panels] if panels else [None])]
    for name, colour, marker in (("basin_entropy", "#0072B2", "o"), ("boundary_entropy", "#D55E00", "s")):
        look: dict[str, Any] = {"color": colour, "marker": marker, "markersize": 3.5, "linewidth": 0.7}
        axes.plot(at, measured.panels[name].to_numpy(float), label=name.replace("_", " "), **look)
    axes.axhline(np.log(2.0), color="#555555", linewidth=0.7, linestyle="--")
    axes.annotate("ln 2", (1.0, np.log(2.0)), xycoords=("axes fraction", "data"), ha="right", va="bottom")
    largest = np.nanmax(measured.panels[["basin_entropy", "boundary_entropy"]].to_numpy(float))
    axes.set_ylim(0.0, max(0.8, 1.05 * float(largest)))
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.22))


def _draw_uncertain(
    axes: Axes, table: pd.DataFrame, measured: Basins, panels: str | None, unit: str | None
) -> None:
    """Draw the uncertainty fraction over eps, a line for each value of the panels, with its exponent.

    Without a unit that all axes of starts have, eps is in steps of the grid.
    """
    eps, shown = ("steps", "grid steps") if unit is None else ("eps", unit)
    begin = "error" if unit is None else "error of a start"
    axes.set_xlabel(rf"{begin} $\varepsilon$ ({shown})" if shown else rf"{begin} $\varepsilon$")
    axes.set_ylabel("share of uncertain starts")
    if not np.any(measured.uncertainty["uncertain"].to_numpy(float) > 0.0):
        empty = measured.uncertainty.empty
        lack = "is too narrow to compare starts" if empty else "has no boundary between outcomes"
        axes.set_xticks([])
        _explain(axes, measured, lack)
        return
    values = list(measured.panels[panels]) if panels else [None]
    many = len(values) > _MOST_NAMED
    digits = digits_of(table, panels) if panels else None
    shades = _shades()(np.linspace(0.0, 1.0, len(values)))
    for number, value in enumerate(values):
        uncertain = _with_value(measured.uncertainty, panels, value)
        uncertain = rows_where(uncertain, uncertain["uncertain"] > 0.0)
        exponent = _exponent_text(_with_value(measured.panels, panels, value))
        label = f"{written(table, panels, value, digits)}, {exponent}" if panels else exponent
        look: dict[str, Any] = {"color": shades[number], "markersize": 3.5, "linewidth": 0.7}
        look["marker"] = theme.SPARE_MARKERS[number % len(theme.SPARE_MARKERS)]
        axes.loglog(uncertain[eps], uncertain["uncertain"], label=None if many else label, **look)
    for axis in (axes.xaxis, axes.yaxis):
        low, high = axis.get_view_interval()
        axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)) if high > 2.0 * low else MaxNLocator(3))
        axis.set_major_formatter(ScalarFormatter())
        axis.set_minor_formatter(NullFormatter())
    if many and panels:
        _draw_colour_bar(axes, table, measured.panels, panels)
    else:
        heading = None if current().caption is False else "exponent (95 % interval)"
        axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.22), title=heading)


def _exponent_text(panel: pd.DataFrame) -> str:
    """The uncertainty exponent of one value of the panels, with its interval: `0.45 (0.41 to 0.50)`."""
    exponent, low, high = panel[["exponent", "exponent_low", "exponent_high"]].to_numpy(float)[0]
    return f"{exponent:.2f} ({low:.2f} to {high:.2f})" if np.isfinite(exponent) else "no exponent"


def _explain(axes: Axes, measured: Basins, lack: str) -> None:
    """Write the reason into a panel without a measure."""
    on_grid = measured.panels["grid"].to_numpy(bool).any()
    without_grid = "The starts form no complete grid, which this measure needs."
    theme.message(axes, f"The grid of starts {lack}." if on_grid else without_grid)
    axes.set_yticks([])


def _draw_colour_bar(axes: Axes, table: pd.DataFrame, measured: pd.DataFrame, panels: str) -> None:
    """Draw a colour bar of the lines, from the panels' first value to the last, and the exponents' range."""
    values = list(measured[panels])
    bar = axes.inset_axes((0.1, -0.36, 0.8, 0.05))
    bar.imshow(np.linspace(0.0, 1.0, len(values))[None, :], cmap=_shades(), aspect="auto", vmin=0.0, vmax=1.0)
    bar.set_yticks([])
    ends = (0, len(values) - 1)
    bar.set_xticks(ends, [written(table, panels, values[end]) for end in ends])
    bar.tick_params(length=0)
    exponents = measured["exponent"].to_numpy(float)
    if np.isfinite(exponents).any():
        text = f"exponents {np.nanmin(exponents):.2f} to {np.nanmax(exponents):.2f}"
        axes.text(0.04, 0.96, text, transform=axes.transAxes, ha="left", va="top", fontsize=theme.points(7.5))
