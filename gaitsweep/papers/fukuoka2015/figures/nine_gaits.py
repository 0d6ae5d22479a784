"""The 3 x 3 table of gaits, with the footfalls of an example in each cell (Fukuoka 2015, Fig. 5c)."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from gaitsweep.papers.fukuoka2015.analysis.gait_tables import gaits_in
from gaitsweep.papers.fukuoka2015.analysis.swing_onsets import FLEXORS
from gaitsweep.papers.fukuoka2015.figures.footfalls import CONTACTS, footfalls
from gaitsweep.papers.fukuoka2015.figures.gait_looks import colour_of, in_words, label_of
from gaitsweep.papers.fukuoka2015.planar_quadruped.nine_gaits import CHART
from gaitsweep.plot import (
    PlannedTable,
    Positive,
    Refusal,
    Title,
    figure_kind,
    require_columns,
    rows_where,
    theme,
)

_NOTE_WIDTH = 1.5  # inches; width of the description of a cell
_NARROW_WIDTH = 5.0  # inches; below, cells have their speed alone, and the first column names the legs
_TILTS = ("hind leg first\n(tilted down)", "together\n(level)", "fore leg first\n(tilted up)")
_PAIRS = ("left fore and right hind leg", "right fore and left hind leg")  # of the columns and of the rows


def _check(figure: Any, table: PlannedTable) -> Iterator[Refusal]:
    if (name := table.missing([*FLEXORS.values(), *CONTACTS.values()])) is not None:
        yield figure.needs(table, f"the signal {name}")


@figure_kind("trace", check=_check)
def nine_gaits(
    table: pd.DataFrame,
    *,
    cycles: Annotated[Positive, "cycles that an example shows"] = 2.5,
    title: Title = None,
) -> Figure:
    """A cell for each gait: which leg of each diagonal pair swings first, with the footfalls of one row.

    The row shown is the one of its gait with the largest margin to another gait; the cell of a gait without
    rows stays empty.

    Args:
        table: a trace of a model with the nine gaits.

    Raises:
        PlotError: the table does not have a column.
    """
    require_columns(table, "row", "t", *FLEXORS.values())
    gaits = gaits_in(table)
    narrow = theme.width_of(theme.PAGE) < _NARROW_WIDTH
    with theme.canvas(theme.PAGE, 4.9, title) as figure:
        grid = figure.subplots(3, 3)
        for place, gait in enumerate(CHART):
            down, across = divmod(place, 3)
            axes = grid[down, across]
            candidates = gaits.loc[gaits["gait"] == gait]
            if len(candidates):
                clearest = candidates.loc[candidates["margin"].idxmax()]
                _example(axes, table, gait, clearest, cycles, narrow=narrow)
            else:
                _name(axes, gait)
                _empty(axes, "no row" if narrow else "no row has it")
            if across > 0 and narrow:
                axes.tick_params(labelleft=False)
        for across, axes in enumerate(grid[0]):
            _head_column(axes, across, 32 if narrow else 42)
        for down, axes in enumerate(grid[:, 0]):
            axes.set_ylabel(_TILTS[down], fontsize=theme.points(7.5), labelpad=4)
        for axes in grid[2]:
            axes.set_xlabel("time (s)")
        figure.supylabel(_PAIRS[1], fontsize=theme.points(7.5))
    return figure


def _head_column(axes: Axes, across: int, above: float) -> None:
    """The heading of a column of cells, `above` points over it; over all three what they have in common."""
    style: dict[str, Any] = {"ha": "center", "fontsize": theme.points(7.5)}
    style |= {"xycoords": "axes fraction", "textcoords": "offset points"}
    axes.annotate(_TILTS[across], (0.5, 1.0), (0, above), **style)
    if across == 1:  # a line that is wider than its column
        axes.annotate(_PAIRS[0], (0.5, 1.0), (0, above + 22), in_layout=False, **style)
        axes.annotate(" ", (0.5, 1.0), (0, above + 22), **style)


def _example(
    axes: Axes, table: pd.DataFrame, gait: str, record: pd.Series, cycles: float, *, narrow: bool
) -> None:
    """The footfalls of a row, whose entry of `gaits_in` is `record`, with its description."""
    samples = rows_where(table, table["row"] == record["row"]).sort_values("t", kind="stable")
    samples = samples.assign(t=samples["t"] - samples["t"].min())
    end = cycles * float(np.asarray(record["period"], float))
    samples = rows_where(samples, samples["t"] <= end)
    footfalls(axes, samples)
    axes.set_xlim(0.0, end)
    words = in_words(table, record, samples)
    note = words[0] if narrow else theme.wrapped(", ".join(words), _NOTE_WIDTH, 7.0)
    _name(axes, gait, note)
    last = float(f"{0.8 * end:.1g}")
    axes.set_xticks([0.0, last], ["0", f"{last:g}"])


def _empty(axes: Axes, text: str) -> None:
    """The cell of a gait without rows."""
    axes.set_xticks([])
    axes.set_yticks([])
    for spine in axes.spines.values():
        spine.set_visible(False)
    theme.message(axes, text)


def _name(axes: Axes, gait: str, note: str = "") -> None:
    """The name of the gait above its cell, and below it a description of the example."""
    style: dict[str, Any] = {"xycoords": "axes fraction", "textcoords": "offset points"}
    above = 3 + 9 * (note.count("\n") + 1)
    style |= {"fontsize": theme.points(8.5), "weight": "bold"}
    axes.annotate(label_of(gait), (0.0, 1.0), (0, above), color=colour_of(gait), **style)
    style |= {"fontsize": theme.points(7), "weight": "normal"}
    axes.annotate(note, (0.0, 1.0), (0, 3), color="#444444", **style)
