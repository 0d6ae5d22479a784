"""Parts shared by the rivals written by hand: Table 1, packed starts, results, and the timing.

A rival by hand is a function (`Runner`) that runs all the starts once and gives what it `Found`.
"""

from __future__ import annotations

import ctypes
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .starts import Array, Parameters, Row, errors, reference_crossings, stacked, states

LEGS, SEGMENTS = 4, 3
# Leg 1 starts pressed in by a picometre, so that rounding does not decide whether it touches.
TOUCH = 1e-12
EVENT_TOLERANCE = 1e-12  # s
# Attempts a crossing after which a trajectory is given up (about 4 200 are made with steps of 4 ms).
PATIENCE = 50_000


class Table(ctypes.Structure):
    """Table 1; of each segment its end and length (rad), the leg's slope (m/rad) and its end's height (m)."""

    _fields_ = (
        *((name, ctypes.c_double) for name in ("kappa", "sigma", "K", "D", "omega", "rate", "g")),
        ("dt", ctypes.c_double),
        ("tolerance", ctypes.c_double),
        ("inverse_mass", ctypes.c_double * LEGS),
        *((name, ctypes.c_double * SEGMENTS) for name in ("ends", "extents", "slopes", "feet")),
    )

    @classmethod
    def of(cls, p: Parameters, dt: float) -> Table:
        ends = p.corners
        springs = (p.kappa, p.spring_damper, p.K, p.ground_damper)
        rest = (p.omega, 1.0 / p.tau, p.g, dt, EVENT_TOLERANCE)
        segments = (ends, np.diff(ends, prepend=0.0), p.slopes, p.slopes * (ends - p.origins))
        return cls(*springs, *rest, tuple(1.0 / p.mass), *(tuple(row) for row in segments))


@dataclass(frozen=True)
class Starts:
    """`z` (rows, 16): x - L, v, q, y of each leg; `modes` (rows, 8): contact and segment of each leg.

    q is the phase from the end of the leg's segment (rad, negative until that ends).
    """

    z: Array
    modes: NDArray[np.int32]

    @classmethod
    def of(cls, p: Parameters, psi: Array) -> Starts:
        begin = states(p, psi)
        z = np.concatenate([stacked(begin, name) for name in ("x", "v", "phi", "y")], axis=1)
        z[:, 0] -= TOUCH
        contact, segment = (stacked(begin, name).astype(np.int32) for name in ("contact", "segment"))
        z[:, 2 * LEGS : 3 * LEGS] -= p.corners[segment]
        return cls(z, np.concatenate([contact, segment], axis=1))


@dataclass(frozen=True)
class Found:
    """`crossings` (rows, crossings, 4): t (s) and psi (rad), NaN where none came; `attempts` (rows,)."""

    crossings: Array
    attempts: NDArray[np.int64]

    @classmethod
    def empty(cls, rows: int, crossings: int) -> Found:
        return cls(np.full((rows, crossings, LEGS), np.nan), np.zeros(rows, np.int64))


Runner = Callable[[Starts, int, float], Found]


def missing(name: str, note: str) -> Row:
    nan = float("nan")
    return {"name": name, "steps_per_second": nan, "cycles_per_second": nan, "error_rad": nan, "note": note}


def timed(name: str, run: Runner, lanes: int, crossings: int, dt: float, note: str, repeats: int = 3) -> Row:
    """The best of `repeats` timings after a warm-up; the error is the 95 % quantile over the starts."""
    true = reference_crossings()
    chosen = np.arange(lanes) % len(true)
    base = Starts.of(Parameters(), true[:, 0])
    starts = Starts(base.z[chosen], base.modes[chosen])
    run(starts, 1, dt)
    seconds, result = np.inf, None
    for _ in range(repeats):
        begun = time.perf_counter()
        result = run(starts, crossings, dt)
        seconds = min(seconds, time.perf_counter() - begun)
    assert result is not None
    error = errors(result.crossings[:, :, 1:], true[chosen, 1 : crossings + 1])
    attempts = int(result.attempts.sum())
    return {
        "name": name,
        "steps_per_second": attempts / seconds,
        "cycles_per_second": lanes * crossings / seconds,
        "error_rad": float(np.quantile(error, 0.95)),
        "note": f"{lanes} starts, dt {dt} s; median error {np.median(error):.1e} rad, "
        f"{attempts / lanes / crossings:.0f} attempts a cycle{note}",
    }
