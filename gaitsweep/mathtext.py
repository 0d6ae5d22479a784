"""Formulas in texts of figures: whether Matplotlib can set them, and texts that it can."""

from __future__ import annotations

import functools


@functools.lru_cache(maxsize=1024)
def can_be_set(text: str) -> bool:
    r"""Return whether Matplotlib can draw a text; TeX stands between two dollar signs, and \$ is a dollar."""
    if text.replace("\\$", "").count("$") < 2:
        return True
    from matplotlib.mathtext import MathTextParser  # only for texts that have formulas

    try:
        MathTextParser("path").parse(text)
    except (ValueError, RuntimeError, RecursionError):
        return False
    return True


def settable(text: str) -> str:
    """A text in which dollar signs are dollars where Matplotlib cannot set its formulas."""
    return text if can_be_set(text) else text.replace("$", "\\$")
