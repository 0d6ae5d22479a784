"""Bodies that bounce: over floors at any height, fixed or moving, in boxes, several at one instant."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import jax.numpy as jnp
import numpy as np

import gaitsweep as gs
from gaitsweep import DeclaredModel, event, parameter, variable
from gaitsweep.dynamics.event_declarations import Event

from .family import COMPLETE, TOLERANCE, Case, Family, Solution, System, Values, any_of, solved

FLOORS = (0.0, 1.0, 100.0, -3.0)  # m


class Ball(DeclaredModel):
    """A ball over a floor that stands or moves at a constant speed.

    Its jump may put it onto the floor or leave its height, and turn its speed or take the size of it.
    """

    g = parameter("m/s2", "gravitational acceleration", 9.81)
    rest = parameter("1", "share of the speed that a landing leaves", 0.5)
    lift = parameter("m/s", "speed of the floor upwards", 0.0)
    snaps = parameter("1", "1: the jump puts the ball onto the floor", 0.0)
    by_size = parameter("1", "1: the jump takes the size of the speed", 0.0)
    h = variable("m", "height", 1.0)
    v = variable("m/s", "speed upwards", 0.0)
    y = variable("m", "height of the floor", 0.0)

    def flow(self, p, s):
        return {"h": s.v, "v": -p.g, "y": p.lift}

    @event("lands", section=True)
    def lands(self, p, s):
        return s.y - s.h

    @lands.jump
    def bounce(self, p, s):
        speed = s.v - p.lift
        away = p.rest * jnp.where(p.by_size > 0.5, jnp.abs(speed), -speed)
        return s.replace(h=jnp.where(p.snaps > 0.5, s.y, s.h), v=p.lift + away)

    def period(self, p):
        return 1.0 + 0.0 * p.g


def _ball(random: np.random.Generator, least: float, most: float) -> Values:
    floor = any_of(random, *FLOORS, float(random.uniform(-50.0, 50.0)))
    return {
        "g": float(random.uniform(1.6, 20.0)),
        "rest": float(random.uniform(least, most)),
        "lift": any_of(random, 0.0, 0.0, float(random.uniform(-1.0, 1.0))),
        "snaps": float(random.integers(2)),
        "by_size": float(random.integers(2)),
        "h_0": floor + float(random.uniform(0.05, 3.0)),
        "v_0": any_of(random, 0.0, float(random.uniform(-2.0, 2.0))),
        "y_0": floor,
    }


def _bounces(case: Case) -> Solution:
    p = case.values
    n = case.run.crossings
    rows = []
    t, above, speed = 0.0, p["h_0"] - p["y_0"], p["v_0"] - p["lift"]
    for _ in range(n):
        root = np.sqrt(speed**2 + 2.0 * p["g"] * above)
        t += (speed + root) / p["g"]
        speed, above = p["rest"] * root, 0.0
        y = p["y_0"] + p["lift"] * t
        rows.append((t, y, speed + p["lift"], y))
    columns: dict[str, np.ndarray] = dict(zip(("t", "h_n", "v_n", "y_n"), np.array(rows).T, strict=True))
    first: dict[str, float] = dict(zip(("h", "v", "y"), rows[0][1:], strict=True))
    return Solution(COMPLETE, columns, 1.0, {}, first)


def _draw_bounce(random: np.random.Generator) -> Case:
    return Case(_ball(random, 0.4, 1.0), gs.ReturnMap(crossings=5))


def _draw_on_floor(random: np.random.Generator) -> Case:
    values = _ball(random, 0.4, 1.0)
    speed = values["lift"] - float(random.uniform(0.2, 3.0))
    return Case({**values, "h_0": values["y_0"], "v_0": speed}, gs.ReturnMap(crossings=4))


def _draw_below(random: np.random.Generator) -> Case:
    values = _ball(random, 0.4, 1.0)
    depth = float(10.0 ** random.uniform(-9.0, 0.0))
    below = {"h_0": values["y_0"] - depth, "v_0": values["lift"] - any_of(random, 0.0, 1.0), "lift": 0.0}
    return Case({**values, **below}, gs.FixedTime(duration=2.0))


def _unmarked(case: Case) -> Solution:
    return Solution(frozenset())


def _accumulation(values: Values) -> float:
    """The time (s) at which the bounces accumulate."""
    above, speed = values["h_0"] - values["y_0"], values["v_0"] - values["lift"]
    root = np.sqrt(speed**2 + 2.0 * values["g"] * above)
    rest = values["rest"]
    return float((speed + root + 2.0 * root * rest / (1.0 - rest)) / values["g"])


def _draw_accumulating(random: np.random.Generator) -> Case:
    values = _ball(random, 0.05, 0.95)
    beyond = gs.FixedTime(duration=150.0)
    return Case(values, any_of(random, gs.Settle(max_cycles=3000), gs.Settle(max_cycles=3000), beyond))


def _accumulates(case: Case) -> Solution:
    p = case.values
    end = _accumulation(p)
    # a bounce is no longer seen where its height is a rounding error of those of ball and floor
    rounding = np.spacing(max(abs(p["h_0"]), abs(p["y_0"] + p["lift"] * end)))
    unseen = 16.0 * np.sqrt(8.0 * rounding / p["g"]) / (1.0 - p["rest"])  # s, with all bounces after it
    return Solution(frozenset({"event_stall"}), {"t_end": end}, max(end, unseen / TOLERANCE))


class Shaken(DeclaredModel):
    """A ball over a floor that moves up and down as a sine."""

    g = parameter("m/s2", "gravitational acceleration", 9.81)
    rest = parameter("1", "restitution", 0.5)
    size = parameter("m", "amplitude of the floor", 0.01)
    omega = parameter("rad/s", "frequency of the floor", 10.0)
    base = parameter("m", "height about which the floor moves", 0.0)
    h = variable("m", "height", 1.0)
    v = variable("m/s", "speed upwards", 0.0)
    phi = variable("rad", "phase of the floor", 0.0)

    def flow(self, p, s):
        return {"h": s.v, "v": -p.g, "phi": p.omega}

    @event("lands", section=True)
    def lands(self, p, s):
        return p.base + p.size * jnp.sin(s.phi) - s.h

    @lands.jump
    def bounce(self, p, s):
        floor = p.size * p.omega * jnp.cos(s.phi)
        return s.replace(v=floor + p.rest * (floor - s.v))

    def period(self, p):
        return 1.0 + 0.0 * p.g


def _shaken(case: Case) -> Solution:
    p = case.values

    def flow(x: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
        def at(t: np.ndarray) -> np.ndarray:
            h = x[0] + x[1] * t - 0.5 * p["g"] * t**2
            return np.stack([h, x[1] - p["g"] * t, x[2] + p["omega"] * t], axis=1)

        return at

    def bounce(x: np.ndarray) -> np.ndarray:
        floor = p["size"] * p["omega"] * np.cos(x[2])
        return np.array([p["base"] + p["size"] * np.sin(x[2]), floor + p["rest"] * (floor - x[1]), x[2]])

    system = System(
        ("h", "v", "phi"),
        flow,
        lambda x: (p["base"] + p["size"] * np.sin(x[:, 2]) - x[:, 0])[:, None],
        [bounce],
        frozenset({0}),
        look=1.0,
        samples=400,
    )
    start = np.array([p["h_0"], p["v_0"], p["phi_0"]])
    return solved(system, start, case.run.crossings, 1.0, {})


def _draw_shaken(random: np.random.Generator) -> Case:
    while True:
        omega = float(random.uniform(3.0, 20.0))
        floor = any_of(random, *FLOORS)
        values = {
            "g": 9.81,
            "rest": float(random.uniform(0.3, 0.9)),
            "size": float(random.uniform(0.1, 1.0)) / omega,
            "omega": omega,
            "base": floor,
            "h_0": floor + float(random.uniform(0.6, 2.0)),
            "v_0": float(random.uniform(-1.0, 1.0)),
            "phi_0": float(random.uniform(0.0, 2.0 * np.pi)),
        }
        case = Case(values, gs.ReturnMap(crossings=3))
        reference = _shaken(case).columns
        # landings so gentle that the next may be missed by the look of either side are another family's
        floor_speed = values["size"] * omega * np.cos(reference["phi_n"])
        if np.all(reference["v_n"] - floor_speed > 0.3):
            return case


def _wall(axis: int, side: int) -> Event:
    """The event that a wall of the box is hit, and its jump."""

    @event(f"hits wall {'+' if side > 0 else '-'}{axis + 1}")
    def hits(self, p, s):
        return side * (s.x[axis] - (p.high if side > 0 else p.low)[axis])

    @hits.jump
    def returns(self, p, s):
        return s.replace(v=s.v.at[axis].multiply(-p.rest))

    return hits


class Box(DeclaredModel):
    """A ball in a box of three dimensions, without gravity; in corners it hits two or three walls at once."""

    section_coordinates = ("x", "v")
    rest = parameter("1", "restitution", 0.9)
    low = parameter("m", "lower walls", 0.0, count=3)
    high = parameter("m", "upper walls", 1.0, count=3)
    clock = variable("s", "clock", 0.0, observed=False)
    x = variable("m", "place", 0.5, count=3)
    v = variable("m/s", "speed", 1.0, count=3)

    left, right = _wall(0, -1), _wall(0, 1)
    front, back = _wall(1, -1), _wall(1, 1)
    bottom, top = _wall(2, -1), _wall(2, 1)

    def flow(self, p, s):
        return {"clock": 1.0, "x": s.v}

    @event("a second is over", section=True)
    def tick(self, p, s):
        return s.clock - 1.0

    @tick.jump
    def again(self, p, s):
        return s.replace(clock=0.0)

    def complete(self, p, s):
        return s.replace(clock=0.0)

    def period(self, p):
        return 1.0 + 0.0 * p.rest


def _reflected(low: float, high: float, rest: float, x: float, v: float, times: np.ndarray) -> np.ndarray:
    """Place and speed (2, n) after these times of a ball between two walls."""
    impacts, t = [], 0.0
    for until in times:
        while True:
            wall = high if v > 0 else low
            reach = (wall - x) / v
            if t + reach > until:
                break
            t, x, v = t + reach, wall, -rest * v
        impacts.append((x + v * (until - t), v))
    return np.array(impacts).T


def _box(case: Case) -> Solution:
    p = case.values
    times = np.arange(1.0, case.run.crossings + 1.0)
    columns: dict[str, np.ndarray] = {"t": times}
    after: dict[str, float] = {}
    for i in (1, 2, 3):
        x, v = _reflected(p[f"low_{i}"], p[f"high_{i}"], p["rest"], p[f"x_{i}_0"], p[f"v_{i}_0"], times)
        columns |= {f"x_{i}_n": x, f"v_{i}_n": v}
        after |= {f"x_{i}": float(x[0]), f"v_{i}": float(v[0])}
    return Solution(COMPLETE, columns, 1.0, {}, after)


def _draw_box(random: np.random.Generator) -> Case:
    together = int(random.integers(1, 4))
    corner = float(random.uniform(0.2, 0.6))  # s, when so many walls are hit at once
    while True:
        values: Values = {"rest": float(random.uniform(0.5, 1.0))}
        for i in (1, 2, 3):
            low = any_of(random, *FLOORS)
            high = low + float(random.uniform(0.5, 2.0))
            v = float(random.uniform(0.5, 2.0)) * any_of(random, -1.0, 1.0)
            wall = high if v > 0 else low
            reach = corner if i <= together else float(random.uniform(0.1, 0.9))
            values |= {f"low_{i}": low, f"high_{i}": high, f"x_{i}_0": wall - v * reach, f"v_{i}_0": v}
        inside = all(values[f"low_{i}"] < values[f"x_{i}_0"] < values[f"high_{i}"] for i in (1, 2, 3))
        case = Case(values, gs.ReturnMap(crossings=3))
        reference = _box(case).columns
        # not at a wall when the clock strikes
        apart = min(
            np.abs(reference[f"x_{i}_n"] - values[f"{wall}_{i}"]).min()
            for i in (1, 2, 3)
            for wall in ("low", "high")
        )
        if inside and apart > 1e-2:
            return case


MOST_BALLS = 6


def _landing(place: int) -> Event:
    """The event that a ball lands, and its jump."""

    @event(f"ball {place + 1} lands")
    def lands(self, p, s):
        return p.base - s.h[place]

    @lands.jump
    def kicked(self, p, s):
        speed = p.rest * jnp.abs(s.v[place]) + p.kick * (1.0 + jnp.cos(s.phi)) / 2.0
        return s.replace(v=s.v.at[place].set(speed))

    return lands


class Balls(DeclaredModel):
    """Balls that a clock kicks at their landings; springs push them apart. Balls beyond `m` stand still."""

    section_coordinates = ("h", "v")
    g = parameter("m/s2", "gravitational acceleration", 9.81)
    rest = parameter("1", "restitution", 0.5)
    kick = parameter("m/s", "kick", 3.0)
    omega = parameter("rad/s", "frequency of the clock", 12.0)
    k = parameter("1/s2", "repulsion", 0.0)
    base = parameter("m", "height of the floor", 0.0)
    m = parameter("1", "balls that fall", 2.0)
    phi = variable("rad", "clock", 0.0, observed=False)
    h = variable("m", "height of ball", 1.0, count=MOST_BALLS)
    v = variable("m/s", "speed of ball", 0.0, count=MOST_BALLS)

    first, second, third = _landing(0), _landing(1), _landing(2)
    fourth, fifth, sixth = _landing(3), _landing(4), _landing(5)

    def flow(self, p, s):
        falls = jnp.arange(MOST_BALLS) < p.m
        mean = jnp.sum(jnp.where(falls, s.h, 0.0)) / p.m
        push = p.k * p.m * (s.h - mean) - p.g
        return {"phi": p.omega, "h": s.v, "v": jnp.where(falls, push, 0.0)}

    @event("the clock begins a turn", section=True)
    def turn(self, p, s):
        return s.phi - 2.0 * jnp.pi

    @turn.jump
    def wrap(self, p, s):
        return s.replace(phi=s.phi - 2.0 * jnp.pi)

    def complete(self, p, s):
        return s.replace(phi=0.0)

    def period(self, p):
        return 2.0 * jnp.pi / p.omega


def _balls(case: Case) -> Solution:
    p, m = case.values, int(case.values["m"])
    rate = np.sqrt(p["k"] * m)
    count = MOST_BALLS

    def flow(x: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
        h, v = x[1 : 1 + m], x[1 + count : 1 + count + m]
        mean_h, mean_v = h.mean(), v.mean()
        dh, dv = h - mean_h, v - mean_v

        def at(t: np.ndarray) -> np.ndarray:
            result = np.repeat(x[None], len(t), axis=0)
            result[:, 0] += p["omega"] * t
            s = t[:, None]
            result[:, 1 : 1 + count] += x[1 + count :] * s  # those that stand still, if they were moved
            grown = np.sinh(rate * s) / rate if rate > 0 else s
            result[:, 1 : 1 + m] = (
                mean_h + mean_v * s - 0.5 * p["g"] * s**2 + dh * np.cosh(rate * s) + dv * grown
            )
            result[:, 1 + count : 1 + count + m] = (
                mean_v - p["g"] * s + rate**2 * dh * grown + dv * np.cosh(rate * s)
            )
            return result

        return at

    def guards(x: np.ndarray) -> np.ndarray:
        return np.concatenate([p["base"] - x[:, 1 : 1 + count], x[:, :1] - 2.0 * np.pi], axis=1)

    def lands(place: int, x: np.ndarray) -> np.ndarray:
        x = x.copy()
        speed = p["rest"] * abs(x[1 + count + place]) + p["kick"] * (1.0 + np.cos(x[0])) / 2.0
        x[1 + place], x[1 + count + place] = p["base"], speed
        return x

    def wrap(x: np.ndarray) -> np.ndarray:
        return np.concatenate([[0.0], x[1:]])

    names = ["phi", *(f"{name}_{i + 1}" for name in "hv" for i in range(count))]
    period = 2.0 * np.pi / p["omega"]
    jumps = [*(partial(lands, place) for place in range(count)), wrap]
    system = System(names, flow, guards, jumps, frozenset({count}), look=period)
    start = np.array([0.0, *(p[f"{name}_0"] for name in names[1:])])
    return solved(system, start, case.run.crossings, period, {})


def _draw_balls(random: np.random.Generator) -> Case:
    while True:
        m = int(random.integers(2, MOST_BALLS + 1))
        floor = any_of(random, *FLOORS)
        groups = int(random.integers(1, 3))  # balls of a group land at one instant
        heights = floor + random.uniform(0.05, 1.0, groups)
        speeds = random.uniform(-2.0, 1.0, groups)
        omega = float(random.uniform(6.0, 12.0))
        values = {
            "g": 9.81,
            "rest": float(random.uniform(0.3, 0.7)),
            "kick": float(random.uniform(1.0, 3.0)),
            "omega": omega,
            "k": any_of(random, 0.0, float(random.uniform(0.5, 12.0)) / m),
            "base": floor,
            "m": float(m),
        }
        for i in range(MOST_BALLS):
            moves = i < m
            values[f"h_{i + 1}_0"] = float(heights[i % groups]) if moves else floor + 1.0
            values[f"v_{i + 1}_0"] = float(speeds[i % groups]) if moves else 0.0
        case = Case(values, gs.ReturnMap(crossings=2))
        reference = _balls(case).columns
        h = np.stack([reference[f"h_{i + 1}_n"] for i in range(m)])
        v = np.stack([reference[f"v_{i + 1}_n"] for i in range(m)])
        # no ball at the floor when the clock strikes, and none that hops very low
        if (
            np.size(reference["t"]) == 2
            and h.min() > floor + 0.02
            and np.abs(v).max() < 6.0
            and _lively(case)
        ):
            return case


def _lively(case: Case) -> bool:
    """Whether every ball lands at more than 0.3 m/s within the first cycle, and at most three times."""
    p = case.values
    for i in range(int(p["m"])):
        fall = np.sqrt(max(p[f"v_{i + 1}_0"] ** 2 + 2.0 * p["g"] * (p[f"h_{i + 1}_0"] - p["base"]), 0.0))
        if fall < 0.5:
            return False
    return True


CRADLE = 5


def _contact(place: int) -> Event:
    """The event that two neighbours of the row collide, and its jump."""

    @event(f"balls {place + 1} and {place + 2} collide")
    def collide(self, p, s):
        return s.x[place] - s.x[place + 1] + p.width

    @collide.jump
    def exchange(self, p, s):
        first, second = s.v[place], s.v[place + 1]
        return s.replace(v=s.v.at[place].set(second).at[place + 1].set(first))

    return collide


class Cradle(DeclaredModel):
    """Equal balls in a row that collide elastically. A shock runs through those that touch at the start."""

    section_coordinates = ("x", "v")
    width = parameter("m", "diameter", 0.1)
    clock = variable("s", "clock", 0.0, observed=False)
    x = variable("m", "place of ball", (0.0, 0.5, 1.0, 1.5, 2.0), count=CRADLE)
    v = variable("m/s", "speed of ball", 0.0, count=CRADLE)

    one, two, three, four = _contact(0), _contact(1), _contact(2), _contact(3)

    def flow(self, p, s):
        return {"clock": 1.0, "x": s.v}

    @event("a second is over", section=True)
    def tick(self, p, s):
        return s.clock - 1.0

    @tick.jump
    def again(self, p, s):
        return s.replace(clock=0.0)

    def complete(self, p, s):
        return s.replace(clock=0.0)

    def period(self, p):
        return 1.0 + 0.0 * p.width


def _cradle(case: Case) -> Solution:
    """Equal balls that exchange their speeds are points that pass through each other."""
    p = case.values
    places = np.arange(CRADLE)
    x = np.array([p[f"x_{i + 1}_0"] for i in places]) - p["width"] * places
    v = np.array([p[f"v_{i + 1}_0"] for i in places])
    times = np.arange(1.0, case.run.crossings + 1.0)
    columns: dict[str, np.ndarray] = {"t": times}
    moved = x + v * times[:, None]
    order = np.argsort(moved, axis=1)
    found_x = np.take_along_axis(moved, order, axis=1) + p["width"] * places
    found_v = v[order]
    after: dict[str, float] = {}
    for i in places:
        columns |= {f"x_{i + 1}_n": found_x[:, i], f"v_{i + 1}_n": found_v[:, i]}
        after |= {f"x_{i + 1}": float(found_x[0, i]), f"v_{i + 1}": float(found_v[0, i])}
    return Solution(COMPLETE, columns, 1.0, {}, after)


def _draw_cradle(random: np.random.Generator) -> Case:
    touching = bool(random.integers(2))
    while True:
        width = float(random.uniform(0.05, 0.5))
        gaps = random.uniform(0.1, 1.0, CRADLE - 1)
        v = random.uniform(-2.0, 2.0, CRADLE)
        if touching:
            # the balls of a group touch, and are at rest until another ball meets them
            first = int(random.integers(1, CRADLE - 1))
            last = int(random.integers(first + 1, CRADLE))
            gaps[first:last] = 0.0
            v[first : last + 1] = 0.0
            v[first - 1] = abs(v[first - 1]) + 0.2
        x = any_of(random, 0.0, 10.0) + np.concatenate([[0.0], np.cumsum(gaps + width)])
        values: Values = {"width": width}
        for i in range(CRADLE):
            values |= {f"x_{i + 1}_0": float(x[i]), f"v_{i + 1}_0": float(v[i])}
        case = Case(values, gs.ReturnMap(crossings=3), differentiable=not touching)
        reference = _cradle(case).columns
        places = np.stack([reference[f"x_{i + 1}_n"] for i in range(CRADLE)])
        speeds = np.stack([reference[f"v_{i + 1}_n"] for i in range(CRADLE)])
        # no collision when the clock strikes, but balls that touch and are at rest
        apart = np.diff(places, axis=0) - width
        nearing = speeds[:-1] - speeds[1:]
        if np.all((apart > 1e-2) | (nearing == 0.0)):
            return case


FAMILIES = (
    Family(
        "bouncing",
        "a ball over a floor at any height, fixed or moving at a constant speed; four forms of its jump",
        Ball,
        _draw_bounce,
        _bounces,
        share=34,
        jacobian=True,
    ),
    Family(
        "start on a floor",
        "a ball that starts on the floor and moves into it: it lands at t = 0",
        Ball,
        _draw_on_floor,
        _bounces,
        share=10,
    ),
    Family(
        "start below a floor",
        "a ball that starts below the floor, or within 1e-9 m of it, moving down: something has to say so",
        Ball,
        _draw_below,
        _unmarked,
        share=6,
    ),
    Family(
        "accumulating impacts",
        "bounces that accumulate at a known time, on floors at any height, fixed or moving",
        Ball,
        _draw_accumulating,
        _accumulates,
        share=26,
    ),
    Family(
        "shaken floor",
        "a ball over a floor that moves as a sine",
        Shaken,
        _draw_shaken,
        _shaken,
        share=18,
        jacobian=True,
    ),
    Family(
        "corners of a box",
        "a ball in a box of three dimensions, which hits one to three walls at one instant",
        Box,
        _draw_box,
        _box,
        share=18,
        jacobian=True,
    ),
    Family(
        "balls in a row",
        "five equal balls that collide; where some touch, a shock runs through them at one instant",
        Cradle,
        _draw_cradle,
        _cradle,
        share=14,
        jacobian=True,
    ),
    Family(
        "balls together",
        "two to six balls, coupled by springs, that land at one instant or in two groups",
        Balls,
        _draw_balls,
        _balls,
        share=28,
        jacobian=True,
    ),
)
