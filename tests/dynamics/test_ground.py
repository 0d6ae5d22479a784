"""Uneven ground: its heights on all engines, a walker on it against SciPy, and what jobs may say."""

from __future__ import annotations

import types
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy

import gaitsweep as gs
from gaitsweep.dynamics.ground import RISER
from gaitsweep.dynamics.random_numbers import fraction
from gaitsweep.engine.kernel import cuda_lanes
from gaitsweep.engine.kernel.row_functions import over_rows
from gaitsweep.engine.numerics import Numerics
from gaitsweep.engine.recorders.recordings import CrossingRecorder
from gaitsweep.examples.compass_walker import CompassWalker
from gaitsweep.examples.hopper import Hopper
from gaitsweep.examples.slip_runner import SlipRunner
from gaitsweep.job import JobError
from tests.support.host_card import HostCard, compiler
from tests.support.planar_body import planar_body
from tests.support.sweeping import run_rows, same

WIDTH = 0.4
EVEN_TO_ONE_STEP = np.array([-3.0, -0.1, 0.0])


def drawn(kind: str, seed: Any, roughness: float, x: Any) -> Any:
    """The height at places x in NumPy: normal numbers at multiples of the width, and smooth rises."""

    def at(index: Any) -> Any:
        seeds, places, streams = np.broadcast_arrays(seed, index, 0.0)
        u, v = (fraction(seeds, places, streams, half) for half in (0, 1))
        return np.where(index > 0, roughness * np.sqrt(-2.0 * np.log(u)) * np.cos(2.0 * np.pi * v), 0.0)

    index, share = np.floor(x / WIDTH), x / WIDTH - np.floor(x / WIDTH)
    if kind == "steps":
        share = np.clip((share - 1.0 + RISER) / RISER, 0.0, 1.0)
    return at(index) + (at(index + 1.0) - at(index)) * share**2 * (3.0 - 2.0 * share)


def height(kind: str) -> Any:
    """The height of a kind of ground, as a function of a row's seed and a place."""

    def of(seed: Any, x: Any) -> Any:
        values = {"ground_seed": seed, "ground_roughness": 0.02, "ground_width": WIDTH, "ground_slope": 3.0}
        return gs.Ground.of(kind, {**values, "ground_start": 0.5})(x)

    return of


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["steps", "rough"])
def test_heights_are_those_of_numpy_on_each_engine(kind: str) -> None:
    """Logarithms and cosines of an engine's own agree to rounding, and so do heights of 2 cm."""
    seed, x = np.repeat([3.0, 4.0], 200), np.tile(np.linspace(-1.0, 9.0, 200), 2)
    expected = drawn(kind, seed, 0.02, x)
    for found in (height(kind)(seed, x), over_rows(height(kind), all_rows=True)(seed, x)):
        np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-14)
    assert not expected[x <= 0.0].any()
    assert np.std(expected[x > WIDTH]) > 0.01
    assert np.abs(expected[:200] - expected[200:]).max() > 0.01


@pytest.mark.slow
def test_slopes_and_profiles_are_what_they_say(tmp_path: Path) -> None:
    x = np.array([-1.0, 0.5, 2.0])
    np.testing.assert_allclose(
        height("slope")(0.0, x), np.tan(np.radians(3.0)) * np.maximum(x, 0.0), rtol=1e-15
    )
    file = tmp_path / "heights.csv"
    file.write_text("x,z\n0,0.1\n1,0.2\n1.5,0.0\n")
    profile = gs.ground_profile(file)
    # rows start at 0.5 of the profile, where its height is 0.15
    at = np.interp(x + 0.5, [0.0, 1.0, 1.5], [0.1, 0.2, 0.0]) - 0.15
    np.testing.assert_allclose(height(profile)(0.0, x), np.where(x > 0.0, at, 0.0), atol=1e-16)
    job = {"name": "g", "model": "gaitsweep.examples.slip_runner:SlipRunner", "run": {"kind": "settle"}}
    by_file = gs.Job.model_validate({**job, "ground": {"file": str(file)}})
    assert by_file.resolved()["structure"] == {"ground": profile}
    assert gs.Job.model_validate(by_file.resolved()).hash() == by_file.hash()
    # a job without the key is the one that it was before models asked for the ground
    assert gs.Job.model_validate(job).resolved()["structure"] == {}


def test_no_point_of_a_file_is_lost_or_taken_for_names(tmp_path: Path) -> None:
    file = tmp_path / "heights.csv"
    expected = "profile 0.0 0.1 1.0 0.2"
    for text in ("0,0.1\n1,0.2\n", "x,z\n0,0.1\n1,0.2\n", "\n\nx,z\n\n0,0.1\n1,0.2\n"):
        for encoding in ("utf-8", "utf-8-sig"):
            file.write_text(text, encoding=encoding)
            assert gs.ground_profile(file) == expected
    for text, reason in (
        ("0,0\n", "1 points"),
        ("0,0\n0,1\n", "increase"),
        ("a,b\n0\n", "line 2"),
        ("0,0,0\n1,0\n2,0\n", "line 1 is 0,0,0"),
        ("0,x\n1,0\n2,0\n", "line 1 is 0,x"),
        ("x,y,z\n1,0\n2,0\n", "line 1"),
        ("0;0\n1,0\n2,0\n", "line 1"),
        ("x,z\n\n0,0\n\n1;2\n", "line 5 is 1;2"),
    ):
        file.write_text(text)
        with pytest.raises(gs.ArgumentError, match=reason):
            gs.ground_profile(file)


@pytest.mark.parametrize(
    ("model", "ground", "reason"),
    [
        ("compass_walker:CompassWalker", "stps", "stps.*did you mean steps"),
        ("compass_walker:CompassWalker", {"path": "a.csv"}, "file: PATH"),
        ("compass_walker:CompassWalker", {"file": "nothing.csv"}, "nothing.csv"),
        ("hopper:Hopper", "steps", "does not ask for the height of the ground"),
    ],
)
def test_a_wrong_ground_is_refused(model: str, ground: Any, reason: str) -> None:
    fields = {"name": "g", "model": f"gaitsweep.examples.{model}", "run": {"kind": "settle"}}
    with pytest.raises(JobError, match=reason) as refused:
        gs.Job.model_validate({**fields, "ground": ground})
    assert [diagnostic.path for diagnostic in refused.value.diagnostics] == [("ground",)]
    assert "ground_seed" not in {quantity.name for quantity in Hopper().parameters}


def test_the_ground_cannot_vary_in_a_job() -> None:
    fields = {"name": "g", "model": "gaitsweep.examples.compass_walker:CompassWalker"}
    with pytest.raises(JobError, match=r"vary.ground .*cannot vary: set it as ground: KIND"):
        gs.Job.model_validate({**fields, "run": {"kind": "settle"}, "vary": {"ground": ["slope", "steps"]}})


def test_no_fixed_point_is_sought_on_uneven_ground() -> None:
    gait = gs.return_map(CompassWalker(ground="rough"), ground_roughness=0.001)
    with pytest.raises(gs.ArgumentError, match="no step repeats another"):
        gait.fixed_points([-0.2187, 1.0918, 0.3772])
    run = {"kind": "continuation", "parameter": "slope", "path": [2.0, 3.0]}
    job = {"name": "g", "model": "gaitsweep.examples.compass_walker:CompassWalker", "run": run}
    with pytest.raises(JobError, match="no step repeats another"):
        gs.Job.model_validate({**job, "ground": "rough"})


@pytest.mark.slow
@pytest.mark.skipif(compiler() is None, reason="no C++ compiler")
def test_the_program_for_a_card_meets_the_same_ground(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The C of a card, compiled for this processor, beside its kernels: rounding, grown over six strikes."""

    class CudaDevice(HostCard):
        folder = tmp_path

    model, recorder = CompassWalker(ground="steps"), CrossingRecorder(CompassWalker(ground="steps"), 6)
    params = {"ground_seed": np.arange(6.0), "ground_roughness": np.full(6, 0.001)}
    start = {"stance_0": np.full(6, -0.2187)}
    numerics = Numerics(rtol=1e-10, atol=1e-11)
    rows = partial(run_rows, model, recorder, start, params=params, numerics=numerics)
    here = rows()
    monkeypatch.setattr(cuda_lanes, "CudaDevice", CudaDevice)
    device = types.SimpleNamespace(platform="gpu")
    monkeypatch.setattr("tests.support.sweeping.devices_on", lambda platform, engine: [device])
    on_card = rows(lanes=5)
    np.testing.assert_array_equal(on_card.owner, here.owner)
    np.testing.assert_allclose(on_card.samples, here.samples, rtol=0.0, atol=1e-9)
    same(on_card, rows(lanes=3, block=4))


def walked(kind: str, seed: float, roughness: float, most: int) -> list[float]:
    """The rates of the stance leg after the strikes of the walker, by SciPy, until it trips or falls."""
    heights = drawn(kind, seed, roughness, WIDTH * np.arange(60.0))

    def ground(x: float) -> float:
        index, share = int(np.floor(x / WIDTH)), x / WIDTH - np.floor(x / WIDTH)
        share = np.clip((share - 1.0 + RISER) / RISER, 0.0, 1.0) if kind == "steps" else share
        low, high = (heights[max(k, 0)] for k in (index, index + 1))
        return low + (high - low) * share**2 * (3.0 - 2.0 * share)

    m, hip, a, b, g, slope = 5.0, 10.0, 0.5, 0.5, 9.81, np.radians(3.0)
    total = a + b

    def inertia(between: float) -> Any:
        coupling = -m * total * b * np.cos(between)
        return np.array([[(hip + m) * total**2 + m * a**2, coupling], [coupling, m * b**2]])

    def flow(_: float, y: Any) -> Any:
        stance, swing, stance_rate, swing_rate = y
        sine = m * total * b * np.sin(stance - swing)
        weight = (hip * total + m * (2.0 * a + b)) * g
        torque = [weight * np.sin(stance) + sine * swing_rate**2]
        torque.append(-m * b * g * np.sin(swing) - sine * stance_rate**2)
        return [stance_rate, swing_rate, *np.linalg.solve(inertia(stance - swing), torque)]

    foot, y, rates = 0.0, np.array([-0.2187, 2.0 * slope + 0.2187, 1.0918, 0.3772]), []
    for _ in range(most):

        def ahead(y: Any) -> Any:
            return total * (np.sin(y[0]) - np.sin(y[1]))

        def clearance(_: float, y: Any, foot: float = foot) -> float:
            """The slope of the line between the feet above the ground's own; behind it cannot strike."""
            at = ahead(y)
            rise = total * (np.cos(y[0]) - np.cos(y[1])) - ground(foot + at) + ground(foot)
            return rise / at + np.tan(slope) if at > 1e-3 else 1.0

        def falls(_: float, y: Any) -> float:
            return 0.5 * np.pi - abs(y[0])

        clearance.terminal, clearance.direction, falls.terminal = True, -1.0, True  # type: ignore[attr-defined]
        step = scipy.integrate.solve_ivp(
            flow, (0.0, 5.0), y, "DOP853", events=[clearance, falls], rtol=1e-10, atol=1e-11, max_step=0.02
        )
        if not step.t_events[0].size or ahead(step.y_events[0][0]) < 2e-3:
            break
        y = step.y_events[0][0]
        foot = foot + ahead(y)
        c, ab = np.cos(y[0] - y[1]), m * a * b
        whole = (hip * total**2 + 2.0 * m * a * total) * c * y[2] - ab * (y[2] + y[3])
        mass = inertia(y[0] - y[1])
        after = np.linalg.solve([mass.sum(axis=0), mass[1]], [whole, -ab * y[2]])
        y = np.array([y[1], y[0], *after])
        rates.append(y[2])
    return rates


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "engine"), [("steps", "kernel"), ("rough", "kernel"), ("rough", "xla")])
def test_a_walker_meets_the_ground_as_in_scipy(kind: str, engine: str) -> None:
    """Errors of 1e-11 grow along a walk that is about to fall; 1e-7 would show a foothold 1 um off."""
    seeds = np.array([0.0, 3.0])
    table = gs.sweep(
        CompassWalker(ground=kind), ground_seed=seeds, ground_roughness=0.002, ground_width=WIDTH,
        run=gs.ReturnMap(crossings=8), numerics={"rtol": 1e-11, "atol": 1e-12}, engine=engine, verify=0,
    ).table  # fmt: skip
    for seed in seeds:
        expected = walked(kind, seed, 0.002, 8)
        own = (table["ground_seed"].to_numpy() == seed) & (table["crossing"].to_numpy() > 0)
        rates = table["stance_rate_n"].to_numpy()[own]
        assert len(expected) > 3
        np.testing.assert_allclose(rates[: len(expected)], expected, rtol=0.0, atol=1e-7)


@pytest.mark.slow
def test_the_ground_of_a_row_does_not_depend_on_other_rows_lanes_or_blocks() -> None:
    run, model = gs.ReturnMap(crossings=8), CompassWalker(ground="steps")
    values = {"ground_seed": np.arange(6), "ground_roughness": 0.002}
    table = gs.sweep(model, **values, run=run, verify=0, engine="kernel").table
    others = gs.sweep(model, **values, run=run, verify=0, engine={"name": "kernel", "lanes": 3, "block": 2})
    assert table.equals(others.table)
    alone = gs.sweep(model, **{**values, "ground_seed": 4}, run=run, verify=0, engine="kernel").table
    shared = ["t", "stance_rate_n", "step_length_n"]
    np.testing.assert_array_equal(alone[shared], table[table["ground_seed"] == 4][shared])


@pytest.mark.slow
def test_a_runner_keeps_its_energy_on_any_ground_and_falls_where_it_is_rough() -> None:
    run = gs.ReturnMap(crossings=30)
    values = {"ground_roughness": [0.0, 0.001, 0.03], "ground_seed": np.arange(20)}
    table = gs.sweep(SlipRunner(ground="rough"), **values, run=run, verify=0).table
    assert np.ptp(table["energy_n"].to_numpy()) < 1e-4
    roughness, crossing = table["ground_roughness"].to_numpy(), table["crossing"].to_numpy()
    made = {
        rough: [
            crossing[(roughness == rough) & (table["ground_seed"].to_numpy() == seed)].max()
            for seed in range(20)
        ]
        for rough in (0.0, 0.001, 0.03)
    }
    assert set(made[0.0]) == {30}
    assert np.median(made[0.001]) > np.median(made[0.03]) + 3


BALL = """<mujoco><worldbody><geom type="plane" size="9 9 .1" pos="0 0 .02"/>
  <body pos="0 0 .02"><joint name="x" type="slide" axis="1 0 0"/><joint name="z" type="slide" axis="0 0 1"/>
    <joint name="turn" axis="0 1 0"/><geom name="ball" size=".05" mass="1"/></body></worldbody></mujoco>"""
RADIUS, STIFFNESS, DAMPING, FRICTION, GRIP = 0.05, 2e4, 20.0, 0.4, 30.0
SOFT: dict[str, Any] = {
    "ball_contact_stiffness": STIFFNESS, "ball_contact_damping": DAMPING, "ball_friction": FRICTION,
    "ball_grip": GRIP,
}  # fmt: skip
PROFILE = "0,0\n0.3,0\n0.8,0.05\n1.2,-0.01\n"
EXACT = {"method": "tsit5", "rtol": 1e-11, "atol": 1e-12}


Ball = planar_body(BALL)


def relief(kind: str) -> Any:
    """The height and the slope of a ground at a place, as a body meets it, in NumPy."""
    heights = drawn(kind, 3.0, 0.01, WIDTH * np.arange(60.0))
    # place, and change of the slope, of each bend, which is rounded over 1 cm on both sides
    bends = {"slope": [(0.0, np.tan(np.radians(3.0)))], "file": [(0.3, 0.1), (0.8, -0.25), (1.2, 0.15)]}

    def of_bends(x: float) -> tuple[float, float]:
        inside = [(change, np.clip(x - at + 0.01, 0.0, 0.02), x - at) for at, change in bends[kind]]
        height = sum(c * (u * u / 0.04 + max(beyond - 0.01, 0.0)) for c, u, beyond in inside)
        return height, sum(c * u / 0.02 for c, u, _ in inside)

    def of_draws(x: float) -> tuple[float, float]:
        index, share = int(np.floor(x / WIDTH)), x / WIDTH - np.floor(x / WIDTH)
        by_place = 1.0 / WIDTH
        if kind == "steps":
            by_place *= float(share > 1.0 - RISER) / RISER
            share = np.clip((share - 1.0 + RISER) / RISER, 0.0, 1.0)
        low, high = (heights[max(k, 0)] for k in (index, index + 1))
        rise = high - low
        return low + rise * share**2 * (3.0 - 2.0 * share), 6.0 * rise * share * (1.0 - share) * by_place

    return of_bends if kind in bends else of_draws


def bounced(kind: str, start: list[float], duration: float) -> tuple[Any, int]:
    """The end (x, z, turn, rates) of a ball's motion by SciPy, and how often it met or left the ground."""
    ground = relief(kind)

    def contact(y: Any) -> Any:
        """Depth and its rate, normal, place of the contact from the centre, and the ball's velocity there."""
        height, slope = ground(y[0])
        normal = np.array([-slope, 1.0]) / np.hypot(slope, 1.0)
        depth = RADIUS - normal[1] * (y[1] - height)
        place = -normal * (RADIUS - 0.5 * depth)
        speed = np.array([y[3] + y[5] * place[1], y[4] - y[5] * place[0]])
        return depth, -normal @ speed, normal, place, speed

    def flying(_: float, y: Any) -> list[float]:
        return [*y[3:], 0.0, -9.81, 0.0]

    def touching(_: float, y: Any) -> list[float]:
        depth, rate, normal, place, speed = contact(y)
        load, slip = STIFFNESS * depth + DAMPING * rate, speed + rate * normal
        limit = FRICTION * load
        force = load * normal - limit * slip / np.sqrt(slip @ slip + (limit / GRIP) ** 2 + 1e-8)
        torque = place[1] * force[0] - place[0] * force[1]
        return [*y[3:], force[0], force[1] - 9.81, torque / (0.4 * RADIUS**2)]

    def pushes(_: float, y: Any) -> float:
        depth, rate = contact(y)[:2]
        return min(depth, depth + DAMPING / STIFFNESS * rate)

    pushes.terminal = True  # type: ignore[attr-defined]
    t: Any = 0.0
    y, events = np.array(start), 0
    while t < duration:
        pushes.direction = -1.0 if events % 2 else 1.0  # type: ignore[attr-defined]
        flow = touching if events % 2 else flying
        piece = scipy.integrate.solve_ivp(
            flow, (t, duration), y, "DOP853", events=pushes, rtol=1e-11, atol=1e-12, max_step=2e-3
        )
        t, y = piece.t[-1], piece.y[:, -1]
        events += t < duration
    return y, events


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["slope", "steps", "rough", "file"])
def test_a_ball_bounces_on_the_ground_as_in_scipy(kind: str, tmp_path: Path) -> None:
    """Twenty events, with slip and spin; a normal that ignored the slope would be off by centimetres."""
    ground = kind
    if kind == "file":
        (tmp_path / "heights.csv").write_text(PROFILE)
        ground = gs.ground_profile(tmp_path / "heights.csv")
    values = {"slope": {"ground_slope": 3.0}, "file": {}}.get(
        kind, {"ground_seed": 3.0, "ground_roughness": 0.01, "ground_width": WIDTH}
    )
    start = {"x_0": -0.2, "z_0": 0.15, "x_rate_0": 0.9, "turn_rate_0": 5.0}
    options: dict[str, Any] = {**values, **start, **SOFT, "numerics": EXACT}
    trace = gs.simulate(Ball(ground=ground), duration=1.5, every=1.5, **options)
    expected, events = bounced(kind, [-0.2, 0.15, 0.0, 0.9, 0.0, 5.0], 1.5)
    assert events > 15
    assert expected[0] > 0.6
    end = trace[["q_0", "q_1", "q_2"]].to_numpy()[-1]
    np.testing.assert_allclose(end * [1.0, 1.0, RADIUS], expected[:3] * [1.0, 1.0, RADIUS], rtol=0, atol=1e-8)


@pytest.mark.slow
def test_a_slope_of_the_ground_is_gravity_that_is_turned() -> None:
    """The same motion in axes of the world and of the slope; it begins beyond the rounded bend at x = 0."""
    angle = np.radians(5.0)
    turned = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    start, speed = turned @ [0.3, 0.12], turned @ [0.4, -0.2]
    options: dict[str, Any] = {**SOFT, "duration": 0.6, "every": 0.02, "numerics": EXACT}
    world: dict[str, Any] = {"x_0": start[0], "z_0": start[1], "x_rate_0": speed[0], "z_rate_0": speed[1]}
    on_slope = gs.simulate(Ball(ground="slope"), ground_slope=5.0, **world, **options)
    slope: dict[str, Any] = {"x_0": 0.3, "z_0": 0.12, "x_rate_0": 0.4, "z_rate_0": -0.2}
    in_turned_gravity = gs.simulate(Ball(), slope=-angle, **slope, **options)
    assert np.ptp(in_turned_gravity["q_1"]) > 0.03
    own = in_turned_gravity[["q_0", "q_1"]].to_numpy() @ turned.T
    np.testing.assert_allclose(on_slope[["q_0", "q_1"]], own, rtol=0.0, atol=1e-10)
    np.testing.assert_allclose(on_slope["q_2"], in_turned_gravity["q_2"], rtol=0.0, atol=1e-9)


def test_uneven_ground_needs_a_level_plane_and_located_contacts() -> None:
    inclined = BALL.replace('pos="0 0 .02"/>', 'pos="0 0 .02" euler="0 20 0"/>', 1)
    assert planar_body(inclined)().parameters
    with pytest.raises(ValueError, match="ground is rough, which lies on level planes"):
        _ = planar_body(inclined)(ground="rough").parameters
    job = {"name": "g", "run": {"kind": "fixed_time", "duration": 1}, "ground": "rough"}
    stepped = "gaitsweep.examples.mujoco_hopper:MujocoHopper"
    with pytest.raises(JobError, match=r"moves in steps.*dynamics: located"):
        gs.Job.model_validate({**job, "model": stepped})
