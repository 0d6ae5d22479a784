"""Lazy imports: of the public names of a package (`attach_stub`), and of large packages (`lazy_packages`).

Most commands need one or two of the large packages, and reading a job draws none of its figures, so a command
loads such a package when it first uses a name of it. Python 3.15 has `lazy import` for this (PEP 810). JAX,
which computes rows but is not needed to read a job, is imported without its search for ROCm.
"""

from __future__ import annotations

import ast
import builtins
import contextlib
import functools
import gc
import importlib
import importlib.util
import os
import sys
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from importlib.machinery import ModuleSpec
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any, NamedTuple, Union

# The packages that are imported when they are first used.
LAZY = frozenset({"jax", "matplotlib", "mpl_toolkits", "pandas", "pyarrow", "scipy"})

_import = builtins.__import__
_LOCK = threading.Lock()
_JAX_LOCK = threading.RLock()
_contexts = 0  # in all threads
# what `typing` asks of an object that stands in a type
_OF_TYPING = frozenset({"__origin__", "__parameters__", "__typing_subst__", "__typing_unpacked_tuple_args__"})
_AT_IMPORT: dict[str, dict[str, Any]] = {}  # of JAX: its environment, and its settings by it
_AFTER_JAX: list[Callable[[], Any]] = []  # what is called once JAX has been imported


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
            raise NoAttributeError(package, name)
        thresholds = gc.get_threshold()
        # imports make few cycles and many objects, which would be searched again and again
        gc.set_threshold(max(50_000, thresholds[0]) if thresholds[0] else 0, *thresholds[1:])
        try:
            members = vars(importlib.import_module(source))
            return members[name] if name in members else importlib.import_module(f"{source}.{name}")
        finally:
            gc.set_threshold(*thresholds)

    return LazyModule(get, lambda: sorted(sources), sorted(sources))


class NoAttributeError(AttributeError):
    """A package does not have the public name that was asked for; the message has the nearest one.

    `from package import module` raises it too, before it imports the module. So the near miss, which takes
    time, is found only when the message is shown.
    """

    def __init__(self, package: str, name: str) -> None:
        super().__init__(package, name)

    def __str__(self) -> str:
        from gaitsweep import near_miss  # which most commands do not need

        package, name = self.args
        near = "" if name.startswith("_") else near_miss.suggestion(name, dir(sys.modules[package]))
        return f"module {package!r} has no attribute {name!r}{near}"


class Lazy:
    """A module, or one of its members, which is imported when it is first used.

    Args:
        names: the globals of a module; those that refer to this object then refer to the imported one.
        module: the name of the module.
        member: the name of its member.
        arguments, named: the object is what the member returns for them.
    """

    def __init__(
        self, names: dict[str, Any], module: str, member: str | None = None, *arguments: Any, **named: Any
    ) -> None:
        self._arguments = arguments
        self._options = named
        self._names = names
        self._module = module
        self._member = member
        self._object = None

    def _loaded(self) -> Any:
        """The object, imported at the first call."""
        if self._object is None:
            loaded: Any = importlib.import_module(self._module)
            if self._member is not None:
                if not hasattr(loaded, self._member):  # a module of its package
                    importlib.import_module(f"{self._module}.{self._member}")
                loaded = getattr(loaded, self._member)
            if self._arguments or self._options:
                loaded = loaded(*self._arguments, **self._options)
            self._object = loaded
            for attribute in list(vars(self).values()):  # imported modules of a package are its attributes
                if isinstance(attribute, Lazy) and attribute._member is None:
                    attribute._loaded()
            for name, value in list(self._names.items()):
                if value is self:
                    self._names[name] = loaded
        return self._object

    def __getattr__(self, name: str) -> Any:
        if name in _OF_TYPING:
            raise AttributeError(name)
        if self._module in ("jax", "jax.tree_util") and "jax" not in sys.modules and name in _BEFORE_JAX:
            return _BEFORE_JAX[name]
        return getattr(self._loaded(), name)

    def __call__(self, *args: Any, **options: Any) -> Any:
        return self._loaded()(*args, **options)

    def __getitem__(self, key: Any) -> Any:
        return self._loaded()[key]

    def __iter__(self) -> Iterator[Any]:
        return iter(self._loaded())

    def __or__(self, other: Any) -> Any:
        return Union[self, other]  # noqa: UP007 - the operator calls this

    def __ror__(self, other: Any) -> Any:
        return Union[other, self]  # noqa: UP007

    def __mro_entries__(self, bases: Sequence[Any]) -> tuple[Any]:
        return (self._loaded(),)

    def __instancecheck__(self, instance: Any) -> bool:
        return self.__subclasscheck__(type(instance))

    def __subclasscheck__(self, kind: type) -> bool:
        # a package that has not been imported has no instances
        return self._module.partition(".")[0] in sys.modules and issubclass(kind, self._loaded())


def _import_lazily(
    name: str,
    globals: Mapping[str, Any] | None = None,
    locals: Mapping[str, Any] | None = None,
    fromlist: Sequence[str] | None = (),
    level: int = 0,
) -> Any:
    """`__import__`, which defers packages of `LAZY` where a module of gaitsweep imports them at its head."""
    package, _, rest = name.partition(".")
    names: Any = globals
    at_head = globals is not None and globals is locals
    if package not in ("jaxtyping", *LAZY) or not (
        at_head and str(names.get("__name__")).startswith("gaitsweep.")
    ):
        return _import(name, globals, locals, fromlist or (), level)
    if package in ("jax", "jaxtyping") and "jax" in sys.modules:
        return _import(name, globals, locals, fromlist or (), level)
    if package == "jaxtyping":
        module = importlib.import_module(name)
        members = {member: getattr(module, member) for member in fromlist or () if member != "Array"}
        return SimpleNamespace(**members, Array=_Array)
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


class _Array:
    """Stands for `jax.Array` in types of annotations."""


def after_jax(function: Callable[[], Any]) -> None:
    """Call a function at once if JAX has been imported, and otherwise when it is."""
    if "jax" in sys.modules:
        importlib.import_module("jax")  # which another thread may be importing
        function()
    else:
        _AFTER_JAX.append(function)


def register_dataclass(class_: Any, *fields: Any, **named: Any) -> Any:
    """Register a dataclass as a pytree, as `jax.tree_util.register_dataclass` does, once JAX is imported."""
    after_jax(lambda: sys.modules["jax"].tree_util.register_dataclass(class_, *fields, **named))
    return class_


# the members of JAX that modules use as they are imported, before JAX is
_BEFORE_JAX = {
    "Array": Lazy({}, "jax", "Array"),
    "jit": functools.partial(Lazy, {}, "jax", "jit"),
    "register_dataclass": register_dataclass,
    "tree_util": Lazy({}, "jax.tree_util"),
}


def jax_settings() -> list[tuple[str, Any]]:
    """The settings of JAX other than its defaults, the same before its import and after it.

    They are those of the environment as JAX is imported, and those that were changed later.
    """
    environment = _AT_IMPORT.get("environment", _jax_environment())
    of_jax = sys.modules["jax"].config.values if "jax" in sys.modules else {}
    initial = _AT_IMPORT.get("settings", {})  # empty if JAX was imported before gaitsweep
    changed = {name: value for name, value in of_jax.items() if (name, value) not in initial.items()}
    return [*sorted(environment.items()), *sorted(changed.items())]


def jax_version() -> str:
    """The text of the file that holds the version of JAX, which this does not import."""
    spec = importlib.util.find_spec("jax")
    return "" if spec is None else Path(str(spec.origin)).with_name("version.py").read_text()


def _jax_environment() -> dict[str, str]:
    """The environment variables that are settings of JAX."""
    return {name: value for name, value in os.environ.items() if name.startswith("JAX_")}


class _JaxFinder:
    """Finder of `jax`, which is imported without its search for ROCm and followed by `_AFTER_JAX`."""

    @classmethod
    def find_spec(cls, name: str, path: Any = None, target: Any = None) -> ModuleSpec | None:
        """The spec of `jax` as other finders know it; None for another module."""
        if name != "jax":
            return None
        others = (finder for finder in sys.meta_path if finder is not cls)
        spec = next(filter(None, (finder.find_spec(name, path, target) for finder in others)), None)
        if spec is None or spec.loader is None:
            return spec
        execute = spec.loader.exec_module

        def exec_module(module: ModuleType) -> None:
            environment = _jax_environment()
            with _without_rocm():
                execute(module)
            _AT_IMPORT.update(environment=environment, settings=dict(module.config.values))
            while _AFTER_JAX:
                _AFTER_JAX.pop()()

        spec.loader.exec_module = exec_module
        return spec


sys.meta_path.insert(0, _JaxFinder)


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
