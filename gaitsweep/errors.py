"""Errors that a user can correct, each a sentence without a traceback, exit codes of the command, warnings.

Here are the base of all errors and those that several rooms raise: of jobs, models, arguments and systems.
An error of one room is defined there, such as `TableError` (`table/atomic_files.py`) and `RunError`
(`runs/prepare.py`).
"""

from __future__ import annotations

import contextlib
import functools
import os
import sys
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

if TYPE_CHECKING:
    from gaitsweep.schema.diagnostics import Diagnostic

# Exit codes of the command; success is 0.
EXIT_FAILURE = 1  # a valid request failed, for example by a full disk
EXIT_REFUSED = 2  # the request is invalid
EXIT_STRICT = 3  # with `--strict`: complete, but the self-check warns or a claim is not reproduced
EXIT_STOPPED = 130  # Ctrl-C: 128 and the number of SIGINT
EXIT_TERMINATED = 143  # 128 and the number of SIGTERM

_BELOW = (
    f"{Path(__file__).parent}{os.sep}",
    contextlib.__file__,
    functools.__file__,
)  # code between the user's line and a warning
_MAX_ERRORS = 5  # in the message of a job


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


def warn(sentence: str) -> None:
    """Issue a sentence as a Python warning at the line of the caller's code that led to it."""
    frame, level = sys._getframe(1), 2
    while frame.f_back is not None and frame.f_code.co_filename.startswith(_BELOW):
        frame, level = frame.f_back, level + 1
    warnings.warn(sentence.removeprefix("Warning: "), stacklevel=level)


def refuse_windows() -> None:
    """Refuse Windows, whose file locks and signals differ.

    Raises:
        UnsupportedSystem: this is Windows.
    """
    if sys.platform == "win32":
        raise UnsupportedSystem(
            "Windows is not supported; use WSL 2 (`wsl --install`, then `pip install gaitsweep` there)."
        )


class ArgumentError(UserError, ValueError):
    """An invalid argument of a function; the message is a sentence with the allowed values."""


class JobError(UserError):
    """A job that cannot be run: `diagnostics` has all errors, causes first; the message has the first few."""

    def __init__(self, diagnostics: Sequence[Diagnostic]) -> None:
        self.diagnostics = tuple(sorted(dict.fromkeys(diagnostics), key=lambda each: not each.is_cause))
        lines = [str(diagnostic) for diagnostic in self.diagnostics[:_MAX_ERRORS]]
        if len(self.diagnostics) > _MAX_ERRORS:
            lines.append(f"... and {len(self.diagnostics) - _MAX_ERRORS} more.")
        super().__init__("\n".join(lines))

    def __reduce__(self) -> tuple[type[JobError], tuple[tuple[Diagnostic, ...]]]:
        return JobError, (self.diagnostics,)


class ModelError(UserError, LookupError):
    """A model is not available; the message continues a sentence that begins with "The model"."""

    subject = "The model "


class Terminated(KeyboardInterrupt):
    """SIGTERM requested a stop of the run."""


def exit_code_of_stop(stop: KeyboardInterrupt) -> int:
    """The exit code of a command that a signal has stopped."""
    return EXIT_TERMINATED if isinstance(stop, Terminated) else EXIT_STOPPED
