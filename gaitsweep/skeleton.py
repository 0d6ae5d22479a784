"""Drawable parts of a model: its limbs, bodies and springs at the instants of a trace."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from jaxtyping import Float


@dataclasses.dataclass(frozen=True)
class LimbLook:
    """The name and the place of a limb: what figures draw alike; `pair` and `far` as of `Limb`."""

    name: str
    pair: int = 0
    far: bool = False


@dataclasses.dataclass(frozen=True)
class Limb:
    """A limb as it is drawn: `points` (n, k, 3) m from its root to its foot, over n samples.

    Limbs of one `pair` share a colour; `far`: on the left side, away from who looks, and so drawn lighter.
    """

    name: str
    points: Float[np.ndarray, "samples points 3"]
    pair: int = 0
    far: bool = False


@dataclasses.dataclass(frozen=True)
class Skeleton:
    """A body as it is drawn, over n samples; x forward, y to the left, z up from the ground, m.

    `limbs`, the first that of the signal contact_1, or none; `bodies` (n, k, 3), each filled to the hull of
    its points, from head to tail; `springs` (n, 2, 3), their ends; `note`: what a stranger has to know
    besides; `heading`, rad from x: the direction in which it walks, by default from its tail to its head.
    """

    limbs: tuple[Limb, ...]
    bodies: tuple[Float[np.ndarray, "samples _points 3"], ...] = ()
    springs: tuple[Float[np.ndarray, "samples 2 3"], ...] = ()
    note: str = ""
    heading: float | None = None
