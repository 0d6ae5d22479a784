"""Measures for the claims of the paper, beside general ones such as `share` and `value`."""

import numpy as np
import pandas as pd

import gaitsweep as gs


@gs.claims.measure
def hopper_launch_error(table: pd.DataFrame, *, g: float, omega: float) -> float:
    """Largest distance (m/s) of a launch from that of a whole number of turns a hop, turns pi g / omega."""
    even = table.loc[table["gait"] != "none"]
    turns = even["gait"].astype(str).str.partition(":")[0].astype(float)
    return float(np.abs(even["launch_end"] - turns * np.pi * g / omega).max())
