"""Figures from tables; each function is a kind of figure for jobs.

`figure_kind` turns a function into a kind, and `register` adds a class; call them before jobs are read.
"""

from __future__ import annotations

from typing import Any

from gaitsweep.lazy_imports import Lazy, attach_stub
from gaitsweep.plot.kind import FIGURES, drawing_function

_public, _, __all__ = attach_stub(__name__, __file__)


def __getattr__(name: str) -> Any:
    """The drawing function of a kind of figure, extensions' too, or another public name of this package."""
    if name == "theme":  # jobs are read without Matplotlib
        return Lazy({}, f"{__name__}.{name}")
    if name not in __all__ and name in FIGURES:
        return drawing_function(FIGURES[name])
    return _public(name)


def __dir__() -> list[str]:
    return sorted({*__all__, *FIGURES})
