"""Some blocks of a table, computed in this process, for directories that other processes write too."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import pandas as pd

from gaitsweep.engine.sweep.sweep import sweep
from gaitsweep.engine.sweep.sweep_spec import SweepProgress
from gaitsweep.runs.prepare import Prepared


def run_blocks(
    ready: Prepared,
    blocks: Sequence[int],
    write: Callable[[int, pd.DataFrame], None],
    between: Callable[[SweepProgress | None], None],
) -> None:
    """Compute blocks, and pass the records of each to `write(number, records)` when all its rows have ended.

    Args:
        ready: the job made ready.
        blocks: the numbers of the blocks.
        write: called with each block.
        between: called now and then, with how far it is where the sweep engine knows; an exception that it
            raises stops the run.
    """
    work, kind = ready.work, ready.job.run
    if not kind.own_blocks:
        sweep(work, blocks, write, between, encode=lambda _, block: ready.table(block))
        return
    for number in blocks:
        first, last = number * work.block, min((number + 1) * work.block, work.n_rows)
        write(number, kind.block_table(ready.design, work, first, last, lambda note="": between(None)))
