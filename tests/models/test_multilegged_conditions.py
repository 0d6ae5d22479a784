"""Conditions for the gaits to exist, against the paper's and against the motion of the reduced chain."""

from __future__ import annotations

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gaitsweep.engine.numerics import Numerics
from gaitsweep.engine.poincare.poincare_return import crossing_of
from gaitsweep.engine.recorders.settle import SettleRecorder
from gaitsweep.papers.ambe2021.multilegged.reduced import MultileggedReduced
from gaitsweep.papers.ambe2021.theory.chain import Chain, end_resets, touchdown_phase
from gaitsweep.papers.ambe2021.theory.conditions import source_conditions, wave_conditions
from gaitsweep.papers.ambe2021.theory.gaits import distances
from gaitsweep.papers.ambe2021.theory.solution_sets import LagRule, branches, lag_rules, solution
from gaitsweep.status import Status
from tests.support.sweeping import run_rows

STEPS = Numerics(method="semi_implicit", dt=0.4)
TURN = 2.0 * np.pi


def wrapped(difference: object) -> np.ndarray:
    return (np.asarray(difference) + np.pi) % TURN - np.pi


@partial(jax.jit, static_argnums=0)
def _waves(N: int, chain: Chain) -> list[jax.Array]:
    return [wave.hold for wave in wave_conditions(N, chain)]


@settings(max_examples=60)
@given(
    st.sampled_from([3, 4, 8]),
    *(st.floats(*ends) for ends in ((0.05, 0.95), (5.0, 300.0), (0.2, 3.0), (0.1, 1.5), (0.1, 1.2))),
)
def test_conditions_of_uniform_chains(
    N: int, beta: float, kappa: float, m: float, share: float, a: float
) -> None:
    """m/2 < m_B < m and m_B g/kappa < a; above m (2 m_B + m) g/kappa > 2 a and (2 m_B - m) g/kappa < a.

    The lag of neighbours in stance, 2 (1-beta) pi - m_B b, is below 2 beta pi.
    """
    sag = m * 9.8 / (kappa * a)
    stance = 4.0 * beta - 2.0 + (1.0 - beta) * share * sag
    soft, within = (2.0 * share + 1.0) * sag - 2.0, 1.0 - (2.0 * share - 1.0) * sag
    edges = (share - 0.5, share - 1.0, share * sag - 1.0, soft, within, stance)
    if min(map(abs, edges)) < 1e-9:
        return  # on an edge rounding decides
    chain = Chain(beta, kappa, m, share * m, share * m, a)
    expected = share > 0.5 and share * sag < 1.0 and (share < 1.0 or (soft > 0.0 and within > 0.0))
    expected = expected and stance > 0.0
    assert [bool(holds) for holds in _waves(N, chain)] == [expected, expected]


def chains(n: int, N: int) -> Chain:
    """Fields (n,): random chains, most of them with ends of their own that touch by the same phase."""
    rng = np.random.default_rng(5 + N)
    drawn = [rng.uniform(*ends, n) for ends in ((0.3, 0.95), (12.0, 150.0), (0.7, 1.5), (0.1, 0.95))]
    beta, kappa, m, a = drawn
    own = np.where(np.arange(n) % 3 > 0, 1.0, 0.0)[:, None] * rng.uniform(-0.2, 0.2, (n, 4))
    kappa_1, kappa_end = kappa * (1.0 + own[:, 0]), kappa * (1.0 + own[:, 1])
    a_1, a_end = a * (1.0 + own[:, 2]), a * (1.0 + own[:, 3])
    m_1 = m * rng.uniform(0.4, 1.5, n)
    whole = Chain(beta, kappa, m, m_1, m_1, a, np.full(n, 9.8), kappa_1, kappa_end, a_1, a_end)
    head, tail = (np.asarray(each) for each in end_resets(whole))
    return whole._replace(m_end=m_1 * head / tail)


def errors_and_conditions(N: int, chain: Chain) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Of one chain: what a cycle changes at a point of each wave, rad; what should stay; landing's margin."""
    model = MultileggedReduced(N)
    run = crossing_of(model, STEPS.resolve(model), "xla")
    fixed = {
        "sigma": 20.0,
        "m_B": chain.m_1,
        "L": 1.0,
        "K": 1e5,
        "D": 632.0,
        "tau": 0.5,
        "omega": 0.4,
        "clamp": 0.0,
    }
    params = model.params({name: jnp.asarray(each) for name, each in (fixed | chain._asdict()).items()})

    def change(rule: LagRule) -> jax.Array:
        psi = solution(rule, rule.low + 0.37 * (rule.high - rule.low), touchdown_phase(chain), 1)
        start = {f"psi_{i + 1}": psi[i] for i in range(N)}
        after = run(params, model.init(params, {**start, "phi_1": jnp.asarray(jnp.nan)}))[1].psi
        changed = jnp.max(jnp.abs(jnp.mod(after - psi + jnp.pi, TURN) - jnp.pi))
        return jnp.where(rule.low < rule.high, changed, jnp.inf)  # an empty set has no wave

    kept = np.array([row for row, branch in enumerate(branches(N)) if branch.kind != "A"])
    rules = jax.tree.map(lambda field: field[kept], lag_rules(N, chain))
    direct, retrograde = wave_conditions(N, chain)
    # direct, B of k = N .. 3, and B of k = 2, which is the retrograde wave
    sources = [source_conditions(N, chain, k).hold for k in range(N, 2, -1)]
    hold = jnp.stack([direct.hold, *sources, retrograde.hold])
    return jax.lax.map(change, rules), hold, direct.landing


@pytest.mark.slow
@pytest.mark.parametrize("N", [3, 4])
def test_waves_are_motions_of_the_chain_where_their_conditions_hold(N: int) -> None:
    """In each of 400 chains a wave is a fixed point of the reduced map exactly if its conditions hold."""
    some = chains(400, N)
    found, hold, landing = jax.jit(jax.vmap(lambda chain: errors_and_conditions(N, chain)))(some)
    able = np.asarray(landing) > 0.0  # else leg 1 has no touchdown to start at
    # rounding, against 1e-4 and more where a leg in takeoff is off the ground
    fixed = np.asarray(found)[able] < 1e-10
    assert np.array_equal(fixed, np.asarray(hold)[able])
    assert 0.1 < fixed[:, 0].mean() < 0.9


@pytest.fixture(scope="module")
def settled() -> tuple[list[slice], np.ndarray, np.ndarray]:
    """64 starts each: heavy ends in a soft chain and in a stiff one, then legs with and without length."""
    model, n = MultileggedReduced(), 64
    psi = np.tile(np.random.default_rng(4).uniform(0.0, TURN, (n, 3)), (4, 1))
    mass, kappa, a = (np.repeat(each, n) for each in ((HEAVY, HEAVY, 0.9, 0.9), *GROUPS))
    columns = {("m_1", "m_end"): mass, ("a", "a_1", "a_end"): a, ("kappa", "kappa_1", "kappa_end"): kappa}
    params = {name: column for names, column in columns.items() for name in names}
    recorder = SettleRecorder(model, max_cycles=3000, tolerance=1e-6)
    starts = {f"psi_{i + 1}": psi[:, i] for i in range(3)}
    run = run_rows(model, recorder, starts, params=params, numerics=STEPS, engine="kernel", lanes=64)
    assert np.all(run.status == Status.settled)
    return [slice(g * n, (g + 1) * n) for g in range(4)], run.last[:, :3], run.labels["gait"]


HEAVY = 1.1
GROUPS = ((36.0, 100.0, 80.0, 40.0 / 1.5), (0.4, 0.4, 0.5, 1.5))  # kappa, N/m; a, m


@pytest.mark.slow
def test_above_m_a_leg_is_in_the_air_when_its_neighbour_touches(settled: tuple) -> None:
    """Heavier ends than inner legs, N = 3: the waves in a soft chain; in a stiff one legs 2 and 3 follow one
    another by (2 m - m_B) b instead of 2 (1-beta) pi - (3 m_B - m) b, and are called none."""
    (soft, stiff, *_), psi, _ = settled
    apart = jax.jit(jax.vmap(lambda k, at: distances(3, Chain(kappa=k, m_1=HEAVY, m_end=HEAVY), at)))
    away = {
        name: np.asarray(apart(np.full(64, k), psi[at]))
        for name, k, at in (("soft", 36.0, soft), ("stiff", 100.0, stiff))
    }
    # settled to 1e-6 rad a cycle, and a third of what is left goes with each
    assert (away["soft"].min(axis=1) < 1e-4).all()
    assert set(away["soft"].argmin(axis=1)) == set(range(5))
    assert away["stiff"][:, [0, 4]].min() > 0.01  # no direct and no retrograde wave
    b, at = 0.2 * np.pi * 9.8 / (100.0 * 0.4), wrapped(psi[stiff])
    follows = np.abs(np.abs(at[:, 1]) - (2.0 - HEAVY) * b) < 1e-4
    # all others have one of the lags of the source wave at least, read before or after a leg's reset
    lag, reset = 2 * 0.2 * np.pi - (2 * HEAVY - 1.0) * b, HEAVY * b
    lags = (at[:, 0] - lag, at[:, 2] + lag, at[:, 2] + lag - reset)
    assert (follows | (np.abs(lags).min(axis=0) < 1e-4)).all()
    assert follows.sum() >= 8
    assert np.mean(away["stiff"][:, 2] < 1e-4) > 0.35


@pytest.mark.slow
def test_amplitudes_beyond_the_legs_length_are_allowed(settled: tuple) -> None:
    """No equation contains a < L: phases depend on kappa a alone, at half the length as at one and a half."""
    (*_, short, too_short), psi, gaits = settled
    np.testing.assert_array_equal(gaits[short], gaits[too_short])
    # rounding, as long as the line is stable
    assert np.abs(wrapped(psi[short] - psi[too_short])).max() < 1e-9
