"""The gait of each row of any table of a four-legged model, and the number of rows with each gait."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from gaitsweep.analyses import AnalysisError, axes_of, require
from gaitsweep.papers.fukuoka2015.analysis.gaits_of_onsets import GAITS, IN_CYCLES, Steadiness, gait_of
from gaitsweep.papers.fukuoka2015.analysis.swing_onsets import onsets_of
from gaitsweep.papers.fukuoka2015.planar_quadruped.nine_gaits import CHART, STRICT, THRESHOLD, margin, place
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
            maps, ramps); onsets (row, leg, t); or a settle table of `planar_quadruped`, whose `gait` is the
            model's own label at its own threshold.
        signals, level, falling: for a trace, the column of each leg and its threshold, as in
            `swing_onsets.onsets_in`; by default the potentials u_f_LF, ... For feet:
            signals={"LF": "contact_1", ...}, level=0.5, falling=True.
        window: begin and end of the time that is used, s; not for a settle table.
        thresholds: largest shift of a pair in phase, cycles; each but the first adds a column of gaits.
        steadiness: criteria of a steady gait; not for a settle table.

    Returns:
        One record a row: row, swept axes, and the columns of `gaits_of_onsets.gait_of`; for a settle table
        cycles, period, variation, delta_1, delta_2, antiphase, length (the least of the shifts), steady,
        gait, gait_at_0.05, margin and, where the table has them, gait_by_touchdowns, delta_1_touchdown and
        delta_2_touchdown.

    Raises:
        AnalysisError: the table is of another kind, or does not have a column; or window or steadiness are
            given for a settle table.
    """
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


def gaits_counted(table: pd.DataFrame) -> pd.DataFrame:
    """The number of rows with each gait, for each set of the swept axes, repetitions pooled.

    Args:
        table: the result of `gaits_in`.

    Raises:
        AnalysisError: the table does not have a column.
    """
    require(table, "row", "gait", "cycles")
    cases = cases_of(table, "cycles")
    gaits = table["gait"].astype(str)
    shown = set(gaits)
    counts = {name: (gaits == name).astype(int) for name in GAITS if name in shown}
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
    gaits["margin"] = margin(*shifts, thresholds[0])
    if "gait_by_touchdowns" in table.columns:
        landed = table["gait_by_touchdowns"].astype(object).fillna("none")
        gaits["gait_by_touchdowns"] = pd.Categorical(np.where(fell, "none", landed), list(GAITS))
        for name in ("delta_1_touchdown", "delta_2_touchdown"):
            gaits[name] = table[f"{name}_end"].to_numpy(float)
    gaits.attrs["quantities"] = dict(IN_CYCLES)
    return gaits
