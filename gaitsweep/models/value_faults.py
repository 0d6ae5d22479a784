"""Faults of a model's values: at its defaults, over the ranges of its quantities, or at the rows of a job."""

from __future__ import annotations

import builtins
import dataclasses
import inspect
import math
from collections.abc import Callable, Iterator, Mapping
from typing import Any, ClassVar, get_origin

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, Shaped

from gaitsweep.contract import FixedStepDynamics, HybridModel, Model
from gaitsweep.dynamics.declared import Declared
from gaitsweep.dynamics.declared_model import ARMING
from gaitsweep.engine.content import cached_by_content
from gaitsweep.engine.kernel.row_functions import over_rows
from gaitsweep.expression import ExpressionError
from gaitsweep.models.conformity import fault, quantity_faults, traced_fault
from gaitsweep.models.sampled_points import Columns, fields_of, sampled_points, written

# Points over the ranges of parameters and starts at which functions are evaluated.
_SAMPLE_POINTS = 64
# Repeated jumps at one instant after which a guard that fires each time is taken to fire without end.
_REPEATED_JUMPS = 16

_AnyArray = np.ndarray | Array
_Values = Mapping[str, Shaped[_AnyArray, "..."]]
Where = Callable[[int], str]  # words that say at which of some points something is


def faults(model_class: type[Model]) -> list[str]:
    """All faults of a model: of the shapes of its functions, and of their values at its defaults.

    Args:
        model_class: the class; its structure has its defaults.

    Returns:
        Ends of sentences, as in `fault`; empty for a sound model.
    """
    if (unread := _unread_structure(model_class)) is not None:
        return [unread]
    missing = [field.name for field in fields_of(model_class) if _has_no_default(field)]
    if missing:
        return [f"which has no default for {', '.join(missing)}, which the test needs."]
    try:
        model = model_class()
        faults_of_quantities = list(quantity_faults(model))
    except Exception as error:  # a user's class may raise anything
        return [f"which raises {type(error).__name__} when it is created: {str(error).rstrip('.')}."]
    if (first_fault := fault(model)) is not None:
        if not faults_of_quantities:
            return [first_fault]
        # the first is one of the quantities, and hides that of the functions
        return list(dict.fromkeys([*faults_of_quantities, traced_fault(model) or first_fault]))
    try:
        return list(_value_faults(model))
    except ExpressionError as error:
        return [f"which has a default without a value: {error}"]


def _unread_structure(model_class: type[Model]) -> str | None:
    """The fault of a class that annotates fields of structure but is not a dataclass, or None."""
    for base in model_class.__mro__:
        if not issubclass(base, Model) or base.__module__.startswith("gaitsweep.contract"):
            continue
        own = vars(base).get("__dataclass_fields__", {})
        for name, hint in inspect.get_annotations(base).items():
            keyword_only_mark = "KW_ONLY" in str(hint)  # `_: dataclasses.KW_ONLY`, which is no field
            if name not in own and not keyword_only_mark and not _is_class_variable(base, hint):
                return (
                    f"whose class {base.__name__} annotates {name} but is not a dataclass, so no job can set "
                    "it: write @dataclasses.dataclass(frozen=True) before the class."
                )
    return None


def _is_class_variable(base: type[Model], hint: Any) -> bool:
    """Whether an annotation of a class is ClassVar, also as a text, and under another name of typing."""
    if isinstance(hint, str):
        namespace = {**vars(inspect.getmodule(base) or builtins), **vars(base)}
        outer, *attributes = hint.partition("[")[0].strip().split(".")
        hint = namespace.get(outer)
        for attribute in attributes:
            hint = getattr(hint, attribute, None)
    return hint is ClassVar or get_origin(hint) is ClassVar


def _has_no_default(field: dataclasses.Field[Any]) -> bool:
    """Whether a field of a dataclass has to be given."""
    return field.default is dataclasses.MISSING and field.default_factory is dataclasses.MISSING


@dataclasses.dataclass(frozen=True)
class _AtStarts:
    """Values of a model's functions at starts; arrays (n, ...), those of states by their path.

    `rates` and `guards` are those of a model with a flow, `stepped` is the state of one without after 1e-6 s.
    `still` is the state after a jump, and `closes` whether a cycle ends, where no event has fired.
    """

    state: _Values
    observed: _Values
    signals: _Values
    gait: Int[_AnyArray, "*rows"]
    period: Float[_AnyArray, "*rows"]
    fallen: Bool[_AnyArray, "*rows"]
    rates: _Values | None
    guards: Float[_AnyArray, "*rows guards"] | None
    stepped: _Values | None
    still: _Values
    closes: Bool[_AnyArray, "*rows"]
    beyond: _Values
    without: _Values

    @property
    def own_state(self) -> _Values:
        """The state less what arms its events, which is NaN where a guard is."""
        return {name: value for name, value in self.state.items() if not name.startswith(f"{ARMING}.")}


def _by_path(tree: Any) -> dict[str, Any]:
    """The leaves of a tree by their path in it."""
    return {
        jax.tree_util.keystr(path).lstrip("."): leaf
        for path, leaf in jax.tree_util.tree_leaves_with_path(tree)
    }


@cached_by_content(maxsize=16)
def _at_starts_of(model: Model) -> Callable[[Any, Any], _AtStarts]:
    """`(values, starts) -> _AtStarts` of points."""

    def of_one(values: Any, start: Any) -> dict[str, Any]:
        params = model.params(values)
        state = model.init(params, start)
        observed = model.observe(params, state)
        rates = guards = stepped = None
        if isinstance(model, HybridModel):
            rates = model.flow(params, state)
            guards = model.guards(params, state)
            quiet = jnp.zeros(guards.shape, bool)
        else:
            assert isinstance(model, FixedStepDynamics)
            factor = (jnp.ones(()),) if model.stochastic else ()
            after = model.step(params, state, jnp.asarray(1e-6), *factor)
            stepped = _by_path(after)
            quiet = jnp.zeros(model.events(params, state, after).shape, bool)
        return {
            "state": _by_path(state),
            "observed": observed,
            "signals": model.signal(params, state),
            "gait": jnp.asarray(model.label(params, observed)["gait"], int),
            "period": jnp.asarray(model.period(params), float),
            "fallen": jnp.asarray(model.failed(params, state)),
            "rates": rates,
            "guards": guards,
            "stepped": stepped,
            "still": _by_path(model.jump(params, state, quiet)),
            "closes": jnp.asarray(model.section(params, state, quiet)),
            "beyond": model.beyond_at_start(params, state),
            "without": model.without_start(params, state),
        }

    of_rows = over_rows(of_one, "values at start", model)
    return lambda values, starts: _AtStarts(**of_rows(values, starts))


@cached_by_content(maxsize=16)
def _states(model: Model) -> Callable[[Any, Any], tuple[Any, Any]]:
    """`(values, starts) -> (params, state)` of points."""

    def of_one(values: Any, start: Any) -> tuple[Any, Any]:
        params = model.params(values)
        return params, model.init(params, start)

    return over_rows(of_one)


def _value_faults(model: Model) -> Iterator[str]:
    """Faults at the defaults, then faults over the ranges of parameters and starts."""
    # a simulator has thousands of operations, and each set of its parameters is a body
    costly = model.host_parameters or not isinstance(model, HybridModel)
    values, starts = sampled_points(model, _SAMPLE_POINTS // 8 if costly else _SAMPLE_POINTS)
    points = dict(model.on_host(values)), dict(starts)
    begun = _at_starts_of(model)(*points)
    known = {**starts, **values}  # starts are at fault more often, and a sentence names only the first values
    default = _AtStarts(**jax.tree.map(lambda leaf: leaf[:1], vars(begun)))
    if bool(default.fallen[0]):
        yield "but its function failed returns True for its default start."
    if default.guards is not None:
        yield from _non_finite_faults("guards", default.guards, lambda row: written(known, row))
    yield from _start_faults(model, default, lambda row: written(known, row))
    yield from _range_faults(model, begun, points, lambda row: written(known, row))


def faults_of_rows(model: Model, values: Columns, starts: Columns, where: Where) -> list[str]:
    """Find faults as `faults` does, at parameters and starts (n,) of a job's rows.

    Args:
        model, values, starts: the rows; a model without `host_parameters`.
        where: function from the place of a row among these to words such as " at the start of row 3".

    Returns:
        Ends of sentences, as in `fault`.
    """
    points = dict(model.on_host(values)), dict(starts)
    at_starts = _at_starts_of(model)(*points)
    sentences = [*_start_faults(model, at_starts, where), *_range_faults(model, at_starts, points, where)]
    if np.all(at_starts.fallen):
        sentences.append(f"but its function failed returns True{where(0)} and at all other starts tried.")
    has_guards = at_starts.guards is None or ~np.any(np.isnan(at_starts.guards), axis=1)
    for name, beyond in at_starts.beyond.items():
        if (row := _first_row(beyond & has_guards)) is not None:
            value = surface_value(model, name, {**values, **starts}, row)
            is_value = "" if value is None else f", where its function is {value:.3g}"
            sentences.append(
                f"which begins on or beyond the surface of its event {name!r}{where(row)}{is_value}: "
                "the event occurs only after its function has been below 0."
            )
    return sentences


def surface_value(model: Model, name: str, values: Columns, row: int) -> float | None:
    """The function of the event `name` at the start of a row; None for events that are not declared.

    Args:
        model: a model without `host_parameters`.
        name: the name of the event.
        values: parameters and starts of the rows.
        row: the place of the row.
    """
    known = {key: np.asarray(column)[row : row + 1] for key, column in values.items()}
    height = _height(model.original, name)
    return None if height is None else float(height(known)[0])


@cached_by_content(maxsize=16)
def _height(model: Model, name: str) -> Callable[[Any], Any] | None:
    """The function of an event at starts, from parameters and starts (n,); None if it is not declared."""
    events = model.single_events() if isinstance(model, Declared) and not model.host_parameters else []
    event = next((event for event in events if event.name == name), None)
    if event is None:
        return None

    def of_one(known: Any) -> Any:
        params = model.params(known)
        return event.height(model, params, model.init(params, known))

    return over_rows(of_one, "height at start", model, name)


def _start_faults(model: Model, at_starts: _AtStarts, where: Where) -> Iterator[str]:
    """Faults of starts: numbers that are not finite, and changes although no event has fired."""
    has_start = np.ones(len(at_starts.closes), bool)
    for reason, lacks_start in at_starts.without.items():
        if (row := _first_row(lacks_start)) is not None:
            yield f"which cannot begin{where(row)}: {reason}."
        has_start &= ~np.asarray(lacks_start)
    rows = np.flatnonzero(has_start)  # the numbers of the others are NaN
    if rows.size:
        begun = _AtStarts(**jax.tree.map(lambda leaf: leaf[rows], vars(at_starts)))
        yield from _faults_of_begun(model, begun, lambda row: where(int(rows[row])))


def _faults_of_begun(model: Model, at_starts: _AtStarts, where: Where) -> Iterator[str]:
    """Faults of rows that have a start; arguments as of `_start_faults`."""
    without_value = {quantity.name for quantity in model.observables if quantity.may_be_nan}
    numbers = {
        "init": at_starts.own_state,
        "observe": {k: values for k, values in at_starts.observed.items() if k not in without_value},
        "signal": at_starts.signals,
        "flow": at_starts.rates,
        "step": at_starts.stepped,
    }
    for name, values in numbers.items():
        yield from _non_finite_faults(name, values, where)
    yield from _clock_faults(model, at_starts, where)
    for field, old in at_starts.own_state.items():  # which events are armed, no model decides
        new = at_starts.still[field]
        row = _first_row((np.asarray(old) != new) & ~(np.isnan(old) & np.isnan(new)))
        if row is not None:
            text = f"but its function jump changes {field} although no event has fired{where(row)}"
            yield f"{text}: use jnp.where(fired[i], ...)."
    if (row := _first_row(at_starts.closes)) is not None:
        yield f"but its function section closes a cycle although no event has fired{where(row)}."


def _clock_faults(model: Model, at_starts: _AtStarts, where: Where) -> Iterator[str]:
    """No rate, or one other than 1, of the clock of footfalls, whose strides it would scale."""
    feet = model.original.declarations.feet if isinstance(model.original, Declared) else None
    rates = at_starts.rates
    if feet is None or rates is None:
        return
    rate = np.asarray(rates.get(feet.clock, 1.0), float).reshape(-1)
    row = _first_row(np.isfinite(rate) & (rate != 1.0))
    if feet.clock not in rates or row is not None:
        wrong = "no rate" if row is None else f"the rate {rate[row]:g}"
        clock = f"{feet.clock}{'' if row is None else where(row)}, the clock of its footfalls"
        yield f"but its function flow returns {wrong} of {clock}: return 1.0."


def _range_faults(model: Model, at_starts: _AtStarts, points: tuple[Any, Any], where: Where) -> Iterator[str]:
    """Faults of periods, labels and events at any start."""
    period = at_starts.period
    gait = at_starts.gait
    if (row := _first_row(~((period > 0.0) & (period < math.inf)))) is not None:
        result = f"{period[row]:g}{where(row)}"
        yield f"but its function period returns {result}, but must return seconds above 0."
    finite = np.all([np.isfinite(values) for values in at_starts.observed.values()], axis=0)
    if (row := _first_row(finite & ~((gait >= 0) & (gait < len(model.gaits))))) is not None:
        result = f"gait {gait[row]}{where(row)}"
        last = len(model.gaits) - 1
        yield f"but its function label returns {result}, but must return the index of a gait, 0 to {last}."
    if not isinstance(model, HybridModel):
        return
    guards = at_starts.guards
    assert guards is not None
    leaves = [np.reshape(leaf, (len(guards), -1)) for leaf in jax.tree.leaves(at_starts.own_state)]
    sound = np.all(np.concatenate([np.isfinite(np.asarray(leaf, float)) for leaf in leaves], axis=1), axis=1)
    if (row := _first_row(sound & np.any(np.isnan(guards), axis=1))) is not None:
        name = _guard_name(model, int(np.argmax(np.isnan(guards[row]))))
        yield f"but its function guards returns NaN for {name}{where(row)}, so this event never occurs."
    if model.simultaneous == "independent":
        dependent = _dependent_guards(model, *_states(model)(*points))
        for i, j in np.argwhere(np.any(dependent, axis=0)).tolist():
            at = where(int(np.argmax(dependent[:, i, j])))
            events = f"the events {_guard_name(model, i)} and {_guard_name(model, j)}"
            differ = f"{events} lead to different states in two jumps and in one{at}"
            yield f'whose simultaneous is "independent", but {differ}: remove it.'
    # an armed event cannot fire twice without leaving its surface
    armed = isinstance(model, Declared) and all(event.rising for event in model.declarations.events)
    if armed or not np.any(guards >= 0.0):
        return
    fires = _endless_guards(model, *_states(model)(*points))
    for guard in np.flatnonzero(np.any(fires, axis=0)).tolist():
        at = where(int(np.argmax(fires[:, guard])))
        event = _guard_name(model, guard)
        yield f"whose event {event} is not ended by its jump and so occurs without end{at}."


def _guard_name(model: HybridModel, guard: int) -> str:
    """The name of a guard in quotes, or its number from 1."""
    return repr(model.guard_names[guard]) if model.guard_names else f"guard {guard + 1}"


def _dependent_guards(
    model: HybridModel, params: Any, state: Any
) -> Bool[np.ndarray, "starts guards guards"]:
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
        return jnp.any(jnp.concatenate([jnp.ravel(difference) for difference in off]))

    first, second = np.triu_indices(count, 1)
    over_pairs = jax.vmap(of_pair, (None, None, 0, 0))
    pairs = jnp.asarray(first), jnp.asarray(second)
    of_pairs = jax.jit(jax.vmap(lambda p, s: over_pairs(p, s, *pairs)))(params, state)
    dependent = np.zeros((len(of_pairs), count, count), bool)
    dependent[:, first, second] = of_pairs
    return dependent


def _endless_guards(model: HybridModel, params: Any, state: Any) -> Bool[np.ndarray, "starts guards"]:
    """Whether each guard fires at each of `_REPEATED_JUMPS` jumps that follow each other at once."""

    def of_one(params: Any, state: Any) -> Bool[Array, " guards"]:
        def jump(_: int, carry: Any) -> Any:
            state, fires = carry
            fired = model.guards(params, state) >= 0.0
            return model.jump(params, state, fired), fires & fired

        always = jnp.ones(model.guards(params, state).shape, bool)
        return jax.lax.fori_loop(0, _REPEATED_JUMPS, jump, (state, always))[1]

    return np.asarray(jax.jit(jax.vmap(of_one))(params, state))


def _non_finite_faults(name: str, tree: Any, where: Where) -> Iterator[str]:
    """Faults of results (n, ...) of a function that are not finite."""
    for path, leaf in jax.tree.leaves_with_path(tree):
        numbers = np.asarray(leaf, float)
        if (row := _first_row(~np.isfinite(numbers))) is not None:
            field = jax.tree_util.keystr(path).strip(".[]'")
            for_field = f" for {field}" if field else ""
            yield f"but its function {name} returns {numbers[row]}{for_field}{where(row)}."


def _first_row(flags: Bool[_AnyArray, "rows ..."]) -> int | None:
    """The first row of flags (n, ...) of which one is set; None if none is."""
    rows = np.flatnonzero(np.any(np.reshape(flags, (len(flags), -1)), axis=1))
    return int(rows[0]) if rows.size else None
