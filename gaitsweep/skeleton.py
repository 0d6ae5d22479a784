"""Drawable parts of a model: its limbs, bodies and springs at the instants of a trace."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Iterable
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from jaxtyping import Float


def contact_signals(names: Iterable[object]) -> list[str]:
    """The names contact_1, contact_2, ... among those of signals or columns, from 0 or 1 on, in order."""
    contacts = [str(name) for name in names if re.fullmatch(r"contact_(0|[1-9]\d*)", str(name))]
    return sorted(contacts, key=lambda name: int(name.removeprefix("contact_")))


@dataclasses.dataclass(frozen=True)
class LimbLook:
    """The name of a limb, and its place in the body, for figures.

    Args:
        name: its name.
        pair: limbs of one pair have the same colour.
        far: whether it is on the left side, away from the viewer, where limbs are drawn lighter.
    """

    name: str
    pair: int = 0
    far: bool = False


@dataclasses.dataclass(frozen=True)
class Limb:
    """A limb as it is drawn.

    Args:
        name, pair, far: as of `LimbLook`.
        points: from its root to its foot, (n, k, 3) m over n samples.
    """

    name: str
    points: Float[np.ndarray, "samples points 3"]
    pair: int = 0
    far: bool = False


@dataclasses.dataclass(frozen=True)
class Skeleton:
    """A body as it is drawn, over n samples; x forward, y to the left, z up from the ground, m.

    Args:
        limbs: in the order of the signals contact_1, contact_2, ...
        bodies: the points (n, k, 3) of each body, from head to tail; their hull is drawn.
        springs: the two ends (n, 2, 3) of each spring.
        note: a remark for viewers.
        heading: the direction of walking, rad from x; by default from the tail to the head.
        ground: places along the ground and heights (m) of uneven ground, (m, 2), which the program draws.
    """

    limbs: tuple[Limb, ...]
    bodies: tuple[Float[np.ndarray, "samples _points 3"], ...] = ()
    springs: tuple[Float[np.ndarray, "samples 2 3"], ...] = ()
    note: str = ""
    heading: float | None = None
    ground: Float[np.ndarray, "places 2"] | None = None
