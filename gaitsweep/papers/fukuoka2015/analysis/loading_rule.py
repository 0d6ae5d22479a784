"""The rule of leg loading: the more loaded leg of a diagonal pair begins to swing later.

If the body is pitched nose down, the fore leg of a pair bears more load, its flexor is inhibited more, and it
swings after the hind leg: delta < 0. Pitched nose up, the hind leg bears more: delta > 0. These functions
measure how well loads and pitch in a table agree with the rule (`gaitsweep analyse loading-rule`).

Source: Fukuoka, Habu and Fukui 2015, Sci. Rep. 5:8169, Fig. 5 and 6.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd
import scipy
from jaxtyping import Float, Int

from gaitsweep.analyses import LEVEL, AnalysisError, axes_of, require
from gaitsweep.papers.fukuoka2015.analysis.gait_tables import REPEATS, cases_of, gaits_in
from gaitsweep.papers.fukuoka2015.analysis.swing_onsets import FLEXORS, onsets_of
from gaitsweep.papers.fukuoka2015.planar_quadruped.cycle import LATE_STANCE
from gaitsweep.papers.fukuoka2015.planar_quadruped.nine_gaits import CHART, LEGS, PAIRS, THRESHOLD

Cycles = Float[np.ndarray, " cycles"]
Onsets = Float[np.ndarray, " onsets"]
Records = Float[np.ndarray, " records"]

_MAX_ONSET_LAG = 0.25  # cycles; largest distance of an onset from its expected time


# Meaning and unit of each measure of load or pitch in a pair's stance; by the rule it has the sign of -delta.
MEASURES = {
    "load_together": ("load, fore less hind, before the first of the two swings", "N"),
    "load_late": ("load, fore less hind, each in its own late stance", "N"),
    "load_stance": ("mean load in stance, fore less hind", "N"),
    "tilt_together": ("pitch before the first of the two swings, nose down", "rad"),
    "tilt_late": ("pitch in late stance, mean of the two legs', nose down", "rad"),
    "tilt_stance": ("mean pitch in stance, mean of the two legs', nose down", "rad"),
}


def pairs_in(table: pd.DataFrame) -> pd.DataFrame:
    """The shift, loads and pitch of each diagonal pair of each steady row.

    Args:
        table: a trace of `planar_quadruped` (u_f_LF, F_LF, ..., pitch) with every step, since a touchdown's
            load lasts for a few, or a settle table of it. Late stance is the last 15 % of a cycle before a
            leg begins to swing. Only a trace gives the loads of both legs of a pair before the first swing
            (`load_together`, `tilt_together`).

    Returns:
        One record for each pair of a row with one of the nine gaits: row, swept axes, gait, pair_number (1:
        RF and LH, 2: LF and RH), delta (cycles), and those `MEASURES` that the table gives (N, rad).

    Raises:
        AnalysisError: the table is of another kind.
    """
    gaits = gaits_in(table)
    gaits = gaits.loc[gaits["gait"].isin(CHART)]
    axes = [name for name in axes_of(table) if name in gaits.columns]
    rows = gaits[["row", *axes, "gait"]]
    parts = [rows.assign(pair_number=pair, delta=gaits[f"delta_{pair}"]) for pair in (1, 2)]
    pairs = pd.concat(parts, ignore_index=True)
    settled = "late_load_LF_end" in table.columns
    measured = _loads_of_settled(table) if settled else _loads_of_trace(table, pairs)
    pairs = pairs.merge(measured, on=["row", "pair_number"], how="left")
    pairs = pairs.sort_values(["row", "pair_number"], ignore_index=True)
    pairs.attrs["quantities"] = gaits.attrs.get("quantities", {})
    return pairs


def _loads_of_settled(table: pd.DataFrame) -> pd.DataFrame:
    """Loads (N) and pitch (rad) of each row and pair of a settle table, in each leg's own stance."""
    parts = []
    for number, (fore, hind) in enumerate(PAIRS, start=1):
        part = pd.DataFrame({"row": table["row"], "pair_number": number})
        for when in ("late", "stance"):
            load = [f"{when}_load_{leg}_end" for leg in (fore, hind)]
            tilt = [f"{when}_pitch_{leg}_end" for leg in (fore, hind)]
            require(table, *load, *tilt)
            part[f"load_{when}"] = table[load[0]] - table[load[1]]
            part[f"tilt_{when}"] = 0.5 * (table[tilt[0]] + table[tilt[1]])
        parts.append(part)
    return pd.concat(parts, ignore_index=True)


def _loads_of_trace(trace: pd.DataFrame, pairs: pd.DataFrame) -> pd.DataFrame:
    """Loads (N) and pitch (rad) of each row and pair, averaged over the complete cycles of a trace."""
    require(trace, "row", "t", "pitch", *FLEXORS.values(), *(f"F_{leg}" for leg in LEGS))
    onsets = {
        key: onsets_of_leg["t"].to_numpy(float)
        for key, onsets_of_leg in onsets_of(trace).groupby(["row", "leg"])
    }
    shift = pairs.set_index(["row", "pair_number"])["delta"]
    records = []
    for row, samples in trace.groupby("row", sort=True):
        if (row, 1) not in shift.index:
            continue
        stances = _Stances(samples.sort_values("t", kind="stable"))
        for number, (fore, hind) in enumerate(PAIRS, start=1):
            begins = onsets.get((row, fore), np.zeros(0)), onsets.get((row, hind), np.zeros(0))
            loads = stances.of_pair((fore, hind), begins, float(shift.loc[row, number]))
            records.append({"row": row, "pair_number": number} | loads)
    return pd.DataFrame(records, columns=["row", "pair_number", *MEASURES])


class _Stances:
    """The cumulative integrals of one row's samples, so that means over any interval are differences."""

    def __init__(self, samples: pd.DataFrame) -> None:
        self._t = samples["t"].to_numpy(float)
        pitch = samples["pitch"].to_numpy(float)
        sums = {"pitch": pitch}
        for leg in LEGS:
            load = samples[f"F_{leg}"].to_numpy(float)
            stands = (samples[FLEXORS[leg]].to_numpy(float) <= 0.0).astype(float)
            sums |= {f"F_{leg}": load, f"time_{leg}": stands}
            sums |= {f"F_{leg}_standing": load * stands, f"pitch_{leg}": pitch * stands}
        integral = scipy.integrate.cumulative_trapezoid
        self._sums = {name: integral(value, self._t, initial=0) for name, value in sums.items()}

    def over(self, name: str, begin: Cycles, end: Cycles) -> Cycles:
        """The integral of a signal over intervals of time, N s or rad s.

        Args:
            name: of a cumulative integral, such as pitch or F_LF.
            begin, end: of each interval, s.
        """
        sums = self._sums[name]
        return np.interp(end, self._t, sums) - np.interp(begin, self._t, sums)

    def of_pair(self, legs: tuple[str, str], begins: tuple[Onsets, Onsets], delta: float) -> dict[str, float]:
        """The measures of a pair, averaged over its cycles.

        Args:
            legs: its fore and its hind leg.
            begins: their swing onsets, s.
            delta: its phase shift, cycles.

        Returns:
            The values of `MEASURES` (N, rad); none if no cycle is recorded from its start.
        """
        fore, hind, period = _cycles_of_pair(*begins, delta)
        recorded = np.minimum(fore, hind) - period >= self._t[0]
        fore, hind, period = fore[recorded], hind[recorded], period[recorded]
        if not len(fore):
            return {}
        first = np.minimum(fore, hind)
        late = LATE_STANCE * period
        measures: dict[str, Float[np.ndarray, " cycles"]] = {}
        measures["load_together"] = self._difference(legs, (first, first), late)
        measures["tilt_together"] = self.over("pitch", first - late, first) / late
        measures["load_late"] = self._difference(legs, (fore, hind), late)
        measures["tilt_late"] = sum(self.over("pitch", at - late, at) for at in (fore, hind)) / (2.0 * late)
        load, tilt = [], []
        for leg, at in zip(legs, (fore, hind), strict=True):
            time = self.over(f"time_{leg}", at - period, at)
            load.append(self.over(f"F_{leg}_standing", at - period, at) / time)
            tilt.append(self.over(f"pitch_{leg}", at - period, at) / time)
        measures["load_stance"] = load[0] - load[1]
        measures["tilt_stance"] = 0.5 * (tilt[0] + tilt[1])
        return {name: float(np.mean(value)) for name, value in measures.items()}

    def _difference(self, legs: tuple[str, str], at: tuple[Cycles, Cycles], late: Cycles) -> Cycles:
        """The load on the fore leg less that on the hind leg, before each begins to swing, N."""
        ends = zip(legs, at, strict=True)
        fore, hind = (self.over(f"F_{leg}", end - late, end) / late for leg, end in ends)
        return fore - hind


def _cycles_of_pair(fore: Onsets, hind: Onsets, delta: float) -> tuple[Cycles, Cycles, Cycles]:
    """Onsets of a fore leg, the hind leg's in the same cycles, and the durations of the cycles before, s.

    Args:
        fore, hind: all onsets of the two legs, s.
        delta: the pair's shift, cycles.
    """
    if len(fore) < 2 or not len(hind):
        return np.zeros(0), np.zeros(0), np.zeros(0)
    period = np.diff(fore)
    fore = fore[1:]
    due = fore + delta * period
    nearest = hind[np.abs(hind[None, :] - due[:, None]).argmin(axis=1)]
    belongs = np.abs(nearest - due) < _MAX_ONSET_LAG * period
    return fore[belongs], nearest[belongs], period[belongs]


WALKS = ("L-walk", "D-walk")


def loading_rule(
    table: pd.DataFrame,
    *,
    split: str | None = None,
    least: float = THRESHOLD,
    repeats: Sequence[str] = REPEATS,
) -> pd.DataFrame:
    """The agreement of each measure of load and pitch with the rule.

    Rows that differ in `repeats` alone settle in the same gait or its mirror image, and are not independent:
    for the intervals, all pairs of such rows are one case. The interval of r is a bootstrap over cases; that
    of the share is Wilson's, with as many draws as there are shifted cases.

    Args:
        table: as for `pairs_in`, or its result.
        split: a column; each of its values is analysed separately.
        least: the largest absolute delta of a pair without shift, cycles.
        repeats: axes along which rows are repetitions.

    Returns:
        One record for each measure (and value of `split`): measure, pairs, cases, r (correlation with delta
        over all pairs; negative by the rule), r_low, r_high; shifted (pairs), right (the share of them whose
        measure has the sign of the rule), right_low, right_high: intervals of 95 %.

    Raises:
        AnalysisError: the table does not have a column.
    """
    pairs = table if "delta" in table.columns else pairs_in(table)
    require(pairs, "row", "delta")
    if split is not None:
        require(pairs, split)
    cases = cases_of(pairs, "gait", repeats)
    groups: list[tuple[dict[str, Any], pd.DataFrame]] = [({}, pairs)]
    if split is not None:
        groups = [({split: value}, group) for value, group in pairs.groupby(split, observed=True)]
    records = []
    for value, group in groups:
        case = group.groupby(cases, sort=True).ngroup() if cases else group["row"]
        for name in MEASURES:
            if name in group.columns:
                records.append(value | {"measure": name} | _judged(group, name, case.to_numpy(), least))
    if not records:
        raise AnalysisError(f"The table has none of {', '.join(MEASURES)}.")
    return pd.DataFrame(records)


def _judged(pairs: pd.DataFrame, name: str, case: Int[np.ndarray, " pairs"], least: float) -> dict[str, Any]:
    """The agreement of one measure with the rule, as `loading_rule` returns it; `case` of each pair."""
    x = pairs[name].to_numpy(float)
    delta = pairs["delta"].to_numpy(float)
    finite = np.isfinite(x)
    x, delta, case = x[finite], delta[finite], case[finite]
    r, r_low, r_high = correlation(x, delta, case)
    shifted = np.abs(delta) > least
    right = x[shifted] * delta[shifted] < 0.0
    result = {"pairs": len(x), "cases": len(np.unique(case)), "r": r, "r_low": r_low, "r_high": r_high}
    result |= {"shifted": int(shifted.sum()), "right": np.nan, "right_low": np.nan, "right_high": np.nan}
    if shifted.any():
        share = float(right.mean())
        draws = len(np.unique(case[shifted]))
        low, high = wilson_interval(share, draws)
        result |= {"right": share, "right_low": low, "right_high": high}
    return result


def load_prediction(table: pd.DataFrame) -> pd.DataFrame:
    """The loads of trots without load feedback with the shifts of the walks with it, for `loading_rule`.

    Within one gait the rule is hardly tested, since legs that swing one after the other are loaded unequally
    because of it. Here loads and pitch are those of a trot, whose legs swing together, and the shift is that
    of the walk at the same parameters. Canters and gallops are left out: the start decides which of their two
    mirror images is reached.

    Args:
        table: as for `pairs_in`, with feedback and without (k2 = 0) over the same other parameters.

    Returns:
        One record for each set of parameters at which all rows of the nine gaits without feedback trot, and
        all those with it have the same walk; other rows do not count. Its columns: row (its number), swept
        axes, gait (the walk), pair_number (0: the mean of both), delta (of the walk, cycles), and the
        `MEASURES` of the trot.

    Raises:
        AnalysisError: the table does not have a column, or no row is without feedback.
    """
    pairs = pairs_in(table)
    names = [name for name in MEASURES if name in pairs.columns]
    axes = cases_of(pairs, "gait")
    if "k2" not in axes or 0.0 not in set(pairs["k2"]):
        raise AnalysisError("No row has k2 = 0, but the table must contain trots without feedback too.")
    pairs = pairs.assign(everywhere=0)  # the place of all rows if k2 alone varies
    places = ["everywhere", *(name for name in axes if name != "k2")]
    without = pairs.loc[pairs["k2"] == 0.0]
    is_trot = without["gait"].astype(str) == "trot"
    trots = is_trot.groupby([without[name] for name in places]).all()
    loads = without.groupby(places)[names].mean().loc[trots]
    walking = pairs.loc[pairs["k2"] != 0.0].groupby(["everywhere", *axes])
    walks = walking.agg(gait=("gait", "first"), gaits=("gait", "nunique"), delta=("delta", "mean"))
    walks = walks.reset_index()
    walks = walks.loc[walks["gait"].isin(WALKS) & (walks["gaits"] == 1)]
    rows = walks.merge(loads, left_on=places, right_index=True).reset_index(drop=True)
    rows.insert(0, "row", np.arange(len(rows)))
    return rows.assign(pair_number=0)[["row", *axes, "gait", "pair_number", "delta", *names]]


_BOOTSTRAP_DRAWS = 4000  # draws of the bootstrap
_CASES_PER_PART = 2_000_000  # cases drawn at once


def wilson_interval(share: float, draws: int) -> tuple[float, float]:
    """Wilson's score interval of a share of so many independent draws, at the confidence `LEVEL`.

    The share times the draws need not be a whole number, as SciPy's interval asks.

    Args:
        share: 0 to 1.
        draws: number of independent draws.

    Returns:
        The lower and the upper end.

    Source: Wilson 1927, J. Am. Stat. Assoc. 22:209.
    """
    z = scipy.stats.norm.ppf(0.5 + 0.5 * LEVEL)
    middle = (share + z**2 / (2 * draws)) / (1 + z**2 / draws)
    half = z / (1 + z**2 / draws) * np.sqrt(share * (1 - share) / draws + z**2 / (4 * draws**2))
    # rounding would put the ends beside 0 and 1
    return 0.0 if share == 0 else float(middle - half), 1.0 if share == 1 else float(middle + half)


def correlation(x: Records, y: Records, case: Int[np.ndarray, " records"]) -> tuple[float, float, float]:
    """Pearson's r with the ends of its bootstrap interval over cases.

    They are NaN for fewer than three cases, and where x or y is constant.

    Args:
        x, y: the two quantities of each record.
        case: the case of each record; records of a case are drawn together.
    """
    _, case = np.unique(case, return_inverse=True)
    count = int(case.max(initial=-1)) + 1
    if count < 3:
        return np.nan, np.nan, np.nan
    x, y = x - x.mean(), y - y.mean()  # avoids cancellation
    terms = (np.ones_like(x), x, y, x * x, y * y, x * y)
    sums = np.stack([np.bincount(case, term, count) for term in terms], axis=1)
    r = _pearson(sums.sum(axis=0)[None])[0]
    if np.isnan(r):
        return np.nan, np.nan, np.nan
    parts = enumerate(_parts(count))
    drawn = np.concatenate([_counts(count, draws, number) @ sums for number, draws in parts])
    tails = 50.0 * (1.0 - LEVEL)
    low, high = np.nanpercentile(_pearson(drawn), [tails, 100.0 - tails])
    return float(r), float(low), float(high)


def _parts(count: int) -> list[int]:
    """The numbers of bootstrap draws in each part, so that a part takes little memory."""
    most = max(_CASES_PER_PART // count, 1)
    return [min(most, _BOOTSTRAP_DRAWS - first) for first in range(0, _BOOTSTRAP_DRAWS, most)]


def _counts(count: int, draws: int, seed: int) -> Int[np.ndarray, "draws cases"]:
    """The number of times that each of `count` cases occurs in each draw."""
    drawn = np.random.default_rng(seed).integers(count, size=(draws, count))
    drawn += count * np.arange(draws)[:, None]
    return np.bincount(drawn.ravel(), minlength=draws * count).reshape(draws, count)


def _pearson(sums: Float[np.ndarray, "draws 6"]) -> Float[np.ndarray, " draws"]:
    """Pearson's r from sums of 1, x, y, x2, y2 and xy."""
    n, x, y, xx, yy, xy = sums.T
    with np.errstate(invalid="ignore", divide="ignore"):
        return (n * xy - x * y) / np.sqrt((n * xx - x * x) * (n * yy - y * y))
