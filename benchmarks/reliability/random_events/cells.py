"""Events without mechanics: cells that fire each other, clocks that meet, maps as jumps, stick and slip."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import jax.numpy as jnp
import numpy as np

import gaitsweep as gs
from gaitsweep import DeclaredModel, event, mode, parameter, variable
from gaitsweep.dynamics.event_declarations import Event

from .family import COMPLETE, Case, Family, Solution, System, Values, any_of, solved


class Pair(DeclaredModel):
    """Two cells charge to 1; one that fires goes to 0 and lifts the other, which fires with it if over 1."""

    section_coordinates = ("b",)
    drive = parameter("1", "drive", 1.2)
    eps = parameter("1", "pulse", 0.05)
    a = variable("1", "cell a", 0.0)
    b = variable("1", "cell b", 0.0, scale=1.0)

    def flow(self, p, s):
        return {"a": p.drive - s.a, "b": p.drive - s.b}

    @event("a fires", section=True)
    def a_is_full(self, p, s):
        return s.a - 1.0

    @a_is_full.jump
    def a_fires(self, p, s):
        b = s.b + p.eps
        return s.replace(a=0.0, b=jnp.where(b >= 1.0, 0.0, b))

    @event("b fires")
    def b_is_full(self, p, s):
        return s.b - 1.0

    @b_is_full.jump
    def b_fires(self, p, s):
        a = s.a + p.eps
        return s.replace(b=0.0, a=jnp.where(a >= 1.0, 0.0, a))

    def complete(self, p, s):
        return s.replace(a=0.0)

    def period(self, p):
        return jnp.log(p.drive / (p.drive - 1.0))


def _charging(drive: float, moving: np.ndarray) -> Callable[[np.ndarray], Callable[[np.ndarray], np.ndarray]]:
    """The flow x' = drive - x of the variables that move."""

    def flow(x: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
        return lambda t: np.where(moving, drive - (drive - x) * np.exp(-t)[:, None], x)

    return flow


def _pair(case: Case) -> Solution:
    p = case.values

    def fires(mine: int, other: int, x: np.ndarray) -> np.ndarray:
        x = x.copy()
        x[mine] = 0.0
        x[other] += p["eps"]
        if x[other] >= 1.0:
            x[other] = 0.0
        return x

    period = float(np.log(p["drive"] / (p["drive"] - 1.0)))
    system = System(
        ("a", "b"),
        _charging(p["drive"], np.ones(2, bool)),
        lambda x: x - 1.0,
        [partial(fires, 0, 1), partial(fires, 1, 0)],
        frozenset({0}),
        look=1.1 * period,
    )
    return solved(system, np.array([0.0, p["b_0"]]), case.run.crossings, period, {})


def _draw_pair(random: np.random.Generator) -> Case:
    values = {
        "drive": float(random.uniform(1.05, 2.0)),
        "eps": float(random.uniform(0.01, 0.1)),
        "b_0": any_of(random, 0.0, float(random.uniform(0.02, 0.98)), float(random.uniform(0.02, 0.98))),
    }
    return Case(values, gs.ReturnMap(crossings=12))


MOST_CELLS = 30


class Chain(DeclaredModel):
    """Cells in a row: one that is full goes to 0 and lifts its neighbours. One event fires one of them.

    Cells beyond `m` stay at 0. The event fires again at once while another cell is full.
    """

    drive = parameter("1", "drive", 1.2)
    eps = parameter("1", "pulse", 0.05)
    m = parameter("1", "cells that charge", 2.0)
    interval = parameter("s", "turn of the clock", 1.0)
    clock = variable("s", "clock", 0.0, observed=False)
    fired = variable("1", "how often a cell has fired", 0.0)
    x = variable("1", "cell", 0.0, count=MOST_CELLS)

    def flow(self, p, s):
        return {"clock": 1.0, "x": jnp.where(jnp.arange(MOST_CELLS) < p.m, p.drive - s.x, 0.0)}

    @event("a cell fires", during=lambda s: True, rising=False)
    def full(self, p, s):
        return jnp.max(s.x) - 1.0

    @full.jump
    def fires(self, p, s):
        cells = jnp.arange(MOST_CELLS)
        which = jnp.argmax(s.x)
        lifted = s.x + jnp.where((jnp.abs(cells - which) == 1) & (cells < p.m), p.eps, 0.0)
        return s.replace(x=jnp.where(cells == which, 0.0, lifted), fired=s.fired + 1.0)

    @event("the clock strikes", section=True)
    def tick(self, p, s):
        return s.clock - p.interval

    @tick.jump
    def again(self, p, s):
        return s.replace(clock=0.0)

    @property
    def longest_chain(self) -> int:
        return 10 * MOST_CELLS

    def period(self, p):
        return p.interval


def _fire_one(eps: float, m: int, x: np.ndarray) -> np.ndarray:
    x = x.copy()
    which = int(np.argmax(x[2:]))
    x[2 + which] = 0.0
    x[1] += 1.0
    for other in (which - 1, which + 1):
        if 0 <= other < m:
            x[2 + other] += eps
    return x


def _avalanche(eps: float, m: int, x: np.ndarray) -> np.ndarray:
    """All cells that fire at one instant, the fullest first."""
    x = _fire_one(eps, m, x)
    while x[2:].max() >= 1.0:
        x = _fire_one(eps, m, x)
    return x


def _chain(case: Case) -> Solution:
    p, m = case.values, int(case.values["m"])
    moving = np.arange(2 + MOST_CELLS) - 2 < m
    moving[:2] = False
    charged = _charging(p["drive"], moving)

    def flow(x: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
        cells = charged(x)

        def at(t: np.ndarray) -> np.ndarray:
            result = cells(t)
            result[:, 0] = x[0] + t
            return result

        return at

    names = ("clock", "fired", *(f"x_{i + 1}" for i in range(MOST_CELLS)))
    system = System(
        names,
        flow,
        lambda x: np.stack([x[:, 2:].max(axis=1) - 1.0, x[:, 0] - p["interval"]], axis=1),
        [partial(_avalanche, p["eps"], m), lambda x: np.concatenate([[0.0], x[1:]])],
        frozenset({1}),
        look=p["interval"] * 1.1,
        samples=500,
    )
    start = np.array([0.0, 0.0, *(p[f"x_{i + 1}_0"] for i in range(MOST_CELLS))])
    return solved(system, start, case.run.crossings, p["interval"], {})


def _draw_chain(random: np.random.Generator) -> Case:
    m = any_of(random, int(random.integers(2, MOST_CELLS)), MOST_CELLS)
    drive, eps = float(random.uniform(1.1, 1.5)), float(random.uniform(0.05, 0.2))
    first = float(random.uniform(0.2, 0.7))  # s, when the whole row fires
    peak = int(random.integers(m))
    at_peak = 1.0 - eps * random.uniform(0.1, 0.9, MOST_CELLS)
    at_peak[peak] = 1.0
    starts = np.where(np.arange(MOST_CELLS) < m, drive - (drive - at_peak) * np.exp(first), 0.0)
    values: Values = {"drive": drive, "eps": eps, "m": float(m), "interval": 1.0}
    values |= {f"x_{i + 1}_0": float(x) for i, x in enumerate(starts)}
    return Case(values, gs.ReturnMap(crossings=2))


MOST_RELAYS = 12


def _relay(place: int) -> Event:
    """The event that a cell of the relay is full, and its jump."""

    @event(f"cell {place + 1} fires")
    def full(self, p, s):
        return s.x[place] - 1.0

    @full.jump
    def fires(self, p, s):
        x = s.x.at[place].set(0.0)
        if place + 1 < MOST_RELAYS:
            x = x.at[place + 1].add(jnp.where(place + 1 < p.m, p.eps, 0.0))
        return s.replace(x=x, fired=s.fired + 1.0)

    return full


class Relay(DeclaredModel):
    """Cells in a row, an event each: one that is full goes to 0 and lifts the next."""

    drive = parameter("1", "drive", 1.2)
    eps = parameter("1", "pulse", 0.05)
    m = parameter("1", "cells that charge", 2.0)
    clock = variable("s", "clock", 0.0, observed=False)
    fired = variable("1", "how often a cell has fired", 0.0)
    x = variable("1", "cell", 0.0, count=MOST_RELAYS)

    cell_1, cell_2, cell_3, cell_4 = _relay(0), _relay(1), _relay(2), _relay(3)
    cell_5, cell_6, cell_7, cell_8 = _relay(4), _relay(5), _relay(6), _relay(7)
    cell_9, cell_10, cell_11, cell_12 = _relay(8), _relay(9), _relay(10), _relay(11)

    def flow(self, p, s):
        return {"clock": 1.0, "x": jnp.where(jnp.arange(MOST_RELAYS) < p.m, p.drive - s.x, 0.0)}

    @event("the clock strikes", section=True)
    def tick(self, p, s):
        return s.clock - 1.0

    @tick.jump
    def again(self, p, s):
        return s.replace(clock=0.0)

    def period(self, p):
        return 1.0 + 0.0 * p.m


def _relays(case: Case) -> Solution:
    p, m = case.values, int(case.values["m"])
    moving = np.arange(2 + MOST_RELAYS) - 2 < m
    moving[:2] = False
    charged = _charging(p["drive"], moving)

    def flow(x: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
        cells = charged(x)

        def at(t: np.ndarray) -> np.ndarray:
            result = cells(t)
            result[:, 0] = x[0] + t
            return result

        return at

    def fires(place: int, x: np.ndarray) -> np.ndarray:
        x = x.copy()
        x[1] += 1.0
        x[2 + place] = 0.0
        if place + 1 < m:
            x[3 + place] += p["eps"]
        return x

    names = ("clock", "fired", *(f"x_{i + 1}" for i in range(MOST_RELAYS)))
    jumps = [*(partial(fires, place) for place in range(MOST_RELAYS)), lambda x: np.array([0.0, *x[1:]])]
    system = System(
        names,
        flow,
        lambda x: np.concatenate([x[:, 2:] - 1.0, x[:, :1] - 1.0], axis=1),
        jumps,
        frozenset({MOST_RELAYS}),
        look=1.1,
        samples=300,
    )
    start = np.array([0.0, 0.0, *(p[f"x_{i + 1}_0"] for i in range(MOST_RELAYS))])
    return solved(system, start, case.run.crossings, 1.0, {})


def _draw_relay(random: np.random.Generator) -> Case:
    m = int(random.integers(2, MOST_RELAYS + 1))
    drive, eps = float(random.uniform(1.1, 1.5)), float(random.uniform(0.05, 0.2))
    first = float(random.uniform(0.2, 0.7))
    at_peak = 1.0 - eps * random.uniform(0.1, 0.9, MOST_RELAYS)
    at_peak[0] = 1.0
    starts = np.where(np.arange(MOST_RELAYS) < m, drive - (drive - at_peak) * np.exp(first), 0.0)
    values: Values = {"drive": drive, "eps": eps, "m": float(m)}
    values |= {f"x_{i + 1}_0": float(x) for i, x in enumerate(starts)}
    # after the first avalanche the cells are in step, and fire in their order at one instant
    return Case(values, gs.ReturnMap(crossings=4))


CLOCKS = 6


def _clock(place: int) -> Event:
    """The event that a clock strikes, and its jump."""

    @event(f"clock {place + 1} strikes", section=place == 0)
    def strikes(self, p, s):
        return s.c[place] - p.turn[place]

    @strikes.jump
    def again(self, p, s):
        kept = jnp.where(p.subtracts > 0.5, s.c[place] - p.turn[place], 0.0)
        return s.replace(c=s.c.at[place].set(kept), x=p.factor[place] * s.x + p.added[place])

    return strikes


class Clocks(DeclaredModel):
    """Clocks whose turns are multiples of one interval; each changes x, and their order matters."""

    turn = parameter("s", "turn of clock", 1.0, count=CLOCKS)
    factor = parameter("1", "factor on x of clock", 0.5, count=CLOCKS)
    added = parameter("1", "what is added to x by clock", 1.0, count=CLOCKS)
    m = parameter("1", "clocks that go", 2.0)
    subtracts = parameter("1", "1: a clock is put back by its turn, 0: to zero", 0.0)
    c = variable("s", "clock", 0.0, count=CLOCKS, observed=False)
    x = variable("1", "x", 1.0, scale=1.0)

    one, two, three = _clock(0), _clock(1), _clock(2)
    four, five, six = _clock(3), _clock(4), _clock(5)

    def flow(self, p, s):
        return {"c": jnp.where(jnp.arange(CLOCKS) < p.m, 1.0, 0.0)}

    def period(self, p):
        return p.turn[0]


def _clocks(case: Case) -> Solution:
    p, m = case.values, int(case.values["m"])
    interval = p["turn_1"] / np.round(p["turn_1"] / _unit(p))
    turns = [round(p[f"turn_{i + 1}"] / interval) for i in range(m)]
    gone = [round(p[f"c_{i + 1}_0"] / interval) for i in range(m)]
    x, times, values = p["x_0"], [], []
    ticks = 0
    while len(times) < case.run.crossings:
        ticks += 1
        for i in range(m):
            if (ticks + gone[i]) % turns[i] == 0:
                x = p[f"factor_{i + 1}"] * x + p[f"added_{i + 1}"]
        if (ticks + gone[0]) % turns[0] == 0:
            times.append(ticks * interval)
            values.append(x)
    return Solution(COMPLETE, {"t": np.array(times), "x_n": np.array(values)}, p["turn_1"], {})


def _unit(p: Values) -> float:
    """The interval whose multiples the turns are; the last clock, if idle, has a turn of one interval."""
    return p[f"turn_{CLOCKS}"] if p["m"] < CLOCKS else p["turn_6"] / 5.0


def _draw_clocks(random: np.random.Generator) -> Case:
    m = int(random.integers(2, CLOCKS + 1))
    unit = any_of(random, 0.1, 1.0, 1.0 / 3.0, float(10.0 ** random.uniform(-3.0, 2.0)))
    values: Values = {
        "m": float(m),
        "subtracts": float(random.integers(2)),
        "x_0": float(random.uniform(-1, 1)),
    }
    for i in range(CLOCKS):
        turn = int(random.integers(1, 7))
        if i == CLOCKS - 1:
            turn = 5 if m == CLOCKS else 1
        # clocks of one model begin together, or some intervals apart
        gone = any_of(random, 0, int(random.integers(turn)))
        values |= {
            f"turn_{i + 1}": turn * unit,
            f"factor_{i + 1}": float(random.uniform(-0.9, 0.9)),
            f"added_{i + 1}": float(random.uniform(-1.0, 1.0)),
            f"c_{i + 1}_0": gone * unit,
        }
    return Case(values, gs.ReturnMap(crossings=12))


class Henon(DeclaredModel):
    """Henon's map as the jump of a clock; x and y do not move between the jumps."""

    section_coordinates = ("x", "y")
    a = parameter("1", "a", 1.4)
    b = parameter("1", "b", 0.3)
    turn = parameter("s", "turn of the clock", 1.0)
    clock = variable("s", "clock", 0.0, observed=False)
    x = variable("1", "x", 0.0)
    y = variable("1", "y", 0.0)

    def flow(self, p, s) -> dict[str, Any]:
        return {"clock": 1.0}

    @event("the next point", section=True)
    def tick(self, p, s):
        return s.clock - p.turn

    @tick.jump
    def image(self, p, s):
        return s.replace(clock=0.0, x=1.0 - p.a * s.x**2 + s.y, y=p.b * s.x)

    def complete(self, p, s):
        return s.replace(clock=0.0)

    def period(self, p):
        return p.turn


def _henon(case: Case) -> Solution:
    p = case.values
    x, y = p["x_0"], p["y_0"]
    results = []
    with np.errstate(over="ignore", invalid="ignore"):
        for _ in range(case.run.crossings):
            x, y = np.float64(1.0) - p["a"] * np.float64(x) ** 2 + y, p["b"] * x
            results.append((x, y))
    if not np.isfinite(results).all():
        return Solution(frozenset({"diverged"}), after={"x": results[0][0], "y": results[0][1]})
    columns: dict[str, np.ndarray] = dict(zip(("x_n", "y_n"), np.array(results).T, strict=True))
    columns["t"] = p["turn"] * np.arange(1.0, case.run.crossings + 1.0)
    return Solution(COMPLETE, columns, p["turn"], {}, {"x": results[0][0], "y": results[0][1]})


def _draw_henon(random: np.random.Generator) -> Case:
    values = {
        "a": float(random.uniform(0.4, 1.4)),
        "b": float(random.uniform(0.1, 0.3)),
        "turn": float(10.0 ** random.uniform(-3.0, 3.0)),
        "x_0": float(random.uniform(-2.5, 2.5)),
        "y_0": float(random.uniform(-2.5, 2.5)),
    }
    return Case(values, gs.ReturnMap(crossings=30))


class StickSlip(DeclaredModel):
    """A block on a belt, held by a spring: it sticks until the spring is stronger than static friction."""

    section_coordinates = ("x", "v")
    omega = parameter("rad/s", "rate of the spring", 1.0)
    belt = parameter("m/s", "speed of the belt", 0.5)
    static = parameter("m/s2", "static friction", 1.0)
    kinetic = parameter("m/s2", "kinetic friction", 0.6)
    sticks = mode(False, "whether the block moves with the belt")
    x = variable("m", "place", 0.0)
    v = variable("m/s", "speed", 0.0)

    def flow(self, p, s):
        slides = p.kinetic - p.omega**2 * s.x
        return {"x": s.v, "v": jnp.where(s.sticks, 0.0, slides)}

    @event("breaks loose", during=lambda s: s.sticks)
    def breaks(self, p, s):
        return p.omega**2 * s.x - p.static

    @breaks.jump
    def loose(self, p, s):
        return s.replace(sticks=False)

    @event("sticks", section=True, during=lambda s: ~s.sticks)
    def reaches(self, p, s):
        return s.v - p.belt

    @reaches.jump
    def held(self, p, s):
        return s.replace(sticks=True, v=p.belt)

    def period(self, p):
        return 2.0 * jnp.pi / p.omega + (p.static - p.kinetic) / (p.omega**2 * p.belt)


def _stick_slip(case: Case) -> Solution:
    p = case.values
    w, belt = p["omega"], p["belt"]
    middle, edge = p["kinetic"] / w**2, p["static"] / w**2

    def flow(x: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
        def at(t: np.ndarray) -> np.ndarray:
            if x[2] > 0.5:
                return np.stack([x[0] + belt * t, np.full_like(t, belt), np.ones_like(t)], axis=1)
            away = x[0] - middle
            places = middle + away * np.cos(w * t) + x[1] / w * np.sin(w * t)
            speeds = x[1] * np.cos(w * t) - away * w * np.sin(w * t)
            return np.stack([places, speeds, np.zeros_like(t)], axis=1)

        return at

    def guards(x: np.ndarray) -> np.ndarray:
        sticks = x[:, 2] > 0.5
        return np.stack(
            [np.where(sticks, w**2 * x[:, 0] - p["static"], -1.0), np.where(sticks, -1.0, x[:, 1] - belt)],
            axis=1,
        )

    jumps = [lambda x: np.array([edge, belt, 0.0]), lambda x: np.array([x[0], belt, 1.0])]
    system = System(("x", "v", "sticks"), flow, guards, jumps, frozenset({1}), look=4.0 / w, samples=400)
    period = 2.0 * np.pi / w + (p["static"] - p["kinetic"]) / (w**2 * belt)
    scales = {"x": edge, "v": belt}
    return solved(system, np.array([p["x_0"], p["v_0"], 0.0]), case.run.crossings, float(period), scales)


def _draw_stick_slip(random: np.random.Generator) -> Case:
    w = float(10.0 ** random.uniform(-1.0, 3.0))
    belt = float(10.0 ** random.uniform(-2.0, 1.0))
    # amplitude of the slip over that of the belt's speed; friction in units of omega times that speed
    ratio = float(random.uniform(0.2, 3.0))
    kinetic = float(random.uniform(0.1, 5.0)) * w * belt
    static = kinetic + ratio * w * belt
    amplitude = np.sqrt(1.0 + ratio**2) * belt / w * float(random.uniform(0.95, 1.0))
    angle = float(random.uniform(0.25, 0.75)) * 2.0 * np.pi  # slower than the belt
    values = {
        "omega": w,
        "belt": belt,
        "static": static,
        "kinetic": kinetic,
        "x_0": kinetic / w**2 + amplitude * np.sin(angle),
        "v_0": amplitude * w * np.cos(angle),
    }
    return Case(values, gs.ReturnMap(crossings=4))


FAMILIES = (
    Family(
        "pair of cells",
        "two pulse-coupled cells with absorption, in step and not",
        Pair,
        _draw_pair,
        _pair,
        share=14,
    ),
    Family(
        "row of cells, one event",
        "2 to 30 cells that fire each other at one instant through a single event",
        Chain,
        _draw_chain,
        _chain,
        share=12,
    ),
    Family(
        "row of cells, an event each",
        "2 to 12 cells that fire each other at one instant, an event each",
        Relay,
        _draw_relay,
        _relays,
        share=10,
    ),
    Family(
        "clocks that meet",
        "two to six clocks that strike together, with jumps whose order matters",
        Clocks,
        _draw_clocks,
        _clocks,
        share=14,
    ),
    Family(
        "maps as jumps",
        "Henon's map as the jump of a clock, with orbits that diverge",
        Henon,
        _draw_henon,
        _henon,
        share=10,
        jacobian=True,
    ),
    Family(
        "stick and slip",
        "a block on a belt; each phase begins on the surface that ends it",
        StickSlip,
        _draw_stick_slip,
        _stick_slip,
        share=16,
        jacobian=True,
    ),
)
