"""Measures for the claims of the paper, beside general ones such as `share` and `value`."""

import numpy as np
import pandas as pd

import gaitsweep as gs


@gs.claims.measure
def hopper_launch_error(table: pd.DataFrame, *, g: float, omega: float) -> float:
    """Compute the largest error (m/s) of a launch speed: that of n turns a hop is n pi g / omega.

    Args:
        table: the table of settled rows.
        g: gravitational acceleration (m/s2).
        omega: frequency of the oscillator (rad/s).
    """
    locked = table.loc[table["gait"] != "none"]
    turns = locked["gait"].astype(str).str.partition(":")[0].astype(float)
    return float(np.abs(locked["launch_end"] - turns * np.pi * g / omega).max())
