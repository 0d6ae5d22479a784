"""The content of models and functions, their code and data, and caches in a process that are keyed on it.

Two models of one class are equal if their structures are. Between two calls, though, a user may have changed
a global, an attribute or a method of the class, or a value in a closure, and a program compiled before would
give the numbers of before. `ContentReader` digests an object with all that it refers to: code, globals,
closures, classes and data.
"""

from __future__ import annotations

import abc
import contextlib
import functools
import hashlib
import itertools
import opcode
import pickle
import sys
import sysconfig
import types
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextvars import ContextVar
from enum import Enum
from pathlib import Path
from typing import Any, NamedTuple, ParamSpec, TypeVar
from weakref import WeakKeyDictionary

import jax
import numpy as np

from gaitsweep.contract import Model, SteppedModel
from gaitsweep.own_modules import modules_beside

_PLAIN = (type(None), bool, int, float, complex, str, bytes, type(...))
_BASES: tuple[Any, ...] = (int, float, complex, str, bytes)
# what is read by its elements; a user's class that derives from one has attributes and methods as well
_CONTAINERS = (tuple, list, set, frozenset, Mapping, np.ndarray)
# entries of a class that decide no number, or repeat others
_FORMAL = {
    *("__module__", "__qualname__", "__doc__", "__dict__", "__weakref__", "__annotations__"),
    *("__parameters__", "__dataclass_fields__", "__dataclass_params__", "__match_args__", "__orig_bases__"),
    *("__slots__", "__abstractmethods__", "_abc_impl", "__firstlineno__", "__static_attributes__"),
    *("__annotate_func__", "__annotations_cache__", "__annotate__", "__classdictcell__"),
}
# what every named tuple has, made from its fields
_OF_NAMED_TUPLES = {"__new__", "_make", "_replace", "_asdict", "__getnewargs__", "__replace__"}
# packages whose versions, or whose meaning, are the same wherever a digest for other processes is compared
_KNOWN = {
    *("gaitsweep", "jax", "jaxlib", "jaxtyping", "numpy", "builtins", "math", "cmath", "operator"),
    *("abc", "collections", "dataclasses", "enum", "functools", "itertools", "types", "typing"),
}
# names in code that may read what no digest holds
_UNKNOWN = {
    *("__dict__", "__import__", "compile", "eval", "exec", "fromfile", "fromregex", "genfromtxt", "getattr"),
    *("globals", "hash", "id", "import_module", "input", "load", "loadtxt", "locals", "memmap"),
    *("open", "vars"),
    *("random", "devices", "default_backend", "device_count", "local_devices", "callback", "pure_callback"),
}
_IMPORTS = opcode.opmap["IMPORT_NAME"]


class _Code(NamedTuple):
    """The content of a code object and its inner code.

    Attributes:
        digest: its digest.
        names: the names that it reads.
        is_known: whether the digest holds all that it reads: no name may read files, the environment or a
            clock.
        imports: whether it imports modules, which are among its names.
    """

    digest: bytes
    names: tuple[str, ...]
    is_known: bool
    imports: bool


_CODES: WeakKeyDictionary[types.CodeType, _Code] = WeakKeyDictionary()


class ContentReader:
    """A digest of values with all that they refer to; `lasting` is whether it holds in other processes.

    Args:
        known: objects that are added by their places among these alone.
    """

    def __init__(self, *known: Any) -> None:
        self.digest = hashlib.sha256()
        self.lasting = True
        self._seen: dict[int, int] = {id(value): place for place, value in enumerate(known)}
        self._alive: list[Any] = []  # an object that is gone would leave its id to another

    def read(self, value: Any) -> None:
        """Add a value; one that was added before is named by its place."""
        kind = type(value)
        if kind in _PLAIN:
            self._add(kind.__name__, repr(value).encode())
            return
        if isinstance(value, types.ModuleType):  # not named by its place: `_global` reads its members
            self._note_module(value.__name__)
            self._add("module", value.__name__.encode())
            return
        if (place := self._seen.get(id(value))) is not None:
            self._add("again", str(place).encode())
            return
        self._seen[id(value)] = len(self._seen)
        self._alive.append(value)
        if isinstance(value, types.FunctionType):
            self._function(value)
        elif isinstance(value, type):
            self._class(value)
        elif isinstance(value, Enum):
            self._add("enum", f"{kind.__module__}.{value}".encode())
        elif isinstance(value, np.ndarray | np.generic | jax.Array):
            self._array(value)
        elif isinstance(value, tuple | list):
            self._all(kind.__name__, value)
        elif isinstance(value, set | frozenset):
            self._all(kind.__name__, sorted(value, key=repr))
        elif isinstance(value, Mapping):
            self._all(kind.__name__, itertools.chain.from_iterable(list(value.items())))
        else:
            self._object(value)
            return
        if isinstance(value, (*_CONTAINERS, Enum)) and is_user_module(kind.__module__):
            self.read(kind)
            self.attributes(value)

    def attributes(self, value: Any) -> None:
        """Add the attributes of an object, without its cached properties."""
        names = {**dict.fromkeys(_slots(type(value))), **getattr(value, "__dict__", {})}
        for name in names:
            of_class = getattr(type(value), name, None)
            if not isinstance(of_class, functools.cached_property) and hasattr(value, name):
                self._add("attribute", name.encode())
                self.read(getattr(value, name))

    def _note_module(self, module: str | None) -> None:
        """Note whether other processes know what a module defines, by its name or its content."""
        top = str(module).partition(".")[0]
        # Python's modules in C have an underscore
        self.lasting &= top.removeprefix("_") in _KNOWN or (
            top in sys.modules and is_user_module(str(module))
        )

    def _add(self, label: str, data: bytes) -> None:
        self.digest.update(f"{label} {len(data)}:".encode() + data)

    def _all(self, label: str, values: Iterable[Any]) -> None:
        """Add values one after the other, with their number."""
        items = list(values)
        self._add(label, str(len(items)).encode())
        for item in items:
            self.read(item)

    def _function(self, function: types.FunctionType) -> None:
        """Add a function: code, defaults and closure, and the globals that code of a user reads."""
        code = _code(function.__code__)
        self._add("function", code.digest)
        self.read(function.__defaults__)
        self.read(function.__kwdefaults__)
        of_module = function.__globals__
        is_users = is_user_module(str(of_module.get("__name__")))
        for cell in function.__closure__ or ():
            try:
                enclosed = cell.cell_contents
            except ValueError:  # not filled yet
                self._add("empty", b"")
            else:
                self._global(enclosed, code.names if is_users else ())
        self._note_module(of_module.get("__name__"))
        if not is_users:
            return
        self.lasting &= code.is_known
        self.read(vars(function))
        for name in code.names:
            if name in of_module:
                self._add("global", name.encode())
                self._global(of_module[name], code.names)
            for imported in (name, f"{of_module.get('__package__')}.{name}") if code.imports else ():
                if imported in sys.modules and is_user_module(imported):
                    self._global(sys.modules[imported], code.names)

    def _global(
        self, value: Any, names: tuple[str, ...], within: frozenset[str] | set[str] = frozenset()
    ) -> None:
        """Add a global or a value of a closure; of a module its members with one of the code's `names`.

        `within` names the modules that are being read, which may import each other.
        """
        self.read(value)
        if not isinstance(value, types.ModuleType) or value.__name__ in within:
            return
        is_users = is_user_module(value.__name__)
        for name in names:
            member = vars(value).get(name)
            if member is not None and (is_users or isinstance(member, (*_PLAIN, np.ndarray, np.generic))):
                self._add("of module", name.encode())
                self._global(member, names, {*within, value.__name__})

    def _class(self, kind: type) -> None:
        """Add the name of a class, and the members of all of its bases that a user may change."""
        self._add("class", f"{kind.__module__}.{kind.__qualname__}".encode())
        for base in kind.__mro__:
            self._note_module(base.__module__)
            # a class made by calling type() has the module of its metaclass, and no source of its own
            is_called = base.__module__ == "abc" and base is not abc.ABC
            self.lasting &= not is_called
            is_models = base.__module__.startswith("gaitsweep.models.")
            if not (is_called or is_models or is_user_module(base.__module__)):
                continue
            is_named_tuple = issubclass(base, tuple) and "_fields" in vars(base)
            formal = _FORMAL | _OF_NAMED_TUPLES if is_named_tuple else _FORMAL
            for name, value in list(vars(base).items()):
                if name not in formal:
                    self._add("member", name.encode())
                    self.read(value)
        if is_user_module(type(kind).__module__):  # whose attributes are those of the class
            self.read(type(kind))

    def _array(self, value: Any) -> None:
        """Add the dtype, shape and numbers of an array."""
        try:
            array = np.asarray(value)
            data = pickle.dumps(array) if array.dtype.hasobject else array.tobytes()
        except Exception:  # a tracer, or keys of random numbers
            self.lasting = False
            self._add("object", str(id(value)).encode())
            return
        self._add(f"{array.dtype} {array.shape}", data)

    def _object(self, value: Any) -> None:
        """Add an object by what it refers to, or else by its pickle."""
        kind = type(value)
        module = kind.__module__
        if module == "builtins":  # such as a built-in function, which knows its own module or class
            owner = getattr(value, "__self__", None)
            of_owner = owner.__module__ if isinstance(owner, type) else None
            module = getattr(value, "__module__", "builtins") or of_owner
        self._note_module(module)
        self._add("object", f"{kind.__module__}.{kind.__qualname__}".encode())
        parts = [name for name in _PARTS.get(kind, ("__wrapped__",)) if hasattr(value, name)]
        for name in parts:
            self.read(getattr(value, name))
        for base in _BASES:
            if isinstance(value, base):  # a number or a text of a class of its own
                self._add(base.__name__, base.__repr__(value).encode())
        if hasattr(value, "__dict__") or any(True for _ in _slots(kind)):
            self.read(kind)
            self.attributes(value)
        elif not parts:
            try:
                data = pickle.dumps(value)
            except Exception:  # an object that cannot be pickled is identified by itself only
                self.lasting = False
                data = str(id(value)).encode()
            self._add("data", data)


# what objects of Python refer to; others, such as jitted functions, have `__wrapped__`
_PARTS: dict[type, tuple[str, ...]] = {
    types.MethodType: ("__func__", "__self__"),
    classmethod: ("__func__",),
    staticmethod: ("__func__",),
    property: ("fget",),
    functools.partial: ("func", "args", "keywords"),
    functools.cached_property: ("func",),
}


def _slots(kind: type) -> Iterator[str]:
    """The attributes that a class and its bases declare as slots."""
    for base in kind.__mro__:
        slots = vars(base).get("__slots__", ())
        for name in (slots,) if isinstance(slots, str) else slots:
            if name not in ("__dict__", "__weakref__"):
                yield name


def _code(code: types.CodeType) -> _Code:
    """The entry of a code object, which is read once, with its inner code."""
    if code in _CODES:
        return _CODES[code]
    names = dict.fromkeys(code.co_names)
    digest = hashlib.sha256()
    imports = _IMPORTS in code.co_code[::2]
    is_known = _UNKNOWN.isdisjoint(code.co_names) and not imports
    signature = code.co_argcount, code.co_posonlyargcount, code.co_kwonlyargcount, code.co_flags
    digest.update(repr((signature, code.co_names, code.co_varnames, code.co_freevars)).encode())
    digest.update(code.co_code + code.co_exceptiontable)
    for constant in code.co_consts:
        if isinstance(constant, types.CodeType):
            inner = _code(constant)
            is_known &= inner.is_known
            imports |= inner.imports
            digest.update(inner.digest)
            names |= dict.fromkeys(inner.names)
            continue
        # the order of a frozenset differs between processes
        text = sorted(map(repr, constant)) if isinstance(constant, frozenset) else repr(constant)
        digest.update(f"{type(constant).__name__} {text}".encode())
    _CODES[code] = _Code(digest.digest(), tuple(names), is_known, imports)
    return _CODES[code]


@functools.lru_cache(maxsize=4096)
def _in_packages(file: str) -> bool:
    """Whether a file is of Python's standard library or of an installed package."""
    folders = Path(file).resolve().parents
    if Path(sysconfig.get_paths()["stdlib"]).resolve() in folders:
        return True
    return any(_holds_packages(folder) for folder in folders)


@functools.lru_cache(maxsize=4096)
def _holds_packages(folder: Path) -> bool:
    """Whether packages are installed in a folder, also by `pip install --target`."""
    return folder.name in ("site-packages", "dist-packages") or any(folder.glob("*.dist-info"))


def is_user_module(module: str) -> bool:
    """Whether a module may change while Python runs: it is neither gaitsweep's nor an installed package's."""
    if module == "gaitsweep" or module.startswith("gaitsweep."):
        return False
    loaded = sys.modules.get(module)
    if loaded is None or module == "__main__":
        return module not in ("None", "builtins")
    file = getattr(loaded, "__file__", None)
    if not isinstance(file, str):
        return module.partition(".")[0] not in sys.stdlib_module_names
    return not _in_packages(file)


P = ParamSpec("P")
T = TypeVar("T")

ModelKey = tuple[str, str, int]  # the module and the name of the class of a model, or function, and its hash

# The files that the functions of a model read as they are traced.
_FILES: dict[ModelKey, set[Path]] = {}
# The latest content of each model, and of each function: one that is gone may leave its hash to another.
_LATEST: dict[ModelKey, str] = {}
_LATEST_OF_FUNCTIONS: WeakKeyDictionary[Callable[..., Any], str] = WeakKeyDictionary()
# Results that hold while models do not change; None outside of `held_contents`.
_MEMO: ContextVar[dict[tuple[Any, ...], Any] | None] = ContextVar("memo", default=None)


def cached_by_content(maxsize: int) -> Callable[[Callable[P, T]], Callable[P, T]]:
    """Cache a function as `functools.lru_cache` does, keyed on the content of models and functions as well.

    They are those among its arguments, and those that other arguments have as `model` or `functions`.

    Args:
        maxsize: the largest number of results that are kept.
    """

    def decorate(function: Callable[P, T]) -> Callable[P, T]:
        @functools.lru_cache(maxsize)
        def cached(contents: tuple[str, ...], args: Any, options: Any) -> T:
            return function(*args, **dict(options))

        @functools.wraps(function)
        def call(*args: P.args, **options: P.kwargs) -> T:
            arguments = *args, *options.values()
            contents = [content_of(source) for argument in arguments for source in _sources(argument)]
            return cached(tuple(contents), args, tuple(sorted(options.items())))

        return call

    return decorate


def _sources(argument: Any) -> Iterable[Model | Callable[..., Any]]:
    """The models and functions among an argument and its attributes `model` and `functions`."""
    model = getattr(argument, "model", argument)
    if isinstance(model, Model):
        return (model,)
    if hasattr(argument, "functions"):
        return argument.functions
    kind = type(argument)
    if isinstance(argument, type) or not callable(argument) or kind.__module__.startswith("gaitsweep."):
        return ()
    # jitted and partial functions, methods and objects that are called, too, if they can be remembered
    return (argument,) if kind.__weakrefoffset__ else ()


def content_of(model: Model | Callable[..., Any]) -> str:
    """Compute a digest of the functions of a model, or of one: code, globals, closures and class attributes.

    Code of installed packages and of gaitsweep counts by name only. Another process has another digest.
    """
    memo = _MEMO.get()
    if memo is not None and (type(model), model) in memo:
        return memo[type(model), model]
    reader = _read(model)
    key = _key(model)
    for file in sorted(_FILES.get(key, ())):
        reader.read((str(file), _stamp(file)))
    content = reader.digest.hexdigest()
    # JAX keeps traces of a user's jitted functions and loops, which may have read what has changed
    latest: Any = _LATEST if isinstance(model, Model) else _LATEST_OF_FUNCTIONS
    place: Any = key if isinstance(model, Model) else model
    if latest.get(place, content) != content:
        jax.clear_caches()
    latest[place] = content
    if memo is not None:
        memo[type(model), model] = content
    return content


def _stamp(file: Path) -> tuple[int, int] | None:
    """The modification time (ns) and the size of a file; None without a file."""
    try:
        status = file.stat()
    except OSError:
        return None
    return status.st_mtime_ns, status.st_size


@contextlib.contextmanager
def held_contents() -> Iterator[None]:
    """A context in which models do not change, so that the content of each is read once."""
    outer = _MEMO.get()
    token = _MEMO.set({} if outer is None else outer)
    try:
        yield
    finally:
        _MEMO.reset(token)


def held_result(key: tuple[Any, ...], compute: Callable[[], T]) -> T:
    """The result of `compute`, which is called once for each key inside `held_contents`.

    Args:
        key: all that decides the result.
        compute: returns the result; it is always called outside of `held_contents`.
    """
    memo = _MEMO.get()
    if memo is None:
        return compute()
    if key not in memo:
        memo[key] = compute()
    return memo[key]


def lasting_content(source: Model | Callable[..., Any], *others: Any) -> str | None:
    """Compute a digest of a model or a function and of other objects that holds in other processes as well.

    It includes the sources of the modules of a user.

    Args:
        source: the model or the function.
        others: the other objects.

    Returns:
        The digest; None for a source that may read what no digest holds: files, the environment, a clock,
        packages other than JAX and NumPy, or a class without a source.
    """
    if _FILES.get(_key(source)):
        return None
    content = held_result((type(source), source, "lasting"), lambda: _lasting(source))
    if not content:
        return None
    reader = ContentReader(source, type(source))
    reader.read((content, others))
    return reader.digest.hexdigest() if reader.lasting else None


def _lasting(source: Model | Callable[..., Any]) -> str:
    """The digest of a model or a function that holds in other processes; empty if there is none."""
    defined = type(source) if isinstance(source, Model) else source
    module = sys.modules.get(str(getattr(defined, "__module__", None)))
    if module is None or (isinstance(source, Model) and source.host_parameters):
        return ""
    # a model of steps with data files runs a simulator, of which no digest holds the code
    if isinstance(source, SteppedModel) and source.data_digest:
        return ""
    reader = _read(source)
    if is_user_module(module.__name__):
        sources = modules_beside(module)
        reader.lasting &= bool(sources)
        for name, file in sorted(sources.items()):
            try:
                reader.read((name, file.read_bytes()))
            except OSError:
                reader.lasting = False
    return reader.digest.hexdigest() if reader.lasting else ""


def _read(model: Model | Callable[..., Any]) -> ContentReader:
    """A reader that has read the class, the attributes and the data of a model, or a function."""
    reader = ContentReader()
    if not isinstance(model, Model):
        reader.read(model)
        return reader
    reader.read(type(model))
    reader.attributes(model)
    reader.read(model.data_digest)
    return reader


def depends_on(model: Model, files: Iterable[Path]) -> None:
    """Include files in the content of a model.

    Args:
        model: the model.
        files: the files that its functions read as they are traced.
    """
    _FILES.setdefault(_key(model), set()).update(files)
    if (memo := _MEMO.get()) is not None:
        memo.pop((type(model), model), None)


def _key(model: Model | Callable[..., Any]) -> ModelKey:
    return type(model).__module__, type(model).__qualname__, hash(model)
