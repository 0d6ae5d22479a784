"""Distance of settled states of the multi-legged chain from its analytic solutions (Ambe 2021, sec. 3.6)."""

from __future__ import annotations

import numpy as np
import pandas as pd

from gaitsweep.contract import Status
from gaitsweep.papers.ambe2021.theory.gaits import NONE_BEYOND


def largest_distance(table: pd.DataFrame) -> tuple[float, int] | None:
    """The largest distance of settled states from the nearest analytic solution on section 1, and its row.

    Only states that have a gait count: the others are no solutions of the theory.

    Args:
        table: a settle table of the chain, with the column `distance` (rad).

    Returns:
        The distance, rad, and the row; None where the table has no such state.
    """
    if not {"distance", "gait", "status", "row"} <= set(table.columns):
        return None
    distance = np.asarray(table["distance"], float)
    settled = Status.SOUND.among(table["status"])
    labelled = ~np.isin(np.asarray(table["gait"], str), ["locked", "none"])
    counts = settled & labelled & (distance <= NONE_BEYOND)
    if not counts.any():
        return None
    place = int(np.argmax(np.where(counts, distance, -np.inf)))
    return float(distance[place]), int(np.asarray(table["row"])[place])
