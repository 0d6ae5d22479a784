"""Gait bouts: the sequence of gaits along a row of a four-legged model, and the speeds of transitions."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from jaxtyping import Float, Int, Shaped

from gaitsweep.papers.fukuoka2015.analysis.gaits_of_onsets import Steadiness, gait_of
from gaitsweep.papers.fukuoka2015.analysis.swing_onsets import onsets_of
from gaitsweep.papers.fukuoka2015.planar_quadruped.nine_gaits import STRICT, THRESHOLD, family

# The period is not steady while a parameter moves, so only the shifts are tested. Complete cycles of all legs
# are not required, since the first of two onsets between crossings, as in a trot, is not known.
PASSING = Steadiness(variation=math.inf, skipped=0.3, cycles=0)


def gaits_along(
    table: pd.DataFrame,
    *,
    cycles: int = 3,
    signals: Mapping[str, str] | None = None,
    level: float = 0.0,
    falling: bool = False,
    thresholds: Sequence[float] = (THRESHOLD, STRICT),
) -> pd.DataFrame:
    """The gait in each window of a few successive cycles of LF along each row; its period may vary.

    Args:
        table: a trace or a table of crossings, as for `gaits_in`.
        cycles: number of cycles in a window.
        signals, level, falling, thresholds: as for `gaits_in`.

    Returns:
        One record a window: row, begin, end and t (their middle, s), delta_1, delta_2, gait, gait_at_0.05,
        family (walk, trot, canter, gallop), and speed (m/s) where the table has x or speed_n; for a ramp also
        the moving parameter and the pass.

    Raises:
        AnalysisError: the table does not have a column.
    """
    onsets = onsets_of(table, signals=signals, level=level, falling=falling)
    windows, inside = _windows(onsets.sort_values(["row", "t"], kind="stable", ignore_index=True), cycles)
    along = windows.assign(t=0.5 * (windows["begin"] + windows["end"]))
    if not len(along):
        return along.assign(delta_1=0.0, delta_2=0.0, gait="", family="")
    named_cycles = gait_of(inside, rows=range(len(windows)), thresholds=thresholds, steadiness=PASSING)
    named = [name for name in named_cycles.columns if name.startswith(("delta_", "gait"))]
    along = pd.concat([along, named_cycles[named]], axis=1)
    along["family"] = [family(gait) for gait in along["gait"].astype(str)]
    return along.assign(**_beside(table, along))


def gait_bouts(along: pd.DataFrame, by: str = "family", least: int = 2) -> pd.DataFrame:
    """The gait bouts of each row, in order: intervals over which one gait lasts.

    Args:
        along: the result of `gaits_along`.
        by: the column of gaits: family, gait or gait_at_0.05.
        least: least number of windows in a bout; shorter bouts are left out, and their neighbours joined.

    Returns:
        One record a bout: row, `by`, begin and end (s, middles of the first and last window), windows, and
        the values of the other numbers of `along` in these two windows (speed_begin, speed_end, ...).
    """
    numbers = [name for name in along.columns if name not in ("row", "begin", "end", "t")]
    numbers = [name for name in numbers if pd.api.types.is_numeric_dtype(along[name])]
    records: list[dict[str, Any]] = []
    for row, cycles in along.groupby("row", sort=True):
        names = cycles[by].astype(str).to_numpy()
        steady = np.concatenate([part for part in _runs(names) if len(part) >= least] or [np.zeros(0, int)])
        for part in _runs(names[steady]):
            at = cycles.iloc[steady[part]]
            ends = {f"{n}_{e}": at[n].iloc[i] for n in numbers for e, i in (("begin", 0), ("end", -1))}
            times = {"begin": at["t"].iloc[0], "end": at["t"].iloc[-1], "windows": len(at)}
            records.append({"row": row, by: names[steady[part[0]]], **times, **ends})
    return pd.DataFrame(records or {"row": [], by: []})


def _windows(onsets: pd.DataFrame, cycles: int) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Windows of some cycles of LF (row, begin, end), and the onsets inside, with their window as row."""
    row, t = onsets["row"].to_numpy(), onsets["t"].to_numpy(float)
    at = np.flatnonzero((onsets["leg"] == "LF").to_numpy())
    first, last = at[:-cycles], at[cycles:]
    first, last = first[row[first] == row[last]], last[row[first] == row[last]]
    begin, end = t[first], t[last]
    # half a cycle on either side: the other leg of a pair may begin before LF does, or after
    reach = 0.5 * (end - begin) / cycles
    low, high = first.copy(), last.copy()
    for k, number in enumerate(row[first]):
        start, after = np.searchsorted(row, number), np.searchsorted(row, number, "right")
        low[k] = start + np.searchsorted(t[start:after], begin[k] - reach[k])
        high[k] = start + np.searchsorted(t[start:after], end[k] + reach[k], "right") - 1
    count = high - low + 1
    places = np.repeat(high + 1 - np.cumsum(count), count) + np.arange(count.sum())
    inside = onsets.iloc[places][["leg", "t"]].assign(row=np.repeat(np.arange(len(first)), count))
    return pd.DataFrame({"row": row[first], "begin": begin, "end": end}), inside


def _runs(names: Shaped[np.ndarray, " windows"]) -> list[Int[np.ndarray, " run"]]:
    """The indices of each run of equal names."""
    turns = np.flatnonzero(names[1:] != names[:-1]) + 1
    return [part for part in np.split(np.arange(len(names)), turns) if len(part)]


def _beside(table: pd.DataFrame, along: pd.DataFrame) -> dict[str, Float[np.ndarray, " windows"]]:
    """Speed, moving parameter and pass in each window, if the table has them."""
    run = table.attrs.get("job", {}).get("run", {})
    straight = [name for name in (run.get("parameter"), "x", "speed_n") if name in table.columns]
    columns = {name: np.full(len(along), np.nan) for name in straight}
    if "pass" in table.columns:
        columns["pass"] = np.full(len(along), np.nan)
    of_row = along.groupby("row").indices
    for row, trace in table.groupby("row", sort=True):
        at = of_row.get(row)
        trace = trace.loc[np.isfinite(trace["t"].to_numpy(float))].sort_values("t", kind="stable")
        if at is None or not len(trace):
            continue
        t = trace["t"].to_numpy(float)
        begin, middle, end = (along[name].to_numpy(float)[at] for name in ("begin", "t", "end"))
        for name in straight:
            value = trace[name].to_numpy(float)
            if name == "x":
                columns[name][at] = (np.interp(end, t, value) - np.interp(begin, t, value)) / (end - begin)
            else:
                columns[name][at] = np.interp(middle, t, value)
        if "pass" in columns:
            nearest = np.clip(np.searchsorted(t, middle), 0, len(t) - 1)
            columns["pass"][at] = trace["pass"].to_numpy(float)[nearest]
    speed = columns.pop("speed_n", columns.pop("x", None))
    return columns if speed is None else columns | {"speed": speed}
