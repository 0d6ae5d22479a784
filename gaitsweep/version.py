"""The version of the installed package."""

from __future__ import annotations

import functools


@functools.cache
def version() -> str:
    """Give the version, or "unknown" where the package runs from a folder without being installed."""
    from importlib.metadata import PackageNotFoundError
    from importlib.metadata import version as installed

    try:
        return installed("gaitsweep")
    except PackageNotFoundError:
        return "unknown"
