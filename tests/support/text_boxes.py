"""The texts of a figure as a reader sees them: cut, over each other, or too small."""

from __future__ import annotations

import itertools
from collections.abc import Iterator

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.text import Text
from matplotlib.transforms import Bbox

LEAST = 7.0  # points, of a font
OVERLAP = (0.5, 1.5)  # points, across and up, by which two boxes may overlap: their letters do not touch


def text_problems(figure: Figure) -> list[str]:
    """What is wrong with the texts of a figure: `cut: ...`, `overlap: ... / ...`, `6.5 pt: ...`."""
    figure.draw_without_rendering()
    boxes, point = list(_boxes(figure)), figure.dpi / 72
    page = Bbox.from_extents(-point, -point, figure.bbox.width + point, figure.bbox.height + point)
    found = [f"{text.get_fontsize():.3g} pt: {text.get_text()}" for text, _ in boxes
             if float(text.get_fontsize()) < LEAST - 0.01]  # fmt: skip
    found += [f"cut: {text.get_text()}" for text, box in boxes if not _inside(box, page)]
    for (one, here), (other, there) in itertools.combinations(boxes, 2):
        across = min(here.x1, there.x1) - max(here.x0, there.x0)
        up = min(here.y1, there.y1) - max(here.y0, there.y0)
        if across > OVERLAP[0] * point and up > OVERLAP[1] * point:
            found.append(f"overlap: {one.get_text()} / {other.get_text()}")
    return found


def _inside(box: Bbox, page: Bbox) -> bool:
    return page.x0 <= box.x0 and page.y0 <= box.y0 and box.x1 <= page.x1 and box.y1 <= page.y1


def _boxes(figure: Figure) -> Iterator[tuple[Text, Bbox]]:
    """The texts that are shown, with their boxes in pixels."""
    hidden: set[int] = set()
    every = [*figure.axes, *(child for axes in figure.axes for child in axes.child_axes)]
    for axes in every:
        hidden |= set(map(id, _not_shown(axes)))
    for text in figure.findobj(Text):
        assert isinstance(text, Text)
        if id(text) not in hidden and text.get_visible() and text.get_text().strip():
            yield text, text.get_window_extent()


def _not_shown(axes: Axes) -> Iterator[Text]:
    """Texts that Matplotlib keeps but does not draw; texts in space, whose boxes are those of no projection."""
    if not axes.get_visible():
        yield from axes.findobj(Text)  # pyright: ignore[reportReturnType] - of this class
    if hasattr(axes, "zaxis"):
        yield from axes.texts
    for axis in (axes.xaxis, axes.yaxis, *([axes.zaxis] if hasattr(axes, "zaxis") else [])):  # pyright: ignore[reportAttributeAccessIssue]
        shown = axis._update_ticks() if axes.axison else []
        for tick in {*axis.get_major_ticks(), *axis.get_minor_ticks()} - set(shown):
            yield from (tick.label1, tick.label2)
