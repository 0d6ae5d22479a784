"""The chain at rest on rigid legs, against the conditions that define it and a linear programme."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linprog

from gaitsweep.papers.ambe2021.multilegged.forces import obstacle_problem

solved = jax.jit(obstacle_problem)
Case = tuple[list[float], list[float], float]


def _cases(n: int) -> st.SearchStrategy[Case]:
    lengths = st.floats(0.5, 1.5) | st.sampled_from([0.6, 0.8, 1.0])  # equal legs touch together
    masses = st.floats(0.05, 3.0)
    stiffness = st.floats(5.0, 2000.0)
    return st.tuples(*(st.lists(one, min_size=n, max_size=n) for one in (lengths, masses)), stiffness)


@pytest.mark.slow
@settings(max_examples=150)
@given(st.integers(2, 13).flatmap(_cases))
def test_obstacle_problem_is_the_least_height_above_the_legs(case: Case) -> None:
    legs, masses, kappa = np.array(case[0]), np.array(case[1]), case[2]
    x, load = (np.asarray(out) for out in solved(jnp.array(legs), jnp.array(masses), kappa, 9.8))
    bends = np.diff(np.eye(len(legs)), axis=0)
    stiffness, weight = bends.T @ bends, masses * 9.8 / kappa
    assert (x >= legs).all()
    assert (load >= 0.0).all()
    assert (load[x > legs] == 0.0).all()
    # rounding: a soft chain of 13 hangs hundreds of metres deep between its parabola and its legs
    assert np.abs(stiffness @ x + weight - load / kappa).max() < 1e-11 * (1.0 + len(legs) * weight.sum())
    # an independent solver: of all x >= l whose loads are >= 0 the least is the one at rest
    oracle = linprog(np.ones(len(legs)), A_ub=-stiffness, b_ub=weight, bounds=[(leg, None) for leg in legs])
    assert oracle.status == 0
    assert np.abs(oracle.x - x).max() < 1e-5  # HiGHS is feasible to 1e-7, which a long chain amplifies


def test_one_short_leg_by_hand() -> None:
    x, load = solved(jnp.array([1.0, 0.8, 1.0, 1.0]), jnp.array([0.9, 1.0, 1.0, 0.9]), 100.0, 9.8)
    assert np.allclose(x, [1.0, 0.951, 1.0, 1.0], atol=1e-14)
    assert np.allclose(load, [13.72, 0.0, 14.7, 8.82], atol=1e-12)
    assert float(load[1]) == 0.0


def test_a_single_long_leg_carries_all() -> None:
    x, load = solved(jnp.array([0.2, 1.0, 0.3]), jnp.array([1.0, 1.0, 1.0]), 100.0, 9.8)
    assert np.allclose(load, [0.0, 29.4, 0.0], atol=1e-12)
    assert np.allclose(x, [0.902, 1.0, 0.902], atol=1e-14)
