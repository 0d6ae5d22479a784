"""Rival: one trajectory at a time, by `scipy.integrate.solve_ivp` with events, or by the exact propagator."""

from __future__ import annotations

import time

import numpy as np

from .starts import Parameters, Row, errors, reference_crossings

from reference import multilegged_exact, multilegged_scipy  # isort: skip


def measure(exact: bool = False, trajectories: int = 3, crossings: int = 3, rtol: float = 1e-8) -> Row:
    """Seconds of a gait cycle on one core, over `trajectories` of the reference's starts.

    A step of solve_ivp is one of DOP853 at `rtol`; the exact propagator has none (NaN).
    """
    p = Parameters()
    true = reference_crossings()[:trajectories]
    if exact:
        multilegged_exact.run(p, true[0, 0], 2)  # fills its tables
    begun = time.perf_counter()
    records = [
        multilegged_exact.run(p, psi, crossings)
        if exact
        else multilegged_scipy.run(p, psi, crossings, rtol=rtol, atol=1e-3 * rtol)
        for psi in true[:, 0]
    ]
    seconds = (time.perf_counter() - begun) / (trajectories * crossings)
    result = np.array([[c.psi for c in record.crossings[1 : crossings + 1]] for record in records])
    steps = sum(record.steps for record in records) / (trajectories * crossings)
    return {
        "name": "exact propagator, one at a time"
        if exact
        else f"solve_ivp DOP853, rtol {rtol:g}, one at a time",
        "steps_per_second": float("nan") if exact else steps / seconds,
        "cycles_per_second": 1.0 / seconds,
        "error_rad": float(np.quantile(errors(result, true[:, 1 : crossings + 1]), 0.95)),
        "note": f"{seconds:.3f} s a gait cycle, {trajectories} starts of {crossings} cycles",
    }


if __name__ == "__main__":
    print(measure())
    print(measure(exact=True))
