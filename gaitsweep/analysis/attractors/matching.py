"""Attractors along a parameter: the same names from one value to the next, and the shares of their basins."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from scipy.optimize import linear_sum_assignment

from gaitsweep.analysis.attractors.attractors import attractors
from gaitsweep.analysis.attractors.state_space import Space, state_columns
from gaitsweep.analysis.basins.fractions import fractions
from gaitsweep.analysis.records import require

_MOST_STATES = 2000  # of an attractor, between which distances are measured
_FAR = 1e9  # a cost that no match is worth


@dataclasses.dataclass(frozen=True)
class Continued:
    """Attractors followed along a parameter.

    `column`: the attractor of each row under its lasting name, a category, NaN where it did not settle.
    `summary`: the attractors at each value, as `Attractors.summary`, with the parameter and `moved`, the
    distance from the attractor of that name at the last value that had it. `fractions`: the shares of their
    basins at each value, as `Basins.fractions`. `within`: how far an attractor could move and keep its name.
    """

    column: pd.Series
    summary: pd.DataFrame
    fractions: pd.DataFrame
    within: float


def follow_attractors(
    table: pd.DataFrame,
    parameter: str,
    *,
    within: float | None = None,
    **grouping: Any,
) -> Continued:
    """Group the settled rows at each value of a parameter, and keep the names of attractors that stay near.

    At each value the pairs of old and new attractors with the smallest sum of distances get the same name.
    An attractor without one takes that of a vanished attractor that was near, else a new one. The distance of
    two attractors is the larger of the mean distances from the states of each to the nearest of the other.

    Args:
        table: a settle table.
        parameter: the column of the parameter.
        within: how far an attractor may move between two values and keep its name; if not given, half the
            smallest distance between two attractors of one value, inf where no value has two.
        grouping: arguments of `attractors`.

    Raises:
        AnalysisError: a column is not there, or as `attractors`.

    Source: the distance is Dubuisson and Jain's modified Hausdorff distance (1994, Proc. ICPR, p. 566);
    matching along a parameter as in Datseris, Rossi and Wagemakers 2023, Chaos 33:073151.
    """
    require(table, parameter)
    values = np.unique(table[parameter].dropna().to_numpy(float))
    parts = [_at(table, parameter, value) for value in values]
    found = [attractors(part, **grouping) for part in parts]
    space = Space.of(table, grouping.get("columns") or state_columns(table), grouping.get("scales"))
    within = _half_the_smallest(space, [each.states for each in found]) if within is None else within
    seen: dict[str, np.ndarray] = {}  # where each attractor was last
    present: list[str] = []
    called: dict[str, str] = {}
    columns, summaries = [], []
    for value, each in zip(values, found, strict=True):
        names, moved = _named(space, each.states, seen, present, within)
        present = list(names.values())
        seen |= {names[own]: states for own, states in each.states.items()}
        own = each.summary["attractor"]
        # orbits of several crossings are not followed: they are called by their periods everywhere
        orbits = {name: name for name in own if name not in names}
        called |= orbits
        columns.append(each.column.astype(object).map((names | orbits).get))
        summary = each.summary.assign(attractor=own.map((names | orbits).get), moved=own.map(moved.get))
        summary.insert(0, parameter, value)
        summaries.append(summary)
    together = pd.concat(columns).reindex(table.index)
    column = pd.Series(
        pd.Categorical(together, [*seen, *sorted(called)]), index=table.index, name="attractor"
    )
    labelled = table.assign(attractor=column)
    labelled.attrs = table.attrs
    shares = fractions(labelled, label="attractor", by=parameter)
    return Continued(column, pd.concat(summaries, ignore_index=True), shares, within)


def apart(space: Space, one: np.ndarray, other: np.ndarray) -> float:
    """The distance of two attractors by states (m, d) of each: the larger of their mean nearest distances."""
    one, other = (states[:: -(-len(states) // _MOST_STATES)] for states in (one, other))
    return float(max(space.apart(one, other).mean(), space.apart(other, one).mean()))


def _at(table: pd.DataFrame, parameter: str, value: float) -> pd.DataFrame:
    part = table.iloc[np.flatnonzero(table[parameter] == value)]
    part.attrs = table.attrs
    return part


def _half_the_smallest(space: Space, found: Sequence[Mapping[str, np.ndarray]]) -> float:
    """Half the smallest distance between two attractors of one value."""
    pairs = [pair for states in found for pair in itertools.combinations(states.values(), 2)]
    return 0.5 * min((apart(space, *pair) for pair in pairs), default=np.inf)


def _named(
    space: Space,
    states: Mapping[str, np.ndarray],
    seen: Mapping[str, np.ndarray],
    present: Sequence[str],
    within: float,
) -> tuple[dict[str, str], dict[str, float]]:
    """The lasting name of each attractor by its own, and how far it moved (NaN for a new one)."""
    names: dict[str, str] = {}
    moved: dict[str, float] = dict.fromkeys(states, float("nan"))
    # those of the last value come first, the vanished ones after them
    for candidates in (list(present), [name for name in seen if name not in present]):
        left = [own for own in states if own not in names]
        cost = np.array([[apart(space, states[own], seen[name]) for name in candidates] for own in left])
        if not cost.size:
            continue
        rows, columns = linear_sum_assignment(np.where(cost <= within, cost, _FAR))
        for row, column in zip(rows, columns, strict=True):
            if cost[row, column] <= within:
                names[left[row]], moved[left[row]] = candidates[column], float(cost[row, column])
    count = len(seen)
    for own in states:
        if own not in names:
            count += 1
            names[own] = f"A{count}"
    return names, moved
