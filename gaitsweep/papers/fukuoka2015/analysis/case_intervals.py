"""Intervals of a share, and of a correlation whose records come in cases that are not independent."""

from __future__ import annotations

import numpy as np
import scipy
from jaxtyping import Float, Int

from gaitsweep.analyses import LEVEL

_DRAWS = 4000  # draws of the bootstrap
_AT_ONCE = 2_000_000  # cases drawn at once


def wilson(share: float, draws: int, level: float = LEVEL) -> tuple[float, float]:
    """Wilson's score interval of a share of so many independent draws.

    The share times the draws need not be a whole number, as SciPy's interval asks.

    Source: Wilson 1927, J. Am. Stat. Assoc. 22:209.
    """
    z = scipy.stats.norm.ppf(0.5 + 0.5 * level)
    middle = (share + z**2 / (2 * draws)) / (1 + z**2 / draws)
    half = z / (1 + z**2 / draws) * np.sqrt(share * (1 - share) / draws + z**2 / (4 * draws**2))
    # rounding would put the ends beside 0 and 1
    return 0.0 if share == 0 else float(middle - half), 1.0 if share == 1 else float(middle + half)


def correlation(
    x: Float[np.ndarray, " records"], y: Float[np.ndarray, " records"], case: Int[np.ndarray, " records"]
) -> tuple[float, float, float]:
    """Pearson's r with the ends of its bootstrap interval over cases; NaN for fewer than three cases.

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
    parts = enumerate(_parts(count))
    drawn = np.concatenate([_counts(count, draws, number) @ sums for number, draws in parts])
    r = _pearson(sums.sum(axis=0)[None])[0]
    tails = 50.0 * (1.0 - LEVEL)
    low, high = np.nanpercentile(_pearson(drawn), [tails, 100.0 - tails])
    return float(r), float(low), float(high)


def _parts(count: int) -> list[int]:
    """The numbers of bootstrap draws in each part, so that a part takes little memory."""
    most = max(_AT_ONCE // count, 1)
    return [min(most, _DRAWS - first) for first in range(0, _DRAWS, most)]


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
