"""Bodies of an MJCF beside MuJoCo C: contacts with a plane, sensors, Runge-Kutta steps, keyframes."""

# MuJoCo's compiled modules come without types.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

import importlib.util
import re
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from typer.testing import CliRunner

import gaitsweep as gs
from gaitsweep.cli.commands import app
from gaitsweep.dynamics.mjx import against_c
from gaitsweep.dynamics.mjx.against_c import _differences, at_first_use, compare
from gaitsweep.dynamics.mjx.mjx_body import MjxBody, mjx
from gaitsweep.dynamics.mjx.refusals import cautions
from gaitsweep.examples.mujoco_hopper import MujocoHopper
from gaitsweep.models.conformity import fault

# XLA's optimizations would take longer than they save
CHEAP: dict[str, str | bool] = {"xla_backend_optimization_level": "0"}

LYING = """<mujoco><worldbody><geom name="floor" type="plane" size="5 5 .1" euler="5 -8 0"/>
  <body><freejoint/><geom type="capsule" size=".05 .2" mass="1" contype="2" conaffinity="7"/></body>
  <body><freejoint/><geom type="box" size=".1 .07 .05" mass="1" contype="0"/></body>
  <body><freejoint/><geom type="cylinder" size=".06 .1" mass="1" contype="0"/></body>
  <body><freejoint/><geom type="capsule" size=".08 .3" mass="1" contype="2" conaffinity="2"/></body>
  <body><freejoint/><geom size=".1" mass="1" contype="4" conaffinity="2"/></body>
  </worldbody></mujoco>"""


def test_contacts_have_the_points_and_frames_of_c() -> None:
    """At random attitudes, and standing and lying: MJX alone chooses other axes below 30 degrees of tilt."""
    body = MjxBody(LYING, contact=True)
    m = body.mj_model

    def contacts(q: jax.Array) -> Any:
        model, data = body._begun({}, body.start(q, jnp.zeros(m.nv)))
        data: Any = mjx.collision(model, mjx.kinematics(model, data))._impl
        return data.contact.dist, data.contact.pos, data.contact.frame

    with jax.numpy_rank_promotion("allow"):
        run = jax.jit(contacts).lower(jnp.asarray(m.qpos0)).compile(CHEAP)
    chance = np.random.default_rng(0)
    special = ([1, 0, 0, 0], [1, 1, 0, 0], [1, 0, 1, 0], [1, 0.3, 0, 0])
    seen, touching = 0, np.zeros(2)
    for i in range(30):
        data = mujoco.MjData(m)
        for k in range(5):
            quaternion = special[i] if i < len(special) and k < 3 else chance.normal(size=4)
            xy = chance.uniform(-0.1, 0.1, 2) + np.array([0.0, 2.0 * (k if k < 3 else 0)])
            # at most as deep as half its height, as bodies that touch are
            data.qpos[7 * k : 7 * k + 7] = [*xy, 0.14 * xy[0] - 0.09 * xy[1] + 0.04, *quaternion]
        mujoco.mj_normalizeQuat(m, data.qpos)
        mujoco.mj_kinematics(m, data)
        mujoco.mj_collision(m, data)
        distance, place, frame = (np.asarray(each) for each in run(data.qpos))
        assert (distance < 0.0).sum() == data.ncon
        for contact in data.contact:
            places = np.flatnonzero((distance < 0.0) & (np.abs(place - contact.pos).max(axis=1) < 1e-9))
            assert places.size == 1
            np.testing.assert_allclose(distance[places[0]], contact.dist, rtol=0, atol=1e-12)
            # C completes a frame by the rules of its own: normal, then the first axis
            full = np.array(contact.frame).copy()
            np.testing.assert_allclose(frame[places[0], 0], full[:3], rtol=0, atol=1e-12)
            axis = full[3:6] - full[:3] * (full[:3] @ full[3:6])
            if (length := np.linalg.norm(axis)) > 1e-9:
                np.testing.assert_allclose(frame[places[0], 1], axis / length, rtol=0, atol=1e-9)
        seen += data.ncon
        touching += np.array([any(set(c.geom) == {1, k} for c in data.contact) for k in (4, 5)])
    assert seen > 100
    assert (touching > 10).all()


# No constraint acts, and bodies turn about changing axes; the second keyframe has all that a start takes.
TURNING = """<mujoco><option timestep="0.01" integrator="RK4"><flag energy="enable"/></option>
  <default><geom contype="0" conaffinity="0"/></default><worldbody>
  <body name="m" mocap="true" pos="0 0 3"><site name="m"/></body>
  <body name="b" pos="0 0 1"><freejoint name="f"/><geom type="box" size=".1 .2 .3" mass="1"/>
  <body pos=".5 0 0"><joint type="ball" damping=".1"/>
  <geom type="box" size=".1 .05 .2" pos=".2 .1 0" mass="1"/>
  <body pos=".4 0 0"><joint name="j" axis="0 1 0"/><geom size=".05" pos=".1 0 0" mass=".2"/>
  <site name="s" pos=".1 0 0"/></body></body></body></worldbody>
  <actuator><general name="a" joint="j" dyntype="filter" dynprm=".3" gainprm=".03"/></actuator>
  <sensor><clock/><accelerometer site="s"/><actuatorfrc actuator="a"/><jointpos joint="j"/>
  <framelinacc objtype="site" objname="s" cutoff="2"/><framepos objtype="site" objname="m"/></sensor>
  <keyframe><key name="rest"/><key name="thrown" time="3" act="2" ctrl=".5" mpos="0 1 2" mquat="0 1 0 0"
  qpos="0 0 1 1 0 0 0 1 0 0 0 .3" qvel=".1 .2 .3 1 2 3 .5 -.4 1 .2"/></keyframe></mujoco>"""


def model_of(xml: str, control: Any = None, **members: Any) -> gs.MjcfModel:
    functions = {
        "control": control or (lambda self, p, s: jnp.zeros(self.mjx_body.mj_model.nu)),
        "period": lambda self, p: jnp.asarray(1.0),
        "omega": gs.parameter("rad/s", "frequency", 1.0),
        "phi": gs.variable("rad", "phase", 0.0),
    }
    return type("Body", (gs.MjcfModel,), {"body_file": xml, **functions, **members})(dynamics="mjx")


@pytest.mark.slow
def test_a_start_sensors_and_runge_kutta_are_those_of_c() -> None:
    """Sensors are those of a step's beginning, also without a constraint; turns are of order 4."""
    model = model_of(TURNING, lambda self, p, s: self.keyframe_ctrl, keyframe="thrown")
    m = mujoco.MjModel.from_xml_string(TURNING)
    data = mujoco.MjData(m)
    mujoco.mj_resetDataKeyframe(m, data, 1)
    params = model.params({"omega": jnp.ones(())})
    start = {q.name: jnp.asarray(q.default, float) for q in model.initial_conditions}
    state = model.init(params, start)
    run = jax.jit(model.step).lower(params, state, jnp.asarray(0.01)).compile(CHEAP)
    assert not model.mjx_body.start(jnp.zeros(12), jnp.zeros(10)).warm.size
    for _ in range(30):
        mujoco.mj_step(m, data)
        state = run(params, state, jnp.asarray(0.01))
        for found, true in (
            (state.body.q, data.qpos), (state.body.v, data.qvel), (state.body.act, data.act),
            (state.body.time, [data.time]), (state.sensors, data.sensordata),
        ):  # fmt: skip
            np.testing.assert_allclose(found, true, rtol=1e-10, atol=1e-10)
    assert data.sensordata[0] > 3.2  # the keyframe's time counts on
    assert np.abs(data.sensordata[6:9]).max() == 2.0  # cut off


def test_keyframes_are_taken_by_name_and_controls_have_one_shape() -> None:
    assert model_of(TURNING).mjx_body.start(jnp.zeros(12), jnp.zeros(10)).act == 0.0
    with pytest.raises(ValueError, match="no keyframe 'thrwn'; did you mean thrown"):
        model_of(TURNING, keyframe="thrwn").mjx_body  # noqa: B018 - compiles it
    for given in (jnp.zeros(()), jnp.zeros(2), jnp.zeros((1, 1))):
        model = model_of(TURNING, lambda self, p, s, given=given: given)
        with pytest.raises(ValueError, match=re.escape(f"shape {given.shape}, but must return (1,)") + ".*a"):
            model.checked_control(None, None)


def test_untraceable_features_are_named(monkeypatch: Any) -> None:
    xml = "<mujoco><worldbody><body><joint/><geom size='.1'/><site name='s'/></body></worldbody>"
    body = MjxBody(xml + "<sensor><rangefinder name='rf' site='s'/></sensor></mujoco>", contact=True)
    monkeypatch.setattr("mujoco.mjx._src.ray.ray", None)
    with pytest.raises(ValueError, match=r"cannot step this MJCF .*'rf'.*: TypeError"):
        jax.eval_shape(lambda s: body.step({}, s, 0.01)[0], body.start(jnp.zeros(1), jnp.zeros(1)))


STANDING = """<mujoco><option timestep="0.002"/><worldbody><geom name="floor" type="{}" size="1 1 .1"/>
  <body pos="0 0 .3" euler="20 30 10"><freejoint name="f"/>
  <geom name="g" type="box" size=".1 .07 .05"/></body>
  </worldbody></mujoco>"""


@pytest.mark.slow
def test_a_different_motion_is_reported(monkeypatch: Any, tmp_path: Path) -> None:
    """Boxes on boxes have other contacts in MJX; the result is cached."""
    result = compare(model_of(STANDING.format("box")), 100)
    assert result.starts == 9
    assert result.caused
    first = result.caused[0]
    assert first.element == "Joint 'f'"
    assert "box 'floor' with box 'g'" in first.cause
    assert abs(first.ours - first.theirs) > against_c.TOLERANCE * max(1.0, abs(first.theirs))
    monkeypatch.setenv("GAITSWEEP_CACHE", str(tmp_path))
    monkeypatch.setattr(against_c, "compare", lambda model, steps: result)
    message = at_first_use(model_of(STANDING.format("box")))
    assert any("another algorithm" in each for each in message)
    assert any("Joint 'f'" in each for each in message)
    monkeypatch.setattr(against_c, "compare", None)
    assert at_first_use(model_of(STANDING.format("box"))) == message
    (file,) = (tmp_path / "mjcf_comparisons").iterdir()
    file.write_text("[1")
    with pytest.raises(TypeError):  # it is compared anew
        at_first_use(model_of(STANDING.format("box")))


def test_other_numbers_in_a_control_are_compared_anew(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also those of an array, which the text of a jaxpr does not have."""
    monkeypatch.setenv("GAITSWEEP_CACHE", str(tmp_path))
    monkeypatch.setattr(against_c, "_sentences", lambda model, control: [str(control)])
    xml = """<mujoco><worldbody><body><joint name="j"/><geom size=".1"/></body></worldbody>
      <actuator><motor joint="j"/></actuator></mujoco>"""
    for target in (np.array([0.5]), np.array([0.25])):
        sentences = at_first_use(model_of(xml, lambda self, p, s, target=target: jnp.asarray(target)))
        assert sentences == [str(target)]


def test_differences_from_numbers_that_are_not_finite_are_infinite() -> None:
    ours, theirs = np.array([1.0, np.nan, 1.0, 30.0]), np.array([1.0, 1.0, np.nan, 20.0])
    assert _differences(ours, theirs).tolist() == [0.0, np.inf, np.inf, 0.5]


@pytest.mark.slow
def test_a_box_on_a_plane_moves_as_in_c() -> None:
    result = compare(model_of(STANDING.format("plane")), 300)
    assert not result.divergences
    assert result.largest < 1e-6


@pytest.mark.slow
@pytest.mark.parametrize(
    ("package", "file"),
    [("gymnasium", "envs/mujoco/assets/ant.xml"), ("dm_control", "suite/humanoid.xml")],
)
def test_bodies_of_packages_move_as_in_c(package: str, file: str) -> None:
    spec = importlib.util.find_spec(package)
    if spec is None or spec.origin is None:
        pytest.skip(f"{package} is not installed")
    result = compare(model_of(str(Path(spec.origin).parent / file)), 64)
    assert not result.divergences
    assert result.largest < 1e-6


def test_contacts_by_another_algorithm_are_cautioned_of_by_name() -> None:
    assert cautions(mujoco.MjModel.from_xml_string(STANDING.format("plane"))) == []
    (caution,) = cautions(mujoco.MjModel.from_xml_string(STANDING.format("box")))
    assert "'floor' with 'g'" in caution


def test_check_model_beside_c_is_for_models_of_an_mjcf() -> None:
    run = CliRunner().invoke
    other = run(app, ["check-model", "multilegged", "--against-c"])
    assert isinstance(other.exception, gs.ArgumentError)
    alone = run(app, ["check-model", "multilegged", "50"])
    assert isinstance(alone.exception, gs.ArgumentError)


@pytest.mark.slow
def test_check_model_steps_beside_c() -> None:
    done = CliRunner().invoke(
        app, ["check-model", "gaitsweep.examples.mujoco_hopper:MujocoHopper", "--against-c", "40"]
    )
    assert done.exit_code == 0, done.output
    assert "9 of 9 motions of 40 steps agree" in done.output


@pytest.mark.parametrize(
    ("first", "second", "words"),
    [
        ("q", "knee", "signal q_0 has the name of a"),
        ("a-b", "a_b", "have the name a_b_0 twice"),
        ("x", "x_rate", "have the name x_rate_0 twice"),
    ],
)
def test_joints_whose_starts_would_be_one_are_refused(first: str, second: str, words: str) -> None:
    xml = f"""<mujoco><worldbody><body pos="0 0 1">
      <joint name="{first}" axis="0 1 0"/><geom size=".1" mass="1"/>
      <body pos=".4 0 0"><joint name="{second}" axis="0 1 0"/><geom size=".1" mass="1"/></body></body>
      </worldbody></mujoco>"""
    assert words in (fault(model_of(xml)) or "")


@pytest.mark.slow
def test_a_comparison_that_takes_time_is_announced(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It is announced until the cache has it."""
    monkeypatch.setenv("GAITSWEEP_CACHE", str(tmp_path))
    monkeypatch.setattr("gaitsweep.dynamics.mjx.against_c._sentences", lambda model, control: [])
    hopper = MujocoHopper(dynamics="mjx")
    assert "compiles" in hopper.caveats_notice
    assert hopper.caveats() == []
    assert hopper.caveats_notice == ""
