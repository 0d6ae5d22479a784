"""The compliant foot: forces computed by hand, and a block that slides on such ground."""

from __future__ import annotations

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from gaitsweep.dynamics.compliant_foot import (
    friction_slope,
    ground_force,
    normal_force,
    uneven_ground_force,
)
from gaitsweep.dynamics.ground import Ground
from gaitsweep.dynamics.tree.dynamics import forward_dynamics
from gaitsweep.dynamics.tree.from_mjcf import tree_of
from gaitsweep.dynamics.tree.kinematics import integrate, movements, places, velocity_at

GRAVITY = np.array([0.0, 0.0, -9.81])
GROUND = {"K": 2.0e4, "D": 200.0, "mu": 0.5, "v_slip": 0.01}
BLOCK = """
<mujoco><worldbody><body name="block">
  <joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 0 1"/>
  <inertial pos="0 0 0" mass="2" diaginertia="1 1 1"/>
</body></worldbody></mujoco>
"""


def test_ground_pushes_and_never_pulls() -> None:
    depth = jnp.array([-1e-3, 1e-3, 1e-3, 1e-3])
    rate = jnp.array([1.0, 0.0, 0.5, -0.5])
    # above the ground 0; at rest 20 N; sinking 20 + 100 N; rising 20 - 100 N, which would pull
    np.testing.assert_allclose(normal_force(depth, rate, 2e4, 200.0), [0.0, 20.0, 120.0, 0.0])


def test_friction_is_coulomb_above_the_slip_speed() -> None:
    slip = jnp.array([-2.0, -0.01, 0.004, 0.0, 0.3])
    force = friction_slope(jnp.full(5, 40.0), slip, 0.5, 0.01) * slip
    np.testing.assert_allclose(force, [-20.0, -20.0, 8.0, 0.0, 20.0], rtol=1e-12)


def test_the_force_of_a_slope_is_that_of_level_ground_in_turned_axes() -> None:
    """The load is the part across the ground, friction takes energy, and both are zero above the ground."""
    slope = Ground.of("slope", {"ground_slope": 25.0})
    c, s = math.cos(math.radians(25.0)), math.sin(math.radians(25.0))
    turn = np.array([[c, 0.0, -s], [0.0, 1.0, 0.0], [s, 0.0, c]])
    foot = turn @ np.array([2.0, 0.0, 0.0])  # a point of the slope
    for depth, velocity in ((1e-3, [0.3, 0.0, -0.1]), (1e-3, [-0.004, 0.0, 0.02]), (-1e-3, [1.0, 0.0, 0.0])):
        level = ground_force(1, jnp.array([2.0, 0.0, -depth]), jnp.array(velocity), 1e-3, **GROUND)
        at, moving = jnp.asarray(foot - depth * turn[:, 2]), jnp.asarray(turn @ velocity)
        force, load = uneven_ground_force(1, at, moving, 1e-3, slope, slope.normal(at[0]), **GROUND)
        np.testing.assert_allclose(force.force, turn @ level.force, atol=1e-9)
        np.testing.assert_allclose(force.yields, turn @ np.diag(level.yields) @ turn.T, atol=1e-12)
        assert float(load) == pytest.approx(float(level.force[2]), abs=1e-9)
        assert float(turn[:, 2] @ force.force) == pytest.approx(float(load), abs=1e-9)
        assert float((force.force - load * turn[:, 2]) @ moving) <= 0.0


def slid(speed: float, push: float, duration: float, dt: float = 1e-3) -> tuple[np.ndarray, np.ndarray]:
    """Positions and velocities (n, 2) of the block of 2 kg, which begins with a horizontal speed only."""
    tree, geometry = tree_of(BLOCK)

    def step(state, _):
        q, v = state
        placed = places(tree, geometry, q)
        at = placed[1].position(np.zeros(3))
        point_velocity = velocity_at(placed[1], movements(tree, placed, v)[1], at)
        foot = ground_force(1, at, point_velocity, dt, **GROUND)
        v = v + dt * forward_dynamics(tree, geometry, q, v, jnp.array([push, 0.0]), [foot], gravity=GRAVITY)
        q = integrate(tree, q, v, dt)
        return (q, v), (q, v)

    start = jnp.array([0.0, -2.0 * 9.81 / GROUND["K"]]), jnp.array([speed, 0.0])
    return jax.jit(lambda s: jax.lax.scan(step, s, length=round(duration / dt))[1])(start)


@pytest.mark.slow
def test_a_block_slides_to_a_stop_and_stays() -> None:
    q, v = slid(1.0, 0.0, 0.6)
    # v^2 / (2 mu g), with an error of half a step of 1 ms at 1 m/s
    assert float(q[-1, 0]) == pytest.approx(1.0 / (2.0 * 0.5 * 9.81), abs=1.5e-3)
    assert float(np.min(v[:, 0])) >= -1e-12, "friction never turns the motion around"
    np.testing.assert_allclose(q[:, 1], q[0, 1], atol=1e-12)


@pytest.mark.slow
def test_a_block_pushed_less_than_friction_creeps_and_pushed_more_slides() -> None:
    # half of the largest friction, 9.81 N, acts at half the slip speed
    assert float(slid(0.0, 4.905, 0.2)[1][-1, 0]) == pytest.approx(0.005, rel=1e-9)
    # 13.81 N less friction accelerate by 2 m/s2; friction is that of the step's beginning, an error of a step
    assert float(slid(0.0, 13.81, 0.5)[1][-1, 0]) == pytest.approx(1.0, abs=0.03)
