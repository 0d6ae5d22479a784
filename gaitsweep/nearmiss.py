"""How a refusal names what is allowed: the nearest allowed word, and the list of them."""

from __future__ import annotations

import difflib
from collections.abc import Iterable

_LONGEST_LIST = 40


def nearest(word: str, allowed: Iterable[str]) -> str | None:
    """The allowed word that looks most like `word`, or None where none looks like it; case does not count."""
    by_lower: dict[str, str] = {}
    for name in allowed:
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
