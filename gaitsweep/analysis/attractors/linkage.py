"""Single linkage of many states: cells of one grain, the shortest tree between them, and where it is cut."""

from __future__ import annotations

import dataclasses

import numpy as np

from gaitsweep.analysis.attractors.state_space import Space

MOST_CELLS = 8192  # the tree's time grows as their square
GAP = 3.0  # a jump in the lengths of links, as a ratio, that parts attractors


@dataclasses.dataclass(frozen=True)
class Cells:
    """States gathered in cells: `of` (n,) the cell of each state, `first` (m,) a state of each, `side`."""

    of: np.ndarray
    first: np.ndarray
    side: float


def cells(space: Space, points: np.ndarray, grain: float) -> Cells:
    """Gather states (n, d) in cells of side `grain`, doubled until there are at most `MOST_CELLS`."""
    side = grain
    while True:
        count = np.maximum(np.round(space.periods / side), 1.0)
        width = np.where(space.periods > 0.0, space.periods / count, side)
        first, of = _first_of_each(np.floor(points / width).astype(np.int64))
        if first.size <= MOST_CELLS:
            return Cells(of, first, side)
        side *= 2.0


def _first_of_each(places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Of rows (n, d) of whole numbers, the first of each that differs (m,), and which each one is (n,)."""
    of = np.zeros(len(places), np.int64)
    first = np.zeros(min(len(places), 1), np.int64)
    # direction by direction: numbers of one column are sorted far faster than rows of several
    for column in places.T:
        own = column - column.min() if column.size else column
        _, first, of = np.unique(
            of * (own.max() + 1 if own.size else 1) + own, return_index=True, return_inverse=True
        )
    return first, of


def shortest_tree(space: Space, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The shortest tree that joins states (m, d), after Prim: memory as m, time as m^2.

    Returns:
        The links as pairs of places, outwards from the first state, (m - 1, 2), and their lengths, (m - 1,).
    """
    count = len(points)
    near = np.full(count, np.inf)
    source = np.zeros(count, np.int64)
    outside = np.ones(count, bool)
    links, lengths = np.zeros((max(count - 1, 0), 2), np.int64), np.zeros(max(count - 1, 0))
    newest = 0
    for step in range(count - 1):
        outside[newest] = False
        apart = space.distance(points, points[newest])
        closer = outside & (apart < near)
        near[closer], source[closer] = apart[closer], newest
        near[newest] = np.inf
        newest = int(np.argmin(np.where(outside, near, np.inf)))
        links[step], lengths[step] = (source[newest], newest), near[newest]
    return links, lengths


def linking_distance(lengths: np.ndarray, grain: float, rows: int) -> float:
    """The length at which a tree's links are cut: inside the widest gap in their lengths, as a ratio.

    A gap counts where the longer link is `GAP` times the shorter one at least, and where cutting there leaves
    few attractors: no more than the square root of the rows (but two in any case). Without such a gap all is
    one, and the length is inf. Scaling all lengths scales the result.

    Args:
        lengths: of the links between cells, (m - 1,).
        grain: links below it count as the grain, and so do those between rows of one cell.
        rows: in all cells together.
    """
    sorted_lengths = np.sort(np.maximum(lengths, grain))[::-1]
    if rows > lengths.size + 1:
        sorted_lengths = np.append(sorted_lengths, grain)
    most = max(2, int(np.ceil(np.sqrt(rows))))
    ratios = (sorted_lengths[:-1] / sorted_lengths[1:])[: most - 1]
    if not ratios.size or ratios.max() < GAP:
        return np.inf
    widest = int(np.argmax(ratios))
    return float(np.sqrt(sorted_lengths[widest] * sorted_lengths[widest + 1]))


def components(count: int, links: np.ndarray) -> np.ndarray:
    """The component of each of `count` places, (count,), numbered as they come, joined by links (k, 2)."""
    parent = np.arange(count)
    while True:
        low = parent.copy()
        np.minimum.at(low, links[:, 0], parent[links[:, 1]])
        np.minimum.at(low, links[:, 1], parent[links[:, 0]])
        np.minimum.at(low, parent[links[:, 0]], parent[links[:, 1]])
        np.minimum.at(low, parent[links[:, 1]], parent[links[:, 0]])
        while (low[low] != low).any():
            low = low[low]
        if (low == parent).all():
            return np.unique(parent, return_inverse=True)[1]
        parent = low
