"""Identifiability of each constant from the sets of a search: pinned by the targets, or free."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pandas as pd
from jaxtyping import Float

from gaitsweep.fitting.free_parameters import FreeParameter
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

    `best` is its value in the best set; `low` and `high` those among the near-best sets, `spread` their
    distance as a share of its range; `profile` (PARTS,) the least score in each part of its range, NaN
    without a set; `sets` the number of near-best sets.
    """

    name: str
    best: Any
    low: Any
    high: Any
    spread: float
    profile: Float[np.ndarray, " parts"]
    sets: int = 0

    @property
    def verdict(self) -> str:
        """Verdict: pinned, free, or too few sets to say."""
        if self.spread >= PINNED_SPREAD:
            return "free"
        return "pinned" if self.sets >= MIN_SETS else "too few sets to say"

    @property
    def words(self) -> tuple[str, str]:
        """Best value, and range of the near-best values, as text."""
        return _in_words(self.best), f"{_in_words(self.low)} to {_in_words(self.high)}"


def _in_words(value: Any) -> str:
    """A value of a constant as text: numbers in five digits, choices as they are written."""
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    return f"{value:.5g}" if is_number else str(value)


@dataclasses.dataclass(frozen=True)
class Identifiability:
    """Identifiability of each constant from the near-best sets of a search, which are sorted by score.

    `fitting` is the number of sets that miss no target by more than its reading error. The near-best sets are
    these, or, if there is none, those with a score within NEAR_BEST_FACTOR times the least.
    """

    best: pd.DataFrame
    fitting: int
    constants: tuple[Constant, ...]

    def __repr__(self) -> str:
        """Format it, a line for each constant."""
        which = (
            f"{self.fitting} sets fit" if self.fitting else f"no set fits; {len(self.best)} near-best ones"
        )
        lines = [
            f"  {constant.name}: best {constant.words[0]}, {constant.words[1]} ({constant.verdict})"
            for constant in self.constants
            if len(self.best)
        ]
        return "\n".join([f"Identifiability: {which}", *lines])

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
    complete = np.flatnonzero(SetStatus.COMPLETE.among(table))
    sound = table.iloc[complete].sort_values(["score", "row"], kind="stable")
    if not len(sound):
        nothing = tuple(Constant(name, None, None, None, 1.0, np.full(PARTS, np.nan)) for name in search.free)
        return Identifiability(sound, 0, nothing)
    misses = np.abs(sound[[f"{MISS}{name}" for name in search.counted]].to_numpy())
    fits = (misses <= 1.0).all(axis=1)
    near = fits if fits.any() else sound["score"].to_numpy() <= NEAR_BEST_FACTOR * sound["score"].iloc[0]
    near_best = sound.iloc[np.flatnonzero(near)]
    constants = tuple(_constant(name, free, sound, near_best) for name, free in search.free.items())
    return Identifiability(near_best, int(fits.sum()), constants)


def _constant(name: str, free: FreeParameter, sound: pd.DataFrame, near_best: pd.DataFrame) -> Constant:
    """The identifiability of a constant, from the sound and the near-best sets, each sorted by score."""
    values = near_best[name].tolist()
    shares = free.share(free.written(values))
    low, high = values[int(np.argmin(shares))], values[int(np.argmax(shares))]
    profile = np.full(PARTS, np.nan)
    parts = (free.share(free.written(sound[name].tolist())) * PARTS).astype(int)
    np.fmin.at(profile, np.minimum(parts, PARTS - 1), sound["score"].to_numpy())
    return Constant(name, values[0], low, high, float(np.ptp(shares)), profile, len(near_best))
