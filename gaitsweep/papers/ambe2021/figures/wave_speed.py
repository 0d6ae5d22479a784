"""Waves of the chain: length and speed beside the theory (Ambe 2021, eqs. 27, 28), and their sources."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Annotated, Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from gaitsweep import near_miss
from gaitsweep.papers.ambe2021 import extension
from gaitsweep.papers.ambe2021.analysis.travelling_wave import source_place as places_of
from gaitsweep.papers.ambe2021.analysis.travelling_wave import waves
from gaitsweep.papers.ambe2021.figures.gait_shares import require_swept
from gaitsweep.papers.ambe2021.multilegged.chain_of_table import set_columns, without_phases
from gaitsweep.plot import (
    CellGrid,
    Column,
    PlannedTable,
    PlotError,
    Refusal,
    Text,
    Title,
    cell_edges,
    column,
    described,
    figure_kind,
    hatch_cells,
    require_columns,
    theme,
)

# The panels by their columns: the vertical axis, and the label and the line of each column of the theory.
_PANELS = {
    "wavelength": ("wavelength (legs)", {"wavelength_27": ("eq. (27)", "-")}),
    "speed": (
        "speed of the wave (legs/s)",
        {"speed_exact": ("with the reset's shorter cycle", "-"), "speed_28": ("eq. (28) as printed", "--")},
    ),
}


def _check(figure: Any, table: PlannedTable) -> Iterator[Refusal]:
    if table.missing(["phase_1", "contact_1"]):
        yield figure.needs(table, "the multi-legged chain's signals phase_1 and contact_1")
    elif figure.x not in table.varied:
        yield ("x",), f"is {figure.x}, which does not vary in this job. {near_miss.allowing(table.varied)}"


@figure_kind("trace", check=_check)
def wave_speed(
    table: pd.DataFrame, *, x: Annotated[Text, "parameter along the horizontal axis"], title: Title = None
) -> Figure:
    """Wavelength and speed of the waves in a trace over a parameter, and the theory's curves.

    Args:
        table: a trace table of the multi-legged chain in which `x` varies.

    Raises:
        PlotError: the table does not have the column, no waves can be measured in it, or a second
            parameter of the theory varies.
    """
    column(table, x)
    if not len(table):
        with theme.canvas(theme.COLUMN, 2.9, title) as figure:
            theme.message(figure.subplots(), "no rows yet")
        return figure
    measured = waves(table)
    measured[x] = table.groupby("row")[x].first().loc[measured["row"]].to_numpy()
    parameters = [str(name) for name in measured.columns[1 : list(measured.columns).index("gait")]]
    for _, part in measured.groupby(x):
        theories = part[[curve for _, curves in _PANELS.values() for curve in curves]]
        if not np.allclose(theories, theories.iloc[0], rtol=1e-9, atol=0.0, equal_nan=True):
            others = [name for name in parameters if name != x and len(set(part[name])) > 1]
            raise PlotError(
                f"The theory's curves over {x} are of one value of each other parameter, but in this table "
                f"{' and '.join(others)} varies at one {x}, too: draw the rows of one value."
            )
    theory = measured.sort_values(by=x).drop_duplicates(x)
    names = [gait for gait in extension.gait_styles if gait in set(measured["gait"])]
    colour, marker = theme.colours(names), theme.markers(names)
    down, across = theme.shape(2, theme.PAGE, 2.5)
    with theme.canvas(theme.PAGE, 2.9 * down, title) as figure:
        grid = figure.subplots(down, across)
        for axes, (name, (vertical, curves)) in zip(grid, _PANELS.items(), strict=True):
            for curve, (text, line) in curves.items():
                axes.plot(theory[x], theory[curve], line, color="black", lw=0.9, label=text)
            for gait in names:
                rows = measured[np.asarray(measured["gait"] == gait)]
                style = {"s": 30, "linewidths": 1.2, "zorder": 4, "label": f"simulated: {theme.named(gait)}"}
                open_ring = {"facecolors": "none", "edgecolors": colour[gait], "marker": marker[gait]}
                axes.scatter(rows[x], rows[name], **style, **open_ring)
            axes.set_xlabel(described(table, x))
            axes.set_ylabel(vertical)
            axes.set_ylim(bottom=0)
            axes.legend(loc="upper left")
    return figure


_COLOURBAR_ROOM = 1.6  # inches; of labels and colour bars beside the panels
_SHOWN = {"source": ("Blues", "source at this leg"), "meeting": ("Oranges", "waves meet there (hatched)")}


def _check_profiles(figure: Any, table: PlannedTable) -> Iterator[Refusal]:
    if table.missing(["psi_1_end"]):
        yield figure.needs(table, "the multi-legged chain's psi_1")
        return
    swept = without_phases(table.varied)
    for place, name in enumerate(figure.x):
        if name not in swept:
            allowed = near_miss.allowing(swept)
            yield ("x", place), f"is {name}, which is not a varying parameter of this job. {allowed}"
    if hidden := [name for name in swept if name not in figure.x]:
        text = (
            f"leaves out {' and '.join(hidden)}, in which the rows differ, too: fix its value under params."
        )
        yield ("x",), text


@figure_kind("settle", check=_check_profiles, coloured="none")
def source_place(
    table: pd.DataFrame,
    *,
    x: Annotated[Sequence[Column], "strengths of profiles, one panel each; 0 stands for equal legs"],
    title: Title = None,
) -> Figure:
    """The share of starts whose source settles at each leg, over the strength of each profile.

    A panel has the rows in which the other profiles of `x` are 0. The lowest row of cells has the starts with
    neither a source nor a place where waves meet: one wave along the whole chain, or not settled.

    Args:
        table: a settle table of the multi-legged chain, several starts for each profile.

    Raises:
        PlotError: the table lacks a column, one of `x` is no swept parameter, or another parameter varies.
    """
    if not x:
        raise PlotError("x is empty: name a profile that varies, such as m_slope.")
    require_columns(table, *x)
    for name in x:
        require_swept(table, x=name)
    if hidden := [name for name in set_columns(table) if name not in x and len(table[name].unique()) > 1]:
        raise PlotError(
            f"x leaves out {' and '.join(hidden)}, in which the rows differ, too: keep the rows of one value."
        )
    down, across = theme.shape(len(x), theme.PAGE, 1.4)
    with theme.canvas(theme.PAGE, 3.3 * down, title) as figure:
        panels = theme.panels(figure, (down, across), len(x), sharey=True)
        for axes in panels[::across]:
            axes.set_ylabel("leg, 1 at the head")
        if not len(table):
            for axes in panels:
                theme.message(axes, "no rows yet")
            return figure
        shares = places_of(table)
        drawn = {}
        room = (theme.width_of(theme.PAGE) - (_COLOURBAR_ROOM if across == len(x) else 0.7)) / across
        legs = int(shares["leg"].to_numpy().max())
        most = max(float(shares["source"].to_numpy().max()), 0.01)
        for axes, name in zip(panels, x, strict=True):
            others = [other for other in x if other != name]
            alone = np.all(shares[others].to_numpy(float) == 0.0, axis=1)
            axes.set_xlabel(theme.wrapped(described(table, name), room, 8.5))
            if alone.any():
                drawn = _panel(axes, pd.DataFrame(shares[alone]), name, legs, most)
            else:
                theme.message(axes, "No row has 0 for the other profiles.")
        panels[0].set_yticks([*range(1, legs + 1), legs + 2], [*map(str, range(1, legs + 1)), "neither"])
        panels[0].set_ylim(legs + 2.5, 0.5)
        cells = list(figure.axes)  # before those of colour bars
        for mesh, label in drawn.values():
            side: dict[str, Any] = {} if across == len(x) else {"location": "bottom", "aspect": 30}
            figure.colorbar(mesh, ax=cells, label=f"share: {label}", shrink=0.9, pad=0.01, **side)
    return figure


def _panel(axes: Any, shares: pd.DataFrame, name: str, legs: int, most: float) -> dict[str, tuple[Any, str]]:
    """The cells of one profile, and the mesh and the label of each colour bar.

    Starts spread over many legs, so the colours of sources end at the largest share of all panels, `most`.
    """
    across = np.unique(shares[name])
    down = np.arange(1, legs + 1)
    grid = CellGrid((name, "leg"), (across, down), (cell_edges(across), np.arange(legs + 1) + 0.5))
    drawn = {}
    for column_name, (cmap, label) in _SHOWN.items():
        cells = grid.placed(shares, shares[column_name].to_numpy(float))
        style = {"cmap": cmap, "vmin": 0.0, "vmax": most if column_name == "source" else 1.0}
        mesh = axes.pcolormesh(*grid.edges, np.ma.masked_equal(cells, 0.0), rasterized=True, **style)
        drawn[column_name] = mesh, label
    hatch_cells(axes, grid, shares, shares["meeting"] > 0.0, "////", "white")
    neither = shares.groupby(name)["neither"].first().to_numpy(float)[None]
    below = np.array([legs + 1.5, legs + 2.5])
    axes.pcolormesh(grid.edges[0], below, np.ma.masked_equal(neither, 0.0), cmap="Greys", vmin=0.0, vmax=1.0)
    axes.axhline(legs + 1.0, color="#AAAAAA", lw=0.6)
    return drawn
