"""What tracing a model gives, stored in the cache folder, so that a known model is not traced again.

An entry is JSON, of which nothing is run. Its name is a digest of all that decides it: the content of the
model with the sources of its modules, gaitsweep's own files, the versions that trace, and JAX's settings.
"""

from __future__ import annotations

import hashlib
import json
import os
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import jax
from jaxlib.version import __version__ as jaxlib_version
import numpy as np

from gaitsweep.cache_folder import cache_folder, keep, kept
from gaitsweep.contract import Model
from gaitsweep.engine.content import lasting_content

# settings of JAX that change no trace
_WITHOUT_EFFECT = ("cache", "devices", "platforms", "log", "traceback")


def stored(what: str, model: Model, others: tuple[Any, ...], work_out: Callable[[], Any]) -> Any:
    """What `work_out` returns for a model, of lists, texts and numbers; read where a process stored it.

    Args:
        what: the name of the function that works it out.
        model: the model, by whose content it is found again.
        others: what else decides the result.
        work_out: traces the model; not called where its result is stored.
    """
    content = lasting_content(model, what, *others)
    folder = None if content is None else cache_folder("programs")
    if folder is None:
        return work_out()
    key = hashlib.sha256(repr((content, _OWN_FILES, _VERSIONS, _settings())).encode()).hexdigest()
    file = folder / f"{what}_{key[:32]}.json"
    if (text := kept(file)) is not None:
        return json.loads(text)
    result = work_out()
    # unless it has read files, which are known afterwards
    if lasting_content(model, what, *others) == content:
        keep(file, json.dumps(result).encode())
    return result


def _stamps(folder: str) -> Iterator[tuple[str, int, int]]:
    """The path, modification time (ns) and size of each source in a folder and below it."""
    for entry in os.scandir(folder):
        if entry.is_dir() and entry.name != "__pycache__":
            yield from _stamps(entry.path)
        elif entry.name.endswith(".py"):
            about = entry.stat()
            yield entry.path, about.st_mtime_ns, about.st_size


# gaitsweep's sources as they are imported, not as they may be edited later, and the versions that trace
_OWN_FILES = sorted(_stamps(str(Path(__file__).parents[1])))
_VERSIONS = sys.version, jax.__version__, jaxlib_version, np.__version__


def _settings() -> list[tuple[str, str]]:
    """The settings of JAX that may change a trace."""
    names = [name for name in jax.config.values if not any(word in name for word in _WITHOUT_EFFECT)]
    return [(name, repr(getattr(jax.config, name, None))) for name in sorted(names)]
