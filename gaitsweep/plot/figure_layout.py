"""The layout of a figure once its contents are known: broken lines, shared labels, and the least height."""

from __future__ import annotations

import re
import warnings
from typing import cast

import numpy as np
from jaxtyping import Float
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from gaitsweep.plot.columns import PlotError
from gaitsweep.plot.text_sizes import points, wrapped

INCH = 25.4  # mm
_LEAST_PANEL, _LEAST_SHARE_OF_NATURAL = 12.0, 0.6  # height in mm, or if less, share of the natural one
_HIGHEST, _HIGHER = 1000, 5  # mm, of a figure: the heights that are tried
COLLAPSED = "constrained_layout not applied"  # a warning of Matplotlib


def centre_shared_label(figure: Figure) -> None:
    """Move the label that rows of panels share to their middle, in lines no longer than they are high."""
    label = getattr(figure, "_supylabel")  # noqa: B009 - Matplotlib has no public name for it
    if label is None:
        return
    figure.draw_without_rendering()
    places = [axes.get_position() for axes in figure.axes]
    low, high = min(place.y0 for place in places), max(place.y1 for place in places)
    label.set_y(0.5 * (low + high))
    size = float(label.get_fontsize()) / points(1.0)
    label.set_text(wrapped(label.get_text(), (high - low) * figure.get_figheight(), size))


def check_height(figure: Figure, natural: float) -> None:
    """Refuse the height of a figure at which a panel has no room.

    Args:
        figure: that of `canvas`, with the height of its style.
        natural: its height without a style, inches, at which all panels have room.
    """
    asked = least = figure.get_figheight() * INCH
    figure.set_figheight(natural)
    enough = np.minimum(_LEAST_PANEL / INCH, _LEAST_SHARE_OF_NATURAL * _panel_heights(figure))
    figure.set_figheight(asked / INCH)
    while (_panel_heights(figure) < enough).any() and least < _HIGHEST:
        least = _HIGHER * (least // _HIGHER + 1.0)
        figure.set_figheight(least / INCH)
    if least > asked:
        raise PlotError(f"height is {asked:g} mm, but this figure needs at least {least:g} mm.")


def _panel_heights(figure: Figure) -> Float[np.ndarray, " panels"]:
    """The heights of panels in inches, (n,), of which all are 0 if the layout gives one of them no room."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        figure.draw_without_rendering()
    panels = [axes for axes in figure.axes if axes.get_label() != "<colorbar>"]
    heights = np.array([axes.get_position().height for axes in panels]) * figure.get_figheight()
    return heights * (not any(re.match(COLLAPSED, str(warning.message)) for warning in caught))


def break_lines(figure: Figure) -> None:
    """Break the lines of titles and labels that are longer than their panel, once the layout is known."""
    figure.draw_without_rendering()
    renderer = cast(FigureCanvasAgg, figure.canvas).get_renderer()
    panels = [axes.get_window_extent(renderer) for axes in figure.axes]
    for axes, panel in zip(figure.axes, panels, strict=True):
        if not axes.get_visible() or hasattr(axes, "zaxis"):
            continue
        gaps = [other.x0 - panel.x1 for other in panels] + [panel.x0 - other.x1 for other in panels]
        gap = min((gap for gap in gaps if gap > 0.0), default=np.inf)
        titles = (axes.title, *(vars(axes)[f"_{side}_title"] for side in ("left", "right")))
        for text in (axes.xaxis.label, axes.yaxis.label, *titles):
            box = text.get_window_extent(renderer)
            long, room = (box.height, panel.height) if text is axes.yaxis.label else (box.width, panel.width)
            beside = min(0.15 * figure.dpi, panel.x0, figure.bbox.width - panel.x1, 0.45 * gap)
            room += 2.0 * max(beside, 0.0)
            if text.get_text() and long > room:
                lines = text.get_text() if text in titles else text.get_text().replace("\n", " ")
                text.set_text(wrapped(lines, room / figure.dpi, float(text.get_fontsize()) / points(1.0)))
