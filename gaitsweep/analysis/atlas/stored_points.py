"""Points of branches as text, from which a later run continues the branches."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Iterator, Sequence

import jax
import numpy as np

from gaitsweep.analysis.continuation.arclength_step import (
    BranchPoints,
    ContinuationProblem,
    PerBranch,
    Unknowns,
)
from gaitsweep.analysis.continuation.newton import Drifts
from gaitsweep.engine.poincare.maps import Points


@dataclasses.dataclass(frozen=True)
class StoredPoint:
    """One point (1,) of a branch without its image; the attributes are those of `BranchPoints`."""

    points: Points
    drift: Drifts
    parameter: PerBranch
    tangent: Unknowns

    def evaluated(self, problem: ContinuationProblem) -> BranchPoints:
        """The point with its image and its derivatives."""
        return BranchPoints(
            self.points,
            self.drift,
            self.parameter,
            self.tangent,
            problem.evaluated(self.points, self.parameter),
            np.zeros(1, int),
        )


def text_of(at: BranchPoints, aside: BranchPoints | None) -> str:
    """A point (1,) of a branch and the points (k,) beside it on branches that cross there, as JSON.

    The numbers are written such that reading them gives the same bits.
    """
    beside = [] if aside is None else [aside[[k]] for k in range(len(aside.parameter))]
    return json.dumps([list(_numbers(point)) for point in (at, *beside)])


def points_of(text: str, like: Points) -> list[StoredPoint]:
    """Read the point and those beside it from the text that `text_of` wrote.

    Args:
        text: the text.
        like: a point (1,) of the same map, for the structure of its modes.
    """
    leaves, structure = jax.tree.flatten(like.modes)
    points = []
    for at, drift, parameter, tangent, *modes in json.loads(text):
        shaped = [
            np.asarray(values, leaf.dtype).reshape(leaf.shape)
            for values, leaf in zip(modes, leaves, strict=True)
        ]
        batch = Points(np.array([at], float), jax.tree.unflatten(structure, shaped))
        points.append(
            StoredPoint(batch, np.array([drift], float), np.array(parameter), np.array([tangent], float))
        )
    return points


def _numbers(point: BranchPoints) -> Iterator[Sequence[float]]:
    """The coordinates of a point (1,), its drifts, its parameter, its tangent, and each leaf of its modes."""
    yield point.points.at[0].tolist()
    yield point.drift[0].tolist()
    yield point.parameter.tolist()
    yield point.tangent[0].tolist()
    yield from (np.ravel(np.asarray(leaf)).tolist() for leaf in jax.tree.leaves(point.points.modes))
