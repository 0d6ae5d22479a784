"""Events that begin and end inside one step, against the time at which a sine wave comes over a height."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import gaitsweep as gs
from gaitsweep import DeclaredModel, event, parameter, variable
from gaitsweep.engine.hidden_events import may_hide
from gaitsweep.engine.numerics import Numerics
from gaitsweep.engine.poincare.poincare_return import crossing_of
from gaitsweep.engine.recorders.recordings import CrossingRecorder
from gaitsweep.engine.switches import may_bend, switches_within
from gaitsweep.status import Status
from tests.support.sweeping import run_rows


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Moving:
    """A state of a position `x` that moves and a mode `m` that does not."""

    x: jax.Array
    m: jax.Array


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
    "taylor": (Numerics(method="taylor", dt=0.3, rtol=1e-12, atol=1e-13), [1e-3, 1e-5, 1e-8]),
    "propagator6": (Numerics(method="propagator6", dt=0.1), [1e-4, 1e-6]),
    "propagator": (Numerics(method="propagator", dt=0.3), [1e-3, 1e-6, 1e-8]),
}


@pytest.mark.slow(
    "propagator-kernel",
    "propagator-xla",
    "propagator6-xla",
    "rk4-kernel",
    "rk4-xla",
    "taylor-xla",
    "tsit5-kernel",
    "tsit5-xla",
)
@pytest.mark.parametrize("engine", ["xla", "kernel"])
@pytest.mark.parametrize("method", METHODS)
def test_a_peak_shorter_than_a_step_is_met_at_its_time(method: str, engine: str) -> None:
    numerics, below = METHODS[method]
    result = run_rows(
        Peaks(),
        CrossingRecorder(Peaks(), 6),
        {"x_0": [1.0] * len(below)},
        params={"below": below},
        numerics=numerics,
        engine=engine,
    )
    assert set(result.status.tolist()) == {Status.complete}
    t = result.samples.reshape(len(below), 7, -1)[:, 1:, 1]
    early = np.arccos(1.0 - np.array(below)) / 2.0
    # where the height is met within a graze, an error e of x is one of e / (8 below)^(1/2) in time
    np.testing.assert_allclose(t, np.pi * np.arange(1, 7) - early[:, None], rtol=0, atol=2e-5)
    # some of the steps are longer than the peaks by far
    assert numerics.dt is not None
    assert numerics.dt > 3.0 * early.min()


@pytest.mark.slow("xla")
@pytest.mark.parametrize("engine", ["xla", "kernel"])
def test_a_peak_below_zero_is_not_an_event(engine: str) -> None:
    """A step that peaks 1e-10 below the height is halved about fifteen times and then accepted."""
    numerics = Numerics(method="propagator", dt=0.2)
    result = run_rows(
        Peaks(),
        CrossingRecorder(Peaks(), 1),
        {"x_0": [1.0] * 3},
        params={"below": [-1e-3, -1e-8, -1e-10]},
        numerics=numerics,
        engine=engine,
    )
    assert [Status(status).name for status in result.status] == ["time_limit"] * 3


@pytest.mark.slow
@pytest.mark.parametrize("method", ["rk4", "propagator"])
def test_derivatives_go_through_them(method: str) -> None:
    """A section map that meets a hidden peak has the flow's own derivative: the period does not change."""
    numerics, _ = METHODS[method]
    model = Peaks()
    crossing = crossing_of(model, numerics.resolve(model))
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


def test_may_hide_excludes_guards_without_a_maximum() -> None:
    """Guards at both ends of a step of 1 s, their slope at its beginning, and whether one may hide."""
    cases = [
        (-1.0, 3.0, -1.0, True),  # a parabola with its top at 1/2 and +1/2
        (-1.0, 0.9, -1.0, False),  # the tangent stays below zero
        (-1.0, 1.2, -0.1, False),  # rises all the way, slightly bent
        (-1.0, 1.2, -0.5, True),  # a parabola with its top at 0.86
        (-1.0, 3.0, 0.5, False),  # it fires
        (-1.0, -1.0, -3.0, False),
        (-1e6, 1.0, -1e6, False),  # disarmed
    ]
    for near, slope, end, hides in cases:
        arrays = (jnp.array([-1.0, near]), jnp.array([0.0, slope]), jnp.array([-1.0, end]))
        assert bool(may_hide(*arrays, jnp.asarray(1.0))) is hides, (near, slope, end)
    none = jnp.zeros((0,))
    assert not may_hide(none, none, none, jnp.asarray(1.0))


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Clock:
    clock: jax.Array


# pulses of a clock from 1 s on, of a width
PULSES: dict[str, Callable[[jax.Array, float], Any]] = {
    "comparisons": lambda c, w: (c > 1.0) & (c < 1.0 + w),
    "distance": lambda c, w: jnp.abs(c - 1.0 - w / 2) < w / 2,
    "product": lambda c, w: jnp.where((c - 1.0) * (c - 1.0 - w) < 0.0, 1.0, 0.0),
    "remainder": lambda c, w: jnp.mod(c - 1.0, 2.0) < w,
    "signs": lambda c, w: 0.5 * (jnp.sign(c - 1.0) - jnp.sign(c - 1.0 - w)),
    "steps": lambda c, w: jnp.heaviside(c - 1.0, 0.0) - jnp.heaviside(c - 1.0 - w, 0.0),
    "floor": lambda c, w: jnp.floor((c - 1.0) / w) == 0.0,
    "whole number": lambda c, w: ((c - 1.0) / w + 1.0).astype(int) == 1,
    "jitted": jax.jit(lambda c, w: (c > 1.0) & (c < 1.0 + w)),
    "branch": lambda c, w: jax.lax.cond((c > 1.0) & (c < 1.0 + w), lambda: 1.0, lambda: 0.0),
    "hat": lambda c, w: jnp.maximum(0.0, 1.0 - jnp.abs((c - 1.0) / w)),
    "clipped": lambda c, w: jnp.minimum(jnp.maximum((c - 1.0) / w, 0.0), 1.0) - (c > 1.0 + w),
    "clamped": lambda c, w: jax.lax.clamp(0.0, 1.0 - ((c - 1.0) / w) ** 2, 1.0),
    "bell": lambda c, w: jnp.exp(-(((c - 1.0) / w) ** 2)),
    "smooth steps": lambda c, w: jnp.tanh((c - 1.0) / w) - jnp.tanh((c - 1.0 - 5.0 * w) / w),
}


@pytest.mark.parametrize("form", PULSES)
def test_pulses_are_met_however_they_are_written(form: str) -> None:
    """A step over a pulse is rejected; one beside it is accepted."""

    def flow(width, state):
        return {"clock": jnp.asarray(1.0) + 0.0 * PULSES[form](state.clock, width)}

    @jax.jit
    def too_long(begin: jax.Array, h: jax.Array, width: jax.Array) -> jax.Array:
        ones = {"clock": jnp.asarray(1.0)}
        ends = Clock(begin), Clock(begin + h)
        shows, hides = switches_within(flow, width, ends, (ones, ones), h, lambda s: Clock(begin + s * h))
        return shows | hides

    smooth = form in ("bell", "smooth steps")  # which step control sees if they are wide
    for width in (1e-5, 1e-4, 1e-3) if smooth else (1e-5, 1e-4, 1e-3, 1e-2):
        for begin in 0.85 + 0.013 * np.arange(11):  # the pulse is behind the middle of the step, or before it
            assert too_long(begin, 0.2, width), (begin, width)
    if form not in ("floor", "whole number"):  # which count on outside the pulse
        assert not too_long(0.2, 0.1, 1e-3)
        assert not too_long(1.3, 0.1, 1e-3)


class Pulses(DeclaredModel):
    """u' = -u, and a pulse of area 1 from 1 s of each 2 s on; a u for each way to write it."""

    width = parameter("s", "width of the pulse", 0.01)
    clock = variable("s", "time of the cycle", 0.0, observed=False)
    u = variable("1", "u", 0.0, count=5)

    def flow(self, p, s):
        forms = ("comparisons", "distance", "product", "remainder", "signs")
        on = [jnp.asarray(PULSES[form](s.clock, p.width), float) for form in forms]
        return {"clock": 1.0, "u": -s.u + jnp.stack(on) / p.width}

    @event("2 s are over", section=True)
    def tick(self, p, s):
        return s.clock - 2.0

    @tick.jump
    def again(self, p, s):
        return s.replace(clock=0.0)

    def period(self, p):
        return 2.0 + 0.0 * p.width


@pytest.mark.slow
def test_pulses_have_their_closed_solution() -> None:
    width = np.array([1e-4, 1e-3, 5e-3, 1e-2])
    table = gs.sweep(Pulses, width=width, run=gs.ReturnMap(crossings=1)).table
    last = table[table["crossing"] == 1]
    exact = np.exp(-(1.0 - width)) * (1.0 - np.exp(-width)) / width
    for i in range(1, 6):
        np.testing.assert_allclose(last[f"u_{i}_n"], exact, rtol=2e-6)


@pytest.mark.parametrize(
    ("guard", "bends"),
    [
        (lambda x, w, m: x - 0.3, False),
        (lambda x, w, m: 2.0 * jnp.sin(x) - w, False),
        (lambda x, w, m: jnp.where(m > 0, x - 0.3, -x) / w, False),
        (lambda x, w, m: jnp.where(x > 0.3, 1e-9, -1.0), True),
        (lambda x, w, m: jnp.minimum(1e6 * (x - 0.3), 1e-6 * (x - 0.3)), True),
        (lambda x, w, m: jnp.tan(x), True),
        (lambda x, w, m: w / x, True),
    ],
)
def test_a_guard_that_may_bend_is_found_out(guard: Callable[..., Any], bends: bool) -> None:
    state = Moving(x=jnp.asarray(0.2), m=jnp.asarray(1))

    def guards(params: Any, s: Moving) -> jax.Array:
        return jnp.stack([guard(s.x, params["w"], s.m)])

    assert may_bend(guards, {"w": jnp.asarray(1.0)}, state, {"x": jnp.asarray(1.0)}) is bends
