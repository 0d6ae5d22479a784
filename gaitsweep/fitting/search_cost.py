"""Estimate of the sets, rows, steps and time of a search, before it runs."""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from gaitsweep.fitting.search_job import SearchJob
from gaitsweep.runs.estimate import Estimate, estimate

# Cost of a finalist, in sets: its steps are half as long.
_COST_OF_A_FINALIST = 2.0


@dataclasses.dataclass(frozen=True)
class SearchEstimate:
    """Estimate of a search.

    `rows_of_a_set` is the number for each set, without fixed points, and `rows_of_neighbours` that of its
    neighbours, which only sets that keep their targets have; `steps` that of all sets, without neighbours;
    `seconds` the likely time and `seconds_most` that of rows at their limits, with all neighbours. `batch` is
    the estimate of sets in the middle of all ranges, from which these follow, with the run of the job where
    there are targets of it; None where no target has rows.
    """

    sets: int
    together: int
    rows_of_a_set: int
    rows_of_neighbours: int
    steps: float
    seconds: float
    seconds_most: float
    batch: Estimate | None


def estimate_search(job: SearchJob) -> SearchEstimate:
    """Estimate the cost of a search from sets in the middle of the ranges; nothing is written.

    Args:
        job: the search.

    Raises:
        RunError: a device or an engine that the job asks for is not available.
    """
    population = job.fit.population()
    structure = job.fit.structures[0]
    rows = population.rows_of_a_set
    budget = job.options.budget
    together = job.sets_together(population.prepared(structure), rows)
    middle = {
        name: free.at(np.array([0.5]))[0] for name, free in job.free.items() if name not in job.fit.structure
    }
    batches = []  # the estimate of the rows of each run, and the share of a set in them
    for part in population.parts:
        if (sample := part.middle_job(structure, middle, together)) is not None:
            needs = estimate(sample)
            batches.append((needs, part.own_rows_of_a_set / needs.rows))
    if not batches:
        return SearchEstimate(budget, together, 0, 0, 0.0, 0.0, 0.0, None)
    robust = job.options.robust
    neighbours = 0 if robust is None else robust.sets * population.of(robust.targets).rows_of_a_set
    # whole batches, each with the rows of the sample
    sets = math.ceil(budget / together) * together
    sets += _COST_OF_A_FINALIST * min(job.options.finalists, budget)
    compile_s = sum(needs.compile_s for needs, _ in batches)
    seconds = sum((needs.seconds - needs.compile_s) * share for needs, share in batches)
    seconds_most = sum((needs.seconds_most - needs.compile_s) * share for needs, share in batches)
    return SearchEstimate(
        sets=budget,
        together=together,
        rows_of_a_set=rows,
        rows_of_neighbours=neighbours,
        steps=sum(needs.steps * share for needs, share in batches) * budget,
        seconds=compile_s + sets * seconds,
        seconds_most=compile_s + sets * seconds_most * (1.0 + neighbours / rows),
        batch=batches[0][0],
    )
