"""Measures of the equations of motion of Ambe et al. 2021, and of single legs in a trace."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Mapping
from types import MappingProxyType

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
from jaxtyping import Array, Bool, Float

from gaitsweep.claims import MeasureError, defaults, measure, numbers, one_row, records
from gaitsweep.expression import evaluate
from gaitsweep.papers.ambe2021.multilegged.chain_of_table import chain_of, constants_of, of_legs, springs_of
from gaitsweep.papers.ambe2021.multilegged.forces import obstacle_problem
from gaitsweep.papers.ambe2021.multilegged.model import Multilegged
from gaitsweep.papers.ambe2021.multilegged.parameters import PARAMETERS, SPRINGS
from gaitsweep.papers.ambe2021.multilegged.state import State
from gaitsweep.papers.ambe2021.theory.chain import Chain, masses, springs

Legs = Float[np.ndarray, " legs"]
Phases = Float[np.ndarray, "*phases"]

# A touchdown of leg 1 counts from this phase (rad) on: its leg is nearly as long as in its stance.
NEARLY_LONG = 1.8 * np.pi
# The time over which the phase gain is measured, in time constants tau of the phase's recovery.
RECOVERY_TIMES = 10.0


@functools.cache
def chain_defaults() -> Mapping[str, float]:
    """The default parameters of `multilegged`, those of Table 1, with its N."""
    return MappingProxyType({"N": float(SPRINGS), **defaults(PARAMETERS)})


@measure
def chain_parameter(*, formula: str) -> float:
    """Value of a formula over the default parameters of `multilegged`, in the formula's unit."""
    return float(evaluate(formula, chain_defaults()))


@measure
def equation_of_motion() -> float:
    """Largest difference of the model's accelerations from eq. (1) at random states (m/s2)."""
    values = chain_defaults()
    random = np.random.default_rng(1)
    N = SPRINGS
    model = Multilegged(N=N)
    params = model.params(_arrays(values))
    start = _arrays({f"psi_{i}": 1.0 for i in range(1, N + 1)} | {"phi_1": float("nan")})
    initial = model.init(params, start)

    @jax.jit
    def acceleration(state: State) -> Float[Array, " legs"]:
        return model.flow(params, state)["v"]

    largest = 0.0
    for _ in range(20):
        x, v = random.uniform(0.5, 1.1, N + 1), random.uniform(-1.0, 1.0, N + 1)
        phi, y = random.uniform(0.0, 2 * np.pi, N + 1), random.uniform(0.0, 0.5, N + 1)
        length, rate = _printed_leg(phi, values)
        contact = length >= x  # eq. (2)
        segment = np.digitize(phi, [2 * values["beta"] * np.pi, (1 + values["beta"]) * np.pi])
        leaves = {"x": x, "v": v, "phi": phi, "y": y, "contact": contact, "segment": segment}
        state = dataclasses.replace(initial, **{name: jnp.asarray(leaf) for name, leaf in leaves.items()})
        printed = _printed_acceleration(x, v, length, rate * (values["omega"] + y), contact, values)
        largest = max(largest, float(np.abs(np.asarray(acceleration(state)) - printed).max()))
    return largest


def _arrays(values: Mapping[str, float]) -> dict[str, jax.Array]:
    """Values as arrays of JAX, by name."""
    return {name: jnp.asarray(value) for name, value in values.items()}


def _printed_leg(phi: Phases, values: Mapping[str, float]) -> tuple[Phases, Phases]:
    """Leg lengths (m) and their derivative by the phase (m/rad), eq. (3)."""
    beta, slope = values["beta"], values["a"] / ((1 - values["beta"]) * np.pi)
    takeoff, landing = phi - 2 * beta * np.pi, 2 * np.pi - phi
    segments = [phi <= 2 * beta * np.pi, phi < (1 + beta) * np.pi]
    length = values["L"] - slope * np.select(segments, [0.0 * phi, takeoff], landing)
    return length, np.select(segments, [0.0 * phi, 0.0 * phi - slope], slope)


def _printed_acceleration(
    x: Legs, v: Legs, length: Legs, rate: Legs, p: Bool[np.ndarray, " legs"], values: Mapping[str, float]
) -> Legs:
    """Accelerations (m/s2) of the masses, eq. (1).

    Args:
        x, v: heights (m) and velocities (m/s) of the masses.
        length, rate: lengths (m) of the legs and their derivatives (m/s).
        p: the paper's symbol for contact, 1 on the ground and 0 in the air.
        values: parameters by name.
    """
    mass = np.full(len(x), values["m"])
    mass[[0, -1]] = values["m_B"]
    force = -mass * values["g"] - p * (values["K"] * (x - length) + values["D"] * (v - rate))
    for i in range(len(x)):
        for j in (i - 1, i + 1):
            if 0 <= j < len(x):
                force[i] -= values["kappa"] * (x[i] - x[j]) + values["sigma"] * (v[i] - v[j])
    return force / mass


@measure
def leg_length_error(table: pd.DataFrame) -> float:
    """Largest difference of the traced leg lengths from eq. (3) of the traced phases (m)."""
    table = records(table, None)
    length, _ = _printed_leg(of_legs(table, "phase"), constants_of(table, ["beta", "a", "L"]))
    return float(np.abs(length - of_legs(table, "l")).max())


@measure
def contact_as_printed(table: pd.DataFrame) -> float:
    """Share of the traced contacts that are those of eq. (2) (1)."""
    table = records(table, None)
    return float(np.mean((of_legs(table, "contact") > 0.5) == (of_legs(table, "l") >= of_legs(table, "x"))))


@measure
def air_in_swing(table: pd.DataFrame) -> float:
    """Share of takeoff and landing in which a leg is in the air, the smallest of all legs and rows (1)."""
    shares = []
    takeoff = 2 * constants_of(table, ["beta"])["beta"] * np.pi
    for row, part in records(table, None).groupby("row"):
        swings = of_legs(part, "phase") > takeoff
        if not swings.any(axis=0).all():
            raise MeasureError(f"A leg of row {row} does not swing in the recorded time.")
        in_air = swings & (of_legs(part, "contact") < 0.5)
        shares.append((in_air.sum(axis=0) / swings.sum(axis=0)).min())
    return float(min(shares))


@measure
def phase_gain(table: pd.DataFrame) -> float:
    """Gain of leg 1's phase on omega t from just before a touchdown to ten tau after it (rad)."""
    part = one_row(table, 0)
    values = constants_of(part, ["omega", "tau"])
    t = numbers(part, "t")
    contact = numbers(part, "contact_1") > 0.5
    phase = np.unwrap(numbers(part, "phase_1"))
    lands = ~contact[:-1] & contact[1:] & (np.mod(phase[:-1], 2 * np.pi) > NEARLY_LONG)
    recovery = RECOVERY_TIMES * values["tau"]
    touchdowns = np.flatnonzero(lands)
    if not len(touchdowns) or t[touchdowns[0]] + recovery > t[-1]:
        raise MeasureError("Leg 1 does not touch down early enough in the recorded time.")
    before = touchdowns[0]
    after = int(np.searchsorted(t, t[before] + recovery))
    return float(phase[after] - phase[before] - values["omega"] * (t[after] - t[before]))


@measure
def force_balance_error() -> float:
    """Largest residual of the force balance, eq. (8), of heights and loads at random leg lengths (N)."""
    values = chain_defaults()
    random = np.random.default_rng(1)
    chain = Chain(**{name: values[name] for name in Chain._fields})
    mass = np.asarray(masses(SPRINGS, chain))
    solve = _equilibrium(SPRINGS, chain)
    largest = 0.0
    for _ in range(50):
        length = values["L"] - random.uniform(0.0, values["a"], SPRINGS + 1)
        x, load = (np.asarray(solved)[0] for solved in solve(length[None]))
        pull = values["kappa"] * np.diff(x)
        sides = np.append(pull, 0.0) - np.append(0.0, pull) + load - mass * values["g"]
        in_the_air = np.where(x > length + 1e-12, np.abs(load), 0.0)
        largest = max(largest, float(np.abs(sides).max()), float(in_the_air.max()), -float(load.min()))
    return largest


def _equilibrium(
    N: int, chain: Chain
) -> Callable[[Float[np.ndarray, "states legs"]], tuple[jax.Array, jax.Array]]:
    """Heights (m) and loads (N) of a chain with N springs from its leg lengths (n, N+1), by eq. (8)."""
    kappa, mass, g = springs(N, chain), masses(N, chain), jnp.asarray(chain.g)
    return jax.jit(jax.vmap(lambda length: obstacle_problem(length, mass, kappa, g)))


@measure
def height_error(table: pd.DataFrame) -> float:
    """Median distance of traced heights from those of force balance, eq. (8), at the same legs (m)."""
    N = springs_of(table)
    distances = []
    for _, part in records(table, None).groupby("row"):
        heights, _ = _equilibrium(N, chain_of(table, part))(of_legs(part, "l"))
        distances.append(np.abs(np.asarray(heights) - of_legs(part, "x")))
    return float(np.median(np.concatenate(distances)))
