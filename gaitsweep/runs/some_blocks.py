"""Computation of some blocks of a table in this process, for directories that other processes write too."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import pandas as pd

from gaitsweep.engine.sweep.sweep import sweep
from gaitsweep.engine.sweep.sweep_spec import SweepProgress
from gaitsweep.runs.prepare import RunContext


def run_blocks(
    context: RunContext,
    blocks: Sequence[int],
    write: Callable[[int, pd.DataFrame], None],
    on_progress: Callable[[SweepProgress | None], None],
) -> None:
    """Compute blocks, and pass the records of each to `write(number, records)` when its rows have ended.

    Args:
        context: the job's context.
        blocks: the numbers of the blocks.
        write: called with each block.
        on_progress: progress callback, called with None where the progress is not known; an exception that
            it raises stops the run.
    """
    spec, kind = context.spec, context.job.run
    if not kind.own_blocks:
        sweep(spec, blocks, write, on_progress, encode=lambda _, block: context.table(block))
        return
    for number in blocks:
        first, last = number * spec.block, min((number + 1) * spec.block, spec.n_rows)
        write(number, kind.block_table(context.design, spec, first, last, lambda note="": on_progress(None)))
