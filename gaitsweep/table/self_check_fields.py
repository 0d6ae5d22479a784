"""The differences that a self-check counts, by their fields in the manifest, and their words.

Runs write these fields; reports and the marks of figures read them.
"""

from __future__ import annotations

from typing import Final, NamedTuple

# A settled row may move by this many times the tolerance of settling.
TOLERANCES: Final = 10.0


class Difference(NamedTuple):
    """Words after a number of rows: `mark` on a figure, `sentence` elsewhere."""

    mark: str
    sentence: str


STORED_DIFFERS: Final = "stored_differs"
UNSTABLE: Final = "unstable"
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
