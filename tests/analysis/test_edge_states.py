"""Edge states between basins, fixed, periodic or chaotic, on maps whose edges are known."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest

import gaitsweep as gs
from gaitsweep.analysis.basins.edge_states import (
    EdgeLimits,
    EdgeOutcome,
    LabelMapper,
    ProximityMapper,
    edge_states,
)
from gaitsweep.analysis.continuation.floquet_multipliers import multipliers
from gaitsweep.analysis.continuation.newton import newton
from gaitsweep.analysis.continuation.plain_map import PlainMap
from gaitsweep.engine.numerics import Numerics
from gaitsweep.engine.poincare.maps import Coordinates, Points, Values
from gaitsweep.engine.poincare.poincare_return import ReturnStatus
from gaitsweep.engine.poincare.return_map import BatchedReturnMap
from gaitsweep.papers.ambe2021.multilegged.reduced import MultileggedReduced
from gaitsweep.papers.ambe2021.theory.chain import Chain
from gaitsweep.papers.ambe2021.theory.gaits import locked_state
from landscape_model import Landscape, curve


def saddle(values: Values, x: Coordinates) -> Coordinates:
    """(s, w) -> (s + r s (1 - s^2), w/2 + 0.4) with s = u - bend w^2.

    Attractors at s = +-1; saddle at s = 0, w = 0.8.
    """
    s = x[0] - values["bend"] * x[1] ** 2
    w = 0.5 * x[1] + 0.4
    return jnp.stack([s + values["r"] * s * (1.0 - s**2) + values["bend"] * w**2, w])


def three(values: Values, x: Coordinates) -> Coordinates:
    """Attractors at pi/3, pi and 5 pi/3, repellers half-way, multiplier 1 + 3 pull."""
    return x + values["pull"] * jnp.sin(3.0 * x)


def turning(values: Values, x: Coordinates) -> Coordinates:
    """Attractors 0 and {2, -2}; the edge between them is the cycle {1, -1}, multiplier 1.3 a cycle."""
    return -(x + 0.05 * x * (x**2 - 1.0) * (4.0 - x**2))


def chaotic(values: Values, x: Coordinates) -> Coordinates:
    """Attractors x = +-1; on the edge x = 0 the other coordinate never comes to rest."""
    return jnp.stack([x[0] + 0.5 * x[0] * (1.0 - x[0] ** 2), 1.0 - 1.9 * x[1] ** 2])


def broken(values: Values, x: Coordinates) -> Coordinates:
    """Attractors +-1, and no fixed point between: the map jumps at .2."""
    return 0.5 * x + 0.5 * jnp.where(x > 0.2, 1.0, -1.0)


class Halving(gs.MapModel):
    """A map without parameters and gaits."""

    x = gs.variable("1", "place", 0.0)

    def image(self, p: Any, s: Any) -> dict[str, Any]:
        return {"x": 0.5 * s.x}


def wrapped(angle: np.ndarray) -> np.ndarray:
    return (angle + np.pi) % (2.0 * np.pi) - np.pi


SADDLE = PlainMap(saddle, ("u", "w"), (("r", 0.5), ("bend", 0.3)))
LINE = PlainMap(three, ("x",), (("pull", 0.2),))
ANGLE = PlainMap(three, ("x",), (("pull", 0.2),), angles=("x",))
TURNING = PlainMap(turning, ("x",))


@pytest.mark.slow
def test_the_saddle_of_a_bistable_map() -> None:
    """S = 0 at any bend and strength, many pairs at once; the table has its multiplier, newton the rest.

    As a saddle is a fixed point, `still` is the error but for the factor 1/(multiplier - 1) = 2.
    """
    n = 12
    random = np.random.default_rng(3)
    u1 = np.stack([random.uniform(0.5, 1.5, n), random.uniform(-0.5, 0.5, n)], axis=1)
    u2 = np.stack([random.uniform(-1.5, -0.5, n), random.uniform(-0.5, 0.5, n)], axis=1)
    values = {"r": np.linspace(0.5, 0.9, n), "bend": np.linspace(-0.3, 0.3, n)}
    limits = EdgeLimits(settle_cycles=40)
    result = edge_states(SADDLE, SADDLE.points(u1), SADDLE.points(u2), values, limits=limits)
    table = result.table
    assert np.all(table["outcome"] == "fixed")
    expected = np.stack([values["bend"] * 0.8**2, np.full(n, 0.8)], axis=1)
    np.testing.assert_allclose(result.points.at, expected, atol=4e-6)
    assert np.max(table["residual"]) <= 1e-6
    np.testing.assert_allclose(table[["u", "w"]], result.points.at)
    np.testing.assert_allclose(table["growth"], 1.0 + values["r"], rtol=1e-4)
    polished = newton(SADDLE, result.points, values)
    assert polished.converged.all()
    np.testing.assert_allclose(polished.points.at, expected, atol=1e-9)
    outside = np.sum(np.abs(multipliers(polished.images.jacobian)) > 1.0, axis=1)
    assert np.all(outside == 1)
    assert np.all(table["evaluations"] > table["bisections"])


@pytest.mark.slow
def test_a_pair_does_not_depend_on_the_others() -> None:
    """Alone, among others that diverge, and with more cuts at once: the same edge."""
    good, bad = [[1.0, 0.2], [-1.0, 0.1]], [[1.0, 0.2], [9.0, 0.0]]
    pairs = np.array([good, bad, good])
    u1, u2, limits = SADDLE.points(pairs[:, 0]), SADDLE.points(pairs[:, 1]), EdgeLimits(settle_cycles=40)
    many = edge_states(SADDLE, u1, u2, {}, limits=limits)
    alone = edge_states(SADDLE, u1[:1], u2[:1], {}, limits=limits)
    assert many.outcome.tolist() == [EdgeOutcome.fixed, EdgeOutcome.lost, EdgeOutcome.fixed]
    pd.testing.assert_frame_equal(many.table.iloc[[0]], alone.table)
    np.testing.assert_array_equal(many.points.at[2], many.points.at[0])
    assert many.table.loc[1, "met"] == -1 - ReturnStatus.lost
    assert many.table.loc[[1], ["u", "w"]].isna().all(axis=None)
    faster = edge_states(SADDLE, u1[:1], u2[:1], {}, limits=EdgeLimits(settle_cycles=40, cuts=7))
    np.testing.assert_allclose(faster.points.at, alone.points.at, atol=4e-6)
    assert np.sum(faster.table["bisections"]) < 0.5 * np.sum(alone.table["bisections"])


def test_outcomes_beside_a_third_attractor() -> None:
    """On a line, the way from pi/3 to 5 pi/3 leads over pi; round the circle it does not."""
    a, b, c = np.pi / 3.0, np.pi, 5.0 * np.pi / 3.0
    attractors = np.array([[a], [b], [c]])
    u1, u2 = LINE.points([[a], [a], [c + 0.1], [a]]), LINE.points([[c], [b], [c], [2.0 * np.pi / 3.0]])
    mapper = ProximityMapper(LINE, attractors)
    result = edge_states(LINE, u1, u2, {}, mapper=mapper, limits=EdgeLimits(max_cycles=200))
    expected = [EdgeOutcome.third, EdgeOutcome.fixed, EdgeOutcome.same, EdgeOutcome.undecided]
    assert result.outcome.tolist() == expected
    assert result.table["met"].tolist() == [1, -1, -1, -1]
    assert result.table[["label_1", "label_2"]].to_numpy().tolist() == [[0, 2], [0, 1], [2, 2], [0, -1]]
    np.testing.assert_allclose(result.points.at[1], 2.0 * np.pi / 3.0, atol=4e-6)
    np.testing.assert_allclose(result.table.loc[1, "growth"], 1.6, rtol=1e-4)
    unknown = edge_states(LINE, u1[:1], u2[:1], {}, limits=EdgeLimits(max_cycles=50))
    assert unknown.outcome.tolist() == [EdgeOutcome.undecided]
    alike = edge_states(LINE, u1[2:3], u2[2:3], {}, limits=EdgeLimits(settle_cycles=60))
    assert alike.outcome.tolist() == [EdgeOutcome.same]
    round_ = edge_states(ANGLE, ANGLE.points([[a]]), ANGLE.points([[c]]), {})
    assert round_.outcome.tolist() == [EdgeOutcome.fixed]
    np.testing.assert_allclose(ANGLE.difference(round_.points.at, np.zeros((1, 1))), 0.0, atol=4e-6)


def test_an_edge_that_is_a_cycle() -> None:
    """{1, -1} between 0 and {2, -2}, whose multiplier over both of its points is 1.3^2."""
    mapper = ProximityMapper(TURNING, np.array([[0.0], [2.0], [-2.0]]), [0, 1, 1])
    result = edge_states(TURNING, TURNING.points([[0.2]]), TURNING.points([[1.7]]), {}, mapper=mapper)
    assert result.outcome.tolist() == [EdgeOutcome.periodic]
    assert result.table["period"].tolist() == [2]
    np.testing.assert_allclose(np.abs(result.points.at), 1.0, atol=4e-6)
    np.testing.assert_allclose(result.table["growth"], 1.3, rtol=1e-4)
    assert np.max(result.table["residual"]) <= 1e-6


def test_a_wandering_edge_state() -> None:
    """The coordinate across the edge is known; the other one stays between -0.9 and 1."""
    mapping = PlainMap(chaotic, ("x", "y"))

    def side(images, pair, cycle):
        x = images.points.at[:, 0]
        return np.where(np.abs(x) > 0.5, (x > 0).astype(int), -1)

    u1, u2 = mapping.points([[-1.0, 0.3]]), mapping.points([[0.8, 0.4]])
    result = edge_states(mapping, u1, u2, {}, mapper=side, limits=EdgeLimits(max_rounds=3))
    assert result.outcome.tolist() == [EdgeOutcome.wandering]
    assert result.table["rounds"].tolist() == [3]
    assert np.min(result.table["residual"]) > 1e-3
    assert abs(result.points.at[0, 0]) < 1e-6


def test_a_map_that_jumps_has_an_edge_without_a_fixed_point() -> None:
    mapping = PlainMap(broken, ("x",))
    result = edge_states(mapping, mapping.points([[-1.0]]), mapping.points([[0.9]]), {})
    assert result.outcome.tolist() == [EdgeOutcome.jump]
    np.testing.assert_allclose(result.points.at, 0.2, atol=1e-6)
    assert np.min(result.table["residual"]) > 0.3


def test_a_line_inside_one_basin_is_no_edge() -> None:
    """An arbitrary mapper separates the starts, but the map does not."""
    mapping = PlainMap(lambda values, x: 0.5 * x, ("x",))

    def side(images, pair, cycle):
        return (images.points.at[:, 0] > 0).astype(int)

    result = edge_states(
        mapping,
        mapping.points([[-1.0]]),
        mapping.points([[0.7]]),
        {},
        mapper=side,
        limits=EdgeLimits(max_cycles=20),
    )
    assert result.outcome.tolist() == [EdgeOutcome.together]
    assert all(EdgeOutcome(code).sentence for code in EdgeOutcome)


@pytest.mark.slow
def test_a_model_on_its_section() -> None:
    """The curves theta_1 = c and c + pi attract, so the edge lies half-way; its multiplier is exp(rate).

    theta_2 stays as it is, so each pair with one theta_2 has its own edge state. A pair on the cliff falls.
    Both mappers: the two attractors themselves, and the model's label after 25 cycles.
    """
    mapping = BatchedReturnMap(Landscape(), (("cliff", 0.9),), numerics=Numerics(dt=0.02))
    theta_2 = np.array([1.0, 2.5, 4.0, 0.1])
    c = np.asarray(curve({"shift": jnp.zeros(()), "bend": 0.7 * jnp.ones(())}, jnp.asarray(theta_2)))
    u1, _ = mapping.settled({"theta_1": c + 0.3, "theta_2": theta_2}, {}, 0)
    u2, _ = mapping.settled({"theta_1": c + 2.2, "theta_2": theta_2}, {}, 0)
    values = {"rate": np.array([1.0, 2.0, 3.0, 3.0])}
    limits = EdgeLimits(
        bisection_distance=1e-6,
        separation_distance=1e-4,
        residual_tolerance=1e-5,
        cuts=3,
        settle_cycles=15,
        max_cycles=60,
    )
    gaits = LabelMapper(mapping, values, after=25)
    for mapper in (None, gaits):
        result = edge_states(mapping, u1, u2, values, mapper=mapper, limits=limits)
        assert result.outcome.tolist() == [EdgeOutcome.fixed] * 3 + [EdgeOutcome.fell]
        np.testing.assert_allclose(result.table["theta_1"][:3], (c + 0.5 * np.pi)[:3], atol=1e-5)
        np.testing.assert_allclose(result.table["theta_2"][:3], theta_2[:3], atol=1e-12)
        # so near to the edge nothing of the sine's cube is seen
        np.testing.assert_allclose(result.table["growth"][:2], np.exp(values["rate"][:2]), rtol=1e-3)
    assert result.table[["label_1", "label_2"]].to_numpy().tolist()[:3] == [[0, 1]] * 3


def test_no_pairs_have_no_edge_states() -> None:
    none = SADDLE.points(np.zeros((0, 2)))
    for mapper in (None, ProximityMapper(SADDLE, np.eye(2))):
        result = edge_states(SADDLE, none, none, {"r": []}, mapper=mapper)
        assert len(result.points) == len(result.outcome) == len(result.table) == 0
        assert {"r", "u", "w", "outcome"} <= {*result.table}
    with pytest.raises(ValueError, match="evaluated at no points"):
        SADDLE.images(none, {})


def test_refusals() -> None:
    u1 = SADDLE.points([[1.0, 0.0]] * 2)
    with pytest.raises(ValueError, match="both must have the same number"):
        edge_states(SADDLE, u1, u1[:1], {})
    with pytest.raises(ValueError, match="bent is not a parameter of the map; did you mean bend"):
        edge_states(SADDLE, u1, u1, {"bent": 0.1})
    with pytest.raises(ValueError, match="bend has 3 values, but there are 2 points"):
        edge_states(SADDLE, u1, u1, {"bend": [0.1, 0.2, 0.3]})
    with pytest.raises(ValueError, match="resolution of float64"):
        EdgeLimits(bisection_distance=1e-15)
    with pytest.raises(ValueError, match="residual_tolerance is -1, but must be above 0"):
        EdgeLimits(residual_tolerance=-1.0)
    with pytest.raises(ValueError, match="reach is 0, but must be above 0"):
        ProximityMapper(SADDLE, np.eye(2), reach=0.0)
    with pytest.raises(ValueError, match="after is -1 cycles, but must be 0 or more"):
        LabelMapper(BatchedReturnMap(Landscape()), {}, after=-1)
    with pytest.raises(ValueError, match="cuts is 0"):
        EdgeLimits(cuts=0)
    with pytest.raises(ValueError, match=r"max_rounds is 2\.5"):
        EdgeLimits(max_rounds=2.5)  # pyright: ignore[reportArgumentType]
    with pytest.raises(ValueError, match="one label for each"):
        edge_states(SADDLE, u1, u1, {}, mapper=lambda images, pair, cycle: np.zeros(1, int))
    with pytest.raises(ValueError, match="an edge lies between two"):
        ProximityMapper(SADDLE, np.zeros((2, 2)), [0, 0])
    with pytest.raises(ValueError, match="A label is -1, but must be 0 or more"):
        ProximityMapper(SADDLE, np.eye(2), [-1, 1])
    with pytest.raises(ValueError, match="2 points of attractors"):
        ProximityMapper(SADDLE, np.zeros((2, 2)), [0])
    apart = np.array([[[1.0, 0.8], [-1.0, 0.8]]] * 2)
    for mapper in (
        ProximityMapper(SADDLE, apart),
        LabelMapper(BatchedReturnMap(Landscape()), {"rate": [1.0, 2.0]}, after=0),
    ):
        with pytest.raises(ValueError, match="for 2 pairs, but there are more"):
            mapper(SADDLE.images(SADDLE.points([[1.0, 0.0]] * 3), {}), np.arange(3), 1)
    halving = BatchedReturnMap(Halving())
    images = halving.images(halving.settled({"x_0": [0.2, 0.4]}, {}, 0)[0], {})
    # a model without parameters has one set of values, the empty one
    assert LabelMapper(halving, {}, after=0)(images, np.arange(2), 1).tolist() == [0, 0]
    with pytest.raises(ValueError, match="did you mean near"):
        LabelMapper(BatchedReturnMap(Landscape()), {}, after=5, only=["neer"])


@pytest.mark.slow
def test_the_locked_state_of_the_reduced_chain_lies_on_an_edge() -> None:
    """By theory, starts with psi_2 = 0 reach the locked state, and all others leave it.

    The edge is psi_2 = 0, and there the map jumps: what counts is which of legs 2 and 3 touches first. So the
    two come apart at once, however near they are, and what is found is no fixed point; but within
    psi_2 = 0 all of it comes to the locked state, where legs 1 and 4 are reset by m b (eq. 31).
    """
    mapping = BatchedReturnMap(MultileggedReduced(), numerics=Numerics(dt=0.1, method="propagator"))
    starts = {"psi_1": [4.9, 5.4, 5.2, 5.0], "psi_2": [0.3, 0.2, -0.3, -0.6], "psi_3": [1.0, 0.7, 1.2, 1.1]}
    points, _ = mapping.settled({name: np.array(each) for name, each in starts.items()}, {}, 2)

    def sign(images, pair, cycle):
        psi_2 = wrapped(images.points.at[:, 1])
        return np.where(np.abs(psi_2) > 0.9, (psi_2 > 0.0).astype(int), -1)

    limits = EdgeLimits(max_rounds=2, cuts=3, max_cycles=100)
    result = edge_states(mapping, points[:2], points[2:], {}, mapper=sign, limits=limits)
    table = result.table
    assert table["outcome"].tolist() == ["wandering"] * 2
    np.testing.assert_allclose(table["psi_2"], 0.0, atol=1e-7)
    assert np.min(table["growth"]) > 1e5
    assert np.min(table["residual"]) > 1e-3

    exact = result.points.at.copy()
    exact[:, 1] = 0.0
    m_b = (1.0 - 0.8) * 9.8 * np.pi / (100.0 * 0.4)
    for side in (1.0, -1.0):
        beside = Points(exact + side * np.array([0.0, 1e-6, 0.0]), result.points.modes)
        psi_2 = wrapped(mapping.images(beside, {}).points.at[:, 1])
        np.testing.assert_allclose(psi_2, 0.5 * side * m_b, atol=1e-5)
    held = Points(exact, result.points.modes)
    for _ in range(60):
        held = mapping.images(held, {}).points
    locked = np.asarray(locked_state(Chain()))
    expected = locked + m_b * np.array([-1.0, 0.0, 1.0])
    np.testing.assert_allclose(wrapped(held.at - expected), 0.0, atol=1e-6)
