"""Many computations on a map that go on side by side, so that their evaluations are made in batches.

A computation is a generator that yields a `Request` wherever it needs the map, and is sent the images.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Generator, Mapping, Sequence
from typing import Any, TypeVar

import numpy as np

from gaitsweep.engine.poincare.maps import Map, MapEvaluation, Points

T = TypeVar("T")


@dataclasses.dataclass(frozen=True)
class Request:
    """Points at which a map is to be differentiated, by the coordinates and by the parameter `over`.

    `values` has parameters of the points, (n,) each.
    """

    mapping: Map
    over: str
    points: Points
    values: Mapping[str, Any]


Computation = Generator[Request, MapEvaluation, T]


def in_lockstep(computations: Sequence[Computation[T]]) -> list[T]:
    """Run some computations, whose evaluations of one map are made together, and return their results."""
    results: dict[int, T] = {}
    waiting: dict[int, Request] = {}

    def advance(number: int, images: MapEvaluation | None) -> None:
        """Run a computation to its next request or to its result."""
        try:
            computation = computations[number]
            waiting[number] = next(computation) if images is None else computation.send(images)
        except StopIteration as end:
            results[number] = end.value

    for number in range(len(computations)):
        advance(number, None)
    while waiting:
        requests_of_round, groups = dict(waiting), {}
        waiting.clear()
        for number, request in requests_of_round.items():
            groups.setdefault((request.mapping, request.over, tuple(request.values)), []).append(number)
        for (mapping, over, names), numbers in groups.items():
            requests = [requests_of_round[number] for number in numbers]
            together = {
                name: np.concatenate([np.broadcast_to(r.values[name], len(r.points)) for r in requests])
                for name in names
            }
            images = mapping.linearised(Points.joined([r.points for r in requests]), together, over)
            last = np.cumsum([len(r.points) for r in requests])
            for number, request, end in zip(numbers, requests, last, strict=True):
                advance(number, images[slice(end - len(request.points), end)])
    return [results[number] for number in range(len(computations))]


def alone(computation: Computation[T]) -> T:
    """The result of one computation."""
    return in_lockstep([computation])[0]
