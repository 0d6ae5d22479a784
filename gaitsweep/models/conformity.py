"""Test of a user's model against the contract, by tracing its functions without running them."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Iterable, Mapping
from typing import Any

import jax
import jax.numpy as jnp

from gaitsweep import near_miss
from gaitsweep.contract import FixedStepDynamics, HybridModel, Model

_NUMBER = jax.ShapeDtypeStruct((), float)


class _Fault(Exception):
    """A violation of the contract; the message continues `but its function`."""


def fault(model: Model) -> str | None:
    """The first violation of `gaitsweep/contract.py` by a model, or None.

    The functions are traced with shapes only, as by the engine. A model with `host_parameters` is not tested.

    Args:
        model: an instance of the user's class.

    Returns:
        Words that continue a sentence after the model's name, with a full stop at the end.
    """
    try:
        hash(model)
    except TypeError as error:
        return f"which cannot be hashed ({error}): make it a frozen dataclass, with tuples in place of lists."
    return _fault(model)


@functools.lru_cache(maxsize=64)
def _fault(model: Model) -> str | None:
    if model.host_parameters:
        return None
    try:
        _look(model)
    except _Fault as found:
        return f"but its function {found}"
    return None


def _look(model: Model) -> None:
    params = _given("params", model.params, {quantity.name: _NUMBER for quantity in model.parameters})
    start = {quantity.name: _NUMBER for quantity in model.initial_conditions}
    state = _given("init", model.init, params, start)
    if not dataclasses.is_dataclass(state):
        raise _Fault(f"init gives {type(state).__name__}, where it gives a frozen dataclass.")
    events = _events(model, params, state)
    _alike("jump", state, _given("jump", model.jump, params, state, events))
    _scalar("section", _given("section", model.section, params, state, events))
    _scalar("failed", _given("failed", model.failed, params, state))
    _scalar("period", _given("period", model.period, params))
    observed = _given("observe", model.observe, params, state)
    _named("observe", observed, "observables", (quantity.name for quantity in model.observables))
    signals = _given("signal", model.signal, params, state)
    _named("signal", signals, "signals", (quantity.name for quantity in model.signals))
    labels = _given("label", model.label, params, observed)
    fields = ("gait", *(quantity.name for quantity in model.label_fields))
    _named("label", labels, "gait and label fields", fields)


def _events(model: Model, params: Any, state: Any) -> jax.ShapeDtypeStruct:
    """The shape of the flags of events."""
    if isinstance(model, HybridModel):
        _rates(state, _given("flow", model.flow, params, state))
        name, found = "guards", _given("guards", model.guards, params, state)
    else:
        assert isinstance(model, FixedStepDynamics)
        after = _given("step", model.step, params, state, _NUMBER)
        _alike("step", state, after)
        name, found = "events", _given("events", model.events, params, state, after)
    if getattr(found, "ndim", None) != 1:
        shape = getattr(found, "shape", type(found).__name__)
        raise _Fault(f"{name} gives {shape}, where it gives one number for each event, (n,): use jnp.stack.")
    if isinstance(model, HybridModel):
        names = model.guard_names
        if not isinstance(names, tuple) or not all(isinstance(each, str) for each in names):
            raise _Fault(f"guard_names gives {names!r}, where it gives a tuple of texts.")
        if names and len(names) != found.shape[0]:
            raise _Fault(f"guard_names gives {len(names)} names, but guards gives {found.shape[0]} numbers.")
    return jax.ShapeDtypeStruct(found.shape, bool)


def _given(name: str, function: Callable[..., Any], *args: Any) -> Any:
    """The shapes of a function's results."""
    try:
        return jax.eval_shape(function, *args)
    except Exception as error:  # a user's function may raise anything
        reason = (str(error).splitlines() or [""])[0]
        advice = ""
        if isinstance(error, jax.errors.ConcretizationTypeError | jax.errors.TracerArrayConversionError):
            advice = " Use jnp.where in place of if, and jnp in place of math and numpy."
        raise _Fault(f"{name} raises {type(error).__name__}: {reason.rstrip('.')}.{advice}") from error


def _rates(state: Any, rates: Any) -> None:
    fields = list(vars(state))
    if not isinstance(rates, Mapping):
        raise _Fault(f"flow gives {type(rates).__name__}, where it gives rates by the state's fields.")
    for name, rate in rates.items():
        if name not in fields:
            text = f"flow gives a rate of {name}, which is no field of its state"
            raise _Fault(f"{text}{near_miss.suggestion(str(name), fields)}")
        shape = jnp.shape(getattr(state, name))
        if rate.shape not in (shape, ()):
            raise _Fault(f"flow gives {name} a rate of shape {rate.shape}, but the field has {shape}.")


def _alike(name: str, before: Any, after: Any) -> None:
    """Refuse a function whose result is not a state of the same structure and shapes."""
    if jax.tree.structure(before) != jax.tree.structure(after):
        raise _Fault(f"{name} gives {type(after).__name__}, where it gives a {type(before).__name__}.")
    for (path, old), new in zip(jax.tree.leaves_with_path(before), jax.tree.leaves(after), strict=True):
        if old.shape != new.shape:
            field = jax.tree_util.keystr(path).lstrip(".")
            raise _Fault(f"{name} gives {field} the shape {new.shape}, but init gives it {old.shape}.")


def _scalar(name: str, found: Any) -> None:
    if getattr(found, "shape", None) != ():
        shape = getattr(found, "shape", type(found).__name__)
        raise _Fault(f"{name} gives {shape}, where it gives one number, ().")


def _named(name: str, found: Any, kind: str, wanted: Iterable[str]) -> None:
    given = list(found) if isinstance(found, Mapping) else []
    for each in wanted:
        if each not in given:
            told = ", ".join(map(str, given)) or "nothing by name"
            raise _Fault(f"{name} does not give {each}, one of its {kind}; it gives {told}.")
        _scalar(f"{name}, {each},", found[each])
