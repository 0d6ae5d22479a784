"""Swing onsets out of tables that have a record for each crossing of a section."""

from __future__ import annotations

import numpy as np
import pandas as pd

from gaitsweep.analysis.records import require
from gaitsweep.models.planar_quadruped.nine_gaits import LEGS

_SAME = 1e-6  # s: two records of one onset differ by rounding alone


def onsets_of_crossings(table: pd.DataFrame, name: str = "since_{}_n") -> pd.DataFrame:
    """The onsets that the crossings tell of, for `swing_onsets.gait_of`.

    Of a leg that begins to swing twice between two crossings, the first time is not known.

    Args:
        table: records with row, crossing, t (s), status if known, and for each leg the time since its last
            onset (s), as return maps and ramps of `planar_quadruped` have them.
        name: the column of a leg, {} standing for it.

    Returns:
        One record an onset: row, leg, t (s), status where the table has it.

    Raises:
        AnalysisError: a column is not there.
    """
    require(table, "row", "crossing", "t", *(name.format(leg) for leg in LEGS))
    kept = [column for column in ("row", "status") if column in table.columns]
    crossed = table.loc[table["crossing"] > 0]
    parts = []
    for leg in LEGS:
        t = crossed["t"].to_numpy(float) - crossed[name.format(leg)].to_numpy(float)
        part = crossed[kept].assign(leg=leg, t=t)
        part = part.loc[np.isfinite(t) & (t > 0.0)].sort_values(["row", "t"], kind="stable")
        again = part.groupby("row")["t"].diff() < _SAME
        parts.append(part.loc[~again])
    return pd.concat(parts, ignore_index=True).sort_values(["row", "t"], kind="stable", ignore_index=True)
