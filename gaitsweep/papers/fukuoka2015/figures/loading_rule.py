"""The rule of leg loading: each pair's shift over loads and pitch in its stance (Fukuoka 2015, Fig. 5)."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Mapping, Sequence
from typing import Annotated, Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from gaitsweep import near_miss
from gaitsweep.papers.fukuoka2015.analysis.loading_rule import MEASURES, pairs_in
from gaitsweep.papers.fukuoka2015.analysis.loading_rule import loading_rule as agreement_with_rule
from gaitsweep.papers.fukuoka2015.analysis.swing_onsets import FLEXORS
from gaitsweep.papers.fukuoka2015.figures.gait_looks import (
    ORDER,
    check_gaits,
    colour_of,
    gait_key,
    marker_of,
)
from gaitsweep.papers.fukuoka2015.planar_quadruped.nine_gaits import LEGS, THRESHOLD
from gaitsweep.plot import (
    TEXT_COLUMNS,
    Column,
    PlannedTable,
    PlotError,
    Real,
    Refusal,
    Text,
    Title,
    column,
    figure_kind,
    rows_where,
    theme,
    written,
)

_PANELS_ACROSS = 3
_RULE_COLOUR = "#F0F0F0"


def _check(figure: Any, table: PlannedTable) -> Iterator[Refusal]:
    if without_gaits := list(check_gaits(figure, table)):
        yield from without_gaits
        return
    settled = table.missing(["late_load_LF_end"]) is None
    traced = ["pitch", *FLEXORS.values(), *(f"F_{leg}" for leg in LEGS)]
    if not settled and (name := table.missing(traced)) is not None:
        yield figure.needs(table, f"the signal {name}, or loads where rows end")
    allowed = [name for name in MEASURES if not settled or not name.endswith("together")]
    for at, name in enumerate(figure.measures or []):
        if name not in allowed:
            near = near_miss.suggestion(name, allowed)
            yield ("measures", at), f"is {name}, which is not a measure of this job's table{near}"
    if (figure.only is None) != (figure.value is None):
        field, other = ("only", "value") if figure.only is None else ("value", "only")
        yield (field,), f"is missing, but {other} is set: set both or none."
    elif figure.only in TEXT_COLUMNS:
        yield ("only",), f"is {figure.only}, which is not numeric: use an axis of the job."


@figure_kind("fixed_time", "settle", "trace", check=_check)
def loading_rule(
    table: pd.DataFrame,
    *,
    measures: Annotated[Sequence[Text] | None, "measures to show; by default all of the table"] = None,
    only: Annotated[Column | None, "column of which only one value is shown"] = None,
    value: Annotated[Real | None, "value of the column `only` to show"] = None,
    title: Title = None,
) -> Figure:
    """A panel for each measure: delta over it, a point for each diagonal pair of each steady row.

    The two quadrants where a pair's shift has the sign of the rule are light grey. Above each panel are r and
    the share of shifted pairs in these quadrants.

    Args:
        table: a table of `planar_quadruped`, of a trace or of settled rows or rows of fixed time.

    Raises:
        PlotError: a column or a measure is missing, or one of only and value is given without the other.
    """
    if (only is None) != (value is None):
        raise PlotError("only and value select rows together: give both or none.")
    if only is not None and value is not None:
        column(table, only)
        # values of an axis that are not written one by one are rounded
        table = rows_where(table, np.isclose(table[only].to_numpy(float), value, rtol=1e-9, atol=0.0))
    heading = title if only is None else f"{title or ''} {written(table, only, value)}".strip()
    if not len(table):
        with theme.canvas(theme.PAGE, 2.35, heading) as figure:
            theme.message(figure.subplots(), "no rows yet" if only is None else "No row has this value.")
        return figure
    pairs = pairs_in(table)
    agreement = {str(record["measure"]): record for record in agreement_with_rule(pairs).to_dict("records")}
    names = list(measures or agreement)
    missing = [name for name in names if name not in agreement]
    if missing:
        raise PlotError(f"{missing[0]} is not a measure of this table. Allowed: {', '.join(agreement)}.")
    down, across = theme.shape(len(names), theme.PAGE, 1.9, _PANELS_ACROSS)
    present = set(pairs["gait"].astype(str))
    panel_height = 2.25 if across > 1 else 1.75
    with theme.canvas(theme.PAGE, panel_height * down + 0.6, heading) as figure:
        grid = theme.panels(figure, (down, across), len(names), sharey=True)
        for axes, name in zip(grid, names, strict=True):
            _panel(axes, pairs, name, agreement[name])
        label = "shift of the pair, $\\delta$ (cycles)\nhind leg late: positive"
        theme.label_panels(figure, grid, across, y=label)
        quadrants = Patch(color=_RULE_COLOUR, label="sign as the rule says")
        theme.legend(figure, [*gait_key(present), quadrants], ncols=6)
    return figure


def _panel(axes: Axes, pairs: pd.DataFrame, name: str, agreement: Mapping[Any, Any]) -> None:
    """The shifts of pairs over one measure, the quadrants of the rule, and the agreement above."""
    for gait in theme.ordered(ORDER):
        part = rows_where(pairs, pairs["gait"].astype(str) == gait)
        if len(part):
            style: dict[str, Any] = {"color": colour_of(gait), "marker": marker_of(gait), "ms": 3.4, "ls": ""}
            axes.plot(part[name], part["delta"], mew=0.5, alpha=0.8, **style)
    x, delta = np.abs(pairs[name].to_numpy(float)), np.abs(pairs["delta"].to_numpy(float))
    reach = 1.08 * np.nanmax(x, initial=1e-9)
    height = max(0.3, 1.1 * np.nanmax(delta, initial=0.0))
    axes.set_xlim(-reach, reach)
    axes.set_ylim(-height, height)
    for left, low in ((-reach, THRESHOLD), (0.0, -height)):
        style = {"facecolor": _RULE_COLOUR, "linewidth": 0, "zorder": 0}
        axes.fill_between([left, left + reach], low, low + height - THRESHOLD, **style)
    for line in (axes.axhline, axes.axvline):
        line(0.0, color="#AAAAAA", lw=0.5, zorder=1)
    axes.set_xlabel("\n".join(textwrap.wrap("{} ({})".format(*MEASURES[name]), 30)))
    share = f"sign right {theme.percent(agreement['right'])} %" if agreement["shifted"] else "no pair shifted"
    axes.set_title(f"r = {agreement['r']:.2f}, {share}".replace("-", "\u2212"))
