"""The verdict on a claim, worked out from what was measured."""

from __future__ import annotations

import enum
import math
from collections.abc import Sequence
from typing import Any

from gaitsweep.claims.measures import Value
from gaitsweep.claims.paper import Claim


class ClaimVerdict(enum.StrEnum):
    """Verdict on a claim."""

    reproduced = "reproduced"
    not_reproduced = "not"
    open_constants = "open: constants"  # out of tolerance, and the paper leaves out constants that decide it
    definition = "definition"  # it holds because the model or its labels are made so
    answered = "answered"  # the paper asks, and leaves the answer open
    not_run = "not run"

    @property
    def sentence(self) -> str:
        """Meaning of the verdict, for a reader of the page."""
        return _SENTENCES[self]


_SENTENCES = {
    ClaimVerdict.reproduced: "our value agrees with the paper's within the tolerance",
    ClaimVerdict.not_reproduced: "our value does not agree with the paper's, or no longer at a finer step",
    ClaimVerdict.open_constants: "it does not agree, and the paper leaves out constants that decide it",
    ClaimVerdict.definition: "the model or its labels are made so: no simulation could turn it",
    ClaimVerdict.answered: "the paper leaves the question open; what is found here holds in this run too",
    ClaimVerdict.not_run: "not judged: left out by --quick, its job did not run, or its table lacks a column",
}


def verdict(claim: Claim, ours: Value) -> ClaimVerdict:
    """Whether a measured value agrees with what the paper says.

    Args:
        claim: the claim, with its tolerance, bounds or texts.
        ours: what its measure returned.
    """
    if agrees(claim, ours):
        if claim.step:
            return ClaimVerdict.not_reproduced
        if claim.definition:
            return ClaimVerdict.definition
        return ClaimVerdict.answered if claim.asked else ClaimVerdict.reproduced
    return ClaimVerdict.open_constants if claim.open else ClaimVerdict.not_reproduced


def agrees(claim: Claim, ours: Value) -> bool:
    """Whether a value is within a claim's tolerance and bounds, or is its text; NaN never is."""
    if claim.tolerance is not None:
        theirs: Any = claim.paper
        if _listed(theirs) != _listed(ours):
            return False
        pairs = zip(_items(theirs), _items(ours), strict=False)
        same_length = len(_items(theirs)) == len(_items(ours))
        return same_length and all(_number(b) and abs(a - b) <= claim.tolerance for a, b in pairs)
    bounded = [bound for bound in (claim.between, claim.above, claim.below) if bound is not None]
    if bounded:
        low, high = claim.between or (-math.inf, math.inf)
        low = low if claim.above is None else max(low, claim.above)
        high = high if claim.below is None else min(high, claim.below)
        return all(_number(each) and low <= each <= high for each in _items(ours))
    expected: Any = claim.paper if claim.equals is None else claim.equals
    return _listed(expected) == _listed(ours) and list(_items(expected)) == list(_items(ours))


def _listed(value: object) -> bool:
    return isinstance(value, Sequence) and not isinstance(value, str)


def _items(value: Any) -> Sequence[Any]:
    return value if _listed(value) else [value]


def _number(value: object) -> bool:
    return isinstance(value, (int, float)) and math.isfinite(value)
