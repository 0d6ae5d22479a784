"""The verdict on a claim: whether the value that its measure gives agrees with the paper's."""

from __future__ import annotations

import enum
import math
from collections.abc import Sequence
from typing import Any

from gaitsweep.claims.measures import Value
from gaitsweep.claims.paper import Claim


class ClaimVerdict(enum.StrEnum):
    """Verdict on a claim: its value in tables, its words in text for readers, and their meaning."""

    words: str
    sentence: str

    def __new__(cls, value: str, words: str, sentence: str) -> ClaimVerdict:
        member = str.__new__(cls, value)
        member._value_, member.words, member.sentence = value, words, sentence
        return member

    reproduced = (
        "reproduced",
        "reproduced",
        "our value agrees with the paper's within the tolerance",
    )
    not_reproduced = (
        "not",
        "not reproduced",
        "our value does not agree with the paper's, or not with finer steps",
    )
    open_constants = (
        "open: constants",
        "with open constants",
        "our value does not agree, and the paper lacks constants that decide it",
    )
    definition = (
        "definition",
        "true by definition",
        "the definition of the model or of its labels decides it, and no simulation can change it",
    )
    answered = (
        "answered",
        "answered",
        "the paper leaves the question open, and this run confirms our answer",
    )
    not_run = (
        "not run",
        "not run",
        "no verdict: --quick leaves it out, its job did not run, or its table lacks a column",
    )


def verdict(claim: Claim, ours: Value) -> ClaimVerdict:
    """The verdict on a claim from its measured value.

    Args:
        claim: the claim, with its tolerance, bounds or texts.
        ours: the result of its measure.
    """
    if agrees(claim, ours):
        if claim.step:
            return ClaimVerdict.not_reproduced
        if claim.definition:
            return ClaimVerdict.definition
        return ClaimVerdict.answered if claim.asked else ClaimVerdict.reproduced
    return ClaimVerdict.open_constants if claim.open else ClaimVerdict.not_reproduced


def agrees(claim: Claim, ours: Value) -> bool:
    """Whether a value is within a claim's tolerance and bounds, or equals its text; false for NaN."""
    if claim.tolerance is not None:
        theirs: Any = claim.paper
        if _listed(theirs) != _listed(ours):
            return False
        pairs = zip(_items(theirs), _items(ours), strict=False)
        same_length = len(_items(theirs)) == len(_items(ours))
        return same_length and all(_number(b) and abs(a - b) <= claim.tolerance for a, b in pairs)
    if claim.interval is not None:
        low, high = claim.interval
        return all(_number(item) and low <= item <= high for item in _items(ours))
    expected: Any = claim.paper if claim.equals is None else claim.equals
    return _listed(expected) == _listed(ours) and list(_items(expected)) == list(_items(ours))


def _listed(value: object) -> bool:
    return isinstance(value, Sequence) and not isinstance(value, str)


def _items(value: Any) -> Sequence[Any]:
    return value if _listed(value) else [value]


def _number(value: object) -> bool:
    return isinstance(value, (int, float)) and math.isfinite(value)
