"""Time of commands without their rows: imports, tracing, compilation, the self-check, the figure.

    python -m benchmarks.start_up [--repeat 5]

Each is a new process, and the medians are printed: seconds of the clock, and of CPU time on all cores. The
job is Fig. 4 of Ambe 2021 with 4 x 4 x 4 starts, whose rows take a tenth of a second.
"""

from __future__ import annotations

import argparse
import os
import resource
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

JOB = Path(__file__).parents[1] / "sweeps" / "multilegged_solution_set.yaml"
FEW = [f"--set=vary.psi_{i}={{linspace: [0, 2*pi, 4], at: centre}}" for i in (1, 2, 3)]
GAITSWEEP = [sys.executable, "-m", "gaitsweep"]


def run(command: list[str], cache: Path) -> tuple[float, float]:
    """Seconds of the clock and of CPU time of a command."""
    before, began = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    environment = {**os.environ, "GAITSWEEP_CACHE": str(cache)}
    subprocess.run(command, env=environment, check=True, stdout=subprocess.DEVNULL)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    spent = after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime
    return time.perf_counter() - began, spent


def main() -> None:
    """Measure, and print a line each."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--repeat", type=int, default=5, help="processes of each command")
    repeat = parser.parse_args().repeat
    with tempfile.TemporaryDirectory() as folder:
        cache, out = Path(folder, "cache"), Path(folder, "out")
        job = [*GAITSWEEP, "run", str(JOB), *FEW, "--out", str(out)]
        loading = [sys.executable, "-c", f"import gaitsweep as gs; gs.load({str(out)!r})"]
        # what is removed before each process: the result directory, and the caches too
        commands = {
            "gaitsweep run, nothing cached": (job, [out, cache]),
            "gaitsweep run, cached": (job, [out]),
            "gaitsweep run, of a complete job": (job, []),
            "gaitsweep run --dry-run": ([*job, "--dry-run"], []),
            "gaitsweep plot": ([*GAITSWEEP, "plot", str(out)], []),
            "gaitsweep --help": ([*GAITSWEEP, "--help"], []),
            "gs.load": (loading, []),
        }
        print("  clock    CPU")
        for name, (command, removed) in commands.items():
            results = []
            for _ in range(repeat):
                for each in removed:
                    shutil.rmtree(each, ignore_errors=True)
                results.append(run(command, cache))
            clock, spent = (statistics.median(each) for each in zip(*results, strict=True))
            print(f"{clock:5.1f} s {spent:5.1f} s  {name}", flush=True)


if __name__ == "__main__":
    main()
