"""What a search for fixed points holds, of the quantities that a map conserves."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np

from gaitsweep import near_miss
from gaitsweep.engine.poincare.maps import Map, wrap_difference
from gaitsweep.errors import ArgumentError


@dataclasses.dataclass(frozen=True)
class Conditions:
    """The conserved quantities that are held: their places among those of a map, and their values (n, k)."""

    which: tuple[int, ...]
    values: np.ndarray
    circular: np.ndarray

    @classmethod
    def of(cls, mapping: Map, fix: Sequence[str] | Mapping[str, object], kept: np.ndarray) -> Conditions:
        """Those named by `fix`, at its values or, where it has none, as they are in `kept` (n, all of them).

        Raises:
            ValueError: a name that the map does not conserve.
        """
        names = [quantity.name for quantity in mapping.conserved]
        for name in fix:
            if name not in names:
                raise ArgumentError(f"{name} is not conserved by this map{near_miss.suggestion(name, names)}")
        which = tuple(names.index(name) for name in fix)
        values = kept[:, which].copy()
        if isinstance(fix, Mapping):
            for place, given in enumerate(fix.values()):
                if given is not None:
                    values[:, place] = np.asarray(given, np.float64)
        return cls(which, values, np.array([mapping.conserved[k].circular for k in which], bool))

    def __getitem__(self, rows: np.ndarray) -> Conditions:
        return dataclasses.replace(self, values=self.values[rows])

    def missed(self, kept: np.ndarray) -> np.ndarray:
        """How far the quantities are from where they are held, (n, k)."""
        return wrap_difference(kept[:, self.which] - self.values, self.circular)
