"""The layout of figures: sizes of text, lines that fit a width, shared labels, and the least height."""

from __future__ import annotations

import re
import textwrap
import warnings
from typing import cast

import matplotlib as mpl
import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.text import Text

from gaitsweep.plot.columns import PlotError

INCH = 25.4  # mm
_LEAST_PANEL = 12.0  # mm: least height of a panel, unless it is naturally low
_LEAST_SHARE_OF_NATURAL = 0.6  # of a panel that is naturally low
_HIGHEST = 1000  # mm: the highest figure that is tried
_HEIGHT_STEP = 5  # mm: between the heights that are tried
COLLAPSED = "constrained_layout not applied"  # a warning of Matplotlib
_OVERHANG = 0.15  # inches: by which a text may be wider than its panel, at each side
_SHARE_OF_GAP = 0.45  # of the gap to the next panel, whose text may overhang, too
POINTS = 8.0  # of text, unless the user's rcParams differ from Matplotlib's defaults
_LETTER = 0.53  # mean width of a letter, as a share of the size of its font
_LEAST_LETTERS = 8  # in a line, even of a narrower panel
_FORMULA = re.compile(r"(?<!\\)\$(?:[^$\\]|\\.)*\$")  # \$ is a dollar sign, no begin of a formula
# In a formula, what has no width, and commands, which are a letter wide.
_MARKUP = re.compile(r"\\(?:mathrm|mathit|mathbf|bar|hat|tilde|dot|vec|left|right|,)(?![a-z])|[{}_^$]")
_COMMAND = re.compile(r"\\[A-Za-z]+")
# Characters of Unicode for private use, so in no text: a formula while its text is broken into lines, as long
# as its letters, and a space at which no line ends.
_FORMULA_BEGIN, _FORMULA_LETTER, _NO_BREAK = "\ue000", "\ue001", "\ue002"


def points(size: float) -> float:
    """A font size in the theme, larger or smaller if the user's `font.size` is."""
    return size * mpl.rcParams["font.size"] / POINTS


def wrapped(text: str, inches: float, size: float) -> str:
    """A text in lines that fit a width, at a font size of the theme.

    No line ends in a formula, before the unit behind one, or beside a sign of equality.
    """
    letters = max(int(inches * 72 / (_LETTER * points(size))), _LEAST_LETTERS)
    formulas = iter(_FORMULA.findall(text))
    unbroken = _FORMULA.sub(_stand_in, text).replace(" = ", f"{_NO_BREAK}={_NO_BREAK}")
    unbroken = re.sub(f"(?<=[{_FORMULA_BEGIN}{_FORMULA_LETTER}]) [(]", f"{_NO_BREAK}(", unbroken)
    lines = [textwrap.fill(line, letters, break_long_words=False) for line in unbroken.split("\n")]
    with_spaces = "\n".join(lines).replace(_NO_BREAK, " ")
    return re.sub(f"{_FORMULA_BEGIN}{_FORMULA_LETTER}*", lambda _: next(formulas), with_spaces)


def _stand_in(formula: re.Match[str]) -> str:
    """Characters as many as the letters of a formula, at least one."""
    letters = len(_COMMAND.sub("x", _MARKUP.sub("", formula[0])))
    return _FORMULA_BEGIN + _FORMULA_LETTER * (letters - 1)


def centre_shared_label(figure: Figure) -> None:
    """Move the label that rows of panels share to their middle, in lines no longer than they are high."""
    label = getattr(figure, "_supylabel")  # noqa: B009 - Matplotlib has no public name for it
    if label is None:
        return
    figure.draw_without_rendering()
    positions = [axes.get_position() for axes in figure.axes]
    low = min(position.y0 for position in positions)
    high = max(position.y1 for position in positions)
    label.set_y(0.5 * (low + high))
    size = float(label.get_fontsize()) / points(1.0)
    label.set_text(wrapped(label.get_text(), (high - low) * figure.get_figheight(), size))


def check_height(figure: Figure, natural: float) -> None:
    """Refuse the height of a figure at which a panel has no room.

    Args:
        figure: that of `canvas`, with the height of its style.
        natural: its height without a style, inches, at which all panels have room.

    Raises:
        PlotError: a panel has no room; the message has the least height.
    """
    requested = figure.get_figheight() * INCH
    least = requested
    figure.set_figheight(natural)
    enough = np.minimum(_LEAST_PANEL / INCH, _LEAST_SHARE_OF_NATURAL * _panel_heights(figure))
    figure.set_figheight(requested / INCH)
    while (_panel_heights(figure) < enough).any():
        if least >= _HIGHEST:
            raise PlotError(
                f"height is {requested:g} mm, but this figure needs more than {least:g} mm: make it "
                "wider or draw fewer panels."
            )
        least = _HEIGHT_STEP * (least // _HEIGHT_STEP + 1.0)
        figure.set_figheight(least / INCH)
    if least > requested:
        raise PlotError(f"height is {requested:g} mm, but this figure needs at least {least:g} mm.")


def _panel_heights(figure: Figure) -> Float[np.ndarray, " panels"]:
    """The heights of panels in inches, (n,); all are 0 if the layout gives one of them no room."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        figure.draw_without_rendering()
    panels = [axes for axes in figure.axes if axes.get_label() != "<colorbar>"]
    heights = np.array([axes.get_position().height for axes in panels]) * figure.get_figheight()
    collapsed = any(re.match(COLLAPSED, str(warning.message)) for warning in caught)
    return np.zeros_like(heights) if collapsed else heights


def titles_of(axes: Axes) -> list[Text]:
    """The titles of a panel that have a text."""
    # Matplotlib has no public names for titles at the sides
    titles = [axes.title, *(vars(axes)[f"_{side}_title"] for side in ("left", "right"))]
    return [title for title in titles if title.get_text()]


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
        beside = min(_OVERHANG * figure.dpi, panel.x0, figure.bbox.width - panel.x1, _SHARE_OF_GAP * gap)
        overhang = 2.0 * max(beside, 0.0)  # at both sides
        titles = titles_of(axes)
        for text in (axes.xaxis.label, axes.yaxis.label, *titles):
            box = text.get_window_extent(renderer)
            vertical = text is axes.yaxis.label
            length = box.height if vertical else box.width
            room = panel.height if vertical else panel.width + overhang
            if text.get_text() and length > room:
                lines = text.get_text() if text in titles else text.get_text().replace("\n", " ")
                text.set_text(wrapped(lines, room / figure.dpi, float(text.get_fontsize()) / points(1.0)))
