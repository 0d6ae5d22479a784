"""Statuses of sets of constants, and sentences for these and for the statuses of rows."""

from __future__ import annotations

import enum
from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd
from jaxtyping import Bool

from gaitsweep.contract import Status

# Name of a result, for jobs whose rows are sets of constants.
_RESULTS = {"search": "target", "sensitivity": "output"}


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


def status_sentence(status: str, job: Mapping[str, Any]) -> str:
    """Return the sentence of a status; empty for a status of another version of gaitsweep."""
    result = next((word for field, word in _RESULTS.items() if field in job), None)
    if result is None:
        return Status[status].sentence if status in Status.__members__ else ""
    sets: dict[str, str] = {
        SetStatus.COMPLETE: f"Every {result} has a value for this set of constants.",
        SetStatus.FAILED: f"Some {result} has no value for this set; the column `why` says which and why.",
    }
    return sets.get(status, "")
