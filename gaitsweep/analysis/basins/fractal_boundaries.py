"""How entangled basins are: their entropy, and how what is uncertain shrinks with a start's error."""

from __future__ import annotations

import dataclasses

import numpy as np
import pandas as pd

from gaitsweep.analysis.basins.grid import BasinGrid

BOX = (
    5  # cells along a side of the boxes of the basin entropy, as in Daza et al.: 25 starts in two dimensions
)
SATURATED = 0.5  # uncertain shares above it are left out of the slope
FEWEST = 3  # sizes that a slope is read from


@dataclasses.dataclass(frozen=True)
class Entropy:
    """Basin entropies, in nats, and the share of boxes that a boundary crosses."""

    basin: float
    boundary: float
    crossed: float


def basin_entropy(grid: BasinGrid, outcomes: np.ndarray, box: int = BOX) -> Entropy:
    """The entropy of outcomes in a box, averaged over boxes, and over those that a boundary crosses.

    Boxes slide over the grid cell by cell, which averages over where a tiling would begin. A boundary entropy
    above ln 2 shows a fractal boundary; a smooth boundary between two basins stays below. NaN where the grid
    is narrower than a box.

    Args:
        grid: the grid.
        outcomes: what each row came to, (n,).
        box: cells along a side.

    Source: Daza et al. 2016, Sci. Rep. 6:31416, eq. 3 to 6.
    """
    if box > min(grid.lengths):
        return Entropy(float("nan"), float("nan"), float("nan"))
    volume = box ** len(grid.lengths)
    entropy: np.ndarray | float = 0.0
    largest: np.ndarray | int = 0
    for each in pd.unique(outcomes):
        held = grid.windows(outcomes == each, box)
        share = held / volume
        entropy = entropy - share * np.log(np.where(held > 0, share, 1.0))
        largest = np.maximum(largest, held)
    crossed = np.asarray(largest) < volume
    # adding + 0.0 turns the -0.0 of one basin alone into 0
    basin = float(np.mean(entropy)) + 0.0
    boundary = float(np.sum(np.where(crossed, entropy, 0.0)) / crossed.sum()) if crossed.any() else 0.0
    return Entropy(basin, boundary, float(crossed.mean()))


def uncertain_shares(grid: BasinGrid, outcomes: np.ndarray, sizes: list[int] | None = None) -> pd.DataFrame:
    """The share of places at which starts that differ by up to eps come to different outcomes.

    Args:
        grid: the grid.
        outcomes: what each row came to, (n,).
        sizes: eps in steps of the grid; `grid.sizes()` if not given.

    Returns:
        One record a size: steps, eps (the geometric mean of the axes' steps times `steps`) and uncertain, the
        share of windows that a boundary crosses, `steps` wide from the first cell's centre to the last one's.
    """
    step = float(np.exp(np.mean(np.log(grid.steps))))
    found = []
    for size in sizes if sizes is not None else grid.sizes():
        held = [grid.windows(outcomes == each, size + 1) for each in pd.unique(outcomes)]
        largest = np.maximum.reduce(held)
        uncertain = float(np.mean(largest < (size + 1) ** len(grid.lengths)))
        found.append({"steps": size, "eps": size * step, "uncertain": uncertain})
    return pd.DataFrame(found, columns=["steps", "eps", "uncertain"])


@dataclasses.dataclass(frozen=True)
class Exponent:
    """The slope of ln uncertain over ln eps, its standard error, and how many sizes it was read from."""

    value: float
    error: float
    sizes: int


def uncertainty_exponent(shares: pd.DataFrame) -> Exponent:
    """The power of eps with which the uncertain share shrinks: 1 at a smooth boundary, less at a fractal one.

    The boundary's dimension is that of the starts less this exponent. Read by least squares from sizes with
    an uncertain share above 0 and up to `SATURATED`; NaN from fewer than `FEWEST`. The error is that of the
    line; the shares of one grid hang together, so it says how straight the line is and no more.

    Args:
        shares: as `uncertain_shares` gives them.

    Source: Grebogi et al. 1983, Phys. Lett. A 99:415; McDonald et al. 1985, Physica D 17:125.
    """
    used = shares[(shares["uncertain"] > 0.0) & (shares["uncertain"] <= SATURATED)]
    if len(used) < FEWEST:
        return Exponent(float("nan"), float("nan"), len(used))
    x, y = (np.log(np.asarray(used[name], float)) for name in ("eps", "uncertain"))
    x = x - x.mean()
    slope = float(np.sum(x * y) / np.sum(x**2))
    left = y - y.mean() - slope * x
    error = float(np.sqrt(np.sum(left**2) / max(len(used) - 2, 1) / np.sum(x**2)))
    return Exponent(slope, error, len(used))
