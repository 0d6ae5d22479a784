"""Lines, marks and legends of branches of gaits, stable and unstable, in figures over a parameter."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import Any, Literal, TypeVar

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.colors import to_rgba
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from gaitsweep.analysis.continuation.stable_ranges import MARKS
from gaitsweep.angles import unwrap_from
from gaitsweep.plot import theme

STABLE, UNSTABLE = "#0072B2", "#D55E00"
# fill and hatch of the ranges beside the branches, in order
_RANGES = (("#E2E2E2", "////"), ("#F3E3C3", "\\\\\\\\"), ("#DCEBDD", "...."), ("#E9DDEC", "----"))
MARKERS: dict[str, str] = dict(zip(MARKS, "ovsDX><^h", strict=True))
WORDS = {
    "corner": "fold at a bend of the map",
    "neimark_sacker": "Neimark-Sacker",
    "supercritical_pitchfork": "supercritical pitchfork",
    "subcritical_pitchfork": "subcritical pitchfork",
    "branch_point": "branch point",
    "hopf": "Hopf",
}
Piece = Literal["stable", "unstable", "kink"]  # what a line between two points of a branch shows
Look = TypeVar("Look")


def draw_branch(
    axes: Axes,
    branch: pd.DataFrame,
    x: str,
    y: str,
    colour: Any,
    *,
    origin: float | None,
    stable_width: float = 1.4,
) -> None:
    """Draw one branch: its pieces, solid, dashed or dotted, and its bifurcations.

    Args:
        axes: the panel.
        branch: the points of the branch in their order, with the columns of a continuation's table.
        x, y: the columns along the axes.
        colour: that of its lines; None: the colours of stable and unstable gaits.
        origin: the angle (rad) at which the axis y cuts the circle, where lines end; None if y is no angle.
        stable_width: width of the line where the branch is stable, in points.
    """
    at, value = branch[x].to_numpy(float), unwrap_from(branch[y].to_numpy(float), origin)
    special = branch["special"].fillna("").to_numpy(str)
    absent = np.diff(branch["point"].to_numpy(int)) > 1  # no line across a point that the table lacks
    looks: dict[Piece, dict[str, Any]] = {
        "stable": {"color": colour or STABLE, "ls": "-", "lw": stable_width},
        "unstable": {"color": colour or UNSTABLE, "ls": (0, (4, 2)), "lw": 1.4},
        "kink": {"color": colour or "#555555", "ls": ":", "lw": 0.8},
    }
    for (piece, missing), part in stretches(zip(pieces(branch), absent, strict=True)):
        if missing:
            continue
        over_the_cut = (np.abs(np.diff(value[part])) > np.pi) & (origin is not None)
        axes.plot(*theme.interrupted(over_the_cut, at[part], value[part]), zorder=2, **looks[piece])
    for kind, mark in MARKERS.items():
        marked = special == kind
        axes.plot(at[marked], value[marked], mark, ms=4.5, color="black", mfc="white", zorder=3)


def stretches(looks: Iterable[Look]) -> Iterator[tuple[Look, slice]]:
    """Each stretch of equal looks, with its places and the first place after them."""
    begin = 0
    for look, equal in itertools.groupby(looks):
        end = begin + len(list(equal))
        yield look, slice(begin, end + 1)
        begin = end


def pieces(branch: pd.DataFrame) -> list[Piece]:
    """The pieces between the points of a branch: stable, unstable, or over a kink of the map.

    The stability of a piece is that of its end that is no bifurcation.
    """
    special = branch["special"].fillna("").to_numpy(str)
    stable = branch["stable"].to_numpy(bool)
    bifurcates = np.isin(special, list(MARKERS))
    are_stable = np.where(bifurcates[:-1], stable[1:], stable[:-1])
    of_branch: list[Piece] = ["stable" if is_stable else "unstable" for is_stable in are_stable]
    return ["kink" if end == "kink" else piece for end, piece in zip(special[1:], of_branch, strict=True)]


def key(
    table: pd.DataFrame,
    beside: Mapping[str, Sequence[float]] = MappingProxyType({}),
    *,
    coloured: bool,
    stable_width: float = 1.4,
) -> list[Line2D | Patch]:
    """The legend of branches.

    Args:
        table: the records of the branches.
        beside: ranges (low, high) that are shown beside the branches, by name.
        coloured: whether branches are coloured by another column, so that lines are grey in the legend.
        stable_width: width of the line where a branch is stable, in points.
    """
    stable = table["stable"].to_numpy(bool)
    handles: list[Line2D | Patch] = []
    if stable.any():
        colour = "#333333" if coloured else STABLE
        handles.append(Line2D([], [], color=colour, lw=stable_width, label="stable"))
    if not stable.all():
        colour = "#333333" if coloured else UNSTABLE
        handles.append(Line2D([], [], color=colour, lw=1.4, ls=(0, (4, 2)), label="unstable"))
    special = set(table["special"].fillna(""))
    if "kink" in special:
        label = "over a bend or jump of the map"
        handles.append(Line2D([], [], color="#555555", lw=0.8, ls=":", label=label))
    handles += [
        Line2D([], [], ls="", marker=mark, ms=4.5, color="black", mfc="white", label=WORDS.get(kind, kind))
        for kind, mark in MARKERS.items()
        if kind in special
    ]
    handles += [Patch(label=name, **style_of_range(number)) for number, name in enumerate(beside)]
    pairs = itertools.combinations(beside.values(), 2)
    if any(max(low, begin) < min(high, end) for (low, high), (begin, end) in pairs):
        look: dict[str, Any] = {"facecolor": "none", "edgecolor": "#9A9A9A", "hatch": "xxxx", "lw": 0.5}
        handles.append(Patch(label="both of these", **look))
    return handles


def style_of_range(number: int) -> dict[str, Any]:
    """The style of the range with this number: translucent, so that overlaps are visible."""
    face, hatch = _RANGES[number % len(_RANGES)]
    return {"facecolor": to_rgba(face, 0.5), "edgecolor": "#9A9A9A", "hatch": hatch, "linewidth": 0.5}
