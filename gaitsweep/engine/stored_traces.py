"""Results of tracing a model or a function without values: shapes of states, programs, dependences.

`stored` keeps such results in the cache folder, so that what is known is not traced again. The name of an
entry is a digest of all that decides it: the content of the model or function with the sources of its
modules, gaitsweep's own sources, the versions that trace and compile, and the settings of JAX. Results are
JSON, of which nothing is run.
"""

from __future__ import annotations

import hashlib
import json
import os
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import Literal
from jaxlib.version import __version__ as jaxlib_version

from gaitsweep.cache_folder import cache_folder, load_cached, store_cached
from gaitsweep.compiling_threads import compiling
from gaitsweep.contract import HybridModel, Model, Params, State
from gaitsweep.engine.content import cached_by_content, lasting_content
from gaitsweep.lazy_imports import jax_settings, jax_version

# settings of JAX that change no trace
_WITHOUT_EFFECT = ("cache", "device", "platforms", "log", "traceback")


def stored(
    name: str,
    source: Model | Callable[..., Any],
    others: tuple[Any, ...],
    compute: Callable[[], Any],
) -> Any:
    """The result of `compute` for a model or a function, as JSON gives it back, read from the cache if there.

    Args:
        name: the name of the result.
        source: the model or the function, whose content is part of the key of the cache.
        others: other objects that decide the result.
        compute: traces it; called only if the cache lacks the result.
    """
    content = lasting_content(source, name, *others)
    folder = None if content is None else cache_folder("programs")
    if folder is None:
        with compiling():
            return json.loads(json.dumps(compute()))
    key = repr((content, _SOURCES, _VERSIONS, _settings()))
    file = folder / f"{name}_{hashlib.sha256(key.encode()).hexdigest()[:32]}"
    text = load_cached(file)
    if text is None:
        with compiling():
            text = json.dumps(compute()).encode()
        # files that tracing reads are known only afterwards, and change the content
        if lasting_content(source, name, *others) == content:
            store_cached(file, text)
    return json.loads(text)


def _stamps(folder: str) -> Iterator[tuple[str, int, int]]:
    """The path, modification time (ns) and size of each source in a folder and below it."""
    for entry in os.scandir(folder):
        if entry.is_dir() and entry.name != "__pycache__":
            yield from _stamps(entry.path)
        elif entry.name.endswith(".py"):
            status = entry.stat()
            yield entry.path, status.st_mtime_ns, status.st_size


# gaitsweep's sources as they are imported, not as they may be edited later
_SOURCES = hashlib.sha256(repr(sorted(_stamps(str(Path(__file__).parents[1])))).encode()).hexdigest()
_VERSIONS = sys.version, jax_version(), jaxlib_version, np.__version__, os.environ.get("XLA_FLAGS")


def _settings() -> list[tuple[str, str]]:
    """The settings of JAX that may change a trace."""
    return [
        (name, repr(value))
        for name, value in jax_settings()
        if not any(word in name.lower() for word in _WITHOUT_EFFECT)
    ]


def shapes_of(model: Model) -> tuple[Params, State]:
    """The shapes of a model's parameters and of its state, traced without values."""
    number = jax.ShapeDtypeStruct((), jnp.float64)
    values = {q.name: number for q in model.parameters}
    if model.host_parameters:
        values = _shapes_on_host(model)
    params = jax.eval_shape(model.params, values)
    return params, jax.eval_shape(model.init, params, {q.name: number for q in model.initial_conditions})


def _shapes_on_host(model: Model) -> dict[str, jax.ShapeDtypeStruct]:
    """The shapes of what the host computes from a model's parameters, here from their defaults."""
    row: dict[str, np.ndarray] = {}
    for quantity in model.parameters:
        default = quantity.default if isinstance(quantity.default, int | float) else 1.0
        row[quantity.name] = np.full(1, default)
    columns = model.on_host(row)
    return {name: jax.ShapeDtypeStruct(np.shape(column)[1:], jnp.float64) for name, column in columns.items()}


@cached_by_content(maxsize=64)
def counts_of_state(model: HybridModel) -> tuple[int, int]:
    """The number of numbers that the flow of a model moves, and that of the flags of its state."""

    def counts() -> tuple[int, int]:
        params, state = shapes_of(model)
        moving = [getattr(state, name) for name in jax.eval_shape(model.flow, params, state)]
        leaves = jax.tree.leaves(state)
        flags = [leaf for leaf in leaves if jnp.issubdtype(leaf.dtype, jnp.bool_)]
        return sum(leaf.size for leaf in moving), sum(leaf.size for leaf in flags)

    # stored, since every job that leaves the method open asks for them
    variables, flags = stored("counts_of_state", model, (), counts)
    return variables, flags


def dependences(function: Callable[..., Any], *inputs: Any) -> list[frozenset[str]]:
    """The names of the arguments on which each array that a function returns depends.

    A result of an inner function (of `jax.jit`, or a branch) counts as dependent on all arguments of that
    function.

    Args:
        function: of mappings of arrays by name.
        inputs: shapes and dtypes of its arguments, each a mapping.
    """
    program = jax.make_jaxpr(function)(*inputs).jaxpr
    paths = [path for path, _ in jax.tree_util.tree_flatten_with_path(inputs)[0]]
    names = {
        variable: frozenset({path[-1].key}) for variable, path in zip(program.invars, paths, strict=True)
    }

    def names_of(*atoms: Any) -> frozenset[str]:
        variables = (atom for atom in atoms if not isinstance(atom, Literal))
        return frozenset[str]().union(*(names.get(variable, ()) for variable in variables))

    for equation in program.eqns:
        names.update(dict.fromkeys(equation.outvars, names_of(*equation.invars)))
    return [names_of(atom) for atom in program.outvars]
