"""Writing of new files for a user: all or none, and without replacing existing files."""

from __future__ import annotations

import os
import shutil
from collections.abc import Mapping
from pathlib import Path

from gaitsweep.errors import EXIT_FAILURE, UserError


class NewFilesError(UserError):
    """New files would replace existing ones, or cannot be written there; the message names them."""


class NotWrittenError(NewFilesError):
    """New files could not be written, for example on a full disk."""

    exit_code = EXIT_FAILURE


def write_folder(folder: Path, files: Mapping[str, str]) -> None:
    """Write a new folder with these texts by file name.

    Raises:
        NewFilesError: the folder exists, or cannot be made there.
    """
    if folder.exists() or folder.is_symlink():
        raise NewFilesError(f"{folder} exists already: choose another name, or another folder with --to DIR.")
    hidden = None
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        hidden = folder.with_name(f".{folder.name}.{os.getpid()}")
        hidden.mkdir()
        for name, text in files.items():
            (hidden / name).parent.mkdir(parents=True, exist_ok=True)
            (hidden / name).write_text(text, encoding="utf-8")
        os.rename(hidden, folder)
    except OSError as error:
        raise _not_written(folder, error) from error
    finally:
        if hidden is not None:
            shutil.rmtree(hidden, ignore_errors=True)


def add_files(folder: Path, files: Mapping[str, str]) -> list[Path]:
    """Write new files into a folder, which is created if missing; existing identical files are left.

    Args:
        folder: the folder.
        files: their texts by their paths in the folder.

    Returns:
        Their paths.

    Raises:
        NewFilesError: a file exists with different contents; then no file is written.
    """
    paths = {folder / name: text for name, text in files.items()}
    for path, text in paths.items():
        alike = path.is_file() and path.read_bytes() == text.encode()
        if not alike and (path.exists() or path.is_symlink()):
            raise NewFilesError(
                f"{path} exists already with different contents: choose another folder with --to DIR."
            )
    for path, text in paths.items():
        if path.exists():
            continue
        partial = path.with_name(f".{path.name}.{os.getpid()}")
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            partial.write_text(text, encoding="utf-8")
            os.replace(partial, path)
        except OSError as error:
            partial.unlink(missing_ok=True)
            raise _not_written(path, error) from error
    return list(paths)


def _not_written(path: Path, error: OSError) -> NewFilesError:
    why = (error.strerror or type(error).__name__).lower()
    place = isinstance(error, (PermissionError, NotADirectoryError, FileExistsError, IsADirectoryError))
    kind = NewFilesError if place else NotWrittenError
    return kind(f"{path} could not be written: {why}.")
