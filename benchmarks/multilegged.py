"""How fast the multi-legged model runs, side by side in one run: `python -m benchmarks.multilegged`.

Prints a table of trajectory-steps per second and gait cycles per second at the error measured against the
reference crossings in tests/reference (solve_ivp, rtol 1e-11), for gaitsweep and for
 (a) the same equations in plain NumPy over many lanes, events at the step's end and bisected,
 (b) one trajectory at a time with SciPy's solve_ivp, and with an exact propagator,
 (c) diffrax, restarted at each event (installed, or in the interpreter that DIFFRAX_PYTHON names),
then the seconds that each figure of the paper would take at the measured rate. Compilation stands apart.
"""

from __future__ import annotations

import argparse
import math

from .engines import measure
from .rivals import measure_all
from .rivals.starts import Row

# Gait cycles that each figure takes: its starts, times the mean number of cycles until they settle.
FIGURES = {
    "quick_basins (300 starts)": 300 * 56,
    "Fig. 4 (25^3 starts)": 25**3 * 55,
    "Fig. 5 (3 x 99 x 99 starts)": 3 * 99 * 99 * 55,
}


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    options.add_argument("--lanes", type=int, nargs="+", default=[256], help="lanes a device to measure")
    options.add_argument("--dt", type=float, nargs="+", default=[4e-3, 2e-3], help="steps, s")
    options.add_argument("--crossings", type=int, default=5, help="gait cycles a start")
    options.add_argument("--alone", action="store_true", help="leave the rivals out")
    chosen = options.parse_args()
    show(None)
    best: tuple[Row, float] | None = None
    for lanes in chosen.lanes:
        for dt in chosen.dt:
            row, compile_s = measure(lanes, chosen.crossings, dt)
            show(row)
            if best is None or row["cycles_per_second"] > best[0]["cycles_per_second"]:
                best = row, compile_s
    assert best is not None
    if not chosen.alone:
        for row in measure_all():
            show(row, best[0])
    print(
        f"\nA first run compiles for {best[1]:.1f} s; then, at {best[0]['cycles_per_second']:.0f} cycles/s:"
    )
    for figure, cycles in FIGURES.items():
        print(f"  {figure:30s} {cycles / best[0]['cycles_per_second']:10.0f} s")


def show(row: Row | None, best: Row | None = None) -> None:
    """Print a line of the table; its head where there is no row."""
    if row is None:
        print(f"{'':46s} {'steps/s':>9s} {'cycles/s':>9s} {'ratio':>7s} {'error':>8s}")
        return
    ratio = best["cycles_per_second"] / row["cycles_per_second"] if best is not None else 1.0
    numbers = [row["steps_per_second"], row["cycles_per_second"], ratio, row["error_rad"]]
    cells = ["-" if math.isnan(value) else f"{value:.3g}" for value in numbers]
    print(
        f"{row['name']:46s} {cells[0]:>9s} {cells[1]:>9s} {cells[2]:>7s} {cells[3]:>8s}  {row['note']}",
        flush=True,
    )


if __name__ == "__main__":
    main()
