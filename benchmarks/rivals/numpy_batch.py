"""Rival: the multi-legged equations in plain NumPy, all lanes in one array, fixed-step RK4.

Events are taken at the step's end, or (`located`) bisected, each lane then at its own time.
"""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .starts import Array, Parameters, Row, State, errors, reference_crossings, stacked, states

TURN = 2.0 * np.pi


@dataclass
class Batch:
    """z is (lanes, 4, N+1): x - L, v, phi, y; the modes are (lanes, N+1); `landed` is leg 1's, (lanes,)."""

    p: Parameters
    z: Array
    contact: NDArray[np.bool_]
    segment: NDArray[np.int64]
    landed: NDArray[np.bool_]

    @classmethod
    def of(cls, p: Parameters, starts: list[State]) -> Batch:
        z = np.stack([stacked(starts, name) for name in ("x", "v", "phi", "y")], axis=1)
        contact = stacked(starts, "contact") > 0.0
        return cls(p, z, contact, stacked(starts, "segment").astype(int), np.ones(len(starts), bool))

    def lanes(self, chosen: NDArray[np.intp]) -> Batch:
        return Batch(self.p, self.z[chosen], self.contact[chosen], self.segment[chosen], self.landed[chosen])


def flow(batch: Batch, z: Array) -> Array:
    """Eq. 1, 4, 5 at z with the batch's modes."""
    p = batch.p
    x, v, phi, y = z[:, 0], z[:, 1], z[:, 2], z[:, 3]
    slope = p.slopes[batch.segment]
    turning = p.omega + y
    gap = x - slope * (phi - p.origins[batch.segment])
    pull = p.kappa * x + p.spring_damper * v
    force = batch.contact * (p.K * gap + p.ground_damper * (v - slope * turning))
    stretch = np.diff(pull, axis=1)
    force[:, :-1] -= stretch
    force[:, 1:] += stretch
    return np.stack([v, -p.g - force / p.mass, turning, -y / p.tau], axis=1)


def rk4(batch: Batch, h: Array) -> Array:
    """Z one step later; h (s) is (lanes,)."""
    step = h[:, None, None]
    one = flow(batch, batch.z)
    two = flow(batch, batch.z + 0.5 * step * one)
    three = flow(batch, batch.z + 0.5 * step * two)
    four = flow(batch, batch.z + step * three)
    return batch.z + step / 6.0 * (one + 2.0 * (two + three) + four)


def guards(batch: Batch, z: Array) -> Array:
    """(lanes, 2, N+1): contact switches and segment ends, positive once they have happened."""
    p = batch.p
    gap = p.slopes[batch.segment] * (z[:, 2] - p.origins[batch.segment]) - z[:, 0]
    return np.stack([np.where(batch.contact, -gap, gap), z[:, 2] - p.corners[batch.segment]], axis=1)


def bisect(batch: Batch, h: Array, z: Array) -> tuple[Array, Array]:
    """Shortens the steps of lanes in which something happened, to just after the first event."""
    h = h.copy()
    lanes = np.flatnonzero((guards(batch, z) > 0.0).any(axis=(1, 2)))
    if lanes.size == 0:
        return h, z
    some = batch.lanes(lanes)
    low, high = np.zeros(lanes.size), h[lanes]
    while (high - low).max() > 1e-12:
        middle = 0.5 * (low + high)
        happened = (guards(some, rk4(some, middle)) > 0.0).any(axis=(1, 2))
        low, high = np.where(happened, low, middle), np.where(happened, middle, high)
    z = z.copy()
    z[lanes] = rk4(some, high)
    h[lanes] = high
    return h, z


def jump(batch: Batch) -> NDArray[np.bool_]:
    """Applies what has happened by the step's end, in place; the lanes in which a cycle closed."""
    p, z = batch.p, batch.z
    happened = guards(batch, z) > 0.0
    if not happened.any():
        return np.zeros(len(z), bool)
    switch, ended = happened[:, 0], happened[:, 1]
    touched = switch & ~batch.contact
    kicked = touched & (batch.segment == 2) & ~ended
    z[:, 3] += kicked * (TURN - z[:, 2]) / p.tau
    batch.contact ^= switch
    wrapped = ended & (batch.segment == 2)
    z[:, 2] -= TURN * wrapped
    batch.segment = (batch.segment + ended) % 3
    closed = (kicked[:, 0] | wrapped[:, 0]) & ~batch.landed
    batch.landed = (batch.landed | kicked[:, 0]) & ~wrapped[:, 0]
    return closed


def sweep(batch: Batch, crossings: int, dt: float, located: bool) -> tuple[Array, int]:
    """Psi at the first `crossings` crossings of each lane, and the steps (one for all lanes) that it took."""
    lanes = len(batch.z)
    result = np.full((lanes, crossings, batch.p.N), np.nan)
    count = np.zeros(lanes, int)
    full = np.full(lanes, dt)
    steps = 0
    while count.min() < crossings:
        z = rk4(batch, full)
        if located:
            _, z = bisect(batch, full, z)
        batch.z = z
        closed = np.flatnonzero(jump(batch))
        recording = closed[count[closed] < crossings]
        result[recording, count[recording]] = np.diff(batch.z[recording, 2], axis=1) % TURN
        count[closed] += 1
        steps += 1
    return result, steps


def measure(located: bool = False, lanes: int = 1024, crossings: int = 1, dt: float = 2e-3) -> Row:
    """Run `lanes` starts (the reference's, repeated) for `crossings` cycles on one core."""
    p = Parameters()
    true = reference_crossings()
    true = true[np.arange(lanes) % len(true)]
    batch = Batch.of(p, states(p, true[:, 0]))
    begun = time.perf_counter()
    recorded, steps = sweep(batch, crossings, dt, located)
    seconds = time.perf_counter() - begun
    error = errors(recorded, true[:, 1 : crossings + 1])
    return {
        "name": "NumPy batch, RK4, events " + ("bisected" if located else "at the step's end"),
        "steps_per_second": lanes * steps / seconds,
        "cycles_per_second": lanes * crossings / seconds,
        "error_rad": float(np.quantile(error, 0.95)),
        "note": f"{lanes} lanes, dt {dt} s, {crossings} cycles; median error {np.median(error):.1e} rad",
    }


if __name__ == "__main__":
    print(measure(located=False))
    print(measure(located=True))
