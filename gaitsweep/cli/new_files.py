"""New files of a command, which replace none that exist."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Mapping
from pathlib import Path

from gaitsweep.errors import UserError


class NewFilesError(UserError):
    """New files would replace existing ones, or their name is not allowed; the message names them."""


def write_folder(folder: Path, files: Mapping[str, str]) -> None:
    """Write a new folder with these texts by file name.

    Raises:
        NewFilesError: the folder exists.
        TableError: it cannot be written.
    """
    from gaitsweep.table import writing  # loads pandas

    with writing(f"{folder} could not be written"):
        if folder.exists() or folder.is_symlink():
            raise NewFilesError(
                f"{folder} exists already: choose another name, or another folder with --to DIR."
            )
        folder.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=f".{folder.name}.", dir=folder.parent) as hidden:
            new = Path(hidden, folder.name)
            for name, text in files.items():
                (new / name).parent.mkdir(parents=True, exist_ok=True)
                (new / name).write_text(text, encoding="utf-8")
            os.rename(new, folder)


def add_files(folder: Path, files: Mapping[str, str]) -> list[Path]:
    """Write new files into a folder, which is created if missing; existing identical files are left.

    Args:
        folder: the folder.
        files: their texts by their paths in the folder.

    Returns:
        Their paths.

    Raises:
        NewFilesError: a file exists with different contents; then no file is written.
        TableError: a file cannot be written.
    """
    from gaitsweep.table import replace_file, writing  # loads pandas

    paths = {folder / name: text.encode() for name, text in files.items()}
    for path, data in paths.items():
        with writing(f"{path} could not be written"):
            identical = path.is_file() and path.read_bytes() == data
            if not identical and (path.exists() or path.is_symlink()):
                raise NewFilesError(
                    f"{path} exists already with different contents: choose another folder with --to DIR."
                )
    for path, data in paths.items():
        if not path.exists():
            with writing(f"{path} could not be written"):
                path.parent.mkdir(parents=True, exist_ok=True)
                replace_file(path, lambda file, data=data: file.write(data))
    return list(paths)
