"""The rule of leg loading: the more loaded leg of a diagonal pair begins to swing later.

If the body is pitched nose down, the fore leg of a pair bears more load, its flexor is inhibited more, and it
swings after the hind leg: delta < 0. Pitched nose up, the hind leg bears more: delta > 0. These functions
measure how well loads and pitch in a table agree with the rule (`gaitsweep analyse loading-rule`).

Source: Fukuoka, Habu and Fukui 2015, Sci. Rep. 5:8169, Fig. 5 and 6.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import scipy
from jaxtyping import Float, Int

from gaitsweep.analyses import LEVEL, AnalysisError, require
from gaitsweep.papers.fukuoka2015.analysis.gait_tables import REPEATS, cases_of
from gaitsweep.papers.fukuoka2015.analysis.pair_loads import MEASURES, pairs_in
from gaitsweep.papers.fukuoka2015.planar_quadruped.nine_gaits import THRESHOLD

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
    pearson = correlation(x, delta, case)
    shifted = np.abs(delta) > least
    right = x[shifted] * delta[shifted] < 0.0
    result = {"pairs": len(x), "cases": len(np.unique(case))}
    result |= {"r": pearson.r, "r_low": pearson.low, "r_high": pearson.high}
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
        One record for each set of parameters at which all rows without feedback trot and all rows with it
        have the same walk: row (its number), swept axes, gait (the walk), pair_number (0: the mean of both),
        delta (of the walk, cycles), and the `MEASURES` of the trot.

    Raises:
        AnalysisError: the table does not have a column, or no row is without feedback.
    """
    pairs = pairs_in(table)
    names = [name for name in MEASURES if name in pairs.columns]
    axes = cases_of(pairs, "gait")
    if "k2" not in axes or 0.0 not in set(pairs["k2"]):
        raise AnalysisError("No row has k2 = 0, but the table must contain trots without feedback too.")
    places = [name for name in axes if name != "k2"]
    without = pairs.loc[pairs["k2"] == 0.0]
    is_trot = without["gait"].astype(str) == "trot"
    trots = is_trot.groupby([without[name] for name in places]).all()
    loads = without.groupby(places)[names].mean().loc[trots]
    walking = pairs.loc[pairs["k2"] != 0.0].groupby(axes)
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


class Correlation(NamedTuple):
    """Pearson's r, and the ends of its interval."""

    r: float
    low: float
    high: float


def correlation(
    x: Float[np.ndarray, " records"], y: Float[np.ndarray, " records"], case: Int[np.ndarray, " records"]
) -> Correlation:
    """Pearson's r with the ends of its bootstrap interval over cases; NaN for fewer than three cases.

    Args:
        x, y: the two quantities of each record.
        case: the case of each record; records of a case are drawn together.
    """
    _, case = np.unique(case, return_inverse=True)
    count = int(case.max(initial=-1)) + 1
    if count < 3:
        return Correlation(np.nan, np.nan, np.nan)
    x, y = x - x.mean(), y - y.mean()  # avoids cancellation
    terms = (np.ones_like(x), x, y, x * x, y * y, x * y)
    sums = np.stack([np.bincount(case, term, count) for term in terms], axis=1)
    parts = enumerate(_parts(count))
    drawn = np.concatenate([_counts(count, draws, number) @ sums for number, draws in parts])
    r = _pearson(sums.sum(axis=0)[None])[0]
    tails = 50.0 * (1.0 - LEVEL)
    low, high = np.nanpercentile(_pearson(drawn), [tails, 100.0 - tails])
    return Correlation(float(r), float(low), float(high))


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
