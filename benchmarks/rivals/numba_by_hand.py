"""Rival: Numba by hand, one trajectory at a time with branches, `prange` over the trajectories.

Written for this one model: what belongs to the four legs is a tuple of four, so that the state stays in
registers. Phases q are measured from the end of their segment (rad, negative until it ends), heights x
from L (m): a leg's length is then slope * q + foot.
"""

from __future__ import annotations

import math
import time
from collections import namedtuple
from typing import Any

import numpy as np
from numba import njit, prange

from .by_hand import EVENT_TOLERANCE, LEGS, PATIENCE, Found, Starts, timed
from .starts import Array, Parameters, Row

Four = tuple[float, float, float, float]
State = tuple[Four, Four, Four, Four]  # x, v, q, y
Modes = tuple[Four, Four, Four]  # slope and foot of each leg, and 1 for a leg in contact, 0 for others
# q of each leg, then its gap, signed so that both rise to an event
Guards = tuple[float, float, float, float, float, float, float, float]
# Table 1; `rate` is 1/tau, `stance` and `swing` the lengths of the segments (rad), `steep` in m/rad.
Table = namedtuple("Table", "kappa sigma K D omega rate g m m_B a stance swing steep")

TURN, LANDING = 2.0 * math.pi, 2
FIRST_STEP, GROWTH, SECANT_TRIALS, PATIENT_TRIALS = 0.125, 1.25, 24, 60
STRICTLY = 1e-300  # x = l switches no contact
# LLVM leaves the step as a function of its own where it is not told to inline it: a quarter slower
compiled = njit(error_model="numpy", fastmath={"contract"}, forceinline=True)


@compiled
def along(at: Four, step: float, rate: Four) -> Four:
    return at[0] + step * rate[0], at[1] + step * rate[1], at[2] + step * rate[2], at[3] + step * rate[3]


@compiled
def times(one: Four, other: Four) -> Four:
    return one[0] * other[0], one[1] * other[1], one[2] * other[2], one[3] * other[3]


@compiled
def plus(one: Four, other: Four) -> Four:
    return one[0] + other[0], one[1] + other[1], one[2] + other[2], one[3] + other[3]


@compiled
def alike(value: float) -> Four:
    return value, value, value, value


@compiled
def with_one(of: Any, leg: int, value: Any) -> Any:
    a, b, c, d = of
    return (
        value if leg == 0 else a,
        value if leg == 1 else b,
        value if leg == 2 else c,
        value if leg == 3 else d,
    )


@compiled
def acceleration(p: Table, x: Four, v: Four, leg: Four, turn: Four, push: Four) -> Four:
    """Eq. 1; `turn` is the rate of the leg's length, `push` 1 for a leg in contact and 0 for others."""
    pull_1 = p.kappa * (x[1] - x[0]) + p.sigma * (v[1] - v[0])
    pull_2 = p.kappa * (x[2] - x[1]) + p.sigma * (v[2] - v[1])
    pull_3 = p.kappa * (x[3] - x[2]) + p.sigma * (v[3] - v[2])
    ground = along(times(alike(p.K), along(leg, -1.0, x)), p.D, along(turn, -1.0, v))
    force = plus((pull_1, pull_2 - pull_1, pull_3 - pull_2, -pull_3), times(push, ground))
    lift = 1.0 / p.m_B, 1.0 / p.m, 1.0 / p.m, 1.0 / p.m_B
    return plus(times(force, lift), alike(-p.g))


@compiled
def rk4(p: Table, state: State, modes: Modes, h: float) -> State:
    """The classic step; the lag y shrinks by the same factor in all legs, so its stages are a number each."""
    x, v, q, y = state
    slope, foot, push = modes
    half, sixth = 0.5 * h, h * (1.0 / 6.0)
    share_2 = 1.0 - half * p.rate
    share_3 = 1.0 - half * p.rate * share_2
    share_4 = 1.0 - h * p.rate * share_3
    mean = sixth * (1.0 + 2.0 * (share_2 + share_3) + share_4)
    drift, lag = times(alike(p.omega), slope), times(slope, y)
    leg, turn = plus(times(slope, q), foot), plus(drift, lag)
    a = acceleration(p, x, v, leg, turn, push)
    v_2, turn_2 = along(v, half, a), along(drift, share_2, lag)
    a_2 = acceleration(p, along(x, half, v), v_2, along(leg, half, turn), turn_2, push)
    v_3, turn_3 = along(v, half, a_2), along(drift, share_3, lag)
    a_3 = acceleration(p, along(x, half, v_2), v_3, along(leg, half, turn_2), turn_3, push)
    v_4, turn_4 = along(v, h, a_3), along(drift, share_4, lag)
    a_4 = acceleration(p, along(x, h, v_3), v_4, along(leg, h, turn_3), turn_4, push)
    return (
        along(x, sixth, along(plus(v, v_4), 2.0, plus(v_2, v_3))),
        along(v, sixth, along(plus(a, a_4), 2.0, plus(a_2, a_3))),
        along(plus(q, alike(h * p.omega)), mean, y),
        along(y, -p.rate * mean, y),
    )


@compiled
def guards(state: State, modes: Modes) -> Guards:
    gap = along(state[0], -1.0, plus(times(modes[0], state[2]), modes[1]))
    sign = along(alike(-1.0), 2.0, modes[2])
    return state[2] + plus(alike(-STRICTLY), times(sign, gap))


@compiled
def halved(of: Guards) -> Guards:
    return times(alike(0.5), of[:4]) + times(alike(0.5), of[4:])


@compiled
def first_root(near: Guards, far: Guards, h: float) -> float:
    """First root of the secants of the guards that fire, as a step from the state (s)."""
    share = 1.0
    for guard in range(2 * LEGS):
        if far[guard] >= 0.0:
            below = max(-near[guard], 0.0)
            rise = below + far[guard]
            share = min(share, below / rise if rise > 0.0 else 0.0)
    return h * share


@compiled
def line(p: Table, segment: int) -> tuple[float, float, float, float]:
    """Of a segment: the phase at its end, its length (rad), the leg's slope in it (m/rad), its foot (m)."""
    end = TURN - p.swing * (LANDING - segment)
    if segment == 0:
        return end, p.stance, 0.0, 0.0
    return (end, p.swing, p.steep, 0.0) if segment == LANDING else (end, p.swing, -p.steep, -p.a)


@compiled
def jump(p: Table, state: State, modes: Modes, segment: Any, at_trial: Guards, landed: bool) -> Any:
    """State, modes and segments after the events of `there`; leg 1's landing; whether a cycle closed."""
    x, v, q, y = state
    slope, foot, push = modes
    closed = False
    for leg in range(LEGS):
        wraps = at_trial[leg] >= 0.0 and segment[leg] == LANDING
        if at_trial[leg] >= 0.0:
            following = (segment[leg] + 1) % 3
            segment = with_one(segment, leg, following)
            _, extent, rise, start = line(p, following)
            q = with_one(q, leg, q[leg] - extent)
            slope, foot = with_one(slope, leg, rise), with_one(foot, leg, start)
        switched = at_trial[LEGS + leg] >= 0.0
        kicked = switched and push[leg] == 0.0 and segment[leg] == LANDING
        push = with_one(push, leg, 1.0 - push[leg] if switched else push[leg])
        y = with_one(y, leg, y[leg] - p.rate * q[leg] if kicked else y[leg])
        if leg == 0:
            closed = not landed and (kicked or wraps)
            landed = (landed or kicked) and not wraps
    return (x, v, q, y), (slope, foot, push), segment, landed, closed


@compiled
def keep(p: Table, t: float, q: Four, segment: Any, sample: Array) -> None:
    sample[0] = t
    for leg in range(1, LEGS):
        psi = q[leg] + line(p, segment[leg])[0] - q[leg - 1] - line(p, segment[leg - 1])[0]
        sample[leg] = psi - TURN * math.floor(psi / TURN)


@compiled
def four(row: Any, first: int) -> Any:
    return row[first], row[first + 1], row[first + 2], row[first + 3]


@compiled
def trajectory(p: Table, row: Array, segments: Any, dt: float, limit: int, recorded: Array) -> int:
    """Fills `found` (crossings, 4) with t and psi; the attempts that it took."""
    state, segment = (four(row, 0), four(row, 4), four(row, 8), four(row, 12)), four(segments, 0)
    modes = four(row, 16), four(row, 20), four(row, 24)
    near = guards(state, modes)  # halved, as the guards at the far end, where that end stays for long
    far, far_guards, moved, trials = math.inf, near, 0, 0
    t, h, pace, landed, count, attempts = 0.0, 0.0, dt, True, 0, 0
    while count < len(recorded) and attempts < limit:
        attempts += 1
        trial = rk4(p, state, modes, h) if h > 0.0 else state
        at_trial = guards(trial, modes)
        tolerance = EVENT_TOLERANCE * (1.0 + max(trials - PATIENT_TRIALS, 0) ** 2)
        if max(at_trial) < 0.0:
            state, near = trial, at_trial
            t += h
            trials = trials + 1 if far < math.inf else 0
            far = far - h if far > h else math.inf
            if far == math.inf:
                pace = min(dt, GROWTH * pace) if h > 0.0 else FIRST_STEP * dt
                h, moved = pace, 0
                continue
            if moved > 0:
                far_guards = halved(far_guards)
            moved = 1
        elif h - first_root(guards(state, modes), at_trial, h) <= tolerance:
            t += h
            state, modes, segment, landed, closed = jump(p, trial, modes, segment, at_trial, landed)
            if closed:
                keep(p, t, state[2], segment, recorded[count])
                count += 1
            near = guards(state, modes)
            h, far, moved, trials = 0.0, math.inf, 0, 0
            continue
        else:
            if moved < 0:
                near = halved(near)
            far, far_guards, moved, trials = h, at_trial, -1, trials + 1
        # the next trial on the way to the event: the Illinois secant, half a tolerance past its root
        root = first_root(near, far_guards, far) + 0.5 * tolerance
        h = far if far <= tolerance else 0.5 * far if trials > SECANT_TRIALS else min(root, far)
    return attempts


@njit(parallel=True, error_model="numpy", fastmath={"contract"})
def sweep(p: Table, z: Array, segments: Any, dt: float, limit: int, recorded: Array, attempts: Any) -> None:
    for row in prange(len(z)):
        attempts[row] = trajectory(p, z[row], segments[row], dt, limit, recorded[row])


def run(starts: Starts, crossings: int, dt: float = 4e-3) -> Found:
    """All starts on all cores (NUMBA_NUM_THREADS: on so many)."""
    p = Parameters()
    swing = (1.0 - p.beta) * math.pi
    springs = (p.kappa, float(p.spring_damper), p.K, float(p.ground_damper))
    rest = (p.omega, 1.0 / p.tau, p.g, p.m, p.m_B, p.a, 2.0 * p.beta * math.pi, swing, p.a / swing)
    contact, segment = starts.modes[:, :LEGS], starts.modes[:, LEGS:]
    slope, foot = p.slopes[segment], (p.slopes * (p.corners - p.origins))[segment]
    z = np.concatenate([starts.z, slope, foot, contact], axis=1, dtype=float)
    result = Found.empty(len(z), crossings)
    filled = result.crossings, result.attempts
    sweep(Table(*springs, *rest), z, segment.astype(int), dt, PATIENCE * crossings, *filled)
    return result


def measure(lanes: int = 1024, crossings: int = 5, dt: float = 4e-3) -> Row:
    begun = time.perf_counter()
    run(Starts.of(Parameters(), np.ones((1, 3))), 1)
    note = f", compiled in {time.perf_counter() - begun:.0f} s"
    return timed("Numba by hand, one trajectory at a time", run, lanes, crossings, dt, note)


if __name__ == "__main__":
    print(measure())
