"""Identifiability of the constants from the sets of a search: pinned by the targets, or free."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pandas as pd
from jaxtyping import Float

from gaitsweep.fitting.free_parameters import FreeParameter, is_number, number_of_sets
from gaitsweep.fitting.search_job import Search
from gaitsweep.fitting.targets import MISS
from gaitsweep.status import SetStatus

# Where no set fits all targets, the near-best sets are those within this factor of the least score.
NEAR_BEST_FACTOR = 1.1
# A constant whose near-best values span less than this share of its range is pinned.
PINNED_SPREAD = 0.25
# Fewer near-best sets do not determine the range of a constant's values.
MIN_SETS = 20
# Parts of a constant's range in each of which the profile has the least score.
PARTS = 20


@dataclasses.dataclass(frozen=True)
class Constant:
    """Identifiability of one constant from the near-best sets.

    `best` is its value in the best set; `low` and `high` are its least and largest value in the near-best
    sets, and `spread` is their distance as a share of its range. `choices` has those of the
    near-best sets if not all choices are numbers; `spread` is then the share of the other choices that is
    among them. `profile` (PARTS,) has the least score in
    each part of its range, NaN without a set; `sets` is the number of near-best sets.
    """

    name: str
    best: Any
    low: Any
    high: Any
    spread: float
    profile: Float[np.ndarray, " parts"]
    sets: int
    choices: tuple[Any, ...] = ()

    @property
    def verdict(self) -> str:
        """Whether the targets pin it: pinned, free, or too few sets to say."""
        if len(self.choices) > 1 or self.spread >= PINNED_SPREAD:
            return "free"
        return "pinned" if self.sets >= MIN_SETS else "too few sets to say"

    @property
    def words(self) -> tuple[str, str]:
        """Best value, and the range or the choices of the near-best values, as text."""
        if self.choices:
            return _in_words(self.best), ", ".join(map(_in_words, self.choices))
        return _in_words(self.best), f"{_in_words(self.low)} to {_in_words(self.high)}"


def _in_words(value: Any) -> str:
    """Format a value of a constant: numbers in five digits, choices as they are written."""
    return f"{value:.5g}" if is_number(value) else str(value)


@dataclasses.dataclass(frozen=True)
class Identifiability:
    """Identifiability of each constant from the near-best sets of a search.

    `fitting` is the number of sets that miss no target by more than its reading error. `best` has the
    near-best sets, sorted by score: those that fit, or, if there is none, those with a score within
    NEAR_BEST_FACTOR times the least.
    """

    best: pd.DataFrame
    fitting: int
    constants: tuple[Constant, ...]

    def __repr__(self) -> str:
        """Format it, a line for each constant."""
        fit = f"{number_of_sets(self.fitting)} fit{'s' * (self.fitting == 1)}"
        sets = fit if self.fitting else f"no set fits; {number_of_sets(len(self.best), 'near-best one')}"
        lines = [f"Identifiability: {sets}"]
        if len(self.best):
            for constant in self.constants:
                best, span = constant.words
                lines.append(f"  {constant.name}: best {best}, {span} ({constant.verdict})")
        return "\n".join(lines)

    def summary(self) -> dict[str, Any]:
        """Return the fields of the manifest."""
        first = self.best.iloc[0] if len(self.best) else None
        return {
            "best_row": None if first is None else int(first["row"]),
            "best_score": None if first is None else float(first["score"]),
            "near_best": len(self.best),
            "fitting": self.fitting,
            "constants": {constant.name: constant.verdict for constant in self.constants},
        }


def identifiability(table: pd.DataFrame, search: Search) -> Identifiability:
    """Find the near-best sets of a search's table, and the identifiability of each constant.

    Args:
        table: the measured sets.
        search: the search.
    """
    complete = table.iloc[np.flatnonzero(SetStatus.COMPLETE.among(table))]
    complete = complete.sort_values(["score", "row"], kind="stable")
    if not len(complete):
        no_scores = np.full(PARTS, np.nan)
        unknown = tuple(Constant(name, None, None, None, 1.0, no_scores, 0) for name in search.free)
        return Identifiability(complete, 0, unknown)
    scores = complete["score"].to_numpy()
    misses = np.abs(complete[[f"{MISS}{name}" for name in search.counted]].to_numpy())
    fits = (misses <= 1.0).all(axis=1)
    is_near_best = fits if fits.any() else scores <= NEAR_BEST_FACTOR * scores[0]
    near_best = complete.iloc[np.flatnonzero(is_near_best)]
    constants = tuple(_constant(name, free, complete, near_best) for name, free in search.free.items())
    return Identifiability(near_best, int(fits.sum()), constants)


def _constant(name: str, free: FreeParameter, complete: pd.DataFrame, near_best: pd.DataFrame) -> Constant:
    """Return the identifiability of a constant from the complete and the near-best sets, sorted by score."""
    values, free = near_best[name].tolist(), free.ordered
    written = free.written(values)
    shares = free.share(written)
    spread, choices = float(np.ptp(shares)), ()
    if free.choices is not None and not all(map(is_number, free.choices)):  # they have no order
        choices = tuple(choice for choice in free.choices if choice in written)
        spread = (len(choices) - 1) / (len(free.choices) - 1)
    profile = np.full(PARTS, np.nan)
    parts = (free.share(free.written(complete[name].tolist())) * PARTS).astype(int)
    np.fmin.at(profile, np.minimum(parts, PARTS - 1), complete["score"].to_numpy())
    return Constant(
        name,
        best=values[0],
        low=values[int(np.argmin(shares))],
        high=values[int(np.argmax(shares))],
        spread=spread,
        profile=profile,
        sets=len(near_best),
        choices=choices,
    )
