"""Branches of fixed points over a parameter, stable and unstable, with their bifurcations."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import Annotated, Any, TypeVar

import matplotlib as mpl
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize, to_rgba
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from pydantic import Field

from gaitsweep.analysis.continuation.stable_ranges import MARKS
from gaitsweep.near_miss import allowing
from gaitsweep.plot import theme
from gaitsweep.plot.columns import PlotError, column, described, is_angle, moved_parameter, require_columns
from gaitsweep.plot.kind import Column, Observable, Title, figure_kind
from gaitsweep.schema.numbers import Real, Text

STABLE, UNSTABLE = "#0072B2", "#D55E00"
# fill and hatch of the ranges beside the branches, in order
_BESIDE = (("#E2E2E2", "////"), ("#F3E3C3", "\\\\\\\\"), ("#DCEBDD", "...."), ("#E9DDEC", "----"))
MARKERS: dict[str, str] = dict(zip(MARKS, "ovsDX><^h", strict=True))
T = TypeVar("T")
WORDS = {
    "corner": "fold at a bend of the map",
    "neimark_sacker": "Neimark-Sacker",
    "supercritical_pitchfork": "supercritical pitchfork",
    "subcritical_pitchfork": "subcritical pitchfork",
    "branch_point": "branch point",
    "hopf": "Hopf",
}


@figure_kind("continuation")
def continuation(
    table: pd.DataFrame,
    *,
    y: Annotated[
        Observable | None, "observable of the model; by default the first coordinate of the map that is one"
    ] = None,
    x: str | None = None,
    hue: Annotated[
        Column | None, "column of another parameter that differs between branches, or of the gait"
    ] = None,
    intervals: Annotated[
        Mapping[Text, Annotated[Sequence[Real], Field(min_length=2, max_length=2)]],
        "ranges of the parameter to show beside the branches, [low, high] by name",
    ] = MappingProxyType({}),
    title: Title = None,
) -> Figure:
    """Branches over a parameter, solid where stable and dashed where unstable, with marked bifurcations.

    A thin dotted line crosses a corner or a jump of the map.

    Args:
        table: a continuation's table: of a job, or of `return_map(...).continue_`.
        y: the observable; by default the first coordinate of the map that is one, or the first of the table.
        x: the column of the parameter; by default that of the table's job.

    Raises:
        PlotError: the table lacks a column.
    """
    observables = [*table.attrs.get("recorded", ()), *(name for name in table if str(name).endswith("_n"))]
    if y is None and not observables:
        raise PlotError(f"The table names no observable: give y. {allowing(map(str, table.columns))}")
    name = column(table, y or observables[0], ("_n", ""))
    x = x or moved_parameter(table) or "parameter"
    require_columns(table, x, "row", "point", "stable", "special", hue)
    # the two directions in which a map follows a branch begin at one point
    of_branch = [key for key in ("row", "direction") if key in table]
    table = table.dropna(subset=[name]).sort_values([*of_branch, "point"], kind="stable")
    with theme.canvas(theme.COLUMN + 1.6, 3.4, title) as figure:
        axes = figure.subplots()
        axes.set_xlabel(described(table, x))
        axes.set_ylabel(described(table, name, 36))
        if not len(table):
            theme.message(axes, "No row has a fixed point on a branch.")
            return figure
        colours = _colours(table, hue)
        for number, (low, high) in enumerate(intervals.values()):
            axes.axvspan(low, high, zorder=0, **_beside(number))
        for _, branch in table.groupby(of_branch, sort=True):
            draw_branch(axes, branch, x, name, colours.get(branch["row"].iloc[0]))
        theme.value_axis(axes, angle=is_angle(table, name))
        handles = key(table, intervals, coloured=hue is not None)
        if hue is not None and _numbers(table, hue):
            shades = ScalarMappable(_span(table, hue), "viridis")
            figure.colorbar(shades, ax=axes, label=described(table, hue), shrink=0.85)
        elif hue is not None:
            named = theme.colours(theme.ordered(dict.fromkeys(_names(table, hue).values())))
            gaits = [Line2D([], [], color=named[gait], lw=1.4, label=theme.named(gait)) for gait in named]
            handles = gaits + handles
        theme.legend(figure, handles, ncols=2)
    return figure


def _numbers(table: pd.DataFrame, hue: str) -> bool:
    return bool(pd.api.types.is_numeric_dtype(table[hue]))


def _names(table: pd.DataFrame, hue: str) -> dict[Any, str]:
    """The most frequent value of each row."""
    return {row: str(branch[hue].astype(str).mode().iloc[0]) for row, branch in table.groupby("row")}


def _span(table: pd.DataFrame, hue: str) -> Normalize:
    values = table[hue].to_numpy(float)
    low, high = float(values.min()), float(values.max())
    return Normalize(low, high if high > low else low + 1.0)


def _colours(table: pd.DataFrame, hue: str | None) -> dict[Any, Any]:
    """A colour for each row, if colours show another parameter or the gait."""
    if hue is None:
        return {}
    if not _numbers(table, hue):
        names = _names(table, hue)
        named = theme.colours(list(dict.fromkeys(names.values())))
        return {row: named[name] for row, name in names.items()}
    shades, span = mpl.colormaps["viridis"], _span(table, hue)
    return {row: shades(span(float(branch[hue].iloc[0]))) for row, branch in table.groupby("row")}


def draw_branch(
    axes: Axes, branch: pd.DataFrame, x: str, y: str, colour: Any, stable_width: float = 1.4
) -> None:
    """Draw one branch: its pieces, solid, dashed or dotted, and its bifurcations."""
    at, value = branch[x].to_numpy(float), branch[y].to_numpy(float)
    if is_angle(branch, y):
        value = np.unwrap(value)
    special, pieces = branch["special"].fillna("").to_numpy(str), looks_of_pieces(branch)
    start = 0
    number = branch["point"].to_numpy(int)
    absent = np.diff(number) > 1  # no line across a point that the table lacks
    for (kind, missing), group in itertools.groupby(zip(pieces, absent, strict=True)):
        end = start + len(list(group))
        if missing:
            start = end
            continue
        look: dict[str, Any] = {"zorder": 2, "lw": 1.4}
        if kind == "kink":
            look |= {"color": colour or "#555555", "ls": ":", "lw": 0.8}
        else:
            look |= {"color": colour or (STABLE if kind else UNSTABLE), "ls": "-" if kind else (0, (4, 2))}
            look["lw"] = stable_width if kind else 1.4
        axes.plot(at[start : end + 1], value[start : end + 1], **look)
        start = end
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
    """The legend; lines are grey in it if branches are `coloured` by another column."""
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
    handles += [Patch(label=name, **_beside(number)) for number, name in enumerate(beside)]
    pairs = itertools.combinations(beside.values(), 2)
    if any(max(low, begin) < min(high, end) for (low, high), (begin, end) in pairs):
        look: dict[str, Any] = {"facecolor": "none", "edgecolor": "#9A9A9A", "hatch": "xxxx", "lw": 0.5}
        handles.append(Patch(label="both of these", **look))
    return handles


def _beside(number: int) -> dict[str, Any]:
    """The style of the range with this number: translucent, so that overlaps are visible."""
    face, hatch = _BESIDE[number % len(_BESIDE)]
    return {"facecolor": to_rgba(face, 0.5), "edgecolor": "#9A9A9A", "hatch": hatch, "linewidth": 0.5}
