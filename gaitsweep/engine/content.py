"""The content of models, their code and data, and caches in a process that are keyed on it.

Two models of one class are equal if their structures are. Between two calls, though, a user may have changed
a global, an attribute or a method of the class, or a value in a closure, and a program compiled before would
give the numbers of before.
"""

from __future__ import annotations

import contextlib
import functools
import sys
from collections.abc import Callable, Iterable, Iterator
from contextvars import ContextVar
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

import jax

from gaitsweep.contract import Model, SteppedModel
from gaitsweep.engine.content_reader import ContentReader, is_user_module
from gaitsweep.own_modules import modules_beside

P = ParamSpec("P")
T = TypeVar("T")

ModelKey = tuple[str, str, int]  # the module, the name and the hash of a model

# The files that the functions of a model read as they are traced.
_FILES: dict[ModelKey, set[Path]] = {}
# The latest content of each model.
_LATEST: dict[ModelKey, str] = {}
# Results that hold while models do not change; None outside of `held_contents`.
_MEMO: ContextVar[dict[tuple[Any, ...], Any] | None] = ContextVar("memo", default=None)


def cached_by_content(maxsize: int) -> Callable[[Callable[P, T]], Callable[P, T]]:
    """Cache a function as `functools.lru_cache` does, keyed on the content of models as well.

    The models are those among its arguments, and those that other arguments have as their `model`.

    Args:
        maxsize: the largest number of results that are kept.
    """

    def decorate(function: Callable[P, T]) -> Callable[P, T]:
        @functools.lru_cache(maxsize)
        def cached(contents: tuple[str, ...], args: Any, options: Any) -> T:
            return function(*args, **dict(options))

        @functools.wraps(function)
        def call(*args: P.args, **options: P.kwargs) -> T:
            contents = []
            for argument in (*args, *options.values()):
                model = argument if isinstance(argument, Model) else getattr(argument, "model", None)
                if isinstance(model, Model):
                    contents.append(content_of(model))
            return cached(tuple(contents), args, tuple(sorted(options.items())))

        return call

    return decorate


def content_of(model: Model) -> str:
    """Compute a digest of the functions of a model: their code, globals, closures and class attributes.

    Code of installed packages and of gaitsweep counts by name only. Another process has another digest.
    """
    memo = _MEMO.get()
    if memo is not None and (type(model), model) in memo:
        return memo[type(model), model]
    reader = _read(model)
    key = _key(model)
    reader.read(model.data_digest)
    for file in sorted(_FILES.get(key, ())):
        reader.read((str(file), _stamp(file)))
    content = reader.digest.hexdigest()
    # JAX keeps traces of a user's jitted functions and loops, which may have read what has changed
    if _LATEST.get(key, content) != content:
        jax.clear_caches()
    _LATEST[key] = content
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


def lasting_content(model: Model, *others: Any) -> str | None:
    """Compute a digest of a model and other objects that holds in other processes as well.

    It includes the sources of the model's modules.

    Args:
        model: the model.
        others: the other objects.

    Returns:
        The digest; None for a model that may read what no digest holds: files, the environment, a clock,
        packages other than JAX and NumPy, or a class without a source.
    """
    if _FILES.get(_key(model)):
        return None
    content = held_result((type(model), model, "lasting"), lambda: _lasting(model))
    if not content:
        return None
    reader = ContentReader(model, type(model))
    reader.read((content, others))
    return reader.digest.hexdigest() if reader.lasting else None


def _lasting(model: Model) -> str:
    """The digest of a model that holds in other processes; empty if there is none."""
    module = sys.modules.get(type(model).__module__)
    # a model of steps with data files runs a simulator, of which no digest holds the code
    simulated = isinstance(model, SteppedModel) and bool(model.data_digest)
    if module is None or model.host_parameters or simulated:
        return ""
    reader = _read(model)
    reader.read(model.data_digest)
    if is_user_module(module.__name__):
        sources = modules_beside(module)
        reader.lasting &= bool(sources)
        for name, file in sorted(sources.items()):
            try:
                reader.read((name, file.read_bytes()))
            except OSError:
                reader.lasting = False
    return reader.digest.hexdigest() if reader.lasting else ""


def _read(model: Model) -> ContentReader:
    """A reader that has read the class and the attributes of a model."""
    reader = ContentReader()
    reader.read(type(model))
    reader.attributes(model)
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


def _key(model: Model) -> ModelKey:
    return type(model).__module__, type(model).__qualname__, hash(model)
