"""Lazy imports: of the public names of a package (`attach_stub`), and of large packages (`lazy_packages`).

Most commands need one or two of the large packages, and reading a job draws none of its figures, so a command
loads such a package when it first uses a name of it. Python 3.15 has `lazy import` for this (PEP 810). JAX,
which every model needs, is imported without its search for ROCm.
"""

from __future__ import annotations

import ast
import builtins
import contextlib
import gc
import importlib
import sys
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

# The packages that are imported when they are first used.
LAZY = frozenset({"matplotlib", "mpl_toolkits", "pandas", "pyarrow", "scipy"})

_import = builtins.__import__
_LOCK = threading.Lock()
_JAX_LOCK = threading.RLock()
_contexts = 0  # in all threads


class LazyModule(NamedTuple):
    """The functions and names by which a package imports its public names when they are first used."""

    getattr: Callable[[str], Any]
    dir: Callable[[], list[str]]
    all: list[str]


def attach_stub(package: str, file: str) -> LazyModule:
    """Return the `__getattr__`, `__dir__` and `__all__` of a package, from the imports of its stub.

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

    return LazyModule(get, lambda: sorted(sources), sorted(sources))


class Lazy:
    """A module, or one of its members, which is imported when it is first used.

    Args:
        names: the globals of a module; those that refer to this object then refer to the imported one.
        module: the name of the module.
        member: the name of its member.
    """

    def __init__(self, names: dict[str, Any], module: str, member: str | None = None) -> None:
        self._names = names
        self._module = module
        self._member = member
        self._object = None

    def _loaded(self) -> Any:
        """The object, imported at the first call."""
        if self._object is None:
            loaded = importlib.import_module(self._module)
            if self._member is not None:
                if not hasattr(loaded, self._member):  # a module of its package
                    importlib.import_module(f"{self._module}.{self._member}")
                loaded = getattr(loaded, self._member)
            self._object = loaded
            for attribute in list(vars(self).values()):  # imported modules of a package are its attributes
                if isinstance(attribute, Lazy) and attribute._member is None:
                    attribute._loaded()
            for name, value in list(self._names.items()):
                if value is self:
                    self._names[name] = loaded
        return self._object

    def __getattr__(self, name: str) -> Any:
        return getattr(self._loaded(), name)

    def __call__(self, *args: Any, **options: Any) -> Any:
        return self._loaded()(*args, **options)

    def __getitem__(self, key: Any) -> Any:
        return self._loaded()[key]

    def __iter__(self) -> Iterator[Any]:
        return iter(self._loaded())

    def __or__(self, other: Any) -> Any:
        return self._loaded() | other

    def __mro_entries__(self, bases: Sequence[Any]) -> tuple[Any]:
        return (self._loaded(),)

    def __instancecheck__(self, instance: Any) -> bool:
        return isinstance(instance, self._loaded())

    def __subclasscheck__(self, kind: type) -> bool:
        return issubclass(kind, self._loaded())


def _import_lazily(
    name: str,
    globals: Mapping[str, Any] | None = None,
    locals: Mapping[str, Any] | None = None,
    fromlist: Sequence[str] | None = (),
    level: int = 0,
) -> Any:
    """`__import__`, which defers packages of `LAZY` where a module of gaitsweep imports them at its head."""
    package, _, rest = name.partition(".")
    if package == "jax" and package not in sys.modules:
        with _without_rocm():
            return _import(name, globals, locals, fromlist or (), level)
    names: Any = globals
    at_head = package in LAZY and globals is not None and globals is locals
    if not (at_head and str(names.get("__name__")).startswith("gaitsweep.")):
        return _import(name, globals, locals, fromlist or (), level)
    if fromlist:
        lazy = Lazy(names, name)
        vars(lazy).update({member: Lazy(names, name, member) for member in fromlist})
        return lazy
    lazy = inner = Lazy(names, package)
    earlier = names.get(package)
    if isinstance(earlier, Lazy) and vars(earlier)["_module"] == package:
        lazy = inner = earlier  # it has the modules that were imported before
    for part in filter(None, rest.split(".")):  # import a.b.c
        inner = vars(inner).setdefault(part, Lazy(names, f"{vars(inner)['_module']}.{part}"))
    return lazy


@contextlib.contextmanager
def _without_rocm() -> Iterator[None]:
    """A context in which JAX, as it is imported, does not read the metadata of all installed packages.

    It looks for a plugin of ROCm, an eighth of its import's time.
    """
    from importlib import metadata  # which `--help` does not need

    with _JAX_LOCK:  # two threads would restore one another's function
        all_distributions = metadata.distributions
        thread = threading.get_ident()

        def without_own(**context: Any) -> Any:
            """No distributions for this thread, all for others, which may read them meanwhile."""
            return iter(()) if threading.get_ident() == thread else all_distributions(**context)

        if not any(any(Path(folder).glob("jax_rocm*-plugin*")) for folder in sys.path):
            metadata.distributions = without_own
        try:
            yield
        finally:
            metadata.distributions = all_distributions


@contextlib.contextmanager
def lazy_packages() -> Iterator[None]:
    """A context in which modules of gaitsweep that are imported do not load the packages of `LAZY`."""
    global _contexts
    with _LOCK:
        _contexts += 1
        builtins.__import__ = _import_lazily
    try:
        yield
    finally:
        with _LOCK:
            _contexts -= 1
            if not _contexts:
                builtins.__import__ = _import
