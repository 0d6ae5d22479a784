"""The multi-legged model by `scipy.integrate.solve_ivp` with terminal events: the reference of record."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from scipy.integrate import solve_ivp

from .multilegged_page import Array, Parameters, Record, State, jump, section, start

Event = tuple[str, int]
Guard = Callable[[float, Array], float]


def right_hand_side(p: Parameters, state: State) -> Callable[[float, Array], Array]:
    """Eq. 1, 4 and 5 with the modes of `state` held: rates of (x, v, phi, y), each (N+1,).

    With modes held the equations are affine in z: they are written out once and then read off at the unit
    vectors, so that the integrator pays for one product of a matrix and a vector.
    """
    n = p.N + 1
    inverse_mass, link, sigma, damper = 1.0 / p.mass, p.neighbours, p.spring_damper, p.ground_damper
    kappa, omega, stiff, minus_g, tau = p.kappa, p.omega, p.K, -p.g, p.tau
    pushing = (state.contact & ~state.slack).astype(float)
    slope, origin = p.slopes[state.segment], p.origins[state.segment]

    def rates(t: float, z: Array) -> Array:
        x, v, phi, y = z[:n], z[n : 2 * n], z[2 * n : 3 * n], z[3 * n :]
        turning = omega + y
        gap = x - slope * (phi - origin)
        closing = v - slope * turning
        force = link.dot(kappa * x + sigma * v) + pushing * (stiff * gap + damper * closing)
        return np.concatenate([v, minus_g - inverse_mass * force, turning, -y / tau])

    constant = rates(0.0, np.zeros(4 * n))
    matrix = np.array([rates(0.0, unit) - constant for unit in np.eye(4 * n)]).T.copy()
    return lambda t, z: matrix.dot(z) + constant


def _switch(n: int, leg: int, slope: float, origin: float, sign: float) -> Guard:
    return lambda t, z: sign * (slope * (z[2 * n + leg] - origin) - z[leg])


def _turn(n: int, leg: int, corner: float) -> Guard:
    return lambda t, z: z[2 * n + leg] - corner


def _force(p: Parameters, leg: int, slope: float, origin: float, sign: float) -> Guard:
    n, stiff, damper, omega = p.N + 1, p.K, p.ground_damper, p.omega

    def force(t: float, z: Array) -> float:
        gap = slope * (z[2 * n + leg] - origin) - z[leg]
        return sign * (stiff * gap + damper * (slope * (omega + z[3 * n + leg]) - z[n + leg]))

    return force


def guards(p: Parameters, state: State) -> tuple[list[Event], list[Guard]]:
    """The events that can come next and their guards, each rising through zero where it fires."""
    n = p.N + 1
    events: list[Event] = []
    functions: list[Guard] = []

    def add(kind: str, leg: int, function: Guard) -> None:
        function.terminal = True  # type: ignore[attr-defined]
        function.direction = 1.0  # type: ignore[attr-defined]
        events.append((kind, leg))
        functions.append(function)

    for leg in range(n):
        segment = int(state.segment[leg])
        slope = float(p.slopes[segment])
        origin = float(p.origins[segment])
        corner = float(p.corners[segment])
        sign = -1.0 if state.contact[leg] else 1.0

        add("lift" if state.contact[leg] else "touch", leg, _switch(n, leg, slope, origin, sign))
        add("corner", leg, _turn(n, leg, corner))
        if p.clamp and state.contact[leg]:
            pull = 1.0 if state.slack[leg] else -1.0
            add("force", leg, _force(p, leg, slope, origin, pull))
    return events, functions


def _at(state: State, t: float, z: Array) -> State:
    x, v, phi, y = z.reshape(4, -1).copy()
    modes = (state.contact.copy(), state.segment.copy(), state.slack.copy())
    return State(t, x, v, phi, y, *modes, state.landed)


def run(
    p: Parameters,
    psi: Sequence[float] | Array,
    crossings: int = 10,
    *,
    times: Sequence[float] = (),
    method: str = "DOP853",
    rtol: float = 1e-11,
    atol: float = 1e-13,
    max_step: float = 0.01,
    phi_1: float | None = None,
) -> Record:
    """Run from section 1 until `crossings` more crossings (and all sample `times`, s) have passed.

    Raises ArithmeticError if the integrator fails or 2000 events a cycle are exceeded.
    """
    state = start(p, psi, phi_1)
    record = Record([section(state, True)])
    wanted = np.asarray(times, dtype=float)
    limit = 25.0 * (crossings + 1) + (float(wanted[-1]) if wanted.size else 0.0)
    while len(record.crossings) <= crossings or (wanted.size and state.t < wanted[-1]):
        events, functions = guards(p, state)
        z = np.concatenate([state.x, state.v, state.phi, state.y])
        # A short first step lets the guard that has just been armed leave its zero.
        solution = solve_ivp(
            right_hand_side(p, state), (0.0, limit - state.t), z, method=method, rtol=rtol, atol=atol,
            max_step=max_step, first_step=1e-5, events=functions, dense_output=bool(wanted.size),
        )  # fmt: skip
        if solution.status != 1:
            raise ArithmeticError(f"solve_ivp ended at t = {state.t + solution.t[-1]} s: {solution.message}")
        record.steps += len(solution.t) - 1
        begin, end = state.t, state.t + float(solution.t[-1])
        for moment in wanted[(wanted >= begin) & (wanted < end)]:
            record.samples.append(_at(state, float(moment), solution.sol(moment - begin)))
        state = _at(state, end, solution.y[:, -1])
        for event, hits in zip(events, solution.t_events, strict=True):
            if len(hits):
                crossing = jump(p, state, *event)
                record.events += 1
                if crossing is not None:
                    record.crossings.append(crossing)
        if record.events > 2000 * (crossings + 1):
            raise ArithmeticError(f"events follow each other without end near t = {end} s")
    return record
