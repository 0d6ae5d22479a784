"""Estimate of the sets, rows, steps and time of a search, before it runs."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from gaitsweep.fitting.population import Population
from gaitsweep.fitting.search_job import SearchJob
from gaitsweep.runs.estimate import Estimate, estimate

# A finalist's steps are half as long.
_FINALIST = 2.0


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
    """Estimate a search's needs from sets in the middle of the ranges; nothing is written.

    Raises:
        RunError: a device or an engine that the job asks for is not available.
    """
    population = job.fit.population()
    structure = job.fit.structures[0]
    rows = population.rows_of_a_set
    robust = job.options.robust
    near = 0 if robust is None else robust.sets * population.of(robust.targets).rows_of_a_set
    together = job.sets_together(population.prepared(structure), rows)
    middle = {
        name: free.at(np.array([0.5]))[0] for name, free in job.free.items() if name not in job.fit.structure
    }
    batches = [
        batch
        for part in population.parts
        if (batch := _Batch.of(part, structure, middle, together)) is not None
    ]
    if not batches:
        return SearchEstimate(job.options.budget, together, 0, 0, 0.0, 0.0, 0.0, None)
    # whole batches, each with the rows of the sample
    sets = math.ceil(job.options.budget / together) * together
    sets += _FINALIST * min(job.options.finalists, job.options.budget)
    return SearchEstimate(
        sets=job.options.budget,
        together=together,
        rows_of_a_set=rows,
        rows_of_neighbours=near,
        steps=sum(batch.steps for batch in batches) * job.options.budget,
        seconds=sum(batch.estimate.compile_s + sets * batch.seconds for batch in batches),
        seconds_most=sum(
            batch.estimate.compile_s + sets * batch.seconds_most * (1.0 + near / rows) for batch in batches
        ),
        batch=batches[0].estimate,
    )


@dataclasses.dataclass(frozen=True)
class _Batch:
    """Estimate of a batch of rows of one run, and the steps and seconds of each set in it."""

    estimate: Estimate
    steps: float
    seconds: float
    seconds_most: float

    @classmethod
    def of(
        cls, part: Population, structure: Mapping[str, Any], middle: Mapping[str, Any], sets: int
    ) -> _Batch | None:
        """Estimate a batch of sets in the middle of all ranges; return None if they have no rows."""
        sample = part.middle_job(structure, middle, sets)
        if sample is None:
            return None
        needs = estimate(sample)
        share = part.own_rows_of_a_set / needs.rows
        seconds, most = needs.seconds - needs.compile_s, needs.seconds_most - needs.compile_s
        return cls(needs, needs.steps * share, seconds * share, most * share)
