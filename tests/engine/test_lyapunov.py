"""Lyapunov exponents of maps, flows and flows with jumps, beside closed forms and published numbers.

The statuses chaotic and quasi_periodic, beside motions whose kind is known.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest
from jaxtyping import Float

import gaitsweep as gs
from gaitsweep.engine.recorders.exponents import Exponents
from gaitsweep.engine.tangents import orthonormalised
from gaitsweep.examples.bouncing_ball import BouncingBall
from gaitsweep.examples.duffing import Duffing
from gaitsweep.examples.henon import Henon
from gaitsweep.examples.hopper import Hopper
from gaitsweep.examples.lorenz import Lorenz


class Logistic(gs.MapModel):
    r = gs.parameter("1", "rate of growth", 4.0)
    x = gs.variable("1", "population", 0.3)

    def image(self, p: Any, s: Any) -> dict[str, Any]:
        return {"x": p.r * s.x * (1.0 - s.x)}


class Delayed(gs.MapModel):
    """The delayed logistic map: an invariant circle is born at a = 2 (Aronson et al. 1982)."""

    a = gs.parameter("1", "rate of growth", 2.1)
    x = gs.variable("1", "population", 0.4)
    y = gs.variable("1", "population before", 0.45)

    def image(self, p: Any, s: Any) -> dict[str, Any]:
        return {"x": p.a * s.x * (1.0 - s.y), "y": s.x}


class Folded(gs.MapModel):
    """A chaotic map whose image is a curve, along which x is the logistic map."""

    r = gs.parameter("1", "rate of growth", 4.0)
    x = gs.variable("1", "population", 0.3)
    y = gs.variable("1", "its double", 0.6)

    def image(self, p: Any, s: Any) -> dict[str, Any]:
        return {"x": p.r * s.x * (1.0 - s.x), "y": 0.7 * s.x}


class StandardMap(gs.MapModel):
    K = gs.parameter("1", "strength of a kick", 0.3)
    angle = gs.variable("rad", "angle", 1.0, circular=True)
    rate = gs.variable("rad", "change of the angle", 0.3)

    def image(self, p: Any, s: Any) -> dict[str, Any]:
        angle = s.angle + s.rate
        return {"angle": angle, "rate": s.rate + p.K * jnp.sin(angle)}


def settled(model: Any, *, cycles: int, exponents: int = 1, engine: str = "kernel", **values: Any) -> Any:
    run = gs.Settle(max_cycles=cycles, exponents=exponents)
    return gs.sweep(model, run=run, engine=engine, **values).table


def pooled(table: pd.DataFrame, name: str = "lyapunov_1") -> tuple[float, float]:
    """The mean of an exponent over rows on one attractor, and its standard error by those of the rows."""
    values, errors = table[name].to_numpy(float), table[f"{name}_error"].to_numpy(float)
    return float(values.mean()), float(np.sqrt(np.sum(errors**2)) / len(values))


@pytest.mark.slow
def test_a_direction_that_a_crossing_extinguishes_has_no_finite_exponent() -> None:
    row = settled(Folded(), cycles=500, exponents=2).iloc[0]
    assert row["lyapunov_1"] == pytest.approx(np.log(2.0), rel=0.05)
    assert (row["lyapunov_2"], np.isnan(row["lyapunov_2_error"])) == (-np.inf, True)


def test_a_tangent_that_is_no_number_has_no_length() -> None:
    lengths, _ = orthonormalised([jnp.eye(3)[0], 2.0 * jnp.eye(3)[0], jnp.full(3, jnp.nan)])
    np.testing.assert_array_equal(lengths, [1.0, 0.0, np.nan])


@pytest.mark.parametrize("engine", ["kernel", pytest.param("xla", marks=pytest.mark.slow)])
def test_the_logistic_map(engine: str) -> None:
    """The exponent is ln 2 at r = 4; that of a stable orbit is the logarithm of its multiplier per step."""
    starts = np.linspace(0.1, 0.4, 16)
    chaotic = settled(Logistic(), r=4.0, x_0=starts, cycles=4000, engine=engine)
    assert set(chaotic["status"]) == {"chaotic"}
    mean, error = pooled(chaotic)
    assert mean == pytest.approx(np.log(2.0), rel=0.01)
    assert abs(mean - np.log(2.0)) < 4.0 * error
    assert chaotic["lyapunov_1"].std() < 2.0 * chaotic["lyapunov_1_error"].mean()
    stable = settled(Logistic(), r=[2.8, 3.2, 3.44], cycles=4000, engine=engine)
    assert set(stable["status"]) == {"settled"}
    multipliers = [2.0 - 2.8, 4.0 + 2.0 * 3.2 - 3.2**2, 4.0 + 2.0 * 3.44 - 3.44**2]
    expected = np.log(np.abs(multipliers)) / [1, 2, 2]
    np.testing.assert_allclose(stable["lyapunov_1"], expected, rtol=0.01)


def test_long_periods_are_not_chaotic() -> None:
    """Periods 16 to 64 of the doubling cascade, and where it accumulates."""
    table = settled(Logistic(), r=[3.566, 3.569, 3.5697, 3.56994567], cycles=4000)
    assert set(table["status"]) == {"cycle_limit"}
    assert (table["lyapunov_1"] < 3.0 * table["lyapunov_1_error"]).all()


def test_the_henon_map() -> None:
    """0.4192 (Benettin et al.; Wolf et al. 1985, Physica 16D:285); the sum of both is ln 0.3."""
    table = settled(Henon(), x_0=np.linspace(-0.2, 0.2, 16), y_0=0.0, cycles=20000, exponents=2)
    assert set(table["status"]) == {"chaotic"}
    assert pooled(table)[0] == pytest.approx(0.4192, rel=0.003)
    np.testing.assert_allclose(table["lyapunov_1"] + table["lyapunov_2"], np.log(0.3), rtol=1e-9)


@pytest.mark.slow
def test_lorenz() -> None:
    """0.9056, 0 and -14.5723 (Sprott 2003, Chaos and Time-Series Analysis, p. 431).

    The section has no exponent 0, which is that along the flow.
    """
    table = settled(Lorenz(), x_0=np.linspace(1.0, 2.0, 16), cycles=4000, exponents=2)
    assert set(table["status"]) == {"chaotic"}
    assert pooled(table)[0] == pytest.approx(0.9056, rel=0.003)
    assert pooled(table, "lyapunov_2")[0] == pytest.approx(-14.5723, rel=0.001)


class LorenzByTime(gs.DeclaredModel):
    """Lorenz's flow with a section at instants, where all three exponents are."""

    name = "lorenz_by_time"
    rho = gs.parameter("1", "Rayleigh number", 28.0)
    t = gs.time()
    x = gs.variable("1", "x", 1.0)
    y = gs.variable("1", "y", 1.0)
    z = gs.variable("1", "z", 1.0)
    instant = gs.instants("instant", every=lambda p: 0.5, section=True)

    def flow(self, p: Any, s: Any) -> dict[str, Any]:
        x, y, z = s.x, s.y, s.z
        return {"t": 1.0, "x": 10.0 * (y - x), "y": x * (p.rho - z) - y, "z": x * y - 8.0 / 3.0 * z}

    def period(self, p: Any) -> Any:
        return jnp.asarray(0.5)


@pytest.mark.slow
def test_all_exponents_of_a_flow() -> None:
    """The one along the flow is 0, and the sum is the trace, -41/3."""
    table = settled(LorenzByTime(), x_0=np.linspace(1.0, 2.0, 16), cycles=4000, exponents=3)
    own = [pooled(table, f"lyapunov_{i}")[0] for i in (1, 2, 3)]
    np.testing.assert_allclose(own, [0.9056, 0.0, -14.5723], atol=0.01)
    np.testing.assert_allclose(sum(table[f"lyapunov_{i}"] for i in (1, 2, 3)), -41.0 / 3.0, rtol=1e-5)


def duffing_by_numpy(balls: int, turns: int) -> float:
    """The largest exponent (1/s) of `Duffing`, by Runge-Kutta steps of order 4 with its variations."""
    d, f, steps = 0.15, 0.3, 200
    h = 2.0 * np.pi / steps

    def rates(t: float, u: np.ndarray) -> np.ndarray:
        x, v, dx, dv = u
        return np.stack([v, f * np.cos(t) - d * v + x - x**3, dv, -d * dv + (1.0 - 3.0 * x**2) * dx])

    u = np.stack([np.linspace(-1.0, 1.0, balls), np.zeros(balls), np.ones(balls), np.zeros(balls)])
    grown = np.zeros(balls)
    for turn in range(turns + 50):
        for k in range(steps):
            t = k * h
            k1 = rates(t, u)
            k2 = rates(t + h / 2, u + h / 2 * k1)
            k3 = rates(t + h / 2, u + h / 2 * k2)
            u = u + h / 6 * (k1 + 2 * k2 + 2 * k3 + rates(t + h, u + h * k3))
        length = np.hypot(u[2], u[3])
        u[2:] /= length
        grown += np.log(length) if turn >= 50 else 0.0
    return float(grown.mean() / (turns * 2.0 * np.pi))


@pytest.mark.slow
def test_duffing() -> None:
    """Beside a loop in NumPy; the sum of both exponents is that of areas, -d."""
    table = settled(Duffing(), x_0=np.linspace(-1.0, 1.0, 32), v_0=0.0, cycles=2000, exponents=2)
    assert set(table["status"]) == {"chaotic"}
    np.testing.assert_allclose(table["lyapunov_1"] + table["lyapunov_2"], -0.15, rtol=1e-6)
    assert pooled(table)[0] == pytest.approx(duffing_by_numpy(256, 150), rel=0.01)


def ball_by_numpy(
    g: float, e: float, balls: int, hits: int
) -> tuple[Float[np.ndarray, 2], Float[np.ndarray, " balls"]]:
    """The exponents (2,) in 1/s of the exact map of `BouncingBall`, with its exact derivative."""
    phase, speed = np.linspace(0.1, 0.8, balls), np.full(balls, 9.0)
    frame = np.broadcast_to(np.eye(2), (balls, 2, 2)).copy()
    logs, time, flies = np.zeros((balls, 2)), np.zeros(balls), np.ones(balls, bool)

    def height(tau: np.ndarray, phase: np.ndarray, speed: np.ndarray) -> np.ndarray:
        return g * np.sin(phase) + speed * tau - tau**2 / 2.0 - g * np.sin(phase + tau)

    for hit in range(hits + 50):
        # the first return to the table, by steps and then by bisection
        low = np.full(balls, 1e-6)
        waits = np.ones(balls, bool)
        while waits.any():
            waits &= height(low + 0.04, phase, speed) > 0.0
            low = np.where(waits, low + 0.04, low)
        high = low + 0.04
        for _ in range(60):
            middle = (low + high) / 2.0
            above = height(middle, phase, speed) > 0.0
            low, high = np.where(above, middle, low), np.where(above, high, middle)
        tau = (low + high) / 2.0
        after = phase + tau
        incoming, table = speed - tau, g * np.cos(after)
        # d tau from height(tau, phase, speed) = 0
        d_tau = -np.stack([g * np.cos(phase) - table, tau], axis=1) / (incoming - table)[:, None]
        d_phase = np.stack([np.ones(balls), np.zeros(balls)], axis=1) + d_tau
        d_speed = -(1.0 + e) * (g * np.sin(after))[:, None] * d_phase
        d_speed -= e * (np.stack([np.zeros(balls), np.ones(balls)], axis=1) - d_tau)
        q, r = np.linalg.qr(np.stack([d_phase, d_speed], axis=1) @ frame)
        frame = q
        if hit >= 50:
            logs += np.log(np.abs(np.diagonal(r, axis1=1, axis2=2)))
            time += tau
        phase, speed = after, table - e * (incoming - table)
        flies &= tau > 1e-5
    return logs[flies].sum(axis=0) / time[flies].sum(), logs[flies].sum(axis=1) / hits


@pytest.mark.slow
def test_a_bouncing_ball_with_its_exact_saltation() -> None:
    """Beside the exact map and its derivative; a hit shrinks areas by e^2 in the mean.

    Balls that come to rest on the table are left out of both.
    """
    run: dict[str, Any] = {"G": 2.0, "restitution": 0.9, "speed_0": 9.0, "cycles": 1000, "exponents": 2}
    table = settled(BouncingBall(), phase_0=np.linspace(0.1, 0.8, 64), **run)
    # few balls come to rest on the table; slow hits give few exponents a large error
    assert set(table["status"]) <= {"chaotic", "event_stall", "cycle_limit"}
    assert (table["status"] == "chaotic").mean() > 0.85
    table = table[table["lyapunov_1"].notna()]
    expected, sums = ball_by_numpy(2.0, 0.9, 512, 250)
    # which checks the reference itself; areas at the first and the last of 250 hits differ
    assert sums.mean() == pytest.approx(2.0 * np.log(0.9), rel=5e-3)
    own = [pooled(table, f"lyapunov_{i}")[0] for i in (1, 2)]
    np.testing.assert_allclose(own, expected, rtol=0.01)


@pytest.mark.slow
def test_a_stable_gait_has_the_logarithm_of_its_multipliers() -> None:
    table = settled(Hopper(), omega=3.7, phase_0=0.4, launch_0=8.3, cycles=400, exponents=2)
    hops = gs.return_map(Hopper(), omega=3.7)
    multipliers = hops.multipliers(hops.fixed_points([0.4, 8.3]))[0]
    hop = 2.0 * np.pi / 3.7
    assert table["status"][0] == "settled"
    # both multipliers have one modulus, so that single hops differ: their sum does not
    both = table["lyapunov_1"] + table["lyapunov_2"]
    assert both[0] == pytest.approx(np.log(np.abs(multipliers)).sum() / hop, rel=1e-3)


@pytest.mark.slow
def test_invariant_circles_are_quasi_periodic() -> None:
    """Above a = 2 the delayed logistic map has an attracting circle, below it a fixed point."""
    table = settled(Delayed(), a=[1.9, 2.02, 2.05, 2.1, 2.15, 2.27], cycles=2000, exponents=2)
    assert table["status"].tolist() == ["settled", *["quasi_periodic"] * 4, "chaotic"]
    assert (table["lyapunov_1"][1:5].abs() < 1e-3).all()
    # a slow spiral is neither
    slow = settled(Delayed(), a=[1.99, 1.995, 1.999], cycles=500)
    assert set(slow["status"]) == {"cycle_limit"}


@pytest.mark.slow
def test_circles_of_a_map_that_keeps_areas_are_not_chaotic() -> None:
    """Neighbours on circles separate in proportion to time, which is no exponent."""
    table = settled(StandardMap(), K=0.3, rate_0=np.linspace(0.2, 2.4, 24), cycles=3000, exponents=2)
    assert "chaotic" not in set(table["status"])
    assert (table["status"] == "quasi_periodic").mean() > 0.5
    np.testing.assert_allclose(table["lyapunov_1"] + table["lyapunov_2"], 0.0, atol=1e-9)


def test_the_exponents_of_a_fixed_point_are_those_of_its_last_crossings() -> None:
    """The crossings before the row stood still do not count, however long the window of its orbits is."""
    way = jnp.linspace(-jnp.inf, -0.1, 22)[:, None]
    logs = jnp.concatenate([jnp.full((10, 1), -0.7), way])
    exponents = dataclasses.replace(Exponents.begun(1, jnp.zeros(1), 32), logs=logs)
    ago = jnp.minimum(jnp.arange(1.0, 33.0), 12.0)
    numbers = jax.jit(lambda: exponents.numbers(jnp.asarray(1), ago))()
    assert float(numbers["lyapunov_1"]) == pytest.approx(-0.7)
    assert float(numbers["lyapunov_1_error"]) == pytest.approx(0.0, abs=1e-15)


def test_rows_that_fail_have_no_exponents() -> None:
    table = settled(Logistic(), r=[4.1], cycles=400)
    assert table["status"][0] == "diverged"
    assert np.isnan(table["lyapunov_1"][0])


def test_exponents_that_a_model_does_not_have_are_refused() -> None:
    with pytest.raises(gs.JobError, match=r"run\.exponents is 3, but the section of henon has 2 coordinates"):
        settled(Henon(), cycles=100, exponents=3)
    with pytest.raises(gs.JobError, match="has no derivative"):
        settled("plane_maps:Logistic", cycles=100, numerics={"dt": 1.0}, engine="auto")


def test_without_exponents_a_row_has_neither_columns_nor_statuses() -> None:
    table = settled(Logistic(), r=[4.0], cycles=400, exponents=0)
    assert table["status"][0] == "cycle_limit"
    assert not [name for name in table if name.startswith("lyapunov")]
