"""Attractors matched along a parameter, with the fractions of their basins."""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
import scipy
from jaxtyping import Float

from gaitsweep.analysis.basins.attractors import attractors
from gaitsweep.analysis.basins.fractions import fractions
from gaitsweep.analysis.basins.state_space import Space, state_columns
from gaitsweep.analysis.records import AnalysisError, names_in, require_numbers

_MOST_STATES = 2000  # states of an attractor that its distances use
_FAR = 1e9  # cost of a forbidden match


@dataclasses.dataclass(frozen=True)
class Continued:
    """Attractors followed along a parameter.

    Attributes:
        column: the attractor of each row, a category with the same name at all values; NaN where the row did
            not settle.
        summary: the attractors at each value, as `Attractors.summary`, with the parameter and `moved`, the
            distance from the attractor of that name at the last value that had it.
        fractions: the basin fractions at each value, as `Basins.fractions`.
        within: the largest distance of a match.
    """

    column: pd.Series
    summary: pd.DataFrame
    fractions: pd.DataFrame
    within: float


def follow_attractors(
    table: pd.DataFrame, parameter: str, *, within: float | None = None, **grouping: Any
) -> Continued:
    """Group the settled rows at each value of a parameter, and match the attractors of successive values.

    Matched attractors have one name. The matching minimises the sum of distances between old and new
    attractors. An unmatched attractor is matched to a near one that vanished before, else gets a new name.
    The distance of two attractors is the larger of the mean distances from the states of each to the nearest
    state of the other.

    Args:
        table: a settle table.
        parameter: the column of the parameter.
        within: the largest distance of a match; by default half the smallest distance between two attractors
            of one value, inf where no value has two.
        grouping: arguments of `attractors`.

    Raises:
        AnalysisError: the table does not have a column or a value of the parameter, `within` is below 0, or
            as for `attractors`.

    Source: the distance is Dubuisson and Jain's modified Hausdorff distance (1994, Proc. ICPR, p. 566);
    matching along a parameter as in Datseris, Rossi and Wagemakers 2023, Chaos 33:073151.
    """
    require_numbers(table, parameter)
    values = np.unique(table[parameter].dropna().to_numpy(float))
    if not values.size:
        raise AnalysisError(f"No row of the table has a value of {parameter}.")
    if within is not None and not within >= 0.0:
        raise AnalysisError(f"within is {within:g}, but must be 0 or more.")
    rows_of_values = [np.flatnonzero(table[parameter] == value) for value in values]
    groupings = [attractors(table.iloc[rows], **grouping) for rows in rows_of_values]
    columns = names_in(grouping.get("columns") or state_columns(table))
    space = Space.of(table, columns, grouping.get("scales"))
    if within is None:
        within = _half_the_smallest(space, [grouped.states for grouped in groupings])
    latest: dict[str, Float[np.ndarray, "states columns"]] = {}  # the latest states of each attractor
    present: list[str] = []
    orbits: set[str] = set()
    attractor_of_rows, summaries = np.full(len(table), None, object), []
    for value, rows, grouped in zip(values, rows_of_values, groupings, strict=True):
        names, moved = _named(space, grouped.states, latest, present, within)
        present = list(names.values())
        latest |= {names[name]: states for name, states in grouped.states.items()}
        of_value = grouped.summary["attractor"]
        # orbits without states are not matched: their names are their periods
        orbits |= set(of_value) - set(names)
        names = dict(zip(of_value, of_value, strict=True)) | names
        attractor_of_rows[rows] = grouped.column.astype(object).map(names.get)
        summary = grouped.summary.assign(attractor=of_value.map(names.get), moved=of_value.map(moved.get))
        summary.insert(0, parameter, value)
        summaries.append(summary)
    names_of_rows = pd.Categorical(attractor_of_rows, [*latest, *sorted(orbits)])
    column = pd.Series(names_of_rows, index=table.index, name="attractor")
    shares = fractions(table.assign(attractor=column), label="attractor", by=parameter)
    return Continued(column, pd.concat(summaries, ignore_index=True), shares, within)


def attractor_distance(
    space: Space, one: Float[np.ndarray, "states coordinates"], other: Float[np.ndarray, "others coordinates"]
) -> float:
    """The modified Hausdorff distance of two attractors, given states (m, d) of each.

    Args:
        space: the space of the states.
        one, other: the states; of more than 2000, every second, third, ... one is used.
    """
    a, b = (states[:: math.ceil(len(states) / _MOST_STATES)] for states in (one, other))
    return float(max(space.nearest_distance(a, b).mean(), space.nearest_distance(b, a).mean()))


def _half_the_smallest(
    space: Space, states_of_parts: Sequence[Mapping[str, Float[np.ndarray, "_states coordinates"]]]
) -> float:
    """Half the smallest distance between two attractors of one value."""
    pairs = [pair for states in states_of_parts for pair in itertools.combinations(states.values(), 2)]
    return 0.5 * min((attractor_distance(space, *pair) for pair in pairs), default=np.inf)


def _named(
    space: Space,
    states: Mapping[str, Float[np.ndarray, "_states coordinates"]],
    latest: Mapping[str, Float[np.ndarray, "_states coordinates"]],
    present: Sequence[str],
    within: float,
) -> tuple[dict[str, str], dict[str, float]]:
    """The matched name of each attractor, and its distance from the match (NaN for a new one).

    Args:
        space: the space of the states.
        states: the states of the attractors at a value of the parameter, by their names there.
        latest: the latest states of the attractors at earlier values, by their matched names.
        present: the matched names of the attractors at the last value.
        within: the largest distance of a match.
    """
    names: dict[str, str] = {}
    moved: dict[str, float] = dict.fromkeys(states, float("nan"))
    # attractors of the last value are matched first, vanished ones after them
    for candidates in (list(present), [name for name in latest if name not in present]):
        unmatched = [name for name in states if name not in names]
        cost = np.array(
            [
                [attractor_distance(space, states[name], latest[candidate]) for candidate in candidates]
                for name in unmatched
            ]
        )
        if not cost.size:
            continue
        rows, columns = scipy.optimize.linear_sum_assignment(np.where(cost <= within, cost, _FAR))
        for row, column in zip(rows, columns, strict=True):
            if cost[row, column] <= within:
                names[unmatched[row]], moved[unmatched[row]] = candidates[column], float(cost[row, column])
    count = len(latest)
    for name in states:
        if name not in names:
            count += 1
            names[name] = f"A{count}"
    return names, moved
