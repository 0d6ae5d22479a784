"""pyBasin's pendulum: random starts to t = 1 000, rtol 1e-8, atol 1e-6; those that rest, those that turn.

The case study of pyBasin and bSTAB: theta'' = 0.5 - 0.1 theta' - sin theta, starts in its box. A row turns if
its rate at the end is not near zero; shares of all rows are in the notes. The error is that of the rate at
the end, the median of a few rows against SciPy's DOP853 (rtol 1e-12). SciPy's time is that of those few rows
by its RK45, times their number.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import jax
import jax.numpy as jnp
import numpy as np
from scipy.integrate import solve_ivp

from gaitsweep import DeclaredModel, parameter, variable

from .measured import Array, Line, Options, installed, missing, swept, timed, version_of

ALPHA, TORQUE, STIFFNESS = 0.1, 0.5, 1.0
DURATION, RTOL, ATOL = 1000.0, 1e-8, 1e-6
COMPARED = 8
TURNS = 0.1  # 1/s; a pendulum that turns has a rate of about 5, one that rests of less than 1e-6


class Pendulum(DeclaredModel):
    """A damped pendulum under a constant torque."""

    alpha = parameter("1/s", "damping", ALPHA)
    torque = parameter("1/s2", "constant torque", TORQUE)
    stiffness = parameter("1/s2", "gravity over length", STIFFNESS)
    theta = variable("rad", "angle from hanging", 0.5, observed=True)
    theta_rate = variable("rad/s", "its rate", 0.0, observed=True)

    def flow(self, p, s):
        rate = -p.alpha * s.theta_rate + p.torque - p.stiffness * jnp.sin(s.theta)
        return {"theta": s.theta_rate, "theta_rate": rate}

    def period(self, p):
        return 2.0 * jnp.pi / jnp.sqrt(p.stiffness)


def lines(options: Options) -> Iterator[Line]:
    """The lines of diffrax, heyoka, SciPy and gaitsweep."""
    for rows in options.rows_or(2500):
        yield from lines_of(rows, options)


def lines_of(rows: int, options: Options) -> Iterator[Line]:
    """The lines of one number of rows."""
    begin = starts(rows)
    few = np.linspace(0, rows - 1, COMPARED).astype(int)
    right = scipy_ends(begin[few], "DOP853", 1e-12, 1e-14)

    def line(name: str, run: Callable[[Array], Array], repeats: int, note: str = "") -> Line:
        run(begin[:64])  # compiles
        ends, cpu, clock = timed(lambda: run(begin), repeats)
        error = float(np.median(np.abs(ends[few] - right)))
        share = f"{100.0 * np.mean(np.abs(ends) > TURNS):.2f} % turn"
        return Line(f"{name}, {rows} rows", cpu, clock, error, "; ".join(filter(None, (share, note))))

    if installed("heyoka") is None:
        yield missing("heyoka")
    else:
        note = "no cards; Taylor steps of order 11"
        yield line(f"{version_of('heyoka')}, tol {RTOL:g}", heyoka_ends, options.repeats, note)
    if installed("diffrax") is None:
        yield missing("diffrax")
    else:
        run = diffrax_ends()
        run(begin)  # compiles
        note = "steps of a batch end with its slowest row; an event ends a row, without a reset"
        yield line(f"{version_of('diffrax')}, Tsit5", run, 1, note)
    ends, cpu, clock = timed(lambda: scipy_ends(begin[few], "RK45", RTOL, ATOL))
    factor = rows / COMPARED
    error = float(np.median(np.abs(ends - right)))
    name = f"{version_of('scipy')}, RK45, {COMPARED} rows times {factor:.0f}"
    yield Line(name, factor * cpu, factor * clock, error, "one row at a time")
    for method in ("tsit5", "taylor"):
        yield line(f"gaitsweep {method}", lambda at, m=method: our_ends(at, m), options.repeats)


def starts(rows: int) -> Array:
    """Angles and rates at the start (rows, 2), drawn from pyBasin's box."""
    middle = np.arcsin(TORQUE / STIFFNESS)
    low, high = (middle - np.pi, -10.0), (middle + np.pi, 10.0)
    return np.random.default_rng(0).uniform(low, high, (rows, 2))


def our_ends(begin: Array, method: str) -> Array:
    """Rates at the end of rows by gaitsweep."""
    axes = {"theta_0": begin[:, 0], "theta_rate_0": begin[:, 1]}
    numerics = {"method": method, "rtol": RTOL, "atol": ATOL}
    table = swept(Pendulum(), {"kind": "fixed_time", "duration": DURATION}, numerics, zip=axes)
    return table["theta_rate_end"].to_numpy(float)


def scipy_ends(begin: Array, method: str, rtol: float, atol: float) -> Array:
    """Rates at the end by SciPy, one row after the other."""

    def flow(t: float, s: Array) -> list[float]:
        return [s[1], -ALPHA * s[1] + TORQUE - STIFFNESS * np.sin(s[0])]

    runs = [solve_ivp(flow, (0.0, DURATION), start, method, rtol=rtol, atol=atol) for start in begin]
    return np.array([run.y[1, -1] for run in runs])


def heyoka_ends(begin: Array) -> Array:
    """Rates at the end by heyoka's batch mode."""
    hy = installed("heyoka")
    theta, rate = hy.make_vars("theta", "rate")
    system = [(theta, rate), (rate, -ALPHA * rate + TORQUE - STIFFNESS * hy.sin(theta))]
    lanes = hy.recommended_simd_size()
    integrator = hy.taylor_adaptive_batch(system, np.zeros((2, lanes)), tol=RTOL)
    ends = np.empty(len(begin))
    for first in range(0, len(begin), lanes):
        starts = begin[np.minimum(np.arange(first, first + lanes), len(begin) - 1)]
        integrator.set_time(0.0)
        integrator.state[:] = starts.T
        integrator.propagate_until(np.full(lanes, DURATION))
        ends[first : first + lanes] = integrator.state[1, : len(begin) - first]
    return ends


def diffrax_ends() -> Callable[[Array], Array]:
    """A function from starts to rates at the end by diffrax, vmapped, as pyBasin's JaxSolver uses it."""
    diffrax = installed("diffrax")
    term = diffrax.ODETerm(
        lambda t, s, args: jnp.stack([s[1], -ALPHA * s[1] + TORQUE - STIFFNESS * jnp.sin(s[0])])
    )
    controller = diffrax.PIDController(rtol=RTOL, atol=ATOL)

    def end(start):
        solution = diffrax.diffeqsolve(
            term, diffrax.Tsit5(), 0.0, DURATION, None, start, stepsize_controller=controller, max_steps=None
        )
        assert solution.ys is not None
        return solution.ys[-1, 1]

    program = jax.jit(jax.vmap(end))
    return lambda begin: np.asarray(program(begin))
