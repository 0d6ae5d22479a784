"""Running of commands; every user error becomes a sentence and an exit code.

`gaitsweep/errors.py` has the exit codes.
"""

from __future__ import annotations

import errno
import gc
import io
import os
import sys
import warnings
from collections.abc import Callable, Sequence
from typing import Any

import typer

from gaitsweep.cache_folder import cache_folder
from gaitsweep.errors import EXIT_FAILURE, UserError, exit_code_of_stop, refuse_windows
from gaitsweep.lazy_imports import lazy_packages

# Messages of JAX, Python and the loader of shared libraries when memory is exhausted.
_NO_MEMORY = (
    "RESOURCE_EXHAUSTED",
    "can't start new thread",
    "failed to map segment",
    "Cannot allocate memory",
)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line.

    Args:
        arguments: the arguments after `gaitsweep`; by default those of this process.

    Returns:
        The exit code.
    """
    # imports and tracing make few cycles and many objects, which would be searched again and again
    gc.set_threshold(50_000)
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:  # closed (>&-)
            setattr(sys, name, open(os.devnull, "w"))  # noqa: SIM115 - open until the process ends
    for stream in (sys.stdout, sys.stderr):
        # characters outside the terminal's encoding are written as escapes
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    # pydantic would look through all installed packages
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")
    try:
        refuse_windows()
        from gaitsweep.cli.commands import app  # which Windows cannot import

        with lazy_packages(), warnings.catch_warnings():
            warnings.showwarning = _shown_as_sentence(warnings.showwarning)
            keep_compiled_programs()
            keep_other_work_on_host()
            code = app(args=arguments, prog_name="gaitsweep", standalone_mode=False)
            sys.stdout.flush()
    except KeyboardInterrupt as stop:
        return exit_code_of_stop(stop)
    except UserError as error:
        return _report_error(error.sentence, error.exit_code)
    except typer.TyperException as error:
        return _report_error(error.format_message(), error.exit_code)
    except Exception as error:
        if (sentence := _of_the_machine(error)) is None:
            raise  # a fault of the program
        return _report_error(sentence, EXIT_FAILURE)
    return code if isinstance(code, int) else 0


def _report_error(sentence: str, code: int) -> int:
    """Print an error message, and return the exit code; a full or closed stream is not used again."""
    for stream, text in ((sys.stderr, f"{sentence}\n" if sentence else ""), (sys.stdout, "")):
        try:
            stream.write(text)
            stream.flush()
        except OSError:  # Python would try again at its end
            os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
    return code


def _of_the_machine(error: Exception) -> str | None:
    """The message for a shortage of memory, threads or disk, or None for other errors."""
    if isinstance(error, BrokenPipeError):
        return ""  # the reader of our output has closed it (| head), which is no error
    if isinstance(error, OSError):
        from gaitsweep.table.atomic_files import reason  # which loads pandas

        if error.filename is not None:
            return f"{error.filename} cannot be used: {reason(error)}."
        try:
            os.getcwd()
        except OSError:
            return "The working directory no longer exists: change to another one."
        return f"The output cannot be written: {reason(error)}." if error.errno == errno.ENOSPC else None
    import resource  # which Windows lacks, where `main` refuses in a sentence

    limited = resource.getrlimit(resource.RLIMIT_AS)[0] != resource.RLIM_INFINITY
    no_memory = isinstance(error, MemoryError) or any(word in str(error) for word in _NO_MEMORY)
    if no_memory or (limited and isinstance(error, ImportError)):  # a library that cannot be loaded
        return (
            "This process ran out of memory (that of the machine, or the limit of ulimit -v). Stored results "
            "are safe. Reduce engine.lanes or engine.block to use less memory."
        )
    return None


def _shown_as_sentence(otherwise: Callable[..., None]) -> Callable[..., None]:
    """Show gaitsweep's warnings, such as an incomplete table, without the line of code that raised them."""

    def show_warning(message: Warning | str, category: type[Warning], *where: Any, **more: Any) -> None:
        if category is UserWarning:
            print(f"Warning: {message}", file=sys.stderr)
        else:
            otherwise(message, category, *where, **more)

    return show_warning


def keep_compiled_programs() -> None:
    """Set JAX's cache folder, so that XLA's programs are compiled once per machine and not once per run.

    Nothing is set if JAX has been imported or the user has set a folder. JAX manages the cache; its file
    names contain versions and instruction sets of processors, so a home folder may be shared. Programs that
    cannot be read or written are compiled again silently.
    """
    if "jax" in sys.modules or "JAX_COMPILATION_CACHE_DIR" in os.environ:
        return
    folder = cache_folder("xla")
    if folder is None:
        return
    os.environ["JAX_COMPILATION_CACHE_DIR"] = str(folder)
    # also those that compile fast, since a run has many of them
    os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0")
    os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES", "0")
    # programs only: no choices that XLA makes by timing
    os.environ.setdefault("JAX_PERSISTENT_CACHE_ENABLE_XLA_CACHES", "none")
    warnings.filterwarnings("ignore", "Error (reading|writing) persistent compilation cache", UserWarning)


def keep_other_work_on_host() -> None:
    """Make the CPU JAX's default device, for what is computed beside rows: figures, analyses, solutions.

    Rows run on the devices of their run. A GPU takes seconds to begin, and little time of a few small
    programs. Nothing is set if JAX has been imported or may not use the CPU (JAX_PLATFORMS=cuda).
    """
    platforms = os.environ.get("JAX_PLATFORMS") or "cpu"
    if "jax" not in sys.modules and "cpu" in platforms.split(","):
        os.environ.setdefault("JAX_DEFAULT_DEVICE", "cpu")
