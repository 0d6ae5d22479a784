"""The reduced chain against the obstacle problem, the theory, and the full model."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from reference import multilegged_reduced as reference

import gaitsweep as gs
from gaitsweep.engine.numerics import Numerics
from gaitsweep.engine.poincare.poincare_return import crossing_of
from gaitsweep.engine.recorders.recordings import CrossingRecorder
from gaitsweep.engine.recorders.settle import SettleRecorder
from gaitsweep.papers.ambe2021.multilegged.forces import balance, obstacle_problem
from gaitsweep.papers.ambe2021.multilegged.model import GAITS, Multilegged
from gaitsweep.papers.ambe2021.multilegged.reduced import MultileggedReduced
from gaitsweep.papers.ambe2021.theory.chain import Chain
from gaitsweep.papers.ambe2021.theory.gaits import gait_of, locked_state
from gaitsweep.papers.ambe2021.theory.order import characteristic_polynomial, linear_map, multipliers
from gaitsweep.papers.ambe2021.theory.solution_sets import Branch, branches, drift, lag_rules
from gaitsweep.status import Status
from tests.support.multilegged_solutions import solution_set, solution_sets, total
from tests.support.sweeping import run_rows, scalars

DT = 0.4  # s
STEPS = Numerics(method="semi_implicit", dt=DT)
LOCATED = Numerics(method="propagator", dt=0.5)
TURN = 2.0 * np.pi
LEGS = (3, 4, 6, 9)


def wrapped(difference: object) -> np.ndarray:
    return (np.asarray(difference) + np.pi) % TURN - np.pi


def starts(n: int, N: int = 3, seed: int = 4) -> np.ndarray:
    return np.random.default_rng(seed).uniform(0.0, TURN, (n, N))


def columns(psi: np.ndarray) -> dict[str, np.ndarray]:
    return {f"psi_{i + 1}": psi[:, i] for i in range(psi.shape[1])}


def cycle(N: int, numerics: Numerics, **params: float) -> Callable:
    """Psi on section 1 -> psi a cycle later, for one trajectory."""
    model = MultileggedReduced(N)
    values = scalars(model, **params)
    run = crossing_of(model, numerics.resolve(model), "xla")

    def once(psi: jax.Array) -> jax.Array:
        start = {f"psi_{i + 1}": psi[i] for i in range(N)}
        state = model.init(values, {**start, "phi_1": jnp.asarray(jnp.nan)})
        return run(values, state)[1].psi

    return once


@cache
def cycles_of(N: int) -> Callable:
    return jax.jit(jax.vmap(cycle(N, STEPS)))


legs = st.sampled_from([2, 3, 5, 9]).flatmap(
    lambda n: st.tuples(
        *(st.lists(one, min_size=n, max_size=n) for one in (st.floats(0.5, 1.5), st.floats(0.05, 3.0))),
        st.floats(20.0, 2000.0),
    )
)


balanced, solved = jax.jit(balance), jax.jit(obstacle_problem)


@pytest.mark.slow
@settings(max_examples=60)
@given(legs)
def test_balance_is_the_load_with_a_sign(case: tuple[list[float], list[float], float]) -> None:
    length, mass, kappa = np.array(case[0]), np.array(case[1]), case[2]
    result = np.asarray(balanced(length, mass, kappa, 9.8))
    x, load = (np.asarray(out) for out in solved(length, mass, kappa, 9.8))
    scale = 1.0 + mass.size * float(mass.sum()) * 9.8 / case[2]
    assert np.abs(np.maximum(result, 0.0) - load / case[2]).max() < 1e-12 * scale
    assert (result[x - case[0] > 1e-12 * scale] < 0.0).all()
    back = np.asarray(balanced(length[::-1], mass[::-1], kappa, 9.8))[::-1]
    assert np.abs(result - back).max() < 1e-12 * scale


@pytest.mark.slow
@pytest.mark.parametrize("N", [3, 5])
def test_a_cycle_is_that_of_the_obstacle_problem(N: int) -> None:
    """Against touchdowns searched for in the obstacle problem, which knows neither secants nor balances.

    It has no held legs, so starts in which three legs swing together may differ: at most a tenth.
    """
    psi = starts(24, N)
    result = np.asarray(cycles_of(N)(psi))
    expected = np.array([reference.cycle(N, Chain(), row)[0] for row in psi])
    apart = np.abs(wrapped(result - expected)).max(axis=1)
    # rounding alone; a touchdown taken early or late by a step would give 0.1
    assert np.mean(apart < 1e-11) >= 0.9, np.sort(apart)[-6:]


@pytest.mark.slow
def test_located_events_have_the_same_fixed_points() -> None:
    psi = np.asarray(solution_sets(3, samples=8, section=1))[:, 1:-1].reshape(-1, 3)
    after = jax.jit(jax.vmap(cycle(3, LOCATED)))(psi)
    assert np.abs(wrapped(after - psi)).max() < 5e-12  # events are located to 1e-12 s


@pytest.mark.slow
def test_the_locked_state_stays() -> None:
    psi = np.asarray(locked_state(Chain()))[None]
    state = run_rows(MultileggedReduced(), SettleRecorder(MultileggedReduced()), columns(psi), numerics=STEPS)
    assert GAITS[state.labels["gait"][0]] == "locked"


@pytest.mark.slow
@pytest.mark.parametrize("N", LEGS)
def test_analytic_solutions_are_fixed_points_with_their_multipliers(N: int) -> None:
    """The map is linear between jumps, so central differences are right to rounding over the step, 1e-11."""
    step, chain, places = 1e-4, Chain(), [13, 32, 77, 93]
    rules = lag_rules(N, chain)
    low, high = (np.asarray(end)[:, None] for end in (rules.low, rules.high))
    free = low + (high - low) * 0.01 * np.array(places)
    sets = np.asarray(solution_sets(N, chain, 101, 1))[:, places]
    disturbed = sets[:, :, None, None, :] + step * np.array([1.0, -1.0, 0.0])[:, None, None] * np.eye(N)
    after = np.asarray(cycles_of(N)(disturbed.reshape(-1, N))).reshape(disturbed.shape)
    # rounding of N + 1 touchdowns; a wrong order of touchdowns gives 0.1
    assert np.abs(wrapped(after[:, :, 2] - sets[:, :, None])).max() < 1e-12
    jacobians = np.swapaxes(wrapped(after[:, :, 0] - after[:, :, 1]) / (2 * step), -1, -2)
    for row, branch in enumerate(branches(N)):
        for column in range(len(places)):
            result = jacobians[row, column]
            expected = linear_map(N, branch, float(free[row, column]), chain, section=1)
            assert np.abs(result - expected).max() < 1e-9, branch
            # eqs. (22), (26): 1/2 for 2/3 would change the coefficients by 0.1
            assert np.abs(characteristic_polynomial(result) - np.poly(multipliers(N, branch))).max() < 1e-8


@pytest.mark.slow
def test_derivatives_through_located_events_are_those_of_the_theory() -> None:
    jacobian = jax.jit(jax.jacfwd(cycle(3, LOCATED)))
    rules = lag_rules(3, Chain())
    for row, branch in enumerate(branches(3)):
        psi = np.asarray(solution_set(3, branch, samples=101, section=1))[32]
        s = float(rules.low[row] + 0.32 * (rules.high[row] - rules.low[row]))
        assert np.abs(np.asarray(jacobian(psi)) - linear_map(3, branch, s, section=1)).max() < 1e-9


@pytest.mark.slow
def test_engines_and_methods_give_the_same_ends() -> None:
    model, psi = MultileggedReduced(), starts(32)
    ends = [
        run_rows(model, SettleRecorder(model), columns(psi), numerics=numerics, engine=engine, lanes=16)
        for numerics, engine in (
            (STEPS, "kernel"),
            (STEPS, "xla"),
            (Numerics(method="semi_implicit", dt=2.0), "kernel"),
            (LOCATED, "kernel"),
        )
    ]
    for other in ends[1:]:
        np.testing.assert_array_equal(other.labels["gait"], ends[0].labels["gait"])
        np.testing.assert_array_equal(other.cycles, ends[0].cycles)
        assert np.abs(wrapped(other.last - ends[0].last)).max() < 1e-10
    # times are exact where events are located; in steps of 1/38 of a cycle they are late by a few steps
    assert np.abs(ends[0].t_end - ends[3].t_end).max() < 4 * DT
    assert np.all(ends[0].status == Status.settled)
    assert ends[0].labels["distance"].max() < 0.01  # settled to 1e-3 rad a cycle
    assert set(ends[0].labels["gait"]) == {0, 1, 2}


@pytest.mark.slow
def test_the_conserved_quantity_and_its_drift() -> None:
    """E changes by (m_end - m_1) b a cycle, which is 0 in a symmetric chain; eqs. (29)-(32)."""
    model, tail = MultileggedReduced(), Chain(m_1=0.8, m_end=0.95)
    for chain in (Chain(), tail):
        masses = {"m_1": chain.m_1, "m_end": chain.m_end}
        run = run_rows(
            model, CrossingRecorder(model, crossings=60), columns(starts(24)), params=masses, numerics=STEPS
        )
        psi = run.samples.reshape(24, 61, -1)[:, :, 2:-1]
        change = wrapped(np.diff(np.asarray(total(psi)), axis=1))
        expected = float(drift(chain))
        settled = change[:, 30:]
        # rounding; neighbours of the ends may still swing in transients, and stay put at the line's end
        assert np.mean(np.abs(settled - expected) < 1e-12) > 0.9
    assert expected == pytest.approx(0.15 * 0.153938, abs=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("chain", [Chain(m_1=0.6, m_end=0.95), Chain(m_1=0.95, m_end=0.6)])
def test_broken_symmetry_leaves_one_gait(chain: Chain) -> None:
    model = MultileggedReduced()
    masses = {"m_1": chain.m_1, "m_end": chain.m_end}
    recorder = SettleRecorder(model, max_cycles=500, tolerance=1e-6)
    run = run_rows(
        model, recorder, columns(starts(64)), params=masses, numerics=STEPS, engine="kernel", lanes=64
    )
    tail = chain.m_end > chain.m_1
    end = solution_set(3, Branch("B", 2) if tail else Branch("direct", 3), chain, section=1)[-1]
    assert {GAITS[g] for g in run.labels["gait"]} == {"retrograde" if tail else "direct"}
    assert np.all(run.status == Status.settled)
    assert np.abs(wrapped(run.last[:, :3] - np.asarray(end))).max() < 1e-4


@pytest.mark.slow
def test_ten_legs_keep_their_gaits() -> None:
    model = MultileggedReduced(9)
    sets = np.asarray(solution_sets(9, samples=5, section=1))[:, 2]
    noise = np.random.default_rng(3).normal(0.0, 0.02, sets.shape)
    # few rows, whose kernel takes longer to compile than XLA's program
    starts = columns(sets + noise)
    run = run_rows(model, SettleRecorder(model), starts, numerics=STEPS, lanes=17, engine="xla")
    expected = [GAITS[gait_of(branch)] for branch in branches(9)]
    assert [GAITS[g] for g in run.labels["gait"]] == expected


@pytest.mark.slow
def test_signals_are_the_chain_at_rest() -> None:
    model = MultileggedReduced()
    params = scalars(model)
    for psi in starts(5, seed=9):
        start = {f"psi_{i + 1}": jnp.asarray(psi[i]) for i in range(3)}
        state = model.init(params, {**start, "phi_1": jnp.asarray(2.0)})
        signals = {k: float(v) for k, v in model.signal(params, state).items()}
        assert sum(signals[f"load_{i}"] for i in (1, 2, 3, 4)) == pytest.approx(3.8 * 9.8, abs=1e-11)
        assert all(signals[f"x_{i}"] >= signals[f"l_{i}"] for i in (1, 2, 3, 4))


def test_the_sections_coordinates_put_a_state_back() -> None:
    model = MultileggedReduced()
    params, chart = scalars(model), model.chart()
    assert chart is not None
    for psi in np.asarray(solution_sets(3, samples=5, section=1))[:, 2]:
        start = {f"psi_{i + 1}": jnp.asarray(psi[i]) for i in range(3)}
        state = model.init(params, {**start, "phi_1": jnp.asarray(jnp.nan)})
        at = chart.to_coordinates(params, state)
        assert bool(chart.covers(params, state))
        assert np.abs(wrapped(np.asarray(at)[1:] - psi[1:])).max() < 1e-14
        back = chart.from_coordinates(params, at, state)
        np.testing.assert_allclose(np.asarray(back.phi), np.asarray(state.phi), atol=1e-14)


@pytest.mark.slow
def test_no_touchdown_outside_the_conditions() -> None:
    model = MultileggedReduced()
    run = run_rows(model, SettleRecorder(model), columns(starts(4)), params={"a": 0.05}, numerics=STEPS)
    assert np.all(run.status == Status.not_a_number)


@pytest.mark.slow
def test_labels_are_the_full_models() -> None:
    """1 000 random starts: the same gait in 97 % or more, and each gait's share within 2 %."""
    psi = starts(1000, seed=21)
    results = []
    for model, numerics in (
        (MultileggedReduced(), STEPS),
        (Multilegged(), Numerics(method="propagator6", dt=32e-3)),
    ):
        run = run_rows(
            model,
            SettleRecorder(model),
            columns(psi),
            numerics=numerics,
            engine="kernel",
            lanes=256,
            devices=2,
        )
        assert np.all(run.status == Status.settled)
        results.append(run.labels["gait"])
    equal = np.mean(results[0] == results[1])
    print(f"labels equal in {100 * equal:.1f} % of 1 000 random starts")
    assert equal >= 0.97
    shares = [np.bincount(labels, minlength=5) / 1000 for labels in results]
    assert np.abs(shares[0] - shares[1]).max() < 0.02


@pytest.mark.slow
def test_legs_in_phase_are_where_the_models_differ() -> None:
    """From most starts with legs nearly in phase the reduced chain never lifts one; the full model does."""
    psi = np.mod(np.random.default_rng(6).uniform(-0.03, 0.03, (12, 3)), TURN)
    reduced, full = MultileggedReduced(), Multilegged()
    run = run_rows(reduced, SettleRecorder(reduced), columns(psi), numerics=STEPS, engine="kernel", lanes=16)
    stays = np.array([GAITS[gait] == "none" for gait in run.labels["gait"]])
    assert stays.sum() >= 6
    assert np.all(run.last[stays, 3] == 0.0)  # leg 1 has not touched down: its phase passed 2 pi
    numerics = Numerics(method="propagator6", dt=32e-3)
    run = run_rows(full, SettleRecorder(full), columns(psi), numerics=numerics, engine="kernel", lanes=16)
    assert {GAITS[g] for g in run.labels["gait"]} <= {"direct", "source", "retrograde"}


@pytest.mark.slow
def test_the_mirror_image_of_a_wave_is_a_wave() -> None:
    """Reversed, the direct wave psi_i is the wave 2 pi - psi_{4-i}, with the same multipliers."""
    chain = gs.return_map(MultileggedReduced(), numerics={"method": "propagator"}, m_B=0.8)
    wave = chain.fixed_points(chain.settled({"psi_1": 1.13, "psi_2": 0.98, "psi_3": 1.5}, 60), fix=["E"])
    assert wave.converged[0]
    (image,) = chain.mapping.mirrored(wave.points, chain.mapping.complete({}, 1)).values()
    again = chain.fixed_points(image, fix=["E"])
    assert again.residual[0] < 1e-9
    np.testing.assert_allclose(chain(image).at, image.at, atol=1e-9)
    sizes = [np.sort(np.abs(chain.multipliers(points)[0])) for points in (wave.points, image)]
    np.testing.assert_allclose(sizes[0], sizes[1], atol=1e-8)
    # the phases of the legs while all of leg 1's neighbours stand do not depend on the section
    inner = wave.images.observed["psi_2"][0]
    assert again.images.observed["psi_2"][0] == pytest.approx(2.0 * np.pi - inner, abs=1e-9)
