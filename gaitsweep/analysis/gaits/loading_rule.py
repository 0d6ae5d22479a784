"""The rule of leg loading: does the leg of a diagonal pair that bears more begin to swing later?

If the body is tilted down on a pair's two legs, the fore leg bears more, its flexor is inhibited more, and it
swings after the hind leg: delta < 0. Tilted up, the hind leg does: delta > 0.

    python -m gaitsweep.analysis.gaits.loading_rule results/planar_quadruped_loads --split k2

Source: Fukuoka, Habu and Fukui 2015, Sci. Rep. 5:8169, Fig. 5 and 6.
"""

from __future__ import annotations

import argparse
import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd
from scipy.stats import norm

from gaitsweep.analysis.basins.fractions import LEVEL
from gaitsweep.analysis.gaits.gait_tables import gaits_in
from gaitsweep.analysis.gaits.pair_loads import loads_of_settled, loads_of_trace
from gaitsweep.analysis.records import AnalysisError, axes_of, require
from gaitsweep.models.planar_quadruped.nine_gaits import CHART, THRESHOLD

REPEATS = ("seed", "pair", "scatter")  # axes whose rows only repeat a case
_DRAWS = 4000  # of the bootstrap
_AT_ONCE = 2_000_000  # cases drawn at once


@dataclasses.dataclass(frozen=True)
class Measure:
    """Something of a pair's stance that the rule says goes with its shift: what it is, and its unit."""

    meaning: str
    unit: str


# The rule gives each of them the sign against that of delta.
MEASURES = {
    "load_together": Measure("load, fore less hind, before the first of the two swings", "N"),
    "load_late": Measure("load, fore less hind, each in its own late stance", "N"),
    "load_stance": Measure("mean load in stance, fore less hind", "N"),
    "tilt_together": Measure("pitch before the first of the two swings, nose down", "rad"),
    "tilt_late": Measure("pitch in late stance, mean of the two legs', nose down", "rad"),
    "tilt_stance": Measure("mean pitch in stance, mean of the two legs', nose down", "rad"),
}


def pairs_in(table: pd.DataFrame) -> pd.DataFrame:
    """Each diagonal pair of each steady row: its shift, loads and tilts.

    Args:
        table: a trace of `planar_quadruped` (u_f_LF, F_LF, ..., pitch), or a table of where its rows end.
            Late stance is the last 15 % of a cycle before a leg begins to swing; only a trace tells what both
            legs of a pair bear before the first of them does (`load_together`, `tilt_together`).

    Returns:
        One record for each pair of a row with one of the nine gaits: row, what varies, gait, pair (1: RF and
        LH, 2: LF and RH), delta (cycles), and the `MEASURES` that the table tells (N, rad).

    Raises:
        AnalysisError: the table is of no such kind.
    """
    gaits = gaits_in(table)
    gaits = gaits.loc[gaits["gait"].isin(CHART)]
    axes = [name for name in axes_of(table) if name in gaits.columns]
    parts = []
    for pair in (1, 2):
        part = gaits[["row", *axes, "gait"]].assign(pair_number=pair, delta=gaits[f"delta_{pair}"])
        parts.append(part)
    pairs = pd.concat(parts, ignore_index=True)
    measured = (
        loads_of_settled(table) if "late_load_LF_end" in table.columns else loads_of_trace(table, pairs)
    )
    pairs = pairs.merge(measured, on=["row", "pair_number"], how="left")
    pairs = pairs.sort_values(["row", "pair_number"], ignore_index=True)
    pairs.attrs["quantities"] = gaits.attrs.get("quantities", {})
    return pairs


def loading_rule(
    table: pd.DataFrame,
    *,
    split: str | None = None,
    least: float = THRESHOLD,
    repeats: Sequence[str] = REPEATS,
) -> pd.DataFrame:
    """How well each measure of load and tilt goes with a pair's shift.

    Rows that differ in `repeats` alone settle in the same gait or its mirror image, and are no independent
    draws: for the intervals, all pairs of such rows are one case. Those of r are a bootstrap's over cases,
    those of the share Wilson's for as many draws as there are cases with a shift.

    Args:
        table: as for `pairs_in`, or its result.
        split: a column of which each value is judged by itself.
        least: a pair is shifted where |delta| is above it, cycles.
        repeats: axes along which rows are repetitions.

    Returns:
        One record a measure (and value of `split`): measure, pairs, cases, r (of all pairs, with delta; the
        rule says negative), r_low, r_high; shifted (pairs), right (the share of them in which the measure has
        the sign that the rule says), right_low, right_high: intervals of 95 %.

    Raises:
        AnalysisError: a column is not there.
    """
    pairs = table if "delta" in table.columns else pairs_in(table)
    require(pairs, "row", "delta", *([] if split is None else [split]))
    cases = [name for name in axes_of_pairs(pairs) if name not in repeats]
    groups: list[tuple[Any, pd.DataFrame]] = [(None, pairs)]
    if split is not None:
        groups = list(pairs.groupby(split, sort=True, observed=True))
    records = []
    for value, group in groups:
        case = group.groupby(cases, sort=True).ngroup() if cases else group["row"]
        for name in MEASURES:
            if name in group.columns:
                told = {} if split is None else {split: value}
                records.append(told | {"measure": name} | _judged(group, name, case.to_numpy(), least))
    if not records:
        raise AnalysisError(f"The table has none of {', '.join(MEASURES)}.")
    return pd.DataFrame(records)


def axes_of_pairs(pairs: pd.DataFrame) -> list[str]:
    """The columns of what varies in a table that `pairs_in` gives."""
    names = [str(name) for name in pairs.columns]
    return names[names.index("row") + 1 : names.index("gait")]


def _judged(pairs: pd.DataFrame, name: str, case: np.ndarray, least: float) -> dict[str, Any]:
    known = np.isfinite(pairs[name].to_numpy(float))
    x, delta, case = pairs[name].to_numpy(float)[known], pairs["delta"].to_numpy(float)[known], case[known]
    r, r_low, r_high = _correlation(x, delta, case)
    shifted = np.abs(delta) > least
    right = x[shifted] * delta[shifted] < 0.0
    found = {"pairs": len(x), "cases": len(np.unique(case)), "r": r, "r_low": r_low, "r_high": r_high}
    found |= {"shifted": int(shifted.sum()), "right": np.nan, "right_low": np.nan, "right_high": np.nan}
    if shifted.any():
        share, draws = float(right.mean()), len(np.unique(case[shifted]))
        low, high = wilson(share, draws)
        found |= {"right": share, "right_low": low, "right_high": high}
    return found


def wilson(share: float, draws: int, level: float = LEVEL) -> tuple[float, float]:
    """Wilson's score interval of a share of so many independent draws.

    The share times the draws need not be a whole number, as SciPy's interval asks.

    Source: Wilson 1927, J. Am. Stat. Assoc. 22:209.
    """
    z = norm.ppf(0.5 + 0.5 * level)
    middle = (share + z**2 / (2 * draws)) / (1 + z**2 / draws)
    half = z / (1 + z**2 / draws) * np.sqrt(share * (1 - share) / draws + z**2 / (4 * draws**2))
    # rounding would put the ends beside 0 and 1
    return 0.0 if share == 0 else float(middle - half), 1.0 if share == 1 else float(middle + half)


def _correlation(x: np.ndarray, y: np.ndarray, case: np.ndarray) -> tuple[float, float, float]:
    """Pearson's r with the interval of a bootstrap over cases; NaN where there are fewer than three."""
    _, case = np.unique(case, return_inverse=True)
    count = int(case.max(initial=-1)) + 1
    if count < 3:
        return np.nan, np.nan, np.nan
    x, y = x - x.mean(), y - y.mean()  # against cancellation
    sums = np.stack(
        [np.bincount(case, w, count) for w in (np.ones_like(x), x, y, x * x, y * y, x * y)], axis=1
    )
    drawn = np.concatenate(
        [_counts(count, draws, number) @ sums for number, draws in enumerate(_parts(count))]
    )
    r = _pearson(sums.sum(axis=0)[None])[0]
    tails = 50.0 * (1.0 - LEVEL)
    low, high = np.nanpercentile(_pearson(drawn), [tails, 100.0 - tails])
    return float(r), float(low), float(high)


def _parts(count: int) -> list[int]:
    """The draws of a bootstrap over so many cases, in parts that take little memory."""
    most = max(_AT_ONCE // count, 1)
    return [min(most, _DRAWS - done) for done in range(0, _DRAWS, most)]


def _counts(count: int, draws: int, seed: int) -> np.ndarray:
    """How often each of `count` cases comes in each of some draws of as many, (draws, count)."""
    drawn = np.random.default_rng(seed).integers(count, size=(draws, count))
    drawn += count * np.arange(draws)[:, None]
    return np.bincount(drawn.ravel(), minlength=draws * count).reshape(draws, count)


def _pearson(sums: np.ndarray) -> np.ndarray:
    """r (k,) from sums (k, 6) of 1, x, y, x2, y2 and xy."""
    n, x, y, xx, yy, xy = sums.T
    with np.errstate(invalid="ignore", divide="ignore"):
        return (n * xy - x * y) / np.sqrt((n * xx - x * x) * (n * yy - y * y))


def main() -> None:
    from gaitsweep.table import load

    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("directory", help="a result directory of planar_quadruped")
    parser.add_argument("--split", help="a column of which each value is judged by itself")
    given = parser.parse_args()
    print(loading_rule(load(given.directory), split=given.split).round(3).to_string(index=False))


if __name__ == "__main__":
    main()
