"""Lines of states cut where they turn a corner, so that lines that meet come out as one piece each."""

from __future__ import annotations

import numpy as np

from gaitsweep.analysis.attractors.linkage import components
from gaitsweep.analysis.attractors.state_space import Space, extent

WINDOW = 1.0 / 16.0  # of a line's extent: the radius around a state in which its direction is looked at
BENT = 0.05  # variance across the direction over that along it; 0.25 at a right angle, 0 on a straight line


def smooth_pieces(space: Space, states: np.ndarray, flat: np.ndarray, grain: float, gap: float) -> np.ndarray:
    """The piece of each state (m, d) of one line, (m,), numbered as they come.

    A state lies in a corner where its neighbours within `WINDOW` of the line's extent spread across their
    main direction by more than `BENT`. Pieces are what is left, linked over half that window or over `gap`,
    the longest link within the line; what is shorter than the window is no piece. Corners join the nearest.

    Args:
        space: where they lie.
        states, flat: they as they are, and unrolled.
        grain: the distance below which states count as one.
        gap: as said.
    """
    window = WINDOW * extent(flat)
    whole = np.zeros(len(states), np.int64)
    if window < max(4.0 * grain, gap):
        return whole
    straight = np.flatnonzero(_bend(space, states, window) <= BENT)
    if not straight.size:
        return whole
    # a little more than the gap, whose own ends are to stay together
    links = space.tree(states[straight]).query_pairs(max(0.5 * window, 1.01 * gap), output_type="ndarray")
    piece = components(straight.size, links)
    members = [straight[piece == number] for number in range(piece.max() + 1)]
    kept = [mine for mine in members if extent(flat[mine]) >= window]
    if len(kept) < 2:
        return whole
    return np.argmin([space.apart(states, states[mine]) for mine in kept], axis=0)


def _bend(space: Space, states: np.ndarray, window: float) -> np.ndarray:
    """The variance of each state's neighbours across their main direction over that along it, (m,)."""
    around = space.tree(states).query_ball_point(states, window)
    bend = np.zeros(len(states))
    for place, members in enumerate(around):
        away = space.difference(states[members], states[place])
        spread = np.linalg.eigvalsh(np.atleast_2d(np.cov(away.T, bias=True)))
        if spread[-1] > 0.0:
            bend[place] = spread[:-1].sum() / spread[-1]
    return bend
