"""Bodies of an MJCF with located contacts: against MuJoCo C, by convergence, and by their parameters."""

# MuJoCo's compiled modules come without types.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

import gc
import importlib.util
import types
import weakref
from functools import cache
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

import gaitsweep as gs
from gaitsweep.dynamics.body.body_model import Standing
from gaitsweep.dynamics.body.coverage import touches
from gaitsweep.dynamics.body.mechanics import LocatedBody
from gaitsweep.dynamics.tree import tilted
from gaitsweep.engine.kernel import cuda_lanes
from gaitsweep.engine.numerics import Numerics
from gaitsweep.engine.recorders.recordings import CrossingRecorder
from gaitsweep.expression import evaluate
from tests.support.host_card import HostCard, compiler
from tests.support.sweeping import run_rows

LEG = """
<body name="thigh_{side}"><joint name="hip_{side}" axis="0 -1 0" range="-60 60"/>
  <geom name="thigh_{side}" type="capsule" fromto="0 0 0 0 0 -.42" size=".04" mass="2" contype="0"/>
  <body name="shin_{side}" pos="0 0 -.42"><joint name="knee_{side}" axis="0 1 0" range="-2 100"/>
    <geom name="shin_{side}" type="capsule" fromto="0 0 0 0 0 -.41" size=".03" mass="1" contype="0"/>
    <geom name="foot_{side}" type="sphere" pos="0 0 -.41" size=".04" mass=".2"/>
  </body>
</body>"""
BIPED = f"""
<mujoco model="biped"><option timestep="0.001" integrator="RK4"/>
  <default><geom contype="1" conaffinity="0" friction="0.9"/><joint damping="0.5"/>
    <position kp="150" kv="3"/></default>
  <worldbody>
    <geom name="floor" type="plane" size="20 1 .1" conaffinity="1"/>
    <body name="trunk" pos="0 0 .87">
      <joint name="x" type="slide" axis="1 0 0" damping="0"/>
      <joint name="z" type="slide" axis="0 0 1" damping="0"/>
      <joint name="pitch" type="hinge" axis="0 1 0" damping="0"/>
      <geom name="trunk" type="capsule" fromto="0 0 0 0 0 .35" size=".06" mass="8"/>
      {LEG.format(side="l")} {LEG.format(side="r")}
    </body>
  </worldbody>
  <actuator>
    <position name="hip_l" joint="hip_l"/><position name="knee_l" joint="knee_l"/>
    <velocity name="hip_r" joint="hip_r" kv="4"/><motor name="knee_r" joint="knee_r" gear="5"/>
  </actuator>
</mujoco>"""
# a leg on a rail: three degrees of freedom, one foot
HOPPER = """
<mujoco><option timestep="0.0005"/><worldbody>
  <geom name="floor" type="plane" size="9 9 .1" conaffinity="1"/>
  <body name="trunk" pos="0 0 .5"><joint name="z" type="slide" axis="0 0 1"/>
    <joint name="x" type="slide" axis="1 0 0"/>
    <geom name="trunk" type="box" size=".1 .1 .05" mass="2" contype="0" conaffinity="0"/>
    <body name="leg"><joint name="leg" axis="0 1 0" damping=".2"/>
      <geom name="leg" type="capsule" fromto="0 0 0 0 0 -.45" size=".02" mass=".3" contype="0"/>
      <geom name="foot" type="sphere" pos="0 0 -.45" size=".05" mass=".1" conaffinity="0"/>
    </body></body>
  </worldbody>
  <actuator><position name="leg" joint="leg" kp="40" kv="1"/></actuator>
</mujoco>"""
FLYING: dict[str, Any] = {
    "hip_l_0": 0.3, "hip_l_rate_0": 2.0, "knee_l_0": 0.6, "hip_r_0": -0.3, "knee_r_0": 0.5,
    "knee_r_rate_0": 1.0, "pitch_rate_0": 1.5, "x_rate_0": 1.0,
}  # fmt: skip
# a foot that hits the ground at 1.3 m/s, slips, and rises
HOP: dict[str, Any] = {"z_0": 0.08, "z_rate_0": -0.3, "x_rate_0": 0.4, "leg_0": 0.2, "swing": 0.5}
EXACT = {"method": "tsit5", "rtol": 1e-12, "atol": 1e-13}


class Swinging(gs.BodyModel):
    """A body whose actuators all follow one oscillator."""

    body_file = HOPPER
    omega = gs.parameter("rad/s", "frequency", 9.0)
    swing = gs.parameter("rad", "amplitude", 0.4)
    phi = gs.variable("rad", "phase", 0.0, circular=True)

    def control(self, p: Any, s: Any) -> Any:
        return p.swing * jnp.sin(s.phi + jnp.arange(self.body.nu))

    def rates(self, p: Any, s: Any) -> Any:
        return {"phi": p.omega}

    @gs.event("the oscillator begins a turn", section=True)
    def turn(self, p: Any, s: Any) -> Any:
        return s.phi - 2.0 * jnp.pi

    @turn.jump
    def wrap(self, p: Any, s: Any) -> Any:
        return s.replace(phi=s.phi - 2.0 * jnp.pi)

    @gs.observable("m", "height of the trunk", scale=0.1)
    def height(self, p: Any, s: Any) -> Any:
        return self.position(s, "z")

    @gs.signal("N", "force of the ground")
    def force(self, p: Any, s: Any) -> Any:
        return self.load(p, s, "foot")

    def period(self, p: Any) -> Any:
        return 2.0 * jnp.pi / p.omega


def of(xml: str, **members: Any) -> Any:
    """A model of this body, with a pass-through of the force where it has no foot."""
    return type("Body", (Swinging,), {"body_file": xml, "force": None, **members})()


def begun(model: Any, **values: float) -> tuple[Any, Any]:
    """Parameters and state at the defaults, but for these values."""
    settings = {q.name: jnp.asarray(values.get(q.name, q.default), float) for q in model.parameters}
    starts = {q.name: jnp.asarray(values.get(q.name, q.default), float) for q in model.initial_conditions}
    params = model.params(settings)
    return params, model.init(params, starts)


def in_c(xml: str, start: dict[str, float]) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """MuJoCo's model and data at a start."""
    model = mujoco.MjModel.from_xml_string(xml)
    data = mujoco.MjData(model)
    for name, value in start.items():
        if name.endswith("_rate_0"):
            data.joint(name.removesuffix("_rate_0")).qvel[0] = value
        else:
            data.joint(name.removesuffix("_0")).qpos[0] = value
    return model, data


@cache
def flow_of(model: Any) -> Any:
    params, state = begun(model)

    def rates(q: Any, v: Any, phi: Any) -> Any:
        rate = model.flow(params, state.replace(q=q, v=v, phi=phi))
        return rate["q"], rate["v"]

    return jax.jit(rates).lower(state.q, state.v, state.phi).compile({"xla_backend_optimization_level": "0"})


@pytest.mark.slow
def test_free_motion_is_mujocos_at_the_same_steps() -> None:
    """Joints with servos and motors in flight, by Runge and Kutta's steps: only the rounding differs."""
    xml = BIPED.replace('pos="0 0 .87"', 'pos="0 0 5"').replace('range="-2 100"', 'range="-60 100"')
    model = of(xml)
    flow = flow_of(model)
    _, state = begun(model, **FLYING)
    m, data = in_c(xml, FLYING)
    data.ctrl[:] = 0.4 * np.sin(np.arange(4))
    h, q, v, phi = 1e-3, state.q, state.v, jnp.zeros(())
    for _ in range(200):
        k1 = flow(q, v, phi)
        k2 = flow(q + 0.5 * h * k1[0], v + 0.5 * h * k1[1], phi)
        k3 = flow(q + 0.5 * h * k2[0], v + 0.5 * h * k2[1], phi)
        k4 = flow(q + h * k3[0], v + h * k3[1], phi)
        q, v = (
            x + h / 6 * (a + 2 * b + 2 * c + d) for x, a, b, c, d in zip((q, v), k1, k2, k3, k4, strict=True)
        )
        mujoco.mj_step(m, data)
    assert np.abs(data.qpos[3:]).max() > 0.3
    np.testing.assert_allclose(q, data.qpos, rtol=0, atol=1e-12)
    np.testing.assert_allclose(v, data.qvel, rtol=0, atol=1e-11)


@pytest.mark.slow
def test_the_kernels_motion_is_mujocos_in_flight() -> None:
    """MuJoCo's steps of 0.1 ms have errors of some 1e-12."""
    start: dict[str, Any] = {"z_0": 3.0, "leg_0": 0.4, "leg_rate_0": -2.0, "x_rate_0": 1.0}
    trace = gs.simulate(Swinging(), **start, swing=0.0, duration=0.3, every=0.3, numerics=EXACT)
    xml = HOPPER.replace('timestep="0.0005"', 'timestep="0.0001" integrator="RK4"')
    m, data = in_c(xml, start)
    for _ in range(3000):
        mujoco.mj_step(m, data)
    np.testing.assert_allclose(trace[["q_0", "q_1", "q_2"]].to_numpy()[-1], data.qpos, rtol=0, atol=1e-10)


@pytest.mark.slow
@pytest.mark.parametrize("friction", [1, 3])
def test_a_body_at_rest_is_as_deep_as_in_mujoco(friction: int) -> None:
    """At rest MuJoCo's contact is a spring; elliptic cones have it in the normal direction alone."""
    xml = f"""<mujoco><option timestep="0.0005" cone="elliptic"/><worldbody>
      <geom type="plane" size="5 5 .1" condim="{friction}" margin=".003"/>
      <body pos="0 0 .1"><joint name="z" type="slide" axis="0 0 1"/>
        <geom name="ball" type="sphere" size=".1" mass="2" condim="{friction}" margin=".002"/></body>
    </worldbody></mujoco>"""
    m, data = in_c(xml, {})
    for _ in range(6000):
        mujoco.mj_step(m, data)
    model = of(xml, control=lambda self, p, s: jnp.zeros(0))
    trace = gs.simulate(model, duration=3.0, every=3.0)
    np.testing.assert_allclose(trace["q_0"].iloc[-1], data.qpos[0], rtol=1e-4)
    params, state = begun(model, z_0=float(trace["q_0"].iloc[-1]))
    assert state.pushing.all()
    np.testing.assert_allclose(model.load(params, state, "ball"), 2.0 * 9.81, rtol=1e-6)


@pytest.mark.slow
def test_a_body_at_rest_on_a_limit_is_where_it_is_in_mujoco() -> None:
    """A slide on the lower limit of its range, 1 cm before it by the margin; its spring is the deep one."""
    xml = """<mujoco><option timestep="0.0005"/><worldbody><body pos="0 0 1">
      <joint name="z" type="slide" axis="0 0 1" range="-.1 1" limited="true" margin=".01"/>
      <geom name="ball" type="sphere" size=".1" mass="2"/></body></worldbody></mujoco>"""
    m, data = in_c(xml, {})
    for _ in range(8000):
        mujoco.mj_step(m, data)
    trace = gs.simulate(of(xml, control=lambda self, p, s: jnp.zeros(0)), duration=4.0, every=4.0)
    assert data.qpos[0] > -0.0999
    np.testing.assert_allclose(trace["q_0"].iloc[-1], data.qpos[0], rtol=0, atol=3e-4)


@pytest.mark.slow
def test_errors_fall_with_the_fourth_power_of_the_step_through_contacts() -> None:
    """The foot lands, slips, sticks and leaves; a contact found at the end of a step alone has order 1."""

    def end(numerics: dict[str, Any]) -> np.ndarray:
        trace = gs.simulate(Swinging(), **HOP, duration=0.35, every=0.35, numerics=numerics)
        return trace[["q_0", "q_1", "q_2"]].to_numpy()[-1]

    force = gs.simulate(Swinging(), **HOP, duration=0.35, every=0.005, numerics=EXACT)["force"].to_numpy()
    assert (np.diff((force > 0.0).astype(int)) != 0).sum() >= 2  # it lands and leaves
    true = end(EXACT)
    steps = np.array([2e-4, 1e-4, 5e-5])
    errors = [np.abs(end({"method": "rk4", "dt": dt}) - true).max() for dt in steps]
    slope = np.polyfit(np.log(steps), np.log(errors), 1)[0]
    assert abs(slope - 4.0) < 0.4, (slope, errors)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("parameter", "value", "old", "new"),
    [
        ("trunk_mass", 3.0, 'mass="2"', 'mass="3"'),
        ("leg_damping", 0.7, 'damping=".2"', 'damping=".7"'),
        ("leg_kp", 60.0, 'kp="40"', 'kp="60"'),
        ("foot_friction", 0.3, 'size=".05" mass=".1"', 'size=".05" mass=".1" friction=".3" priority="1"'),
        ("gravity", 5.0, 'timestep="0.0005"', 'timestep="0.0005" gravity="0 0 -5"'),
    ],
)
def test_an_axis_equals_the_edited_file(parameter: str, value: float, old: str, new: str) -> None:
    """Rows of a sweep against the reloaded file; the ground's stiffness, which follows masses, is given."""
    assert old in HOPPER
    ground = {"foot_contact_stiffness": 2e4, "foot_contact_damping": 200.0, "foot_grip": 200.0}
    options: dict[str, Any] = {**HOP, **ground, "duration": 0.3, "every": 0.3, "numerics": EXACT}
    options_varied: dict[str, Any] = options | {parameter: value}
    varied = gs.simulate(Swinging(), **options_varied)
    edited = gs.simulate(of(HOPPER.replace(old, new)), **options)
    columns = ["q_0", "q_1", "q_2"]
    np.testing.assert_allclose(varied[columns].iloc[-1], edited[columns].iloc[-1], rtol=0, atol=1e-10)
    plain = gs.simulate(Swinging(), **options)
    assert np.abs(plain[columns].iloc[-1] - edited[columns].iloc[-1]).max() > 1e-4


@pytest.mark.slow
def test_a_size_equals_the_edited_lengths() -> None:
    """The body's lengths, its inertia and the place of what it carries, by one factor."""
    xml = BIPED.replace('fromto="0 0 0 0 0 -.42" size=".04"', 'fromto="0 0 0 0 0 -.63" size=".06"')
    edited = of(xml.replace('pos="0 0 -.42"', 'pos="0 0 -.63"'))
    plain = of(BIPED)
    sizes = {"thigh_l_size": 1.5, "thigh_r_size": 1.5}
    rng = np.random.default_rng(0)
    q, v = rng.normal(size=7), rng.normal(size=7)
    results = []
    for model, values in ((edited, {}), (plain, sizes)):
        params, _ = begun(model, **values)
        geometry = model.body.geometry(params.body)
        results.append([geometry.mass, geometry.com, geometry.inertia, geometry.position])
        stops = model.body.stretches(geometry, params.body, q, v)
        results[-1].append(np.array([float(stop.stretch) for stop in stops]))
    for one, other in zip(*results, strict=True):
        np.testing.assert_allclose(one, other, rtol=0, atol=1e-12)


def test_a_body_that_is_no_longer_used_is_freed() -> None:
    ball = """<mujoco><worldbody><geom type="plane" size="1 1 1"/><body name="ball" pos="0 0 1">
      <joint name="z" type="slide" axis="0 0 1"/><geom name="ball" size=".1"/></body></worldbody></mujoco>"""
    body = LocatedBody(mujoco.MjModel.from_xml_string(ball))
    values: dict[str, Any] = {quantity.name: quantity.default for quantity in body.parameters}
    height = body.heights(values, jnp.zeros(body.nq), jnp.zeros(body.nv))
    np.testing.assert_allclose(height, [-0.9], rtol=1e-15)
    reference = weakref.ref(body)
    del body
    gc.collect()
    assert reference() is None


@pytest.mark.slow
def test_the_return_map_has_a_derivative() -> None:
    """Against central differences through landings; the slide along the ground is no coordinate."""
    hop = gs.return_map(Swinging(), numerics={"method": "tsit5", "rtol": 1e-12, "atol": 1e-14})
    assert list(hop.coordinates) == ["z", "leg", "z_rate", "x_rate", "leg_rate", "phi"]
    x = hop.settled({"z_0": 0.02}, 2).at[0]
    # a foot in the ground is some 0.3 mm deep, so larger steps would see the map's curvature
    n, h = x.size, 1e-6
    ends = np.asarray(hop(x + h * np.concatenate([np.eye(n), -np.eye(n)])))
    central = ((ends[:n] - ends[n:]) / (2.0 * h)).T
    jacobian = np.asarray(hop.jacobian(x)).reshape(n, n)
    size = np.abs(central[:, :-1]).max()
    # the phase is 0 on the section: a start before it would cross it at once
    np.testing.assert_allclose(jacobian[:, :-1], central[:, :-1], rtol=0, atol=1e-6 * size)


def test_formulas_replace_numbers_of_the_file() -> None:
    model = of(BIPED, formulas={"thigh_l_mass": "2*thigh_l_size**3", "thigh_r_mass": "thigh_l_mass"})
    defaults = {q.name: q.default for q in model.parameters}
    assert defaults["thigh_r_mass"] == "thigh_l_mass"
    with pytest.raises(ValueError, match="thig_mass, no parameter of the body; did you mean"):
        _ = of(BIPED, formulas={"thig_mass": 1.0}).parameters


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        (
            'type="sphere" pos="0 0 -.45" size=".05"',
            'type="ellipsoid" pos="0 0 -.45" size=".05 .1 .05"',
            "foot' is of type ellipsoid",
        ),
        ('contype="0"/>\n      <geom name="foot"', '/>\n      <geom name="foot"', None),
        (
            "<actuator>",
            '<actuator><intvelocity name="m" joint="leg" kp="1" actrange="0 1"/>',
            "Actuator 'm' has activation",
        ),
        ('damping=".2"', 'frictionloss=".2"', "Joint 'leg' has frictionloss"),
        ('mass=".1" conaffinity="0"', 'mass=".1" conaffinity="0" condim="6"', "Geom 'foot' has condim 6"),
        (
            "</worldbody>",
            '<body name="other" pos="3 0 1"><freejoint/><geom name="o" size=".1"/></body></worldbody>',
            "'leg' and 'o' may touch",
        ),
        (
            'type="sphere" pos="0 0 -.45" size=".05" mass=".1" conaffinity="0"/>\n    </body></body>',
            'type="cylinder" pos="0 0 -.45" size=".05 .1" mass=".1" conaffinity="0"/>\n    </body></body>'
            '<geom name="step" type="box" size="1 1 .1"/>',
            "foot' is of type cylinder and may touch 'step'.*planar",
        ),
        (
            'type="sphere" pos="0 0 -.45" size=".05" mass=".1" conaffinity="0"/>\n    </body></body>',
            'type="box" pos="0 0 -.45" size=".05 .1 .05" mass=".1" conaffinity="0"/>\n    </body></body>'
            '<geom name="step" type="box" size="1 1 .1"/>',
            "foot' is of type box and may touch 'step'",
        ),
        (
            "</worldbody>",
            '<geom name="hills" type="hfield" hfield="h"/></worldbody><asset>'
            f'<hfield name="h" nrow="20" ncol="20" size="1 1 1 .1" elevation="{"0 " * 399}1"/></asset>',
            "'hills' is a height field of 20 x 20 points",
        ),
    ],
)
def test_what_is_not_covered_is_refused(old: str, new: str, sentence: str | None) -> None:
    assert old in HOPPER
    model = of(HOPPER.replace(old, new))
    if sentence is None:
        assert model.stops == 3
        return
    with pytest.raises(ValueError, match=sentence):
        _ = model.parameters


GYMNASIUM, SUITE = "gymnasium/envs/mujoco/assets", "dm_control/suite"


@pytest.mark.parametrize(
    ("file", "refused"),
    [
        (f"{GYMNASIUM}/hopper.xml", "'torso_geom' and 'leg_geom' may touch"),
        (f"{GYMNASIUM}/walker2d.xml", None),
        (f"{GYMNASIUM}/half_cheetah.xml", None),
        (f"{GYMNASIUM}/ant.xml", None),
        (f"{GYMNASIUM}/swimmer.xml", "fluid"),
        (f"{SUITE}/walker.xml", None),
        (f"{SUITE}/acrobot.xml", None),
        (f"{SUITE}/hopper.xml", "'torso' and 'thigh' may touch"),
        (f"{SUITE}/cheetah.xml", "'torso' and 'bshin' may touch"),
        (f"{SUITE}/quadruped.xml", "Actuator 'yaw_front_left' has activation dynamics"),
    ],
)
def test_known_bodies_load_or_are_refused_by_the_name_of_an_element(file: str, refused: str | None) -> None:
    """Bodies of Gymnasium and dm_control, where these packages are installed; MuJoCo C steps all of them."""
    package = importlib.util.find_spec(file.partition("/")[0])
    if package is None or not package.submodule_search_locations:
        pytest.skip(f"{file.partition('/')[0]} is not installed")
    path = str(Path(package.submodule_search_locations[0]).parent / file)
    members = {"control": lambda self, p, s: jnp.zeros(0), "period": lambda self, p: jnp.ones(())}
    assert type("Stepped", (gs.MjcfModel,), {"body_file": path, **members})(
        dynamics="mujoco"
    ).initial_conditions
    located = type("Located", (gs.BodyModel,), {"body_file": path, **members})()
    if refused is None:
        assert any(q.name.endswith("_mass") for q in located.parameters)
        return
    with pytest.raises(ValueError, match=refused):
        _ = located.parameters


def _file(file: str) -> str:
    """The path of a file of a package; the test is skipped where the package is not installed."""
    package = importlib.util.find_spec(file.partition("/")[0])
    if package is None or not package.submodule_search_locations:
        pytest.skip(f"{file.partition('/')[0]} is not installed")
    return str(Path(package.submodule_search_locations[0]).parent / file)


# The largest differences seen, as shares of the largest acceleration; see docs/own_model.md.
ACCELERATIONS = {
    f"{GYMNASIUM}/walker2d.xml": 1e-14,
    f"{GYMNASIUM}/half_cheetah.xml": 2e-15,
    f"{GYMNASIUM}/ant.xml": 3e-16,
    f"{GYMNASIUM}/inverted_double_pendulum.xml": 5e-15,
}


@pytest.mark.slow
@pytest.mark.parametrize("file", ACCELERATIONS)
def test_known_bodies_accelerate_as_in_c(file: str) -> None:
    """At random states without contacts; ten times the difference seen, since libraries round otherwise."""
    m = mujoco.MjModel.from_xml_path(_file(file))
    body = LocatedBody(m)
    values = {
        quantity.name: jnp.asarray(evaluate(quantity.default or 0.0, {})) for quantity in body.parameters
    }
    data, random = mujoco.MjData(m), np.random.default_rng(0)
    compared = 0
    for _ in range(20):
        mujoco.mj_resetData(m, data)
        for joint in range(m.njnt):
            at = m.jnt_qposadr[joint]
            if m.jnt_type[joint] == mujoco.mjtJoint.mjJNT_FREE:
                data.qpos[at + 2] += 3.0
                data.qpos[at + 3 : at + 7] += 0.3 * random.normal(size=4)
                data.qpos[at + 3 : at + 7] /= np.linalg.norm(data.qpos[at + 3 : at + 7])
            elif m.jnt_limited[joint]:
                data.qpos[at] = random.uniform(*(m.jnt_range[joint] @ [[0.8, 0.2], [0.2, 0.8]]))
            else:
                slides_up = m.jnt_type[joint] == mujoco.mjtJoint.mjJNT_SLIDE and m.jnt_axis[joint, 2] == 1.0
                data.qpos[at] += 3.0 if slides_up else 0.3 * random.normal()
        data.qvel[:] = random.normal(size=m.nv)
        data.ctrl[:] = random.uniform(-0.5, 0.5, m.nu)
        mujoco.mj_forward(m, data)
        if data.nefc:
            continue
        compared += 1
        pushing = jnp.zeros(len(body.stop_names), bool)
        ours = body.accelerations(values, data.qpos.copy(), data.qvel.copy(), data.ctrl.copy(), pushing)
        size = np.abs(data.qacc).max()
        np.testing.assert_allclose(ours, data.qacc, rtol=0, atol=10.0 * ACCELERATIONS[file] * size)
    assert compared > 10


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "kp", "kd", "targets", "height"),
    [
        ("hopper", 400.0, 20.0, None, 1.2075),
        ("walker2d", 400.0, 20.0, None, 1.2095),
        ("half_cheetah", 100.0, 5.0, None, -0.1122),
        ("ant", 150.0, 5.0, (0, 1, 0, -1, 0, -1, 0, 1), 0.5728),
    ],
)
def test_known_bodies_stand_with_springs_at_their_joints(
    name: str, kp: float, kd: float, targets: tuple[float, ...] | None, height: float
) -> None:
    """By MuJoCo's own steps, for 4 s: the root is where it was 2 s before, and nothing moves."""
    file = _file(f"{GYMNASIUM}/{name}.xml")
    m = mujoco.MjModel.from_xml_path(file)
    joints = m.actuator_trnid[:, 0]
    at, dof = m.jnt_qposadr[joints], m.jnt_dofadr[joints]
    wanted = m.qpos0[at] if targets is None else np.array(targets, float)
    root = 2 if m.jnt_type[0] == mujoco.mjtJoint.mjJNT_FREE else 1
    gear = m.actuator_gear[:, 0]
    members = {
        "body_file": file,
        "kp": gs.parameter("N m/rad", "spring of each joint", kp),
        "control": lambda self, p, s: (p.kp * (wanted - s.body.q[at]) - kd * s.body.v[dof]) / gear,
        "period": lambda self, p: jnp.ones(()),
        "height": gs.observable("m", "height of the root", scale=1.0)(lambda self, p, s: s.body.q[root]),
        "root": gs.signal("m", "height of the root")(lambda self, p, s: s.body.q[root]),
        "fastest": gs.signal("1", "largest velocity")(lambda self, p, s: jnp.max(jnp.abs(s.body.v))),
    }
    trace = gs.simulate(
        type("Standing", (gs.MjcfModel,), members)(dynamics="mujoco"), duration=4.0, every=0.5
    )
    assert trace["root"].iloc[-1] == pytest.approx(height, abs=1e-3)
    assert trace["root"].iloc[4:].to_numpy() == pytest.approx(height, abs=2e-3)
    assert trace["fastest"].iloc[-1] < 5e-3


@pytest.mark.slow
@pytest.mark.skipif(compiler() is None, reason="no C++ compiler")
def test_the_code_for_a_card_moves_the_body_as_that_for_the_processor(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The CUDA C, compiled for this machine, through landings on step and floor; both round differently."""

    class CudaDevice(HostCard):
        folder = tmp_path

    step = '<geom name="step" type="box" pos=".5 0 0" size=".45 9 .05" conaffinity="1"/></worldbody>'
    model = of(HOPPER.replace("</worldbody>", step))
    recorder = CrossingRecorder(model, crossings=2)
    starts = {"z_0": np.array([0.0, 0.03, 0.08]), "leg_0": np.array([0.0, 0.2, -0.3])}
    options: dict[str, Any] = {"numerics": Numerics(dt=5e-4, method="rk4"), "engine": "kernel"}
    here = run_rows(model, recorder, starts, **options)
    monkeypatch.setattr(cuda_lanes, "CudaDevice", CudaDevice)
    device = types.SimpleNamespace(platform="gpu")
    monkeypatch.setattr("tests.support.sweeping.devices_on", lambda platform, engine: [device])
    card = run_rows(model, recorder, starts, **options)
    assert np.isfinite(here.samples).all()
    np.testing.assert_allclose(card.samples, here.samples, rtol=1e-9, atol=1e-9)


@pytest.mark.slow
def test_a_gait_is_followed_along_a_mass_of_the_file() -> None:
    """The branch's end is the gait that a return map with that mass settles at."""
    numerics = {"method": "tsit5", "rtol": 1e-10, "atol": 1e-11}
    hop = gs.return_map(Swinging(), numerics=numerics)
    gait = hop.fixed_points(hop.settled({"z_0": 0.02}, 60))
    assert np.abs(hop.multipliers(gait)).max() < 1.0
    last = hop.continue_(gait, "trunk_mass", (2.0, 2.6)).iloc[-1]
    assert last["trunk_mass"] == pytest.approx(2.6)
    heavier = gs.return_map(Swinging(), numerics=numerics, trunk_mass=2.6)
    settled = heavier.settled({"z_0": float(last["height"])}, 60).at[0]
    np.testing.assert_allclose(settled[heavier.coordinates.index("z")], last["height"], rtol=0, atol=1e-7)


@pytest.mark.slow
def test_a_free_box_comes_to_rest_on_its_corners() -> None:
    """A body with six degrees of freedom, thrown forward: its corners carry its weight."""
    xml = """<mujoco><worldbody><geom type="plane" size="9 9 .1"/>
      <body pos="0 0 .2"><freejoint name="root"/>
        <geom name="box" type="box" size=".1 .15 .05" mass="2"/></body>
    </worldbody></mujoco>"""
    members = {
        "control": lambda self, p, s: jnp.zeros(0),
        "height": gs.observable("m", "height", scale=0.1)(lambda self, p, s: s.q[2]),
        "force": gs.signal("N", "force of the ground")(lambda self, p, s: self.load(p, s, "box")),
    }
    trace = gs.simulate(of(xml, **members), root_x_rate_0=0.5, root_z_rate_0=0.5, duration=2.0, every=0.1)
    end = trace.iloc[-1]
    assert trace["q_2"].to_numpy().max() > 0.2
    assert 0.0499 < float(end["q_2"]) < 0.05  # half the height of the box, less the depth
    assert end["force"] == pytest.approx(2.0 * 9.81, rel=1e-4)
    assert end["q_0"] > 0.1  # it flew and slid
    assert trace["q_0"].diff().iloc[-1] == pytest.approx(0.0, abs=1e-6)


READERS: dict[str, dict[str, Any]] = {
    "control": {"control": lambda self, p, s: jnp.stack([self.position(s, "x")])},
    "rate": {"rates": lambda self, p, s: {"phi": p.omega + self.position(s, "x")}},
    "event": {"turn": gs.event("x passes 1 m", section=True)(lambda self, p, s: self.position(s, "x") - 1.0)},
}


@pytest.mark.slow
def test_a_slide_along_the_ground_that_acts_on_the_motion_is_not_left_out() -> None:
    """A servo makes it a coordinate; a map does not cover states where a spring or a function reads it."""
    servo = HOPPER.replace("</actuator>", '<position joint="x" kp="50"/></actuator>')
    assert [of(xml).chart().coordinates[1].name for xml in (HOPPER, servo)] == ["leg", "x"]

    def covers(model: Any, **values: float) -> bool:
        return bool(model.chart().covers(*begun(model, **values)))

    assert covers(of(HOPPER))
    assert not covers(of(HOPPER), x_stiffness=3.0)
    assert not any(covers(of(HOPPER, **members)) for members in READERS.values())
    # of a free body the heading is left out, too
    free: dict[str, Any] = {"height": None, "control": lambda self, p, s: jnp.zeros(0)}
    steered = {"rates": lambda self, p, s: {"phi": p.omega + s.q[6]}}
    assert covers(of(BOX, **free))
    assert not covers(of(BOX, **free, **steered))


BOX = """<mujoco><worldbody><geom type="plane" size="9 9 .1"/>
  <body name="table" pos="0 0 .2"><freejoint name="root"/>
    <geom name="box" type="box" size=".1 .15 .05" mass="2"/></body></worldbody></mujoco>"""


@pytest.mark.slow
def test_a_return_map_does_not_cover_an_overturned_body() -> None:
    """Its coordinates are the tilt, which is that of an upright body too."""
    model = of(BOX, control=lambda self, p, s: jnp.zeros(0), height=None)
    params, state = begun(model)
    for pitch, is_covered in ((1.5, True), (1.6, False), (np.pi, False), (2.0 * np.pi - 1.5, True)):
        turned = jnp.array([np.cos(0.5 * pitch), 0.0, np.sin(0.5 * pitch), 0.0])
        at = state.replace(q=state.q.at[3:7].set(2.0 * turned))
        assert bool(model.chart().covers(params, at)) is is_covered
        back = tilted(model.chart().to_coordinates(params, at)[:2])
        same_pitch = abs(abs(back @ turned) - 1.0) < 1e-12
        assert bool(same_pitch) is is_covered


@pytest.mark.slow
def test_a_box_stands_on_its_corners_for_each_mass() -> None:
    """A sweep of masses, from tilted starts above the ground; a box sinks by m g / (4 K) into its corners.

    On a slope it creeps at a steady speed; on one steeper than its friction it has none.
    """
    members = {
        "body_file": BOX,
        "begins_standing": True,
        "control": lambda self, p, s: jnp.zeros(0),
        "height": gs.observable("m", "height", scale=0.1)(lambda self, p, s: s.q[2]),
        "force": None,
    }
    model = type("Table", (Swinging,), members)()
    masses = np.array([1.0, 5.0])
    stiffness = begun(model)[0].body["box_contact_stiffness"]
    run = gs.Trace(duration=1.0, every=0.5)
    with pytest.warns(
        UserWarning, match=r"2 rows \(the first is row 2\) could not begin.*does not stand still"
    ):
        result = gs.sweep(
            model, table_mass=masses, slope=[0.0, 0.05, 1.2], root_pitch_0=0.3, run=run, verify=0
        )
    table = result.table
    assert set(table["status"][table["slope"] > 1.0]) == {"not_a_number"}
    on_slope = table[table["slope"] == 0.05]
    way, drop = (
        on_slope.pivot(index="table_mass", columns="t", values=q).diff(axis=1) for q in ("q_0", "q_2")
    )
    np.testing.assert_allclose(way[1.0], way[0.5], rtol=1e-9)
    np.testing.assert_allclose(drop[[0.5, 1.0]], 0.0, atol=1e-12)
    # the dampers of its corners carry it: Coulomb's limit lowers them a little
    speed = masses * 9.81 * np.sin(0.05) / (4.0 * begun(model)[0].body["box_grip"])
    np.testing.assert_allclose(way[1.0] / 0.5, speed, rtol=2e-2)
    heights = table[table["slope"] == 0.0].pivot(index="table_mass", columns="t", values="q_2")
    np.testing.assert_allclose(heights[0.0], 0.05 - masses * 9.81 / (4.0 * stiffness), rtol=0, atol=1e-14)
    np.testing.assert_allclose(heights[1.0], heights[0.0], rtol=0, atol=1e-12)  # it stays
    # it tips over its edge, and lies
    with pytest.raises(gs.ArgumentError, match="does not stand still"):
        gs.simulate(model, root_pitch_0=1.08, duration=1.0, every=1.0)


@pytest.mark.slow
def test_a_biped_stands_on_the_targets_of_its_servos() -> None:
    """No acceleration is left, the feet carry the weight, the body stays; without a stride it falls over."""
    servos = BIPED.replace("<velocity", "<position").replace('kv="4"', "").replace("<motor", "<position")
    servos = servos.replace('gear="5"', "")
    force = gs.signal("N", "force of the ground")(
        lambda self, p, s: self.load(p, s, "foot_l") + self.load(p, s, "foot_r")
    )
    members = {
        "hip": gs.parameter("rad", "target of the left hip, and minus that of the right one", 0.25),
        "knee": gs.parameter("rad", "target of the knees", 0.1),
        "control": lambda self, p, s: jnp.stack([p.hip, p.knee, -p.hip, p.knee]),
        "force": force,
    }
    model = of(servos, **members)
    params, state = begun(model, z_0=0.01)
    options: dict[str, Any] = {"xla_backend_optimization_level": "0"}
    find = jax.jit(model.standing_still).lower(params, state).compile(options)
    stands = find(params, state)
    assert Standing(int(stands.standing)) is Standing.stands
    assert stands.residual < 1e-9
    assert abs(stands.q[2]) < 0.5
    names = ("x", "z", "pitch", "hip_l", "knee_l", "hip_r", "knee_r")
    start = {f"{name}_0": float(number) for name, number in zip(names, stands.q, strict=True)}
    trace = gs.simulate(model, start=start, duration=5.0, every=2.5)
    q = trace[[f"q_{i}" for i in range(7)]].to_numpy()
    np.testing.assert_allclose(q, np.tile(stands.q, (3, 1)), rtol=0, atol=1e-9)
    weight = 9.81 * mujoco.MjModel.from_xml_string(servos).body_mass.sum()
    np.testing.assert_allclose(trace["force"], weight, rtol=1e-9)
    # an upright rod, and one that leans
    upright, leaning = (Standing(int(find(*begun(model, hip=0.0, knee=k)).standing)) for k in (0.0, 0.1))
    assert upright is Standing.unstable
    assert leaning is not Standing.stands


@pytest.mark.slow
def test_variables_and_events_of_a_body_that_begins_standing_follow_from_its_rest() -> None:
    """A ball that starts 5 cm above the ground has not landed: it has been down since before the start."""
    ball = (
        '<mujoco><worldbody><geom type="plane" size="1 1 .1"/><body pos="0 0 .1">'
        '<joint name="z" type="slide" axis="0 0 1"/><geom name="foot" size=".1" mass="1"/></body>'
        "</worldbody></mujoco>"
    )
    lands = gs.event("foot lands")(lambda self, p, s: self.depth(p, s, "foot"))
    lands.jump(lambda self, p, s: s)
    members = {
        "begins_standing": True,
        "control": lambda self, p, s: jnp.zeros(0),
        "lands": lands,
        "begin": gs.variable("m", "height at the start", held=True),
        "complete": lambda self, p, s: s.replace(begin=s.q[0]),
    }
    model = of(ball, **members)
    params, state = begun(model, z_0=0.05)
    assert -0.01 < float(state.begin) == float(state.q[0]) < 0.0
    assert bool(state.pushing[0])
    guards = np.asarray(model.guards(params, state))
    assert (guards[np.array(model.guard_names) == "foot lands"] < 0.0).all()


def test_planes_with_different_friction_under_one_geom_are_refused() -> None:
    """A geom of located contacts has one friction and one softness."""
    floor = '<geom name="floor" type="plane" size="5 5 .1" friction=".2"/>'
    wall = '<geom name="wall" type="plane" size="5 5 .1" pos="-1 0 0" euler="0 90 0" friction="{}"/>'
    ball = '<body pos="0 0 .1"><freejoint/><geom name="ball" size=".1" mass="1" friction=".1"/></body>'
    bodies = "<mujoco><worldbody>" + floor + wall + ball + "</worldbody></mujoco>"
    alike = LocatedBody(mujoco.MjModel.from_xml_string(bodies.format(".2")))
    friction = {quantity.name: quantity.default for quantity in alike.parameters}["ball_friction"]
    assert friction == pytest.approx(0.2)
    with pytest.raises(ValueError, match="'ball' may touch the ground with different friction"):
        LocatedBody(mujoco.MjModel.from_xml_string(bodies.format("2")))


def test_elements_that_would_share_a_parameter_are_refused() -> None:
    """Else the mass of one foot would be that of the other, too."""
    foot = '<body name="{}" pos="0 {} 1"><freejoint/><geom size=".1" mass="{}" conaffinity="0"/></body>'
    bodies = "".join(foot.format(*numbers) for numbers in (("foot.1", 0, 1), ("foot-1", 1, 3)))
    with pytest.raises(ValueError, match="have the parameter foot_1_mass"):
        LocatedBody(mujoco.MjModel.from_xml_string(f"<mujoco><worldbody>{bodies}</worldbody></mujoco>"))


def ball_on_floor(stop: str) -> mujoco.MjModel:
    """A ball of 1 kg on a plane, both with these solref and solimp."""
    return mujoco.MjModel.from_xml_string(
        f'<mujoco><option timestep=".001"/><worldbody><geom name="floor" type="plane" size="5 5 1" {stop}/>'
        f'<body pos="0 0 .1"><freejoint/><geom name="ball" size=".1" mass="1" {stop}/></body>'
        "</worldbody></mujoco>"
    )


@pytest.mark.parametrize(
    "stop",
    [
        "",
        'solimp=".9 .95 .001 .5 .5"',
        'solimp=".9 .95 0 .1 2"',
        'solimp=".9 .95 .001 0 2"',
        'solimp=".9 .95 .001 1 2"',
        'solref="-1000 -10"',
    ],
)
def test_the_spring_of_a_contact_has_mujocos_depth_at_rest(stop: str) -> None:
    """Numbers of solimp outside their ranges are replaced as MuJoCo does."""
    m = ball_on_floor(stop)
    data = mujoco.MjData(m)
    mujoco.mj_step(m, data, 4000)
    (touch,) = touches(m)
    np.testing.assert_allclose(touch.softness.K, 9.81 / (0.1 - data.qpos[2]), rtol=1e-6)


def test_mixed_formats_of_solref_are_the_default() -> None:
    """As in MuJoCo, which warns at each step."""
    (default,) = touches(ball_on_floor(""))
    for solref in ("0.03 -1", "-1000 10", "0.03 0", "0 1"):
        (touch,) = touches(ball_on_floor(f'solref="{solref}"'))
        assert touch.softness == default.softness
    with pytest.raises(ValueError, match="'ball' has solref 0 0, so no stiffness"):
        touches(ball_on_floor('solref="0 0"'))
