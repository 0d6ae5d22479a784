"""Samples: points drawn from a seed, independently (random), by a Latin hypercube or by a Sobol sequence."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from jaxtyping import Float, Int, UInt

SampleMethod = Literal["random", "latin_hypercube", "sobol"]

_SOBOL_BITS = 30
_SOBOL_CHUNK = 2**16  # points drawn at a time: a power of two, as the sequence needs


@dataclass(frozen=True)
class SampleBox:
    """Points of a sample, which are drawn together at their first use."""

    names: tuple[str, ...]
    count: int
    seed: int
    method: SampleMethod

    @cached_property
    def points(self) -> dict[str, Float[np.ndarray, " points"]]:
        """Points of [0, 1) by name, (count,)."""
        if self.method == "random":
            # 53 of the 64 bits of each word, which are the bits of a float in [0, 1)
            shift = np.uint64(11)
            return {name: (_bits(self.seed, name, self.count) >> shift) * 2.0**-53 for name in self.names}
        if self.method == "latin_hypercube":
            return {name: _one_in_each_part(self.seed, name, self.count) for name in self.names}
        return _sobol(self.seed, list(self.names), self.count)


@dataclass(frozen=True)
class RandomAxis:
    """Points of [0, 1) for one name of a sample, (length,)."""

    box: SampleBox
    name: str

    def __call__(self, index: Int[np.ndarray, " rows"]) -> Float[np.ndarray, " rows"]:
        """Return the positions (n,) of points in [0, 1)."""
        return self.box.points[self.name][index]


def _bits(seed: int, name: str, count: int) -> UInt[np.ndarray, " points"]:
    """Draw random 64-bit words, which no version of NumPy changes; each name has its own stream."""
    key = int.from_bytes(hashlib.sha256(f"{seed} {name}".encode()).digest()[:16], "big")
    return np.asarray(np.random.Philox(key=key).random_raw(count))


def _one_in_each_part(seed: int, name: str, count: int) -> Float[np.ndarray, " points"]:
    """Draw a point in each of `count` equal parts of [0, 1), in random order."""
    bits = _bits(seed, name, 2 * count)
    # 28 bits, so that a sum with the number of a part has no rounding error and stays below its end
    within = (bits[:count] >> np.uint64(36)) * 2.0**-28
    return (np.argsort(bits[count:], kind="stable") + within) / count


def _sobol(seed: int, names: list[str], count: int) -> dict[str, Float[np.ndarray, " points"]]:
    """Draw an unscrambled Sobol sequence with our own digital shift, since SciPy's scrambling may change."""
    import scipy

    sequence = scipy.stats.qmc.Sobol(len(names), scramble=False, bits=_SOBOL_BITS)
    shifts = [_bits(seed, name, 1)[0] >> np.uint64(64 - _SOBOL_BITS) for name in names]
    points = np.empty((len(names), count))
    chunk = min(_SOBOL_CHUNK, 1 << (count - 1).bit_length())  # a power of two
    for first in range(0, count, _SOBOL_CHUNK):
        part = sequence.random(chunk)[: count - first]
        cells = np.rint(part * 2.0**_SOBOL_BITS).astype(np.uint64)
        for column, shift in enumerate(shifts):
            drawn = ((cells[:, column] ^ shift) + 0.5) * 2.0**-_SOBOL_BITS
            points[column, first : first + len(part)] = drawn
    return dict(zip(names, points, strict=True))
