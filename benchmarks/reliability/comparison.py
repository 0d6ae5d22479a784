"""Comparison of runs of random parameter sets, set by set, with an independent integrator."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

import gaitsweep as gs
from gaitsweep.job import Job
from gaitsweep.job.step_lengths import row_steps

from .parameter_sets import Found, Subject, Values

TOLERANCE = 1e-2  # rad, of any observable, in its scale
MOST_LOST = 0.01  # of the sets where the independent integrator is sound

# What may come out of a set. Sound: as the independent integrator has it, a fall included.
SOUND, WRONG, LOST, SENSITIVE, UNKNOWN = "sound", "wrong", "lost", "sensitive", "unknown"


@dataclass(frozen=True)
class Verdict:
    """One set: its values, what both integrators say, how far apart they are (rad), and the outcome.

    `unsure` is the distance of the independent integrator's two runs (rad).
    """

    values: Values
    ours: Found
    theirs: Found
    unsure: float
    apart: float
    outcome: str


def judged(subject: Subject, values: Values, ours: Found, theirs: Found, again: Found) -> Verdict:
    """The outcome of one set; `again` is the independent integrator's second run."""
    unsure = subject.distance(theirs, again, values)
    apart = subject.distance(ours, theirs, values)
    if theirs.status != again.status or unsure > TOLERANCE:
        outcome = SENSITIVE
    elif theirs.status == "failed":
        outcome = UNKNOWN
    elif ours.status != theirs.status:
        # a fall that is none is a wrong answer, and so is a walk that is a fall
        outcome = LOST if ours.status == "failed" else WRONG
    else:
        outcome = WRONG if apart > TOLERANCE else SOUND
    return Verdict(values, ours, theirs, unsure, apart, outcome)


def job_of(
    subject: Subject,
    sets: list[Values],
    crossings: int,
    numerics: Mapping[str, Any] | None = None,
    engine: str = "auto",
) -> Job:
    """The job of the sets, a row each; without `numerics` it says nothing of them."""
    fields: dict[str, Any] = {} if numerics is None else {"numerics": dict(numerics)}
    return Job(
        name="reliability",
        model=subject.model,
        structure=dict(subject.structure),
        params=dict(subject.fixed),
        vary={"zip": {name: {"values": [values[name] for values in sets]} for name in sets[0]}},
        run={"kind": "return_map", "crossings": crossings},
        engine={"name": engine},
        verify=0,
        **fields,
    )


def steps_of(job: Job) -> np.ndarray:
    """The longest step (s) of each row."""
    steps = row_steps(job.design, job.run, job.integration)
    dt = np.empty(job.design.n_rows)
    dt[steps.rows] = steps.dt
    return dt


def ours_of(subject: Subject, job: Job, crossing: int) -> list[Found]:
    """Gaitsweep's outcome of each row of the job at a crossing."""
    with tempfile.TemporaryDirectory() as folder:
        table = gs.run(job, Path(folder) / "run").table
    columns = {name: name if name == "t" else f"{name}_n" for name in subject.observables}
    last = table.loc[table["crossing"] == crossing].set_index("row")
    results = []
    for row, status in table.groupby("row")["status"].last().to_dict().items():
        if status == "complete":
            seen = {name: float(last.loc[row, column]) for name, column in columns.items()}
            results.append(Found("complete", seen))
        else:
            # every status but a fall says that the row was lost
            results.append(Found("fell" if status == "fell" else "failed"))
    return results


def theirs_of(subject: Callable[[int], Subject], crossings: int, job: tuple[Values, bool]) -> Found:
    """One run of the independent integrator, in a process of its own."""
    values, nudge = job
    return subject(crossings).reference(values, nudge)


def references(
    subject_of: Callable[[int], Subject], crossings: int, work: list[tuple[Values, bool]], workers: int
) -> list[Found]:
    """The independent integrator's outcome of each set, computed in so many processes."""
    run = partial(theirs_of, subject_of, crossings)
    if workers == 1:
        return [run(one) for one in work]
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        return list(pool.map(run, work, chunksize=2))


def compared(
    subject_of: Callable[[int], Subject],
    *,
    sets: int,
    seed: int,
    crossings: int,
    numerics: Mapping[str, Any] | None = None,
    engine: str = "auto",
    workers: int = 2,
) -> tuple[list[Verdict], np.ndarray]:
    """The verdicts on `sets` random sets, and the longest step (s) of each; see `parameters`."""
    subject = subject_of(crossings)
    drawn = subject.draw(np.random.default_rng(seed), sets)
    job = job_of(subject, drawn, crossings, numerics, engine)
    steps = steps_of(job)
    values_with_steps = [{**values, "dt": float(dt)} for values, dt in zip(drawn, steps, strict=True)]
    work = [
        (values, nudge)
        for values in (values_with_steps if subject.same_steps else drawn)
        for nudge in (False, True)
    ]
    results = references(subject_of, crossings, work, workers)
    ours = ours_of(subject, job, crossings)
    verdicts = [
        judged(subject, values, our_row, results[2 * i], results[2 * i + 1])
        for i, (values, our_row) in enumerate(zip(values_with_steps, ours, strict=True))
    ]
    return verdicts, steps


def counts(verdicts: list[Verdict]) -> dict[str, int]:
    """Number of sets of each outcome."""
    return {
        name: sum(verdict.outcome == name for verdict in verdicts)
        for name in (SOUND, WRONG, LOST, SENSITIVE, UNKNOWN)
    }


def holds(verdicts: list[Verdict]) -> bool:
    """The guarantee: no set silently wrong, at most 1 % lost of those where the other integrator is sound."""
    result = counts(verdicts)
    judged_sets = result[SOUND] + result[WRONG] + result[LOST]
    return result[WRONG] == 0 and result[LOST] <= MOST_LOST * judged_sets
