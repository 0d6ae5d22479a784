"""Differences of angles, for NumPy and JAX alike."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, TypeVar

if TYPE_CHECKING:
    import jax
    import numpy as np
    import pandas as pd

TURN = 2.0 * math.pi  # rad

T = TypeVar("T", "float", "np.ndarray", "jax.Array", "pd.Series")


def wrapped_difference(difference: T) -> T:
    """Differences of angles, wrapped to [-pi, pi).

    Args:
        difference: a number or an array of any shape, rad.

    Example:
        >>> import numpy as np, gaitsweep as gs
        >>> degrees = np.array([350.0 - 10.0, 90.0 - 0.0])
        >>> np.rad2deg(gs.analyses.wrapped_difference(np.deg2rad(degrees))).round(6).tolist()
        [-20.0, 90.0]
    """
    return (difference + math.pi) % TURN - math.pi
