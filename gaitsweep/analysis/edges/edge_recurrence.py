"""How near trajectories come to where they have been some cycles before."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from gaitsweep.engine.poincare.maps import Points


class Recurrence:
    """The nearest return of each of n trajectories after 1, 2, ... cycles.

    `gaps` (n, longest) how near it was; `states`, for each number of cycles, n points that came back so near.

    Args:
        distance: between coordinates (n, size), (n,).
        begun: where the trajectories begin.
        longest: number of cycles up to which returns are looked for.
    """

    def __init__(
        self, distance: Callable[[np.ndarray, np.ndarray], np.ndarray], begun: Points, longest: int
    ) -> None:
        self._distance, self._longest, self._past = distance, longest, [begun]
        self.gaps, self.states = np.full((len(begun), longest), np.inf), [begun] * longest

    def add(self, on: np.ndarray, now: Points) -> np.ndarray:
        """Where the trajectories are a cycle later, of which those `on` are still going.

        Returns:
            Those that moved less than in any cycle before.
        """
        calmer = on[:0]
        for k, before in enumerate(self._past):
            gap = self._distance(now.at[on], before.at[on])
            nearer = gap < self.gaps[on, k]
            which = on[nearer]
            self.gaps[which, k] = gap[nearer]
            self.states[k] = self.states[k].merged(which, before[which])
            calmer = which if k == 0 else calmer
        self._past = [now, *self._past][: self._longest]
        return calmer
