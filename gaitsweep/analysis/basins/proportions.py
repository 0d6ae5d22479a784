"""Intervals of confidence for a share of counted cases."""

from __future__ import annotations

import numpy as np
from scipy.stats import beta, norm

LEVEL = 0.95


def wilson(hits: np.ndarray, of: np.ndarray, level: float = LEVEL) -> tuple[np.ndarray, np.ndarray]:
    """Wilson's score interval: covers the share in `level` of samples on average over shares.

    Args:
        hits, of: cases that came so, and all cases, independent draws, (n,) each; `of` above 0.

    Returns:
        Low and high ends, (n,) each.

    Source: Wilson 1927, J. Am. Stat. Assoc. 22:209.
    """
    hits, of = np.asarray(hits, float), np.asarray(of, float)
    z = norm.ppf(0.5 + 0.5 * level)
    share = hits / of
    middle = (share + z**2 / (2 * of)) / (1 + z**2 / of)
    half = z / (1 + z**2 / of) * np.sqrt(share * (1 - share) / of + z**2 / (4 * of**2))
    # the ends at no hits and at all hits are exact; rounding would put them beside
    return np.where(hits == 0, 0.0, middle - half), np.where(hits == of, 1.0, middle + half)


def clopper_pearson(hits: np.ndarray, of: np.ndarray, level: float = LEVEL) -> tuple[np.ndarray, np.ndarray]:
    """Clopper and Pearson's exact interval: covers any share in at least `level` of samples.

    Args, returns: as for `wilson`.

    Source: Clopper and Pearson 1934, Biometrika 26:404.
    """
    hits, of = np.asarray(hits, float), np.asarray(of, float)
    outside = 0.5 * (1.0 - level)
    low = np.where(hits > 0, beta.ppf(outside, np.maximum(hits, 1), of - hits + 1), 0.0)
    high = np.where(hits < of, beta.ppf(1.0 - outside, hits + 1, np.maximum(of - hits, 1)), 1.0)
    return low, high


def one_a_cell(shares: np.ndarray, level: float = LEVEL) -> float:
    """Half the width of the interval for one draw from each of n cells, given the share in each cell (n,).

    Only cells that a boundary crosses add to the error: its variance is the sum of share * (1 - share) over
    n^2 (stratified sampling, Cochran 1977, sec. 5.3).
    """
    shares = np.asarray(shares, float).ravel()
    return float(norm.ppf(0.5 + 0.5 * level) * np.sqrt(np.sum(shares * (1.0 - shares))) / shares.size)
