"""Conflicts between targets of a search: which are met together, and which exclude each other."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
import pandas as pd
from jaxtyping import Bool

from gaitsweep.analysis.records import names_in
from gaitsweep.errors import ArgumentError
from gaitsweep.fitting.targets import FAILED_MISS, MISS
from gaitsweep.near_miss import suggestion


@dataclasses.dataclass(frozen=True)
class Conflicts:
    """Targets that are met together.

    `sets` is the number of sets; `together` (targets, targets) the number of sets that meet both of two
    targets, or one on the diagonal; `nearest` (targets, targets) the least miss of the column's target, in
    reading errors, among the sets that meet the row's, NaN where no set has a value of both; `most` the
    targets met by the sets that meet most of them, and `most_sets` the number of these sets.
    """

    sets: int
    together: pd.DataFrame
    nearest: pd.DataFrame
    most: tuple[str, ...]
    most_sets: int


def conflicts(
    tables: Sequence[pd.DataFrame], within: float = 1.0, targets: str | Sequence[str] | None = None
) -> Conflicts:
    """Count the sets of searches for the same targets that meet one, two or more of them.

    Args:
        tables: the tables of one search or several.
        within: the miss up to which a target counts as met, in reading errors.
        targets: names of the targets to compare; all of the tables by default, also those held back.

    Raises:
        ArgumentError: the tables are not those of searches, or have different targets.
    """
    names = _target_names(tables, names_in(targets or ()))
    columns = [f"{MISS}{name}" for name in names]
    misses = np.concatenate([np.abs(table[columns]) for table in tables])
    met = misses <= within
    counts = met.T.astype(np.int64) @ met
    with_value = np.where(misses < FAILED_MISS, misses, np.inf)
    nearest = np.array([with_value[meets_row].min(axis=0, initial=np.inf) for meets_row in met.T])
    most, most_sets = _most_met(met)
    return Conflicts(
        sets=len(met),
        together=pd.DataFrame(counts, index=names, columns=names),
        nearest=pd.DataFrame(np.where(np.isfinite(nearest), nearest, np.nan), index=names, columns=names),
        most=tuple(name for name, is_met in zip(names, most, strict=True) if is_met),
        most_sets=most_sets,
    )


def _most_met(met: Bool[np.ndarray, "sets targets"]) -> tuple[Bool[np.ndarray, " targets"], int]:
    """Return the largest combination of targets that a set meets, the most frequent one, and its sets."""
    targets_met = met.sum(axis=1)
    largest = met[targets_met == targets_met.max(initial=0)]
    if not len(largest):
        return np.zeros(met.shape[1], bool), 0
    combinations, sets = np.unique(largest, axis=0, return_counts=True)
    most_frequent = int(sets.argmax())
    return combinations[most_frequent], int(sets[most_frequent])


def _target_names(tables: Sequence[pd.DataFrame], chosen: Sequence[str]) -> list[str]:
    """Return the chosen targets of searches, by default all; refuse tables with different targets."""
    target_names = [
        [str(column).removeprefix(MISS) for column in table.columns if str(column).startswith(MISS)]
        for table in tables
    ]
    if not target_names or not all(target_names):
        raise ArgumentError("This is not the table of a search: it has no columns miss_NAME of targets.")
    for names in target_names[1:]:
        if names != target_names[0]:
            raise ArgumentError(
                f"The searches have different targets: {', '.join(target_names[0])} and {', '.join(names)}."
            )
    if not chosen:
        return target_names[0]
    for name in chosen:
        if name not in target_names[0]:
            raise ArgumentError(f"{name} is not a target of the search{suggestion(name, target_names[0])}")
    return list(chosen)
