"""Lines, marks and legends of branches of gaits, stable and unstable, in figures over a parameter."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import Any, TypeVar

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
T = TypeVar("T")


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
    for (kind, missing), part in stretches(zip(looks_of_pieces(branch), absent, strict=True)):
        if missing:
            continue
        look: dict[str, Any] = {"zorder": 2, "lw": 1.4}
        if kind == "kink":
            look |= {"color": colour or "#555555", "ls": ":", "lw": 0.8}
        else:
            look |= {"color": colour or (STABLE if kind else UNSTABLE), "ls": "-" if kind else (0, (4, 2))}
            look["lw"] = stable_width if kind else 1.4
        over_the_cut = (np.abs(np.diff(value[part])) > np.pi) & (origin is not None)
        axes.plot(*theme.interrupted(over_the_cut, at[part], value[part]), **look)
    for kind, mark in MARKERS.items():
        marked = special == kind
        axes.plot(at[marked], value[marked], mark, ms=4.5, color="black", mfc="white", zorder=3)


def stretches(looks: Iterable[T]) -> Iterator[tuple[T, slice]]:
    """Each stretch of equal looks, with its places and the first place after them."""
    begin = 0
    for look, equal in itertools.groupby(looks):
        end = begin + len(list(equal))
        yield look, slice(begin, end + 1)
        begin = end


def looks_of_pieces(branch: pd.DataFrame) -> list[str | bool]:
    """Whether each piece between two points of a branch is stable, or "kink".

    The stability of a piece is that of its end that is no bifurcation.
    """
    special = branch["special"].fillna("").to_numpy(str)
    stable, plain = branch["stable"].to_numpy(bool), ~np.isin(special, list(MARKERS))
    return [
        "kink" if special[k + 1] == "kink" else bool(stable[k] if plain[k] else stable[k + 1])
        for k in range(len(special) - 1)
    ]


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
        beside: ranges that are shown beside the branches, by name.
        coloured: whether branches are coloured by another column, so that lines are grey in the legend.
        stable_width: width of the line where a branch is stable, in points.
    """
    stable = table["stable"].to_numpy(bool)
    of_stable, of_unstable = ("#333333", "#333333") if coloured else (STABLE, UNSTABLE)
    handles: list[Line2D | Patch] = []
    if stable.any():
        handles.append(Line2D([], [], color=of_stable, lw=stable_width, label="stable"))
    if not stable.all():
        handles.append(Line2D([], [], color=of_unstable, lw=1.4, ls=(0, (4, 2)), label="unstable"))
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
