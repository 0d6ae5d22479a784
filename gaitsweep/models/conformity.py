"""Tests of a model against the contract.

`fault` looks at a model's quantities and traces its functions, before any job of a user's model runs.
`faults` also evaluates them, at the defaults and over the ranges of parameters and starts, `faults_of_rows`
at the rows of a job.
"""

from __future__ import annotations

import dataclasses
import inspect
import math
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any, ClassVar, get_origin

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from gaitsweep import near_miss
from gaitsweep.contract import FixedStepDynamics, HybridModel, Model, Quantity
from gaitsweep.dynamics.declarations import Mode, Variable, faults_of_quantity
from gaitsweep.dynamics.declared_model import ARMING, STEPS, Declared, DeclaredModel
from gaitsweep.dynamics.map_model import MapModel
from gaitsweep.engine.content import cached_by_content, held_result
from gaitsweep.engine.dependence import dependences
from gaitsweep.engine.kernel.columns import over_rows
from gaitsweep.engine.kernel.program import Program
from gaitsweep.engine.kernel.trace import Tracer, UnsupportedError
from gaitsweep.engine.stored_programs import stored
from gaitsweep.expression import ExpressionError, resolve
from gaitsweep.mathtext import can_be_set
from gaitsweep.models.traced_program import unrepeatable

_NUMBER = jax.ShapeDtypeStruct((), float)
# Points over the ranges of parameters and starts at which functions are evaluated; repeated jumps at one
# instant after which a guard that fires each time is taken to fire without end.
_SAMPLE, _JUMPS = 64, 16
_WIDE = 100.0  # times the reach about a default: bounds that are further apart only clip it
_UNSET = "which Matplotlib cannot set: write TeX that it knows, and \\$ for a dollar."
NAMED = 8  # values that a sentence about a point names


Columns = Mapping[str, Float[np.ndarray, " rows"]]
Where = Callable[[int], str]  # words that say at which of some points something is


class _Fault(Exception):
    """A violation of the contract; the message follows `but its function`."""


def _returns(name: str, result: object, required: str) -> _Fault:
    """The violation by a function that returns something else than it must."""
    return _Fault(f"{name} returns {result}, but must return {required}.")


def _type_of(result: object) -> str:
    """The name of a result's type, for a message."""
    return "nothing" if result is None else type(result).__name__


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
    if not model.parameters:
        return "which has no parameter: declare at least one, such as a frequency or a mass."
    if not model.observables:
        return "which has no observable: declare at least one, to be recorded at each crossing."
    return next(_of_quantities(model), None) or stored("fault", model, (), lambda: _traced(model))


def _traced(model: Model) -> str | None:
    """The first violation by a model's functions."""
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
    if isinstance(model, Declared) and isinstance(model, HybridModel):
        _event_functions(model, params, _bare_state(model))  # before `init`, which takes their derivatives
    try:
        state = _given("init", model.init, params, start)
    except _Fault:
        if isinstance(model, Declared) and isinstance(model, HybridModel):
            _called_by_init(model, params, _bare_state(model))
        raise
    if not dataclasses.is_dataclass(state):
        raise _returns("init", type(state).__name__, "a frozen dataclass")
    if isinstance(model, Declared):
        _event_functions(model, params, state)
    rates: Mapping[str, Any] = {}
    if isinstance(model, HybridModel):  # before `jump`, which may read the rates
        rates = _given("flow", model.flow, params, state)
        _rates(state, rates)
    if isinstance(model, Declared):
        _jump_functions(model, params, state)
    events = _events(model, params, state)
    _alike("jump", state, _given("jump", model.jump, params, state, events))
    if isinstance(model, HybridModel):
        _moved_or_jumped(model, params, state, events, rates)
    _scalar("section", _given("section", model.section, params, state, events))
    _scalar("failed", _given("failed", model.failed, params, state))
    _scalar("period", period := _given("period", model.period, params))
    if (kind := _kind(period)) != "real numbers":  # a time limit of its type would be rounded
        raise _returns("period", kind, "a real number of seconds: 3.0, not 3")
    observed = _given("observe", model.observe, params, state)
    _named("observe", observed, "observables", (quantity.name for quantity in model.observables))
    signals = _given("signal", model.signal, params, state)
    _named("signal", signals, "signals", (quantity.name for quantity in model.signals))
    labels = _given("label", model.label, params, observed)
    fields = ("gait", *(quantity.name for quantity in model.label_fields))
    _named("label", labels, "gait and label fields", fields)
    if (kind := _kind(labels["gait"])) not in ("whole numbers", "booleans"):
        raise _returns("label", f"the gait as {kind}", "the index of a gait, a whole number")


def _bare_state(model: Declared) -> Any:
    """A state with the declared fields of a model; fields added by `init` are empty."""
    fields: dict[str, Any] = {}
    for field in dataclasses.fields(model.State):
        declared = model.declarations.get(field.name)
        if isinstance(declared, Mode):
            fields[field.name] = jnp.broadcast_to(jnp.asarray(declared.start), declared.shape(model))
        else:
            fields[field.name] = jnp.zeros(declared.shape(model) if isinstance(declared, Variable) else 0)
    return model.State(**fields)


def _event_functions(model: Declared, params: Any, state: Any) -> None:
    """Refuse event functions that do not return one real number, by the events' names."""
    for event in model.declared_events():
        name = f"for the event {event.name!r}"
        result = _given(name, lambda p, s, event=event: event.function(model, p, s), params, state)
        _shaped(name, result, event.counted.shape(model))
        if (kind := _kind(result)) != "real numbers":
            required = "a real number that rises through zero: s.x - 2.0, not s.x > 2.0"
            raise _returns(name, kind, required)
        conditions = {"during": (event.during, (state,)), "when": (event.when, (params, state))}
        for which, (condition, arguments) in conditions.items():
            if condition is None:
                continue
            name = f"{which}= of the event {event.name!r}"
            result = _given(name, condition, *arguments)
            if _kind(result) != "booleans" or jnp.shape(result) not in ((), event.counted.shape(model)):
                raise _returns(name, f"{_kind(result)} {jnp.shape(result)}", "a condition, such as s.x > 0.0")


def _called_by_init(model: Any, params: Any, state: Any) -> None:
    """Refuse a flow or a jump that fails at a bare state, so that `init` is not blamed for it."""
    added = {field.name for field in dataclasses.fields(state)} - set(model.declarations) - {ARMING, STEPS}
    if added:  # they are empty here, and a flow may read them
        return
    _rates(state, _given("flow", model.flow, params, state))
    _jump_functions(model, params, state)


def _jump_functions(model: Declared, params: Any, state: Any) -> None:
    """Refuse jumps of events that do not return a state, by the events' names."""
    for event in model.declared_events():
        if event.effect is None:
            continue
        name, single = f"for the jump of {event.name!r}", event.singles(model)[0]
        after = _given(name, lambda p, s, single=single: single.jumped(model, p, s), params, state)
        if not isinstance(after, type(state)):
            raise _returns(name, _type_of(after), "a state, such as s.replace(...)")


def _events(model: Model, params: Any, state: Any) -> jax.ShapeDtypeStruct:
    """The shape of the flags of events."""
    if isinstance(model, HybridModel):
        name, result = "guards", _given("guards", model.guards, params, state)
    else:
        assert isinstance(model, FixedStepDynamics)
        if isinstance(model, MapModel):
            _image(state, _given("image", model.image, params, state))
        after = _given("step", model.step, params, state, _NUMBER)
        _alike("step", state, after)
        name, result = "events", _given("events", model.events, params, state, after)
    if getattr(result, "ndim", None) != 1:
        shape = getattr(result, "shape", type(result).__name__)
        raise _returns(name, shape, "one number for each event, (n,): use jnp.stack")
    if isinstance(model, HybridModel):
        if _kind(result) != "real numbers":
            raise _returns("guards", _kind(result), "real numbers")
        names = model.guard_names
        if not isinstance(names, tuple) or not all(isinstance(guard_name, str) for guard_name in names):
            raise _returns("guard_names", repr(names), "a tuple of texts")
        if names and len(names) != result.shape[0]:
            count = result.shape[0]
            raise _Fault(f"guard_names returns {len(names)} names, but guards returns {count} numbers.")
    return jax.ShapeDtypeStruct(result.shape, bool)


def _given(name: str, function: Callable[..., Any], *args: Any) -> Any:
    """The shapes of a function's results, traced for arguments of these shapes."""
    try:
        with warnings.catch_warnings():
            # complex numbers have a message of their own
            warnings.simplefilter("ignore", np.exceptions.ComplexWarning)
            return jax.make_jaxpr(function, return_shape=True)(*args)[1]
    except Exception as error:  # a user's function may raise anything
        reason = (str(error).splitlines() or [""])[0]
        advice = ""
        if isinstance(error, jax.errors.ConcretizationTypeError | jax.errors.TracerArrayConversionError):
            advice = " Use jnp.where instead of if, and jnp instead of math and numpy."
        raise _Fault(f"{name} raises {type(error).__name__}: {reason.rstrip('.')}.{advice}") from error


def _image(state: Any, image: Any) -> None:
    """Refuse an image that is no mapping from fields of a state, or a mapping from others."""
    if not isinstance(image, Mapping):
        raise _returns("image", _type_of(image), "a mapping from variables to their values in the image")
    fields = list(vars(state))
    for name in image:
        if name not in fields:
            near = near_miss.suggestion(str(name), fields)
            raise _Fault(f"image returns a value of {name}, which is not a field of its state{near}")


def _rates(state: Any, rates: Any) -> None:
    fields = list(vars(state))
    if not isinstance(rates, Mapping):
        raise _returns("flow", _type_of(rates), "a mapping from fields of the state to rates")
    for name, rate in rates.items():
        if name not in fields:
            near = near_miss.suggestion(str(name), _continuous(state))
            raise _Fault(f"flow returns a rate of {name}, which is not a field of its state{near}")
        if name not in _continuous(state):
            raise _Fault(f"flow returns a rate of {name}, which is a mode: only jump can change it.")
        shape = jnp.shape(getattr(state, name))
        if rate.shape not in (shape, ()):
            other = f"shape {rate.shape}, but the field has shape {shape}"
            raise _Fault(f"flow returns a rate of {name} with {other}.")
        if (kind := _kind(rate)) != "real numbers":
            zero = ": write 1.0 instead of 1" if kind == "whole numbers" else ""
            raise _returns("flow", f"the rate of {name} as {kind}", f"real numbers{zero}")
        if rate.dtype.itemsize < (own := jnp.result_type(getattr(state, name))).itemsize:
            raise _Fault(f"flow returns the rate of {name} in {rate.dtype}, but the field is in {own}.")


def _moved_or_jumped(model: Model, params: Any, state: Any, events: Any, rates: Mapping[str, Any]) -> None:
    """Refuse a declared variable without a rate that no jump changes: its rate was forgotten."""
    declared = model.declarations.items() if isinstance(model, Declared) else ()
    still = [
        name for name, declaration in declared if isinstance(declaration, Variable) and name not in rates
    ]
    if not still:
        return
    # a scalar program has one node for equal values
    tracer, before = Tracer(Program()), (params, state, events)
    inputs = jax.tree.unflatten(jax.tree.structure(before), tracer.inputs(before, 0, steady=False))
    try:
        nodes = tracer.read(jax.make_jaxpr(model.jump)(*before), jax.tree.leaves(inputs))
    except UnsupportedError:
        return
    after = jax.tree.unflatten(jax.tree.structure(state), nodes)
    for name in still:
        if np.array_equal(getattr(inputs[1], name), getattr(after, name)):
            constant = "return its rate, or 0.0 if it is constant"
            raise _Fault(f"flow returns no rate of {name}, and no jump changes it: {constant}.")


@cached_by_content(maxsize=64)
def idle_starts(model: Model) -> tuple[str, ...]:
    """The names of starts on which the state at t = 0 does not depend; of a model with a body, none."""
    if model.host_parameters:
        return ()
    return tuple(stored("idle_starts", model, (), lambda: _idle_starts(model)))


def _idle_starts(model: Model) -> list[str]:
    quantities = (model.parameters, model.initial_conditions)
    given = tuple({quantity.name: _NUMBER for quantity in some} for some in quantities)

    def begun(values: Any, start: Any) -> Any:
        return model.init(model.params(values), start)

    tracer = Tracer(Program())
    inputs = tracer.inputs(given, 0, steady=False)
    starts = jax.tree.unflatten(jax.tree.structure(given), inputs)[1]
    try:
        state = tracer.read(jax.make_jaxpr(begun)(*given), inputs)
    except UnsupportedError:
        read = frozenset[str]().union(*dependences(begun, *given))
        return [name for name in starts if name not in read]
    needed = set(tracer.program.needed(node for leaf in state for node in leaf.ravel().tolist()))
    return [name for name, node in starts.items() if int(node) not in needed]


def sets_starts(model: Model) -> str:
    """The function that sets the starts in `idle_starts`."""
    own = isinstance(model, DeclaredModel) and type(model).complete is not DeclaredModel.complete
    return "complete" if own else "init"


def _kind(array: Any) -> str:
    """The kind of numbers of an array."""
    kinds = {"b": "booleans", "i": "whole numbers", "u": "whole numbers", "f": "real numbers"}
    return kinds.get(jnp.result_type(array).kind, "complex numbers")


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
        raise _returns(name, type(after).__name__, type(before).__name__)
    for (path, old), new in zip(jax.tree.leaves_with_path(before), jax.tree.leaves(after), strict=True):
        field = jax.tree_util.keystr(path).lstrip(".")
        for what, was, now in (("shape", old.shape, new.shape), ("type", old.dtype, new.dtype)):
            if was != now:
                returned = f"{field} with {what} {now}"
                raise _Fault(f"{name} returns {returned}, but init returns it with {what} {was}.")


def _scalar(name: str, value: Any) -> None:
    _shaped(name, value, ())


def _shaped(name: str, value: Any, shape: tuple[int, ...]) -> None:
    if getattr(value, "shape", None) != shape:
        required = f"{shape[0]} numbers, {shape}, as count= says" if shape else "one number, ()"
        raise _returns(name, getattr(value, "shape", type(value).__name__), required)


def _named(name: str, returned: Any, kind: str, required: Iterable[str]) -> None:
    names = list(returned) if isinstance(returned, Mapping) else []
    for wanted_name in required:
        if wanted_name not in names:
            outputs = ", ".join(map(str, names)) or "no names"
            raise _Fault(f"{name} does not return {wanted_name}, one of its {kind}; it returns {outputs}.")
        _scalar(f"{name}, {wanted_name},", returned[wanted_name])


def faults(kind: type[Model]) -> list[str]:
    """All faults of a model: of the shapes of its functions, and of their values at its defaults.

    Args:
        kind: the class; its structure has its defaults.

    Returns:
        Ends of sentences, as in `fault`; empty for a sound model.
    """
    if (unread := _unread_structure(kind)) is not None:
        return [unread]
    missing = [field.name for field in dataclasses.fields(kind) if _required(field)]  # pyright: ignore
    if missing:
        return [f"which has no default for {', '.join(missing)}, which the test needs."]
    try:
        model = kind()
        wrong = list(_of_quantities(model))
    except Exception as error:  # a user's class may raise anything
        return [f"which raises {type(error).__name__} when it is created: {str(error).rstrip('.')}."]
    if (first_fault := fault(model)) is not None:
        return list(dict.fromkeys([*wrong, _traced(model) or first_fault])) if wrong else [first_fault]
    try:
        return list(_by_value(model))
    except ExpressionError as error:
        return [f"which has a default without a value: {error}"]


def _unread_structure(kind: type[Model]) -> str | None:
    """Fields annotated as structure in a class that is not a dataclass, which so have no effect."""
    for base in kind.__mro__:
        if not issubclass(base, Model) or base.__module__.startswith("gaitsweep.contract"):
            continue
        own = vars(base).get("__dataclass_fields__", {})
        for name, hint in inspect.get_annotations(base).items():
            constant = get_origin(hint) is ClassVar or str(hint).startswith(("ClassVar", "typing.ClassVar"))
            if name not in own and not constant:
                return (
                    f"whose class {base.__name__} annotates {name} but is not a dataclass, so no job can set "
                    "it: write @dataclasses.dataclass(frozen=True) before the class."
                )
    return None


def _required(field: dataclasses.Field) -> bool:
    return field.default is dataclasses.MISSING and field.default_factory is dataclasses.MISSING


def _of_quantities(model: Model) -> Iterator[str]:
    """Faults of names, units, symbols, bounds, defaults and scales."""
    starts = {quantity.name for quantity in model.initial_conditions}
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
                must = "names must consist of letters, digits and underscores"
                yield f"whose {where} have the name {name!r}: {must}."
        for quantity in quantities:
            yield from _of_quantity(quantity, quantity.name in starts)
    if all(quantity.scale == math.inf and not quantity.circular for quantity in model.observables):
        yield "whose observables all have an infinite scale, so that each row would settle at once."
    hidden = {quantity.name for quantity in settable} & {quantity.name for quantity in model.signals}
    for name in sorted(hidden):
        hides = "has the name of a parameter or start and would hide it in a trace"
        yield f"whose signal {name} {hides}: rename it."
    if not model.gaits or len(set(model.gaits)) < len(model.gaits):
        yield f'whose gaits are {model.gaits}: there must be at least one name ("none"), without repetitions.'
    named = {
        "a gait": model.gaits,
        "an event": model.guard_names if isinstance(model, HybridModel) else (),
        "a limb": [limb.name for limb in model.limbs],
    }
    for what, names in named.items():
        for name in names:
            if isinstance(name, str) and not can_be_set(name):
                yield f"which has {what} named {name!r}, {_UNSET}"


def _of_quantity(quantity: Quantity, start: bool) -> Iterator[str]:
    texts = {"symbol": f"${quantity.symbol}$", "unit": quantity.unit, "meaning": quantity.meaning}
    for field, text in texts.items():
        if getattr(quantity, field) and not can_be_set(text):
            yield f"whose {quantity.name} has the {field} {getattr(quantity, field)!r}, {_UNSET}"
    yield from faults_of_quantity(quantity, start)


@dataclasses.dataclass(frozen=True)
class _Begun:
    """Evaluate a model's functions at starts; arrays (n, ...), those of states by their path.

    `rates` and `guards` are those of a model with a flow, `stepped` is the state of one without after 1e-6 s.
    `still` is the state after a jump, and `closes` whether a cycle ends, where no event has fired.
    """

    state: dict[str, Any]
    observed: Any
    signals: Any
    gait: Any
    period: Any
    fallen: Any
    rates: Any
    guards: Any
    stepped: Any
    still: dict[str, Any]
    closes: Any
    beyond: dict[str, Any]

    @property
    def own_state(self) -> dict[str, Any]:
        """The state less what arms its events, which is NaN where a guard is."""
        return {name: value for name, value in self.state.items() if not name.startswith(ARMING)}


def _by_path(tree: Any) -> dict[str, Any]:
    return {
        jax.tree_util.keystr(path).lstrip("."): leaf
        for path, leaf in jax.tree_util.tree_leaves_with_path(tree)
    }


@cached_by_content(maxsize=16)
def _begun(model: Model) -> Callable[[Any, Any], _Begun]:
    """`(values, starts) -> _Begun` of points."""

    def of_one(values: Any, start: Any) -> dict[str, Any]:
        params = model.params(values)
        state = model.init(params, start)
        observed = model.observe(params, state)
        rates = guards = stepped = None
        if isinstance(model, HybridModel):
            rates, guards = model.flow(params, state), model.guards(params, state)
            quiet = jnp.zeros(guards.shape, bool)
        else:
            assert isinstance(model, FixedStepDynamics)
            after = model.step(params, state, jnp.asarray(1e-6))
            stepped, quiet = _by_path(after), jnp.zeros(model.events(params, state, after).shape, bool)
        begun = _Begun(
            state=_by_path(state),
            observed=observed,
            signals=model.signal(params, state),
            gait=jnp.asarray(model.label(params, observed)["gait"], int),
            period=jnp.asarray(model.period(params), float),
            fallen=jnp.asarray(model.failed(params, state)),
            rates=rates,
            guards=guards,
            stepped=stepped,
            still=_by_path(model.jump(params, state, quiet)),
            closes=jnp.asarray(model.section(params, state, quiet)),
            beyond=model.beyond_at_start(params, state),
        )
        return vars(begun)

    of_rows = over_rows(of_one, "start", model)
    return lambda values, starts: _Begun(**of_rows(values, starts))


@cached_by_content(maxsize=16)
def _states(model: Model) -> Callable[[Any, Any], tuple[Any, Any]]:
    """`(values, starts) -> (params, state)` of points."""

    def of_one(values: Any, start: Any) -> tuple[Any, Any]:
        params = model.params(values)
        return params, model.init(params, start)

    return over_rows(of_one)


def _by_value(model: Model) -> Iterator[str]:
    """Faults at the defaults, then faults over the ranges of parameters and starts."""
    # a simulator has thousands of operations, and each set of its parameters is a body
    costly = model.host_parameters or not isinstance(model, HybridModel)
    values, starts = sample(model, _SAMPLE // 8 if costly else _SAMPLE)
    points = dict(model.on_host(values)), dict(starts)
    begun, known = _begun(model)(*points), {**values, **starts}
    default = _Begun(**jax.tree.map(lambda leaf: leaf[:1], vars(begun)))
    if bool(default.fallen[0]):
        yield "but its function failed returns True for its default start."
    if default.guards is not None:
        yield from _not_finite("guards", default.guards, lambda row: written(known, row))
    yield from _sound(default, lambda row: written(known, row))
    yield from _in_order(model, begun, points, lambda row: written(known, row))


def faults_of_rows(model: Model, values: Columns, starts: Columns, where: Where) -> list[str]:
    """Find faults as `faults` does, at parameters and starts (n,) of a job's rows.

    Args:
        model, values, starts: the rows; a model without `host_parameters`.
        where: function from the place of a row among these to words such as " at the start of row 3".

    Returns:
        Ends of sentences, as in `fault`.
    """
    points = dict(model.on_host(values)), dict(starts)
    at_starts = _begun(model)(*points)
    sentences = [*_sound(at_starts, where), *_in_order(model, at_starts, points, where)]
    if np.all(at_starts.fallen):
        sentences.append(f"but its function failed returns True{where(0)} and at all other starts tried.")
    has_guards = True if at_starts.guards is None else ~np.any(np.isnan(at_starts.guards), axis=1)
    for name, beyond in at_starts.beyond.items():
        if (row := _first_row(beyond & has_guards)) is not None:
            sentences.append(
                f"which begins on or beyond the surface of its event {name!r}{where(row)}: "
                "the event occurs only after its function has been below zero."
            )
    return sentences


def _sound(at_starts: _Begun, where: Where) -> Iterator[str]:
    """Faults of starts: numbers that are not finite, and changes although no event has fired."""
    numbers = {
        "init": at_starts.own_state,
        "observe": at_starts.observed,
        "signal": at_starts.signals,
        "flow": at_starts.rates,
        "step": at_starts.stepped,
    }
    for name, values in numbers.items():
        yield from _not_finite(name, values, where)
    for field, old in at_starts.state.items():
        new = at_starts.still[field]
        row = _first_row((np.asarray(old) != new) & ~(np.isnan(old) & np.isnan(new)))
        if row is not None:
            text = f"but its function jump changes {field} although no event has fired{where(row)}"
            yield f"{text}: use jnp.where(fired[i], ...)."
    if (row := _first_row(at_starts.closes)) is not None:
        yield f"but its function section closes a cycle although no event has fired{where(row)}."


def _in_order(model: Model, at_starts: _Begun, points: tuple[Any, Any], where: Where) -> Iterator[str]:
    """Faults of periods, labels and events at any start."""
    period, gait = at_starts.period, at_starts.gait
    if (row := _first_row(~((period > 0.0) & (period < math.inf)))) is not None:
        result = f"{period[row]:g}{where(row)}"
        yield f"but its function {_returns('period', result, 'seconds above 0')}"
    finite = np.all([np.isfinite(values) for values in at_starts.observed.values()], axis=0)
    if (row := _first_row(finite & ~((gait >= 0) & (gait < len(model.gaits))))) is not None:
        index = f"the index of a gait, 0 to {len(model.gaits) - 1}"
        yield f"but its function {_returns('label', f'gait {gait[row]}{where(row)}', index)}"
    if not isinstance(model, HybridModel):
        return
    guards = at_starts.guards
    assert guards is not None
    leaves = [np.reshape(leaf, (len(guards), -1)) for leaf in jax.tree.leaves(at_starts.own_state)]
    sound = np.all(np.concatenate([np.isfinite(np.asarray(leaf, float)) for leaf in leaves], axis=1), axis=1)
    if (row := _first_row(sound & np.any(np.isnan(guards), axis=1))) is not None:
        name = _guard(model, int(np.argmax(np.isnan(guards[row]))))
        yield f"but its function guards returns NaN for {name}{where(row)}, so this event never occurs."
    if model.simultaneous == "independent":
        dependent = _dependent(model, *_states(model)(*points))
        for i, j in np.argwhere(np.any(dependent, axis=0)).tolist():
            at = where(int(np.argmax(dependent[:, i, j])))
            events = f"the events {_guard(model, i)} and {_guard(model, j)}"
            differ = f"{events} lead to different states in two jumps and in one{at}"
            yield f'whose simultaneous is "independent", but {differ}: remove it.'
    # an armed event cannot fire twice without leaving its surface
    armed = isinstance(model, Declared) and all(event.rising for event in model.declared_events())
    if armed or not np.any(guards >= 0.0):
        return
    fires = _without_end(model, *_states(model)(*points))
    for guard in np.flatnonzero(np.any(fires, axis=0)).tolist():
        at = where(int(np.argmax(fires[:, guard])))
        yield f"whose event {_guard(model, guard)} is not ended by its jump and so occurs without end{at}."


def _guard(model: HybridModel, guard: int) -> str:
    return repr(model.guard_names[guard]) if model.guard_names else f"guard {guard + 1}"


def _dependent(model: HybridModel, params: Any, state: Any) -> Bool[np.ndarray, "starts guards guards"]:
    """Whether two guards, the first before the second, need their turns (starts, guards, guards)."""
    count = model.guards(*jax.tree.map(lambda leaf: leaf[0], (params, state))).size
    one = jnp.eye(count, dtype=bool)

    def of_pair(params: Any, state: Any, i: Int[Array, ""], j: Int[Array, ""]) -> Bool[Array, ""]:
        at_once = model.jump(params, state, one[i] | one[j])
        in_turn = model.jump(params, model.jump(params, state, one[i]), one[j])
        off = [
            ~jnp.isclose(a, b, rtol=1e-9, atol=1e-12, equal_nan=True)
            for a, b in zip(jax.tree.leaves(at_once), jax.tree.leaves(in_turn), strict=True)
        ]
        return (i < j) & jnp.any(jnp.concatenate([jnp.ravel(difference) for difference in off]))

    pairs = jnp.repeat(jnp.arange(count), count), jnp.tile(jnp.arange(count), count)
    over_pairs = jax.vmap(of_pair, (None, None, 0, 0))
    dependent = jax.jit(jax.vmap(lambda p, s: over_pairs(p, s, *pairs)))(params, state)
    return np.asarray(dependent).reshape(-1, count, count)


def _without_end(model: HybridModel, params: Any, state: Any) -> Bool[np.ndarray, "starts guards"]:
    """Whether each guard fires at each of `_JUMPS` jumps that follow each other at once (starts, guards)."""

    def of_one(params: Any, state: Any) -> Bool[Array, " guards"]:
        def jump(_: int, carry: Any) -> Any:
            state, fires = carry
            fired = model.guards(params, state) >= 0.0
            return model.jump(params, state, fired), fires & fired

        always = jnp.ones(model.guards(params, state).shape, bool)
        return jax.lax.fori_loop(0, _JUMPS, jump, (state, always))[1]

    return np.asarray(jax.jit(jax.vmap(of_one))(params, state))


def sample(model: Model, n: int) -> tuple[Columns, Columns]:
    """Parameters and starts (n,) by name: the defaults, then random points over their ranges.

    A range is that between a quantity's bounds. Where these are far apart or missing, a parameter goes from
    half to twice its default, and a start by three times its default (by 3 where that is 0) to both sides.

    Raises:
        ExpressionError: a default has no value.
    """
    random = np.random.default_rng(0)
    sizes: dict[str, Any] = {
        field.name: float(size)
        for field in dataclasses.fields(model)  # pyright: ignore[reportArgumentType]
        if isinstance(size := getattr(model, field.name), int | float)
    }

    def drawn(quantities: Sequence[Quantity], numbers_before: Mapping[str, Any], start: bool) -> Columns:
        formulas = {q.name: q.default for q in quantities if isinstance(q.default, str)}
        numbers = {q.name: _spread(random, n, q, start) for q in quantities if q.name not in formulas}
        resolved = resolve(formulas, {**numbers_before, **numbers})
        return {q.name: np.broadcast_to(np.asarray(resolved[q.name], float), (n,)) for q in quantities}

    parameters = drawn(model.parameters, sizes, False)
    return parameters, drawn(model.initial_conditions, {**sizes, **parameters}, True)


def _spread(
    random: np.random.Generator, n: int, quantity: Quantity, start: bool
) -> Float[np.ndarray, " rows"]:
    """The default of a quantity, then n - 1 random values in its range."""
    default = _middle(quantity)
    if math.isnan(default) or quantity.whole:  # a start that the model itself decides, or a mode
        return np.full(n, default)
    reach = 3.0 * (abs(default) or 1.0)
    low, high = (default - reach, default + reach) if start else sorted((0.5 * default, 2.0 * default))
    if quantity.high - quantity.low < _WIDE * reach:
        low, high = quantity.low, quantity.high
    within = random.uniform(max(low, quantity.low), min(high, quantity.high), n - 1)
    return np.append(default, within)


def written(values: Columns, row: int) -> str:
    """The values of a row that differ from the first: " at w = 2, x_0 = 2.4"; the first has the defaults."""
    differ = [f"{name} = {column[row]:.6g}" for name, column in values.items() if column[row] != column[0]]
    if not differ:
        return " at the model's defaults"
    return " at " + ", ".join(differ[:NAMED]) + (", ..." if len(differ) > NAMED else "")


def _middle(quantity: Quantity) -> float:
    """The default of a quantity that is a number; near 1 in its bounds where it has none."""
    assert not isinstance(quantity.default, str)
    return float(np.clip(1.0, quantity.low, quantity.high) if quantity.default is None else quantity.default)


def _not_finite(name: str, tree: Any, where: Where) -> Iterator[str]:
    for path, leaf in jax.tree.leaves_with_path(tree):
        numbers = np.asarray(leaf, float)
        if (row := _first_row(~np.isfinite(numbers))) is not None:
            field = jax.tree_util.keystr(path).strip(".[]'")
            for_field = f" for {field}" if field else ""
            yield f"but its function {name} returns {numbers[row]}{for_field}{where(row)}."


def _first_row(flags: Bool[np.ndarray, "rows ..."]) -> int | None:
    """The first row of flags (n, ...) of which one is set; None if none is."""
    rows = np.flatnonzero(np.any(np.reshape(flags, (len(flags), -1)), axis=1))
    return int(rows[0]) if rows.size else None
