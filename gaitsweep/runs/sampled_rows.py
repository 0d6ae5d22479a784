"""The rows of a run that its self-check reruns: their number, and which they are."""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Int

from gaitsweep.design import Design
from gaitsweep.engine.solver.methods import fixed_step_scheme
from gaitsweep.runs.prepare import RunContext, nominal_period

# The sample's steps, as a share of the run's own: irrational, so that no step ends where one of these does.
FINER = 1.0 / math.sqrt(7.0)
# The largest share of a run's work that its sample takes, and its fewest rows, if a job gives no number.
MOST_WORK = 0.1
LEAST_ROWS = 4
# Crossings over which rows are compared that do not come to rest, and those of kinds that do not ask for it.
CROSSINGS = 10


def finer_share(context: RunContext) -> float:
    """Return the steps of the sample as a share of the run's own: half of those along a path of noise."""
    steps = fixed_step_scheme(context.spec.numerics.method, context.model)
    return 0.5 if steps is not None and steps.stochastic else FINER


def is_checked(context: RunContext) -> bool:
    """Return whether a run integrates something that finer steps would change."""
    steps = fixed_step_scheme(context.spec.numerics.method, context.model)
    exact = steps is not None and steps.is_return_map
    return context.job.run.integrates and not exact


def rows_to_repeat(context: RunContext) -> int:
    """Return the rows of the sample: as the job says, else at most 32 and `MOST_WORK` of the run's work."""
    job, design = context.job, context.design
    if "verify" in job.model_fields_set or design.n_rows <= LEAST_ROWS:
        return min(job.verify, design.n_rows)
    if math.isnan(period := nominal_period(design)):
        return min(job.verify, LEAST_ROWS)
    cycles = job.run.cost(design, 1.0, period).likely  # of a row, as a number of cycles
    if job.run.compared in ("settled", "ends"):
        repeated = (1.0 + 1.0 / FINER) * cycles
    else:
        repeated = (2.0 + 1.0 / FINER) * min(cycles, CROSSINGS)
    most = int(MOST_WORK * design.n_rows * cycles / max(repeated, 1e-300))
    return min(job.verify, design.n_rows, max(LEAST_ROWS, most))


def sample_rows(design: Design, count: int) -> Int[np.ndarray, " sampled"]:
    """Select representative rows (n,): both ends of each axis, and points that fill the grid evenly.

    Args:
        design: the job's rows.
        count: how many at most; all rows where there are no more.
    """
    if design.n_rows <= count:
        return np.arange(design.n_rows, dtype=np.int64)
    lengths = np.array([group.length for group in design.groups], dtype=np.int64)
    strides = np.array([design.stride(place) for place in range(lengths.size)], dtype=np.int64)
    # the additive recurrence of Roberts (2018): powers of the root of x^(d+1) = x + 1
    root = 1.5
    for _ in range(64):
        root = (1.0 + root) ** (1.0 / (lengths.size + 1))
    slopes = root ** -np.arange(1.0, lengths.size + 1.0)
    ends = [(axis, end) for axis in range(lengths.size) for end in (0, lengths[axis] - 1)]
    chosen: dict[int, None] = {}
    for k in range(64 * count):
        point = np.floor(np.mod(0.5 + k * slopes, 1.0) * lengths).astype(np.int64)
        if k < len(ends):
            axis, end = ends[k]
            point[axis] = end
        chosen.setdefault(int(np.sum(np.minimum(point, lengths - 1) * strides)))
        if len(chosen) == count:
            break
    return np.array(sorted(chosen), dtype=np.int64)
