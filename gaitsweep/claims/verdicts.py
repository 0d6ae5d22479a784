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
        member._value_ = value
        member.words = words
        member.sentence = sentence
        return member

    reproduced = "reproduced", "reproduced", "our value agrees with the paper's within the tolerance"
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
    answered = "answered", "answered", "the paper leaves the question open, and this run confirms our answer"
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
    """Return whether a value is within a claim's tolerance and bounds, or equals its text; false for NaN.

    Args:
        claim, ours: as for `verdict`.
    """
    values = _items(ours)
    tolerance = claim.tolerance
    if tolerance is None and claim.interval is not None:
        low, high = claim.interval
        return all(_is_finite(value) and low <= value <= high for value in values)
    expected: Any = claim.paper if claim.equals is None or tolerance is not None else claim.equals
    expected_values = _items(expected)
    if _is_list(expected) != _is_list(ours) or len(expected_values) != len(values):
        return False
    if tolerance is None:
        return expected_values == values
    pairs = zip(expected_values, values, strict=True)
    return all(_is_finite(value) and abs(target - value) <= tolerance for target, value in pairs)


def _is_list(value: Value) -> bool:
    """Return whether a value is a list; a text is none."""
    return isinstance(value, Sequence) and not isinstance(value, str)


def _items(value: Any) -> list[Any]:
    """The items of a list; a list with the value itself for others."""
    return list(value) if _is_list(value) else [value]


def _is_finite(value: object) -> bool:
    """Return whether a value is a finite number."""
    return isinstance(value, (int, float)) and math.isfinite(value)
