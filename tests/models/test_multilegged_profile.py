"""Chains whose inner legs are not all alike: no profile as before, the theory of a profile, and its drift."""

from __future__ import annotations

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest

from gaitsweep.analysis.records import AnalysisError
from gaitsweep.engine.numerics import Numerics
from gaitsweep.engine.poincare.poincare_return import crossing_of
from gaitsweep.engine.recorders.recordings import CrossingRecorder
from gaitsweep.engine.recorders.settle import SettleRecorder
from gaitsweep.errors import ArgumentError
from gaitsweep.job.job import Job
from gaitsweep.papers.ambe2021.multilegged.chain_of_table import chain_of, chains_of
from gaitsweep.papers.ambe2021.multilegged.model import Multilegged
from gaitsweep.papers.ambe2021.multilegged.reduced import MultileggedReduced
from gaitsweep.papers.ambe2021.theory.chain import Chain, amplitudes, lag, masses, reset, springs
from gaitsweep.papers.ambe2021.theory.conditions import source_conditions, wave_conditions
from gaitsweep.papers.ambe2021.theory.gaits import classify
from gaitsweep.papers.ambe2021.theory.order import linear_map, order_sets, touchdown_residuals
from gaitsweep.papers.ambe2021.theory.solution_sets import branches, drift, drift_on_ground, lag_rules
from gaitsweep.status import Status
from tests.support.multilegged_solutions import solution_sets, total
from tests.support.sweeping import run_rows, scalars

STEPS = Numerics(method="semi_implicit", dt=0.4)
TURN = 2.0 * np.pi
ENDS = ("m_1", "m_end", "kappa_1", "kappa_end", "a_1", "a_end")


def wrapped(difference: object) -> np.ndarray:
    return (np.asarray(difference) + np.pi) % TURN - np.pi


def columns(n: int, N: int, seed: int = 4) -> dict[str, np.ndarray]:
    psi = np.random.default_rng(seed).uniform(0.0, TURN, (n, N))
    return {f"psi_{i + 1}": psi[:, i] for i in range(N)}


def profile(N: int, seed: int = 3) -> tuple[Chain, dict[str, float]]:
    """Ends of 0.7 kg that touch alike and inner legs that all differ: the chain, and its parameters."""
    rng = np.random.default_rng(seed)
    m, kappa, a = rng.uniform(0.9, 1.15, N - 1), rng.uniform(92, 108, N - 2), rng.uniform(0.38, 0.42, N - 1)
    chain = Chain(m_1=0.7, m_end=0.7, m=m, kappa=kappa, a=a)
    chain = chain._replace(kappa_1=100.0, kappa_end=100.0, a_1=0.4, a_end=0.4)
    values = {name: float(np.asarray(getattr(chain, name))) for name in ENDS}
    for name, inner in (("m", m), ("kappa", kappa), ("a", a)):
        values |= {f"{name}_{i}": float(value) for i, value in enumerate(inner, start=2)}
    return chain, values


@pytest.mark.slow
@pytest.mark.parametrize("kind", [Multilegged, MultileggedReduced])
def test_a_profile_of_equal_values_is_the_uniform_chain(kind: type[Multilegged]) -> None:
    """Starts, crossings and labels are equal to the last bit."""
    ends = []
    for model in (kind(N=3), kind(N=3, profile=True)):
        recorder = SettleRecorder(model, max_cycles=40, tolerance=1e-3)
        numerics = STEPS if kind is MultileggedReduced else Numerics()
        run = run_rows(
            model, recorder, columns(8, 3), params={"m_B": 0.85}, numerics=numerics, engine="kernel"
        )
        ends.append((run.status, run.last, *run.labels.values()))
    for one, other in zip(*ends, strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.slow
@pytest.mark.parametrize("N", [3, 6])
def test_solutions_of_a_profile_are_fixed_points_of_the_reduced_chain(N: int) -> None:
    """Where its conditions hold: neither the model nor its obstacle problem knows eqs. (12) to (20)."""
    chain, values = profile(N)
    direct, retrograde = wave_conditions(N, chain)
    assert bool(direct.hold)
    assert bool(retrograde.hold)
    assert all(bool(source_conditions(N, chain, k).hold) for k in range(3, N + 1))
    model = MultileggedReduced(N, profile=True)
    params, run = scalars(model, **values), crossing_of(model, STEPS.resolve(model), "xla")

    def cycle(psi: jax.Array) -> jax.Array:
        start = {f"psi_{i + 1}": psi[i] for i in range(N)}
        return run(params, model.init(params, {**start, "phi_1": jnp.asarray(jnp.nan)}))[1].psi

    places = [13, 32, 77, 93]  # none at an end or in the middle of a set
    psi = np.asarray(solution_sets(N, chain, 101, 1))[:, places]
    step, once = 1e-4, jax.jit(jax.vmap(cycle))
    disturbed = psi[:, :, None, None, :] + step * np.array([1.0, -1.0, 0.0])[:, None, None] * np.eye(N)
    after = np.asarray(once(disturbed.reshape(-1, N))).reshape(disturbed.shape)
    # rounding of N + 1 touchdowns; the solutions of equal legs change by 6e-3 rad and more
    assert np.abs(wrapped(after[:, :, 2] - psi[:, :, None])).max() < 1e-12
    even = np.asarray(solution_sets(N, Chain(m_1=0.7, m_end=0.7), 101, 1))[:, places].reshape(-1, N)
    assert np.abs(wrapped(np.asarray(once(even)) - even)).max() > 5e-3
    jacobians = np.swapaxes(wrapped(after[:, :, 0] - after[:, :, 1]) / (2 * step), -1, -2)
    rules = lag_rules(N, chain)
    for row, branch in enumerate(branches(N)):
        free = rules.low[row] + (rules.high[row] - rules.low[row]) * 0.01 * places[1]
        expected = linear_map(N, branch, float(free), chain, section=1)
        assert np.abs(jacobians[row, 1] - expected).max() < 1e-9, branch


@pytest.mark.slow
@pytest.mark.parametrize("N", [3, 6])
def test_every_point_of_a_profiles_set_takes_the_sets_label(N: int) -> None:
    chain, _ = profile(N)
    psi = np.asarray(solution_sets(N, chain, 12, 1))[:, 1:-1]
    label = jax.jit(jax.vmap(jax.vmap(partial(classify, N), in_axes=(0, None)), in_axes=(0, None)))
    _, k, distance = label(psi, chain)
    assert np.asarray(distance).max() < 1e-12
    own = [branch.k if branch.k > 2 and branch.kind != "direct" else 0 for branch in branches(N)]
    assert np.array_equal(np.asarray(k), np.broadcast_to(np.array(own)[:, None], k.shape))


@pytest.mark.slow
def test_the_full_model_settles_on_the_profiles_solutions() -> None:
    """Nearer to them than to those of equal legs, and within the 0.11 rad of sec. 3.6."""
    N = 5
    chain, values = profile(N)
    psi = np.asarray(solution_sets(N, chain, 7, 1))[[0, 2, 4, 6, 8], 3]
    psi = psi + np.random.default_rng(2).uniform(-0.1, 0.1, psi.shape)
    starts = {f"psi_{i + 1}": psi[:, i] for i in range(N)}
    model = Multilegged(N, profile=True)
    recorder = SettleRecorder(model, max_cycles=150, tolerance=1e-3)
    run = run_rows(model, recorder, starts, params=values, engine="kernel", lanes=5)
    assert np.all(run.status == Status.settled)
    assert run.labels["gait"].tolist() == [0, 1, 1, 1, 2]
    assert run.labels["distance"].max() < 0.11
    label = jax.jit(jax.vmap(partial(classify, N), in_axes=(0, None)))
    even = np.asarray(label(run.last[:, :N], Chain(m_1=0.7, m_end=0.7))[2])
    assert np.median(even) > 1.5 * np.median(run.labels["distance"])


@pytest.mark.slow
@pytest.mark.parametrize("kind", [Multilegged, MultileggedReduced])
def test_kernels_and_xla_agree(kind: type[Multilegged]) -> None:
    _, values = profile(4)
    model, ends = kind(4, profile=True), []
    numerics = STEPS if kind is MultileggedReduced else Numerics()
    for engine in ("kernel", "xla"):
        recorder = CrossingRecorder(model, crossings=3)
        run = run_rows(model, recorder, columns(4, 4), params=values, numerics=numerics, engine=engine)
        ends.append(run.samples)
    # events are located to 1e-12 s, in another order of operations
    np.testing.assert_allclose(ends[0], ends[1], rtol=0, atol=1e-9)


@pytest.mark.slow
def test_no_profile_of_the_inner_legs_moves_the_source() -> None:
    """E is kept to rounding wherever the source is; the leg with the largest own reset is an end."""
    N = 7
    chain, values = profile(N)
    assert float(drift(chain)) == 0.0
    # D of each leg with all its neighbours in stance: eq. (31) for the first leg, eq. (32) for the last one
    stiffness = np.convolve(springs(N, chain), [1.0, 1.0])  # both springs of each leg
    weights = chain.g * np.asarray(masses(N, chain))
    own = (1.0 - chain.beta) * np.pi * weights / (np.asarray(amplitudes(N, chain)) * stiffness)
    assert own[[0, -1]] == pytest.approx(float(reset(chain)))
    assert own[1:-1].max() < own[0]
    model = MultileggedReduced(N, profile=True)
    psi = np.asarray(solution_sets(N, chain, 9, 1))[:, [2, 5]].reshape(-1, N)
    psi = psi + np.random.default_rng(1).uniform(-0.05, 0.05, psi.shape)  # beside the line, by 0.05 rad
    starts = {f"psi_{i + 1}": psi[:, i] for i in range(N)}
    recorder = CrossingRecorder(model, crossings=60)
    run = run_rows(model, recorder, starts, params=values, numerics=STEPS, engine="kernel")
    E = np.asarray(total(run.samples.reshape(len(psi), 61, -1)[:, :, 2 : N + 2]))
    assert np.abs(wrapped(E[:, 1:] - E[:, :1])).max() < 1e-10


@pytest.mark.slow
def test_a_heavy_inner_leg_removes_the_source() -> None:
    """Its reset exceeds the ends', both waves run towards it, and no lag is free."""
    N, heavy = 4, 2
    model = MultileggedReduced(N, profile=True)
    recorder = SettleRecorder(model, max_cycles=1500, tolerance=1e-9)
    params = {"m_B": 0.6, f"m_{heavy}": 1.6}  # resets of 0.6 b and 0.8 b
    run = run_rows(model, recorder, columns(12, N), params=params, numerics=STEPS, engine="kernel")
    psi = wrapped(run.last[:, :N])
    assert np.all(run.status == Status.settled)
    assert np.all(psi[:, : heavy - 1] < 0.0)
    assert np.all(psi[:, heavy - 1 :] > 0.0)
    assert np.ptp(psi, axis=0).max() < 1e-6  # one state from all starts


@pytest.mark.slow
def test_the_grounds_compliance_breaks_the_tie() -> None:
    """On a soft ground the full model drifts as the ends' neighbours sink, wherever the source is."""
    N, K = 5, 1.0e4
    model, slopes = Multilegged(N, profile=True), (-0.3, 0.3)
    psi = np.array([[1.1] * (k - 2) + [3.0] + [5.2] * (N - k + 1) for k in (3, 4, 5)] * 2)
    starts = {f"psi_{i + 1}": psi[:, i] for i in range(N)}
    params = {"m_B": 0.7, "m_slope": np.repeat(slopes, 3), "K": K}
    recorder = CrossingRecorder(model, crossings=70)
    run = run_rows(model, recorder, starts, params=params, engine="kernel", lanes=6)
    E = run.samples.reshape(len(psi), 71, -1)[:, :, 2 : N + 2].sum(axis=2)
    found = wrapped(E[:, -1] - E[:, -11]) / 10
    for slope, mine in zip(slopes, found.reshape(2, 3), strict=True):
        m = 1.0 + slope * np.array([-3 / 5, -1 / 5, 1 / 5, 3 / 5])
        chain = Chain(m=m, kappa=np.full(N - 2, 100.0), a=np.full(N - 1, 0.4), m_1=0.7, m_end=0.7)
        chain = chain._replace(kappa_1=100.0, kappa_end=100.0, a_1=0.4, a_end=0.4)
        # damping and inertia are left out; without the ground's term nothing drifts
        assert mine == pytest.approx(np.full(3, float(drift_on_ground(N, chain, K))), rel=0.1)


def test_profiles_follow_one_number() -> None:
    """A slope is a straight line over the legs, a bend a parabola; both ends stay."""
    fields = {"N": 5, "profile": True}
    job = Job.model_validate(
        {
            "name": "some",
            "model": "multilegged",
            "structure": fields,
            "params": {"m_bend": 0.5, "kappa_2": "kappa + 7", "a_3": 0.37},
            "vary": {"m_slope": [0.0, 0.2]},
            "start": {f"psi_{i}": 1.0 for i in range(1, 6)},
            "run": {"kind": "settle"},
        }
    )
    values, _ = job.design.values(0, 2)
    x = np.array([-3 / 5, -1 / 5, 1 / 5, 3 / 5])
    for row, slope in enumerate((0.0, 0.2)):
        results = [values[f"m_{i}"][row] for i in range(2, 6)]
        assert results == pytest.approx(1.0 + slope * x + 0.5 * (1.0 - x**2))
    assert [values[f"kappa_{i}"][0] for i in (2, 3, 4)] == [107.0, 100.0, 100.0]
    assert values["m_1"].tolist() == values["m_end"].tolist() == [0.9, 0.9]

    table = pd.DataFrame({"row": [0, 1], "m_slope": [0.0, 0.2]})
    table.attrs["job"] = job.resolved()
    chains = chains_of(table, table.filter(["m_slope"]))
    assert np.asarray(chains.m)[1] == pytest.approx([values[f"m_{i}"][1] for i in range(2, 6)])
    assert np.asarray(chains.kappa).shape == (2, 3)
    assert chain_of(table).a == pytest.approx([0.4, 0.37, 0.4, 0.4])
    table.attrs["job"]["params"] |= {"m_2": "m_3", "m_3": "m_2"}
    with pytest.raises(AnalysisError, match="cycle"):
        chain_of(table)


def test_jobs_without_a_profile_stay_as_they_were() -> None:
    """The resolved job, its hash and its parameters do not know of profiles."""
    plain = {"name": "some", "model": "multilegged", "start": {f"psi_{i}": 1.0 for i in (1, 2, 3)}}
    jobs = [
        Job.model_validate({**plain, "structure": structure, "run": {"kind": "settle"}})
        for structure in ({}, {"profile": False}, {"profile": True})
    ]
    assert jobs[0].resolved()["structure"] == jobs[1].resolved()["structure"] == {"N": 3}
    assert jobs[0].hash() == jobs[1].hash() != jobs[2].hash()
    assert "m_2" not in jobs[0].resolved()["params"]
    assert jobs[2].resolved()["structure"] == {"N": 3, "profile": True}


def test_analyses_of_equal_legs_refuse_a_profile() -> None:
    chain, _ = profile(4)
    branch = branches(4)[2]
    for refused in (
        lambda: lag(chain),
        lambda: order_sets(4, branch, 3.0, chain),
        lambda: touchdown_residuals(4, branch, 3.0, chain),
        lambda: reset(chain._replace(kappa_1=None)),
        lambda: lag_rules(5, chain),
    ):
        with pytest.raises(ArgumentError, match="profile"):
            refused()
