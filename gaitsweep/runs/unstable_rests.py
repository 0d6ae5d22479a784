"""Rows of a self-check that rest on an unstable gait, which no finer step would show.

Legs that are alike to the last digit stay alike, and a row that begins at a fixed point stays there, whether
that gait is stable or not. Such rows are rerun with the same steps; the states in which they rest are
displaced and followed on.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import jax
import numpy as np
import pandas as pd
from jaxtyping import Bool, Float, Int

from gaitsweep.contract import Model, Params, Quantity, State
from gaitsweep.dynamics.declared import Declared
from gaitsweep.dynamics.gaits_by_footfalls import Footfalls
from gaitsweep.engine.kernel.lanes import over_started_rows
from gaitsweep.engine.kernel.row_functions import over_rows
from gaitsweep.engine.poincare.maps import MIN_SCALE, Points
from gaitsweep.engine.poincare.poincare_return import Returned, ReturnStatus
from gaitsweep.engine.poincare.return_map import BatchedReturnMap
from gaitsweep.engine.recorders.staircase import StepRecorder
from gaitsweep.engine.recorders.states import StateRecorder, state_size, states_of
from gaitsweep.engine.solver.methods import derivative_refusal, fixed_step_scheme
from gaitsweep.engine.tangents import AllVariables
from gaitsweep.row_outcome import RowOutcome
from gaitsweep.runs.prepare import RunContext
from gaitsweep.runs.self_check_result import changes

# On a symmetric gait an angle is a multiple of a turn / `PARTS_OF_A_TURN`, within `ALIKE` (rad), or two
# observables of one unit are equal, within a share `ALIKE` of their magnitude.
ALIKE = 1e-9
PARTS_OF_A_TURN = 24
# A row rests where it began if it has moved by less than `UNMOVED` (of each observable's magnitude, at least
# 1, or its `scale` if that is smaller). A state does not rest if its next crossing differs by more than
# `SAME` from the stored one.
UNMOVED = 1e-6
SAME = 1e-3
DISPLACEMENT = 1e-6  # of the scale of each coordinate
# At a stable gait a displacement may grow a thousandfold before it decays. So the states that left are
# displaced again, by a share `SMALLER` of that, and followed for `REACH` times as many crossings: at an
# unstable gait they leave again, since they grow at the same rate, or the state itself leaves, which rests
# beside the gait and not on it.
SMALLER = 1e-3
REACH = 2
DIRECTIONS = 3  # in which each state is displaced
COPIES = 1 + DIRECTIONS  # trajectories of a state: its own, and the displaced ones
# A displaced state has left if it is `LEFT` away, or `GROWN` times as far as at the start and, after the
# second half of its crossings, more than `FASTER` times as far as after the first: along a neutral direction
# it is twice as far. It has returned if its distance has decayed to a share `RETURNED`.
LEFT = 1e-3
GROWN = 10.0
FASTER = 2.5
RETURNED = 1e-4
# It stays where it is, along a neutral direction or within errors of integration, if after `STILL_AFTER`
# crossings none of its displacements over the last `STILL_FOR` differs from the others by more than a share
# `STILL` of the first one: an unstable direction would have to begin with 3e-5 of the displacement.
STILL_AFTER = 80
STILL_FOR = 20
STILL = 5e-3
# In steps of fixed length a crossing falls on a step's end: a state has left if it is `SCATTERED` times
# farther away than successive crossings of the resting row are from each other, over the first crossings.
SCATTERED = 10.0
SCATTER_CROSSINGS = 8
# A displaced state is followed for `MAX_CROSSINGS`, or until all states have used up the budget: as many
# crossings as the rows of the sample have, at least `MIN_BUDGET`. With more states than `MAX_STATES`, or than
# the budget has `MIN_CROSSINGS` for, some of them are followed.
MAX_CROSSINGS = 200
MIN_CROSSINGS = 40
MIN_BUDGET = 4000
MAX_STATES = 64
# A sign of symmetry that all records have may be due to the section, such as the phase that defines it: then
# the next crossings of displaced starts have it too. They do so as well on a gait that attracts strongly, so
# up to `PROBED_ROWS` rows are displaced, by `START_DISPLACEMENT` of the scale of each coordinate.
START_DISPLACEMENT = 1e-3
PROBED_ROWS = 64


def unstable_rests(
    context: RunContext,
    records: pd.DataFrame,
    begun: Float[np.ndarray, "rows observables"],
    rerun: Callable[[Int[np.ndarray, " rows"], StateRecorder], RowOutcome],
    on_progress: Callable[[float], None],
) -> pd.DataFrame:
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
        The first such record of each row: `row`, its number `sample` there, and the moving parameter. Rows
        whose rerun does not rest where they do are among them.
    """
    model = context.model
    in_fixed_steps = fixed_step_scheme(context.spec.numerics.method, model) is not None
    if in_fixed_steps and model.host_parameters:
        return records.iloc[:0]  # a map has no parameters that the host computes
    # a crossing of a simulator takes long: the least number suffices for one state
    min_budget = MAX_CROSSINGS * COPIES if in_fixed_steps else MIN_BUDGET
    budget = max(int(np.asarray(records.groupby("row")["crossing"].max(), np.int64).sum()), min_budget)
    resting = _resting(model, records)
    observed = _observables(model, resting)
    unmoved = _near(model, observed, begun[resting["place"]], UNMOVED)
    signs = signs_of_symmetry(model, observed)
    suspects = resting.iloc[np.flatnonzero(unmoved | signs.any(axis=1))]
    if suspects.empty:
        return suspects
    states = _StatesOfRows(context, np.unique(records["row"].to_numpy(np.int64)))
    telling = states.telling_signs(suspects, signs)
    suspects = resting.iloc[np.flatnonzero(unmoved | signs[:, telling].any(axis=1))]
    if suspects.empty:
        return suspects
    count = int(np.clip(budget // (MIN_CROSSINGS * COPIES), 1, MAX_STATES))
    suspects = suspects.iloc[followed(suspects["ahead"].to_numpy(float), count)]
    samples, same = states.rerun(suspects, rerun)
    unstable = [suspects.iloc[np.flatnonzero(~same)]]
    if same.any():
        suspects = suspects.iloc[np.flatnonzero(same)]
        leaving = states.leaving(suspects, samples[same], telling, budget, on_progress)
        unstable.append(suspects.iloc[leaving])
    # the record of each row with the least number there
    return pd.concat(unstable).sort_values(["row", "sample"]).drop_duplicates("row")


def _resting(model: Model, records: pd.DataFrame) -> pd.DataFrame:
    """The records that rest, with the `place` of their row, their number `sample` in it, and `ahead`."""
    place = np.unique(records["row"].to_numpy(np.int64), return_inverse=True)[1]
    sample = records.groupby("row").cumcount()
    numbered = records.assign(place=place, sample=sample, ahead=_changes_ahead(model, records))
    resting = records["rests"].to_numpy(bool) & (records["crossing"].to_numpy(np.int64) > 0)
    return numbered.iloc[np.flatnonzero(resting)]


class _StatesOfRows:
    """The states in which some rows of a job rest, which its return map follows.

    Args:
        context: the job's context.
        rows: the rows (n,), of which records have the `place`.
    """

    def __init__(self, context: RunContext, rows: Int[np.ndarray, " rows"]) -> None:
        self._context, self._rows = context, rows
        self._model, self._numerics = context.model, context.spec.numerics
        self._moving = context.job.run.moved
        parameters, starts = context.design.values_in(rows)
        self._shape = _state_shape(context, parameters, starts)
        following = {} if self._moving is None else context.design.following(self._moving)
        self._parameters = {name: column for name, column in parameters.items() if name not in following}
        engine = "quick" if context.spec.engine == "kernel" else context.spec.engine
        mapping = BatchedReturnMap(self._model, tuple(following.items()), self._numerics, engine)
        self._mapping = dataclasses.replace(mapping, least=MIN_SCALE * _units(mapping.coordinates))
        self._at_section = not isinstance(context.spec.recorder, StepRecorder)
        self._deciding = self._mapping.settings, self._numerics, self._at_section
        self._follow = _following(self._mapping, self._deciding)

    def _values_at(self, records: pd.DataFrame) -> dict[str, Float[np.ndarray, " records"]]:
        """The parameters of the map at records."""
        moved = {} if self._moving is None else {self._moving: records[self._moving].to_numpy(float)}
        return {name: column[records["place"]] for name, column in self._parameters.items()} | moved

    def telling_signs(
        self, suspects: pd.DataFrame, signs: Bool[np.ndarray, "records signs"]
    ) -> Bool[np.ndarray, " signs"]:
        """Mask of the signs of symmetry that are not due to the section.

        Args:
            suspects: records with such signs, or of rows that have not moved.
            signs: the signs of all records that rest.
        """
        telling = ~np.all(signs, axis=0)
        if telling.all():
            return telling
        first_of_rows = np.unique(suspects["place"], return_index=True)[1]
        spread = np.linspace(0, first_of_rows.size - 1, min(PROBED_ROWS, first_of_rows.size)).astype(int)
        return telling | ~self._signs_by_the_section(suspects.iloc[first_of_rows[spread]])

    def _signs_by_the_section(self, probed: pd.DataFrame) -> Bool[np.ndarray, " signs"]:
        """Mask of the signs that displaced starts of the rows of records all have at their next crossing."""
        starts = self._starting_points(self._rows[probed["place"]])
        size = START_DISPLACEMENT * self._mapping.sizes(starts.at)
        displaced = _with_copies(starts, size)[len(starts) :]
        copies = {name: np.tile(column, DIRECTIONS) for name, column in self._values_at(probed).items()}
        images = self._follow(displaced, copies, len(displaced))
        observed = np.stack([images.observed[q.name] for q in self._model.observables], axis=1)
        signs = signs_of_symmetry(self._model, observed[images.sound])
        return np.all(signs, axis=0) & bool(images.sound.any())

    def _starting_points(self, rows: Int[np.ndarray, " rows"]) -> Points:
        """The coordinates and states of rows (n,) at their starts, which may lie between crossings."""
        model, spec, chart = self._model, self._context.spec, self._mapping.chart

        def point(params: Params, state: State) -> tuple[jax.Array, list[jax.Array]]:
            return chart.to_coordinates(params, state), jax.tree.leaves(state)

        of_rows = over_started_rows(point, "starting_point", model, spec.numerics.dtype, spec.drive)
        parameters, starts = self._context.design.values_in(rows)
        at, leaves = of_rows(model.on_host(parameters), starts)
        structure = jax.tree.structure(self._shape)
        return Points(np.asarray(at), jax.tree.unflatten(structure, map(np.asarray, leaves)))

    def rerun(
        self,
        suspects: pd.DataFrame,
        rerun: Callable[[Int[np.ndarray, " rows"], StateRecorder], RowOutcome],
    ) -> tuple[Float[np.ndarray, "suspects width"], Bool[np.ndarray, " suspects"]]:
        """The samples of rerun rows at some records, and whether the rerun rests where these do."""
        recorder = StateRecorder(self._model, self._context.spec.recorder, state_size(self._shape))
        names = [quantity.name for quantity in self._model.observables]
        places, place = np.unique(suspects["place"], return_inverse=True)
        outcome = rerun(self._rows[places], recorder)
        number = suspects["sample"].to_numpy()  # of the record in its row
        exists = number < outcome.record_counts[place]
        first = np.cumsum(outcome.record_counts) - outcome.record_counts
        samples = outcome.samples[np.where(exists, first[place] + number, 0)]
        observed = outcome.last[place]
        if recorder.base.names:
            observed = samples[:, [recorder.names.index(f"{name}_n") for name in names]]
        return samples, exists & _near(self._model, observed, suspects[names].to_numpy(float), SAME)

    def leaving(
        self,
        suspects: pd.DataFrame,
        samples: Float[np.ndarray, "suspects width"],
        telling: Bool[np.ndarray, " signs"],
        budget: int,
        on_progress: Callable[[float], None],
    ) -> Int[np.ndarray, " leaving"]:
        """The places of the suspects whose displaced states leave them.

        Args:
            suspects: the records.
            samples: those of the rerun, with their states.
            telling: a mask of the signs of symmetry that tell a symmetric gait.
            budget: the crossings in which the states are followed.
            on_progress: called with the share that is followed.
        """
        values = self._values_at(suspects)
        points = self._points(values, states_of(samples, self._shape))
        leaving = np.arange(len(points))
        # a smaller displacement is lost among the digits of float32
        for share in (1.0, SMALLER) if self._numerics.dtype == "float64" else (1.0,):
            if leaving.size:
                displaced = _DisplacedStates(
                    self._mapping,
                    self._follow,
                    points[leaving],
                    {name: column[leaving] for name, column in values.items()},
                    _observables(self._model, suspects.iloc[leaving]),
                    telling,
                    suspects["period"].to_numpy(np.int64)[leaving],
                    smooth=fixed_step_scheme(self._numerics.method, self._model) is None,
                    share=share,
                )
                leaving = leaving[displaced.follow(budget, on_progress)]
        return leaving

    def _points(self, values: Mapping[str, Float[np.ndarray, " states"]], states: State) -> Points:
        """The points of states (n,) at a crossing of the section, or of the next crossings of others."""
        mapping, at_section = self._mapping, self._at_section
        # coordinates of a chart of all variables describe any state, so that the map itself leads to the
        # section
        by_map = not at_section and isinstance(mapping.chart, AllVariables)

        def point(
            values_of_state: Mapping[str, jax.Array], state: State
        ) -> tuple[jax.Array, list[jax.Array]]:
            params = mapping.params(values_of_state)
            crossed = state if at_section or by_map else mapping.state(params, state)[1]
            return mapping.chart.to_coordinates(params, crossed), jax.tree.leaves(crossed)

        leaves, structure = jax.tree.flatten(states)
        complete = mapping.complete(values, len(leaves[0]))
        if at_section or by_map:
            at, crossed = over_rows(point, "resting_point", mapping.model, self._deciding)(complete, states)
        else:
            at, crossed = jax.jit(jax.vmap(point))(complete, states)
        points = Points(np.asarray(at), jax.tree.unflatten(structure, map(np.asarray, crossed)))
        return self._follow(points, values, COPIES * len(points)).points if by_map else points


def _observables(model: Model, records: pd.DataFrame) -> Float[np.ndarray, "records observables"]:
    """The observables of some records."""
    return records[[quantity.name for quantity in model.observables]].to_numpy(float)


def _changes_ahead(model: Model, records: pd.DataFrame) -> Float[np.ndarray, " records"]:
    """The change of each record to the next one of its row, relative to its size; 0 at the end of a row."""
    observed = _observables(model, records)
    size = np.maximum(np.abs(observed[:-1]), _units(model.observables))
    relative = np.nan_to_num(changes(model, observed[:-1], observed[1:]) / size, nan=0.0)
    row = records["row"].to_numpy()
    same_row = row[:-1] == row[1:]
    return np.append(np.where(same_row, relative.max(axis=1, initial=0.0), 0.0), 0.0)


def followed(changes_ahead: Float[np.ndarray, " suspects"], count: int) -> Int[np.ndarray, " followed"]:
    """The places of at most `count` suspects: those before the largest changes, and evenly spaced ones.

    Before a jump to another gait a row may have rested on an unstable one.
    """
    if len(changes_ahead) <= count:
        return np.arange(len(changes_ahead))
    before_jumps = np.argsort(-changes_ahead, kind="stable")[: (count + 1) // 2]
    spaced = np.linspace(0, len(changes_ahead) - 1, count - len(before_jumps)).astype(int)
    return np.unique(np.concatenate([before_jumps, spaced]))


def signs_of_symmetry(
    model: Model, observed: Float[np.ndarray, "records observables"]
) -> Bool[np.ndarray, "records signs"]:
    """Signs of a symmetric gait: an angle is a part of a turn, or two observables are equal.

    Args:
        model: the model.
        observed: its observables in each record.

    Returns:
        For each record a mask of the signs: of the angles, then of pairs of observables of one unit.
    """
    part = 2.0 * np.pi / PARTS_OF_A_TURN
    signs = [
        np.abs(angle - part * np.round(angle / part)) < ALIKE
        for angle, quantity in zip(observed.T, model.observables, strict=True)
        if quantity.circular
    ]
    shared = set(strides_of_feet(model))
    for i, k in itertools.combinations(range(len(model.observables)), 2):
        if {model.observables[i].name, model.observables[k].name} <= shared:
            continue
        if model.observables[i].unit == model.observables[k].unit:
            values = observed[:, i]
            equal = np.abs(values - observed[:, k]) <= ALIKE * np.abs(values)
            # whole numbers are counts, which may be equal on any gait
            signs.append(equal & (values != np.round(values)))
    return np.stack(signs, axis=1) if signs else np.zeros((len(observed), 0), bool)


def strides_of_feet(model: Model) -> dict[str, str]:
    """The leg of each stride of declared footfalls, which all legs have alike on every periodic gait."""
    original = model.original
    declarations = original.declarations.values() if isinstance(original, Declared) else ()
    footfalls = [declared for declared in declarations if isinstance(declared, Footfalls)]
    return {
        name: leg
        for declared in footfalls
        for name, leg in zip(declared.stride_names, declared.legs, strict=True)
    }


def _near(
    model: Model,
    one: Float[np.ndarray, "records observables"],
    other: Float[np.ndarray, "records observables"],
    share: float,
) -> Bool[np.ndarray, " records"]:
    """Mask of records whose observables differ by less than a share of their magnitude, at least `_units`."""
    near = changes(model, one, other) < share * np.maximum(np.abs(one), _units(model.observables))
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

    inputs = model.on_host(parameters), starts
    return jax.eval_shape(state, *jax.tree.map(lambda x: jax.ShapeDtypeStruct(x.shape[1:], x.dtype), inputs))


class _Images(NamedTuple):
    """The images of points, a mask of those that have one, and the observables there by name."""

    points: Points
    sound: Bool[np.ndarray, " points"]
    observed: Mapping[str, Float[np.ndarray, " points"]]


# The images of points (n,) with values (n,) of parameters, in a batch of the given width: XLA compiles a map
# for each width of a batch.
_Follow = Callable[[Points, Mapping[str, Float[np.ndarray, " points"]], int], _Images]


def _following(mapping: BatchedReturnMap, deciding: Any) -> _Follow:
    """The function that follows points to their images: by kernels alone where the map has some.

    Args:
        mapping: the return map.
        deciding: what decides it besides its model and numerics.
    """

    def by_map(points: Points, values: Mapping[str, Float[np.ndarray, " points"]], width: int) -> _Images:
        order = np.minimum(np.arange(width), len(points) - 1)
        images = mapping.images(points[order], {name: column[order] for name, column in values.items()})
        images = images[: len(points)]
        return _Images(images.points, images.sound, images.observed)

    model, numerics = mapping.model, mapping.integration
    if mapping.engine != "quick" or derivative_refusal(numerics.method, model) is not None:
        return by_map
    from gaitsweep.engine.kernel.poincare_returns import ReturnsWithoutXla
    from gaitsweep.engine.kernel.trace import UnsupportedError

    def begin(values: Any, at: jax.Array, modes: State) -> tuple[Params, State]:
        params = mapping.params(values)
        return params, mapping.chart.from_coordinates(params, at, modes)

    def end(params: Params, returned: Returned) -> Mapping[str, Any]:
        at, state, status, observed = mapping.ended(params, *returned)
        return {"at": at, "state": jax.tree.leaves(state), "status": status, "observed": observed}

    returns = ReturnsWithoutXla(model, numerics, begin, end, deciding)
    supported = True

    def by_kernels(points: Points, values: Mapping[str, Float[np.ndarray, " points"]], width: int) -> _Images:
        nonlocal supported
        if supported:
            try:
                ends = returns(mapping.complete(values, len(points)), points.at, points.modes)
            except UnsupportedError:
                supported = False
            else:
                modes = jax.tree.unflatten(jax.tree.structure(points.modes), ends["state"])
                sound = ends["status"] == ReturnStatus.crossed
                return _Images(Points(ends["at"], modes), sound, ends["observed"])
        return by_map(points, values, width)

    return by_kernels


class _DisplacedStates:
    """Displaced copies of points (n,) where rows rest, followed to decide whether they leave the points.

    Args:
        mapping: the return map.
        follow: follows points to their images under it.
        points: the points.
        values: their parameters.
        observed: the observables of their records.
        telling: a mask of the signs of symmetry that not all crossings have.
        period: the periods (n,) of their orbits, in crossings; 0 if unknown, which counts as 1.
        smooth: whether distances grow as under a smooth map, so that slow growth tells an unstable point.
        share: the displacement, as a share of `DISPLACEMENT`.
    """

    def __init__(
        self,
        mapping: BatchedReturnMap,
        follow: _Follow,
        points: Points,
        values: Mapping[str, Float[np.ndarray, " points"]],
        observed: Float[np.ndarray, "points observables"],
        telling: Bool[np.ndarray, " signs"],
        period: Int[np.ndarray, " points"],
        *,
        smooth: bool,
        share: float,
    ) -> None:
        n = len(points)
        self._mapping = mapping
        self._follow = follow
        self._points = points
        self._values = values
        self._observed = observed
        self._telling = telling
        self._period = np.maximum(period, 1)
        self._smooth = smooth
        self._displacement = share * DISPLACEMENT * mapping.sizes(points.at)
        self._reach = 1 if share == 1.0 else REACH
        self._scattered_until = (0 if smooth else SCATTER_CROSSINGS) * self._period
        self._rests = np.zeros(n, bool)
        self._left = np.zeros(n, bool)
        self._left_at = np.full(n, LEFT)  # the distance from which on a state counts as left
        self._ended = np.zeros((DIRECTIONS, n), bool)  # trajectories without another crossing

    def follow(self, budget: int, on_progress: Callable[[float], None]) -> Bool[np.ndarray, " points"]:
        """Return a mask of the points (n,) where rows rest and that trajectories from some side leave.

        Args:
            budget: crossings in which all points and their displaced copies are followed, times `REACH` for
                a smaller displacement.
            on_progress: called with the share that is followed.
        """
        budget *= self._reach
        n, most = len(self._points), self._reach * MAX_CROSSINGS
        followed = np.arange(n)  # the points that are not decided
        batch = _with_copies(self._points, self._displacement)
        distances = [self._from_first(batch.at.reshape(COPIES, n, -1))]
        previous = self._points.at.copy()  # the coordinates a period of each orbit ago
        decided_from = np.maximum(self._period, self._scattered_until)
        displacements: deque[Float[np.ndarray, "directions points coordinates"]] = deque(maxlen=STILL_FOR + 1)
        while followed.size and (number := len(distances)) <= most:
            on_progress(number / most)
            budget -= followed.size * COPIES
            if budget < 0 and number > self._reach * MIN_CROSSINGS:
                break
            copies = np.tile(followed, COPIES)
            values = {name: column[copies] for name, column in self._values.items()}
            images = self._follow(batch, values, COPIES * n)
            batch = images.points
            at = batch.at.reshape(COPIES, followed.size, -1)
            period = self._period[followed]
            if (number <= period).any():
                observed = {name: column[: followed.size] for name, column in images.observed.items()}
                rests = _on_the_gait(self._mapping.model, observed, self._observed[followed], self._telling)
                self._rests[followed] |= rests & (number <= period)
            again = number % period == 0  # at the place of the orbit where the state was first
            scattered = np.flatnonzero(again & (number <= self._scattered_until[followed]))
            some = followed[scattered]
            scatter = SCATTERED * self._mapping.distance(previous[some], at[0][scattered])
            self._left_at[some] = np.maximum(self._left_at[some], scatter)
            previous[some] = at[0][scattered]
            self._record_ends(followed, images.sound.reshape(COPIES, followed.size))
            distance = distances[-1].copy()
            distance[:, followed] = self._from_first(at)
            distance[self._ended] = 0.0
            distances.append(distance)
            decided = number >= decided_from
            self._left |= decided & (distance > self._left_at).any(axis=0)
            if self._reach > 1:
                gone = self._mapping.distance(self._points.at[followed], at[0])
                self._left[followed] |= decided[followed] & again & (gone > self._left_at[followed])
            away = np.any(distance > RETURNED * distances[0], axis=0)
            now = np.full((DIRECTIONS, n, at.shape[-1]), np.nan)
            now[:, followed] = self._mapping.difference(at[1:], np.broadcast_to(at[0], at[1:].shape))
            displacements.append(now)
            if self._smooth and number >= STILL_AFTER:
                for of_orbit in np.unique(period):
                    is_still = _still(displacements, self._displacement, of_orbit)
                    away &= (self._period != of_orbit) | ~is_still
            undecided = np.flatnonzero((~decided | (away & ~self._left))[followed])
            batch = batch[(np.arange(COPIES)[:, None] * followed.size + undecided).ravel()]
            followed = followed[undecided]
        if self._smooth:
            self._left |= self._grown(distances)
        return self._rests & self._left

    def _grown(
        self, distances: Sequence[Float[np.ndarray, "directions points"]]
    ) -> Bool[np.ndarray, " points"]:
        """Mask of points from which copies moved away, faster after half of their crossings.

        Distances are compared at the same place of the orbit.
        """
        last, half = len(distances) - 1, len(distances) // 2
        halfway = last - self._period * np.round((last - half) / self._period).astype(np.int64)
        before = np.stack(distances)[np.maximum(halfway, 0), :, np.arange(self._period.size)].T
        now = distances[-1]
        return np.asarray(((now > GROWN * distances[0]) & (now > FASTER * before)).any(axis=0))

    def _from_first(
        self, at: Float[np.ndarray, "copies points coordinates"]
    ) -> Float[np.ndarray, "directions points"]:
        """The distances of the displaced points from the points themselves, the first of the copies."""
        return self._mapping.distance(np.broadcast_to(at[0], at[1:].shape), at[1:])

    def _record_ends(
        self, followed: Int[np.ndarray, " followed"], sound: Bool[np.ndarray, "copies followed"]
    ) -> None:
        """Count a point as left where a displaced trajectory ends before the point's own does."""
        ended = self._ended[:, followed]
        self._left[followed] |= (~ended & sound[0] & ~sound[1:]).any(axis=0)
        self._ended[:, followed] = ended | ~sound[0] | ~sound[1:]


def _units(quantities: Sequence[Quantity]) -> Float[np.ndarray, " quantities"]:
    """The sizes (k,) below which quantities are not compared by their magnitude: 1, or a smaller `scale`."""
    return np.array([1.0 if q.circular or q.scale is None else min(q.scale, 1.0) for q in quantities])


def _with_copies(points: Points, size: Float[np.ndarray, "points coordinates"]) -> Points:
    """The points (n,), and then those displaced in each direction, by at most `size`."""
    shape = (DIRECTIONS, 1, points.at.shape[1])
    directions = np.random.default_rng(0).uniform(-1.0, 1.0, shape)
    displaced = points.at + size * directions
    copies = np.tile(np.arange(len(points)), COPIES)
    return Points(np.concatenate([points.at, *displaced]), points[copies].modes)


def _still(
    displacements: Sequence[Float[np.ndarray, "directions points coordinates"]],
    size: Float[np.ndarray, "points coordinates"],
    period: int,
) -> Bool[np.ndarray, " points"]:
    """Mask of points whose displaced copies keep their displacement, at the same places of the orbit.

    Args:
        displacements: those of the last crossings.
        size: the displacement at the start.
        period: the period of the orbit, in crossings.
    """
    last, *before = list(displacements)[::-period]
    if not before:
        return np.zeros(len(size), bool)
    changes_of_one = np.max([np.abs(last - earlier) for earlier in before], axis=0) / size
    return np.asarray(np.all(changes_of_one < STILL, axis=(0, 2)))


def _on_the_gait(
    model: Model,
    images: Mapping[str, Float[np.ndarray, " points"]],
    observed: Float[np.ndarray, "points observables"],
    telling: Bool[np.ndarray, " signs"],
) -> Bool[np.ndarray, " points"]:
    """Mask of observables of images, by name, that are those of records that rest, or of a symmetric gait.

    Records of earlier cycles, such as those of lifted feet, may differ on the same symmetric gait.
    """
    reached = np.stack([images[q.name] for q in model.observables], axis=1)
    return _near(model, reached, observed, SAME) | signs_of_symmetry(model, reached)[:, telling].any(axis=1)
