"""Events that begin and end inside one step, against the time at which a sine wave comes over a height."""

from __future__ import annotations

from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from sweeping import run_rows

from gaitsweep import DeclaredModel, event, parameter, variable
from gaitsweep.contract import Status
from gaitsweep.engine.advance import Numerics
from gaitsweep.engine.hidden_events import may_hide
from gaitsweep.engine.poincare.poincare_return import crossing_of
from gaitsweep.engine.recorders.crossings import CrossingRecorder


class Peaks(DeclaredModel):
    """x = cos(2 t) comes over the height 1 - `below` once a cycle, for a time of about (2 below)^(1/2)."""

    linear: ClassVar[bool] = True
    below = parameter("1", "distance of the section from the peak", 1e-4)
    x = variable("1", "position", 1.0)
    v = variable("1/s", "velocity", 0.0)

    def flow(self, p, s):
        return {"x": s.v, "v": -4.0 * s.x}

    @event("x comes over the height", section=True)
    def rises(self, p, s):
        return s.x - (1.0 - p.below)

    def period(self, p):
        return jnp.asarray(jnp.pi)


METHODS = {
    # the step's own error has to be smaller than the peaks that it should see
    "rk4": (Numerics(method="rk4", dt=0.02), [1e-5, 1e-6]),
    "tsit5": (Numerics(method="tsit5", dt=0.1, rtol=1e-12, atol=1e-13), [1e-5, 1e-8]),
    "propagator6": (Numerics(method="propagator6", dt=0.1), [1e-4, 1e-6]),
    "propagator": (Numerics(method="propagator", dt=0.3), [1e-3, 1e-6, 1e-8]),
}


@pytest.mark.parametrize("engine", ["xla", "kernel"])
@pytest.mark.parametrize("method", METHODS)
def test_a_peak_shorter_than_a_step_is_met_at_its_time(method: str, engine: str) -> None:
    numerics, below = METHODS[method]
    found = run_rows(
        Peaks(),
        CrossingRecorder(Peaks(), 6),
        {"x_0": [1.0] * len(below)},
        params={"below": below},
        numerics=numerics,
        engine=engine,
    )
    assert set(found.status.tolist()) == {Status.complete}
    t = found.samples.reshape(len(below), 7, -1)[:, 1:, 1]
    early = np.arccos(1.0 - np.array(below)) / 2.0
    # where the height is met within a graze, an error e of x is one of e / (8 below)^(1/2) in time
    np.testing.assert_allclose(t, np.pi * np.arange(1, 7) - early[:, None], rtol=0, atol=2e-5)
    # some of the steps are longer than the peaks by far
    assert numerics.dt is not None
    assert numerics.dt > 3.0 * early.min()


@pytest.mark.parametrize("engine", ["xla", "kernel"])
def test_a_peak_that_stays_below_is_no_event_and_ends_the_search(engine: str) -> None:
    """At 1e-10 below the height the steps are halved some fifteen times, then they pass."""
    numerics = Numerics(method="propagator", dt=0.2)
    found = run_rows(
        Peaks(),
        CrossingRecorder(Peaks(), 1),
        {"x_0": [1.0] * 3},
        params={"below": [-1e-3, -1e-8, -1e-10]},
        numerics=numerics,
        engine=engine,
    )
    assert [Status(status).name for status in found.status] == ["time_limit"] * 3


@pytest.mark.parametrize("method", ["rk4", "propagator"])
def test_derivatives_go_through_them(method: str) -> None:
    """A section map that meets a hidden peak has the flow's own derivative: the period does not change."""
    numerics, _ = METHODS[method]
    model = Peaks()
    crossing = crossing_of(model, numerics)
    below = 1e-5

    def time(at: jax.Array) -> jax.Array:
        params = model.params({"below": at})
        state = model.init(params, {"x_0": jnp.asarray(1.0), "v_0": jnp.asarray(0.0)})
        return crossing(params, state)[0]

    value, slope = jax.jvp(time, (jnp.asarray(below),), (jnp.asarray(1.0),))
    assert abs(value - (np.pi - np.arccos(1.0 - below) / 2.0)) < 1e-6
    # d/d below of -arccos(1 - below) / 2
    expected = -1.0 / (2.0 * np.sqrt(2.0 * below - below**2))
    assert abs(slope / expected - 1.0) < 1e-3


def test_what_cannot_have_turned_is_not_looked_at_again() -> None:
    """Guards at both ends of a step of 1 s, their slope at its beginning, and whether one may hide."""
    cases = [
        (-1.0, 3.0, -1.0, True),  # a parabola with its top at 1/2 and +1/2
        (-1.0, 0.9, -1.0, False),  # the tangent stays below zero
        (-1.0, 1.2, -0.1, False),  # rises all the way, slightly bent
        (-1.0, 1.2, -0.5, True),  # a parabola with its top at .86
        (-1.0, 3.0, 0.5, False),  # it fires
        (-1.0, -1.0, -3.0, False),
        (-1e6, 1.0, -1e6, False),  # disarmed
    ]
    for near, slope, end, hides in cases:
        arrays = (jnp.array([-1.0, near]), jnp.array([0.0, slope]), jnp.array([-1.0, end]))
        assert bool(may_hide(*arrays, jnp.asarray(1.0))) is hides, (near, slope, end)
    none = jnp.zeros((0,))
    assert not may_hide(none, none, none, jnp.asarray(1.0))
