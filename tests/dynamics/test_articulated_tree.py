"""The articulated tree against MuJoCo, against the laws of conservation, and as a scalar program."""

# MuJoCo's compiled modules come without types.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from functools import lru_cache
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gaitsweep.dynamics.tree.articulated_tree import Geometry, Link, Tree, rescaled
from gaitsweep.dynamics.tree.dynamics import PointForce, YieldingForce, forward_dynamics
from gaitsweep.dynamics.tree.from_mjcf import tree_of
from gaitsweep.dynamics.tree.kinematics import integrate, movements, places, rates, velocity, velocity_at
from gaitsweep.dynamics.tree.spatial import quaternion_exponential, solve_positive
from tests.support.random_trees import Moment, moment, tree_xml, waist_quadruped_xml
from tests.support.scalar_programs import outputs_of, trace
from tests.support.tree_mechanics import (
    WorldForce,
    centre_of_mass,
    inverse_dynamics,
    kinetic_energy,
    mass_matrix,
    momentum,
    potential_energy,
)

GRAVITY = np.array([0.3, -0.2, -9.81])
ARM = """
<mujoco><worldbody><body name="upper">
  <joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 0 1"/><joint axis="0 1 0"/>
  <inertial pos="0.1 0 0.02" mass="3" diaginertia="0.1 0.2 0.3"/>
  <body name="lower" pos="0.3 0 -0.1">
    <joint axis="0 -1 0"/><inertial pos="0 0 -0.1" mass="1" diaginertia="0.01 0.02 0.01"/>
  </body>
</body></worldbody></mujoco>
"""
seeds = st.integers(0, 2**31)


@lru_cache(maxsize=4)
def example(seed: int) -> tuple[Tree, Geometry, Moment]:
    rng = np.random.default_rng(seed)
    while True:
        model = mujoco.MjModel.from_xml_string(tree_xml(rng))
        if model.nv:
            return *tree_of(model), moment(rng, model)


def pushes(tree: Tree, now: Moment) -> list[Any]:
    """MuJoCo's xfrc_applied, in the two ways in which a force can be given."""
    results: list[Any] = []  # `forward_dynamics` asks a force for its `link` and calls its `on`
    for body in range(1, now.model.nbody):
        link = tree.index(now.model.body(body).name)
        force, torque = now.data.xfrc_applied[body, :3], now.data.xfrc_applied[body, 3:]
        if body % 2:
            results.append(PointForce(link, now.model.body_ipos[body], force))
            results.append(WorldForce(link, torque, np.zeros(3)))
        else:
            results.append(WorldForce(link, torque + np.cross(now.data.xipos[body], force), force))
    return results


def near(mine: Any, theirs: Any, relative: float) -> None:
    """Within `relative` of the largest number there."""
    np.testing.assert_allclose(
        mine, theirs, rtol=0.0, atol=relative * max(np.abs(theirs).max(initial=0.0), 1e-9)
    )


# Both sides round in another order; 1e-10 leaves room for a badly conditioned mass matrix, while a wrong
# term of any size shows at random states.
@pytest.mark.slow
@given(seeds)
@settings(max_examples=15)
def test_accelerations_and_forces_are_mujocos(seed: int) -> None:
    tree, geometry, now = example(seed)
    external = pushes(tree, now)
    result = forward_dynamics(tree, geometry, now.q, now.v, now.tau, external, gravity=GRAVITY)
    near(result, now.data.qacc, 1e-10)
    near(inverse_dynamics(tree, geometry, now.q, now.v, result, external, gravity=GRAVITY), now.tau, 1e-10)


@given(seeds)
@settings(max_examples=15)
def test_mass_matrix_and_energies_are_mujocos(seed: int) -> None:
    tree, geometry, now = example(seed)
    model, data = now.model, now.data
    full = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, full)
    near(mass_matrix(tree, geometry, now.q), full, 1e-12)
    mujoco.mj_energyPos(model, data)
    mujoco.mj_energyVel(model, data)
    # a body welded to the world is part of it, and has no energy here
    still = [b for b in range(1, model.nbody) if model.body_weldid[b] == 0]
    held = -sum(model.body_mass[b] * GRAVITY @ data.xipos[b] for b in still)
    near(potential_energy(tree, geometry, now.q, gravity=GRAVITY), data.energy[0] - held, 1e-11)
    near(kinetic_energy(tree, geometry, now.q, now.v), data.energy[1], 1e-12)


@given(seeds)
@settings(max_examples=15)
def test_positions_and_velocities_are_mujocos(seed: int) -> None:
    tree, geometry, now = example(seed)
    placed = places(tree, geometry, now.q)
    moving = movements(tree, placed, now.v)
    for body in range(1, now.model.nbody):
        at = tree.index(now.model.body(body).name)
        place, point = placed[at], np.array([0.1, -0.2, 0.3])
        turn = now.data.xmat[body].reshape(3, 3)
        where = now.data.xpos[body] + turn @ point
        near(place.frame @ place.turn, turn, 1e-12)
        near(place.position(point), where, 1e-12)
        jacobian = np.zeros((3, now.model.nv))
        mujoco.mj_jac(now.model, now.data, jacobian, None, where, body)
        near(velocity(place, moving[at], point), jacobian @ now.v, 1e-12)


@pytest.mark.slow
@given(seeds, st.sampled_from([1e-9, 1e-3, 0.3, 2.0]))
@settings(max_examples=15)
def test_positions_follow_from_velocities_as_in_mujoco(seed: int, dt: float) -> None:
    tree, _, now = example(seed)
    after = now.q.copy()
    mujoco.mj_integratePos(now.model, after, now.v, dt)
    near(integrate(tree, now.q, now.v, dt), after, 1e-14)
    _, slope = jax.jvp(lambda t: integrate(tree, now.q, now.v, t), (0.0,), (1.0,))
    near(rates(tree, now.q, now.v), slope, 1e-14)


def _along(tree: Tree, geometry: Geometry, now: Moment, tau: np.ndarray, of: Callable) -> tuple[Any, Any]:
    """`of` (q, v) and its rate of change along the motion under `tau`."""
    acceleration = forward_dynamics(tree, geometry, now.q, now.v, tau, gravity=GRAVITY)
    return jax.jvp(of, (now.q, now.v), (rates(tree, now.q, now.v), acceleration))


@pytest.mark.slow
@given(seeds)
@settings(max_examples=10)
def test_power_is_that_of_forces_and_dampers(seed: int) -> None:
    tree, geometry, now = example(seed)

    def energy(q: Any, v: Any) -> Any:
        return kinetic_energy(tree, geometry, q, v) + potential_energy(tree, geometry, q, gravity=GRAVITY)

    _, power = _along(tree, geometry, now, now.tau, energy)
    near(power, now.tau @ now.v - now.v @ (geometry.damping * now.v), 1e-10)


def _free_floating(seed: int) -> tuple[Tree, Geometry, Moment]:
    """A free tree whose joints neither damp nor store energy outside of its bodies."""
    while True:
        tree, geometry, now = example(seed)
        if [link.kind for link in tree.links if link.parent < 0] == ["free"] and tree.nv > 8:
            nought = {name: 0.0 * getattr(geometry, name) for name in ("damping", "armature", "stiffness")}
            return tree, dataclasses.replace(geometry, **nought), now
        seed += 1


@pytest.mark.slow
@given(seeds)
@settings(max_examples=6)
def test_a_free_tree_falls_and_keeps_its_angular_momentum(seed: int) -> None:
    tree, geometry, now = _free_floating(seed)
    inner = np.where(np.arange(tree.nv) < 6, 0.0, now.tau)
    (linear, _), (push, couple) = _along(
        tree, geometry, now, inner, lambda q, v: momentum(tree, geometry, q, v)
    )
    mass = geometry.mass.sum()
    near(push, mass * GRAVITY, 1e-11)
    np.testing.assert_allclose(couple, 0.0, atol=1e-10)  # of terms up to 1e3 N m that cancel
    _, drift = jax.jvp(lambda q: centre_of_mass(tree, geometry, q), (now.q,), (rates(tree, now.q, now.v),))
    near(mass * drift, linear, 1e-11)


@pytest.mark.slow
def test_runge_and_kutta_keep_energy_and_momentum_to_fourth_order() -> None:
    tree, geometry, now = _free_floating(3)

    @jax.jit
    def run(q: Any, v: Any, dt: Any, steps: Any) -> tuple[Any, Any]:
        def flow(q: Any, v: Any) -> tuple[Any, Any]:
            tau = jnp.zeros(tree.nv)
            return rates(tree, q, v), forward_dynamics(tree, geometry, q, v, tau, gravity=np.zeros(3))

        def stage(q: Any, v: Any, k: Any, h: Any) -> Any:
            return flow(q + h * k[0], v + h * k[1])

        def step(_: Any, state: Any) -> Any:
            q, v = state

            def staged(i: Any, carry: Any) -> Any:
                last, total = carry
                k = stage(q, v, last, jnp.array([0.0, 0.5, 0.5, 1.0])[i] * dt)
                weight = jnp.array([1.0, 2.0, 2.0, 1.0])[i] / 6.0
                return k, (total[0] + weight * k[0], total[1] + weight * k[1])

            nought = (0.0 * q, 0.0 * v)
            _, mean = jax.lax.fori_loop(0, 4, staged, (nought, nought))
            return q + dt * mean[0], v + dt * mean[1]

        return jax.lax.fori_loop(0, steps, step, (q, v))

    def errors(steps: int) -> np.ndarray:
        q, v = run(now.q, now.v, 0.4 / steps, steps)
        before = momentum(tree, geometry, now.q, now.v)
        after = momentum(tree, geometry, q, v)
        energy = kinetic_energy(tree, geometry, q, v) - kinetic_energy(tree, geometry, now.q, now.v)
        gaps = [np.linalg.norm(a - b) for a, b in zip(after, before, strict=True)]
        return np.array([abs(energy), *gaps])

    coarse, fine = errors(40), errors(80)
    np.testing.assert_allclose(np.log2(coarse / fine), 4.0, atol=0.2)  # 3.93, 3.98 and 4.02 here


@pytest.mark.slow
def test_masses_that_vary_from_row_to_row() -> None:
    xml = waist_quadruped_xml()
    tree, geometry = tree_of(xml)
    now = moment(np.random.default_rng(5), mujoco.MjModel.from_xml_string(xml), pushed=False)

    def found(mass: Any, size: Any) -> Any:
        body = rescaled(
            tree, geometry, mass={"rear": mass}, size={"fore": jnp.stack([size, 1.0, 1.0]), "rear": size}
        )
        return forward_dynamics(tree, body, now.q, now.v, now.tau, gravity=GRAVITY)

    def with_slope(mass: Any, size: Any) -> Any:
        return jax.jvp(lambda m: found(m, size), (mass,), (1.0,))

    masses, sizes = jnp.array([1.0, 0.6, 1.7]), jnp.array([1.0, 1.3, 0.8])
    # run once: XLA's optimizations would take longer than they save
    batched = jax.jit(jax.vmap(with_slope)).lower(masses, sizes)
    batch, slopes = batched.compile({"xla_backend_optimization_level": "0"})(masses, sizes)

    def by_mujoco(mass: float, size: float) -> np.ndarray:
        model = mujoco.MjModel.from_xml_string(waist_quadruped_xml(mass=mass, size=size))
        data = mujoco.MjData(model)
        model.opt.gravity[:] = GRAVITY
        data.qpos[:], data.qvel[:] = now.q, now.v
        mujoco.mj_forward(model, data)
        return data.qacc

    for i, (mass, size) in enumerate(zip(masses.tolist(), sizes.tolist(), strict=True)):
        near(batch[i], by_mujoco(mass, size), 1e-11)
        difference = (by_mujoco(mass + 1e-5, size) - by_mujoco(mass - 1e-5, size)) / 2e-5
        near(slopes[i], difference, 1e-7)  # the error of a difference: h^2, and rounding over h


@pytest.mark.slow
def test_the_quadruped_is_a_short_scalar_program() -> None:
    tree, geometry = tree_of(waist_quadruped_xml())
    toe = np.array([0.0, 0.0, -0.08])
    feet = [tree.index(f"{name}_lower") for name in ("right_fore", "left_fore", "right_hind", "left_hind")]

    def found(q: Any, v: Any, tau: Any, forces: Any) -> Any:
        external = [PointForce(foot, toe, forces[k]) for k, foot in enumerate(feet)]
        return forward_dynamics(tree, geometry, q, v, tau, external, gravity=GRAVITY)

    now = moment(np.random.default_rng(2), mujoco.MjModel.from_xml_string(waist_quadruped_xml()))
    args = [jnp.asarray(a) for a in (now.q, now.v, now.tau, np.arange(12.0).reshape(4, 3))]
    traced = trace(found, *args, steady=[False] * 4)
    nodes = [traced.program.nodes[at].op for at in traced.program.needed(traced.outputs)]
    # 2 581 as written, 560 of them sines and cosines: a zero that is no longer structural costs hundreds
    assert sum(op not in ("input", "constant") for op in nodes) < 2650
    (mine,) = outputs_of(found, *args)
    near(mine, found(*args), 1e-12)


def test_limbs_of_parallel_hinges_are_written_in_the_axes_of_what_carries_them() -> None:
    tree, _ = tree_of(waist_quadruped_xml())
    own = {link.name for link, axes in zip(tree.links, tree.link_axes, strict=True) if axes.own}
    assert own == {"fore", "rear"}


@pytest.mark.slow
def test_quaternions_of_small_turns_are_smooth() -> None:
    for size in (0.0, 1e-7, 0.99e-6, 1.01e-6, 1e-3):
        turn = np.array([0.6, 0.0, 0.8]) * size
        exact = np.array([np.cos(size / 2), *(np.sinc(size / 2 / np.pi) / 2 * turn)])
        np.testing.assert_allclose(quaternion_exponential(turn), exact, rtol=0.0, atol=1e-15)
    slope = jax.jacfwd(quaternion_exponential)(np.zeros(3))
    np.testing.assert_array_equal(slope, np.vstack([np.zeros(3), 0.5 * np.eye(3)]))


def test_small_systems_are_solved() -> None:
    root = np.random.default_rng(0).normal(size=(6, 6))
    A, b = root @ root.T + np.eye(6), np.arange(6.0)
    # the upper triangle alone is read
    near(solve_positive(np.triu(A), b), np.linalg.solve(A, b), 1e-13)


@pytest.mark.parametrize(
    ("inside", "after", "sentence"),
    [
        ('<joint name="hip" type="ball"/>', "", "Joint 'hip' is a ball joint"),
        ('<joint name="hip" range="-1 1" limited="true"/>', "", "Joint 'hip' has a limit"),
        ('<joint frictionloss="1"/>', "", "Joint 'joint 0' has frictionloss"),
        ('<joint/><geom size="1"/></body><body name="arm" gravcomp="1"><joint/>', "", "Body 'arm'"),
        ('<joint/><geom size="1"/></body><body mocap="true" name="hand">', "", "Body 'hand' is a mocap"),
        ('<joint name="root" type="free" stiffness="1"/>', "", "Joint 'root' is free and has a spring"),
        (
            '<joint name="hip"/>',
            '<actuator><motor name="m" joint="hip" armature="1"/></actuator>',
            "Actuator 'm' has armature",
        ),
        ("<joint/>", '<option density="1"/>', "fluid"),
        ("", "", "no joint"),
        (
            '<joint name="hip"/>',
            '<tendon><fixed name="t"><joint joint="hip" coef="1"/></fixed></tendon>',
            "a tendon 't'",
        ),
        (
            '<joint name="hip"/>',
            '<equality><joint joint1="hip"/></equality>',
            "an equality constraint",
        ),
    ],
)
def test_unsupported_features_are_refused_by_name(inside: str, after: str, sentence: str) -> None:
    xml = f'<mujoco><worldbody><body>{inside}<geom size="1"/></body></worldbody>{after}</mujoco>'
    with pytest.raises(ValueError, match=sentence):
        tree_of(xml)


def test_trees_are_checked_and_can_be_compared() -> None:
    xml = waist_quadruped_xml()
    assert hash(tree_of(xml)[0]) == hash(tree_of(mujoco.MjModel.from_xml_string(xml))[0])
    with pytest.raises(ValueError, match="did you mean rear"):
        tree_of(xml)[0].index("raer")
    with pytest.raises(ValueError, match="after its parent"):
        Tree((Link("a", 0, "hinge", (0.0, 1.0, 0.0)),))
    with pytest.raises(ValueError, match="length 1"):
        Tree((Link("a", -1, "hinge"),))
    with pytest.raises(FileNotFoundError, match=r"no_such\.xml"):
        tree_of("no_such.xml")
    tree, geometry = tree_of(xml)
    astray = [PointForce(-1, np.zeros(3), np.zeros(3))]
    with pytest.raises(ValueError, match="link -1"):
        forward_dynamics(tree, geometry, np.ones(16), np.ones(15), np.ones(15), astray, gravity=GRAVITY)


def test_a_yielding_force_decreases_with_acceleration() -> None:
    """An arm moves as under the constant force that remains at the acceleration of its point."""
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

    def velocity_after(time: jax.Array) -> Any:
        q_then, v_then = q + time * v + 0.5 * time**2 * a, v + time * a
        then = places(tree, geometry, q_then)
        return velocity(then[3], movements(tree, then, v_then)[3], point)

    accelerated = jax.jvp(velocity_after, (0.0,), (1.0,))[1]
    remaining = YieldingForce(3, at, yielding.force - yielding.yields * accelerated, jnp.zeros(3))
    same = forward_dynamics(tree, geometry, q, v, tau, [remaining], gravity=GRAVITY)
    np.testing.assert_allclose(same, a, rtol=1e-11)  # rounding: both solve the same equations


def test_velocities_of_points_given_in_body_and_in_world_agree() -> None:
    tree, geometry = tree_of(ARM)
    q, v, point = jnp.array([0.2, 0.5, 0.3, -0.7]), jnp.array([1.0, -0.5, 2.0, 3.0]), np.array([0.1, 0, 0.2])
    placed = places(tree, geometry, q)
    moving = movements(tree, placed, v)
    for place, movement in zip(placed, moving, strict=True):
        at = velocity_at(place, movement, place.position(point))
        np.testing.assert_allclose(at, velocity(place, movement, point), atol=1e-13)
