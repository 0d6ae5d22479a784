"""CuBIE's example: Van der Pol, all pairs of 1 024 starts and 1 024 mu, t from 0 to 20, rtol 1e-3.

CuBIE's README (version 0.17) gives 29 ms for the million of runs with its rk45, atol 1e-6, on an RTX 4070
Super; it runs on NVIDIA's cards only. Without `--platform cuda` fewer pairs are run here. The error is that
of x at the end, the largest of a few rows against SciPy's DOP853 (rtol 1e-12).
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

from gaitsweep import DeclaredModel, parameter, variable

from .measured import Array, Line, Options, installed, swept, timed, version_of

DURATION, ATOL = 20.0, 1e-6
COMPARED = 16
NO_EVENTS = "no events and no resets"


class VanDerPol(DeclaredModel):
    """Van der Pol's oscillator."""

    mu = parameter("1", "strength of the damping", 1.5)
    x = variable("1", "displacement", 1.0, observed=True)
    v = variable("1/s", "its rate", 0.0)

    def flow(self, p, s):
        return {"x": s.v, "v": p.mu * (1.0 - s.x**2) * s.v - s.x}

    def period(self, p):
        return 2.0 * np.pi + 0.0 * p.mu


def lines(options: Options) -> Iterator[Line]:
    """The lines of CuBIE, published and measured, and of gaitsweep."""
    published = "published in CuBIE's README: CuBIE rk45, 1 048 576 pairs, RTX 4070 Super"
    yield Line(published, clock_s=0.029, note=f"{NO_EVENTS}; error not given")
    for pairs in options.rows_or(1024**2 if options.platform == "cuda" else 128**2):
        yield from lines_of(pairs, options)


def lines_of(pairs: int, options: Options) -> Iterator[Line]:
    """The lines of one number of pairs."""
    on_card = options.platform == "cuda"
    side = round(pairs**0.5)
    x, mu = np.linspace(1.0, 2.0, side), np.linspace(1.0, 3.0, side)
    few = np.random.default_rng(0).integers(0, side, (COMPARED, 2))
    right = np.array([reference(float(x[i]), float(mu[j])) for i, j in few])

    def error(ends: Array) -> float:
        return float(np.max(np.abs(ends[few[:, 0], few[:, 1]] - right)))

    if on_card and installed("cubie") is not None:
        for precision in (np.float32, np.float64):
            yield cubie_line(x, mu, precision, error, options.repeats)
    elif on_card:
        yield Line("CuBIE", note="not installed: pip install 'cubie[cuda13]'")
    else:
        yield Line("CuBIE", note="not run: it needs an NVIDIA card (--platform cuda)")
    for method, rtol in (("tsit5", 1e-3), ("tsit5", 1e-8)):
        ends, cpu, clock = timed(lambda r=rtol, m=method: our_ends(x, mu, m, r), options.repeats)
        note = "whole call: table of all rows in memory"
        yield Line(f"gaitsweep {method}, rtol {rtol:g}, {side**2} pairs", cpu, clock, error(ends), note)


def our_ends(x: Array, mu: Array, method: str, rtol: float) -> Array:
    """X at the end (starts, mu) by gaitsweep."""
    numerics = {"method": method, "rtol": rtol, "atol": min(ATOL, rtol)}
    table = swept(VanDerPol(), {"kind": "fixed_time", "duration": DURATION}, numerics, x_0=x, mu=mu)
    return table["x_end"].to_numpy(float).reshape(len(x), len(mu))


def reference(x: float, mu: float) -> float:
    """X at the end by SciPy."""
    run = solve_ivp(
        lambda t, s: [s[1], mu * (1.0 - s[0] ** 2) * s[1] - s[0]], (0.0, DURATION), [x, 0.0], "DOP853",
        rtol=1e-12, atol=1e-14,
    )  # fmt: skip
    return float(run.y[0, -1])


def cubie_line(x: Array, mu: Array, precision: type, error: Any, repeats: int) -> Line:
    """The line of CuBIE in one precision (float32 is its default); it also returns the state at the start."""
    cubie = installed("cubie")
    system = cubie.create_ODE_system(
        ["dx = v", "dv = mu * (1 - x*x) * v - x"],
        precision=precision, states={"x": 1.0, "v": 0.0}, parameters={"mu": 1.5},
    )  # fmt: skip

    def run() -> Any:
        return cubie.solve_ivp(
            system, y0={"x": x, "v": [0.0]}, parameters={"mu": mu}, method="rk45", duration=DURATION,
            atol=ATOL, rtol=1e-3,
        )  # fmt: skip

    run()  # compiles
    result, cpu, clock = timed(run, repeats)
    place = list(result.time_domain_legend.values()).index("x")
    ends = np.asarray(result.time_domain_array)[-1, place].reshape(len(x), len(mu))
    name = f"{version_of('cubie')}, rk45, rtol 0.001, {precision.__name__}"
    return Line(name, cpu, clock, error(ends), NO_EVENTS)
