"""The compass walker against an independent derivation, and the slope at which its gait doubles."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import gaitsweep as gs
from gaitsweep.examples.compass_walker import CompassWalker
from tests.support.sweeping import scalars


def masses(p: Any, angles: jax.Array) -> tuple[jax.Array, jax.Array]:
    """The masses (3,) of hip, stance leg and swing leg, and their places (3, 2) from the stance foot."""

    def leg(angle):
        return jnp.stack([jnp.sin(angle), jnp.cos(angle)])

    hip = (p.a + p.b) * leg(angles[0])
    return jnp.stack([p.m_H, p.m, p.m]), jnp.stack([hip, p.a * leg(angles[0]), hip - p.b * leg(angles[1])])


def lagrangian(p: Any, angles: jax.Array, rates: jax.Array) -> jax.Array:
    mass, at = masses(p, angles)
    speed = jax.jvp(lambda a: masses(p, a)[1], (angles,), (rates,))[1]
    return jnp.sum(0.5 * mass * jnp.sum(speed**2, axis=1) - mass * p.g * at[:, 1])


@pytest.mark.slow
def test_the_swing_is_lagranges() -> None:
    """Accelerations by automatic differentiation of the point masses' Lagrangian."""
    model = CompassWalker()
    p, random = scalars(model, a=0.4, m=3.0), np.random.default_rng(1)
    momenta = jax.grad(lagrangian, 2)
    for _ in range(5):
        q, v = (jnp.asarray(random.uniform(-1.0, 1.0, 2)) for _ in "qv")
        inertia = jax.jacfwd(momenta, 2)(p, q, v)
        turned = jax.jacfwd(momenta, 1)(p, q, v) @ v
        true = jnp.linalg.solve(inertia, jax.grad(lagrangian, 1)(p, q, v) - turned)
        state = model.State(q[0], q[1], v[0], v[1], foot=None, arming=None)
        rates = model.flow(p, state)
        np.testing.assert_allclose([rates["stance_rate"], rates["swing_rate"]], true, rtol=1e-12)


def test_a_strike_keeps_angular_momentum() -> None:
    """About the new foot that of all masses, about the hip that of the leg that lifts off."""
    model = CompassWalker()
    p, random = scalars(model, a=0.4, m=3.0), np.random.default_rng(2)

    def motion(state):
        q, v = jnp.stack([state.stance, state.swing]), jnp.stack([state.stance_rate, state.swing_rate])
        mass, at = masses(p, q)
        return mass, at, jax.jvp(lambda a: masses(p, a)[1], (q,), (v,))[1]

    def momentum(mass, arm, speed):
        return jnp.sum(mass * (arm[:, 0] * speed[:, 1] - arm[:, 1] * speed[:, 0]))

    effect = model.exchange.effect
    assert effect is not None
    for _ in range(5):
        before = model.State(*map(jnp.asarray, random.uniform(-1.0, 1.0, 4)), foot=jnp.zeros(()), arming=None)
        after = effect(model, p, before)
        (mass, at, speed), (_, at_2, speed_2) = motion(before), motion(after)
        foot = at[0] - (p.a + p.b) * jnp.stack([jnp.sin(before.swing), jnp.cos(before.swing)])
        np.testing.assert_allclose(
            momentum(mass, at - foot[None], speed), momentum(mass, at_2, speed_2), rtol=1e-12
        )
        # the old stance leg is the new swing leg
        old = momentum(mass[1:2], at[1:2] - at[:1], speed[1:2])
        np.testing.assert_allclose(old, momentum(mass[2:], at_2[2:] - at_2[:1], speed_2[2:]), rtol=1e-12)


@pytest.mark.slow
def test_a_foot_that_rises_behind_is_no_strike() -> None:
    """It rose by rounding at the start, which was a strike at t = 0; the next one is that of a step."""
    start: dict[str, Any] = {"stance_0": -0.397192, "stance_rate_0": 1.968102, "swing_rate_0": 2.286758}
    table = gs.sweep(CompassWalker(), **start, run=gs.ReturnMap(crossings=1), verify=0).table
    assert table["t"].iloc[1] > 0.5


@pytest.mark.slow
def test_the_gait_doubles_at_4_39_degrees() -> None:
    """Goswami, Thuilot and Espiau 1998: one step up to 4.39 degrees, two from there."""
    path = gs.Continuation(parameter="slope", path=[3.0, 5.0])
    branch = gs.sweep(CompassWalker(), run=path).table
    flips = branch.loc[branch["special"] == "flip", "slope"].to_numpy()
    np.testing.assert_allclose(flips, [4.39], rtol=0, atol=0.005)  # as printed
    slopes = [4.0, 4.35, 4.45, 4.6]
    settled = gs.sweep(CompassWalker(), slope=slopes, run=gs.Settle(max_cycles=600)).table
    assert settled["attractor_period"].tolist() == [1, 1, 2, 2]
