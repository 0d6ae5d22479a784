"""Settled states in space and in two projections, with the analytic solutions (Ambe 2021, Fig. 4)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Annotated, Any, Literal

import numpy as np
import pandas as pd
from jaxtyping import Float
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from mpl_toolkits.mplot3d import proj3d
from pydantic import Field

from gaitsweep.analyses import in_order, stored_function
from gaitsweep.papers.ambe2021.multilegged.chain_of_table import (
    chain_of,
    largest_distance,
    may_be_of_chain,
    profile_of,
)
from gaitsweep.papers.ambe2021.theory.chain import Chain
from gaitsweep.papers.ambe2021.theory.gaits import SHORTEST_PIECE, Segments, segments
from gaitsweep.plot import (
    Flag,
    Hue,
    Observable,
    PlotError,
    Real,
    Text,
    Title,
    axis_label,
    column,
    figure_kind,
    is_angle,
    outcome,
    rows_where,
    theme,
)
from gaitsweep.status import Outcome

_ThreeEntries = Field(min_length=3, max_length=3)
_NAME_DISTANCE = 11.0  # points from a marked point to its name
_PSI = ("psi_1", "psi_2", "psi_3")
_AXES: tuple[Literal["x"], Literal["y"], Literal["z"]] = ("x", "y", "z")
Planes = list[tuple[Any, list[int]]]  # the axes of each projection, and the two observables along them


@figure_kind("settle")
def solution_set(
    table: pd.DataFrame,
    *,
    axes: Annotated[Sequence[Observable], _ThreeEntries, "three observables of the model"],
    hue: Hue = "gait",
    theory: Annotated[
        Flag, "whether to draw the analytic solutions, which are known for psi_1, psi_2, psi_3"
    ] = True,
    points: Annotated[
        Mapping[Text, Annotated[Sequence[Real], _ThreeEntries]], "points to mark, by name, three numbers each"
    ] = MappingProxyType({}),
    title: Title = None,
) -> Figure:
    """The settled states in the space of three observables, and projected on two pairs of them.

    Args:
        table: a settle table; rows that failed or did not settle are left out and counted in the legend.

    Raises:
        PlotError: the table does not have a column, or axes or points do not have three entries.
    """
    if len(axes) != 3:
        raise PlotError(f"axes has {len(axes)} entries, but must have three observables.")
    names = [column(table, name, ("_end", "")) for name in axes]
    column(table, hue)
    for name, place in points.items():
        if len(place) != 3:
            text = f"has {len(place)} numbers, but must have one for each of the three axes."
            raise PlotError(f"Point {name} {text}")
    shown = outcome(table, hue)
    lines, remark = _theory(table, list(axes)) if theory else (np.zeros((0, 2, 3)), None)
    with theme.canvas(theme.PAGE, 4.3, title) as figure:
        space, planes = _panels(figure)
        settled = _scatter(table, names, hue, shown, space, planes)
        for ends in lines:
            space.plot(*ends.T, color="black", lw=0.9, zorder=5)
            for plane, pair in planes:
                plane.plot(*ends[:, pair].T, color="black", lw=0.9, zorder=5)
        _label(table, names, space, planes)
        if not len(settled):
            theme.message(planes[0][0], "No row has settled yet.")
        far = largest_distance(table)
        distance = "" if far is None else f", {far[0]:.3f} rad away at most"
        theory_label = f"analytic solutions{distance}" if len(lines) else None
        _legend(figure, table, hue, shown, theory_label, remark)
        if points:
            along = np.linspace(lines[:, 0], lines[:, 1], 20).reshape(-1, 3)
            marked = _wrapped(table, names, np.array(list(points.values()), float))
            _mark(list(points), marked, np.concatenate([settled, along]), space, planes)
    return figure


def _panels(figure: Figure) -> tuple[Any, Planes]:
    """The axes in space beside those of the projections, or above them in a narrow figure."""
    wide = theme.shape(2, theme.PAGE, 2.5) == (1, 2)
    grid = figure.add_gridspec(2, 2, **{"width_ratios" if wide else "height_ratios": (1.45, 1.0)})
    places = (grid[:, 0], grid[0, 1], grid[1, 1]) if wide else (grid[0, :], grid[1, 0], grid[1, 1])
    space: Any = figure.add_subplot(places[0], projection="3d")
    space.view_init(elev=22.0, azim=-58.0)
    space.set_box_aspect((1, 1, 0.95), zoom=0.95)  # pyright: ignore
    space.computed_zorder = False  # else matplotlib hides the lines behind the points
    return space, [(figure.add_subplot(places[1]), [0, 1]), (figure.add_subplot(places[2]), [1, 2])]


def _scatter(
    table: pd.DataFrame, names: list[str], hue: str, shown: pd.Series, space: Any, planes: Planes
) -> Float[np.ndarray, "rows 3"]:
    """The settled rows in all three panels; returns their places."""
    order = theme.ordered(in_order(table, hue, shown))
    colour, marker = theme.colours(order), theme.markers(order)
    places = [np.zeros((0, 3))]
    for name in order:
        rows = rows_where(table, shown == name)
        if name in (Outcome.NOT_SETTLED, Outcome.FAILED) or not len(rows):
            continue
        place = _wrapped(table, names, rows[names].to_numpy(float))
        width = 0.8 if marker[name] == "x" else 0
        style = {"color": colour[name], "marker": marker[name], "linewidths": width, "clip_on": False}
        size = float(np.clip(3e3 / len(rows), 9.0, 16.0))  # larger than the width of the lines over them
        space.scatter(*place.T, s=size, depthshade=False, **style)
        for plane, pair in planes:
            plane.scatter(*place[:, pair].T, s=size, rasterized=True, **style)
        places.append(place)
    return np.concatenate(places)


def _wrapped(
    table: pd.DataFrame, names: Sequence[str], places: Float[np.ndarray, "points 3"]
) -> Float[np.ndarray, "points 3"]:
    """Places with their angles (rad) from 0 to 2 pi, as the axes are."""
    return np.where([is_angle(table, name) for name in names], np.mod(places, 2 * np.pi), places)


def _mark(
    names: Sequence[str],
    places: Float[np.ndarray, "names 3"],
    drawn: Float[np.ndarray, "points 3"],
    space: Any,
    planes: Planes,
) -> None:
    """Named points: open rings, each with its name on the side farthest from what is drawn."""
    ring = {"facecolors": "none", "edgecolors": "black", "s": 34, "linewidths": 1.1, "zorder": 8}
    space.scatter(*places.T, depthshade=False, **ring)
    for plane, pair in planes:
        plane.scatter(*places[:, pair].T, **ring)
    space.get_figure(root=True).draw_without_rendering()  # places the panels
    to_page = space.get_proj()
    flat = [np.stack(proj3d.proj_transform(*s.T, M=to_page)[:2], axis=1) for s in (places, drawn)]
    _name(space, names, *flat)
    for plane, pair in planes:
        _name(plane, names, places[:, pair], drawn[:, pair])


def _name(
    axes: Any,
    names: Sequence[str],
    places: Float[np.ndarray, "names 2"],
    drawn: Float[np.ndarray, "points 2"],
) -> None:
    """Write names beside their places, far from each other and from what is drawn."""
    text = {"fontsize": theme.points(9), "fontweight": "bold", "ha": "center", "va": "center", "zorder": 9}
    turns = np.linspace(0.0, 2 * np.pi, 8, endpoint=False)
    sides = _NAME_DISTANCE * np.stack([np.cos(turns), np.sin(turns)], axis=1)
    occupied = axes.transData.transform(np.concatenate([places, drawn])) * 72 / axes.figure.dpi
    for name, place, point in zip(names, places, occupied[: len(places)], strict=True):
        room = np.linalg.norm((point + sides)[:, None] - occupied, axis=2).min(axis=1)
        side = sides[int(np.argmax(room.round()))]
        axes.annotate(name, place, side, textcoords="offset points", **text)
        occupied = np.concatenate([occupied, [point + side]])


def _label(table: pd.DataFrame, names: list[str], space: Any, planes: Planes) -> None:
    """Label the axes of all panels, with ticks of angles in multiples of pi."""
    labels = [axis_label(table, name) for name in names]
    for which, name, label in zip(_AXES, names, labels, strict=True):
        getattr(space, f"set_{which}label")(label, labelpad=-2)
        if is_angle(table, name):
            theme.angle_axis(space, which, steps=2)
    space.tick_params(pad=-1)
    for plane, pair in planes:
        for which, i in zip(_AXES[:2], pair, strict=True):
            getattr(plane, f"set_{which}label")(labels[i])
            if is_angle(table, names[i]):
                theme.angle_axis(plane, which)
        if all(is_angle(table, names[i]) for i in pair):
            plane.set_aspect("equal")


def _legend(
    figure: Figure, table: pd.DataFrame, hue: str, shown: pd.Series, theory: str | None, remark: str | None
) -> None:
    """The legend: each outcome with its rows, the analytic solutions, or the `remark` why there are none."""
    order = theme.ordered(in_order(table, hue, shown))
    colour, marker = theme.colours(order), theme.markers(order)
    handles = []
    for name in order:
        count = int((shown == name).sum())
        hidden = name in (Outcome.NOT_SETTLED, Outcome.FAILED)
        face = "none" if hidden else colour[name]
        label = f"{theme.named(name)}: {count}, not shown" if hidden else f"{theme.named(name)} ({count})"
        handles.append(Line2D([], [], ls="", marker=marker[name], color=face, label=label, ms=5))
    if theory:
        handles.append(Line2D([], [], color="black", lw=0.9, label=theory))
    title = f"No analytic solutions are drawn: {remark}" if remark else None
    if handles or title:
        theme.legend(figure, handles, ncols=min(4, max(len(handles), 1)), title=title)


def _segments(chain: Mapping[str, Any]) -> Segments:
    """The pieces of a chain of four legs, from its fields by name."""
    return segments(3, Chain(**chain))


# stored, since the figure would wait for JAX and XLA
_segments_of_chains = stored_function(_segments)


def _theory(table: pd.DataFrame, axes: list[str]) -> tuple[Float[np.ndarray, "pieces 2 3"], str | None]:
    """The ends of the analytic pieces on section 1, and a reason if there are no pieces."""
    none = np.zeros((0, 2, 3))
    if not may_be_of_chain(table):
        return none, "they are those of the multi-legged chain."
    if any(name.removesuffix("_end") not in _PSI for name in axes):
        return none, "they are known for psi_1, psi_2 and psi_3 only."
    if "psi_4_end" in table.columns:
        return none, "they are drawn for N = 3 only."
    names = (*Chain._fields, "m_B", *profile_of(table))
    varied = [name for name in names if name in table.columns and len(table[name].unique()) > 1]
    if varied:
        return none, f"{', '.join(varied)} varies."
    chain = {name: np.array([value]) for name, value in chain_of(table).by_name.items()}
    middle, direction, half = (array[0] for array in _segments_of_chains(chain))
    half = half[..., None]
    reach = direction * half
    ends = np.stack([middle - reach, middle + reach], axis=2)[half[..., 0] > SHORTEST_PIECE]
    order = [_PSI.index(name.removesuffix("_end")) for name in axes]
    return ends[:, :, order], None
