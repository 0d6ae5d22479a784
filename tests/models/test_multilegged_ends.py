"""Chains whose ends have springs and amplitudes of their own: statics, drift, and the gait that is left."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from reference import multilegged_reduced as reference
from scipy.optimize import linprog

from gaitsweep.engine.numerics import Numerics
from gaitsweep.engine.recorders.recordings import CrossingRecorder
from gaitsweep.engine.recorders.settle import SettleRecorder
from gaitsweep.papers.ambe2021.multilegged.forces import balance, obstacle_problem
from gaitsweep.papers.ambe2021.multilegged.model import Multilegged
from gaitsweep.papers.ambe2021.multilegged.reduced import MultileggedReduced
from gaitsweep.papers.ambe2021.theory.chain import Chain, end_resets, springs
from gaitsweep.papers.ambe2021.theory.conditions import wave_conditions
from gaitsweep.papers.ambe2021.theory.gaits import GAITS
from gaitsweep.papers.ambe2021.theory.order import linear_map
from gaitsweep.papers.ambe2021.theory.solution_sets import Branch, branches, drift, lag_rules
from gaitsweep.status import Status
from tests.support.multilegged_solutions import solution_set, solution_sets, total
from tests.support.sweeping import run_rows, scalars

STEPS = Numerics(method="semi_implicit", dt=0.4)
TURN = 2.0 * np.pi
# ends that differ in all but m/(kappa a), by which they touch: nothing drifts
MATCHED = Chain(m_1=0.81, kappa_1=108.0, a_1=0.3375, m_end=1.045, kappa_end=95.0, a_end=0.4950)
SOFT_TAIL = Chain(kappa_end=92.0)
TOO_SOFT = Chain(kappa_end=80.0)  # its leg 3 would bear less than nothing when leg 2 touches
SHORT_HEAD = Chain(a_1=0.37, a_end=0.42)
UNLIKE = Chain(m_1=0.85, kappa_1=104.0, kappa_end=97.0, a_1=0.42, a_end=0.39)

solved, balanced = jax.jit(obstacle_problem), jax.jit(balance)


def wrapped(difference: object) -> np.ndarray:
    return (np.asarray(difference) + np.pi) % TURN - np.pi


def params_of(*chains: Chain) -> dict[str, np.ndarray]:
    """Differences from the model's defaults, for rows of one chain after the other."""
    names = ("m_1", "m_end", "kappa_1", "kappa_end", "a_1", "a_end")
    inner = {"kappa": 100.0, "a": 0.4}
    given = {name: [getattr(chain, name) for chain in chains] for name in names}
    return {
        name: np.array([inner[name.split("_")[0]] if value is None else value for value in values])
        for name, values in given.items()
    }


def columns(n: int, N: int = 3, seed: int = 4) -> dict[str, np.ndarray]:
    psi = np.random.default_rng(seed).uniform(0.0, TURN, (n, N))
    return {f"psi_{i + 1}": psi[:, i] for i in range(N)}


def _chains(n: int) -> st.SearchStrategy:
    def lists(low: float, high: float, size: int) -> st.SearchStrategy:
        return st.lists(st.floats(low, high), min_size=size, max_size=size)

    return st.tuples(lists(0.5, 1.5, n), lists(0.05, 3.0, n), lists(20.0, 2000.0, n - 1))


@pytest.mark.slow
@settings(max_examples=60)
@given(st.sampled_from([2, 3, 5, 8]).flatmap(_chains))
def test_the_chain_at_rest_with_a_spring_for_each_pair(case: tuple[list[float], ...]) -> None:
    """Against the conditions that define it, and a linear programme; `balance` is its load with a sign."""
    legs, masses, kappa = (np.array(each) for each in case)
    n, weight = len(legs), masses * 9.8
    x, load = (np.asarray(out) for out in solved(legs, masses, kappa, 9.8))
    bends = np.diff(np.eye(n), axis=0)
    stiffness = bends.T @ np.diag(kappa) @ bends
    # rounding: a soft spring lets a stiff pair hang deep
    scale = weight.sum() * n * kappa.max() / kappa.min()
    assert (x >= legs).all()
    assert (load >= 0.0).all()
    assert np.abs(stiffness @ x + weight - load).max() < 1e-13 * n * scale
    oracle = linprog(np.ones(n), A_ub=-stiffness, b_ub=weight, bounds=[(leg, None) for leg in legs])
    assert np.abs(oracle.x - x).max() < 1e-5  # HiGHS is feasible to 1e-7, which a long chain amplifies
    unit = kappa[(n - 1) // 2]
    result = np.asarray(balanced(legs, masses, kappa, 9.8))
    assert np.abs(np.maximum(result, 0.0) - load / unit).max() < 1e-13 * n * scale / unit
    assert (result[x - legs > 1e-10] < 0.0).all()


@pytest.mark.slow
def test_E_drifts_by_the_resets_of_the_ends() -> None:
    """Eqs. (31), (32) with an own spring and amplitude of each end, while its neighbour is in stance."""
    model, chains, n = MultileggedReduced(), (SOFT_TAIL, SHORT_HEAD, UNLIKE, MATCHED), 24
    params = {name: np.repeat(values, n) for name, values in params_of(*chains).items()}
    recorder = CrossingRecorder(model, crossings=60)
    run = run_rows(model, recorder, columns(4 * n), params=params, numerics=STEPS, engine="kernel", lanes=96)
    psi = run.samples.reshape(4, n, 61, -1)[:, :, 30:, 2:-1]
    change = wrapped(np.diff(np.asarray(total(psi)), axis=2))
    for chain, found in zip(chains, change, strict=True):
        by_hand = 0.2 * np.pi * 9.8 * chain.m_end / ((chain.kappa_end or 100.0) * (chain.a_end or 0.4))
        by_hand -= 0.2 * np.pi * 9.8 * chain.m_1 / ((chain.kappa_1 or 100.0) * (chain.a_1 or 0.4))
        assert float(drift(chain)) == pytest.approx(by_hand, abs=1e-15)
        # rounding, where the drift is 0 or 0.01 and more; rows at the end of their line stand still
        assert np.mean(np.abs(found - by_hand) < 1e-12) > 0.8


@pytest.mark.slow
@pytest.mark.parametrize(("chain", "N"), [(MATCHED, 3), (MATCHED, 5), (UNLIKE._replace(a_end=0.5), 4)])
def test_ends_with_equal_touchdowns_keep_the_lines_of_solutions(chain: Chain, N: int) -> None:
    """The lags of eq. (12) beside the ends; against touchdowns searched for in the obstacle problem."""
    head, tail = (float(each) for each in end_resets(chain))
    alike = chain._replace(m_end=chain.m_end * head / tail)
    every = np.asarray(solution_sets(N, alike, 8, 1))
    for branch, psis in zip(branches(N), every, strict=True):
        for psi in psis[[2, 5]]:
            after, _ = reference.cycle(N, alike, psi)
            # rounding over a cycle; the lags of a uniform chain would be off by 0.01 and more
            assert np.abs(wrapped(after - psi)).max() < 1e-12, branch


@pytest.mark.slow
def test_the_linear_map_knows_the_ends() -> None:
    """Product of touchdowns against differences of the searched map, which is linear between jumps."""
    step, rules = 1e-4, lag_rules(3, MATCHED)
    for row, branch in enumerate(branches(3)):
        psi = np.asarray(solution_set(3, branch, MATCHED, 101, 1))[32]
        s = float(rules.low[row] + 0.32 * (rules.high[row] - rules.low[row]))
        ends = [
            [reference.cycle(3, MATCHED, psi + sign * step * unit)[0] for unit in np.eye(3)]
            for sign in (1.0, -1.0)
        ]
        found = wrapped(np.subtract(ends[0], ends[1])).T / (2 * step)
        assert np.abs(found - linear_map(3, branch, s, MATCHED, section=1)).max() < 1e-9


@pytest.mark.slow
def test_unlike_ends_leave_one_gait() -> None:
    """The gait of the end that resets by more; none of the three where `wave_conditions` do not hold."""
    model, chains, n = MultileggedReduced(), (SOFT_TAIL, SHORT_HEAD, UNLIKE, TOO_SOFT), 24
    recorder = SettleRecorder(model, max_cycles=2500, tolerance=1e-6)
    params = {name: np.repeat(values, n) for name, values in params_of(*chains).items()}
    run = run_rows(model, recorder, columns(4 * n), params=params, numerics=STEPS, engine="kernel", lanes=96)
    assert np.all(run.status == Status.settled)
    for number, chain in enumerate(chains):
        mine = slice(number * n, (number + 1) * n)
        tail = float(drift(chain)) > 0.0
        end = solution_set(3, Branch("B", 2) if tail else Branch("direct", 3), chain, section=1)[-1]
        found = {GAITS[g] for g in run.labels["gait"][mine]}
        if not bool(wave_conditions(3, chain)[int(tail)].hold):
            assert chain is TOO_SOFT
            assert found == {"none"}
            continue
        assert found == {"retrograde" if tail else "direct"}
        assert np.abs(wrapped(run.last[mine, :3] - np.asarray(end))).max() < 1e-4


def test_springs_of_the_theory_are_the_models() -> None:
    for model in (Multilegged(5), MultileggedReduced(5)):
        params = scalars(model, **{name: float(each[0]) for name, each in params_of(UNLIKE).items()})
        np.testing.assert_array_equal(np.asarray(params.kappa), np.asarray(springs(5, UNLIKE)))
        np.testing.assert_array_equal(np.asarray(params.a), [0.42, 0.4, 0.4, 0.4, 0.4, 0.39])
        assert params.masses.shape == (6,)
    uniform = scalars(Multilegged())
    assert jnp.array_equal(uniform.kappa, jnp.full(3, 100.0))
    assert float(uniform.sigma) == 20.0
