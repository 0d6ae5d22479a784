"""Even selection of the rows of a large table for its figures, which name the selection."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

# Rows of a table of which all are shown; a page has fewer distinguishable points.
MOST_SHOWN = 2_000_000


@dataclasses.dataclass(frozen=True)
class Thinned:
    """The rows (n,) that a figure shows, in rising order, and a remark on them."""

    rows: np.ndarray
    remark: str


def thinned(manifest: Mapping[str, Any], most: int = MOST_SHOWN) -> Thinned | None:
    """Select the rows that figures of a table show, at most `most`; None if they show all.

    The longest axes are thinned: of a grid, every n-th point; of a sample, its first points, since
    every n-th of a Sobol sequence may lie in one half of an axis.

    Args:
        manifest: that of the table; a table without axes is not thinned.
        most: the largest number of rows.
    """
    axes: Sequence[Mapping[str, Any]] = manifest.get("axes", ())
    if manifest["rows"] <= most or math.prod(axis["length"] for axis in axes) != manifest["rows"]:
        return None
    steps = [1] * len(axes)
    while math.prod(_shown(axis, step) for axis, step in zip(axes, steps, strict=True)) > most:
        longest = max(range(len(axes)), key=lambda at: _shown(axes[at], steps[at]))
        # odd steps, so that the points of a grid of cells are the middles of larger cells
        steps[longest] += 2
    rows = np.zeros(1, np.int64)
    thinned_names: dict[str, list[str]] = {}
    for axis, step in zip(axes, steps, strict=True):
        shown = np.arange(_shown(axis, step))
        points = shown if axis["drawn"] else shown * step + step // 2
        rows = (rows[:, None] * axis["length"] + points[None, :]).ravel()
        if step > 1:
            which = f"the first {shown.size} of" if axis["drawn"] else f"every {_ordinal(step)}"
            thinned_names.setdefault(which, []).extend(axis["names"])
    text = "; ".join(f"{which} {', '.join(names)}" for which, names in thinned_names.items())
    return Thinned(rows, f"{rows.size} of {manifest['rows']} rows: {text}")


def _shown(axis: Mapping[str, Any], step: int) -> int:
    """The number of points of an axis that are shown."""
    length = axis["length"]
    return max(length // step, 1) if axis["drawn"] else len(range(step // 2, length, step)) or 1


def _ordinal(number: int) -> str:
    ending = "th" if number % 100 in (11, 12, 13) else {1: "st", 2: "nd", 3: "rd"}.get(number % 10, "th")
    return f"{number}{ending}"
