"""The files of a user's model: its module and the modules next to it that it imports."""

from __future__ import annotations

import ast
import contextlib
import functools
import sys
import sysconfig
from collections.abc import Iterator
from contextvars import ContextVar
from pathlib import Path
from types import ModuleType, TracebackType
from typing import Any

Stamp = tuple[int, int]  # modification time (ns) and size of a file

_OURS = __name__.partition(".")[0]
_HERE = Path(__file__).parent
_CODE = (".py", ".pyc", ".so", ".pth")
# files that this thread opens while a user's module is imported
_OPENED: ContextVar[set[str] | None] = ContextVar("opened", default=None)


def modules_beside(module: ModuleType) -> dict[str, Path]:
    """The files of a user's module and of those that it imports, directly or not, by module name.

    Only modules in the folder of the user's module (of its outermost package) or below it are included; in a
    folder of installed packages, only those of the same package. Imports are read from the sources, also
    inside functions; imports by computed names are not detected.

    Args:
        module: the user's module.

    Returns:
        Each module after those that it imports, the user's module last; empty if it has no file.
    """
    folder = _folder_of(module)
    if folder is None:
        return {}
    name = module.__name__
    top = name.partition(".")[0] if _installed(folder) else None
    files: dict[str, Path] = {}
    _follow(name, folder, top, files, set())
    return files


def modules_in(folder: Path) -> list[str]:
    """The names of the modules and packages that could be imported from a folder."""
    try:
        entries = list(folder.iterdir())
    except OSError:
        return []
    files = [entry.stem for entry in entries if entry.suffix == ".py"]
    packages = [entry.name for entry in entries if (entry / "__init__.py").is_file()]
    return [name for name in (*files, *packages) if name.isidentifier() and name != "__init__"]


def installed(module: ModuleType) -> bool:
    """Return whether a module belongs to Python or to an installed package, which does not change."""
    folder = _folder_of(module)
    return folder is None or _installed(folder)


def folder_of_class(class_: type) -> Path | None:
    """The folder of the module, or of the model file, of a user's class; None for an installed one."""
    if (file := getattr(class_, "model_file", None)) is not None:
        return None if _installed(file.parent) else file.parent
    module = sys.modules.get(class_.__module__)
    if module is None or installed(module):
        return None
    return _folder_of(module)


def line_of(error: BaseException) -> str:
    """The line of a user's file at which an exception was raised, as " (walker.py, line 12)".

    It is the innermost line outside of gaitsweep and of installed packages; "" if there is none, and for an
    exception that names a line itself.
    """
    if isinstance(error, SyntaxError):
        return ""
    innermost = ""
    step: TracebackType | None = error.__traceback__
    while step is not None:
        file = Path(step.tb_frame.f_code.co_filename)
        folders = file.parents
        if file.is_file() and not (_HERE in folders or any(map(_installed, folders))):
            innermost = f" ({file.name}, line {step.tb_lineno})"
        step = step.tb_next
    return innermost


def _folder_of(module: ModuleType) -> Path | None:
    """The folder from which a module is imported; None if it has no source."""
    file = getattr(module, "__file__", None)
    if file is None or not file.endswith(".py") or module.__name__ == "__main__":
        return None
    path = Path(file).resolve()
    outer = len(module.__name__.split(".")) - (0 if path.name == "__init__.py" else 1)
    return path.parents[outer] if outer < len(path.parents) else None


def stamp_of(file: Path) -> Stamp:
    """The modification time (ns) and the size of a file."""
    status = file.stat()
    return status.st_mtime_ns, status.st_size


@contextlib.contextmanager
def data_files() -> Iterator[dict[Path, Stamp]]:
    """The files that are read inside the context, filled in at its end: code and packages are left out."""
    _listen()
    opened: set[str] = set()
    outer = _OPENED.set(opened)
    stamps: dict[Path, Stamp] = {}
    try:
        yield stamps
    finally:
        _OPENED.reset(outer)
        for name in opened:
            file = Path(name).absolute()
            with contextlib.suppress(OSError):
                if file.suffix not in _CODE and file.is_file() and not any(map(_installed, file.parents)):
                    stamps[file] = stamp_of(file)


@functools.cache
def _listen() -> None:
    """Install a hook that records the files that Python opens."""

    def note(event: str, arguments: tuple[Any, ...]) -> None:
        if event != "open" or (opened := _OPENED.get()) is None:
            return
        name, mode, *_ = arguments
        if isinstance(name, str) and (mode is None or mode.startswith("r")):
            opened.add(name)

    sys.addaudithook(note)


@functools.cache
def _package_folders() -> frozenset[Path]:
    # not that of data: an environment may have been made in the folder of the user's own files
    paths = sysconfig.get_paths()
    return frozenset(Path(paths[name]).resolve() for name in ("stdlib", "platstdlib", "purelib", "platlib"))


def _installed(folder: Path) -> bool:
    """Return whether a folder contains installed packages, which are independent of each other."""
    return folder in _package_folders() or folder.name in ("site-packages", "dist-packages")


def _follow(name: str, folder: Path, top: str | None, files: dict[str, Path], visited: set[str]) -> None:
    """Add a module after those that it imports; circular imports are visited once."""
    if name in visited or (file := _file_of(name, folder)) is None:
        return
    if name.partition(".")[0] == _OURS or (top is not None and name.partition(".")[0] != top):
        return
    visited.add(name)
    if "." in name:  # importing a module runs its parent packages first
        _follow(name.rpartition(".")[0], folder, top, files, visited)
    package = name if file.name == "__init__.py" else name.rpartition(".")[0]
    try:
        imported = _imports(file, stamp_of(file), package)
    except OSError:
        return
    for imported_name in imported:
        _follow(imported_name, folder, top, files, visited)
    files[name] = file


@functools.lru_cache(maxsize=4096)
def _folders_of(file: str) -> frozenset[Path]:
    return frozenset(Path(file).resolve().parents)


def _file_of(name: str, folder: Path) -> Path | None:
    """The source of a module in a folder, if the module is imported from there."""
    loaded = getattr(sys.modules.get(name.partition(".")[0]), "__file__", None)
    if loaded is not None and folder not in _folders_of(loaded):
        return None  # an installed module of that name has precedence
    place = folder.joinpath(*name.split("."))
    for file in (place / "__init__.py", place.with_name(f"{place.name}.py")):
        if file.is_file():
            return file
    return None


@functools.lru_cache(maxsize=256)
def _imports(file: Path, stamp: Stamp, package: str) -> tuple[str, ...]:
    """The names that a source may import; a name in a module may be a module as well."""
    try:
        tree = ast.parse(file.read_bytes())
    except (SyntaxError, ValueError):
        return ()
    return tuple(dict.fromkeys(name for node in ast.walk(tree) for name in _imported(node, package)))


def _imported(node: ast.AST, package: str) -> Iterator[str]:
    """The names that an import statement may import, absolute ones."""
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
