"""The analytic solutions of the multi-legged chain against its reduced map and the printed equations."""

from __future__ import annotations

import itertools
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from reference import multilegged_reduced as reduced

from gaitsweep import ArgumentError
from gaitsweep.papers.ambe2021.theory.chain import (
    TABLE_1,
    Chain,
    end_resets,
    shift,
    touchdown_phase,
    wave_speed,
    wavelength,
)
from gaitsweep.papers.ambe2021.theory.gaits import locked_state, segments
from gaitsweep.papers.ambe2021.theory.order import (
    characteristic_polynomial,
    eigenvalues,
    jumps,
    linear_map,
    multipliers,
    order_sets,
    reset_sets,
    touchdown_order,
    touchdown_residuals,
)
from gaitsweep.papers.ambe2021.theory.solution_sets import (
    Branch,
    branches,
    drift,
    lag_rules,
    line_length,
    rule_of,
    touches_early,
    worst_case_cycles,
)
from tests.support.multilegged_solutions import solution_set, solution_sets, total, transport

OTHER = Chain(beta=0.72, kappa=140.0, m=1.1, m_1=0.8, m_end=0.8, a=0.35, g=9.81)
LEGS = (3, 4, 6, 9)
TURN = 2.0 * np.pi


def apart(one: object, other: object) -> float:
    """Largest wrapped difference, rad."""
    return float(np.abs((np.asarray(one) - np.asarray(other) + np.pi) % TURN - np.pi).max())


def points(N: int, chain: Chain, section: int | None = None) -> np.ndarray:
    """Points of every set, none at its end or in its middle (where two legs of set A touch at once)."""
    return np.asarray(solution_sets(N, chain, 8, section))[:, 1:-1]


def own_legs(N: int) -> np.ndarray:
    return np.array([branch.k for branch in branches(N)])


@pytest.mark.slow("4-table 1", "6-table 1", "9-other", "9-table 1", "6-other", "4-other")
@pytest.mark.parametrize("chain", [TABLE_1, OTHER], ids=["table 1", "other"])
@pytest.mark.parametrize("N", LEGS)
def test_solutions_on_section_1_are_fixed_points_of_the_reduced_map(N: int, chain: Chain) -> None:
    every = slice(None) if N == 3 else slice(1, 2)
    for branch, psis in zip(branches(N), points(N, chain, 1), strict=True):
        for psi in psis[every]:
            after, met = reduced.cycle(N, chain, psi)
            # rounding of phases of order 2 pi over N + 1 touchdowns; a wrong order of touchdowns gives 0.1
            assert apart(after, psi) < 1e-12, branch
            assert apart(met, touchdown_phase(chain)) < 1e-12
            assert len(met) == N + 1


def test_a_state_off_the_sets_is_not_a_fixed_point() -> None:
    psi = points(3, TABLE_1, 1)[2][3] + [0.05, 0.0, 0.0]
    after, _ = reduced.cycle(3, TABLE_1, psi)
    assert apart(after, psi) > 0.01


def test_the_locked_state_is_a_fixed_point_of_the_reduced_map() -> None:
    for chain in (TABLE_1, OTHER):
        psi, touchdown = np.asarray(locked_state(chain)), float(TURN - chain.m * shift(chain))
        after, met = reduced.cycle(3, chain, psi, touchdown, tie=1e-13)
        assert apart(after, psi) < 1e-11  # `tie` is 2e-13 rad of phase for each leg
        assert apart(met, touchdown) < 1e-11
        assert len(met) == 4
    # the full model's, from its page; its direct wave is as far from the theory's (0.011 rad)
    assert apart(locked_state(TABLE_1), [5.209, 0.0, 1.074]) < 0.02


def _printed(N: int, branch: Branch, chain: Chain, psi: np.ndarray, early: np.ndarray) -> np.ndarray:
    """Eqs. (17), (20), (24) to the letter on section k; the free relative phase taken from psi."""
    b, m, m_B, beta, k = float(shift(chain)), chain.m, chain.m_1, chain.beta, branch.k
    printed = psi.copy()
    for i in range(1, N + 1):
        forward = 2 * (1 - beta) * np.pi - ((2 if early[i - 1] else 3) * m_B - m) * b
        backward = 2 * beta * np.pi + ((2 if early[i] else 3) * m_B - m) * b
        if branch.kind == "direct":
            printed[i - 1] = psi[i - 1] if i == N else forward
        elif i == k and branch.kind == "A":
            printed[i - 1] = psi[k - 2] + (4 * beta - 2) * np.pi + (4 * m_B - m) * b
        elif i != k - 1:
            printed[i - 1] = forward if i < k - 1 else backward
    return printed


@pytest.mark.slow("4", "6", "9")
@pytest.mark.parametrize("N", LEGS)
def test_sets_on_their_own_section_are_the_printed_equations(N: int) -> None:
    b, beta, m_B = float(shift(OTHER)), OTHER.beta, OTHER.m_1
    sets, legs, circle = points(N, OTHER), own_legs(N), touchdown_phase(OTHER)
    threshold = jnp.asarray(2 * beta * np.pi + (2 * m_B - OTHER.m) * b)
    order = jax.vmap(jax.vmap(lambda psi, leg: touches_early(psi, circle, threshold, leg), (0, None)))
    for branch, psis, early in zip(branches(N), sets, np.asarray(jax.jit(order)(sets, legs)), strict=True):
        for psi, who in zip(psis, early, strict=True):
            assert apart(psi, _printed(N, branch, OTHER, psi, who)) < 1e-12, branch

    psi_A = 2 * (1 - beta) * np.pi - (3 * m_B - OTHER.m) * b
    psi_B = 2 * (1 - beta) * np.pi - m_B * b
    rules = jax.jit(lag_rules, static_argnums=0)(N, OTHER)
    for branch, low, high in zip(branches(N), rules.low, rules.high, strict=True):
        if branch.kind == "direct":
            ends = [2 * (1 - beta) * np.pi, 2 * beta * np.pi + m_B * b]
            assert apart([-high, -low], ends) < 1e-12  # eq. (25)
        else:
            ends = [psi_A, psi_B] if branch.kind == "A" else [psi_B, 2 * beta * np.pi]
            assert apart([low, high], ends) < 1e-12  # eqs. (19), (20)


def test_order_sets_exist_for_more_legs() -> None:
    psi = np.asarray(solution_set(9, Branch("B", 5), samples=33))
    # psi_2 jumps where leg 2 comes to touch before leg 3
    assert len({round(float(row[1]), 6) for row in psi}) == 2
    assert np.ptp(psi[:, 1]) == pytest.approx(0.9 * float(shift(TABLE_1)), abs=1e-12)
    assert np.ptp(psi[:, 2]) < 1e-12


@pytest.mark.slow("9", "6", "4")
@pytest.mark.parametrize("N", LEGS)
def test_transport_between_sections_is_exact_and_undone_by_going_back(N: int) -> None:
    circle = touchdown_phase(TABLE_1)
    across = jax.vmap(jax.vmap(lambda psi, one, other: transport(psi, circle, one, other), (0, None, None)))
    moved, own, legs = jax.jit(across), points(N, TABLE_1), own_legs(N)
    for leg in (1, N + 1):
        there, target = points(N, TABLE_1, leg), np.full_like(legs, leg)
        assert apart(moved(own, legs, target), there) < 1e-12
        assert apart(moved(there, target, legs), own) < 1e-12


def test_numbers_of_the_models_page() -> None:
    assert float(shift(TABLE_1)) == pytest.approx(0.153938, abs=5e-7)
    assert float(touchdown_phase(TABLE_1)) == pytest.approx(6.14464, abs=5e-6)
    assert float(wavelength()) == pytest.approx(6.17588, abs=5e-6)
    printed, exact = wave_speed(0.4)
    assert float(printed) == pytest.approx(0.39317, abs=5e-6)
    assert float(exact) == pytest.approx(0.40203, abs=5e-6)
    beta, kappa, m, m_B, _, a, g, *_ = OTHER
    equation_27 = (1 / (1 - beta) - m_B * g / (2 * kappa * a)) / (1 - (3 * m_B - m) * g / (2 * kappa * a))
    assert float(wavelength(OTHER)) == pytest.approx(equation_27, rel=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("N", [3, 6])
def test_pieces_are_the_whole_of_the_sets_and_join_but_for_resets(N: int) -> None:
    lines = segments(N)
    half, middle, direction = (np.asarray(part) for part in (lines.half, lines.middle, lines.direction))
    rules = lag_rules(N, TABLE_1)
    whole = np.asarray(rules.high - rules.low) * np.linalg.norm(rules.slope, axis=1)
    assert np.allclose(2 * half.sum(axis=1), whole, atol=1e-12)
    reach = direction * half[..., None]
    # the direct wave's pieces are numbered away from where it joins set A of k = N
    half, middle, reach = (np.concatenate([part[:1, ::-1], part[1:]]) for part in (half, middle, reach))
    reach, middle = (part.reshape(-1, N)[half.ravel() > 1e-9] for part in (reach, middle))
    # one piece after another along the line of all sets: a leg's reset on the way shifts two psi by m_B b
    jump = 0.9 * float(shift(TABLE_1))
    ends = np.stack([middle - reach, middle + reach])
    pairs = [(one[:-1], other[1:]) for one in ends for other in ends]
    gaps = np.min([np.abs((one - other + np.pi) % TURN - np.pi).max(axis=1) for one, other in pairs], axis=0)
    assert (np.minimum(gaps, np.abs(gaps - jump)) < 1e-9).all(), gaps


@pytest.mark.slow
def test_unequal_ends_leave_the_end_points_of_the_models_page() -> None:
    tail, beta = Chain(m_1=0.6, m_end=0.95), 0.8
    b = float(shift(tail))
    psi = np.array([2 * beta * np.pi + (1.9 - 0.6) * b, *[2 * beta * np.pi + (2.85 - 1.0) * b] * 2])
    after, _ = reduced.cycle(3, tail, psi)
    assert apart(after, psi) < 1e-12
    assert apart(solution_set(3, Branch("B", 2), tail, section=1)[-1], psi) < 1e-12
    head = Chain(m_1=0.95, m_end=0.6)
    mirrored = -psi[::-1]  # reversing the legs makes section 1 that of the last leg
    assert apart(solution_set(3, Branch("direct", 3), head, section=4)[-1], mirrored) < 1e-12
    on_first = np.asarray(solution_set(3, Branch("direct", 3), head, section=1)[-1])
    after, _ = reduced.cycle(3, head, on_first, tie=1e-14)
    assert apart(after, on_first) < 1e-12


@pytest.mark.parametrize("branch", [Branch("A", 4), Branch("B", 1), Branch("direct", 2)])
def test_a_boundary_leg_outside_the_chain_is_refused(branch: Branch) -> None:
    with pytest.raises(ValueError, match=r"one of 2 \.\. 3"):
        rule_of(3, branch, TABLE_1)
    with pytest.raises(ValueError, match="at least 2"):
        branches(1)


@pytest.mark.slow("9-table 1")
@pytest.mark.parametrize("chain", [TABLE_1, OTHER], ids=["table 1", "other"])
@pytest.mark.parametrize("N", LEGS)
def test_multipliers_are_the_papers(N: int, chain: Chain) -> None:
    """Eqs. (22), (26) from the product of touchdowns, on any section."""

    def matrix(branch: Branch, share: float, section: int | None) -> np.ndarray:
        rule = rule_of(N, branch, chain)
        s = float(rule.low + share * (rule.high - rule.low))
        return np.asarray(linear_map(N, branch, s, chain, section))

    for branch, share, section in itertools.product(branches(N), (0.13, 0.37, 0.9), (None, 1, N + 1)):
        result = characteristic_polynomial(matrix(branch, share, section))
        # rounding; 1/2 for one 2/3 would change the coefficients by 0.1
        assert np.abs(result - np.poly(multipliers(N, branch))).max() < 1e-12
    # why polynomials: the 2/3 block is defective
    last = branches(N)[-1]
    eigenvalues = np.linalg.eigvals(matrix(last, 0.9, N + 1))
    assert np.abs(np.sort(eigenvalues.real) - np.sort(multipliers(N, last))).max() < 0.05


def test_characteristic_polynomial_of_a_known_matrix() -> None:
    matrix = np.array([[2.0, 1.0, 0.0], [0.0, 2.0, 0.0], [3.0, 0.0, -1.0]])
    assert np.allclose(characteristic_polynomial(matrix), np.poly([2.0, 2.0, -1.0]), atol=1e-14)


@pytest.mark.parametrize("N", [4, 9])
def test_orders_of_touchdown_are_those_of_the_figure(N: int) -> None:
    """Fig. 9: from leg k on backwards one by one, the legs a wave behind put in between."""
    for branch in branches(N):
        rule = rule_of(N, branch, TABLE_1)
        for share in (0.2, 0.8):
            order = touchdown_order(N, branch, float(rule.low + share * (rule.high - rule.low)))
            assert sorted(order) == list(range(1, N + 2))
            assert order[0] == branch.k
            if branch.kind != "direct" and N - branch.k < 5:  # less than a wave: one after another
                behind = [leg for leg in order if leg >= branch.k]
                assert behind == list(range(branch.k, N + 2))
    for section in (0, N + 2):
        for function in (jumps, partial(touchdown_order, s=1.0), partial(linear_map, s=1.0)):
            with pytest.raises(ArgumentError, match=f"section is {section}, .* a leg from 1 to {N + 1}"):
                function(N, branches(N)[0], section=section)
    # a wave is 6.2 legs long: leg 9 is 7 behind leg 2, touches after it and before its own neighbours
    assert touchdown_order(9, Branch("B", 2), 4.0)[:5] == (2, 9, 3, 10, 4)


@pytest.mark.slow("3", "6", "9")
@pytest.mark.parametrize("N", LEGS)
def test_sets_jump_by_the_resets_phase_where_the_order_changes(N: int) -> None:
    """Fig. 11: each jump is m_B b, up in one relative phase of the leg that passes and down in the other."""
    size = 0.9 * float(shift(TABLE_1))
    for branch in branches(N):
        for section in (branch.k, 1):
            for jump in jumps(N, branch, section=section):
                expected = np.zeros(N)
                side = np.sign(jump.change[np.abs(jump.change).argmax()]) * size
                for i in (jump.leg - 2, jump.leg - 1):
                    if 0 <= i < N:
                        expected[i] = abs(side) * np.sign(jump.change[i])
                assert np.abs(jump.change - expected).max() < 1e-12
                near = [touchdown_order(N, branch, jump.s + d, section=section) for d in (-1e-3, 1e-3)]
                assert near[0] != near[1]
                assert jump.leg in {order[1] for order in near} | {order[-1] for order in near}


def test_results_of_uniform_chains_refuse_ends_that_differ() -> None:
    """The threshold of eq. (18) would count leg 1 as early, which touches down after leg 2."""
    branch, other = Branch("B", 8), Chain(kappa_1=70.0, kappa_end=130.0)
    rule = rule_of(9, branch, other)
    s = float(rule.low + 0.24 * (rule.high - rule.low))
    assert [leg for leg, each in enumerate(reset_sets(9, branch, s, other), 1) if each.is_first] == [2, 8]
    for refused in (order_sets, touchdown_residuals):
        with pytest.raises(ArgumentError, match="kappa_1 is 70 and kappa 100"):
            refused(9, branch, s, other)
        refused(9, branch, s, Chain(kappa_1=100.0, a_end=0.4))


@pytest.mark.slow
def test_a_chain_at_the_limit_of_existence_has_numbers() -> None:
    """At m_B = m/2 no neighbour is in takeoff, and set A is empty."""
    lengths = [float(line_length(3, Chain(m_1=m, m_end=m))) for m in (0.5, 0.5 + 1e-9)]
    assert lengths[0] == pytest.approx(lengths[1], abs=1e-6)
    direct = solution_set(3, Branch("A", 3), Chain(m_1=0.5, m_end=0.5), samples=2)
    assert np.isfinite(direct).all()


def test_early_legs_are_those_that_jumped() -> None:
    """T_1 of (9, B, k = 5): empty, then leg 1, then leg 2; psi_2 is longer while leg 2 is in it."""
    first, second = jumps(9, Branch("B", 5))
    assert (first.leg, second.leg) == (1, 2)
    for s, early in ((first.s - 0.1, set()), (first.s + 0.1, {1}), (second.s + 0.1, {2})):
        in_front, behind = order_sets(9, Branch("B", 5), s)
        assert (in_front, behind) == (early, set())
    assert order_sets(9, Branch("B", 2), 4.0)[1] == {9}


@pytest.mark.slow
def test_the_conserved_quantity() -> None:
    """Eqs. (29)-(32): E distinguishes the solutions of a line, and drifts if head and tail differ."""
    psi = np.asarray(solution_sets(3, samples=33, section=2))
    E = np.unwrap(np.concatenate([np.asarray(total(psi))[0][::-1], *np.asarray(total(psi))[1:]]))
    along = np.abs(np.diff(E))
    assert (along < 0.2).all()  # no gap but for a reset, 0.14 rad
    assert float(line_length(3)) == pytest.approx(12.218, abs=1e-3)
    assert float(line_length(20)) == pytest.approx(4.2 * 20, rel=0.02)  # its page: about 4.2 N
    tail = Chain(m_1=0.85, m_end=0.95)
    head, end = map(float, end_resets(tail))
    assert head == pytest.approx(0.85 * 9.8 * 0.2 * np.pi / (100 * 0.4), rel=1e-12)
    assert end - head == pytest.approx(float(drift(tail)), abs=1e-15)
    assert float(drift(tail)) == pytest.approx(0.1 * 0.153938, abs=1e-7)
    # the page's largest of random starts: 825 and 237 cycles, the way to the line included
    assert float(worst_case_cycles(3, tail)) == pytest.approx(800.2, abs=0.1)
    assert float(worst_case_cycles(3, Chain(m_1=0.6, m_end=0.95))) == pytest.approx(229.3, abs=0.1)
    assert float(worst_case_cycles(3, TABLE_1)) == np.inf


@pytest.mark.parametrize("N", [3, 9])
def test_each_leg_touches_down_by_its_set_in_table_2(N: int) -> None:
    """Eq. (14) holds with the resets of each leg's set, and with no other ones."""
    for branch in branches(N):
        rule = rule_of(N, branch, OTHER)
        s = float(rule.low + 0.7 * (rule.high - rule.low))
        assert np.abs(touchdown_residuals(N, branch, s, OTHER)).max() < 1e-14
        sets = reset_sets(N, branch, s, OTHER)
        order = touchdown_order(N, branch, s, OTHER)
        # S_3 (S_1, S_7 at the ends) are the legs that touch down before their neighbours: k, T_1 and T_2
        alone = {i for i, each in enumerate(sets, 1) if not each.front and not each.rear}
        t_1, t_2 = order_sets(N, branch, s, OTHER)
        assert alone == {branch.k} | t_1 | t_2
        assert {sets[0].number, sets[-1].number} <= {1, 2, 7, 8}
        assert order[0] == branch.k
        # in the retrograde part S_5 does not occur, in the direct part S_6 does not
        assert all(each.number != 6 for each in sets[: branch.k - 1])
        assert all(each.number != 5 for each in sets[branch.k :])


@pytest.mark.parametrize("N", [3, 9, pytest.param(20, marks=pytest.mark.slow)])
def test_eigenvalues_of_a_cycle_are_those_printed_without_scatter(N: int) -> None:
    for branch in branches(N)[:: max(1, N // 4)]:
        rule = rule_of(N, branch, OTHER)
        result = eigenvalues(linear_map(N, branch, float(rule.low + 0.45 * (rule.high - rule.low)), OTHER))
        expected = np.sort(multipliers(N, branch))[::-1]
        assert np.abs(result - expected).max() < 1e-12, branch


def test_eigenvalues_of_a_full_matrix_are_numpys() -> None:
    matrix = np.random.default_rng(0).normal(size=(5, 5))
    expected = np.linalg.eigvals(matrix)
    assert np.allclose(np.poly(eigenvalues(matrix)), np.poly(expected))
