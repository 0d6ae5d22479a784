"""Crossings and windows of samples of one run, against the closed form of the bouncing mass."""

from __future__ import annotations

import numpy as np
import pytest

from gaitsweep.engine.numerics import Numerics
from gaitsweep.engine.recorders.windows import WindowsRecorder
from gaitsweep.status import Status
from tests.support.sweeping import run_rows
from toy_model import Toy, bounce_times, launches

W, D = 2.0, 0.5  # rad/s, m: the toy's defaults


@pytest.mark.parametrize("engine", [pytest.param("xla", marks=pytest.mark.slow), "kernel"])
def test_every_crossing_and_the_samples_of_each_window_are_kept(engine: str) -> None:
    """Three windows of 50 samples, at 0 s, 4 s and 7 s, have more samples than the buffer holds."""
    launch = 1.3
    recorder = WindowsRecorder(Toy(), every=0.02, samples=50, first=0.0, second=4.0, spacing=3.0, more=2)
    assert recorder.duration == pytest.approx(7.98)
    result = run_rows(Toy(), recorder, {"launch_1": [launch, 0.9]}, numerics=Numerics(dt=1e-3), engine=engine)
    assert np.all(result.status == Status.complete)
    samples = result.samples[result.owner == 0]
    bounces = np.concatenate([[0.0], bounce_times(launch, W, D, 0.5, 0.5, 12)])
    speeds = launches(launch, 0.5, 0.5, 12)
    crossed = samples[:, 0] >= 0.0
    number = samples[crossed, 0].astype(int)
    np.testing.assert_array_equal(number, np.arange(np.count_nonzero(bounces <= recorder.duration)))
    # events are located to 1e-12 s, the method's own error is larger
    np.testing.assert_allclose(samples[crossed, 1], bounces[number], rtol=0, atol=1e-9)
    np.testing.assert_allclose(samples[crossed, 2], speeds[number], rtol=0, atol=1e-9)
    t, height = samples[~crossed, 1], samples[~crossed, 3]
    windows = (np.array([0.0, 4.0, 7.0])[:, None] + 0.02 * np.arange(50)).ravel()
    np.testing.assert_allclose(t, windows, rtol=0, atol=1e-9)
    flight = np.searchsorted(bounces, t, side="right") - 1
    since, u = t - bounces[flight], speeds[flight]
    np.testing.assert_allclose(height, -D + D * np.cos(W * since) + u / W * np.sin(W * since), atol=1e-9)
