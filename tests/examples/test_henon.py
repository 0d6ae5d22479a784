"""Henon's map against its closed forms."""

from __future__ import annotations

import numpy as np

import gaitsweep as gs
from gaitsweep.examples.henon import Henon


def test_the_flip_of_the_fixed_point() -> None:
    """At a = 3 (1 - b)^2 / 4 (Henon 1976, section 4), where a multiplier is -1."""
    a = 3.0 * 0.7**2 / 4.0
    fixed = (-0.7 + np.sqrt(0.7**2 + 4.0 * a)) / (2.0 * a)
    multipliers = gs.return_map(Henon(), a=a).multipliers([fixed, 0.3 * fixed])
    np.testing.assert_allclose(np.real(multipliers), [-1.0, 0.3], atol=1e-12)
