"""The planar quadruped in MuJoCo C, its network and motors in plain numbers, written from its page alone.

One trajectory at a time, as plain as can be: the model's oracle. Only the MJCF of the body is shared with it.
Legs: 0 LF, 1 LH, 2 RF, 3 RH.
"""

# MuJoCo's compiled modules come without types.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

import dataclasses
from typing import Any

import mujoco
import numpy as np

HIP, KNEE = (3, 5, 7, 9), (4, 6, 8, 10)  # in qpos and in qvel
ACROSS, BESIDE = (2, 3, 0, 1), (1, 0, 3, 2)  # the contralateral and the ipsilateral leg
# s, Tr, theta_st, Kp hip stance, Kp knee stance, l_sw, Kp knee swing at sigma 0, 0.5 and 1
COLUMNS = np.array(
    [
        [1.18, 0.085, -0.166, 5.0, 2840.0, 0.065, 2130.0],
        [1.71, 0.0473, -0.438, 8.13, 1970.0, 0.057, 1860.0],
        [1.40, 0.0206, -1.0, 10.6, 1820.0, 0.054, 2740.0],
    ]
)


@dataclasses.dataclass
class PlanarQuadruped:
    """The page's constants and the state between two steps; `start` are the potentials (2, 4): e, f."""

    model: mujoco.MjModel
    sigma: float
    start: np.ndarray
    pair: int = 0
    k2: float = 0.08
    dt: float = 1e-3

    def __post_init__(self) -> None:
        self.speed = [float(np.interp(self.sigma, [0.0, 0.5, 1.0], column)) for column in COLUMNS.T]
        self.data = mujoco.MjData(self.model)
        self.model.opt.timestep = self.dt
        swings = [i in ((1, 2) if self.pair == 0 else (0, 3)) for i in range(4)]
        self.u_e, self.u_f = [float(u) for u in self.start[0]], [float(u) for u in self.start[1]]
        self.f_e = [0.0 if swing else 0.1 for swing in swings]
        self.f_f = [0.1 if swing else 0.0 for swing in swings]
        self.load = [0.0] * 4
        for i in range(4):
            self.data.qpos[HIP[i]] = -0.2 if swings[i] else 0.2
            self.data.qpos[KNEE[i]] = 0.13
        self.data.qpos[1] = (0.175 + 0.13 - 0.025) * np.cos(0.2) + 0.025 + 0.005

    def step(self) -> None:
        """One step of network, motors and body, each from what was there before it."""
        s, Tr, theta_st, Kp_hip_st, Kp_knee_st, l_sw, Kp_knee_sw = self.speed
        theta = [float(self.data.qpos[i]) for i in HIP]
        length = [float(self.data.qpos[i]) for i in KNEE]
        y_e, y_f = [max(0.0, u) for u in self.u_e], [max(0.0, u) for u in self.u_f]
        u_e, u_f, f_e, f_f = ([0.0] * 4 for _ in range(4))
        for i in range(4):
            hip = 3.0 * (theta[i] + 0.262)
            into_e = -2.0 * y_f[i] - 0.3 * y_e[ACROSS[i]] - 0.8 * y_e[BESIDE[i]] - 3.0 * self.f_e[i] + s + hip
            into_f = -2.0 * y_e[i] - 0.3 * y_f[ACROSS[i]] - 0.8 * y_f[BESIDE[i]] - 3.0 * self.f_f[i] + s - hip
            into_f -= self.k2 * self.load[i]
            u_e[i] = self.u_e[i] + self.dt * (into_e - self.u_e[i]) / Tr
            u_f[i] = self.u_f[i] + self.dt * (into_f - self.u_f[i]) / Tr
            f_e[i] = self.f_e[i] + self.dt * (y_e[i] - self.f_e[i]) / 0.6
            f_f[i] = self.f_f[i] + self.dt * (y_f[i] - self.f_f[i]) / 0.6
        self.u_e, self.u_f, self.f_e, self.f_f = u_e, u_f, f_e, f_f
        for i in range(4):
            if y_f[i] > 0.0:
                torque, force = 7.6 * (1.312 - theta[i]), Kp_knee_sw * (l_sw - length[i])
            else:
                torque, force = Kp_hip_st * (theta_st - theta[i]), Kp_knee_st * (0.13 - length[i])
            self.data.qfrc_applied[HIP[i]] = torque
            self.data.qfrc_applied[KNEE[i]] = force
        self.move()

    def move(self) -> None:
        """The body alone, under what is applied."""
        mujoco.mj_step(self.model, self.data)
        self.load = [float(load) for load in self.data.sensordata[:4]]


@dataclasses.dataclass
class OnCompliantFeet(PlanarQuadruped):
    """The same with MuJoCo's contacts off: springs and dampers under the feet, dense linear algebra.

    Damping of the joints and friction are those at the step's end, linear in the accelerations.
    """

    K: float = 8.0e4
    D: float = 250.0
    mu: float = 1.0
    v_slip: float = 0.01

    def __post_init__(self) -> None:
        super().__post_init__()
        self.model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT

    def move(self) -> None:
        """Semi-implicit Euler: v + dt a, then q with it."""
        m, d, dt = self.model, self.data, self.dt
        mujoco.mj_forward(m, d)
        M = np.zeros((m.nv, m.nv))
        mujoco.mj_fullM(m, d, M)
        M += dt * np.diag(m.dof_damping)
        force = d.qfrc_applied + d.qfrc_passive - d.qfrc_bias
        J, turning = np.zeros((3, m.nv)), np.zeros((3, m.nv))
        for i, leg in enumerate(("LF", "LH", "RF", "RH")):
            at = d.geom(f"foot_{leg}").xpos - [0.0, 0.0, m.geom(f"foot_{leg}").size[0]]
            body = m.body(f"lower_{leg}").id
            mujoco.mj_jac(m, d, J, None, at, body)
            mujoco.mj_jacDot(m, d, turning, None, at, body)
            slip, _, rise = J @ d.qvel
            pressed = at[2] < 0.0
            self.load[i] = max(0.0, -self.K * at[2] - self.D * rise) if pressed else 0.0
            slope = self.mu * self.load[i] / max(abs(slip), self.v_slip)
            M += dt * slope * np.outer(J[0], J[0])
            force += J[2] * self.load[i] - J[0] * slope * (slip + dt * turning[0] @ d.qvel)
        d.qvel += dt * np.linalg.solve(M, force)
        d.qpos += dt * d.qvel


def begun(pair: int = 0) -> np.ndarray:
    """The page's potentials (2, 4) at the start, unperturbed."""
    swings = np.isin(np.arange(4), (1, 2) if pair == 0 else (0, 3))
    return np.stack([np.where(swings, -0.5, 1.0), np.where(swings, 1.0, -0.5)])


def onsets(quadruped: PlanarQuadruped, duration: float) -> list[tuple[int, float]]:
    """Leg and time (s) of every swing onset in the first `duration` seconds, straight inside a step."""
    results = []
    for k in range(round(duration / quadruped.dt)):
        before = quadruped.u_f
        quadruped.step()
        for i, (old, new) in enumerate(zip(before, quadruped.u_f, strict=True)):
            if old <= 0.0 < new:
                results.append((i, (k - old / (new - old)) * quadruped.dt))
    return results


def followed(quadruped: PlanarQuadruped, duration: float) -> dict[str, Any]:
    """Q (n, 11), v (n, 11), u (n, 2, 4) and loads (n, 4) after each step of the first `duration` seconds."""
    kept: dict[str, list[Any]] = {"q": [], "v": [], "u": [], "load": []}
    for _ in range(round(duration / quadruped.dt)):
        quadruped.step()
        kept["q"].append(quadruped.data.qpos.copy())
        kept["v"].append(quadruped.data.qvel.copy())
        kept["u"].append(np.array([quadruped.u_e, quadruped.u_f]))
        kept["load"].append(np.array(quadruped.load))
    return {name: np.stack(values) for name, values in kept.items()}
