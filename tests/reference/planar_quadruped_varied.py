"""The planar quadruped on compliant feet in MuJoCo C, with other masses, parameters and starts."""

# MuJoCo's compiled modules come without types.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import mujoco
import numpy as np

from .planar_quadruped_mujoco import HIP, KNEE, OnCompliantFeet, begun

LEGS = ("LF", "LH", "RF", "RH")
LF, LH, RF, RH = range(4)
# A fall, as the model defines it: heights below 0.45 of the standing one (0.175 + 0.13 m), and pitch (rad).
LOWEST, MOST_PITCH = 0.45 * (0.175 + 0.13), 1.0
SCATTER = 0.1  # largest change of a potential at the start
LONGEST_CYCLE = 3.0  # s: a row that takes longer for its cycles is given up
# Their multiples modulo 1 are the pseudo-random potentials of a seed, as the model defines them.
ROOTS = np.sqrt([[2.0, 3.0, 5.0, 7.0], [11.0, 13.0, 17.0, 19.0]])


@dataclass(frozen=True)
class Crossing:
    """LF's swing onset (s) that closes a cycle: shifts (cycles), period (s), mean speed (m/s)."""

    time: float
    delta_1: float
    delta_2: float
    period: float
    speed: float


def varied(xml: str, values: Mapping[str, float]) -> mujoco.MjModel:
    """The body with these masses (kg), `torso_inertia` (kg m2), `com_x`, `hip_x` (m) and joint damping."""
    spec = mujoco.MjSpec.from_string(xml)
    torso = spec.body("torso")
    torso.mass, torso.ipos = values["torso_mass"], [values["com_x"], 0.0, 0.0]
    torso.inertia = torso.inertia * values["torso_inertia"] / torso.inertia[1]
    for leg in LEGS:
        upper = spec.body(f"upper_{leg}")
        upper.pos = [math.copysign(values["hip_x"], upper.pos[0]), upper.pos[1], 0.0]
        for part in ("upper", "lower", "foot"):
            spec.geom(f"{part}_{leg}").mass = values[f"{part}_mass"]
    model = spec.compile()
    model.dof_damping[list(HIP)], model.dof_damping[list(KNEE)] = values["Kv_hip"], values["Kv_knee"]
    return model


def crossings(
    xml: str, values: Mapping[str, float], count: int, *, dt: float = 1e-3, nudge: float = 0.0
) -> list[Crossing] | None:
    """The first `count` crossings, None where the quadruped falls or does not come to them.

    Args:
        xml: MJCF of the body.
        values: parameters by name, and `seed` and `pair` of the start.
        dt: the step, s.
        nudge: is added to the torso's height at the start, m.
    """
    pair = int(values["pair"])
    turns = (values["seed"] + 1.0) * ROOTS
    start = begun(pair) + SCATTER * (2.0 * (turns - np.floor(turns)) - 1.0)
    walker = OnCompliantFeet(
        varied(xml, values), values["sigma"], start, pair, values["k2"], dt,
        K=values["K_foot"], D=values["D_foot"], mu=values["mu"], v_slip=values["v_slip"],
    )  # fmt: skip
    walker.data.qpos[1] += nudge
    recorded: list[Crossing] = []
    onset, last_x = [0.0] * 4, float(walker.data.qpos[0])
    for k in range(round(LONGEST_CYCLE * (count + 2) / dt)):
        before = walker.u_f
        walker.step()
        z, pitch, x = walker.data.qpos[1], walker.data.qpos[2], float(walker.data.qpos[0])
        if not np.isfinite(z) or z < LOWEST or abs(pitch) > MOST_PITCH:
            return None
        began = [old <= 0.0 < new for old, new in zip(before, walker.u_f, strict=True)]
        period = 0.0
        for i in np.flatnonzero(began):
            time = (k - before[i] / (walker.u_f[i] - before[i])) * dt
            period = time - onset[i] if i == LF else period
            onset[i] = time
        if began[LF]:
            shifts = [(onset[LH] - onset[RF]) / period, (onset[RH] - onset[LF]) / period]
            delta_1, delta_2 = (shift - math.floor(shift + 0.5) for shift in shifts)
            recorded.append(Crossing(onset[LF], delta_1, delta_2, period, (x - last_x) / period))
            last_x = x
            if len(recorded) == count:
                return recorded
    return None
