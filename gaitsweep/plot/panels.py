"""Grids of panels: their shape, their shared labels, and the reason written into an empty one."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any, TypeVar, cast

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from gaitsweep.plot.canvas import width_of
from gaitsweep.plot.figure_layout import wrapped
from gaitsweep.plot.figure_style import current

PAGE_HEIGHT = 7.0  # inches: of all panels above each other, so that a figure is about 200 mm high at most
Panel = TypeVar("Panel")


def shape(
    panels: int,
    natural: float,
    least: float,
    most: int | None = None,
    *,
    height_of: Callable[[int], float] | None = None,
    narrowest: float = 1.5,
) -> tuple[int, int]:
    """The rows and columns of a grid of panels, at least one of each.

    Args:
        panels: the number of panels.
        natural: natural width of the figure, inches.
        least: least width of a panel with its labels, inches, unless the style has `panel_columns`.
        most: the most panels in a row, likewise; by default all.
        height_of: height of a row of panels, inches, by the number of columns. Where the figure would be
            higher than a page there are more columns.
        narrowest: least width of a panel there, inches.
    """
    if requested := current().panel_columns:
        columns = max(1, min(panels, requested))
        return rows_of(panels, columns), columns
    width = width_of(natural)
    columns = max(1, min(panels, most or panels, int(width / least)))
    widest = min(panels, int(width / narrowest))
    while height_of is not None and columns < widest:
        if rows_of(panels, columns) * height_of(columns) <= PAGE_HEIGHT:
            break
        columns += 1
    return rows_of(panels, columns), columns


def rows_of(count: int, columns: int) -> int:
    """The rows that some cells fill in so many columns, at least one."""
    return max(1, math.ceil(count / columns))


def first_of(
    panels: list[Panel], most: int, title: str | None, noun: str = "panels"
) -> tuple[list[Panel], str | None]:
    """The first panels of a figure, at most `most`, and its title, which mentions panels left out."""
    if len(panels) > most:
        title = f"{title or ''} (the first {most} of {len(panels)} {noun})".strip()
    return panels[:most], title


def panels(figure: Figure, grid: tuple[int, int], count: int, **look: Any) -> list[Axes]:
    """A grid of panels, of which the last row may have empty cells; the lowest of each column has numbers.

    Args:
        figure: that of `canvas`.
        grid: rows and columns, the result of `shape`.
        count: number of panels.
        look: options of `Figure.subplots`.
    """
    cells = figure.subplots(*grid, squeeze=False, **look).ravel()
    for axes in cells[count:]:
        axes.remove()
    for axes in cells[max(count - grid[1], 0) : count]:
        axes.tick_params(labelbottom=True)
    return list(cells[:count])


def label_panels(figure: Figure, panels: Sequence[Axes], across: int, *, x: str = "", y: str = "") -> None:
    """Label axes that panels share, once where there is a middle: of their columns, and of their rows.

    Args:
        figure: that of `canvas`.
        panels: those of `panels`, in rows of `across`.
        x, y: labels of the horizontal and the vertical axes.
    """
    for number, axes in enumerate(panels):
        lowest = number + across >= len(panels)
        if x and lowest and (across % 2 == 0 or number % across == across // 2):
            axes.set_xlabel(x)
    if len(panels) > across:
        figure.supylabel(y, fontsize=mpl.rcParams["axes.labelsize"])
    else:
        panels[0].set_ylabel(y)


def message(axes: Axes, text: str) -> None:
    """Write the reason, a sentence, into an empty panel."""
    width = axes.get_position().width * cast(Figure, axes.get_figure(root=True)).get_figwidth()
    lines = wrapped(text, 0.9 * width, 8.0)
    axes.text(0.5, 0.5, lines, transform=axes.transAxes, ha="center", va="center", color="#555555")
