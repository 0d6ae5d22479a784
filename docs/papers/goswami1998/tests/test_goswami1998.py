"""The compass gait beside derivations of its own; `pytest` runs it once the package is installed."""

from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from goswami1998.model import CompassGait, exchanged
from scipy.integrate import solve_ivp

import gaitsweep as gs

jax.config.update("jax_enable_x64", True)
P = SimpleNamespace(m=5.0, m_H=10.0, a=0.5, b=0.5, g=9.81, phi=3.0, steps=1.0)
OTHER = SimpleNamespace(m=3.0, m_H=7.0, a=0.4, b=0.7, g=9.81, phi=4.0, steps=1.0)
# theta_s (rad), rates (rad/s) of the gait on 3 degrees, after a strike
FIXED = (0.2186687, -1.0923840, -0.3773740)


def places(p, q):
    """The places (3, 2) of hip, stance mass and swing mass from the stance foot (m), at angles (ns, s)."""

    def leg(angle):  # counterclockwise from the vertical
        return jnp.stack([-jnp.sin(angle), jnp.cos(angle)])

    hip = (p.a + p.b) * leg(q[1])
    return jnp.stack([hip, p.a * leg(q[1]), hip - p.b * leg(q[0])])


def masses(p):
    return jnp.array([p.m_H, p.m, p.m])


def lagrangian(p, q, v):
    at, speed = jax.jvp(lambda x: places(p, x), (q,), (v,))
    return jnp.sum(masses(p) * (0.5 * jnp.sum(speed**2, axis=1) - p.g * at[:, 1]))


def accelerations(p, q, v):
    """Lagrange's equations of the point masses, by automatic differentiation (rad/s2)."""

    def of(q, v):  # the parameters are constants of what is differentiated
        return lagrangian(p, q, v)

    turned = jax.jacfwd(jax.grad(of, 1), 0)(q, v) @ v
    return jnp.linalg.solve(jax.hessian(of, 1)(q, v), jax.grad(of, 0)(q, v) - turned)


def state(q, v):
    return State(theta_ns=q[0], theta_s=q[1], theta_ns_dot=v[0], theta_s_dot=v[1])


class State(SimpleNamespace):
    step_time, T, loss, left = 0.5, 0.0, 0.0, 0

    def replace(self, **changed):
        return State(**{**vars(self), **changed})


def angular_momentum(mass, arm, speed):
    return float(jnp.sum(mass * (arm[:, 0] * speed[:, 1] - arm[:, 1] * speed[:, 0])))


@pytest.mark.parametrize("p", [P, OTHER])
def test_a_strike_keeps_angular_momentum(p):
    """About the new stance foot that of all masses, about the hip that of the leg that leaves the ground."""
    random = np.random.default_rng(1)
    for _ in range(5):
        q, v = jnp.asarray(random.uniform(-1, 1, 2)), jnp.asarray(random.uniform(-2, 2, 2))
        after = exchanged(p, state(q, v))
        at, speed = jax.jvp(lambda x: places(p, x), (q,), (v,))
        q_2 = jnp.stack([after.theta_ns, after.theta_s])
        v_2 = jnp.stack([after.theta_ns_dot, after.theta_s_dot])
        np.testing.assert_array_equal(q_2, q[::-1])
        at_2, speed_2 = jax.jvp(lambda x: places(p, x), (q_2,), (v_2,))
        foot = at[0] - (p.a + p.b) * jnp.stack([-jnp.sin(q[0]), jnp.cos(q[0])])
        whole = angular_momentum(masses(p), at - foot, speed)
        assert angular_momentum(masses(p), at_2, speed_2) == pytest.approx(whole, abs=1e-9)
        leg = angular_momentum(masses(p)[1:2], at[1:2] - at[:1], speed[1:2])
        swing = angular_momentum(masses(p)[2:], at_2[2:] - at_2[:1], speed_2[2:])
        assert swing == pytest.approx(leg, abs=1e-9)


@pytest.mark.parametrize("p", [P, OTHER])
def test_the_swing_is_lagranges(p):
    random = np.random.default_rng(2)
    for _ in range(3):
        q, v = jnp.asarray(random.uniform(-1, 1, 2)), jnp.asarray(random.uniform(-2, 2, 2))
        true = accelerations(p, q, v)
        rates = CompassGait().flow(p, state(q, v))
        np.testing.assert_allclose([rates["theta_ns_dot"], rates["theta_s_dot"]], true, rtol=1e-9)


def test_the_swing_keeps_the_energy():
    trace = gs.simulate(CompassGait(), phi=3.0, duration=2.0)
    jumps = np.flatnonzero(np.diff(trace["loss"]) != 0)  # the last sample before each strike
    pieces = np.split(trace["E"].to_numpy(), jumps + 1)
    assert len(pieces) == 3
    for each in pieces:
        np.testing.assert_allclose(each, each[0], rtol=0, atol=1e-9 * abs(each[0]))


def test_a_step_is_scipys():
    """One step by solve_ivp with events; accelerations are those of the Lagrangian."""

    @jax.jit
    def rates(x):
        return jnp.concatenate([x[2:], accelerations(P, x[:2], x[2:])])

    def strikes(t, x):
        return -(x[0] + x[1] + 2 * np.deg2rad(P.phi))

    def flown(since, until, x, **options):
        return solve_ivp(
            lambda t, x: np.asarray(rates(x)), (since, until), x, "DOP853", rtol=1e-12, atol=1e-13, **options
        )

    strikes.terminal, strikes.direction = True, 1
    theta_s, theta_s_dot, theta_ns_dot = FIXED
    start = [-2 * np.deg2rad(P.phi) - theta_s, theta_s, theta_ns_dot, theta_s_dot]
    # the swing foot was below the ground until the legs passed each other
    passed = flown(0.0, 0.5, start).y[:, -1]
    assert strikes(0.5, passed) < 0
    done = flown(0.5, 2.0, passed, events=strikes)
    before = done.y_events[0][0]
    after = exchanged(P, state(jnp.asarray(before[:2]), jnp.asarray(before[2:])))
    ours = gs.sweep(
        "goswami1998",
        phi=[P.phi],
        theta_s_0=theta_s,
        theta_s_dot_0=theta_s_dot,
        theta_ns_dot_0=theta_ns_dot,
        run=gs.ReturnMap(crossings=1),
    ).table.iloc[-1]  # crossing 0 is the start
    assert ours["T_n"] == pytest.approx(done.t_events[0][0], abs=1e-9)
    for name in ("theta_s", "theta_s_dot", "theta_ns_dot"):
        # the sweep's own method keeps rates to some 1e-9
        assert ours[f"{name}_n"] == pytest.approx(float(getattr(after, name)), abs=1e-8)
    np.testing.assert_allclose(
        [ours["theta_s_n"], ours["theta_s_dot_n"], ours["theta_ns_dot_n"]], FIXED, atol=1e-5
    )


def test_the_model_keeps_the_contract():
    assert gs.fault(gs.models.find("goswami1998")()) is None


def test_the_claims_can_be_read():
    assert len(gs.claims.read_paper("goswami1998").claims) == 21
