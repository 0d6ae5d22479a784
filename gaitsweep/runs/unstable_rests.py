"""Rows of a self-check that rest on an unstable gait, which no finer step would show.

Legs that are alike to the last digit stay alike, and a row that begins at a fixed point stays there, whether
that gait is stable or not. Such rows are rerun with the same steps; the states in which they rest are
displaced and followed on.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping

import jax
import numpy as np
import pandas as pd
from jaxtyping import Bool, Float, Int

from gaitsweep.contract import Model, State
from gaitsweep.engine.poincare.maps import MapEvaluation, Points, sizes
from gaitsweep.engine.poincare.return_map import BatchedReturnMap
from gaitsweep.engine.recorders.staircase import StepRecorder
from gaitsweep.engine.recorders.states import StateRecorder, state_size, states_of
from gaitsweep.engine.solver import fixed_step_scheme
from gaitsweep.row_outcome import RowOutcome
from gaitsweep.runs.observable_changes import changes
from gaitsweep.runs.prepare import RunContext

# On a symmetric gait an angle is a part of a turn, within this many rad, or two observables of one unit are
# equal, within this share of their magnitude.
ALIKE, PARTS_OF_A_TURN = 1e-9, 24
# A row that has moved by less than this from its start (of each observable's magnitude, at least 1) rests
# where it began. A state whose next crossing differs by more from the stored one does not rest.
UNMOVED, SAME = 1e-6, 1e-3
# States are displaced by this distance (of the scale of each coordinate), in so many directions.
DISPLACED, DIRECTIONS = 1e-6, 3
COPIES = 1 + DIRECTIONS  # trajectories of a state: its own, and the displaced ones
# Displaced states are followed for so many crossings at most. One has left if it is `LEFT` away, or `GROWN`
# times as far as at the start and, over the second half, faster than along a neutral direction. It has
# returned if its distance has decayed to a share `RETURNED`.
FOLLOWED, LEFT, GROWN, FASTER, RETURNED = 200, 1e-3, 10.0, 2.5, 1e-4
# In steps of fixed length a crossing falls on a step's end: a state has left if it is this many times farther
# away than successive crossings of the resting row are from each other, over so many crossings.
SCATTERED, SCATTER_CROSSINGS = 10.0, 8
# States are followed for as many crossings in total as the sample's rows have, or for these; and so many
# states at most, each for `SHORTEST` crossings at least.
LEAST_CROSSINGS, MOST_STATES, SHORTEST = 4000, 64, 40


def unstable_rests(
    context: RunContext,
    records: pd.DataFrame,
    begun: Float[np.ndarray, "rows observables"],
    rerun: Callable[[Int[np.ndarray, " rows"], StateRecorder], RowOutcome],
    on_progress: Callable[[float], None] = lambda _: None,
) -> Int[np.ndarray, " unstable"]:
    """Find the rows that rest on an unstable gait.

    Args:
        context: the job's context.
        records: all records of some rows in their order: `row`, whether it `rests` there, the number of the
            `crossing`, the `period` of its orbit in crossings, the observables by their names, and the
            parameter that moves.
        begun: the observables at the start of each row of the records, in the order of their numbers.
        rerun: reruns rows (n,) with the same steps and the given recorder.
        on_progress: called with the share of the displaced states that is followed.

    Returns:
        The numbers of the rows. Rows whose rerun does not rest where they do are among them.
    """
    model, numerics = context.model, context.spec.numerics
    in_fixed_steps = fixed_step_scheme(numerics.method, model) is not None
    if in_fixed_steps and model.host_parameters:
        return np.zeros(0, np.int64)  # a map has no parameters that the host computes
    rows, place = np.unique(records["row"].to_numpy(np.int64), return_inverse=True)
    records = records.assign(place=place, sample=records.groupby("row").cumcount())
    crossing = records["crossing"].to_numpy(np.int64)
    of_sample = sum(int(crossing[place == row].max()) for row in range(rows.size))
    # a crossing of a simulator takes long: the least number suffices for one state
    budget = max(of_sample, FOLLOWED * COPIES if in_fixed_steps else LEAST_CROSSINGS)
    suspects = _suspects(model, records, begun)
    if not len(suspects):
        return rows[:0]
    count = int(np.clip(budget // (SHORTEST * COPIES), 1, MOST_STATES))
    suspects = suspects.iloc[np.unique(np.linspace(0, len(suspects) - 1, count).astype(int))]

    parameters, starts = context.design.values_in(rows)
    shape = _state_shape(context, parameters, starts)
    again = np.unique(suspects["place"])
    recorder = StateRecorder(model, context.spec.recorder, state_size(shape))
    outcome = rerun(rows[again], recorder)
    samples, same = _samples(recorder, outcome, np.searchsorted(again, suspects["place"]), suspects)
    elsewhere, suspects = suspects.iloc[np.flatnonzero(~same)], suspects.iloc[np.flatnonzero(same)]

    moving = context.job.run.moved
    following = context.design.following(moving) if moving is not None else {}
    values = {k: column[suspects["place"]] for k, column in parameters.items() if k not in following}
    if moving is not None:
        values[moving] = suspects[moving].to_numpy(float)
    mapping = BatchedReturnMap(model, tuple(following.items()), numerics, context.spec.engine)
    at_section = not isinstance(recorder.base, StepRecorder)
    points = _points(mapping, values, states_of(samples[same], shape), at_section=at_section)
    leaves = _leave(mapping, points, values, suspects, budget, on_progress, smooth=not in_fixed_steps)
    return rows[np.unique(np.concatenate([elsewhere["place"], suspects["place"][leaves]]))]


def _suspects(
    model: Model, records: pd.DataFrame, begun: Float[np.ndarray, "rows observables"]
) -> pd.DataFrame:
    """The records that rest on a symmetric gait, or where their row began."""
    observed = records[[q.name for q in model.observables]].to_numpy(float)
    suspect = symmetric(model, observed) | _near(model, observed, begun[records["place"]], UNMOVED)
    suspect &= records["rests"].to_numpy(bool) & (records["crossing"].to_numpy(np.int64) > 0)
    return records.iloc[np.flatnonzero(suspect)]


def symmetric(
    model: Model, observed: Float[np.ndarray, "records observables"]
) -> Bool[np.ndarray, " records"]:
    """Mask of observables as on a symmetric gait: an angle is a part of a turn, or two numbers are equal.

    Args:
        model: the model.
        observed: its observables in each record.
    """
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
    near = changes(model, one, other) < share * np.maximum(np.abs(one), 1.0)
    return np.asarray(np.all(near | (np.isnan(one) & np.isnan(other)), axis=1))


def _state_shape(
    context: RunContext,
    parameters: Mapping[str, Float[np.ndarray, " rows"]],
    starts: Mapping[str, Float[np.ndarray, " rows"]],
) -> State:
    """The shapes and dtypes of the leaves of a row's state."""
    model, drive = context.model, context.spec.drive

    def state(values: Mapping[str, jax.Array], start: Mapping[str, jax.Array]) -> State:
        params = model.params(values) if drive is None else drive(values, jax.numpy.zeros(()))
        return model.init(params, start)

    given = model.on_host(parameters), starts
    return jax.eval_shape(state, *jax.tree.map(lambda x: jax.ShapeDtypeStruct(x.shape[1:], x.dtype), given))


def _samples(
    recorder: StateRecorder,
    outcome: RowOutcome,
    place: Int[np.ndarray, " suspects"],
    suspects: pd.DataFrame,
) -> tuple[Float[np.ndarray, "suspects width"], Bool[np.ndarray, " suspects"]]:
    """The samples of rerun rows at some records, and whether the rerun rests where these do.

    Args:
        recorder: the recorder of the rerun.
        outcome: its results.
        place: the place of each record's row among the rerun ones.
        suspects: the records.
    """
    nth, names = suspects["sample"].to_numpy(), [q.name for q in recorder.model.observables]
    exists = nth < outcome.kept[place]
    first = np.cumsum(outcome.kept) - outcome.kept
    samples = outcome.samples[np.where(exists, first[place] + nth, 0)]
    now = outcome.last[place]
    if recorder.base.names:
        now = samples[:, [recorder.names.index(f"{name}_n") for name in names]]
    return samples, exists & _near(recorder.model, now, suspects[names].to_numpy(float), SAME)


def _points(
    mapping: BatchedReturnMap,
    values: Mapping[str, Float[np.ndarray, " states"]],
    states: State,
    *,
    at_section: bool,
) -> Points:
    """The points of states (n,) at a crossing of the section, or of the next crossings of states between."""

    def one(own: Mapping[str, jax.Array], state: State) -> tuple[jax.Array, State]:
        params = mapping.params(own)
        crossed = state if at_section else mapping.state(params, state)[1]
        return mapping.chart.to_coordinates(params, crossed), crossed

    complete = mapping.complete(values, len(jax.tree.leaves(states)[0]))
    return Points(*jax.tree.map(np.asarray, jax.jit(jax.vmap(one))(complete, states)))


def _leave(
    mapping: BatchedReturnMap,
    points: Points,
    values: Mapping[str, Float[np.ndarray, " points"]],
    suspects: pd.DataFrame,
    budget: int,
    on_progress: Callable[[float], None],
    *,
    smooth: bool,
) -> Bool[np.ndarray, " points"]:
    """Mask of the points (n,) where rows rest and that trajectories from some side leave.

    Args:
        mapping: the return map.
        points: the points.
        values: their parameters.
        suspects: their records.
        budget: crossings in which all points and their displaced copies are followed.
        on_progress: called with the share that is followed.
        smooth: whether distances grow as under a smooth map, so that slow growth tells an unstable point.
    """
    n = len(points)
    period = int(np.max(suspects["period"].to_numpy(np.int64), initial=1))
    observed = suspects[[q.name for q in mapping.model.observables]].to_numpy(float)
    scattered_until = 0 if smooth else SCATTER_CROSSINGS * period
    batch = _with_copies(points)
    distances = [_from_first(mapping, batch.at.reshape(COPIES, n, -1))]
    going = np.arange(n)  # the points whose trajectories are followed
    turn = points.at
    rests = np.zeros(n, bool)
    left = np.zeros(n, bool)
    left_at = np.full(n, LEFT)
    ended = np.zeros((DIRECTIONS, n), bool)
    while going.size and (number := len(distances)) <= FOLLOWED:
        on_progress(number / FOLLOWED)
        budget -= going.size * COPIES
        if budget < 0 and number > SHORTEST:
            break
        images = mapping.images(batch, {k: column[np.tile(going, COPIES)] for k, column in values.items()})
        batch = images.points
        at = batch.at.reshape(COPIES, going.size, -1)
        if number <= period:
            rests |= _on_the_gait(mapping.model, images[:n], observed)
        if number <= scattered_until and number % period == 0:
            left_at = np.maximum(left_at, SCATTERED * mapping.distance(turn, at[0]))
            turn = at[0]
        sound = images.sound.reshape(COPIES, going.size)
        left[going] |= (~ended[:, going] & sound[0] & ~sound[1:]).any(axis=0)
        ended[:, going] |= ~sound[0] | ~sound[1:]
        distance = distances[-1].copy()
        distance[:, going] = _from_first(mapping, at)
        distance[ended] = 0.0
        distances.append(distance)
        if number >= max(period, scattered_until):
            left |= (distance > left_at).any(axis=0)
            away = np.any(distance > RETURNED * distances[0], axis=0)
            stay = np.flatnonzero((away & ~left)[going])
            batch = batch[(np.arange(COPIES)[:, None] * going.size + stay).ravel()]
            going = going[stay]
    if smooth:
        halfway = distances[len(distances) // 2]
        last = distances[-1]
        left |= ((last > GROWN * distances[0]) & (last > FASTER * halfway)).any(axis=0)
    return rests & left


def _with_copies(points: Points) -> Points:
    """The points (n,), and then those displaced in each direction."""
    shape = (DIRECTIONS, 1, points.at.shape[1])
    directions = np.random.default_rng(0).uniform(-1.0, 1.0, shape)
    displaced = points.at + DISPLACED * sizes(points.at) * directions
    return Points(
        np.concatenate([points.at, *displaced]), points[np.tile(np.arange(len(points)), COPIES)].modes
    )


def _from_first(
    mapping: BatchedReturnMap, at: Float[np.ndarray, "copies points coordinates"]
) -> Float[np.ndarray, "directions points"]:
    """The distances of the displaced points from the points themselves, the first of the copies."""
    return mapping.distance(np.broadcast_to(at[0], at[1:].shape), at[1:])


def _on_the_gait(
    model: Model, images: MapEvaluation, observed: Float[np.ndarray, "points observables"]
) -> Bool[np.ndarray, " points"]:
    """Mask of images with the observables of records that rest, or with those of a symmetric gait.

    Records of earlier cycles, such as those of lifted feet, may differ on the same symmetric gait.
    """
    reached = np.stack([images.observed[q.name] for q in model.observables], axis=1)
    return _near(model, reached, observed, SAME) | symmetric(model, reached)
