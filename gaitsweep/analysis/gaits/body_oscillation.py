"""How often the body pitches in a cycle of its legs: once, as in canters and gallops, or twice, as in walks.

    python -m gaitsweep.analysis.gaits.body_oscillation results/planar_quadruped_loads

Source: Fukuoka, Habu and Fukui 2015, Sci. Rep. 5:8169, Discussion.
"""

from __future__ import annotations

import argparse

import numpy as np
import pandas as pd

from gaitsweep.analysis.gaits.gait_tables import gaits_in
from gaitsweep.analysis.records import axes_of, require
from gaitsweep.models.planar_quadruped.nine_gaits import CHART, family


def body_oscillation(trace: pd.DataFrame) -> pd.DataFrame:
    """The amplitudes with which the pitch goes once and twice a cycle, over the whole cycles of each row.

    Args:
        trace: row, t (s), pitch (rad) and u_f_LF, ...

    Returns:
        One record for each row with one of the nine gaits: row, what varies, gait, period (s), once and twice
        (rad: half of what is between the extremes of each part).

    Raises:
        AnalysisError: a column is not there.
    """
    require(trace, "row", "t", "pitch")
    every = gaits_in(trace)
    named = every["gait"].isin(CHART).to_numpy()
    gaits = every[["row", *axes_of(trace), "gait", "period"]].loc[named].reset_index(drop=True)
    of_row = {row: samples.sort_values("t") for row, samples in trace.groupby("row")}
    parts = np.zeros((len(gaits), 2))
    for number, (row, period) in enumerate(zip(gaits["row"], gaits["period"], strict=True)):
        t, pitch = (of_row[row][name].to_numpy(float) for name in ("t", "pitch"))
        cycles = (t - t[0]) / period
        whole = cycles < np.floor(cycles[-1])
        for part in (1, 2):
            turning = np.exp(-2j * np.pi * part * cycles[whole])
            parts[number, part - 1] = 2.0 * np.abs(np.mean((pitch[whole] - pitch[whole].mean()) * turning))
    return gaits.assign(once=parts[:, 0], twice=parts[:, 1])


def main() -> None:
    from gaitsweep.table import load

    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("directory", help="the result directory of a trace")
    found = body_oscillation(load(parser.parse_args().directory))
    found["family"] = [family(str(gait)) for gait in found["gait"]]
    axes = [
        name for name in axes_of(found.rename(columns={"gait": "status"})) if name not in ("seed", "pair")
    ]
    means = found.groupby([*axes, "family"]).agg(once=("once", "mean"), twice=("twice", "mean"))
    print(means.round(4).to_string())


if __name__ == "__main__":
    main()
