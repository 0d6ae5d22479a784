"""Return maps and their Jacobians through located events."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import yaml

from gaitsweep.analysis.continuation.floquet_multipliers import multipliers
from gaitsweep.analysis.continuation.newton import newton
from gaitsweep.dynamics.tree.spatial import quaternion_product
from gaitsweep.engine.advance import advance
from gaitsweep.engine.carry import Halt, start
from gaitsweep.engine.leaves import extended_type, with_float_leaves
from gaitsweep.engine.numerics import Numerics
from gaitsweep.engine.poincare.maps import Points
from gaitsweep.engine.poincare.poincare_return import PoincareReturn, ReturnEngine, ReturnStatus, crossing_of
from gaitsweep.engine.poincare.return_map import BatchedReturnMap
from gaitsweep.errors import ArgumentError
from gaitsweep.papers.ambe2021.multilegged.model import Multilegged
from gaitsweep.papers.ambe2021.multilegged.reduced import MultileggedReduced
from gaitsweep.papers.aoi2011.waist_quadruped import WaistQuadruped
from tests.support.sweeping import scalars
from toy_model import Toy, flight_time

# one start near each gait of the chain: direct, retrograde, source
GAITS = {
    "psi_1": np.array([1.13, 3.97, 1.13]),
    "psi_2": np.array([0.98, 5.29, 1.10]),
    "psi_3": np.array([1.50, 5.29, 5.28]),
}


def differences(mapping: BatchedReturnMap, points: Points, values: dict, step: float) -> np.ndarray:
    """Central differences of the map at each of n points, (n, size, size)."""
    size = points.at.shape[1]
    result = np.zeros((len(points), size, size))
    for k in range(len(points)):
        many = points[np.full(size, k)]
        ends = [
            mapping.images(Points(many.at + sign * step * np.eye(size), many.modes), values)
            for sign in (1.0, -1.0)
        ]
        assert all(end.sound.all() for end in ends)
        result[k] = (mapping.difference(ends[0].points.at, ends[1].points.at) / (2.0 * step)).T
    return result


def off(jacobian: np.ndarray, expected: np.ndarray) -> float:
    """The largest difference, relative to the matrix norm."""
    return float(np.abs(jacobian - expected).max() / np.linalg.norm(expected, 2))


@pytest.fixture(scope="module")
def chain() -> BatchedReturnMap:
    return BatchedReturnMap(Multilegged(), numerics=Numerics(dt=32e-3, method="propagator6"))


@pytest.fixture(scope="module")
def settled(chain: BatchedReturnMap) -> Points:
    points, way = chain.settled(GAITS, {}, 60)
    assert np.all(way == ReturnStatus.crossed)
    return points


def masses(engine: ReturnEngine = "kernel") -> BatchedReturnMap:
    """Two bouncing masses."""
    return BatchedReturnMap(Toy(2), numerics=Numerics(dt=1e-3, method="rk4"), engine=engine)


@pytest.mark.slow("xla")
@pytest.mark.parametrize("engine", ["xla", "kernel"])
def test_saltation_of_a_bouncing_mass(engine: ReturnEngine) -> None:
    """Two masses bounce, the section is mass 1's landing: all entries in closed form.

    A launch speed u flies for T(u) = 2/w atan(u/(w d)) and lands with speed u; mass 2, launched at that time
    with speed u_2 > u, is then at d(cos wT - 1) + u_2/w sin wT. Selects alone would leave out T's derivative,
    -23 % of the entry, for example.
    """
    w, d, r, kick = 2.0, 0.5, 0.5, 0.5
    mapping = masses(engine)
    names = [quantity.name for quantity in mapping.coordinates]
    assert names == [f"{part}_{i}" for part in ("height", "speed", "launch") for i in (1, 2)]
    starts, way = mapping.settled({"launch_1": 0.8, "launch_2": 2.0}, {}, 0)
    result = mapping.linearised(starts, {}, "stiffness")
    assert result.status.tolist() == way.tolist() == [ReturnStatus.crossed]
    T = float(flight_time(np.array(0.8), w, d))
    dT = 2.0 * d / (w**2 * d**2 + 0.8**2)
    height_2 = d * (np.cos(w * T) - 1.0) + 2.0 / w * np.sin(w * T)
    speed_2 = -w * d * np.sin(w * T) + 2.0 * np.cos(w * T)
    np.testing.assert_allclose(
        result.points.at[0], [0.0, height_2, r * 0.8 + kick, speed_2, r * 0.8 + kick, 2.0], atol=1e-10
    )
    over_speed_1 = [0.0, speed_2 * dT, r, -(w**2) * (height_2 + d) * dT, r, 0.0]
    np.testing.assert_allclose(result.jacobian[0][:, 2], over_speed_1, atol=1e-9)
    over_speed_2 = [0.0, np.sin(w * T) / w, 0.0, np.cos(w * T), 0.0, 0.0]
    np.testing.assert_allclose(result.jacobian[0][:, 3], over_speed_2, atol=1e-9)
    # the landing speed is the launch speed whatever w; the kick is w/4
    np.testing.assert_allclose(result.d_parameter[0, 2], 0.25 * 0.5 / w, atol=1e-9)


@pytest.mark.slow
def test_fixed_point_of_a_bouncing_mass() -> None:
    """u* = kick/(1 - r), multiplier r, and zeros for what the landing forgets."""
    mapping = BatchedReturnMap(Toy(), numerics=Numerics(dt=1e-3))
    starts, _ = mapping.settled({"launch_1": np.array([0.3, 2.0])}, {}, 1)
    result = newton(mapping, starts, {"restitution": np.array([0.5, 0.8])})
    assert result.converged.all()
    np.testing.assert_allclose(result.points.at[:, 1], [0.5 / 0.5, 0.5 / 0.2], atol=1e-9)
    found_multipliers = multipliers(result.images.jacobian)
    np.testing.assert_allclose(found_multipliers[:, 0], [0.5, 0.8], atol=1e-9)
    np.testing.assert_allclose(found_multipliers[:, 1:], 0.0, atol=1e-7)


@pytest.mark.slow
def test_stages_of_a_step_are_those_of_an_attempt() -> None:
    """Worked out one by one, a step of rk4 ends where the attempt as a whole does, events included."""
    model, numerics = Multilegged(), Numerics(dt=4e-3, method="rk4")
    params = scalars(model)
    start_values = {"psi_1": 1.9, "psi_2": 2.7, "psi_3": 4.5, "phi_1": np.nan}
    state = model.init(params, {k: jnp.asarray(v) for k, v in start_values.items()})
    attempt = advance(model, numerics.resolve(model))
    carry = start(model, params, state, dt=4e-3, stop=4.0 * model.period(params))
    whole = jax.jit(
        lambda c: jax.lax.while_loop(lambda c: c.halt == Halt.GOING, lambda c: attempt(params, c), c)
    )(carry)
    t, after, way = jax.jit(crossing_of(model, numerics.resolve(model), "xla"))(params, state)
    assert int(way) == ReturnStatus.crossed
    # the same arithmetic; compilers may round sums of products differently
    assert abs(float(t - whole.t)) < 1e-12
    np.testing.assert_allclose(np.asarray(after.phi), np.asarray(whole.state.phi), atol=1e-12)
    np.testing.assert_allclose(np.asarray(after.y), np.asarray(whole.state.y), atol=1e-12)


@pytest.mark.slow
def test_engines_agree() -> None:
    """Crossing, time and derivative of the chain by XLA and by the scalar kernel."""
    model = Multilegged()
    params = scalars(model)
    values = {"psi_1": 1.9, "psi_2": 2.7, "psi_3": 4.5, "phi_1": np.nan}
    state = model.init(params, {k: jnp.asarray(v) for k, v in values.items()})
    state = jax.tree.map(lambda x: jnp.asarray(x, jnp.result_type(x)), state)
    along = dataclasses.replace(
        jax.tree.map(lambda x: np.zeros(x.shape, jax.dtypes.float0), state),
        x=jnp.zeros(4),
        v=jnp.zeros(4),
        phi=jnp.array([0.0, 1.0, 0.0, 0.0]),
        y=jnp.array([0.5, 0.0, 0.0, 0.1]),
    )
    ends = []
    for engine in ("xla", "kernel"):
        crossing = crossing_of(model, Numerics(dt=4e-3, method="rk4").resolve(model), engine)
        (t, after, way), (dt_, d_after, _) = jax.jit(
            lambda s, d, c=crossing: jax.jvp(lambda s: c(params, s), (s,), (d,))
        )(state, along)
        assert int(way) == ReturnStatus.crossed
        ends.append([float(t), float(dt_), *after.phi, *after.v, *d_after.phi, *d_after.y, *d_after.x])
    np.testing.assert_allclose(ends[0], ends[1], rtol=0, atol=1e-11)


@pytest.mark.slow
def test_jacobian_of_the_chain(chain: BatchedReturnMap, settled: Points) -> None:
    """15 x 15 at the fixed points of all three gaits: differentiation against central differences, 1e-6."""
    assert len(chain.coordinates) == 15
    result = chain.linearised(settled, {}, "m_B")
    for jacobian, expected in zip(result.jacobian, differences(chain, settled, {}, 1e-5), strict=True):
        assert off(jacobian, expected) < 1e-6
    step = 1e-6
    ends = [chain.images(settled, {"m_B": 0.9 + sign * step}).points.at for sign in (1.0, -1.0)]
    np.testing.assert_allclose(result.d_parameter, chain.difference(*ends) / (2.0 * step), rtol=0, atol=2e-6)


@pytest.mark.slow("chain")
@pytest.mark.parametrize("model", ["chain", "masses"])
def test_images_without_derivatives_are_the_same(model: str, request: pytest.FixtureRequest) -> None:
    """Through a kernel of their own, in any number; how they were filled up does not matter."""
    if model == "chain":
        mapping, settled = request.getfixturevalue("chain"), request.getfixturevalue("settled")
    else:
        mapping = masses()
        settled, _ = mapping.settled({"launch_1": np.array([0.8, 1.0, 1.3]), "launch_2": 2.0}, {}, 0)
    found, images = mapping.linearised(settled, {}), mapping.images(settled, {})
    np.testing.assert_allclose(images.points.at, found.points.at, rtol=0, atol=1e-12)
    np.testing.assert_array_equal(images.conserved_jacobian, found.conserved_jacobian)
    assert np.isnan(images.jacobian).all()
    one = mapping.images(settled[np.array([1])], {})
    np.testing.assert_array_equal(one.points.at[0], images.points.at[1])


def test_place_and_read_are_each_others_inverse(chain: BatchedReturnMap) -> None:
    """The functions are inverse at starts of each gait, and beside them."""
    chart, params = chain.chart, scalars(Multilegged())
    init, read, place = (jax.jit(f) for f in (chain.model.init, chart.to_coordinates, chart.from_coordinates))
    random = np.random.default_rng(1)
    for k in range(3):
        like = init(params, {"phi_1": np.nan, **{name: psi[k] for name, psi in GAITS.items()}})
        at = read(params, like)
        for beside in (0.0, 1e-3):
            there = at + beside * random.normal(size=at.shape)
            state = place(params, there, like)
            assert bool(chart.covers(params, state))
            np.testing.assert_allclose(read(params, state), there, atol=1e-14)
            assert beside or np.allclose(state.x, like.x, rtol=0.0, atol=1e-9)


@pytest.mark.slow
def test_coordinates_of_the_quadruped_omit_place_and_heading() -> None:
    """The 46 coordinates do not change with place and heading, and determine the rest of the state."""
    model = WaistQuadruped()
    chart, params = model.chart(), scalars(model)
    assert chart is not None
    state = model.init(params, {"delta_13": jnp.asarray(2.8)})
    tilt = jnp.array([0.99, 0.05, -0.06, 0.0])
    random = np.random.default_rng(5)
    state = dataclasses.replace(
        state,
        q=state.q.at[3:7].set(tilt / jnp.linalg.norm(tilt)).at[7:].add(0.1 * random.normal(size=9)),
        v=jnp.asarray(random.normal(size=15)),
        anchor=jnp.asarray(random.normal(size=(4, 2))),
    )
    at = chart.to_coordinates(params, state)
    assert at.shape == (46,) == (len(chart.coordinates),)
    placed = chart.from_coordinates(params, at, state)
    np.testing.assert_allclose(np.asarray(chart.to_coordinates(params, placed)), np.asarray(at), atol=1e-14)
    assert abs(float(params.mechanics.feet(placed.q, placed.v)[0][2, 2])) < 1e-15

    turn, c, s = 0.7, np.cos(0.7), np.sin(0.7)
    world = jnp.array([[c, -s], [s, c]])
    heading = jnp.array([np.cos(turn / 2), 0.0, 0.0, np.sin(turn / 2)])
    away = dataclasses.replace(
        state,
        q=jnp.concatenate(
            [
                world @ state.q[:2] + jnp.array([3.0, -2.0]),
                state.q[2:3],
                quaternion_product(heading, state.q[3:7]),
                state.q[7:],
            ]
        ),
        v=jnp.concatenate([world @ state.v[:2], state.v[2:]]),
        anchor=state.anchor @ world.T + jnp.array([[3.0, -2.0]]),
    )
    np.testing.assert_allclose(np.asarray(chart.to_coordinates(params, away)), np.asarray(at), atol=1e-13)


@pytest.mark.slow
def test_multipliers_of_the_reduced_chain_are_the_theorys() -> None:
    """Eq. (22), (26): {1, 2/3, 2/3} of the direct and the retrograde gait, {1, 2/3, 1/2} of a source wave.

    Their polynomials, since the double multiplier has one direction only; exact but for event location.
    """
    mapping = BatchedReturnMap(MultileggedReduced(), numerics=Numerics(dt=0.1, method="propagator"))
    points, _ = mapping.settled(GAITS, {}, 40)
    result = multipliers(mapping.linearised(points, {}).jacobian)
    for row, theory in zip(result, ([1, 2 / 3, 2 / 3], [1, 2 / 3, 2 / 3], [1, 2 / 3, 1 / 2]), strict=True):
        np.testing.assert_allclose(np.poly(row), np.poly(theory), atol=1e-8)


@pytest.mark.slow
def test_multipliers_of_the_chain_tend_to_the_theorys(chain: BatchedReturnMap) -> None:
    """The full model's small parameter is omega: at fixed E the slow multipliers tend to the reduced ones.

    At 0.1 rad/s the polynomial of the direct and the retrograde gait is within 2e-3 of (z - 2/3)^2, at Table
    1's 0.4 it is 0.09 away; all other multipliers are below 0.01 there, so the slow ones are two.
    """
    apart = []
    for omega in (0.4, 0.1):
        points, _ = chain.settled({k: v[:2] for k, v in GAITS.items()}, {"omega": omega}, 60)
        result = newton(chain, points, {"omega": omega}, fix=["E"])
        assert result.converged.all()
        slow = multipliers(result.images.jacobian, result.images.conserved_jacobian)
        assert np.all(np.abs(slow[:, 2:]) < 0.01)
        polynomials = np.array([np.poly(row[:2]) for row in slow])
        apart.append(np.abs(polynomials - np.poly([2 / 3, 2 / 3])).max())
    assert apart[0] < 0.1
    assert apart[1] < 2e-3


def test_no_derivative_in_steps_of_fixed_length() -> None:
    model = WaistQuadruped()
    flight = PoincareReturn(model, Numerics(dt=2e-4, method="semi_implicit").resolve(model))
    assert not flight.differentiable
    crossing = crossing_of(model, Numerics(dt=2e-4, method="semi_implicit").resolve(model))
    params = scalars(model)
    state = jax.tree.map(
        lambda x: jnp.asarray(x, jnp.result_type(x)),
        jax.jit(model.init)(params, {"delta_13": jnp.asarray(2.8)}),
    )
    numbers = [leaf for leaf in jax.tree.leaves(state) if jnp.issubdtype(leaf.dtype, jnp.floating)]
    assert numbers
    with pytest.raises(ValueError, match="has no derivative: steps have a fixed length"):
        jax.jvp(lambda q: crossing(params, dataclasses.replace(state, q=q))[0], (state.q,), (state.q,))


def test_unknown_names_are_refused() -> None:
    with pytest.raises(ValueError, match="did you mean beta"):
        BatchedReturnMap(Multilegged(), (("betta", 0.8),)).complete({}, 1)
    engine: Any = "gpu"
    with pytest.raises(ValueError, match="Allowed: auto, kernel, quick, xla"):
        crossing_of(Multilegged(), Numerics().resolve(Multilegged()), engine)
    with pytest.raises(ValueError, match="did you mean psi_1"):
        BatchedReturnMap(Multilegged()).settled({"psi1": [0.5]}, {}, 0)


@pytest.mark.slow
def test_jacobian_of_the_quadruped() -> None:
    """46 x 46 at the trot and the walk of f = 2.6: against central differences, 1e-6 of the matrix norm.

    A step that suits the differences: 1e-7, since a tenth of a micrometre is much for a foot on hard ground.
    """
    mapping = BatchedReturnMap(WaistQuadruped(), numerics=Numerics(dt=3e-4))
    points, way = mapping.settled({"delta_13": np.array([2.81, 2.38])}, {}, 60)
    assert np.all(way == ReturnStatus.crossed)
    result = newton(mapping, points, {})
    assert result.converged.all()
    # the model's page: trot 2.81, walk 2.38
    np.testing.assert_allclose(result.points.at[:, 0], [2.81, 2.38], atol=0.01)
    expected = differences(mapping, result.points, {}, 1e-7)
    for jacobian, by_differences in zip(result.images.jacobian, expected, strict=True):
        assert off(jacobian, by_differences) < 1e-6
    # the slow multiplier is that of the settling: delta_13 comes closer by it each cycle
    trot = multipliers(result.images.jacobian)[0, 0]
    approach, _ = mapping.settled({"delta_13": 2.81}, {}, 100), None
    before = mapping.difference(approach[0].at, result.points.at[:1])[0, 0]
    after = mapping.difference(mapping.images(approach[0], {}).points.at, result.points.at[:1])[0, 0]
    assert abs(after / before - trot.real) < 1e-3


@pytest.mark.slow
def test_jacobian_where_feet_slip() -> None:
    """Trot, walk and pace of `configs/aoi2011.yaml` at f = 2.6: central differences, 3e-6 of the norm.

    A foot starts and stops slipping without an event, so that the map has kinks: differences must stay
    between them, 1e-8 apart. The slow multiplier is that of the settling.
    """
    shipped = yaml.safe_load((Path(__file__).parents[2] / "configs" / "aoi2011.yaml").read_text())
    model, constants = WaistQuadruped(**shipped["structure"]), tuple(shipped["params"].items())
    mapping = BatchedReturnMap(model, constants, numerics=Numerics(dt=1e-4))
    points, way = mapping.settled({"delta_13": np.array([3.07, 2.74, 0.52])}, {}, 120)
    assert np.all(way == ReturnStatus.crossed)
    result = newton(mapping, points, {})
    assert result.converged.all()
    # docs/waist_quadruped.md has the first two, rounded
    np.testing.assert_allclose(result.points.at[:, 0], [3.066, 2.739, 0.523], atol=1e-3)
    expected = differences(mapping, result.points, {}, 1e-8)
    for jacobian, by_differences in zip(result.images.jacobian, expected, strict=True):
        assert off(jacobian, by_differences) < 3e-6
    slow = np.real(multipliers(result.images.jacobian)[:, 0])
    # the others, of which return maps over delta_13 alone know nothing, have decayed long before
    assert np.abs(multipliers(result.images.jacobian)[:, 1]).max() < 0.5
    early, _ = mapping.settled({"delta_13": np.array([3.1, 2.7, 0.45])}, {}, 70)
    before = mapping.difference(early.at, result.points.at)[:, 0]
    after = mapping.difference(mapping.images(early, {}).points.at, result.points.at)[:, 0]
    np.testing.assert_allclose(after / before, slow, atol=0.02)


@pytest.mark.parametrize(
    ("settings", "starts", "sentence"),
    [
        ((("kick", "foo"),), {"launch_1": 1.0}, "foo is not a parameter of toy"),
        (
            (("kick", "restitution"), ("restitution", "kick")),
            {"launch_1": 1.0},
            "use one another",
        ),
        ((), {"launch_1": [1.0, 2.0, 3.0]}, "mass has 2 values, but there are 3 points"),
    ],
)
def test_a_map_refuses_what_it_cannot_compute(settings: Any, starts: Any, sentence: str) -> None:
    mapping = BatchedReturnMap(Toy(), settings=settings)
    values = {"mass": [1.0, 1.1]} if "values" in sentence else {}
    with pytest.raises(ArgumentError, match=sentence):
        mapping.settled(starts, values, 2)


def test_a_map_refuses_other_numbers_of_values_and_of_applications() -> None:
    mapping = BatchedReturnMap(Toy())
    with pytest.raises(ArgumentError, match="mass has 2 values, but there are 3 points"):
        mapping.complete({"mass": [1.0, 1.1]}, 3)
    for count in (0, -1):
        with pytest.raises(ArgumentError, match=f"applied {count} times"):
            mapping.iterated(count)


@pytest.mark.parametrize(("infinite", "status"), [("launch", "late"), ("height", "lost")])
def test_a_variable_that_is_infinite_ends_a_return_and_a_mode_does_not(infinite: str, status: str) -> None:
    """As it is with the rows of a run."""
    model = Toy()
    returns = PoincareReturn(model, Numerics(dt=1e-3, method="rk4").resolve(model), derivatives=False)
    params = scalars(model)
    state = dataclasses.replace(
        model.init(params, {"launch_1": jnp.ones(())}), **{infinite: jnp.full(1, jnp.inf)}
    )
    number = jax.jit(lambda state: returns.status(params, returns.begin(params, state)))(state)
    assert ReturnStatus(int(number)).name == status


def test_a_state_with_a_default_has_a_map() -> None:
    @jax.tree_util.register_dataclass
    @dataclasses.dataclass(frozen=True)
    class State:
        height: float
        side: float = 1.0

    extended = extended_type(State, ("clock",))(height=1.0, side=2.0, clock=3.0)
    assert jax.tree.leaves(extended) == [1.0, 2.0, 3.0]
    with pytest.raises(ValueError, match="shorter"):
        with_float_leaves(extended, [1.0, 2.0])
