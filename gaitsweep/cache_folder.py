"""The folder of what can be computed again.

It is $GAITSWEEP_CACHE, by default $XDG_CACHE_HOME/gaitsweep or ~/.cache/gaitsweep.
"""

from __future__ import annotations

import os
import tempfile
from pathlib import Path


def cache_folder(name: str) -> Path | None:
    """The folder of this name in the cache, made if it is not there; None where it cannot be written."""
    base = os.environ.get("GAITSWEEP_CACHE")
    if base is None:
        base = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "gaitsweep"
    folder = Path(base) / name
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return folder
    except OSError:
        return None


def write_whole(file: Path, content: bytes) -> None:
    """Write a file at once, since other processes may read it."""
    with tempfile.NamedTemporaryFile(dir=file.parent, suffix=".tmp", delete=False) as draft:
        draft.write(content)
    os.replace(draft.name, file)
