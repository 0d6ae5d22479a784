"""The gaits and the pitching of the body along a row of a four-legged model, and the speeds of transitions.

The body pitches once in a gait cycle, as in canters and gallops, or twice, as in walks.

Source: Fukuoka, Habu and Fukui 2015, Sci. Rep. 5:8169, Discussion.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd
from jaxtyping import Float, Int, Shaped

from gaitsweep.analyses import AnalysisError, axes_of, require
from gaitsweep.papers.fukuoka2015.analysis.gait_tables import cases_of, gaits_in
from gaitsweep.papers.fukuoka2015.analysis.swing_onsets import Steadiness, gait_of, onsets_of
from gaitsweep.papers.fukuoka2015.planar_quadruped.nine_gaits import CHART, FAMILIES, STRICT, family

Samples = Float[np.ndarray, " samples"]

# The period is not steady while a parameter moves, so only the shifts are tested. Complete cycles of all legs
# are not required, since the first of two onsets between crossings, as in a trot, is not known.
WHILE_RAMPING = Steadiness(variation=math.inf, skipped=0.3, cycles=0)
MIN_WINDOWS = 3  # of a bout that is named in figures, or whose speeds are those of a transition


def gaits_along(table: pd.DataFrame, *, cycles: int = 3) -> pd.DataFrame:
    """The gait in each window of a few successive cycles of LF along each row; its period may vary.

    Args:
        table: a trace or a table of crossings, as for `gaits_in`.
        cycles: number of cycles in a window, 1 or more.

    Returns:
        One record a window: row, begin, end and t (their middle, s), delta_1, delta_2, gait, gait_at_0.05,
        family (walk, trot, canter, gallop), and speed (m/s) where the table has x or speed_n; for a ramp also
        the moving parameter and the pass.

    Raises:
        AnalysisError: the table does not have a column, or `cycles` is below 1.
    """
    if cycles < 1:
        raise AnalysisError(f"cycles is {cycles}, but a window has at least 1 cycle.")
    onsets = onsets_of(table)
    onsets = onsets.loc[np.isfinite(onsets["t"].to_numpy(float))]
    windows, inside = _windows(onsets.sort_values(["row", "t"], kind="stable", ignore_index=True), cycles)
    along = windows.assign(t=0.5 * (windows["begin"] + windows["end"]))
    if not len(along):
        means = {"pass": "pass", "speed_n": "speed", "x": "speed", _parameter(table): _parameter(table)}
        of_table = dict.fromkeys(name for column, name in means.items() if column in table.columns)
        gaits = dict.fromkeys(("gait", f"gait_at_{STRICT:g}", "family"), "")
        return along.assign(delta_1=0.0, delta_2=0.0, **gaits, **dict.fromkeys(of_table, 0.0))
    named_cycles = gait_of(inside, rows=range(len(windows)), steadiness=WHILE_RAMPING)
    named = [name for name in named_cycles.columns if name.startswith(("delta_", "gait"))]
    along = pd.concat([along, named_cycles[named]], axis=1)
    along["family"] = [family(gait) for gait in along["gait"].astype(str)]
    return _with_means(along, table)


def gait_bouts(along: pd.DataFrame, by: str = "family", least: int = 2) -> pd.DataFrame:
    """The gait bouts of each row, in order: intervals over which one gait lasts.

    Args:
        along: the result of `gaits_along`.
        by: the column of gaits: family, gait or gait_at_0.05.
        least: least number of windows in a bout; shorter bouts are left out, and their neighbours joined.

    Returns:
        One record a bout: row, `by`, begin and end (s, middles of the first and last window), windows, and
        the values of the other numbers of `along` in these two windows (speed_begin, speed_end, ...).

    Raises:
        AnalysisError: `along` does not have a column.
    """
    require(along, "row", "t", by)
    numeric = [
        name
        for name in along.columns
        if name not in ("row", "begin", "end", "t") and pd.api.types.is_numeric_dtype(along[name])
    ]
    ends = [f"{name}_{end}" for name in numeric for end in ("begin", "end")]
    records: list[dict[str, Any]] = []
    for row, windows in along.groupby("row", sort=True):
        names = windows[by].astype(str).to_numpy()
        long_runs = [run for run in _runs(names) if len(run) >= least]
        steady = np.concatenate([*long_runs, np.zeros(0, int)])
        for run in _runs(names[steady]):
            bout = windows.iloc[steady[run]]
            record = {"row": row, by: names[steady[run[0]]]}
            record |= {"begin": bout["t"].iloc[0], "end": bout["t"].iloc[-1], "windows": len(bout)}
            for name in numeric:
                record |= {f"{name}_begin": bout[name].iloc[0], f"{name}_end": bout[name].iloc[-1]}
            records.append(record)
    return pd.DataFrame(records, columns=["row", by, "begin", "end", "windows", *ends])


def _windows(onsets: pd.DataFrame, cycles: int) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Windows of some cycles of LF (row, begin, end), and the onsets inside, with their window as row."""
    row, t = onsets["row"].to_numpy(), onsets["t"].to_numpy(float)
    onsets_of_LF = np.flatnonzero((onsets["leg"] == "LF").to_numpy())
    first, last = onsets_of_LF[:-cycles], onsets_of_LF[cycles:]
    first, last = first[row[first] == row[last]], last[row[first] == row[last]]
    begin, end = t[first], t[last]
    # half a cycle on either side: the other leg of a pair may begin before LF does, or after
    reach = 0.5 * (end - begin) / cycles
    low = first.copy()
    high = last.copy()
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


def _with_means(along: pd.DataFrame, table: pd.DataFrame) -> pd.DataFrame:
    """The windows with their moving parameter, pass and speed, those that the table has."""
    parameter = _parameter(table)
    traces = dict(iter(table.groupby("row")))
    means = [_means_of_row(traces[row], windows, parameter) for row, windows in along.groupby("row")]
    return along.join(pd.concat(means))


def _parameter(table: pd.DataFrame) -> str | None:
    """The moving parameter of the table's job."""
    return table.attrs.get("job", {}).get("run", {}).get("parameter")


def _means_of_row(trace: pd.DataFrame, windows: pd.DataFrame, parameter: str | None) -> pd.DataFrame:
    """The moving parameter, the pass and the speed (m/s) in each window of one row."""
    trace = trace.loc[np.isfinite(trace["t"].to_numpy(float))].sort_values("t", kind="stable")
    t = trace["t"].to_numpy(float)
    begin, middle, end = (windows[name].to_numpy(float) for name in ("begin", "t", "end"))
    means = pd.DataFrame(index=windows.index)
    if parameter in trace.columns:
        means[parameter] = np.interp(middle, t, trace[parameter].to_numpy(float))
    if "pass" in trace.columns:
        nearest = np.clip(np.searchsorted(t, middle), 0, len(t) - 1)
        means["pass"] = trace["pass"].to_numpy(float)[nearest]
    if "speed_n" in trace.columns:
        means["speed"] = np.interp(middle, t, trace["speed_n"].to_numpy(float))
    elif "x" in trace.columns:
        x = trace["x"].to_numpy(float)
        means["speed"] = (np.interp(end, t, x) - np.interp(begin, t, x)) / (end - begin)
    return means


def speed_transitions(table: pd.DataFrame, by: str | Sequence[str] = (), cycles: int = 3) -> pd.DataFrame:
    """The speed at which a faster family begins as the speed rises, and a slower one as it falls.

    The transition up from `slower` to `faster` is where a row first comes to `faster` or a family above it;
    the one down is where it then first comes to `slower` or a family below it as the speed falls. The speed
    is the middle of those at the end of one gait bout and the begin of the next. A ramp lags: a width is
    that of this ramp.

    Args:
        table: a ramp, or a trace with a moving parameter, of a model with the nine gaits; the parameter rises
            in pass 0 and falls in pass 1.
        by: swept axes; rows with equal values are pooled.
        cycles: number of cycles in a window of `gaits_along`.

    Returns:
        One record for each set of `by` and pair of families: by, slower, faster; up, up_low, up_high, down,
        down_low, down_high (median, least and largest over the rows, m/s); width (median of up less down of
        the rows that have both, m/s), rows (with both), of (all rows).

    Raises:
        AnalysisError: the table does not have a column, or has no passes up and down, or its parameter falls
            in pass 0.
    """
    by = [by] if isinstance(by, str) else list(by)
    require(table, "row", "t", *by)
    if "pass" not in table.columns:
        raise AnalysisError(
            "These rows have no passes up and down: use a ramp, or a trace with run.parameter."
        )
    path = table.attrs.get("job", {}).get("run", {}).get("path") or []
    if len(path) > 1 and path[1] < path[0]:
        raise AnalysisError(
            f"The parameter falls in pass 0, from {path[0]:g} to {path[1]:g}, but must rise there and "
            "fall in pass 1: begin run.path at the lower value."
        )
    along = gaits_along(after_dwell(table), cycles=cycles)
    if "speed" not in along.columns:
        raise AnalysisError("The table has no speeds (speed_n, or x of a trace).")
    records = []
    named = along.loc[along["family"].isin(FAMILIES)]
    for row in np.unique(table["row"]):
        cycles_of_row = named.loc[named["row"] == row]
        bouts = gait_bouts(cycles_of_row, least=MIN_WINDOWS)
        turn = cycles_of_row.loc[cycles_of_row["pass"] == 1, "t"].min()
        for slower, faster in itertools.pairwise(FAMILIES):
            up, down = _up_and_down(bouts, FAMILIES.index(faster), turn)
            records.append({"row": row, "slower": slower, "faster": faster, "up": up, "down": down})
    speeds = pd.DataFrame(records, columns=["row", "slower", "faster", "up", "down"])
    for name in reversed([name for name in by if name != "row"]):
        speeds.insert(0, name, table.groupby("row")[name].first().reindex(speeds["row"]).to_numpy())
    return _pooled(speeds.assign(width=speeds["up"] - speeds["down"]), [*by, "slower", "faster"])


def after_dwell(table: pd.DataFrame) -> pd.DataFrame:
    """The records of each row after its parameter has begun to move."""
    run = table.attrs.get("job", {}).get("run", {})
    begin: Any = run.get("initial_dwell", 0.0)
    parameter = _parameter(table)
    if "initial_dwell" not in run and parameter in table.columns:  # rows of several jobs
        moves = table[parameter] != table.groupby("row")[parameter].transform("first")
        begin = table["t"].where(moves).groupby(table["row"]).transform("min")
    moving = table.loc[table["t"] >= begin]
    moving.attrs = table.attrs
    return moving


def _up_and_down(bouts: pd.DataFrame, rank: int, turn: float) -> tuple[float, float]:
    """The speeds (m/s) at which a row comes to families of a rank and above, and leaves them; NaN if never.

    Args:
        bouts: the row's gait bouts.
        rank: of the slower of the families above the transition.
        turn: when the parameter begins to fall, s.
    """
    faster = np.array([FAMILIES.index(name) >= rank for name in bouts["family"]], bool)
    middle = 0.5 * (bouts["speed_end"].to_numpy()[:-1] + bouts["speed_begin"].to_numpy()[1:])
    begin = bouts["begin"].to_numpy()[1:]
    up = np.flatnonzero(faster[1:] & ~faster[:-1])
    if not len(up):
        return np.nan, np.nan
    down = np.flatnonzero(~faster[1:] & faster[:-1] & (begin > max(turn, begin[up[0]])))
    return float(middle[up[0]]), float(middle[down[0]]) if len(down) else np.nan


def _pooled(speeds: pd.DataFrame, keys: list[str]) -> pd.DataFrame:
    """The speeds of transitions of all rows with the same keys."""
    groups = speeds.groupby(keys, sort=False)
    pooled = groups.agg(
        up=("up", "median"), up_low=("up", "min"), up_high=("up", "max"),
        down=("down", "median"), down_low=("down", "min"), down_high=("down", "max"),
        width=("width", "median"), rows=("width", "count"), of=("row", "nunique"),
    )  # fmt: skip
    return pooled.reset_index()


def body_oscillation(trace: pd.DataFrame) -> pd.DataFrame:
    """The amplitudes of the pitch at once and twice the gait frequency, over the complete cycles of each row.

    Args:
        trace: row, t (s), pitch (rad) and u_f_LF, ...

    Returns:
        One record for each row with one of the nine gaits: row, swept axes, gait, period (s), once and twice
        (amplitudes, rad).

    Raises:
        AnalysisError: the table does not have a column.
    """
    require(trace, "row", "t", "pitch")
    of_rows = gaits_in(trace)
    named = of_rows["gait"].isin(CHART).to_numpy()
    gaits = of_rows[["row", *axes_of(trace), "gait", "period"]].loc[named].reset_index(drop=True)
    known = trace.loc[np.isfinite(trace["t"].to_numpy(float))]
    samples_of = {row: samples.sort_values("t") for row, samples in known.groupby("row")}
    amplitudes = np.zeros((len(gaits), 2))
    for number, (row, period) in enumerate(zip(gaits["row"], gaits["period"], strict=True)):
        t, pitch = (samples_of[row][name].to_numpy(float) for name in ("t", "pitch"))
        cycles = (t - t[0]) / period
        complete = cycles < np.floor(cycles[-1])
        amplitudes[number] = harmonics(cycles[complete], pitch[complete] - pitch[complete].mean())
    return gaits.assign(once=amplitudes[:, 0], twice=amplitudes[:, 1])


def harmonics(phase: Samples, signal: Samples) -> tuple[float, float]:
    """The amplitudes of a signal at once and twice the frequency of its phase (cycles), in its unit."""
    once, twice = (2.0 * np.abs(np.mean(signal * np.exp(-2j * n * np.pi * phase))) for n in (1, 2))
    return float(once), float(twice)


def family_oscillation(trace: pd.DataFrame) -> pd.DataFrame:
    """The mean of `body_oscillation` for each set of parameters and family of gaits, repetitions pooled.

    Args:
        trace: as for `body_oscillation`.

    Raises:
        AnalysisError: the table does not have a column.
    """
    oscillation = body_oscillation(trace)
    oscillation["family"] = [family(str(gait)) for gait in oscillation["gait"]]
    groups = oscillation.groupby([*cases_of(oscillation, "gait"), "family"])
    return groups.agg(once=("once", "mean"), twice=("twice", "mean"))


def oscillation_along(trace: pd.DataFrame, cycles: int = 4) -> pd.DataFrame:
    """The pitch at once and twice the gait frequency in each gait bout along a row whose speed changes.

    Args:
        trace: row, t (s), pitch (rad), x (m) and u_f_LF, ...
        cycles: number of cycles in a window.

    Returns:
        One record a bout, in order: row, pass, family, speed_begin and speed_end (m/s), windows, once and
        twice (median amplitudes over the windows with a pitch throughout, rad), body_cycles (oscillations a
        gait cycle: 2 if twice is larger than once, else 1), and agree (share of these windows with that
        number); NaN without such a window.

    Raises:
        AnalysisError: the table does not have a column.
    """
    require(trace, "row", "t", "pitch", "x")
    along = gaits_along(trace, cycles=cycles)
    amplitudes = np.full((len(along), 2), np.nan)
    for row, samples in trace.groupby("row"):
        samples = samples.sort_values("t")
        t, pitch = (samples[name].to_numpy(float) for name in ("t", "pitch"))
        for number in np.flatnonzero(along["row"].to_numpy() == row):
            begin, end = along["begin"].iloc[number], along["end"].iloc[number]
            inside = (t >= begin) & (t < end)
            phase = cycles * (t[inside] - begin) / (end - begin)
            trend = np.polyval(np.polyfit(phase, pitch[inside], 1), phase)
            amplitudes[number] = harmonics(phase, pitch[inside] - trend)
    along = along.assign(once=amplitudes[:, 0], twice=amplitudes[:, 1])
    if "pass" not in along.columns:
        along["pass"] = 0
    of_bouts = ["family", "speed_begin", "speed_end", "windows"]
    records = []
    for _, windows in along.groupby(["row", "pass"], sort=True):
        for bout in gait_bouts(windows).to_dict("records"):
            during = windows["t"].between(bout["begin"], bout["end"])
            of_bout = windows.loc[during & (windows["family"] == bout["family"])].dropna(
                subset=["once", "twice"]
            )
            medians = {name: of_bout[name].median() for name in ("once", "twice")}
            count = (2 if medians["twice"] > medians["once"] else 1) if len(of_bout) else np.nan
            agree = (of_bout["twice"] > of_bout["once"]) == (count == 2)
            record = {"row": windows["row"].iloc[0], "pass": int(windows["pass"].iloc[0])}
            record |= {name: bout[name] for name in of_bouts}
            records.append(record | medians | {"body_cycles": count, "agree": float(agree.mean())})
    return pd.DataFrame(records, columns=["row", "pass", *of_bouts, "once", "twice", "body_cycles", "agree"])
