"""Edge states: the attractors within a basin boundary, for many pairs of starts at once.

The boundary lies between two points that lead to different attractors. The pair is bisected along the line
between the points, then both are followed as long as they stay close, which they do along the boundary. Once
they separate, they are bisected again. The trajectory between them converges to a saddle, a cycle or a
chaotic set within the boundary (Skufca, Yorke and Eckhardt 2006, Phys. Rev. Lett. 96:174101; Mehling, Boerner
and Lucarini 2023, arXiv:2308.16251). Mappers assign the trajectories of a map to attractors.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import NamedTuple

import jax
import numpy as np
import pandas as pd
from jaxtyping import Bool, Float, Int

from gaitsweep import near_miss
from gaitsweep.engine.poincare.maps import Map, MapEvaluation, Points, Values
from gaitsweep.engine.poincare.poincare_return import ReturnStatus
from gaitsweep.engine.poincare.return_map import BatchedReturnMap
from gaitsweep.errors import ArgumentError
from gaitsweep.status import ResultCode

Trajectories = Int[np.ndarray, " trajectories"]  # a number for each trajectory
# The label of a trajectory that has reached no attractor yet; -1 - w if it ended by the `ReturnStatus` w.
UNDECIDED = -1
# Least number of lanes in a call: fewer take a kernel as long, and every size is compiled separately.
FEWEST = 8

# (images of n trajectories, the pair of each (n,), cycles since the start) -> the labels (n,) of their
# attractors, 0 or more, or UNDECIDED.
AttractorMapper = Callable[[MapEvaluation, Trajectories, int], Trajectories]


class ProximityMapper:
    """Assigns a trajectory within `reach` to that attractor.

    Args:
        mapping: the map.
        attractors: coordinates of one point of each, (k, size), or for each pair, (pairs, k, size); several
            points with one label for attractors that are not fixed points.
        labels: of these points, (k,), whole numbers from 0 on; by default 0, 1, ...
        reach: as a share of the smallest distance between points of different labels; it must be less than
            the distance from any of these points to an edge. A distance is the largest of any coordinate,
            relative to its magnitude at the attractors.

    Raises:
        ArgumentError: the number of labels is not that of the points, a label is below 0, all labels are
            equal, or `reach` is not above 0.
    """

    def __init__(
        self,
        mapping: Map,
        attractors: Float[np.ndarray, " ..."],
        labels: Sequence[int] | None = None,
        reach: float = 0.1,
    ) -> None:
        if not reach > 0.0:
            raise ArgumentError(f"reach is {reach:g}, but must be above 0.")
        places = np.asarray(attractors, np.float64)
        self._mapping, self._places = mapping, places if places.ndim == 3 else places[None]
        k = self._places.shape[1]
        self._labels = np.arange(k) if labels is None else np.asarray(labels, int)
        if len(self._labels) != k:
            raise ArgumentError(f"There are {len(self._labels)} labels, but {k} points of attractors.")
        if k and self._labels.min() < 0:  # those of trajectories without an attractor
            raise ArgumentError(f"A label is {self._labels.min()}, but must be 0 or more.")
        if len(set(self._labels.tolist())) < 2:
            raise ArgumentError("All points of attractors have one label, but an edge lies between two.")
        self._scale = np.mean(mapping.sizes(self._places), axis=1, keepdims=True)
        away = mapping.difference(self._places[:, :, None], self._places[:, None]) / self._scale[:, None]
        different = self._labels[:, None] != self._labels
        smallest = np.min(np.where(different, np.max(np.abs(away), axis=3), np.inf), axis=(1, 2))
        self._reach = reach * smallest

    def __call__(self, images: MapEvaluation, pair: Trajectories, cycle: int) -> Trajectories:
        which = _entry_of_pair(pair, len(self._places), "attractors")
        away = self._mapping.difference(images.points.at[:, None], self._places[which]) / self._scale[which]
        distance = np.max(np.abs(away), axis=2)
        nearest = np.argmin(distance, axis=1)
        close = np.min(distance, axis=1) <= self._reach[which]
        return np.where(close, self._labels[nearest], UNDECIDED)


class LabelMapper:
    """Assigns every trajectory, after a number of cycles, to the attractor with the model's gait label.

    The number must be large enough that each trajectory has left the edge, however near it started.

    Args:
        mapping: the return map of a model.
        values: parameters, numbers or one for each pair (n,).
        after: number of cycles.
        only: gaits that count as attractors; other labels are undecided. By default all gaits count.

    Raises:
        ArgumentError: the model does not have a gait in `only`, or `after` is below 0.
    """

    def __init__(
        self, mapping: BatchedReturnMap, values: Values, after: int, only: Sequence[str] | None = None
    ) -> None:
        if after < 0:
            raise ArgumentError(f"after is {after} cycles, but must be 0 or more.")
        model = mapping.model
        for name in only or ():
            if name not in model.gaits:
                near = near_miss.suggestion(name, model.gaits)
                raise ArgumentError(f"{name} is not a gait of {model.name}{near}")
        self._after = after
        self._counts = np.array([only is None or name in only for name in model.gaits])
        self._pairs = max([np.size(value) for value in values.values()], default=1)
        self._values = mapping.complete(values, self._pairs)
        self._observables = [quantity.name for quantity in model.observables]
        self._label = jax.jit(jax.vmap(lambda v, o: model.label(mapping.params(v), o)["gait"]))

    def __call__(self, images: MapEvaluation, pair: Trajectories, cycle: int) -> Trajectories:
        if cycle < self._after:
            return np.full(len(pair), UNDECIDED)
        which = _entry_of_pair(pair, self._pairs, "values")
        observed = {name: images.observed[name] for name in self._observables}
        values = {name: column[which] for name, column in self._values.items()}
        label = np.asarray(self._label(values, observed))
        if (wrong := label[images.sound & ~((label >= 0) & (label < self._counts.size))]).size:
            raise ArgumentError(
                f"The model's function label returns gait {wrong[0]}, but must return the index of a gait, "
                f"0 to {self._counts.size - 1}."
            )
        label = np.where(images.sound, label, 0)
        return np.where(self._counts[label], label, UNDECIDED)


def _entry_of_pair(pair: Trajectories, count: int, argument: str) -> Trajectories:
    """The index of each pair in an argument that has one entry for all pairs, or one for each."""
    if count > 1 and np.max(pair) >= count:
        raise ArgumentError(
            f"{argument} are given for {count} pairs, but there are more: give one for each, or one for all."
        )
    return pair if count > 1 else np.zeros_like(pair)


def advanced(mapping: Map, points: Points, values: dict[str, Float[np.ndarray, " points"]]) -> MapEvaluation:
    """The images of points (n,), n > 0, in a batch of at least `FEWEST`.

    Args:
        mapping: the map.
        points: the points.
        values: parameters (n,) by name.
    """
    n = len(points)
    order = np.minimum(np.arange(max(n, FEWEST)), n - 1)
    images = mapping.images(points[order], {name: column[order] for name, column in values.items()})
    return images[np.arange(n)]


class Fates(NamedTuple):
    """The ends of n trajectories, (n,) each.

    `labels`: of attractors, or `UNDECIDED`, or -1 - w of trajectories that ended by the `ReturnStatus` w;
    `cycles`: the number of evaluations of the map; `last`: the coordinates (n, size) of the last points.
    """

    labels: Trajectories
    cycles: Trajectories
    last: Float[np.ndarray, "trajectories coordinates"]


def fates(
    mapping: Map,
    points: Points,
    values: dict[str, Float[np.ndarray, " pairs"]],
    pair: Int[np.ndarray, " points"],
    mapper: AttractorMapper,
    most: int,
) -> Fates:
    """Follow n trajectories to their attractors, each with the parameters of its pair.

    Args:
        mapping: the map.
        points: n initial points.
        values: parameters (pairs,).
        pair: (n,) the pair of each trajectory.
        mapper: assigns trajectories to attractors.
        most: the largest number of cycles; trajectories without an attractor then are `UNDECIDED`.

    Raises:
        ArgumentError: `mapper` does not give one label for each trajectory.
    """
    labels, cycles = np.full(len(points), UNDECIDED), np.zeros(len(points), int)
    last_points = points.at.copy()
    going = np.arange(len(points))
    for cycle in range(1, most + 1):
        if not going.size:
            break
        images = advanced(mapping, points, {name: column[pair[going]] for name, column in values.items()})
        cycles[going] = cycle
        reached = np.asarray(mapper(images, pair[going], cycle))
        if reached.shape != going.shape:
            raise ArgumentError(
                f"mapper gave an array of shape {reached.shape}, but must return one label for each of "
                f"{going.size} trajectories."
            )
        labels[going] = np.where(images.sound, np.maximum(reached, UNDECIDED), -1 - images.status)
        last_points[going[images.sound]] = images.points.at[images.sound]
        goes_on = images.sound & (reached < 0)
        points, going = images.points[goes_on], going[goes_on]
    return Fates(labels, cycles, last_points)


Rows = Int[np.ndarray, " rows"]  # numbers of pairs
Coordinates = Float[np.ndarray, "... coordinates"]
# Attractors at a smaller relative distance from each other are the same.
SAME = 1e-3
# Offset of the cuts from even parts of the line, as a share of a part: half-way between mirror images a
# trajectory may stay on the edge for ever.
UNEVEN = 0.0557


class EdgeOutcome(ResultCode):
    """Outcomes of the search for an edge state, with a sentence each."""

    fixed = 0, "The edge state is a fixed point of the map."
    periodic = 1, "The edge state is a cycle of the map."
    wandering = 2, "The edge trajectory did not settle in the rounds allowed."
    jump = 3, "The edge trajectory stays at a point that is not fixed: the map is discontinuous there."
    same = 4, "Both points lead to the same attractor, so there may be no edge between them."
    third = 5, "The line between the two points meets the basin of a third attractor."
    undecided = 6, "A trajectory reached no attractor in the cycles allowed."
    fell = 7, "A trajectory fell."
    lost = 8, "A trajectory did not return to the section, or diverged."
    together = 9, "The two trajectories converged: the mapper separates them, not the map."


@dataclasses.dataclass(frozen=True)
class EdgeLimits:
    """Tolerances and limits of edge tracking; distances are the largest relative one of any coordinate.

    Args:
        bisection_distance: the distance between two points at which their bisection ends.
        separation_distance: the distance at which they are bisected again. The line between them then misses
            the edge state by the order of its square.
        residual_tolerance: the residual of the map below which a state is fixed.
        cuts: points tried at once on the line between the two: 1 bisects. More points take fewer rounds and
            more evaluations, and find an edge beside a third basin more often.
        max_cycles: cycles within which a trajectory has to reach an attractor, and after which two that have
            not separated are bisected anew.
        max_period: the longest period of a periodic edge state; longer ones count as wandering.
        max_rounds: the largest number of bisections followed by tracking.
        settle_cycles: cycles after which a start is at its attractor; used only without a mapper.

    Raises:
        ArgumentError: a distance or the residual is not in its range, or another value is no whole number
            from 1 on.
    """

    bisection_distance: float = 1e-7
    separation_distance: float = 1e-5
    residual_tolerance: float = 1e-6
    cuts: int = 1
    max_cycles: int = 1000
    max_period: int = 4
    max_rounds: int = 20
    settle_cycles: int = 200

    def __post_init__(self) -> None:
        near, far = self.bisection_distance, self.separation_distance
        if not 1e-13 <= near < far:
            raise ArgumentError(
                f"bisection_distance is {near:g} and separation_distance is {far:g}. Allowed: "
                "bisection_distance from 1e-13 on (resolution of float64), separation_distance above it."
            )
        if not self.residual_tolerance > 0.0:
            raise ArgumentError(f"residual_tolerance is {self.residual_tolerance:g}, but must be above 0.")
        for name in ("cuts", "max_cycles", "max_period", "max_rounds", "settle_cycles"):
            value = getattr(self, name)
            if not (isinstance(value, int | np.integer) and value >= 1):
                raise ArgumentError(f"{name} is {value}. Allowed: whole numbers from 1 on.")


@dataclasses.dataclass(frozen=True)
class EdgeStates:
    """The results of the searches of n pairs.

    Attributes:
        points: the edge states, as starts for `newton`; where a third basin was met, a start leading there.
        outcome: an `EdgeOutcome` of each, (n,).
        table: one record a pair: row, the given parameters, the coordinates of the edge state, outcome (the
            name), period, residual (largest relative change of a coordinate over a period), growth (the
            factor by which the two separate in a cycle: an estimate of the multiplier across the edge),
            label_1 and label_2 (of the two attractors), met (the label that ended the search, where it is
            neither: -1 undecided, -1 - w for the `ReturnStatus` w), rounds, bisections, evaluations (of the
            map).
    """

    points: Points
    outcome: Int[np.ndarray, " pairs"]
    table: pd.DataFrame


def edge_states(
    mapping: Map,
    u1: Points,
    u2: Points,
    values: Values,
    *,
    mapper: AttractorMapper | None = None,
    limits: EdgeLimits | None = None,
) -> EdgeStates:
    """Find the edge states between the basins of n pairs of points.

    Args:
        mapping: a return map, or any other.
        u1, u2: n points each, n >= 0, such as `BatchedReturnMap.settled` gives, with equal conserved
            quantities.
        values: parameters, numbers or one for each pair (n,).
        mapper: a `ProximityMapper`, a `LabelMapper` or any `AttractorMapper` function. By default the pair's
            own two trajectories after `limits.settle_cycles` cycles are its attractors.
        limits: tolerances and limits.

    Raises:
        ArgumentError: u1 and u2 differ in length, the map does not have a parameter that is given, or the
            mapper is of another number of pairs or returns another number of labels.
    """
    if len(u1) != len(u2):
        raise ArgumentError(
            f"u1 has {len(u1)} points and u2 has {len(u2)}, but both must have the same number."
        )
    limits = limits or EdgeLimits()
    n = len(u1)
    search = Tracking(mapping, u1, u2, mapping.complete(values, n), mapper, limits)
    for _ in range(limits.max_rounds):
        if not search.going.any():
            break
        search.round()
    return EdgeStates(search.edge, search.outcome, _table(mapping, values, search))


def _table(mapping: Map, values: Values, search: Tracking) -> pd.DataFrame:
    """The table of `EdgeStates`."""
    n = len(search.outcome)
    reached = search.rounds + search.bisections > 0
    columns: dict[str, object] = {"row": np.arange(n)}
    columns |= {name: np.broadcast_to(np.asarray(value, np.float64), (n,)) for name, value in values.items()}
    for k, quantity in enumerate(mapping.coordinates):
        columns[quantity.name] = np.where(reached, search.edge.at[:, k], np.nan)
    columns["outcome"] = [EdgeOutcome(code).name for code in search.outcome]
    columns |= {"period": search.period, "residual": search.residual, "growth": search.growth}
    columns |= {"label_1": search.labels[:, 0], "label_2": search.labels[:, 1], "met": search.met}
    columns |= {"rounds": search.rounds, "bisections": search.bisections, "evaluations": search.evaluations}
    return pd.DataFrame(columns)


class Recurrence:
    """The closest return of each of n trajectories after 1, 2, ... cycles.

    `gaps` (n, longest) the distances of these returns; `states` the n points of each, by number of cycles.

    Args:
        distance: function of two arrays of coordinates (n, size) that gives their distances (n,).
        starts: the initial points.
        longest: the largest number of cycles.
    """

    def __init__(
        self,
        distance: Callable[[Coordinates, Coordinates], Float[np.ndarray, " ..."]],
        starts: Points,
        longest: int,
    ) -> None:
        self._distance, self._longest, self._past = distance, longest, [starts]
        self.gaps, self.states = np.full((len(starts), longest), np.inf), [starts] * longest

    def add(self, on: Int[np.ndarray, " some"], now: Points) -> Int[np.ndarray, " nearer"]:
        """Add the points one cycle later, for the trajectories `on` that still run.

        Returns:
            Those that moved less than in any cycle before.
        """
        slower = on[:0]
        for k, before in enumerate(self._past):
            gap = self._distance(now.at[on], before.at[on])
            nearer = gap < self.gaps[on, k]
            which = on[nearer]
            self.gaps[which, k] = gap[nearer]
            self.states[k] = self.states[k].merged(which, before[which])
            slower = which if k == 0 else slower
        self._past = [now, *self._past][: self._longest]
        return slower


class Tracking:
    """The state of the searches of n pairs: both points, `one` and `other`, and the results so far."""

    def __init__(
        self,
        mapping: Map,
        one: Points,
        other: Points,
        values: dict[str, Float[np.ndarray, " pairs"]],
        mapper: AttractorMapper | None,
        limits: EdgeLimits,
    ) -> None:
        n = len(one)
        self.mapping, self.one, self.other, self.values, self.limits = mapping, one, other, values, limits
        self.going = np.ones(n, bool)
        self.outcome = np.full(n, EdgeOutcome.wandering)
        self.labels = np.full((n, 2), UNDECIDED)
        self.met = np.full(n, UNDECIDED)
        self.edge = self._first = self._between(np.arange(n))
        self.residual, self.growth = np.full(n, np.nan), np.full(n, np.nan)
        self.period, self.rounds = np.ones(n, int), np.zeros(n, int)
        self.bisections, self.evaluations = np.zeros(n, int), np.zeros(n, int)
        self.mapper = self._mapper_of_ends() if mapper is None else mapper
        if mapper is not None:
            self._label_starts(mapper)

    def round(self) -> None:
        """Bisect all pairs that still run, then follow them until they separate."""
        self._narrow()
        self._follow()

    def _mapper_of_ends(self) -> AttractorMapper:
        """A mapper for each pair from the final states of its own two trajectories."""
        n = len(self.one)
        rows = np.tile(np.arange(n), 2)
        points, most = Points.joined([self.one, self.other]), self.limits.settle_cycles
        labels, cycles, last = fates(self.mapping, points, self.values, rows, _undecided, most)
        np.add.at(self.evaluations, rows, cycles)
        for trajectory in np.argsort(cycles, kind="stable"):
            if labels[trajectory] < UNDECIDED:
                self._end(int(rows[trajectory]), int(labels[trajectory]))
        attractors = last.reshape(2, n, last.shape[1]).swapaxes(0, 1)
        distance = self._distance(attractors[:, 1], attractors[:, 0])
        self.labels = np.where(self.going[:, None], np.array([0, 1]), UNDECIDED)
        self._stop(np.flatnonzero(self.going & (distance <= SAME)), EdgeOutcome.same)
        return ProximityMapper(self.mapping, attractors)

    def _label_starts(self, mapper: AttractorMapper) -> None:
        """Map the starts to attractors, and end the pairs without an edge between them."""
        n = len(self.one)
        rows = np.tile(np.arange(n), 2)
        labels = self._fates(Points.joined([self.one, self.other]), rows, mapper)
        self.labels = labels.reshape(2, n).T
        for label in self.labels.T:
            for row in np.flatnonzero(self.going & (label < 0)):
                self._end(int(row), label[row])
        self._stop(np.flatnonzero(self.going & (self.labels[:, 0] == self.labels[:, 1])), EdgeOutcome.same)

    def _narrow(self) -> None:
        """Bisect until the two points of each pair are close."""
        while True:
            width = self._distance(self.other.at, self.one.at)
            rows = np.flatnonzero(self.going & (width > self.limits.bisection_distance))
            if not rows.size:
                break
            self._divide(rows)

    def _divide(self, rows: Rows) -> None:
        """Map points on the line, and keep two neighbours that lead to the two attractors."""
        cuts = self.limits.cuts
        share = (np.arange(1, cuts + 1) - UNEVEN) / (cuts + 1)
        tried = self._between(np.repeat(rows, cuts), np.tile(share, rows.size))
        labels = np.zeros((rows.size, cuts + 2), int)
        labels[:, 0], labels[:, -1] = self.labels[rows].T
        labels[:, 1:-1] = self._fates(tried, np.repeat(rows, cuts), self.mapper).reshape(rows.size, cuts)
        self.bisections[rows] += 1
        passes = (labels[:, :-1] == labels[:, :1]) & (labels[:, 1:] == labels[:, -1:])
        first = np.argmax(passes, axis=1)
        for k in np.flatnonzero(~np.any(passes, axis=1)):
            third = 1 + int(np.argmax(labels[k, 1:-1] != labels[k, 0]))
            self.edge = self.edge.merged(rows[[k]], tried[[k * cuts + third - 1]])
            self._end(int(rows[k]), labels[k, third])
        divides = np.any(passes, axis=1)
        lower, upper = divides & (first > 0), divides & (first < cuts)
        at = np.arange(rows.size) * cuts + first
        self.one = self.one.merged(rows[lower], tried[at[lower] - 1])
        self.other = self.other.merged(rows[upper], tried[at[upper]])

    def _follow(self) -> None:
        """Follow both points, and the one between them, until the two separate; then classify the edge."""
        limits, rows = self.limits, np.flatnonzero(self.going)
        if not rows.size:
            return
        n = len(self.one)
        first = middle = self._between(np.arange(n))
        width, cycles = self._distance(self.other.at, self.one.at), np.zeros(n, int)
        calm_width, calm_from = width.copy(), cycles.copy()
        course = Recurrence(self._distance, first, limits.max_period)
        for _ in range(limits.max_cycles):
            near = self._distance(self.other.at, self.one.at) <= limits.separation_distance
            on = np.flatnonzero(self.going & near)
            if not on.size:
                break
            lanes = np.tile(on, 3)
            points = Points.joined([self.one[on], self.other[on], middle[on]])
            values = {name: column[lanes] for name, column in self.values.items()}
            images = advanced(self.mapping, points, values)
            np.add.at(self.evaluations, lanes, 1)
            cycles[on] += 1
            one, other, between = (images.points[np.arange(on.size) + k * on.size] for k in range(3))
            self.one, self.other = self.one.merged(on, one), self.other.merged(on, other)
            middle = middle.merged(on, between)
            for k in np.flatnonzero(~images.sound):
                self._end(int(lanes[k]), -1 - images.status[k])
            calmer = course.add(on, middle)
            calm_width[calmer] = self._distance(self.other.at, self.one.at)[calmer]
            calm_from[calmer] = cycles[calmer]
        begins_calm = calm_from < cycles
        calm_width, calm_from = np.where(begins_calm, (calm_width, calm_from), (width, np.zeros(n)))
        distance = self._distance(self.other.at, self.one.at)
        with np.errstate(divide="ignore", invalid="ignore"):
            growth = (distance / calm_width) ** (1.0 / np.maximum(cycles - calm_from, 1.0))
        self.growth[rows] = growth[rows]
        self._conclude(rows, first, course, distance <= width, cycles == 1)

    def _conclude(
        self,
        rows: Rows,
        first: Points,
        course: Recurrence,
        together: Bool[np.ndarray, " pairs"],
        at_once: Bool[np.ndarray, " pairs"],
    ) -> None:
        """End the pairs `rows` that have found a fixed point, a cycle or a jump of the map.

        Args:
            rows: the pairs.
            first: the points (n,) between both trajectories at the beginning of this round.
            course: the returns of the trajectories that began there.
            together: which pairs are no farther apart than at the beginning.
            at_once: which pairs separated within one cycle.
        """
        stayed = self._distance(first.at, self._first.at) <= self.limits.residual_tolerance
        self._first = self._first.merged(rows, first[rows])
        self.edge = self.edge.merged(rows, first[rows])
        self.residual[rows] = course.gaps[rows, 0]
        self.rounds[rows] += 1
        self._stop(rows[self.going[rows] & together[rows]], EdgeOutcome.together)
        for k in range(self.limits.max_period):
            concluded = rows[self.going[rows] & (course.gaps[rows, k] <= self.limits.residual_tolerance)]
            self.edge = self.edge.merged(concluded, course.states[k][concluded])
            self.residual[concluded] = course.gaps[concluded, k]
            self.period[concluded] = k + 1
            self._stop(concluded, EdgeOutcome.fixed if k == 0 else EdgeOutcome.periodic)
        # at a discontinuity the two separate at once, and the line between them crosses it again
        jumps = self.going & at_once & stayed & (self.rounds > 1)
        self._stop(rows[jumps[rows]], EdgeOutcome.jump)

    def _fates(self, points: Points, rows: Rows, mapper: AttractorMapper) -> Rows:
        """The labels (n,) of the attractors of points of the pairs `rows`."""
        labels, cycles, _ = fates(self.mapping, points, self.values, rows, mapper, self.limits.max_cycles)
        np.add.at(self.evaluations, rows, cycles)
        return labels

    def _between(self, rows: Rows, share: Float[np.ndarray, " rows"] | None = None) -> Points:
        """Points on the lines between the two, half-way or at `share`, with the modes of the nearer point."""
        share = np.full(rows.size, 0.5) if share is None else share
        one, other = self.one[rows], self.other[rows]
        at = one.at + share[:, None] * self.mapping.difference(other.at, one.at)
        nearer = share > 0.5
        like = jax.tree.map(
            lambda a, b: np.where(nearer.reshape(-1, *[1] * (np.ndim(a) - 1)), b, a), one.modes, other.modes
        )
        return Points(at, like)

    def _distance(self, a: Coordinates, b: Coordinates) -> Float[np.ndarray, " ..."]:
        """The largest relative distance of any coordinate, (n,); infinite where it is NaN."""
        with np.errstate(invalid="ignore"):
            return self.mapping.distance(b, a)

    def _end(self, row: int, label: int) -> None:
        """End a pair with a trajectory whose label is that of neither attractor."""
        if not self.going[row]:
            return
        self.met[row] = label
        if label >= 0:
            outcome = EdgeOutcome.third
        elif label == UNDECIDED:
            outcome = EdgeOutcome.undecided
        else:
            outcome = EdgeOutcome.fell if -1 - label == ReturnStatus.fell else EdgeOutcome.lost
        self._stop(np.array([row]), outcome)

    def _stop(self, rows: Rows, outcome: EdgeOutcome) -> None:
        """End the pairs `rows` with an outcome."""
        self.outcome[rows] = outcome
        self.going[rows] = False


def _undecided(images: MapEvaluation, pair: Rows, cycle: int) -> Rows:
    """An `AttractorMapper` for trajectories that are followed to their ends."""
    return np.full(pair.size, UNDECIDED)
