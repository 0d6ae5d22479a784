"""MuJoCo C's Runge-Kutta step of order 4, in which turns of free and ball joints are of that order too.

MJX averages the angular velocities of the stages as if turns could be added, which is of order 2 for a body
that turns about changing axes.
"""

# MuJoCo's compiled modules come without types.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from mujoco.mjx._src import forward, scan

_SHARES = 0.5, 0.5, 1.0  # of the step, at the second to the fourth stage
_WEIGHTS = np.array([1.0, 2.0, 2.0, 1.0]) / 6.0


def runge_kutta(model: Any, data: Any) -> Any:
    """MJX's data one step later, from those at its beginning after `mjx.forward`."""
    start = data
    turns = _turns(model)
    rates = data.qvel, data.qacc, data.act_dot
    stages = [rates]
    for share in _SHARES:
        dt = share * model.opt.timestep
        moved, faster, act = (dt * rate for rate in rates)
        v = start.qvel + faster
        place = scan.flat(model, _moved, "jqv", "q", model.jnt_type, start.qpos, moved)
        data = data.replace(qpos=place, qvel=v, act=start.act + act, time=start.time + dt)
        data = forward.forward(model, data)
        rates = _rate(moved, v, turns), data.qacc, data.act_dot
        stages.append(rates)
    v, qacc, act = (
        sum(w * stage for w, stage in zip(_WEIGHTS, kind, strict=True)) for kind in zip(*stages, strict=True)
    )
    data = data.replace(qpos=start.qpos, qvel=start.qvel, act=start.act, time=start.time)
    return forward._advance(model, data, act, qacc, v)


def _moved(joints: Any, q: jax.Array, change: jax.Array) -> jax.Array:
    return forward._integrate_pos(joints, q, change, dt=1.0)


def _turns(model: Any) -> np.ndarray:
    """The degrees of freedom (n, 3) of the turns of free and ball joints."""
    first = [
        address + (3 if kind == mujoco.mjtJoint.mjJNT_FREE else 0)
        for kind, address in zip(model.jnt_type.tolist(), model.jnt_dofadr.tolist(), strict=True)
        if kind in (mujoco.mjtJoint.mjJNT_FREE, mujoco.mjtJoint.mjJNT_BALL)
    ]
    return np.array(first, int)[:, None] + np.arange(3)


def _rate(moved: jax.Array, v: jax.Array, turns: np.ndarray) -> jax.Array:
    """The rate (nv,) of a change of place from its value `moved` and the velocities there.

    For a turn u this is the inverse of the derivative of the exponential map: w + u x w / 2 + ...
    (Munthe-Kaas 1998, BIT 38:92).
    """
    u = moved[turns]
    w = v[turns]
    square = jnp.sum(u * u, axis=1, keepdims=True)
    small = square < 1e-4
    half = 0.5 * jnp.sqrt(jnp.where(small, 1.0, square))
    factor = jnp.where(small, 1.0 / 12.0 + square / 720.0, (1.0 - half / jnp.tan(half)) / (4.0 * half * half))
    across = jnp.cross(u, w)
    return v.at[turns].set(w + 0.5 * across + factor * jnp.cross(u, across))
