"""Tables with the columns of a job's run and made-up numbers, for tests of figures."""

from __future__ import annotations

import math

import numpy as np
import pandas as pd

from gaitsweep.contract import Quantity
from gaitsweep.job import Job
from gaitsweep.kinds.columns import STATUSES, quantities_of
from gaitsweep.kinds.run_kind import table_columns
from gaitsweep.table.frames import outcomes

RECORDS = 24  # of a row, where a run makes several


def table_of(job: Job, seed: int = 0) -> pd.DataFrame:
    """A table with the columns, types and rows that the job's run makes; what it measures is random."""
    design, run = job.design, job.run
    random = np.random.default_rng(seed)
    each = 1 if run.one_a_row else RECORDS
    rows = np.repeat(np.arange(design.n_rows, dtype=np.int64), each)
    place = np.tile(np.arange(each), design.n_rows)
    model, moved = design.model, run.moved
    known: dict[str, Quantity] = {q.name: q for q in (*model.signals, *model.label_fields)}
    known |= {f"{q.name}_{end}": q for q in model.observables for end in ("end", "n")}
    axes = design.at(np.arange(design.n_rows), design.names)
    columns: dict[str, object] = {}
    for name in table_columns(design, run):
        if name == "row":
            columns[name] = rows
        elif name in axes:
            columns[name] = axes[name][rows]
        elif name == moved:
            low, high = min(run.turns), max(run.turns)
            columns[name] = low + (high - low) * (1.0 - np.abs(2.0 * place / (each - 1) - 1.0))
        elif name == "pass":
            columns[name] = (place > each // 2).astype(np.int64)
        elif name in ("crossing", "point", "stair", "cycles", "unstable", "corrections"):
            columns[name] = place.astype(np.int64)
        elif name in ("t", "t_end"):
            columns[name] = 0.05 * (1.0 + place)
        elif name == "status":
            end = "settled" if run.kind_name == "settle" else "complete"
            columns[name] = pd.Categorical(np.full(len(rows), end), categories=STATUSES)
        elif name == "gait":
            codes = random.integers(0, len(model.gaits), len(rows))
            columns[name] = pd.Categorical.from_codes(codes.tolist(), categories=list(model.gaits))
        elif name == "outcome":
            columns[name] = outcomes(columns["gait"], columns["status"])  # pyright: ignore[reportArgumentType]
        elif name in ("stable", "settled"):
            columns[name] = np.ones(len(rows), bool)
        elif name in ("special", "end", "slowest", "stalled_by"):
            columns[name] = pd.Categorical(np.full(len(rows), ""))
        else:
            columns[name] = _made_up(known.get(name), name, place, len(rows), random)
    table = pd.DataFrame(columns)
    table.attrs = {"job": job.resolved(), "quantities": quantities_of(model)}
    return table


def _made_up(
    quantity: Quantity | None, name: str, place: np.ndarray, n: int, random: np.random.Generator
) -> np.ndarray:
    """Values of an observable, a signal or a trait."""
    if name.startswith("contact_"):
        return ((place + int(name.removeprefix("contact_"))) % 8 < 5).astype(float)
    if quantity is not None and quantity.circular:
        return random.uniform(0.0, 2.0 * math.pi, n)
    if name.startswith("u_f"):  # a neuron's output, which rises and falls
        return np.sin(0.8 * place + 0.7 * len(name) + ord(name[-1]))
    return random.uniform(0.1, 0.9, n)
