"""Runs a command, and turns every error of the user into a sentence and an exit code.

0: done; 1: something failed while running (a full disk); 2: the user's input was refused; 130: Ctrl-C;
143: SIGTERM.
"""

from __future__ import annotations

import gc
import io
import os
import sys
import warnings
from collections.abc import Callable, Sequence
from typing import Any

import typer

from gaitsweep.cli.commands import STOPPED, app
from gaitsweep.cli.compiled_programs import keep_compiled_programs
from gaitsweep.errors import FAILED, UserError, refuse_windows


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line.

    Args:
        arguments: the words after `gaitsweep`; by default those of this process.

    Returns:
        The exit code.
    """
    # imports and tracing make few cycles and many objects, which would be searched again and again
    gc.set_threshold(50_000)
    for stream in (sys.stdout, sys.stderr):
        # characters outside the terminal's encoding are written as escapes
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    try:
        refuse_windows()
        with warnings.catch_warnings():
            warnings.showwarning = _shown_as_sentence(warnings.showwarning)
            keep_compiled_programs()
            code = app(args=arguments, prog_name="gaitsweep", standalone_mode=False)
    except KeyboardInterrupt as stop:
        return getattr(stop, "exit_code", STOPPED)
    except UserError as error:
        print(error.sentence, file=sys.stderr)
        return error.exit_code
    except typer.TyperException as error:
        print(error.format_message(), file=sys.stderr)
        return error.exit_code
    except BrokenPipeError:
        # the reader of our output has closed it (| head): this is no error, and nothing can be printed
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return FAILED
    return code if isinstance(code, int) else 0


def _shown_as_sentence(otherwise: Callable[..., None]) -> Callable[..., None]:
    """Show our own warnings, such as an incomplete table, without the line of code that raised them."""

    def show(message: Warning | str, category: type[Warning], *where: Any, **more: Any) -> None:
        if category is UserWarning:
            print(f"Warning: {message}", file=sys.stderr)
        else:
            otherwise(message, category, *where, **more)

    return show
