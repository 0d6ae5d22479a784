"""Statuses of sets of constants."""

from __future__ import annotations

import enum

import numpy as np
import pandas as pd
from jaxtyping import Bool


class SetStatus(enum.StrEnum):
    """Statuses of a set of constants, in the table of a search or a sensitivity analysis.

    Such a table has no rows of a sweep, so its column `status` has these names in place of those of `Status`.
    """

    COMPLETE = "complete"  # every target or output has a value
    FAILED = "failed"  # one of them has none

    @classmethod
    def column(cls, failed: Bool[np.ndarray, " sets"]) -> pd.Categorical:
        """Return the column `status` of a table, from a mask of the sets that failed."""
        return pd.Categorical.from_codes(failed.astype(int), [str(status) for status in cls])

    def among(self, table: pd.DataFrame) -> Bool[np.ndarray, " sets"]:
        """Return a mask of the sets of a table that have this status."""
        return (table["status"].astype(str) == str(self)).to_numpy(bool)
