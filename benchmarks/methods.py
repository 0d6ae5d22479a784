"""Methods with step control beside each other: `python -m benchmarks.methods`.

Each row is a compass walker that takes 20 steps down its slope from another start. CPU time is that of a
second run in one process, when its kernel is compiled. The error is the largest of the angles (rad), rates
(rad/s) and times (s) at the end, beside `tsit5` with tolerances of 1e-13.
"""

from __future__ import annotations

import argparse
import time

import numpy as np

import gaitsweep as gs
from gaitsweep.examples.compass_walker import CompassWalker

METHODS = ("tsit5", "taylor")
ENDS = ["stance_end", "stance_rate_end", "swing_rate_end", "t_end"]


def walked(rows: int, method: str, tolerance: float) -> tuple[np.ndarray, float]:
    """The ends (rows, 4), and the CPU time (s) of the run."""
    begun = time.process_time()
    result = gs.sweep(
        CompassWalker(),
        stance_rate_0=np.linspace(1.08, 1.1, rows),
        run={"kind": "settle", "max_cycles": 20, "tolerance": 1e-30},
        numerics={"method": method, "rtol": tolerance, "atol": tolerance},
        verify=0,
    )
    return result.table[ENDS].to_numpy(float), time.process_time() - begun


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--rows", type=int, default=4096)
    rows = parser.parse_args().rows
    right, _ = walked(rows, "tsit5", 1e-13)
    print(f"{rows} rows\n{'rtol':>8s} {'method':8s} {'CPU s':>7s} {'of tsit5':>9s} {'error':>9s}")
    for tolerance in (1e-6, 1e-8, 1e-10, 1e-12):
        seconds = {}
        for method in METHODS:
            walked(rows, method, tolerance)
            ends, seconds[method] = walked(rows, method, tolerance)
            ratio = seconds[method] / seconds[METHODS[0]]
            error = np.abs(ends - right).max()
            print(
                f"{tolerance:8.0e} {method:8s} {seconds[method]:7.2f} {ratio:9.2f} {error:9.1e}", flush=True
            )


if __name__ == "__main__":
    main()
