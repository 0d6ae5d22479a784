"""Whether a wrong model turns what the claims say of the papers: `python -m benchmarks.reliability.faults`.

Each fault is one plausible slip in a model (a sign, a factor 2, another pair of legs, another start), planted
in a copy of the package, in which `gaitsweep reproduce PAPER --quick` runs. Of the simulated claims that the
model as it is reproduces, some are drawn by seed, and the faults that turn each of them are printed. Exit
code 1 where none turns a claim. A claim that is `not run` in a copy counts as not turned.
"""

from __future__ import annotations

import argparse
import os
import random
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from queue import SimpleQueue
from typing import NamedTuple

import pandas as pd

from benchmarks.reliability.mutated_jobs import ROOT
from gaitsweep.claims.claims_and_verdicts import ClaimVerdict, Paper, known_papers, read_paper
from gaitsweep.errors import EXIT_FAILURE

CORES = 2  # of each run
MORE = 1.5  # claims that run for each that is drawn, since --quick does not reproduce all
COPIED = ("gaitsweep", "configs", "sweeps")
AS_IS = "as it is"


class Fault(NamedTuple):
    """A slip: `right` stands once in `file`, a path in gaitsweep/, and `wrong` takes its place."""

    name: str
    file: str
    right: str
    wrong: str

    def plant(self, tree: Path) -> None:
        """Change the file in a copy of the package.

        Raises:
            ValueError: the text does not stand there exactly once.
        """
        file = tree / "gaitsweep" / self.file
        text = file.read_text()
        if text.count(self.right) != 1:
            raise ValueError(
                f"{self.name}: {self.file} has {text.count(self.right)} times, not once: {self.right}"
            )
        file.write_text(text.replace(self.right, self.wrong))


_CHAIN, _THEORY = "papers/ambe2021/multilegged/", "papers/ambe2021/theory/"
_PLANAR, _WAIST = "papers/fukuoka2015/planar_quadruped/", "papers/aoi2011/waist_quadruped/"
FAULTS = {
    "ambe2021": (
        Fault("reset backwards", _CHAIN + "state.py",
              "(TWO_PI - phi) / tau", "(phi - TWO_PI) / tau"),
        Fault("springs doubled", _CHAIN + "forces.py",
              "pull = kappa * (x[:-1]", "pull = 2.0 * kappa * (x[:-1]"),
        Fault("swing doubled", _CHAIN + "state.py", "slope = p.a / (", "slope = 2.0 * p.a / ("),
        Fault("head as heavy as inner legs", _CHAIN + "parameters.py",
              '"mass of the head\'s segment", "m_B"', '"mass of the head\'s segment", "m"'),
        Fault("psi of the leg behind", _CHAIN + "model.py", "wrapped(state.phi[1:] - state.phi[:-1])",
              "wrapped(state.phi[:-1] - state.phi[1:])"),
        Fault("starts from the tail", _CHAIN + "model.py",
              '*(start[f"psi_{i}"] for i in range(1, self.N + 1))',
              '*(start[f"psi_{i}"] for i in range(self.N, 0, -1))'),
        Fault("contact on the longest leg", _CHAIN + "model.py", "gap = s.x - length\n", "gap = s.x - p.L\n"),
    ),
    "aoi2011": (
        Fault("waist twice as fast", _WAIST + "model.py", 'TWO_PI * v["f"]', '2.0 * TWO_PI * v["f"]'),
        Fault("no reset", _WAIST + "rhythm.py", "(p.resetting > 0.0)", "(p.resetting < 0.0)"),
        Fault("hind limbs in phase", _WAIST + "rhythm.py", "s.phi[3] - p.delta_star[\"34\"]", "s.phi[3]"),
        Fault("hind limbs' motors exchanged", _WAIST + "kinematics.py",
              "(7, 9, 12, 14), (8, 10, 13, 15)", "(7, 9, 14, 12), (8, 10, 15, 13)"),
        Fault("starts with the other limb ahead", _WAIST + "model.py",
              'params, start["delta_13"]', 'params, -start["delta_13"]'),
        Fault("stride doubled", _WAIST + "state.py", "D, h = self.D * grown", "D, h = 2.0 * self.D * grown"),
        Fault("hips half as stiff", _WAIST + "mechanics.py",
              "-self.kappa_1 * (q", "-0.5 * self.kappa_1 * (q"),
    ),
    "fukuoka2015": (
        Fault("load excites", "dynamics/matsuoka.py", "-hip - k2 * F", "-hip + k2 * F"),
        Fault("load of the other leg", _PLANAR + "model.py", "stepped(s.u, s.f, theta, s.load, dt)",
              "stepped(s.u, s.f, theta, s.load[np.array([1, 0, 3, 2])], dt)"),
        Fault("hip's feedback, a sign", "dynamics/matsuoka.py", "hip = k1 * (theta - theta0)",
              "hip = -k1 * (theta - theta0)"),
        Fault("diagonal legs inhibit", _PLANAR + "rhythm.py",
              'LEGS.index("RF")), (LEGS.index("LH"), LEGS.index("RH"))',
              'LEGS.index("RH")), (LEGS.index("LH"), LEGS.index("RF"))'),
        Fault("rhythm half as fast", "dynamics/matsuoka.py",
              "/ Tr, (-f + y) / Ta", "/ (2.0 * Tr), (-f + y) / (2.0 * Ta)"),
        Fault("hips twice as stiff", _PLANAR + "rhythm.py",
              "self.Kp_hip_st * (self.theta_st", "2.0 * self.Kp_hip_st * (self.theta_st"),
        Fault("fore and hind hips exchanged", _PLANAR + "mechanics.py",
              'leg.endswith("F")', 'leg.endswith("H")'),
        Fault("slow half of the path from its other end", _PLANAR + "parameters.py",
              '"min(sigma, 0.5)"', '"min(1 - sigma, 0.5)"'),
        Fault("pitch, a sign", _PLANAR + "observables.py", '"pitch": s.q[PITCH]', '"pitch": -s.q[PITCH]'),
    ),
}  # fmt: skip


def candidates(paper: Paper, seed: int) -> list[str]:
    """Names of the claims that a simulation could turn and `--quick` judges, in an order drawn by seed."""
    quick = [judged for claim in paper.claims if (judged := claim.as_quick()) is not None]
    chosen = [
        claim.id
        for claim in quick
        if claim.of
        and not (claim.definition or claim.asked)
        and all(paper.jobs[name].quick is not False for name in claim.of)
    ]
    return random.Random(f"{seed} {paper.name}").sample(chosen, len(chosen))


def verdicts(
    paper: str, fault: Fault | None, claims: Sequence[str], folder: Path, cores: set[int]
) -> dict[str, str]:
    """The verdict of each claim in a copy of the package, with a fault or as it is; `not run` if that fails.

    A run that was stopped goes on in the same folder.
    """
    tree, out = folder / "tree", folder / "results"
    shutil.rmtree(tree, ignore_errors=True)
    (out / "claims.parquet").unlink(missing_ok=True)
    for name in COPIED:
        shutil.copytree(ROOT / name, tree / name, ignore=shutil.ignore_patterns("__pycache__"))
    if fault is not None:
        fault.plant(tree)
    others = [entry for entry in os.environ.get("PYTHONPATH", "").split(os.pathsep) if entry]
    path = os.pathsep.join([str(tree), *(other for other in others if Path(other).resolve() != ROOT)])
    place = {**os.environ, "PYTHONPATH": path, "GAITSWEEP_CACHE": str(folder / "cache")}
    command = [sys.executable, "-m", "gaitsweep", "reproduce", paper, "--quick"]
    command += ["--claims", ",".join(claims), "--out", str(out)]
    if cores and hasattr(os, "sched_setaffinity"):
        command = [sys.executable, "-c", _ON_CORES, ",".join(map(str, cores)), *command]
    with (folder / "log").open("w") as log:
        code = subprocess.run(command, stdout=log, stderr=log, cwd=folder, env=place, check=False).returncode
    table = out / "claims.parquet"
    if code not in (0, EXIT_FAILURE) or not table.is_file():
        print(f"{folder.name}: {(folder / 'log').read_text()[-3000:]}", file=sys.stderr)
        return dict.fromkeys(claims, ClaimVerdict.not_run)
    result = pd.read_parquet(table)
    return dict(zip(result["id"], result["verdict"], strict=True))


# the cores are set in a process of its own, before JAX counts them; with threads here, no fork may run Python
_ON_CORES = (
    "import os, sys; os.sched_setaffinity(0, map(int, sys.argv[1].split(','))); "
    "os.execv(sys.argv[2], sys.argv[2:])"
)


def table(
    drawn: Sequence[str], verdicts_of_runs: dict[str, dict[str, str]]
) -> tuple[str, list[str], list[str]]:
    """A line a claim with the faults that turn it; the claims that only become open; those of no fault."""
    lines, only_open, never = [], [], []
    for claim in drawn:
        turned = {name: verdicts_of_claims[claim] for name, verdicts_of_claims in verdicts_of_runs.items()}
        turned = {
            name: verdict
            for name, verdict in turned.items()
            if verdict not in (ClaimVerdict.reproduced, ClaimVerdict.not_run)
        }
        if not turned:
            never.append(claim)
        elif set(turned.values()) == {ClaimVerdict.open_constants}:
            only_open.append(claim)
        faults = ", ".join(turned) or "NONE"
        lines.append(f"  {claim:<34}{len(turned):>2} of {len(verdicts_of_runs)}: {faults}")
    return "\n".join(lines), only_open, never


def main(arguments: Sequence[str] | None = None) -> int:
    """Plant, run, print, and give 1 where a drawn claim is turned by no fault."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", 1)[0])
    parser.add_argument(
        "papers", nargs="*", metavar="PAPER", help=f"of {', '.join(known_papers())}; else all"
    )
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--claims", type=int, default=20, help="claims drawn from each paper")
    names = [fault.name for value in FAULTS.values() for fault in value]
    parser.add_argument("--fault", action="append", choices=names, help="one of them; may be repeated")
    parser.add_argument("--workers", type=int, help=f"runs at a time; else one for {CORES} cores")
    parser.add_argument(
        "--out", type=Path, help="folder of the copies and their results; else a temporary one"
    )
    options = parser.parse_args(arguments)
    began = time.perf_counter()
    with tempfile.TemporaryDirectory() as name:
        turned = _measured(options.papers or list(FAULTS), options, options.out or Path(name))
    print(f"{time.perf_counter() - began:.0f} s in all")
    return int(not all(turned))


def _measured(papers: Sequence[str], options: argparse.Namespace, folder: Path) -> list[bool]:
    """Whether each paper's drawn claims are turned, after all runs."""
    cores = sorted(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else []
    workers = options.workers or max(len(cores) // CORES, 1)
    free: SimpleQueue[set[int]] = SimpleQueue()
    for i in range(workers):
        free.put(set(cores[i::workers]))
    order = {paper: candidates(read_paper(paper), options.seed) for paper in papers}

    def run(paper: str, fault: Fault | None) -> dict[str, str]:
        name = fault.name if fault else AS_IS
        place = folder.resolve() / paper / name.replace(" ", "_").replace("'", "")
        place.mkdir(parents=True, exist_ok=True)
        own_cores, began = free.get(), time.perf_counter()
        try:
            return verdicts(paper, fault, order[paper][: int(MORE * options.claims)], place, own_cores)
        finally:
            free.put(own_cores)
            print(f"{paper}, {name}: {time.perf_counter() - began:.0f} s", file=sys.stderr, flush=True)

    with ThreadPoolExecutor(workers) as pool:
        runs = {
            paper: {
                fault.name if fault else AS_IS: pool.submit(run, paper, fault)
                for fault in (None, *FAULTS[paper])
                if fault is None or options.fault is None or fault.name in options.fault
            }
            for paper in papers
        }
    return [
        _report(paper, {name: future.result() for name, future in of.items()}, order[paper], options.claims)
        for paper, of in runs.items()
    ]


def _report(
    paper: str, verdicts_of_runs: dict[str, dict[str, str]], order: Sequence[str], claims: int
) -> bool:
    """Print what became of a paper's claims; whether enough were drawn and a fault turns each."""
    as_is = verdicts_of_runs.pop(AS_IS)
    good = [claim for claim in order if as_is.get(claim) == ClaimVerdict.reproduced]
    drawn = good[:claims]
    lines, only_open, never = table(drawn, verdicts_of_runs)
    print(
        f"\n{paper}: {len(drawn)} claims of {len(order)} that a simulation could turn, "
        f"{len(verdicts_of_runs)} faults\n{lines}"
    )
    for words, names in (("turned only to open", only_open), ("turned by no fault", never)):
        print(f"  {words}: {', '.join(names) or 'none'}")
    for name, verdicts_of_claims in verdicts_of_runs.items():
        as_before = (ClaimVerdict.reproduced, ClaimVerdict.not_run)
        turned = [claim for claim in drawn if verdicts_of_claims[claim] not in as_before]
        print(f"  {name} turns {len(turned)}")
    return len(drawn) == claims and not never


if __name__ == "__main__":
    sys.exit(main())
