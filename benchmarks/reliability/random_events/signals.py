"""Events of known signals: oscillators of any frequency, narrow bumps, pulses, ramps, guards that jump."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
import numpy as np

import gaitsweep as gs
from gaitsweep import DeclaredModel, event, parameter, variable

from .family import COMPLETE, Case, Family, Solution, System, any_of, solved

TURN = 2.0 * np.pi


class Oscillator(DeclaredModel):
    """A damped harmonic oscillator of any frequency; its section is x rising through 0."""

    section_coordinates = ("x", "v")
    f = parameter("Hz", "frequency", 1.0)
    damping = parameter("1", "rate of decay over the angular frequency", 0.0)
    turns = parameter("1", "nominal period in periods", 1.0)
    x = variable("1", "x", 1.0, scale=1.0)
    v = variable("1", "velocity over the angular frequency", 0.0, scale=1.0)

    def flow(self, p, s):
        w = 2.0 * jnp.pi * p.f
        return {"x": w * (s.v - p.damping * s.x), "v": -w * (s.x + p.damping * s.v)}

    @event("x rises through 0", section=True)
    def rises(self, p, s):
        return s.x

    def period(self, p):
        return p.turns / p.f


def _oscillator(case: Case) -> Solution:
    p = case.values
    size = np.hypot(p["x_0"], p["v_0"])
    # x + i v = size exp(i angle); x' = w v turns it clockwise, and x rises where the angle is pi/2
    angle = np.arctan2(p["v_0"], p["x_0"])
    first = np.mod(angle - 0.5 * np.pi, TURN) / TURN
    if isinstance(case.run, gs.Settle):
        ends = {"x_end": 0.0, "v_end": size, "attractor_period": 1.0}
        return Solution(frozenset({"settled"}), ends, 1.0 / p["f"], {"x_end": TURN})
    turns = first + np.arange(case.run.crossings)
    speeds = size * np.exp(-p["damping"] * TURN * turns)
    columns = {"t": turns / p["f"], "x_n": 0.0 * turns, "v_n": speeds}
    return Solution(COMPLETE, columns, 1.0 / p["f"], {"x_n": TURN}, {"x": 0.0, "v": float(speeds[0])})


def _draw_oscillator(random: np.random.Generator) -> Case:
    angle = float(random.uniform(0.0, TURN))
    size = float(random.uniform(0.1, 10.0))
    settles = bool(random.random() < 0.3)
    values = {
        "f": float(10.0 ** random.uniform(0.0, 12.0)),
        "damping": 0.0 if settles else any_of(random, 0.0, float(random.uniform(0.0, 0.1))),
        "turns": any_of(random, 1.0, 1.0, float(10.0 ** random.uniform(-1.5, 1.5))),
        "x_0": float(size * np.cos(angle)),
        "v_0": float(size * np.sin(angle)),
    }
    return Case(values, gs.Settle(max_cycles=50) if settles else gs.ReturnMap(crossings=6))


class Teeth(DeclaredModel):
    """A wheel that turns once in 2 pi s and counts its teeth as they pass."""

    teeth = parameter("1", "teeth", 100.0)
    phi = variable("rad", "angle", 0.1, observed=False)
    counted = variable("1", "teeth counted", 0.0)

    def flow(self, p, s) -> dict[str, Any]:
        return {"phi": 1.0}

    @event("a tooth passes")
    def tooth(self, p, s):
        return jnp.sin(p.teeth * s.phi)

    @tooth.jump
    def add(self, p, s):
        return s.replace(counted=s.counted + 1.0)

    @event("the wheel has turned", section=True)
    def turn(self, p, s):
        return s.phi - 2.0 * jnp.pi

    @turn.jump
    def back(self, p, s):
        return s.replace(phi=s.phi - 2.0 * jnp.pi)

    def period(self, p):
        return 2.0 * jnp.pi + 0.0 * p.teeth


def _teeth(case: Case) -> Solution:
    p = case.values
    turns = np.arange(1.0, case.run.crossings + 1.0)
    passed = np.floor(p["teeth"] * p["phi_0"] / TURN)
    columns = {"t": TURN * turns - p["phi_0"], "counted_n": p["teeth"] * turns - passed}
    return Solution(COMPLETE, columns, TURN)


def _draw_teeth(random: np.random.Generator) -> Case:
    teeth = float(int(10.0 ** random.uniform(0.5, 2.5)))
    # between two teeth
    phi = TURN / teeth * (int(random.integers(int(teeth))) + float(random.uniform(0.1, 0.9)))
    return Case({"teeth": teeth, "phi_0": float(phi)}, gs.ReturnMap(crossings=2))


class Bump(DeclaredModel):
    """A clock of 1 s, and a guard that is above zero for a short time of each turn."""

    at = parameter("s", "where the bump is", 0.5)
    width = parameter("s", "its width", 0.01)
    clock = variable("s", "clock", 0.0, observed=False)
    seen = variable("s", "clock when the bump was last met", 0.0)
    counted = variable("1", "how often it was met", 0.0)

    def flow(self, p, s) -> dict[str, Any]:
        return {"clock": 1.0}

    @event("the bump")
    def bump(self, p, s):
        return jnp.exp(-(((s.clock - p.at) / p.width) ** 2)) - 0.5

    @bump.jump
    def met(self, p, s):
        return s.replace(seen=s.clock, counted=s.counted + 1.0)

    @event("the clock strikes", section=True)
    def tick(self, p, s):
        return s.clock - 1.0

    @tick.jump
    def again(self, p, s):
        return s.replace(clock=0.0)

    def period(self, p):
        return 1.0 + 0.0 * p.at


def _bump(case: Case) -> Solution:
    p = case.values
    turns = np.arange(1.0, case.run.crossings + 1.0)
    seen = p["at"] - p["width"] * np.sqrt(np.log(2.0)) + 0.0 * turns
    return Solution(COMPLETE, {"t": turns, "seen_n": seen, "counted_n": turns})


def _draw_bump(random: np.random.Generator) -> Case:
    values = {"at": float(random.uniform(0.35, 0.65)), "width": float(10.0 ** random.uniform(-2.2, -0.8))}
    return Case(values, gs.ReturnMap(crossings=3))


class Pulse(DeclaredModel):
    """u' = -u, and a pulse of area 1 of a short `width` in each turn of a clock of 2 s."""

    onset = parameter("s", "when the pulse begins", 1.0)
    width = parameter("s", "width", 0.01)
    clock = variable("s", "clock", 0.0, observed=False)
    u = variable("1", "u", 1.0)

    def flow(self, p, s):
        on = (s.clock > p.onset) & (s.clock < p.onset + p.width)
        return {"clock": 1.0, "u": -s.u + jnp.where(on, 1.0 / p.width, 0.0)}

    @event("2 s are over", section=True)
    def tick(self, p, s):
        return s.clock - 2.0

    @tick.jump
    def again(self, p, s):
        return s.replace(clock=s.clock - 2.0)

    def period(self, p):
        return 2.0 + 0.0 * p.width


def _pulse(case: Case) -> Solution:
    p = case.values
    w = p["width"]
    gained = np.exp(-(2.0 - p["onset"] - w)) * -np.expm1(-w) / w
    u, pulses = p["u_0"], []
    for _ in range(case.run.crossings):
        u = np.exp(-2.0) * u + gained
        pulses.append(u)
    return Solution(COMPLETE, {"t": 2.0 * np.arange(1.0, len(pulses) + 1.0), "u_n": np.array(pulses)}, 2.0)


def _draw_pulse(random: np.random.Generator) -> Case:
    values = {
        "onset": float(random.uniform(0.2, 1.5)),
        "width": float(10.0 ** random.uniform(-3.5, -0.5)),
        "u_0": float(random.uniform(0.0, 2.0)),
    }
    return Case(values, gs.ReturnMap(crossings=5))


class Saw(DeclaredModel):
    """x grows steadily and is set to 0 at a threshold."""

    c = parameter("1", "threshold", 1.0)
    speed = parameter("1/s", "rate of x", 1.0)
    x = variable("1", "x", 0.0, observed=False)
    last = variable("1", "x at the last reset", 0.0)

    def flow(self, p, s):
        return {"x": p.speed}

    @event("reset", section=True)
    def reached(self, p, s):
        return s.x - p.c

    @reached.jump
    def reset(self, p, s):
        return s.replace(last=s.x, x=0.0)

    def period(self, p):
        return 1.0 / p.speed


def _saw(case: Case) -> Solution:
    p, run = case.values, case.run
    lengths = np.abs(np.diff(run.path)) / run.rate
    corners = run.initial_dwell + np.concatenate([[0.0], np.cumsum(lengths)])
    corners, levels = np.concatenate([[0.0], corners]), np.array([run.path[0], *run.path])
    times, last, begun = [], [], 0.0
    x = p["x_0"]
    while True:
        t = _meeting(corners, levels, begun, x, p["speed"])
        if t is None:
            break
        times.append(t)
        last.append(x + p["speed"] * (t - begun))
        begun, x = t, 0.0
    return Solution(COMPLETE, {"t": np.array(times), "last_n": np.array(last)}, 1.0 / p["speed"])


def _meeting(corners: np.ndarray, levels: np.ndarray, begun: float, x: float, speed: float) -> float | None:
    """Time at which x, that grows from `begun` on, meets a threshold that moves in straight pieces."""
    for i in range(len(corners) - 1):
        if corners[i + 1] <= begun or corners[i + 1] == corners[i]:
            continue
        slope = (levels[i + 1] - levels[i]) / (corners[i + 1] - corners[i])
        # x + speed (t - begun) = levels[i] + slope (t - corners[i])
        t = (levels[i] - slope * corners[i] - x + speed * begun) / (speed - slope)
        if max(begun, corners[i]) < t <= corners[i + 1]:
            return float(t)
    return None


RAMPS = (
    gs.Ramp(parameter="c", path=[1.0, 0.2], rate=0.05),
    gs.Ramp(parameter="c", path=[0.5, 1.2, 0.4], rate=0.2, initial_dwell=1.3),
    gs.Ramp(parameter="c", path=[0.3, 2.0], rate=0.3),
)


def _draw_saw(random: np.random.Generator) -> Case:
    values = {"speed": float(random.uniform(0.6, 3.0)), "x_0": float(random.uniform(0.0, 0.25))}
    return Case(values, any_of(random, *RAMPS))


class Line(DeclaredModel):
    """m grows at a steady rate; a clock of 1 s is the section."""

    rate = parameter("1/s", "rate", 1.0)
    turn = parameter("s", "turn of the clock", 1.0)
    clock = variable("s", "clock", 0.0, observed=False)
    m = variable("1", "m", 0.0)

    def flow(self, p, s):
        return {"clock": 1.0, "m": p.rate}

    @event("a turn is over", section=True)
    def tick(self, p, s):
        return s.clock - p.turn

    @tick.jump
    def again(self, p, s):
        return s.replace(clock=s.clock - p.turn)

    def period(self, p):
        return p.turn


def _line(case: Case) -> Solution:
    p, end = case.values, case.run.duration
    columns = {"m_end": p["m_0"] + p["rate"] * end, "t_end": end, "cycles": float(np.floor(end / p["turn"]))}
    return Solution(COMPLETE, columns, p["turn"])


def _draw_line(random: np.random.Generator) -> Case:
    values = {
        "rate": float(random.uniform(-2.0, 2.0)),
        "turn": float(random.uniform(0.3, 9.0)),
        "m_0": float(random.uniform(-1.0, 1.0)),
    }
    return Case(values, gs.FixedTime(duration=5.9))


class Switch(DeclaredModel):
    """A clock of 1 s, and a guard that jumps from below zero to above it, from one slope to another."""

    at = parameter("s", "where the guard jumps", 0.5)
    below = parameter("1", "the guard before", -1.0)
    above = parameter("1", "the guard after", 1.0)
    slope = parameter("1/s", "its slope after", 0.0)
    clock = variable("s", "clock", 0.0, observed=False)
    seen = variable("s", "clock when the guard last rose", 0.0)
    counted = variable("1", "how often it rose", 0.0)

    def flow(self, p, s) -> dict[str, Any]:
        return {"clock": 1.0}

    @event("the guard jumps")
    def rises(self, p, s):
        past = s.clock - p.at
        return jnp.where(past < 0.0, p.below, p.above + p.slope * past)

    @rises.jump
    def met(self, p, s):
        return s.replace(seen=s.clock, counted=s.counted + 1.0)

    @event("the clock strikes", section=True)
    def tick(self, p, s):
        return s.clock - 1.0

    @tick.jump
    def again(self, p, s):
        return s.replace(clock=0.0)

    def period(self, p):
        return 1.0 + 0.0 * p.at


def _switch(case: Case) -> Solution:
    turns = np.arange(1.0, case.run.crossings + 1.0)
    seen = case.values["at"] + 0.0 * turns
    return Solution(COMPLETE, {"t": turns, "seen_n": seen, "counted_n": turns})


def _draw_switch(random: np.random.Generator) -> Case:
    values = {
        "at": float(random.uniform(0.1, 0.9)),
        "below": -float(10.0 ** random.uniform(-2.0, 1.0)),
        "above": float(10.0 ** random.uniform(-2.0, 1.0)),
        "slope": any_of(random, 0.0, float(random.uniform(0.0, 3.0))),
    }
    return Case(values, gs.ReturnMap(crossings=3))


class Wavy(DeclaredModel):
    """x grows steadily and is set to 0 where it meets a threshold that waves fast."""

    speed = parameter("1/s", "rate of x", 1.0)
    size = parameter("1", "amplitude of the threshold", 0.1)
    omega = parameter("rad/s", "frequency of the threshold", 50.0)
    phi = variable("rad", "phase of the threshold", 0.0, observed=False)
    x = variable("1", "x", 0.0, observed=False)
    last = variable("1", "x at the last reset", 0.0)

    def flow(self, p, s):
        return {"phi": p.omega, "x": p.speed}

    @event("x meets the threshold", section=True)
    def meets(self, p, s):
        return s.x - 1.0 - p.size * jnp.sin(s.phi)

    @meets.jump
    def reset(self, p, s):
        return s.replace(last=s.x, x=0.0)

    def period(self, p):
        return 1.0 / p.speed


def _wavy(case: Case) -> Solution:
    p = case.values

    def flow(x: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
        return lambda t: np.stack([x[0] + p["omega"] * t, x[1] + p["speed"] * t, 0.0 * t + x[2]], axis=1)

    system = System(
        ("phi", "x", "last"),
        flow,
        lambda x: (x[:, 1] - 1.0 - p["size"] * np.sin(x[:, 0]))[:, None],
        [lambda x: np.array([x[0], 0.0, x[1]])],
        frozenset({0}),
        look=2.0 / p["speed"],
        samples=20000,
    )
    start = np.array([p["phi_0"], p["x_0"], 0.0])
    return solved(system, start, case.run.crossings, 1.0 / p["speed"], {})


def _grazes(case: Case) -> float:
    """Smallest distance of x from the threshold, at one of its local maxima, before x meets it."""
    p, reference = case.values, _wavy(case).columns
    closest = np.inf
    begun, phi, x = 0.0, p["phi_0"], p["x_0"]
    for t in np.atleast_1d(reference["t"]):
        passed = np.linspace(0.0, t - begun, 20001)
        height = x + p["speed"] * passed - 1.0 - p["size"] * np.sin(phi + p["omega"] * passed)
        top = (height[1:-1] > height[:-2]) & (height[1:-1] > height[2:])
        closest = min(closest, float(np.min(-height[1:-1][top], initial=np.inf)))
        phi, x, begun = phi + p["omega"] * (t - begun), 0.0, t
    return closest


def _draw_wavy(random: np.random.Generator) -> Case:
    while True:
        speed = float(random.uniform(0.5, 2.0))
        values = {
            "speed": speed,
            "size": float(random.uniform(0.02, 0.3)),
            "omega": TURN * speed * float(10.0 ** random.uniform(0.0, 2.0)),
            "phi_0": float(random.uniform(0.0, TURN)),
            "x_0": float(random.uniform(0.0, 0.5)),
        }
        case = Case(values, gs.ReturnMap(crossings=4))
        if _grazes(case) > 1e-3 * values["size"]:
            return case


FAMILIES = (
    Family(
        "oscillators",
        "harmonic oscillators of 1 Hz to 1 THz; nominal periods that are up to 30 times too long or short",
        Oscillator,
        _draw_oscillator,
        _oscillator,
        share=20,
    ),
    Family(
        "teeth of a wheel",
        "guards with 3 to 316 zeros in a cycle",
        Teeth,
        _draw_teeth,
        _teeth,
        share=12,
    ),
    Family(
        "narrow bumps",
        "guards that are above zero for 1e-4 to 0.3 of a cycle",
        Bump,
        _draw_bump,
        _bump,
        share=10,
    ),
    Family(
        "threshold that waves",
        "the first of many crossings of a threshold that waves 1 to 100 times a cycle",
        Wavy,
        _draw_wavy,
        _wavy,
        share=10,
    ),
    Family(
        "pulses in the flow",
        "a flow that is changed for 2e-4 to 0.2 of a cycle, written with jnp.where",
        Pulse,
        _draw_pulse,
        _pulse,
        share=12,
    ),
    Family(
        "threshold that ramps",
        "a sawtooth whose threshold moves in a run of kind ramp",
        Saw,
        _draw_saw,
        _saw,
        share=10,
    ),
    Family(
        "read at a given time",
        "a run of kind fixed_time, read where it ends",
        Line,
        _draw_line,
        _line,
        share=4,
    ),
    Family(
        "guards that jump",
        "guards of two branches that jump over zero",
        Switch,
        _draw_switch,
        _switch,
        share=10,
    ),
)
