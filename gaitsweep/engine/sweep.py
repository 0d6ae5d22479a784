"""All rows of a job through the lanes, block by block."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Sequence

from gaitsweep.engine.block import BlockResult
from gaitsweep.engine.labels import Labels
from gaitsweep.engine.pool import Pool
from gaitsweep.engine.work import Progress, Work


@dataclasses.dataclass
class Timings:
    """Seconds of compiling (the first call of each program) and of running, and attempts made."""

    compile_s: float = 0.0
    run_s: float = 0.0
    attempts: int = 0


def sweep(
    work: Work,
    blocks: Sequence[int],
    write: Callable[[int, BlockResult], None],
    progress: Callable[[Progress], None] | None = None,
    timings: Timings | None = None,
) -> Timings:
    """Run the rows of `blocks` and give each block to `write(number, result)` when all its rows are done.

    `timings`, where given, is kept up to date as the sweep goes, so that it tells of an interrupted one too.
    """
    timings = Timings() if timings is None else timings
    began = time.perf_counter()
    pool = Pool(work, blocks)
    label = Labels(work)
    if pool.total == 0:
        return timings
    pool.refill()
    pool.collect(pool.chunk(0))
    timings.compile_s = time.perf_counter() - began
    while pool.busy:
        for number in pool.collect(pool.chunk()):
            block = pool.close(number)
            write(number, block.result(label(block)))
        timings.attempts = pool.attempts
        timings.run_s = time.perf_counter() - began - timings.compile_s
        if progress is not None:
            progress(pool.progress(timings.run_s))
        pool.refill()
    return timings
