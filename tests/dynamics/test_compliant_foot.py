"""The compliant foot: forces by hand, and bodies whose motion on such ground is known."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from gaitsweep.dynamics.compliant_foot import friction_slope, ground_force, normal_force
from gaitsweep.dynamics.tree.dynamics import forward_dynamics
from gaitsweep.dynamics.tree.external_force import YieldingForce
from gaitsweep.dynamics.tree.from_mjcf import tree_of
from gaitsweep.dynamics.tree.kinematics import integrate, movements, places, velocity, velocity_at
from tests.support.tree_mechanics import inverse_dynamics

GRAVITY = np.array([0.0, 0.0, -9.81])
GROUND = {"K": 2.0e4, "D": 200.0, "mu": 0.5, "v_slip": 0.01}
BLOCK = """
<mujoco><worldbody><body name="block">
  <joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 0 1"/>
  <inertial pos="0 0 0" mass="2" diaginertia="1 1 1"/>
</body></worldbody></mujoco>
"""
ARM = """
<mujoco><worldbody><body name="upper">
  <joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 0 1"/><joint axis="0 1 0"/>
  <inertial pos="0.1 0 0.02" mass="3" diaginertia="0.1 0.2 0.3"/>
  <body name="lower" pos="0.3 0 -0.1">
    <joint axis="0 -1 0"/><inertial pos="0 0 -0.1" mass="1" diaginertia="0.01 0.02 0.01"/>
  </body>
</body></worldbody></mujoco>
"""


def test_ground_pushes_and_never_pulls() -> None:
    depth = jnp.array([-1e-3, 1e-3, 1e-3, 1e-3])
    rate = jnp.array([1.0, 0.0, 0.5, -0.5])
    # above the ground nothing; 20 N; 20 + 100 N; 20 - 100 N would pull
    np.testing.assert_allclose(normal_force(depth, rate, 2e4, 200.0), [0.0, 20.0, 120.0, 0.0])


def test_friction_is_coulombs_beyond_the_slip_speed() -> None:
    slip = jnp.array([-2.0, -0.01, 0.004, 0.0, 0.3])
    force = friction_slope(jnp.full(5, 40.0), slip, 0.5, 0.01) * slip
    np.testing.assert_allclose(force, [-20.0, -20.0, 8.0, 0.0, 20.0], rtol=1e-12)


def slid(speed: float, push: float, duration: float, dt: float = 1e-3) -> tuple[np.ndarray, np.ndarray]:
    """Positions and velocities (n, 2) of the block of 2 kg, at rest in the ground but for its slip."""
    tree, geometry = tree_of(BLOCK)

    def step(state, _):
        q, v = state
        placed = places(tree, geometry, q)
        at = placed[1].position(np.zeros(3))
        speed_there = velocity_at(placed[1], movements(tree, placed, v)[1], at)
        foot = ground_force(1, at, speed_there, dt, **GROUND)
        v = v + dt * forward_dynamics(tree, geometry, q, v, jnp.array([push, 0.0]), [foot], gravity=GRAVITY)
        q = integrate(tree, q, v, dt)
        return (q, v), (q, v)

    start = jnp.array([0.0, -2.0 * 9.81 / GROUND["K"]]), jnp.array([speed, 0.0])
    return jax.jit(lambda s: jax.lax.scan(step, s, length=round(duration / dt))[1])(start)


@pytest.mark.slow
def test_a_block_slides_to_a_stop_and_stays() -> None:
    q, v = slid(1.0, 0.0, 0.6)
    # v^2 / (2 mu g), which steps of 1 ms at a speed of 1 m/s miss by half a step
    assert float(q[-1, 0]) == pytest.approx(1.0 / (2.0 * 0.5 * 9.81), abs=1.5e-3)
    assert float(np.min(v[:, 0])) >= -1e-12, "friction never turns the motion around"
    np.testing.assert_allclose(q[:, 1], q[0, 1], atol=1e-12)


@pytest.mark.slow
def test_a_block_pushed_less_than_friction_creeps_and_pushed_more_slides() -> None:
    # of the largest friction, 9.81 N, the half is reached at half the slip speed
    assert float(slid(0.0, 4.905, 0.2)[1][-1, 0]) == pytest.approx(0.005, rel=1e-9)
    # 2 m/s2 remain of 13.81 N; the friction is that of the step's beginning, so to a step
    assert float(slid(0.0, 13.81, 0.5)[1][-1, 0]) == pytest.approx(1.0, abs=0.03)


def test_a_yielding_force_is_its_force_less_what_it_yields() -> None:
    """An arm accelerates under it as under the force that its point's acceleration leaves of it."""
    tree, geometry = tree_of(ARM)
    q, v = jnp.array([0.2, 0.5, 0.3, -0.7]), jnp.array([1.0, -0.5, 2.0, 3.0])
    tau, point = jnp.array([0.1, 0.0, -0.4, 0.3]), np.array([0.05, 0.0, -0.25])
    placed = places(tree, geometry, q)
    at = placed[3].position(point)
    yielding = YieldingForce(3, at, jnp.array([-3.0, 0.0, 20.0]), jnp.array([0.7, 0.0, 0.2]))
    a = forward_dynamics(tree, geometry, q, v, tau, [yielding], gravity=GRAVITY)
    np.testing.assert_allclose(
        inverse_dynamics(tree, geometry, q, v, a, [yielding], gravity=GRAVITY), tau, atol=1e-12
    )

    def moving(time):  # the point's velocity a time later
        q_then, v_then = q + time * v + 0.5 * time**2 * a, v + time * a
        then = places(tree, geometry, q_then)
        return velocity(then[3], movements(tree, then, v_then)[3], point)

    accelerated = jax.jvp(moving, (0.0,), (1.0,))[1]
    left = YieldingForce(3, at, yielding.force - yielding.yields * accelerated, jnp.zeros(3))
    same = forward_dynamics(tree, geometry, q, v, tau, [left], gravity=GRAVITY)
    np.testing.assert_allclose(same, a, rtol=1e-11)  # rounding: both solve the same equations


def test_velocities_of_points_of_the_body_and_of_the_world_agree() -> None:
    tree, geometry = tree_of(ARM)
    q, v, point = jnp.array([0.2, 0.5, 0.3, -0.7]), jnp.array([1.0, -0.5, 2.0, 3.0]), np.array([0.1, 0, 0.2])
    placed = places(tree, geometry, q)
    moving = movements(tree, placed, v)
    for place, movement in zip(placed, moving, strict=True):
        at = velocity_at(place, movement, place.position(point))
        np.testing.assert_allclose(at, velocity(place, movement, point), atol=1e-13)
