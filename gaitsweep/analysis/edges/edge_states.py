"""Edge states: what trajectories on the edge between two basins come to, for many pairs of starts at once.

Two points that come to different attractors have the edge between them. They are brought together along the
line between them, then followed while they stay together, which they do along the edge; once they are apart
they are brought together again. What lies between them comes to what attracts within the edge: a saddle, a
cycle, or something that does not come to rest (Skufca, Yorke and Eckhardt 2006, Phys. Rev. Lett. 96:174101;
Mehling, Boerner and Lucarini 2023, arXiv:2308.16251).
"""

from __future__ import annotations

import dataclasses

import numpy as np
import pandas as pd

from gaitsweep.analysis.edges.attractor_mappers import Decide, Gaits, Nearest
from gaitsweep.analysis.edges.edge_search import Limits, Outcome
from gaitsweep.analysis.edges.edge_tracking import Tracking
from gaitsweep.engine.poincare.maps import Map, Points, Values
from gaitsweep.errors import ArgumentError

__all__ = ["Decide", "EdgeStates", "Gaits", "Limits", "Nearest", "Outcome", "edge_states"]


@dataclasses.dataclass(frozen=True)
class EdgeStates:
    """What a search gave for each pair (n,).

    `points` where it ended, as `newton` takes them for starts: the edge state, or, beside a third basin, the
    start that leads there; `outcome` (n,) an `Outcome`; `table`, a record a pair:
    row, the parameters that were given, the coordinates of the edge state, outcome (the name), period,
    residual (the largest share, of its size, by which a coordinate is not back after a period), growth (by
    which factor the two came apart in a cycle: an estimate of the multiplier across the edge), one and other
    (labels of the two attractors), met (the label of what ended the search, where that is neither: -1 not
    decided, -1 - w for the `ReturnStatus` w), rounds, bisections, evaluations (of the map).
    """

    points: Points
    outcome: np.ndarray
    table: pd.DataFrame

    @property
    def found(self) -> np.ndarray:
        """Which searches came to a fixed point or a cycle, (n,)."""
        return (self.outcome == Outcome.fixed) | (self.outcome == Outcome.periodic)


def edge_states(
    mapping: Map,
    ones: Points,
    others: Points,
    values: Values,
    *,
    decide: Decide | None = None,
    limits: Limits | None = None,
) -> EdgeStates:
    """The edge states between the basins of n pairs of points.

    Args:
        mapping: a return map, or any other.
        ones, others: n points each, such as `ReturnMap.settled` gives. What the map conserves should be the
            same for both.
        values: parameters, numbers or one for each pair (n,).
        decide: which attractor a trajectory has come to, from its images, its pair and the cycles gone:
            a label from 0 on, or -1 as long as that is not known. `Nearest`, `Gaits`, or any function. If not
            said, the nearer of the two points where the pair's own trajectories are after `limits.settle`
            cycles.
        limits: lengths and numbers.

    Raises:
        ValueError: not as many points on one side as on the other; a parameter that the map does not have.
    """
    if len(ones) != len(others):
        raise ArgumentError(
            f"ones are {len(ones)} points and others {len(others)}, but each needs its other."
        )
    limits = limits or Limits()
    n = len(ones)
    search = Tracking(mapping, ones, others, mapping.complete(values, n), decide, limits)
    for _ in range(limits.rounds):
        if not search.going.any():
            break
        search.round()
    return EdgeStates(search.edge, search.outcome, _table(mapping, values, search))


def _table(mapping: Map, values: Values, search: Tracking) -> pd.DataFrame:
    n = len(search.outcome)
    reached = search.rounds + search.bisections > 0
    columns: dict[str, object] = {"row": np.arange(n)}
    columns |= {name: np.broadcast_to(np.asarray(value, np.float64), (n,)) for name, value in values.items()}
    for k, quantity in enumerate(mapping.coordinates):
        columns[quantity.name] = np.where(reached, search.edge.at[:, k], np.nan)
    columns |= {
        "outcome": [Outcome(code).name for code in search.outcome],
        "period": search.period,
        "residual": search.residual,
        "growth": search.growth,
        "one": search.labels[:, 0],
        "other": search.labels[:, 1],
        "met": search.met,
        "rounds": search.rounds,
        "bisections": search.bisections,
        "evaluations": search.evaluations,
    }
    return pd.DataFrame(columns)
