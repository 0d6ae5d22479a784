"""The swing onsets of four legs, in traces and in tables of crossings."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np
import pandas as pd

from gaitsweep import near_miss
from gaitsweep.analyses import AnalysisError, require
from gaitsweep.papers.fukuoka2015.planar_quadruped.nine_gaits import LEGS

SINCE = "since_{}_n"  # the column of a leg's time since its last onset
_ONSET_TOLERANCE = 1e-6  # s; two records of one onset differ by rounding errors alone


def onsets_in(
    trace: pd.DataFrame, signals: Mapping[str, str], *, level: float = 0.0, falling: bool = False
) -> pd.DataFrame:
    """The swing onsets in a trace: times at which a signal exceeds a level, by linear interpolation.

    Args:
        trace: a trace table: row, t and the signals; there is no onset beside a NaN sample.
        signals: the column of each leg's signal, by the leg's name in `LEGS`.
        level: in the signals' unit. A leg swings while u_f > 0; for contacts take 0.5 and `falling`.
        falling: whether an onset is where the signal falls below the level.

    Returns:
        One record an onset: row, leg, t (s), status where the trace has it.

    Raises:
        AnalysisError: the table does not have a column, or a leg is unknown.
    """
    require(trace, "row", "t", *signals.values())
    require_legs(signals)
    trace = trace.sort_values(["row", "t"], kind="stable")
    row, t = trace["row"].to_numpy(), trace["t"].to_numpy(float)
    way = -1.0 if falling else 1.0
    parts = []
    for leg, name in signals.items():
        over = way * (trace[name].to_numpy(float) - level)
        at = np.flatnonzero((row[:-1] == row[1:]) & (over[:-1] <= 0.0) & (over[1:] > 0.0))
        share = over[at] / (over[at] - over[at + 1])
        columns = {"row": row[at], "leg": leg, "t": t[at] + share * (t[at + 1] - t[at])}
        if "status" in trace.columns:
            columns["status"] = trace["status"].to_numpy(object)[at]
        parts.append(pd.DataFrame(columns))
    return pd.concat(parts, ignore_index=True).sort_values(["row", "t"], kind="stable", ignore_index=True)


def onsets_of_crossings(table: pd.DataFrame) -> pd.DataFrame:
    """The swing onsets in a table of crossings, for `gait_of`.

    If a leg begins to swing twice between two crossings, the first onset is unknown.

    Args:
        table: records with row, crossing, t (s), status if known, and for each leg the time since its last
            onset (s), since_LF_n and so on, as return maps and ramps of `planar_quadruped` have them.

    Returns:
        One record an onset: row, leg, t (s), status where the table has it.

    Raises:
        AnalysisError: the table does not have a column.
    """
    require(table, "row", "crossing", "t", *(SINCE.format(leg) for leg in LEGS))
    copied = [column for column in ("row", "status") if column in table.columns]
    crossed = table.loc[table["crossing"] > 0]
    parts = []
    for leg in LEGS:
        t = crossed["t"].to_numpy(float) - crossed[SINCE.format(leg)].to_numpy(float)
        part = crossed[copied].assign(leg=leg, t=t)
        part = part.loc[np.isfinite(t) & (t > 0.0)].sort_values(["row", "t"], kind="stable")
        again = part.groupby("row")["t"].diff() < _ONSET_TOLERANCE
        parts.append(part.loc[~again])
    return pd.concat(parts, ignore_index=True).sort_values(["row", "t"], kind="stable", ignore_index=True)


def require_legs(legs: Iterable[object]) -> None:
    """Refuse names that are no legs."""
    for leg in legs:
        if leg not in LEGS:
            raise AnalysisError(f"{leg} is not a leg{near_miss.suggestion(str(leg), LEGS)}")


FLEXORS = {leg: f"u_f_{leg}" for leg in LEGS}


def onsets_of(
    table: pd.DataFrame,
    *,
    signals: Mapping[str, str] | None = None,
    level: float = 0.0,
    falling: bool = False,
) -> pd.DataFrame:
    """The swing onsets (row, leg, t) in a trace, a table of crossings or a table of onsets.

    Args:
        table: the trace, the table of crossings, or the onsets themselves.
        signals, level, falling: as for `onsets_in`, for a trace; by default the potentials u_f_LF, ...

    Raises:
        AnalysisError: the table is of another kind, or does not have a column.
    """
    require(table, "row")
    if signals is not None:
        return onsets_in(table, signals, level=level, falling=falling)
    if "leg" in table.columns:
        return table
    if SINCE.format(LEGS[0]) in table.columns:
        return onsets_of_crossings(table)
    if all(name in table.columns for name in FLEXORS.values()):
        return onsets_in(table, FLEXORS, level=level, falling=falling)
    raise AnalysisError(
        "The table has no swing onsets: it has neither u_f_LF, ... (a trace), nor "
        "since_LF_n, ... (crossings), nor leg and t (onsets). Of another trace name each leg's column in "
        "`signals`."
    )
