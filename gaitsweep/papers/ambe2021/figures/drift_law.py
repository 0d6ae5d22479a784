"""The settling time of a multi-legged chain with unequal ends, compared with the law of the drift."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator
from typing import Annotated, Any, Literal

import numpy as np
import pandas as pd
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import LogLocator, MaxNLocator, NullLocator, StrMethodFormatter

from gaitsweep.papers.ambe2021.multilegged.chain_of_table import chain_of, profile_of, springs_of
from gaitsweep.papers.ambe2021.theory.chain import Chain
from gaitsweep.papers.ambe2021.theory.solution_sets import drift, worst_case_cycles
from gaitsweep.plot import (
    GaitColumn,
    PlannedTable,
    PlotError,
    Refusal,
    Title,
    Word,
    figure_kind,
    outcome,
    require_columns,
    rows_where,
    theme,
)
from gaitsweep.status import Outcome

EQUAL_WITHIN = 1e-9  # largest asymmetry of equal ends, kg or rad per cycle
ENDS = {"m": [("m_1", "m_end")], "kappa": [("kappa_1", "kappa_end")], "a": [("a_1", "a_end")]}
ENDS["ends"] = list(itertools.chain(*ENDS.values()))
ASYMMETRY_LABELS = {
    "m": "difference of head's and tail's mass, $|m_{N+1} - m_1|$ (kg)",
    **dict.fromkeys(("kappa", "a", "ends"), "drift of the sum of relative phases, $E$ (rad per cycle)"),
}
_FIELDS = {"max": "most cycles", "median": "median"}  # of the starts with a gait: filled and open markers


def _check(figure: Any, table: PlannedTable) -> Iterator[Refusal]:
    if table.missing(["psi_1_end"]):
        yield figure.needs(table, "the multi-legged chain's psi_1")
        return
    if not any(table.missing(pair) is None for pair in ENDS[figure.of]):
        yield ("of",), f"is {figure.of}, but {_in_words(ENDS[figure.of])} must vary in this job."


def _in_words(pairs: Iterable[tuple[str, str]]) -> str:
    """Pairs of columns in a sentence."""
    return ", or ".join(map(" and ".join, pairs))


@figure_kind("settle", check=_check)
def drift_law(
    table: pd.DataFrame,
    *,
    of: Annotated[
        Literal["m", "kappa", "a", "ends"],
        Word(),
        "quantities that differ between head and tail: masses, end springs, amplitudes; ends: any of these",
    ] = "m",
    hue: GaitColumn = "gait",
    title: Title = None,
) -> Figure:
    """Cycles until settled over the asymmetry of the ends, and the worst case of eqs. (30)-(32).

    Shown are the largest and the median number of cycles for each pair of ends and each gait. Pairs that do
    not drift, which keep all their gaits, are left out, and so are starts without a gait. Unequal masses are
    drawn over their difference, to which the drift is proportional; others over the drift itself.

    Args:
        table: a settle table of the multi-legged chain with the columns of the head's and the tail's value.

    Raises:
        PlotError: the table lacks a column, `of` is unknown, or another parameter of the theory varies.
    """
    if of not in ASYMMETRY_LABELS:
        raise PlotError(f"of is {of}, but must be one of {', '.join(ASYMMETRY_LABELS)}.")
    require_columns(table, "cycles", hue)
    ends = [name for pair in ENDS[of] if set(pair) <= set(table.columns) for name in pair]
    if not ends:
        raise PlotError(f"of is {of}, which needs the columns {_in_words(ENDS[of])} of a table.")
    settled = rows_where(table, ~outcome(table, hue).isin([Outcome.NOT_SETTLED, Outcome.FAILED, "none"]))
    with theme.canvas(theme.COLUMN + 0.9, 3.1, title) as figure:
        axes = figure.subplots()
        axes.set_xlabel(theme.wrapped(ASYMMETRY_LABELS[of], theme.width_of(theme.COLUMN + 0.9) - 0.8, 8.5))
        axes.set_ylabel("cycles until settled")
        pairs = _pairs(table, settled, ends, hue, by_mass=of == "m")
        if not len(pairs):
            theme.message(axes, "Of the rows with unequal ends none has settled.")
            return figure
        names = theme.ordered(sorted(pairs[hue].unique()))
        colour, marker = theme.colours(names), theme.markers(names)
        for name in names:
            points = pairs[pairs[hue] == name]
            for field in _FIELDS:
                faces = {"facecolors": colour[name] if field == "max" else "none", "edgecolors": colour[name]}
                style: dict[str, Any] = {"marker": marker[name], "s": 16, "linewidths": 0.8, **faces}
                axes.scatter(points["asymmetry"], points[field], **style)
        law = pd.Series(pairs.groupby("asymmetry")["law"].max())
        axes.plot(law.index, law, color="black", lw=0.9)
        axes.set(xscale="log", yscale="log")
        for axis in (axes.xaxis, axes.yaxis):
            _ticks(axis)
        theme.legend(figure, _key({name: (colour[name], marker[name]) for name in names}), ncols=6)
    return figure


def _key(styles: dict[str, tuple[str, str]]) -> list[Line2D]:
    """The legend: the colour and marker of each gait, what filled and open markers are, and the law."""
    point: dict[str, Any] = {"ls": "", "ms": 4.5, "mew": 0.8}
    gaits = [
        Line2D([], [], color=colour, marker=marker, label=theme.named(name), **point)
        for name, (colour, marker) in styles.items()
    ]
    grey = {"color": "#555555", "marker": "o"}
    faces = zip(_FIELDS.values(), ("#555555", "none"), strict=True)
    fields = [Line2D([], [], mfc=face, label=label, **grey, **point) for label, face in faces]
    return [*gaits, Line2D([], [], color="black", lw=0.9, label="law, eqs. (30)-(32)"), *fields]


def _ticks(axis: Axis) -> None:
    """Ticks at round numbers, more of them where the axis covers less than a decade."""
    low, high = axis.get_view_interval()
    subs = (1.0, 2.0, 5.0) if high > 8.0 * low else (1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0)
    # below a factor of 1.5 a logarithmic axis may have no round number at all
    locator = LogLocator(subs=subs) if high > 1.5 * low else MaxNLocator(2)
    axis.set_major_locator(locator)
    axis.set_minor_locator(NullLocator())
    axis.set_major_formatter(StrMethodFormatter("{x:g}"))


def _pairs(
    table: pd.DataFrame, settled: pd.DataFrame, ends: list[str], hue: str, *, by_mass: bool
) -> pd.DataFrame:
    """Per drifting pair of ends and gait: median and largest cycles, asymmetry, cycles of the law."""
    of_law = ("N", *Chain._fields, *profile_of(table))
    others = [name for name in of_law if name in table and name not in ends]
    for name in others:
        if len(table[name].unique()) > 1:
            all_ends = " and ".join(ends)
            raise PlotError(f"{name} varies, but the law needs one value of all but the ends' {all_ends}.")
    springs = springs_of(table)
    groups = settled.groupby([*ends, settled[hue].astype(str)])["cycles"].agg(["median", "max"])
    pairs = groups.reset_index()
    sets = pairs[ends].assign(**{name: table[name].min() for name in others})  # of one value
    chains = [chain_of(table, sets.iloc[[place]]) for place in range(len(sets))]
    pairs["law"] = [float(worst_case_cycles(springs, chain_of_pair)) for chain_of_pair in chains]
    drifts = np.round([abs(float(drift(chain_of_pair))) for chain_of_pair in chains], 9)
    pairs["asymmetry"] = np.abs(pairs[ends[1]] - pairs[ends[0]]).round(9) if by_mass else drifts
    return rows_where(pairs, pairs["asymmetry"] > EQUAL_WITHIN)
