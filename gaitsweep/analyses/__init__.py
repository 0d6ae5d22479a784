"""Analyses of result tables, and the functions that they share: `gs.analyses.attractors(table)`."""

from __future__ import annotations

import importlib
from typing import Any

from gaitsweep.extension import extensions
from gaitsweep.lazy_imports import attach_stub

_public, _, __all__ = attach_stub(__name__, __file__)


def __getattr__(name: str) -> Any:
    """An analysis, or an extension's module of analyses, imported when it is first used."""
    if name in __all__ or name not in (of_extensions := _of_extensions()):
        return _public(name)
    module, _, function = of_extensions[name].partition(":")
    imported = importlib.import_module(module)
    return getattr(imported, function) if function else imported


def __dir__() -> list[str]:
    return sorted({*__all__, *_of_extensions()})


def _of_extensions() -> dict[str, str]:
    """The places of the extensions' analyses, MODULE or MODULE:FUNCTION, by name."""
    return {name: place for extension in extensions().values() for name, place in extension.functions.items()}
