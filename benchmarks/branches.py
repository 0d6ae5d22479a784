"""Branches of a compass walker followed all at once, against the same branches one by one.

    python -m benchmarks.branches [--branches 1000] [--alone 20]

Each branch is the walk at another mass of the hip, from a slope of 3 degrees to 5, through its flip. Times
are of the processor, without compilation. The rival is this program's own loop over branches.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable

import numpy as np
import pandas as pd

import gaitsweep as gs
from gaitsweep.analysis.continuation.continuation import continuation
from gaitsweep.examples.compass_walker import CompassWalker

MASSES = (8.0, 12.0)  # kg


def timed(work: Callable[[], pd.DataFrame]) -> tuple[float, pd.DataFrame]:
    """The processor's time (s) of some work, and its result."""
    begun = time.process_time()
    result = work()
    return time.process_time() - begun, result


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--branches", type=int, default=1000, help="branches that are followed at once")
    parser.add_argument("--alone", type=int, default=20, help="branches that are followed one by one")
    arguments = parser.parse_args()
    mapping = gs.return_map(CompassWalker(), slope=3.0)
    walk = mapping.settled({}, 200)

    def followed(masses: np.ndarray) -> pd.DataFrame:
        starts = walk[np.zeros(masses.size, int)]
        return continuation(
            mapping.mapping, starts, {"m_H": masses}, parameter="slope", within=(2.0, 5.0), begin=3.0
        )

    masses = np.linspace(*MASSES, arguments.branches)
    some = masses[np.linspace(0, masses.size - 1, arguments.alone).astype(int)]
    followed(masses)  # compiles the programs of all sizes of batches
    followed(some[:1])
    together, table = timed(lambda: followed(masses))
    alone, _ = timed(lambda: pd.concat([followed(some[[k]]) for k in range(some.size)]))
    flips = int(np.sum(table["special"] == "flip"))
    rate, own = masses.size / together, some.size / alone
    print(f"{masses.size} branches at once: {together:.1f} s, {rate:.0f} branches/s, {flips} flips located")
    print(f"{some.size} branches one by one: {alone:.1f} s, {own:.1f} branches/s")
    print(f"ratio {rate / own:.1f}")


if __name__ == "__main__":
    main()
