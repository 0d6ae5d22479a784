"""How a refusal names what is allowed: the nearest allowed word, and the list of them."""

from __future__ import annotations

import difflib
import itertools
from collections.abc import Iterable

from gaitsweep.effort import Effort

_LONGEST_LIST = 40
_LONGEST_WORD = 60  # letters: what is longer is no slip of the finger, and takes long to compare
_MOST_COMPARED = 2000  # allowed words that are compared


def nearest(word: str, allowed: Iterable[str]) -> str | None:
    """The allowed word that looks most like `word`, or None where none looks like it; case does not count.

    None too where `word` is very long, or where a job has had near misses enough (`Effort`).
    """
    if len(word) > _LONGEST_WORD or not Effort.spend("near misses"):
        return None
    by_lower: dict[str, str] = {}
    for name in itertools.islice(allowed, _MOST_COMPARED):
        if len(name) <= 2 * _LONGEST_WORD:
            by_lower.setdefault(name.lower(), name)
    found = difflib.get_close_matches(word.lower(), list(by_lower), n=1, cutoff=0.6)
    return by_lower[found[0]] if found else None


def suggestion(word: str, allowed: Iterable[str]) -> str:
    """The end of a refusal, "; did you mean kappa? Allowed: beta, kappa.", the near miss if there is one."""
    names = list(allowed)
    near = nearest(word, names)
    question = f"; did you mean {near}?" if near is not None else "."
    return f"{question} {allowing(names)}"


def allowing(names: Iterable[str]) -> str:
    """The list of what is allowed as a sentence, cut where it grows past what anybody reads."""
    listed = list(names)
    if not listed:
        return "Nothing is allowed here."
    tail = "" if len(listed) <= _LONGEST_LIST else f" and {len(listed) - _LONGEST_LIST} more"
    return f"Allowed: {', '.join(listed[:_LONGEST_LIST])}{tail}."
