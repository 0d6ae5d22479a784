"""Memory of large jobs of the reduced chain, and of their tables and figures.

    python -m benchmarks.memory

For 1e8 rows: `--dry-run`, then a made-up table of so many rows, whose records repeat those of a small run:
its writing, its figure and its loading. The job is `sweeps/multilegged_reduced_basins.yaml` over a finer
grid of starts. The table takes 6 GB in the temporary folder (TMPDIR) and is removed at the end.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import resource
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

JOB = Path(__file__).parents[1] / "sweeps" / "multilegged_reduced_basins.yaml"
PANELS = 3  # values of psi_3


def overrides(points: int) -> list[str]:
    """The settings of the job over `points` values of psi_1 and of psi_2."""
    axis = f"{{linspace: [0, 2*pi, {points}], at: centre}}"
    return [f"vary.psi_1={axis}", f"vary.psi_2={axis}", "engine.block=auto"]


def make_up(path: Path, template: Path, points: int) -> None:
    """Write the directory of a finer grid, with the records of another run over and over."""
    import gaitsweep as gs
    from gaitsweep.job import load_job
    from gaitsweep.runs.prepare import prepare
    from gaitsweep.runs.summary import describe, sum_up
    from gaitsweep.table import ResultDirectory

    context = prepare(load_job(JOB, overrides(points)))
    records = gs.load(template)
    with ResultDirectory.open(path, context.job.resolved(engine=context.engine), context.layout) as directory:
        describe(context, directory)
        for number in directory.missing_blocks():
            first, last = directory.layout.rows_of(number)
            frame = records.iloc[np.arange(first, last) % len(records)].reset_index(drop=True)
            rows = np.arange(first, last)
            frame = frame.assign(row=rows, **context.design.at(rows, context.design.names))
            directory.write_part(number, frame)
        sum_up(context, directory, {})


def load(path: Path, columns: list[str] | None, rows: slice | None) -> None:
    """Load a table as a notebook does."""
    import gaitsweep as gs

    gs.load(path, columns, rows)


def command(*words: object) -> None:
    """Run the command `gaitsweep`."""
    from gaitsweep.cli import main

    if main([str(word) for word in words]) != 0:
        raise SystemExit(1)


def measured(name: str, spec: Callable[..., None], *arguments: object) -> None:
    """Print the largest memory (MB) and the time (s) of a process that does nothing else."""
    began = time.perf_counter()
    process = multiprocessing.get_context("spawn").Process(target=_alone, args=(spec, arguments))
    process.start()
    process.join()
    seconds = time.perf_counter() - began
    if process.exitcode:
        raise SystemExit(f"{name}: exit code {process.exitcode}")
    print(f"    {name}: {seconds:.1f} s", flush=True)


def _alone(spec: Callable[..., None], arguments: tuple[object, ...]) -> None:
    sys.stdout.flush()
    with open(os.devnull, "w") as nowhere:
        out, sys.stdout = sys.stdout, nowhere
        spec(*arguments)
        sys.stdout = out
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / (2**20 if sys.platform == "darwin" else 2**10)
    print(f"{peak:8.0f} MB", end="", flush=True)


def main() -> None:
    """Measure, and print a line each."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--points", type=int, default=5774, help="values of psi_1, and of psi_2")
    points = parser.parse_args().points
    settings = [word for override in overrides(points) for word in ("--set", override)]
    rows = PANELS * points**2
    print(f"{rows:.3g} rows: {PANELS} x {points} x {points} starts")
    with tempfile.TemporaryDirectory() as folder:
        small, large = Path(folder, "small"), Path(folder, "large")
        measured("gaitsweep run --dry-run", command, "run", JOB, "--dry-run", *settings)
        measured("gaitsweep run, 29 403 rows", command, "run", JOB, "--out", small)
        measured("the made-up table written and summed up", make_up, large, small, points)
        measured("gaitsweep plot", command, "plot", large)
        measured("gaitsweep info", command, "info", large)
        measured('gs.load(DIR, columns=["gait"])', load, large, ["gait"], None)
        measured('gs.load(DIR, columns=["psi_1_end"])', load, large, ["psi_1_end"], None)
        measured("gs.load(DIR, rows=slice(0, None, 100))", load, large, None, slice(0, None, 100))


if __name__ == "__main__":
    main()
