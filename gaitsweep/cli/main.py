"""Runs a command, and turns every refusal into a sentence and an exit code.

0: done; 1: something failed while running (a full disk); 2: the user's input was refused; 130: Ctrl-C.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence

import typer

from gaitsweep.cli.commands import app

FAILED, REFUSED, STOPPED = 1, 2, 130

# By module: one that is not imported has raised nothing, and importing it only to ask would cost seconds.
_SENTENCES = (
    ("gaitsweep.job", "JobError", REFUSED),
    ("gaitsweep.models", "ModelError", REFUSED),
    ("gaitsweep.table", "WriteError", FAILED),
    ("gaitsweep.table", "TableError", REFUSED),
    ("gaitsweep.runner", "RunError", REFUSED),
    ("gaitsweep.plot", "PlotError", REFUSED),
)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line.

    Args:
        arguments: what follows `gaitsweep`; that of this process by default.

    Returns:
        The exit code.
    """
    try:
        code = app(args=arguments, prog_name="gaitsweep", standalone_mode=False)
    except KeyboardInterrupt:
        return STOPPED
    except Exception as error:
        refusal = _refusal(error)
        if refusal is None:
            raise
        sentence, code = refusal
        print(sentence, file=sys.stderr)
    return code if isinstance(code, int) else 0


def _refusal(error: Exception) -> tuple[str, int] | None:
    """Give the sentence and the exit code of what a user can do something about, None for a fault of ours."""
    for module, name, code in _SENTENCES:
        if module in sys.modules and isinstance(error, getattr(sys.modules[module], name)):
            return (f"The model {error}" if name == "ModelError" else str(error)), code
    if isinstance(error, typer.TyperException):
        return error.format_message(), error.exit_code
    if isinstance(error, OSError) and error.filename is not None:
        return f"{error.filename}: {(error.strerror or 'cannot be used').lower()}.", FAILED
    return None
