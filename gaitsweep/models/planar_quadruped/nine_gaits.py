"""The nine gaits of a quadruped whose diagonal pairs keep in antiphase: which leg of each pair swings late.

A trot's two pairs are RF with LH (1) and LF with RH (2). In each the hind leg may swing with the fore leg,
later (+; the body is tilted up) or earlier (-; down), which makes 3 x 3 gaits.

Source: Fukuoka, Habu and Fukui 2015, Sci. Rep. 5:8169, Fig. 5.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from gaitsweep import near_miss
from gaitsweep.errors import ArgumentError

LEGS = ("LF", "LH", "RF", "RH")
# Fore and hind leg of pair 1 and of pair 2.
PAIRS = (("RF", "LH"), ("LF", "RH"))
# By the signs of delta_1 and delta_2, the second varying fastest: -, 0, +. The canters with u are unusual: no
# animal is seen to use them.
CHART = (
    "D-walk", "uR-canter", "LT-gallop",
    "uL-canter", "trot", "L-canter",
    "RT-gallop", "R-canter", "L-walk",
)  # fmt: skip
FAMILIES = ("walk", "trot", "canter", "gallop")  # in the order of speed
THRESHOLD = 0.07  # cycles
STRICT = 0.05  # cycles: a second threshold, told beside the first


def place(delta_1: Any, delta_2: Any, threshold: Any = THRESHOLD) -> Any:
    """Where in `CHART` the gaits with these shifts stand, 0 to 8; of NumPy's arrays and of JAX's.

    Args:
        delta_1, delta_2: phases of LH - RF and of RH - LF, cycles in [-0.5, 0.5), of one shape.
        threshold: a shift of at most this much is none, cycles.
    """
    return 3 * _sign(delta_1, threshold) + _sign(delta_2, threshold) + 4


def margin(delta_1: Any, delta_2: Any, threshold: Any = THRESHOLD) -> np.ndarray:
    """How far, in cycles, the nearer of the shifts is from where the gait would have another name.

    That is at the threshold, or at half a cycle, where late and early meet: between walks there is the pace,
    between gallops the bound.
    """
    sizes = np.abs(np.stack(np.broadcast_arrays(delta_1, delta_2)))
    return np.minimum(np.abs(sizes - threshold), 0.5 - sizes).min(axis=0)


def signs(gait: str) -> tuple[int, int]:
    """The signs of delta_1 and delta_2 of one of the nine gaits.

    Raises:
        ValueError: it is none of them; names the near miss.
    """
    if gait not in CHART:
        raise ArgumentError(f"{gait} is none of the nine gaits{near_miss.suggestion(gait, CHART)}")
    first, second = divmod(CHART.index(gait), 3)
    return first - 1, second - 1


def family(gait: str) -> str:
    """walk, trot, canter or gallop for one of the nine gaits; any other name as it is."""
    if gait not in CHART:
        return gait
    first, second = signs(gait)
    if first == second:
        return "walk" if first else "trot"
    return "gallop" if first * second else "canter"


def ideal_phases(gait: str, shift: float = 0.25) -> dict[str, float]:
    """The phases in [0, 1) of the legs' swing onsets against that of LF, cycles.

    The legs of a pair are shifted by as much in opposite directions, so that the pairs' middles stay in
    antiphase (Fig. 5a).

    Args:
        gait: one of `CHART`.
        shift: what a pair is shifted by where it is, cycles; 0.25 spaces the legs of a walk evenly.
    """
    phases = {}
    for middle, sign, (fore, hind) in zip((0.0, 0.5), signs(gait), PAIRS, strict=True):
        phases[fore], phases[hind] = middle - 0.5 * sign * shift, middle + 0.5 * sign * shift
    return {leg: (phases[leg] - phases["LF"]) % 1.0 for leg in LEGS}


def mirrored(gait: str) -> str:
    """The gait with left and right exchanged: pair 1 becomes pair 2."""
    first, second = signs(gait)
    return CHART[3 * second + first + 4]


def _sign(delta: Any, threshold: Any) -> Any:
    return 1 * (delta > threshold) - 1 * (delta < -threshold)
