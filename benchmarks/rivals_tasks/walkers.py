"""Jaxonomy's rimless wheel and compass gait: its simulations under vmap, and the equations that it ships.

1 000 wheels roll for 5 s from other rates, with Jaxonomy's parameters; the error is that of the
rate at the end, the largest of a few rows against SciPy with terminal events (rtol 1e-12). Of the
compass gait the shipped accelerations and heel strike are compared, at one state, with Goswami et al. 1998.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from scipy.integrate import solve_ivp

from gaitsweep.examples.compass_walker import CompassWalker
from gaitsweep.examples.rimless_wheel import RimlessWheel

from .measured import Array, Line, Options, installed, missing, swept, timed, version_of

GRAVITY, SLOPE, ALPHA, DURATION = 9.81, np.pi / 12.0, np.pi / 7.0, 5.0  # of legs of 1 m
RATES = (2.0, 4.0)  # rad/s, at which all wheels roll on
RTOL, ATOL = 1e-10, 1e-12
COMPARED = 8


def lines(options: Options) -> Iterator[Line]:
    """The lines of Jaxonomy and of gaitsweep."""
    for rows in options.rows_or(1000):
        yield from lines_of(rows, options)
    if installed("jaxonomy") is not None:
        yield compass_gait()


def lines_of(rows: int, options: Options) -> Iterator[Line]:
    """The lines of one number of rows."""
    rates = np.linspace(*RATES, rows)
    few = np.linspace(0, rows - 1, COMPARED).astype(int)
    right = np.array([reference(rate) for rate in rates[few]])

    def error(ends: Array) -> float:
        return float(np.max(np.abs(ends[few] - right)))

    if installed("jaxonomy") is None:
        yield missing("jaxonomy")
    else:
        run = jaxonomy_wheel()
        run(rates)  # compiles
        ends, cpu, clock = timed(lambda: run(rates), options.repeats)
        note = "resets are right under vmap" if error(ends) < 1e-6 else "resets are wrong under vmap"
        name = f"rimless wheel, {rows} rows: {version_of('jaxonomy')}, rtol {RTOL:g}"
        yield Line(name, cpu, clock, error(ends), f"{note}; no cards tried, no continuation of gaits")
    for method in ("tsit5", "taylor"):
        ends, cpu, clock = timed(lambda m=method: our_wheel(rates, m), options.repeats)
        yield Line(f"rimless wheel, {rows} rows: gaitsweep {method}, rtol {RTOL:g}", cpu, clock, error(ends))


def our_wheel(rates: Array, method: str) -> Array:
    """Rates (rad/s) at the end (rows, 1) by gaitsweep, whose unit of time is sqrt(leg / gravity)."""
    unit = GRAVITY**-0.5
    run = {"kind": "fixed_time", "duration": DURATION / unit}
    numerics = {"method": method, "rtol": RTOL, "atol": ATOL}
    table = swept(RimlessWheel(), run, numerics, slope=SLOPE, alpha=ALPHA, rate_0=rates * unit)
    return table["rate_end"].to_numpy(float)[:, None] / unit


def reference(rate: float) -> Array:
    """Rate at the end by SciPy."""

    def lands(t: float, s: Array) -> float:
        return s[0] - SLOPE - ALPHA

    lands.terminal, lands.direction = True, 1.0  # type: ignore[attr-defined]
    t, state = 0.0, np.array([SLOPE - ALPHA, rate])
    while t < DURATION:
        run = solve_ivp(
            lambda t, s: [s[1], GRAVITY * np.sin(s[0])], (t, DURATION), state, "DOP853", events=lands,
            rtol=1e-12, atol=1e-13,
        )  # fmt: skip
        t, state = run.t[-1], run.y[:, -1]
        if run.status == 1:
            state = np.array([SLOPE - ALPHA, np.cos(2.0 * ALPHA) * state[1]])
    return state[1:]


def jaxonomy_wheel() -> Any:
    """A function from rates at the start to rates at the end (rows, 1) by Jaxonomy."""
    jaxonomy = installed("jaxonomy")
    models = installed("jaxonomy", "jaxonomy.models.rimless_wheel")
    logging.getLogger("jaxonomy").setLevel(logging.WARNING)
    wheel = models.RimlessWheel(name="wheel")
    context = wheel.create_context()
    options = jaxonomy.SimulatorOptions(rtol=RTOL, atol=ATOL, max_major_steps=200)

    def end(rate):
        begun = context.with_continuous_state(jnp.stack([SLOPE - ALPHA, rate]))
        ended = jaxonomy.simulate(wheel, begun, (0.0, DURATION), options=options)
        return ended.context.continuous_state[1:]

    together = jax.jit(jax.vmap(end))
    return lambda rates: np.asarray(together(jnp.asarray(rates)))


def compass_gait() -> Line:
    """The largest difference of Jaxonomy's accelerations from the published ones, at one state."""
    models = installed("jaxonomy", "jaxonomy.models.compass_gait")
    gait, walker = models.CompassGait(name="gait"), CompassWalker()
    names = ("stance", "swing", "stance_rate", "swing_rate")
    state = dict(zip(names, (0.2, -0.1, 1.0, 0.3), strict=True))
    context = gait.create_context().with_continuous_state(jnp.array(list(state.values())))
    parameters = {q.name: jnp.asarray(q.default) for q in walker.parameters}
    params = walker.params(parameters)
    start = {q.name: jnp.zeros(()) for q in walker.initial_conditions}
    at = walker.init(params, start).replace(**{name: jnp.asarray(value) for name, value in state.items()})
    rates = walker.flow(params, at)
    published = np.array([float(rates[name]) for name in names])
    shipped = np.asarray(gait.ode(0.0, context.state, **context.parameters))
    struck = np.asarray(gait.reset(0.0, context.state, **context.parameters).continuous_state)[2:]
    note = (
        f"accelerations {shipped[2:].round(2)}, published {published[2:].round(2)} rad/s2 (the stance leg's "
        f"lacks gravity); rates after the heel strike {struck.round(2)}, by the momenta "
        f"{heel_strike(**state).round(2)} (a 1 is missing in its contact Jacobian): no rows are timed"
    )
    return Line(
        "compass gait: Jaxonomy's equations", error=float(np.max(np.abs(shipped - published))), note=note
    )


def heel_strike(stance: float, swing: float, stance_rate: float, swing_rate: float) -> Array:
    """Rates of the legs after a heel strike, by the angular momenta about the new foot and the hip.

    Legs have 1 m and 5 kg in their middle, the hip has 10 kg, as the walkers of both libraries.
    """

    def momenta(below: float, above: float, rates: Array, foot: Array) -> tuple[Any, ...]:
        """Momenta of the walker about `foot`, and of the legs below and above the hip about it."""
        legs = np.array([[np.sin(angle), np.cos(angle)] for angle in (below, above)])
        turned = rates[:, None] * legs[:, ::-1] * (1.0, -1.0)
        hip, velocity = legs[0], turned[0]
        places = np.array([0.5 * legs[0], hip - 0.5 * legs[1]])
        velocities = np.array([0.5 * turned[0], velocity - 0.5 * turned[1]])
        total = 10.0 * _cross(hip - foot, velocity) + 5.0 * np.sum(_cross(places - foot, velocities))
        return total, *(5.0 * _cross(places - hip, velocities))

    new_foot = np.array([np.sin(stance) - np.sin(swing), np.cos(stance) - np.cos(swing)])
    total, of_stance, _ = momenta(stance, swing, np.array([stance_rate, swing_rate]), new_foot)
    after = np.array([momenta(swing, stance, unit, np.zeros(2))[::2] for unit in np.eye(2)]).T
    return np.linalg.solve(after, np.array([total, of_stance]))


def _cross(r: Array, v: Array) -> Array:
    return r[..., 0] * v[..., 1] - r[..., 1] * v[..., 0]
