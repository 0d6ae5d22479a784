"""Event stalls: events that follow each other at one instant without end, and the guards of such events.

The time of such a row does not advance. A recorder ends it as `Status.event_stall`.
"""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Int

from gaitsweep.contract import HybridModel, Model
from gaitsweep.engine.carry import Carry, Flag, GuardFlags, Guards

# Jumps at one instant, for each guard, beyond which a row is stalled: far above most physical chains of
# events.
JUMPS_PER_GUARD = 4
# Guards in one word of `LaneRecord.fired`: a slot of a kernel is a float64, which has 53 bits.
GUARDS_PER_WORD = 32


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
