"""Wavelength and speed of simulated waves beside those of the theory (Ambe 2021, eqs. 27, 28)."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Any, NamedTuple

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from gaitsweep import near_miss
from gaitsweep.analyses import AnalysisError
from gaitsweep.papers.ambe2021 import extension
from gaitsweep.papers.ambe2021.analysis.travelling_wave import waves
from gaitsweep.plot import (
    PlannedTable,
    PlotError,
    Refusal,
    Text,
    Title,
    column,
    described,
    figure_kind,
    theme,
)


class Panel(NamedTuple):
    """A panel: its vertical axis, and the label and the line of each column of the theory in it."""

    label: str
    curves: dict[str, tuple[str, str]]


_PANELS = {
    "wavelength": Panel("wavelength (legs)", {"wavelength_27": ("eq. (27)", "-")}),
    "speed": Panel(
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
    try:
        measured = waves(table)
    except AnalysisError as error:
        raise PlotError(str(error)) from error
    measured[x] = table.groupby("row")[x].first().loc[measured["row"]].to_numpy()
    parameters = [str(name) for name in measured.columns[1 : list(measured.columns).index("gait")]]
    for _, part in measured.groupby(x):
        theories = part[[curve for panel in _PANELS.values() for curve in panel.curves]]
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
        for axes, (name, panel) in zip(grid, _PANELS.items(), strict=True):
            for curve, (text, line) in panel.curves.items():
                axes.plot(theory[x], theory[curve], line, color="black", lw=0.9, label=text)
            for gait in names:
                rows = measured[np.asarray(measured["gait"] == gait)]
                style = {"s": 30, "linewidths": 1.2, "zorder": 4, "label": f"simulated: {theme.named(gait)}"}
                open_ring = {"facecolors": "none", "edgecolors": colour[gait], "marker": marker[gait]}
                axes.scatter(rows[x], rows[name], **style, **open_ring)
            axes.set_xlabel(described(table, x))
            axes.set_ylabel(panel.label)
            axes.set_ylim(bottom=0)
            axes.legend(loc="upper left")
    return figure
