"""Figures of the nine gaits: their colours and markers, footfall bars of four legs, and shared checks."""

from __future__ import annotations

import functools
from collections.abc import Iterable, Iterator, Mapping
from types import MappingProxyType
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from gaitsweep import LimbLook
from gaitsweep.papers.fukuoka2015 import extension
from gaitsweep.papers.fukuoka2015.analysis.gait_tables import FLEXORS
from gaitsweep.papers.fukuoka2015.planar_quadruped import drawing
from gaitsweep.papers.fukuoka2015.planar_quadruped.nine_gaits import LEGS
from gaitsweep.plot import (
    PlannedTable,
    PlotError,
    Refusal,
    contact_intervals,
    limb_colours,
    name_limbs,
    theme,
    written,
)

ORDER = (*extension.gait_styles, "none")
NAMES = MappingProxyType({"none": "none of them, or fallen"})
LIMBS: Mapping[str, LimbLook] = MappingProxyType(dict(zip(LEGS, drawing.LIMBS, strict=True)))
CONTACTS = MappingProxyType({leg: f"contact_{i + 1}" for i, leg in enumerate(LEGS)})
FLIGHT = "#E6E6E6"
_BAR = 0.62


@functools.cache
def leg_colours() -> Mapping[str, str]:
    """The colour of each leg, as in all figures of its limbs."""
    return MappingProxyType(dict(zip(LEGS, limb_colours(drawing.LIMBS), strict=True)))


def colour_of(gait: str) -> str:
    """The colour of a gait, or of no gait."""
    return theme.colours([gait])[gait]


def areas_of(gaits: Iterable[str]) -> dict[str, dict[str, Any]]:
    """The look of an area of each gait that occurs; the two sides of a gait share their colour and hatch."""
    present = set(gaits)
    firsts: dict[str, str] = {}
    for gait in [gait for gait in ORDER if gait in present]:
        firsts.setdefault(colour_of(gait), gait)
    hatch = theme.hatches(firsts.values())
    return {gait: theme.hatched(colour_of(gait), hatch[firsts[colour_of(gait)]]) for gait in present}


def marker_of(gait: str) -> str:
    """The marker of a gait, or of no gait."""
    return theme.markers([gait])[gait]


def label_of(gait: str) -> str:
    """The label of a gait, or of no gait, in legends and along axes."""
    label = theme.named(gait)
    return NAMES.get(label, label)


def check_gaits(figure: Any, table: PlannedTable) -> Iterator[Refusal]:
    """Refusal of a table whose gaits cannot be determined."""
    if not has_swing_onsets(table):
        yield figure.needs(table, "the swing onsets of four legs (as from planar_quadruped)")


def has_swing_onsets(table: PlannedTable) -> bool:
    """Whether a table has the swing onsets of legs, for `analysis.gait_tables`."""
    averages = ("delta_1_mean", "delta_2_mean", "period", "variation", "antiphase", "length")
    return (
        table.missing([f"{name}_end" for name in averages]) is None
        or table.missing([f"since_{leg}_n" for leg in LEGS]) is None
        or table.missing(list(FLEXORS.values())) is None
    )


def in_words(table: pd.DataFrame, gait: pd.Series, samples: pd.DataFrame) -> list[str]:
    """The mean speed of a row's samples, and the values of its swept axes, from its entry of `gaits_in`."""
    texts = []
    if "x" in samples.columns:
        t, x = samples["t"].to_numpy(float), samples["x"].to_numpy(float)
        texts.append(f"{(x[-1] - x[0]) / (t[-1] - t[0]):.2f} m/s")
    names = list(map(str, gait.index))
    axes = [name for name in names[1 : names.index("cycles")] if name not in ("seed", "pair")]
    return texts + [written(table, name, gait[name]) for name in axes]


def gait_key(gaits: Iterable[str]) -> list[Line2D]:
    """Legend handles of the gaits that occur, in the order of speed."""
    present = set(gaits)
    return [
        Line2D([], [], ls="", marker=marker_of(gait), color=colour_of(gait), ms=4.5, label=label_of(gait))
        for gait in theme.ordered(ORDER)
        if gait in present
    ]


def footfalls(axes: Axes, samples: pd.DataFrame) -> None:
    """A bar for each leg while it is on the ground, the first leg on top; flight phases in light grey.

    Args:
        axes: the axes, over time in s.
        samples: a part of one row of a trace: t and contact_1, ... in the order of `LEGS`.

    Raises:
        PlotError: a contact is not in the table.
    """
    missing = [contact for contact in CONTACTS.values() if contact not in samples.columns]
    if missing:
        raise PlotError(f"The table has no column {missing[0]}: footfalls need a trace.")
    t = samples["t"].to_numpy(float)
    down = samples[list(CONTACTS.values())].to_numpy(float)
    for row, leg in enumerate(LEGS):
        starts, stops = contact_intervals(t, down[:, row])
        bars = list(zip(starts, stops - starts, strict=True))
        axes.broken_barh(bars, (row - _BAR / 2, _BAR), facecolors=leg_colours()[leg], linewidth=0)
    shade_flights(axes, t, down)
    name_limbs(axes, list(LIMBS.values()))


def shade_flights(axes: Axes, t: np.ndarray, down: np.ndarray) -> None:
    """Light grey flight phases; `t` (n,) s, `down` (n, legs)."""
    for start, stop in zip(*contact_intervals(t, (down.max(axis=1) < 0.5).astype(float)), strict=True):
        axes.axvspan(float(start), float(stop), facecolor=FLIGHT, linewidth=0, zorder=0)
