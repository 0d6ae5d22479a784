"""What a search would need, before it runs: sets, rows, steps and time."""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from gaitsweep.fitting.search_job import SearchJob
from gaitsweep.runs.estimate import Estimate, estimate

# A finalist's steps are half as long.
_FINALIST = 2.0


@dataclasses.dataclass(frozen=True)
class SearchEstimate:
    """What a search would need.

    `rows_of_a_set` are those of each set, fixed points not among them; `steps` those of all sets; `seconds`
    the likely time and `seconds_most` that of rows at their limits. `batch` is the estimate of sets in the
    middle of all ranges, from which these follow, None where no target has rows.
    """

    sets: int
    together: int
    rows_of_a_set: int
    steps: float
    seconds: float
    seconds_most: float
    batch: Estimate | None


def estimate_search(job: SearchJob) -> SearchEstimate:
    """Estimate a search's needs from sets in the middle of the ranges; nothing is written.

    Raises:
        RunError: the job asks for what is not here.
    """
    population = job.fit.population()
    structure = job.fit.structures[0]
    rows = population.rows_of_a_set
    together = job.sets_together(population.prepared(structure), rows)
    middle = {
        name: free.at(np.array([0.5]))[0] for name, free in job.free.items() if name not in job.fit.structure
    }
    sample = population.middle_job(structure, middle, together)
    if sample is None:
        return SearchEstimate(job.choice.budget, together, 0, 0.0, 0.0, 0.0, None)
    batch = estimate(sample)
    # the search in batches of as many rows as the sample has
    batches = math.ceil(job.choice.budget / together) * together * rows / batch.rows
    finalists = _FINALIST * min(job.choice.finalists, job.choice.budget) * rows / batch.rows
    return SearchEstimate(
        sets=job.choice.budget,
        together=together,
        rows_of_a_set=rows,
        steps=batch.steps / batch.rows * rows * job.choice.budget,
        seconds=batch.compile_s + (batches + finalists) * (batch.seconds - batch.compile_s),
        seconds_most=batch.compile_s + (batches + finalists) * (batch.seconds_most - batch.compile_s),
        batch=batch,
    )
