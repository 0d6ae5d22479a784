"""Branches of fixed points over a parameter, their bifurcations, and the regions of stable gaits."""

from __future__ import annotations

import itertools
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import Annotated, Any, Literal, TypeVar

import matplotlib as mpl
import numpy as np
import pandas as pd
from jaxtyping import Float, Shaped
from matplotlib.axes import Axes
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from pydantic import Field

from gaitsweep.analysis.continuation.stable_ranges import MARKS, range_of_gait
from gaitsweep.analysis.continuation.stable_ranges import stable_ranges as ranges_of
from gaitsweep.angles import unwrap_from
from gaitsweep.plot import theme
from gaitsweep.plot.arguments import AlongAxis, Column, GaitColumn, Observable, Title
from gaitsweep.plot.column_labels import described, symbol
from gaitsweep.plot.columns import (
    PlotError,
    branch_parameter,
    origin_of,
    recorded_column,
    require_columns,
    rows_where,
)
from gaitsweep.plot.kind import figure_kind
from gaitsweep.schema.numbers import Real, Text

STABLE, UNSTABLE = "#0072B2", "#D55E00"
# fill and hatch of the ranges beside the branches, in order
_RANGES = (("#E2E2E2", "////"), ("#F3E3C3", "\\\\\\\\"), ("#DCEBDD", "...."), ("#E9DDEC", "----"))
WORDS = {
    "corner": "fold at a bend of the map",
    "neimark_sacker": "Neimark-Sacker",
    "supercritical_pitchfork": "supercritical pitchfork",
    "subcritical_pitchfork": "subcritical pitchfork",
    "branch_point": "branch point",
    "hopf": "Hopf",
}
Marks = Mapping[str, tuple[str, str]]  # the marker and the words of each kind of bifurcation
_MARKERS: Marks = {
    kind: (marker, WORDS.get(kind, kind)) for kind, marker in zip(MARKS, "ovsDX><^h", strict=True)
}
_MARK: dict[str, Any] = {"ls": "", "color": "black", "mfc": "white"}
_UNSTABLE: dict[str, Any] = {"lw": 1.4, "ls": (0, (4, 2))}
_KINK: dict[str, Any] = {"lw": 0.8, "ls": ":"}
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
    beside: Sequence[Patch] = (),
) -> None:
    """Draw one branch: its pieces, solid, dashed or dotted, and its bifurcations.

    Args:
        axes: the panel.
        branch: the points of the branch in their order, with the columns of a continuation's table.
        x, y: the columns along the axes.
        colour: that of its lines; None: the colours of stable and unstable gaits.
        origin: the angle (rad) at which the axis y cuts the circle, where lines end; None if y is no angle.
        stable_width: width of the line where the branch is stable, in points.
        beside: areas behind the branches, which show in the gaps of dashes.
    """
    at, value = branch[x].to_numpy(float), unwrap_from(branch[y].to_numpy(float), origin)
    absent = np.diff(branch["point"].to_numpy(int)) > 1  # no line across a point that the table lacks
    looks: dict[Piece, dict[str, Any]] = {
        "stable": {"color": colour or STABLE, "ls": "-", "lw": stable_width},
        "unstable": {"color": colour or UNSTABLE, **_UNSTABLE},
        "kink": {"color": colour or "#555555", **_KINK},
    }
    for (piece, missing), part in stretches(zip(pieces(branch), absent, strict=True)):
        if missing:
            continue
        over_the_cut = (np.abs(np.diff(value[part])) > np.pi) & (origin is not None)
        line = theme.interrupted(over_the_cut, at[part], value[part])
        look = looks[piece]
        if piece == "unstable":  # dashes of a branch that was followed from two starts would fill their gaps
            axes.plot(*line, color=axes.get_facecolor(), lw=look["lw"], zorder=1.9)
            for area in beside:
                (within,) = axes.plot(*line, color=area.get_facecolor(), lw=look["lw"], zorder=1.9)
                within.set_clip_path(area)
        axes.plot(*line, zorder=2 if piece == "stable" else 1.9, **look)
    if len(branch) == 1:
        look = looks["stable" if branch["stable"].iloc[0] else "unstable"]
        axes.plot(at, value, ".", color=look["color"])
    draw_marks(axes, at, value, branch["special"].to_numpy(object))


def draw_marks(
    axes: Axes,
    at: Float[np.ndarray, " points"],
    up: Float[np.ndarray, " points"],
    kinds: Shaped[np.ndarray, " points"],
    marks: Marks = _MARKERS,
    *,
    size: float = 4.5,
    zorder: float = 3,
) -> None:
    """Mark the points at which the table has a bifurcation.

    Args:
        axes: the panel.
        at, up: places of the points, (n,).
        kinds: the kind of bifurcation at each point, (n,).
        marks: the markers by kind.
        size: of the markers, points.
        zorder: of the markers.
    """
    for kind, (marker, _) in marks.items():
        marked = np.asarray(kinds == kind, bool)
        axes.plot(at[marked], up[marked], marker=marker, ms=size, zorder=zorder, **_MARK)


def key_of_marks(kinds: Collection[str], marks: Marks = _MARKERS, *, size: float = 4.5) -> list[Line2D]:
    """The legend of the markers of the kinds of bifurcations that occur."""
    return [
        Line2D([], [], marker=marker, ms=size, label=words, **_MARK)
        for kind, (marker, words) in marks.items()
        if kind in kinds
    ]


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

    Raises:
        PlotError: the stability of a point is missing.
    """
    if np.any(branch["stable"].isna()):
        raise PlotError("stable has no value at some points of a branch: leave these points out.")
    special = branch["special"].fillna("").to_numpy(str)
    stable = branch["stable"].to_numpy(bool)
    bifurcates = np.isin(special, list(_MARKERS))
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
        handles.append(Line2D([], [], color=colour, label="unstable", **_UNSTABLE))
    special = set(table["special"].fillna(""))
    if "kink" in special:
        handles.append(Line2D([], [], color="#555555", label="over a bend or jump of the map", **_KINK))
    handles += key_of_marks(special)
    handles += [Patch(label=name, **style_of_range(number)) for number, name in enumerate(beside)]
    pairs = itertools.combinations(map(sorted, beside.values()), 2)
    if any(max(low, begin) < min(high, end) for (low, high), (begin, end) in pairs):
        look: dict[str, Any] = {"facecolor": "none", "edgecolor": "#9A9A9A", "hatch": "xxxx", "lw": 0.5}
        handles.append(Patch(label="both of these", **look))
    return handles


def style_of_range(number: int) -> dict[str, Any]:
    """The style of the range with this number: translucent, so that overlaps are visible."""
    face, hatch = _RANGES[number % len(_RANGES)]
    return {"facecolor": to_rgba(face, 0.5), "edgecolor": "#9A9A9A", "hatch": hatch, "linewidth": 0.5}


@figure_kind("continuation")
def continuation(
    table: pd.DataFrame,
    *,
    y: Annotated[
        Observable | None, "observable of the model; by default the first coordinate of the map that is one"
    ] = None,
    x: str | None = None,  # no field of a job, whose run moves one parameter
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
        PlotError: the table lacks a column or the stability of a point, or a range is not two numbers.
    """
    for label, ends in intervals.items():
        if len(ends) != 2:
            raise PlotError(f"intervals.{label} has {len(ends)} numbers, but must be [low, high].")
    name = recorded_column(table, y)
    x = x or branch_parameter(table)
    require_columns(table, x, "row", "point", "stable", "special", hue)
    # the two directions in which a map follows a branch begin at one point
    of_branch = [name_of_part for name_of_part in ("row", "direction") if name_of_part in table]
    table = table.dropna(subset=[name]).sort_values([*of_branch, "point"], kind="stable")
    with theme.diagram(table, x, name, title) as (figure, axes):
        if not len(table):
            theme.message(axes, "No row has a fixed point on a branch.")
            return figure
        colours, hue_key = _colours_of_rows(figure, axes, table, hue)
        origin = origin_of(table, name, table[name].to_numpy(float))
        spans = [
            axes.axvspan(low, high, zorder=0, **style_of_range(number))
            for number, (low, high) in enumerate(intervals.values())
        ]
        for _, branch in table.groupby(of_branch, sort=True):
            colour = colours.get(branch["row"].iloc[0])
            draw_branch(axes, branch, x, name, colour, origin=origin, beside=spans)
        theme.value_axis(axes, angle=origin is not None)
        of_branches = key(table, intervals, coloured=hue is not None)
        theme.legend(figure, [*hue_key, *of_branches], ncols=2)
    return figure


def _colours_of_rows(
    figure: Figure, axes: Axes, table: pd.DataFrame, hue: str | None
) -> tuple[dict[Any, Any], list[Line2D]]:
    """A colour for each row by the column `hue`, and the handles of the legend that name these colours.

    Numbers have a colour bar, which is drawn here, and names are the most frequent of a row. A row without a
    number or a name is grey.
    """
    if hue is None:
        return {}, []
    grey = theme.COLOURS["none"]
    without_hue = Line2D([], [], color=grey, lw=1.4, label=f"no {symbol(table, hue)}")
    rows = table.groupby("row")[hue]
    if not pd.api.types.is_numeric_dtype(table[hue]):
        modes = {row: names.dropna().astype(str).mode() for row, names in rows}
        name_of_row = {row: mode.iloc[0] for row, mode in modes.items() if len(mode)}
        colours = theme.colours(theme.ordered(dict.fromkeys(name_of_row.values())))
        handles = [
            Line2D([], [], color=colour, lw=1.4, label=theme.named(name)) for name, colour in colours.items()
        ]
        if len(name_of_row) < len(modes):
            handles.append(without_hue)
        named = {row: colours[name] for row, name in name_of_row.items()}
        return dict.fromkeys(modes, grey) | named, handles
    numbers = rows.first()  # the first of a row that is not NaN
    values = numbers.to_numpy(float)
    has_number = ~np.isnan(values)
    colours_of_rows: dict[Any, Any] = dict.fromkeys(numbers.index, grey)
    if has_number.any():
        scale = theme.ColourScale(values[has_number])
        scale.draw_bar(figure, axes, described(table, hue), 0.85)
        of_numbers = map(tuple, scale.to_rgba(scale.on_scale(values[has_number])))
        colours_of_rows |= dict(zip(numbers.index[has_number], of_numbers, strict=True))
    return colours_of_rows, [] if has_number.all() else [without_hue]


_STRIPES = {"hatch": "\\\\\\", "facecolor": "none", "lw": 0.0}  # of the second gait over the first


@figure_kind("continuation")
def stable_ranges(
    table: pd.DataFrame,
    *,
    y: Annotated[AlongAxis, "column of the parameter that differs between branches"],
    x: str | None = None,
    hue: GaitColumn = "gait",
    title: Title = None,
) -> Figure:
    """The range of a parameter in which each gait is stable, over another that differs between branches.

    Each gait has an area, striped in the colour of another that is stable too; edges are marked by the
    bifurcation there. At an edge without a mark the branch ended, or stability changes at a corner or jump of
    the map; at an edge without a line branches begin or leave their range.

    Args:
        table: a continuation's table. If several branches have the same gait at one value of y, their stable
            ranges must touch, and are joined.
        x: the column of the continuation parameter; by default that of the job.

    Raises:
        PlotError: a column is missing, y is not numeric, or a gait's ranges at one value of y are disjoint.
    """
    x = x or branch_parameter(table)
    require_columns(table, x, y, hue, "row", "point", "stable", "special", "end")
    with theme.diagram(table, x, y, title, width=theme.COLUMN + 1.2, height=3.5) as (figure, axes):
        areas = _areas(table.assign(gait=table[hue]), x, y)
        if not areas:
            theme.message(axes, "no stable gait was found" if len(table) else "no rows yet")
            return figure
        _draw(axes, areas)
        theme.legend(figure, *_key(areas), ncols=2)
    return figure


def _areas(table: pd.DataFrame, x: str, y: str) -> dict[str, pd.DataFrame]:
    """The ranges of each named gait, with the value `up` of y, in the order of y."""
    table = rows_where(table, table[y].notna())
    up_of_row = dict(zip(table["row"], table[y], strict=True))
    values = pd.DataFrame({"up": np.unique(table[y].to_numpy(float))})
    areas = {}
    for gait in dict.fromkeys(ranges_of(table, x)["gait"].dropna()):
        if gait == "none":
            continue
        ranges = range_of_gait(table, x, gait)
        ranges = ranges.assign(up=[up_of_row[row] for row in ranges["row"]])
        unions = [
            _union(at_value, f"{gait} at {y} = {value:g}", x)
            for value, at_value in ranges.groupby("up", sort=True)
        ]
        # no area crosses a value of y at which the gait is not stable
        area = values.merge(pd.DataFrame(unions), on="up", how="left")
        areas[gait] = area.fillna({"low_by": "", "high_by": ""})
    return areas


def _union(ranges: pd.DataFrame, place: str, x: str) -> pd.Series:
    """The union of the ranges of branches at one value of y, which `place` names in messages.

    Raises:
        PlotError: the ranges are disjoint.
    """
    ranges = ranges.sort_values("low", kind="stable")
    low, high = ranges["low"].to_numpy(float), ranges["high"].to_numpy(float)
    reach = np.maximum.accumulate(high)
    if np.any(low[1:] > reach[:-1]):
        raise PlotError(
            f"{place}: stable in separate ranges of {x}, which do not form one area. Draw fewer branches, or "
            "the branches themselves (figures: continuation)."
        )
    last = ranges.iloc[int(np.argmax(high))]
    return pd.Series({**ranges.iloc[0], "high": last["high"], "high_by": last["high_by"]})


def _draw(axes: Axes, areas: dict[str, pd.DataFrame]) -> None:
    """Draw the areas, their overlaps and their edges."""
    colour, hatch = theme.colours(areas), theme.hatches(areas)
    for name, area in areas.items():
        low, high, up = (area[key].to_numpy(float) for key in ("low", "high", "up"))
        axes.fill_betweenx(up, low, high, **theme.hatched(colour[name], hatch[name]))
        known = np.pad(np.isfinite(low), 1)
        alone = known[1:-1] & ~known[:-2] & ~known[2:]  # values of y without an area
        if alone.any():
            axes.hlines(up[alone], low[alone], high[alone], color=colour[name], lw=3.0)
    for (one, other), (low, high, up) in _overlaps(areas).items():
        axes.fill_betweenx(up, low, high, color=colour[one], lw=0.0)
        axes.fill_betweenx(up, low, high, edgecolor=colour[other], **_STRIPES)
    for area in areas.values():
        for side in ("low", "high"):
            at, up = area[side].to_numpy(float), area["up"].to_numpy(float)
            is_lost = ~area[f"{side}_by"].isin(["start", "range"]).to_numpy(bool)
            edge_colour = mpl.rcParams["axes.edgecolor"]
            axes.plot(np.where(is_lost, at, np.nan), up, color=edge_colour, lw=1.0, zorder=3)
            draw_marks(axes, at, up, area[f"{side}_by"].to_numpy(object), zorder=4)


def _overlaps(
    areas: dict[str, pd.DataFrame],
) -> dict[tuple[str, str], tuple[Float[np.ndarray, " points"], ...]]:
    """For each pair of gaits: low, high and up of the range where both are stable, NaN where not."""
    overlaps = {}
    for one, other in itertools.combinations(areas, 2):
        both = areas[one].merge(areas[other], on="up", suffixes=("", "_2"))
        low = both[["low", "low_2"]].to_numpy(float).max(axis=1)
        high = both[["high", "high_2"]].to_numpy(float).min(axis=1)
        overlap = low < high  # False where one of the gaits is not stable
        if overlap.any():
            up = both["up"].to_numpy(float)
            overlaps[one, other] = np.where(overlap, low, np.nan), np.where(overlap, high, np.nan), up
    return overlaps


def _key(areas: dict[str, pd.DataFrame]) -> tuple[list[Any], list[str]]:
    """The handles and texts of the legend."""
    colour, hatch = theme.colours(areas), theme.hatches(areas)
    handles: list[Any] = [Patch(**theme.hatched(colour[name], hatch[name])) for name in areas]
    labels = [f"{theme.named(name)} stable" for name in areas]
    for one, other in _overlaps(areas):
        handles.append((Patch(color=colour[one], lw=0.0), Patch(edgecolor=colour[other], **_STRIPES)))
        labels.append(f"{theme.named(one)} and {theme.named(other)} stable")
    causes = {cause for area in areas.values() for cause in (*area["low_by"], *area["high_by"])}
    marks = key_of_marks(causes)
    return [*handles, *marks], [*labels, *(str(mark.get_label()) for mark in marks)]
