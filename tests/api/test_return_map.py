"""The return map from Python, against the toy model's map in closed form."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

import gaitsweep as gs
import toy_model
from gaitsweep.examples.bouncing_ball import BouncingBall
from gaitsweep.examples.hopper import Hopper
from gaitsweep.examples.rimless_wheel import RimlessWheel

KICK, R = 0.3, 0.4
FIXED = KICK / (1 - R)  # launch speed of the fixed point of u -> r u + kick
TOY = toy_model.Toy()


def launch(points: np.ndarray, mapping: gs.PoincareMap) -> np.ndarray:
    return points[..., mapping.coordinates.index("launch_1")]


@pytest.mark.slow
def test_images_jacobian_and_multipliers() -> None:
    """Bounds are those of the fixed numerics' own error, 1e-8 a flight."""
    mapping = gs.return_map(TOY, kick=KICK, restitution=R)
    starts = {"launch_1": np.array([0.5, 1.0, 2.0])}
    images = mapping(starts)
    np.testing.assert_allclose(launch(images.at, mapping), R * starts["launch_1"] + KICK, atol=1e-7)
    points = mapping.settled(starts, 2)
    np.testing.assert_allclose(mapping(points).at, mapping(points.at), atol=1e-12)
    single = mapping(points.at[0])
    assert single.shape == (len(mapping.coordinates),)
    result = mapping.fixed_points(mapping.settled({"launch_1": 1.0}, 3))
    assert result.converged.all()
    np.testing.assert_allclose(launch(result.points.at, mapping), FIXED, atol=1e-7)
    np.testing.assert_allclose(np.abs(mapping.multipliers(result))[0, 0], R, atol=1e-5)
    assert mapping.jacobian(result).shape == (1, *2 * (len(mapping.coordinates),))
    assert mapping.jacobian(result.points.at[0]).ndim == 2


class DroppedBall(gs.DeclaredModel):
    """A ball over a floor that keeps a share of its speed; all variables are coordinates of the section."""

    rest = gs.parameter("1", "share of the speed that a landing leaves", 0.6)
    height = gs.variable("m", "height", 0.0, observed=True)
    speed = gs.variable("m/s", "speed upwards", 2.0, observed=True)

    def flow(self, p, s):
        return {"height": s.speed, "speed": -10.0}

    @gs.event("lands", section=True)
    def lands(self, p, s):
        return -s.height

    @lands.jump
    def bounces(self, p, s):
        return s.replace(speed=-p.rest * s.speed)

    def period(self, p):
        return 1.0 + 0.0 * p.rest


@pytest.mark.slow
def test_the_return_of_a_start_off_the_section_is_its_first_crossing() -> None:
    """Displaced crossings are moved onto the section; starts are not, whatever the model's own start."""
    mapping = gs.return_map(DroppedBall())
    lands = 0.6 * np.sqrt(20.0)  # from 1 m
    dropped = {"height_0": 1.0, "speed_0": 0.0}
    np.testing.assert_allclose(mapping(dropped).at, [[0.0, lands]], atol=1e-9)
    np.testing.assert_allclose(mapping([1.0, 0.0]), [0.0, lands], atol=1e-9)
    slope = [[0.0, 0.0], [6.0 / np.sqrt(20.0), 0.0]]
    np.testing.assert_allclose(mapping.jacobian(dropped), [slope], atol=1e-9)
    crossing = mapping.settled(dropped, 1)
    below = dataclasses.replace(crossing, at=crossing.at - [1e-6, 0.0])
    np.testing.assert_allclose(mapping(below).at, mapping(crossing).at, atol=1e-9)


@pytest.mark.slow
def test_many_maps_at_once() -> None:
    """An array of a parameter: a map for each value, and points belong to them in order."""
    kicks = np.array([0.2, 0.3, 0.4])
    mapping = gs.return_map(TOY, kick=kicks, restitution=R, start={"launch_1": 1.0})
    assert repr(mapping) == f"PoincareMap(toy: {', '.join(mapping.coordinates)} over kick)"
    result = mapping.fixed_points(mapping.settled(cycles=3))
    np.testing.assert_allclose(launch(result.points.at, mapping), kicks / (1 - R), atol=1e-7)


@pytest.mark.slow
def test_a_branch() -> None:
    """u* = kick / (1 - r), on both sides of the kick at which it begins."""
    mapping = gs.return_map(TOY, kick=KICK, restitution=R)
    result = mapping.fixed_points(mapping.settled({"launch_1": 1.0}, 3))
    branch = mapping.continue_(result, "kick", (0.2, 0.5))
    assert np.min(branch["kick"]) == pytest.approx(0.2)
    assert np.max(branch["kick"]) == pytest.approx(0.5)
    np.testing.assert_allclose(branch["launch_1"], branch["kick"] / (1 - R), atol=1e-6)
    assert branch["gait"].cat.categories.tolist() == list(mapping.model.gaits)
    assert branch.groupby("direction", observed=True)["gait"].nunique().tolist() == [1, 1]
    assert set(mapping.continue_(result, "kick", (0.2, 0.5), towards=1)["direction"]) == {1}
    axes = gs.plot.continuation(branch).axes[0]
    assert axes.get_xlabel() == "speed that a bounce adds (m/s)"
    assert "m/s" in axes.get_ylabel()  # of the first coordinate, launch_1


@pytest.mark.slow
def test_conserved_quantities_are_constrained_by_default() -> None:
    """E of the chain is constrained unless `fix` is given; without, Newton's equations are singular."""
    chain = gs.models.Multilegged(N=3)
    mapping = gs.return_map(chain, beta=0.8)
    assert mapping.conserved == ["E"]
    points = mapping.settled({"psi_1": 1.13, "psi_2": 0.98, "psi_3": 1.5}, 30)
    held = mapping.fixed_points(points)
    assert held.converged.all()
    energy = held.points.at[0, :3].sum() - points.at[0, :3].sum()
    assert abs(energy) < 1e-8
    assert not mapping.fixed_points(points, fix=()).converged.any()


@pytest.mark.slow
def test_starts_of_several_values_are_replaced_by_another_number_of_them() -> None:
    """The other starts, which have one value, do not keep the number of the map's own points."""
    dropped = gs.return_map(DroppedBall(), speed_0=[2.0, 3.0])
    points = dropped.settled({"speed_0": [1.0, 2.0, 4.0]}, cycles=0)
    np.testing.assert_array_equal(points.at, [[0.0, 1.0], [0.0, 2.0], [0.0, 4.0]])


@pytest.mark.slow
def test_refusals() -> None:
    reduced = gs.return_map(gs.models.MultileggedReduced(N=3))
    starts = {"psi_1": 1.0, "psi_2": 2.0, "psi_3": 3.0}
    assert np.isfinite(reduced(starts).at).all()
    for refused in (reduced.jacobian, reduced.multipliers, reduced.fixed_points):
        with pytest.raises(gs.ArgumentError, match=r"by semi_implicit has no derivative: .*Use rk4\."):
            refused(starts)
    with pytest.raises(gs.ArgumentError, match="has no derivative"):
        reduced.continue_(starts, "beta", (0.7, 0.9))
    with pytest.raises(gs.ArgumentError, match="psi_1 of multilegged_reduced has no default"):
        reduced(np.zeros(3))
    in_params = gs.return_map(gs.models.MultileggedReduced(N=3), params=starts)
    np.testing.assert_array_equal(in_params.settled().at, reduced.settled(starts).at)
    mapping = gs.return_map(TOY, kick=KICK)
    with pytest.raises(gs.ArgumentError, match=r"shape \(7,\), but the map has"):
        mapping(np.zeros(7))
    with pytest.raises(gs.ArgumentError, match=r"'trot'.*start values by name.*fixed_points\(m\.settled\("):
        mapping.multipliers("trot")
    with pytest.raises(gs.ArgumentError, match="lanch_1 is not a start value of toy; did you mean launch_1"):
        mapping.settled({"lanch_1": 1.0})
    with pytest.raises(gs.ArgumentError, match=r"kick is 0\.3 at the map's points, but the range is"):
        mapping.continue_({"launch_1": 1.0}, "kick", (1, 2))
    with pytest.raises(gs.ArgumentError, match="towards is 0, but must be 1, -1"):
        mapping.continue_({"launch_1": 1.0}, "kick", (0.1, 2), towards=0)
    for within in (("a", "b"), 0.1, (0.1, np.inf), (0.3, 0.3)):
        with pytest.raises(gs.ArgumentError, match="must be two different finite numbers"):
            mapping.continue_({"launch_1": 1.0}, "kick", within)  # pyright: ignore[reportArgumentType]
    # of several values the one outside the range is named
    with pytest.raises(gs.ArgumentError, match=r"kick is 0\.5 at the map's points, but the range is"):
        gs.return_map(TOY, kick=[KICK, 0.5]).continue_({"launch_1": 1.0}, "kick", (0.2, 0.4))
    with pytest.raises(gs.ArgumentError, match="tolerance is -1, but must be a number above 0"):
        mapping.fixed_points({"launch_1": 1.0}, tolerance=-1)
    with pytest.raises(gs.ArgumentError, match="most is 0, but must be a whole number from 1"):
        mapping.fixed_points({"launch_1": 1.0}, most=0)
    with pytest.raises(gs.ArgumentError, match="cycles is -1, but"):
        mapping.settled(cycles=-1)
    with pytest.raises(gs.ArgumentError, match="period is 0, but"):
        gs.return_map(TOY, kick=KICK, period=0)
    with pytest.raises(gs.ArgumentError, match="kik is not a parameter of toy; did you mean kick"):
        mapping.continue_({"launch_1": 1.0}, "kik", (1, 2))
    with pytest.raises(gs.ArgumentError, match="lunch is neither a parameter nor a start value"):
        gs.return_map(TOY, lunch=1.0)


@pytest.mark.parametrize(
    ("method", "wrong", "message"),
    [
        ("fixed_points", {"tolerance": "1e-9"}, "tolerance is '1e-9', but"),
        ("fixed_points", {"tolerance": np.inf}, "tolerance is inf, but"),
        ("fixed_points", {"most": 2.5}, "most is 2.5, but"),
        ("fixed_points", {"fix": 3}, "3 is not a name"),
        ("continue_", {"fix": 3}, "3 is not a name"),
        ("continue_", {"parameter": 3}, "parameter is 3, but"),
        ("continue_", {"towards": True}, "towards is True, but"),
        ("continue_", {"towards": np.array([1, -1])}, "towards is array"),
        ("continue_", {"within": (True, 13.0)}, "within is .* two different finite numbers"),
        ("continue_", {"within": (-3.0, 13.0)}, r"within is .*, but omega must be above 0"),
    ],
)
def test_refusals_of_arguments(method: str, wrong: dict[str, Any], message: str) -> None:
    arguments = {} if method == "fixed_points" else {"parameter": "omega", "within": (11.0, 13.0)}
    with pytest.raises(gs.ArgumentError, match=message):
        getattr(gs.return_map(Hopper()), method)([0.4, 2.5], **{**arguments, **wrong})


@pytest.mark.slow
def test_a_branch_needs_one_value_for_each_point() -> None:
    hops = gs.return_map(Hopper(), omega=[3.6, 3.7])
    with pytest.raises(gs.ArgumentError, match="omega has 2 values, but there are 3 points"):
        hops.continue_([[0.4, 8.3]] * 3, "omega", (3.5, 3.7))
    ends = hops.continue_([[0.4, 8.3]] * 2, "omega", (3.7, 3.56), towards=-1)["end"]
    assert set(ends) == {"", "range"}


@pytest.mark.slow
def test_an_orbit_ends_where_a_trajectory_fails() -> None:
    ball = gs.return_map(BouncingBall(), G=1.6, period=3)
    crossings = ball.orbit([0.5, -3.0])  # below the table
    np.testing.assert_array_equal(crossings[0], [0.5, -3.0])
    assert np.isnan(crossings[1:]).all()
    assert np.isnan(ball([0.5, -3.0])).all()
    with pytest.warns(UserWarning, match=r"1 of 1 starts did not cross the section 6 times"):
        gs.return_map(RimlessWheel(), period=3).settled({"rate_0": 0.01}, cycles=2)


@pytest.mark.slow
def test_phases_may_be_counted_by_an_integer_of_numpy() -> None:
    hops = gs.return_map(Hopper(), omega=3.7)
    gait = hops.fixed_points([0.4, 8.3])
    table = hops.phase_response(gait, "phase", np.int64(4))
    assert table["push_phase"].tolist() == [0.0, 0.25, 0.5, 0.75]


@pytest.mark.slow
def test_points_that_are_no_fixed_points_have_no_multipliers() -> None:
    hops = gs.return_map(Hopper(), omega=3.7)
    found = hops.fixed_points([[0.4, 8.3], [np.nan, 8.3]])
    with pytest.warns(UserWarning, match="1 of 2 points are no fixed points"):
        factors = hops.multipliers(found)
    assert np.isnan(factors).all(axis=1).tolist() == [False, True]
    assert np.isnan(hops.multipliers([np.nan, 8.3])).all()


class Pulled(gs.MapModel):
    """x -> x + pull - shift x, at rest in pull / shift."""

    pull = gs.parameter("1", "pull", 1.0)
    shift = gs.parameter("1", "share of x that is lost", 0.5)
    x = gs.variable("1", "place", 0.0)

    def image(self, p, s):
        return {"x": s.x + p.pull - p.shift * s.x}


def test_branches_along_a_formula_begin_at_its_value_for_each_point() -> None:
    """The formula pull = 2 shift has another value for each shift."""
    mapping = gs.return_map(Pulled(), params={"pull": "2 * shift"}, shift=[0.25, 0.5])
    points = mapping.fixed_points([[1.9], [2.1]])
    branches = mapping.continue_(points, "pull", (0.1, 3.0), towards=1).groupby("row").first()
    np.testing.assert_allclose(branches["pull"], [0.5, 1.0])
    np.testing.assert_allclose(branches["x"], [2.0, 2.0])


def test_starts_follow_the_given_ones_by_their_formulas() -> None:
    """As in a sweep; a formula of a given start is not evaluated."""
    mapping = gs.return_map(TwoPlaces(), start={"z_0": "y_0 - shift"}, shift=[0.25, 0.5])
    np.testing.assert_allclose(mapping.settled({"x_0": 3.0}, 0).at, [[3.0, 6.0, 5.75], [3.0, 6.0, 5.5]])
    np.testing.assert_allclose(mapping.settled({"y_0": [7.0, 8.0]}, 0).at[:, 2], [6.75, 7.5])
    with pytest.raises(gs.ArgumentError, match="has 2 values, but there are 3 points"):
        mapping.settled({"y_0": [7.0, 8.0, 9.0]}, 0)


class TwoPlaces(gs.MapModel):
    """Three places, of which the second begins at twice the first."""

    shift = gs.parameter("1", "share that is lost", 0.5)
    x = gs.variable("1", "first place", 1.0)
    y = gs.variable("1", "second place", "2 * x_0")
    z = gs.variable("1", "third place", 0.0)

    def image(self, p, s):
        return {"x": s.x - p.shift * s.x, "y": s.y, "z": s.z}


class Mixed(gs.DeclaredModel):
    """A linear map of x and y once a second, which also counts turns; y is left out of the coordinates."""

    section_coordinates = ("x",)

    rate = gs.parameter("1/s", "frequency", 1.0)
    clock = gs.variable("1", "share of the cycle", 0.0, observed=False)
    x = gs.variable("1", "first state", 0.3)
    y = gs.variable("1", "second state", 0.2)
    path = gs.variable("m", "length of the path", 0.0)

    def flow(self, p, s):
        return {"clock": p.rate, "path": 1.0 + s.x}

    @gs.event("it ticks", section=True)
    def tick(self, p, s):
        return s.clock - 1.0

    @tick.jump
    def again(self, p, s):
        return s.replace(clock=0.0, x=0.5 * s.x + 0.3 * s.y, y=0.4 * s.x + 0.2 * s.y)

    def period(self, p):
        return 1.0 / p.rate


@pytest.mark.slow
def test_multipliers_warn_of_a_coordinate_that_is_missing() -> None:
    """The path's length changes nothing, and is not named."""

    class Whole(Mixed):
        section_coordinates = ("x", "y")

    whole = gs.return_map(Whole())
    factors = whole.multipliers(whole.settled({}, cycles=3))
    assert np.sort(factors[0].real) == pytest.approx(np.sort(np.linalg.eigvals([[0.5, 0.3], [0.4, 0.2]])))
    part = gs.return_map(Mixed())
    with pytest.warns(UserWarning, match=r"depend on y, which section_coordinates of \w+ leaves out"):
        part.multipliers(part.settled({}, cycles=3))
