"""Differences that a self-check counts: their fields in a manifest, and their words for readers."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final, NamedTuple


class Difference(NamedTuple):
    """Words after a number of rows that a self-check found different: `mark` on a figure, else `sentence`."""

    mark: str
    sentence: str


# A settled row may move by this many times the tolerance of settling.
TOLERANCES: Final = 10.0
STORED_DIFFERS: Final = "stored_differs"
UNSTABLE: Final = "unstable"
# Differences that a self-check counts, by their fields in the manifest.
DIFFERENCES: Final = {
    STORED_DIFFERS: Difference(
        "not reproduced", "did not reproduce their stored records with the same steps"
    ),
    "status_differs": Difference("end otherwise", "ended with another status"),
    "gait_differs": Difference("change gait", "ended with another gait"),
    "count_differs": Difference("change their count", "ended with another count"),
    "moved": Difference("depend on the step", f"moved by more than {TOLERANCES:g} tolerances"),
    UNSTABLE: Difference(
        "rest on unstable gaits", "rest on an unstable gait, which any small displacement leaves"
    ),
}
# Rows whose observables change much with the step that is part of their model: marked, but no difference.
BY_STEP: Final = "by_step"
BY_STEP_WORDS: Final = Difference(
    "depend on the model's step",
    "changed by more than a tenth of an observable's size with the model's step",
)


def self_check_warned(check: object) -> bool:
    """Return whether the self-check in a manifest warned; false for none."""
    return isinstance(check, Mapping) and check.get("verdict") == "warned"
