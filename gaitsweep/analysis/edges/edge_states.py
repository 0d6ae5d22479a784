"""Edge states: the attractors within a basin boundary, for many pairs of starts at once.

The boundary lies between two points that lead to different attractors. The pair is bisected along the line
between the points, then both are followed as long as they stay close, which they do along the boundary. Once
they separate, they are bisected again. The trajectory between them converges to a saddle, a cycle or a
chaotic set within the boundary (Skufca, Yorke and Eckhardt 2006, Phys. Rev. Lett. 96:174101; Mehling, Boerner
and Lucarini 2023, arXiv:2308.16251).
"""

from __future__ import annotations

import dataclasses

import numpy as np
import pandas as pd
from jaxtyping import Int

from gaitsweep.analysis.edges.attractor_mappers import AttractorMapper
from gaitsweep.analysis.edges.edge_tracking import EdgeLimits, EdgeOutcome, Tracking
from gaitsweep.engine.poincare.maps import Map, Points, Values
from gaitsweep.errors import ArgumentError


@dataclasses.dataclass(frozen=True)
class EdgeStates:
    """The results of the searches of n pairs.

    `points` the edge states, as starts for `newton` (where a third basin was met, a start that leads there);
    `outcome` (n,) an `EdgeOutcome`; `table`, one record a pair: row, the given parameters, the coordinates of
    the edge state, outcome (the name), period, residual (largest relative change of a coordinate over a
    period), growth (the factor by which the two separate in a cycle: an estimate of the multiplier across the
    edge), label_1 and label_2 (of the two attractors), met (the label that ended the search, where it is
    neither: -1 undecided, -1 - w for the `Way` w), rounds, bisections, evaluations (of the map).
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
        u1, u2: n points each, such as `BatchedReturnMap.settled` gives, with equal conserved quantities.
        values: parameters, numbers or one for each pair (n,).
        mapper: a `ProximityMapper`, a `LabelMapper` or any `AttractorMapper` function. By default the pair's
            own two trajectories after `limits.settle_cycles` cycles are its attractors.
        limits: tolerances and limits.

    Raises:
        ValueError: u1 and u2 differ in length, or the map does not have a parameter that is given.
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
    n = len(search.outcome)
    reached = search.rounds + search.bisections > 0
    columns: dict[str, object] = {"row": np.arange(n)}
    columns |= {name: np.broadcast_to(np.asarray(value, np.float64), (n,)) for name, value in values.items()}
    for k, quantity in enumerate(mapping.coordinates):
        columns[quantity.name] = np.where(reached, search.edge.at[:, k], np.nan)
    columns |= {
        "outcome": [EdgeOutcome(code).name for code in search.outcome],
        "period": search.period,
        "residual": search.residual,
        "growth": search.growth,
        "label_1": search.labels[:, 0],
        "label_2": search.labels[:, 1],
        "met": search.met,
        "rounds": search.rounds,
        "bisections": search.bisections,
        "evaluations": search.evaluations,
    }
    return pd.DataFrame(columns)
