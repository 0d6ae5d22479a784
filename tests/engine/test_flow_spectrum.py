"""Eigenvalues of flows between events, and the rates by which models bound them."""

from __future__ import annotations

import dataclasses
import itertools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import gaitsweep as gs
from gaitsweep.engine.flow_spectrum import fastest_rates, flow_eigenvalues, slowest_limit
from gaitsweep.engine.numerics import longest_step
from gaitsweep.engine.poincare.return_map import BatchedReturnMap
from gaitsweep.papers.ambe2021.multilegged.model import Multilegged
from gaitsweep.papers.aoi2011.waist_quadruped import WaistQuadruped
from tests.support.sweeping import scalars


def _params(model: Multilegged, values: dict[str, float]) -> Any:
    return BatchedReturnMap(model, tuple(values.items())).params({})


def _eigenvalues(p: Any) -> np.ndarray:
    """Eigenvalues of the chain's masses on springs, for every combination of feet on the ground."""
    masses, kappa = np.asarray(p.masses), np.asarray(p.kappa)
    sigma, K, D = float(p.sigma), float(p.K), float(p.D)
    n = masses.size

    def laplacian(w: np.ndarray) -> np.ndarray:
        return np.diag(np.append(w, 0.0) + np.append(0.0, w)) - np.diag(w, 1) - np.diag(w, -1)

    spectra = []
    for contact in itertools.product((0.0, 1.0), repeat=n):
        stiffness = (laplacian(kappa) + K * np.diag(contact)) / masses[:, None]
        damping = (laplacian(np.full(n - 1, sigma)) + D * np.diag(contact)) / masses[:, None]
        spectra.append(np.linalg.eigvals(np.block([[np.zeros((n, n)), np.eye(n)], [-stiffness, -damping]])))
    return np.array(spectra)


@pytest.mark.slow
def test_the_chains_rates_bound_the_eigenvalues_of_every_mode() -> None:
    """Over masses, springs and grounds far from the paper's: never below, and within a third of them."""
    random = np.random.default_rng(0)
    for trial in range(60):
        model = Multilegged(int(random.choice([3, 4])))
        values = {
            "m_B": random.uniform(0.3, 3.0),
            "m_1": random.uniform(0.3, 3.0),
            "kappa": 10 ** random.uniform(1.0, 5.0),
            "kappa_1": 10 ** random.uniform(1.0, 4.0),
            "K": 10 ** random.uniform(4.0, 6.3),
        }
        if trial % 2:
            values |= {"D": 10 ** random.uniform(0.5, 3.3), "sigma": 10 ** random.uniform(-1.0, 2.0)}
        params = _params(model, values)
        largest = np.max(np.abs(_eigenvalues(params)))
        bound = float(jnp.max(model.fast_modes(params)[0]))
        assert largest <= bound * (1 + 1e-9) + 1e-9, values
        assert largest > 0.66 * bound, values


@pytest.mark.slow
def test_eigenvalues_of_a_flow_are_found_by_its_flags() -> None:
    """The chain's flow, differentiated, has the eigenvalues of its matrices; the slowest limit follows."""
    model = Multilegged()
    params = _params(model, {"m_B": 0.7})
    start = {"psi_1": 1.0, "psi_2": 2.0, "psi_3": 3.0, "phi_1": jnp.nan}
    state = model.init(params, {k: jnp.asarray(v) for k, v in start.items()})
    largest = np.abs(flow_eigenvalues(model, params, state)).max()
    assert largest == pytest.approx(np.abs(_eigenvalues(params)).max(), rel=1e-9)
    limit = slowest_limit(model, params, state, "propagator6")
    known = float(longest_step(model, "propagator6", params))  # type: ignore[arg-type]
    assert known <= limit < 1.3 * known


def _fastest_motion_error(model: WaistQuadruped, **values: float) -> float:
    """The relative error of the fastest motion from the largest eigenvalue of the Jacobian."""
    params = scalars(model, **values)
    state = model.init(params, {"delta_13": jnp.asarray(np.pi)})

    def rates(x: jax.Array) -> jax.Array:
        flow = model.flow(params, dataclasses.replace(state, q=x[:16], v=x[16:]))
        return jnp.concatenate([flow["q"], flow["v"]])

    # not compiled, which would take longer than some evaluations
    jacobian = jax.jacfwd(rates)(jnp.concatenate([state.q, state.v]))
    largest = np.abs(np.linalg.eigvals(np.asarray(jacobian))).max()
    return float(params.mechanics.fastest_motion(params.farthest_foot)[0]) / largest - 1.0


@pytest.mark.slow
def test_the_waist_quadrupeds_fastest_motion_is_close_to_its_largest_eigenvalue() -> None:
    """Random stiffnesses, dampings and masses: never far below it, and mostly 15 % above it at most."""
    model, random = WaistQuadruped(), np.random.default_rng(0)
    defaults = {q.name: q.default for q in model.parameters}
    names = ("K_TL", "D_TL", "kappa_1", "kappa_2", "sigma_1", "sigma_2", "body_mass", "link_mass")
    errors = []
    for _ in range(6):
        values = {name: defaults[name] * 2.0 ** random.uniform(-1.0, 1.0) for name in names}
        errors.append(_fastest_motion_error(model, **values))
    assert min(errors) > -0.06
    assert max(errors) < 0.5
    assert np.mean([0.0 <= error <= 0.15 for error in errors]) >= 0.9


@pytest.mark.slow
def test_a_stiff_waist_counts_in_the_fastest_motion() -> None:
    """Waists far stiffer than the paper's, alone and with other masses: within 6 % below the eigenvalue."""
    model, random = WaistQuadruped(), np.random.default_rng(1)
    defaults = {q.name: q.default for q in model.parameters}
    errors = [_fastest_motion_error(model, f=f) for f in (6.0, 11.0, 16.0, 30.0)]
    for _ in range(4):
        names = ("body_mass", "link_mass", "body_width", "D_TL", "zeta_0")
        values = {name: defaults[name] * 2.0 ** random.uniform(-1.0, 1.0) for name in names}
        errors.append(_fastest_motion_error(model, f=float(random.uniform(4.0, 40.0)), **values))
    assert min(errors) > -0.06, errors
    assert max(errors) < 1.5, errors


class Decay(gs.DeclaredModel):
    """A decay whose rate is its parameter."""

    k = gs.parameter("1/s", "rate", 2.0)
    x = gs.variable("1", "displacement", 1.0)

    def flow(self, p, s):
        return {"x": -p.k * s.x}

    def period(self, p):
        return 3.0 / p.k


def test_fastest_rates_are_those_of_each_row_in_its_place() -> None:
    """Equal rows are computed once; the rates are exact to rounding."""
    k = np.array([5.0, 2.0, 5.0, 1.0, 2.0])
    rates, periods = fastest_rates(Decay(), {"k": k}, {"x_0": np.ones(5)})
    np.testing.assert_allclose(rates, k, rtol=1e-14)
    np.testing.assert_allclose(periods, 3.0 / k, rtol=1e-14)
