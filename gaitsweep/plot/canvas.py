"""The canvas of a figure: a page with the theme's fonts and widths, or the user's axes, and its panels."""

from __future__ import annotations

import contextlib
import math
import warnings
import weakref
from collections.abc import Callable, Iterator, Sequence
from typing import Any, TypeVar, cast

import matplotlib as mpl
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.legend import Legend

from gaitsweep.errors import warn
from gaitsweep.plot.column_labels import described
from gaitsweep.plot.columns import PlotError, log_axes
from gaitsweep.plot.figure_layout import (
    COLLAPSED,
    INCH,
    POINTS,
    break_lines,
    centre_shared_label,
    check_height,
    points,
    wrapped,
)
from gaitsweep.plot.figure_style import MILLIMETRES, current, given_axes

# Widths of figures in a paper, inches.
COLUMN = MILLIMETRES["column"] / INCH
PAGE = MILLIMETRES["page"] / INCH
_TOO_HIGH = 11.0  # inches: an A4 page is 11.7 high
_SIZES = {
    "axes.titlesize": 8.5,
    "axes.labelsize": 8.5,
    "xtick.labelsize": 7.5,
    "ytick.labelsize": 7.5,
    "legend.fontsize": 7.5,
    "legend.title_fontsize": 7.5,
}
_RC: dict[str, Any] = {
    "legend.frameon": False,
    "axes.linewidth": 0.6,
    "axes.formatter.useoffset": False,  # an offset beside an axis is easily overlooked
    "axes.spines.top": False,
    "axes.spines.right": False,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "lines.linewidth": 1.0,
    "figure.dpi": 150.0,
    "savefig.dpi": 200.0,
    "hatch.linewidth": 0.5,
    "legend.handleheight": 1.0,  # of which a hatch shows its pattern
}
_EMBEDDED = {"pdf.fonttype": 42, "ps.fonttype": 42}  # TrueType, which publishers ask for
# Dark ink on a white page in every notebook: the colours and black lines of figures are made for it.
_INK = (
    "text.color", "lines.color", "patch.edgecolor", "axes.edgecolor", "axes.labelcolor", "axes.facecolor",
    "xtick.color", "ytick.color", "xtick.labelcolor", "ytick.labelcolor", "grid.color", "figure.facecolor",
    "figure.edgecolor", "savefig.facecolor", "savefig.edgecolor", "legend.labelcolor",
    "axes3d.xaxis.panecolor", "axes3d.yaxis.panecolor", "axes3d.zaxis.panecolor",
)  # fmt: skip
_PAPER: dict[Any, Any] = {key: mpl.rcParamsDefault[key] for key in _INK}
_TITLE_POINTS = 9.5
_EMPTY: weakref.WeakSet[Axes] = weakref.WeakSet()  # panels that have a message only


class _Figure(Figure):
    """A figure whose files embed their fonts as Type 42, and whose page is white in dark notebooks too."""

    def savefig(self, fname: Any, **options: Any) -> None:
        with mpl.rc_context({**_unchanged(_EMBEDDED), **_PAPER}):
            super().savefig(fname, **options)

    def draw(self, renderer: Any) -> None:
        with mpl.rc_context(_PAPER):  # ticks are made as they are drawn
            super().draw(renderer)


_Figure.__name__ = Figure.__name__  # what notebooks show


class OnePanel(Figure):
    """Axes of the user in the place of a figure of one panel; more than this panel is refused."""

    _given: Sequence[Axes] = ()  # which Matplotlib would clear with a new figure

    def __init__(self, panel: Axes) -> None:
        super().__init__()
        self.panel = panel
        self._given = (panel,)

    @property
    def axes(self) -> list[Axes]:
        return list(self._given)

    def subplots(self, nrows: int = 1, ncols: int = 1, *, squeeze: bool = True, **_: Any) -> Any:
        if nrows * ncols != 1:
            raise PlotError(f"This figure has {nrows * ncols} panels, but ax is one: leave ax out.")
        return self.panel if squeeze else np.array([[self.panel]], object)

    def add_subplot(self, *_: Any, projection: str | None = None, **__: Any) -> Any:
        if projection is not None:
            raise PlotError("This figure has panels of its own, but ax is one: leave ax out.")
        return self.panel

    def add_gridspec(self, *_: Any, **__: Any) -> Any:
        raise PlotError("This figure has several panels, but ax is one: leave ax out.")

    subfigures = add_gridspec

    def text(self, *_: Any, **__: Any) -> Any:
        raise PlotError("This figure has text beside its panels, but ax is a panel: leave ax out.")

    def legend(self, *_: Any, loc: str = "", **look: Any) -> Legend:
        return self.panel.legend(**look)

    def colorbar(self, mappable: Any, *_: Any, **look: Any) -> Any:
        return cast(Figure, self.panel.get_figure(root=True)).colorbar(mappable, **{**look, "ax": self.panel})

    def set_figheight(self, val: float, forward: bool = True) -> None:
        """Keep the user's height."""


def _unchanged(defaults: dict[Any, Any]) -> dict[Any, Any]:
    """The rcParams of `defaults` that the user has not changed."""
    return {key: value for key, value in defaults.items() if mpl.rcParams[key] == mpl.rcParamsDefault[key]}


@contextlib.contextmanager
def canvas(width: float, height: float, title: str | None = None) -> Iterator[Figure]:
    """A context with an empty figure, in which Matplotlib has this theme.

    The user's rcParams are obeyed, but for the colours of page and ink.

    Args:
        width, height: size in inches, unless the figure's style has another.
        title: text above the figure.
    """
    own_axes, requested = given_axes(), current()
    with _themed(_PAPER if own_axes is None else {}):
        if own_axes is not None:
            if title:
                own_axes.set_title(title)
            yield OnePanel(own_axes)
            return
        wide = width_of(width)
        lines = wrapped(title, wide, _TITLE_POINTS) if title else ""
        height += 0.16 * lines.count("\n")
        high = requested.height / INCH if requested.height else height
        figure = _Figure((wide, high), layout="constrained")
        FigureCanvasAgg(figure)
        # room for half of the label of a last tick, which the layout may miss
        if requested.width is not None:
            room = (0.0, 0.0, 1.0 - 0.07 / wide, 1.0)
            cast(ConstrainedLayoutEngine, figure.get_layout_engine()).set(rect=room)
        if lines:
            figure.suptitle(lines, fontsize=points(_TITLE_POINTS))
        with warnings.catch_warnings():
            if requested.height is not None:  # which is refused, with the least that fits
                warnings.filterwarnings("ignore", COLLAPSED)
            yield figure
            _remove_ticks_of_no_data(figure)
            centre_shared_label(figure)
            if requested.width is not None:
                break_lines(figure)
                break_lines(figure)  # broken labels may have made other panels narrower
            if requested.height is not None:
                check_height(figure, height)
        if figure.get_figheight() > _TOO_HIGH and requested.height is None:
            warn(
                f"This figure is {INCH * figure.get_figheight():.0f} mm high, more than a page: give it a "
                "width of page, panel_columns or a height, or draw fewer panels, from a selection of rows."
            )


@contextlib.contextmanager
def diagram(
    table: pd.DataFrame,
    x: str,
    y: str,
    title: str | None,
    *,
    width: float = COLUMN + 1.6,
    height: float = 3.4,
) -> Iterator[tuple[Figure, Axes]]:
    """A context like `canvas`, with one panel whose axes have the labels and scales of columns.

    Args:
        table: the table.
        x, y: its columns along the axes.
        title: text above the figure.
        width, height: size in inches, unless the figure's style has another.
    """
    with canvas(width, height, title) as figure:
        axes = figure.subplots()
        axes.set_xlabel(described(table, x))
        axes.set_ylabel(described(table, y, 36))
        log_axes(axes, table, x=x, y=y)
        yield figure, axes


@contextlib.contextmanager
def frame(width: float, height: float) -> Iterator[Figure]:
    """A context like `canvas`, for a picture of exactly this size: it has no style and no layout engine.

    Args:
        width, height: size in inches.
    """
    with _themed(_PAPER):
        figure = _Figure((width, height))
        figure.set_layout_engine("none")
        yield figure


@contextlib.contextmanager
def _themed(paper: dict[Any, Any]) -> Iterator[None]:
    """A context in which Matplotlib has the theme, and the colours of `paper`."""
    scale = 1.0 if _unchanged({"font.size": POINTS}) else mpl.rcParams["font.size"] / POINTS
    sizes = _unchanged({key: size * scale for key, size in _SIZES.items()})
    with mpl.rc_context({**_unchanged(_RC), **sizes, **paper, "font.size": POINTS * scale}):
        yield


def width_of(natural: float) -> float:
    """The width in inches of the figure that is being drawn: its style's, else its natural one."""
    width = current().width
    if width is None:
        return natural
    return (MILLIMETRES[width] if isinstance(width, str) else width) / INCH


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


def _remove_ticks_of_no_data(figure: Figure) -> None:
    """Remove the ticks of axes with a `message` that have no range, nor data in a panel that shares them."""
    for axes in _EMPTY.intersection(figure.axes):
        for axis, shared, automatic in (
            (axes.xaxis, axes.get_shared_x_axes(), axes.get_autoscalex_on()),
            (axes.yaxis, axes.get_shared_y_axes(), axes.get_autoscaley_on()),
        ):
            if automatic and not any(panel.has_data() for panel in shared.get_siblings(axes)):
                axis.set_ticks([])
                axis.set_ticks([], minor=True)


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


def stacked_panels(
    figure: Figure, grid: tuple[int, int], count: int, heights: Sequence[float]
) -> list[list[Axes]]:
    """A grid of panels of several axes above each other: for each of these heights, the axes of all panels.

    Panels share the horizontal axis, and each of their vertical axes with those beside it.

    Args:
        figure: that of `canvas`.
        grid: rows and columns of panels, the result of `shape`.
        count: number of panels.
        heights: heights of the axes of a panel, relative to each other.
    """
    down, across = grid
    options: dict[str, Any] = {"sharex": True, "squeeze": False, "height_ratios": [*heights] * down}
    cells = figure.subplots(len(heights) * down, across, **options)
    layers = [cells[layer :: len(heights)].ravel() for layer in range(len(heights))]
    for layer in layers:
        for axes in layer[count:]:
            axes.remove()
        for axes in layer[1:count]:
            axes.sharey(layer[0])
    return [list(layer[:count]) for layer in layers]


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
    """Write the reason, a sentence, into an empty panel; axes without a range lose their ticks."""
    _EMPTY.add(axes)
    width = axes.get_position().width * cast(Figure, axes.get_figure(root=True)).get_figwidth()
    lines = wrapped(text, 0.9 * width, 8.0)
    axes.text(0.5, 0.5, lines, transform=axes.transAxes, ha="center", va="center", color="#555555")
