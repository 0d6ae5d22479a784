"""The simplest walker, 20 steps a row, at the error of heyoka: Taylor steps in batches with terminal events.

heyoka has no resets: a callback in Python applies them, lane by lane. Its tolerances are 1e-8 and 1e-12; the
rtol of each method here is the coarsest of a ladder whose error is no larger. The error is the largest of the
stance angle, of its rate and of the time after the last step relative to its size, over a few rows, against
SciPy's DOP853 with terminal events (rtol 1e-13).
"""

from __future__ import annotations

import math
import resource
import subprocess
import sys
from collections.abc import Iterator

import numpy as np

from .measured import Array, Line, Options, installed, missing, swept, timed, version_of

SLOPE, RATE = 0.009, -0.199832473004977  # rad; Garcia et al. 1998
STEPS = 20
ANGLES = (0.1995, 0.2010)  # rad, of the stance leg after a heel strike, within the basin of the gait
COMPARED = 10
TOLERANCES = (1e-8, 1e-12)
LADDER = tuple(10.0**-k for k in range(8, 15))
RUN = {"kind": "settle", "max_cycles": STEPS, "tolerance": 1e-30}
PROCESS_ROWS = 1000


def lines(options: Options) -> Iterator[Line]:
    """The lines of heyoka and of gaitsweep's methods."""
    right = reference(starts(COMPARED))
    for rows in options.rows_or(1000, 20_000):
        for tolerance in TOLERANCES:
            aim = tolerance
            if installed("heyoka") is None:
                yield missing("heyoka")
            else:
                walk = heyoka_walk(tolerance)
                (ends, count), cpu, clock = timed(
                    lambda walk=walk, rows=rows: walk(starts(rows)), options.repeats
                )
                aim = error_of(walk(starts(COMPARED))[0], right)
                note = (
                    f"{count / rows / STEPS:.1f} Taylor steps a walking step; resets by a callback in Python"
                )
                name = f"{version_of('heyoka')}, tol {tolerance:g}, {rows} rows"
                yield Line(name, cpu, clock, aim, note if np.isfinite(ends).all() else "rows are lost")
            for method in ("tsit5", "taylor"):
                yield ours(method, aim, rows, right, options)
    yield from processes()


def ours(method: str, aim: float, rows: int, right: Array, options: Options) -> Line:
    """The line of a method of gaitsweep whose error is at most `aim`, or the least that it has."""
    errors = {rtol: error_of(walk(method, rtol, starts(COMPARED)), right) for rtol in LADDER}
    fine = [rtol for rtol in LADDER if errors[rtol] <= aim] or [min(errors, key=lambda rtol: errors[rtol])]
    rtol = fine[0]
    _, cpu, clock = timed(lambda: walk(method, rtol, starts(rows)), options.repeats)
    beside = timed(lambda: walk(method, rtol, starts(rows), steps=1), options.repeats)[1]
    note = f"of them {cpu - beside:.3g} s of CPU time beyond a call of one step a row"
    return Line(f"gaitsweep {method}, rtol {rtol:g}, {rows} rows", cpu, clock, errors[rtol], note)


def starts(rows: int) -> Array:
    """Stance angles (rad) at the start of each row."""
    return np.linspace(*ANGLES, rows)


def walk(method: str, rtol: float, angles: Array, steps: int = STEPS) -> Array:
    """Time, stance angle and rate after the last step of each row, (rows, 3), by gaitsweep."""
    from tests.support.models.simplest_walker import SimplestWalker

    numerics = {"method": method, "rtol": rtol, "atol": rtol, "event_tolerance": 1e-15}
    axes = {"theta_0": angles, "phi_0": 2.0 * angles, "phi_rate_0": (1.0 - np.cos(2.0 * angles)) * RATE}
    table = swept(SimplestWalker(), {**RUN, "max_cycles": steps}, numerics, zip=axes)
    return table[["t_end", "theta_end", "theta_rate_end"]].to_numpy(float)


def reference(angles: Array) -> Array:
    """The same by SciPy, one row after the other."""
    from scipy.integrate import solve_ivp

    def flow(t: float, s: Array) -> list[float]:
        fall = np.sin(s[0] - SLOPE)
        return [s[1], fall, s[3], fall + (s[1] ** 2 - np.cos(s[0] - SLOPE)) * np.sin(s[2])]

    def strike(t: float, s: Array) -> float:
        return s[2] - 2.0 * s[0] if t > 0.5 else 1.0  # it rises at the beginning, too

    strike.terminal, strike.direction = True, 1.0  # type: ignore[attr-defined]
    ends = []
    for angle in angles:
        time, theta, rate = 0.0, angle, RATE
        for _ in range(STEPS):
            start = [theta, rate, 2.0 * theta, (1.0 - np.cos(2.0 * theta)) * rate]
            run = solve_ivp(
                flow, (0.0, 9.0), start, "DOP853", events=strike, rtol=1e-13, atol=1e-14, max_step=0.05
            )
            at = run.y_events[0][0]
            time, theta, rate = time + run.t_events[0][0], -at[0], np.cos(2.0 * at[0]) * at[1]
        ends.append([time, theta, rate])
    return np.array(ends)


def error_of(ends: Array, right: Array) -> float:
    """The largest error, of times relative to their size."""
    return float(np.max(np.abs(ends - right) / np.array([right[:, 0].max(), 1.0, 1.0])))


def heyoka_walk(tolerance: float):
    """A function from stance angles to ends (rows, 3) and the number of Taylor steps, by heyoka."""
    hy = installed("heyoka")
    theta, theta_rate, phi, phi_rate = hy.make_vars("theta", "theta_rate", "phi", "phi_rate")
    fall = hy.sin(theta - SLOPE)
    swing = fall + (theta_rate**2 - hy.cos(theta - SLOPE)) * hy.sin(phi)
    system = [(theta, theta_rate), (theta_rate, fall), (phi, phi_rate), (phi_rate, swing)]
    lanes = hy.recommended_simd_size()
    steps, last = [0] * lanes, np.zeros((lanes, 3))
    walking = set(range(lanes))

    def exchange(integrator, sign, lane):
        state = integrator.state
        angle = state[0, lane]
        if angle > 0.0:  # the start is on the surface of the event
            return True
        cosine = math.cos(2.0 * angle)
        rate = cosine * state[1, lane]
        state[0, lane], state[1, lane] = -angle, rate
        state[2, lane], state[3, lane] = -2.0 * angle, (1.0 - cosine) * rate
        steps[lane] += 1
        if steps[lane] == STEPS:
            last[lane] = integrator.time[lane], -angle, rate
            walking.discard(lane)
        # an event that ends one lane ends the batch: lanes that are ahead walk on
        return bool(walking)

    strike = hy.t_event_batch(phi - 2.0 * theta, direction=hy.event_direction.positive, callback=exchange)
    integrator = hy.taylor_adaptive_batch(system, np.zeros((4, lanes)), tol=tolerance, t_events=[strike])

    def ends_of(angles: Array) -> tuple[Array, int]:
        ends, count = np.full((len(angles), 3), np.nan), 0
        for first in range(0, len(angles), lanes):
            starts = angles[np.minimum(np.arange(first, first + lanes), len(angles) - 1)]
            integrator.set_time(0.0)
            integrator.reset_cooldowns()
            rate = np.full(lanes, RATE)
            integrator.state[:] = starts, rate, 2.0 * starts, (1.0 - np.cos(2.0 * starts)) * rate
            steps[:] = [0] * lanes
            walking.update(range(lanes))
            integrator.propagate_until(np.full(lanes, 1e3))
            rows = ends[first : first + lanes]
            rows[:] = last[: len(rows)]
            count += sum(result[3] for result in integrator.propagate_res)
        return ends, count

    return ends_of


def processes() -> Iterator[Line]:
    """Whole processes: each imports, sweeps and ends; the best of three after one that fills the caches."""
    module = __name__
    commands = {
        "gaitsweep taylor": f"import {module} as t; t.walk('taylor', 1e-12, t.starts({PROCESS_ROWS}))",
        "heyoka": f"import {module} as t; t.heyoka_walk(1e-12)(t.starts({PROCESS_ROWS}))",
    }
    for name, command in commands.items():
        if name == "heyoka" and installed("heyoka") is None:
            continue
        spent = []
        for _ in range(4):
            before = resource.getrusage(resource.RUSAGE_CHILDREN)
            subprocess.run([sys.executable, "-c", command], check=True)
            after = resource.getrusage(resource.RUSAGE_CHILDREN)
            spent.append(after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime)
        yield Line(f"{name}, whole process of {PROCESS_ROWS} rows", min(spent[1:]))
