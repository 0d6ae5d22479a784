"""What errors that a user can mend have in common: the message is a sentence, and all that is shown."""

from __future__ import annotations


class UserError(Exception):
    """Something the user asked for cannot be done; the message says what, and what is allowed."""

    def _render_traceback_(self) -> list[str]:
        """What IPython shows in a notebook instead of the way through the package."""
        return [f"{type(self).__name__}: {self}"]
