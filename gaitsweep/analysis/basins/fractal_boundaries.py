"""Fractality of basin boundaries: basin entropy and uncertainty exponent."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd
import scipy

from gaitsweep.analysis.basins.grid import BasinGrid

# Cells along a side of the boxes of the basin entropy, as in Daza et al.: 25 starts in two dimensions.
BOX = 5
SATURATED = 0.5  # largest uncertainty fraction that the fit uses
FEWEST = 3  # least number of sizes in the fit


@dataclasses.dataclass(frozen=True)
class Entropy:
    """Basin entropy and boundary basin entropy, in nats, and the share of boxes that a boundary crosses."""

    basin: float
    boundary: float
    crossed: float


def basin_entropy(grid: BasinGrid, labels: np.ndarray, box: int = BOX) -> Entropy:
    """The entropy of outcomes in a box, averaged over all boxes, and over those that a boundary crosses.

    Boxes slide over the grid cell by cell, which averages over the offset of a tiling. A boundary entropy
    above ln 2 indicates a fractal boundary; a smooth boundary between two basins stays below. NaN where the
    grid is narrower than a box.

    Args:
        grid: the grid.
        labels: the outcome of each row, (n,).
        box: cells along a side.

    Source: Daza et al. 2016, Sci. Rep. 6:31416, eq. 3 to 6.
    """
    if box > min(grid.lengths):
        return Entropy(float("nan"), float("nan"), float("nan"))
    volume = box ** len(grid.lengths)
    entropy: np.ndarray | float = 0.0
    largest: np.ndarray | int = 0
    for each in pd.unique(labels):
        held = grid.windows(labels == each, box)
        share = held / volume
        entropy = entropy - share * np.log(np.where(held > 0, share, 1.0))
        largest = np.maximum(largest, held)
    crossed = np.asarray(largest) < volume
    # adding + 0.0 turns the -0.0 of one basin alone into 0
    basin = float(np.mean(entropy)) + 0.0
    boundary = float(np.sum(np.where(crossed, entropy, 0.0)) / crossed.sum()) if crossed.any() else 0.0
    return Entropy(basin, boundary, float(crossed.mean()))


def uncertainty_fraction(
    grid: BasinGrid, labels: np.ndarray, sizes: Sequence[int] | None = None
) -> pd.DataFrame:
    """The fraction of windows of width eps that hold starts with different outcomes.

    Args:
        grid: the grid.
        labels: the outcome of each row, (n,).
        sizes: eps in steps of the grid; by default `grid.sizes()`.

    Returns:
        One record a size: steps, eps (the geometric mean of the axes' steps times `steps`) and uncertain, the
        fraction of windows that a boundary crosses, `steps` wide from the first cell's centre to the last.
    """
    step = float(np.exp(np.mean(np.log(grid.steps))))
    found = []
    for size in sizes if sizes is not None else grid.sizes():
        held = [grid.windows(labels == each, size + 1) for each in pd.unique(labels)]
        largest = np.maximum.reduce(held)
        uncertain = float(np.mean(largest < (size + 1) ** len(grid.lengths)))
        found.append({"steps": size, "eps": size * step, "uncertain": uncertain})
    return pd.DataFrame(found, columns=["steps", "eps", "uncertain"])


@dataclasses.dataclass(frozen=True)
class Exponent:
    """The slope of ln uncertain over ln eps, its standard error, and the number of sizes in the fit."""

    value: float
    error: float
    sizes: int


def uncertainty_exponent(uncertain: pd.DataFrame) -> Exponent:
    """The uncertainty exponent: the power of eps with which the uncertainty fraction falls.

    It is 1 at a smooth boundary, less at a fractal one; the boundary's dimension is that of the starts less
    this exponent. It is fitted by least squares to sizes with a fraction above 0 and up to `SATURATED`; NaN
    for fewer than `FEWEST`. The standard error measures how straight the line is and no more, since the
    fractions of one grid are correlated.

    Args:
        uncertain: the result of `uncertainty_fraction`.

    Source: Grebogi et al. 1983, Phys. Lett. A 99:415; McDonald et al. 1985, Physica D 17:125.
    """
    used = uncertain[(uncertain["uncertain"] > 0.0) & (uncertain["uncertain"] <= SATURATED)]
    if len(used) < FEWEST:
        return Exponent(float("nan"), float("nan"), len(used))
    x, y = (np.log(np.asarray(used[name], float)) for name in ("eps", "uncertain"))
    fit: Any = scipy.stats.linregress(x, y)
    return Exponent(float(fit.slope), float(fit.stderr), len(used))
