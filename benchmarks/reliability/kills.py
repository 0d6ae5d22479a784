"""Kills of working runs of every kind: `python -m benchmarks.reliability.kills`.

Each run is a process of the command line, which is sent SIGKILL, SIGINT or SIGTERM at a random moment of its
working phase, twice, and then let come to its end. Its table has to be equal to the bit to that of
a run that nobody stopped, its manifest complete. A row that had ended 5 s before a SIGKILL, and every row
that had ended before a SIGINT or SIGTERM, has to be on disk. What fails is printed, and the exit code is 1.
"""

from __future__ import annotations

import argparse
import collections
import dataclasses
import math
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import yaml

import gaitsweep as gs
from gaitsweep.engine.sweep.sweep import SAFE_WITHIN
from gaitsweep.table import Snapshot, TableError

ROOT = Path(__file__).resolve().parents[2]
OWN_MODULES = str(ROOT), str(ROOT / "tests" / "support" / "models")
SIGNALS = (signal.SIGKILL, signal.SIGKILL, signal.SIGTERM, signal.SIGINT)
EXIT = {signal.SIGINT: 130, signal.SIGTERM: 143, signal.SIGKILL: -9}

# Masses that bounce on springs, a landscape with two basins; all in
# tests/support/models; steps far too short, so that few rows take long. Blocks: of all rows, of some, few.
RUNS: dict[str, tuple[dict[str, Any], int, int, float]] = {  # run, rows, block, step (s)
    "settle": ({"kind": "settle", "max_cycles": 400, "tolerance": 1e-9}, 300, 100_000, 2.0e-5),
    "fixed_time": ({"kind": "fixed_time", "duration": 100.0}, 300, 128, 4.0e-5),
    "return_map": ({"kind": "return_map", "crossings": 60}, 300, 1000, 3.0e-5),
    "ramp": ({"kind": "ramp", "parameter": "mass", "path": [1, 2, 1], "rate": 0.02}, 300, 150, 4.0e-5),
    "staircase": (
        {"kind": "staircase", "parameter": "mass", "path": [1, 2], "step": 0.1, "dwell": 10.0},
        300,
        1000,
        4.0e-5,
    ),
    "trace": ({"kind": "trace", "duration": 100.0, "every": 0.5}, 300, 1000, 4.0e-5),
    "refine": ({"kind": "settle", "max_cycles": 60, "refine": "boundary"}, 0, 300, 1.2e-4),
    "continuation": (
        {
            "kind": "continuation",
            "parameter": "stiffness",
            "path": [2, 8],
            "settle": 20,
            "step": 0.02,
            "longest": 0.03,
        },
        8,
        2,
        1.0e-3,
    ),
}
KILLS_A_TABLE = 2
UNCOUNTED = ("refine", "continuation")  # whose progress does not count rows that have ended


def job_of(kind: str) -> dict[str, Any]:
    """The job file of a kind of run."""
    run, rows, block, step = RUNS[kind]
    if kind == "refine":
        angle = {"linspace": [0, "2*pi", 48], "at": "centre"}
        model = {"model": "landscape_model:Landscape"}
        vary: dict[str, Any] = {"theta_2": angle, "shift": [0.3, 2.0], "theta_1": angle}
    else:
        model = {"model": "toy_model:Toy", "params": {"restitution": 0.6}}
        vary = {"launch_1": {"linspace": [0.2, 3.0, rows]}}
    return {
        "name": kind,
        **model,
        "vary": vary,
        "run": run,
        "numerics": {"method": "rk4", "dt": step},
        "verify": 4,
        "engine": {"block": block, "lanes": 16, "devices": 1},
    }


WORKER = """
import sys, time
import gaitsweep.runs.execute
run_job = gaitsweep.runs.execute.run_job

def logged(job, out, *, on_progress, **options):
    def both(done, total, rate, fraction, note):
        if note != "compiling":
            print(time.monotonic(), done, flush=True)
        on_progress(done, total, rate, fraction, note)
    return run_job(job, out, on_progress=both, **options)

gaitsweep.runs.execute.run_job = logged
from gaitsweep.cli.main import main
sys.exit(main(["run", *sys.argv[1:]]))
"""


class Run:
    """A run of the command line in a process of its own, which says how many rows have ended, and when."""

    def __init__(self, job_file: Path, out: Path) -> None:
        self.process = subprocess.Popen(
            [sys.executable, "-c", WORKER, str(job_file), "--out", str(out)],
            env={
                **os.environ,
                "PYTHONPATH": os.pathsep.join([*OWN_MODULES, os.environ.get("PYTHONPATH", "")]),
                "JAX_PLATFORMS": "cpu",
            },
            text=True,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
        )
        self.reports: list[tuple[float, int]] = []  # s, rows
        self.errors = ""
        self.working = threading.Event()  # or ended
        self._readers = [threading.Thread(target=read, daemon=True) for read in (self._read, self._complain)]
        for reader in self._readers:
            reader.start()

    def _read(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            words = line.split()
            if len(words) == 2 and words[1].isdigit():
                self.reports.append((float(words[0]), int(words[1])))
                self.working.set()
        self.working.set()

    def _complain(self) -> None:
        assert self.process.stderr is not None
        self.errors = self.process.stderr.read()

    def ended(self, within: float) -> int:
        """Wait for its end; the exit code."""
        code = self.process.wait(timeout=within)
        for reader in self._readers:
            reader.join()
        return code


@dataclasses.dataclass
class Tally:
    """Results of the runs of one kind."""

    kills: int = 0
    late: int = 0  # runs that had ended when the signal came
    tables: int = 0  # compared
    oldest: float = 0.0  # s that the oldest row that a SIGKILL lost had been finished for
    faults: list[str] = dataclasses.field(default_factory=list)


def strike(kind: str, kills: int, folder: Path, seed: int) -> Tally:
    """Stop a kind's runs that many times, let each come to its end, and compare."""
    random = np.random.default_rng(seed)
    tally = Tally()
    job_file = folder / f"{kind}.yaml"
    job_file.write_text(yaml.safe_dump(job_of(kind), sort_keys=False))
    whole = Run(job_file, folder / f"{kind}-whole")
    if whole.ended(600) != 0:
        tally.faults.append(f"the run that nobody stopped failed: {whole.errors[-400:]}")
        return tally
    (first, _), (last_report, total) = whole.reports[0], whole.reports[-1]
    expected = gs.load(folder / f"{kind}-whole")
    attempt = 0
    while tally.kills < kills and tally.late < 2 * kills + 5:
        out = folder / f"{kind}-{attempt}"
        attempt += 1
        code, struck_here = -1, 0
        # not more often, or most strikes would fall on what little is left
        while code != 0 and struck_here < KILLS_A_TABLE and tally.kills < kills:
            sent = SIGNALS[int(random.integers(len(SIGNALS)))]
            run = Run(job_file, out)
            run.working.wait(300)
            left = 1.0 - run.reports[0][1] / total if run.reports else 0.0
            time.sleep(float(random.uniform(0.0, 0.9 * left * (last_report - first))))
            struck = time.monotonic()
            run.process.send_signal(sent)
            code = run.ended(300)
            # at the very end, when all is done, Python's own ways with these two signals are back
            if code == 0 or (sent != signal.SIGKILL and code == -sent and _is_done(out)):
                tally.late += 1
                code = 0
                continue
            tally.kills += 1
            struck_here += 1
            if code != EXIT[sent]:
                tally.faults.append(f"{sent.name} gave exit code {code}: {run.errors[-400:]}")
            _check_loss(kind, run, out, sent, struck, tally)
        if code != 0:
            last = Run(job_file, out)
            if last.ended(600) != 0:
                tally.faults.append(f"the run did not come to its end: {last.errors[-400:]}")
                continue
        _compare(out, expected, tally)
    return tally


def _is_done(out: Path) -> bool:
    try:
        manifest = Snapshot.of(out).manifest
        return manifest.get("complete", False) and "self_check" in manifest
    except TableError:
        return False


def _check_loss(kind: str, run: Run, out: Path, sent: signal.Signals, struck: float, tally: Tally) -> None:
    if kind in UNCOUNTED or not run.reports:
        return
    try:
        safe = Snapshot.of(out).rows_safe
    except TableError as error:
        tally.faults.append(f"after {sent.name}: {error}")
        return
    lost = [at for at, rows in run.reports if rows > safe]
    if sent == signal.SIGKILL:
        age = struck - min(lost) if lost else 0.0
        tally.oldest = max(tally.oldest, age)
        if age > SAFE_WITHIN:
            tally.faults.append(f"SIGKILL lost rows that had ended {age:.2f} s before")
    elif lost:
        tally.faults.append(f"{sent.name} lost rows: {safe} are safe, {run.reports[-1][1]} had ended")
    elif f"{safe} of" not in run.errors:
        tally.faults.append(f"{sent.name} does not say that {safe} rows are safe: {run.errors[-200:]}")


def _compare(out: Path, expected: pd.DataFrame, tally: Tally) -> None:
    tally.tables += 1
    try:
        table = gs.load(out)
        pd.testing.assert_frame_equal(table, expected, check_exact=True)
    except (TableError, AssertionError) as error:
        tally.faults.append(f"{out.name}: {str(error)[:300]}")
        return
    manifest, whole = table.attrs["manifest"], expected.attrs["manifest"]
    for name in ("complete", "counts", "gaits", "quantities", "refinement", "self_check"):
        if manifest.get(name) != whole.get(name):
            tally.faults.append(f"{out.name}: the manifest's {name} is {manifest.get(name)}")
    if missing := whole.keys() - manifest.keys():
        tally.faults.append(f"{out.name}: the manifest lacks {', '.join(sorted(missing))}")
    if left := [file.name for file in out.rglob("open-*")]:
        tally.faults.append(f"{out.name}: {', '.join(left)} were left")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kills", type=int, default=60)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--kinds", nargs="*", default=list(RUNS), choices=list(RUNS))
    parser.add_argument("--at-once", type=int, default=2, help="processes at once")
    options = parser.parse_args()
    share = collections.Counter(options.kinds[i % len(options.kinds)] for i in range(options.kills))
    began = time.monotonic()
    with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(options.at_once) as threads:
        runs = {
            kind: threads.submit(strike, kind, share[kind], Path(folder), options.seed + i)
            for i, kind in enumerate(options.kinds)
        }
        print(f"{'kind':<14}{'kills':>7}{'too late':>10}{'tables':>8}{'oldest lost row, s':>20}{'faults':>8}")
        for kind, future in runs.items():
            result = future.result()
            oldest = math.nan if kind in UNCOUNTED else result.oldest
            numbers = (
                f"{result.kills:>7}{result.late:>10}{result.tables:>8}{oldest:>20.2f}{len(result.faults):>8}"
            )
            print(f"{kind:<14}{numbers}", flush=True)
            for fault in result.faults:
                print(f"  {fault}", file=sys.stderr)
    done = [future.result() for future in runs.values()]
    kills, faults = sum(one.kills for one in done), sum(len(one.faults) for one in done)
    print(f"{kills} kills in {time.monotonic() - began:.0f} s, {faults} faults")
    return 1 if faults or kills < options.kills else 0


if __name__ == "__main__":
    sys.exit(main())
