"""Summaries of the gaits in a table: measures, repertoires of parameter sets, effect of the threshold."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

import numpy as np
import pandas as pd

from gaitsweep.analyses import AnalysisError, require
from gaitsweep.papers.fukuoka2015.analysis.gait_tables import cases_of, gaits_in
from gaitsweep.papers.fukuoka2015.analysis.gaits_of_onsets import GAITS
from gaitsweep.papers.fukuoka2015.planar_quadruped.nine_gaits import CHART, THRESHOLD
from gaitsweep.status import Status

MEASURES = (
    "speed", "period", "flight", "pitch_range", "pitch_mean", "power_hip", "power_knee", "cost_of_transport",
    "delta_1_mean", "delta_2_mean", "delta_1_touchdown", "delta_2_touchdown", "margin",
)  # fmt: skip

# The gaits and mirror images of each kind; slow kinds first.
KINDS = {
    "walk": ("L-walk", "D-walk"),
    "trot": ("trot",),
    "canter": ("R-canter", "L-canter"),
    "unusual": ("uR-canter", "uL-canter"),
    "gallop": ("RT-gallop", "LT-gallop"),
}


def gait_measures(table: pd.DataFrame, by: str | Sequence[str] | None = None) -> pd.DataFrame:
    """The median measures of each gait at each set of the swept axes.

    Args:
        table: a fixed_time or settle table of a model with gaits.
        by: the columns to group by, besides the gait; by default the swept axes but
            repetitions (seed, pair, scatter).

    Returns:
        One record for each set and gait: by, gait, rows, and the medians of those of `MEASURES` that the
        table has: speed (m/s), period (s), flight (share of a cycle), pitch_range and pitch_mean (rad),
        power_hip and power_knee (W), cost_of_transport (1), the pairs' shifts delta_1_mean, delta_2_mean and
        those by touchdowns, and the margin to the next label (cycles). Rows that failed are left out.

    Raises:
        AnalysisError: the table does not have a column, or none of the measures.
    """
    require(table, "gait", "status")
    if by is None:
        by = cases_of(table)
    axes = [name for name in ([by] if isinstance(by, str) else by) if name != "gait"]
    require(table, *axes)
    # a label's field has no suffix
    columns = {name: name if name in table.columns else f"{name}_end" for name in MEASURES}
    names = {column: name for name, column in columns.items() if column in table.columns}
    if not names:
        raise AnalysisError(f"The table has none of {', '.join(MEASURES)} where its rows end.")
    sound = table.loc[~Status.FAILED.among(table["status"])]
    groups = sound.assign(gait=sound["gait"].astype(str)).groupby([*axes, "gait"], dropna=False)
    medians = groups[list(names)].median().rename(columns=names)
    medians.insert(0, "rows", groups.size())
    return medians.reset_index()


def repertoire(
    table: pd.DataFrame, sets: str | Sequence[str], *, gait: str = "gait", speed: str = "speed_end"
) -> pd.DataFrame:
    """Count the gaits of each parameter set: one record for each set, in the order of the table.

    Columns: the `sets` themselves; `rows`; `fell`; `unsteady`; a count for each of the nine gaits; `gaits`,
    how many of the nine there are; `speed_walk` and so on, the median speed (m/s) of each of `KINDS`;
    `in_order`: walk, trot, canter and gallop are all there and their median speeds rise.

    Args:
        table: a hold or settle table.
        sets: the columns that define a parameter set.
        gait: the column of gaits.
        speed: the column of speeds, m/s.

    Raises:
        AnalysisError: the table does not have a column.
    """
    sets = [sets] if isinstance(sets, str) else list(sets)
    require(table, *sets, gait, speed, "status")
    keys = list(sets)
    fell = Status.FAILED.among(table["status"])
    name = np.where(fell, "", table[gait].astype(str))
    number = table.groupby(keys, sort=False, observed=True).ngroup().to_numpy()
    count = int(number.max(initial=-1)) + 1
    counts = pd.DataFrame(table.drop_duplicates(keys)[keys]).reset_index(drop=True)
    counts["rows"] = np.bincount(number, minlength=count)
    counts["fell"] = np.bincount(number[fell], minlength=count)
    for gait_name in ("unsteady", *CHART):
        counts[gait_name] = np.bincount(number[name == gait_name], minlength=count)
    counts["gaits"] = (counts[list(CHART)] > 0).sum(axis=1)
    for kind, members in KINDS.items():
        shown = np.isin(name, members)
        medians = table.loc[shown, speed].groupby(number[shown]).median()
        counts[f"speed_{kind}"] = medians.reindex(range(count)).to_numpy()
    speeds = counts[[f"speed_{kind}" for kind in ("walk", "trot", "canter", "gallop")]].to_numpy()
    return counts.assign(in_order=np.all(np.diff(speeds, axis=1) > 0.0, axis=1))


THRESHOLDS = (0.03, 0.04, 0.05, 0.06, 0.07, 0.08, 0.09, 0.1)  # cycles
_BIN_WIDTH = 0.01  # cycles


def gaits_by_threshold(
    table: pd.DataFrame,
    thresholds: Sequence[float] = THRESHOLDS,
    window: tuple[float, float] = (-math.inf, math.inf),
) -> pd.DataFrame:
    """The number of rows with each gait, and the kinds of gaits in the order of their median speeds.

    Args:
        table: as for `gait_tables.gaits_in`: by swing onsets where it has them.
        thresholds: largest shifts of a pair in phase, cycles.
        window: begin and end of the time that is used, s; not for a settle table.

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
        medians = {}
        for kind, members in KINDS.items():
            speeds_of_kind = speed[np.isin(gait, members)]
            if np.isfinite(speeds_of_kind).any():
                medians[kind] = float(np.nanmedian(speeds_of_kind))
        counts = {name: int((gait == name).sum()) for name in GAITS}
        shown = sum(counts[name] > 0 for name in itertools.chain(*KINDS.values()))
        order = " ".join(sorted(medians, key=medians.__getitem__))
        records.append({"threshold": threshold, "gaits": shown, **counts, "order": order})
    counted = pd.DataFrame(records)
    return counted.drop(columns=[name for name in GAITS if not np.any(counted[name].to_numpy(int))])


def shift_sizes(gaits: pd.DataFrame) -> pd.DataFrame:
    """The histogram of the sizes of both pairs' shifts, in rows with one of the nine gaits.

    Args:
        gaits: the result of `gait_tables.gaits_in`.

    Returns:
        One record a bin of 0.01: low and high (cycles), read_as (in phase or shifted, by `THRESHOLD`),
        shifts (their number) and, where `gaits` has them, by_touchdowns (the number of those by touchdowns,
        in rows with one of the nine gaits by them).
    """
    edges = _BIN_WIDTH * np.arange(round(0.5 / _BIN_WIDTH) + 1)
    counts = {}
    for number, gait, shifts in (
        ("shifts", "gait", ["delta_1", "delta_2"]),
        ("by_touchdowns", "gait_by_touchdowns", ["delta_1_touchdown", "delta_2_touchdown"]),
    ):
        if gait in gaits.columns:
            sizes = gaits.loc[gaits[gait].isin(CHART), shifts].abs().to_numpy(float)
            counts[number] = np.histogram(sizes, edges)[0]
    sides = np.where(edges[1:] <= THRESHOLD + 0.5 * _BIN_WIDTH, "in phase", "shifted")
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
