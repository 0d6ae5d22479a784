"""The theme of figures: sizes, fonts, panels and legends.

The colours of gaits (`gait_looks`), the axes of angles (`value_axes`) and the sizes of text
(`figure_layout`) are part of it.
"""

from __future__ import annotations

import contextlib
import math
import warnings
from collections.abc import Callable, Iterator, Sequence
from typing import Any, TypeVar, cast

import matplotlib as mpl
import numpy as np
from jaxtyping import Bool, Float
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg, RendererAgg
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.legend import Legend
from matplotlib.legend_handler import HandlerTuple
from matplotlib.transforms import ScaledTranslation

from gaitsweep.plot.columns import PlotError
from gaitsweep.plot.figure_layout import (
    COLLAPSED,
    INCH,
    POINTS,
    break_lines,
    centre_shared_label,
    check_height,
)
from gaitsweep.plot.figure_layout import points as points
from gaitsweep.plot.figure_layout import wrapped as wrapped
from gaitsweep.plot.figure_style import MILLIMETRES, current, given_axes
from gaitsweep.plot.gait_looks import COLOURS as COLOURS
from gaitsweep.plot.gait_looks import CONTRAST as CONTRAST
from gaitsweep.plot.gait_looks import DASHES as DASHES
from gaitsweep.plot.gait_looks import HATCH as HATCH
from gaitsweep.plot.gait_looks import LINE_COLOURS as LINE_COLOURS
from gaitsweep.plot.gait_looks import MOST_NAMED_LINES as MOST_NAMED_LINES
from gaitsweep.plot.gait_looks import SPARE_COLOURS as SPARE_COLOURS
from gaitsweep.plot.gait_looks import SPARE_MARKERS as SPARE_MARKERS
from gaitsweep.plot.gait_looks import colours as colours
from gaitsweep.plot.gait_looks import contrast as contrast
from gaitsweep.plot.gait_looks import hatched as hatched
from gaitsweep.plot.gait_looks import hatches as hatches
from gaitsweep.plot.gait_looks import ink_on as ink_on
from gaitsweep.plot.gait_looks import line_on as line_on
from gaitsweep.plot.gait_looks import markers as markers
from gaitsweep.plot.gait_looks import mixed as mixed
from gaitsweep.plot.gait_looks import named as named
from gaitsweep.plot.gait_looks import ordered as ordered
from gaitsweep.plot.value_axes import angle_axis as angle_axis
from gaitsweep.plot.value_axes import angle_ticks as angle_ticks
from gaitsweep.plot.value_axes import in_pi as in_pi
from gaitsweep.plot.value_axes import value_axis as value_axis

# Widths of figures in a paper, inches.
COLUMN = MILLIMETRES["column"] / INCH
PAGE = MILLIMETRES["page"] / INCH
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
PAGE_HEIGHT = 7.0  # inches: of all panels above each other, so that a figure is about 200 mm high at most
_TOO_HIGH = 11.0  # inches: an A4 page is 11.7 high
_BELOW = 0.4  # inches: height of a legend below panels
_LINE = 0.13  # inches: height of another line in a legend
_TITLE_POINTS = 9.5
_LEGEND_POINTS = 7.5
_KEY_WIDTH = 0.45  # inches: of the mark before a text in a legend
Panel = TypeVar("Panel")


class _Figure(Figure):
    """A figure whose files embed their fonts as Type 42, and whose page is white in dark notebooks too."""

    def savefig(self, fname: Any, **options: Any) -> None:
        with mpl.rc_context({**_unchanged(_EMBEDDED), **_PAPER}):
            super().savefig(fname, **options)

    def draw(self, renderer: Any) -> None:
        with mpl.rc_context(_PAPER):  # ticks are made as they are drawn
            super().draw(renderer)


_Figure.__name__ = Figure.__name__  # what notebooks show


class _OnePanel:
    """Axes of the user in the place of a figure of one panel."""

    def __init__(self, axes: Axes) -> None:
        self.axes = axes

    def subplots(self, rows: int = 1, columns: int = 1, *, squeeze: bool = True, **_: Any) -> Any:
        if rows * columns != 1:
            raise PlotError(f"This figure has {rows * columns} panels, but ax is one: leave ax out.")
        return self.axes if squeeze else np.array([[self.axes]], object)

    def add_subplot(self, *_: Any, projection: str | None = None) -> Axes:
        if projection is not None:
            raise PlotError("This figure has panels of its own, but ax is one: leave ax out.")
        return self.axes

    def add_gridspec(self, *_: Any, **__: Any) -> Any:
        raise PlotError("This figure has several panels, but ax is one: leave ax out.")

    subfigures = add_gridspec

    def legend(self, *, loc: str, **look: Any) -> Legend:
        return self.axes.legend(**look)

    def colorbar(self, image: Any, *, ax: Any, **look: Any) -> Any:
        return cast(Figure, self.axes.get_figure(root=True)).colorbar(image, ax=self.axes, **look)

    def set_figheight(self, height: float) -> None:
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
    scale = 1.0 if _unchanged({"font.size": POINTS}) else mpl.rcParams["font.size"] / POINTS
    sizes = _unchanged({key: size * scale for key, size in _SIZES.items()})
    paper = _PAPER if own_axes is None else {}
    with mpl.rc_context({**_unchanged(_RC), **sizes, **paper, "font.size": POINTS * scale}):
        if own_axes is not None:
            if title:
                own_axes.set_title(title)
            yield cast(Figure, _OnePanel(own_axes))
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
            centre_shared_label(figure)
            if requested.width is not None:
                break_lines(figure)
                break_lines(figure)  # broken labels may have made other panels narrower
            if requested.height is not None:
                check_height(figure, height)
        if figure.get_figheight() > _TOO_HIGH and requested.height is None:
            warnings.warn(
                f"This figure is {INCH * figure.get_figheight():.0f} mm high, more than a page: give it a "
                "width of page, panel_columns or a height, or draw fewer panels, from a selection of rows.",
                stacklevel=2,
            )


def width_of(natural: float) -> float:
    """The width in inches of the figure that is being drawn: its style's, else its natural one."""
    width = current().width
    if width is None:
        return natural
    return (MILLIMETRES[width] if isinstance(width, str) else width) / INCH


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
    if current().panel_columns:
        columns = max(1, min(panels, current().panel_columns or 1))
        return _rows_of(panels, columns), columns
    width = width_of(natural)
    columns = max(1, min(panels, most or panels, int(width / least)))
    widest = min(panels, int(width / narrowest))
    while height_of is not None and columns < widest:
        if _rows_of(panels, columns) * height_of(columns) <= PAGE_HEIGHT:
            break
        columns += 1
    return _rows_of(panels, columns), columns


def _rows_of(count: int, columns: int) -> int:
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


def interrupted(
    parted: Bool[np.ndarray, " gaps"], *lines: Float[np.ndarray, " points"]
) -> list[Float[np.ndarray, " interrupted"]]:
    """Insert NaN into lines (n,) between neighbours that are `parted` (n - 1,), where a line has a gap."""
    gaps = np.flatnonzero(parted) + 1
    return [np.insert(line, gaps, np.nan) for line in lines]


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


def legend(
    figure: Figure,
    handles: Sequence[Any] | None = None,
    labels: Sequence[str] | None = None,
    *,
    ncols: int = 2,
    title: str | None = None,
    in_cell: bool = False,
) -> None:
    """The legend below a figure, in as many columns as its width allows.

    Args:
        figure: that of `canvas`.
        handles, labels: entries and their texts; by default those of all panels.
        ncols: the most columns.
        title: text above the entries, unless the style leaves out captions.
        in_cell: whether it may stand in the empty cell at the end of a grid of panels; the figure is then
            lower by its height.
    """
    title = None if current().caption is False else title
    if not title and handles is not None and not len(handles):
        return
    look: dict[str, Any] = {"loc": "outside lower center", "title": title}
    look["handler_map"] = {tuple: HandlerTuple(ndivide=1, pad=0.0)}  # several handles as one, over each other
    if handles is not None:
        look["handles"] = handles
    if labels is not None:
        look["labels"] = labels
    if isinstance(figure, _OnePanel):
        figure.legend(ncols=1, **look)
    elif not (in_cell and _legend_in_cell(figure, look)):
        _legend_below(figure, look, _filled_columns(len(handles), ncols) if handles else ncols)


def _filled_columns(count: int, most: int) -> int:
    """The number of columns, at most `most`, that entries fill in as few rows."""
    return math.ceil(count / _rows_of(count, most))


def _renderer(figure: Figure) -> RendererAgg:
    """The renderer by which texts of a figure are measured."""
    return cast(FigureCanvasAgg, figure.canvas).get_renderer()


def _legend_below(figure: Figure, look: dict[str, Any], most: int) -> None:
    """Draw the legend below a figure in at most `most` columns, with broken lines if one is too wide."""
    width = figure.get_figwidth() - 0.1
    if look["title"]:
        look = {**look, "title": wrapped(look["title"], width, _LEGEND_POINTS)}
    renderer = _renderer(figure)
    columns = most
    drawn = figure.legend(ncols=columns, **look)
    count = len(drawn.get_texts())
    while columns > 1 and drawn.get_window_extent(renderer).width > width * figure.dpi:
        drawn.remove()
        columns = _filled_columns(count, columns - 1)
        drawn = figure.legend(ncols=columns, **look)
    grow(figure, _LINE * (_rows_of(count, columns) - _rows_of(count, most)))
    if drawn.get_window_extent(renderer).width > width * figure.dpi:
        for text in drawn.get_texts():
            text.set_text(wrapped(text.get_text(), width - _KEY_WIDTH, _LEGEND_POINTS))
        breaks = np.array_split([text.get_text().count("\n") for text in drawn.get_texts()], columns)
        grow(figure, _LINE * max(int(of_column.sum()) for of_column in breaks))


def grow(figure: Figure, inches: float) -> None:
    """Make a figure higher, for what stands below its panels, unless its style has a height."""
    if current().height is None and not isinstance(figure, _OnePanel):
        figure.set_figheight(figure.get_figheight() + inches)


def _legend_in_cell(figure: Figure, look: dict[str, Any]) -> bool:
    """Put the legend into the empty cell beside the last panel; False if there is none, or no room."""
    last_cell = figure.axes[-1].get_subplotspec()
    if last_cell is None or last_cell.colspan.stop == last_cell.get_gridspec().ncols:
        return False
    grid = last_cell.get_gridspec()
    width = figure.get_figwidth() * (1.0 - last_cell.colspan.stop / grid.ncols) - 0.35
    in_cell: dict[str, Any] = {
        **look,
        "title": wrapped(look["title"], width, _LEGEND_POINTS) if look["title"] else None,
        "loc": "center left",
        "bbox_to_anchor": (1.0, 0.5),
        "bbox_transform": figure.axes[-1].transAxes + ScaledTranslation(0.3, 0.0, figure.dpi_scale_trans),
        "borderaxespad": 0.0,
    }
    drawn = figure.legend(ncols=1, **in_cell)
    box = drawn.get_window_extent(_renderer(figure))
    if box.width <= width * figure.dpi and box.height <= figure.bbox.height / grid.nrows:
        grow(figure, -_BELOW)
        return True
    drawn.remove()
    return False


def percent(share: float) -> str:
    """Format a fraction in whole per cent, for a legend."""
    return "<1" if 0.0 < share < 0.005 else f"{100 * share:.0f}"


def message(axes: Axes, text: str) -> None:
    """Write the reason, a sentence, into an empty panel."""
    width = axes.get_position().width * cast(Figure, axes.get_figure(root=True)).get_figwidth()
    lines = wrapped(text, 0.9 * width, 8.0)
    axes.text(0.5, 0.5, lines, transform=axes.transAxes, ha="center", va="center", color="#555555")
