"""What reading one job may cost: searches and evaluations are counted, so that no file takes long."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from contextvars import ContextVar
from typing import Literal

Kind = Literal["near misses", "expressions"]

# A near miss takes about 1 ms, an expression .1 ms.
MOST: dict[Kind, int] = {"near misses": 200, "expressions": 5_000}
_LEFT: ContextVar[dict[Kind, int] | None] = ContextVar("_LEFT", default=None)


class Effort:
    """How much more of each kind a job that is being read may ask for; nothing is limited elsewhere."""

    @staticmethod
    @contextlib.contextmanager
    def limited() -> Iterator[None]:
        """The time in which one job is read; one inside another counts for the outer one."""
        if _LEFT.get() is not None:
            yield
            return
        token = _LEFT.set(dict(MOST))
        try:
            yield
        finally:
            _LEFT.reset(token)

    @staticmethod
    def spend(kind: Kind) -> bool:
        """Take one of a kind; False where none is left."""
        left = _LEFT.get()
        if left is None:
            return True
        left[kind] -= 1
        return left[kind] >= 0
