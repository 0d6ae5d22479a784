"""What is written down of each point of a branch of fixed points."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd

from gaitsweep.analysis.continuation.arclength import Places, Track
from gaitsweep.analysis.continuation.bifurcation_tests import multipliers_of
from gaitsweep.analysis.continuation.conserved_constraints import Conditions
from gaitsweep.engine.poincare.maps import Map


class Book:
    """The records of all branches.

    Args:
        mapping, parameter: what is followed, and along what.
        values: others that the records show, a number or one for each branch (n,).
        n: branches.
        held: what is held.
    """

    def __init__(
        self, mapping: Map, parameter: str, values: dict[str, np.ndarray], n: int, held: Conditions
    ) -> None:
        self.parameter = parameter
        self._values = {k: np.broadcast_to(v, (n,)) for k, v in values.items() if k != parameter}
        self._held = [mapping.conserved[k].name for k in held.which]
        self._records: list[list[dict[str, Any]]] = [[] for _ in range(n)]

    def counts(self, rows: np.ndarray) -> np.ndarray:
        return np.array([len(self._records[row]) for row in rows])

    def end(self, rows: np.ndarray, why: str) -> None:
        for row in rows:
            self._records[row][-1]["end"] = why

    def failed(self, row: int, parameter: float, why: str) -> None:
        self._records[row].append({**self._head(row, parameter), "end": why})

    def _head(self, row: int, parameter: float) -> dict[str, Any]:
        others = {name: each[row] for name, each in self._values.items()}
        return {"row": row, "point": len(self._records[row]), self.parameter: parameter, **others}

    def write(self, rows: np.ndarray, track: Track, places: Places, special: Sequence[str]) -> None:
        if not len(rows):
            return
        found = multipliers_of(track, places)
        for k, row in enumerate(rows):
            unstable = int(np.sum(np.abs(found[k]) > 1.0))
            self._records[row].append(
                {
                    **self._head(int(row), float(places.parameter[k])),
                    **{name: float(each[k]) for name, each in places.images.observed.items()},
                    **{f"drift_{name}": places.drift[k, i] for i, name in enumerate(self._held)},
                    "multiplier": float(np.abs(found[k, 0])),
                    "multiplier_re": float(found[k, 0].real),
                    "multiplier_im": float(found[k, 0].imag),
                    "unstable": unstable,
                    "stable": unstable == 0,
                    "special": special[k],
                    "corrections": int(places.corrections[k]),
                    "end": "",
                }
            )

    def table(self) -> pd.DataFrame:
        return pd.DataFrame([record for branch in self._records for record in branch])
