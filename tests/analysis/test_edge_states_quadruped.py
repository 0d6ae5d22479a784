"""Edge states of the quadruped with a waist, between walk and trot."""

from __future__ import annotations

import numpy as np
import pytest

from gaitsweep.analysis.basins.edge_states import EdgeLimits, edge_states
from gaitsweep.analysis.continuation.floquet_multipliers import multipliers
from gaitsweep.analysis.continuation.newton import newton
from gaitsweep.engine.numerics import Numerics
from gaitsweep.engine.poincare.poincare_return import ReturnStatus
from gaitsweep.engine.poincare.return_map import BatchedReturnMap
from gaitsweep.papers.aoi2011.waist_quadruped import WaistQuadruped


@pytest.mark.slow
def test_between_walk_and_trot_of_the_quadruped() -> None:
    """Over the waist's stiffness, edge states are the unstable fixed points that Newton's method finds.

    At f = 2.6 Hz the map's jumps leave two narrow attractors between walk and trot, which wander within
    0.0004 and 0.005 rad. So the line from trot to walk meets a third basin there, and the edges of the four
    basins are the three fixed points, at 2.586, 2.590 and 2.637 rad.
    """
    mapping = BatchedReturnMap(WaistQuadruped(), numerics=Numerics(dt=3e-4))
    f = np.array([2.4, 2.5, 2.6, 2.7, 2.8])
    begun = np.concatenate([np.full(5, 2.83), np.full(5, 2.38), [2.6, 2.594]])
    points, way = mapping.settled({"delta_13": begun}, {"f": np.concatenate([f, f, [2.6, 2.6]])}, 80)
    assert np.all(way == ReturnStatus.crossed)
    upper, lower = points.at[:5, 0] - 0.03, points.at[5:10, 0] + 0.03
    # trot, the wider and the narrower attractor, walk of f = 2.6
    four = np.array([2, 10, 11, 7])
    u1, u2 = points[np.append(np.arange(5), four[:-1])], points[np.append(np.arange(5, 10), four[1:])]
    stiffness = np.append(f, [2.6] * 3)
    place = np.append(np.arange(5), [2] * 3)

    def gait(images, pair, cycle):
        delta, at = images.points.at[:, 0], place[pair]
        label = np.where(delta > upper[at], 0, np.where(delta < lower[at], 3, -1))
        if cycle >= 40:
            between = (stiffness[pair] == 2.6) & (label < 0)
            label = np.where(between & (delta > 2.622) & (delta < 2.631), 1, label)
            label = np.where(between & (delta > 2.5887) & (delta < 2.5896), 2, label)
        return label

    # two come no farther apart than the next place where the map jumps is, 0.0003 rad from the edge at 2.5897
    limits = EdgeLimits(
        bisection_distance=3e-4,
        separation_distance=3e-3,
        residual_tolerance=1e-4,
        cuts=4,
        max_cycles=400,
        max_rounds=3,
    )
    result = edge_states(mapping, u1, u2, {"f": stiffness}, mapper=gait, limits=limits)
    table = result.table
    print(table[["f", "delta_13", "outcome", "residual", "growth", "label_1", "label_2", "met"]])
    assert table["outcome"].tolist() == ["fixed", "fixed", "third", *["fixed"] * 5]
    assert table["met"][2] in (1, 2)
    assert table[["label_1", "label_2"]].to_numpy()[5:].tolist() == [[0, 1], [1, 2], [2, 3]]
    np.testing.assert_allclose(table["delta_13"][5:], [2.637, 2.590, 2.586], atol=1e-3)

    edges = np.flatnonzero(result.table["outcome"].isin(["fixed", "periodic"]))
    polished = newton(mapping, result.points[edges], {"f": stiffness[edges]})
    assert polished.converged.all()
    # the residual allowed, over what is left of it by the smallest multiplier, 1.05
    np.testing.assert_allclose(result.points.at[edges, 0], polished.points.at[:, 0], atol=5e-4)
    sizes = np.abs(multipliers(polished.images.jacobian))
    print(polished.points.at[:, 0], sizes[:, :2])
    assert np.all(np.sum(sizes > 1.0, axis=1) == 1)
    assert np.all(sizes[:, 1] < 0.7)
    # within a few ten-thousandths of the saddle the map is its derivative to about that share
    np.testing.assert_allclose(table["growth"][edges], sizes[:, 0], atol=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("dt", [3e-4, 1.5e-4])
def test_narrow_attractors_between_walk_and_trot(dt: float) -> None:
    """At f = 2.6 Hz two attractors between walk and trot keep their ranges for 100 cycles.

    The unstable fixed points beside them, 2.5859, 2.5897 and 2.6370 rad, would let them go within 100 cycles
    of multiplier 1.07 from anywhere but the last thousandth of the way. Half the step gives the same ranges.
    """
    mapping = BatchedReturnMap(WaistQuadruped(), numerics=Numerics(dt=dt))
    points, way = mapping.settled({"delta_13": np.array([2.6, 2.594])}, {"f": 2.6}, 80)
    assert np.all(way == ReturnStatus.crossed)
    course = []
    for _ in range(100):
        points = mapping.images(points, {"f": 2.6}).points
        course.append(points.at[:, 0])
    low, high = np.min(course, axis=0), np.max(course, axis=0)
    print(dt, low, high)
    np.testing.assert_allclose(low, [2.6244, 2.5890], atol=3e-4)
    np.testing.assert_allclose(high, [2.6290, 2.5894], atol=3e-4)
    assert np.all(high - low > 2e-4), "neither is a fixed point"
