"""Speed of the multi-legged model beside other programs, in one run: `python -m benchmarks.multilegged`.

Prints attempts (trajectory-steps) and gait cycles a second, and the error against the reference crossings in
tests/reference (solve_ivp, rtol 1e-11), for gaitsweep's engines and methods and for
 (a) the same algorithm written for this one model by hand: Numba, C with SIMD, CUDA where there is a device,
 (b) the same equations in plain NumPy over many lanes, events at the step's end and bisected,
 (c) one trajectory at a time with SciPy's solve_ivp, and with an exact propagator,
 (d) diffrax, restarted at each event (installed, or in the interpreter that DIFFRAX_PYTHON names),
then the seconds that two figures of the paper would take at the measured rate. Compilation stands apart.

`ratio` is cycles a second over those of the kernel engine with rk4. `of peak` is the share of the machine's
double-precision peak: attempts a second times the operations that an attempt takes in the kernel's own
program (of rk4 for what is written by hand, which may do with fewer); a multiply-add counts as two.
"""

from __future__ import annotations

import argparse
import math
import os
import sys

from . import engines, peak
from .rivals import general, written_by_hand
from .rivals.starts import Row

# Gait cycles that each figure takes: its starts, times the mean number of cycles until they settle.
FIGURES = {"Fig. 4, s": 25**3 * 55, "Fig. 5, s": 3 * 99 * 99 * 55}
HEAD = ("", "attempts/s", "cycles/s", "ratio", "error p95", "of peak", *FIGURES)
WIDTHS = (46, 10, 10, 8, 9, 7, *(9 for _ in FIGURES))


def main() -> None:
    options = argparse.ArgumentParser(
        prog="python -m benchmarks.multilegged",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    options.add_argument("--engines", nargs="+", choices=["xla", "kernel"], default=["xla", "kernel"])
    options.add_argument(
        "--lanes", type=int, nargs="+", default=[None], help="on each device; by default, the engine's own"
    )
    options.add_argument("--crossings", type=int, default=20, help="gait cycles a row")
    options.add_argument("--alone", action="store_true", help="leave all rivals out")
    options.add_argument("--quick", action="store_true", help="leave out the slow rivals, (b) to (d)")
    chosen = options.parse_args()

    load = os.getloadavg()[0]
    ours = engines.local_devices()
    gpu = peak.of_gpu() if ours[0].platform == "gpu" or not chosen.alone else None
    operations = {method: engines.operations(method) for method in engines.STEPS}
    # measured again after each row, since others may use the machine: the highest is the machine's
    peaks = [peak.of_cpu()]
    # each row with its operations an attempt (0: not counted) and the GPUs that it ran on (0: the CPU)
    rows: list[tuple[Row, int, int]] = []
    base = math.nan

    def add(row: Row, count: int = 0, gpus: int = 0) -> None:
        print(f"measured: {row['name']}: {row['cycles_per_second']:.4g} cycles/s", file=sys.stderr)
        rows.append((row, count, gpus))
        peaks.append(peak.of_cpu())

    for (engine, method), row in engines.measure_all(chosen.engines, chosen.lanes, chosen.crossings):
        add(row, operations[method], len(ours) if ours[0].platform == "gpu" else 0)
        if (engine, method) == ("kernel", "rk4") and math.isnan(base):
            base = row["cycles_per_second"]
    if not chosen.alone:
        for platform, row in written_by_hand(chosen.crossings):
            add(row, operations["rk4"], int(platform == "gpu"))
        for row in () if chosen.quick else general():
            add(row)

    cpu = max(peaks, key=lambda measured_peak: measured_peak.per_second)
    print(f"Load average before the run {load:.2f}. Peaks in double precision, 1e9 operations a second:")
    for machine in (cpu, gpu):
        if machine is not None:
            print(f"  {machine.per_second / 1e9:8.0f}  {machine.basis}")
    print(
        "Operations an attempt: " + ", ".join(f"{name} {count}" for name, count in operations.items()) + "\n"
    )
    print(laid_out(HEAD))
    for row, count, gpus in rows:
        whole = gpu.per_second * gpus if gpu and gpus else cpu.per_second
        share = row["steps_per_second"] * count / whole if count else math.nan
        print(laid_out(cells(row, share, base)))
    print()
    for row, _, _ in rows:
        print(f"{row['name']}: {row['note']}.")


def cells(row: Row, share: float, base: float) -> tuple[str, ...]:
    """A row's numbers as text."""
    rate = row["cycles_per_second"]
    values = [row["steps_per_second"], rate, rate / base, row["error_rad"]]
    seconds = [cycles / rate for cycles in FIGURES.values()]
    texts = [f"{value:.3g}" for value in values] + [f"{share:.1%}"] + [f"{value:.3g}" for value in seconds]
    return row["name"], *("-" if text.startswith("nan") else text for text in texts)


def laid_out(texts: tuple[str, ...]) -> str:
    name, *numbers = texts
    columns = [f"{text:>{width}s}" for text, width in zip(numbers, WIDTHS[1:], strict=True)]
    return f"{name:{WIDTHS[0]}s} " + " ".join(columns)


if __name__ == "__main__":
    main()
