"""Methods with step control beside each other: `python -m benchmarks.methods [--models hopper ...]`.

Rows of the smooth models among the examples, each from another start. CPU time is the least of a few runs in
one process, when the kernel is compiled, less that of a run of one cycle. The error is the largest of an
observable or of the time at the end, relative to its largest value, beside `tsit5` with tolerances of 1e-13.
"""

from __future__ import annotations

import argparse
import time
from typing import Any

import numpy as np

import gaitsweep as gs
from gaitsweep.contract import Model
from gaitsweep.examples.compass_walker import CompassWalker
from gaitsweep.examples.hopper import Hopper
from gaitsweep.examples.lorenz import Lorenz
from gaitsweep.examples.ring_hopper import RingHopper
from gaitsweep.examples.slip_runner import SlipRunner

METHODS = ("tsit5", "taylor")
# a model, the start that varies, its range, and the cycles of a row: few where motion is chaotic
CASES: dict[str, tuple[Model, str, tuple[float, float], int]] = {
    "compass_walker": (CompassWalker(), "stance_rate_0", (1.08, 1.1), 20),
    "slip_runner": (SlipRunner(), "z_0", (1.0, 1.2), 20),
    "hopper": (Hopper(), "launch_0", (4.0, 8.0), 20),
    "ring_hopper": (RingHopper(), "launch_0", (4.0, 8.0), 20),
    "lorenz": (Lorenz(), "x_0", (1.0, 2.0), 10),
}
REPEATS = 3


def run(case: str, rows: int, cycles: int, method: str, tolerance: float) -> tuple[np.ndarray, float]:
    """The ends (rows, quantities), and the CPU time (s)."""
    model, start, (low, high), _ = CASES[case]
    keywords: dict[str, Any] = {start: np.linspace(low, high, rows)}
    begun = time.process_time()
    result = gs.sweep(
        model,
        **keywords,
        run={"kind": "settle", "max_cycles": cycles, "tolerance": 1e-30},
        numerics={"method": method, "rtol": tolerance, "atol": tolerance},
        verify=0,
    )
    names = [*(f"{q.name}_end" for q in model.observables if not q.circular), "t_end"]
    return result.table[names].to_numpy(float), time.process_time() - begun


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--rows", type=int, default=4096)
    parser.add_argument("--models", nargs="*", default=list(CASES), choices=CASES)
    arguments = parser.parse_args()
    rows = arguments.rows
    print(
        f"{rows} rows\n{'model':16s} {'rtol':>6s} {'method':8s} {'CPU s':>7s} {'of tsit5':>9s} {'error':>9s}"
    )
    for case in arguments.models:
        cycles = CASES[case][-1]
        right, _ = run(case, rows, cycles, "tsit5", 1e-13)
        size = np.nanmax(np.abs(right), axis=0)
        for tolerance in (1e-6, 1e-8, 1e-10, 1e-12):
            seconds: dict[str, float] = {}
            errors: dict[str, float] = {}
            beside = {method: [run(case, rows, 1, method, tolerance)[1]] for method in METHODS}
            whole: dict[str, list[float]] = {method: [] for method in METHODS}
            for _ in range(REPEATS):
                for method in METHODS:
                    beside[method].append(run(case, rows, 1, method, tolerance)[1])
                    ends, spent = run(case, rows, cycles, method, tolerance)
                    whole[method].append(spent)
                    errors[method] = float(np.nanmax(np.abs(ends - right) / np.where(size, size, 1.0)))
            for method in METHODS:
                seconds[method] = min(whole[method]) - min(beside[method])
                ratio = seconds[method] / seconds[METHODS[0]]
                row = f"{case:16s} {tolerance:6.0e} {method:8s} {seconds[method]:7.3f} {ratio:9.2f}"
                print(f"{row} {errors[method]:9.1e}", flush=True)


if __name__ == "__main__":
    main()
