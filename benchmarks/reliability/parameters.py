"""Are a model's own numerics right over random parameters? `python -m benchmarks.reliability.parameters`.

Each random set runs with `numerics` left out and by an integrator that shares neither physics nor events with
gaitsweep; compared are status and observables at a crossing of the section. The guarantee: no set is silently
wrong by more than 1e-2 rad, and at most 1 % are lost where the independent integrator is sound. Sets on which
the independent integrator does not agree with itself, from a start moved by 1e-9 and at a finer tolerance,
are `sensitive`: counted apart and listed. Exit code 1 where the guarantee fails.

The planar quadruped is defined by its steps of 1 ms, which the independent integrator takes too; `--finer 8`
says besides how far it is from itself at an eighth of them.
"""

from __future__ import annotations

import argparse
import math
import os
import sys
import time
from collections.abc import Callable
from typing import Any

# one thread for each process: the matrices are small
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
import yaml

from . import multilegged_sets, planar_quadruped_sets, waist_quadruped_sets
from .comparison import LOST, SENSITIVE, SOUND, WRONG, Verdict, compared, counts, holds, references
from .parameter_sets import Subject

SUBJECTS: dict[str, tuple[Callable[[int], Subject], int]] = {
    "multilegged": (multilegged_sets.subject, 640),
    "waist_quadruped": (waist_quadruped_sets.subject, 100),
    "planar_quadruped": (planar_quadruped_sets.subject, 100),
}


def table(verdicts: list[Verdict]) -> str:
    """The counts and the errors of the sets that are sound or wrong, as lines of text."""
    result = counts(verdicts)
    errors = [v.apart for v in verdicts if v.outcome in (SOUND, WRONG) and not math.isnan(v.apart)]
    fell = sum(v.outcome == SOUND and v.theirs.status == "fell" for v in verdicts)
    lines = [
        ("sets", f"{len(verdicts)}"),
        ("agree", f"{result[SOUND]}, of which {fell} fall in both"),
        ("silently wrong by more than 1e-2 rad, or in the status", f"{result[WRONG]}"),
        ("lost where the independent integrator is sound", f"{result[LOST]}"),
        ("sensitive: the independent integrator disagrees with itself", f"{result[SENSITIVE]}"),
        ("the independent integrator failed", f"{result['unknown']}"),
    ]
    if errors:
        shares = np.percentile(errors, [50, 95, 100])
        lines.append(("error, rad: median, 95 %, largest", ", ".join(f"{e:.1e}" for e in shares)))
    return "\n".join(f"  {name:62s} {text}" for name, text in lines)


def listed(verdicts: list[Verdict], most: int = 12) -> str:
    """The sets that are not sound, with their values."""
    lines = []
    for outcome in (WRONG, LOST, SENSITIVE):
        chosen = [(i, v) for i, v in enumerate(verdicts) if v.outcome == outcome]
        for i, v in chosen[:most]:
            values = ", ".join(f"{name} {value:.5g}" for name, value in v.values.items())
            lines.append(
                f"  {outcome} {i}: ours {v.ours.status}, theirs {v.theirs.status}, apart {v.apart:.2g} rad, "
                f"theirs from themselves {v.unsure:.2g}; {values}"
            )
        if len(chosen) > most:
            lines.append(f"  {outcome}: {len(chosen) - most} more")
    return "\n".join(lines)


def finer(subject: Callable[[int], Subject], verdicts: list[Verdict], chosen: argparse.Namespace) -> str:
    """Differences of the independent integrator from itself at shorter steps, as lines of text."""
    about = subject(chosen.crossings)
    sets = [{**v.values, "dt": v.values["dt"] / chosen.finer} for v in verdicts]
    shorter = references(subject, chosen.crossings, [(values, False) for values in sets], chosen.workers)
    pairs = list(zip(verdicts, shorter, strict=True))
    apart = [about.distance(v.theirs, finer_row, v.values) for v, finer_row in pairs]
    shares = np.nanpercentile(apart, [50, 95, 100])
    other = sum(v.theirs.status != finer_row.status for v, finer_row in pairs)
    lines = [
        ("distance, rad: median, 95 %, largest", ", ".join(f"{e:.2g}" for e in shares)),
        ("of another status", f"{other}"),
    ]
    return "\n".join(f"    {name:60s} {text}" for name, text in lines)


def main(arguments: list[str] | None = None) -> int:
    options = argparse.ArgumentParser(
        prog="python -m benchmarks.reliability.parameters",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    options.add_argument("--model", choices=list(SUBJECTS), action="append", help="all three by default")
    options.add_argument("--sets", type=int, help="640 of the chain, 100 of each quadruped by default")
    options.add_argument("--seed", type=int, default=0)
    options.add_argument("--crossings", type=int, default=2, help="the crossing that is compared")
    options.add_argument("--numerics", help="YAML; left out by default, as a user would")
    options.add_argument("--engine", default="auto", choices=["auto", "kernel", "xla"])
    options.add_argument("--workers", type=int, default=2, help="processes of the independent integrator")
    options.add_argument("--finer", type=int, help="of a model that its steps define: how much finer")
    chosen = options.parse_args(arguments)

    numerics: dict[str, Any] | None = yaml.safe_load(chosen.numerics) if chosen.numerics else None
    right = True
    for model in chosen.model or SUBJECTS:
        subject, usual = SUBJECTS[model]
        begun = time.monotonic()
        verdicts, steps = compared(
            subject,
            sets=chosen.sets or usual,
            seed=chosen.seed,
            crossings=chosen.crossings,
            numerics=numerics,
            engine=chosen.engine,
            workers=chosen.workers,
        )
        good = holds(verdicts)
        right &= good
        about = subject(chosen.crossings)
        print(f"{model}, seed {chosen.seed}, crossing {chosen.crossings}, numerics {numerics or 'left out'}")
        print(f"  drawn: {about.ranges}")
        print(f"  independent: {about.about}")
        print(table(verdicts))
        print(f"  {'longest steps of the rows, s: least, most':62s} {steps.min():.3g}, {steps.max():.3g}")
        print(f"  {'guarantee':62s} {'holds' if good else 'FAILS'}")
        print(f"  {'time':62s} {time.monotonic() - begun:.0f} s", flush=True)
        if chosen.finer and about.same_steps:
            print(f"  the independent integrator at 1/{chosen.finer} of these steps, from itself")
            print(finer(subject, verdicts, chosen), flush=True)
        if text := listed(verdicts):
            print(text, flush=True)
    return 0 if right else 1


if __name__ == "__main__":
    sys.exit(main())
