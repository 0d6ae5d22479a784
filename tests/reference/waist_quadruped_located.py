"""The quadruped with a waist joint as an ODE with located events, written from its page alone.

Accelerations are MuJoCo C's. Steps are Dormand and Prince's 5(4) with step control; an event is located by
taking the step again with shorter lengths, so nothing of a step's accuracy is lost at its end. One trajectory
at a time, as plain as can be. Limbs: 1 right fore, 2 left fore, 3 right hind, 4 left hind.
"""

# MuJoCo's compiled modules come without types.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import cast

import mujoco
import numpy as np
from scipy.optimize import brentq

from .dormand_prince import Fallen, LateEvent, advanced
from .waist_quadruped_body import varied

HIP, KNEE, WAIST = (7, 9, 12, 14), (8, 10, 13, 15), 11  # in qpos; in qvel one less
TWO_PI = 2.0 * math.pi
RELEASE = 1e-7  # m above the ground, where a foot is let go of
STANCE, EARLY, LATE, BEYOND = range(4)
Q, V, PHI, ANCHOR = slice(0, 16), slice(16, 31), slice(31, 35), slice(35, 43)


@dataclass(frozen=True)
class Landing:
    """Limb 3's landing: time (s), all phases (4,) rad after the reset, where the front body is (m).

    Of the cycle that it ends: the share that each foot stood, and how often each touched down, (4,).
    """

    time: float
    phases: np.ndarray
    x: float
    duty: np.ndarray
    touchdowns: np.ndarray


class Quadruped:
    """The page's equations with its parameters' `values`, and the state: y (43,) is q, v, phi, anchors."""

    def __init__(
        self,
        xml: str,
        values: Mapping[str, float],
        delta_13: float,
        swing: str,
        damping: str,
        slip: str,
        ground: Callable[[float], float] | None = None,
    ) -> None:
        p = self.p = dict(values)
        self.ground = ground
        self.swing, self.damping, self.slip = swing, damping, slip
        self.bend = [1.0 if p[f"{pair}_knees"] > 0.0 else -1.0 for pair in ("fore", "fore", "hind", "hind")]
        self.x_c, self.H = ([p[f"{name}_fore"]] * 2 + [p[f"{name}_hind"]] * 2 for name in ("x_c", "H"))
        self.model = varied(xml, p)
        self.data = mujoco.MjData(self.model)
        self.sites = [self.model.site(f"foot_{i + 1}").id for i in range(4)]
        self.AEP = TWO_PI * (1.0 - p["beta"])
        self.omega = TWO_PI * (1.0 - p["beta"]) / p["T_sw"]
        stiff = TWO_PI * p["f"]
        self.waist = p["kappa_0"] * stiff**2, 2.0 * p["kappa_0"] * p["zeta_0"] * stiff
        self.delta_13, self.time = delta_13, 0.0
        first = self.AEP + delta_13
        phi = np.mod([first, first - math.pi, self.AEP, self.AEP - math.pi], TWO_PI)
        self.segment = [STANCE if a >= self.AEP else EARLY if a < p["gate"] * self.AEP else LATE for a in phi]
        self.contact, self.lifted = [True] * 4, [False] * 4
        self.growing = self.held = True
        self.cycle_began, self.down_since, self.stood, self.touched = 0.0, [0.0] * 4, [0.0] * 4, [0] * 4
        self.LP = [(x, -H) for x, H in zip(self.x_c, self.H, strict=True)]
        self.y = np.zeros(43)
        self.y[PHI] = phi
        self.y[3] = 1.0
        starts = [self.path(i, 0.0, float(phi[i])) for i in range(4)]
        for i, (x, z) in enumerate(starts):
            self.y[[HIP[i], KNEE[i]]] = self.angles(x, z, self.bend[i])
        self.LP = starts
        # pitched until fore and hind feet are equally high
        self.slope(cast(float, brentq(self.slope, -1.0, 1.0, xtol=1e-15)))
        weight = (p["front_mass"] + p["rear_mass"] + 8.0 * p["link_mass"]) * p["g"]
        self.y[2] -= self.data.site_xpos[self.sites[0]][2] + weight / (4.0 * p["K_N"])
        if ground is not None:  # the fore AEP is at x = 0
            self.y[0] = -(p["front_hip_x"] + p["x_c_fore"] + 0.5 * p["D"])
        self.placed(self.y)
        self.y[ANCHOR] = np.ravel([self.data.site_xpos[site][:2] for site in self.sites])
        self.jacobian = np.zeros((3, 15))

    def slope(self, pitch: float) -> float:
        """Height of the fore feet above the hind feet with the body pitched (m)."""
        self.y[3], self.y[5] = math.cos(0.5 * pitch), math.sin(0.5 * pitch)
        self.placed(self.y)
        return self.data.site_xpos[self.sites[0]][2] - self.data.site_xpos[self.sites[2]][2]

    def angles(self, x: float, z: float, bend: float) -> tuple[float, float]:
        """Hip and knee of a limb with its foot at (x, z) from the hip, by the law of cosines."""
        far = math.hypot(x, z)
        inner = math.acos(min(far / (2.0 * self.p["link_length"]), 1.0))
        return math.atan2(-x, -z) - bend * inner, 2.0 * bend * inner

    def path(self, i: int, t: float, phi: float) -> tuple[float, float]:
        """Desired position of foot i relative to its hip (x, z), m."""
        p = self.p
        grown = t / p["T_grow"] if self.growing else 1.0
        D, h, H = p["D"] * grown, p["h"] * grown, self.H[i]
        back, ahead = self.x_c[i] - 0.5 * D, self.x_c[i] + 0.5 * D
        done = (phi - self.AEP) / (TWO_PI - self.AEP)
        if self.segment[i] == STANCE:
            x, z = self.LP[i]
            return x + (back - x) * done, z + (-H - z) * done
        if self.swing == "ellipse":
            below = self.segment[i] == BEYOND
            swung = phi / self.AEP - (p["swing_ease"] - 1.0) * math.sin(TWO_PI * phi / self.AEP) / TWO_PI
            angle = math.pi * (1.0 + done if below else swung)  # from the PEP over the top
            height = p["dip"] if below else h
            return self.x_c[i] - 0.5 * D * math.cos(angle), height * math.sin(angle) - H
        if self.segment[i] == BEYOND:
            return ahead + (back - ahead) * done, -H - p["dip"] * math.sin(math.pi * done)
        turn = TWO_PI * phi / self.AEP
        x = back + D * (turn - p["swing_ease"] * math.sin(turn)) / TWO_PI
        if self.swing == "sine":
            return x, h * math.sin(0.5 * turn) - H
        if self.swing == "two_cycloids":
            half = 2.0 * min(turn, TWO_PI - turn)  # of the cycloid up, or of the one down read backwards
            return x, h * (half - math.sin(half)) / TWO_PI - H
        return x, 0.5 * h * (1.0 - math.cos(turn)) - H

    def beneath(self, x: float) -> tuple[float, np.ndarray]:
        """Height (m) of the ground at a place, and its axes (3, 3): along it, y, and across it."""
        if self.ground is None:
            return 0.0, np.eye(3)
        span = 1e-6
        angle = math.atan2(self.ground(x + span) - self.ground(x - span), 2.0 * span)
        c, s = math.cos(angle), math.sin(angle)
        return self.ground(x), np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])

    def turning(self, i: int, t: float, phi: float, rate: float) -> tuple[float, float]:
        """Rates of the desired hip and knee angles of limb i, by differences (rad/s)."""
        span = 1e-6
        late, soon = (
            np.array(self.angles(*self.path(i, t + s, phi + s * rate), self.bend[i])) for s in (span, -span)
        )
        hip, knee = (late - soon) / (2.0 * span)
        return float(hip), float(knee)

    def placed(self, y: np.ndarray) -> None:
        """Positions of all in the data."""
        self.data.qpos[:] = y[Q]
        mujoco.mj_kinematics(self.model, self.data)

    def rates(self, t: float, y: np.ndarray) -> np.ndarray:
        """dy/dt with the modes as they are."""
        m, d, p = self.model, self.data, self.p
        q, v, phi = y[Q], y[V], y[PHI].tolist()
        rate = self.phase_rates(phi)
        d.qpos[:], d.qvel[:] = q, v
        mujoco.mj_fwdPosition(m, d)
        mujoco.mj_fwdVelocity(m, d)
        push = d.qfrc_applied
        push[:] = 0.0
        push[WAIST - 1] = -self.waist[0] * q[WAIST] - self.waist[1] * v[WAIST - 1]
        for i in range(4):
            hip, knee = self.angles(*self.path(i, t, phi[i]), self.bend[i])
            turning = 0.0, 0.0
            if self.damping == "rate_error":
                turning = self.turning(i, t, phi[i], float(rate[i]))
            push[HIP[i] - 1] = -p["kappa_1"] * (q[HIP[i]] - hip) - p["sigma_1"] * (v[HIP[i] - 1] - turning[0])
            push[KNEE[i] - 1] = -p["kappa_2"] * (q[KNEE[i]] - knee)
            push[KNEE[i] - 1] -= p["sigma_2"] * (v[KNEE[i] - 1] - turning[1])
        creep = np.zeros((4, 2))
        for i in range(4):
            if self.contact[i]:
                J = self.jacobian
                mujoco.mj_jacSite(m, d, J, None, self.sites[i])
                height, axes = self.beneath(y[35 + 2 * i])
                sunk = axes @ (d.site_xpos[self.sites[i]] - [*y[35 + 2 * i : 37 + 2 * i], height])
                speed = axes @ J @ v
                force = -p["K_TL"] * sunk - p["D_TL"] * speed
                damper = p["D_N"] * (p["D_rising"] if speed[2] > 0.0 else 1.0)
                force[2] = -p["K_N"] * sunk[2] - damper * speed[2]
                if p["clamp"] > 0.0:
                    force[2] = max(force[2], 0.0)
                if self.slip == "coulomb":
                    along, most = float(np.linalg.norm(force[:2])), p["mu"] * max(force[2], 0.0)
                    if along > most:
                        excess = force[:2] * (1.0 - most / along)
                        creep[i] = -excess / (p["K_TL"] * p["T_slip"])
                        force[:2] -= excess
                        creep[i, 0] *= axes[0, 0]
                push += force @ axes @ J
        mujoco.mj_fwdAcceleration(m, d)
        dy = np.empty(43)
        dy[:3] = v[:3]
        w, x, y_, z = q[3:7]
        a, b, c = v[3:6]  # in the body's own axes
        dy[3:7] = (
            -x * a - y_ * b - z * c,
            w * a + y_ * c - z * b,
            w * b + z * a - x * c,
            w * c + x * b - y_ * a,
        )
        dy[3:7] *= 0.5
        dy[7:16] = v[6:]
        dy[V] = d.qacc_smooth
        dy[PHI], dy[ANCHOR] = rate, creep.ravel()
        return dy

    def phase_rates(self, phi: list[float]) -> list[float]:
        """Rates of the phases (rad/s)."""
        p = self.p
        held = p["K_hold"] if self.held else 0.0
        pulls = [
            (i, j, p[f"K_{i + 1}{j + 1}"], p[f"K_{j + 1}{i + 1}"], p[f"delta_star_{i + 1}{j + 1}"])
            for i in range(4)
            for j in range(i + 1, 4)
        ]
        pulls += [(0, 2, held, held, self.delta_13), (1, 3, held, held, self.delta_13)]
        rate = [self.omega] * 4
        for i, j, on_i, on_j, wanted in pulls:
            sine = math.sin(phi[i] - phi[j] - wanted)
            rate[i] -= on_i * sine
            rate[j] += on_j * sine
        return rate

    def guards(self, t: float, y: np.ndarray) -> np.ndarray:
        """Guards, which rise through zero at an event (10,): corners (4), feet (4), the start's ends (2)."""
        self.placed(y)
        corners = [TWO_PI, self.p["gate"] * self.AEP, self.AEP, TWO_PI]
        turned = [y[31 + i] - corners[self.segment[i]] for i in range(4)]
        heights = []
        for site in self.sites:
            x, _, z = self.data.site_xpos[site]
            height, axes = self.beneath(x)
            heights.append((z - height) * axes[2, 2])
        feet = [up - RELEASE if on else -up for up, on in zip(heights, self.contact, strict=True)]
        grown = t - self.p["T_grow"] if self.growing else -1.0
        free = t - self.p["T_hold"] if self.held else -1.0
        return np.array([*turned, *feet, grown, free])

    def jump(self, fired: np.ndarray) -> Landing | None:
        """Apply the jumps of the guards that have risen; return limb 3's landing if it lands."""
        self.placed(self.y)
        wanted = [self.path(i, self.time, float(self.y[31 + i])) for i in range(4)]
        found = None
        for i in range(4):
            if fired[4 + i]:
                self.contact[i] = not self.contact[i]
                if self.contact[i]:
                    self.down_since[i] = self.time
                    self.touched[i] += 1
                else:
                    self.stood[i] += self.time - self.down_since[i]
                if self.contact[i] and not (self.segment[i] == STANCE and self.p["anchor_kept"] > 0.0):
                    self.y[35 + 2 * i : 37 + 2 * i] = self.data.site_xpos[self.sites[i]][:2]
            before = self.segment[i]
            if fired[i] and before in (STANCE, BEYOND):
                self.segment[i], self.lifted[i] = EARLY, False
                self.y[31 + i] -= TWO_PI
            elif fired[i]:
                self.segment[i] = before + 1
            self.lifted[i] |= not self.contact[i]
            late = self.segment[i] == LATE and self.lifted[i]
            if self.contact[i] and (late or self.segment[i] == BEYOND):
                resets = late or self.p["late_reset"] > 0.0
                self.segment[i], self.LP[i] = STANCE, self.landing_point(i, wanted[i], resets)
                if resets and self.p["resetting"] > 0.0:
                    self.y[31 + i] = self.AEP
                found = i == 2 or found
        self.growing &= not fired[8]
        self.held &= not fired[9]
        return self.ended() if found is True else None

    def landing_point(self, i: int, wanted: tuple[float, float], resets: bool) -> tuple[float, float]:
        """Beginning of the line of limb i's stance; without a reset, the AEP."""
        if not resets:
            grown = self.time / self.p["T_grow"] if self.growing else 1.0
            return self.x_c[i] + 0.5 * self.p["D"] * grown, -self.H[i]
        d, number = self.data, i + 1
        frame = d.body("front" if i < 2 else "rear").xmat.reshape(3, 3)
        foot = (d.site(f"foot_{number}").xpos - d.body(f"upper_{number}").xpos) @ frame
        share = self.p["landing_actual"]
        return tuple(wanted[k] + share * (foot[2 * k] - wanted[k]) for k in (0, 1))

    def ended(self) -> Landing:
        """Readings of the cycle that limb 3's landing ends."""
        on = [
            self.time - since if down else 0.0
            for since, down in zip(self.down_since, self.contact, strict=True)
        ]
        duty = (np.array(self.stood) + on) / (self.time - self.cycle_began)
        landing = Landing(self.time, self.y[PHI].copy(), float(self.y[0]), duty, np.array(self.touched))
        self.cycle_began, self.down_since, self.stood, self.touched = (
            self.time,
            [self.time] * 4,
            [0.0] * 4,
            [0] * 4,
        )
        return landing

    def fell(self) -> bool:
        """The front body is low, has tilted or the waist has twisted over (the page's limits)."""
        w, x, y, z = self.y[3:7] / np.linalg.norm(self.y[3:7])
        ahead, side = 2.0 * (x * z - w * y), 2.0 * (y * z + w * x)
        up = w * w - x * x - y * y + z * z
        tilted = abs(math.atan2(side, up)) > 1.2 or abs(math.asin(max(-1.0, min(1.0, ahead)))) > 1.2
        return bool(self.y[2] < 0.4 * self.H[0] or tilted or abs(self.y[WAIST]) > 1.5)


def landings(
    xml: str,
    values: Mapping[str, float],
    delta_13: float,
    crossings: int,
    *,
    rtol: float,
    nudge: float = 0.0,
    swing: str = "cycloid",
    damping: str = "joint_rate",
    slip: str = "none",
    ground: Callable[[float], float] | None = None,
) -> list[Landing]:
    """Limb 3's first landings, `crossings` of them.

    Args:
        xml: MJCF of the body at the page's values.
        values: each of the model's parameters.
        delta_13: the start, rad; `nudge` is added to the front body's height (m).
        rtol: of the steps, relative to 1 (m, rad, m/s, rad/s).
        swing, damping, slip: words of the model's structure.
        ground: the height (m) of uneven ground at a place x (m).

    Raises:
        Fallen: the body fell first. LateEvent: no event where one was due, or events without end.
    """
    walker = Quadruped(xml, values, delta_13, swing, damping, slip, ground)
    walker.y[2] += nudge
    results: list[Landing] = []
    limit = 3.0 * (crossings + 1) * TWO_PI / walker.omega
    h, chain = 1e-5, 0
    guards = walker.guards(walker.time, walker.y)
    while len(results) < crossings:
        if np.any(guards >= 0.0):
            chain += 1
            if chain > 50 or walker.time > limit:
                raise LateEvent(f"events follow each other at t = {walker.time} s")
            landing = walker.jump(guards >= 0.0)
            if landing is not None:
                results.append(landing)
            guards = walker.guards(walker.time, walker.y)
            h = min(h, 1e-5)
            continue
        accepted = advanced(walker.rates, walker.guards, walker.time, walker.y, h, guards, rtol)
        chain = 0 if accepted.t - walker.time > 1e-9 else chain
        walker.time, walker.y, guards, h = accepted.t, accepted.y, accepted.guards, accepted.h
        if walker.fell():
            raise Fallen(f"at t = {walker.time} s")
        if walker.time > limit:
            raise LateEvent(f"{len(results)} landings until t = {walker.time} s")
    return results
