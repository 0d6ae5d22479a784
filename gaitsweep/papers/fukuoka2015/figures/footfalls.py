"""Footfalls of four legs: a bar for each leg while it stands, and shaded flight phases."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from types import MappingProxyType

import numpy as np
import pandas as pd
from jaxtyping import Float
from matplotlib.axes import Axes

from gaitsweep import LimbLook
from gaitsweep.papers.fukuoka2015.planar_quadruped import drawing
from gaitsweep.papers.fukuoka2015.planar_quadruped.nine_gaits import LEGS
from gaitsweep.plot import PlotError, contact_intervals, limb_colours, name_limbs

LIMBS: Mapping[str, LimbLook] = MappingProxyType(dict(zip(LEGS, drawing.LIMBS, strict=True)))
CONTACTS = MappingProxyType({leg: f"contact_{i + 1}" for i, leg in enumerate(LEGS)})
FLIGHT = "#E6E6E6"
_BAR = 0.62


@functools.cache
def leg_colours() -> Mapping[str, str]:
    """The colour of each leg, as in all figures of its limbs."""
    return MappingProxyType(dict(zip(LEGS, limb_colours(drawing.LIMBS), strict=True)))


def footfalls(axes: Axes, samples: pd.DataFrame) -> None:
    """A bar for each leg while it is on the ground, the first leg on top; flight phases in light grey.

    Args:
        axes: the axes, over time in s.
        samples: a part of one row of a trace: t and contact_1, ... in the order of `LEGS`.

    Raises:
        PlotError: a contact is not in the table.
    """
    missing = [contact for contact in CONTACTS.values() if contact not in samples.columns]
    if missing:
        raise PlotError(f"The table has no column {missing[0]}: footfalls need a trace.")
    t = samples["t"].to_numpy(float)
    down = samples[list(CONTACTS.values())].to_numpy(float)
    for row, leg in enumerate(LEGS):
        starts, stops = contact_intervals(t, down[:, row])
        bars = list(zip(starts, stops - starts, strict=True))
        axes.broken_barh(bars, (row - _BAR / 2, _BAR), facecolors=leg_colours()[leg], linewidth=0)
    shade_flights(axes, t, down)
    name_limbs(axes, list(LIMBS.values()))


def shade_flights(
    axes: Axes, t: Float[np.ndarray, " samples"], down: Float[np.ndarray, "samples legs"]
) -> None:
    """Light grey flight phases: times `t` (s) at which no leg is `down` (1)."""
    for start, stop in zip(*contact_intervals(t, (down.max(axis=1) < 0.5).astype(float)), strict=True):
        axes.axvspan(float(start), float(stop), facecolor=FLIGHT, linewidth=0, zorder=0)
