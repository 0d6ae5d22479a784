"""The traced program of a user's model: a digest of each function, with its constants, and of its quantities.

A number that a module reads from a file when it is imported stands in no source, but in the program.
"""

from __future__ import annotations

import dataclasses
import hashlib
import re
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from gaitsweep.contract import HybridModel, Model
from gaitsweep.dynamics.mjx.mjcf_model import MjcfModel
from gaitsweep.engine.content import cached_by_content, depends_on
from gaitsweep.engine.devices import see_all_cores
from gaitsweep.engine.stored_traces import stored
from gaitsweep.own_modules import data_files

# functions that others call, so that the cause is there, and those that call most others
_CALLED_FUNCTIONS = ("params", "period", "flow", "control", "rates", "step", "observe", "jump")
_CALLING_FUNCTIONS = ("guards", "init")
# the arguments of each function: results of others, or `values`, `start`, `dt` and `flags`, in their order
_OF_STATE = ("params", "init")
_ARGUMENTS = {
    **dict.fromkeys(
        ("flow", "guards", "control", "rates", "observe", "signal", "failed", "chart"), _OF_STATE
    ),
    **dict.fromkeys(("fast_modes", "longest_step", "period", "free_after"), ("params",)),
    **dict.fromkeys(("jump", "section"), (*_OF_STATE, "flags")),
    "params": ("values",),
    "init": ("params", "start"),
    "step": (*_OF_STATE, "dt"),
    "events": (*_OF_STATE, "init"),
    "label": ("params", "observe"),
}
_OUTPUTS = ("observables", "label_fields", "signals", "gaits")  # their scales decide when a row has settled
DECLARATIONS = ("parameters", *_OUTPUTS)  # names of digests that are not those of functions
_ADDRESS = re.compile(r"0x[0-9a-f]+")


@dataclasses.dataclass(frozen=True)
class TracedProgram:
    """Program that the functions of a model compute.

    `digests` are those of functions and quantities, by name; empty for gaitsweep's models, which its version
    identifies.
    `varying` is a function that is another one each time it is traced, or None.
    """

    digests: Mapping[str, str]
    varying: str | None = None


def unrepeatable(model: Model) -> str | None:
    """The reason why a model is not reproducible, as the end of a sentence after its name, or None."""
    varying = traced_program(model).varying
    if varying is None:
        return None
    return (
        f"but its function {varying} differs each time that it is traced: it draws random numbers or reads a "
        "clock when it is compiled. Make such a number a parameter, or a constant of the module with a fixed "
        "seed."
    )


@cached_by_content(maxsize=64)
def traced_program(model: Model) -> TracedProgram:
    """Trace the functions of a user's model twice, and compare.

    Functions that cannot be traced are left out; `models.conformity` reports them.
    """
    if type(model).__module__.startswith("gaitsweep."):
        return TracedProgram({})
    see_all_cores()  # float64, as the engine traces

    def traced_twice() -> tuple[Mapping[str, str], str | None]:
        # JAX keeps traces of jitted functions and of the bodies of loops, by this context too
        trace = jax.make_user_context("")
        with trace("first"), data_files() as read:
            first = dict(_digests(model))
        depends_on(model, read)
        with trace("second"):
            second = dict(_digests(model))
        return first, first_difference(first, second)

    return TracedProgram(*stored("functions", model, (), traced_twice))


def first_difference(one: Mapping[str, str], other: Mapping[str, str]) -> str | None:
    """The function in which two programs differ, one that others call before those; None if none does."""
    others = (name for name in (*one, *other) if name not in _CALLING_FUNCTIONS)
    names = (*_CALLED_FUNCTIONS, *others, *_CALLING_FUNCTIONS)
    return next((name for name in names if one.get(name) != other.get(name)), None)


def _digests(model: Model) -> Iterator[tuple[str, str]]:
    """The digests of the quantities and of each function, in the order in which a run calls them."""
    yield "parameters", _digest_of_text(repr((model.parameters, model.initial_conditions)))
    for name in _OUTPUTS:
        yield name, _digest_of_text(repr(getattr(model, name)))
    number = jax.ShapeDtypeStruct((), float)
    values: Any = {quantity.name: number for quantity in model.parameters}
    if model.host_parameters:
        defaults = {
            q.name: np.array([q.default if isinstance(q.default, int | float) else 1.0])
            for q in model.parameters
        }
        try:
            values = model.on_host(defaults)
        except Exception:  # defaults need not make a body
            return
        yield "on_host", _digest_of_text(repr({name: _bytes(value) for name, value in values.items()}))
        values = {name: jax.ShapeDtypeStruct(np.shape(v)[1:], float) for name, v in values.items()}
    start = {quantity.name: number for quantity in model.initial_conditions}
    shapes = {"values": values, "start": start, "dt": number}
    if isinstance(model, HybridModel):
        motion = ("flow", "guards", "fast_modes")
    elif isinstance(model, MjcfModel):  # its step takes seconds to trace; `data_digest` covers its body
        motion = ("control", "rates", "events", "longest_step")
    else:
        motion = ("step", "events", "longest_step")
    for name in ("params", "init", *motion):
        yield from _digest(shapes, name, getattr(model, name))
    events = shapes.get("guards", shapes.get("events"))
    shapes["flags"] = jax.ShapeDtypeStruct(getattr(events, "shape", (0,)), bool)
    for name in ("jump", "section", "observe", "signal", "label", "failed", "period", "free_after"):
        yield from _digest(shapes, name, getattr(model, name))
    if (chart := model.chart()) is not None:
        yield from _digest(shapes, "chart", chart.to_coordinates)


def _digest(shapes: dict[str, Any], name: str, function: Callable[..., Any]) -> Iterator[tuple[str, str]]:
    """The name and digest of a function, or nothing where it cannot be traced; `shapes` gets its results."""
    arguments = (shapes.get(shape) for shape in _ARGUMENTS[name])
    try:
        jaxpr, shapes[name] = jax.make_jaxpr(
            lambda *inputs: function(*inputs),  # a function that JAX has not seen
            return_shape=True,
        )(*arguments)
    except Exception:  # a user's function may raise anything
        return
    digest = hashlib.sha256()
    _add_program(digest.update, jaxpr)
    yield name, digest.hexdigest()[:16]


def _add_program(add: Callable[[bytes], None], program: Any) -> None:
    """Add the operations of a program and their constants, to the last bit."""
    jaxpr = getattr(program, "jaxpr", program)
    places: dict[Any, int] = {}

    def begin(variables: Any) -> None:
        for variable in variables:
            places[variable] = len(places)
            add(f"{variable.aval} ".encode())

    def use(variables: Any) -> None:
        for variable in variables:
            if hasattr(variable, "val"):
                add(_bytes(variable.val))
            else:
                add(f"{places[variable]} ".encode())

    for value in getattr(program, "consts", ()):
        add(_bytes(value))
    begin([*jaxpr.constvars, *jaxpr.invars])
    for equation in jaxpr.eqns:
        add(f"{equation.primitive.name}\n".encode())
        use(equation.invars)
        for name, value in sorted(equation.params.items()):
            add(f"{name} ".encode())
            _add_parameter(add, value)
        begin(equation.outvars)
    use(jaxpr.outvars)


def _add_parameter(add: Callable[[bytes], None], value: Any) -> None:
    """Add a parameter of an operation: programs by their content, arrays by their bits."""
    if isinstance(value, tuple | list):
        add(f"{len(value)} ".encode())
        for item in value:
            _add_parameter(add, item)
    elif isinstance(value, np.ndarray | np.generic | jax.Array):
        add(_bytes(value))
    elif hasattr(getattr(value, "jaxpr", value), "eqns"):
        _add_program(add, value)
    elif not callable(value):  # rules of derivatives are traced where a derivative is taken
        add(_ADDRESS.sub("", repr(value)).encode())


def _bytes(value: Any) -> bytes:
    """The type, the shape and the bits of an array."""
    if isinstance(value, jax.Array) and jnp.issubdtype(value.dtype, jax.dtypes.prng_key):
        value = jax.random.key_data(value)
    array = np.asarray(value)
    return f"{array.dtype} {array.shape}".encode() + array.tobytes()


def _digest_of_text(text: str) -> str:
    """The first 16 digits of a text's SHA-256."""
    return hashlib.sha256(text.encode()).hexdigest()[:16]
