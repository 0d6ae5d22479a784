"""Drawable parts of a model: its limbs, bodies and springs at the instants of a trace."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from jaxtyping import Float


@dataclasses.dataclass(frozen=True)
class LimbLook:
    """The name of a limb, and its place in the body; see `Limb`."""

    name: str
    pair: int = 0
    far: bool = False


@dataclasses.dataclass(frozen=True)
class Limb:
    """A limb as it is drawn: `points` (n, k, 3) m from its root to its foot, over n samples.

    Limbs of one `pair` have the same colour. A `far` limb is on the left side, away from the viewer, and is
    drawn lighter.
    """

    name: str
    points: Float[np.ndarray, "samples points 3"]
    pair: int = 0
    far: bool = False


@dataclasses.dataclass(frozen=True)
class Skeleton:
    """A body as it is drawn, over n samples; x forward, y to the left, z up from the ground, m.

    `limbs` are in the order of the signals contact_1, contact_2, ... `bodies` (n, k, 3) are drawn as the
    hulls of their points, from head to tail. `springs` (n, 2, 3) are the two ends of each spring. `note` is
    a remark for viewers. `heading` is the direction of walking, rad from x; by default from the tail to the
    head.
    """

    limbs: tuple[Limb, ...]
    bodies: tuple[Float[np.ndarray, "samples _points 3"], ...] = ()
    springs: tuple[Float[np.ndarray, "samples 2 3"], ...] = ()
    note: str = ""
    heading: float | None = None
