"""TeX formulas in texts of figures: whether Matplotlib can draw them, and their escape where it cannot."""

from __future__ import annotations

import functools
import re


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


def escape_unparsable(text: str) -> str:
    """Escape the dollar signs of a text whose formulas Matplotlib cannot draw."""
    return text if can_be_set(text) else re.sub(r"(?<!\\)\$", r"\\$", text)
