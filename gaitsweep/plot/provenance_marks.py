"""Marks on figures of tables that are not complete, or whose run's self-check warned."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from typing import Any, ParamSpec

import pandas as pd
from matplotlib.figure import Figure

_BAND = 0.2  # inches, added to the figure above all else
_TITLE = 0.22  # inches that its title takes
_LOOK: dict[str, Any] = {"fontsize": 7.5, "color": "#B00020", "weight": "bold", "ha": "right", "va": "center"}
Spec = ParamSpec("Spec")


def remarks(table: pd.DataFrame) -> list[str]:
    """What has to be known of a table beside what a figure shows: `incomplete: 812 of 1000 rows`.

    Read from `table.attrs`: `complete`, `rows_missing` and the manifest's `rows` and `self_check`.
    """
    manifest = table.attrs.get("manifest")
    manifest = manifest if isinstance(manifest, Mapping) else {}
    found = []
    if table.attrs.get("complete", True) is False:
        there = _rows_there(table, manifest)
        rows = manifest.get("rows")
        found.append("incomplete" if there is None else f"incomplete: {there} of {rows} rows")
    check = manifest.get("self_check")
    if isinstance(check, Mapping) and check.get("verdict") == "warned":
        found.append("self-check: warned")
    return found


def _rows_there(table: pd.DataFrame, manifest: Mapping[str, Any]) -> int | None:
    """How many rows of the job the table was loaded with; None where it does not say so."""
    rows, missing = manifest.get("rows"), table.attrs.get("rows_missing")
    if not isinstance(rows, int):
        return None
    if isinstance(missing, int):
        return rows - missing
    if missing is not None and hasattr(missing, "__len__"):
        return rows - len(missing)
    # of a part of the table nothing could be said, but where all rows that are there are in it
    there = len(table["row"].unique()) if "row" in table.columns else rows
    return there if there < rows else None


def mark(figure: Figure, told: list[str]) -> None:
    """Write remarks into the upper right corner of a figure, in a band that is added for them."""
    if not told:
        return
    width, height = figure.get_size_inches()
    share = _BAND / (height + _BAND)
    figure.set_size_inches(width, height + _BAND)
    taken = share
    title = getattr(figure, "_suptitle", None)
    if title is not None:  # the layout would put it into the band, so it is put below it by hand
        title.set_y(1.0 - share)
        title.set_in_layout(False)
        title._autopos = False
        taken += _TITLE / (height + _BAND)
    engine = figure.get_layout_engine()
    if engine is not None:
        engine.set(rect=(0.0, 0.0, 1.0, 1.0 - taken))  # pyright: ignore[reportCallIssue]
    figure.text(1.0 - 0.05 / width, 1.0 - 0.5 * share, "; ".join(told), **_LOOK)


def marked(figure_of: Callable[Spec, Figure]) -> Callable[Spec, Figure]:
    """A function from a table to a figure, whose figures bear the table's remarks."""

    @functools.wraps(figure_of)
    def with_marks(*args: Spec.args, **spec: Spec.kwargs) -> Figure:
        figure = figure_of(*args, **spec)
        table = args[0] if args else spec.get("table")
        if isinstance(table, pd.DataFrame):
            mark(figure, remarks(table))
        return figure

    return with_marks
