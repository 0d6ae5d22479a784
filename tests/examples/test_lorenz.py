"""Lorenz's flow against its published shortest periodic orbit."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import gaitsweep as gs
from gaitsweep.examples.lorenz import Lorenz


@pytest.mark.slow
def test_the_shortest_periodic_orbit() -> None:
    """Viswanath 2003, Nonlinearity 16:1035, Table 1: a point of the orbit AB, and its period.

    It goes once round each fixed point, and so crosses the section twice a turn at mirrored places. The orbit
    is unstable: its point's 13 digits leave an error of some 1e-11 after one turn.
    """
    start: dict[str, Any] = {"x_0": -13.763610682134, "y_0": -19.578751942452, "z_0": 27.0}
    numerics = {"rtol": 1e-12, "atol": 1e-13}
    at = gs.sweep(Lorenz(), **start, run=gs.ReturnMap(crossings=3), numerics=numerics).table.iloc[1:]
    t, x, y = (at[name].to_numpy() for name in ("t", "x_n", "y_n"))
    np.testing.assert_allclose(t[2] - t[0], 1.5586522107161747, rtol=0, atol=1e-9)
    np.testing.assert_allclose([x[0], y[0]], [-x[1], -y[1]], rtol=0, atol=1e-9)
