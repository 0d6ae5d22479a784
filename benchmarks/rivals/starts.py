"""The starts that all rivals run, the crossings that they ought to find, and the row that they report."""

from __future__ import annotations

import csv
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TypedDict

import numpy as np
from numpy.typing import NDArray

TESTS = Path(__file__).resolve().parents[2] / "tests"
if str(TESTS) not in sys.path:
    sys.path.insert(0, str(TESTS))

from reference.multilegged_page import Parameters, State, start  # noqa: E402 - needs the path above

Array = NDArray[np.float64]


class Row(TypedDict):
    """Result of a rival or an engine; NaN where nothing could be measured.

    `steps_per_second` are attempts of all trajectories together; `error_rad` is the 95 % quantile, over the
    starts, of the largest error of psi at any crossing (rad).
    """

    name: str
    steps_per_second: float
    cycles_per_second: float
    error_rad: float
    note: str


def reference_crossings() -> Array:
    """Psi (rad) at crossings 0..10 of the base starts that do not graze, (starts, 11, 3)."""
    with (TESTS / "reference" / "multilegged_crossings.csv").open() as file:
        lines = csv.DictReader(line for line in file if not line.startswith("#"))
        rows = [line for line in lines if line["set"] == "base" and line["graze"] == "0"]
    flat = np.array([[float(row[f"psi_{i}"]) for i in (1, 2, 3)] for row in rows])
    return flat.reshape(-1, 11, 3)


def states(p: Parameters, psi: Array) -> list[State]:
    return [start(p, row) for row in psi]


def stacked(states: Sequence[State], name: str) -> Array:
    """One field of all states, (lanes, N+1), as float64."""
    return np.array([getattr(state, name) for state in states], dtype=float)


def errors(computed: Array, true: Array) -> Array:
    """Largest wrapped distance (rad) of each start, both (starts, crossings, N), over what both have."""
    crossings = min(computed.shape[1], true.shape[1])
    gap = np.abs(computed[:, :crossings] - true[:, :crossings]) % (2.0 * np.pi)
    return np.minimum(gap, 2.0 * np.pi - gap).max(axis=(1, 2))
