"""The ground that an MJCF draws: distances against MuJoCo C, motions over it against SciPy, its bounds."""

# MuJoCo's compiled modules come without types.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
import scipy

import gaitsweep as gs
from gaitsweep.dynamics.body.mechanics import Contact, LocatedBody
from gaitsweep.dynamics.ground import Ground, heights_of_model, is_uneven
from tests.support.planar_body import planar_body

RADIUS, STIFFNESS, DAMPING, FRICTION, GRIP = 0.05, 2e4, 20.0, 0.4, 30.0
SOFT: dict[str, Any] = {
    "ball_contact_stiffness": STIFFNESS, "ball_contact_damping": DAMPING, "ball_friction": FRICTION,
    "ball_grip": GRIP,
}  # fmt: skip
EXACT = {"method": "tsit5", "rtol": 1e-11, "atol": 1e-12}
FLOOR = '<geom name="floor" type="plane" size="9 9 .1"/>'
# the upper face is 10 cm high, and ends at x = 0.3
STEP = '<geom name="step" type="box" pos="-.7 0 0" size="1 1 .1"/>'
HILLS = """<geom name="hills" type="hfield" hfield="h" pos=".5 0 .02"/>"""
# points at x = -1, -0.5, ..., 2, 0.1 m high at 1
ELEVATION = (0.0, 0.0, 0.2, 0.6, 1.0, 0.3, 0.5)
HEIGHTS = 0.1 * np.array(np.array(ELEVATION, np.float32), float) + 0.02
ASSET = f"""<asset><hfield name="h" nrow="2" ncol="7" size="1.5 1 .1 .1"
  elevation="{" ".join(map(str, 2 * ELEVATION))}"/></asset>"""
PLANAR = """<body name="body"><joint name="x" type="slide" axis="1 0 0"/>
  <joint name="z" type="slide" axis="0 0 1"/><joint name="turn" axis="0 1 0"/>{geom}</body>"""
BALL = '<geom name="ball" size=".05" mass="1" conaffinity="0"/>'
Place = Callable[[float, float], tuple[np.ndarray, float]]


def world(ground: str, body: str) -> str:
    """The MJCF of a ground and a body."""
    return f"<mujoco>{ASSET}<worldbody>{ground}{body}</worldbody></mujoco>"


def planar(ground: str, geom: str = BALL) -> str:
    """The MJCF of a ground and a body of one geom in a vertical plane."""
    return world(ground, PLANAR.format(geom=geom))


def of(xml: str) -> Any:
    """The model of this MJCF."""
    return planar_body(xml)()


def compiled(xml: str) -> tuple[mujoco.MjModel, mujoco.MjData, LocatedBody, Any]:
    """MuJoCo's model and data, the located body, and a function of positions to its contacts and bounds."""
    m = mujoco.MjModel.from_xml_string(xml)
    body = LocatedBody(m)
    values: Any = {quantity.name: quantity.default for quantity in body.parameters}

    def contacts(q: Any) -> Any:
        stops = body.stretches(body.geometry(values), values, q, jnp.zeros(body.nv))
        touching = [stop for stop in stops if isinstance(stop, Contact)]
        depths = jnp.stack([jnp.asarray(contact.stretch) for contact in touching])
        normals = jnp.stack([jnp.asarray(contact.normal) for contact in touching])
        return depths, normals, body.bounds(values, q)

    return m, mujoco.MjData(m), body, jax.jit(contacts)


@pytest.mark.parametrize("shape", ['type="sphere" size=".1"', 'type="capsule" size=".1 .2"'])
def test_distances_to_a_box_are_those_of_c(shape: str) -> None:
    """A turned box and random poses, where MuJoCo C has one nearest pair: ends and sides, but for corners."""
    box = '<geom name="box" type="box" pos=".3 .2 .1" euler="10 20 30" size=".5 .4 .3" contype="1"/>'
    body = f'<body name="b"><freejoint/><geom name="g" {shape} conaffinity="0"/></body>'
    m, data, _, contacts = compiled(world(box, body))
    rng = np.random.default_rng(0)
    exact = 0
    sides = 0
    fromto = np.zeros(6)
    for _ in range(400):
        data.qpos[:3] = rng.uniform(-1.0, 1.0, 3)
        data.qpos[3:] = rng.normal(size=4)
        data.qpos[3:] /= np.linalg.norm(data.qpos[3:])
        mujoco.mj_kinematics(m, data)
        distance = mujoco.mj_geomDistance(m, data, 0, 1, 10.0, fromto)
        depths, normals, bounds = contacts(data.qpos)
        turn, other = data.geom_xmat[:2].reshape(2, 3, 3)
        along = np.linspace(-1.0, 1.0, 2001)[:, None] * m.geom_size[1, 1] * other[:, 2]
        axis = (data.geom_xpos[1] + along - data.geom_xpos[0]) @ turn
        if (np.abs(axis) < m.geom_size[0]).all(axis=1).any():  # C then takes other pairs of faces
            continue
        exact += 1
        own = -float(depths.max())
        assert own == pytest.approx(distance, rel=0.0, abs=1e-12)
        # a row ends as soon as the side touches a corner
        local = turn.T @ (fromto[:3] - data.geom_xpos[0])
        at_corner = (np.abs(np.abs(local) - m.geom_size[0]) < 1e-9).all()
        at_side = depths.argmax() > 1
        sides += at_side
        if at_side and distance < -1e-8:
            assert (bounds > 0.0).any() == at_corner
        between = np.sign(distance) * (fromto[3:] - fromto[:3]) / np.linalg.norm(fromto[3:] - fromto[:3])
        np.testing.assert_allclose(normals[int(depths.argmax())], between, rtol=0.0, atol=1e-11)
    assert exact > 200
    assert sides > 40 or shape.startswith('type="sphere"')


@pytest.mark.parametrize("axis", ["across", "along"])
def test_cylinders_of_planar_bodies_meet_a_plane_as_in_c(axis: str) -> None:
    """A disc, and a rectangle; C adds points between for its solver, so the deepest ones are compared."""
    euler = 'euler="90 0 0"' if axis == "across" else 'euler="0 35 0"'
    geom = f'<geom name="g" type="cylinder" {euler} size=".1 .06" pos=".05 0 .02" conaffinity="0"/>'
    plane = '<geom type="plane" size="9 9 .1" euler="0 12 0" pos="0 0 .1"/>'
    m, data, _, contacts = compiled(planar(plane, geom))
    m.geom_margin[:] = 10.0
    for q in np.random.default_rng(1).uniform(-1.0, 1.0, (60, 3)) * [0.3, 0.3, np.pi]:
        data.qpos = q
        mujoco.mj_kinematics(m, data)
        mujoco.mj_collision(m, data)
        depths, normals, _ = contacts(q)
        assert -data.contact.dist.min() == pytest.approx(float(depths.max()), rel=0.0, abs=1e-12)
        np.testing.assert_allclose(normals[0], data.contact.frame[0, :3], rtol=0.0, atol=1e-12)


def test_cylinders_in_space_meet_a_plane_as_in_c() -> None:
    """The rims of a cylinder; ends that are nearly flat on the plane are domed by up to 1 % of the radius."""
    geom = '<geom name="g" type="cylinder" euler="20 30 0" size=".1 .06" pos=".05 0 .02" conaffinity="0"/>'
    plane = '<geom type="plane" size="9 9 .1" euler="5 12 0" pos="0 0 .1"/>'
    m, data, _, contacts = compiled(world(plane, f'<body name="b"><freejoint/>{geom}</body>'))
    m.geom_margin[:] = 10.0
    rng = np.random.default_rng(1)
    domed = 0
    for k in range(60):
        data.qpos[:3] = rng.uniform(-0.3, 0.3, 3)
        data.qpos[3:] = rng.normal(size=4)
        if k >= 40:  # one end is nearly flat on the plane
            back = np.zeros(4)
            mujoco.mju_negQuat(back, m.geom_quat[1])
            tilt = np.append(1.0, rng.normal(size=3) * 0.01)
            mujoco.mju_mulQuat(back, tilt / np.linalg.norm(tilt), back)
            mujoco.mju_mulQuat(data.qpos[3:], m.geom_quat[0], back)
        data.qpos[3:] /= np.linalg.norm(data.qpos[3:])
        mujoco.mj_kinematics(m, data)
        mujoco.mj_collision(m, data)
        depths, normals, _ = contacts(data.qpos)
        normal = data.contact.frame[0, :3]
        along = abs(data.geom_xmat[1].reshape(3, 3)[:, 2] @ normal)
        tilt = np.sqrt(1.0 - along**2) / along
        domed += tilt < 0.02
        dome = 0.1 * along * (0.01 + tilt**2 / 0.04 - tilt) if tilt < 0.02 else 0.0
        assert -data.contact.dist.min() + dome == pytest.approx(float(depths.max()), rel=0.0, abs=1e-9)
        np.testing.assert_allclose(normals[0], normal, rtol=0.0, atol=1e-12)
    assert 5 < domed < 20


def floor(x: float, z: float) -> tuple[np.ndarray, float]:
    """The normal of the floor, and the height over it."""
    return np.array([0.0, 1.0]), z


def step(x: float, z: float) -> tuple[np.ndarray, float]:
    """The normal and the distance of the step's upper and right sides."""
    away = np.array([max(x - 0.3, 0.0), z - 0.1])
    return away / np.hypot(*away), float(np.hypot(*away))


def hills(x: float, z: float) -> tuple[np.ndarray, float]:
    """The normal of the hills, whose bends are parabolas 1 cm to both sides, and the distance."""
    places = np.linspace(-1.0, 2.0, 7)
    slopes = np.diff(HEIGHTS) / 0.5
    changes = np.diff(slopes)
    share = np.clip((x - places[1:-1] + 0.01) / 0.02, 0.0, 1.0)
    slope = slopes[0] + changes @ share
    bent = changes @ (0.01 * share**2 + np.maximum(x - places[1:-1] - 0.01, 0.0))
    height = HEIGHTS[0] + slopes[0] * (x + 1.0) + bent
    normal = np.array([-slope, 1.0]) / np.hypot(slope, 1.0)
    return normal, normal[1] * (z - height)


def rolled(surfaces: list[Place], start: list[float], duration: float) -> tuple[Any, int]:
    """The end (x, z, turn, rates) of a ball's motion by SciPy, and how often it met or left a surface."""

    def contact(surface: Place, y: Any) -> Any:
        """Depth and its rate, normal, place of the contact from the centre, and the ball's velocity there."""
        normal, distance = surface(y[0], y[1])
        depth = RADIUS - distance
        place = -normal * (RADIUS - 0.5 * depth)
        speed = np.array([y[3] + y[5] * place[1], y[4] - y[5] * place[0]])
        return depth, -normal @ speed, normal, place, speed

    def flow(_: float, y: Any) -> list[float]:
        force = np.array([0.0, -9.81])
        torque = 0.0
        for surface, touches in zip(surfaces, touching, strict=True):
            if touches:
                depth, rate, normal, place, speed = contact(surface, y)
                limit = FRICTION * (STIFFNESS * depth + DAMPING * rate)
                slip = speed + rate * normal
                push = limit / FRICTION * normal
                push = push - limit * slip / np.sqrt(slip @ slip + (limit / GRIP) ** 2 + 1e-8)
                force = force + push
                torque += place[1] * push[0] - place[0] * push[1]
        return [*y[3:], *force, torque / (0.4 * RADIUS**2)]

    def event(k: int) -> Any:
        def pushes(_: float, y: Any) -> float:
            depth, rate = contact(surfaces[k], y)[:2]
            return min(depth, depth + DAMPING / STIFFNESS * rate)

        pushes.terminal = True  # type: ignore[attr-defined]
        pushes.direction = -1.0 if touching[k] else 1.0  # type: ignore[attr-defined]
        return pushes

    t: Any = 0.0
    y, events = np.array(start), 0
    touching = [event_height > 0.0 for event_height in (RADIUS - s(y[0], y[1])[1] for s in surfaces)]
    while True:
        piece = scipy.integrate.solve_ivp(
            flow, (t, duration), y, "DOP853", rtol=1e-11, atol=1e-12, max_step=2e-3,
            events=[event(k) for k in range(len(surfaces))],
        )  # fmt: skip
        t, y = piece.t[-1], piece.y[:, -1]
        fired = [k for k, times in enumerate(piece.t_events) if len(times)]
        if not fired:
            return y, events
        for k in fired:
            touching[k] = not touching[k]
        events += len(fired)


@pytest.mark.slow
@pytest.mark.parametrize("ground", ["step", "hills"])
def test_a_ball_rolls_as_in_scipy(ground: str) -> None:
    """Down a step's edge, whose normal turns, or over the crest of hills at 1 m."""
    drawn, surfaces, x, speed, end_x = {
        "step": (FLOOR + STEP, [floor, step], 0.1, 0.4, 0.45),
        "hills": (HILLS, [hills], 0.7, 1.0, 1.05),
    }[ground]
    start = {"x_0": x, "z_0": 0.16, "x_rate_0": speed, "turn_rate_0": 8.0}
    options: dict[str, Any] = {**start, **SOFT, "duration": 1.2, "every": 1.2, "numerics": EXACT}
    trace = gs.simulate(of(planar(drawn)), **options)
    expected, events = rolled(surfaces, [x, 0.16, 0.0, speed, 0.0, 8.0], 1.2)
    assert events > 5
    assert expected[0] > end_x
    end = trace[["q_0", "q_1", "q_2"]].to_numpy()[-1]
    np.testing.assert_allclose(end * [1.0, 1.0, RADIUS], expected[:3] * [1.0, 1.0, RADIUS], rtol=0, atol=1e-8)


@pytest.mark.slow
def test_heights_of_the_ground_are_those_of_rays_of_c() -> None:
    """Vertical rays onto a turned box, a floor and hills, away from bends; a movie draws these heights."""
    ramp = '<geom name="ramp" type="box" pos="-3 .1 0" euler="0 -10 25" size=".8 .5 .2"/>'
    m, data, body, _ = compiled(planar(FLOOR + HILLS + STEP + ramp))
    mujoco.mj_kinematics(m, data)
    places = np.random.default_rng(2).uniform([-4.5, -1.3], [3.0, 1.3], (300, 2))
    bends = np.abs(places[:, :1] - np.linspace(-1.0, 2.0, 7)).min(axis=1) < 0.011
    heights = np.asarray(body.ground_height(*places.T))
    down = np.array([0.0, 0.0, -1.0])
    geom = np.zeros(1, np.int32)
    # rays from the ball's body on leave it out
    rays = [mujoco.mj_ray(m, data, np.append(p, 5.0), down, None, 1, 1, geom) for p in places]
    np.testing.assert_allclose(heights[~bends], 5.0 - np.array(rays)[~bends], rtol=0.0, atol=1e-12)
    model = of(planar(FLOOR + STEP))
    assert heights_of_model(model, {}, np.array([0.0, 0.5])) == pytest.approx([0.1, 0.0])
    # which is not raised by the margin of contacts, on any surface
    with_margin = of(planar((FLOOR + STEP).replace("<geom ", '<geom margin=".01" ')))
    assert heights_of_model(with_margin, {}, np.array([0.0, 0.5])) == pytest.approx([0.1, 0.0])
    # without a floor, there is none beside the step
    over_void = heights_of_model(of(planar(STEP)), {}, np.array([0.0, 0.5]))
    np.testing.assert_array_equal(over_void, [0.1, np.nan])
    assert not is_uneven(of(planar(FLOOR)))


@pytest.mark.parametrize("margin", [0.0, 0.2])
def test_a_slope_on_a_level_plane_is_an_inclined_plane(margin: float) -> None:
    """The margin is a distance along the normal of both."""
    stretches = []
    for turned, ground in (
        ("0 -20 0", Ground.of("even", {})),
        ("0 0 0", Ground.of("slope", {"ground_slope": 20.0})),
    ):
        floor = f'<geom type="plane" size="5 5 1" euler="{turned}" margin="{margin}"/>'
        m = mujoco.MjModel.from_xml_string(world(floor, f"<body><freejoint/>{BALL}</body>"))
        body = LocatedBody(m)
        values: Any = {quantity.name: quantity.default for quantity in body.parameters}
        q = jnp.array([1.0, 0.0, 0.6, 1.0, 0.0, 0.0, 0.0])
        stretches.append(body.depths_and_forces(values, q, jnp.zeros(6), ground)[0])
    np.testing.assert_allclose(stretches[1], stretches[0], rtol=0.0, atol=1e-12)


@pytest.mark.slow
def test_a_height_field_in_x_and_y_is_that_of_c() -> None:
    """Heights of rays, depth and normal of contacts within a triangle; the slope is continuous at bends."""
    rng = np.random.default_rng(4)
    elevation = " ".join(map(str, rng.uniform(0.0, 1.0, 12).round(3)))
    xml = f"""<mujoco><asset><hfield name="h" nrow="3" ncol="4" size="1.5 1 .3 .1" elevation="{elevation}"/>
      </asset><worldbody><geom type="hfield" hfield="h" pos=".5 .1 .02"/>
      <body><freejoint/>{BALL}</body></worldbody></mujoco>"""
    m, data, located, contacts = compiled(xml)
    m.geom_margin[:] = 10.0
    line = np.linspace([-0.9, -0.85], [1.9, 1.05], 40001)
    places = np.concatenate([rng.uniform([-0.9, -0.85], [1.9, 1.05], (60, 2)), line])
    heights = np.asarray(jax.jit(located.ground_height)(*places.T))
    cells = 0
    for place, z in zip(places[:60], heights[:60], strict=True):
        data.qpos[:3] = *place, 0.5
        mujoco.mj_kinematics(m, data)
        mujoco.mj_collision(m, data)
        depths, normals, _ = contacts(data.qpos)
        nearest = data.contact.dist.argmin()
        normal = data.contact.frame[nearest, :3]
        foot = place - normal[:2] * (data.contact.dist[nearest] + RADIUS)
        cell, share = np.divmod(np.array([place, foot]) + np.array([1.0, 0.9]), 1.0)
        over_diagonal = share[:, 0] - share[:, 1]
        from_bends = np.minimum(np.minimum(share, 1.0 - share).min(axis=1), np.abs(over_diagonal) / 1.5)
        if from_bends[0] > 0.01:
            down = np.array([0.0, 0.0, -1.0])
            ray = mujoco.mj_ray(m, data, np.append(place, 5.0), down, None, 1, 1, np.zeros(1, np.int32))
            assert z == pytest.approx(5.0 - ray, rel=0.0, abs=1e-12)
        if from_bends.min() > 0.01 and (cell[0] == cell[1]).all() and over_diagonal.prod() > 0.0:
            cells += 1
            assert -float(depths[0]) == pytest.approx(data.contact.dist[nearest], rel=0.0, abs=1e-9)
            np.testing.assert_allclose(normals[0], normal, rtol=0.0, atol=1e-9)
    assert cells > 15
    # along the line, a bend that is not rounded has a second difference of 1e-5
    assert np.abs(np.diff(heights[60:], 2)).max() < 1e-6


def test_no_fixed_point_is_sought_over_steps() -> None:
    """The place along the ground is a coordinate there, which it is not on a plane."""
    over_steps = of(planar(FLOOR + STEP)).body.joints
    on_a_plane = of(planar(FLOOR)).body.joints
    assert [joint.along_ground for joint in over_steps] == [False, False, False]
    assert [joint.along_ground for joint in on_a_plane] == [True, False, False]
    with pytest.raises(gs.ArgumentError, match="no step repeats another"):
        gs.return_map(of(planar(FLOOR + STEP))).fixed_points([0.1, 0.2, 0.0, 0.0, 0.0, 0.0])


@pytest.mark.slow
# MuJoCo's matrix of a turn about z has a rounding error, above or below, in the vertical component of z
@pytest.mark.parametrize(
    ("turn", "covered"), [("0 0 0", True), ("0 10 0", False), ("0 0 5", True), ("0 0 20", True)]
)
def test_places_of_a_free_body_are_left_out_on_level_planes_alone(turn: str, covered: bool) -> None:
    """Along an inclined plane, its height would change with its place."""
    plane = f'<geom type="plane" size="9 9 .1" euler="{turn}"/>'
    model = of(world(plane, f'<body name="b"><freejoint name="root"/>{BALL}</body>'))
    params = model.params({quantity.name: jnp.asarray(quantity.default) for quantity in model.parameters})
    starts = {quantity.name: jnp.asarray(quantity.default) for quantity in model.initial_conditions}
    upright = model.init(params, starts).replace(q=jnp.array([0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0]))
    assert bool(model.chart().covers(params, upright)) == covered
    assert model.body.velocities_along_ground == ((0, 1) if covered else ())


ROD = '<geom name="rod" type="capsule" size=".05" fromto="-.5 0 0 .5 0 0" mass="1" conaffinity="0"/>'


@pytest.mark.slow
def test_a_rod_that_slides_over_an_edge_keeps_its_energy() -> None:
    """It lies on a step, and its end slides over the edge, past which its side reached before."""
    free = {"rod_friction": 0.0, "rod_contact_damping": 0.0, "rod_contact_stiffness": STIFFNESS}
    start: dict[str, Any] = {"x_0": -0.18, "z_0": 0.1497, "turn_0": 1e-4, "x_rate_0": -0.4}
    options: dict[str, Any] = {**start, **free, "duration": 0.1, "every": 0.0005, "numerics": EXACT}
    rates = gs.signal("1", "velocities", count=3)(lambda self, p, s: s.v)
    model: Any = type("Rod", (planar_body(planar(FLOOR + STEP, ROD)),), {"speed": rates})()
    trace = gs.simulate(model, **options)
    q = trace[["q_0", "q_1", "q_2"]].to_numpy()
    v = trace[["speed_1", "speed_2", "speed_3"]].to_numpy()
    inertia = float(mujoco.MjModel.from_xml_string(planar(FLOOR, ROD)).body_inertia[1, 1])
    energy = 0.5 * (v[:, :2] ** 2).sum(axis=1) + 0.5 * inertia * v[:, 2] ** 2 + 9.81 * q[:, 1]
    along = np.stack([np.cos(q[:, 2]), -np.sin(q[:, 2])], axis=1)
    ends = [q[:, :2] + sign * 0.5 * along for sign in (1.0, -1.0)]
    corner = np.array([0.3, 0.1])
    share = ((corner - q[:, :2]) * along).sum(axis=1).clip(-0.5, 0.5)
    side, *at_corner = (
        np.maximum(RADIUS - np.linalg.norm(p - corner, axis=1), 0.0)
        for p in (q[:, :2] + share[:, None] * along, *ends)
    )
    depths = [RADIUS - np.array([surface(*p)[1] for p in end]) for end in ends for surface in (floor, step)]
    energy += 0.5 * STIFFNESS * sum(np.maximum(depth, 0.0) ** 2 for depth in depths)
    energy += 0.5 * STIFFNESS * (side**2 - np.maximum(*at_corner) ** 2)
    np.testing.assert_allclose(energy, energy[0], rtol=0.0, atol=1e-8)
    overlap = np.maximum(*at_corner)
    assert ((side > 0.0) & (overlap <= 0.0)).any()  # the edge is between the ends
    assert ((overlap > 0.0) & (side > overlap)).any()  # the end comes
    assert ((overlap > 0.0) & (share >= 0.5)).any() or depths[1][-1] > 0.0  # it has passed


@pytest.mark.slow
def test_a_cylinder_that_falls_on_its_end_keeps_its_energy() -> None:
    """It rocks on rim and dome; the depth of each end is the support function of the domed cylinder."""
    geom = '<geom name="g" type="cylinder" size=".1 .06" mass="1" conaffinity="0"/>'
    xml = world(FLOOR, f'<body name="b"><freejoint name="root"/>{geom}</body>')
    free = {"g_friction": 0.0, "g_contact_damping": 0.0, "g_contact_stiffness": STIFFNESS}
    start: dict[str, Any] = {"root_z_0": 0.063, "root_pitch_0": 0.03, "root_w_x_0": 0.2}
    options: dict[str, Any] = {**start, **free, "duration": 0.2, "every": 0.0005, "numerics": EXACT}
    rates = gs.signal("1", "velocities", count=6)(lambda self, p, s: s.v)
    model: Any = type("Can", (planar_body(xml),), {"speed": rates})()
    trace = gs.simulate(model, **options)
    q = trace[[f"q_{k}" for k in range(7)]].to_numpy()
    v = trace[[f"speed_{k}" for k in range(1, 7)]].to_numpy()
    inertia = mujoco.MjModel.from_xml_string(xml).body_inertia[1]
    energy = 0.5 * (v[:, :3] ** 2).sum(axis=1) + 0.5 * v[:, 3:] ** 2 @ inertia + 9.81 * q[:, 2]
    along = scipy.spatial.transform.Rotation.from_quat(q[:, [4, 5, 6, 3]]).as_matrix()[:, 2, 2]
    tilt = np.sqrt(1.0 - along**2) / along
    dome = np.where(tilt < 0.02, tilt**2 / 0.04 + 0.01, tilt)
    depth = along * (0.06 + 0.1 * dome) - q[:, 2]
    energy += 0.5 * STIFFNESS * np.maximum(depth, 0.0) ** 2
    np.testing.assert_allclose(energy, energy[0], rtol=0.0, atol=1e-8)
    assert ((depth > 0.0) & (tilt < 0.02)).any()
    assert ((depth > 0.0) & (tilt > 0.02)).any()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("ground", "geom", "start", "bound", "beyond"),
    [
        # a ball that rolls off the end of the hills at x = 2
        (
            HILLS,
            BALL,
            {"x_0": 1.9, "z_0": 0.13, "x_rate_0": 1.0},
            "ball meets a height field beyond",
            {"x_0": 2.1, "z_0": 0.1},
        ),
    ],
)
def test_rows_end_where_a_contact_is_not_covered(
    ground: str, geom: str, start: dict[str, Any], bound: str, beyond: dict[str, Any]
) -> None:
    model = of(planar(ground, geom))
    run = gs.Trace(duration=1.0, every=0.02)
    with pytest.warns(UserWarning, match=f"ends as not_a_number.*{bound}"):
        table = gs.sweep(model, **start, run=run, verify=0).table
    assert set(table["status"]) == {"not_a_number"}
    assert 0.05 < table["t"].to_numpy().max() < 0.5
    with pytest.raises(gs.ArgumentError, match=f"not covered at its start .*{bound}"):
        gs.simulate(model, start={**start, **beyond}, duration=1.0, every=1.0)
