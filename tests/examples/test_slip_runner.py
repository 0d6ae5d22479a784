"""The spring-mass runner against its equations in SciPy and published results."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import gaitsweep as gs
from gaitsweep.examples.slip_runner import SlipRunner

ALPHA, K, M, L0, G, SPEED = np.deg2rad(68.0), 20e3, 80.0, 1.0, 9.81, 5.0


def stance(height: float) -> tuple[np.ndarray, float]:
    """The state (x, z, v_x, v_z) at lift-off and the time of stance, after an apex of this height."""

    def flow(t: float, s: np.ndarray) -> list[float]:
        x, z, u, w = s
        r = np.hypot(x, z)
        push = K / M * (L0 - r) / r
        return [u, w, push * x, push * z - G]

    def length(t: float, s: np.ndarray) -> float:
        return np.hypot(s[0], s[1]) - L0

    length.terminal, length.direction = True, 1.0  # type: ignore[attr-defined]
    down = L0 * np.sin(ALPHA)
    forwards = np.sqrt(SPEED**2 + 2.0 * G * (L0 - height))
    begin = [-L0 * np.cos(ALPHA), down, forwards, -np.sqrt(2.0 * G * (height - down))]
    run = solve_ivp(flow, (0.0, 2.0), begin, "DOP853", events=length, rtol=1e-12, atol=1e-12)
    return run.y_events[0][0], run.t_events[0][0]


def next_apex(height: float) -> float:
    _, z, _, w = stance(height)[0]
    return z + w**2 / (2.0 * G)


@pytest.mark.slow
def test_successive_apices_are_scipys() -> None:
    heights = np.array([0.95, 1.0, 1.1, 1.2, 1.3])
    rows = gs.sweep(SlipRunner(), z_0=heights, run=gs.ReturnMap(crossings=3), numerics={"rtol": 1e-11}).table
    result = rows["z_n"].to_numpy().reshape(5, 4)
    for n in range(3):
        np.testing.assert_allclose(result[:, n + 1], [next_apex(z) for z in result[:, n]], rtol=0, atol=1e-8)
    np.testing.assert_allclose(rows["energy_n"], M * G * L0 + M * SPEED**2 / 2.0, rtol=1e-8)


@pytest.mark.slow
def test_fixed_points_at_68_degrees() -> None:
    """A stable and an unstable gait, as Fig. 6 of Seyfarth, Geyer and Herr 2003 shows."""
    mapping = gs.return_map(SlipRunner())
    fixed = mapping.fixed_points({"z_0": [0.95, 1.3]})
    assert fixed.converged.all()
    for (z,), (multiplier,) in zip(fixed.points.at, mapping.multipliers(fixed), strict=True):
        assert abs(next_apex(z) - z) < 1e-7
        slope = (next_apex(z + 1e-5) - next_apex(z - 1e-5)) / 2e-5
        assert abs(multiplier - slope) < 1e-4
    assert (np.abs(mapping.multipliers(fixed))[:, 0] < 1.0).tolist() == [True, False]


@pytest.mark.slow
def test_stance_is_that_of_the_published_approximation() -> None:
    """Geyer, Seyfarth and Blickhan 2005: within 1 % of the compression and 0.6 degrees of the angle.

    The leg's strain e obeys e'' + w^2 e = W^2 - g/l0 with w^2 = k/m + 3 W^2, W the leg's rate at touchdown;
    the leg turns at W (1 - 2 e).
    """
    trace = gs.simulate(SlipRunner(), duration=0.5, every=2e-4, z_0=0.95)
    leg = np.hypot(trace["x"].to_numpy(), trace["z"].to_numpy())
    down = np.flatnonzero(np.diff(trace["x"]) < -0.1)[0] + 1  # x counts from the foot
    up = down + np.flatnonzero(leg[down:] > L0)[0]
    t = (trace["t"] - trace["t"][down]).to_numpy()[down:up]
    at = trace.iloc[down]
    radial = (at["x"] * at["v_x"] + at["z"] * at["v_z"]) / L0
    turning = (at["z"] * at["v_x"] - at["x"] * at["v_z"]) / L0**2
    w = np.sqrt(K / M + 3.0 * turning**2)
    mean = (turning**2 - G / L0) / w**2
    strain = mean * (1.0 - np.cos(w * t)) + radial / (L0 * w) * np.sin(w * t)
    assert np.abs(strain - (leg[down:up] / L0 - 1.0)).max() < 0.01
    swept = np.arctan2(trace["x"].to_numpy(), trace["z"].to_numpy())[down:up]
    turned = turning * np.concatenate([[0.0], np.cumsum(np.diff(t) * (1.0 - 2.0 * strain[:-1]))])
    assert np.abs(np.rad2deg(swept - swept[0] - turned)).max() < 0.6


@pytest.mark.slow
def test_an_apex_below_touchdown_falls_and_so_does_a_leg_too_steep() -> None:
    low = gs.sweep(SlipRunner(), z_0=[0.92]).table
    steep = gs.sweep(SlipRunner(), alpha=[74.0]).table
    assert low["status"].tolist() == steep["status"].tolist() == ["fell"]
    assert low["cycles"].tolist() == [0]
