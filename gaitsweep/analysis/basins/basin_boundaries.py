"""Basin boundaries: their entropy and uncertainty exponent, and the Wada property.

Boundaries are Wada if every boundary point is one of all basins, which is tested by merging basins.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import TypedDict

import numpy as np
import pandas as pd
import scipy
from jaxtyping import Float, Int, Shaped
from scipy import special

from gaitsweep.analysis.basins.fractions import panels_and_axes
from gaitsweep.analysis.basins.grid import BasinGrid, find_grid
from gaitsweep.analysis.records import AnalysisError, outcome_labels, panels_of, require_rows

# Cells along a side of the boxes of the basin entropy, as in Daza et al.: 25 starts in two dimensions.
ENTROPY_BOX = 5
FEWEST = 3  # least number of sizes in the fit
BLOCKS = 64  # of a grid, of which the scatter gives the sampling error of the uncertainty fractions
# Standard deviations of the change of the local slope over an octave of eps that the interval averages over.
_SLOPE_STEPS = np.geomspace(0.002, 0.3, 30)


@dataclasses.dataclass(frozen=True)
class Entropy:
    """Basin entropy and boundary basin entropy, in nats, and the share of boxes that a boundary crosses."""

    basin: float
    boundary: float
    crossed: float


def basin_entropy(grid: BasinGrid, labels: Shaped[np.ndarray, " rows"], box: int = ENTROPY_BOX) -> Entropy:
    """The entropy of outcomes in a box, averaged over all boxes, and over those that a boundary crosses.

    Boxes slide over the grid cell by cell, which averages over the offset of a tiling. A boundary entropy
    above ln 2 implies a fractal boundary, if few boxes hold three basins or more. The converse does not hold:
    below ln 2 the boundary may be smooth or fractal. NaN where the grid is narrower than a box.

    Args:
        grid: the grid.
        labels: the outcome of each row, (n,).
        box: cells along a side.

    Source: Daza et al. 2016, Sci. Rep. 6:31416, eq. 3 to 6.

    Example:
        Each box of 2 by 2 cells of a checkerboard has two outcomes in equal shares, so both entropies are
        ln 2:

        >>> import numpy as np, pandas as pd
        >>> from gaitsweep.analysis.basins.basin_boundaries import basin_entropy
        >>> from gaitsweep.analysis.basins.grid import find_grid
        >>> x, y = np.indices((8, 8)).reshape(2, -1)
        >>> grid = find_grid(pd.DataFrame({"x": x, "y": y}), ["x", "y"])
        >>> entropy = basin_entropy(grid, (x + y) % 2, box=2)
        >>> round(entropy.basin, 4), round(entropy.boundary, 4), entropy.crossed
        (0.6931, 0.6931, 1.0)
    """
    if box > min(grid.lengths):
        return Entropy(float("nan"), float("nan"), float("nan"))
    volume = box ** len(grid.lengths)
    entropy: Float[np.ndarray, " *boxes"] | float = 0.0
    largest: Int[np.ndarray, " *boxes"] | int = 0
    for label in pd.unique(labels):
        cells_of_label = grid.windows(labels == label, box)
        share = cells_of_label / volume
        entropy = entropy - share * np.log(np.where(cells_of_label > 0, share, 1.0))
        largest = np.maximum(largest, cells_of_label)
    crossed = np.asarray(largest) < volume
    # adding + 0.0 turns the -0.0 of one basin alone into 0
    basin = float(np.mean(entropy)) + 0.0
    boundary = float(np.sum(np.where(crossed, entropy, 0.0)) / crossed.sum()) if crossed.any() else 0.0
    return Entropy(basin, boundary, float(crossed.mean()))


@dataclasses.dataclass(frozen=True)
class Uncertainty:
    """Uncertainty fractions at several eps, and their sampling error.

    `fractions`: one record a size (steps; eps, the geometric mean of the axes' steps times `steps`;
    uncertain). `covariance` (sizes, sizes): the covariance of ln uncertain between the sizes.
    """

    fractions: pd.DataFrame
    covariance: Float[np.ndarray, "sizes sizes"]


def uncertainty_fraction(
    grid: BasinGrid, labels: Shaped[np.ndarray, " rows"], sizes: Sequence[int] | None = None
) -> Uncertainty:
    """The fraction f(eps) of starts of which a neighbour at a distance of eps has a different outcome.

    A start is compared with its two neighbours at +eps and -eps along one axis, and f is the share of all
    such comparisons, over all axes. What lies between the neighbours does not enter, so f is free of bias at
    any eps, one step included. All sizes share the same starts: those at least the largest size from both
    ends of an axis that does not wrap.

    Args:
        grid: the grid.
        labels: the outcome of each row, (n,).
        sizes: eps in steps of the grid; by default `grid.sizes()`.

    Raises:
        AnalysisError: a size is no whole number from 1 on, or leaves no start with both neighbours on the
            grid.

    Source: Grebogi et al. 1983, Phys. Lett. A 99:415, who shift one coordinate by eps both ways.
    """
    sizes = sorted(set(grid.sizes() if sizes is None else sizes))
    margin, shape = max(sizes, default=0), grid.lengths
    if fractional := [size for size in sizes if not isinstance(size, int | np.integer)]:
        raise AnalysisError(f"sizes has {fractional[0]:g}, but must be whole numbers of steps.")
    if sizes and sizes[0] < 1:
        raise AnalysisError(f"sizes has {sizes[0]} steps, but a neighbour is 1 step away or more.")
    if 2 * margin >= min(shape):
        raise AnalysisError(
            f"sizes has {margin} steps, but the grid is {min(shape)} starts wide: at most "
            f"{(min(shape) - 1) // 2} steps leave a start with both neighbours."
        )
    outcome = grid.filled(pd.factorize(labels)[0])
    block, block_count = _blocks(shape)
    differ = np.zeros((len(sizes), block_count))
    compared = np.zeros(block_count)
    for axis, wraps in enumerate(grid.wraps):
        # rolling meets the other end of the axis, which is beyond the margin unless the axis wraps
        inner = slice(None) if wraps else slice(margin, shape[axis] - margin)
        inside = (slice(None),) * axis + (inner,)
        of_block = block[inside].ravel()
        compared += np.bincount(of_block, minlength=compared.size)
        for number, size in enumerate(sizes):
            differs = np.roll(outcome, size, axis) != outcome
            differs |= np.roll(outcome, -size, axis) != outcome
            differ[number] += np.bincount(of_block, differs[inside].ravel(), compared.size)
    fraction = differ.sum(axis=1) / compared.sum()
    deviation = (differ - fraction[:, None] * compared) / np.maximum(differ.sum(axis=1), 1.0)[:, None]
    blocks = np.count_nonzero(compared)
    step = float(np.exp(np.mean(np.log(grid.steps))))
    table = pd.DataFrame({"steps": sizes, "eps": step * np.array(sizes), "uncertain": fraction})
    return Uncertainty(table, deviation @ deviation.T * blocks / max(blocks - 1, 1))


def _blocks(shape: tuple[int, ...]) -> tuple[Int[np.ndarray, " ..."], int]:
    """The number of the block that each cell of a grid is in, and the number of blocks, about `BLOCKS`."""
    along = max(round(BLOCKS ** (1 / len(shape))), 2)  # blocks along an axis
    of_axes = [index * along // length for index, length in zip(np.indices(shape), shape, strict=True)]
    block = np.ravel_multi_index(tuple(of_axes), (along,) * len(shape))
    return np.asarray(block), along ** len(shape)


@dataclasses.dataclass(frozen=True)
class Exponent:
    """The uncertainty exponent, the ends of its interval, and the number of sizes in the fit."""

    value: float
    low: float
    high: float
    sizes: int


def uncertainty_exponent(uncertainty: Uncertainty, level: float = 0.95) -> Exponent:
    """The uncertainty exponent: the power of eps with which the uncertainty fraction falls as eps tends to 0.

    It is 1 at a smooth boundary, less at a fractal one; the boundary's dimension is that of the starts less
    this exponent. It is estimated from the local slopes of ln f over ln eps between neighbouring sizes. Each
    has three errors: the sampling error; saturation, which bends ln f by a term of the order of f; and a
    random walk from the limit at eps = 0 towards larger eps, for what else departs from a power law. The
    slopes are weighted by the inverse of this covariance. The step of the walk is averaged over, each value
    weighted by its restricted likelihood. The interval covers the limit so far as the boundary below the
    smallest eps is like that above. NaN for fewer than `FEWEST` sizes with a fraction between 0 and 1.

    Args:
        uncertainty: the result of `uncertainty_fraction`.
        level: confidence level of the interval.

    Source: Grebogi et al. 1983, Phys. Lett. A 99:415; McDonald et al. 1985, Physica D 17:125. The interval is
    this project's own; `tests/analysis/test_basin_measures.py` measures how often it covers.

    Example:
        A fraction that falls with the square root of eps has the exponent 0.5:

        >>> import numpy as np, pandas as pd
        >>> from gaitsweep.analysis.basins.basin_boundaries import Uncertainty, uncertainty_exponent
        >>> eps = np.array([0.01, 0.02, 0.04, 0.08])
        >>> fractions = pd.DataFrame({"steps": [1, 2, 4, 8], "eps": eps, "uncertain": np.sqrt(eps)})
        >>> exponent = uncertainty_exponent(Uncertainty(fractions, 1e-6 * np.eye(4)))
        >>> round(exponent.value, 3), exponent.sizes
        (0.5, 4)
    """
    f = uncertainty.fractions["uncertain"].to_numpy(float)
    used = np.flatnonzero((f > 0.0) & (f < 1.0))
    if used.size < FEWEST:
        return Exponent(float("nan"), float("nan"), float("nan"), used.size)
    f, covariance = f[used], uncertainty.covariance[np.ix_(used, used)]
    x = np.log(uncertainty.fractions["eps"].to_numpy(float)[used])
    to_slopes = np.diff(np.eye(f.size), axis=0) / np.diff(x)[:, None]
    slope = to_slopes @ np.log(f)
    of_sampling_and_saturation = to_slopes @ covariance @ to_slopes.T + np.diag((to_slopes @ f) ** 2)
    octaves = (x[1:] - x[0]) / np.log(2.0)
    likelihood, centre, spread = (np.empty(_SLOPE_STEPS.size) for _ in range(3))
    for number, step in enumerate(_SLOPE_STEPS):
        total = of_sampling_and_saturation + step**2 * np.minimum.outer(octaves, octaves)
        weight = np.linalg.solve(total, np.ones(slope.size))
        variance = 1.0 / weight.sum()
        centre[number], spread[number] = variance * (weight @ slope), np.sqrt(variance)
        residual = slope - centre[number]
        misfit = residual @ np.linalg.solve(total, residual)
        likelihood[number] = 0.5 * (np.log(variance) - np.linalg.slogdet(total)[1] - misfit)
    share = special.softmax(likelihood)
    value = float(share @ centre)
    reach = value + 8.0 * spread.max() * np.linspace(-1.0, 1.0, 4001)
    below = special.ndtr((reach[:, None] - centre) / spread) @ share
    low, high = np.interp([(1.0 - level) / 2.0, (1.0 + level) / 2.0], below, reach)
    return Exponent(value, float(low), float(high), used.size)


RADIUS = 5.0  # distance in steps within which two boundaries count as the same


class BoundaryDistance(TypedDict):
    """A record of `wada`."""

    outcome: str
    other: str
    cells: int
    distance: float
    within: float


def wada(
    table: pd.DataFrame | Sequence[pd.DataFrame],
    axes: str | Sequence[str] | None = None,
    *,
    label: str = "gait",
    by: str | Sequence[str] = (),
    radius: float = RADIUS,
) -> pd.DataFrame:
    """Test whether the basins of a table have the Wada property, by merging.

    The property is one of three basins or more: two have one boundary in common, whatever its shape. The test
    is no proof: boundaries that differ by less than the distance of two starts pass.

    Args:
        table: a settle table of which the starts of each panel form a grid.
        axes: the columns of the starts; by default the swept axes that are not in `by`.
        label: the column of the outcomes.
        by: columns of which each combination of values is a panel, tested separately.
        radius: distance in steps within which two boundaries count as the same.

    Returns:
        A record for each panel and two outcomes: outcome, other, cells (of the boundary of `outcome` with all
        others merged), distance (from its farthest cell to the boundary of `other`, in steps), within (the
        share of its cells at most the radius away). Both are NaN in a panel of two outcomes. The property
        holds at this resolution if every `distance` is at most the radius.

    Raises:
        AnalysisError: the table has no rows or lacks a column, its starts form no grid, or `radius` is not
            above 0.

    Source: Daza, Wagemakers and Sanjuan 2018, Sci. Rep. 8:9954.
    """
    if not radius > 0.0:
        raise AnalysisError(f"radius is {radius:g} steps, but must be above 0.")
    table, by, axes = panels_and_axes(table, by, axes)
    require_rows(table)
    labels = outcome_labels(table, label)
    records: list[dict[str, object]] = []
    for panel, rows in panels_of(table, by):
        grid = find_grid(table.iloc[rows], axes)
        if grid is None:
            raise AnalysisError(
                f"The starts along {', '.join(axes) or 'no axis'} do not form a grid: name the other "
                "axes as by."
            )
        nearby = boundaries_nearby(grid, labels.iloc[rows].to_numpy(), radius)
        records += [{**panel, **record} for record in nearby]
    return pd.DataFrame(records, columns=[*by, "outcome", "other", "cells", "distance", "within"])


def boundaries_nearby(
    grid: BasinGrid, labels: Shaped[np.ndarray, " rows"], radius: float
) -> list[BoundaryDistance]:
    """The distances from the boundary of each basin, all others merged, to the boundaries of other basins.

    Args:
        grid: the grid.
        labels: the outcome of each row, (n,).
        radius: distance in steps within which two boundaries count as the same.

    Returns:
        The records of `wada`; none of a single basin.
    """
    cells = np.stack(np.unravel_index(grid.place, grid.lengths), axis=1)
    period = [length if wraps else 0 for length, wraps in zip(grid.lengths, grid.wraps, strict=True)]
    names = pd.unique(labels)
    shares = [grid.shares_nearby(labels == name) for name in names]
    edges = [cells[(share > 0.0) & (share < 1.0)] for share in shares]
    trees = [scipy.spatial.KDTree(edge, boxsize=period) for edge in edges]
    records: list[BoundaryDistance] = []
    for name, edge in zip(names, edges, strict=True):
        for other_name, tree in zip(names, trees, strict=True):
            if other_name != name:
                away = tree.query(edge)[0]
                farthest, within = float(away.max()), float(np.mean(away <= radius))
                if len(names) < 3:
                    farthest = within = float("nan")
                pair = BoundaryDistance(
                    outcome=name, other=other_name, cells=len(edge), distance=farthest, within=within
                )
                records.append(pair)
    return records
