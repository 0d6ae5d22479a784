"""What errors that a user can mend have in common: a sentence, which is all that is shown, and a code."""

from __future__ import annotations

from typing import ClassVar

REFUSED = 2  # what the user asked for cannot be done
FAILED = 1  # it could be done, but something failed on the way: a full disk


class UserError(Exception):
    """Something the user asked for cannot be done; the message says what, and what is allowed.

    Every error that a user can cause is one: the command line shows its `sentence` and ends with its
    `exit_code`; whatever else is raised is a fault of the program.
    """

    exit_code: ClassVar[int] = REFUSED

    @property
    def sentence(self) -> str:
        """The message as a sentence of its own."""
        return str(self)

    def _render_traceback_(self) -> list[str]:
        """What IPython shows in a notebook instead of the way through the package."""
        return [f"{type(self).__name__}: {self}"]


class ArgumentError(UserError, ValueError):
    """An argument that a function does not take; the message is a sentence that says what it takes."""
