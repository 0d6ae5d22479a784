"""The quadruped with a waist joint in MuJoCo C, its controller in NumPy, written from its page alone.

One trajectory in steps of fixed length, as slow and plain as can be: the models' oracle. Only the MJCF of the
body is shared with them. Limbs: 1 right fore, 2 left fore, 3 right hind, 4 left hind.
"""

# MuJoCo's compiled modules come without types.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

import dataclasses
import math
from typing import NamedTuple

import mujoco
import numpy as np

HIP, KNEE, WAIST = (7, 9, 12, 14), (8, 10, 13, 15), 11  # in qpos; in qvel one less
BEND = (1.0, 1.0, -1.0, -1.0)  # knees: fore one way, hind the other
LINK = 0.08
TWO_PI = 2.0 * math.pi


class Landing(NamedTuple):
    """Limb (0 to 3), time (s), and all phases (4,) rad at the end of that step, after the reset."""

    limb: int
    time: float
    phases: np.ndarray


@dataclasses.dataclass
class Quadruped:
    """The constants of the page, and the state between two steps."""

    model: mujoco.MjModel
    delta_13: float
    T_grow: float = 4.0
    T_hold: float = 7.0
    f: float = 2.6
    beta: float = 0.75
    dt: float = 2e-4

    def __post_init__(self) -> None:
        self.model.opt.timestep = self.dt
        self.data = mujoco.MjData(self.model)
        self.AEP = TWO_PI * (1.0 - self.beta)  # the anterior extreme position's phase
        self.omega = TWO_PI * (1.0 - self.beta) / 0.1
        self.x_c, self.H = -0.0008, 0.133
        stiff = 0.042 * (TWO_PI * self.f) ** 2
        self.waist = stiff, 2.0 * 0.042 * (TWO_PI * self.f)
        first = self.AEP + self.delta_13
        self.phi = np.mod([first, first - math.pi, self.AEP, self.AEP - math.pi], TWO_PI)
        self.stance = self.phi >= self.AEP
        self.contact, self.lifted = np.ones(4, bool), np.zeros(4, bool)
        self.LP = np.tile([self.x_c, -self.H], (4, 1))
        self.height, self.gain, self.time = np.zeros(4), np.zeros(4), 0.0
        weight = (2 * 1.0 + 8 * 0.1) * 9.8
        self.data.qpos[2] = self.H - weight / (4 * 3.6e4)
        for i in range(4):
            self.data.qpos[[HIP[i], KNEE[i]]] = self.angles(i, self.x_c, -self.H)
        mujoco.mj_forward(self.model, self.data)
        self.anchor = np.array([self.data.site(f"foot_{i + 1}").xpos[:2] for i in range(4)])

    def angles(self, i: int, x: float, z: float) -> tuple[float, float]:
        """Hip and knee of limb i with its foot at (x, z) from the hip, by the law of cosines."""
        far = math.hypot(x, z)
        inner = math.acos(min(far / (2.0 * LINK), 1.0))
        return math.atan2(-x, -z) - BEND[i] * inner, 2.0 * BEND[i] * inner

    def path(self, phi: float, stance: bool, LP: np.ndarray) -> np.ndarray:
        """Desired position of a foot relative to its hip (x, z)."""
        grown = min(self.time / self.T_grow, 1.0)
        D, h = 0.056 * grown, 0.0393 * grown
        PEP, AEP = np.array([self.x_c - D / 2, -self.H]), np.array([self.x_c + D / 2, -self.H])
        rest = (phi - self.AEP) / (TWO_PI - self.AEP)
        if stance:
            return LP + (PEP - LP) * rest
        if phi > self.AEP:
            return AEP + (PEP - AEP) * rest - [0.0, 0.009 * math.sin(math.pi * rest)]
        s = phi / self.AEP
        up = 0.5 * h * (1.0 - math.cos(TWO_PI * s))
        return PEP + np.array([D * (s - math.sin(TWO_PI * s) / TWO_PI), up])

    def landed(self, i: int, since_touch: float) -> float | None:
        """The phase that has passed since limb i landed in the last step, None where it has not.

        `since_touch`: that since its foot came down in this step, infinite where it stood before.
        """
        if self.stance[i] or not self.contact[i]:
            return None
        by_phase = [self.phi[i] - self.AEP, self.phi[i] - 0.5 * self.AEP]
        allowed = [by_phase[0], by_phase[1] if self.lifted[i] else -1.0]
        ways = [min(since_touch, since) for since in allowed if since >= 0.0]
        return max(ways) if ways else None

    def step(self) -> list[Landing]:
        """One step of semi-implicit Euler; the landings of the one before it."""
        m, d = self.model, self.data
        mujoco.mj_step1(m, d)
        results = []
        push = np.zeros(m.nv)
        wanted = np.zeros((4, 2))
        for i in range(4):
            site = d.site(f"foot_{i + 1}").id
            at, J = d.site_xpos[site], np.zeros((3, m.nv))
            mujoco.mj_jacSite(m, d, J, None, site)
            speed = J @ d.qvel
            touches = not self.contact[i] and at[2] <= 0.0
            rest = -at[2] / (self.height[i] - at[2]) if touches else 0.0
            self.contact[i] = touches or (self.contact[i] and at[2] <= 1e-7)
            if touches:
                self.anchor[i] = at[:2] - rest * self.dt * speed[:2]
            over = self.landed(i, rest * self.gain[i] if touches else math.inf)
            if over is not None:
                self.LP[i] = self.path(self.phi[i] - over, False, self.LP[i])
                self.stance[i], self.phi[i] = True, self.AEP + over
                results.append(Landing(i, self.time - over / self.omega, self.phi))
            elif self.phi[i] >= TWO_PI:
                self.stance[i], self.phi[i], self.lifted[i] = False, self.phi[i] - TWO_PI, False
            self.lifted[i] |= not self.contact[i]
            self.height[i] = at[2]
            wanted[i] = self.path(self.phi[i], self.stance[i], self.LP[i])
            if self.contact[i]:
                sunk = at - [*self.anchor[i], 0.0]
                push += J.T @ (-3.6e4 * sunk - 175.0 * speed)
        results = [landing._replace(phases=self.phi.copy()) for landing in results]
        d.qfrc_applied[:] = push + self.torques(wanted)
        mujoco.mj_step2(m, d)
        self.gain = self.dt * self.rates()
        self.phi, self.time = self.phi + self.gain, self.time + self.dt
        return results

    def torques(self, wanted: np.ndarray) -> np.ndarray:
        q, v = self.data.qpos, self.data.qvel
        tau = np.zeros(self.model.nv)
        tau[WAIST - 1] = -self.waist[0] * q[WAIST] - self.waist[1] * v[WAIST - 1]
        for i in range(4):
            hip, knee = self.angles(i, *wanted[i])
            tau[HIP[i] - 1] = -16.3 * (q[HIP[i]] - hip) - 0.125 * v[HIP[i] - 1]
            tau[KNEE[i] - 1] = -9.75 * (q[KNEE[i]] - knee) - 0.0755 * v[KNEE[i] - 1]
        return tau

    def rates(self) -> np.ndarray:
        """Rates of the phases: K_12 = K_34 = 10 towards pi, and K_13 = 20 towards delta_13 at the start.

        Of the step in which T_hold lies, K_13 counts for the share before it.
        """
        pairs = [(0, 1, 10.0, math.pi), (2, 3, 10.0, math.pi)]
        held = 20.0 * min(max((self.T_hold - self.time) / self.dt, 0.0), 1.0)
        pairs += [(0, 2, held, self.delta_13), (1, 3, held, self.delta_13)]
        rates = np.full(4, self.omega)
        for i, j, K, wanted in pairs:
            pull = K * math.sin(self.phi[i] - self.phi[j] - wanted)
            rates[[i, j]] += -pull, pull
        return rates


def landings(model: mujoco.MjModel, duration: float, **how: float) -> list[Landing]:
    """All landings within `duration` (s) of the start."""
    quadruped = Quadruped(model, **how)  # type: ignore[arg-type]
    return [found for _ in range(round(duration / quadruped.dt)) for found in quadruped.step()]
