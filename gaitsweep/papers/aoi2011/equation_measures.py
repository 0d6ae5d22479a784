"""Measures of the model's constants and equations.

Equations are compared with what the model computes, at random states: by formulas written out here, or by
MuJoCo, which shares nothing with gaitsweep's equations of motion but the description of the body.
"""

# MuJoCo's compiled modules come without types.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

import dataclasses
import functools
import math
from typing import Any, Literal

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jaxtyping import Array, Float
from scipy.spatial.transform import Rotation

from gaitsweep.analyses import TURN
from gaitsweep.claims import MeasureError, defaults, measure
from gaitsweep.dynamics.tree import PointForce, movements, places, rates, turned, velocity
from gaitsweep.papers.aoi2011.waist_quadruped import WaistQuadruped
from gaitsweep.papers.aoi2011.waist_quadruped.kinematics import HIP, KNEE, LATE, WAIST
from gaitsweep.papers.aoi2011.waist_quadruped.mechanics import WaistMechanics
from gaitsweep.papers.aoi2011.waist_quadruped.parameters import LIMBS, body
from gaitsweep.papers.aoi2011.waist_quadruped.rhythm import after_events, phase_rates, transitions
from gaitsweep.papers.aoi2011.waist_quadruped.state import Params, State

Positions = Float[Array, " 16"]
Velocities = Float[Array, " 15"]

MODEL = WaistQuadruped()
STATES = 20  # random states at which an equation is tested
FOOT_X, FOOT_Z = 0.01, -0.12  # m, a desired position of a foot within its limb's reach


@measure
def degrees_of_freedom() -> float:
    """Number of degrees of freedom of the waist quadruped."""
    return float(body()[0].nv)


@measure
def nominal_gait(*, beta: float) -> list[float]:
    """Duty factor, frequency (rad/s), stride (m) and speed (m/s) of eq. (3), from the model's oscillators."""
    p = _params(beta=beta)
    cycle = TURN / float(p.omega)
    stance = cycle - float(p.T_sw)
    return [stance / cycle, float(p.omega), cycle / stance * float(p.D), float(p.D) / stance]


@measure
def phase_rate_error() -> float:
    """Largest difference (rad/s) of the oscillators' rates from eq. (2) with eq. (6)."""
    rng = np.random.default_rng(1)
    worst = 0.0
    pairs = [(i, j) for i in range(4) for j in range(4) if i != j]
    for _ in range(STATES):
        gains = dict(zip((f"K_{i + 1}{j + 1}" for i, j in pairs), rng.uniform(0.0, 20.0, 12), strict=True))
        leads = {f"delta_star_{i + 1}{j + 1}": rng.uniform(0.0, TURN) for i, j in pairs if i < j}
        p = _params(**gains, **leads)
        phi = rng.uniform(0.0, TURN, 4)
        expected = np.full(4, float(p.omega))
        for i, j in pairs:
            lead = leads[f"delta_star_{min(i, j) + 1}{max(i, j) + 1}"] * (1.0 if i < j else -1.0)
            expected[i] -= gains[f"K_{i + 1}{j + 1}"] * math.sin(phi[i] - phi[j] - lead)
        computed = phase_rates(p, _state(phi=jnp.asarray(phi)), jnp.zeros(()))
        worst = max(worst, _largest(computed, expected))
    return worst


@measure
def reset_error() -> float:
    """Largest difference (rad) of the phase after a landing from phi_AEP, eq. (7)."""
    p = _params()
    worst = 0.0
    aep = float(p.phi_AEP)
    for phase in np.linspace(0.51, 0.99, STATES) * aep:
        s = _state(phi=jnp.full(4, phase), segment=jnp.full(4, LATE), lifted=jnp.ones(4, bool))
        landing = transitions(s, jnp.zeros(4, bool), jnp.ones(4, bool))
        after = after_events(p, s, landing, (s.landing_x, s.landing_z))
        worst = max(worst, _largest(after.phi, aep))
    return worst


@measure
def waist_constants(*, f: float) -> list[float]:
    """Stiffness and damping of the waist as shares of kappa_0 (2 pi f)^2 and 2 kappa_0 zeta_0 (2 pi f)."""
    p = _params(f=f)
    values = _defaults()
    rate = TURN * f
    spring, damper = values["kappa_0"] * rate**2, 2.0 * values["kappa_0"] * values["zeta_0"] * rate
    return [float(p.mechanics.kappa_w) / spring, float(p.mechanics.sigma_w) / damper]


@measure
def torque_error(*, joints: Literal["waist", "limbs"]) -> float:
    """Largest difference (N m) of the torques of the `waist`, eq. (A6), or the `limbs`, eq. (4)."""
    m = _params().mechanics
    # of each joint: its place in q, the desired angle, the spring and the damper
    driven = [(WAIST, 0.0, m.kappa_w, m.sigma_w)] if joints == "waist" else []
    for i in LIMBS if joints == "limbs" else ():
        hip, knee = _angles_by_cosines(FOOT_X, FOOT_Z, float(m.link_length), float(m.bends[i]))
        driven += [(HIP[i], hip, m.kappa_1, m.sigma_1), (KNEE[i], knee, m.kappa_2, m.sigma_2)]
    worst = 0.0
    for q, v in _moments():
        tau = np.asarray(m.torques(jnp.asarray(q), jnp.asarray(v), jnp.full(4, FOOT_X), jnp.full(4, FOOT_Z)))
        for at, angle, spring, damper in driven:
            expected = -float(spring) * (q[at] - angle) - float(damper) * v[at - 1]
            worst = max(worst, _largest(tau[at - 1], expected))
    return worst


@measure
def ground_force_error() -> float:
    """Largest difference (N) of the force on a foot from eq. (A8), in contact and off the ground."""
    m = _params().mechanics
    rng = np.random.default_rng(3)
    worst = 0.0
    for _ in range(STATES):
        at, speed = rng.normal(0.0, 1e-3, (4, 3)), rng.normal(0.0, 0.1, (4, 3))
        anchor = rng.normal(0.0, 1e-3, (4, 2))
        contact = at[:, 2] <= 0.0
        sunk = at - np.concatenate([anchor, np.zeros((4, 1))], axis=1)
        expected = np.where(contact[:, None], -float(m.K_TL) * sunk - float(m.D_TL) * speed, 0.0)
        computed = m.ground_forces(*map(jnp.asarray, (at, speed, anchor, contact)))
        worst = max(worst, _largest(np.stack([push.force for push in computed]), expected))
    return worst


@measure
def angular_velocity_error() -> float:
    """Largest error (1/s) of the quaternion's rate against the 3-1-2 Euler angles of eq. (A1) and (A2)."""
    rng = np.random.default_rng(4)
    step = 1e-6
    worst = 0.0

    def quaternion(angles: Float[np.ndarray, 3]) -> Float[np.ndarray, 4]:
        return Rotation.from_euler("ZXY", angles[[2, 0, 1]]).as_quat(scalar_first=True)

    for _ in range(STATES):
        angles = rng.uniform(-1.0, 1.0, 3)
        turning = rng.normal(0.0, 2.0, 3)
        (s1, c1), (s2, c2) = ((math.sin(a), math.cos(a)) for a in angles[:2])
        b = np.array([[c2, 0.0, -c1 * s2], [0.0, 1.0, s1], [s2, 0.0, c1 * c2]])
        q = np.concatenate([np.zeros(3), quaternion(angles), np.zeros(9)])
        v = np.concatenate([np.zeros(3), b @ turning, np.zeros(9)])
        rate = (quaternion(angles + step * turning) - quaternion(angles - step * turning)) / (2.0 * step)
        worst = max(worst, _largest(rates(body()[0], jnp.asarray(q), jnp.asarray(v))[3:7], rate))
    return worst


@measure
def mechanics_error(*, of: Literal["kinetic_energy", "feet", "accelerations"]) -> float:
    """Largest relative difference of `kinetic_energy`, `feet` or `accelerations` from MuJoCo's.

    Eq. (A3), (A7), (1). Accelerations are those under gravity, joint torques and forces on the feet.
    """
    m = _params().mechanics
    functions = {"kinetic_energy": _kinetic_energy, "feet": _feet, "accelerations": _accelerations}
    compute = jax.jit(functions[of])
    model = mujoco.MjModel.from_xml_string(MODEL.mjcf(_defaults()))
    data = mujoco.MjData(model)
    rng = np.random.default_rng(5)
    worst = 0.0
    for q, v in _moments():
        tau, forces = rng.normal(0.0, 1.0, 15), rng.normal(0.0, 10.0, (4, 3))
        data.qpos, data.qvel = q, v
        mujoco.mj_forward(model, data)  # before the Jacobians
        data.qfrc_applied = tau
        for i in LIMBS:
            jacobian = np.zeros((3, model.nv))
            mujoco.mj_jacSite(model, data, jacobian, None, data.site(f"foot_{i + 1}").id)
            data.qfrc_applied += jacobian.T @ forces[i]
        mujoco.mj_forward(model, data)
        mujoco.mj_energyVel(model, data)
        feet = np.stack([data.site(f"foot_{i + 1}").xpos for i in LIMBS])
        expected = {"kinetic_energy": data.energy[1], "feet": feet, "accelerations": data.qacc}[of]
        pushed = (tau, forces) if of == "accelerations" else ()
        worst = max(worst, _largest(compute(m, q, v, *pushed), expected) / _largest(expected, 0.0))
    return worst


def _feet(m: WaistMechanics, q: Positions, v: Velocities) -> Float[Array, "4 3"]:
    """The positions of the feet, m."""
    return m.feet(q, v)[0]


def _accelerations(
    m: WaistMechanics, q: Positions, v: Velocities, tau: Velocities, forces: Float[Array, "4 3"]
) -> Velocities:
    """The model's accelerations for torques of the joints and forces (N) on the feet."""
    tree, _ = body()
    foot = jnp.stack([0.0 * m.link_length, 0.0 * m.link_length, -m.link_length])
    pushes = [PointForce(tree.index(f"lower_{i + 1}"), foot, forces[i]) for i in LIMBS]
    return m.accelerations(q, v, tau, pushes)


def _kinetic_energy(m: WaistMechanics, q: Positions, v: Velocities) -> Float[Array, ""]:
    """The kinetic energy of the bodies and links, J."""
    geometry = m.geometry()
    placed = places(body()[0], geometry, q)
    total = jnp.zeros(())
    for i, (place, moving) in enumerate(zip(placed, movements(body()[0], placed, v), strict=True)):
        speed = velocity(place, moving, geometry.com[i])
        w = moving.angular
        spin = w @ turned(place.turn, geometry.inertia[i]) @ w
        total = total + 0.5 * (geometry.mass[i] * (speed @ speed) + spin)
    return total


def _largest(computed: Any, expected: Any) -> float:
    """The largest difference of two arrays.

    Raises:
        MeasureError: an element is not a finite number, which a largest error of several states would leave
            out.
    """
    largest = float(np.max(np.abs(np.asarray(computed) - np.asarray(expected))))
    if not math.isfinite(largest):
        raise MeasureError("The model computes a number that is not finite.")
    return largest


@functools.cache
def _defaults() -> dict[str, float]:
    """The model's default parameters by name."""
    return defaults(MODEL.parameters)


def _params(**changed: float) -> Params:
    """The default parameters, some of them changed."""
    values = {**_defaults(), **changed}
    return MODEL.params({name: jnp.asarray(value) for name, value in values.items()})


def _state(**changed: Any) -> State:
    """A state that is zero except for the given values."""
    fields = {field.name: jnp.zeros(()) for field in dataclasses.fields(State)}
    fields |= dict.fromkeys(("landing_x", "landing_z", "height", "gain"), jnp.zeros(4))
    fields |= {"q": jnp.zeros(16), "v": jnp.zeros(15), "segment": jnp.zeros(4, int)}
    fields |= dict.fromkeys(("contact", "lifted"), jnp.zeros(4, bool))
    return State(**fields | changed)


def _moments() -> list[tuple[Float[np.ndarray, 16], Float[np.ndarray, 15]]]:
    """Random positions and velocities of the whole body."""
    rng = np.random.default_rng(2)
    moments = []
    for _ in range(STATES):
        turn = Rotation.from_euler("ZXY", rng.uniform(-0.5, 0.5, 3)).as_quat(scalar_first=True)
        q = np.concatenate([rng.normal(0.0, 0.2, 3), turn, rng.uniform(-0.8, 0.8, 9)])
        moments.append((q, rng.normal(0.0, 1.0, 15)))
    return moments


def _angles_by_cosines(x: float, z: float, link: float, bend: float) -> tuple[float, float]:
    """Hip and knee angles (rad) of a limb of two equal links (m) with its foot at (x, z), by cosines."""
    inner = math.acos(min(math.hypot(x, z) / (2.0 * link), 1.0))
    return math.atan2(-x, -z) - bend * inner, 2.0 * bend * inner
