"""The drawing of the chain: a box for each mass, its leg below it, and springs between neighbours."""

from __future__ import annotations

import itertools
from collections.abc import Mapping

import numpy as np
from jaxtyping import Float

from gaitsweep import Limb, Skeleton

# Drawn distance of neighbours and half size of masses, in leg lengths; the model has neither.
_SPACING, _HALF_SIZE = 0.6, 0.075
# Corners of a box in halves of its size.
_CORNERS = np.array([(x, y, z) for y in (-1.0, 1.0) for x in (-1.0, 1.0) for z in (-1.0, 1.0)])


class MultileggedDrawing:
    """The member `skeleton` of a chain of N + 1 legs."""

    N: int

    def skeleton(
        self, values: Mapping[str, float], signals: Mapping[str, Float[np.ndarray, " times"]]
    ) -> Skeleton:
        """The chain, its head to the right."""
        masses, feet = [], []
        for i in range(self.N + 1):
            height, length = signals[f"x_{i + 1}"], signals[f"l_{i + 1}"]
            along = np.full_like(height, -_SPACING * values["L"] * i)
            level = np.zeros_like(height)
            masses.append(np.stack([along, level, height], axis=1))
            feet.append(np.stack([along, level, height - length], axis=1))
        size = _HALF_SIZE * values["L"] * _CORNERS
        return Skeleton(
            limbs=tuple(
                Limb(f"leg {i + 1}", np.stack([masses[i], feet[i]], axis=1), pair=1)
                for i in range(self.N + 1)
            ),
            bodies=tuple(mass[:, None, :] + size for mass in masses),
            springs=tuple(np.stack(ends, axis=1) for ends in itertools.pairwise(masses)),
            note="Leg 1 is the head's. Masses only move up and down; "
            "how far apart they are is not in the model.",
        )
