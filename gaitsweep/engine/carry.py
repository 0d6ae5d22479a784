"""The state of one trajectory's integration, with the types of its arrays and choices between its values.

Events that follow each other at one instant without end stall a row, whose time does not advance any more; a
recorder ends it as `Status.event_stall`.

All decisions along a trajectory are selects. A condition that is seldom or nearly always true is marked
(`unlikely`, `likely`): a kernel computes what depends on the exception only where there is one; XLA computes
everything.
"""

from __future__ import annotations

import dataclasses
import math
from typing import Any, TypeVar, cast

import jax
import jax.numpy as jnp
import numpy as np
from jax.ad_checkpoint import checkpoint_name
from jaxtyping import Array, Bool, Float, Int

from gaitsweep.contract import HybridModel, Model, Params, State

Number = Float[Array, ""]
Flag = Bool[Array, ""]
Integer = Int[Array, ""]
Guards = Float[Array, " guards"]  # one number for each guard of a model
GuardFlags = Bool[Array, " guards"]
Observed = Float[Array, " observables"]

T = TypeVar("T")  # a pytree

# Jumps at one instant beyond which a row is stalled, for each guard, and as many more: far above most
# physical chains of events.
JUMPS_PER_GUARD = 4
# Guards in one word of `LaneRecord.fired`: a slot of a kernel is a float64, which has 53 bits.
GUARDS_PER_WORD = 32
# The usual value of a marked condition, by the name of its mark.
USUAL = {"gaitsweep.unlikely": False, "gaitsweep.likely": True}


class Halt:
    """Whether a trajectory goes on (GOING), or else why it waits for its recorder.

    It does not move until the recorder has polled it, so no crossing is lost and none has to be copied.
    """

    GOING, CROSSING, TIME, FINISHED, FELL = range(5)


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Carry:
    """The state of a trajectory's integration.

    Attributes:
        state: the state.
        t: the time (s).
        h: the next step (s).
        h_max: the upper bound of `h` (s), which grows after an event.
        near: the guards at the state.
        far: the shortest step known to fire (s); infinite unless an event is being located.
        far_guards: the guards there; at an instant with jumps >= 0 for all guards that have fired, and
            infinite for those that wait for their jump.
        weight: the Illinois weight of the end of the bracket that was kept: above zero the near end, below
            zero the far end.
        trials: the attempts to locate this event.
        chain: the jumps at this instant.
        attempts: the total number of attempts.
        closed: whether the section was crossed at this instant, before other guards that wait for their jump.
        shift: the time (s) of the events of these guards after that crossing: zero, but for its derivative.
        stop: the time (s) at which to halt.
        halt: whether the trajectory goes on, or why it waits, one of `Halt`.
        dt: the longest step (s), a constant of the trajectory.
        step_factor: the factor on that step, by which tolerances are finer as well; a constant.
        unit: the nominal period (s), the unit of the tolerance on event times; a constant.
        tangents: derivatives along some directions, a list of `tangents.Tangent`, if they are followed.
    """

    state: State
    t: Number
    h: Number
    h_max: Number
    near: Guards
    far: Number
    far_guards: Guards
    weight: Number
    trials: Integer
    chain: Integer
    attempts: Integer
    closed: Flag
    shift: Number
    stop: Number
    halt: Integer
    dt: Number
    step_factor: Number
    unit: Number
    tangents: Any = ()


def start(
    model: Model,
    params: Params,
    state: State,
    *,
    dt: Number | float,
    stop: Number | float = math.inf,
    step_factor: Number | float = 1.0,
) -> Carry:
    """A trajectory at t = 0; the first attempt of a hybrid model has zero length and fires guards >= 0 there.

    Args:
        model: the model.
        params: its parameters.
        state: its initial state.
        dt: its longest step (s), with the factor `step_factor` applied.
        stop: the time (s) at which to halt.
        step_factor: see `Carry`.
    """
    # the step of a stepped model is not shortened, since no event is located
    near = model.guards(params, state) if isinstance(model, HybridModel) else jnp.zeros((0,), jnp.float64)
    zero = jnp.zeros((), near.dtype)
    count = jnp.zeros((), jnp.int32)
    # a tolerance in time does not depend on the parameters as the trajectory does
    unit = jax.lax.stop_gradient(model.period(params))
    return Carry(
        state=state,
        t=zero,
        h=zero,
        h_max=zero,
        near=near,
        far=zero + jnp.inf,
        far_guards=jnp.where(near >= 0.0, jnp.inf, near),
        weight=zero + 1.0,
        trials=count,
        chain=count,
        attempts=jnp.zeros((), jnp.int64),
        closed=jnp.zeros((), bool),
        shift=zero,
        stop=zero + stop,
        halt=count,
        dt=zero + dt,
        step_factor=zero + step_factor,
        unit=zero + unit,
    )


def select(condition: Flag, yes: T, no: T) -> T:
    """The leaves of one of two pytrees of the same structure.

    Args:
        condition: whether they are those of `yes`.
        yes: a pytree.
        no: a pytree.
    """
    return jax.tree.map(lambda a, b: jnp.where(condition, a, b), yes, no)


def unlikely(condition: Flag) -> Flag:
    """The condition itself, marked as seldom true."""
    return cast(jax.Array, checkpoint_name(condition, "gaitsweep.unlikely"))


def likely(condition: Flag) -> Flag:
    """The condition itself, marked as nearly always true."""
    return cast(jax.Array, checkpoint_name(condition, "gaitsweep.likely"))


def restarted(carry: Carry, now: Flag) -> Carry:
    """The trajectory whose state or parameters have changed at its present time if `now`.

    The change may fire a guard where the trajectory stands, so it begins as a start does, by an attempt of
    zero length; an event that was being located is forgotten, and so are the guards that fired last.
    """
    return dataclasses.replace(
        carry,
        h=jnp.where(now, 0.0, carry.h),
        far=jnp.where(now, jnp.inf, carry.far),
        far_guards=jnp.where(now, -1.0, carry.far_guards),
    )


def longest_chain(model: Model, guards: Guards) -> int:
    """The most jumps at one instant before a row is stalled (`HybridModel.longest_chain`)."""
    longest = model.longest_chain if isinstance(model, HybridModel) else None
    return JUMPS_PER_GUARD * (guards.size + 1) if longest is None else longest


def is_stalled(model: Model, carry: Carry) -> Flag:
    """Whether a trajectory has made more jumps at one instant than `longest_chain` allows."""
    return carry.chain > longest_chain(model, carry.near)


def fired_guards(carry: Carry) -> Int[Array, " words"]:
    """The guards that fired at the last instant of an event, a bit each in words of `GUARDS_PER_WORD` bits.

    There are no words without guards.
    """
    return packed(carry.far_guards >= 0.0)


def packed(fired: GuardFlags) -> Int[Array, " words"]:
    """Flags of guards (n,) as bits of words."""
    bits = jnp.asarray([1 << (i % GUARDS_PER_WORD) for i in range(fired.size)], jnp.int64)
    words = []
    for first in range(0, fired.size, GUARDS_PER_WORD):
        of_word = slice(first, first + GUARDS_PER_WORD)
        words.append(jnp.sum(jnp.where(fired[of_word], bits[of_word], 0)))
    return jnp.stack(words) if words else jnp.zeros((0,), jnp.int64)


def unpacked(words: Int[np.ndarray, "rows words"]) -> Bool[np.ndarray, "rows guards"]:
    """The guards that fired (rows, guards), from `LaneRecord.fired` (rows, words); padded with False."""
    bits = np.arange(GUARDS_PER_WORD)
    bits_of_words = (words[:, :, None].astype(np.int64) >> bits) & 1
    return bits_of_words.astype(bool).reshape(len(words), words.shape[1] * bits.size)
