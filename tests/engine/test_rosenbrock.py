"""Rodas5P: its order, its linear solver, stiff flows beside SciPy's LSODA, events, and the choice by auto."""

from __future__ import annotations

import dataclasses
import types
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import gaitsweep as gs
from gaitsweep.engine.numerics import Numerics
from gaitsweep.engine.solver.rosenbrock import _factorised, _solved, rodas5p
from gaitsweep.examples.duffing import Duffing
from tests.support.sweeping import scalars


class VanDerPol(gs.DeclaredModel):
    """Van der Pol's oscillator; the section is the largest displacement."""

    mu = gs.parameter("1", "damping", 1000.0, low=0.0)
    x = gs.variable("1", "displacement", 2.0)
    v = gs.variable("1/s", "velocity", 0.0)

    def flow(self, p: Any, s: Any) -> dict[str, Any]:
        return {"x": s.v, "v": p.mu * (1.0 - s.x**2) * s.v - s.x}

    @gs.event("top", section=True)
    def top(self, p: Any, s: Any) -> Any:
        return -s.v

    def period(self, p: Any) -> Any:
        return 2.0 * jnp.pi + (3.0 - 2.0 * jnp.log(2.0)) * p.mu


class Foot(gs.DeclaredModel):
    """A mass that falls on a heavily damped ground, and sinks into it at g/D after a transient of m/D."""

    D = gs.parameter("1/s", "damping of the ground over the mass", 1e6, low=0.0)
    z = gs.variable("m", "height", 1.0)
    u = gs.variable("m/s", "speed upwards", 0.0)
    stands = gs.mode(False, "whether the foot touches the ground")
    t = gs.time()

    def flow(self, p: Any, s: Any) -> dict[str, Any]:
        return {"z": s.u, "u": -9.81 - jnp.where(s.stands, p.D * s.u, 0.0), "t": 1.0}

    @gs.event("touchdown", during=lambda s: ~s.stands)
    def touchdown(self, p: Any, s: Any) -> Any:
        return -s.z

    @touchdown.jump
    def land(self, p: Any, s: Any) -> Any:
        return s.replace(stands=True)

    @gs.event("depth", section=True)
    def depth(self, p: Any, s: Any) -> Any:
        return -2e-5 - s.z

    def period(self, p: Any) -> Any:
        return 1.0


@pytest.mark.slow
def test_steps_converge_with_order_five() -> None:
    """Four seconds of Duffing's oscillator, beside SciPy's DOP853."""
    model = Duffing()
    params = scalars(model)
    state = model.init(params, {"t_0": jnp.asarray(0.0), "x_0": jnp.asarray(1.5), "v_0": jnp.asarray(0.0)})
    step = jax.jit(rodas5p(model))

    def rates(t: float, y: np.ndarray) -> list[float]:
        return [y[1], 0.3 * np.cos(t) - 0.15 * y[1] + y[0] - y[0] ** 3]

    reference = solve_ivp(rates, (0.0, 4.0), [1.5, 0.0], method="DOP853", rtol=1e-13, atol=1e-14).y[:, -1]
    errors = []
    for n in (16, 32, 64):
        at = state
        for _ in range(n):
            at, _error = step(params, at, jnp.asarray(4.0 / n))
        errors.append(np.hypot(float(at.x) - reference[0], float(at.v) - reference[1]))
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert np.all((orders > 4.7) & (orders < 5.4)), (errors, orders)


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Velocity:
    u: jax.Array


def test_a_body_starts_from_rest_although_its_speed_has_no_derivative_there() -> None:
    """Its drag is the square of the speed: u = tanh(t)."""
    model: Any = types.SimpleNamespace(flow=lambda _, state: {"u": 1.0 - jnp.sqrt(state.u**2) * state.u})
    end, _ = jax.jit(rodas5p(model))(None, Velocity(jnp.zeros(())), jnp.asarray(0.01))
    # an error of order 6 in the step
    assert float(end.u) == pytest.approx(np.tanh(0.01), abs=1e-12)


def test_the_linear_solver_exchanges_rows() -> None:
    """Matrices with zeros and small numbers on their diagonal, beside NumPy."""
    random = np.random.default_rng(0)
    for size in (1, 2, 5, 8):
        matrix = random.normal(size=(size, size))
        if size > 1:
            matrix[np.diag_indices(size)] = np.where(np.arange(size) % 2, 1e-18, 0.0)
        right = random.normal(size=size)
        factors = _factorised([[jnp.asarray(number) for number in row] for row in matrix])
        solution = np.array(_solved(factors, [jnp.asarray(number) for number in right]))
        np.testing.assert_allclose(solution, np.linalg.solve(matrix, right), rtol=1e-9)


@pytest.mark.parametrize("engine", ["kernel", pytest.param("xla", marks=pytest.mark.slow)])
def test_the_period_of_a_relaxation_oscillation(engine: str) -> None:
    """The limit cycle of Van der Pol at mu = 1000, whose rates differ by 1e7, beside SciPy's LSODA."""

    def rates(t: float, y: np.ndarray) -> list[float]:
        return [y[1], 1000.0 * (1.0 - y[0] ** 2) * y[1] - y[0]]

    def top(t: float, y: np.ndarray) -> float:
        return y[1]

    top.direction = -1.0  # type: ignore[attr-defined]
    run: dict[str, Any] = {"method": "LSODA", "rtol": 1e-10, "atol": 1e-13, "events": top}
    tops = solve_ivp(rates, (0.0, 3300.0), [2.0, 0.0], **run).t_events[0]
    reference = float(tops[-1] - tops[-2])

    table = gs.sweep(
        VanDerPol(),
        x_0=[2.0, 1.5],
        run={"kind": "return_map", "crossings": 3},
        numerics={"method": "rodas5p", "rtol": 1e-9, "atol": 1e-12},
        engine={"name": engine},
        verify=0,
    ).table
    periods = table.groupby("row")["t"].agg(lambda t: t.iloc[-1] - t.iloc[-2])
    np.testing.assert_allclose(periods, reference, rtol=1e-7)


@pytest.mark.slow
def test_an_event_among_stiff_modes() -> None:
    """A depth in the ground, met within a transient or long after one of 1e-6 s, in closed form."""
    table = gs.sweep(
        Foot(),
        D=[1e4, 1e6],
        run={"kind": "settle", "max_cycles": 1},
        numerics={"rtol": 1e-9, "atol": 1e-14},
        verify=0,
    ).table
    g = 9.81
    landing = np.sqrt(2.0 / g)
    for D, t in zip([1e4, 1e6], table["t_end"], strict=True):
        T = t - landing
        depth = g * T / D + (g * landing - g / D) * (1.0 - np.exp(-D * T)) / D
        assert depth == pytest.approx(2e-5, rel=1e-6)


@pytest.mark.parametrize(
    ("mu", "method"), [([1.0, 10.0], "tsit5"), ([1.0, 1000.0], "rodas5p"), ([1000.0, 1.0], "rodas5p")]
)
def test_auto_takes_it_where_a_row_is_stiff(mu: list[float], method: str) -> None:
    result = gs.sweep(VanDerPol(), mu=mu, run={"kind": "return_map", "crossings": 1}, verify=0)
    assert result.manifest["job"]["numerics"]["method"] == method
    assert Numerics().resolve(VanDerPol()).method == "tsit5"  # of which no rows are known


@pytest.mark.slow
def test_return_maps_have_derivatives_through_it() -> None:
    """The multiplier of Van der Pol's cycle, exp of the integral of the flow's divergence (Liouville)."""
    mapping = gs.return_map(VanDerPol(), mu=1.0, numerics={"method": "rodas5p", "rtol": 1e-10, "atol": 1e-12})
    cycle = mapping.fixed_points(mapping.settled(cycles=20))
    top = float(cycle.points.at[0, 0])

    def rates(t: float, y: np.ndarray) -> list[float]:
        return [y[1], (1.0 - y[0] ** 2) * y[1] - y[0], 1.0 - y[0] ** 2]

    period = 6.6632868593231  # of mu = 1, where the section is met again to 1e-9 in x
    end = solve_ivp(rates, (0.0, period), [top, 0.0, 0.0], rtol=1e-10, atol=1e-12).y[:, -1]
    assert end[:2] == pytest.approx([top, 0.0], abs=1e-7)
    divergence = end[2]
    assert np.max(np.abs(mapping.multipliers(cycle))) == pytest.approx(np.exp(divergence), rel=1e-5)


class Applied(VanDerPol):
    """The oscillator, with an operation that JAX cannot differentiate."""

    def flow(self, p, s):
        rates = super().flow(p, s)
        return {**rates, "x": jnp.stack([rates["x"], s.x]).at[1].apply(jnp.sin)[0]}


@jax.custom_vjp
def own_sine(x):
    return jnp.sin(x)


own_sine.defvjp(lambda x: (own_sine(x), x), lambda x, cotangent: (cotangent * jnp.cos(x),))


class OnlyBackwards(VanDerPol):
    """The oscillator, with a function that has a derivative in reverse mode alone."""

    def flow(self, p, s):
        return {**super().flow(p, s), "x": s.v + 0.0 * own_sine(s.x)}


@pytest.mark.slow
@pytest.mark.parametrize("kind", [Applied, OnlyBackwards])
def test_a_flow_without_derivative_runs_by_default_and_is_refused_where_one_is_needed(kind) -> None:
    once = {"mu": [1.0], "run": {"kind": "return_map", "crossings": 1}, "verify": 0}
    assert gs.sweep(kind(), **once).table["t"].iloc[-1] == pytest.approx(6.7, abs=0.1)
    with pytest.raises(gs.JobError, match=r"takes the flow's derivative, but JAX has none"):
        gs.sweep(kind(), **once, numerics={"method": "rodas5p"})
