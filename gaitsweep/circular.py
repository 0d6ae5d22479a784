"""Differences of angles, for NumPy and JAX alike."""

from __future__ import annotations

import math
from typing import Any

TURN = 2.0 * math.pi  # rad


def wrapped_difference(difference: Any) -> Any:
    """Differences of angles by the shorter way, rad, in [-pi, pi)."""
    return (difference + math.pi) % TURN - math.pi
