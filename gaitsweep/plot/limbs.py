"""The names and colours of limbs, the same in all figures and movies."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import pandas as pd
from matplotlib.axes import Axes
from matplotlib.colors import to_hex, to_rgb

from gaitsweep import models
from gaitsweep.contract import Model
from gaitsweep.skeleton import Limb, LimbLook

_PAIRS = ("#D55E00", "#0072B2", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
_FAR = 0.45  # share of white in the colour of the far limb of a pair
_ALIKE = "#000000"  # of limbs that are all of one pair and side, whose colours could not tell them apart


def limb_colours(limbs: Iterable[Limb | LimbLook]) -> list[str]:
    """A colour for each limb: that of its pair, lighter on the far side; black if all are equal."""
    sides = [(limb.pair, limb.far) for limb in limbs]
    if len(set(sides)) == 1:
        return [_ALIKE] * len(sides)
    colours: list[str] = []
    for pair, far in sides:
        white = _FAR if far else 0.0
        channels = to_rgb(_PAIRS[pair % len(_PAIRS)])
        red, green, blue = (channel + white * (1.0 - channel) for channel in channels)
        colours.append(to_hex((red, green, blue)))
    return colours


def model_of(table: pd.DataFrame) -> Model | None:
    """The model of a table with its structure; None if it is unavailable or the table has no job."""
    job = table.attrs.get("job", {})
    try:
        return models.find_of_table(table.attrs)(**job.get("structure", {}))
    except (TypeError, ValueError, models.ModelError):
        return None


def limbs_of_model(model: Model | None, count: int) -> tuple[LimbLook, ...]:
    """The `count` limbs of a model, in the order of its contacts; `leg 1`, ... if it names others."""
    if model is not None and len(model.limbs) == count:
        return model.limbs
    return tuple(LimbLook(f"leg {number + 1}") for number in range(count))


def name_limbs(
    axes: Axes, limbs: Sequence[Limb | LimbLook], most: int | None = None, weight: str = "normal"
) -> None:
    """Label rows of bars with the names of their limbs, each in its colour, the first limb on top.

    Args:
        axes: the panel.
        limbs: the limbs.
        most: the most names; of more limbs every second one is named, or every third, ...
        weight: of the font.
    """
    named = range(0, len(limbs), max(1, math.ceil(len(limbs) / (most or len(limbs) or 1))))
    axes.set_yticks(list(named), [limbs[row].name for row in named])
    colours = limb_colours(limbs)
    for tick, row in zip(axes.get_yticklabels(), named, strict=True):
        tick.set(color=colours[row], fontweight=weight)
    axes.tick_params(axis="y", length=0)
    axes.set_ylim(len(limbs) - 0.4, -0.6)
