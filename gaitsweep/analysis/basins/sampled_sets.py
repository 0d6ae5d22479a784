"""Attractors without a period, each known by the set that the crossings of its rows occupy."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np
import pandas as pd

from gaitsweep.analysis.basins.state_space import Space, StateArray

# Largest ratio of the mean distance of crossings from such a set, to that between the crossings within it.
NEAR = 3.0
# States by which a set is known.
MOST_STATES = 2000


class SampledSet:
    """The states (m, d) of some rows, and the mean distance from each to the nearest other one."""

    def __init__(self, space: Space, rows: list[int], states: StateArray) -> None:
        self._space, self.rows, self.states = space, rows, states
        self._tree = space.tree(states)
        nearest = np.asarray(self._tree.query(states, k=2)[0])[:, 1]
        # one state alone is near to its equals only
        self._within = float(nearest.mean()) if len(states) > 1 else 0.0

    def is_near(self, other: SampledSet) -> bool:
        """Whether the set with fewer states is a sample of the other one."""
        fewer, more = sorted((self, other), key=lambda one: len(one.states))
        distance = float(np.asarray(more._tree.query(fewer.states)[0]).mean())
        return distance <= NEAR * more._within

    def joined(self, other: SampledSet) -> SampledSet:
        """The set with the rows of both, and states of both up to `MOST_STATES`."""
        fewer, more = sorted((self, other), key=lambda one: len(one.states))
        if len(more.states) >= MOST_STATES:
            # the tree of its states stays as it is
            more.rows += fewer.rows
            return more
        states = np.concatenate([more.states, fewer.states])
        return SampledSet(self._space, more.rows + fewer.rows, states[:MOST_STATES])


def sampled_sets(space: Space, table: pd.DataFrame, columns: Sequence[str], status: str) -> list[SampledSet]:
    """The sets on which the rows of a status are, from that with the most rows on.

    Args:
        space: the space of the states.
        table: a settle table.
        columns: the columns of the state.
        status: chaotic or quasi_periodic.

    A row is on a set if its crossings (x_end, x_end_2, ...) lie as near to those of the rows found there as
    these lie to each other, within a factor of `NEAR` in the means of the distances to the nearest one.
    """
    later = itertools.takewhile(lambda k: f"{columns[0]}_{k}" in table, itertools.count(2))
    names = [list(columns), *([f"{name}_{k}" for name in columns] for k in later)]
    rows = np.flatnonzero((table["status"].astype(str) == status).to_numpy())
    crossings = np.stack([space.points(table.iloc[rows], at_crossing) for at_crossing in names], axis=1)
    known = np.isfinite(crossings).all(axis=(1, 2))
    sets: list[SampledSet] = []
    for row, states in zip(rows[known].tolist(), crossings[known], strict=True):
        newest = SampledSet(space, [row], states)
        # a set that grows may come to be that of others
        while (near := next((known for known in sets if known.is_near(newest)), None)) is not None:
            sets.remove(near)
            newest = near.joined(newest)
        sets.append(newest)
    return sorted(sets, key=lambda of_rows: -len(of_rows.rows))
