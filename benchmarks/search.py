"""Number of sets of constants that a search judges by holds: `python -m benchmarks.search --sets 2000`.

Sets of the quadruped with a waist are drawn evenly from the ranges of
sweeps/waist_quadruped_phases_search.yaml. Each is judged by four holds of 120 s: trot and walk, on both sides
of the stiffness at which the paper loses them. A hold does not end where a gait has come to rest, but where
the model falls. Beside it the kernel alone: rows of the shipped constants, which do not fall, in the same
steps and precision.

`holds` is the simulated time of all holds that ran to their end, in s for each second of the search, and
`ratio` the kernel's simulated time over it: what choosing, collecting, judging and writing cost, and the idle
ends of batches. Sets that fall cost time too, which `holds` leaves out.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path
from typing import Any

import jax
import numpy as np
import yaml

import gaitsweep as gs
from benchmarks.waist_quadruped import STEP, ours

JOB = Path(__file__).parents[1] / "sweeps" / "waist_quadruped_phases_search.yaml"
# s of a hold, after the start of 7 s.
HOLD, START = 120.0, 7.0
# Stiffnesses (Hz) and starts (rad) of the holds.
HOLDS = {
    "trot_kept": (2.89, 3.05),
    "trot_lost": (2.96, 3.05),
    "walk_kept": (2.35, 2.6),
    "walk_lost": (2.31, 2.6),
}


def job(sets: int, population: int | None, seed: int) -> dict[str, Any]:
    """The fields of the search."""
    fields = yaml.safe_load(JOB.read_text())
    free = fields["search"]["free"]
    targets = {
        name: {
            "kind": "value",
            "of": "delta_13",
            "at": {"f": f, "delta_13": start},
            "wanted": 3.0,
            "error": 0.05,
        }
        for name, (f, start) in HOLDS.items()
    }
    chosen = {
        "free": free,
        "targets": targets,
        "method": "sobol",
        "budget": sets,
        "seed": seed,
        "finalists": 0,
    }
    if population is not None:
        chosen["population"] = population
    return {
        "name": "search_benchmark",
        "model": "waist_quadruped",
        "structure": fields["structure"],
        "run": {"kind": "fixed_time", "duration": START + HOLD},
        "numerics": {"method": "semi_implicit", "dt": STEP, "precision": "mixed"},
        "search": chosen,
    }


def main() -> None:
    options = argparse.ArgumentParser(
        prog="python -m benchmarks.search",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    options.add_argument("--sets", type=int, default=2000)
    options.add_argument("--population", type=int, help="sets of a batch; the search's own by default")
    options.add_argument("--seed", type=int, default=1)
    chosen = options.parse_args()
    alone = ours("kernel", "semi_implicit", STEP, 5.0, None, precision="mixed")
    with tempfile.TemporaryDirectory() as folder:
        began = time.perf_counter()
        result = gs.search(job(chosen.sets, chosen.population, chosen.seed), Path(folder) / "search")
        took = time.perf_counter() - began
    values = result.table[list(HOLDS)].to_numpy()
    whole = np.isfinite(values)
    holds = whole.sum() * (START + HOLD) / took
    print(f"{jax.devices()[0].device_kind}: {chosen.sets} sets by four holds of {HOLD:g} s in {took:.0f} s,")
    print(f"{chosen.sets / took:.1f} sets/s; {100 * whole.mean():.1f} % of the holds ran to their end.")
    print(
        f"holds {holds:.4g} s/s; kernel alone {alone.simulated:.4g} s/s; ratio {alone.simulated / holds:.3g}"
    )


if __name__ == "__main__":
    main()
