"""Colours of limbs, the same in footfall diagrams, stick figures and movies."""

from __future__ import annotations

from collections.abc import Sequence

from matplotlib.colors import to_hex, to_rgb

from gaitsweep.skeleton import Limb

_PAIRS = ("#D55E00", "#0072B2", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
_FAR = 0.45  # share of white in the colour of the far limb of a pair


def limb_colours(limbs: Sequence[Limb]) -> list[str]:
    """A colour for each limb: that of its pair, lighter on the far side."""
    found: list[str] = []
    for limb in limbs:
        white = _FAR if limb.far else 0.0
        red, green, blue = (part + white * (1.0 - part) for part in to_rgb(_PAIRS[limb.pair % len(_PAIRS)]))
        found.append(to_hex((red, green, blue)))
    return found
