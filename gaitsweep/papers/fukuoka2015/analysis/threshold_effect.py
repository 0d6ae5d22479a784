"""The effect of the threshold by which gaits are named: counts for several, and the sizes of shifts."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pandas as pd

from gaitsweep.analyses import AnalysisError
from gaitsweep.papers.fukuoka2015.analysis.gait_summaries import KINDS
from gaitsweep.papers.fukuoka2015.analysis.gait_tables import gaits_in
from gaitsweep.papers.fukuoka2015.analysis.gaits_of_onsets import GAITS
from gaitsweep.papers.fukuoka2015.planar_quadruped.nine_gaits import CHART, THRESHOLD

THRESHOLDS = (0.03, 0.04, 0.05, 0.06, 0.07, 0.08, 0.09, 0.1)  # cycles
_WIDTH = 0.01  # cycles


def gaits_by_threshold(
    table: pd.DataFrame,
    thresholds: Sequence[float] = THRESHOLDS,
    window: tuple[float, float] = (-math.inf, math.inf),
) -> pd.DataFrame:
    """The number of rows with each gait, and the kinds of gaits in the order of their median speeds.

    Args:
        table: as for `gait_tables.gaits_in`: by swing onsets where it has them.
        thresholds: largest shifts of a pair in phase, cycles.
        window: begin and end of the time that is used, s; not used for a settle table.

    Returns:
        One record for each threshold: threshold, gaits (how many of the nine occur), the rows with each gait
        that occurs at any of them, and order: walk, trot, canter, unusual (canter) and gallop, in the order
        of their median speeds, where the table has speeds.

    Raises:
        AnalysisError: the table is of another kind, or does not have a column.
    """
    if not len(thresholds):
        raise AnalysisError("thresholds is empty: give at least one threshold.")
    gaits = gaits_in(table, window=window, thresholds=(thresholds[0], *thresholds))
    speeds = _speeds(table, window)
    speed = np.array([speeds.get(row, np.nan) for row in gaits["row"].to_numpy()], float)
    records = []
    for threshold in thresholds:
        gait = np.asarray(gaits[f"gait_at_{threshold:g}"], str)
        medians = {
            kind: float(np.nanmedian(speed[np.isin(gait, members)]))
            for kind, members in KINDS.items()
            if np.count_nonzero(np.isfinite(speed[np.isin(gait, members)]))
        }
        counts = {name: int((gait == name).sum()) for name in GAITS}
        shown = sum(counts[name] > 0 for members in KINDS.values() for name in members)
        order = " ".join(sorted(medians, key=lambda kind: medians[kind]))
        records.append({"threshold": threshold, "gaits": shown, **counts, "order": order})
    counted = pd.DataFrame(records)
    return counted.drop(columns=[name for name in GAITS if not np.any(counted[name].to_numpy(int))])


def shift_sizes(gaits: pd.DataFrame, threshold: float = THRESHOLD) -> pd.DataFrame:
    """The histogram of the sizes of both pairs' shifts, in rows with one of the nine gaits.

    Args:
        gaits: the result of `gait_tables.gaits_in`.
        threshold: largest shift of a pair in phase, cycles: a whole number of bins.

    Returns:
        One record a bin of 0.01: low and high (cycles), read_as (in phase or shifted, by the threshold),
        shifts (their number) and, where `gaits` has them, by_touchdowns (the number of those by touchdowns,
        in rows with one of the nine gaits by them).
    """
    edges = _WIDTH * np.arange(round(0.5 / _WIDTH) + 1)
    counts = {}
    for number, gait, shifts in (
        ("shifts", "gait", ["delta_1", "delta_2"]),
        ("by_touchdowns", "gait_by_touchdowns", ["delta_1_touchdown", "delta_2_touchdown"]),
    ):
        if gait in gaits.columns:
            sizes = gaits.loc[gaits[gait].isin(CHART), shifts].abs().to_numpy(float)
            counts[number] = np.histogram(sizes, edges)[0]
    sides = np.where(edges[1:] <= threshold + 0.5 * _WIDTH, "in phase", "shifted")
    sizes = pd.DataFrame({"low": edges[:-1], "high": edges[1:], "read_as": sides, **counts})
    last = int(np.flatnonzero(sizes[list(counts)].any(axis=1)).max(initial=-1))
    return sizes.iloc[: last + 1]


def _speeds(table: pd.DataFrame, window: tuple[float, float]) -> dict[object, float]:
    """The median speed of each row in the window, m/s; empty where the table has no speeds."""
    for name in ("speed_end", "speed_n", "speed"):
        if name in table.columns:
            inside = table if name == "speed_end" else table.loc[table["t"].between(*window)]
            return inside.groupby("row")[name].median().to_dict()
    return {}
