"""Time of commands without their rows: imports, tracing, compilation, the self-check, the figure.

    python -m benchmarks.start_up [--repeat 5]

Each is a new process, and the medians are printed: seconds of the clock, and of CPU time on all cores. The
job is Fig. 4 of Ambe 2021 with 4 x 4 x 4 starts, whose rows take a tenth of a second. The model of `gs.sweep`
is a copy of the hopper of the examples, as a user's own; the last lines are calls in one session.
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
HOPPER = Path(__file__).parents[1] / "gaitsweep" / "examples" / "hopper.py"
SWEEP = """
import numpy as np, gaitsweep as gs
from own_hopper import Hopper
def sweep(): gs.sweep(Hopper(), launch_0=np.linspace(0.1, 8.0, 16), run=gs.Settle(max_cycles=400))
def simulate(): gs.simulate(Hopper(), launch_0=2.0, duration=2.0)
"""
WARM = """
import time
for call in (sweep, simulate):
    call()
    began, spent = time.perf_counter(), time.process_time()
    for _ in range(50): call()
    clock, spent = (time.perf_counter() - began) / 50, (time.process_time() - spent) / 50
    print(f"{clock:6.3f} s {spent:6.3f} s  gs.{call.__name__}, in a warm session")
"""


def environment_of(cache: Path) -> dict[str, str]:
    """The environment of a command with this cache, the user's model beside it, and bytecode."""
    paths = os.pathsep.join([str(cache.parent), os.environ.get("PYTHONPATH", "")])
    environment = {**os.environ, "GAITSWEEP_CACHE": str(cache), "PYTHONPATH": paths}
    environment.pop("PYTHONDONTWRITEBYTECODE", None)  # with it Python compiles all imports in each process
    environment.setdefault("PYTHONPYCACHEPREFIX", str(cache.parent / "bytecode"))
    return environment


def run(command: list[str], cache: Path) -> tuple[float, float]:
    """Seconds of the clock and of CPU time of a command."""
    before, began = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    environment = environment_of(cache)
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
        shutil.copy(HOPPER, Path(folder, "own_hopper.py"))
        sweeping = [sys.executable, "-c", f"{SWEEP}sweep()"]
        loading = [sys.executable, "-c", f"import gaitsweep as gs; gs.load({str(out)!r})"]
        # what is removed before each process: the result directory, and the caches too
        commands = {
            "gaitsweep run, nothing cached": (job, [out, cache]),
            "gaitsweep run, cached": (job, [out]),
            "gaitsweep run, of a complete job": (job, []),
            "gaitsweep run --dry-run": ([*job, "--dry-run"], []),
            "gaitsweep check": ([*GAITSWEEP, "check", str(JOB)], []),
            "gaitsweep plot": ([*GAITSWEEP, "plot", str(out)], []),
            "gaitsweep --help": ([*GAITSWEEP, "--help"], []),
            "gs.load": (loading, []),
            "first gs.sweep, of a new model": (sweeping, [cache]),
            "first gs.sweep, of a known model": (sweeping, []),
        }
        print("  clock    CPU")
        for name, (command, removed) in commands.items():
            results = []
            for _ in range(repeat):
                for values in removed:
                    shutil.rmtree(values, ignore_errors=True)
                results.append(run(command, cache))
            clock, spent = (statistics.median(values) for values in zip(*results, strict=True))
            print(f"{clock:5.1f} s {spent:5.1f} s  {name}", flush=True)
        subprocess.run([sys.executable, "-c", SWEEP + WARM], env=environment_of(cache), check=True)


if __name__ == "__main__":
    main()
