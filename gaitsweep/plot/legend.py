"""The legend of a figure, below its panels or in an empty cell of their grid, and scales of colours."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, cast

import matplotlib as mpl
import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg, RendererAgg
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.legend_handler import HandlerTuple
from matplotlib.transforms import ScaledTranslation

from gaitsweep.plot.canvas import OnePanel, rows_of
from gaitsweep.plot.figure_layout import wrapped
from gaitsweep.plot.figure_style import current

_BELOW = 0.4  # inches: height of a legend below panels
_LINE = 0.13  # inches: height of another line in a legend
_POINTS = 7.5
_KEY_WIDTH = 0.45  # inches: of the mark before a text in a legend
_SCALE = mpl.colormaps["viridis"].with_extremes(under="#CC79A7", over="#D55E00")
_ARROWS = {(False, True): "max", (True, False): "min", (True, True): "both"}


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
    if isinstance(figure, OnePanel):
        figure.legend(ncols=1, **look)
    elif not (in_cell and _legend_in_cell(figure, look)):
        _legend_below(figure, look, _filled_columns(len(handles), ncols) if handles else ncols)


def _filled_columns(count: int, most: int) -> int:
    """The number of columns, at most `most`, that entries fill in as few rows."""
    return math.ceil(count / rows_of(count, most))


def _renderer(figure: Figure) -> RendererAgg:
    """The renderer by which texts of a figure are measured."""
    return cast(FigureCanvasAgg, figure.canvas).get_renderer()


def _legend_below(figure: Figure, look: dict[str, Any], most: int) -> None:
    """Draw the legend below a figure in at most `most` columns, with broken lines if one is too wide."""
    width = figure.get_figwidth() - 0.1
    if look["title"]:
        look = {**look, "title": wrapped(look["title"], width, _POINTS)}
    renderer = _renderer(figure)
    columns = most
    drawn = figure.legend(ncols=columns, **look)
    count = len(drawn.get_texts())
    while columns > 1 and drawn.get_window_extent(renderer).width > width * figure.dpi:
        drawn.remove()
        columns = _filled_columns(count, columns - 1)
        drawn = figure.legend(ncols=columns, **look)
    grow(figure, _LINE * (rows_of(count, columns) - rows_of(count, most)))
    if drawn.get_window_extent(renderer).width > width * figure.dpi:
        for text in drawn.get_texts():
            text.set_text(wrapped(text.get_text(), width - _KEY_WIDTH, _POINTS))
        breaks = np.array_split([text.get_text().count("\n") for text in drawn.get_texts()], columns)
        grow(figure, _LINE * max(int(of_column.sum()) for of_column in breaks))


def grow(figure: Figure, inches: float) -> None:
    """Make a figure higher, for what stands below its panels, unless its style has a height."""
    if current().height is None and not isinstance(figure, OnePanel):
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
        "title": wrapped(look["title"], width, _POINTS) if look["title"] else None,
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


class ColourScale(ScalarMappable):
    """The colours of numbers (n,): from the least to the largest finite one, and those of infinite ones."""

    def __init__(self, numbers: Float[np.ndarray, " numbers"]) -> None:
        finite = numbers[np.isfinite(numbers)]
        low, high = (float(finite.min()), float(finite.max())) if finite.size else (0.0, 0.0)
        margin = 0.0 if low < high else 0.1 * abs(low) or 0.1
        self._low, self._high = low - margin, high + margin
        super().__init__(Normalize(self._low, self._high), _SCALE)
        self._infinite = bool(np.isneginf(numbers).any()), bool(np.isposinf(numbers).any())

    def on_scale(self, numbers: Float[np.ndarray, " *numbers"]) -> Float[np.ndarray, " *numbers"]:
        """The numbers, with finite ones beyond the ends for infinite ones, which Matplotlib does not draw."""
        span = self._high - self._low
        return np.clip(numbers, self._low - span, self._high + span)

    def draw_bar(
        self, figure: Figure, beside: Axes | Sequence[Axes], label: str, shrink: float = 1.0
    ) -> None:
        """Draw the colour bar beside axes, with arrows in the colours of infinite numbers."""
        if any(self._infinite):
            label += "\n(arrows: infinite)" if all(self._infinite) else "\n(arrow: infinite)"
        arrows = _ARROWS.get(self._infinite, "neither")
        figure.colorbar(self, ax=beside, label=label, shrink=shrink, extend=arrows)


def percent(share: float) -> str:
    """Format a fraction in whole per cent, for a legend; 0 and 100 are exact."""
    if 0.0 < share < 0.005:
        return "<1"
    return ">99" if 0.995 <= share < 1.0 else f"{100 * share:.0f}"
