"""Events of declared models: impacts, landings on a surface, events of one instant, bodies that rest."""

from __future__ import annotations

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import gaitsweep as gs
from gaitsweep import DeclaredModel, event, mode, parameter, variable

G = 9.81


class Ball(DeclaredModel):
    """A ball that falls on a floor and keeps a share of its speed; the jump changes the speed alone."""

    keeps = parameter("1", "share of its speed that a landing keeps", 0.5)
    ground = parameter("m", "height of the floor", 0.0)
    z = variable("m", "height", 1.0)
    v = variable("m/s", "speed upwards", 0.0, observed=True)

    def flow(self, p, s):
        return {"z": s.v, "v": -G}

    @event("lands", section=True)
    def landing(self, p, s):
        return p.ground - s.z

    @landing.jump
    def bounce(self, p, s):
        return s.replace(v=-p.keeps * s.v)

    def period(self, p):
        return 1.0 + 0.0 * p.keeps


@pytest.mark.parametrize("floor", [0.0, 1.0, 100.0, -3.0])
def test_bounces_accumulate_on_a_floor_at_any_height(floor: float) -> None:
    """They do so at (2 h / g)^(1/2) (1 + e) / (1 - e), and no ball is below the floor then.

    At 100 m a height is known to 1e-14 m, so bounces that last 1e-7 s cannot be seen.
    """
    e = np.array([0.05, 0.3, 0.5, 0.7, 0.9])
    end = gs.sweep(
        Ball, keeps={"values": e}, ground=floor, start={"z_0": floor + 1.0}, run=gs.FixedTime(duration=20.0)
    ).table
    assert set(end["status"]) == {"event_stall"}
    assert set(end["stalled_by"]) == {"lands"}
    accumulated = np.sqrt(2.0 / G) * (1.0 + e) / (1.0 - e)
    rtol, atol = 1e-6 if floor == 100.0 else 0.0, 1e-7 if floor == 0.0 else 2e-6
    np.testing.assert_allclose(end["t_end"], accumulated, rtol=rtol, atol=atol)
    np.testing.assert_allclose(end["z_end"], floor, rtol=0, atol=1e-10)


def test_a_downward_start_on_the_floor_lands_at_once() -> None:
    """As for a start just above the floor, the speed is reversed at t = 0; an upward start is in flight."""
    down, above, up = (
        gs.simulate(Ball, z_0=z, v_0=v, keeps=1.0, duration=0.1, every=0.1).iloc[-1]
        for z, v in ((0.0, -1.0), (1e-12, -1.0), (0.0, 1.0))
    )
    for end in (down, above, up):
        assert end["v"] == pytest.approx(1.0 - 0.1 * G, abs=1e-9)
        assert end["z"] == pytest.approx(0.1 - 0.005 * G, abs=1e-9)


class Wheel(DeclaredModel):
    """A rimless wheel on a slope: either neighbour of the stance spoke may land. It may stand on two spokes.

    Each jump puts the wheel on the surface of the other event.
    """

    alpha = parameter("rad", "half the angle between spokes", np.pi / 8.0)
    gamma = parameter("rad", "slope", 0.08)
    theta = variable("rad", "angle of the stance spoke", 0.0)
    rate = variable("rad/s", "its rate", 2.0, scale=1.0)
    stands = mode(False, "stands on two spokes")

    def flow(self, p, s):
        moves = jnp.where(s.stands, 0.0, 1.0)
        return {"theta": moves * s.rate, "rate": moves * G * jnp.sin(s.theta)}

    @event("next spoke lands", section=True, during=lambda s: ~s.stands)
    def forward(self, p, s):
        return s.theta - (p.gamma + p.alpha)

    @forward.jump
    def step(self, p, s):
        return s.replace(theta=p.gamma - p.alpha, rate=s.rate * jnp.cos(2.0 * p.alpha))

    @event("last spoke lands", section=True, during=lambda s: ~s.stands)
    def backward(self, p, s):
        return (p.gamma - p.alpha) - s.theta

    @backward.jump
    def back(self, p, s):
        return s.replace(theta=p.gamma + p.alpha, rate=s.rate * jnp.cos(2.0 * p.alpha))

    @forward.rest
    def stand(self, p, s):
        return s.replace(stands=True, rate=0.0)

    @backward.rest
    def stand_back(self, p, s):
        return s.replace(stands=True, rate=0.0)

    def period(self, p):
        return 1.0 + 0.0 * p.gamma


@pytest.mark.slow
def test_a_rimless_wheel_rolls_or_stops() -> None:
    """Its speed after a landing is cos(2 a) (4 g sin(a) sin(slope) / sin(2 a)^2)^(1/2) (McGeer 1990).

    A slow start on a small slope rocks between two spokes and comes to stand. `theta` jumps onto the other
    event's surface exactly, or off it by rounding.
    """
    alpha, gamma = np.pi / 8.0, 0.08
    speed = np.cos(2 * alpha) * np.sqrt(4 * G * np.sin(alpha) * np.sin(gamma)) / np.sin(2 * alpha)
    run = gs.Settle(max_cycles=300, tolerance=1e-8)
    rolls = gs.sweep(Wheel, start={"rate_0": {"values": [0.5, 1.0, 2.0]}}, run=run).table
    assert set(rolls["status"]) == {"settled"}
    np.testing.assert_allclose(rolls["rate_end"], speed, rtol=1e-7)
    still = gs.simulate(Wheel, gamma=0.01, rate_0=0.3, duration=12.0, every=12.0).iloc[-1]
    assert still["rate"] == 0.0
    assert abs(still["theta"] - 0.01) == pytest.approx(alpha, abs=1e-9)


class Resting(Ball):
    """The ball on a floor that shakes; it rests until the floor falls away faster than it."""

    amplitude = parameter("m", "amplitude of the floor", 0.0)
    phase = variable("rad", "phase of the floor", -0.5 * np.pi, observed=False)
    lies = mode(False, "lies on the floor")
    lifts = mode(0, "times that it was lifted")

    def flow(self, p, s):
        speed = 10.0 * p.amplitude * jnp.cos(s.phase)
        pull = -100.0 * p.amplitude * jnp.sin(s.phase)
        return {"z": jnp.where(s.lies, speed, s.v), "v": jnp.where(s.lies, pull, -G), "phase": 10.0}

    @event("lands", section=True, during=lambda s: ~s.lies)
    def landing(self, p, s):
        return p.amplitude * jnp.sin(s.phase) - s.z

    @landing.jump
    def bounce(self, p, s):
        floor = 10.0 * p.amplitude * jnp.cos(s.phase)
        return s.replace(v=floor - p.keeps * (s.v - floor))

    @landing.rest
    def lie(self, p, s):
        return s.replace(lies=True, z=p.amplitude * jnp.sin(s.phase), v=10.0 * p.amplitude * jnp.cos(s.phase))

    @event("is lifted", during=lambda s: s.lies)
    def lift(self, p, s):
        return 100.0 * p.amplitude * jnp.sin(s.phase) - G

    @lift.jump
    def fly(self, p, s):
        return s.replace(lies=False, lifts=s.lifts + 1)


@pytest.mark.slow
def test_a_ball_rests_where_its_bounces_accumulate_until_the_force_lifts_it() -> None:
    """On a still floor for ever; on one that shakes it flies where the floor's acceleration passes -g."""
    held = gs.sweep(Resting, keeps={"values": [0.0, 0.5, 0.9]}, run=gs.FixedTime(duration=20.0)).table
    assert set(held["status"]) == {"complete"}
    still = gs.simulate(Resting, keeps=0.5, duration=5.0, every=0.5)
    after = still.loc[still["t"] > 1.36]
    assert (after["z"].abs().max(), after["v"].abs().max()) == (0.0, 0.0)
    # 100 A = 2 g: the ball comes to lie, and is lifted at sin(phase) = 1/2, with the floor's speed there
    flight = gs.simulate(
        Resting, keeps=0.0, amplitude=2 * G / 100.0, z_0=-2 * G / 100.0, duration=0.4, every=0.01
    )
    lifted = (np.arcsin(0.5) + 0.5 * np.pi) / 10.0
    t = flight["t"].to_numpy()
    z, v = 2 * G / 100.0 * 0.5, 10.0 * 2 * G / 100.0 * np.cos(np.arcsin(0.5))
    true = np.where(
        t < lifted,
        2 * G / 100.0 * np.sin(10.0 * t - 0.5 * np.pi),
        z + v * (t - lifted) - 0.5 * G * (t - lifted) ** 2,
    )
    np.testing.assert_allclose(flight["z"], true, rtol=0, atol=1e-8)


class Cells(DeclaredModel):
    """Two cells charge to 1; one that fires goes to 0 and lifts the other, which fires too from 1 on."""

    drive = parameter("1", "drive", 1.2)
    eps = parameter("1", "pulse", 0.05)
    a = variable("1", "cell a", 0.0, scale=1.0)
    b = variable("1", "cell b", 0.0, scale=1.0)

    def flow(self, p, s):
        return {"a": p.drive - s.a, "b": p.drive - s.b}

    @event("a fires", section=True)
    def first(self, p, s):
        return s.a - 1.0

    @first.jump
    def fire_first(self, p, s):
        b = s.b + p.eps
        return s.replace(a=0.0, b=jnp.where(b >= 1.0, 0.0, b))

    @event("b fires")
    def second(self, p, s):
        return s.b - 1.0

    @second.jump
    def fire_second(self, p, s):
        a = s.a + p.eps
        return s.replace(b=0.0, a=jnp.where(a >= 1.0, 0.0, a))

    def period(self, p):
        return jnp.log(p.drive / (p.drive - 1.0))


def test_an_event_that_an_earlier_jump_removed_does_not_jump() -> None:
    """Cells that fire together stay together: their interval is ln(drive / (drive - 1))."""
    table = gs.sweep(Cells, start={"b_0": {"values": [0.0, 0.3, 0.9]}}, run=gs.ReturnMap(crossings=60)).table
    last = table[table["crossing"] >= 50]
    np.testing.assert_allclose(last["a_n"], 0.0, rtol=0, atol=1e-11)
    np.testing.assert_allclose(last["b_n"], 0.0, rtol=0, atol=1e-11)
    intervals = last.groupby("row")["t"].diff().dropna()
    np.testing.assert_allclose(intervals, np.log(1.2 / 0.2), rtol=0, atol=1e-10)


@dataclasses.dataclass(frozen=True)
class Dominoes(DeclaredModel):
    """A clock tips the first of N stones, each of which tips the next at the same instant, by one event."""

    N: int = 30

    unused = parameter("1", "a model has one parameter at least", 1.0)
    clock = variable("s", "clock", 0.0, observed=False)
    fallen = mode(0, "stones that have fallen")
    last = variable("1", "stones that fell at the last tick", 0.0)

    @property
    def longest_chain(self):
        return 80

    def flow(self, p, s) -> dict[str, Any]:
        return {"clock": 1.0, "last": 0.0}

    @event("the clock ticks", section=True)
    def tick(self, p, s):
        return s.clock - 1.0

    @tick.jump
    def tip(self, p, s):
        return s.replace(clock=0.0, fallen=1)

    @event("a stone tips the next", during=lambda s: s.fallen > 0, rising=False)
    def tips(self, p, s):
        return jnp.where(s.fallen > 0, 1.0, -1.0)

    @tips.jump
    def fall(self, p, s):
        whole = s.fallen >= self.N
        return s.replace(
            fallen=jnp.where(whole, 0, s.fallen + 1), last=jnp.where(whole, s.fallen, s.last).astype(float)
        )

    def period(self, p):
        return jnp.asarray(1.0)


@pytest.mark.slow
def test_longest_chain_limits_a_chain_of_events() -> None:
    end = gs.sweep(Dominoes(), run=gs.FixedTime(duration=3.5)).table.iloc[0]
    assert (end["status"], end["last_end"]) == ("complete", 30.0)
    short = type("Short", (Dominoes,), {"longest_chain": None})
    assert gs.sweep(short(), run=gs.FixedTime(duration=3.5)).table["status"].iloc[0] == "event_stall"


class Leap(DeclaredModel):
    """A guard that leaps from -1 to a small number above 0 where x passes 1; x' = 1."""

    unused = parameter("1", "a model has one parameter at least", 1.0)
    x = variable("1", "x", 0.3)

    def flow(self, p, s) -> dict[str, Any]:
        return {"x": 1.0}

    @event("leaps", section=True)
    def leap(self, p, s):
        return jnp.where(s.x >= 1.0, 1e-9 * s.x, -1.0)

    @leap.jump
    def back(self, p, s):
        return s.replace(x=s.x - 1.0)

    def period(self, p):
        return jnp.asarray(1.0)


def test_a_guard_that_leaps_is_located_by_bisection() -> None:
    t = gs.sweep(Leap, run=gs.ReturnMap(crossings=5)).table["t"].to_numpy()
    np.testing.assert_allclose(t[1:], 0.7 + np.arange(5), rtol=0, atol=1e-11)


class Switched(DeclaredModel):
    """x = sin(t); each crossing of 0, either way, begins the mode in which the other one may happen."""

    unused = parameter("1", "a model has one parameter at least", 1.0)
    x = variable("1", "x", 0.0)
    v = variable("1/s", "its rate", 1.0)
    rises = mode(False, "rises next")
    crossings = variable("1", "crossings", 0.0)

    def flow(self, p, s):
        return {"x": s.v, "v": -s.x, "crossings": 0.0}

    @event("falls through 0", section=True, during=lambda s: ~s.rises)
    def fall(self, p, s):
        return -s.x

    @fall.jump
    def below(self, p, s):
        return s.replace(rises=True, crossings=s.crossings + 1.0)

    @event("rises through 0", section=True, during=lambda s: s.rises)
    def rise(self, p, s):
        return s.x

    @rise.jump
    def above(self, p, s):
        return s.replace(rises=False, crossings=s.crossings + 1.0)

    def period(self, p):
        return jnp.asarray(2.0 * jnp.pi)


def test_an_event_that_becomes_possible_on_its_surface_is_armed_by_the_flow() -> None:
    table = gs.sweep(Switched, run=gs.ReturnMap(crossings=8)).table
    np.testing.assert_allclose(table["t"], np.pi * np.arange(9), rtol=0, atol=1e-8)
    np.testing.assert_array_equal(table["crossings_n"], np.arange(9))


class Twin(DeclaredModel):
    """Two balls, kicked at their landings by one clock; a spring pushes them apart."""

    section_coordinates = ("h", "v", "h2", "v2")
    kick = parameter("m/s", "kick", 1.4142351631324523)
    k = parameter("1/s2", "repulsion", 0.0)
    phi = variable("rad", "clock", 0.0, observed=False)
    h = variable("m", "height", 0.11896989121288715)
    v = variable("m/s", "speed", -2.0643955630350206)
    h2 = variable("m", "height 2", 0.11896989121288715)
    v2 = variable("m/s", "speed 2", -2.0643955630350206)

    def flow(self, p, s):
        push = p.k * (s.h - s.h2)
        return {"phi": 12.0, "h": s.v, "v": push - G, "h2": s.v2, "v2": -push - G}

    @event("1 lands")
    def landing(self, p, s):
        return -s.h

    @landing.jump
    def up(self, p, s):
        return s.replace(h=0.0, v=0.5 * jnp.abs(s.v) + p.kick * (1.0 + jnp.cos(s.phi)) / 2.0)

    @event("2 lands")
    def landing_2(self, p, s):
        return -s.h2

    @landing_2.jump
    def up_2(self, p, s):
        return s.replace(h2=0.0, v2=0.5 * jnp.abs(s.v2) + p.kick * (1.0 + jnp.cos(s.phi)) / 2.0)

    @event("turn", section=True)
    def turn(self, p, s):
        return s.phi - 2.0 * jnp.pi

    @turn.jump
    def wrap(self, p, s):
        return s.replace(phi=s.phi - 2.0 * jnp.pi)

    def complete(self, p, s):
        return s.replace(phi=0.0)

    def period(self, p):
        return jnp.asarray(2.0 * jnp.pi / 12.0)


@pytest.mark.slow
def test_each_event_of_an_instant_has_its_own_derivative_of_time() -> None:
    """Without the spring the balls are independent; with it, saltation matrices by hand give 3.3205 at k =
    10.

    The flip, where the multiplier passes -1, is at 6.1612.
    """
    for k, expected in (
        (0.0, [0.70711] * 4),
        (5.0, [0.70711] * 4),
        (10.0, [3.32055, 0.70711, 0.70711, 0.15058]),
    ):
        mapping = gs.return_map(Twin, k=k)
        result = mapping.fixed_points({})
        sizes = np.sort(np.abs(mapping.multipliers(result)[0]))[::-1]
        np.testing.assert_allclose(sizes, expected, rtol=0, atol=2e-5)
        x = result.points.at[0]
        steps = 1e-6 * np.eye(4)
        differences = np.stack([(mapping(x + e) - mapping(x - e)) / 2e-6 for e in steps], axis=1)
        # second derivatives jump where the balls come apart, so differences are of first order
        np.testing.assert_allclose(mapping.jacobian(x), differences, rtol=0, atol=5e-5)
    branch = gs.return_map(Twin).continue_({}, "k", [0.0, 10.0], towards=1)
    (flip,) = branch.loc[branch["special"] == "flip", "k"]
    assert flip == pytest.approx(6.1612, abs=1e-4)


class Clocks(DeclaredModel):
    """Two clocks that tick at the same instant: the section is that of the first, the other turns z over."""

    section_coordinates = ("d", "z")
    k = parameter("1/s", "rate of decay", 0.3)
    c = variable("s", "first clock", 0.0, observed=False)
    d = variable("s", "second clock", 0.0)
    z = variable("1", "driven by the second clock", 1.0)

    def flow(self, p, s):
        return {"c": 1.0, "d": 1.0, "z": s.d - p.k * s.z}

    @event("first ticks", section=True)
    def first(self, p, s):
        return s.c - 1.0

    @first.jump
    def again(self, p, s):
        return s.replace(c=s.c - 1.0)

    @event("second ticks")
    def second(self, p, s):
        return s.d - 1.0

    @second.jump
    def turn(self, p, s):
        return s.replace(d=s.d - 1.0, z=-0.5 * s.z)

    def complete(self, p, s):
        return s.replace(c=0.0)

    def period(self, p):
        return jnp.asarray(1.0)


@pytest.mark.slow
def test_a_section_that_is_crossed_at_the_instant_of_another_event_is_read_at_its_own_time() -> None:
    """The closed solution: the second clock ticks at 1 - d, the section is crossed at 1."""
    k = 0.3

    def drifted(d, z, t):  # z' = d + t - k z
        return (z - d / k + 1.0 / k**2) * jnp.exp(-k * t) + (d + t) / k - 1.0 / k**2

    def image(x):
        return jnp.stack([x[0], drifted(0.0, -0.5 * drifted(x[0], x[1], 1.0 - x[0]), x[0])])

    x = jnp.array([0.0, 1.0])
    mapping = gs.return_map(Clocks)
    np.testing.assert_allclose(mapping(np.asarray(x)), image(x), rtol=0, atol=1e-9)
    np.testing.assert_allclose(mapping.jacobian(np.asarray(x)), jax.jacfwd(image)(x), rtol=0, atol=1e-8)


@pytest.mark.slow
def test_a_placed_point_is_armed_by_its_own_place() -> None:
    """Its flags do not depend on the default start's: the map of an array is that of start values."""
    mapping = gs.return_map(Twin, k=1.0)
    x = np.array([0.3, -0.4, 0.0, 1.0])
    named = mapping(dict(zip(("h_0", "v_0", "h2_0", "v2_0"), x[:, None], strict=True)))
    np.testing.assert_allclose(mapping(x), named.at[0], rtol=0, atol=1e-12)


class Teeth(DeclaredModel):
    """A wheel that counts its teeth, and a pulse of area 1 in each turn of 2 s."""

    teeth = parameter("1", "teeth", 100.0)
    width = parameter("s", "width of the pulse", 0.01)
    clock = variable("s", "clock", 0.001, observed=False)
    count = variable("1", "teeth so far", 0.0)
    u = variable("1", "driven by the pulse", 0.0)

    def flow(self, p, s):
        on = (s.clock > 1.0) & (s.clock < 1.0 + p.width)
        return {"clock": 1.0, "count": 0.0, "u": -s.u + jnp.where(on, 1.0 / p.width, 0.0)}

    @event("a tooth passes")
    def tooth(self, p, s):
        return jnp.sin(p.teeth * jnp.pi * s.clock)

    @tooth.jump
    def add(self, p, s):
        return s.replace(count=s.count + 1.0)

    @event("a turn", section=True)
    def turn(self, p, s):
        return s.clock - 2.0

    @turn.jump
    def back(self, p, s):
        return s.replace(clock=s.clock - 2.0)

    def period(self, p):
        return jnp.asarray(2.0)


@pytest.mark.slow
def test_teeth_and_pulses_shorter_than_a_step_are_met() -> None:
    teeth, width = np.array([3.0, 30.0, 50.0, 64.0, 100.0]), np.array([0.005, 0.01, 0.015, 0.002, 1e-4])
    axes = {"teeth": {"values": teeth}, "width": {"values": width}}
    table = gs.sweep(Teeth, zip=axes, run=gs.ReturnMap(crossings=8)).table
    last = table[table["crossing"] == 8]
    np.testing.assert_array_equal(last["count_n"], 8 * teeth)
    forever = np.exp(-(1 - width)) * (1 - np.exp(-width)) / width / (1 - np.exp(-2.0))
    np.testing.assert_allclose(last["u_n"], forever * (1 - np.exp(-16.0)), rtol=2e-6)


class Saw(DeclaredModel):
    """x grows by 1 a second and is set to 0 at a threshold."""

    c = parameter("1", "threshold", 1.0)
    x = variable("1", "x", 0.0, observed=False)
    last = variable("1", "x at the last reset", 0.0)

    def flow(self, p, s) -> dict[str, Any]:
        return {"x": 1.0, "last": 0.0}

    @event("reset", section=True)
    def reached(self, p, s):
        return s.x - p.c

    @reached.jump
    def reset(self, p, s):
        return s.replace(last=s.x, x=0.0)

    def period(self, p):
        return 1.0 + 0.0 * p.c


@pytest.mark.slow
def test_a_threshold_on_a_ramp_is_that_of_the_event_s_time() -> None:
    table = gs.sweep(Saw, run=gs.Ramp(parameter="c", path=[1.0, 0.2], rate=0.05)).table
    (first,) = table.loc[table["crossing"] == 1, "t"]
    assert first == pytest.approx(1.0 / 1.05, abs=1e-11)
    crossed = table[table["crossing"] > 0]
    np.testing.assert_allclose(crossed["last_n"], crossed["c"], rtol=0, atol=1e-11)


class Drum(DeclaredModel):
    """A strobe of the time since the start, whose interval a ramp may lengthen."""

    interval = parameter("s", "interval of the strobe", 1.0)
    t = gs.time()
    angle = variable("rad", "angle", 0.0)
    strobe = gs.instants("strobe", every=lambda p: p.interval, section=True)

    def flow(self, p, s) -> dict[str, Any]:
        return {"t": 1.0, "angle": 1.0}

    def period(self, p):
        return p.interval


@pytest.mark.slow
def test_an_event_that_a_ramp_moves_away_happens_once() -> None:
    """The guard of its time is that of the next step's beginning: the event is not met once more."""
    run = gs.Ramp(parameter="interval", path=[1.0, 1.2], rate=0.002)
    table = gs.sweep(Drum, run=run, verify=0).table
    turns = table["t"] / table["interval"]
    np.testing.assert_allclose(turns, np.arange(len(table)), rtol=0, atol=1e-10)
    assert len(table) == 84


class Oscillator(DeclaredModel):
    """A harmonic oscillator; its section is x rising through 0."""

    f = parameter("Hz", "frequency", 1.0)
    x = variable("1", "x", 1.0, scale=1.0)
    v = variable("1", "velocity over the angular frequency", 0.0, scale=1.0)

    def flow(self, p, s):
        return {"x": 2 * jnp.pi * p.f * s.v, "v": -2 * jnp.pi * p.f * s.x}

    @event("x rises through 0", section=True)
    def up(self, p, s):
        return s.x

    def period(self, p):
        return 1.0 / p.f


def test_time_has_no_unit_of_its_own() -> None:
    """From 1e-6 Hz to 1 THz."""
    f = np.array([1e-6, 1.0, 1e6, 1e9, 1e12])
    end = gs.sweep(Oscillator, f={"values": f}, run=gs.Settle(max_cycles=50)).table
    assert set(end["status"]) == {"settled"}
    np.testing.assert_allclose(end["x_end"], 0.0, rtol=0, atol=1e-10)
    np.testing.assert_allclose(end["t_end"] * f, end["t_end"].iloc[1], rtol=1e-9)
