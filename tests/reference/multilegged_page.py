"""The multi-legged model (Ambe 2021) as its page states it: parameters, start, modes, jumps.

Shared by the two ways of moving between events: `multilegged_scipy` (of record) and `multilegged_exact`.
Heights and leg lengths are kept as distances from L (m), which saves digits where a leg dips by 1e-4 m.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
TURN = 2.0 * np.pi
STANCE, TAKEOFF, LANDING = 0, 1, 2


@dataclass(frozen=True)
class Parameters:
    """Table 1, in kg, m, s, N/m, N s/m, rad/s; `m_1`, `m_end`, `sigma`, `D` of None take their formulas."""

    N: int = 3
    beta: float = 0.8
    kappa: float = 100.0
    sigma: float | None = None
    m: float = 1.0
    m_B: float = 0.9
    m_1: float | None = None
    m_end: float | None = None
    a: float = 0.4
    L: float = 1.0
    K: float = 1.0e5
    D: float | None = None
    omega: float = 0.4
    tau: float = 0.5
    g: float = 9.8
    clamp: bool = False

    @cached_property
    def mass(self) -> Array:
        mass = np.full(self.N + 1, self.m)
        mass[0] = self.m_B if self.m_1 is None else self.m_1
        mass[-1] = self.m_B if self.m_end is None else self.m_end
        return mass

    @cached_property
    def spring_damper(self) -> float:
        return 2.0 * np.sqrt(self.kappa) if self.sigma is None else self.sigma

    @cached_property
    def ground_damper(self) -> float:
        return 2.0 * np.sqrt(self.K) if self.D is None else self.D

    @cached_property
    def neighbours(self) -> Array:
        """(N+1, N+1) matrix whose product with x gives sum over neighbours j of (x_i - x_j)."""
        n = self.N + 1
        link = np.eye(n, k=1) + np.eye(n, k=-1)
        return np.diag(link.sum(axis=1)) - link

    @cached_property
    def corners(self) -> Array:
        """Phase (rad) at which the stance, takeoff and landing segments end."""
        return np.array([2.0 * self.beta * np.pi, (1.0 + self.beta) * np.pi, TURN])

    @cached_property
    def slopes(self) -> Array:
        """dl/dphi (m/rad) in the stance, takeoff and landing segments (eq. 3)."""
        slope = self.a / ((1.0 - self.beta) * np.pi)
        return np.array([0.0, -slope, slope])

    @cached_property
    def origins(self) -> Array:
        """Phase (rad) at which the line of each segment's leg length passes through L."""
        return np.array([0.0, 2.0 * self.beta * np.pi, TURN])

    @property
    def b(self) -> float:
        return (1.0 - self.beta) * self.g * np.pi / (self.kappa * self.a)


@dataclass
class State:
    """Continuous state (each (N+1,)) and the discrete modes that only `jump` changes."""

    t: float
    x: Array  # height minus L, m
    v: Array  # m/s
    phi: Array  # rad, in [0, 2 pi]
    y: Array  # rad/s
    contact: Mask
    segment: NDArray[np.int64]
    slack: Mask  # contact whose force would pull, with clamp
    landed: bool  # leg 1 had its first landing contact of this cycle


@dataclass
class Crossing:
    """Section 1: time (s), psi (N,) and phi_1 (rad), whether leg 1 landed (else: wrapped without)."""

    t: float
    psi: Array
    phi_1: float
    landed: bool


@dataclass
class Record:
    """Record of a run: crossings (0 is the start), sampled states, the numbers of events and steps."""

    crossings: list[Crossing] = field(default_factory=list)
    samples: list[State] = field(default_factory=list)
    events: int = 0
    steps: int = 0


def section(state: State, landed: bool) -> Crossing:
    return Crossing(state.t, np.mod(np.diff(state.phi), TURN), float(state.phi[0]), landed)


def leg_lengths(p: Parameters, phi: Array, segment: NDArray[np.int64]) -> Array:
    """Leg lengths minus L (m) of eq. 3, by the segments held in the state."""
    return p.slopes[segment] * (phi - p.origins[segment])


def leg_rates(p: Parameters, y: Array, segment: NDArray[np.int64]) -> Array:
    return p.slopes[segment] * (p.omega + y)


def ground_force(p: Parameters, state: State) -> Array:
    """K (l - x) + D (l' - v) of every leg (N), whether in contact or not."""
    gap = leg_lengths(p, state.phi, state.segment) - state.x
    return p.K * gap + p.ground_damper * (leg_rates(p, state.y, state.segment) - state.v)


def obstacle(p: Parameters, lengths: Array) -> tuple[Array, Array]:
    """Rigid obstacle problem: heights x >= l, loads R = m g + kappa neighbours x >= 0, R (x - l) = 0.

    Every set of touching legs is tried; the one whose worst violation is least is the answer.
    """
    n = p.N + 1
    stiffness = p.kappa * p.neighbours
    weight = p.mass * p.g
    best, found = -np.inf, (np.empty(n), np.empty(n))
    for chosen in itertools.product((False, True), repeat=n):
        touching = np.array(chosen)
        if not touching.any():
            continue
        x = lengths.copy()
        free = ~touching
        if free.any():
            pull = stiffness[np.ix_(free, touching)] @ lengths[touching]
            x[free] = np.linalg.solve(stiffness[np.ix_(free, free)], -weight[free] - pull)
        load = np.where(touching, stiffness @ x + weight, 0.0)
        worst = min(float(np.min(x - lengths)), float(np.min(load)) / p.kappa)
        # Ties (a leg just touching) are the same solution up to rounding: the first found stays.
        if worst > best + 1e-13:
            best, found = worst, (x, load)
    if best < -1e-9:
        raise ArithmeticError(f"the obstacle problem has no solution to 1e-9 m (at best {best:.3g} m)")
    return found


def start(p: Parameters, psi: Sequence[float] | Array, phi_1: float | None = None) -> State:
    """The state on section 1 just after leg 1's kick (crossing 0); with `phi_1` given there is no kick."""
    first = TURN - float(p.mass[0]) * p.b if phi_1 is None else phi_1
    phi = np.mod(first + np.concatenate([[0.0], np.cumsum(np.asarray(psi, dtype=float))]), TURN)
    segment = (phi > p.corners[0]).astype(np.int64) + (phi > p.corners[1])
    lengths = leg_lengths(p, phi, segment)
    x, load = obstacle(p, lengths)
    contact = load > 1e-9
    y = np.zeros(p.N + 1)
    if phi_1 is None:
        contact[0] = True
        y[0] = (TURN - phi[0]) / p.tau
    x = np.where(contact, lengths - np.maximum(load, 0.0) / p.K, x)
    state = State(0.0, x, np.zeros(p.N + 1), phi, y, contact, segment, np.zeros(p.N + 1, bool), phi_1 is None)
    if p.clamp:
        state.slack = contact & (ground_force(p, state) < 0.0)
    return state


def jump(p: Parameters, state: State, kind: str, leg: int) -> Crossing | None:
    """Applies one event to `state` in place; gives the crossing where it closes a cycle.

    `kind`: touch, lift, corner (the leg's segment ends), force (the clamped force changes sign).
    """
    crossing = None
    if kind == "touch":
        state.contact[leg] = True
        if state.segment[leg] == LANDING:
            if leg == 0 and not state.landed:
                crossing = section(state, True)
                state.landed = True
            state.y[leg] += (TURN - state.phi[leg]) / p.tau
    elif kind == "lift":
        state.contact[leg] = False
    elif kind == "corner":
        old = int(state.segment[leg])
        state.phi[leg] = p.corners[old]
        if old == LANDING:
            if leg == 0:
                if not state.landed:
                    crossing = section(state, False)
                state.landed = False
            state.phi[leg] = 0.0
        state.segment[leg] = (old + 1) % 3
    if kind == "force":
        state.slack[leg] = not state.slack[leg]
    else:
        state.slack[leg] = p.clamp and state.contact[leg] and ground_force(p, state)[leg] < 0.0
    return crossing
