"""Speed of whole commands on the devices of this machine: `python -m benchmarks.sweeps`.

On a CPU: `gaitsweep run` of starts of the chain that settle, as many for each core, on 1, 2, 4, ... cores,
beside C written by hand on as many threads. On NVIDIA GPUs: 128 x 128 x 128 starts on one and on all of them,
beside the kernel alone. Then Fig. 4 of Ambe et al. 2021 with its figure and its self-check, from the shell to
the prompt. Every command runs twice, and the faster run counts: the first compiles.

`attempts/s` are those of the rows, without the start of the command; `whole` is the command in seconds.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

JOB = Path(__file__).parents[1] / "sweeps" / "multilegged_solution_set.yaml"
# Starts of one core, in planes of 25 x 25: about ten seconds.
PLANES_A_CORE = 5
# Points of each phase on a GPU.
POINTS_ON_A_CARD = 128
_C_BY_HAND = """
from benchmarks.rivals import c_simd
print(c_simd.measure(lanes={lanes}, crossings=20)["steps_per_second"])
"""
_ALONE = """
import jax
jax.config.update("jax_enable_x64", True)
from benchmarks.card_alone import SETTLING, measure
print(measure(SETTLING).rate)
"""


class Command(NamedTuple):
    """Attempts a second of the rows, and seconds of the whole command."""

    rate: float
    whole: float


def main() -> None:
    options = argparse.ArgumentParser(
        prog="python -m benchmarks.sweeps",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    options.add_argument("--platform", choices=["cpu", "cuda"], default=["cpu"], nargs="+")
    options.add_argument("--cores", type=int, nargs="+", help="by default 1, 2, 4, ... and all")
    chosen = options.parse_args()
    if "cpu" in chosen.platform:
        on_cores(chosen.cores or _doubled(len(os.sched_getaffinity(0))))
    if "cuda" in chosen.platform:
        on_cards()


def on_cores(counts: list[int]) -> None:
    """The lines of a CPU."""
    print(f"{'cores':>6} {'attempts/s':>11} {'times':>6} {'C by hand':>11} {'times':>6} {'whole, s':>9}")
    first: tuple[float, float] | None = None
    for cores in counts:
        ours = settled("cpu", cores, (25, 25, PLANES_A_CORE * cores))
        rival = _number(_C_BY_HAND.format(lanes=2048 * cores), {"OMP_NUM_THREADS": str(cores)})
        first = first or (ours.rate, rival)
        print(
            f"{cores:6} {ours.rate:11.3g} {ours.rate / first[0]:6.2f} {rival:11.3g} "
            f"{rival / first[1]:6.2f} {ours.whole:9.1f}",
            flush=True,
        )
    print(f"Fig. 4, whole command, {counts[-1]} cores: {whole_figure('cpu'):.1f} s")


def on_cards() -> None:
    """The lines of NVIDIA GPUs."""
    n = POINTS_ON_A_CARD
    alone, all_cards = _number(_ALONE), int(_number("import jax; print(len(jax.devices('gpu')))"))
    print(f"kernel alone, one GPU: {alone:.3g} attempts/s")
    print(f"{'GPUs':>6} {'attempts/s':>11} {'times':>6} {'of alone':>9} {'whole, s':>9}")
    first: float | None = None
    for cards in sorted({1, all_cards}):
        ours = settled("cuda", cards, (n, n, n))
        first = first or ours.rate
        share = ours.rate / (alone * cards)
        print(
            f"{cards:6} {ours.rate:11.3g} {ours.rate / first:6.2f} {share:9.2f} {ours.whole:9.1f}", flush=True
        )
    print(f"Fig. 4, whole command, one GPU: {whole_figure('cuda'):.1f} s")


def settled(platform: str, devices: int, points: tuple[int, int, int]) -> Command:
    """The command that lets so many starts settle, without self-check and figure."""
    phases = [f"vary.psi_{i}={{linspace: [0, 2*pi, {n}], at: centre}}" for i, n in enumerate(points, start=1)]
    return _run(platform, [f"engine.devices={devices}", "figures=[]", "verify=0", *phases])


def whole_figure(platform: str) -> float:
    """Seconds of the command that makes Fig. 4."""
    return _run(platform, []).whole


def _run(platform: str, arguments: list[str]) -> Command:
    """The faster of two runs of the job with these fields."""
    runs = []
    for _ in range(2):
        with tempfile.TemporaryDirectory() as folder:
            fields = [word for field in arguments for word in ("--set", field)]
            command = [sys.executable, "-m", "gaitsweep", "run", str(JOB), "--out", f"{folder}/run", *fields]
            began = time.perf_counter()
            environment = os.environ | {"JAX_PLATFORMS": "cpu" if platform == "cpu" else f"{platform},cpu"}
            environment.pop("PYTHONDONTWRITEBYTECODE", None)  # with it, Python compiles all modules each time
            done = subprocess.run(command, env=environment, capture_output=True)
            whole = time.perf_counter() - began
            if done.returncode:
                sys.exit(done.stderr.decode())
            timings = json.loads(Path(folder, "run", "manifest.json").read_text())["timings"]
            runs.append(Command(timings["attempts"] / timings["run_s"], whole))
    return Command(max(run.rate for run in runs), min(run.whole for run in runs))


def _number(program: str, environment: dict[str, str] | None = None) -> float:
    """The number that a program of this folder prints."""
    command = [sys.executable, "-c", program]
    done = subprocess.run(
        command, cwd=JOB.parents[1], env=os.environ | (environment or {}), capture_output=True, text=True
    )
    if done.returncode:
        sys.exit(done.stderr)
    return float(done.stdout.split()[-1])


def _doubled(most: int) -> list[int]:
    """1, 2, 4, ... and the largest number."""
    powers = [2**i for i in range(most.bit_length())]
    return sorted({*(p for p in powers if p < most), most})


if __name__ == "__main__":
    main()
