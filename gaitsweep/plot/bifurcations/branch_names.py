"""Names of gaits beside the branches of a figure, where there is room."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd
from jaxtyping import Float, Shaped
from matplotlib.axes import Axes
from matplotlib.transforms import Bbox

from gaitsweep.plot import theme
from gaitsweep.status import Outcome

_LEAST_SHARE = 0.02  # of the records that a gait with a name has
_PLACES = 15  # along a branch at which room is looked for
_OFFSET = 4.0  # points: least distance of a name from its branch
_CLEARANCE = 2.0  # points: least distance of a name from other lines
_STEP = 2.0  # pixels: distance of the points by which lines are represented


def named_gaits(table: pd.DataFrame, without: Sequence[str] = ()) -> list[str]:
    """The gaits of a table's records that are more than a few, besides some."""
    if "gait" not in table.columns:
        return []
    shares = table["gait"].astype(str).value_counts(normalize=True)
    names = [str(name) for name, share in shares.items() if share >= _LEAST_SHARE]
    return theme.ordered(name for name in names if name not in (Outcome.NO_GAIT, *without))


def name_branches(
    axes: Axes,
    at: Float[np.ndarray, " records"],
    value: Float[np.ndarray, " records"],
    gaits: Shaped[np.ndarray, " records"],
) -> list[str]:
    """Write the name of each gait beside its records; returns those for which there is no room.

    Args:
        axes: a panel with a layout and all of its lines.
        at, value: places of the records, (n,).
        gaits: the gait of each record, (n,).
    """
    ink = _ink(axes)
    taken = [patch.get_window_extent() for patch in axes.patches if patch.get_alpha() is None]
    marked = (line for line in axes.lines if line.get_marker() not in (None, "None", ""))
    apart = max([_CLEARANCE, *(0.5 * float(line.get_markersize()) + 0.5 for line in marked)])
    without = []
    for gait in dict.fromkeys(gaits.tolist()):
        records = np.flatnonzero(gaits == gait)
        records = records[np.argsort(at[records], kind="stable")]
        middle_first = sorted(np.linspace(0.0, 1.0, _PLACES), key=lambda share: abs(share - 0.5))
        places = [records[round(share * (len(records) - 1))] for share in middle_first]
        if not any(
            _fits(axes, gait, (float(at[k]), float(value[k])), side, apart, ink, taken)
            for k in places
            for side in (1, -1)
        ):
            without.append(gait)
    return without


def _fits(
    axes: Axes,
    gait: str,
    at: tuple[float, float],
    side: int,
    apart: float,
    ink: Float[np.ndarray, "points 2"],
    taken: list[Bbox],
) -> bool:
    """Write a name above or below a place; False, and no name, if anything is within `apart` points."""
    look: dict[str, Any] = {"ha": "center", "va": "bottom" if side > 0 else "top", "color": "#333333"}
    text = axes.annotate(
        theme.named(gait),
        at,
        (0.0, side * max(_OFFSET, apart + 1.5)),
        textcoords="offset points",
        fontsize=theme.points(7),
        **look,
    )
    box, panel = text.get_window_extent(), axes.get_window_extent()
    inside = panel.x0 <= box.x0 and box.x1 <= panel.x1 and panel.y0 <= box.y0 and box.y1 <= panel.y1
    around = box.padded(apart * axes.figure.dpi / 72)
    meets = ((ink >= around.min) & (ink <= around.max)).all(axis=1).any() or any(map(around.overlaps, taken))
    if not inside or meets:
        text.remove()
        return False
    taken.append(box)
    return True


def _ink(axes: Axes) -> Float[np.ndarray, "points 2"]:
    """Points (n, 2) along all lines and markers of a panel, in pixels."""
    points = [np.empty((0, 2))]
    for line in axes.lines:
        ends = line.get_transform().transform(np.asarray(line.get_xydata(), float))
        points.append(ends)
        if line.get_linestyle() != "None":
            for a, b in itertools.pairwise(ends):
                far = float(np.hypot(*(b - a)))
                if np.isfinite(far) and far > _STEP:
                    points.append(np.linspace(a, b, int(far / _STEP) + 1))
    return np.concatenate(points)
