"""Errors that a user can correct: a sentence, which is shown without a traceback, and an exit code."""

from __future__ import annotations

import sys
from typing import ClassVar

EXIT_FAILURE = 1  # exit code: the request is valid, but its execution failed, for example by a full disk
EXIT_REFUSED = 2  # exit code: the request is invalid
EXIT_DOUBTFUL = 3  # exit code with `--strict`: a self-check warned, or a claim was not reproduced


class UserError(Exception):
    """A request of the user cannot be executed; the message gives the reason and the allowed values.

    All errors that a user can cause derive from it: the command line shows the `sentence` and ends with the
    `exit_code`. Any other exception is a bug.
    """

    exit_code: ClassVar[int] = EXIT_REFUSED
    subject: ClassVar[str] = ""  # the words that the message continues, if it is not a complete sentence

    @property
    def sentence(self) -> str:
        """The message as a complete sentence."""
        return f"{self.subject}{self}"

    def _render_traceback_(self) -> list[str]:
        """The lines that IPython shows in a notebook instead of a traceback."""
        return [f"{type(self).__name__}: {self}"]


class UnsupportedSystem(UserError):
    """This system lacks a feature that the request needs; the message names an alternative."""


def refuse_windows() -> None:
    """Raise UnsupportedSystem on Windows, whose file locks and signals differ."""
    if sys.platform == "win32":
        raise UnsupportedSystem(
            "Windows is not supported; use WSL 2 (`wsl --install`, then `pip install gaitsweep` there)."
        )


class ArgumentError(UserError, ValueError):
    """An invalid argument of a function; the message is a sentence with the allowed values."""
