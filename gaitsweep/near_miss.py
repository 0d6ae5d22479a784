"""The end of an error message about an unknown name: the nearest allowed name, and the list of them.

Near misses take time, so a file with many errors has a budget of them, and of expressions: it is read
quickly whatever is written in it.
"""

from __future__ import annotations

import contextlib
import difflib
import itertools
from collections.abc import Iterable, Iterator
from contextvars import ContextVar
from typing import Literal

__all__ = ["allowing", "nearest", "suggestion"]

_LONGEST_LIST = 40
_LONGEST_WORD = 60  # letters: longer words are not typing errors, and are slow to compare
_MAX_COMPARED = 2000  # number of allowed words that are compared

Budgeted = Literal["near misses", "expressions"]
# The budget of one file. A near miss takes about 1 ms, an expression 0.1 ms.
BUDGET: dict[Budgeted, int] = {"near misses": 200, "expressions": 5_000}
# The remaining budget of the file that is being read; without one there is no limit.
_REMAINING: ContextVar[dict[Budgeted, int] | None] = ContextVar("remaining", default=None)


@contextlib.contextmanager
def limited_effort() -> Iterator[None]:
    """A context in which one file is read; a nested context uses the budget of the outer one."""
    token = _REMAINING.set(_REMAINING.get() or dict(BUDGET))
    try:
        yield
    finally:
        _REMAINING.reset(token)


def spend(kind: Budgeted) -> bool:
    """Spend one unit of the budget of a kind; return False if none is left."""
    remaining = _REMAINING.get()
    if remaining is None:
        return True
    remaining[kind] -= 1
    return remaining[kind] >= 0


def nearest(word: str, allowed: Iterable[str]) -> str | None:
    """The allowed word that is most similar to another one, without regard to case.

    Of equally similar words it is the first of those with the longest common beginning, and then the nearest
    letter or digit: of x_1, x_2 and x_3 the last for x_4.

    Args:
        word: the word that is not allowed.
        allowed: the allowed words.

    Returns:
        The word; None if none is similar, if `word` is very long, or if the file's budget of near misses is
        spent.
    """
    if len(word) > _LONGEST_WORD or not spend("near misses"):
        return None
    by_lower: dict[str, str] = {}
    for name in itertools.islice(allowed, _MAX_COMPARED):
        if len(name) <= 2 * _LONGEST_WORD:
            by_lower.setdefault(name.lower(), name)
    lower = word.lower()
    matches = difflib.get_close_matches(lower, list(by_lower), n=_MAX_COMPARED, cutoff=0.6)
    if not matches:
        return None
    similarity = {name: difflib.SequenceMatcher(None, name, lower).ratio() for name in matches}
    most_similar = [name for name in by_lower if similarity.get(name) == similarity[matches[0]]]

    def beginning(name: str) -> tuple[int, int]:
        """The length of the common beginning, and minus the distance of the characters behind it."""
        length = next(end for end in range(len(lower), -1, -1) if name.startswith(lower[:end]))
        behind = zip(name[length : length + 1], lower[length : length + 1], strict=False)
        return length, -sum(abs(ord(character) - ord(other)) for character, other in behind)

    return by_lower[max(most_similar, key=beginning)]


def suggestion(word: str, allowed: Iterable[str]) -> str:
    """The end of an error message about an unknown word: "; did you mean kappa? Allowed: beta, kappa.".

    Args:
        word: the word that is not allowed.
        allowed: the allowed words.

    Example:
        >>> import gaitsweep as gs
        >>> gs.near_miss.suggestion("kapa", ["beta", "kappa"])
        '; did you mean kappa? Allowed: beta, kappa.'
    """
    names = list(allowed)
    near = nearest(word, names)
    question = f"; did you mean {near}?" if near is not None else "."
    return f"{question} {allowing(names)}"


def column_suggestion(word: str, columns: Iterable[str]) -> str:
    """The end of an error message about an unknown column: as `suggestion`, and where an observable stands.

    Args:
        word: the name that is no column.
        columns: the columns of the table.
    """
    names = list(columns)
    meanings = {f"{word}_n": "at each section crossing", f"{word}_end": "where a row ended"}
    explained = [f"{name} is its value {where}" for name, where in meanings.items() if name in names]
    text = suggestion(word, names)
    return f"{text} {', and '.join(explained)}." if explained else text


def allowing(names: Iterable[str]) -> str:
    """The list of allowed names as a sentence, shortened to `_LONGEST_LIST` names."""
    listed = list(names)
    if not listed:
        return "Nothing is allowed here."
    tail = "" if len(listed) <= _LONGEST_LIST else f" and {len(listed) - _LONGEST_LIST} more"
    return f"Allowed: {', '.join(listed[:_LONGEST_LIST])}{tail}."
