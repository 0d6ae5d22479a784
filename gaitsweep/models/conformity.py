"""Tests of what a model states, and of the shapes of its functions, against the contract.

`fault` runs before any job of a user's model; `value_faults` also evaluates the functions.
"""

from __future__ import annotations

import dataclasses
import math
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from gaitsweep import near_miss
from gaitsweep.contract import FixedStepDynamics, HybridModel, Model, Quantity
from gaitsweep.dynamics.declaration_faults import faults_of_quantity
from gaitsweep.dynamics.declarations import Mode, Time, Variable
from gaitsweep.dynamics.declared import STEPS, Declared
from gaitsweep.dynamics.declared_model import ARMING
from gaitsweep.dynamics.map_model import MapModel
from gaitsweep.dynamics.sliding import Sliding
from gaitsweep.engine.content import cached_by_content, held_result
from gaitsweep.engine.kernel.program import Program
from gaitsweep.engine.kernel.trace import Tracer, UnsupportedError
from gaitsweep.engine.stored_traces import dependences, stored
from gaitsweep.mathtext import can_be_set
from gaitsweep.models.traced_program import unrepeatable
from gaitsweep.own_modules import line_of
from gaitsweep.status import Outcome

_NOT_TEX = "which Matplotlib cannot set: write TeX that it knows, and \\$ for a dollar."


def quantity_faults(model: Model) -> Iterator[str]:
    """Faults of names, units, symbols, bounds, defaults and scales, as ends of sentences."""
    starts = {quantity.name for quantity in model.initial_conditions}
    settable = [*model.parameters, *model.initial_conditions]
    groups = {
        "parameters or initial_conditions": settable,
        **{name: getattr(model, name) for name in ("observables", "signals", "label_fields")},
    }
    for where, quantities in groups.items():
        names = [quantity.name for quantity in quantities]
        for name in dict.fromkeys(names):
            if names.count(name) > 1:
                yield f"whose {where} have the name {name} twice: rename one."
            if not name.isidentifier():
                must = "names must consist of letters, digits and underscores"
                yield f"whose {where} have the name {name!r}: {must}."
        for quantity in quantities:
            yield from _faults_of_quantity(quantity, is_start=quantity.name in starts)
    if all(quantity.scale == math.inf and not quantity.circular for quantity in model.observables):
        yield "whose observables all have an infinite scale, so that each row would settle at once."
    hiding = (
        ("signal", model.signals, "parameter or start", settable, "in a trace"),
        ("observable", model.observables, "parameter", model.parameters, "along a branch"),
    )
    for kind, quantities, owner, others, where in hiding:
        for name in sorted({quantity.name for quantity in quantities} & {other.name for other in others}):
            yield f"whose {kind} {name} has the name of a {owner} and would hide it {where}: rename it."
    if not model.gaits or len(set(model.gaits)) < len(model.gaits):
        yield f'whose gaits are {model.gaits}: there must be at least one name ("none"), without repetitions.'
    for name in (Outcome.FAILED, Outcome.NOT_SETTLED):
        if name in model.gaits:
            yield f"which has a gait named {name}, the outcome of rows without a gait: rename it."
    events = model.guard_names if isinstance(model, HybridModel) else ()
    names_by_owner = {"a gait": model.gaits, "an event": events, "a limb": [x.name for x in model.limbs]}
    for owner, names in names_by_owner.items():
        for name in names:
            if isinstance(name, str) and not can_be_set(name):
                yield f"which has {owner} named {name!r}, {_NOT_TEX}"


def _faults_of_quantity(quantity: Quantity, *, is_start: bool) -> Iterator[str]:
    """Faults of one quantity, as ends of sentences."""
    texts = {"symbol": f"${quantity.symbol}$", "unit": quantity.unit, "meaning": quantity.meaning}
    for field, text in texts.items():
        if getattr(quantity, field) and not can_be_set(text):
            yield f"whose {quantity.name} has the {field} {getattr(quantity, field)!r}, {_NOT_TEX}"
    yield from faults_of_quantity(quantity, is_start)


class _Fault(Exception):
    """A violation of the contract; the message follows `but its function`."""


def _returns(name: str, result: object, required: str) -> _Fault:
    """The violation by a function that returns something else than it must."""
    return _Fault(f"{name} returns {result}, but must return {required}.")


def _type_of(result: object) -> str:
    """The name of a result's type, for a message."""
    if result is None:
        return "nothing"
    return "an array" if isinstance(result, jax.ShapeDtypeStruct) else type(result).__name__


def fault(model: Model) -> str | None:
    """The first violation of `gaitsweep/contract.py` by a model, or None.

    The functions are traced with shapes only, as by the engine; those of a model with `host_parameters` are
    not.

    Args:
        model: an instance of the user's class.

    Returns:
        The end of a sentence that begins with the model's name.
    """
    try:
        hash(model)
    except TypeError as error:
        return f"which cannot be hashed ({error}): make it a frozen dataclass, with tuples in place of lists."
    return held_result(("fault", type(model), model), lambda: _fault(model) or unrepeatable(model))


@cached_by_content(maxsize=64)
def _fault(model: Model) -> str | None:
    """The first violation by the quantities or the functions of a model, or None."""
    if not model.parameters:
        return "which has no parameter: declare at least one, such as a frequency or a mass."
    if not model.observables:
        return "which has no observable: declare at least one, to be recorded at each crossing."
    return next(quantity_faults(model), None) or stored("fault", model, (), lambda: traced_fault(model))


def traced_fault(model: Model) -> str | None:
    """The first violation by a model's functions, as the end of a sentence, or None."""
    if model.host_parameters:
        return None
    try:
        _trace_functions(model)
    except _Fault as fault_of_function:
        return f"but its function {fault_of_function}"
    return None


def _trace_functions(model: Model) -> None:
    """Trace all functions of a model with shapes only; raises `_Fault` at the first violation."""
    params = _traced_result(
        "params", model.params, {quantity.name: _scalar() for quantity in model.parameters}
    )
    start = {quantity.name: _scalar() for quantity in model.initial_conditions}
    declared = model if isinstance(model, Declared) and isinstance(model, HybridModel) else None
    if (
        declared is not None
    ):  # before `init`, which takes derivatives of these functions, and reads the period
        _require_event_functions(declared, params, _bare_state(declared))
        _traced_result("period", model.period, params)
    try:
        state = _traced_result("init", model.init, params, start)
    except _Fault:
        if declared is not None:
            _refuse_functions_of_init(declared, params, _bare_state(declared))
        raise
    if not dataclasses.is_dataclass(state):
        raise _returns("init", _type_of(state), "a frozen dataclass")
    if isinstance(model, Declared):
        _require_event_functions(model, params, state)
    rates: Mapping[str, Any] = {}
    if isinstance(model, HybridModel):  # before `jump`, which may read the rates
        rates = _traced_result("flow", model.flow, params, state)
        _require_rates(state, rates)
    if isinstance(model, Declared):
        _require_intensities(model, params, state)
        _require_jump_functions(model, params, state)
    events = _event_flags(model, params, state)
    _require_like("jump", state, _traced_result("jump", model.jump, params, state, events))
    if isinstance(model, HybridModel):
        _refuse_forgotten_rates(model, params, state, events, rates)
    _require_shape("section", _traced_result("section", model.section, params, state, events), ())
    _require_shape("failed", _traced_result("failed", model.failed, params, state), ())
    period = _traced_result("period", model.period, params)
    _require_shape("period", period, ())
    if _kind_of_numbers(period) != "real numbers":  # a time limit of its type would be rounded
        raise _returns("period", _kind_of_numbers(period), "a real number of seconds: 3.0, not 3")
    observed = _traced_result("observe", model.observe, params, state)
    _require_names("observe", observed, "observables", (quantity.name for quantity in model.observables))
    signals = _traced_result("signal", model.signal, params, state)
    _require_names("signal", signals, "signals", (quantity.name for quantity in model.signals))
    labels = _traced_result("label", model.label, params, observed)
    fields = ("gait", *(quantity.name for quantity in model.label_fields))
    _require_names("label", labels, "gait and label fields", fields)
    kind_of_gait = _kind_of_numbers(labels["gait"])
    if kind_of_gait not in ("whole numbers", "booleans"):
        raise _returns("label", f"the gait as {kind_of_gait}", "the index of a gait, a whole number")


def _bare_state(model: Declared) -> Any:
    """A state with the declared fields of a model; fields added by `init` are empty."""
    fields: dict[str, Any] = {}
    for field in dataclasses.fields(model.State):
        declared = model.declarations.get(field.name)
        if isinstance(declared, Sliding):
            fields[field.name] = jnp.asarray(1)
        elif isinstance(declared, Mode):
            fields[field.name] = jnp.broadcast_to(jnp.asarray(declared.start), declared.shape(model))
        else:
            fields[field.name] = jnp.zeros(declared.shape(model) if isinstance(declared, Variable) else 0)
    return model.State(**fields)


def _require_event_functions(model: Declared, params: Any, state: Any) -> None:
    """Refuse event functions that do not return one real number, by the events' names."""
    for event in model.declarations.events:
        name = f"for the event {event.name!r}"
        result = _traced_result(name, lambda p, s, event=event: event.function(model, p, s), params, state)
        _require_shape(name, result, event.counted.shape(model))
        if (kind := _kind_of_numbers(result)) != "real numbers":
            required = "a real number that rises through zero: s.x - 2.0, not s.x > 2.0"
            raise _returns(name, kind, required)
        shapes = ((), event.counted.shape(model))
        if event.during is not None:
            _require_condition(f"during= of the event {event.name!r}", event.during, shapes, state)
        if event.when is not None:
            _require_condition(f"when= of the event {event.name!r}", event.when, shapes, params, state)


def _require_condition(
    name: str, condition: Callable[..., Any], shapes: tuple[tuple[int, ...], ...], *arguments: Any
) -> None:
    """Refuse a condition that does not return truth values of one of these shapes."""
    result = _traced_result(name, condition, *arguments)
    if _kind_of_numbers(result) != "booleans" or jnp.shape(result) not in shapes:
        returned = f"{_kind_of_numbers(result)} {jnp.shape(result)}"
        raise _returns(name, returned, "a condition, such as s.x > 0.0")


def _refuse_functions_of_init(model: Any, params: Any, state: Any) -> None:
    """Refuse a flow or a jump that fails at a bare state, so that `init` is not blamed for it."""
    added = {field.name for field in dataclasses.fields(state)} - set(model.declarations) - {ARMING, STEPS}
    if added:  # they are empty here, and a flow may read them
        return
    _require_rates(state, _traced_result("flow", model.flow, params, state))
    _require_jump_functions(model, params, state)


def _require_intensities(model: Declared, params: Any, state: Any) -> None:
    """Refuse intensities of noise that are no mapping from continuous fields, or of another shape.

    Also refused is noise that moves states off a surface of sliding, on which they would not stay.
    """
    if (noise := model.declarations.diffusion) is None:
        return
    intensities = _traced_result("diffusion", lambda p, s: noise.function(model, p, s), params, state)
    _require_by_field("diffusion", "an intensity", state, intensities)
    noisy = {name: getattr(state, name) for name in intensities}
    zeros = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), (params, state))
    for name, surface in model.declarations.of_kind(Sliding).items():
        (moving,) = dependences(lambda f, s=surface: [s.height(zeros[0], zeros[1].replace(**f))], noisy)
        if moving:
            text = (
                f"diffusion returns an intensity of {min(moving)}, with which a state leaves the surface of "
            )
            raise _Fault(
                f"{text}{name} at once: write the switch into flow, with jnp.sign, in place of sliding."
            )


def _require_jump_functions(model: Declared, params: Any, state: Any) -> None:
    """Refuse jumps of events that do not return a state, by the events' names."""
    for event in model.declarations.events:
        if event.effect is None:
            continue
        name = f"for the jump of {event.name!r}"
        single = event.singles(model)[0]
        after = _traced_result(name, lambda p, s, single=single: single.jumped(model, p, s), params, state)
        if not isinstance(after, type(state)):
            raise _returns(name, _type_of(after), "a state, such as s.replace(...)")


def _scalar() -> jax.ShapeDtypeStruct:
    """The shape of one number; a function, since `check` reads this module without importing JAX."""
    return jax.ShapeDtypeStruct((), np.float64)


def _event_flags(model: Model, params: Any, state: Any) -> jax.ShapeDtypeStruct:
    """The shape of the flags of events."""
    name = "guards" if isinstance(model, HybridModel) else "events"
    if isinstance(model, HybridModel):
        result = _traced_result(name, model.guards, params, state)
    else:
        assert isinstance(model, FixedStepDynamics)
        if isinstance(model, MapModel):
            clocks = model.declarations.of_kind(Time)
            _require_image(state, _traced_result("image", model.image, params, state), clocks)
        factor = (_scalar(),) if model.stochastic else ()
        after = _traced_result("step", model.step, params, state, _scalar(), *factor)
        _require_like("step", state, after)
        result = _traced_result(name, model.events, params, state, after)
    if getattr(result, "ndim", None) != 1:
        shape = getattr(result, "shape", type(result).__name__)
        raise _returns(name, shape, "one number for each event, (n,): use jnp.stack")
    if isinstance(model, HybridModel):
        if _kind_of_numbers(result) != "real numbers":
            raise _returns("guards", _kind_of_numbers(result), "real numbers")
        names = model.guard_names
        if not isinstance(names, tuple) or not all(isinstance(guard_name, str) for guard_name in names):
            raise _returns("guard_names", repr(names), "a tuple of texts")
        if names and len(names) != (count := result.shape[0]):
            raise _Fault(f"guard_names returns {len(names)} names, but guards returns {count} numbers.")
    return jax.ShapeDtypeStruct(result.shape, bool)


def _traced_result(name: str, function: Callable[..., Any], *args: Any) -> Any:
    """The shapes of a function's results, traced for arguments of these shapes."""
    try:
        with warnings.catch_warnings():
            # complex numbers have a message of their own
            warnings.simplefilter("ignore", np.exceptions.ComplexWarning)
            return jax.make_jaxpr(function, return_shape=True)(*args)[1]
    except Exception as error:  # a user's function may raise anything
        reason = (str(error).splitlines() or [""])[0]
        needs_values = (jax.errors.ConcretizationTypeError, jax.errors.TracerArrayConversionError)
        remedy = " Use jnp.where instead of if, and jnp instead of math and numpy."
        advice = remedy if isinstance(error, needs_values) else ""
        kind = f"{type(error).__name__}{line_of(error)}"
        raise _Fault(f"{name} raises {kind}: {reason.rstrip('.')}.{advice}") from error


def _require_image(state: Any, image: Any, clocks: Iterable[str]) -> None:
    """Refuse an image that is no mapping from fields of a state, or one from others, or without a clock."""
    if not isinstance(image, Mapping):
        raise _returns("image", _type_of(image), "a mapping from variables to their values in the image")
    fields = list(vars(state))
    for name in image:
        if name not in fields:
            near = near_miss.suggestion(str(name), fields)
            raise _Fault(f"image returns a value of {name}, which is not a field of its state{near}")
    for name in clocks:
        if name not in image:
            raise _Fault(f"image returns no value of the time {name}, which stays 0: return s.{name} + 1.0.")


def _require_by_field(function: str, noun: str, state: Any, values: Any) -> None:
    """Refuse values that are no mapping from continuous fields of a state, or of another shape.

    Args:
        function: the name of the function that returns them.
        noun: that of a value, such as "a rate".
        state: the state.
        values: the values by field.
    """
    fields = list(vars(state))
    if not isinstance(values, Mapping):
        raise _returns(function, _type_of(values), f"a mapping from fields of the state, each to {noun}")
    for name, value in values.items():
        returned = f"{function} returns {noun} of {name}"
        if name not in fields:
            near = near_miss.suggestion(str(name), _continuous_fields(state))
            raise _Fault(f"{returned}, which is not a field of its state{near}")
        if name not in _continuous_fields(state):
            raise _Fault(f"{returned}, which is a mode: only jump can change it.")
        if not hasattr(value, "shape"):
            raise _Fault(f"{returned} as {_type_of(value)}, but must return one array: use jnp.stack.")
        shape = jnp.shape(getattr(state, name))
        if value.shape not in (shape, ()):
            raise _Fault(f"{returned} with shape {value.shape}, but the field has shape {shape}.")


def _require_rates(state: Any, rates: Any) -> None:
    """Refuse rates that are no mapping from continuous fields of a state, or of another shape or type."""
    _require_by_field("flow", "a rate", state, rates)
    for name, rate in rates.items():
        if (kind := _kind_of_numbers(rate)) != "real numbers":
            zero = ": write 1.0 instead of 1" if kind == "whole numbers" else ""
            raise _returns("flow", f"the rate of {name} as {kind}", f"real numbers{zero}")
        if rate.dtype.itemsize < (own := jnp.result_type(getattr(state, name))).itemsize:
            raise _Fault(f"flow returns the rate of {name} in {rate.dtype}, but the field is in {own}.")


def _refuse_forgotten_rates(
    model: Model, params: Any, state: Any, events: Any, rates: Mapping[str, Any]
) -> None:
    """Refuse a declared variable without a rate that no jump changes, and a held one with a rate."""
    variables = model.declarations.of_kind(Variable) if isinstance(model, Declared) else {}
    for name, variable in variables.items():
        if variable.held and name in rates:
            raise _Fault(f"flow returns a rate of {name}, which has held=True: leave out one of the two.")
    without_rate = [name for name in variables if name not in rates]
    if not without_rate:
        return
    # a scalar program has one node for equal values
    tracer = Tracer(Program())
    before = (params, state, events)
    inputs = jax.tree.unflatten(jax.tree.structure(before), tracer.inputs(before, 0, steady=False))
    try:
        nodes = tracer.read(jax.make_jaxpr(model.jump)(*before), jax.tree.leaves(inputs))
    except UnsupportedError:
        return
    after = jax.tree.unflatten(jax.tree.structure(state), nodes)
    for name in without_rate:
        if np.array_equal(getattr(inputs[1], name), getattr(after, name)):
            constant = "return its rate, or 0.0 if it is constant"
            raise _Fault(f"flow returns no rate of {name}, and no jump changes it: {constant}.")


@cached_by_content(maxsize=64)
def variables_without_rate(model: Model) -> tuple[str, ...]:
    """The declared variables of which `flow` returns no rate, and that are not declared as held.

    They change at events alone, which may be meant. The clock of footfalls is a fault, not among them.
    """
    original = model.original
    if not isinstance(original, Declared) or not isinstance(original, HybridModel) or model.host_parameters:
        return ()
    feet = original.declarations.feet
    clock = None if feet is None else feet.clock
    variables = original.declarations.of_kind(Variable).items()
    unheld = [name for name, variable in variables if not variable.held and name != clock]
    if not unheld:
        return ()

    def rates(values: Any, start: Any) -> Any:
        params = original.params(values)
        return original.flow(params, original.init(params, start))

    def compute() -> list[str]:
        quantities = original.parameters, original.initial_conditions
        shapes = [{quantity.name: _scalar() for quantity in group} for group in quantities]
        known = jax.eval_shape(rates, *shapes)
        return [name for name in unheld if name not in known]

    return tuple(stored("variables_without_rate", original, (), compute))


def remark_on_rates(names: Sequence[str]) -> str:
    """A sentence about the variables that `variables_without_rate` returns."""
    them, rates = ("it", "its rate") if len(names) == 1 else ("them", "their rates")
    return (
        f"flow returns no rate of {', '.join(names)}, so that only events change {them}: return {rates}, or "
        f"declare {them} with held=True."
    )


def _kind_of_numbers(array: Any) -> str:
    """The kind of numbers of an array."""
    kinds = {"b": "booleans", "i": "whole numbers", "u": "whole numbers", "f": "real numbers"}
    return kinds.get(jnp.result_type(array).kind, "complex numbers")


def _continuous_fields(state: Any) -> list[str]:
    """The fields of a state that are real numbers; modes have no rates."""
    return [
        name
        for name, value in vars(state).items()
        if all(jnp.issubdtype(jnp.result_type(leaf), jnp.floating) for leaf in jax.tree.leaves(value))
    ]


def _require_like(name: str, before: Any, after: Any) -> None:
    """Refuse a function whose result is not a state of the same structure and shapes."""
    if jax.tree.structure(before) != jax.tree.structure(after):
        raise _returns(name, type(after).__name__, type(before).__name__)
    for (path, old), new in zip(jax.tree.leaves_with_path(before), jax.tree.leaves(after), strict=True):
        field = jax.tree_util.keystr(path).lstrip(".")
        for what, was, now in (("shape", old.shape, new.shape), ("type", old.dtype, new.dtype)):
            if was != now:
                returned = f"{field} with {what} {now}"
                raise _Fault(f"{name} returns {returned}, but init returns it with {what} {was}.")


def _require_shape(name: str, value: Any, shape: tuple[int, ...]) -> None:
    """Refuse a result of another shape."""
    if getattr(value, "shape", None) != shape:
        required = f"{shape[0]} numbers, {shape}, as count= says" if shape else "one number, ()"
        raise _returns(name, getattr(value, "shape", type(value).__name__), required)


def _require_names(name: str, returned: Any, kind: str, required: Iterable[str]) -> None:
    """Refuse a result that lacks the name of a quantity of a kind, or has a value that is not one number."""
    names = list(returned) if isinstance(returned, Mapping) else []
    for wanted_name in required:
        if wanted_name not in names:
            outputs = ", ".join(map(str, names)) or "no names"
            raise _Fault(f"{name} does not return {wanted_name}, one of its {kind}; it returns {outputs}.")
        _require_shape(f"{name}, {wanted_name},", returned[wanted_name], ())
