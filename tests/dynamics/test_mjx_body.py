"""Bodies stepped by MJX against MuJoCo C, stage by stage and along a trajectory; refusals; what varies."""

# MuJoCo's compiled modules come without types.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

import re
import xml.etree.ElementTree as ElementTree
from functools import cache
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from gaitsweep.dynamics.mjx.mjx_body import MjxBody, refusals
from gaitsweep.dynamics.mjx.variants import Variants, rescale
from gaitsweep.papers.aoi2011.waist_quadruped.bodies import compiled_variants
from gaitsweep.papers.aoi2011.waist_quadruped.bodies import mjx_body as body
from gaitsweep.papers.aoi2011.waist_quadruped.parameters import mjcf
from tests.support.random_trees import unit

pytestmark = pytest.mark.slow  # MJX compiles for seconds

DT = 2e-4
FEET = [f"foot_{i + 1}" for i in range(4)]
LINKS = {"link_mass": 0.1, "link_length": 0.08}
FRONT = {"front_mass": 1.0, "front_length": 0.1, "front_width": 0.1}
HIPS = {
    "front_hip_x": 0.048,
    "rear_hip_x": 0.048,
    "front_hip_y": 0.05,
    "rear_hip_y": 0.05,
    "body_distance": 0.1,
}
TABLE_1 = FRONT | {name.replace("front", "rear"): value for name, value in FRONT.items()} | LINKS | HIPS
OTHER = {
    "front_mass": 1.3, "front_length": 0.12, "front_width": 0.09,
    "rear_mass": 0.8, "rear_length": 0.095, "rear_width": 0.105, "link_mass": 0.07, "link_length": 0.1,
    "front_hip_x": 0.051, "rear_hip_x": 0.044, "front_hip_y": 0.047, "rear_hip_y": 0.052,
    "body_distance": 0.11,
}  # fmt: skip


@cache
def step() -> Any:
    """One compiled program for all tests of the quadruped's body: what is known before a step and after."""

    def run(numbers: Any, q: Any, v: Any, tau: Any, forces: Any) -> dict[str, Any]:
        at, speed = body().points(numbers, q, v)
        _, after = body().step(numbers, body().start(q, v), DT, tau=tau, forces=forces)
        names = ("xipos", "qfrc_bias", "qacc", "qpos", "qvel")
        return {
            "at": at,
            "speed": speed,
            "M": after._impl.M,
            **{name: getattr(after, name) for name in names},
        }

    shapes = jax.tree.map(jnp.asarray, (float_leaves(TABLE_1), *at_random(0)[:4]))
    # run a few hundred times: XLA's optimizations would take longer than they save
    return jax.jit(run).lower(*shapes).compile({"xla_backend_optimization_level": "0"})


def float_leaves(
    values: dict[str, float], gravity: tuple[float, ...] = (0.0, 0.0, -9.8)
) -> dict[str, np.ndarray]:
    columns = {name: np.array([value]) for name, value in values.items()}
    fields = compiled_variants().numbers(columns)
    return {name: field[0] for name, field in fields.items()} | {"opt.gravity": np.array(gravity)}


def at_random(seed: int) -> tuple[np.ndarray, ...]:
    """Positions, velocities, forces on degrees of freedom and on feet, gravity."""
    rng = np.random.default_rng(seed)
    q, v = rng.normal(size=16), 3.0 * rng.normal(size=15)
    q[3:7] = unit(rng, 4)
    return q, v, rng.normal(size=15), 10.0 * rng.normal(size=(4, 3)), 5.0 * rng.normal(size=3)


def in_mujoco(
    model: mujoco.MjModel, q: np.ndarray, v: np.ndarray, tau: np.ndarray, forces: np.ndarray
) -> mujoco.MjData:
    """MuJoCo's data before a step, forces on the feet brought to the degrees of freedom."""
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:], data.qfrc_applied[:] = q, v, tau
    mujoco.mj_forward(model, data)
    for name, force in zip(FEET, forces, strict=True):
        site = model.site(name)
        where, on = data.site_xpos[site.id], int(site.bodyid[0])
        mujoco.mj_applyFT(model, data, force, np.zeros(3), where, on, data.qfrc_applied)
    mujoco.mj_forward(model, data)
    return data


def feet_of(model: mujoco.MjModel, data: mujoco.MjData) -> tuple[np.ndarray, np.ndarray]:
    speeds = np.zeros((4, 6))
    for name, speed in zip(FEET, speeds, strict=True):
        mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_SITE, model.site(name).id, speed, 0)
    return np.array([data.site(name).xpos for name in FEET]), speeds[:, 3:]


def near(mine: Any, theirs: np.ndarray, relative: float) -> None:
    """Within `relative` of the largest number there."""
    np.testing.assert_allclose(mine, theirs, rtol=0.0, atol=relative * np.abs(theirs).max())


@pytest.fixture(params=range(4))
def both(request: pytest.FixtureRequest) -> tuple[dict[str, Any], mujoco.MjModel, mujoco.MjData]:
    """A step at random in MJX, and MuJoCo just before the same step."""
    *state, gravity = at_random(request.param)
    model = mujoco.MjModel.from_xml_string(mjcf())
    model.opt.gravity[:] = gravity
    return step()(float_leaves(TABLE_1, tuple(gravity)), *state), model, in_mujoco(model, *state)


# The two sides round alike but for the order of sums; a wrong term of any size shows at random states.
@pytest.mark.slow("0")
def test_kinematics(both: Any) -> None:
    found, model, data = both
    at, speed = feet_of(model, data)
    near(found["at"], at, 1e-14)
    near(found["speed"], speed, 1e-13)
    near(found["xipos"], data.xipos, 1e-14)


def test_mass_matrix(both: Any) -> None:
    found, model, data = both
    full = np.zeros((15, 15))
    mujoco.mj_fullM(model, data, full)
    near(found["M"], full, 1e-13)


def test_bias(both: Any) -> None:
    found, _, data = both
    near(found["qfrc_bias"], data.qfrc_bias, 1e-13)


def test_acceleration(both: Any) -> None:
    found, _, data = both
    near(found["qacc"], data.qacc, 1e-12)


def test_euler_step(both: Any) -> None:
    found, model, data = both
    mujoco.mj_step(model, data)
    near(found["qvel"], data.qvel, 1e-12)
    near(found["qpos"], data.qpos, 1e-14)


def test_two_hundred_steps() -> None:
    """Hung by springs and dampers at its feet, thrown."""
    model = mujoco.MjModel.from_xml_string(mjcf())
    q, v, tau, _, _ = at_random(7)
    numbers, origin = float_leaves(TABLE_1), None
    mine, tau = (q, v), 0.05 * tau
    theirs = q, v
    for _ in range(200):
        at, speed = feet_of(model, in_mujoco(model, *theirs, tau, np.zeros((4, 3))))
        origin = at if origin is None else origin
        data = in_mujoco(model, *theirs, tau, 500.0 * (origin - at) - 5.0 * speed)
        mujoco.mj_step(model, data)
        theirs = data.qpos.copy(), data.qvel.copy()
        known = step()(numbers, *mine, tau, np.zeros((4, 3)))
        result = step()(numbers, *mine, tau, 500.0 * (origin - known["at"]) - 5.0 * known["speed"])
        mine = result["qpos"], result["qvel"]
    # 1e-13 in a step, and neighbours drift apart a hundredfold in these 0.04 s
    near(mine[0], theirs[0], 1e-10)
    near(mine[1], theirs[1], 1e-10)
    assert np.abs(theirs[0] - q).max() > 0.1


def rewritten(values: dict[str, float]) -> str:
    """The quadruped's MJCF with other masses and lengths, written from its comment and the paper's table."""
    root = ElementTree.fromstring(mjcf())
    parts = {part.get("name", ""): part for part in root.iter("body")}
    trunks = [
        [values[f"{body}_{part}"] for part in ("mass", "length", "width")] for body in ("front", "rear")
    ]

    def place(part: ElementTree.Element, *xyz: float) -> None:
        part.set("pos", " ".join(map(repr, xyz)))

    def weigh(name: str, mass: float, squares: list[float]) -> ElementTree.Element:
        inertial = parts[name].find("inertial")
        assert inertial is not None
        inertial.set("mass", repr(mass))
        inertial.set("diaginertia", " ".join(map(repr, squares)))
        return inertial

    boxes = [
        [m / 12.0 * s for s in (wide**2 + 0.05**2, long**2 + 0.05**2, long**2 + wide**2)]
        for m, long, wide in trunks
    ]
    weigh("front", trunks[0][0], boxes[0])
    behind = values["body_distance"] - trunks[0][1] / 2  # the rear body's centre of mass, behind the waist
    place(weigh("rear", trunks[1][0], boxes[1]), -behind, 0.0, 0.0)
    place(parts["rear"], -trunks[0][1] / 2, 0.0, 0.0)
    mass, link = values["link_mass"], values["link_length"]
    rod = mass * link * link / 12.0
    for i in range(4):
        x = values["front_hip_x"] if i < 2 else -behind - values["rear_hip_x"]
        y = (-1.0, 1.0)[i % 2] * values["front_hip_y" if i < 2 else "rear_hip_y"]
        place(parts[f"upper_{i + 1}"], x, y, 0.0)
        place(parts[f"lower_{i + 1}"], 0.0, 0.0, -link)
        for part in ("upper", "lower"):
            own = 1e-6 * (mass / 0.1) * (link / 0.08) ** 2
            place(weigh(f"{part}_{i + 1}", mass, [rod, rod, own]), 0.0, 0.0, -link / 2)
        site = parts[f"lower_{i + 1}"].find("site")
        assert site is not None
        place(site, 0.0, 0.0, -link)
    return ElementTree.tostring(root, encoding="unicode")


def test_varied_masses_and_lengths_are_those_of_models_compiled_anew() -> None:
    model = mujoco.MjModel.from_xml_string(rewritten(OTHER))
    numbers = float_leaves(OTHER)
    for name, field in numbers.items():
        if name != "opt.gravity":
            np.testing.assert_allclose(field, getattr(model, name), rtol=1e-14, atol=1e-16, err_msg=name)
    for seed in range(4):
        *state, _ = at_random(seed)
        data = in_mujoco(model, *state)
        result = step()(numbers, *state)
        near(result["qacc"], data.qacc, 1e-12)
        near(result["at"], feet_of(model, data)[0], 1e-14)


def test_rows_get_the_fields_of_their_own_values() -> None:
    n = 5
    columns = {name: np.full(n, value) for name, value in TABLE_1.items()}
    columns["front_mass"] = np.array([1.0, 1.3, 1.0, 0.7, 1.3])
    fields = compiled_variants().numbers(columns)
    assert {len(field) for field in fields.values()} == {n}
    np.testing.assert_array_equal(fields["body_mass"][:, 1], columns["front_mass"])
    np.testing.assert_array_equal(fields["body_subtreemass"][1], fields["body_subtreemass"][4])
    one = compiled_variants().numbers({name: column[:1] for name, column in columns.items()})
    assert one.keys() == fields.keys()
    with pytest.raises(ValueError, match=r"front_mass -1, .*, MuJoCo refuses the body"):
        compiled_variants().numbers(columns | {"front_mass": np.full(n, -1.0)})


def test_a_value_that_is_usually_zero_may_vary() -> None:
    xml = '<mujoco><worldbody><body name="b"><joint/><geom size="1"/></body></worldbody></mujoco>'

    def lift(spec: Any, values: Any) -> None:
        spec.body("b").pos = [0.0, 0.0, values["height"]]

    fields = Variants(xml, lift, {"height": 0.0}).numbers({"height": np.array([0.0, 0.3])})
    assert fields["body_pos"][:, 1, 2].tolist() == [0.0, 0.3]


@pytest.mark.parametrize(
    "inertial",
    [
        "",
        '<inertial pos="0 0 0" mass="1" fullinertia="1 2 2.5 0 0 0"/>',
        '<inertial pos="0 0 0" mass="1" diaginertia="1 2 2.5" euler="30 0 0"/>',
        '<inertial pos="0 0 0" mass="1" diaginertia="1 2 2.5" quat=".8 .6 0 0"/>',
    ],
)
def test_bodies_that_cannot_be_rescaled_are_refused(inertial: str) -> None:
    body = f'<body name="b">{inertial}<joint/><geom size="1"/></body>'
    xml = f"<mujoco><worldbody>{body}</worldbody></mujoco>"
    with pytest.raises(ValueError, match="Body 'b' needs an inertial"):
        Variants(xml, lambda spec, values: rescale(spec, {"b": values["m"]}, {}), {"m": 1.0})


# A ball falls to a floor, bounces and slides; beside it a pendulum is driven through a filter.
TOUCHING = """<mujoco><option timestep="0.002"/><worldbody>
  <geom name="floor" type="plane" size="5 5 .1"/>
  <body pos="0 0 .12"><freejoint/><geom size=".1" mass="1"/></body>
  <body pos="2 0 1"><joint name="j" axis="0 1 0" damping=".05"/><geom size=".1" pos=".3 0 0"/></body>
  </worldbody><actuator><general joint="j" dyntype="filter" dynprm=".1" gainprm="2"/></actuator></mujoco>"""


@pytest.mark.slow
def test_mujocos_own_contact_and_actuators() -> None:
    touching = MjxBody(TOUCHING, contact=True)
    model = touching.mj_model
    data = mujoco.MjData(model)
    data.qvel[:], data.ctrl[:] = [0.5, 0.0, -1.0, 0.0, 0.0, 0.0, 0.3], 0.7

    def one(_: Any, state: Any) -> Any:
        return touching.step({}, state, 0.002, ctrl=jnp.array([0.7]))[0]

    start = touching.start(jnp.asarray(data.qpos), jnp.asarray(data.qvel))
    # a state that keeps its types can be carried by a loop
    run = jax.jit(lambda s: jax.lax.fori_loop(0, 100, one, s)).lower(start)
    end = run.compile({"xla_backend_optimization_level": "0"})(start)
    touched = False
    for _ in range(100):
        mujoco.mj_step(model, data)
        touched |= data.ncon > 0
    assert touched
    assert start.warm.shape == (7,)
    near(end.q, data.qpos, 1e-12)
    near(end.v, data.qvel, 1e-10)
    near(end.act, data.act, 1e-13)


def test_contact_is_off_by_default() -> None:
    assert MjxBody(TOUCHING).start(jnp.zeros(8), jnp.zeros(7)).warm.shape == (0,)


@pytest.mark.slow
def test_precision_is_that_of_the_state() -> None:
    q, v, tau, forces, _ = (jnp.asarray(a, jnp.float32) for a in at_random(0))
    state = body().start(q, v)
    shapes = jax.eval_shape(lambda s: body().step({}, s, DT, tau=tau, forces=forces)[0], state)
    assert {leaf.dtype for leaf in jax.tree.leaves(shapes)} == {jnp.dtype("float32")}


def _pendulum(joint: str = "", geom: str = "", option: str = "", after: str = "", beside: str = "") -> str:
    return (
        f"<mujoco>{option}<worldbody>{beside}<site name='wall' pos='0 0 1'/>"
        f"<body name='arm'><joint name='j' {joint}/><geom name='g' size='.1' pos='.2 0 0' {geom}/>"
        f"<site name='tip' pos='.3 0 0'/></body></worldbody>{after}</mujoco>"
    )


def _tendon(extra: str) -> str:
    return f"<tendon><spatial name='t' {extra}><site site='wall'/><site site='tip'/></spatial></tendon>"


def _sensor(kind: str, extra: str) -> str:
    return f"<sensor><{kind} name='x' {extra}/></sensor>"


def _motor(extra: str) -> str:
    return f"<actuator><general name='m' joint='j' {extra}/></actuator>"


REFUSED = {
    "Geom 'g' has adhesion": _pendulum(geom="adhesion='1'"),
    "Pair 'p' has adhesion": _pendulum(
        beside="<geom name='floor' type='plane' size='1 1 1'/>",
        after="<contact><pair name='p' geom1='g' geom2='floor' adhesion='1'/></contact>",
    ),
    "Actuator 'a' is an adhesion": _pendulum(
        after="<actuator><adhesion name='a' body='arm' ctrlrange='0 1'/></actuator>"
    ),
    "Geom 'g' has surfacevel": _pendulum(geom="surfacevel='1 0 0 0 0 0'"),
    "Geom 'g' has fluidshape": _pendulum(geom="fluidshape='ellipsoid'"),
    "Joint 'j' has springyield": _pendulum("stiffness='1' springyield='.1'"),
    "Joint 'j' has a stiffness that is a polynomial": _pendulum("stiffness='1 2 3'"),
    "Joint 'j' has a damping that is a polynomial": _pendulum("damping='1 2 3'"),
    "Tendon 't' has springyield": _pendulum(after=_tendon("stiffness='1' springyield='.1'")),
    "Tendon 't' has a stiffness that is a polynomial": _pendulum(after=_tendon("stiffness='1 2 3'")),
    "Tendon 't' has a damping that is a polynomial": _pendulum(after=_tendon("damping='1 2 3'")),
    "Actuator 'm' has a delay": _pendulum(after=_motor("delay='.02' nsample='12'")),
    "Actuator 'm' has actearly": _pendulum(after=_motor("dyntype='filter' dynprm='1' actearly='true'")),
    "Actuator 'm' has an armature": _pendulum(after=_motor("armature='1'")),
    "Actuator 'm' has a damping of its own, which": _pendulum(after=_motor("damping='1'")),
    "Actuator 'm' has a damping of its own that": _pendulum(after=_motor("damping='0 1 1'")),
    "Actuator 'm' is disabled by its group": _pendulum(
        option="<option actuatorgroupdisable='2'/>", after=_motor("group='2'")
    ),
    "Equality 'e' is a connect or weld": _pendulum(
        after="<equality><connect name='e' body1='arm' anchor='0 0 0'/></equality>"
    ),
    "noslip_iterations": _pendulum(option="<option noslip_iterations='3'/>"),
    "flag sleep": _pendulum(option="<option><flag sleep='enable'/></option>"),
    "flag spring or damper": _pendulum(option="<option><flag damper='disable'/></option>"),
    "The integrator is one": _pendulum(option="<option integrator='implicit'/>"),
    "Joint 'j' can be within the margins of both limits": _pendulum(
        "range='-5 5' limited='true' margin='.15'"
    ),
    "Tendon 't' can be within the margins of both": _pendulum(
        after=_tendon("range='.2 .3' limited='true' margin='.1'")
    ),
    "Sensor 'x' has a delay": _pendulum(after=_sensor("jointvel", "joint='j' nsample='10' delay='.01'")),
    "Sensor 'x' has an interval": _pendulum(after=_sensor("jointvel", "joint='j' interval='.02'")),
    "Sensor 'x' is of type jointlimitpos": _pendulum(
        "range='-5 5' limited='true'", after=_sensor("jointlimitpos", "joint='j'")
    ),
    "Sensor 'x' is a rangefinder, for which MJX does not see a cylinder": _pendulum(
        beside="<geom type='cylinder' size='1 1'/>", after=_sensor("rangefinder", "site='tip'")
    ),
    "Sensor 'x' is of contacts by body": _pendulum(after=_sensor("contact", "body1='arm' data='force'")),
    "Geom 'floor' .plane. and 'g' have condim 1": _pendulum(
        geom="condim='1'",
        beside="<geom name='floor' type='plane' size='1 1 1' condim='1'/>",
        option="<option cone='elliptic'/>",
    ),
    "Geom 'c' .cylinder. and 'h' .box. may touch": _pendulum(
        beside="<geom name='c' type='cylinder' size='1 1'/>"
        "<body><freejoint/><geom name='h' type='box' size='1 1 1'/></body>"
    ),
    "flag override": _pendulum(option="<option><flag override='enable'/></option>"),
    "solver is PGS": _pendulum(option="<option solver='PGS'/>"),
    "Actuator 'm' has a transmission slidercrank": _pendulum(
        after="<actuator><motor name='m' cranksite='tip' slidersite='wall' cranklength='1'/></actuator>"
    ),
}


@pytest.mark.parametrize("sentence", REFUSED)
def test_features_that_mjx_ignores_are_refused_by_name(sentence: str) -> None:
    try:
        model = mujoco.MjModel.from_xml_string(REFUSED[sentence])
    except ValueError as error:
        if "unrecognized attribute" in str(error) or "Schema violation" in str(error):
            pytest.skip("this version of MuJoCo does not know it")
        raise
    assert any(re.search(sentence, complaint) for complaint in refusals(model)), refusals(model)
    with pytest.raises(ValueError, match=sentence):
        MjxBody(model)


def test_features_that_mjx_supports_are_accepted() -> None:
    for xml in (
        mjcf(),
        _pendulum("stiffness='1' damping='1'", after=_motor("") + _tendon("damping='1'")),
        _pendulum("range='-5 5' limited='true' margin='.08'"),
        _pendulum(option="<option><flag energy='enable' fwdinv='enable'/></option>"),
        TOUCHING,
    ):
        assert MjxBody(xml, contact=True).mj_model.nq


def test_missing_sites_are_refused() -> None:
    with pytest.raises(ValueError, match="did you mean tip"):
        MjxBody(_pendulum(), ["tipp"])
