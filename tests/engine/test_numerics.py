"""The adaptive pair and its tolerances, and the step that a model recommends."""

from __future__ import annotations

from typing import Any, get_args

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import gaitsweep as gs
from firing_neuron import Neuron, firing_times
from gaitsweep import models
from gaitsweep.engine.numerics import Numerics, longest_step, step_of
from gaitsweep.engine.recorders.recordings import CrossingRecorder
from gaitsweep.engine.solver.methods import METHODS, refusal
from gaitsweep.engine.solver.runge_kutta import DIFFERENCE, STAGES
from gaitsweep.errors import ArgumentError
from gaitsweep.job.numerics import MethodName
from gaitsweep.status import Status
from tests.support.sweeping import run_rows, scalars
from toy_model import Toy, bounce_times


def test_tsitouras_coefficients_meet_the_order_conditions() -> None:
    """The weights of order 5 to its 17 conditions' quadratures, the estimate to zero up to order 4."""
    a = np.zeros((7, 7))
    for row, weights in enumerate(STAGES, start=1):
        a[row, : len(weights)] = weights
    c, b, d = a.sum(axis=1), a[6], np.array(DIFFERENCE)
    np.testing.assert_allclose(c, [0, 0.161, 0.327, 0.9, 0.9800255409045097, 1, 1], atol=1e-13)
    ac = a @ c
    for power in range(5):
        assert b @ c**power == pytest.approx(1 / (power + 1), abs=1e-13)
    for power in range(4):
        assert d @ c**power == pytest.approx(0, abs=1e-13)
    assert b @ ac == pytest.approx(1 / 6, abs=1e-13)
    assert b @ (c * ac) == pytest.approx(1 / 8, abs=1e-13)
    assert b @ (a @ c**2) == pytest.approx(1 / 12, abs=1e-13)
    assert b @ (a @ ac) == pytest.approx(1 / 24, abs=1e-13)
    assert b @ (a @ (a @ ac)) == pytest.approx(1 / 120, abs=1e-13)
    assert abs(d @ c**4) > 1e-4, "the estimate sees errors of order 5"


@pytest.mark.slow
@pytest.mark.parametrize("engine", ["xla", "kernel"])
def test_default_numerics_meet_their_tolerance(engine: str) -> None:
    """A neuron that fires and a mass that bounces, in closed form, with tolerances 1e-8 and 1e-10."""
    random = np.random.default_rng(5)
    v_0, current = random.uniform(-0.9, 1.5, 24), random.uniform(0.05, 30.0, 24)
    exact = np.array([firing_times(v, i, 2.0, -1.0, 10) for v, i in zip(v_0, current, strict=True)])
    result = run_rows(
        Neuron(),
        CrossingRecorder(Neuron(), crossings=10),
        {"v_0": v_0},
        params={"current": current},
        engine=engine,
    )
    assert np.all(result.status == Status.complete)
    t = result.samples.reshape(24, 11, -1)[:, 1:, 1]
    assert np.max(np.abs(t - exact) / exact) < 2e-8
    launches = {"launch_1": np.array([0.3, 5.0])}
    t = run_rows(Toy(), CrossingRecorder(Toy(), crossings=12), launches, engine=engine).samples.reshape(
        2, 13, -1
    )[:, 1:, 1]
    for row, launch in enumerate((0.3, 5.0)):
        np.testing.assert_allclose(t[row], bounce_times(launch, 2.0, 0.5, 0.5, 0.5, 12), atol=1e-7)


@pytest.mark.slow
def test_errors_follow_the_tolerance() -> None:
    """A hundred times finer tolerances make errors far smaller, with more attempts."""
    v_0 = np.linspace(-0.9, 1.5, 16)
    exact = np.array([firing_times(v, 30.0, 2.0, -1.0, 10) for v in v_0])
    errors, attempts = [], []
    for rtol in (1e-3, 1e-5, 1e-7):
        numerics = Numerics(rtol=rtol, atol=rtol)
        options: dict[str, Any] = {"params": {"current": 30.0}}
        result = run_rows(
            Neuron(), CrossingRecorder(Neuron(), crossings=10), {"v_0": v_0}, **options, numerics=numerics
        )
        errors.append(np.max(np.abs(result.samples.reshape(16, 11, -1)[:, 1:, 1] - exact)))
        attempts.append(int(result.attempts.sum()))
    assert errors[0] < 1e-3
    assert errors[1] < 0.5 * errors[0]
    assert errors[2] < 0.05 * errors[0], errors
    assert attempts[0] < attempts[1] < attempts[2]


@pytest.mark.slow
def test_float32_rows_are_not_given_tolerances_below_their_resolution() -> None:
    """An adaptive step cannot meet 1e-8 in float32, but rows still end."""
    numerics = Numerics(precision="float32", rtol=1e-5, atol=1e-6)
    result = run_rows(
        Toy(), CrossingRecorder(Toy(), crossings=5), {"launch_1": np.ones(2)}, numerics=numerics
    )
    assert np.all(result.status == Status.complete)
    assert jax.config.read("jax_enable_x64")


@pytest.mark.parametrize("name", models.names())
def test_every_model_has_a_step(name: str) -> None:
    model = models.find(name)()
    params = scalars(model)
    dt = float(step_of(model, Numerics().resolve(model), params))
    assert 0.0 < dt < float(model.period(params)) / 8.0
    longest = longest_step(model, Numerics().resolve(model).method, params)
    assert longest is not None
    assert dt <= float(longest) * (1 + 1e-12)


def test_unknown_numerics_are_refused_with_the_near_miss() -> None:
    assert get_args(MethodName) == ("auto", *METHODS)
    with pytest.raises(ArgumentError, match=r"method is rk5.*rk4"):
        Numerics(method="rk5").resolve(Toy())
    precision: Any = "float46"
    with pytest.raises(ArgumentError, match=r"precision is float46.*float64"):
        Numerics(precision=precision).resolve(Toy())


@pytest.mark.parametrize("name", ["dt", "rtol", "atol", "event_tolerance"])
@pytest.mark.parametrize("value", [0.0, -1e-3, np.nan, np.inf])
def test_steps_and_tolerances_are_numbers_above_0(name: str, value: float) -> None:
    fields: dict[str, Any] = {name: value}
    with pytest.raises(ArgumentError, match=f"numerics.{name} is {value:g}"):
        Numerics(**fields).resolve(Toy())


class Stopped(gs.DeclaredModel):
    """A linear decay; `whole` is whether its derivative is that of the flow, which `stop_gradient` hides."""

    linear = True
    whole = False
    x = gs.variable("1", "what decays", 1.0)
    rate = gs.parameter("1/s", "rate", 1.0)

    def flow(self, p, s):
        return {"x": -p.rate * (s.x if self.whole else jax.lax.stop_gradient(s.x))}

    def period(self, p):
        return 1.0 / p.rate


@pytest.mark.parametrize("method", ["propagator", "propagator6"])
def test_methods_by_the_flows_derivative_refuse_a_flow_that_hides_it(method: str) -> None:
    """Without the derivative their steps would be those of Euler's method."""

    class Whole(Stopped):
        whole = True

    assert refusal(method, Whole(), "float64") is None
    hides = refusal(method, Stopped(), "float64")
    assert hides is not None
    assert "stop_gradient" in hides
    assert "Allowed: tsit5" in hides


class Oscillation(gs.DeclaredModel):
    """A mass on a spring whose force is a function of its position, said to be linear."""

    linear = True
    x = gs.variable("m", "position", 1.0)
    v = gs.variable("m/s", "velocity")
    w = gs.parameter("rad/s", "frequency", 1.0)

    def flow(self, p, s):
        return {"x": s.v, "v": -(p.w**2) * self.force(s.x)}

    def force(self, x):
        return x * (x > 0.0) + jnp.maximum(x, 0.5) + jnp.sign(x) * x / 3.0

    def period(self, p):
        return 6.0 / p.w


@pytest.mark.parametrize(
    ("operation", "force"),
    [("sin", jnp.sin), ("mul", lambda x: x * jnp.abs(x)), ("integer_pow", lambda x: x - x**3 / 6.0)],
)
def test_a_flow_that_is_said_to_be_linear_and_is_not_is_refused(operation: str, force: Any) -> None:
    """Methods for linear flows would make steps of order 2 without a word."""

    class Wrong(Oscillation):
        def force(self, x):
            return force(x)

    wrong = refusal("propagator6", Wrong(), "float64")
    assert wrong is not None
    assert f"'{operation}'" in wrong
    assert "Allowed: tsit5" in wrong
    # a flow that is linear between switches is none
    assert refusal("propagator6", Oscillation(), "float64") is None
