"""The nine gaits in figures: their colours, markers and labels, and the check of a table for them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

import pandas as pd
from matplotlib.lines import Line2D

from gaitsweep.papers.fukuoka2015 import extension
from gaitsweep.papers.fukuoka2015.analysis.gait_tables import cases_of
from gaitsweep.papers.fukuoka2015.analysis.swing_onsets import FLEXORS
from gaitsweep.papers.fukuoka2015.planar_quadruped.nine_gaits import LEGS
from gaitsweep.plot import PlannedTable, Refusal, theme, written

ORDER = (*extension.gait_styles, "none")


def colour_of(gait: str) -> str:
    """The colour of a gait, or of no gait."""
    return theme.colours([gait])[gait]


def areas_of(gaits: Iterable[str]) -> dict[str, dict[str, Any]]:
    """The style of an area of each gait that occurs; the two sides of a gait share their colour and hatch."""
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
    return "none of them, or fallen" if label == "none" else label


def check_gaits(figure: Any, table: PlannedTable) -> Iterator[Refusal]:
    """Refusal of a table without swing onsets, by which `analysis.gait_tables` determines gaits."""
    averages = ("delta_1_mean", "delta_2_mean", "period", "variation", "antiphase", "length")
    forms = ([f"{name}_end" for name in averages], [f"since_{leg}_n" for leg in LEGS], [*FLEXORS.values()])
    if all(map(table.missing, forms)):
        yield figure.needs(table, "the swing onsets of four legs (as from planar_quadruped)")


def in_words(table: pd.DataFrame, gait: pd.Series, samples: pd.DataFrame) -> list[str]:
    """The mean speed of a row's samples, and the values of its swept axes, from its entry of `gaits_in`."""
    texts = []
    if "x" in samples.columns and len(samples) > 1:
        t, x = samples["t"].to_numpy(float), samples["x"].to_numpy(float)
        texts.append(f"{(x[-1] - x[0]) / (t[-1] - t[0]):.2f} m/s")
    return texts + [written(table, name, gait[name]) for name in cases_of(gait.to_frame().T, "cycles")]


def gait_key(gaits: Iterable[str]) -> list[Line2D]:
    """Legend handles of the gaits that occur, in the order of speed."""
    present = set(gaits)
    return [
        Line2D([], [], ls="", marker=marker_of(gait), color=colour_of(gait), ms=4.5, label=label_of(gait))
        for gait in theme.ordered(ORDER)
        if gait in present
    ]
