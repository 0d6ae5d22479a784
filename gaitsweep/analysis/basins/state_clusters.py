"""Clusters of states by single linkage; those that are lines are cut at their corners."""

from __future__ import annotations

import dataclasses

import numpy as np
import pandas as pd
import scipy
from jaxtyping import Float, Int

from gaitsweep.analysis.basins.state_space import Space, StateArray, extent

Links = Int[np.ndarray, "links 2"]  # pairs of states
Groups = Int[np.ndarray, " states"]  # a number for each state
MOST_CELLS = 8192  # the time of the spanning tree grows with their square
GAP = 3.0  # least ratio of successive link lengths at a gap between attractors
GRAINS_OF_A_POINT = 10.0  # largest extent of a point attractor, in grains
# radius of the neighbourhood that gives the direction of a line, as a share of its extent
WINDOW = 1.0 / 16.0
BENT = 0.05  # variance across a line over that along it, at a corner; 0.25 at a right angle, 0 if straight


@dataclasses.dataclass(frozen=True)
class Cells:
    """States binned into cells: `of` (n,) the cell of each state, `first` (m,) one state of each, `side`."""

    of: Groups
    first: Int[np.ndarray, " cells"]
    side: float


def cells(space: Space, points: StateArray, grain: float) -> Cells:
    """Bin states (n, d) into cells of side `grain`, doubled until there are at most `MOST_CELLS`.

    Args:
        space: the space of the states.
        points: the states.
        grain: the first side, in units of the scales.
    """
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


def cut_at_corners(
    space: Space,
    states: StateArray,
    flat: StateArray,
    group: Groups,
    links: Links,
    gaps: Float[np.ndarray, " links"],
    side: float,
) -> Groups:
    """The groups of states, lines split at their corners.

    Args:
        space: the space of the states.
        states: (m, d), and `flat` (m, d) the same without turns of angles between linked states.
        group: the group of each state, (m,).
        links: links between states, (k, 2), and `gaps` (k,) their lengths, 0 where cut.
        side: the distance below which states are equal.

    Returns:
        A number for each state, (m,).
    """
    pieces = np.zeros(len(flat), np.int64)
    for number in range(group.max(initial=-1) + 1):
        members = np.flatnonzero(group == number)
        if box_dimension(flat[members], side) == 1:
            gap = gaps[group[links[:, 0]] == number].max(initial=0.0)
            pieces[members] = _smooth_pieces(space, states[members], flat[members], side, gap)
    return np.unique(np.stack([group, pieces]), axis=1, return_inverse=True)[1].reshape(-1)


def box_dimension(flat: StateArray, side: float) -> int:
    """The box-counting dimension of unrolled states (m, d), rounded; 0 for a point."""
    size = extent(flat)
    if size <= GRAINS_OF_A_POINT * side:
        return 0
    sides = [size / 2.0**k for k in (2, 3, 4) if size / 2.0**k >= 1.2 * side]
    boxes = [len(np.unique(np.floor((flat - flat[0]) / box + 0.5), axis=0)) for box in sides]
    slope = np.polyfit(-np.log(sides), np.log(boxes), 1)[0]
    return max(1, round(float(slope)))


def _smooth_pieces(space: Space, states: StateArray, flat: StateArray, side: float, gap: float) -> Groups:
    """The smooth piece (m,) of each state of one line; at a corner its neighbours are bent."""
    window = WINDOW * extent(flat)
    one_piece = np.zeros(len(states), np.int64)
    if window < max(4.0 * side, gap):
        return one_piece
    straight = np.flatnonzero(_bend(space, states, window) <= BENT)
    if not straight.size:
        return one_piece
    # slightly more than the gap, so that the two ends of the longest link stay together
    links = space.tree(states[straight]).query_pairs(max(0.5 * window, 1.01 * gap), output_type="ndarray")
    piece = components(straight.size, links)
    members = [straight[piece == number] for number in range(piece.max() + 1)]
    large = [members_of_piece for members_of_piece in members if extent(flat[members_of_piece]) >= window]
    if len(large) < 2:
        return one_piece
    return np.argmin(
        [space.nearest_distance(states, states[members_of_piece]) for members_of_piece in large], axis=0
    )


def _bend(space: Space, states: StateArray, window: float) -> Float[np.ndarray, " states"]:
    """The variance of each state's neighbours across their main direction over that along it, (m,)."""
    around = space.tree(states).query_ball_point(states, window)
    bend = np.zeros(len(states))
    for place, members in enumerate(around):
        away = space.difference(states[members], states[place])
        spread = np.linalg.eigvalsh(np.atleast_2d(np.cov(away.T, bias=True)))
        if spread[-1] > 0.0:
            bend[place] = spread[:-1].sum() / spread[-1]
    return bend
