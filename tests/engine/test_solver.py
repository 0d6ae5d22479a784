"""Methods of stepping: their order, their stability, and the chain that they are made for."""

from __future__ import annotations

import csv
import dataclasses
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from reference import exponential_polynomial

import gaitsweep as gs
from firing_neuron import Neuron
from gaitsweep import models
from gaitsweep.contract import HybridModel
from gaitsweep.engine.numerics import Numerics
from gaitsweep.engine.poincare.poincare_return import crossing_of
from gaitsweep.engine.recorders.recordings import CrossingRecorder
from gaitsweep.engine.recorders.settle import SettleRecorder
from gaitsweep.engine.solver.exponential import PROPAGATOR, PROPAGATOR6
from gaitsweep.engine.solver.methods import METHODS, refusal
from gaitsweep.papers.ambe2021.multilegged.model import Multilegged
from gaitsweep.status import Status
from tests.support.sweeping import run_rows, scalars
from toy_model import Toy, flight_time

REFERENCE = Path(__file__).parents[1] / "reference" / "multilegged_crossings.csv"
LINEAR = [cls() for cls in (*map(models.find, models.names()), Toy) if getattr(cls, "linear", False)]
# dt (s) that leaves a third of the range of stability to rows with lighter masses
LONG = {"rk4": 4e-3, "propagator6": 32e-3, "propagator": 32e-3}


@pytest.mark.parametrize(
    ("name", "order", "counts"),
    [("rk4", 4, (40, 50, 60, 80)), ("propagator6", 6, (7, 9, 12, 16)), ("propagator", 8, (7, 9, 12, 16))],
)
def test_order_on_a_linear_flow(name: str, order: int, counts: tuple[int, ...]) -> None:
    """A free oscillation, w = 2 rad/s, over 4 s in so many steps, against its cosine."""
    model = Toy()
    params = scalars(model, stiffness=4.0, mass=1.0, preload=0.5)
    of = METHODS[name].step
    assert of is not None
    step = jax.jit(of(model))
    begin = model.init(params, {"launch_1": jnp.asarray(1.0)})
    begin = dataclasses.replace(begin, height=jnp.array([0.7]), speed=jnp.array([0.0]))
    errors = []
    for count in counts:
        state = begin
        for _ in range(count):
            state = step(params, state, jnp.asarray(4.0 / count))
        errors.append(abs(float(state.height[0]) - (1.2 * np.cos(8.0) - 0.5)))
    slope = -np.polyfit(np.log(counts), np.log(errors), 1)[0]
    assert abs(slope - order) < 0.2, (slope, errors)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kept", "order"), [(PROPAGATOR6, 6), (PROPAGATOR, 8)], ids=["propagator6", "propagator"]
)
def test_polynomials_are_the_best_of_their_degree(kept: tuple[float, ...], order: int) -> None:
    """Their error exceeds that of a new fit by at most a fiftieth, and they are bounded beyond its range."""
    z = -np.linspace(0.0, 20.0, 4001)
    anew = exponential_polynomial.shares(order, len(kept), 20.0)
    worst, least = (np.abs(exponential_polynomial.value(s, z) - np.exp(z)).max() for s in (kept, anew))
    assert worst < 1.02 * least
    assert np.abs(exponential_polynomial.value(kept, -np.linspace(20.0, 21.4, 100))).max() <= 1.0
    for degrees, radius in ((15.0, 17.0), (30.0, 12.0), (45.0, 8.9)):
        ray = np.linspace(0.0, radius, 2000) * np.exp(1j * np.radians(180.0 - degrees))
        assert np.abs(exponential_polynomial.value(kept, ray)).max() <= 1.0 + 1e-12


@pytest.mark.parametrize("model", LINEAR, ids=lambda model: model.name)
def test_flows_declared_linear_are_linear(model: HybridModel) -> None:
    """Twice the displacement changes the flow by twice as much, in the modes of the start."""
    params = scalars(model)
    start = {
        q.name: jnp.asarray(0.7 if q.default is None else float(q.default)) for q in model.initial_conditions
    }
    flow = jax.jit(model.flow)
    state = jax.jit(model.init)(params, start)
    rates = flow(params, state)
    random = np.random.default_rng(0)
    way = {name: random.normal(size=rate.shape) for name, rate in rates.items()}

    def at(share: float) -> dict[str, jax.Array]:
        moved = {name: getattr(state, name) + share * way[name] for name in way}
        return flow(params, dataclasses.replace(state, **moved))

    once, twice = at(1.0), at(2.0)
    for name, rate in rates.items():
        np.testing.assert_allclose(
            twice[name] - rate, 2.0 * (once[name] - rate), rtol=1e-9, atol=1e-9 * np.abs(once[name]).max()
        )


def crossings_of(chosen: str) -> np.ndarray:
    """Psi (rad) at crossings 0..10 of one set of reference starts, (starts, 11, 3)."""
    with REFERENCE.open() as file:
        rows = [row for row in csv.DictReader(x for x in file if x[0] != "#") if row["set"] == chosen]
    psi = np.array([[float(row[f"psi_{i}"]) for i in (1, 2, 3)] for row in rows])
    return psi.reshape(-1, 11, 3)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "chosen", "params", "bound"),
    [
        ("rk4", "base", {}, 1e-7),
        ("propagator6", "base", {}, 2e-8),
        ("propagator", "base", {}, 3e-11),
        ("propagator6", "masses", {"m_1": 0.85, "m_end": 0.95}, 1e-8),
        ("propagator", "beta", {"beta": 0.7}, 3e-11),
        # the clamp's kink is not an event, and the step does not see it
        ("propagator6", "clamp", {"clamp": 1.0}, 1e-4),
    ],
)
def test_crossings_of_the_chain(name: str, chosen: str, params: dict[str, float], bound: float) -> None:
    """Ten crossings of every start; an event that is missed or taken late costs 1e-6 and more."""
    true = crossings_of(chosen)
    starts = {f"psi_{i + 1}": true[:, 0, i] for i in range(3)}
    result = run_rows(
        Multilegged(),
        CrossingRecorder(Multilegged(), crossings=10),
        starts,
        params=params,
        numerics=Numerics(dt=LONG[name], method=name),
        lanes=len(true),
    )
    assert np.all(result.status == Status.complete)
    found = result.samples.reshape(len(true), 11, -1)[:, 1:, 2:5]
    gap = np.abs(found - true[:, 1:]) % (2.0 * np.pi)
    assert np.minimum(gap, 2.0 * np.pi - gap).max() < bound
    # located events included; rk4 takes 4 170
    assert result.attempts.max() / 10 < (4400 if name == "rk4" else 900)


@pytest.mark.slow
def test_labels_do_not_depend_on_the_method() -> None:
    """200 random starts to settling: the same gait by all methods, but at most two at a basin's boundary."""
    psi = np.random.default_rng(7).uniform(0.0, 2.0 * np.pi, (3, 200))
    starts = {f"psi_{i + 1}": psi[i] for i in range(3)}
    gaits = {}
    for name, dt in LONG.items():
        result = run_rows(
            Multilegged(),
            SettleRecorder(Multilegged()),
            starts,
            numerics=Numerics(dt=dt, method=name),
            lanes=100,
        )
        assert np.all(result.status == Status.settled)
        gaits[name] = result.labels["gait"]
    assert np.sum(gaits["propagator6"] != gaits["rk4"]) <= 2
    assert np.sum(gaits["propagator"] != gaits["rk4"]) <= 2


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name, method in METHODS.items() if method.step is not None])
def test_every_method_is_differentiable(name: str) -> None:
    """The derivative of a landing time over the launch speed u is 2 d/(w^2 d^2 + u^2) for the toy."""
    model, u, w, d = Toy(), 1.0, 2.0, 0.5
    params = scalars(model)
    run = crossing_of(model, Numerics(dt=1e-3, method=name).resolve(model), "xla")

    def landing(launch: jax.Array) -> jax.Array:
        return run(params, model.init(params, {"launch_1": launch}))[0]

    t, slope = jax.jvp(landing, (jnp.asarray(u),), (jnp.asarray(1.0),))
    assert abs(float(t) - flight_time(np.asarray(u), w, d)) < 1e-11
    assert abs(float(slope) - 2.0 * d / (w**2 * d**2 + u**2)) < 1e-9


def test_methods_for_linear_flows_are_refused_elsewhere() -> None:
    for name in ("propagator6", "propagator"):
        assert refusal(name, Multilegged(), "float64") is None
        assert "linear" in (refusal(name, Neuron(), "float64") or "")
        assert "float64" in (refusal(name, Multilegged(), "float32") or "")
    assert refusal("rk4", Neuron(), "float32") is None


class Drift(gs.DeclaredModel):
    """A variable with noise, whose steps have a fixed length."""

    x = gs.variable("m", "place", 0.0)

    def flow(self, p, s):
        return {"x": -s.x}

    @gs.diffusion
    def noise(self, p, s):
        return {"x": jnp.asarray(1.0)}

    def period(self, p):
        return jnp.asarray(1.0)


def test_a_model_of_steps_without_structure_refuses_methods_of_flows() -> None:
    assert "drift has only steps. Allowed: semi_implicit" in (refusal("rk4", Drift(), "float64") or "")


def _growth(name: str, z: complex) -> complex:
    """Factor of a step of x' = z x, dt = 1, from the method's own code on a complex flow of two numbers."""
    shares = {"rk4": (1.0,) * 4, "propagator6": PROPAGATOR6, "propagator": PROPAGATOR}[name]
    total, term = 1.0 + 0.0j, 1.0 + 0.0j
    for k, share in enumerate(shares, start=1):
        term *= z / k
        total += share * term
    return total


def test_steps_are_stable_at_their_limit_and_not_far_beyond() -> None:
    """|R| <= 1 at the limit along all directions; twice the limit of the real axis is unstable."""
    for name in ("rk4", "propagator6", "propagator"):
        method = METHODS[name]
        ratios, limits = zip(*method.limits, strict=True)
        # an undamped motion neither grows nor dies in the flow itself
        for damping in np.linspace(1.0, 0.0, 100, endpoint=False):
            z = np.interp(damping, ratios, limits) * (-damping + 1j * np.sqrt(1.0 - damping**2))
            assert abs(_growth(name, z)) <= 1.0 + 1e-3, (name, damping)
        assert abs(_growth(name, -2.0 * method.limits[-1][1])) > 1.0
