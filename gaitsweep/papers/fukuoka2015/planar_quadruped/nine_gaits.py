"""The nine gaits of a quadruped with diagonal pairs in antiphase, by the sign of each pair's phase shift.

The two pairs of a trot are RF with LH (1) and LF with RH (2). In each pair the hind leg may swing with the
fore leg, later (+; the body is pitched up) or earlier (-; down): 3 x 3 gaits.

Source: Fukuoka, Habu and Fukui 2015, Sci. Rep. 5:8169, Fig. 5.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from gaitsweep import ArgumentError, near_miss

LEGS = ("LF", "LH", "RF", "RH")
# Fore and hind leg of pair 1 and of pair 2.
PAIRS = (("RF", "LH"), ("LF", "RH"))
# By the signs of delta_1 and delta_2, the second varying fastest: -, 0, +. The canters with u are unusual:
# they have not been observed in animals.
CHART = (
    "D-walk", "uR-canter", "LT-gallop",
    "uL-canter", "trot", "L-canter",
    "RT-gallop", "R-canter", "L-walk",
)  # fmt: skip
FAMILIES = ("walk", "trot", "canter", "gallop")  # in the order of speed
THRESHOLD = 0.07  # cycles
STRICT = 0.05  # cycles: a second threshold, reported beside the first
# Limits of a steady gait: resultant length of the shifts, coefficient of variation of the period, and
# deviation of the pairs from antiphase, cycles.
MIN_LENGTH, MAX_VARIATION, MAX_ANTIPHASE_ERROR = 0.95, 0.05, 0.25


def place(delta_1: Any, delta_2: Any, threshold: Any = THRESHOLD) -> Any:
    """The index in `CHART`, 0 to 8, of the gaits with these shifts; for NumPy and JAX arrays.

    Args:
        delta_1, delta_2: phases of LH - RF and of RH - LF, cycles in [-0.5, 0.5), of equal shape.
        threshold: shifts up to this count as zero, cycles.
    """
    return 3 * _sign(delta_1, threshold) + _sign(delta_2, threshold) + 4


def margin(delta_1: Any, delta_2: Any, threshold: Any = THRESHOLD, xp: Any = np) -> Any:
    """The smaller distance of the two shifts, in cycles, from the boundary to another gait.

    Boundaries are at the threshold, and at half a cycle, where late and early are the same: between walks it
    is the pace, between gallops the bound.

    Args:
        delta_1, delta_2, threshold: as for `place`.
        xp: NumPy, or jax.numpy for its arrays.
    """
    sizes = xp.abs(xp.stack(xp.broadcast_arrays(delta_1, delta_2)))
    return xp.minimum(xp.abs(sizes - threshold), 0.5 - sizes).min(axis=0)


def signs(gait: str) -> tuple[int, int]:
    """The signs of delta_1 and delta_2 of one of the nine gaits.

    Raises:
        ArgumentError: it is not one of them; the message names the near miss.
    """
    if gait not in CHART:
        raise ArgumentError(f"{gait} is not one of the nine gaits{near_miss.suggestion(gait, CHART)}")
    first, second = divmod(CHART.index(gait), 3)
    return first - 1, second - 1


def family(gait: str) -> str:
    """The family of one of the nine gaits: walk, trot, canter or gallop; another name unchanged."""
    if gait not in CHART:
        return gait
    first, second = signs(gait)
    if first == second:
        return "walk" if first else "trot"
    return "gallop" if first * second else "canter"


def _sign(delta: Any, threshold: Any) -> Any:
    """1 above the threshold, -1 below its negative, else 0."""
    return 1 * (delta > threshold) - 1 * (delta < -threshold)
