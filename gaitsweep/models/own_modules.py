"""A user's module and the modules beside it that it imports: what decides the numbers of the user's model."""

from __future__ import annotations

import ast
import functools
import sys
import sysconfig
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

Stamp = tuple[int, int]  # when a file was written (ns), and its size

_OURS = __name__.partition(".")[0]


def modules_beside(module: ModuleType) -> dict[str, Path]:
    """The files of a user's module and of those that it imports, directly or not, by module name.

    Modules count that lie in the folder of the user's module (of its outermost package), or below it; where
    that is a folder of installed packages, those of the same package alone. Imports are read from the
    sources, those inside functions too; what is imported by a name that is worked out is not seen.

    Args:
        module: the user's module.

    Returns:
        Each module after those that it imports, the user's own the last; empty where it has no file.
    """
    folder = _folder_of(module)
    if folder is None:
        return {}
    name = module.__name__
    top = name.partition(".")[0] if _installed(folder) else None
    found: dict[str, Path] = {}
    _follow(name, folder, top, found, set())
    return found


def installed(module: ModuleType) -> bool:
    """Whether a module is part of Python or of an installed package, which nobody edits meanwhile."""
    folder = _folder_of(module)
    return folder is None or _installed(folder)


def _folder_of(module: ModuleType) -> Path | None:
    """The folder from which a module is imported; None where it has no source."""
    file = getattr(module, "__file__", None)
    if file is None or not file.endswith(".py") or module.__name__ == "__main__":
        return None
    path = Path(file).resolve()
    outer = len(module.__name__.split(".")) - (0 if path.name == "__init__.py" else 1)
    return path.parents[outer] if outer < len(path.parents) else None


def stamp_of(file: Path) -> Stamp:
    """When a file was written, and its size."""
    about = file.stat()
    return about.st_mtime_ns, about.st_size


def _installed(folder: Path) -> bool:
    """Whether a folder holds installed packages, which have nothing to do with each other."""
    paths = {Path(each).resolve() for each in sysconfig.get_paths().values()}
    return folder in paths or folder.name in ("site-packages", "dist-packages")


def _follow(name: str, folder: Path, top: str | None, found: dict[str, Path], seen: set[str]) -> None:
    """Add a module after those that it imports; a circle of imports is entered once."""
    if name in seen or (file := _file_of(name, folder)) is None:
        return
    if name.partition(".")[0] == _OURS or (top is not None and name.partition(".")[0] != top):
        return
    seen.add(name)
    if "." in name:  # importing a module runs the packages around it first
        _follow(name.rpartition(".")[0], folder, top, found, seen)
    package = name if file.name == "__init__.py" else name.rpartition(".")[0]
    try:
        imported = _imports(file, stamp_of(file), package)
    except OSError:
        return
    for each in imported:
        _follow(each, folder, top, found, seen)
    found[name] = file


def _file_of(name: str, folder: Path) -> Path | None:
    """The source of a module in a folder, if it is one that would be imported from there."""
    loaded = getattr(sys.modules.get(name.partition(".")[0]), "__file__", None)
    if loaded is not None and folder not in Path(loaded).resolve().parents:
        return None  # an installed module of that name came first
    place = folder.joinpath(*name.split("."))
    for file in (place / "__init__.py", place.with_name(f"{place.name}.py")):
        if file.is_file():
            return file
    return None


@functools.lru_cache(maxsize=256)
def _imports(file: Path, stamp: Stamp, package: str) -> tuple[str, ...]:
    """The names that a source may import; a name out of a module may be a module too."""
    try:
        tree = ast.parse(file.read_bytes())
    except (SyntaxError, ValueError):
        return ()
    return tuple(dict.fromkeys(name for node in ast.walk(tree) for name in _imported(node, package)))


def _imported(node: ast.AST, package: str) -> Iterator[str]:
    if isinstance(node, ast.Import):
        yield from (alias.name for alias in node.names)
    elif isinstance(node, ast.ImportFrom):
        base = node.module or ""
        if node.level:
            around = package.split(".")
            around = around[: len(around) - node.level + 1]
            base = ".".join([*around, *([base] if base else [])])
        if base:
            yield base
            yield from (f"{base}.{alias.name}" for alias in node.names)
