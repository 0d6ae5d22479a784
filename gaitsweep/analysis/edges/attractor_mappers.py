"""Which attractor a trajectory of a map comes to: what decides it, and many followed until it is known."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from functools import cached_property
from typing import Any

import jax
import numpy as np

from gaitsweep import near_miss
from gaitsweep.analysis.continuation.newton import sizes
from gaitsweep.engine.poincare.maps import Map, MapEvaluation, Points, Values
from gaitsweep.engine.poincare.poincare_return import ReturnStatus
from gaitsweep.engine.poincare.return_map import ReturnMap
from gaitsweep.errors import ArgumentError

# The label of a trajectory that has come to no attractor yet; of one that ended by the `ReturnStatus` w it is
# -1 - w.
UNDECIDED = -1
# Lanes in a call at least: fewer take a kernel as long, and every size is compiled for itself.
FEWEST = 8

# (where trajectories are now, the pair of each, cycles since they began) -> the label of each one's
# attractor, 0 or more, or UNDECIDED.
Decide = Callable[[MapEvaluation, np.ndarray, int], np.ndarray]


@dataclasses.dataclass(frozen=True, eq=False)
class Nearest:
    """Decided is what is within `reach` of an attractor.

    Args:
        mapping: the map.
        attractors: coordinates of one point of each, (k, size), or other ones for each pair, (pairs, k,
            size); several points of one label for attractors that are not fixed points.
        labels: of these points, (k,); 0, 1, ... if not said.
        reach: as a share of the smallest distance between points of different labels; it has to be less than
            the way from any of these points to an edge. Distances are the largest of any coordinate, as a
            share of its size at the attractors.

    Raises:
        ValueError: one label for each point is not given, or all are the same.
    """

    mapping: Map
    attractors: np.ndarray
    labels: Sequence[int] | None = None
    reach: float = 0.1

    def __post_init__(self) -> None:
        k = np.shape(self.attractors)[-2]
        if len(self._labels) != k:
            raise ArgumentError(f"labels are {len(self._labels)}, but there are {k} points of attractors.")
        if len(set(self._labels.tolist())) < 2:
            raise ArgumentError("All points of attractors have one label, but an edge lies between two.")

    def __call__(self, images: MapEvaluation, pair: np.ndarray, cycle: int) -> np.ndarray:
        which = _of_each(pair, len(self._places), "attractors")
        away = self.mapping.difference(images.points.at[:, None], self._places[which]) / self._scale[which]
        distance = np.max(np.abs(away), axis=2)
        nearest = np.argmin(distance, axis=1)
        close = np.min(distance, axis=1) <= self.reach * self._room[which]
        return np.where(close, self._labels[nearest], UNDECIDED)

    @cached_property
    def _labels(self) -> np.ndarray:
        k = np.shape(self.attractors)[-2]
        return np.arange(k) if self.labels is None else np.asarray(self.labels, int)

    @cached_property
    def _places(self) -> np.ndarray:
        places = np.asarray(self.attractors, np.float64)
        return places if places.ndim == 3 else places[None]

    @cached_property
    def _scale(self) -> np.ndarray:
        return np.mean(sizes(self._places), axis=1, keepdims=True)

    @cached_property
    def _room(self) -> np.ndarray:
        away = self.mapping.difference(self._places[:, :, None], self._places[:, None]) / self._scale[:, None]
        different = self._labels[:, None] != self._labels
        return np.min(np.where(different, np.max(np.abs(away), axis=3), np.inf), axis=(1, 2))


@dataclasses.dataclass(frozen=True, eq=False)
class Gaits:
    """Decided is everything after so many cycles, by the label that the model gives.

    Enough cycles are those after which a trajectory has left the edge however near to it it began.

    Args:
        mapping: the return map of a model.
        values: parameters, numbers or one for each pair (n,).
        after: cycles.
        only: gaits that count; what has another label is not decided. All, if not said.

    Raises:
        ValueError: a gait that the model does not have.
    """

    mapping: ReturnMap
    values: Values
    after: int
    only: Sequence[str] | None = None

    def __post_init__(self) -> None:
        gaits = self.mapping.model.gaits
        for name in self.only or ():
            if name not in gaits:
                raise ArgumentError(f"{name} is not a gait of {self.mapping.model.name}"
                                 f"{near_miss.suggestion(name, gaits)}")  # fmt: skip

    def __call__(self, images: MapEvaluation, pair: np.ndarray, cycle: int) -> np.ndarray:
        if cycle < self.after:
            return np.full(len(pair), UNDECIDED)
        which = _of_each(pair, len(next(iter(self._held.values()))), "values")
        observed = {name: images.observed[name] for name in self._read}
        label = np.asarray(self._label({name: each[which] for name, each in self._held.items()}, observed))
        gaits = self.mapping.model.gaits
        counts = np.array([self.only is None or name in self.only for name in gaits])
        return np.where(counts[label], label, UNDECIDED)

    @cached_property
    def _held(self) -> dict[str, np.ndarray]:
        return self.mapping.complete(self.values, max([np.size(v) for v in self.values.values()], default=1))

    @cached_property
    def _read(self) -> tuple[str, ...]:
        return tuple(quantity.name for quantity in self.mapping.model.observables)

    @cached_property
    def _label(self) -> Callable[..., jax.Array]:
        mapping = self.mapping
        return jax.jit(jax.vmap(lambda v, o: mapping.model.label(mapping.params(v), o)["gait"]))


def _of_each(pair: np.ndarray, given: int, what: str) -> np.ndarray:
    """Where each pair's is, of what is given for all at once or for each."""
    if given > 1 and np.max(pair) >= given:
        raise ArgumentError(
            f"{what} are given for {given} pairs, but there are more: give one for each, or for all."
        )
    return pair if given > 1 else np.zeros_like(pair)


def advanced(mapping: Map, points: Points, values: dict[str, np.ndarray]) -> MapEvaluation:
    """The images of points (n,), n > 0, in no smaller batch than `FEWEST`."""
    n = len(points)
    order = np.minimum(np.arange(max(n, FEWEST)), n - 1)
    found = mapping.images(points[order], {name: each[order] for name, each in values.items()})
    return found[np.arange(n)]


def fates(
    mapping: Map, points: Points, values: dict[str, np.ndarray], pair: np.ndarray, decide: Decide, most: int
) -> tuple[np.ndarray, np.ndarray]:
    """The labels (n,) of trajectories, and how often the map was evaluated for each, (n,).

    Args:
        mapping: the map.
        points: n points where trajectories begin.
        values: parameters (pairs,).
        pair: (n,) to which each trajectory belongs.
        decide: what decides.
        most: cycles after which what is not decided is left so.

    Returns:
        Labels of attractors, or `UNDECIDED`, or -1 - w of trajectories that ended by the `ReturnStatus` w.

    Raises:
        ValueError: `decide` does not give a label for each trajectory.
    """
    labels, cycles = np.full(len(points), UNDECIDED), np.zeros(len(points), int)
    going = np.arange(len(points))
    for cycle in range(1, most + 1):
        if not going.size:
            break
        images = advanced(mapping, points, {name: each[pair[going]] for name, each in values.items()})
        cycles[going] = cycle
        found = np.asarray(decide(images, pair[going], cycle))
        if found.shape != going.shape:
            raise ArgumentError(
                f"decide gave an array of shape {found.shape}, but must give one label for each of "
                f"{going.size} trajectories."
            )
        labels[going] = np.where(images.sound, np.maximum(found, UNDECIDED), -1 - images.status)
        goes_on = images.sound & (found < 0)
        points, going = images.points[goes_on], going[goes_on]
    return labels, cycles


def ended(label: Any) -> ReturnStatus:
    """How a trajectory with this negative label ended."""
    return ReturnStatus(-1 - int(label))
