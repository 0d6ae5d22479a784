"""The pitching of the body in a gait cycle: once, as in canters and gallops, or twice, as in walks.

Source: Fukuoka, Habu and Fukui 2015, Sci. Rep. 5:8169, Discussion.
"""

from __future__ import annotations

import numpy as np
import pandas as pd
from jaxtyping import Float

from gaitsweep.analyses import axes_of, require
from gaitsweep.papers.fukuoka2015.analysis.gait_bouts import gait_bouts, gaits_along
from gaitsweep.papers.fukuoka2015.analysis.gait_tables import cases_of, gaits_in
from gaitsweep.papers.fukuoka2015.planar_quadruped.nine_gaits import CHART, family


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
    samples_of = {row: samples.sort_values("t") for row, samples in trace.groupby("row")}
    amplitudes = np.zeros((len(gaits), 2))
    for number, (row, period) in enumerate(zip(gaits["row"], gaits["period"], strict=True)):
        t, pitch = (samples_of[row][name].to_numpy(float) for name in ("t", "pitch"))
        cycles = (t - t[0]) / period
        complete = cycles < np.floor(cycles[-1])
        amplitudes[number] = harmonics(cycles[complete], pitch[complete] - pitch[complete].mean())
    return gaits.assign(once=amplitudes[:, 0], twice=amplitudes[:, 1])


def harmonics(
    phase: Float[np.ndarray, " samples"], signal: Float[np.ndarray, " samples"]
) -> tuple[float, float]:
    """The amplitudes of a signal at once and twice the frequency of its phase (cycles), in its unit."""
    once = 2.0 * np.abs(np.mean(signal * np.exp(-2j * np.pi * phase)))
    twice = 2.0 * np.abs(np.mean(signal * np.exp(-4j * np.pi * phase)))
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
        twice (median amplitudes over the windows, rad), body_cycles (oscillations a gait cycle: 2 if twice is
        larger than once, else 1), and agree (share of windows with that number).

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
            of_bout = windows.loc[during & (windows["family"] == bout["family"])]
            medians = {name: of_bout[name].median() for name in ("once", "twice")}
            count = 2 if medians["twice"] > medians["once"] else 1
            agree = (of_bout["twice"] > of_bout["once"]) == (count == 2)
            record = {"row": windows["row"].iloc[0], "pass": int(windows["pass"].iloc[0])}
            record |= {name: bout[name] for name in of_bouts}
            records.append(record | medians | {"body_cycles": count, "agree": float(agree.mean())})
    return pd.DataFrame(records, columns=["row", "pass", *of_bouts, "once", "twice", "body_cycles", "agree"])
