"""The swing onsets of four legs in a table; by them the phases, their steadiness, and each row's gait."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from jaxtyping import Bool, Float, Int

from gaitsweep import near_miss
from gaitsweep.analyses import AnalysisError, require, require_single_records
from gaitsweep.papers.fukuoka2015.planar_quadruped.nine_gaits import (
    CHART,
    LEGS,
    MAX_ANTIPHASE_ERROR,
    MAX_VARIATION,
    MIN_LENGTH,
    PAIRS,
    STRICT,
    THRESHOLD,
    margin,
    place,
)
from gaitsweep.status import Status

RowNumbers = Int[np.ndarray, " onsets"]
Phases = Float[np.ndarray, " onsets"]
OfRows = Float[np.ndarray, " rows"]
FLEXORS = {leg: f"u_f_{leg}" for leg in LEGS}  # the columns of the legs' flexors
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
        AnalysisError: the table does not have a column, a leg is unknown, or a row has two samples of a time.
    """
    require(trace, "row", "t", *signals.values())
    require_legs(signals)
    require_single_records(trace, "t")
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
        AnalysisError: the table does not have a column, or a row has a crossing twice.
    """
    require(table, "row", "crossing", "t", *(SINCE.format(leg) for leg in LEGS))
    require_single_records(table, "stair" if "stair" in table.columns else "crossing")
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


GAITS = (*CHART, "unsteady", "none")
_UNSTEADY = len(CHART)
_NONE = len(CHART) + 1
# by their names the deltas would be taken for radians
IN_CYCLES = {name: {"unit": "cycles", "circular": False} for name in ("delta_1", "delta_2")}


@dataclasses.dataclass(frozen=True)
class Steadiness:
    """The criteria of a steady gait (the first two: Fukuoka et al. 2015, completed by the project).

    `length`: least resultant length of delta_1, delta_2 and the fore legs' shift; `variation`: largest
    coefficient of variation of the period; `skipped`: largest share of a row's intervals between onsets of a
    leg that are below half or above one and a half of the period, which are left out of all else; `cycles`:
    smallest number of cycles of a leg; `antiphase_error`: how far the pairs may be from antiphase, in cycles.
    """

    length: float = MIN_LENGTH
    variation: float = MAX_VARIATION
    skipped: float = 0.1
    cycles: int = 3
    antiphase_error: float = MAX_ANTIPHASE_ERROR


def gait_of(
    onsets: pd.DataFrame,
    *,
    window: tuple[Any, Any] = (-math.inf, math.inf),
    rows: Iterable[Any] | None = None,
    thresholds: Sequence[float] = (THRESHOLD, STRICT),
    steadiness: Steadiness | None = None,
) -> pd.DataFrame:
    """The gait of each row, from the swing onsets of its legs.

    A leg's phase is the circular mean of the positions of its onsets in the cycles of another leg. A row's
    gait is one of the nine, `unsteady`, or `none` if it failed, has too few cycles, or has pairs that are not
    in antiphase.

    Args:
        onsets: records with row, leg (a name of `LEGS`) and t (s), and status if known, in any order; NaN is
            left out.
        window: begin and end of the time used, s: numbers, or one for each of the result's rows.
        rows: the rows of the result, including those without onsets; by default those in `onsets`.
        thresholds: largest shift of a pair in phase, cycles; each but the first adds a column of gaits.
        steadiness: criteria of a steady gait.

    Returns:
        One record a row, everything in cycles but for `period` (s), NaN where it is not known: row, cycles
        (of the leg with fewest), period, variation, skipped; delta_1, delta_2 in [-0.5, 0.5); antiphase (of
        the pairs' middles; its length and spread are those of the fore legs' shift) and phase_LF, ... in
        [0, 1), that of LF 0; length_* and spread_* (circular standard deviation) of these; steady, gait,
        gait_at_0.05, margin (see `nine_gaits.margin`).

    Raises:
        AnalysisError: a column is not there, or a leg is unknown.
    """
    require(onsets, "row", "leg", "t")
    require_legs(onsets["leg"].dropna().unique())
    fell = set()
    if "status" in onsets.columns:
        fell = set(onsets.loc[Status.FAILED.among(onsets["status"]), "row"])
    index = pd.Index(np.unique(onsets["row"]) if rows is None else rows, name="row")
    sound = np.isfinite(onsets["t"].to_numpy(float)) & onsets["leg"].notna().to_numpy()
    records = onsets.loc[sound, ["row", "leg", "t"]].astype({"leg": str})
    records = records.assign(row=index.get_indexer(pd.Index(records["row"])))
    records = _inside(records.loc[records["row"] >= 0], window, len(index))
    cycles, table = _cycles(records, len(index))
    table = table.assign(**_shifts(cycles, len(index)))
    table.insert(0, "row", index)
    has_fallen = table["row"].isin(list(fell)).to_numpy()
    table = table.assign(**_named(table, has_fallen, thresholds, steadiness or Steadiness()))
    table.attrs["quantities"] = dict(IN_CYCLES)
    return table


def _inside(records: pd.DataFrame, window: tuple[Any, Any], count: int) -> pd.DataFrame:
    """The onsets in their rows' windows."""
    begin, end = (np.broadcast_to(np.asarray(edge, float), (count,))[records["row"]] for edge in window)
    return records.loc[(records["t"] >= begin) & (records["t"] <= end)]


def _cycles(records: pd.DataFrame, count: int) -> tuple[pd.DataFrame, pd.DataFrame]:
    """The onsets with the duration `lasts` of the cycle each begins (NaN: none), and the rows' cycles."""
    records = records.sort_values(["row", "leg", "t"], kind="stable", ignore_index=True)
    since = records.groupby(["row", "leg"])["t"].diff()
    usual = since.groupby(records["row"]).transform("median").to_numpy(float)
    again = since.to_numpy(float) < 0.5 * usual  # a second onset so soon belongs to the same swing
    odd = np.bincount(records["row"].to_numpy()[again], minlength=count)
    records, usual = records.loc[~again], usual[~again]
    lasts = -records.groupby(["row", "leg"])["t"].diff(-1).to_numpy(float)
    missed = lasts > 1.5 * usual
    odd += np.bincount(records["row"].to_numpy()[missed], minlength=count)
    records = records.assign(lasts=np.where(missed, np.nan, lasts))

    complete = records.dropna()
    row, lasts = complete["row"].to_numpy(), complete["lasts"].to_numpy()
    cycles_by_leg = [np.bincount(row[(complete["leg"] == leg).to_numpy()], minlength=count) for leg in LEGS]
    n = np.bincount(row, minlength=count)
    with np.errstate(invalid="ignore"):
        period = np.bincount(row, lasts, count) / n
        variance = np.bincount(row, (lasts - period[row]) ** 2, count) / n
        skipped = odd / (odd + n)
    table = {"cycles": np.min(cycles_by_leg, axis=0), "period": period}
    return records, pd.DataFrame(table | {"variation": np.sqrt(variance) / period, "skipped": skipped})


def _shifts(cycles: pd.DataFrame, count: int) -> dict[str, OfRows]:
    """Shifts and phases of each of `count` rows, with their resultant lengths and spreads."""
    by_leg = {leg: cycles.loc[cycles["leg"] == leg, ["row", "t", "lasts"]].sort_values("t") for leg in LEGS}
    columns: dict[str, OfRows] = {}

    def add(name: str, leg: str, other: str, lowest: float) -> OfRows:
        """Add the mean phase of a leg in the cycles of another, from `lowest`, its length and spread."""
        mean, length = _mean(*_phases(by_leg[leg], by_leg[other]), count)
        # twice, since by rounding the share of a small negative phase is 1
        columns[name] = (mean - lowest) % 1.0 % 1.0 + lowest
        columns[f"length_{name}"] = length
        deviation = np.sqrt(2.0 * np.abs(np.log(np.maximum(length, 1e-300))))  # rad
        columns[f"spread_{name}"] = deviation / (2.0 * math.pi)
        return columns[name]

    (fore_1, hind_1), (fore_2, hind_2) = PAIRS
    delta_1 = add("delta_1", hind_1, fore_1, -0.5)
    delta_2 = add("delta_2", hind_2, fore_2, -0.5)
    between = add("antiphase", fore_2, fore_1, 0.0)
    columns["antiphase"] = (between + 0.5 * (delta_2 - delta_1)) % 1.0 % 1.0
    for leg in LEGS:
        add(f"phase_{leg}", leg, "LF", 0.0)
    return columns


def _phases(onsets: pd.DataFrame, others: pd.DataFrame) -> tuple[RowNumbers, Phases]:
    """The rows of one leg's onsets within cycles of another, and their phases there, in [0, 1)."""
    begins = others.dropna()
    begins = begins.assign(begin=begins["t"])  # of `others`, an empty frame would take all its rows again
    pairs = pd.merge_asof(onsets[["row", "t"]], begins, on="t", by="row")
    phase = ((pairs["t"] - pairs["begin"]) / pairs["lasts"]).to_numpy()
    inside = phase < 1.0
    return pairs["row"].to_numpy()[inside], phase[inside]


def _mean(row: RowNumbers, phase: Phases, count: int) -> tuple[OfRows, OfRows]:
    """The circular mean of each row's phases, cycles, and its resultant length; NaN if none."""
    angle = 2.0 * math.pi * phase
    x, y = np.bincount(row, np.cos(angle), count), np.bincount(row, np.sin(angle), count)
    with np.errstate(invalid="ignore"):
        n = np.bincount(row, minlength=count)
        return np.arctan2(y / n, x / n) / (2.0 * math.pi), np.minimum(np.hypot(x, y) / n, 1.0)


def _named(
    table: pd.DataFrame, fell: Bool[np.ndarray, " rows"], thresholds: Sequence[float], limits: Steadiness
) -> dict[str, Any]:
    """Columns steady, gait at each threshold, and margin."""
    lengths = table[["length_delta_1", "length_delta_2", "length_antiphase"]].min(axis=1, skipna=False)
    readable = (table["cycles"] >= limits.cycles) & ~fell
    steady = readable & (lengths >= limits.length) & (table["variation"] <= limits.variation)
    steady &= table["skipped"] <= limits.skipped
    opposed = (table["antiphase"] - 0.5).abs() <= limits.antiphase_error
    delta_1, delta_2 = table["delta_1"].to_numpy(), table["delta_2"].to_numpy()
    named: dict[str, Any] = {"steady": steady}
    for number, threshold in enumerate(thresholds):
        which = np.where(steady & opposed, place(delta_1, delta_2, threshold), _NONE)
        which = np.where(readable & ~steady, _UNSTEADY, which)
        named[f"gait_at_{threshold:g}" if number else "gait"] = pd.Categorical.from_codes(which, list(GAITS))
    return named | {"margin": margin(delta_1, delta_2, thresholds[0])}
