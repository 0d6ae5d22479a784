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

_LEAST_SHARE = 0.02  # of all records: a gait with fewer has no name
_PLACES = 15  # records of a branch beside which room is looked for
_OFFSET = 4.0  # points: least distance of a name from its branch
_CLEARANCE = 2.0  # points: least distance of a name from other lines
_STEP = 2.0  # pixels: distance of the points by which lines are represented


def named_gaits(table: pd.DataFrame, without: Sequence[str] = ()) -> list[str]:
    """The gaits that more than a few of a table's records have, `without` some."""
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
    boxes = [patch.get_window_extent() for patch in axes.patches if patch.get_alpha() is None]
    with_markers = (line for line in axes.lines if line.get_marker() not in (None, "None", ""))
    clearance = max([_CLEARANCE, *(0.5 * float(line.get_markersize()) + 0.5 for line in with_markers)])
    middle_first = sorted(np.linspace(0.0, 1.0, _PLACES), key=lambda share: abs(share - 0.5))
    without_room = []
    for gait in dict.fromkeys(gaits.tolist()):
        records = np.flatnonzero(gaits == gait)
        records = records[np.argsort(at[records], kind="stable")]
        for share, above in itertools.product(middle_first, (True, False)):
            record = records[round(share * (len(records) - 1))]
            point = (float(at[record]), float(value[record]))
            box = _write_name(axes, gait, point, clearance, ink, boxes, above=above)
            if box is not None:
                boxes.append(box)
                break
        else:
            without_room.append(gait)
    return without_room


def _write_name(
    axes: Axes,
    gait: str,
    point: tuple[float, float],
    clearance: float,
    ink: Float[np.ndarray, "points 2"],
    boxes: Sequence[Bbox],
    *,
    above: bool,
) -> Bbox | None:
    """Write a name above or below a point; returns its box, or None, and writes no name, without room.

    Args:
        axes: the panel.
        gait: the gait that is named.
        point: coordinates of a record of the gait.
        clearance: least distance of the name from `ink` (pixels) and `boxes`, in points.
        ink: points of all lines.
        boxes: boxes of other names and of patches.
        above: whether the name is above the point.
    """
    offset = max(_OFFSET, clearance + 1.5)
    look: dict[str, Any] = {"ha": "center", "va": "bottom" if above else "top", "color": "#333333"}
    text = axes.annotate(
        theme.named(gait),
        point,
        (0.0, offset if above else -offset),
        textcoords="offset points",
        fontsize=theme.points(7),
        **look,
    )
    box, panel = text.get_window_extent(), axes.get_window_extent()
    inside = panel.x0 <= box.x0 and box.x1 <= panel.x1 and panel.y0 <= box.y0 and box.y1 <= panel.y1
    around = box.padded(clearance * axes.figure.dpi / 72)
    over_ink = ((ink >= around.min) & (ink <= around.max)).all(axis=1).any()
    if inside and not over_ink and not any(map(around.overlaps, boxes)):
        return box
    text.remove()
    return None


def _ink(axes: Axes) -> Float[np.ndarray, "points 2"]:
    """Points (n, 2) along all lines and markers of a panel, in pixels."""
    points = [np.empty((0, 2))]
    for line in axes.lines:
        ends = line.get_transform().transform(np.asarray(line.get_xydata(), float))
        points.append(ends)
        if line.get_linestyle() != "None":
            for begin, end in itertools.pairwise(ends):
                length = float(np.hypot(*(end - begin)))
                if np.isfinite(length) and length > _STEP:
                    points.append(np.linspace(begin, end, int(length / _STEP) + 1))
    return np.concatenate(points)
