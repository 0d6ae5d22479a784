"""A body from any MJCF, stepped by MJX: MuJoCo's algorithms in JAX.

External forces act on the degrees of freedom and on points (sites) of bodies; MuJoCo's contacts are off by
default. Features that MJX would silently ignore are refused.
"""

# MuJoCo's compiled modules come without types.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

import contextlib
import copy
import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jaxtyping import Array, Float, Num

from gaitsweep.dynamics.mjcf import compiled, data_at_keyframe
from gaitsweep.dynamics.mjx.corrections import mjx as mjx
from gaitsweep.dynamics.mjx.corrections import replace_contacts, runge_kutta
from gaitsweep.dynamics.mjx.refusals import HARMLESS, refusals, untraceable
from gaitsweep.near_miss import suggestion

replace_contacts()

_INTEGRATE = {
    mujoco.mjtIntegrator.mjINT_EULER: mjx.euler,
    mujoco.mjtIntegrator.mjINT_RK4: runge_kutta,
    mujoco.mjtIntegrator.mjINT_IMPLICITFAST: mjx.implicit,
}

Numbers = Mapping[str, Num[Array, " ..."]]  # fields of mjx.Model, or of its options ("opt.gravity"), by name


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class BodyState:
    """The state of a body between steps.

    `q` (nq,) and `v` (nv,) are MuJoCo's qpos and qvel; `act` (na,) the activations of its actuators; `warm`
    (nv,) the last acceleration, the initial guess of the constraint solver, (0,) for a body without
    constraints; `time` (1,) s, (0,) for a body without a sensor of the clock.
    """

    q: Float[Array, " nq"]
    v: Float[Array, " nv"]
    act: Float[Array, " na"]
    warm: Float[Array, " warm"]
    time: Float[Array, " clock"]


class MjxBody:
    """A compiled MJCF, with its functions of one trajectory.

    The argument `numbers` of these functions has the fields of the model that differ from the MJCF: those of
    a row (`variants.Variants`), or the option gravity.

    Args:
        source: a compiled model, a path, or the XML itself.
        points: names of the sites where forces act.
        contact: whether MuJoCo's contacts are on.
        keyframe: the number of the keyframe whose `act`, `time`, `mpos` and `mquat` a start has.

    Raises:
        ValueError: the model has a feature that MJX does not support or ignores, or lacks a site of `points`.
        FileNotFoundError: there is no file at the path.
    """

    def __init__(
        self,
        source: mujoco.MjModel | str | Path,
        points: str | Sequence[str] = (),
        *,
        contact: bool = False,
        keyframe: int | None = None,
    ) -> None:
        points = [points] if isinstance(points, str) else list(points)
        model = copy.copy(compiled(source))
        for flag in HARMLESS:  # MJX refuses some
            model.opt.enableflags &= ~int(flag)
        if not contact:
            model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
        if complaints := refusals(model):
            raise ValueError(" ".join(complaints))
        self.mj_model = model
        self._keyframe = keyframe
        at_start = self.at_start()
        has_clock = (model.sensor_type == mujoco.mjtSensor.mjSENS_CLOCK).any()
        self._act = np.array(at_start.act)
        self._time = np.full(int(has_clock), at_start.time)
        # a body may be created while a program is traced
        with jax.ensure_compile_time_eval(), jax.enable_x64(True):
            try:
                mjx_model = mjx.put_model(model)
                if not model.nmat:  # MJX's rays look up the material that no geom has
                    mjx_model = mjx_model.replace(mat_rgba=jnp.ones((1, 4)))
                data = mjx.make_data(mjx_model)
            except NotImplementedError as error:
                raise ValueError(f"MJX does not support this model: {str(error).rstrip('.')}.") from error
            data = data.replace(
                mocap_pos=jnp.asarray(at_start.mocap_pos), mocap_quat=jnp.asarray(at_start.mocap_quat)
            )
            # on the host, since a program may run on any device
            self._model = jax.tree.map(np.asarray, mjx_model)
            self._data = jax.tree.map(np.asarray, data)
        self._lowest, self._highest = _sensor_bounds(model)
        names = [model.site(i).name for i in range(model.nsite)]
        for name in points:
            if name not in names:
                raise ValueError(f"The model has no site '{name}'{suggestion(name, names)}")
        self._sites = np.array([names.index(name) for name in points], np.int64)

    def start(self, q: Float[Array, " nq"], v: Float[Array, " nv"]) -> BodyState:
        """The state at these positions (nq,) and velocities (nv,)."""
        act = jnp.asarray(self._act, q.dtype)
        time = jnp.asarray(self._time, q.dtype)
        return BodyState(q, v, act, jnp.zeros(v.size if self._constrained else 0, q.dtype), time)

    def at_start(self) -> mujoco.MjData:
        """MuJoCo's own data at the start."""
        return data_at_keyframe(self.mj_model, self._keyframe)

    @property
    def _constrained(self) -> bool:
        """Whether a constraint, such as a contact or a limit, can act."""
        return self._data._impl.efc_J.size > 0

    def points(
        self, numbers: Numbers, q: Float[Array, " nq"], v: Float[Array, " nv"]
    ) -> tuple[Float[Array, "points 3"], Float[Array, "points 3"]]:
        """Positions (k, 3) m and velocities (k, 3) m/s in the world of the k points."""
        with _settings_of_mjx(q):
            model, data = self._begun(numbers, self.start(q, v))
            data = mjx.com_vel(model, mjx.com_pos(model, mjx.kinematics(model, data)))
            at = data.site_xpos[self._sites]
            body = self.mj_model.site_bodyid[self._sites]
            # MuJoCo's cvel is at the centre of mass of the kinematic tree
            turning = data.cvel[body, :3]
            moving = data.cvel[body, 3:]
            lever = at - data.subtree_com[self.mj_model.body_rootid[body]]
            return at, moving + jnp.cross(turning, lever)

    def step(
        self,
        numbers: Numbers,
        state: BodyState,
        dt: Float[Array, ""] | float,
        *,
        tau: Float[Array, " nv"] | None = None,
        forces: Float[Array, "points 3"] | None = None,
        ctrl: Float[Array, " nu"] | None = None,
    ) -> tuple[BodyState, Any]:
        """The state `dt` (s) later in its own precision, by the integrator that the MJCF names.

        Args:
            numbers: fields of the model that differ from the MJCF.
            state: the state before.
            dt: the step.
            tau: generalised forces (nv,), N m and N.
            forces: forces on the points (k, 3), N, in the world's axes.
            ctrl: actuator controls (nu,).

        Returns:
            The state, and MJX's data of the step: derived quantities at its beginning, q and v at its end.

        Raises:
            ValueError: MJX cannot trace a feature of the model.
        """
        with _settings_of_mjx(state.q):
            model, data = self._begun(numbers, state)
            model = model.tree_replace({"opt.timestep": jnp.asarray(dt, state.q.dtype)})
            if forces is not None:
                data = data.replace(xfrc_applied=self._pushes(model, data, forces))
            if tau is not None:
                data = data.replace(qfrc_applied=tau)
            if ctrl is not None:
                data = data.replace(ctrl=ctrl)
            try:
                data = mjx.forward(model, data)
                if not self._constrained:  # MJX then leaves out sensors of accelerations and forces
                    data = mjx.sensor_acc(model, data)
            except (NotImplementedError, IndexError, TypeError, ValueError) as error:
                raise ValueError(untraceable(self.mj_model, error)) from error
            sensors = jnp.clip(data.sensordata, self._lowest, self._highest)
            # RK4 writes those of its stages over the sensors
            data = _INTEGRATE[self.mj_model.opt.integrator](model, data).replace(sensordata=sensors)
        warm = data.qacc_warmstart if state.warm.size else state.warm
        after = BodyState(data.qpos, data.qvel, data.act, warm, jnp.full(state.time.shape, data.time))
        return jax.tree.map(lambda new, old: new.astype(old.dtype), after, state), data

    def pressures(self, data: Any) -> Float[Array, " contacts"]:
        """The normal force (k,) N of each possible contact, at the beginning of the step to `data`.

        Raises:
            ValueError: the model has frictionless contacts or elliptic cones, whose forces have another
                layout.
        """
        contact = self._data._impl.contact
        if self.mj_model.opt.cone != mujoco.mjtCone.mjCONE_PYRAMIDAL or (contact.dim != 3).any():
            raise ValueError("Pressures need contacts with pyramidal cones and condim 3.")
        # the force is a sum over the four edges of the friction pyramid, whose normal component is 1
        edges = contact.efc_address[:, None] + np.arange(4)
        return jnp.sum(data._impl.efc_force[edges], axis=1)

    def _begun(self, numbers: Numbers, state: BodyState) -> tuple[Any, Any]:
        """MJX's model and data of a state, in the precision of that state."""

        def in_precision(leaf: np.ndarray) -> jax.Array:
            return jnp.asarray(leaf, state.q.dtype if leaf.dtype.kind == "f" else None)

        model, data = jax.tree.map(in_precision, (self._model, self._data))
        model = model.tree_replace({name: jnp.asarray(v, state.q.dtype) for name, v in numbers.items()})
        warm = state.warm if state.warm.size else data.qacc_warmstart
        time = state.time[0] if state.time.size else data.time
        return model, data.replace(qpos=state.q, qvel=state.v, act=state.act, qacc_warmstart=warm, time=time)

    def _pushes(self, model: Any, data: Any, forces: Float[Array, "points 3"]) -> Float[Array, "bodies 6"]:
        """MuJoCo's xfrc_applied (bodies, 6), at the centres of mass, from forces (k, 3) on the points."""
        at = mjx.com_pos(model, mjx.kinematics(model, data))
        body = self.mj_model.site_bodyid[self._sites]
        couples = jnp.cross(at.site_xpos[self._sites] - at.xipos[body], forces)
        return data.xfrc_applied.at[body].add(jnp.concatenate([forces, couples], axis=1))


def _sensor_bounds(model: mujoco.MjModel) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """The numbers (n,) at which MuJoCo cuts off the readings of sensors, below and above."""
    uncut = np.isin(model.sensor_type, (mujoco.mjtSensor.mjSENS_CONTACT, mujoco.mjtSensor.mjSENS_GEOMFROMTO))
    cutoff = np.repeat(model.sensor_cutoff, model.sensor_dim)
    data_type = np.repeat(np.where(uncut, -1, model.sensor_datatype), model.sensor_dim)
    is_signed = data_type == mujoco.mjtDataType.mjDATATYPE_REAL
    is_positive = data_type == mujoco.mjtDataType.mjDATATYPE_POSITIVE
    lowest = np.where(is_signed & (cutoff > 0.0), -cutoff, -np.inf)
    highest = np.where((is_signed | is_positive) & (cutoff > 0.0), cutoff, np.inf)
    return lowest, highest


@contextlib.contextmanager
def _settings_of_mjx(q: jax.Array) -> Iterator[None]:
    """Set JAX's default precision, and allow rank promotion, both of which MJX relies on."""
    with jax.enable_x64(q.dtype == jnp.float64), jax.numpy_rank_promotion("allow"):
        yield
