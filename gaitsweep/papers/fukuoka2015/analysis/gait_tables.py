"""The gait of each row of any table of a four-legged model, and summaries: counts, measures, repertoires."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from gaitsweep.analyses import AnalysisError, axes_of, require
from gaitsweep.papers.fukuoka2015.analysis.swing_onsets import (
    FLEXORS,
    GAITS,
    IN_CYCLES,
    SINCE,
    Steadiness,
    gait_of,
    onsets_of,
)
from gaitsweep.papers.fukuoka2015.planar_quadruped.nine_gaits import (
    CHART,
    LEGS,
    STRICT,
    THRESHOLD,
    margin,
    place,
)
from gaitsweep.status import Status

REPEATS = ("seed", "pair", "scatter")  # axes along which rows are repetitions of one case
_MEAN = "delta_{}_mean_end"


def cases_of(table: pd.DataFrame, own: str | None = None, repeats: Sequence[str] = REPEATS) -> list[str]:
    """The swept axes of a table that tell its cases apart, not those along which rows are repetitions.

    Args:
        table: a result table, or the result of an analysis.
        own: of a result, its first column after `row` and the axes.
        repeats: the axes of repetitions.
    """
    names = [str(name) for name in table.columns]
    axes = axes_of(table) if own is None else names[names.index("row") + 1 : names.index(own)]
    return [name for name in axes if name not in repeats]


def gaits_in(
    table: pd.DataFrame,
    *,
    signals: Mapping[str, str] | None = None,
    level: float = 0.0,
    falling: bool = False,
    window: tuple[Any, Any] = (-math.inf, math.inf),
    thresholds: Sequence[float] = (THRESHOLD, STRICT),
    steadiness: Steadiness | None = None,
) -> pd.DataFrame:
    """The gait of each row at each threshold, with its shifts and their steadiness.

    Args:
        table: a trace with a signal for each leg; records of crossings with since_LF_n and so on (return
            maps, ramps); onsets (row, leg, t); or a settle table of `planar_quadruped`, whose `gait` and
            `margin` are the model's own at its own threshold.
        signals, level, falling: for a trace, the column of each leg and its threshold, as in
            `swing_onsets.onsets_in`; by default the potentials u_f_LF, ... For feet:
            signals={"LF": "contact_1", ...}, level=0.5, falling=True.
        window: begin and end of the time that is used, s; not for a settle table.
        thresholds: largest shift of a pair in phase, cycles; each but the first adds a column of gaits.
        steadiness: criteria of a steady gait; not for a settle table.

    Returns:
        One record a row: row, swept axes, and the columns of `swing_onsets.gait_of`; for a settle table
        cycles, period, variation, delta_1, delta_2, antiphase, length (the least of the shifts), steady,
        gait, gait_at_0.05, margin and, where the table has them, gait_by_touchdowns, delta_1_touchdown and
        delta_2_touchdown.

    Raises:
        AnalysisError: the table is of another kind, or does not have a column; a threshold is outside its
            range; or window or steadiness are given for a settle table.
    """
    for threshold in thresholds:
        if not 0.0 <= threshold <= 0.5:
            raise AnalysisError(f"A threshold is {threshold:g} cycles, but must be from 0 to 0.5.")
    if signals is None and _MEAN.format(1) in table.columns:
        begin, end = window
        if np.any(np.isfinite(begin)) or np.any(np.isfinite(end)) or steadiness is not None:
            raise AnalysisError(
                "A settle table has the averages at the end of each row alone: window and steadiness need a "
                "trace or a table of crossings."
            )
        gaits = _of_averages(table, thresholds)
    else:
        onsets = onsets_of(table, signals=signals, level=level, falling=falling)
        rows = np.unique(table["row"])
        gaits = gait_of(onsets, rows=rows, window=window, thresholds=thresholds, steadiness=steadiness)
    axes = table.groupby("row", sort=True)[axes_of(table)].first()
    for number, name in enumerate(axes.columns):
        gaits.insert(1 + number, name, axes.loc[gaits["row"], name].to_numpy())
    gaits.attrs["quantities"] = table.attrs.get("quantities", {}) | gaits.attrs.get("quantities", {})
    return gaits


def own_gaits_in(table: pd.DataFrame) -> pd.DataFrame | None:
    """The gait of each row of a table of another model by that model's own names, for `gaits_counted`.

    Args:
        table: a table.

    Returns:
        One record a row: row, swept axes, cycles and gait, which is the outcome of a row without one, such as
        failed; None if the table has swing onsets, no gaits, or several records of a row.
    """
    has_onsets = {"leg", _MEAN.format(1), SINCE.format(LEGS[0]), FLEXORS[LEGS[0]]} & set(table.columns)
    if has_onsets or not {"row", "gait", "cycles"} <= set(table.columns) or table["row"].duplicated().any():
        return None
    gaits = table["outcome" if "outcome" in table.columns else "gait"].astype(object).fillna("none")
    return pd.DataFrame(table[["row", *axes_of(table), "cycles"]].assign(gait=gaits))


def gaits_counted(table: pd.DataFrame) -> pd.DataFrame:
    """The number of rows with each gait, for each set of the swept axes, repetitions pooled.

    Args:
        table: the result of `gaits_in` or `own_gaits_in`.

    Raises:
        AnalysisError: the table does not have a column.
    """
    require(table, "row", "gait", "cycles")
    cases = cases_of(table, "cycles")
    gaits = table["gait"].astype(str)
    shown = sorted(set(gaits))
    names = [name for name in GAITS if name in shown]
    names += [name for name in shown if name not in GAITS]
    counts = {name: (gaits == name).astype(int) for name in names}
    if not cases:
        return pd.DataFrame({name: [count.sum()] for name, count in counts.items()})
    return pd.DataFrame(table[cases].assign(**counts).groupby(cases, as_index=False, dropna=False).sum())


def _of_averages(table: pd.DataFrame, thresholds: Sequence[float]) -> pd.DataFrame:
    """The gaits of a settle table, from the averages at the end of its rows."""
    names = {"delta_1": _MEAN.format(1), "delta_2": _MEAN.format(2)}
    names |= {name: f"{name}_end" for name in ("period", "variation", "antiphase", "length")}
    require(table, "row", "cycles", "gait", *names.values())
    table = table.sort_values("row", kind="stable", ignore_index=True)
    gaits = pd.DataFrame({"row": table["row"], "cycles": table["cycles"]})
    for name in ("period", "variation", "delta_1", "delta_2", "antiphase", "length"):
        gaits[name] = table[names[name]].to_numpy(float)
    fell = Status.FAILED.among(table["status"]) if "status" in table.columns else np.zeros(len(table), bool)
    labels = np.where(fell | table["gait"].isna(), "none", table["gait"].astype(str))
    steady = np.isin(labels, CHART)
    gaits["steady"] = steady
    gaits["gait"] = pd.Categorical(labels, list(GAITS))
    shifts = gaits["delta_1"].to_numpy(), gaits["delta_2"].to_numpy()
    for threshold in thresholds[1:]:
        named = np.array(CHART, object)[np.where(steady, place(*shifts, threshold), 4)]
        gaits[f"gait_at_{threshold:g}"] = pd.Categorical(np.where(steady, named, labels), list(GAITS))
    # that of the model is to its own threshold, as the gait is
    gaits["margin"] = table["margin"] if "margin" in table.columns else margin(*shifts, thresholds[0])
    if "gait_by_touchdowns" in table.columns:
        landed = table["gait_by_touchdowns"].astype(object).fillna("none")
        gaits["gait_by_touchdowns"] = pd.Categorical(np.where(fell, "none", landed), list(GAITS))
        for name in ("delta_1_touchdown", "delta_2_touchdown"):
            gaits[name] = table[f"{name}_end"].to_numpy(float)
    gaits.attrs["quantities"] = dict(IN_CYCLES)
    return gaits


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


def repertoire(table: pd.DataFrame, sets: Sequence[str]) -> pd.DataFrame:
    """Count the gaits of each parameter set: one record for each set, in the order of the table.

    Columns: the `sets` themselves; `rows`; `fell`, those that failed in any way; `unsteady`; a count for each
    of the nine gaits; `gaits`, how many of the nine there are; `speed_walk` and so on, the median speed (m/s)
    of each of `KINDS`; `in_order`: walk, trot, canter and gallop are all there and their median speeds rise.

    Args:
        table: a hold or settle table.
        sets: the columns that define a parameter set.

    Raises:
        AnalysisError: the table does not have a column, or `sets` is empty.
    """
    require(table, *sets, "gait", "speed_end", "status")
    if not sets:
        raise AnalysisError("sets is empty: name the columns that define a parameter set.")
    keys = list(sets)
    fell = Status.FAILED.among(table["status"])
    name = np.where(fell, "", table["gait"].astype(str))
    number = table.groupby(keys, sort=False, observed=True, dropna=False).ngroup().to_numpy()
    count = int(number.max(initial=-1)) + 1
    counts = pd.DataFrame(table.drop_duplicates(keys)[keys]).reset_index(drop=True)
    counts["rows"] = np.bincount(number, minlength=count)
    counts["fell"] = np.bincount(number[fell], minlength=count)
    for gait in ("unsteady", *CHART):
        counts[gait] = np.bincount(number[name == gait], minlength=count)
    counts["gaits"] = (counts[list(CHART)] > 0).sum(axis=1)
    for kind, members in KINDS.items():
        shown = np.isin(name, members)
        medians = table.loc[shown, "speed_end"].groupby(number[shown]).median()
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
