"""Curves of folds in the plane of two parameters, with their cusps."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from jaxtyping import Bool, Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from gaitsweep.plot import theme
from gaitsweep.plot.arguments import GaitColumn, Title
from gaitsweep.plot.bifurcations.continuation import Piece, stretches
from gaitsweep.plot.column_labels import described
from gaitsweep.plot.columns import PlotError, require_columns, rows_where
from gaitsweep.plot.kind import figure_kind

_TOGETHER = "#BFE6DA"  # a light tint of the colour of two gaits in a gait map
_MARKS = {"cusp": ("*", 9.0), "curve lost": ("x", 5.0)}
_LOOKS: dict[Piece, dict[str, Any]] = {
    "kink": {"ls": ":", "lw": 0.8},
    "stable": {"ls": "-", "lw": 1.4},
    "unstable": {"ls": (0, (4, 2)), "lw": 1.4},
}


class _Boundary(NamedTuple):
    """A part of a curve at which a stable gait is lost, along which the second parameter rises.

    `at` and `up` (n,) are values of both parameters; the gait exists where the first parameter is larger than
    `at` (`side` 1), or smaller (`side` -1).
    """

    row: Any
    gait: str
    side: int
    at: Float[np.ndarray, " points"]
    up: Float[np.ndarray, " points"]


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
        curves = table.groupby("row")
        boundaries = [part for row, curve in curves for part in _boundaries(row, curve, x, y)]
        pairs = _fill(axes, boundaries)
        for _, curve in curves:
            _draw(axes, curve, x, y, colour)
        theme.legend(figure, _key(table, colour, pairs), ncols=2)
    return figure


def _pieces(curve: pd.DataFrame) -> Iterator[Piece]:
    """The pieces between the points of a curve: folds of stable or unstable gaits, or a kink of the map."""
    point, special = curve["point"].to_numpy(int), curve["special"].to_numpy(str)
    unstable = curve["unstable"].to_numpy(int)
    for k in range(len(curve) - 1):
        far_end = k if point[k] < 0 else k + 1  # a kink is marked behind the leap, seen from point 0
        if special[far_end] == "kink":
            yield "kink"
        else:
            yield "unstable" if unstable[k] and unstable[k + 1] else "stable"


def _draw(axes: Axes, curve: pd.DataFrame, x: str, y: str, colour: dict[str, str]) -> None:
    """Draw a curve in the colours of the gaits that are lost, and its marks."""
    at, up = curve[x].to_numpy(float), curve[y].to_numpy(float)
    for (piece, gait), part in stretches(zip(_pieces(curve), _gaits(curve), strict=True)):
        axes.plot(at[part], up[part], color=colour[gait], zorder=2, **_LOOKS[piece])
    for mark, marked in _marked(curve).items():
        symbol, size = _MARKS[mark]
        axes.plot(at[marked], up[marked], symbol, ms=size, color="black", zorder=3)


def _gaits(curve: pd.DataFrame) -> list[str]:
    """The gait of each piece of a curve, from its first point, or its second if the first is a cusp."""
    gait = curve["gait"].tolist()
    cusp = _marked(curve)["cusp"]
    return [gait[k + 1] if cusp[k] else gait[k] for k in range(len(curve) - 1)]


def _marked(curve: pd.DataFrame) -> dict[str, Bool[np.ndarray, " points"]]:
    """Masks of the points of a curve that have a mark, (n,) each."""
    return {
        "cusp": (curve["special"] == "cusp").to_numpy(bool),
        "curve lost": (curve["end"] == "lost").to_numpy(bool),
    }


def _boundaries(row: Any, curve: pd.DataFrame, x: str, y: str) -> Iterator[_Boundary]:
    """The parts of a curve where a stable gait is lost on one side, and the second parameter is monotone."""
    at, up = curve[x].to_numpy(float), curve[y].to_numpy(float)
    side = curve["side"].to_numpy(int)
    side_of_piece = np.where(_marked(curve)["cusp"][:-1], side[1:], side[:-1]).tolist()
    rises = (np.diff(up) > 0.0).tolist()
    is_stable = [piece != "unstable" for piece in _pieces(curve)]
    of_pieces = zip(side_of_piece, _gaits(curve), rises, is_stable, strict=True)
    for (sign, gait, _, stable), part in stretches(of_pieces):
        if stable:
            order = np.argsort(up[part])
            yield _Boundary(row, gait, sign, at[part][order], up[part][order])


def _fill(axes: Axes, boundaries: list[_Boundary]) -> set[str]:
    """Fill the areas in which two gaits exist; returns the names of these pairs, "" for sides of a cusp."""
    pairs = set()
    for left, right in itertools.product(boundaries, boundaries):
        two_gaits = left.gait != right.gait
        if (left.side, right.side) != (1, -1) or not (two_gaits or left.row == right.row):
            continue
        low = max(left.up[0], right.up[0])
        high = min(left.up[-1], right.up[-1])
        if low >= high:
            continue
        up = np.unique(np.clip(np.concatenate([left.up, right.up]), low, high))
        begin, end = (np.interp(up, boundary.up, boundary.at) for boundary in (left, right))
        if np.any(begin < end):
            axes.fill_betweenx(up, begin, end, where=begin < end, color=_TOGETHER, lw=0, zorder=0)
            pairs.add(" and ".join(sorted({left.gait, right.gait})) if two_gaits else "")
    return pairs


def _key(table: pd.DataFrame, colour: dict[str, str], pairs: set[str]) -> list[Line2D | Patch]:
    """The legend: gaits by colour, areas of pairs of gaits, and the lines and marks that occur."""
    handles: list[Line2D | Patch] = [
        Line2D([], [], color=tint, lw=1.4, label=f"{theme.named(gait)} lost by a fold")
        for gait, tint in colour.items()
    ]
    if pairs:
        names = ", ".join(sorted(pairs - {""}))
        label = f"two gaits: {names}" if names else "two gaits"
        handles.append(Patch(facecolor=_TOGETHER, label=label))
    occurring = {piece for _, curve in table.groupby("row") for piece in _pieces(curve)}
    if "unstable" in occurring:
        handles.append(Line2D([], [], color="black", label="of an unstable gait", **_LOOKS["unstable"]))
    if "kink" in occurring:
        handles.append(Line2D([], [], color="black", label="the map bends or jumps", **_LOOKS["kink"]))
    handles += [
        Line2D([], [], ls="", marker=symbol, color="black", ms=0.7 * size, label=mark)
        for mark, (symbol, size) in _MARKS.items()
        if _marked(table)[mark].any()
    ]
    return handles
