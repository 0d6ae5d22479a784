"""Where the files that come with gaitsweep are: configs, jobs, tables of claims."""

from __future__ import annotations

from pathlib import Path

_PACKAGE = Path(__file__).parent


def shipped(name: str) -> Path:
    """The path of a shipped folder or file, such as `sweeps/quick_basins.yaml`.

    In an installed wheel they are inside the package, in a checkout beside it.
    """
    inside = _PACKAGE / "shipped" / name
    return inside if inside.exists() else _PACKAGE.parent / name
