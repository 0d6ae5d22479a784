"""Attractor mappers of the search for edge states: they assign trajectories of a map to attractors."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float, Int

from gaitsweep import near_miss
from gaitsweep.engine.poincare.maps import Map, MapEvaluation, Points, Values, sizes
from gaitsweep.engine.poincare.return_map import BatchedReturnMap
from gaitsweep.errors import ArgumentError

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
        labels: of these points, (k,); by default 0, 1, ...
        reach: as a share of the smallest distance between points of different labels; it must be less than
            the distance from any of these points to an edge. A distance is the largest of any coordinate,
            relative to its magnitude at the attractors.

    Raises:
        ArgumentError: the number of labels is not that of the points, all labels are equal, or `reach` is not
            above 0.
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
        if len(set(self._labels.tolist())) < 2:
            raise ArgumentError("All points of attractors have one label, but an edge lies between two.")
        self._scale = np.mean(sizes(self._places), axis=1, keepdims=True)
        away = mapping.difference(self._places[:, :, None], self._places[:, None]) / self._scale[:, None]
        different = self._labels[:, None] != self._labels
        smallest = np.min(np.where(different, np.max(np.abs(away), axis=3), np.inf), axis=(1, 2))
        self._reach = reach * smallest

    def __call__(self, images: MapEvaluation, pair: Trajectories, cycle: int) -> Trajectories:
        which = _of_each(pair, len(self._places), "attractors")
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
        which = _of_each(pair, self._pairs, "values")
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


def _of_each(pair: Trajectories, count: int, what: str) -> Trajectories:
    """The index of each pair in an argument that has one entry for all pairs, or one for each."""
    if count > 1 and np.max(pair) >= count:
        raise ArgumentError(
            f"{what} are given for {count} pairs, but there are more: give one for each pair, or one for all."
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
    """Follow n trajectories to their attractors, those of each pair by one function.

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
