"""Marks on finished figures: letters of panels, and remarks on a table that is incomplete or doubtful."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import pandas as pd

from gaitsweep.plot.columns import PlotError
from gaitsweep.plot.figure_style import current
from gaitsweep.table.manifest import BY_STEP, BY_STEP_WORDS, DIFFERENCES, self_check_warned

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.text import Annotation

_BAND = 0.2  # inches: height of the band added on top of the figure, with one line of remarks
_LINE = 0.13  # inches: height of each further line
_MARGIN = 0.05  # inches: between the remarks and the figure's right edge
_BOLD = 1.15  # width of bold letters, in widths of usual ones
_TITLE, _TITLE_LINE = 0.22, 0.16  # inches: height of the title, and of each further line
_LETTERED = "panel with its letter"
STRIP = "<strip>"  # the label of axes that belong to the panel above them, whose letter they have
_SIZE = 7.5  # pt, of remarks
_LOOK: dict[str, Any] = {"fontsize": _SIZE, "color": "#B00020", "weight": "bold", "ha": "right"}


def remarks(table: pd.DataFrame) -> list[str]:
    """The remarks on a table, such as `incomplete: 812 of 1000 rows`.

    Read from `table.attrs`: `complete`, `rows_missing`, `thinned` and the manifest's `rows` and `self_check`.
    """
    manifest = table.attrs.get("manifest")
    manifest = manifest if isinstance(manifest, Mapping) else {}
    notes = []
    if table.attrs.get("complete", True) is False:
        rows = _rows_so_far(table, manifest)
        notes.append("incomplete" if rows is None else f"incomplete: {rows} of {manifest.get('rows')} rows")
    if "thinned" in table.attrs:
        notes.append(str(table.attrs["thinned"]))
    check = manifest.get("self_check")
    if isinstance(check, Mapping) and (self_check_warned(check) or check.get(BY_STEP)):
        notes.append(f"self-check: {_differences(check)}")
    return notes


def _differences(check: Mapping[str, Any]) -> str:
    """Differences that a self-check found, such as `2 of 32 rows change gait`."""
    of_rows = f"of {check.get('rows', 0)} rows"
    marks = {**DIFFERENCES, BY_STEP: BY_STEP_WORDS}
    texts = [f"{check[name]} {of_rows} {words.mark}" for name, words in marks.items() if check.get(name)]
    return ", ".join(texts) or "warned"


def _rows_so_far(table: pd.DataFrame, manifest: Mapping[str, Any]) -> int | None:
    """The number of the job's rows in the table; None if the table does not give it."""
    rows = manifest.get("rows")
    missing = table.attrs.get("rows_missing")
    if not isinstance(rows, int):
        return None
    if isinstance(missing, int):
        return rows - missing
    # a selection of rows is no evidence, unless the table has all rows so far
    present = len(table["row"].unique()) if "row" in table.columns else rows
    return present if present < rows else None


def _letter(number: int) -> str:
    """The letter of a panel: a to z, then aa to az, ba and so on."""
    turn, place = divmod(number, 26)
    last = chr(ord("a") + place)
    return _letter(turn - 1) + last if turn else last


def letter_panels(axes_of_figure: Sequence[Axes], letters: Sequence[str] | bool) -> None:
    """Write letters above the left corner of each panel: the given ones, else a, b, c, ...

    One letter that is given for several panels is that of the whole figure, at its top left corner.

    Raises:
        PlotError: there are fewer letters than panels.
    """
    skipped = ("<colorbar>", STRIP, _LETTERED)  # one figure may draw another
    panels = [axes for axes in axes_of_figure if axes.get_visible() and axes.get_label() not in skipped]
    if not isinstance(letters, Sequence):
        letters = [_letter(number) for number in range(len(panels))]
    if len(letters) == 1 < len(panels):
        _letter_figure(panels, letters[0])
        return
    if len(letters) < len(panels):
        raise PlotError(f"panel_letters has {len(letters)} letters, but the figure has {len(panels)} panels.")
    look: dict[str, Any] = {"xycoords": "axes fraction", "textcoords": "offset points", "weight": "bold"}
    written = []
    for axes, letter in zip(panels, letters, strict=False):
        written.append(axes.annotate(letter, (0.0, 1.0), (-4, 3), ha="right", va="bottom", **look))
        axes.set_label(_LETTERED)
    if written:
        _avoid_titles(panels, written)


def _letter_figure(panels: Sequence[Axes], letter: str) -> None:
    """Write the letter of a whole figure at its top left corner, above what stands there."""
    from gaitsweep.plot.figure_layout import titles_of  # jobs are read without Matplotlib

    figure = panels[0].get_figure(root=True)
    assert figure is not None
    look: dict[str, Any] = {"weight": "bold", "ha": "left", "va": "top"}
    width, height = figure.get_size_inches()
    written = figure.text(_MARGIN / width, 1.0 - _MARGIN / height, letter, **look)
    figure.draw_without_rendering()
    box = written.get_window_extent()
    title = getattr(figure, "_suptitle", None)
    texts = [title] if title is not None else []
    for axes in panels:
        texts += [*titles_of(axes), axes.yaxis.label, *axes.get_yticklabels()]
    if any(text.get_text() and box.overlaps(text.get_window_extent()) for text in texts):
        _add_band(figure, box.height / figure.dpi + _MARGIN)
        written.set_y(1.0 - _MARGIN / figure.get_figheight())
    for axes in panels:
        axes.set_label(_LETTERED)


def _avoid_titles(panels: Sequence[Axes], letters: Sequence[Annotation]) -> None:
    """Move the letters of panels above their titles if one of them lies over a title."""
    from gaitsweep.plot.figure_layout import titles_of

    titles = [titles_of(axes) for axes in panels]
    figure = panels[0].get_figure(root=True)
    if figure is None or not any(titles):
        return
    figure.draw_without_rendering()
    boxes = [[title.get_window_extent() for title in of_panel] for of_panel in titles]
    # by which boxes of texts may overlap in height, whose letters do not touch, and must be apart in width
    spare = 1.5 * figure.dpi / 72
    if not any(
        box.overlaps(letter.get_window_extent().padded(spare, -spare))
        for of_panel, letter in zip(boxes, letters, strict=True)
        for box in of_panel
    ):
        return
    for axes, of_panel, letter in zip(panels, boxes, letters, strict=True):
        top = max((box.y1 for box in of_panel), default=axes.bbox.y1)
        letter.set_position((-4, 3 + 72 * (top - axes.bbox.y1) / figure.dpi))
    if current().height is None:
        rows = {round(axes.get_position().y1, 2) for axes in panels}
        figure.set_figheight(figure.get_figheight() + _LINE * len(rows))


def mark(figure: Figure | Axes, notes: list[str]) -> None:
    """Write remarks above the right corner of a panel, or of a figure, in an added band."""
    text = "; ".join(notes)
    written = (" ".join(label.get_text().split()) for label in figure.texts)
    if not notes or text in written:  # one figure may draw another
        return
    from matplotlib.figure import Figure  # jobs are read without Matplotlib

    from gaitsweep.plot.figure_layout import wrapped

    if not isinstance(figure, Figure):
        figure.text(1.0, 1.0, text, transform=figure.transAxes, va="bottom", **_LOOK)
        return
    width, height = figure.get_size_inches()
    text = wrapped(text, width - 2.0 * _MARGIN, _BOLD * _SIZE)
    added = _BAND + _LINE * text.count("\n")
    _add_band(figure, added)
    figure.text(1.0 - _MARGIN / width, 1.0 - 0.5 * added / (height + added), text, va="center", **_LOOK)


def _add_band(figure: Figure, added: float) -> None:
    """Make a figure higher by a band of so many inches above its title and panels."""
    width, height = figure.get_size_inches()
    figure.set_size_inches(width, height + added)
    above_panels = added
    title = getattr(figure, "_suptitle", None)
    if title is not None:  # the layout would move the title into the band, so it is placed below by hand
        title.set_y(1.0 - added / (height + added))
        title.set_in_layout(False)
        title._autopos = False
        above_panels += _TITLE + _TITLE_LINE * title.get_text().count("\n")
    engine = figure.get_layout_engine()
    if engine is not None:
        left, low, share_of_width, _ = engine.get()["rect"]
        top = 1.0 - above_panels / (height + added)
        engine.set(rect=(left, low, share_of_width, top))  # pyright: ignore[reportCallIssue]
