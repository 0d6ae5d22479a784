"""Rows of a self-check that rest on an unstable gait, which no finer step would show.

Legs that are alike to the last digit stay alike, and a row that begins at a fixed point stays there, whether
that gait is stable or not. Such rows are followed to their fixed points again, displaced, and followed on.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping

import numpy as np
import pandas as pd
from jaxtyping import Bool, Float, Int

from gaitsweep.contract import Model
from gaitsweep.design import Design
from gaitsweep.engine.poincare.maps import Points, sizes
from gaitsweep.engine.poincare.return_map import BatchedReturnMap
from gaitsweep.engine.solver import fixed_step_scheme
from gaitsweep.engine.sweep.sweep_spec import SweepSpec
from gaitsweep.runs.observable_changes import changes

# On a symmetric gait an angle is a part of a turn, within this many rad, or two observables of one unit are
# equal, within this share of their magnitude.
ALIKE, PARTS_OF_A_TURN = 1e-9, 24
# A row that has moved by less than this from its start (of each observable's magnitude, at least 1) rests
# where it began. A fixed point that differs by more from the stored one is another.
UNMOVED, SAME = 1e-6, 1e-3
# Fixed points are displaced by this distance (of the scale of each coordinate), in so many directions.
DISPLACED, DIRECTIONS = 1e-6, 3
# Displaced points are followed for so many crossings. One has left if it is `LEFT` away, or `GROWN` times as
# far as at the start and, over the second half, faster than along a neutral direction.
FOLLOWED, LEFT, GROWN, FASTER = 200, 1e-3, 10.0, 2.5
# The most crossings of a row up to a fixed point, and the least and the most fixed points of all rows: more
# than the least only where they are followed for no more crossings than the rows themselves had.
MOST_CROSSINGS, LEAST_POINTS, MOST_POINTS = 5000, 4, 192


def unstable_rests(
    design: Design,
    spec: SweepSpec,
    records: pd.DataFrame,
    begun: Float[np.ndarray, "rows observables"],
    moving: str | None,
) -> Int[np.ndarray, " unstable"]:
    """Find the rows that rest on an unstable gait; none in steps of fixed length, in which a map has jumps.

    Args:
        design: the job's rows.
        spec: the specification of their sweep.
        records: records of some rows in their order: `row`, whether it `rests` there, the number of the
            `crossing`, the `period` of its orbit in crossings, the observables by their names, and the
            parameter that moves.
        begun: the observables at the start of each row of the records, in the order of their numbers.
        moving: the parameter that moves; None if none does.

    Returns:
        The numbers of the rows.
    """
    model = spec.model
    if fixed_step_scheme(spec.numerics.method, model) is not None:
        return np.zeros(0, np.int64)
    rows, place = np.unique(records["row"].to_numpy(np.int64), return_inverse=True)
    observed = records[[q.name for q in model.observables]].to_numpy(float)
    crossing = records["crossing"].to_numpy(np.int64)
    suspect = symmetric(model, observed) | _near(model, observed, begun[place], UNMOVED)
    suspect &= records["rests"].to_numpy(bool) & (crossing > 0) & (crossing <= MOST_CROSSINGS)
    chosen = np.flatnonzero(suspect)
    if not chosen.size:
        return rows[:0]
    crossings = sum(crossing[place == row].max() for row in range(rows.size))
    count = crossings // (FOLLOWED * (1 + DIRECTIONS))
    count = int(np.clip(count, LEAST_POINTS, MOST_POINTS))
    chosen = chosen[np.unique(np.linspace(0, chosen.size - 1, count).astype(int))]

    parameters, starts = design.values_in(rows)
    following = design.following(moving) if moving is not None else {}
    values = {name: column for name, column in parameters.items() if name not in following}
    mapping = BatchedReturnMap(model, tuple(following.items()), spec.numerics, spec.engine)
    levels = None if moving is None else (moving, records[moving].to_numpy(float))
    points = _points_at(mapping, values, starts, place, crossing, levels, chosen)
    values = {name: column[place[chosen]] for name, column in values.items()}
    if levels is not None:
        values[levels[0]] = levels[1][chosen]

    same, turn = np.zeros(chosen.size, bool), points
    for _ in range(np.max(records["period"].to_numpy(np.int64))):
        images = mapping.images(turn, values)
        reached = np.stack([images.observed[q.name] for q in model.observables], axis=1)
        # records of earlier cycles, such as those of lifted feet, may differ on the same symmetric gait
        same |= _near(model, reached, observed[chosen], SAME) | symmetric(model, reached)
        turn = images.points
    return rows[np.unique(place[chosen[same & _leave(mapping, points, values)]])]


def symmetric(
    model: Model, observed: Float[np.ndarray, "records observables"]
) -> Bool[np.ndarray, " records"]:
    """Mask of observables as on a symmetric gait: an angle is a part of a turn, or two numbers are equal."""
    part = 2.0 * np.pi / PARTS_OF_A_TURN
    alike = np.zeros(len(observed), bool)
    for i, quantity in enumerate(model.observables):
        if quantity.circular:
            alike |= np.abs(observed[:, i] - part * np.round(observed[:, i] / part)) < ALIKE
    for i, k in itertools.combinations(range(len(model.observables)), 2):
        if model.observables[i].unit == model.observables[k].unit:
            one, other = observed[:, i], observed[:, k]
            # whole numbers are counts, which may be equal on any gait
            alike |= (np.abs(one - other) <= ALIKE * np.abs(one)) & (one != np.round(one))
    return alike


def _near(
    model: Model,
    one: Float[np.ndarray, "records observables"],
    other: Float[np.ndarray, "records observables"],
    share: float,
) -> Bool[np.ndarray, " records"]:
    """Mask of records whose observables differ by less than a share of their magnitude, at least 1."""
    return np.asarray(np.all(changes(model, one, other) < share * np.maximum(np.abs(one), 1.0), axis=1))


def _points_at(
    mapping: BatchedReturnMap,
    values: Mapping[str, Float[np.ndarray, " rows"]],
    starts: Mapping[str, Float[np.ndarray, " rows"]],
    place: Int[np.ndarray, " records"],
    crossing: Int[np.ndarray, " records"],
    levels: tuple[str, Float[np.ndarray, " records"]] | None,
    chosen: Int[np.ndarray, " some"],
) -> Points:
    """The points of the `chosen` records, at their crossings.

    A parameter that moves has the level of a record since the crossing of the one before it.
    """
    own = [np.flatnonzero(place == row) for row in range(place.max() + 1)]

    def values_at(number: int) -> dict[str, Float[np.ndarray, " rows"]]:
        """The parameters of the rows on the way to a crossing."""
        if levels is None:
            return dict(values)
        nearest = [k[min(np.searchsorted(crossing[k], number), k.size - 1)] for k in own]
        return {**values, levels[0]: levels[1][nearest]}

    at, _ = mapping.settled(starts, values_at(1), 1)
    points = at[place[chosen]]
    for number in range(2, int(crossing[chosen].max()) + 1):
        at = mapping.images(at, values_at(number)).points
        due = np.flatnonzero(crossing[chosen] == number)
        if due.size:
            points = points.merged(due, at[place[chosen[due]]])
    return points


def _leave(
    mapping: BatchedReturnMap, points: Points, values: Mapping[str, Float[np.ndarray, " points"]]
) -> Bool[np.ndarray, " points"]:
    """Mask of the points (n,) that trajectories from some side leave."""
    n, size = points.at.shape
    directions = np.random.default_rng(0).uniform(-1.0, 1.0, (DIRECTIONS, 1, size))
    displaced = points.at + DISPLACED * sizes(points.at) * directions
    copies = np.tile(np.arange(n), 1 + DIRECTIONS)
    batch = points[copies]
    batch = Points(np.concatenate([points.at, displaced.reshape(-1, size)]), batch.modes)
    values = {name: column[copies] for name, column in values.items()}

    left = np.zeros((DIRECTIONS, n), bool)
    ends = np.zeros((DIRECTIONS, n), bool)  # a trajectory ended, or that of the point itself
    first = mapping.distance(np.broadcast_to(points.at, displaced.shape), displaced)
    halfway = distance = first
    for number in range(1, FOLLOWED + 1):
        images = mapping.images(batch, values)
        sound = images.sound.reshape(1 + DIRECTIONS, n)
        left |= ~ends & sound[0] & ~sound[1:]
        ends |= ~sound[0] | ~sound[1:]
        at = images.points.at.reshape(1 + DIRECTIONS, n, size)
        distance = np.where(ends, 0.0, mapping.distance(np.broadcast_to(at[0], at[1:].shape), at[1:]))
        left |= distance > LEFT
        halfway = distance if number == FOLLOWED // 2 else halfway
        batch = images.points
        if np.all(left.any(axis=0) | ends.all(axis=0)):
            break
    left |= (distance > GROWN * first) & (distance > FASTER * halfway)
    return np.asarray(left.any(axis=0))
