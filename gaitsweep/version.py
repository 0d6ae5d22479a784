"""The version of the installed package."""

from __future__ import annotations

import functools
import importlib.metadata


@functools.cache
def version() -> str:
    """Give the version, or "unknown" where the package runs from a folder without being installed."""
    try:
        return importlib.metadata.version("gaitsweep")
    except importlib.metadata.PackageNotFoundError:
        return "unknown"
