"""Model files and their controllers: closed forms, MuJoCo C's kinematics, and refusals with lines."""

# MuJoCo's compiled modules come without types.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

import json
import os
import re
import shutil
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import jax.numpy as jnp
import mujoco
import numpy as np
import pandas as pd
import pytest

import gaitsweep as gs
from gaitsweep.cli import main
from gaitsweep.dynamics.controllers.controlled_body import ControlledBody, Leg, Trunk
from gaitsweep.dynamics.controllers.leg_targets import FootPath, FootPaths, actuator_of, two_link_leg
from gaitsweep.dynamics.controllers.model_file import model_of_file
from gaitsweep.dynamics.controllers.oscillators import (
    HopfOscillators,
    LegSenses,
    MatsuokaOscillators,
    PhaseOscillators,
)
from gaitsweep.errors import JobError
from gaitsweep.kinds.columns import quantities_of
from gaitsweep.models.conformity import variables_without_rate
from gaitsweep.models.sampled_points import sampled_points
from gaitsweep.models.starts import starts_in_ground
from gaitsweep.plot.column_labels import described
from gaitsweep.shipped import EXAMPLES

WALKERS = EXAMPLES / "walkers"
LEGS = ("LF", "RF", "LH", "RH")
PHASES = "{kind: phase, omega: 6, coupling: 4, phases: {L: 0, R: pi}, sigma: 0.03}"
MATSUOKA = "{kind: matsuoka, rise: 0.05, adaptation: 0.5, hip: 3}"
DELTA = np.array([0.0, 3.0, 2.9, 0.3])
PHASE = np.array([0.4, 3.9, 2.0, 5.5])
LOADS = np.array([12.0, 0.0, 30.0, 5.0])
SENSES = LegSenses(lambda: jnp.asarray(LOADS), lambda: jnp.asarray([0.1, -0.2, 0.3, 0.0]))


def params(**values: float) -> Any:
    deltas = {f"delta_{leg}": float(delta) for leg, delta in zip(LEGS, DELTA, strict=True)}
    return SimpleNamespace(**{"omega": 9.0, "coupling": 1.5, "sigma": 0.02, "gain": 8.0, **deltas, **values})


def phase_rates() -> np.ndarray:
    """Rates of the phases (n,), by the sum over all pairs of legs."""
    apart = PHASE - DELTA
    pull = np.array([sum(np.sin(other - own) for other in apart) for own in apart])
    return 9.0 + 0.02 * LOADS * np.cos(PHASE) + 1.5 * pull


def test_phases_are_pulled_by_each_other_and_by_loads() -> None:
    oscillators = PhaseOscillators.model_validate({"kind": "phase", "omega": 9.0, "sigma": 0.02})
    rates = oscillators.rates(LEGS, params(), SimpleNamespace(phase=jnp.asarray(PHASE)), SENSES)
    np.testing.assert_allclose(rates["phase"], phase_rates(), rtol=0, atol=1e-13)


@pytest.mark.slow
def test_a_load_holds_a_leg_in_stance() -> None:
    """Under a strong load a phase stops in stance, at arccos(-omega / (sigma N)), from wherever it begins."""
    oscillators = PhaseOscillators.model_validate({"kind": "phase", "omega": 9.0, "sigma": 1.0})
    loaded = LegSenses(lambda: jnp.full(4, 20.0), lambda: jnp.zeros(4))
    phase = jnp.asarray(PHASE)
    for _ in range(2000):
        state = SimpleNamespace(phase=phase)
        phase = (
            phase + 1e-3 * oscillators.rates(LEGS, params(sigma=1.0, coupling=0.0), state, loaded)["phase"]
        )
    np.testing.assert_allclose(np.mod(phase, 2.0 * np.pi), np.arccos(-9.0 / 20.0), rtol=0, atol=1e-6)
    assert oscillators.pattern(params(), SimpleNamespace(phase=phase))[1].max() == 0.0  # no foot is lifted


def test_hopf_oscillators_on_their_circle_are_the_phase_oscillators() -> None:
    """Inside the circle the radius grows at gain (1 - r^2) r, in the pattern, where the coupling vanishes."""
    oscillators = HopfOscillators.model_validate({"kind": "hopf", "omega": 9.0, "sigma": 0.02})
    state = SimpleNamespace(hopf_x=jnp.cos(PHASE), hopf_y=jnp.sin(PHASE))
    rates = oscillators.rates(LEGS, params(), state, SENSES)
    turning = np.cos(PHASE) * rates["hopf_y"] - np.sin(PHASE) * rates["hopf_x"]
    np.testing.assert_allclose(turning, phase_rates(), rtol=0, atol=1e-13)
    small = SimpleNamespace(hopf_x=0.5 * jnp.cos(DELTA), hopf_y=0.5 * jnp.sin(DELTA))
    rates = oscillators.rates(LEGS, params(), small, SENSES)
    growth = np.cos(DELTA) * rates["hopf_x"] + np.sin(DELTA) * rates["hopf_y"]
    np.testing.assert_allclose(growth, 8.0 * 0.75 * 0.5, rtol=0, atol=1e-13)


def test_a_landing_foot_sets_its_phase() -> None:
    """To the nearest phase that is the one of landing, so that a reset at the section crosses it."""
    phases = PhaseOscillators.model_validate({"kind": "phase", "omega": 9.0, "reset": 0.0})
    assert phases.resets
    state = SimpleNamespace(phase=jnp.asarray([6.1, 0.3]))
    state.replace = lambda phase: phase
    np.testing.assert_allclose(phases.landed(params(phase_landing=0.0), state, 0), [2.0 * np.pi, 0.3])
    np.testing.assert_allclose(phases.landed(params(phase_landing=0.0), state, 1), [6.1, 0.0], atol=1e-15)
    hopf = HopfOscillators.model_validate({"kind": "hopf", "omega": 9.0, "reset": 0.5})
    begun = SimpleNamespace(hopf_x=jnp.asarray([0.6]), hopf_y=jnp.asarray([-0.8]))
    begun.replace = lambda **changes: changes
    landed = hopf.landed(params(phase_landing=0.5), begun, 0)
    np.testing.assert_allclose([landed["hopf_x"][0], landed["hopf_y"][0]], [np.cos(0.5), np.sin(0.5)])


def test_matsuoka_oscillators_have_their_feedback_and_frequency() -> None:
    """The rates of a lone half-centre by hand; the period against integration of a pair, within 15 %."""
    fields = {"kind": "matsuoka", "rise": 0.05, "adaptation": 0.5, "hip": 3.0, "load": 0.01}
    oscillators = MatsuokaOscillators.model_validate(fields)
    numbers = {"Tr": 0.05, "Ta": 0.5, "b": 2.5, "gamma_": -2.0, "drive": 1.0, "between": -0.5}
    p = SimpleNamespace(**numbers, k1=3.0, k2=0.01, theta0=0.0)
    # rows begin before the section by default, so that its event is not missed at the start
    begun = SimpleNamespace(u=jnp.asarray(oscillators.declarations(LEGS)["u"].start))
    assert float(oscillators.turned(begun)) < 0.0
    u, f = np.arange(8.0) / 8.0 - 0.3, np.arange(8.0) / 10.0
    rates = oscillators.rates(LEGS, p, SimpleNamespace(u=jnp.asarray(u), f=jnp.asarray(f)), SENSES)
    hip = 3.0 * np.array([0.1, -0.2, 0.3, 0.0])
    felt = np.concatenate([hip, -hip - 0.01 * LOADS])
    opposite = np.maximum(np.roll(u, 4), 0.0)
    np.testing.assert_allclose(rates["u"], (-u - 2.0 * opposite - 2.5 * f + 1.0 + felt) / 0.05, atol=1e-12)
    x, crossings, dt = np.array([1.0, 0.1, 0.0, 0.0]), [], 1e-3
    for k in range(12000):
        y = np.maximum(x[:2], 0.0)
        change = np.concatenate([(-x[:2] - 2.0 * y[::-1] - 2.5 * x[2:] + 1.0) / 0.05, (y - x[2:]) / 0.5])
        crossings += [k * dt] if x[0] < x[1] and (x + dt * change)[0] >= (x + dt * change)[1] else []
        x = x + dt * change
    assert oscillators.period(p) == pytest.approx(np.diff(crossings)[-1], rel=0.15)


@pytest.mark.parametrize("side", ["lf", "rh"])
def test_inverse_kinematics_put_the_foot_on_its_path(side: str) -> None:
    """MuJoCo's own kinematics place the foot at the target; the knee bends within its range."""
    m = mujoco.MjModel.from_xml_path(str(WALKERS / "quadruped.xml"))
    data = mujoco.MjData(m)
    leg = two_link_leg(m, f"hip_{side}", f"knee_{side}", f"foot_{side}")
    for x, z in ((0.05, -0.3), (-0.12, -0.33), (0.0, -0.2), (0.1, -0.38)):
        hip, knee = leg.angles(jnp.asarray(x), jnp.asarray(z))
        data.joint(leg.hip).qpos[0], data.joint(leg.knee).qpos[0] = hip, knee
        mujoco.mj_kinematics(m, data)
        place = data.geom(f"foot_{side}").xpos - data.joint(leg.hip).xanchor
        np.testing.assert_allclose(place[[0, 2]], [x, z], rtol=0, atol=1e-9)
        low, high = m.joint(leg.knee).range
        assert low - 1e-9 < knee < high + 1e-9


@pytest.mark.parametrize(
    ("thigh", "shin", "hip_range", "knee_range"),
    [
        (-0.2, 0.2, (-1.5, 1.5), (-2.9, -0.2)),
        (-0.2, 0.2, (-1.5, 1.5), (0.2, 2.9)),
        (0.2, 0.2, (1.6, 4.7), (-2.9, -0.2)),
        (0.2, -0.2, (1.6, 4.7), (3.2, 6.1)),
    ],
)
def test_angles_of_legs_are_in_their_ranges_wherever_zero_is(
    thigh: float, shin: float, hip_range: tuple[float, float], knee_range: tuple[float, float]
) -> None:
    """The leg is folded, or points up, at zero angles."""
    m = mujoco.MjModel.from_xml_string(
        '<mujoco><compiler angle="radian" autolimits="true"/><worldbody><body>'
        f'<joint name="hip" axis="0 1 0" range="{hip_range[0]} {hip_range[1]}"/><geom size=".02"/>'
        f'<body pos="0 0 {thigh}"><joint name="knee" axis="0 1 0" range="{knee_range[0]} {knee_range[1]}"/>'
        f'<geom name="foot" size=".02" pos="0 0 {shin}"/></body></body></worldbody></mujoco>'
    )
    data = mujoco.MjData(m)
    leg = two_link_leg(m, "hip", "knee", "foot")
    for x, z in ((0.05, -0.3), (-0.12, -0.3), (0.0, -0.2)):
        data.qpos[:] = leg.angles(jnp.asarray(x), jnp.asarray(z))
        mujoco.mj_kinematics(m, data)
        np.testing.assert_allclose(data.geom("foot").xpos[[0, 2]], [x, z], rtol=0, atol=1e-9)
        assert hip_range[0] < data.qpos[0] < hip_range[1]
        assert knee_range[0] < data.qpos[1] < knee_range[1]


@pytest.mark.slow
@pytest.mark.parametrize(("keyframe", "sign"), [("", -1.0), ("behind", 1.0)])
def test_a_knee_without_limits_bends_as_in_the_keyframe_of_the_start(
    tmp_path: Path, keyframe: str, sign: float
) -> None:
    body = (WALKERS / "quadruped.xml").read_text().replace(' range="-120 0" limited="true"', "")
    place = int(mujoco.MjModel.from_xml_string(body).joint("knee_lf").qposadr[0])
    keys = ""
    for name, angle in (("ahead", -1.0), ("behind", 1.0)):
        qpos = mujoco.MjModel.from_xml_string(body).qpos0
        qpos[place] = angle
        keys += f'<key name="{name}" qpos="{" ".join(map(str, qpos))}"/>'
    body = body.replace("</mujoco>", f"<keyframe>{keys}</keyframe></mujoco>")
    (tmp_path / "quadruped.xml").write_text(body)
    text = (WALKERS / "quadruped.yaml").read_text()
    named = f"body: quadruped.xml\nkeyframe: {keyframe}\n" if keyframe else "body: quadruped.xml\n"
    (tmp_path / "quadruped.yaml").write_text(text.replace("body: quadruped.xml\n", named))
    model: Any = model_of_file(tmp_path / "quadruped.yaml")()
    p = model.params({q.name: jnp.asarray(q.default, float) for q in model.parameters})
    start = {q.name: jnp.zeros(()) for q in model.initial_conditions}
    assert np.sign(model.control(p, model.init(p, start))[1]) == sign


@pytest.mark.parametrize(
    ("pairs", "stance"),
    [
        ([], "0101"),
        (["12", "34"], "0101"),
        (["13", "24"], "0110"),
        (["12", "24", "34", "13"], "0110"),
        (["14"], "0101"),
        (["12", "23", "13"], "0111"),
    ],
)
def test_legs_that_inhibit_each_other_begin_in_turn(pairs: list[str], stance: str) -> None:
    """A leg in stance has an active extensor. In a ring of three legs two of a pair begin alike."""
    fields = {"kind": "matsuoka", "rise": 0.05, "adaptation": 0.5, "inhibited": [[*pair] for pair in pairs]}
    starts = MatsuokaOscillators.model_validate(fields).declarations("1234")["u"].start
    assert (
        "".join(str(int(extensor > flexor)) for extensor, flexor in zip(starts[:4], starts[4:], strict=True))
        == stance
    )


def test_a_foot_is_on_its_path_with_the_lengths_and_places_of_a_row(tmp_path: Path) -> None:
    """MuJoCo's own kinematics of these lengths; the knee is above the origin of its body."""
    body = (WALKERS / "quadruped.xml").read_text()
    for old, new in (
        ('<body name="shin_lf" pos="0 0', '<body name="shin_lf" pos=".03 0'),
        ('<joint name="knee_lf"', '<joint name="knee_lf" pos="0 0 .02"'),
    ):
        assert old in body
        body = body.replace(old, new)
    (tmp_path / "quadruped.xml").write_text(body)
    text = (WALKERS / "quadruped.yaml").read_text()
    (tmp_path / "quadruped.yaml").write_text(text.replace("dynamics: stepped", "dynamics: located"))
    model: Any = model_of_file(tmp_path / "quadruped.yaml")()
    row = {"thigh_lf_size": 1.2, "shin_lf_size": 0.9, "shin_lf_x": -0.02, "shin_lf_z": -0.17}
    p = model.params({q.name: jnp.asarray(row.get(q.name, q.default), float) for q in model.parameters})
    m = mujoco.MjModel.from_xml_path(str(tmp_path / "quadruped.xml"))
    path = FootPath(stride=0.05, lift=0.05, height=0.3)
    paths = FootPaths(path, [two_link_leg(m, "hip_lf", "knee_lf", "foot_lf")])
    targets = paths.of_joints(model, p, jnp.asarray([0.4]), jnp.asarray([0.5]))
    m.body("shin_lf").pos = 1.2 * np.array([-0.02, 0.0, -0.17])
    m.joint("knee_lf").pos = 0.9 * m.joint("knee_lf").pos
    m.geom("foot_lf").pos = 0.9 * m.geom("foot_lf").pos
    data = mujoco.MjData(m)
    for joint, target in targets.items():
        data.joint(joint).qpos[0] = target
    mujoco.mj_kinematics(m, data)
    place = data.geom("foot_lf").xpos - data.joint("hip_lf").xanchor
    np.testing.assert_allclose(place[[0, 2]], [0.01, -0.275], rtol=0, atol=1e-9)


@pytest.mark.parametrize(
    ("turned", "joints", "moves"),
    [
        ("", '<joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 0 1" ref=".87"/>', True),
        ('euler="20 -30 90"', '<joint type="slide" axis="0 0 1"/><joint type="slide" ref="-.4"/>', True),
        ('euler="180 0 0"', '<joint type="slide" axis="0 0 1" ref=".87"/><joint axis="0 1 0"/>', False),
        (
            'euler="0 15 0"',
            '<joint axis="0 1 1" pos=".1 0 .2" ref="20"/><joint type="slide" axis="1 0 1" ref=".3"/>'
            '<joint type="ball" pos="0 .3 .1"/>',
            True,
        ),
        ('euler="0 15 0"', "<freejoint/>", True),
        ("", '<joint axis="0 0 1" pos="0 -1 0"/><joint axis="0 1 0"/>', True),
        ("", '<joint axis="0 1 0"/><joint type="slide" axis="0 0 1"/>', True),
    ],
    ids=["ref", "turned trunk", "upside down", "slide after a hinge", "free", "boom", "leg that extends"],
)
def test_the_place_of_the_trunk_is_that_of_mujoco(turned: str, joints: str, moves: bool) -> None:
    """At random positions, with references of joints, turned trunks, and anchors beside the origin."""
    body = f'<body pos=".1 .2 .87" {turned}>{joints}<geom name="foot" size=".1"/></body>'
    others = (
        '<body pos="9 9 9"><geom size=".1"/></body><body pos="5 5 5"><freejoint/><geom size=".1"/></body>'
    )
    behind = f'{others}<body pos="1 2 3" euler="0 0 50">{body}</body>'
    for bodies in (body, *([] if "free" in joints else [behind]), f"{others}{body}"):
        m = mujoco.MjModel.from_xml_string(f"<mujoco><worldbody>{bodies}</worldbody></mujoco>")
        data = mujoco.MjData(m)
        trunk = Trunk(m, ["foot"])
        assert trunk.moves == moves
        rng = np.random.default_rng(3)
        for q in [m.qpos0, *rng.normal(size=(4, m.nq))]:
            data.qpos[:] = q
            mujoco.mj_kinematics(m, data)
            np.testing.assert_allclose(trunk.place(jnp.asarray(q)), data.xpos[-1], rtol=0, atol=1e-12)


def test_a_trunk_on_a_boom_walks_around_it() -> None:
    """Half of a turn by 0.2 rad, 1 m from the axis, is ahead wherever on the circle."""
    body = (
        '<body pos="0 1 1" euler="0 0 180"><joint axis="0 0 1" pos="0 1 0"/><geom name="f" size=".1"/></body>'
    )
    trunk = Trunk(mujoco.MjModel.from_xml_string(f"<mujoco><worldbody>{body}</worldbody></mujoco>"), ["f"])
    for angle in (0.0, 1.0, 2.5):
        begin = trunk.place(jnp.asarray([angle]))[:2]
        np.testing.assert_allclose(trunk.ahead(jnp.asarray([angle + 0.2]), begin), np.sin(0.2), atol=1e-12)


@pytest.mark.parametrize(
    "arms",
    [
        '<body pos="0 1 .8" euler="0 0 180"><joint axis="0 0 1"/><joint axis="1 0 0"/>{}</body>',
        '<body pos="0 1 .8" euler="0 0 180"><joint axis="0 0 1"/><body><joint axis="1 0 0"/>{}</body></body>',
        '<body pos="0 1 0" euler="0 0 180"><joint type="slide" axis="0 0 1" ref="-.8"/><body pos="0 0 .8">'
        '<joint axis="0 0 1"/>{}</body></body>',
    ],
    ids=["one arm", "two arms", "post"],
)
@pytest.mark.parametrize("joint", ["", '<joint axis="0 1 0"/>', '<joint axis="0 1 0" pos=".1 0 .2"/>'])
def test_the_trunk_is_what_the_arms_of_a_boom_carry(arms: str, joint: str) -> None:
    """It is where MuJoCo has it; half of a turn of the boom by 0.2 rad, 1 m from its axis, is ahead."""
    leg = '<body><joint axis="0 1 0"/><geom name="{}" size=".1"/></body>'
    trunk_and_legs = f'<body pos="0 -1 .1">{joint}<geom size=".1"/>{leg.format("l")}{leg.format("r")}</body>'
    bodies = arms.replace("<joint", '<geom size=".1"/><joint').format(trunk_and_legs)
    m = mujoco.MjModel.from_xml_string(f"<mujoco><worldbody>{bodies}</worldbody></mujoco>")
    data, trunk = mujoco.MjData(m), Trunk(m, ["l", "r"])
    body = m.geom("l").bodyid[0] - 1
    assert trunk.moves
    for q in np.random.default_rng(3).normal(size=(4, m.nq)):
        data.qpos[:] = q
        mujoco.mj_kinematics(m, data)
        np.testing.assert_allclose(trunk.place(jnp.asarray(q)), data.xpos[body], rtol=0, atol=1e-12)
    turn = int(np.argmax((m.jnt_type == mujoco.mjtJoint.mjJNT_HINGE) & (m.jnt_axis[:, 2] == 1.0)))
    for angle in (0.0, 2.5):
        begin, end = (jnp.asarray(m.qpos0).at[turn].set(q) for q in (angle, angle + 0.2))
        np.testing.assert_allclose(trunk.ahead(end, trunk.place(begin)[:2]), np.sin(0.2), atol=1e-12)


def test_a_robot_fixed_to_the_world_has_a_trunk_that_stands() -> None:
    leg = '<body><joint pos="0 0 .1" axis="0 1 0"/><geom name="{}" size=".1"/></body>'
    body = f'<body pos="0 0 1"><geom size=".1"/>{leg.format("l")}{leg.format("r")}</body>'
    m = mujoco.MjModel.from_xml_string(f"<mujoco><worldbody>{body}</worldbody></mujoco>")
    trunk = Trunk(m, ["l", "r"])
    assert not trunk.moves
    np.testing.assert_allclose(trunk.place(jnp.ones(2)), [0.0, 0.0, 1.0], atol=1e-12)


def test_hips_count_forwards_whatever_the_frame_of_their_body() -> None:
    """MuJoCo moves both feet ahead: the right thigh is turned, with the same axis in the world."""
    shape = 'type="capsule" fromto="0 0 0 0 0 -.4" size=".03"'
    body = f"""<mujoco><worldbody><body pos="0 0 1" {{}}>{{}}<geom size=".1"/>
      <body pos="0 .1 0"><joint name="a" axis="0 -1 0"/><geom name="l" {shape}/></body>
      <body pos="0 -.1 0" euler="0 0 180"><joint name="b" axis="0 1 0"/><geom name="r" {shape}/></body>
      </body></worldbody></mujoco>"""
    legs = [Leg("L", "l", {"hip": "a"}), Leg("R", "r", {"hip": "b"})]
    model: Any = SimpleNamespace(position=lambda state, joint: jnp.asarray(0.3))
    for turned, joint in (("", '<joint type="slide"/>'), ('euler="0 0 90"', "<freejoint/>")):
        m = mujoco.MjModel.from_xml_string(body.format(turned, joint))
        none: Any = None
        hips = ControlledBody(m, True, none, legs, none, {})._hips(model, None)
        np.testing.assert_allclose(hips, [0.3, 0.3])


def test_a_hip_that_is_not_about_y_has_no_angle_to_feel(tmp_path: Path) -> None:
    body = (WALKERS / "biped.xml").read_text().replace('name="hip_r"/>', 'name="hip_r" axis="1 0 0"/>', 1)
    text = (WALKERS / "biped.yaml").read_text().replace(PHASES, MATSUOKA)
    (tmp_path / "biped.xml").write_text(body)
    (tmp_path / "biped.yaml").write_text(text)
    with pytest.raises(
        JobError, match=r"legs\.R\.hip is not accepted: .*'hip_r' is no hinge about y.*\(1, 0, 0\)"
    ):
        model_of_file(tmp_path / "biped.yaml")


@pytest.mark.slow
def test_a_model_file_is_the_class_that_one_would_write() -> None:
    """The boom walker's control and phases, from the same numbers in YAML."""
    from gaitsweep.examples.boom_walker import BoomWalker

    ours, theirs = model_of_file(WALKERS / "biped.yaml")(), BoomWalker()
    assert model_of_file(WALKERS / "biped.yaml") is type(ours)
    assert gs.models.find(gs.models.name_of(type(ours))) is type(ours)
    results = []
    for model in (ours, theirs):
        values = {q.name: jnp.asarray(q.default, float) for q in model.parameters}
        starts = {
            q.name: jnp.asarray({"phase_1_0": 1.0, "phase_2_0": 4.3}.get(q.name, 0.0))
            for q in model.initial_conditions
        }
        p = model.params(values)
        state = model.init(p, starts).replace(phase=jnp.asarray([1.0, 4.3]))
        results.append([model.control(p, state), model.rates(p, state)["phase"], model.period(p)])
    for one, other in zip(*results, strict=True):
        np.testing.assert_allclose(one, other, rtol=0, atol=1e-12)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        (
            "hip: hip_l,",
            "hip: hpi_l,",
            r"line 9: controller\.legs\.L is not accepted: .*'hpi_l'; did you mean",
        ),
        ("foot: foot_l,", "foot: fot_l,", r"line 9: controller\.legs\.L\.foot is fot_l.*did you mean foot_l"),
        (
            "knee: knee_l}",
            "kne: knee_l}",
            r"line 9: controller\.legs\.L\.kne is not a role.*did you mean knee",
        ),
        ("kind: phase", "kind: phse", r"line 4: controller\.oscillators.*phse.*phase"),
        ("omega: 6", "omga: 6", r"line 4: controller\.oscillators\.omga .*did you mean omega"),
        ("omega: 6", "omega: -6", r"line 4: .*omega is -6, but must be above 0"),
        (
            "phases: {L: 0,",
            "phases: {LL: 0,",
            r"line 4: controller\.oscillators\.phases has LL.*did you mean L",
        ),
        (
            "phases: {L: 0, R: pi}",
            "phases: {L: 0}",
            r"line 4: controller\.oscillators\.phases has no phase of R: .*R: pi",
        ),
        (
            "fallen: 0.47",
            "falen: 0.47",
            r"line 11: falen is not a field of a model file; did you mean fallen",
        ),
        (
            "    hip: {swing",
            "    ankle: {swing: 0.1}\n    hip: {swing",
            r"line 6: controller\.joints\.ankle moves nothing, since no leg has it: write ankle: JOINT",
        ),
        (
            "    hip: {swing",
            "    foot: {swing: 0.1}\n    hip: {swing",
            r"line 6: controller\.joints\.foot is the entry of a leg that names the geom .* such as ankle",
        ),
        ("  joints:", "  kp: 3\n  joints:", "kp or kd, but all of its joints have <position>"),
        ("body: biped.xml", "body: bipd.xml", r"line 2: body is not accepted: .*bipd\.xml does not exist"),
        ("body: biped.xml", "body: .", "line 2: body is not accepted: .*is a folder"),
        ("body: biped.xml", "body: biped.yaml", "line 2: body is not accepted: .*XML"),
        (
            "body: biped.xml",
            "body: biped.xml\ndynamics: stepped\nstart: standing",
            "line 4: start is standing, which needs",
        ),
        ("body: biped.xml", "body: biped.xml\nstart: standign", "line 3: start"),
        ("fallen: 0.47", "shortest_contact: 0.7", r"line 11: shortest_contact is 0\.7"),
        ("body: biped.xml", "body: biped.xml\nkeyframe: stnd", r"line 3: keyframe .*'stnd'"),
        (
            "R: {foot: foot_r, hip: hip_r",
            "R: {foot: foot_r, hip: hip_l",
            r"line 10: controller\.legs\.R\.hip is hip_l, which is already the hip of leg L",
        ),
        ("R: {foot: foot_r", "R: {foot: foot_l", r"legs\.R\.foot is foot_l, .* already the foot of leg L"),
        ("knee: knee_l}", "knee: hip_l}", r"legs\.L\.knee is hip_l, .* already the hip of leg L"),
        (
            "L: {foot: foot_l, hip: hip_l, knee: knee_l}",
            "L: {foot: foot_l}",
            r"line 9: controller\.legs\.L has no joint, .* hip, knee: JOINT",
        ),
        (
            f"{PHASES}\n",
            "{kind: matsuoka, rise: 0.05, adaptation: 0.5, inhibited: [[L, L]]}\n",
            r"line 4: controller\.oscillators\.inhibited has L and L as a pair: give two different legs",
        ),
        (
            f"{PHASES}\n",
            "{kind: matsuoka, rise: 0.05}\n",
            r"line 4: controller\.oscillators\.adaptation is missing",
        ),
        (
            f"{PHASES}\n",
            "{kind: matsuoka, rise: 0.05, adaptation: 0.5, hip_rest: 0.1}\n",
            r"line 4: controller\.oscillators has hip_rest, .* give hip, too",
        ),
        (
            f"{PHASES}\n",
            "{kind: matsuoka, rise: 0.05, adaptation: 0.5, between: -1}\n",
            r"line 4: controller\.oscillators has between, .* give inhibited, too",
        ),
        (f"{PHASES}\n", f"{MATSUOKA}\n", r"line 9: controller\.legs\.L has no hip, .* write hip: JOINT"),
    ],
)
def test_errors_of_a_model_file_have_its_line(tmp_path: Path, old: str, new: str, words: str) -> None:
    text = (WALKERS / "biped.yaml").read_text()
    assert old in text
    if new.startswith(MATSUOKA):
        text = text.replace("foot_l, hip: hip_l", "foot_l")
    (tmp_path / "biped.yaml").write_text(text.replace(old, new))
    (tmp_path / "biped.xml").write_text((WALKERS / "biped.xml").read_text())
    with pytest.raises(JobError, match=words):
        model_of_file(tmp_path / "biped.yaml")


@pytest.mark.slow
def test_controls_follow_the_gears_and_gains_of_a_row(tmp_path: Path) -> None:
    """Hips have servos of the length gear x angle; knees have motors of the torque gear x gain x control."""
    body = (WALKERS / "biped.xml").read_text()
    for side in "lr":
        body = body.replace(f'name="hip_{side}" joint', f'name="hip_{side}" gear="2" joint')
        body = body.replace(f'<position name="knee_{side}"', f'<motor name="knee_{side}" gear="3"')
    text = (WALKERS / "biped.yaml").read_text().replace("  joints:", "  kp: 30\n  kd: 2\n  joints:")
    (tmp_path / "biped.xml").write_text(body)
    for dynamics, rows_own in (
        ("located", {"hip_l_gear": 4, "knee_l_gear": 5, "knee_l_gain": 2}),
        ("stepped", {}),
    ):
        (tmp_path / "geared.yaml").write_text(
            text.replace("controller:", f"dynamics: {dynamics}\ncontroller:", 1)
        )
        model: Any = model_of_file(tmp_path / "geared.yaml")()
        values = {q.name: jnp.asarray(rows_own.get(q.name, q.default), float) for q in model.parameters}
        start = {q.name: jnp.asarray(0.0) for q in model.initial_conditions}
        own = {"phase_1_0": 1.0, "phase_2_0": 4.0, "knee_r_rate_0": 0.5}
        start |= {name: jnp.asarray(number) for name, number in own.items()}
        p = model.params(values)
        control = model.control(p, model.init(p, start))
        hips = 0.25 * np.cos([1.0, 4.0]) * (rows_own.get("hip_l_gear", 2), 2)
        torques = 30.0 * (0.15 + np.maximum(-np.sin([1.0, 4.0]), 0.0)) - 2.0 * np.array([0.0, 0.5])
        knees = torques / ((10 if rows_own else 3), 3)
        np.testing.assert_allclose(control, [hips[0], knees[0], hips[1], knees[1]], rtol=1e-12)
    for element in ('<velocity name="hip_l"', '<general biastype="affine" biasprm="0 1" name="hip_l"'):
        (tmp_path / "biped.xml").write_text(body.replace('<position name="hip_l"', element))
        with pytest.raises(JobError, match="actuator of joint 'hip_l' is neither a <position> actuator"):
            model_of_file(tmp_path / "geared.yaml")


def test_the_actuator_of_a_joint_is_not_that_of_a_tendon_with_its_number() -> None:
    xml = """<mujoco><worldbody><body><joint name="hip"/><geom size=".1"/></body></worldbody>
      <tendon><fixed name="strap"><joint joint="hip" coef="1"/></fixed></tendon>
      <actuator><position tendon="strap" kp="10"/>{}</actuator></mujoco>"""
    with pytest.raises(ValueError, match="'hip' has 0 actuators"):
        actuator_of(mujoco.MjModel.from_xml_string(xml.format("")), "hip")
    assert actuator_of(mujoco.MjModel.from_xml_string(xml.format('<motor joint="hip"/>')), "hip") == 1


def test_targets_and_gains_of_slides_have_their_units(tmp_path: Path) -> None:
    """A shin that slides in its thigh, with a motor, below a hip that turns."""
    body = (
        (WALKERS / "biped.xml").read_text().replace('axis="0 1 0" range="0 120"', 'type="slide" range="0 1"')
    )
    body = body.replace('<position name="knee', '<motor name="knee')
    text = (WALKERS / "biped.yaml").read_text().replace("  joints:", "  kp: 30\n  kd: 2\n  joints:")
    (tmp_path / "biped.xml").write_text(body)
    (tmp_path / "biped.yaml").write_text(text)
    units = {q.name: q.unit for q in model_of_file(tmp_path / "biped.yaml")().parameters}
    assert [units[name] for name in ("hip_swing", "knee_offset", "kp", "kd")] == ["rad", "m", "N/m", "N s/m"]


def test_the_load_of_a_stepped_foot_is_that_of_its_own_sensor(tmp_path: Path) -> None:
    """Two feet on one body have a sensor each; a ball joint has no position that is one number."""
    body = """<mujoco><worldbody><geom type="plane" size="9 9 .1"/><body pos="0 0 .1"><freejoint name="root"/>
      <geom name="heel" size=".1"/><geom name="toe" size=".1" pos="1 0 0"/>
      <site name="a" size=".2"/><site name="b" size=".2" pos="1 0 0"/></body></worldbody>
      <sensor><touch name="{}" site="a"/><touch name="{}" site="b"/></sensor></mujoco>"""
    members = {"control": lambda self, p, s: jnp.zeros(0), "period": lambda self, p: jnp.ones(())}
    state = SimpleNamespace(sensors=jnp.asarray([3.0, 5.0]), body=SimpleNamespace(q=jnp.zeros(7)))
    named, other = (
        type("Feet", (gs.MjcfModel,), {"body_file": body.format(*names), **members})()
        for names in (("heel", "toe"), ("rear", "front"))
    )
    assert [float(named.load(None, state, geom)) for geom in ("heel", "toe")] == [3.0, 5.0]
    with pytest.raises(ValueError, match=r"geom 'toe' is read from .* but that has 2 of other names"):
        other.load(None, state, "toe")
    with pytest.raises(ValueError, match="no hinge or slide 'root'"):
        named.position(state, "root")


def test_a_model_file_says_that_rows_begin_standing(tmp_path: Path) -> None:
    (tmp_path / "biped.xml").write_bytes((WALKERS / "biped.xml").read_bytes())
    text = (WALKERS / "biped.yaml").read_text()
    kinds: list[Any] = []
    for start in ("keyframe", "standing"):
        (tmp_path / f"{start}.yaml").write_text(f"{text}\nstart: {start}\n")
        kinds.append(model_of_file(tmp_path / f"{start}.yaml"))
    assert [kind.begins_standing for kind in kinds] == [False, True]


def test_the_first_cycle_of_a_stepped_trunk_begins_at_its_start(tmp_path: Path) -> None:
    """The mean speed of that cycle counts from there."""
    text = (WALKERS / "biped.yaml").read_text()
    (tmp_path / "biped.yaml").write_text(f"{text}\ndynamics: stepped\n")
    (tmp_path / "biped.xml").write_bytes((WALKERS / "biped.xml").read_bytes())
    model = model_of_file(tmp_path / "biped.yaml")()
    values = {q.name: jnp.asarray(q.default, float) for q in model.parameters}
    starts = {q.name: jnp.asarray(0.0) for q in model.initial_conditions}
    state = model.init(model.params(values), {**starts, "x_0": jnp.asarray(0.7)})
    np.testing.assert_allclose(state.begin, [0.7, 0.0], rtol=0, atol=1e-12)


@pytest.mark.slow
def test_the_height_of_a_trunk_counts_from_a_step_of_the_mjcf(tmp_path: Path) -> None:
    """A box of 5 cm from x = 0.5 on, below a trunk at 0 and at 1 m."""
    step = '<geom name="step" type="box" pos="1.5 0 0" size="1 1 .05" conaffinity="1"/><body name="trunk"'
    xml = (WALKERS / "biped.xml").read_text().replace('<body name="trunk"', step)
    assert step in xml
    (tmp_path / "biped.xml").write_text(xml)
    (tmp_path / "biped.yaml").write_bytes((WALKERS / "biped.yaml").read_bytes())
    model = model_of_file(tmp_path / "biped.yaml")()
    params = model.params({q.name: jnp.asarray(q.default, float) for q in model.parameters})
    starts = {q.name: jnp.asarray(0.0) for q in model.initial_conditions}
    heights = [
        float(model.signal(params, model.init(params, {**starts, "x_0": jnp.asarray(x)}))["height"])
        for x in (0.0, 1.0)
    ]
    assert heights[0] - heights[1] == pytest.approx(0.05, abs=1e-12)


@pytest.mark.slow
def test_the_order_of_legs_counts_and_that_of_their_joints_does_not(tmp_path: Path) -> None:
    """The first leg closes the cycle. Feedback reads the hips: by it, the angle 0.2 rad of hip_r adds
    3 x 0.2 / 0.05 = 12 1/s to the rate of its extensor and takes them from its flexor's."""
    text = (WALKERS / "biped.yaml").read_text().replace(PHASES, MATSUOKA)
    left, right = (line for line in text.splitlines(keepends=True) if "foot: foot_" in line)
    (tmp_path / "biped.xml").write_text((WALKERS / "biped.xml").read_text())
    path = tmp_path / "biped.yaml"

    def model_of(legs: str) -> Any:
        path.write_text(text.replace(left + right, legs))
        return model_of_file(path)()

    def rates(model: Any, hip_r: float) -> np.ndarray:
        p = model.params({q.name: jnp.asarray(q.default, float) for q in model.parameters})
        starts = {q.name: jnp.asarray(0.0) for q in model.initial_conditions}
        return np.asarray(model.rates(p, model.init(p, {**starts, "hip_r_0": jnp.asarray(hip_r)}))["u"])

    knee_first = right.replace("hip: hip_r, knee: knee_r", "knee: knee_r, hip: hip_r")
    model = model_of(left + knee_first)
    felt = rates(model, 0.2) - rates(model, 0.0)
    np.testing.assert_allclose(np.abs(felt), [0.0, 12.0, 0.0, 12.0], atol=1e-9)
    swapped = model_of(right + left)
    assert type(swapped) is not type(model)
    assert swapped.data_digest != model.data_digest
    np.testing.assert_allclose(rates(swapped, 0.2) - rates(swapped, 0.0), felt[[1, 0, 3, 2]], atol=1e-9)


def test_signals_of_positions_name_their_joints_with_units() -> None:
    """The addresses and kinds of joints are those of MuJoCo; a quaternion has no unit."""
    model = model_of_file(WALKERS / "quadruped.yaml")()
    m = mujoco.MjModel.from_xml_path(str(WALKERS / "quadruped.xml"))
    signals = {q.name: q for q in model.signals}
    assert [name for name in signals if name.startswith("q_")] == [f"q_{i}" for i in range(m.nq)]
    for j in range(m.njnt):
        first = m.jnt_qposadr[j]
        if m.jnt_type[j] == mujoco.mjtJoint.mjJNT_FREE:
            units = ["m"] * 3 + ["1"] * 4
        else:
            units = ["m" if m.jnt_type[j] == mujoco.mjtJoint.mjJNT_SLIDE else "rad"]
        for i, unit in enumerate(units, first):
            assert signals[f"q_{i}"].unit == unit
            assert re.search(rf"\b{m.jnt(j).name}\b", signals[f"q_{i}"].meaning)
    table = pd.DataFrame({"row": [0], "q_8": [0.1]})
    table.attrs["quantities"] = quantities_of(model)
    label = described(table, "q_8")
    assert "knee_lf" in label
    assert label.endswith("(rad)")


def test_legs_without_names_of_gaits_are_drawn_with_their_names(tmp_path: Path) -> None:
    """The far leg is on the left, y > 0, in whatever order legs are listed."""
    text = re.sub(r"\bL\b", "port", re.sub(r"\bR\b", "starboard", (WALKERS / "biped.yaml").read_text()))
    (tmp_path / "biped.xml").write_text((WALKERS / "biped.xml").read_text())
    (tmp_path / "biped.yaml").write_text(text)
    model = model_of_file(tmp_path / "biped.yaml")()
    names = [q.name for q in model.signals if q.name.startswith(("q_", "contact_"))]
    values: dict[str, Any] = {q.name: q.default for q in model.parameters}
    drawn = model.skeleton(values, {n: np.zeros(2) for n in names})
    assert drawn is not None
    legs = [("port", True), ("starboard", False)]
    assert [(limb.name, limb.far) for limb in drawn.limbs] == legs
    assert [(limb.name, limb.far) for limb in model.limbs] == legs


def test_an_empty_model_file_and_a_body_that_is_not_located_are_refused(tmp_path: Path) -> None:
    (tmp_path / "biped.yaml").write_text("")
    with pytest.raises(JobError, match=r"is empty: a model file is a mapping \(body: \.\.\., controller"):
        model_of_file(tmp_path / "biped.yaml")
    (tmp_path / "biped.yaml").write_text((WALKERS / "biped.yaml").read_text())
    xml = (WALKERS / "biped.xml").read_text()
    (tmp_path / "biped.xml").write_text(xml.replace("<worldbody>", '<option density="1"/><worldbody>'))
    with pytest.raises(JobError, match=r"line 2: body is not accepted: .*fluid"):
        model_of_file(tmp_path / "biped.yaml")


def test_a_missing_model_file_is_refused_with_the_near_miss(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "biped.yaml").write_text("body: biped.xml\n")
    with pytest.raises(gs.models.ModelError, match=r"no such file in .*; did you mean biped\.yaml"):
        gs.models.find("bipde.yaml")


def test_an_edit_of_an_included_file_or_a_mesh_is_seen_and_the_body_is_drawn(tmp_path: Path) -> None:
    """A tetrahedron of three equal edges at right angles has its centre a quarter of the edge from each."""

    def write_mesh(edge: float) -> None:
        vertices = f"v 0 0 0\nv {edge} 0 0\nv 0 {edge} 0\nv 0 0 {edge}\n"
        file = tmp_path / "meshes" / "load.obj"
        file.write_text(vertices + "f 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n")
        # MuJoCo keeps meshes by their times in whole seconds
        os.utime(file, (1000.0 * edge, 1000.0 * edge))

    def write_assets(scale: float) -> None:
        mesh = f'<mesh name="load" file="load.obj" scale="{scale} {scale} {scale}"/>'
        (tmp_path / "assets.xml").write_text(f"<mujoco><asset>{mesh}</asset></mujoco>")

    def centre() -> float:
        model: Any = model_of_file(tmp_path / "biped.yaml")()
        defaults = {q.name: q.default for q in model.parameters}
        signals = {q.name: np.zeros(1) for q in model.signals}
        drawn = model.skeleton({"trunk_size": 1.1}, signals).bodies
        assert len(drawn) == 8  # the mesh, and seven geoms of trunk and legs
        return defaults["load_com_x"]

    (tmp_path / "meshes").mkdir()
    body = (WALKERS / "biped.xml").read_text()
    body = body.replace(
        "<worldbody>", '<compiler meshdir="meshes"/><include file="assets.xml"/><worldbody>', 1
    )
    load = '<body name="load"><geom type="mesh" mesh="load" mass="1"/></body>'
    (tmp_path / "biped.xml").write_text(body.replace('<geom name="trunk"', f'{load}<geom name="trunk"', 1))
    (tmp_path / "biped.yaml").write_text((WALKERS / "biped.yaml").read_text())
    write_mesh(0.1)
    write_assets(1.0)
    assert centre() == pytest.approx(0.1 / 4.0)
    write_mesh(0.25)
    assert centre() == pytest.approx(0.25 / 4.0)
    write_assets(2.0)
    assert centre() == pytest.approx(0.5 / 4.0)


@pytest.mark.slow
def test_a_stepped_model_file_moves_as_mujoco_c(tmp_path: Path) -> None:
    """The same controller by hand along MuJoCo C's own steps, through landings."""
    text = (WALKERS / "biped.yaml").read_text().replace("controller:", "dynamics: stepped\ncontroller:", 1)
    (tmp_path / "stepped.yaml").write_text(text)
    (tmp_path / "biped.xml").write_text((WALKERS / "biped.xml").read_text())
    kind: Any = model_of_file(tmp_path / "stepped.yaml")
    model = kind(dynamics="mujoco")
    m = mujoco.MjModel.from_xml_path(str(WALKERS / "biped.xml"))
    dt = m.opt.timestep
    trace = gs.simulate(model, duration=400 * dt, every=400 * dt, numerics={"dt": dt})
    data, phase, loads = mujoco.MjData(m), np.array([0.0, np.pi]), np.zeros(2)
    for _ in range(400):
        lift = np.maximum(-np.sin(phase), 0.0)
        hips, knees = 0.25 * np.cos(phase), 0.15 + lift
        data.ctrl[:] = [hips[0], knees[0], hips[1], knees[1]]
        pull = 4.0 * np.sin(phase[::-1] - phase - np.pi * np.array([1.0, -1.0]))
        phase = phase + dt * (6.0 + 0.03 * loads * np.cos(phase) + pull)
        mujoco.mj_step(m, data)
        loads = data.sensordata.copy()
    assert loads.max() > 30.0
    np.testing.assert_allclose(trace[[f"q_{i}" for i in range(m.nq)]].iloc[-1], data.qpos, rtol=0, atol=1e-8)


@pytest.mark.slow
def test_the_quadruped_trots_paces_and_bounds_at_half_the_time_step_too() -> None:
    """The second stairs of the example's job: gaits, lags and physical duty factors."""
    kind = model_of_file(WALKERS / "quadruped.yaml")
    tables = [
        gs.sweep(
            kind(),
            zip={"delta_RF": [np.pi, np.pi, 0.0], "delta_LH": [np.pi, 0.0, np.pi]},
            params={"sigma": 0.075, "delta_RH": "delta_RF + delta_LH"},
            run=gs.Settle(max_cycles=30, tolerance=0.03),
            numerics={"dt": dt},
            verify=0,
        ).table
        for dt in (0.002, 0.001)
    ]
    for table in tables:
        assert table["gait"].tolist() == ["trot", "pace", "bound"]
        assert set(table["status"].astype(str)) == {"settled"}
        duty = table[[f"duty_{i}_end" for i in (1, 2, 3, 4)]].to_numpy()
        assert duty.min() > 0.45
        assert duty.max() < 0.7
    strides = [table["stride_1_end"].to_numpy() for table in tables]
    np.testing.assert_allclose(*strides, rtol=0.02)  # a step of 2 ms is 0.5 % of a stride


@pytest.mark.slow
def test_bounces_of_a_located_foot_do_not_count() -> None:
    """A biped whose feet bounce for 42 ms after touchdown, and one whose feet do so before liftoff."""
    model = model_of_file(WALKERS / "biped.yaml")()
    values = {"sigma": [0.06, 0.05], "thigh_l_mass": [1.5, 4.0], "thigh_r_mass": [1.5, 4.0]}
    table = gs.sweep(model, zip=values, run=gs.Settle(tolerance=1e-4), verify=0).table
    traces = gs.sweep(model, zip=values, run=gs.Trace(duration=30.0, every=0.001), verify=0).table
    assert table["gait"].tolist() == ["walk", "walk"]
    shortest = 0.05 * 2.0 * np.pi / 6.0
    for row in (0, 1):
        trace = traces.loc[traces["row"] == row]
        down = trace["contact_1"].to_numpy() > 0.5
        t = trace["t"].to_numpy()
        touches = t[1:][down[1:] & ~down[:-1]]
        lifts = t[1:][~down[1:] & down[:-1]]
        lifts = lifts[lifts > touches[0]]
        before, after = lifts[: touches.size - 1], touches[1 : lifts.size + 1]
        before = before[: after.size]
        # a stance lasts from the end of one flight to the beginning of the next; bounces are no flights
        is_flight = after - before > shortest
        assert (~is_flight[-4:]).any()
        first, second = after[is_flight][-2:]
        stride = second - first
        stance = before[is_flight][-1] - first
        assert table["stride_1_end"].iloc[row] == pytest.approx(stride, abs=0.002)  # two samples
        assert table["duty_1_end"].iloc[row] == pytest.approx(stance / stride, abs=0.003)


def test_angles_of_a_start_are_the_quaternion_of_mujoco() -> None:
    """Yaw, pitch and roll as intrinsic z, y, x; a start's quaternion and angular velocity."""
    xml = """<mujoco><worldbody><geom type="plane" size="1 1 .1"/><body pos="0 0 1"><freejoint name="root"/>
      <geom name="ball" size=".1" mass="1"/></body></worldbody></mujoco>"""
    members = {"control": lambda self, p, s: jnp.zeros(0), "period": lambda self, p: jnp.ones(())}
    model = type("Ball", (gs.BodyModel,), {"body_file": xml, **members})()
    start: dict[str, Any] = {q.name: q.default for q in model.initial_conditions}
    start |= {"root_roll_0": 0.3, "root_pitch_0": 0.4, "root_yaw_0": 0.5, "root_w_y_0": 2.0}
    q, v = model.started_at(start)
    true = np.zeros(4)
    mujoco.mju_euler2Quat(true, np.array([0.5, 0.4, 0.3]), "zyx")
    np.testing.assert_allclose(q[3:], true, rtol=0, atol=1e-15)
    np.testing.assert_allclose(v, [0.0, 0.0, 0.0, 0.0, 2.0, 0.0])


def walker(folder: Path, mjcf: tuple[str, str] = ("", ""), file: tuple[str, str] = ("", "")) -> Any:
    """The model of the biped with a piece of its MJCF and one of its model file replaced."""
    (folder / "biped.xml").write_text((WALKERS / "biped.xml").read_text().replace(*mjcf))
    path = folder / "biped.yaml"
    text = (WALKERS / "biped.yaml").read_text()
    for old, new in zip(file[::2], file[1::2], strict=True):
        text = text.replace(old, new)
    path.write_text(text)
    return model_of_file(path)()


def test_a_model_file_has_its_shortest_contact_and_the_meaning_of_a_fall(tmp_path: Path) -> None:
    model = walker(tmp_path, file=("fallen: 0.47", "shortest_contact: 0.1\nfallen: 0.5"))
    assert model.declarations.feet.shortest_contact == 0.1
    assert type(model).failed.__doc__ == "The trunk sank below `fallen` = 0.5 m."
    assert variables_without_rate(model) == ()


def test_the_height_of_a_trunk_counts_from_the_plane_of_the_mjcf(tmp_path: Path) -> None:
    heights = []
    for z in (0.0, -0.9):
        floor = ('name="floor" type="plane"', f'name="floor" pos="0 0 {z}" type="plane"')
        model = walker(tmp_path, floor, ("controller:", "dynamics: stepped\ncontroller:"))
        params = model.params({q.name: jnp.asarray(q.default, float) for q in model.parameters})
        state = model.init(params, {q.name: jnp.asarray(0.0) for q in model.initial_conditions})
        heights.append(float(model.observe(params, state)["height"]))
    assert heights[1] - heights[0] == pytest.approx(0.9, abs=1e-12)


def test_the_phase_of_the_first_leg_begins_below_a_turn(tmp_path: Path) -> None:
    """Beyond one it would never meet the section, which is the end of the first turn."""
    model = walker(tmp_path, file=("{L: 0, R: pi}", "{L: 2*pi, R: 3*pi}"))
    _, starts = sampled_points(model, 1)
    assert [starts[f"phase_{i}_0"][0] for i in (1, 2)] == pytest.approx([0.0, 3.0 * np.pi], abs=1e-12)


@pytest.mark.slow
def test_legs_whose_names_give_no_gaits_are_remarked(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert walker(tmp_path).caveats() == []
    renamed = ("L: {foot", "left: {foot", "R: {foot", "right: {foot", "{L: 0, R: pi}", "{left: 0, right: pi}")
    with pytest.raises(JobError, match=r"shortest_contact has no effect: the legs left, right"):
        walker(tmp_path, file=(*renamed, "fallen", "shortest_contact: 0.1\nfallen"))  # pyright: ignore[reportArgumentType]
    (remark,) = walker(tmp_path, file=renamed).caveats()  # pyright: ignore[reportArgumentType]
    assert "left, right have no lags" in remark
    assert "L, R; LF, RF, LH, RH" in remark
    assert "call left L, right R" in remark
    job = {
        "name": "j",
        "model": str(tmp_path / "biped.yaml"),
        "vary": {"omega": [6, 7]},
        "run": {"kind": "settle"},
    }
    (tmp_path / "job.yaml").write_text(json.dumps(job))
    assert main(["check", str(tmp_path / "job.yaml")]) == 0
    assert "Warning" in (checked := capsys.readouterr().err)
    assert remark in checked


def test_a_foot_that_is_no_geom_is_refused_with_the_names_of_geoms(tmp_path: Path) -> None:
    """Geoms without a name are not among them."""
    without_name = ('<geom name="trunk"', "<geom")
    with pytest.raises(JobError, match=r"did you mean foot_l\? Allowed: floor, thigh_l"):
        walker(tmp_path, mjcf=without_name, file=("foot: foot_l", "foot: foo_l"))


@pytest.mark.slow("located")
@pytest.mark.parametrize("dynamics", ["located", "stepped"])
def test_a_body_that_begins_in_the_ground_is_remarked(tmp_path: Path, dynamics: str) -> None:
    """At its pose in the file the biped's feet touch the floor, so z_0 is minus their depth."""
    model = walker(tmp_path, file=("fallen", f"dynamics: {dynamics}\nfallen"))
    # the first ones are the defaults
    values, starts = (
        {name: column[[0, 0]] for name, column in group.items()} for group in sampled_points(model, 1)
    )

    def remarked(z: float) -> list[str]:
        columns = {**starts, "z_0": np.array([0.5, z])}
        return starts_in_ground(model, values, columns, lambda row: f" in row {row}")

    assert remarked(0.0) == []
    (sentence,) = remarked(-0.03)
    assert "in row 1: foot_l 0.03 m, foot_r 0.03 m" in sentence
    assert ("`start: standing` in the model file, which compiles for about" in sentence) == (
        dynamics == "located"
    )
    lifted = re.search(r"`start: {z_0: ([-+.e0-9]+)}`", sentence)
    assert lifted is not None
    assert float(lifted[1]) == pytest.approx(0.0, abs=1e-9)
    if dynamics == "located":
        # one contact carries the body at weight / stiffness
        weight = 9.81 * sum(mass[0] for name, mass in values.items() if name.endswith("_mass"))
        at_rest = weight / values["foot_l_contact_stiffness"][0]
        assert remarked(-0.99 * at_rest) == []
        assert remarked(-1.01 * at_rest)


@pytest.mark.slow
def test_the_biped_walks_with_the_matsuoka_oscillators_of_the_guide(tmp_path: Path) -> None:
    page = (Path(__file__).parents[2] / "docs" / "walker.md").read_text()
    text = page[page.index("# matsuoka.yaml") :]
    (tmp_path / "matsuoka.yaml").write_text(text[: text.index("```")])
    shutil.copy(WALKERS / "biped.xml", tmp_path)
    run = gs.Settle(max_cycles=100)
    model = model_of_file(tmp_path / "matsuoka.yaml")()
    table = gs.sweep(model, run=run, knee_lift=[0.8, 0.9], pitch_stiffness=300.0, verify=0).table
    assert table["status"].tolist() == ["settled"] * 2
    assert table["gait"].tolist() == ["walk"] * 2
    assert np.all(table["speed_end"] > 0.2)
