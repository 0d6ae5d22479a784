"""Random numbers of models: functions of a seed, a counter and a stream, all of them whole numbers.

A number depends on nothing else: not on the engine, the device, the lane, the block, or on numbers drawn
before it. The generator is Philox 4x32 with ten rounds, of the seed as its key, and of counter and stream as
its counter. Source: Salmon, Moraes, Dror and Shaw 2011, Parallel random numbers: as easy as 1, 2, 3 (SC '11).
"""

from __future__ import annotations

import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir
from jaxtyping import Array, Float

__all__ = ["MULTIPLIERS", "ROUNDS", "WEYL", "WHOLE", "normal", "philox_words", "uniform"]

ROUNDS = 10
MULTIPLIERS = (0xD2511F53, 0xCD9E8D57)
WEYL = (0x9E3779B9, 0xBB67AE85)
# Whole numbers up to this are exact; seeds, counters and streams beyond it, and NaN, count as 0.
WHOLE = 2.0**53
_MASK = 0xFFFFFFFF
_LARGEST_SINGLE = np.float32(1.0 - 2.0**-24)  # below 1


def uniform(seed: Any, counter: Any, stream: Any = 0) -> Float[Array, " ..."]:
    """A random number between 0 and 1, both excluded, the same on every engine and device to the last bit.

    Args:
        seed: a parameter, such as one that `vary` lists; fractions are dropped.
        counter: which number of the seed, such as a mode that counts steps, or the index of a foothold; it
            may be negative.
        stream: which of several independent sequences.

    Returns:
        A multiple of 2^-53, of the broadcast shape.

    Example:
        >>> import gaitsweep as gs
        >>> [round(float(gs.uniform(7, step)), 6) for step in (0, 1, 2)]
        [0.954597, 0.40696, 0.006075]
    """
    return _uniform(seed, counter, stream, 0)


def normal(seed: Any, counter: Any, stream: Any = 0) -> Float[Array, " ..."]:
    """A normally distributed random number of mean 0 and variance 1, by the method of Box and Muller.

    Engines and devices agree to rounding, since their logarithms and cosines do. Arguments are those of
    `uniform`; a number is not independent of the uniform one of the same seed, counter and stream.
    """
    radius = jnp.sqrt(-2.0 * jnp.log(_uniform(seed, counter, stream, 0)))
    return radius * jnp.cos(2.0 * jnp.pi * _uniform(seed, counter, stream, 1))


def _uniform(seed: Any, counter: Any, stream: Any, half: int) -> Float[Array, " ..."]:
    """The number of the first or second `half` of the words; in single precision if all reals are."""
    key = [jnp.asarray(value) for value in (seed, counter, stream)]
    dtypes = [value.dtype for value in key if jnp.issubdtype(value.dtype, jnp.floating)]
    number = _philox().bind(*jnp.broadcast_arrays(*(value.astype(jnp.float64) for value in key)), half=half)
    if dtypes and all(dtype == jnp.float32 for dtype in dtypes):
        return jnp.minimum(number.astype(jnp.float32), _LARGEST_SINGLE)
    return number


def philox_words(counter: Any, key: Any) -> list[Any]:
    """The four words of Philox 4x32-10 of a counter (4 words) and a key (2 words), as uint64 below 2^32."""
    c0, c1, c2, c3 = counter
    k0, k1 = key
    for number in range(ROUNDS):
        if number:
            k0 = (k0 + WEYL[0]) & _MASK
            k1 = (k1 + WEYL[1]) & _MASK
        first = c0 * MULTIPLIERS[0]
        second = c2 * MULTIPLIERS[1]
        c0, c1, c2, c3 = (second >> 32) ^ c1 ^ k0, second & _MASK, (first >> 32) ^ c3 ^ k1, first & _MASK
    return [c0, c1, c2, c3]


def fraction(seed: Any, counter: Any, stream: Any, half: int, numpy: Any = np) -> Any:
    """The number between 0 and 1 of three float64, of the first or second `half` of the words.

    `numpy` is NumPy or its JAX counterpart.
    """
    words = []
    for value in (seed, counter, stream):
        whole = numpy.where(numpy.abs(value) < WHOLE, numpy.floor(value), 0.0)
        bits = numpy.asarray(whole).astype(np.int64).astype(np.uint64)
        words.append((bits & np.uint64(_MASK), bits >> np.uint64(32)))
    key, *counters = words
    high, low = philox_words([word for pair in counters for word in pair], key)[2 * half : 2 * half + 2]
    whole = ((high >> np.uint64(6)) << np.uint64(26)) | (low >> np.uint64(6))
    return (whole.astype(np.float64) + 0.5) * 2.0**-52


def _by_jax(seed: Array, counter: Array, stream: Array, *, half: int) -> Array:
    """The number by JAX's own operations, where no kernel has code for it."""
    return fraction(seed, counter, stream, half, jnp)


def _constant(primals: Any, _: Any, *, half: int) -> Any:
    """The number and its derivative, which is zero."""
    number = _philox().bind(*primals, half=half)
    return number, ad.Zero(jax.typeof(number).to_tangent_aval())


def _batched(operands: Any, places: Any, *, half: int) -> tuple[Array, int]:
    """The numbers of a batch; an operand without a batch, such as a row's seed, is repeated."""
    (size,) = {x.shape[place] for x, place in zip(operands, places, strict=True) if place is not None}
    fronts = (batching.bdim_at_front(x, place, size) for x, place in zip(operands, places, strict=True))
    return _philox().bind(*fronts, half=half), 0


@functools.cache
def _philox() -> Primitive:
    """JAX's primitive of the numbers, made when a model first draws one."""
    philox = Primitive("philox")
    philox.def_impl(_by_jax)
    philox.def_abstract_eval(lambda seed, *_, half: seed)
    mlir.register_lowering(philox, mlir.lower_fun(_by_jax, multiple_results=False))
    batching.primitive_batchers[philox] = _batched
    ad.primitive_jvps[philox] = _constant
    return philox
