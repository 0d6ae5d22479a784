"""Figures of an atlas: branches over a parameter, bifurcations in the plane of two, events along a branch."""

from __future__ import annotations

import itertools
from typing import Annotated, Any

import numpy as np
import pandas as pd
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.transforms import offset_copy

from gaitsweep.plot import theme
from gaitsweep.plot.arguments import Observable, Title
from gaitsweep.plot.bifurcations.continuation import (
    WORDS,
    Marks,
    draw_branch,
    draw_marks,
    key,
    key_of_marks,
    pieces,
    stretches,
)
from gaitsweep.plot.column_labels import described
from gaitsweep.plot.columns import (
    PlotError,
    branch_parameter,
    origin_of,
    recorded_column,
    require_columns,
    rows_where,
)
from gaitsweep.plot.kind import figure_kind
from gaitsweep.plot.style_names import period_names
from gaitsweep.schema.numbers import CountOrZero

STABLE_WIDTH = 2.2
_BAR = 4.0  # points: width of a bar
# Line styles of curves by the kind of bifurcation.
_LINES: dict[str, Any] = {
    "fold": "-",
    "flip": (0, (5, 1.5)),
    "neimark_sacker": (0, (1, 1)),
    "hopf": (0, (1, 1)),
    "branch_point": (0, (5, 1.5, 1, 1.5)),
    "order_change": (0, (1, 2.5)),
    "corner": (0, (3, 1, 1, 1, 1, 1)),
}
_CURVES = {**WORDS, "branch_point": "pitchfork or transcritical", "order_change": "order of events"}
# Bifurcations of codimension 2: their marks and words.
_MARKS: Marks = {
    "cusp": ("*", "cusp"),
    "resonance_1_1": ("P", "1:1 resonance"),
    "resonance_1_2": ("X", "1:2 resonance"),
    "resonance_1_3": ("^", "1:3 resonance"),
    "resonance_1_4": ("s", "1:4 resonance"),
    "fold_flip": ("D", "fold-flip"),
    "generalized_flip": ("v", "generalized flip"),
    "chenciner": ("h", "Chenciner point"),
    "fold_neimark_sacker": ("<", "fold-Neimark-Sacker"),
    "flip_neimark_sacker": (">", "flip-Neimark-Sacker"),
    "double_neimark_sacker": ("8", "double Neimark-Sacker"),
    "pitchfork_flip": ("d", "pitchfork-flip"),
    "pitchfork_neimark_sacker": ("p", "pitchfork-Neimark-Sacker"),
    "bogdanov_takens": ("P", "Bogdanov-Takens"),
    "generalized_hopf": ("h", "generalized Hopf"),
    "fold_hopf": ("<", "fold-Hopf"),
    "double_hopf": ("8", "double Hopf"),
    "pitchfork_hopf": ("p", "pitchfork-Hopf"),
}
# Line styles of the times of events, and the beginning of the meaning of their columns.
_EVENT_LINES = ("-", (0, (5, 1.5)), (0, (1, 1)), (0, (5, 1.5, 1, 1.5)))
_MEANING = "first time in the cycle: "


@figure_kind("atlas")
def road_map(
    table: pd.DataFrame,
    *,
    y: Annotated[Observable | None, "observable of the model; by default its first"] = None,
    row: Annotated[CountOrZero, "row of the job"] = 0,
    title: Title = None,
) -> Figure:
    """Draw the branches of all gaits over the parameter, stable ones thick, with their bifurcations.

    Colours are the gaits, or the periods of gaits that have no names (`colours: {period 1: red}`). Of a gait
    of several crossings, the one that the table has is drawn; `gs.return_map(...).orbit` gives the others. A
    grey line marks where gaits were searched.

    Args:
        table: the table of an atlas.
        y: the observable, by default the first of the table.
        row: the row of the job.

    Raises:
        PlotError: the table lacks a column, or the row.
    """
    x = branch_parameter(table)
    require_columns(table, x, "part", "gait", "period", "stable", "special")
    name = recorded_column(table, y)
    of_row = _of_row(table, row)
    branches = rows_where(of_row, (of_row["part"] == "branch") & of_row[name].notna())
    with theme.diagram(table, x, name, title) as (figure, axes):
        if not len(branches):
            theme.message(axes, "No gait was found.")
            return figure
        origin = origin_of(table, name, branches[name].to_numpy(float))
        parts = [part for _, branch in branches.groupby("number") for part in _parts_of_gaits(branch)]
        colours = theme.colours(theme.ordered(dict.fromkeys(gait for gait, _ in parts)))
        run = table.attrs["job"]["run"]
        searched_at = run.get("at")
        if searched_at is None:
            searched_at = next(iter(run.get("path") or ()), None)
        if searched_at is not None:
            axes.axvline(searched_at, color="#BBBBBB", lw=0.8, zorder=0)
        for gait, part in parts:
            draw_branch(axes, part, x, name, colours[gait], origin=origin, stable_width=STABLE_WIDTH)
        theme.value_axis(axes, angle=origin is not None)
        handles: list[Any] = [
            Line2D([], [], color=colour, lw=STABLE_WIDTH, label=theme.named(gait))
            for gait, colour in colours.items()
        ]
        theme.legend(figure, [*handles, *key(branches, coloured=True, stable_width=STABLE_WIDTH)], ncols=3)
    return figure


@figure_kind("atlas", coloured="periods")
def atlas(
    table: pd.DataFrame, *, row: Annotated[CountOrZero, "row of the job"] = 0, title: Title = None
) -> Figure:
    """Draw the curves of bifurcations in the plane of both parameters, and what happens along them.

    Line styles are the kinds of bifurcation, colours the periods of the gaits. Thin lines are bifurcations of
    gaits that are unstable on both sides. Bars at the value of the second parameter at which branches were
    followed are the stable gaits there: a region has those of the bars in it.

    Args:
        table: the table of an atlas with a second parameter.
        row: the row of the job.

    Raises:
        PlotError: the atlas has no second parameter, or the table lacks the row.
    """
    run = table.attrs.get("job", {}).get("run", {})
    if not run.get("second"):
        raise PlotError("This atlas has no second parameter: give run.second, such as {m_H: [5, 20]}.")
    x = branch_parameter(table)
    y = next(iter(run["second"]))
    require_columns(table, x, y, "part", "period", "stable", "unstable", "special", "found")
    of_row = _of_row(table, row)
    curves = rows_where(of_row, (of_row["part"] != "branch") & (of_row["part"] != ""))
    with theme.diagram(table, x, y, title) as (figure, axes):
        if not len(curves):
            theme.message(axes, "No branch has a bifurcation that can be followed.")
            return figure
        branches = rows_where(of_row, (of_row["part"] == "branch") & of_row["found"].notna())
        periods = period_names(sorted({*curves["period"], *branches["period"]}))
        colours = theme.colours(periods)
        bars = _draw_bars(axes, branches, x, y, colours)
        for _, curve in curves.groupby("number"):
            _draw_curve(axes, curve, x, y, colours)
        handles = _curve_key(curves, colours)
        if run.get("stationary"):
            handles[0].set_label("rest")
        if bars:
            handles.append(Line2D([], [], color="#777777", lw=_BAR, alpha=0.5, label="stable gaits"))
        theme.legend(figure, handles, ncols=3)
    return figure


def _draw_bars(
    axes: Axes, branches: pd.DataFrame, x: str, y: str, colours: dict[str, str]
) -> list[tuple[float, float, int]]:
    """Draw the stable parts of branches as bars at their second parameter; returns these parts."""
    bars = _stable_parts(branches, x)
    if not bars:
        return []
    level = float(branches[y].iloc[0])
    rounding = 1e-6 * float(np.ptp(branches[x].to_numpy(float)))
    ends: list[float] = []  # of the last bar of each lane: bars that overlap lie one above the other
    for low, high, period in bars:
        lane = next((k for k, end in enumerate(ends) if low > end - rounding), len(ends))
        ends[lane : lane + 1] = [high]
        in_lane = offset_copy(axes.transData, axes.get_figure(root=True), 0.0, lane * _BAR, units="points")
        colour = colours[period_names([period])[0]]
        bar = Line2D([low, high], [level, level], lw=_BAR, color=colour, alpha=0.5, zorder=0)
        bar.set(transform=in_lane, solid_capstyle="butt")
        axes.add_artist(bar)
    axes.update_datalim([(end, level) for low, high, _ in bars for end in (low, high)])
    return bars


def _stable_parts(branches: pd.DataFrame, x: str) -> list[tuple[float, float, int]]:
    """The ranges of x in which branches are stable, in order: low, high, and the period of the gait."""
    ranges = []
    for _, branch in branches.groupby("number"):
        at = branch[x].to_numpy(float)
        period = int(branch["period"].iloc[0])
        for piece, part in stretches(pieces(branch)):
            if piece == "stable":
                ranges.append((float(at[part].min()), float(at[part].max()), period))
    return sorted(ranges)


def _of_row(table: pd.DataFrame, row: int) -> pd.DataFrame:
    """The records of a row of the job, in the order of the points along each branch and curve.

    Raises:
        PlotError: the table lacks the row, or a column.
    """
    require_columns(table, "row", "number", "point")
    rows = table["row"].to_numpy(int)
    if row not in rows:
        allowed = f"has the rows 0 to {rows.max()}" if len(rows) else "has no rows yet"
        raise PlotError(f"row is {row}, but the table {allowed}.")
    return rows_where(table, rows == row).sort_values(["number", "point"], kind="stable")


def _parts_of_gaits(branch: pd.DataFrame) -> list[tuple[str, pd.DataFrame]]:
    """The parts of a branch with one gait each, or one period where the model does not name it.

    Each reaches to the first point of the next.
    """
    gaits = branch["gait"].astype(str).tolist()
    period = period_names(branch["period"].unique())[0]
    names = [period if gait in ("none", "nan", "") else gait for gait in gaits]
    return [(name, branch.iloc[part]) for name, part in stretches(names)]


def _draw_curve(axes: Axes, curve: pd.DataFrame, x: str, y: str, colours: dict[str, str]) -> None:
    """Draw one curve and the marks on it."""
    at, up = curve[x].to_numpy(float), curve[y].to_numpy(float)
    colour = colours[period_names(curve["period"])[0]]
    kind = str(curve["part"].iloc[0])
    for of_stable, part in stretches(curve["unstable"].to_numpy(int) == 0):
        axes.plot(at[part], up[part], color=colour, lw=1.8 if of_stable else 0.8, ls=_LINES[kind])
    draw_marks(axes, at, up, curve["special"].to_numpy(object), _MARKS, size=5.5)


def _curve_key(curves: pd.DataFrame, colours: dict[str, str]) -> list[Line2D]:
    """The legend: periods by colour, kinds of bifurcations by line style, and the marks that occur."""
    handles = [Line2D([], [], color=colour, lw=1.8, label=period) for period, colour in colours.items()]
    kinds = set(curves["part"].astype(str))
    handles += [
        Line2D([], [], color="black", lw=1.4, ls=look, label=_CURVES.get(kind, kind))
        for kind, look in _LINES.items()
        if kind in kinds
    ]
    handles += key_of_marks(set(curves["special"].astype(str)), _MARKS, size=5.0)
    if np.any(curves["unstable"].to_numpy(int) > 0):
        handles.append(Line2D([], [], color="black", lw=0.8, label="of an unstable gait"))
    return handles


@figure_kind("atlas", coloured="none")
def orbit_family(
    table: pd.DataFrame,
    *,
    branch: Annotated[CountOrZero, "number of the branch"] = 0,
    row: Annotated[CountOrZero, "row of the job"] = 0,
    title: Title = None,
) -> Figure:
    """Draw the times of the events of the gaits along a branch, as shares of the cycle, and its duration.

    Stable gaits have thick lines. A dotted line marks where the order of events changes.

    Args:
        table: the table of an atlas.
        branch: the number of the branch.
        row: the row of the job.

    Raises:
        PlotError: the table lacks a column, the row or the branch, or the gaits have no events.
    """
    x = branch_parameter(table)
    require_columns(table, x, "part", "time", "stable", "special")
    of_row = _of_row(table, row)
    branches = rows_where(of_row, of_row["part"] == "branch")
    family = rows_where(branches, branches["number"] == branch)
    if not len(family):
        numbers = ", ".join(map(str, np.unique(branches["number"].to_numpy(int))))
        raise PlotError(f"branch is {branch}, but row {row} has the branches {numbers or '(none)'}.")
    names = _events(table, family)
    if not names:
        raise PlotError("The gaits of this branch have no events.")
    with theme.canvas(theme.COLUMN + 1.6, 4.4, title) as figure:
        above, below = figure.subplots(2, 1, sharex=True, height_ratios=[2.2, 1.0])
        duration = family["time"].to_numpy(float)
        colours = theme.colours(names.values())
        lines = dict(zip(names.values(), itertools.cycle(_EVENT_LINES)))
        for column, name in names.items():
            share = family[column].to_numpy(float) / duration
            _draw_along(above, family, x, share, colours[name], lines[name])
        _draw_along(below, family, x, duration, "#333333", "-")
        for at in family.loc[family["special"] == "order_change", x]:
            for axes in (above, below):
                axes.axvline(float(at), color="#777777", ls=":", lw=0.9, zorder=0)
        above.set_ylabel("share of the cycle")
        above.set_ylim(-0.02, 1.02)
        below.set_ylabel("duration (s)")
        below.set_xlabel(described(table, x))
        handles = [
            Line2D([], [], color=colours[name], ls=line, lw=1.8, label=name) for name, line in lines.items()
        ]
        if not family["stable"].to_numpy(bool).all():
            handles.append(Line2D([], [], color="#333333", lw=0.8, label="thin: unstable"))
        theme.legend(figure, handles, ncols=2)
    return figure


def _events(table: pd.DataFrame, family: pd.DataFrame) -> dict[str, str]:
    """The columns of the times of events that occur along a branch, with the name of each event."""
    quantities = table.attrs.get("quantities", {})
    meanings = {
        str(name): str(quantities.get(name, {}).get("meaning", f"{_MEANING}{name}"))
        for name in family
        if str(name).startswith("t_") and np.isfinite(family[name].to_numpy(float)).any()
    }
    # parameters and observables may have such names, too
    return {
        name: meaning.removeprefix(_MEANING)
        for name, meaning in meanings.items()
        if meaning.startswith(_MEANING)
    }


def _draw_along(
    axes: Axes, family: pd.DataFrame, x: str, values: Float[np.ndarray, " points"], colour: str, line: Any
) -> None:
    """Draw a number along the branch, thick where its gaits are stable."""
    at = family[x].to_numpy(float)
    for piece, part in stretches(pieces(family)):
        style = ":" if piece == "kink" else line
        axes.plot(at[part], values[part], color=colour, ls=style, lw=0.8 if piece == "unstable" else 1.8)
