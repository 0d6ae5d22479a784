"""Numerics that models recommend: the adaptive pair, the longest step of each row, and explicit steps."""

from __future__ import annotations

import dataclasses
import itertools
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from firing_neuron import Neuron, firing_times
from gaitsweep import models
from gaitsweep.contract import Status
from gaitsweep.engine.flow_spectrum import flow_eigenvalues, slowest_limit
from gaitsweep.engine.numerics import Numerics, longest_step, step_of
from gaitsweep.engine.recorders.crossings import CrossingRecorder
from gaitsweep.engine.solver import METHODS
from gaitsweep.engine.solver.runge_kutta import DIFFERENCE, STAGES
from gaitsweep.job import Job, JobError
from gaitsweep.job.step_lengths import row_steps
from gaitsweep.papers.ambe2021.multilegged.model import Multilegged
from gaitsweep.runs.prepare import row_values
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
def test_the_chains_rates_bound_the_eigenvalues_of_every_mode() -> None:
    """Over masses, springs and grounds far from the paper's: never below, and within a third of them."""
    random = np.random.default_rng(0)
    for trial in range(60):
        model = Multilegged(int(random.choice([3, 4])))
        given = {
            "m_B": random.uniform(0.3, 3.0),
            "m_1": random.uniform(0.3, 3.0),
            "kappa": 10 ** random.uniform(1.0, 5.0),
            "kappa_1": 10 ** random.uniform(1.0, 4.0),
            "K": 10 ** random.uniform(4.0, 6.3),
        }
        if trial % 2:
            given |= {"D": 10 ** random.uniform(0.5, 3.3), "sigma": 10 ** random.uniform(-1.0, 2.0)}
        params = _params(model, given)
        result = np.max(np.abs(_eigenvalues(params)))
        bound = float(jnp.max(model.fast_modes(params)[0]))
        assert result <= bound * (1 + 1e-9) + 1e-9, given
        assert result > 0.66 * bound, given


@pytest.mark.slow
def test_eigenvalues_of_a_flow_are_found_by_its_flags() -> None:
    """The chain's flow, differentiated, has the eigenvalues of its matrices; the slowest limit follows."""
    model = Multilegged()
    params = _params(model, {"m_B": 0.7})
    start = {"psi_1": 1.0, "psi_2": 2.0, "psi_3": 3.0, "phi_1": jnp.nan}
    state = model.init(params, {k: jnp.asarray(v) for k, v in start.items()})
    result = np.abs(flow_eigenvalues(model, params, state)).max()
    assert result == pytest.approx(np.abs(_eigenvalues(params)).max(), rel=1e-9)
    limit = slowest_limit(model, params, state, "propagator6")
    known = float(longest_step(model, "propagator6", params))  # type: ignore[arg-type]
    assert known <= limit < 1.3 * known


def test_steps_are_stable_at_their_limit_and_not_far_beyond() -> None:
    """|R| <= 1 at the limit along each direction; twice the limit of the real axis is unstable."""
    for name in ("rk4", "propagator6", "propagator"):
        method = METHODS[name]
        for damping, limit in method.limits:
            if damping == 0.0:
                continue  # an undamped motion neither grows nor dies in the flow itself
            z = limit * (-damping + 1j * np.sqrt(1.0 - damping**2))
            assert abs(_growth(name, z)) <= 1.0 + 1e-3, (name, damping)
        assert abs(_growth(name, -2.0 * method.limits[-1][1])) > 1.0


@pytest.mark.parametrize("name", models.names())
def test_every_model_has_a_step(name: str) -> None:
    model = models.find(name)()
    params = scalars(model)
    dt = float(step_of(model, Numerics().resolve(model), params))
    assert 0.0 < dt < float(model.period(params)) / 8.0
    longest = longest_step(model, Numerics().resolve(model).method, params)
    assert longest is not None
    assert dt <= float(longest) * (1 + 1e-12)


def test_each_row_has_its_own_longest_step() -> None:
    job = Job(
        name="masses", model="multilegged", vary={"m_B": [0.6, 0.9], "psi_1": [1, 2, 3]},
        start={"psi_2": 2, "psi_3": 3}, run={"kind": "settle"},
    )  # fmt: skip
    steps = row_steps(job.design, job.run, job.integration)
    assert steps.dt.size == 2, "two sets of parameters, whatever the starts"
    assert steps.each == 3
    assert steps.dt[0] < 0.7 * steps.dt[1]
    resolved = job.resolved()["numerics"]
    assert (resolved["method"], resolved["dt"]) == ("propagator6", "auto")
    assert "rtol" not in resolved


def test_a_ramp_has_the_step_of_its_whole_path() -> None:
    run = {"kind": "ramp", "parameter": "m_B", "path": [0.9, 0.5, 0.9], "rate": 0.01}
    start = {"psi_1": 1, "psi_2": 2, "psi_3": 3}
    moving = Job(name="ramp", model="multilegged", start=start, run=run)
    still = Job(name="still", model="multilegged", start=start, params={"m_B": 0.5}, run={"kind": "settle"})
    (ramp,), (least,) = (row_steps(job.design, job.run, job.integration).dt for job in (moving, still))
    assert ramp == pytest.approx(least)


@pytest.mark.slow("numerics0-sentences0")
@pytest.mark.parametrize(
    ("numerics", "sentences"),
    [
        ({"method": "propagator6", "dt": 32e-3}, ["too long for 36 of 72 rows", "0.02576 s (at m_B = 0.7)"]),
        ({"method": "rk4", "dt": 4.5e-3}, ["too long for 36 of 72 rows", "longest accurate step of rk4"]),
        ({"dt": 32}, ["numerics.dt is 32 s, too long for 72 of 72 rows"]),
    ],
)
def test_an_explicit_step_is_refused_where_it_is_too_long(numerics: dict, sentences: list[str]) -> None:
    """The readme's own example: at 0.7 kg 32 ms lost 31 of 36 rows without a word."""
    phases = {"linspace": [0, "2*pi", 6], "at": "centre"}
    fields: dict[str, Any] = {
        "name": "end_mass", "model": "multilegged", "start": {"psi_3": "pi"}, "run": {"kind": "settle"},
        "vary": {"m_B": [0.7, 0.9], "psi_1": phases, "psi_2": phases},
    }  # fmt: skip
    with pytest.raises(JobError) as refused:
        Job(**fields, numerics=numerics)
    for sentence in sentences:
        assert sentence in str(refused.value)
    Job(**fields, numerics={"method": "propagator6", "dt": 25e-3})


def test_steps_of_unexamined_rows_are_checked_when_they_begin() -> None:
    """Also in a round of a refined run, where only some rows of the job are simulated."""
    start = {"psi_1": 1, "psi_2": 2, "psi_3": 3}
    job = Job(
        name="some", model="multilegged", start=start, run={"kind": "settle"}, vary={"m_B": [0.9, 0.9, 0.7]}
    )
    steps = dataclasses.replace(row_steps(job.design, job.run, job.integration), sampled=True)
    numerics = dataclasses.replace(job.integration, dt=27e-3)

    def values(*rows: int) -> np.ndarray:
        given = row_values(job.design, job.run, numerics, steps, lambda a, b: np.array(rows)[a:b])
        return given(0, len(rows))[0]["m_B"]

    assert values(1, 0).tolist() == [0.9, 0.9]
    with pytest.raises(JobError, match=r"too long for row 2: use at most 0\.02"):
        values(0, 2)


def _params(model: Multilegged, given: dict[str, float]) -> Any:
    from gaitsweep.engine.poincare.return_map import BatchedReturnMap

    return BatchedReturnMap(model, tuple(given.items())).params({})


def _eigenvalues(p: Any) -> np.ndarray:
    """Of the chain's masses on springs, with every combination of feet on the ground."""
    masses, kappa = np.asarray(p.masses), np.asarray(p.kappa)
    sigma, K, D = float(p.sigma), float(p.K), float(p.D)
    n = masses.size

    def laplacian(w: np.ndarray) -> np.ndarray:
        return np.diag(np.append(w, 0.0) + np.append(0.0, w)) - np.diag(w, 1) - np.diag(w, -1)

    results = []
    for contact in itertools.product((0.0, 1.0), repeat=n):
        stiffness = (laplacian(kappa) + K * np.diag(contact)) / masses[:, None]
        damping = (laplacian(np.full(n - 1, sigma)) + D * np.diag(contact)) / masses[:, None]
        results.append(np.linalg.eigvals(np.block([[np.zeros((n, n)), np.eye(n)], [-stiffness, -damping]])))
    return np.array(results)


def _growth(name: str, z: complex) -> complex:
    """Factor of a step of x' = z x, dt = 1, from the method's own code on a complex flow of two numbers."""
    from gaitsweep.engine.solver.exponential import PROPAGATOR, PROPAGATOR6

    shares = {"rk4": (1.0,) * 4, "propagator6": PROPAGATOR6, "propagator": PROPAGATOR}[name]
    total, term = 1.0 + 0.0j, 1.0 + 0.0j
    for k, share in enumerate(shares, start=1):
        term *= z / k
        total += share * term
    return total


@pytest.mark.slow
def test_float32_rows_are_not_given_tolerances_below_their_resolution() -> None:
    """An adaptive step cannot meet 1e-8 in float32, but rows still end."""
    numerics = Numerics(precision="float32", rtol=1e-5, atol=1e-6)
    result = run_rows(
        Toy(), CrossingRecorder(Toy(), crossings=5), {"launch_1": np.ones(2)}, numerics=numerics
    )
    assert np.all(result.status == Status.complete)
    assert jax.config.read("jax_enable_x64")


@pytest.mark.slow
def test_reading_a_job_leaves_every_core_to_its_run(tmp_path: Any) -> None:
    """JAX counts its devices at its first computation, that of a job's steps."""
    (tmp_path / "job.yaml").write_text(
        "name: cores\nmodel: multilegged\nstart: {psi_1: 1, psi_2: 2, psi_3: 3}\nrun: {kind: settle}\n"
    )
    code = (
        "import os; from gaitsweep.job import load_job; "
        "from gaitsweep.engine.sweep.xla import local_devices; "
        "load_job('job.yaml'); print(len(local_devices()) == len(os.sched_getaffinity(0)))"
    )
    environment = {**os.environ, "JAX_PLATFORMS": "cpu", "PYTHONPATH": str(Path(__file__).parents[2])}
    done = subprocess.run(
        [sys.executable, "-c", code],
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.strip() == "True"
