"""Traces, crossings and ramps against the closed form of the bouncing masses."""

from __future__ import annotations

import dataclasses
import re

import jax.numpy as jnp
import numpy as np
import pytest

from gaitsweep.engine.numerics import Numerics
from gaitsweep.engine.recorders.parameter_schedules import RampSchedule
from gaitsweep.engine.recorders.recorder import DIVERGED
from gaitsweep.engine.recorders.recordings import (
    CrossingRecorder,
    FixedTimeRecorder,
    TraceRecorder,
    WindowsRecorder,
    end_values,
)
from gaitsweep.row_outcome import RowOutcome
from gaitsweep.status import Status
from tests.support.sweeping import run_rows
from toy_model import Toy, bounce_times, launches

W, D = 2.0, 0.5  # rad/s, m: the toy's defaults


@pytest.mark.slow
def test_trace_samples_are_at_their_times() -> None:
    """Heights at given times, through bounces, against the closed form."""
    launch = 1.3
    result = run_rows(
        Toy(),
        TraceRecorder(Toy(), duration=3.0, every=0.05),
        {"launch_1": launch},
        numerics=Numerics(dt=1e-3),
    )
    t, height = result.samples[:, 0], result.samples[:, 1]
    np.testing.assert_allclose(t, 0.05 * np.arange(61), rtol=0, atol=1e-12)
    bounces = np.concatenate([[0.0], bounce_times(launch, W, D, 0.5, 0.5, 12)])
    speeds = launches(launch, 0.5, 0.5, 12)
    flight = np.searchsorted(bounces, t, side="right") - 1
    since, u = t - bounces[flight], speeds[flight]
    exact = -D + D * np.cos(W * since) + u / W * np.sin(W * since)
    np.testing.assert_allclose(height, exact, rtol=0, atol=1e-10)


@pytest.mark.slow
def test_trace_counts_from_the_crossing_that_it_waits_for() -> None:
    result = run_rows(Toy(), TraceRecorder(Toy(), duration=0.2, every=0.1, after_cycles=4), {"launch_1": 1.3})
    np.testing.assert_allclose(result.samples[:, 0], [0.0, 0.1, 0.2], atol=1e-12)
    speed = launches(1.3, 0.5, 0.5, 4)[4]
    np.testing.assert_allclose(result.samples[0, 1:], [0.0, speed], atol=1e-9)


def test_a_hold_ends_in_time_at_its_last_crossing() -> None:
    launch, duration = 1.3, 7.0
    result = run_rows(
        Toy(), FixedTimeRecorder(Toy(), duration), {"launch_1": [launch, 0.9]}, numerics=Numerics(dt=1e-3)
    )
    assert np.all(result.status == Status.complete)
    np.testing.assert_allclose(result.t_end, duration, rtol=0, atol=1e-12)
    bounces = bounce_times(launch, W, D, 0.5, 0.5, 40)
    assert result.cycles[0] == np.count_nonzero(bounces < duration)
    np.testing.assert_allclose(result.last[0, 0], launches(launch, 0.5, 0.5, 40)[result.cycles[0]], atol=1e-9)
    assert np.all(result.labels["gait"] >= 0)


@pytest.mark.slow
def test_full_buffers_lose_no_crossing() -> None:
    """More crossings come between two visits of the host than a buffer holds: the row waits, none is lost."""
    count = 700
    result = run_rows(
        Toy(),
        CrossingRecorder(Toy(), crossings=count),
        {"launch_1": [1.0, 0.7]},
        numerics=Numerics(dt=0.5),
        lanes=2,
    )
    assert np.all(result.status == Status.complete)
    for row in (0, 1):
        crossing = result.samples[result.owner == row, 0]
        np.testing.assert_array_equal(crossing, np.arange(count + 1))


@pytest.mark.slow
def test_crossings_after_some_cycles() -> None:
    result = run_rows(Toy(), CrossingRecorder(Toy(), crossings=3, after_cycles=5), {"launch_1": 1.3})
    np.testing.assert_array_equal(result.samples[:, 0], [5, 6, 7, 8])
    np.testing.assert_allclose(result.samples[:, 2], launches(1.3, 0.5, 0.5, 8)[5:], atol=1e-9)


def test_path_of_a_ramp() -> None:
    """Up, down and up again, with a hold at the start; passes are counted from zero."""
    path = RampSchedule((2.0, 3.2, 2.0), rate=0.1, initial_dwell=5.0)
    assert abs(path.duration - 29.0) < 1e-12
    t = np.array([0.0, 5.0, 11.0, 17.0, 23.0, 29.0, 40.0])
    np.testing.assert_allclose(path.at(jnp.asarray(t)), [2.0, 2.0, 2.6, 3.2, 2.6, 2.0, 2.0], atol=1e-12)
    np.testing.assert_array_equal(path.passes(t), [0, 0, 0, 1, 1, 1, 1])


@pytest.mark.slow
def test_a_slow_ramp_follows_the_fixed_point() -> None:
    """The launch speed follows kick/(1 - restitution) as the kick moves up and down; starts are forgotten."""
    model = Toy()
    path = RampSchedule((0.5, 1.0, 0.5), rate=0.01, initial_dwell=10.0)

    def drive(values, t):
        return model.params({**values, "kick": path.at(t)})

    result = run_rows(
        model,
        CrossingRecorder(model, duration=path.duration),
        {"launch_1": [0.3, 2.0]},
        numerics=Numerics(dt=5e-3),
        drive=drive,
    )
    assert np.all(result.status == Status.complete)
    assert np.all(result.t_end == path.duration)
    for row in (0, 1):
        t, launch = result.samples[result.owner == row, 1:3].T
        late = t > 8.0
        followed = np.asarray(path.at(jnp.asarray(t[late]))) / 0.5
        # a bounce lags by about one flight: rate x flight time x the map's memory
        assert np.abs(launch[late] - followed).max() < 0.03


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


@pytest.mark.slow
def test_labels_and_ends_of_rows_in_single_precision_are_computed_in_double() -> None:
    """Whether or not all rows of a block have samples."""
    in_single = Numerics(precision="float32")
    recorder = CrossingRecorder(Toy(), 5, gaits=True)
    rows = run_rows(Toy(), recorder, {"launch_1": [0.3, 1.3]}, numerics=in_single, engine="xla")
    assert rows.samples.dtype == np.float32
    after_start = rows.samples[:, 0] > 0
    launch = rows.samples[after_start, 2].astype(float)
    apex = np.sqrt(D**2 + (launch / W) ** 2) - D
    np.testing.assert_allclose(rows.sample_labels["apex"][after_start], apex, rtol=1e-12)
    for counts in ([1, 1], [1, 0]):
        ended = RowOutcome.empty(np.arange(2), (), 1, 1)
        samples = np.ones((sum(counts), 1), np.float32)
        ended = dataclasses.replace(ended, record_counts=np.array(counts), samples=samples)
        assert end_values(ended).dtype == np.float64


def test_the_bound_of_divergence_is_told() -> None:
    """It is in each variable's own unit, so a model in micrometres may meet it."""
    told = re.findall(r"past (\S+) in its own unit", Status.diverged.sentence)
    assert [float(number) for number in told] == [DIVERGED]
