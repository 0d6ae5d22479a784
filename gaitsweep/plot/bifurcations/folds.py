"""Curves of folds in the plane of two parameters, with their cusps."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from typing import Any

import numpy as np
import pandas as pd
from jaxtyping import Bool
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from gaitsweep.plot import theme
from gaitsweep.plot.arguments import GaitColumn, Title
from gaitsweep.plot.bifurcations.branch_lines import stretches
from gaitsweep.plot.columns import PlotError, described, require_columns, rows_where
from gaitsweep.plot.kind import figure_kind

_TOGETHER = "#BFE6DA"  # a light tint of the colour of two gaits in a gait map
_MARKS = {"cusp": ("*", 9.0), "curve lost": ("x", 5.0)}


@figure_kind("folds")
def folds(
    table: pd.DataFrame,
    *,
    x: str | None = None,
    y: str | None = None,
    hue: GaitColumn = "gait",
    title: Title = None,
) -> Figure:
    """Draw the folds at which gaits are lost in the plane of two parameters, and where two gaits are stable.

    A curve is dashed where an unstable gait is lost, and thin and dotted over a corner or a jump of the map.
    The area between a curve below which one gait exists and a curve above which another gait exists is
    filled, and so is the area between both sides of a cusp.

    Args:
        table: the table of a run of folds.
        x, y: the columns of both parameters at the folds; by default those of the table's job.

    Raises:
        PlotError: a column is missing.
    """
    names = table.attrs.get("job", {}).get("run", {}).get("parameters") or ["x", "y"]
    x, y = x or f"{names[0]}_fold", y or f"{names[1]}_fold"
    require_columns(table, x, y, hue, "row", "point", "side", "unstable", "special", "end")
    if x == y:
        raise PlotError(f"y is {y}, like x: name another column.")
    table = rows_where(table, table[x].notna()).sort_values(["row", "point"], kind="stable")
    table = table.assign(gait=table[hue].astype(str))
    with theme.canvas(theme.COLUMN + 1.2, 3.5, title) as figure:
        axes = figure.subplots()
        axes.set_xlabel(described(table, x.removesuffix("_fold")))
        axes.set_ylabel(described(table, y.removesuffix("_fold"), 36))
        if not len(table):
            theme.message(axes, "No curve of folds was found: see column end of the table.")
            return figure
        colour = theme.colours(list(dict.fromkeys(table["gait"])))
        pieces = [piece for row, curve in table.groupby("row") for piece in _pieces(row, curve, x, y)]
        together = _fill(axes, pieces)
        for _, curve in table.groupby("row"):
            _draw(axes, curve, x, y, colour)
        theme.legend(figure, _key(table, colour, together), ncols=2)
    return figure


def _looks(curve: pd.DataFrame) -> Iterator[str]:
    """The look of each segment of a curve: "kink", "stable" or "unstable"."""
    point, special = curve["point"].to_numpy(int), curve["special"].to_numpy(str)
    unstable = curve["unstable"].to_numpy(int)
    for k in range(len(curve) - 1):
        far = k if point[k] < 0 else k + 1  # a kink is marked behind the leap, seen from point 0
        if special[far] == "kink":
            yield "kink"
        else:
            yield "unstable" if unstable[k] and unstable[k + 1] else "stable"


def _draw(axes: Axes, curve: pd.DataFrame, x: str, y: str, colour: dict[str, str]) -> None:
    """Draw a curve in the colours of the gaits that are lost, and its marks."""
    at, up = curve[x].to_numpy(float), curve[y].to_numpy(float)
    looks: dict[str, dict[str, Any]] = {
        "kink": {"ls": ":", "lw": 0.8},
        "stable": {"ls": "-", "lw": 1.4},
        "unstable": {"ls": (0, (4, 2)), "lw": 1.4},
    }
    for (look, name), part in stretches(zip(_looks(curve), _gaits(curve), strict=True)):
        axes.plot(at[part], up[part], color=colour[name], zorder=2, **looks[look])
    for mark, marked in _marked(curve).items():
        symbol, size = _MARKS[mark]
        axes.plot(at[marked], up[marked], symbol, ms=size, color="black", zorder=3)


def _gaits(curve: pd.DataFrame) -> list[str]:
    """The gait of each segment of a curve, from its first point, or its second if the first is a cusp."""
    gait, cusp = curve["gait"].tolist(), _marked(curve)["cusp"]
    return [gait[k + 1] if cusp[k] else gait[k] for k in range(len(curve) - 1)]


def _marked(curve: pd.DataFrame) -> dict[str, Bool[np.ndarray, " points"]]:
    """Masks of the points of a curve that have a mark, (n,) each."""
    return {
        "cusp": (curve["special"] == "cusp").to_numpy(bool),
        "curve lost": (curve["end"] == "lost").to_numpy(bool),
    }


def _pieces(row: Any, curve: pd.DataFrame, x: str, y: str) -> Iterator[dict[str, Any]]:
    """The parts of a curve where a stable gait is lost on one side, and the second parameter is monotone."""
    at, up = curve[x].to_numpy(float), curve[y].to_numpy(float)
    side, cusp, gait = curve["side"].to_numpy(int), _marked(curve)["cusp"], _gaits(curve)
    segments = [
        (int(side[k + 1] if cusp[k] else side[k]), gait[k], bool(up[k + 1] > up[k]), look != "unstable")
        for k, look in enumerate(_looks(curve))
    ]
    for (sign, name, _, stable), part in stretches(segments):
        order = np.argsort(up[part])
        if stable:
            yield {"row": row, "gait": name, "side": sign,
                   "at": at[part][order], "up": up[part][order]}  # fmt: skip


def _fill(axes: Axes, pieces: list[dict[str, Any]]) -> set[str]:
    """Fill the areas in which two gaits exist; returns the names of these pairs."""
    pairs = set()
    for above, below in itertools.product(pieces, pieces):
        other = above["gait"] != below["gait"]
        if (above["side"], below["side"]) != (1, -1) or not (other or above["row"] == below["row"]):
            continue
        low = max(above["up"][0], below["up"][0])
        high = min(above["up"][-1], below["up"][-1])
        if low >= high:
            continue
        up = np.unique(np.clip(np.concatenate([above["up"], below["up"]]), low, high))
        left, right = (np.interp(up, piece["up"], piece["at"]) for piece in (above, below))
        if np.any(left < right):
            axes.fill_betweenx(up, left, right, where=left < right, color=_TOGETHER, lw=0, zorder=0)
            pairs.add(" and ".join(sorted({above["gait"], below["gait"]})) if other else "")
    return pairs


def _key(table: pd.DataFrame, colour: dict[str, str], together: set[str]) -> list[Line2D | Patch]:
    """The legend: gaits by colour, areas of two gaits `together`, and the lines and marks that occur."""
    handles: list[Line2D | Patch] = [
        Line2D([], [], color=tint, lw=1.4, label=f"{theme.named(gait)} lost by a fold")
        for gait, tint in colour.items()
    ]
    if together:
        named = ", ".join(sorted(together - {""}))
        label = f"two gaits: {named}" if named else "two gaits"
        handles.append(Patch(facecolor=_TOGETHER, label=label))
    looks = {look for _, curve in table.groupby("row") for look in _looks(curve)}
    if "unstable" in looks:
        handles.append(Line2D([], [], color="black", ls=(0, (4, 2)), lw=1.4, label="of an unstable gait"))
    if "kink" in looks:
        handles.append(Line2D([], [], color="black", ls=":", lw=0.8, label="the map bends or jumps"))
    handles += [
        Line2D([], [], ls="", marker=symbol, color="black", ms=0.7 * size, label=mark)
        for mark, (symbol, size) in _MARKS.items()
        if _marked(table)[mark].any()
    ]
    return handles
