"""The sign and the size of each force, against motions in closed form, energy balances and MuJoCo C."""

# MuJoCo's compiled modules come without types.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

from collections.abc import Callable

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from gaitsweep.dynamics import compliant_foot
from gaitsweep.dynamics.tree.dynamics import PointForce, YieldingForce, forward_dynamics
from gaitsweep.dynamics.tree.from_mjcf import tree_of
from gaitsweep.dynamics.tree.kinematics import places
from gaitsweep.papers.ambe2021.multilegged import model as multilegged
from gaitsweep.papers.ambe2021.multilegged.forces import neighbour_force
from gaitsweep.papers.aoi2011.waist_quadruped import mechanics, parameters
from gaitsweep.papers.aoi2011.waist_quadruped.kinematics import WAIST
from gaitsweep.papers.aoi2011.waist_quadruped.model import WaistQuadruped
from tests.support.sweeping import scalars
from tests.support.tree_mechanics import WorldForce

M, K, D = 0.7, 300.0, 4.0  # kg, N/m, N s/m
TIMES = np.linspace(0.0, 0.35, 15)


def moved(force: Callable, x: np.ndarray, v: np.ndarray, masses: np.ndarray | float) -> np.ndarray:
    """Positions (times, n) under a force of positions and velocities (n,)."""
    n = len(x)
    compiled = jax.jit(force)

    def rates(_: float, y: np.ndarray) -> np.ndarray:
        return np.r_[y[n:], np.asarray(compiled(jnp.asarray(y[:n]), jnp.asarray(y[n:]))) / masses]

    run = solve_ivp(rates, (0.0, TIMES[-1]), np.r_[x, v], t_eval=TIMES, rtol=1e-9, atol=1e-12)
    return run.y[:n].T


def damped(x: float, v: float, mass: float = M) -> np.ndarray:
    """The motion of a mass on a spring K and a damper D about zero, in closed form."""
    decay = D / (2.0 * mass)
    omega = np.sqrt(K / mass - decay**2)
    return np.exp(-decay * TIMES) * (
        x * np.cos(omega * TIMES) + (v + decay * x) / omega * np.sin(omega * TIMES)
    )


def test_a_mass_on_the_compliant_ground_oscillates_and_is_damped() -> None:
    """Gap and rate of either sign, as eq. (1) has it; out of contact it flies on."""
    x, v = np.array([0.02, -0.03, 0.01]), np.array([0.5, -0.4, 0.3])
    contact = jnp.array([True, True, False])
    spring = jnp.asarray(K), jnp.asarray(D), jnp.zeros(())
    path = moved(lambda x, v: multilegged.ground_force(x, v, contact, *spring), x, v, M)
    for leg in (0, 1):
        np.testing.assert_allclose(path[:, leg], damped(x[leg], v[leg]), atol=1e-8)
    np.testing.assert_allclose(path[:, 2], x[2] + v[2] * TIMES, atol=1e-9)


def test_a_foot_at_its_anchor_oscillates_along_all_axes() -> None:
    """A spring and a damper between the foot and (anchor, 0), the same along x, y and z."""
    anchor = np.array([0.4, -0.3, 0.0])
    x, v = anchor + np.array([0.01, -0.02, -0.015]), np.array([0.3, 0.2, -0.4])
    path = moved(
        lambda x, v: mechanics.anchored_force(
            x, v, jnp.asarray(anchor[:2]), jnp.asarray(True), jnp.full(3, K), jnp.full(3, D)
        ),
        x, v, M,
    )  # fmt: skip
    for axis in range(3):
        np.testing.assert_allclose(
            path[:, axis] - anchor[axis], damped(x[axis] - anchor[axis], v[axis]), atol=1e-8
        )


@pytest.mark.slow
def test_a_compliant_foot_is_pushed_up_and_loses_energy() -> None:
    """The vertical motion in closed form while it is deep; friction against the slip, mu times the load."""
    ground = {"K": K, "D": D, "mu": 0.4, "v_slip": 1e-3}

    def force(x, v):  # the ground's, on the foot's lowest point, which is 0.1 m deep at rest here
        result = compliant_foot.ground_force(
            1,
            jnp.stack([x[0], jnp.zeros(()), x[1] - 0.1]),
            jnp.stack([v[0], jnp.zeros(()), v[1]]),
            0.0,
            **ground,
        )
        return jnp.stack([result.force[0], result.force[2] - 0.1 * K])

    x, v = np.array([0.0, 0.03]), np.array([0.8, -0.4])
    path = moved(force, x, v, M)
    np.testing.assert_allclose(path[:, 1], damped(x[1], v[1]), atol=1e-8)
    for slip in (0.8, -0.8):
        pushed = force(jnp.zeros(2), jnp.array([slip, 0.0]))
        assert float(pushed[0]) == pytest.approx(-np.sign(slip) * 0.4 * K * 0.1)


@pytest.mark.parametrize("kappa", [np.array([100.0]), np.array([100.0, 60.0, 150.0])])
def test_a_chain_moves_by_the_exponential_of_its_matrix(kappa: np.ndarray) -> None:
    """Springs and dampers pull neighbours together: the matrix is put together from each spring's energy."""
    n = len(kappa) + 1
    masses, sigma = np.linspace(0.5, 1.1, n), 0.02 * kappa
    stiff, damp = np.zeros((n, n)), np.zeros((n, n))
    for i in range(n - 1):  # the energy kappa (x_i - x_{i+1})^2 / 2, and the power sigma (v_i - v_{i+1})^2
        between = np.zeros(n)
        between[[i, i + 1]] = 1.0, -1.0
        stiff += kappa[i] * np.outer(between, between)
        damp += sigma[i] * np.outer(between, between)
    random = np.random.default_rng(n)
    x, v = random.normal(size=n), random.normal(size=n)
    path = moved(lambda x, v: neighbour_force(x, v, jnp.asarray(kappa), jnp.asarray(sigma)), x, v, masses)
    inverse = np.diag(1.0 / masses)
    matrix = np.block([[np.zeros((n, n)), np.eye(n)], [-inverse @ stiff, -inverse @ damp]])
    exact = np.array([(expm(matrix * t) @ np.r_[x, v])[:n] for t in TIMES])
    np.testing.assert_allclose(path, exact, atol=1e-7)


def test_the_waist_s_torque_is_that_of_mujoco_s_spring_and_damper() -> None:
    """MuJoCo C's passive force of a joint with this stiffness and damping, all other joints left free."""
    model = mujoco.MjModel.from_xml_string(parameters.mjcf())
    free = dict.fromkeys(("kappa_1", "sigma_1", "kappa_2", "sigma_2"), 0.0)
    mine = scalars(WaistQuadruped(), f=2.6, **free).mechanics
    waist = model.joint("waist")
    waist.stiffness, waist.damping = float(mine.kappa_w), float(mine.sigma_w)
    data = mujoco.MjData(model)
    random = np.random.default_rng(3)
    for _ in range(3):
        data.qpos[7:], data.qvel[:] = random.uniform(-0.5, 0.5, model.nq - 7), random.normal(size=model.nv)
        mujoco.mj_forward(model, data)
        assert abs(data.qfrc_passive[WAIST - 1]) > 0.1
        torques = mine.torques(
            jnp.asarray(data.qpos), jnp.asarray(data.qvel), jnp.zeros(4), -0.1 * jnp.ones(4)
        )
        np.testing.assert_allclose(torques, data.qfrc_passive, atol=1e-12)


ARM = """
<mujoco><option gravity="0 0 -9.81"/><worldbody><body name="upper" pos="0.1 0.2 0.3">
  <freejoint/><inertial pos="0.1 0 0.02" mass="3" diaginertia="0.1 0.2 0.3"/>
  <body name="lower" pos="0.3 0 -0.1"><joint axis="0 -1 0.3"/>
    <inertial pos="0 0 -0.1" mass="1" diaginertia="0.01 0.02 0.01"/></body>
</body></worldbody></mujoco>
"""


@pytest.mark.parametrize("kind", ["point", "world", "yielding"])
def test_a_force_from_outside_accelerates_as_in_mujoco(kind: str) -> None:
    """The same force at the same point by mj_applyFT, on a free arm that turns."""
    model = mujoco.MjModel.from_xml_string(ARM)
    data = mujoco.MjData(model)
    tree, geometry = tree_of(ARM)
    random = np.random.default_rng(4)
    turn = random.normal(size=4)
    data.qpos[3:7], data.qpos[7] = turn / np.linalg.norm(turn), 0.4
    data.qvel[:] = random.normal(size=model.nv)
    mujoco.mj_forward(model, data)
    force, point = np.array([3.0, -5.0, 11.0]), np.array([0.05, 0.02, -0.25])
    body, link = model.body("lower").id, tree.index("lower")
    at = data.xpos[body] + data.xmat[body].reshape(3, 3) @ point
    mujoco.mj_applyFT(model, data, force, np.zeros(3), at, body, data.qfrc_applied)
    mujoco.mj_forward(model, data)
    external = {
        "point": PointForce(link, jnp.asarray(point), jnp.asarray(force)),
        "world": WorldForce(link, jnp.asarray(np.cross(at, force)), jnp.asarray(force)),
        "yielding": YieldingForce(link, jnp.asarray(at), jnp.asarray(force), jnp.zeros(3)),
    }[kind]
    q, v = jnp.asarray(data.qpos), jnp.asarray(data.qvel)
    np.testing.assert_allclose(places(tree, geometry, q)[link].position(point), at, atol=1e-12)
    a = forward_dynamics(
        tree, geometry, q, v, jnp.zeros(model.nv), [external], gravity=np.array([0, 0, -9.81])
    )
    np.testing.assert_allclose(a, data.qacc, rtol=1e-9, atol=1e-9)


BLOCK = """
<mujoco><worldbody><body name="block"><joint type="slide" axis="1 0 0"/>
  <inertial pos="0 0 0" mass="2" diaginertia="1 1 1"/></body></worldbody></mujoco>
"""


def test_yielding_forces_are_evaluated_at_the_end_of_the_step() -> None:
    """A block under -c v has v' = v / (1 + c dt / m), which does not change sign."""
    tree, geometry = tree_of(BLOCK)
    c, dt, v = 5e4, 1e-2, 3.0
    damper = YieldingForce(0, jnp.zeros(3), jnp.array([-c * v, 0.0, 0.0]), jnp.array([dt * c, 0.0, 0.0]))
    a = forward_dynamics(
        tree, geometry, jnp.zeros(1), jnp.array([v]), jnp.zeros(1), [damper], gravity=np.zeros(3)
    )
    assert v + dt * float(a[0]) == pytest.approx(v / (1.0 + c * dt / 2.0), rel=1e-9)
