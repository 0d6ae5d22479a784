"""Single linkage of states: cells of equal states, their spanning tree, and where its links are cut."""

from __future__ import annotations

import dataclasses

import numpy as np
import pandas as pd
import scipy
from jaxtyping import Float, Int

from gaitsweep.analysis.basins.state_space import Space, StateArray

Links = Int[np.ndarray, "links 2"]  # pairs of states
Groups = Int[np.ndarray, " states"]  # a number for each state
MOST_CELLS = 8192  # the time of the spanning tree grows with their square
GAP = 3.0  # least ratio of successive link lengths at a gap between attractors


@dataclasses.dataclass(frozen=True)
class Cells:
    """States binned into cells: `of` (n,) the cell of each state, `first` (m,) one state of each, `side`."""

    of: Groups
    first: Int[np.ndarray, " cells"]
    side: float


def cells(space: Space, points: StateArray, grain: float) -> Cells:
    """Bin states (n, d) into cells of side `grain`, doubled until there are at most `MOST_CELLS`."""
    side = grain
    while True:
        count = np.maximum(np.round(space.periods / side), 1.0)
        width = np.where(space.periods > 0.0, space.periods / count, side)
        places = pd.DataFrame(np.floor(points / width).astype(np.int64))
        of = places.groupby(list(places)).ngroup().to_numpy()
        first = np.unique(of, return_index=True)[1]
        if first.size <= MOST_CELLS:
            return Cells(of, first, side)
        side *= 2.0


def spanning_tree(space: Space, points: StateArray) -> tuple[Links, Float[np.ndarray, " links"]]:
    """The minimum spanning tree of states (m, d) by Prim's algorithm, in memory O(m) and time O(m^2).

    Returns:
        The links as pairs of indices, outwards from the first state, (m - 1, 2), and their lengths, (m - 1,).
    """
    count = len(points)
    near = np.full(count, np.inf)
    source = np.zeros(count, np.int64)
    outside = np.ones(count, bool)
    links, lengths = np.zeros((max(count - 1, 0), 2), np.int64), np.zeros(max(count - 1, 0))
    newest = 0
    for step in range(count - 1):
        outside[newest] = False
        distance = space.distance(points, points[newest])
        closer = outside & (distance < near)
        near[closer], source[closer] = distance[closer], newest
        near[newest] = np.inf
        newest = int(np.argmin(np.where(outside, near, np.inf)))
        links[step], lengths[step] = (source[newest], newest), near[newest]
    return links, lengths


def linking_distance(lengths: Float[np.ndarray, " links"], grain: float, rows: int) -> float:
    """The length above which a tree's links are cut: within the widest gap in their lengths, as a ratio.

    A gap counts where the longer link is at least `GAP` times the shorter one, and where cutting there leaves
    at most as many attractors as the square root of the rows (at least two). Without such a gap there is one
    attractor, and the length is inf. Scaling all lengths scales the result.

    Args:
        lengths: of the links between cells, (m - 1,).
        grain: the least length; shorter links, and those between rows of one cell, count as this long.
        rows: number of rows in all cells.
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


def components(count: int, links: Links) -> Int[np.ndarray, " nodes"]:
    """The component (count,) of each of `count` nodes joined by links (k, 2), numbered in their order."""
    joined = np.ones(len(links), bool), (links[:, 0], links[:, 1])
    graph = scipy.sparse.coo_array(joined, shape=(count, count))
    return scipy.sparse.csgraph.connected_components(graph, directed=False)[1].astype(np.int64)
