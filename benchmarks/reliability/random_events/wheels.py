"""Legs that change their stance: rimless wheels with both neighbours as events, and a hopper on a spring."""

from __future__ import annotations

from collections.abc import Callable

import jax.numpy as jnp
import numpy as np
from scipy.integrate import solve_ivp

import gaitsweep as gs
from gaitsweep import DeclaredModel, event, mode, observable, parameter, variable

from .family import Case, Family, Solution, System, Values, any_of, solved


class Wheel(DeclaredModel):
    """A rimless wheel on a slope; either neighbour of the stance spoke may land."""

    section_coordinates = ("theta", "rate")
    alpha = parameter("rad", "half the angle between spokes", 0.39269908169872414)
    gamma = parameter("rad", "slope", 0.08)
    g = parameter("1/s2", "gravity over the length", 9.81)
    theta = variable("rad", "angle of the stance spoke", 0.0)
    rate = variable("rad/s", "its rate", 2.0)

    def flow(self, p, s):
        return {"theta": s.rate, "rate": p.g * jnp.sin(s.theta)}

    @event("next spoke lands", section=True)
    def forward(self, p, s):
        return s.theta - (p.gamma + p.alpha)

    @forward.jump
    def step(self, p, s):
        return s.replace(theta=p.gamma - p.alpha, rate=s.rate * jnp.cos(2.0 * p.alpha))

    @event("last spoke lands", section=True)
    def backward(self, p, s):
        return (p.gamma - p.alpha) - s.theta

    @backward.jump
    def back(self, p, s):
        return s.replace(theta=p.gamma + p.alpha, rate=s.rate * jnp.cos(2.0 * p.alpha))

    @observable("rad/s", "rate after the landing", scale=1.0)
    def landed(self, p, s):
        return s.rate

    def period(self, p):
        return 1.0 + 0.0 * p.g


def _wheel_system(p: Values) -> System:
    def flow(x: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
        way = solve_ivp(
            lambda _, y: [y[1], p["g"] * np.sin(y[0])],
            (0.0, 0.5),
            x,
            method="DOP853",
            rtol=1e-13,
            atol=1e-14,
            dense_output=True,
            max_step=0.05,
        ).sol
        return lambda t: way(t).T

    high, low, share = p["gamma"] + p["alpha"], p["gamma"] - p["alpha"], np.cos(2.0 * p["alpha"])
    return System(
        ("theta", "rate"),
        flow,
        lambda x: np.stack([x[:, 0] - high, low - x[:, 0]], axis=1),
        [lambda x: np.array([low, x[1] * share]), lambda x: np.array([high, x[1] * share])],
        frozenset({0, 1}),
        look=0.5,
    )


def _wheel(case: Case) -> Solution:
    p = case.values
    return solved(_wheel_system(p), np.array([p["theta_0"], p["rate_0"]]), case.run.crossings, 1.0, {})


def _a_wheel(random: np.random.Generator) -> Values:
    alpha = np.pi / int(random.integers(6, 13))
    gamma = float(random.uniform(0.02, 0.2))
    return {
        "alpha": alpha,
        "gamma": gamma,
        "g": float(random.uniform(5.0, 20.0)),
        "theta_0": gamma + alpha * float(random.uniform(-0.8, 0.8)),
        "rate_0": float(random.uniform(-3.0, 3.0)),
    }


def _after_vaulting(p: Values, rate: float, theta: float) -> float:
    """The square of the rate over the top, from a rate at an angle; below 0 where it is not reached."""
    return rate**2 - 2.0 * p["g"] * (1.0 - np.cos(theta))


def _draw_wheel(random: np.random.Generator) -> Case:
    while True:
        case = Case(_a_wheel(random), gs.ReturnMap(crossings=5))
        p = case.values
        reference = _wheel(case).columns
        rates = np.concatenate([[p["rate_0"]], reference["rate_n"]])
        angles = np.concatenate([[p["theta_0"]], reference["theta_n"]])
        margins = [abs(_after_vaulting(p, r, a)) for r, a in zip(rates, angles, strict=True)]
        # never near the unstable equilibrium, nor so slow that the landings accumulate
        if min(margins) > 0.05 and np.abs(rates[1:]).min() > 0.15:
            return case


def _rolling(p: Values) -> float:
    """The rate after a landing at which the wheel rolls on for ever; NaN where it does not."""
    share = np.cos(2.0 * p["alpha"]) ** 2
    gained = 4.0 * p["g"] * np.sin(p["alpha"]) * np.sin(p["gamma"])
    rate = np.sqrt(share * gained / (1.0 - share))
    return float(rate) if _after_vaulting(p, rate, p["gamma"] - p["alpha"]) > 0.05 else np.nan


def _draw_rolling(random: np.random.Generator) -> Case:
    while True:
        values = _a_wheel(random)
        rate = _rolling(values)
        fast = float(random.uniform(1.0, 2.0))
        values |= {"theta_0": values["gamma"] - 0.9 * values["alpha"], "rate_0": fast * rate}
        if not np.isnan(rate):
            return Case(values, gs.Settle(max_cycles=300, tolerance=1e-10))


def _rolls(case: Case) -> Solution:
    return Solution(
        frozenset({"settled"}), {"landed_end": _rolling(case.values), "attractor_period": 1.0}, 1.0, {}
    )


def _draw_standing(random: np.random.Generator) -> Case:
    while True:
        values = _a_wheel(random)
        values |= {"gamma": values["alpha"] * any_of(random, 0.0, float(random.uniform(0.0, 0.4)))}
        values |= {
            "theta_0": values["gamma"] + values["alpha"] * float(random.uniform(-0.9, 0.9)),
            "rate_0": 0.0,
        }
        case = Case(values, any_of(random, gs.Settle(max_cycles=3000), gs.FixedTime(duration=300.0)))
        if abs(values["theta_0"]) > 0.02 and not np.isnan(_standstill(values)):
            return case


NODES, WEIGHTS = np.polynomial.legendre.leggauss(60)


def _falling(g: float, turned: float, way: float) -> float:
    """The time (s) from rest at an angle above 0 until it has grown by `way`."""
    u = 0.5 * (NODES + 1.0)
    grown = way * u**2
    rates = np.sqrt(4.0 * g * np.sin(turned + 0.5 * grown) * np.sin(0.5 * grown))
    return float(0.5 * np.sum(WEIGHTS * 2.0 * way * u / rates))


def _standstill(p: Values) -> float:
    """Time at which a wheel that starts at rest has rocked until it stands; NaN if it rolls on."""
    # the stance spoke's angle from the vertical at a landing forwards and one backwards
    ends = (p["alpha"] + p["gamma"], p["alpha"] - p["gamma"])
    share = np.cos(2.0 * p["alpha"])
    side = 0 if p["theta_0"] > 0 else 1
    t = _falling(p["g"], abs(p["theta_0"]), ends[side] - abs(p["theta_0"]))
    energy = np.cos(p["theta_0"]) - np.cos(ends[side])  # of the rate, over g
    while True:
        # the next spoke, on its other side, keeps a part of the energy, turns and comes back to its side
        energy, side = share**2 * energy, 1 - side
        if energy < 1e-14:
            break
        if energy > 1.0 - np.cos(ends[side]) - 1e-3:
            return float("nan")
        way = 0.0
        for _ in range(60):  # cos(end - way) - cos(end) = energy
            way = 2.0 * np.arcsin(0.5 * energy / np.sin(ends[side] - 0.5 * way))
        t += 2.0 * _falling(p["g"], ends[side] - way, way)
    rate = np.sqrt(2.0 * p["g"] * energy)
    while rate > 1e-30:
        t += 2.0 * rate / (p["g"] * np.sin(ends[side]))
        rate, side = rate * share, 1 - side
    return t


def _stands(case: Case) -> Solution:
    end = _standstill(case.values)
    return Solution(frozenset({"event_stall"}), {"t_end": end}, end)


class Hopper(DeclaredModel):
    """A body on a spring that hops: it lands, and takes off with a kick where the spring is as long again."""

    section_coordinates = ("h", "v")
    g = parameter("m/s2", "gravitational acceleration", 9.81)
    omega = parameter("rad/s", "rate of the spring", 20.0)
    length = parameter("m", "height at which the spring touches", 1.0)
    keep = parameter("1", "share of the speed that a take-off leaves", 0.8)
    kick = parameter("m/s", "speed that a take-off adds", 0.5)
    stands = mode(False, "whether the spring touches the ground")
    h = variable("m", "height", 1.5)
    v = variable("m/s", "speed upwards", 1.0)

    def flow(self, p, s):
        push = p.omega**2 * (p.length - s.h)
        return {"h": s.v, "v": jnp.where(s.stands, push, 0.0) - p.g}

    @event("lands", during=lambda s: ~s.stands)
    def lands(self, p, s):
        return p.length - s.h

    @lands.jump
    def touch(self, p, s):
        return s.replace(stands=True)

    @event("takes off", during=lambda s: s.stands)
    def takes_off(self, p, s):
        return s.h - p.length

    @takes_off.jump
    def leave(self, p, s):
        return s.replace(stands=False, v=p.keep * s.v + p.kick)

    @event("apex", section=True, during=lambda s: ~s.stands)
    def apex(self, p, s):
        return -s.v

    def period(self, p):
        return 1.0 + 0.0 * p.g


def _hopper(case: Case) -> Solution:
    p = case.values

    def flow(x: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
        h, v, stands = x
        low = p["length"] - p["g"] / p["omega"] ** 2

        def at(t: np.ndarray) -> np.ndarray:
            w = p["omega"] * t
            if stands:
                places = low + (h - low) * np.cos(w) + v / p["omega"] * np.sin(w)
                speeds = v * np.cos(w) - (h - low) * p["omega"] * np.sin(w)
            else:
                places, speeds = h + v * t - 0.5 * p["g"] * t**2, v - p["g"] * t
            return np.stack([places, speeds, np.full_like(t, stands)], axis=1)

        return at

    def guards(x: np.ndarray) -> np.ndarray:
        stands = x[:, 2] > 0.5
        away = -1.0
        lands = np.where(stands, away, p["length"] - x[:, 0])
        return np.stack(
            [lands, np.where(stands, x[:, 0] - p["length"], away), np.where(stands, away, -x[:, 1])], axis=1
        )

    jumps = [
        lambda x: np.array([p["length"], x[1], 1.0]),
        lambda x: np.array([p["length"], p["keep"] * x[1] + p["kick"], 0.0]),
        lambda x: np.array([x[0], 0.0, x[2]]),
    ]
    system = System(("h", "v", "stands"), flow, guards, jumps, frozenset({2}), look=0.5, samples=400)
    return solved(system, np.array([p["h_0"], p["v_0"], 0.0]), case.run.crossings, 1.0, {})


def _draw_hopper(random: np.random.Generator) -> Case:
    while True:
        length = any_of(random, 1.0, 0.1, 50.0, -3.0)
        values = {
            "g": float(random.uniform(1.6, 12.0)),
            "omega": float(10.0 ** random.uniform(1.0, 2.5)),
            "length": length,
            "keep": float(random.uniform(0.4, 1.0)),
            "kick": float(random.uniform(0.2, 1.5)),
            "h_0": length + float(random.uniform(0.1, 1.0)),
            "v_0": any_of(random, -1.0, 1.0) * float(random.uniform(0.2, 2.0)),
        }
        case = Case(values, gs.ReturnMap(crossings=4))
        if np.all(_hopper(case).columns["h_n"] < length + 3.0):
            return case


FAMILIES = (
    Family(
        "rimless wheel",
        "a wheel with both neighbours of the stance spoke as events, rolling, rocking and turning back",
        Wheel,
        _draw_wheel,
        _wheel,
        share=20,
        jacobian=True,
        step=1e-3,
    ),
    Family(
        "rolling wheel",
        "wheels that settle at the rate that is known in closed form",
        Wheel,
        _draw_rolling,
        _rolls,
        share=8,
    ),
    Family(
        "standing wheel",
        "wheels that rock until they stand: their landings accumulate",
        Wheel,
        _draw_standing,
        _stands,
        share=8,
    ),
    Family(
        "hopper",
        "a body on a spring: each phase begins on the surface that ends it",
        Hopper,
        _draw_hopper,
        _hopper,
        share=16,
        jacobian=True,
    ),
)
