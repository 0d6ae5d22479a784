"""Invariant sets without a period, as of chaotic rows, by the states that rows sample of them."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
import pandas as pd
import scipy

from gaitsweep.analysis.basins.state_space import Space, StateArray, crossing_columns

# Largest ratio of the mean distance of crossings from a sampled set, to that between the crossings within it.
NEAR = 3.0
# States by which a sampled set is known.
MOST_STATES = 2000


@dataclasses.dataclass(frozen=True)
class SampledSet:
    """The states of some rows on one invariant set.

    Attributes:
        rows: the places of the rows in their table.
        states: states of these rows, (m, d).
        tree: the k-d tree of the states.
        spacing: the mean distance from each state to the nearest other one; 0 of one state.
    """

    rows: list[int]
    states: StateArray
    tree: scipy.spatial.KDTree
    spacing: float

    @classmethod
    def of(cls, space: Space, rows: list[int], states: StateArray) -> SampledSet:
        """The set of states (m, d) in a space."""
        tree = space.tree(states)
        nearest = np.asarray(tree.query(states, k=2)[0])[:, 1]
        return cls(rows, states, tree, float(nearest.mean()) if len(states) > 1 else 0.0)

    def is_near(self, other: SampledSet) -> bool:
        """Whether the set with fewer states is a sample of the other one."""
        fewer, more = sorted((self, other), key=lambda one: len(one.states))
        return float(np.asarray(more.tree.query(fewer.states)[0]).mean()) <= NEAR * more.spacing

    def joined(self, other: SampledSet, space: Space) -> SampledSet:
        """The set with the rows of both, and states of both up to `MOST_STATES`."""
        fewer, more = sorted((self, other), key=lambda one: len(one.states))
        rows = more.rows + fewer.rows
        if len(more.states) >= MOST_STATES:
            return dataclasses.replace(more, rows=rows)
        return SampledSet.of(space, rows, np.concatenate([more.states, fewer.states])[:MOST_STATES])


def sampled_sets(space: Space, table: pd.DataFrame, columns: Sequence[str], status: str) -> list[SampledSet]:
    """The sets on which the rows of a status are, from that with the most rows on.

    A row is on a set if its crossings (x_end, x_end_2, ...) are as near to those of the rows found there as
    these are to each other, within a factor of `NEAR` in the means of the distances to the nearest one.

    Args:
        space: the space of the states.
        table: a settle table.
        columns: the columns of the state.
        status: chaotic or quasi_periodic.
    """
    rows = np.flatnonzero((table["status"].astype(str) == status).to_numpy())
    crossings = np.stack(
        [space.points(table.iloc[rows], at_crossing) for at_crossing in crossing_columns(table, columns)],
        axis=1,
    )
    known = np.isfinite(crossings).all(axis=(1, 2))
    sets: list[SampledSet] = []
    for row, states in zip(rows[known].tolist(), crossings[known], strict=True):
        newest = SampledSet.of(space, [row], states)
        # a set that grows may become one with others
        while (near := next((known for known in sets if known.is_near(newest)), None)) is not None:
            sets.remove(near)
            newest = near.joined(newest, space)
        sets.append(newest)
    return sorted(sets, key=lambda of_rows: -len(of_rows.rows))
