"""Sentences for the statuses of rows, and of sets of constants of a search or a sensitivity analysis."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from gaitsweep.contract import Status

# Name of a result, for jobs whose rows are sets of constants.
_RESULTS = {"search": "target", "sensitivity": "output"}


def status_sentence(status: str, job: Mapping[str, Any]) -> str:
    """Return the sentence of a status; empty for a status of another version of gaitsweep."""
    result = next((word for field, word in _RESULTS.items() if field in job), None)
    if result is None:
        return Status[status].sentence if status in Status.__members__ else ""
    sets = {
        "complete": f"Every {result} has a value for this set of constants.",
        "failed": f"Some {result} has no value for this set; the column `why` says which and why.",
    }
    return sets.get(status, "")
