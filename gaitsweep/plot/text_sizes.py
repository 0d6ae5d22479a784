"""Sizes of text in figures, and lines that fit a width."""

from __future__ import annotations

import re
import textwrap

import matplotlib as mpl

POINTS = 8.0  # of text, unless the user's rcParams differ from Matplotlib's defaults
_LETTER = 0.53  # mean width of a letter, as a share of the size of its font
_FORMULA = re.compile(r"(?<!\\)\$(?:[^$\\]|\\.)*\$")  # \$ is a dollar sign, no begin of a formula
# In a formula, what has no width, and commands, which are a letter wide.
_MARKUP = re.compile(r"\\(?:mathrm|mathit|mathbf|bar|hat|tilde|dot|vec|left|right|,)(?![a-z])|[{}_^$]")
_COMMAND = re.compile(r"\\[A-Za-z]+")


def points(size: float) -> float:
    """A font size in the theme, larger or smaller if the user's `font.size` is."""
    return size * mpl.rcParams["font.size"] / POINTS


def wrapped(text: str, inches: float, size: float) -> str:
    """A text in lines that fit a width, at a font size of the theme."""
    letters = max(int(inches * 72 / (_LETTER * points(size))), 8)
    formulas = iter(_FORMULA.findall(text))
    # no break in a formula, which is as long as its letters, before its unit, nor beside a sign of equality
    unbroken = _FORMULA.sub(lambda formula: "\1" + "\2" * (_letters(formula[0]) - 1), text)
    unbroken = re.sub("(?<=[\1\2]) [(]", "\0(", unbroken.replace(" = ", "\0=\0"))
    lines = (textwrap.fill(line, letters, break_long_words=False) for line in unbroken.split("\n"))
    return re.sub("\1\2*", lambda _: next(formulas), "\n".join(lines).replace("\0", " "))


def _letters(formula: str) -> int:
    """The number of letters in a formula, at least one."""
    return max(len(_COMMAND.sub("x", _MARKUP.sub("", formula))), 1)
