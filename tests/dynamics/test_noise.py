"""Noise in a flow against the Ornstein-Uhlenbeck process, its orders, and events between noisy steps."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

import gaitsweep as gs
from gaitsweep.engine.numerics import Numerics
from gaitsweep.engine.recorders.recordings import FixedTimeRecorder
from gaitsweep.examples.rimless_wheel import RimlessWheel
from tests.support.sweeping import run_rows


class Relaxation(gs.DeclaredModel):
    """Two Ornstein-Uhlenbeck processes, and a third variable whose noise grows with it."""

    theta = gs.parameter("1/s", "rate of relaxation", 2.0)
    x = gs.variable("m", "place", (1.0, -1.0), count=2)
    y = gs.variable("m", "size", 1.0)

    def flow(self, p, s):
        return {"x": -p.theta * s.x, "y": 0.3 * s.y}

    @gs.diffusion
    def noise(self, p, s):
        return {"x": 0.5 + 0.0 * s.x, "y": 0.4 * s.y}

    def period(self, p):
        return 1.0 + 0.0 * p.theta


class NoisyWheel(RimlessWheel):
    """The rimless wheel with noise in its rate."""

    shake = gs.parameter("1", "intensity of the noise, in units of the rate per root of time", 0.0, low=0.0)

    @gs.diffusion
    def noise(self, p, s):
        return {"rate": p.shake}


@dataclasses.dataclass(frozen=True, kw_only=True)
class Shortened(Numerics):
    """The numerics of rows that the self-check repeats with a share of the step."""

    share: float

    def resolve(self, model: Any) -> Any:
        own = {name: value for name, value in vars(self).items() if name != "share"}
        return dataclasses.replace(Numerics(**own).resolve(model), factor=self.share)


def ends(dt: float, share: float, n: int) -> np.ndarray:
    """The ends (n, 3) of paths at t = 1 with steps of a share of dt."""
    starts = {"y_0": np.ones(n)}
    recorder, seeds = FixedTimeRecorder(Relaxation(), 1.0), {"noise_seed": np.arange(float(n))}
    numerics = Shortened(share=share, dt=dt, method="semi_implicit")
    return run_rows(Relaxation(), recorder, starts, params=seeds, numerics=numerics, engine="kernel").samples


@pytest.mark.slow
def test_the_ornstein_uhlenbeck_process_has_its_mean_variance_and_orders() -> None:
    """Means and variances within 4 standard errors of the exact ones of the scheme, and their order.

    With steps h a mean falls by 1 - z + z^2 / 2 and noise by 1 - z / 2, z = theta h: errors of order 2.
    """
    n, theta, h = 40_000, 2.0, 0.0625
    coarse, fine = ends(h, 1.0, n), ends(h, 0.5, n)
    keeps, gain = 1.0 - theta * h + 0.5 * (theta * h) ** 2, 0.5 * (1.0 - 0.5 * theta * h) * np.sqrt(h)
    mean, variance = keeps**16, gain**2 * (1.0 - keeps**32) / (1.0 - keeps**2)
    for column, start in ((0, 1.0), (1, -1.0)):
        assert coarse[:, column].mean() == pytest.approx(start * mean, abs=4.0 * np.sqrt(variance / n))
        assert coarse[:, column].var() == pytest.approx(variance, rel=4.0 * np.sqrt(2.0 / n))
    # the scheme's own are near those of the process, which the bound above would not tell from it
    assert mean == pytest.approx(np.exp(-theta), rel=0.01)
    assert variance == pytest.approx(0.25 / 4.0 * (1.0 - np.exp(-4.0)), rel=0.02)
    assert abs(np.corrcoef(coarse[:, :2].T)[0, 1]) < 4.0 / np.sqrt(n)
    # E y = exp(0.3), whatever the noise: the equation is Ito's, not Stratonovich's, whose mean is exp(0.38)
    assert coarse[:, 2].mean() == pytest.approx(np.exp(0.3), rel=0.01)
    # along one path: half the step halves the error with constant noise, and divides it by sqrt(2) else
    finer, finest = ends(h / 4.0, 1.0, n), ends(h / 4.0, 0.5, n)
    errors = [np.sqrt(((a - b) ** 2).mean(axis=0)) for a, b in ((coarse, fine), (finer, finest))]
    order = np.log(errors[0] / errors[1]) / np.log(4.0)
    np.testing.assert_allclose(order, [1.0, 1.0, 0.5], atol=0.15)


@pytest.mark.slow
def test_events_between_noisy_steps_have_errors_of_second_order_and_engines_agree() -> None:
    run, even = gs.FixedTime(duration=20.0), {"rate_0": 0.9, "slope": 0.2, "run": gs.FixedTime(duration=20.0)}
    exact = gs.sweep(RimlessWheel(), **even, verify=0).table["margin_end"].item()
    errors = [
        abs(gs.sweep(NoisyWheel(), **even, numerics={"dt": dt}, verify=0).table["margin_end"].item() - exact)
        for dt in (0.02, 0.005)
    ]
    assert np.log(errors[0] / errors[1]) / np.log(4.0) > 1.6
    noisy = {"shake": 0.05, "noise_seed": np.arange(6), "slope": 0.2, "run": run, "numerics": {"dt": 0.01}}
    tables = [
        gs.sweep(NoisyWheel(), **noisy, engine=engine, verify=0).table
        for engine in ("kernel", "xla", {"name": "kernel", "lanes": 4, "block": 3})
    ]
    assert tables[0].equals(tables[2])
    rates = [table["rate_end"].to_numpy() for table in tables]
    np.testing.assert_allclose(rates[0], rates[1], rtol=1e-9)
    assert np.unique(rates[0].round(3)).size > 3


def test_noise_needs_a_step_and_has_no_return_map() -> None:
    with pytest.raises(gs.JobError, match=r"numerics.dt"):
        gs.sweep(Relaxation(), run=gs.FixedTime(duration=1.0))
    with pytest.raises(gs.JobError, match="has only steps"):
        gs.sweep(Relaxation(), run=gs.FixedTime(duration=1.0), numerics={"method": "tsit5", "dt": 0.1})
    result = gs.sweep(
        Relaxation(), noise_seed=[1, 2, 3], run=gs.FixedTime(duration=1.0), numerics={"dt": 0.05}
    )
    # the self-check repeats the rows with half the step along the same path
    assert "0.5 of the step" in repr(result)
