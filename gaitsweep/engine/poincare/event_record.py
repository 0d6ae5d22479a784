"""The events of one return to the section: when each takes place, by a model that counts its own jumps."""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Callable
from typing import Any, TypeAlias

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from gaitsweep.contract import HybridModel, Params, Rates, State
from gaitsweep.engine.numerics import ResolvedNumerics
from gaitsweep.engine.poincare.poincare_return import crossing_of

# Events of one guard between two crossings that have a time.
MAX_TIMED_EVENTS = 3
# The fields with which a state keeps the record: the time (s), and for each guard the times of its first
# events and their number.
FIELDS = ("event_clock", "event_times", "event_counts")

# The times (MAX_TIMED_EVENTS, guards) in s, NaN where there was none, and the number of each guard's events.
EventRecord: TypeAlias = "tuple[Float[Array, 'most guards'], Int[Array, ' guards']]"


def recorded_return(
    model: HybridModel, numerics: ResolvedNumerics, engine: str
) -> Callable[[Params, State], EventRecord]:
    """The function `(params, state) -> EventRecord` of the return from a state, in JAX.

    Args:
        model: the model.
        numerics: the method and its tolerances.
        engine: as for `crossing_of`.
    """

    def one(params: Params, state: State) -> EventRecord:
        guards = jax.eval_shape(model.guards, params, state).shape
        kind = _with_record(type(state))

        def with_record(plain: State, *record: Array) -> State:
            fields = {field.name: getattr(plain, field.name) for field in dataclasses.fields(state)}
            return kind(**fields, **dict(zip(FIELDS, record, strict=True)))

        def flow(params: Params, state: State) -> Rates:
            return {**model.flow(params, state), FIELDS[0]: jnp.ones(())}

        def jump(params: Params, before: State, fired: Bool[Array, " guards"]) -> State:
            clock, times, counts = (getattr(before, name) for name in FIELDS)
            happened = model.occurred(params, before, fired)
            place = jnp.arange(MAX_TIMED_EVENTS)[:, None] == counts[None]
            times = jnp.where(happened[None] & place, clock, times)
            after = model.jump(params, before, fired)
            return with_record(after, clock, times, counts + happened.astype(counts.dtype))

        recording = copy.copy(model)
        vars(recording).update(flow=flow, jump=jump)
        crossing = crossing_of.__wrapped__(recording, numerics, engine)  # type: ignore[attr-defined]
        empty = jnp.zeros(()), jnp.zeros((MAX_TIMED_EVENTS, *guards)), jnp.zeros(guards, jnp.int32)
        _, end, _ = crossing(params, with_record(state, *empty))
        _, times, counts = (getattr(end, name) for name in FIELDS)
        return jnp.where(jnp.arange(MAX_TIMED_EVENTS)[:, None] < counts[None], times, jnp.nan), counts

    return one


def _with_record(state: type) -> type:
    """The type of states with the fields of the record."""
    more: list[Any] = [(name, Any) for name in FIELDS]
    kind = dataclasses.make_dataclass(state.__name__, more, bases=(state,), frozen=True)
    names = [field.name for field in dataclasses.fields(kind)]
    return jax.tree_util.register_dataclass(kind, names, [])
