"""Families of periodic orbits that are published with their digits, found from the equations alone.

The starts of each search are drawn over ranges; nothing of the orbits is given to it.
"""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import gaitsweep as gs
from gaitsweep.examples.lorenz import Lorenz
from simplest_walker import ANGLE, RATE, SimplestWalker

# Viswanath 2003, Nonlinearity 16:1035, Table 1: x, y (z = 27, rising) and the period of each word of up to
# five turns round one side (A) or the other (B).
LORENZ = {
    "AB": (-13.763610682134, -19.578751942452, 1.5586522107162),
    "AAB": (-12.595115397689, -16.970525307084, 2.3059072639398),
    "ABB": (-14.426408025035, -21.111230056994, 2.3059072639398),
    "AAAB": (-11.998523280062, -15.684254096883, 3.0235837034339),
    "AABB": (-12.915137970311, -17.673100172646, 3.0842767758221),
    "ABBB": (-14.839800671717, -22.086807160089, 3.0235837034339),
    "AAAAB": (-11.586951663722, -14.814615288122, 3.7256417715558),
    "AAABB": (-12.231406596273, -16.182730598894, 3.8202541634368),
    "AABAB": (-12.698941349915, -17.197497247713, 3.8695391125646),
    "AABBB": (-13.056930146345, -17.987214049281, 3.8202541634368),
}
# Cyclic words of n letters A and B that do not repeat a shorter word, up to the exchange of A and B.
WORDS = {2: 1, 3: 1, 4: 2, 5: 3}


def rising_points(x: float, y: float, period: float) -> np.ndarray:
    """The points (x, y) at which the orbit through (x, y, 27) rises through z = 27, by SciPy."""

    def flow(t: float, s: np.ndarray) -> list[float]:
        return [10.0 * (s[1] - s[0]), s[0] * (28.0 - s[2]) - s[1], s[0] * s[1] - 8.0 / 3.0 * s[2]]

    def level(t: float, s: np.ndarray) -> float:
        return s[2] - 27.0

    level.direction = 1.0  # type: ignore[attr-defined]
    run = solve_ivp(flow, (0.0, period), [x, y, 27.0], "DOP853", events=level, rtol=1e-13, atol=1e-13)
    return run.y_events[0][:, :2]


@pytest.mark.slow
def test_the_orbits_of_lorenz_by_their_words() -> None:
    """All ten published orbits, to 1e-8 in the period and in a point, and no orbit beside their words.

    An orbit and its mirror image (ABB of AAB) are one record. The fixed points of the flow lie on the section
    and are gaits of period 1.
    """
    lorenz = gs.atlas(
        Lorenz(), parameter="rho", path=(27.99, 28.01), at=28.0,
        ranges={"x": (-20.0, 20.0), "y": (-25.0, 25.0)}, periods=5, budget=128, batch=128, depth=0,
        longest=1.0, step=0.5, verify=0,
        numerics={"rtol": 1e-12, "atol": 1e-12},
    )  # fmt: skip
    orbits = lorenz.gaits.query("period > 1")
    turns, counts = np.unique(orbits["period"].to_numpy(int), return_counts=True)
    assert dict(zip(turns.tolist(), counts.tolist(), strict=True)) == WORDS
    assert lorenz.missing < 1.0
    found = [
        (float(time), rising_points(float(x), float(y), float(time)))
        for x, y, time in orbits[["x_n", "y_n", "time"]].to_numpy(float)
    ]
    for word, (x, y, period) in LORENZ.items():
        time, points = min(found, key=lambda orbit: abs(orbit[0] - period))
        assert abs(time - period) < 1e-8, word
        away = np.min([np.abs(side * points - [x, y]).max(axis=1) for side in (-1.0, 1.0)])
        # SciPy's steps from the falling to the rising crossings add some 1e-11, times the orbit's multiplier
        assert away < 1e-8, word


class Walker(SimplestWalker):
    """The simplest walker with the two coordinates of its section."""

    section_coordinates = ("theta", "theta_rate")

    def complete(self, p: Any, s: Any) -> Any:
        return s.replace(phi=2.0 * s.theta, phi_rate=(1.0 - jnp.cos(2.0 * s.theta)) * s.theta_rate)


@pytest.mark.slow
def test_the_gaits_of_the_simplest_walker() -> None:
    """Garcia et al. 1998 have two gaits of one step at a slope of 0.009: a long one and a short one.

    Points: the paper's, and those in M. Garcia's own program of 1998, with its multipliers, which are by
    finite differences. The families: the paper's expansions for gentle slopes.
    """
    walks = gs.atlas(
        Walker(), parameter="gamma", path=(0.001, 0.02), at=0.009, periods=4, budget=256, depth=2, verify=0,
        ranges={"theta": (0.05, 0.35), "theta_rate": (-0.35, -0.05)}, numerics={"rtol": 1e-12, "atol": 1e-13},
    )  # fmt: skip
    gaits = walks.gaits.sort_values("theta_n", ascending=False)
    assert gaits["period"].tolist() == [1, 1]
    assert gaits["stable"].tolist() == [True, False]
    points = gaits[["theta_n", "theta_rate_n"]].to_numpy(float)
    np.testing.assert_allclose(points[0], [ANGLE, RATE], rtol=0, atol=1e-10)
    published = [[0.20031090049483, -0.19983247291764], [0.19393736960624, -0.20386692731962]]
    np.testing.assert_allclose(points, published, rtol=0, atol=1e-8)
    multipliers = gaits[["multiplier_re", "multiplier_im"]].to_numpy(float)
    np.testing.assert_allclose(np.abs(multipliers[0]), [0.19120868949940, 0.55633363687106], atol=2e-3)
    np.testing.assert_allclose(multipliers[1], [4.000, 0.0], atol=5e-3)
    # the next terms of the expansions are of the order gamma, some 2e-4 here
    gentle = walks.branches.query("gamma == 0.001").sort_values("theta_n", ascending=False)
    expansions = [0.0970956, 0.0943976]  # the leading terms, of gamma^(1/3)
    np.testing.assert_allclose(gentle["theta_n"].to_numpy(float), expansions, rtol=0, atol=3e-4)
    flips = walks.points.query("special == 'flip'")
    assert flips["period"].tolist() == [1, 2, 4]
    np.testing.assert_allclose(flips["gamma"].iloc[0], 0.0151, atol=5e-5)  # as printed
    np.testing.assert_allclose(flips["gamma"].to_numpy(float), [0.015088, 0.017669, 0.018160], atol=1e-6)


def after_steps(theta: float, rate: float, gamma: float, steps: int) -> tuple[float, float]:
    """The angle and its rate after some steps of the simplest walker, by SciPy."""

    def flow(t: float, s: np.ndarray) -> list[float]:
        fall = np.sin(s[0] - gamma)
        return [s[1], fall, s[3], fall + (s[1] ** 2 - np.cos(s[0] - gamma)) * np.sin(s[2])]

    def strike(t: float, s: np.ndarray) -> float:
        return s[2] - 2.0 * s[0] if t > 0.5 else 1.0  # it rises at the beginning, too

    strike.terminal, strike.direction = True, 1.0  # type: ignore[attr-defined]
    for _ in range(steps):
        start = [theta, rate, 2.0 * theta, (1.0 - np.cos(2.0 * theta)) * rate]
        run = solve_ivp(
            flow, (0.0, 9.0), start, "DOP853", events=strike, rtol=1e-12, atol=1e-13, max_step=0.05
        )
        at = run.y_events[0][0]
        theta, rate = -at[0], np.cos(2.0 * at[0]) * at[1]
    return theta, rate


@pytest.mark.slow
def test_gaits_of_three_and_four_steps_that_were_not_published_with_the_model() -> None:
    """At a slope of 0.0175 there are seven; those of 3 and 4 steps were reported later (Zbl 1254.70020)."""
    walks = gs.atlas(
        Walker(), parameter="gamma", path=(0.001, 0.02), at=0.0175, periods=4, budget=384, batch=128, depth=0,
        ranges={"theta": (0.05, 0.35), "theta_rate": (-0.35, -0.05)}, patience=2, verify=0,
        numerics={"rtol": 1e-12, "atol": 1e-13},
    )  # fmt: skip
    gaits = walks.gaits
    assert sorted(gaits["period"].tolist()) == [1, 1, 2, 3, 3, 4, 4]
    for theta, rate, period in gaits[["theta_n", "theta_rate_n", "period"]].to_numpy(float):
        # the largest multiplier is 134, and SciPy's error of a step some 1e-11
        np.testing.assert_allclose(after_steps(theta, rate, 0.0175, int(period)), (theta, rate), atol=1e-7)
    points = walks.points.query("period > 2")
    folds, flips = (points.query(f"special == '{kind}'").sort_values("period") for kind in ("fold", "flip"))
    np.testing.assert_allclose(folds["gamma"].to_numpy(float), [0.012281, 0.010090], atol=1e-6)
    np.testing.assert_allclose(flips["gamma"].to_numpy(float), [0.012635, 0.010132], atol=1e-6)
