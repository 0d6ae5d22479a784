"""Attractors that are lines, split at their corners."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from gaitsweep.analysis.basins.single_linkage import Groups, Links, components
from gaitsweep.analysis.basins.state_space import Space, StateArray, extent

GRAINS_OF_A_POINT = 10.0  # largest extent of a point attractor, in grains
# radius of the neighbourhood that gives the direction of a line, as a share of its extent
WINDOW = 1.0 / 16.0
BENT = 0.05  # variance across a line over that along it, at a corner; 0.25 at a right angle, 0 if straight


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
