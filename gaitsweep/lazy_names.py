"""Lazy imports of the public names that the stub of a package declares."""

from __future__ import annotations

import ast
import gc
import importlib
from collections.abc import Callable
from pathlib import Path
from typing import Any


def attach_stub(package: str, file: str) -> tuple[Callable[[str], Any], Callable[[], list[str]], list[str]]:
    """`__getattr__`, `__dir__` and `__all__` of a package, from the imports of its stub.

    Type checkers read the same stub. This is the scheme of Scientific Python's SPEC 1.

    Args:
        package: its `__name__`.
        file: its `__file__`; the stub `__init__.pyi` stands beside it.
    """
    stub = ast.parse(Path(file).with_suffix(".pyi").read_text(encoding="utf-8"))
    imports = [node for node in stub.body if isinstance(node, ast.ImportFrom)]
    sources = {alias.name: node.module for node in imports for alias in node.names if alias.asname}

    def get(name: str) -> Any:
        source = sources.get(name)
        if source is None:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        thresholds = gc.get_threshold()
        # imports make few cycles and many objects, which would be searched again and again
        gc.set_threshold(max(50_000, thresholds[0]) if thresholds[0] else 0, *thresholds[1:])
        try:
            members = vars(importlib.import_module(source))
            return members[name] if name in members else importlib.import_module(f"{source}.{name}")
        finally:
            gc.set_threshold(*thresholds)

    return get, lambda: sorted(sources), sorted(sources)
