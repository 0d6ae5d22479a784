"""A body from any MJCF, stepped by MuJoCo C on the host, for JAX programs of a CPU."""

# MuJoCo's compiled modules come without types.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

import copy
import functools
import types
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jaxtyping import Array, Float
from mujoco import rollout

from gaitsweep.dynamics.mjcf import data_at_keyframe
from gaitsweep.dynamics.mjx.mjx_body import BodyState, Numbers

_LARGEST = 1e10  # mjMAXVAL, beyond which MuJoCo warns in a file and on the terminal
_MODELS = 4096  # copies of a model with other steps


class CBody:
    """A compiled MJCF, stepped by MuJoCo C: the rows of a program in one call.

    Args:
        model: the compiled MJCF.
        keyframe: the number of the keyframe whose `act`, `time`, `mpos` and `mquat` a start has.

    Raises:
        ValueError: the MJCF has a plugin or a delay, whose states are not kept.
    """

    def __init__(self, model: Any, keyframe: int | None = None) -> None:
        self.mj_model = copy.copy(model)
        # a row that blows up ends, and does not begin anew
        self.mj_model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
        self._keyframe = keyframe
        m = self.mj_model
        if mujoco.mj_stateSize(m, mujoco.mjtState.mjSTATE_FULLPHYSICS) != 1 + m.nq + m.nv + m.na:
            raise ValueError(
                "The MJCF has a plugin, or a sensor or actuator with a delay, whose state is not kept."
            )
        self._start = self.at_start()
        self._free: list[Any] = []  # data that no call is using
        self._rollout = rollout.Rollout(nthread=0)  # JAX has a thread for each core
        self._with_step = functools.lru_cache(_MODELS)(self._copy_with_step)

    def start(self, q: Float[Array, " nq"], v: Float[Array, " nv"]) -> BodyState:
        """The state at these positions (nq,) and velocities (nv,)."""
        act = jnp.asarray(self._start.act, q.dtype)
        time = jnp.full(1, self._start.time, q.dtype)
        return BodyState(q, v, act, jnp.zeros(v.size, q.dtype), time)

    def at_start(self) -> Any:
        """MuJoCo's own data at the start."""
        return data_at_keyframe(self.mj_model, self._keyframe)

    def step(
        self, numbers: Numbers, state: BodyState, dt: Float[Array, ""], *, ctrl: Float[Array, " nu"]
    ) -> tuple[BodyState, types.SimpleNamespace]:
        """The state `dt` (s) later by the MJCF's integrator, and `sensordata` (n,) at its beginning.

        Args:
            numbers: none; the body's numbers are the MJCF's.
            state: the state before.
            dt: the step.
            ctrl: actuator controls (nu,).
        """
        assert not numbers
        m = self.mj_model
        # one array in and one out, since each costs as much as the steps of several rows
        inputs = jnp.concatenate([state.time, state.q, state.v, state.act, state.warm, ctrl, dt[None]])
        shape = jax.ShapeDtypeStruct((1 + m.nq + m.nv + m.na + m.nsensordata,), np.dtype(np.float64))
        outputs = jax.pure_callback(self._stepped, shape, inputs, vmap_method="broadcast_all")
        time, q, v, act, sensors = jnp.split(outputs, np.cumsum([1, m.nq, m.nv, m.na]))
        # the solver begins at the last acceleration, as in a motion of MuJoCo C alone
        moved = BodyState(q, v, act, (v - state.v) / dt, time)
        return moved, types.SimpleNamespace(sensordata=sensors)

    def _stepped(self, inputs: jax.Array) -> np.ndarray:
        """States and sensors (..., n) after a step, from states, warm starts, controls and steps (..., k)."""
        numbers = np.asarray(inputs, np.float64)
        rows = numbers.reshape(-1, numbers.shape[-1])
        m = self.mj_model
        outputs = np.full((len(rows), 1 + m.nq + m.nv + m.na + m.nsensordata), np.nan)
        sound = (np.abs(rows) < _LARGEST).all(axis=1)
        if sound.all():
            outputs[:] = self._rolled_out(rows)
        elif sound.any():
            outputs[sound] = self._rolled_out(rows[sound])
        return outputs.reshape(*numbers.shape[:-1], -1)

    def _rolled_out(self, rows: np.ndarray) -> np.ndarray:
        """States and sensors (rows, n) after a step of some rows."""
        m = self.mj_model
        physics, warm, ctrl, dt = np.split(rows, np.cumsum([1 + m.nq + m.nv + m.na, m.nv, m.nu]), axis=1)
        steps = np.unique(dt)
        models = [self._with_step(step) for step in (dt.ravel() if len(steps) > 1 else steps).tolist()]
        specification = mujoco.mjtState.mjSTATE_CTRL
        if m.nmocap:
            specification |= mujoco.mjtState.mjSTATE_MOCAP_POS | mujoco.mjtState.mjSTATE_MOCAP_QUAT
            mocap = np.concatenate([self._start.mocap_pos.ravel(), self._start.mocap_quat.ravel()])
            ctrl = np.concatenate([ctrl, np.broadcast_to(mocap, (len(ctrl), mocap.size))], axis=1)
        try:
            data = self._free.pop()
        except IndexError:
            data = mujoco.MjData(m)
        try:
            outputs: Any = self._rollout.rollout(
                models if len(steps) > 1 else models[0],
                data,
                physics,
                ctrl[:, None] if ctrl.size else None,
                control_spec=int(specification),
                nstep=1,
                initial_warmstart=warm,
            )
        finally:
            self._free.append(data)
        states, sensors = outputs
        return np.concatenate([states[:, 0], sensors[:, 0]] if m.nsensordata else [states[:, 0]], axis=1)

    def _copy_with_step(self, step: float) -> Any:
        """The compiled MJCF with another time step (s)."""
        model = copy.copy(self.mj_model)
        model.opt.timestep = step
        return model
