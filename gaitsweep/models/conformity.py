"""Tests of a model against the contract: `fault` traces its functions, `faults` runs them once as well."""

from __future__ import annotations

import dataclasses
import inspect
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Any, ClassVar, get_origin

import jax
import jax.numpy as jnp
import numpy as np

from gaitsweep import near_miss
from gaitsweep.contract import FixedStepDynamics, HybridModel, Model, Quantity
from gaitsweep.engine.content import cached_by_content
from gaitsweep.expression import ExpressionError, resolve
from gaitsweep.models.traced_program import unrepeatable

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
    return _fault(model) or unrepeatable(model)


@cached_by_content(maxsize=64)
def _fault(model: Model) -> str | None:
    if model.host_parameters:
        return None
    if not model.parameters:
        return "which has no parameter: declare one at least, such as a frequency or a mass."
    if not model.observables:
        return "which has no observable: declare one at least, which is recorded at each crossing."
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
            raise _Fault(f"{text}{near_miss.suggestion(str(name), _continuous(state))}")
        shape = jnp.shape(getattr(state, name))
        if rate.shape not in (shape, ()):
            raise _Fault(f"flow gives {name} a rate of shape {rate.shape}, but the field has {shape}.")


def _continuous(state: Any) -> list[str]:
    """The fields of a state that are real numbers; modes have no rates."""
    return [
        name
        for name, value in vars(state).items()
        if all(jnp.issubdtype(jnp.result_type(leaf), jnp.floating) for leaf in jax.tree.leaves(value))
    ]


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


def faults(kind: type[Model]) -> list[str]:
    """All that is found wrong with a model, by its functions' shapes and by their values at its defaults.

    Args:
        kind: the class; its structure takes its defaults.

    Returns:
        As `fault`: words that continue a sentence after the model's name. Empty where nothing is wrong.
    """
    if (unread := _unread_structure(kind)) is not None:
        return [unread]
    missing = [field.name for field in dataclasses.fields(kind) if _required(field)]  # pyright: ignore
    if missing:
        return [f"which has no default for {', '.join(missing)}: it is tested with its defaults."]
    try:
        model = kind()
        named = list(_named_twice_or_unsaid(model))
    except Exception as error:  # a user's class may raise anything
        return [f"which raises {type(error).__name__} when it is made: {error}."]
    if (found := fault(model)) is not None:
        return [*named, found]
    try:
        return [*named, *_by_value(model)]
    except ExpressionError as error:
        return [*named, f"a default of which has no value: {error}"]


def _unread_structure(kind: type[Model]) -> str | None:
    """Fields that are annotated as structure in a class that is no dataclass, and so have no effect."""
    for each in kind.__mro__:
        if not issubclass(each, Model) or each.__module__.startswith("gaitsweep.contract"):
            continue
        own = vars(each).get("__dataclass_fields__", {})
        for name, hint in inspect.get_annotations(each).items():
            constant = get_origin(hint) is ClassVar or str(hint).startswith(("ClassVar", "typing.ClassVar"))
            if name not in own and not constant:
                return (
                    f"whose class {each.__name__} annotates {name} but is no dataclass, so no job can set "
                    "it: write @dataclasses.dataclass(frozen=True) before the class."
                )
    return None


def _required(field: dataclasses.Field) -> bool:
    return field.default is dataclasses.MISSING and field.default_factory is dataclasses.MISSING


def _named_twice_or_unsaid(model: Model) -> Iterator[str]:
    settable = [*model.parameters, *model.initial_conditions]
    recorded = {
        "observables": model.observables,
        "signals": model.signals,
        "label_fields": model.label_fields,
    }
    for where, quantities in {"parameters or initial_conditions": settable, **recorded}.items():
        names = [quantity.name for quantity in quantities]
        for name in dict.fromkeys(names):
            if names.count(name) > 1:
                yield f"whose {where} have the name {name} twice: rename one."
            if not name.isidentifier():
                yield f"whose {where} have the name {name!r}: it takes letters, digits and underscores."
        for quantity in quantities:
            for field in ("unit", "meaning"):
                if not getattr(quantity, field):
                    unit = ' ("1" for a number without one)' if field == "unit" else ""
                    yield f"whose {quantity.name} has no {field}: tables and figures show it{unit}."
    hidden = {quantity.name for quantity in settable} & {quantity.name for quantity in model.signals}
    for name in sorted(hidden):
        yield f"whose signal {name} has the name of what a job sets and would hide it in a trace: rename it."
    if not model.gaits or len(set(model.gaits)) < len(model.gaits):
        yield f'whose gaits are {model.gaits}: it takes at least one name ("none"), each once.'


def _by_value(model: Model) -> Iterator[str]:
    """Faults that show at the defaults: numbers that are not finite, types and modes that change."""
    values = _defaults(model.parameters, {})
    known = {name: jnp.asarray(value) for name, value in model.on_host(values).items()}
    first = {name: each[0] if jnp.ndim(each) else each for name, each in known.items()}
    params = model.params(first)
    start = _defaults(model.initial_conditions, values)
    state = model.init(params, {name: jnp.asarray(start[name][0]) for name in start})
    yield from _not_finite("init", state)
    yield from _not_finite("observe", observed := model.observe(params, state))
    yield from _not_finite("signal", model.signal(params, state))
    if not (period := float(model.period(params))) > 0.0:
        yield f"but its function period gives {period:g}, where it gives seconds above 0."
    gait, gaits = int(model.label(params, observed)["gait"]), len(model.gaits)
    if not 0 <= gait < gaits:
        yield f"but its function label gives gait {gait}, where it gives an index into its {gaits} gaits."
    if bool(model.failed(params, state)):
        yield "but its function failed says that its default start has fallen."
    if isinstance(model, HybridModel):
        rates = model.flow(params, state)
        yield from _not_finite("flow", rates)
        guards = model.guards(params, state)
        yield from _not_finite("guards", guards)
        quiet = jnp.zeros(guards.shape, bool)
        for name in rates:
            if not jnp.issubdtype(jnp.result_type(getattr(state, name)), jnp.floating):
                yield f"but its function flow gives a rate of {name}, which is a mode: only jump changes it."
    else:
        assert isinstance(model, FixedStepDynamics)
        after = jax.jit(model.step)(
            params, state, jnp.asarray(1e-6)
        )  # a simulator has thousands of operations
        yield from _not_finite("step", after)
        quiet = jnp.zeros(model.events(params, state, after).shape, bool)
    still = model.jump(params, state, quiet)
    for (path, old), new in zip(jax.tree.leaves_with_path(state), jax.tree.leaves(still), strict=True):
        field = jax.tree_util.keystr(path).lstrip(".")
        if jnp.result_type(old) != jnp.result_type(new):
            types = f"{jnp.result_type(new)}, but init gives it {jnp.result_type(old)}"
            yield f"but its function jump gives {field} the type {types}."
        elif not np.array_equal(old, new, equal_nan=True):
            yield f"but its function jump changes {field} where nothing fired: use jnp.where(fired[i], ...)."
    if bool(model.section(params, state, quiet)):
        yield "but its function section closes a cycle where no event has fired."


def _defaults(quantities: Iterable[Quantity], known: Mapping[str, Any]) -> dict[str, np.ndarray]:
    """The defaults of quantities, (1,) each; the middle of its bounds where one has none."""
    formulas = {
        q.name: q.default if q.default is not None else float(np.clip(1.0, q.low, q.high)) for q in quantities
    }
    found = resolve(formulas, {name: float(value[0]) for name, value in known.items()})
    return {name: np.array([float(found[name])]) for name in formulas}


def _not_finite(name: str, found: Any) -> Iterator[str]:
    for path, leaf in jax.tree.leaves_with_path(found):
        if not np.all(np.isfinite(np.asarray(leaf, float))):
            field = jax.tree_util.keystr(path).strip(".[]'")
            where = f" for {field}" if field else ""
            yield f"but its function {name} gives {np.asarray(leaf)}{where} at the model's defaults."
