"""The multi-legged model by exact propagation: between events it is linear, a matrix for each contact mode.

The state (x, v, l, w, c, 1), with w = dl/dphi y and c = dl/dphi omega, obeys s' = A s; A depends only on
which legs push. Blocks of samples come from stored exponentials; steps double from 0.25 ms after an event
to 8 ms. A sample interval where a guard rises through zero, or where its tangents do not exclude a hidden
touch, is repeated in 0.25 ms steps, there by the Taylor polynomial of order 18 and `brentq`.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import cast

import numpy as np
from scipy.linalg import expm
from scipy.optimize import brentq

from .multilegged_page import Array, Parameters, Record, State, jump, leg_lengths, section, start

FINEST = 2.5e-4  # s, the shortest interval of samples
LEVELS = 6  # lengths of these intervals, each twice the one before
SAMPLES = 32  # intervals of a block
ORDER = 18  # of the Taylor polynomial over the shortest interval


@lru_cache(maxsize=1024)
def system_matrix(p: Parameters, pushing: tuple[bool, ...]) -> Array:
    """A of s' = A s for the pushing legs, (5 n + 1, 5 n + 1) with n = N + 1."""
    n = p.N + 1
    matrix = np.zeros((5 * n + 1, 5 * n + 1))
    x, v, leg, w, c = (slice(k * n, (k + 1) * n) for k in range(5))
    inverse, push = np.diag(1.0 / p.mass), np.diag(np.array(pushing, dtype=float))
    matrix[x, v] = np.eye(n)
    matrix[v, x] = -inverse @ (p.kappa * p.neighbours + p.K * push)
    matrix[v, v] = -inverse @ (p.spring_damper * p.neighbours + p.ground_damper * push)
    matrix[v, leg] = inverse @ push * p.K
    matrix[v, w] = matrix[v, c] = inverse @ push * p.ground_damper
    matrix[v, -1] = -p.g
    matrix[leg, w] = matrix[leg, c] = np.eye(n)
    matrix[w, w] = -np.eye(n) / p.tau
    return matrix


@lru_cache(maxsize=768)
def propagators(p: Parameters, pushing: tuple[bool, ...], level: int) -> Array:
    """Rows (x, v) of expm(A j h), j = 0..SAMPLES, h = FINEST 2^level: ((SAMPLES + 1) 2 n, 5 n + 1)."""
    n = p.N + 1
    one = expm(system_matrix(p, pushing) * FINEST * 2**level)
    power = np.eye(5 * n + 1)
    rows = [power[: 2 * n]]
    for _ in range(SAMPLES):
        power = one @ power
        rows.append(power[: 2 * n])
    return np.concatenate(rows)


class Flow:
    """The exact solution from a state while its modes stay: samples, guards, Taylor polynomial."""

    def __init__(self, p: Parameters, state: State) -> None:
        self.p, self.state, self.n = p, state, p.N + 1
        slope = p.slopes[state.segment]
        self.pushing = tuple(bool(flag) for flag in state.contact & ~state.slack)
        self.leg = leg_lengths(p, state.phi, state.segment)
        self.w, self.c = slope * state.y, slope * p.omega
        self.s = np.concatenate([state.x, state.v, self.leg, self.w, self.c, [1.0]])
        self.sign = np.where(state.contact, -1.0, 1.0)
        self.pull = np.where(state.slack, 1.0, -1.0)

    def guards(self, x: Array, v: Array, leg: Array, rate: Array) -> Array:
        """The guards, which rise where they fire, along the last axis: contacts, then (clamp) forces."""
        contact = self.sign * (leg - x)
        if not self.p.clamp:
            return contact
        force = self.pull * (self.p.K * (leg - x) + self.p.ground_damper * (rate - v))
        # A leg in the air has no force guard; its scale of 1/K makes it a length like the others.
        return np.concatenate([contact, np.where(self.state.contact, force / self.p.K, -1.0)], axis=-1)

    def block(self, level: int) -> tuple[Array, Array, Array]:
        """States (SAMPLES + 1, 2 n), guards and a bound on their slopes at the samples."""
        n = self.n
        states = (propagators(self.p, self.pushing, level) @ self.s).reshape(SAMPLES + 1, 2 * n)
        time = (np.arange(SAMPLES + 1) * (FINEST * 2**level))[:, None]
        decay = np.exp(-time / self.p.tau)
        leg = self.leg + self.c * time + self.w * (self.p.tau * (1.0 - decay))
        rate = self.c + self.w * decay
        x, v = states[:, :n], states[:, n:]
        guard = self.guards(x, v, leg, rate)
        slope = self.sign * (rate - v)
        if self.p.clamp:
            matrix = system_matrix(self.p, self.pushing)[n : 2 * n]
            ones = np.ones((SAMPLES + 1, 1))
            full = np.concatenate([x, v, leg, self.w * decay, np.broadcast_to(self.c, v.shape), ones], axis=1)
            jolt = -self.w * decay / self.p.tau - full @ matrix.T
            force = self.pull * ((rate - v) + self.p.ground_damper / self.p.K * jolt)
            slope = np.concatenate([slope, np.where(self.state.contact, force, 0.0)], axis=1)
        return states, guard, slope

    def polynomials(self) -> tuple[Array, Array]:
        """Taylor coefficients in units of FINEST: of the state (ORDER + 1, 5 n + 1) and of the guards."""
        matrix = system_matrix(self.p, self.pushing) * FINEST
        terms = [self.s]
        for k in range(1, ORDER + 1):
            terms.append(matrix @ terms[-1] / k)
        series = np.array(terms)
        x, v, leg, w, c = (series[:, k * self.n : (k + 1) * self.n] for k in range(5))
        guard = self.guards(x, v, leg, w + c)
        if self.p.clamp:
            guard[1:, self.n :] = np.where(self.state.contact, guard[1:, self.n :], 0.0)
        return series, guard

    def after(self, seconds: float, mechanics: Array) -> State:
        """The state some seconds later, from its (x, v) there."""
        p, old = self.p, self.state
        x, v = mechanics.reshape(2, -1).copy()
        phi = old.phi + p.omega * seconds - old.y * p.tau * np.expm1(-seconds / p.tau)
        y = old.y * np.exp(-seconds / p.tau)
        return State(old.t + seconds, x, v, phi, y, old.contact, old.segment, old.slack, old.landed)

    def corner(self) -> tuple[float, int]:
        """Seconds until the first leg reaches the end of its segment, and that leg."""
        p, old = self.p, self.state
        best, leg = np.inf, 0
        for i in range(self.n):
            gap = float(p.corners[old.segment[i]] - old.phi[i])
            y = float(old.y[i])

            def past_the_end(seconds: float, gap: float = gap, y: float = y) -> float:
                return p.omega * seconds - y * p.tau * np.expm1(-seconds / p.tau) - gap

            moment = 0.0 if gap <= 0.0 else _zero(past_the_end, gap / p.omega + 1e-12)
            if moment < best:
                best, leg = moment, i
        return best, leg


def _zero(function: Callable[[float], float], end: float) -> float:
    return cast(float, brentq(function, 0.0, end, xtol=1e-15))


def _value(series: list[float], s: float) -> float:
    """The polynomial whose coefficients fall from the highest power (Horner)."""
    value = 0.0
    for coefficient in series:
        value = value * s + coefficient
    return value


def _root(coefficients: Array, end: float, fresh: bool) -> float | None:
    """First s in [0, end] (units of FINEST) where the guard's polynomial rises through zero, or None."""
    series = coefficients[::-1].tolist()
    if fresh:
        series = series[:-1]  # this guard is zero at s = 0 by its own event: divide that root out
    if series[-1] >= 0.0:
        return None if fresh else 0.0
    if _value(series, end) < 0.0:
        slope = [(len(series) - 1 - k) * coefficient for k, coefficient in enumerate(series[:-1])]
        if slope[-1] <= 0.0 or _value(slope, end) >= 0.0:
            return None
        top = _zero(lambda s: _value(slope, s), end)
        if _value(series, top) < 0.0:
            return None
        end = top
    return _zero(lambda s: _value(series, s), end)


def next_event(p: Parameters, state: State, fresh: int | None, until: float) -> tuple[State, str, int]:
    """The state at the next event, its kind and leg; kind "sample" where t = `until` comes first.

    `fresh` is the guard (leg, or n + leg for a force) that is zero now because it has just fired.
    """
    level = 0
    spare, turning = Flow(p, state).corner()
    while True:
        flow = Flow(p, state)
        h = FINEST * 2**level
        ahead = min(spare, until - state.t)
        states, guard, slope = flow.block(level)
        room = np.minimum(guard[:-1] + slope[:-1] * h, guard[1:] - slope[1:] * h)
        hidden = (slope[:-1] > 0.0) & (slope[1:] < 0.0) & (room >= 0.0)
        rising = (guard[1:] >= 0.0) | hidden
        flagged = np.flatnonzero(rising.any(axis=1))
        j = min(int(flagged[0]) if flagged.size else SAMPLES, int(ahead / h))
        if level == 0 and j == 0:
            end = min(FINEST, ahead)
            series, polynomial = flow.polynomials()
            suspects = np.flatnonzero(rising[0] | (guard[0] >= 0.0))
            roots = [(_root(polynomial[:, k], end / FINEST, k == fresh), int(k)) for k in suspects]
            first = min(((root, k) for root, k in roots if root is not None), default=None)
            seconds = end if first is None else first[0] * FINEST
            mechanics = (seconds / FINEST) ** np.arange(ORDER + 1) @ series[:, : 2 * flow.n]
            state = flow.after(seconds, mechanics)
            if first is not None:
                leg = first[1] % flow.n
                kind = "force" if first[1] >= flow.n else "lift" if state.contact[leg] else "touch"
                return state, kind, leg
            if end == ahead:
                return (state, "corner", turning) if ahead == spare else (state, "sample", 0)
            spare -= end
            fresh = None
            continue
        state = flow.after(j * h, states[j])
        spare -= j * h
        if j > 0:
            fresh = None
        level = min(level + 1, LEVELS - 1) if j == SAMPLES else 0


def run(
    p: Parameters,
    psi: Sequence[float] | Array,
    crossings: int = 10,
    *,
    times: Sequence[float] = (),
    phi_1: float | None = None,
) -> Record:
    """Run from section 1 until `crossings` more crossings and all sample `times` (s) have passed.

    Raises:
        ArithmeticError: more than 2000 events a cycle.
    """
    state = start(p, psi, phi_1)
    record = Record([section(state, True)])
    touching = abs(float((leg_lengths(p, state.phi, state.segment) - state.x)[0])) < 1e-13
    fresh = 0 if phi_1 is None and touching else None
    waiting = [float(moment) for moment in times]
    while len(record.crossings) <= crossings or waiting:
        state, kind, leg = next_event(p, state, fresh, waiting[0] if waiting else np.inf)
        if kind == "sample":
            waiting.pop(0)
            record.samples.append(copy.deepcopy(state))
            fresh = None
            continue
        crossing = jump(p, state, kind, leg)
        fresh = {"touch": leg, "lift": leg, "force": p.N + 1 + leg}.get(kind)
        record.events += 1
        if crossing is not None:
            record.crossings.append(crossing)
        if record.events > 2000 * (crossings + 1):
            raise ArithmeticError(f"events follow each other without end near t = {state.t} s")
    return record
