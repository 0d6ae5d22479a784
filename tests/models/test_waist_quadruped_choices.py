"""Choices that the paper of the quadruped with a waist leaves open, each against an independent result."""

# MuJoCo's compiled modules come without types.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

import dataclasses
import math
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from reference.waist_quadruped_body import varied
from reference.waist_quadruped_located import landings
from scipy.integrate import solve_ivp

from gaitsweep.engine.numerics import Numerics
from gaitsweep.engine.recorders.recordings import CrossingRecorder
from gaitsweep.job import Job, JobError
from gaitsweep.papers.aoi2011.waist_quadruped import WaistQuadruped
from gaitsweep.papers.aoi2011.waist_quadruped.kinematics import (
    BEYOND,
    EARLY,
    HIP,
    KNEE,
    LATE,
    STANCE,
    SWINGS,
    FootPath,
    Swing,
    joint_angles,
    joint_rates,
)
from gaitsweep.papers.aoi2011.waist_quadruped.parameters import LIMBS, body, mjcf
from gaitsweep.papers.aoi2011.waist_quadruped.rhythm import desired_velocities
from gaitsweep.status import Status
from tests.support.sweeping import complete, run_rows, scalars

MODEL, HIGH = WaistQuadruped(), WaistQuadruped(heights="given")
BODIES = ("front", "rear")
QUICK = {"T_grow": 0.4, "T_hold": 0.7}  # D and h full after one cycle
STEPS = Numerics(dt=2e-4, method="semi_implicit")
HIPS = {
    "front_hip_x": 0.051, "rear_hip_x": 0.044, "front_hip_y": 0.047, "rear_hip_y": 0.052,
    "body_distance": 0.093,
}  # fmt: skip
HEIGHTS = {
    "front_height": 0.06,
    "rear_height": 0.045,
    "front_hip_z": -0.012,
    "rear_hip_z": 0.004,
    "waist_z": 0.007,
}
POSTURE = {"x_c_fore": 0.001, "x_c_hind": -0.003, "H_fore": 0.1335, "H_hind": 0.132}
GROUND = {"K_N": 2.9e4, "D_N": 150.0, "D_TL": 190.0, "D_rising": 0.4, "clamp": 1.0, "anchor_kept": 1.0}
RESET = {"gate": 0.7, "landing_actual": 0.15}
AEP, D, H, RISE, DIP = 0.5 * math.pi, 0.056, 0.133, 0.0393, 0.009


def observed(
    model: WaistQuadruped, params: dict[str, float], count: int, numerics: Numerics
) -> dict[str, np.ndarray]:
    """The observables (count,) at the first landings of limb 3."""
    recorder = CrossingRecorder(model, crossings=count)
    result = run_rows(
        model, recorder, {"delta_13": np.array([2.9])}, params=params, numerics=numerics, engine="kernel"
    )
    np.testing.assert_array_equal(result.status, Status.complete)
    table = result.samples.reshape(count + 1, -1)[1:, 2:]
    return dict(zip((q.name for q in model.observables), table.T, strict=True))


# ---- trajectories -----------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize(
    ("structure", "params"),
    [
        (
            {"swing": "sine", "damping": "rate_error"},
            {"swing_ease": 0.7, "sigma_1": 0.2, "sigma_2": 0.12, "hind_knees": 1.0, **GROUND},
        ),
        ({"swing": "two_cycloids"}, {"swing_ease": 1.2, "late_reset": 0.0, "fore_knees": 0.0, **POSTURE}),
        ({}, {**HIPS, **POSTURE, **GROUND, **RESET}),
        ({"heights": "given"}, {**HEIGHTS, **HIPS, "hind_knees": 1.0}),
        ({"swing": "ellipse", "slip": "coulomb"}, {"swing_ease": 0.8, "mu": 0.3, "T_slip": 5e-4, **HIPS}),
    ],
    ids=["sine", "two_cycloids", "parameters", "heights", "ellipse and slip"],
)
def test_landings_are_those_of_a_loop_in_mujoco(structure: dict[str, str], params: dict[str, float]) -> None:
    """Two cycles of the loop written from the model's page alone, with events located in both.

    Neither locates the kinks of `clamp`, `D_rising` and the cone of friction; damping by the error of rates
    is stiffer.
    """
    model = WaistQuadruped(**structure)
    near = 1e-5 if {"clamp", "mu"} & set(params) or "damping" in structure else 1e-6
    result = observed(model, {**QUICK, **params}, 2, Numerics(dt=2e-5, method="rk4"))
    values = {name: float(value[0]) for name, value in complete(model, {**QUICK, **params}, 1).items()}
    expected = landings(
        mjcf(), values, 2.9, 2, rtol=1e-9, swing=model.swing, damping=model.damping, slip=model.slip
    )
    phases = np.array([one.phases for one in expected])
    for name, (i, j) in {"delta_13": (0, 2), "delta_12": (0, 1), "delta_34": (2, 3)}.items():
        np.testing.assert_allclose(
            result[name], np.mod(phases[:, i] - phases[:, j], 2.0 * math.pi), atol=near
        )
    np.testing.assert_allclose(result["stride"], np.diff([0.0, *(one.x for one in expected)]), atol=near)
    for i in LIMBS:
        assert result[f"touchdowns_{i + 1}"].tolist() == [one.touchdowns[i] for one in expected]


@pytest.mark.slow
def test_small_steps_tend_to_located_events() -> None:
    """The error of semi-implicit Euler at a quarter of the step is below half of it: first order."""
    model = WaistQuadruped(swing="ellipse", slip="coulomb", damping="rate_error")
    params = {**HIPS, **POSTURE, **GROUND, **RESET, "mu": 0.3, "sigma_1": 0.2, "sigma_2": 0.12}
    exact, coarse, fine = (
        observed(model, {**QUICK, **params}, 4, numerics)["delta_13"]
        for numerics in (
            Numerics(dt=1e-4, method="rk4"), STEPS, Numerics(dt=5e-5, method="semi_implicit"),
        )
    )  # fmt: skip
    errors = [np.abs(steps - exact).max() for steps in (coarse, fine)]
    assert errors[1] < 0.5 * errors[0]
    assert errors[0] < 0.02


# ---- swing ------------------------------------------------------------------------------------------------


def path_of(swing: Swing, ease: float = 1.0) -> FootPath:
    numbers = (jnp.asarray(v) for v in (AEP, -0.0008, D, H, RISE, DIP, ease))
    return FootPath(*numbers, swing=swing)


@pytest.mark.parametrize("swing", SWINGS)
def test_every_swing_joins_the_extreme_positions(swing: Swing) -> None:
    """At the PEP, the top and the AEP; after the AEP without a landing the path returns to the PEP."""
    path = path_of(swing, 0.6)
    middle, back, ahead = -0.0008, -0.0008 - 0.5 * D, -0.0008 + 0.5 * D
    for phi, segment, x, z in (
        (0.0, EARLY, back, -H),
        (0.5 * AEP, LATE, middle, RISE - H),
        (AEP, LATE, ahead, -H),
        (AEP, BEYOND, ahead, -H),
        (0.5 * (AEP + 2.0 * math.pi), BEYOND, middle, -H - DIP),
        (2.0 * math.pi, BEYOND, back, -H),
        (2.0 * math.pi, STANCE, back, -H),
    ):
        result = path.target(jnp.asarray(phi), jnp.asarray(segment), (jnp.asarray(0.01), jnp.asarray(-0.13)))
        np.testing.assert_allclose(result, (x, z), atol=1e-15)


@pytest.mark.parametrize(
    ("swing", "ease", "x_speed", "z_speed"),
    [
        ("cycloid", 1.0, 0.0, 0.0),
        ("cycloid", 0.0, D, 0.0),
        ("sine", 0.4, 0.6 * D, -math.pi * RISE),
        ("two_cycloids", 1.0, 0.0, 0.0),
        ("ellipse", 1.0, 0.0, -math.pi * RISE),
        ("ellipse", 1.6, 0.0, -0.4 * math.pi * RISE),
        # that of the stance line, by which the feet go back: D (1 - beta) / beta for beta = 3/4
        ("cycloid", 4.0 / 3.0, -D / 3.0, 0.0),
    ],
)
def test_speeds_at_the_end_of_the_swing(swing: Swing, ease: float, x_speed: float, z_speed: float) -> None:
    """Speeds (m a swing) at the AEP, worked out by hand, against differences."""
    path, landing, e = path_of(swing, ease), (jnp.asarray(0.0), jnp.asarray(-H)), 1e-6
    late, soon = (
        np.array(path.target(jnp.asarray(AEP + s * AEP), jnp.asarray(LATE), landing)) for s in (e, -e)
    )
    np.testing.assert_allclose((late - soon) / (2.0 * e), (x_speed, z_speed), atol=1e-6)


def test_the_ellipse_is_one() -> None:
    path = path_of("ellipse")
    for phi in np.linspace(0.0, AEP, 9):
        x, z = path.target(jnp.asarray(phi), jnp.asarray(EARLY), (jnp.zeros(()), jnp.zeros(())))
        assert float(((x + 0.0008) / (0.5 * D)) ** 2 + ((z + H) / RISE) ** 2) == pytest.approx(1.0, abs=1e-12)


# ---- landing ----------------------------------------------------------------------------------------------


def landed(phase: float, **params: float) -> tuple[Any, Any, Any]:
    """Parameters, and the states before and after foot 3 touches down at a phase (share of phi_AEP)."""
    p = scalars(MODEL, **params)
    s = MODEL.init(p, {"delta_13": jnp.asarray(2.9)})
    segment = BEYOND if phase > 1.0 else LATE if phase > float(p.gate) else EARLY
    s = dataclasses.replace(
        s,
        clock=jnp.asarray(10.0),
        growing=jnp.asarray(False),
        phi=s.phi.at[2].set(phase * p.phi_AEP),
        segment=s.segment.at[2].set(segment),
        contact=s.contact.at[2].set(False),
        lifted=s.lifted.at[2].set(True),
        q=s.q.at[HIP[2]].add(0.05),
    )
    return p, s, MODEL.jump(p, s, jnp.zeros(10, bool).at[6].set(True))


@pytest.mark.slow
@pytest.mark.parametrize(("gate", "lands"), [(0.5, False), (0.3, True)])
def test_a_touchdown_is_a_landing_from_the_gate_on(gate: float, lands: bool) -> None:
    p, before, after = landed(0.4, gate=gate)
    assert (int(after.segment[2]) == STANCE) == lands
    assert float(after.phi[2]) == float(p.phi_AEP if lands else before.phi[2])


@pytest.mark.slow
def test_a_late_landing_without_a_reset_continues_along_the_line() -> None:
    """Phase and desired x are the same before and after the landing; a reset sets the phase back."""
    p, before, after = landed(1.6, late_reset=0.0)
    assert float(after.phi[2]) == float(before.phi[2])
    path = p.path(before.clock, before.growing)
    x = [path.target(s.phi, s.segment, (s.landing_x, s.landing_z))[0][2] for s in (before, after)]
    assert float(x[0]) == pytest.approx(float(x[1]), abs=1e-15)
    p, _, reset = landed(1.6)
    assert float(reset.phi[2]) == float(p.phi_AEP)
    p, _, early = landed(0.8, late_reset=0.0)
    assert float(early.phi[2]) == float(p.phi_AEP)


@pytest.mark.slow
def test_the_stance_line_begins_where_the_foot_is() -> None:
    """The actual foot by MuJoCo's kinematics, in the axes of its body; half way for a share of one half."""
    points = []
    for share in (0.0, 0.5, 1.0):
        _, before, after = landed(0.8, landing_actual=share)
        points.append((float(after.landing_x[2]), float(after.landing_z[2])))
    model = mujoco.MjModel.from_xml_string(mjcf())
    data = mujoco.MjData(model)
    data.qpos[:] = before.q
    mujoco.mj_kinematics(model, data)
    foot = data.site("foot_3").xpos - data.body("upper_3").xpos
    x, _, z = foot @ data.body("rear").xmat.reshape(3, 3)
    np.testing.assert_allclose(points[2], (x, z), atol=1e-14)
    np.testing.assert_allclose(points[1], 0.5 * (np.array(points[0]) + points[2]), atol=1e-15)
    assert abs(points[0][0] - x) > 1e-3


@pytest.mark.slow
@pytest.mark.parametrize("kept", [0.0, 1.0])
def test_a_foot_that_bounces_is_held_where_it_was_or_anew(kept: float) -> None:
    p = scalars(MODEL, anchor_kept=kept)
    s = MODEL.init(p, {"delta_13": jnp.asarray(2.9)})
    moved = dataclasses.replace(
        s, q=s.q.at[0].add(0.01), contact=jnp.zeros(4, bool), segment=jnp.array([STANCE, LATE, STANCE, EARLY])
    )
    after = MODEL.jump(p, moved, jnp.zeros(10, bool).at[4:8].set(True))
    by = np.where([kept > 0.0, False, kept > 0.0, False], 0.0, 0.01)
    np.testing.assert_allclose(after.anchor[:, 0] - s.anchor[:, 0], by, atol=1e-15)


# ---- ground -----------------------------------------------------------------------------------------------


def test_the_grounds_vertical_spring_and_damper_are_its_own() -> None:
    m = scalars(MODEL, K_N=1e4, D_N=50.0, D_rising=0.2).mechanics
    at = jnp.array([[1e-3, 2e-3, -1e-3]] * 4)
    speed = jnp.array([[0.1, 0.2, 0.3], [0.1, 0.2, -0.3], [0.0, 0.0, 0.0], [0.0, 0.0, 0.3]])
    forces = m.ground_forces(at, speed, jnp.zeros((4, 2)), jnp.array([True, True, True, False]))
    # K_TL = 36 000 N/m and D_TL = 175 N s/m along the ground
    wanted = [
        [-36.0 - 17.5, -72.0 - 35.0, 10.0 - 0.2 * 15.0],
        [-36.0 - 17.5, -72.0 - 35.0, 10.0 + 15.0],
        [-36.0, -72.0, 10.0],
        [0.0, 0.0, 0.0],
    ]
    np.testing.assert_allclose([force.force for force in forces], wanted, atol=1e-12)
    followed = scalars(MODEL, K_TL=2e4, D_TL=100.0).mechanics
    assert (float(followed.K_N), float(followed.D_N)) == (2e4, 100.0)


@pytest.mark.slow
def test_no_force_leaves_the_cone_of_friction() -> None:
    """Within the cone the anchor stays; beyond it the force is mu times the load, in its old direction."""
    stick = scalars(MODEL).mechanics
    slip, rng = scalars(WaistQuadruped(slip="coulomb"), mu=0.6).mechanics, np.random.default_rng(0)
    slipped = 0
    for _ in range(25):
        at = np.c_[rng.normal(0.0, 5e-4, (4, 2)), rng.uniform(-1e-3, 2e-4, 4)]
        where = [jnp.asarray(one) for one in (at, rng.normal(0.0, 0.03, (4, 3)))]
        held = jnp.zeros((4, 2)), jnp.ones(4, bool)
        stuck = np.stack([force.force for force in stick.ground_forces(*where, *held)])
        result = np.stack([force.force for force in slip.ground_forces(*where, *held)])
        load, along = np.maximum(stuck[:, 2], 0.0), np.hypot(*stuck[:, :2].T)
        np.testing.assert_array_equal(result[:, 2], stuck[:, 2])
        np.testing.assert_allclose(np.hypot(*result[:, :2].T), np.minimum(along, 0.6 * load), atol=1e-12)
        np.testing.assert_allclose(result[:, 0] * stuck[:, 1], result[:, 1] * stuck[:, 0], atol=1e-10)
        creep = np.array(slip.creep(*where, *held))
        np.testing.assert_array_equal(creep[along <= 0.6 * load], 0.0)
        # an anchor that has crept for T_slip, with all else at rest, leaves spring and damper on the cone
        moved = jnp.asarray(creep * float(slip.T_slip or 0.0)), held[1]
        after = np.stack([force.force for force in stick.ground_forces(*where, *moved)])
        np.testing.assert_allclose(after, result, atol=1e-12)
        # it slides against the force: friction takes energy
        assert np.all(np.sum(result[:, :2] * creep, axis=1) <= 0.0)
        slipped += int(np.sum(along > 0.6 * load))
    assert 20 < slipped < 95


def test_a_foot_that_is_pulled_down_has_no_friction() -> None:
    m = scalars(WaistQuadruped(slip="coulomb")).mechanics
    up = jnp.array([[1e-3, 0.0, -1e-6]] * 4), jnp.array([[0.0, 0.0, 1.0]] * 4)  # the damper pulls
    forces = m.ground_forces(*up, jnp.zeros((4, 2)), jnp.ones(4, bool))
    np.testing.assert_array_equal([force.force[:2] for force in forces], 0.0)
    assert all(force.force[2] < 0.0 for force in forces)


@pytest.mark.slow
@pytest.mark.parametrize("push", [2.0, 18.0])
def test_a_block_slips_where_it_is_pushed_by_more_than_its_friction(push: float) -> None:
    """Coulomb's law for a mass on a foot with 5 N of load and mu = 1, by SciPy's integrator."""
    m, mass, load, end = scalars(WaistQuadruped(slip="coulomb"), mu=1.0).mechanics, 0.5, 5.0, 0.05
    K, D = float(m.K_TL), float(m.D_TL)

    def rates(_: float, y: np.ndarray) -> np.ndarray:
        x, v, anchor = y
        at, speed = np.array([[x, 0.0, -load / float(m.K_N)]] * 4), np.array([[v, 0.0, 0.0]] * 4)
        where = jnp.asarray(at), jnp.asarray(speed), jnp.asarray([[anchor, 0.0]] * 4), jnp.ones(4, bool)
        force = float(m.ground_forces(*where)[0].force[0])
        return np.array([v, (push + force) / mass, float(m.creep(*where)[0, 0])])

    x, v, anchor = solve_ivp(rates, (0.0, end), np.zeros(3), rtol=1e-8, atol=1e-11, method="LSODA").y[:, -1]
    if push < load:
        assert (anchor, x) == (0.0, pytest.approx(push / K, rel=1e-3))
    else:
        assert v == pytest.approx((push - load) / mass * end, rel=0.02)
        # spring and damper are beyond the cone by what moves the anchor at the foot's speed
        beyond = K * float(scalars(WaistQuadruped(slip="coulomb")).mechanics.T_slip or 0.0) * v
        assert x - anchor == pytest.approx((load + beyond - D * v) / K, rel=0.05)


def test_slip_has_located_events_and_names_of_its_own() -> None:
    job = {
        "name": "slips", "model": "waist_quadruped", "structure": {"slip": "coulomb"},
        "params": {"mu": 0.5, "T_slip": 1e-3}, "run": {"kind": "settle"},
    }  # fmt: skip
    assert Job(**job).design.model == WaistQuadruped(slip="coulomb")
    assert WaistQuadruped(slip="coulomb").recommended.method == "rk4"
    with pytest.raises(JobError, match=r"params\.mu is not"):
        Job(**{**job, "structure": {}})
    with pytest.raises(ValueError, match=r"slip is 'colomb'; did you mean coulomb"):
        WaistQuadruped(slip="colomb")


# ---- control ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("bend", [1.0, -1.0])
def test_rates_of_desired_angles_are_their_derivatives(bend: float) -> None:
    rng = np.random.default_rng(1)
    x, z = rng.uniform(-0.05, 0.05, 30), -rng.uniform(0.1, 0.15, 30)
    dx, dz = rng.normal(0.0, 0.5, (2, 30))
    result = joint_rates(jnp.asarray(x), jnp.asarray(z), jnp.asarray(dx), jnp.asarray(dz), 0.08, bend)
    e = 1e-7
    late, soon = (np.array(joint_angles(jnp.asarray(x + s * dx), jnp.asarray(z + s * dz), 0.08, bend))
                  for s in (e, -e))  # fmt: skip
    np.testing.assert_allclose(result, (late - soon) / (2.0 * e), atol=1e-6)
    out_of_reach = joint_rates(
        jnp.asarray(0.0), jnp.asarray(-0.2), jnp.asarray(0.1), jnp.asarray(1.0), 0.08, bend
    )
    np.testing.assert_allclose(out_of_reach, [-0.5, 0.0], atol=1e-15)  # it turns as the target does
    x, dx, dz = jnp.asarray(0.0), jnp.asarray(0.1), jnp.asarray(1.0)
    still = jax.jacfwd(lambda z: jnp.stack(joint_rates(x, z, dx, dz, 0.08, bend)))(-0.2)
    np.testing.assert_allclose(still, [-0.1 / 0.2**2, 0.0], rtol=1e-12, atol=1e-15)


@pytest.mark.slow
def test_a_joint_that_moves_as_it_should_feels_no_torque() -> None:
    """At the desired angles and rates of the path the PD control is at rest; by their own rates it is not."""
    model = WaistQuadruped(damping="rate_error")
    p = scalars(model)
    s = model.init(p, {"delta_13": jnp.asarray(2.9)})
    s = dataclasses.replace(s, clock=jnp.asarray(9.0), growing=jnp.asarray(False), held=jnp.asarray(False))
    x, z = p.path(s.clock, s.growing).target(s.phi, s.segment, (s.landing_x, s.landing_z))
    velocities = desired_velocities(p, s, jnp.zeros(()))
    q, v = s.q, s.v
    for i in LIMBS:
        at = joint_angles(x[i], z[i], 0.08, p.mechanics.bends[i])
        rates = joint_rates(x[i], z[i], velocities[0][i], velocities[1][i], 0.08, p.mechanics.bends[i])
        q = q.at[HIP[i]].set(at[0]).at[KNEE[i]].set(at[1])
        v = v.at[HIP[i] - 1].set(rates[0]).at[KNEE[i] - 1].set(rates[1])
    np.testing.assert_allclose(p.mechanics.torques(q, v, x, z, velocities), 0.0, atol=1e-13)
    assert float(jnp.abs(p.mechanics.torques(q, v, x, z)).max()) > 0.1


# ---- places and posture -----------------------------------------------------------------------------------


@pytest.mark.parametrize(("kind", "heights"), [(MODEL, {}), (HIGH, HEIGHTS)], ids=["level", "given"])
def test_hips_and_bodies_are_where_they_are_put(kind: WaistQuadruped, heights: dict[str, float]) -> None:
    """Feet by MuJoCo's kinematics of a body made from the page; a drawing has them at the same places."""
    fields = {**HIPS, **heights, "front_length": 0.11, "rear_width": 0.09}
    values = {name: float(value[0]) for name, value in complete(kind, fields, 1).items()}
    q = np.r_[0.1, 0.2, 0.3, 0.9, 0.1, -0.3, 0.2, np.random.default_rng(4).normal(0.0, 0.5, 9)]
    q[3:7] /= np.linalg.norm(q[3:7])
    found, _ = scalars(kind, **fields).mechanics.feet(jnp.asarray(q), jnp.zeros(15))
    page, drawn = varied(mjcf(), values), mujoco.MjModel.from_xml_string(kind.mjcf(values))
    boxes = [drawn.geom_size[drawn.body(name).geomadr[0]] for name in ("front", "rear")]
    wanted = [(values[f"{n}_length"], values[f"{n}_width"], values.get(f"{n}_height", 0.05)) for n in BODIES]
    np.testing.assert_allclose(2.0 * np.array(boxes), wanted, atol=1e-15)
    for model in (page, drawn):
        data = mujoco.MjData(model)
        data.qpos[:] = q
        mujoco.mj_kinematics(model, data)
        np.testing.assert_allclose(found, [data.site(f"foot_{i + 1}").xpos for i in LIMBS], atol=1e-14)
    tree, _ = body()
    geometry = scalars(kind, **fields).mechanics.geometry()
    centre = geometry.com[tree.index("rear")]
    np.testing.assert_allclose(centre, [-(0.093 - 0.055), 0.0, -heights.get("waist_z", 0.0)], atol=1e-15)
    for name in BODIES:  # the boxes' own axes are those of their frames
        inertia = np.diag(page.body(name).inertia)
        np.testing.assert_allclose(geometry.inertia[tree.index(name)], inertia, rtol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("heights", [{}, HEIGHTS], ids=["level", "given"])
def test_hips_of_mjx_are_at_the_same_places(heights: dict[str, float]) -> None:
    word, given = "given" if heights else "level", {**HIPS, **heights}
    model, other = WaistQuadruped("mjx", heights=word), WaistQuadruped(heights=word)
    columns = model.on_host(complete(model, given, 1))
    p = model.params({name: jnp.asarray(column[0]) for name, column in columns.items()})
    tree = scalars(other, **given)
    s = other.init(tree, {"delta_13": jnp.asarray(2.9)})
    s = dataclasses.replace(s, v=jnp.asarray(np.random.default_rng(2).normal(0.0, 0.3, 15)))
    found, wanted = (
        jax.jit(kind.fixed_step_scheme().step)(values, s, jnp.asarray(2e-4))
        for kind, values in ((model, p), (other, tree))
    )
    np.testing.assert_allclose(found.v, wanted.v, atol=1e-11)


@pytest.mark.slow
def test_heights_of_a_level_body_are_the_default() -> None:
    """Landings are the same up to rounding."""
    level, given = (observed(kind, QUICK, 3, STEPS) for kind in (MODEL, HIGH))
    for name, values in level.items():
        np.testing.assert_allclose(given[name], values, atol=1e-9)


def test_heights_are_parameters_of_that_structure_only() -> None:
    job = {"name": "high", "model": "waist_quadruped", "params": {"waist_z": 0.01}, "run": {"kind": "settle"}}
    assert Job(**job, structure={"heights": "given"}).design.model == HIGH
    with pytest.raises(JobError, match=r"params\.waist_z is not"):
        Job(**job)
    with pytest.raises(ValueError, match=r"heights is 'given_'; did you mean given"):
        WaistQuadruped(heights="given_")


@pytest.mark.parametrize("posture", [{}, POSTURE, HEIGHTS, {"H": 0.13, "x_c": 0.004, "H_hind": 0.125}])
def test_it_begins_with_all_feet_on_the_ground(posture: dict[str, float]) -> None:
    """Feet begin at the depth at which the springs carry 2.8 kg, for all lengths of limbs."""
    p = scalars(HIGH, **posture, K_N=2e4)
    s = HIGH.init(p, {"delta_13": jnp.asarray(2.9)})
    np.testing.assert_allclose(s.height, -2.8 * 9.8 / (4.0 * 2e4), atol=1e-15)
    assert float(jnp.linalg.norm(s.q[3:7])) == pytest.approx(1.0, abs=1e-15)


def test_knees_point_in_the_chosen_direction() -> None:
    """The knee is ahead of the line from hip to foot, or behind it; the feet do not move."""
    for fore, hind in ((1.0, 0.0), (0.0, 1.0), (0.0, 0.0), (1.0, 1.0)):
        p = scalars(MODEL, fore_knees=fore, hind_knees=hind)
        s = MODEL.init(p, {"delta_13": jnp.asarray(2.9)})
        x, z = p.mechanics.from_hips(s.q)
        np.testing.assert_allclose(x, -0.0008, atol=1e-15)
        np.testing.assert_allclose(z, -0.133, atol=1e-15)
        knees = [-0.08 * math.sin(float(s.q[HIP[i]])) for i in LIMBS]
        assert [knee > -0.0004 for knee in knees] == [fore > 0.0, fore > 0.0, hind > 0.0, hind > 0.0]
