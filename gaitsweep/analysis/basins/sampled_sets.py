"""Attractors without a period, each known by the set that the crossings of its rows occupy."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np
import pandas as pd
from jaxtyping import Int

from gaitsweep.analysis.basins.state_space import Space, StateArray

# Largest ratio of the mean distance of crossings from such a set, to that between the crossings within it.
NEAR = 3.0
# States by which a set is known.
MOST_STATES = 2000

Sample = tuple[list[int], StateArray]  # rows, and their crossings (m, d)


def sampled_sets(
    space: Space, table: pd.DataFrame, columns: Sequence[str], status: str
) -> list[tuple[Int[np.ndarray, " rows"], StateArray]]:
    """The rows of a status on each set, the most frequent first, and states of the set (m, d).

    A row is on a set if its crossings (x_end, x_end_2, ...) lie as near to those of the rows found there as
    these lie to each other, within a factor of `NEAR` in the means of the distances to the nearest one.
    """
    last = itertools.takewhile(lambda k: f"{columns[0]}_{k}" in table, itertools.count(2))
    names = [list(columns), *([f"{name}_{k}" for name in columns] for k in last)]
    rows = np.flatnonzero((table["status"].astype(str) == status).to_numpy())
    crossings = np.stack([space.points(table.iloc[rows], own) for own in names], axis=1)
    known = np.isfinite(crossings).all(axis=(1, 2))
    sets: list[Sample] = []
    for row, own in zip(rows[known].tolist(), crossings[known], strict=True):
        newest: Sample = [row], own
        # a set that grows may come to be that of others
        while (place := _near(space, newest[1], sets)) is not None:
            members, states = sets.pop(place)
            newest = members + newest[0], _thinned(np.concatenate([states, newest[1]]))
        sets.append(newest)
    sets.sort(key=lambda sample: -len(sample[0]))
    return [(np.array(members), states) for members, states in sets]


def _near(space: Space, states: StateArray, sets: Sequence[Sample]) -> int | None:
    """The place of a set of which some states are a sample, or that is one of theirs; None: there is none."""
    for place, (_, others) in enumerate(sets):
        fewer, more = sorted((states, others), key=len)
        within = np.asarray(space.tree(more).query(more, k=2)[0])[:, 1].mean()
        if space.nearest_distance(fewer, more).mean() <= NEAR * within:
            return place
    return None


def _thinned(states: StateArray) -> StateArray:
    """At most `MOST_STATES` of some states, evenly spaced among them."""
    return states[:: -(-len(states) // MOST_STATES)]
