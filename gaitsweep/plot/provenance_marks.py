"""Remarks on figures whose table is incomplete or thinned, or whose run's self-check warned."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import pandas as pd

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_BAND = 0.2  # inches; height of the band added on top of the figure
_TITLE = 0.22  # inches; height of the title
_LOOK: dict[str, Any] = {"fontsize": 7.5, "color": "#B00020", "weight": "bold", "ha": "right", "va": "center"}


def remarks(table: pd.DataFrame) -> list[str]:
    """The remarks on a table, such as `incomplete: 812 of 1000 rows`.

    Read from `table.attrs`: `complete`, `rows_missing`, `thinned` and the manifest's `rows` and `self_check`.
    """
    manifest = table.attrs.get("manifest")
    manifest = manifest if isinstance(manifest, Mapping) else {}
    found = []
    if table.attrs.get("complete", True) is False:
        there = _rows_there(table, manifest)
        rows = manifest.get("rows")
        found.append("incomplete" if there is None else f"incomplete: {there} of {rows} rows")
    if "thinned" in table.attrs:
        found.append(str(table.attrs["thinned"]))
    check = manifest.get("self_check")
    if isinstance(check, Mapping) and check.get("verdict") == "warned":
        found.append("self-check: warned")
    return found


def _rows_there(table: pd.DataFrame, manifest: Mapping[str, Any]) -> int | None:
    """The number of the job's rows in the table; None if the table does not give it."""
    rows, missing = manifest.get("rows"), table.attrs.get("rows_missing")
    if not isinstance(rows, int):
        return None
    if isinstance(missing, int):
        return rows - missing
    if missing is not None and hasattr(missing, "__len__"):
        return rows - len(missing)
    # a selection of rows is no evidence, unless the table has all rows so far
    there = len(table["row"].unique()) if "row" in table.columns else rows
    return there if there < rows else None


def mark(figure: Figure, notes: list[str]) -> None:
    """Write remarks into the upper right corner of a figure, in an added band."""
    text = "; ".join(notes)
    if not notes or text in (each.get_text() for each in figure.texts):  # one figure may draw another
        return
    width, height = figure.get_size_inches()
    share = _BAND / (height + _BAND)
    figure.set_size_inches(width, height + _BAND)
    taken = share
    title = getattr(figure, "_suptitle", None)
    if title is not None:  # the layout would move the title into the band, so it is placed below by hand
        title.set_y(1.0 - share)
        title.set_in_layout(False)
        title._autopos = False
        taken += _TITLE / (height + _BAND)
    engine = figure.get_layout_engine()
    if engine is not None:
        engine.set(rect=(0.0, 0.0, 1.0, 1.0 - taken))  # pyright: ignore[reportCallIssue]
    figure.text(1.0 - 0.05 / width, 1.0 - 0.5 * share, text, **_LOOK)
