"""Results of tracing a model in the cache folder, so that a known model is not traced again.

The name of an entry is a digest of all that decides it: the content of the model with the sources of its
modules, gaitsweep's own sources, the versions that trace and compile, and the settings of JAX. Results are
JSON, of which nothing is run.
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
import numpy as np
from jaxlib.version import __version__ as jaxlib_version

from gaitsweep.cache_folder import cache_folder, load_cached, store_cached
from gaitsweep.compilation import compiling
from gaitsweep.contract import Model
from gaitsweep.engine.content import lasting_content

# settings of JAX that change no trace
_WITHOUT_EFFECT = ("cache", "devices", "platforms", "log", "traceback")


def stored(name: str, model: Model, others: tuple[Any, ...], compute: Callable[[], Any]) -> Any:
    """The result of `compute` for a model, as JSON gives it back, read from the cache if it is there.

    Args:
        name: the name of the result.
        model: the model, whose content is part of the key of the cache.
        others: other objects that decide the result.
        compute: traces the model; called only if the cache lacks the result.
    """
    content = lasting_content(model, name, *others)
    folder = None if content is None else cache_folder("programs")
    if folder is None:
        with compiling():
            return json.loads(json.dumps(compute()))
    key = repr((content, _SOURCES, _VERSIONS, _settings()))
    file = folder / f"{name}_{hashlib.sha256(key.encode()).hexdigest()[:32]}"
    text = load_cached(file)
    if text is None:
        with compiling():
            text = json.dumps(compute()).encode()
        # files that tracing reads are known only afterwards, and change the content
        if lasting_content(model, name, *others) == content:
            store_cached(file, text)
    return json.loads(text)


def _stamps(folder: str) -> Iterator[tuple[str, int, int]]:
    """The path, modification time (ns) and size of each source in a folder and below it."""
    for entry in os.scandir(folder):
        if entry.is_dir() and entry.name != "__pycache__":
            yield from _stamps(entry.path)
        elif entry.name.endswith(".py"):
            status = entry.stat()
            yield entry.path, status.st_mtime_ns, status.st_size


# gaitsweep's sources as they are imported, not as they may be edited later
_SOURCES = hashlib.sha256(repr(sorted(_stamps(str(Path(__file__).parents[1])))).encode()).hexdigest()
_VERSIONS = sys.version, jax.__version__, jaxlib_version, np.__version__, os.environ.get("XLA_FLAGS")


def _settings() -> list[tuple[str, str]]:
    """The settings of JAX that may change a trace."""
    settings = []
    for name, value in sorted(jax.config.values.items()):
        if not any(word in name for word in _WITHOUT_EFFECT):
            settings.append((name, repr(value)))
    return settings
