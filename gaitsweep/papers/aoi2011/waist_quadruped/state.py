"""The parameters and the state of the quadruped, its start, its observables at the section, and its signals.

The section is limb 3's landing.
"""

from __future__ import annotations

import dataclasses
import math
from typing import Literal, get_args

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from gaitsweep.contract import Quantity
from gaitsweep.dynamics import wrapped
from gaitsweep.papers.aoi2011.waist_quadruped.kinematics import (
    EARLY,
    HIP,
    KNEE,
    LATE,
    STANCE,
    WAIST,
    FootPath,
    Swing,
    joint_angles,
    tilt,
)
from gaitsweep.papers.aoi2011.waist_quadruped.mechanics import WaistMechanics
from gaitsweep.papers.aoi2011.waist_quadruped.parameters import LIMBS

Damping = Literal["joint_rate", "rate_error"]  # the rate that joints are damped by
DAMPINGS: tuple[Damping, ...] = get_args(Damping)

_OF_TRUNK = 7  # positions of the free front body, before those of the joints: place and quaternion
_JOINTS = 9
_LINKS = 8  # of the limbs


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Params:
    """Parameters as in the equations; units as in `PARAMETERS`.

    `K` has the gain with which limb j pulls limb i, K_ij, and `delta_star` the desired lead of limb i over
    limb j, i < j, both by the two numbers, such as "12". `gait_centres` and `gait_widths` (3,) are those of
    walk, trot and pace.
    """

    K: dict[str, jax.Array]
    delta_star: dict[str, jax.Array]
    gait_centres: jax.Array
    gait_widths: jax.Array
    beta: jax.Array
    T_sw: jax.Array
    resetting: jax.Array
    T_grow: jax.Array
    T_hold: jax.Array
    K_hold: jax.Array
    D: jax.Array
    H_fore: jax.Array
    H_hind: jax.Array
    x_c_fore: jax.Array
    x_c_hind: jax.Array
    h: jax.Array
    dip: jax.Array
    gate: jax.Array
    late_reset: jax.Array
    landing_actual: jax.Array
    swing_ease: jax.Array
    anchor_kept: jax.Array
    omega: jax.Array  # rad/s
    phi_AEP: jax.Array  # rad
    mechanics: WaistMechanics
    swing: Swing = dataclasses.field(default="cycloid", metadata={"static": True})
    damping: Damping = dataclasses.field(default="joint_rate", metadata={"static": True})

    @property
    def x_c(self) -> jax.Array:
        """Middle (4,) of each limb's extreme positions, ahead of its hip, m."""
        return jnp.stack([self.x_c_fore, self.x_c_fore, self.x_c_hind, self.x_c_hind])

    @property
    def H(self) -> jax.Array:
        """Depth (4,) of each limb's extreme positions below its hip, m."""
        return jnp.stack([self.H_fore, self.H_fore, self.H_hind, self.H_hind])

    @property
    def farthest_foot(self) -> jax.Array:
        """The largest distance of a foot's extreme positions from its hip, m."""
        return jnp.max(jnp.hypot(self.H, 0.5 * self.D + jnp.abs(self.x_c)))

    def depths(self) -> tuple[jax.Array, jax.Array]:
        """Depths (m) of the extreme positions of fore and hind feet below their bodies' centres of mass."""
        m = self.mechanics
        if m.front_hip_z is None or m.rear_hip_z is None:
            return self.H_fore, self.H_hind
        return self.H_fore - m.front_hip_z, self.H_hind - m.rear_hip_z

    def path(self, clock: jax.Array, growing: jax.Array | bool) -> FootPath:
        """The path of the feet at a time (s); while `growing`, at the start, its size increases from zero."""
        grown = jnp.where(growing, clock / self.T_grow, 1.0)
        D, h = self.D * grown, self.h * grown
        return FootPath(self.phi_AEP, self.x_c, D, self.H, h, self.dip, self.swing_ease, self.swing)


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class State:
    """The state along a trajectory; arrays (4,) are in the order of the limbs.

    Attributes:
        q, v: MuJoCo's qpos (16,) and qvel (15,).
        phi: phases of the limbs, (4,) rad.
        clock: time, s.
        growing: whether the stride is still growing, as at the start.
        held: whether delta_13 is held, as at the start.
        contact: whether each foot is on the ground, (4,).
        anchor: touchdown points, (4, 2) m.
        segment: segments of the foot paths, (4,).
        lifted: whether each foot has been off the ground since the beginning of its swing, (4,).
        landing_x, landing_z: the points at which the stance lines begin (LP), (4,) m.
        height: heights of the feet above the ground at the beginning of the last fixed step, (4,) m.
        gain: gain of the phases in the last fixed step, (4,) rad.
        closed: whether limb 3 landed in the last fixed step.
        held_lead: the delta_13 that is held, rad.
        stride_x, stride_t: position (m) and time (s) at limb 3's last landing.
        speed, period: of the cycle before that landing, m/s and s.
        stood: times of lift-off less those of touchdown since that landing, (4,) s.
        landed: number of touchdowns since that landing, (4,).
        duty, touchdowns: duty factors and numbers of touchdowns in the cycle before that landing, (4,).
    """

    q: jax.Array
    v: jax.Array
    phi: jax.Array
    clock: jax.Array
    growing: jax.Array
    held: jax.Array
    contact: jax.Array
    anchor: jax.Array
    segment: jax.Array
    lifted: jax.Array
    landing_x: jax.Array
    landing_z: jax.Array
    height: jax.Array
    gain: jax.Array
    closed: jax.Array
    held_lead: jax.Array
    stride_x: jax.Array
    stride_t: jax.Array
    speed: jax.Array
    period: jax.Array
    stood: jax.Array
    landed: jax.Array
    duty: jax.Array
    touchdowns: jax.Array


def initial_state(p: Params, lead: jax.Array) -> State:
    """All feet on the ground below their hips, limb 3 at its AEP; `lead` (rad) is delta_13."""
    zero = jnp.zeros_like(p.omega)
    phi_3 = p.phi_AEP
    phi_1 = phi_3 + lead
    phi = wrapped(jnp.stack([phi_1, phi_1 - jnp.pi, phi_3, phi_3 - jnp.pi]))
    early = phi < p.gate * p.phi_AEP
    segment = jnp.where(phi >= p.phi_AEP, STANCE, jnp.where(early, EARLY, LATE))
    path = p.path(zero, True)
    x, z = path.target(phi, segment, (path.x_c, -path.H))
    q = _standing(p, x, z)
    at, _ = p.mechanics.feet(q, jnp.zeros(15, q.dtype))
    true, none = jnp.ones((), bool), jnp.zeros(4, q.dtype)
    return State(
        q=q, v=jnp.zeros(15, q.dtype), phi=phi, clock=zero, growing=true, held=true, held_lead=lead,
        contact=jnp.ones(4, bool), anchor=at[:, :2], segment=segment, lifted=jnp.zeros(4, bool),
        landing_x=x, landing_z=z, height=p.mechanics.heights(at), gain=none, closed=~true,
        stride_x=q[0], stride_t=zero, speed=zero, period=zero,
        stood=none, landed=none, duty=jnp.ones(4, q.dtype), touchdowns=none,
    )  # fmt: skip


def _standing(p: Params, x: jax.Array, z: jax.Array) -> jax.Array:
    """Positions (16,) of the standing body, its feet at x and z (4,) m from their hips."""
    m = p.mechanics
    zero = jnp.zeros_like(p.omega)
    angles = [zero] * _JOINTS
    for i in LIMBS:
        hip, knee = joint_angles(x[i], z[i], m.link_length, m.bends[i])
        angles[HIP[i] - _OF_TRUNK], angles[KNEE[i] - _OF_TRUNK] = hip, knee
    # pitched so that fore and hind feet are at one height
    fore = m.front_hip_x + p.x_c_fore
    (fore_depth, hind_depth) = p.depths()
    pitch = jnp.arctan2(hind_depth - fore_depth, fore + m.body_distance + m.rear_hip_x - p.x_c_hind)
    height = fore_depth * jnp.cos(pitch) + fore * jnp.sin(pitch)
    turn = jnp.cos(0.5 * pitch), zero, jnp.sin(0.5 * pitch), zero
    q = jnp.concatenate([jnp.stack([zero, zero, height, *turn]), jnp.stack(angles)])
    # compression of the ground by the body's weight
    weight = (m.front_mass + m.rear_mass + _LINKS * m.link_mass) * m.g
    if m.ground is not None:  # all feet begin where the ground is even, and the fore AEP is at x = 0
        q = q.at[0].set(-(fore + 0.5 * p.D))
    return q.at[2].add(-weight / (4.0 * m.K_N))


def _difference(i: int, j: int) -> Quantity:
    """The lead of limb i over limb j."""
    return Quantity(
        f"delta_{i}{j}", "rad", f"lead of limb {i} over limb {j} at limb 3's landing",
        circular=True, symbol=rf"\Delta_{{{i}{j}}}", source="eq. (5)",
    )  # fmt: skip


# The infinite scales: a row settles or not by its phases, speed and period, whatever its feet do meanwhile.
OBSERVABLES = (
    _difference(1, 3),
    _difference(1, 2),
    _difference(3, 4),
    Quantity("speed", "m/s", "mean speed along x, the first direction, in the last cycle", symbol="v"),
    Quantity("period", "s", "duration of the last cycle", symbol="T"),
    Quantity("stride", "m", "distance along x in the last cycle", symbol="S", source="eq. (3)",
             scale=math.inf),
    *(
        Quantity(f"duty_{i + 1}", "1", f"share of the last cycle with foot {i + 1} on the ground",
                 symbol=rf"\beta_{i + 1}", source="eq. (3)", scale=math.inf)
        for i in LIMBS
    ),
    *(
        Quantity(f"touchdowns_{i + 1}", "1", f"touchdowns of foot {i + 1} in the last cycle",
                 symbol=f"n_{i + 1}", scale=math.inf)
        for i in LIMBS
    ),
)  # fmt: skip
SIGNALS = (
    *(
        Quantity(f"phase_{i + 1}", "rad", f"phase of limb {i + 1}", circular=True, symbol=rf"\phi_{i + 1}")
        for i in LIMBS
    ),
    *(Quantity(f"contact_{i + 1}", "1", f"1 while foot {i + 1} is on the ground") for i in LIMBS),
    Quantity("waist", "rad", "angle of the waist joint", symbol=r"\theta_w"),
    Quantity("roll", "rad", "roll of the front body, for small angles"),
    Quantity("pitch", "rad", "pitch of the front body, for small angles"),
    *(Quantity(f"q_{i}", "m, 1 or rad", f"position {i} of the tree, as MuJoCo's qpos") for i in range(16)),
)


def observed(state: State) -> dict[str, Float[Array, ""]]:
    """The observables of a state at limb 3's landing."""
    phi = state.phi
    return {
        "delta_13": wrapped(phi[0] - phi[2]),  # eq. (5)
        "delta_12": wrapped(phi[0] - phi[1]),
        "delta_34": wrapped(phi[2] - phi[3]),
        "speed": state.speed,
        "period": state.period,
        "stride": state.speed * state.period,
        **{f"duty_{i + 1}": state.duty[i] for i in LIMBS},
        **{f"touchdowns_{i + 1}": state.touchdowns[i] for i in LIMBS},
    }


def signalled(state: State) -> dict[str, Float[Array, ""]]:
    """The signals of a state."""
    contact = state.contact.astype(state.phi.dtype)
    roll, pitch = tilt(state.q)
    return {
        **{f"phase_{i + 1}": wrapped(state.phi)[i] for i in LIMBS},
        **{f"contact_{i + 1}": contact[i] for i in LIMBS},
        "waist": state.q[WAIST],
        "roll": roll,
        "pitch": pitch,
        **{f"q_{i}": state.q[i] for i in range(16)},
    }
