"""Sliding by declaration: stick-slip and rest by friction, beside closed forms."""

from __future__ import annotations

import re
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

import gaitsweep as gs
from gaitsweep.models.conformity import fault


class OnBelt(gs.DeclaredModel):
    """A block of 1 kg on a spring of 1 N/m and a belt of speed u, with static friction above the kinetic.

    The section is the end of a stick.
    """

    u = gs.parameter("m/s", "speed of the belt", 0.2, low=0.0)
    kinetic = gs.parameter("m/s2", "kinetic friction over the mass", 0.5, low=0.0)
    ratio = gs.parameter("1", "static friction over the kinetic one", 2.0, low=1.0)
    x = gs.variable("m", "stretch of the spring", 0.0)
    v = gs.variable("m/s", "speed", 0.2)
    slip = gs.sliding("block sticks", lambda p, s: s.v - p.u, static=lambda p: p.ratio)

    @slip.flow
    def flow(self, p: Any, s: Any) -> dict[str, Any]:
        return {"x": s.v, "v": -s.x - p.kinetic * s.slip}

    @gs.event("stretched", section=True)
    def stretched(self, p: Any, s: Any) -> Any:
        return s.x - 0.75 * p.kinetic * p.ratio

    def period(self, p: Any) -> Any:
        return 2.0 * jnp.pi


def stick_slip_period(u: float, kinetic: float, ratio: float) -> float:
    """The period of the block on its belt, in closed form.

    It slips from the stretch of static friction, as a harmonic motion about that of kinetic friction, until
    its speed is the belt's again, and sticks for the way back.
    """
    drop = kinetic * (ratio - 1.0)  # of the force, and from the middle of the motion
    slip = 2.0 * np.pi - 2.0 * np.arctan2(drop, u)
    # the motion about `kinetic` begins and ends at +drop and -drop from it
    return slip + 2.0 * drop / u


@pytest.mark.slow
@pytest.mark.parametrize("engine", ["kernel", "xla"])
def test_the_period_of_stick_slip(engine: str) -> None:
    belts = np.array([0.1, 0.2, 0.4])
    result = gs.sweep(
        OnBelt(),
        u=belts,
        v_0=0.0,
        run={"kind": "return_map", "crossings": 4},
        numerics={"method": "tsit5", "rtol": 1e-10, "atol": 1e-12},
        engine={"name": engine},
        verify=0,
    )
    assert set(result.table["status"]) == {"complete"}
    periods = result.table.groupby("row")["t"].agg(lambda t: t.iloc[-1] - t.iloc[-2])
    np.testing.assert_allclose(periods, [stick_slip_period(u, 0.5, 2.0) for u in belts], rtol=1e-8)


@pytest.mark.slow
def test_a_stick_forgets_the_past() -> None:
    """The return map has one value for all starts, so its multipliers are 0."""
    mapping = gs.return_map(OnBelt())
    cycle = mapping.fixed_points(mapping.settled({"v_0": 0.0}, cycles=3))
    assert np.max(np.abs(mapping.multipliers(cycle))) < 1e-9


class Damped(gs.DeclaredModel):
    """A block on a spring and on ground with Coulomb's friction; the section is each second."""

    friction = gs.parameter("m/s2", "friction over the mass", 0.2, low=0.0)
    x = gs.variable("m", "place", 2.5)
    v = gs.variable("m/s", "speed", 0.0)
    t = gs.time()
    slip = gs.sliding("block sticks", lambda p, s: s.v)
    tick = gs.instants("tick", every=lambda p: 1.0, section=True)

    @slip.flow
    def flow(self, p: Any, s: Any) -> dict[str, Any]:
        return {"x": s.v, "v": -s.x - p.friction * s.slip, "t": 1.0}

    def period(self, p: Any) -> Any:
        return 1.0


@pytest.mark.slow
def test_coulombs_friction_stops_a_block() -> None:
    """Each half swing loses twice the friction of the amplitude, until the spring is weaker than friction."""
    starts = np.array([-2.5, -1.3, -0.15, 0.05, 0.19, 0.25, 0.7, 1.0, 2.45, 3.1])
    table = gs.sweep(
        Damped(), x_0=starts, run={"kind": "fixed_time", "duration": 40.0},
        numerics={"method": "tsit5", "rtol": 1e-10, "atol": 1e-12}, verify=0,
    ).table  # fmt: skip
    rests = []
    for x in starts:
        while abs(x) > 0.2:
            x = -np.sign(x) * (abs(x) - 0.4)
        rests.append(x)
    np.testing.assert_allclose(table["x_end"], rests, atol=1e-8)
    np.testing.assert_allclose(table["v_end"], 0.0, atol=1e-12)


@pytest.mark.slow
def test_a_flow_that_crosses_goes_through() -> None:
    """Without an opposing flow behind it, the surface only switches the flow: x' = 1 below 0, 3 above."""

    class Through(gs.DeclaredModel):
        rate = gs.parameter("m/s", "mean rate", 2.0)
        x = gs.variable("m", "place", -1.0)
        side = gs.sliding("switches", lambda p, s: s.x)

        @side.flow
        def flow(self, p: Any, s: Any) -> dict[str, Any]:
            return {"x": p.rate + s.side}

        @gs.event("arrives", section=True)
        def arrives(self, p: Any, s: Any) -> Any:
            return s.x - 3.0

        def period(self, p: Any) -> Any:
            return 1.0

    table = gs.sweep(Through(), run={"kind": "settle", "max_cycles": 1}, x_0=[-1.0, 0.0, 1.0], verify=0).table
    np.testing.assert_allclose(table["t_end"], [2.0, 1.0, 2.0 / 3.0], rtol=1e-10)


class Carried(gs.DeclaredModel):
    """A block of 1 kg on a belt, on a spring that is too soft to pull it off."""

    u = gs.parameter("m/s", "speed of the belt", 0.0)
    stiffness = gs.parameter("1/s2", "stiffness of the spring over the mass", 0.01)
    x = gs.variable("m", "place", 0.0)
    v = gs.variable("m/s", "speed", 0.0)
    t = gs.time()
    slip = gs.sliding("block sticks", lambda p, s: s.v - p.u)
    tick = gs.instants("tick", every=lambda p: 1.0, section=True)

    @slip.flow
    def flow(self, p: Any, s: Any) -> dict[str, Any]:
        return {"t": 1.0, "x": s.v, "v": -p.stiffness * s.x - 3.0 * s.slip}

    def period(self, p: Any) -> Any:
        return 1.0


@pytest.mark.slow
def test_a_push_takes_a_block_off_its_belt() -> None:
    """A push by a brings the block forward until friction has stopped it: a harmonic motion about -F/k."""
    belt, friction, push, place = 0.2, 0.5, 0.1, 0.2
    period = stick_slip_period(belt, friction, 2.0)
    phase = 1.0 - (0.75 * 2.0 * friction - place) / belt / period
    table = gs.perturb(OnBelt(), ["v"], push_v=push, push_phase=phase, v_0=0.0, verify=0).table
    radius = np.hypot(place + friction, belt + push)
    turned = np.arctan2(belt + push, place + friction) - np.arcsin(belt / radius)
    ahead = (np.sqrt(radius**2 - belt**2) - friction - place) / belt - turned
    np.testing.assert_allclose(table["phase_shift"], ahead / period, atol=1e-7)

    mapping = gs.return_map(OnBelt())
    gait = mapping.fixed_points(mapping.settled({"v_0": 0.0}, cycles=3))
    small = mapping.phase_response(gait, ["x", "v"], phases=[phase])
    np.testing.assert_allclose(small["response_x"], 1.0 / belt / period, rtol=1e-7)
    np.testing.assert_allclose(small["response_v"], 0.0, atol=1e-9)


@pytest.mark.slow
def test_coordinates_of_a_map_have_the_side_on_which_they_lie() -> None:
    starts = np.array([[0.1, 0.0], [0.1, 1.0], [0.1, -1.0]])
    images = gs.return_map(Carried())(starts)
    rows = gs.sweep(Carried(), zip={"x_0": starts[:, 0], "v_0": starts[:, 1]}, run=gs.ReturnMap(crossings=1))
    ends = rows.table[rows.table["crossing"] == 1]
    np.testing.assert_allclose(images, ends[["x_n", "v_n"]], atol=1e-9)


@pytest.mark.slow
def test_a_block_follows_the_stairs_of_its_belt() -> None:
    stairs = gs.Staircase(parameter="u", path=[0.0, 0.2, 0.0], step=0.1, dwell=10.0)
    table = gs.sweep(Carried(), run=stairs, stiffness=0.0, verify=0).table
    np.testing.assert_allclose(table["v_n"], table["u"], atol=1e-9)
    # it loses u^2/(2 friction) where the belt becomes faster, and gains as much where it becomes slower
    np.testing.assert_allclose(table["x_n"].iloc[-1], 4.0, atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("run", "values", "says"),
    [
        (
            gs.Ramp(parameter="u", path=[0.0, 0.2], rate=0.1),
            {},
            r"over the surface of slip depends.*staircase",
        ),
        (
            gs.Trace(duration=1.0, every=0.5, parameter="u", path=[0.0, 0.2], rate=0.1),
            {},
            r"over the surface of slip depends.*staircase",
        ),
        (
            gs.Perturb(push=["v"], force=True),
            {"push_v": 0.1, "push_duration": 0.1},
            r"force is true.*does not feel the force",
        ),
    ],
)
def test_what_a_sliding_state_would_not_feel_is_refused(run: Any, values: dict[str, Any], says: str) -> None:
    with pytest.raises(gs.UserError, match=says):
        gs.sweep(Carried(), run=run, **values)


@pytest.mark.slow
def test_noise_across_a_surface_is_refused() -> None:
    """A state with noise in the height does not stay on the surface; other noise it may have."""
    noisy = {
        name: type("Noisy", (Carried,), {"noise": gs.diffusion(lambda self, p, s, name=name: {name: 0.1})})()
        for name in ("x", "v")
    }
    assert fault(noisy["x"]) is None
    assert re.search("intensity of v, with which a state leaves the surface of slip", fault(noisy["v"]) or "")


def test_a_flow_without_its_decorator_is_refused() -> None:
    with pytest.raises(TypeError, match=r"Half declares slip as sliding: write @slip\.flow above flow"):

        class Half(gs.DeclaredModel):
            x = gs.variable("m", "place", 0.0)
            slip = gs.sliding("sticks", lambda p, s: s.x)

            def flow(self, p: Any, s: Any) -> dict[str, Any]:
                return {"x": 1.0}

            @gs.event("arrives", section=True)
            def arrives(self, p: Any, s: Any) -> Any:
                return s.x
