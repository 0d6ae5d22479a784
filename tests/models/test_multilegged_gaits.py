"""Labels of settled states: the analytic solution that they lie nearest to."""

from __future__ import annotations

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gaitsweep.papers.ambe2021.theory.chain import Chain
from gaitsweep.papers.ambe2021.theory.gaits import GAITS, LOCKED, NONE, SOURCE, classify, distances, gait_of
from gaitsweep.papers.ambe2021.theory.solution_sets import Branch, branches
from tests.support.multilegged_solutions import solution_set, solution_sets

LEGS = (3, 4, 6, 9)
TURN = 2.0 * np.pi
labels = jax.jit(jax.vmap(lambda psi: classify(psi.shape[0], psi)))
away = jax.jit(lambda psi: distances(3, Chain(), psi))


@pytest.mark.slow
def test_known_points_of_the_full_model_take_their_gait() -> None:
    a, b, c = [1.1301, 0.9842, 1.4960], [3.959, 5.300, 5.291], [1.130, 1.102, 5.282]
    psi = [a, b, c, [5.209, 0.0, 1.074], [3.0, 3.0, 3.0]]
    gait, k, distance = labels(jnp.array(psi))
    assert [GAITS[g] for g in gait] == ["direct", "retrograde", "source", "locked", "none"]
    assert k.tolist() == [0, 0, 3, 0, 0]
    assert float(distance[:3].max()) < 0.12  # the paper's largest distance is 0.11 rad
    almost = jnp.array([[5.209, 0.06, 1.074], [5.209, 0.02, 1.074], [jnp.nan, 1.0, 1.0]])
    assert labels(almost)[0].tolist() == [NONE, LOCKED, NONE]


@pytest.mark.slow("4", "6", "9")
@pytest.mark.parametrize("N", LEGS)
def test_every_point_of_a_set_takes_the_sets_label(N: int) -> None:
    # the ends left out: there the next set is as near
    psi = solution_sets(N, samples=24, section=1)[:, 2:-2]
    gait, k, distance = (np.asarray(out).reshape(len(psi), -1) for out in labels(psi.reshape(-1, N)))
    for row, branch in enumerate(branches(N)):
        assert set(gait[row]) == {gait_of(branch)}
        assert set(k[row]) == {branch.k if gait_of(branch) == SOURCE else 0}
    assert distance.max() < 1e-12


@pytest.mark.slow("4", "6")
@pytest.mark.parametrize("N", LEGS)
def test_reversing_the_legs_maps_direct_to_retrograde(N: int) -> None:
    mirrors = {Branch("direct", N): Branch("B", 2), Branch("B", 2): Branch("direct", N)}
    for branch in branches(N):
        beyond = 2 if branch.kind == "A" else 3
        mirrors.setdefault(branch, Branch(branch.kind, N + beyond - branch.k))
    psi = solution_sets(N, samples=22, section=N + 1)[:, 1:-1]  # as many as above: one program of labels
    reversed_legs = -psi[:, :, ::-1].reshape(-1, N)  # section N + 1 becomes section 1
    gait, k, distance = (np.asarray(out).reshape(len(psi), -1) for out in labels(reversed_legs))
    for row, branch in enumerate(branches(N)):
        mirror = mirrors[branch]
        assert set(gait[row]) == {gait_of(mirror)}
        assert set(k[row]) == {mirror.k if gait_of(mirror) == SOURCE else 0}
    assert distance.max() < 1e-12


def test_beside_a_corner_the_first_set_counts_whatever_the_rounding() -> None:
    """The direct and a source set end in one corner, to which a whole line of starts of Fig. 5 comes."""
    beside = np.array([1.13026897970, 0.98520440730, 5.16697428540])  # beyond the ends of both sets
    near = np.sort(np.asarray(away(beside)))
    assert near[1] - near[0] < 1e-12 < near[2] - near[1]
    moved = beside + 1e-11 * np.random.default_rng(5).normal(size=(22, 3))
    assert {GAITS[each] for each in labels(moved)[0]} == {"direct"}


angles = st.lists(st.floats(0, TURN), min_size=3, max_size=3)


@pytest.mark.slow
@settings(max_examples=200)
@given(angles, st.lists(st.integers(-2, 2), min_size=3, max_size=3))
def test_labels_do_not_change_with_whole_turns(psi: list[float], turns: list[int]) -> None:
    both = np.array([psi, np.add(psi, TURN * np.array(turns))])
    gait, k, distance = (np.asarray(out) for out in labels(both))
    assert distance[0] == pytest.approx(distance[1], abs=1e-9)
    nearest = np.sort(away(both[0]))
    # rounding may decide where two sets are equally near, and at the edge of `none`
    if nearest[1] - nearest[0] > 1e-9 and abs(nearest[0] - 0.2) > 1e-9:
        assert (gait[0], k[0]) == (gait[1], k[1])


@functools.cache
def _dense_sets() -> np.ndarray:
    return np.asarray(solution_sets(3, samples=512, section=1))


@settings(max_examples=100)
@given(angles)
def test_distances_are_those_from_densely_sampled_sets(psi: list[float]) -> None:
    dense = _dense_sets()
    nearest = np.linalg.norm((np.array(psi) - dense + np.pi) % TURN - np.pi, axis=2).min(axis=1)
    exact = np.asarray(away(np.array(psi)))
    near = nearest < 1.5  # farther away a slanted piece is measured from one of its images only
    assert (exact <= nearest + 1e-9)[near].all()
    assert (exact > nearest - 6e-3)[near].all()  # half the distance between samples


@pytest.mark.slow
def test_unequal_ends_keep_their_end_points_gait() -> None:
    tail = {"m_1": 0.6, "m_end": 0.95}
    psi = solution_set(3, Branch("B", 2), Chain(**tail), section=1)[-1]
    gait, _, distance = classify(3, psi, Chain(**tail))
    assert (GAITS[int(gait)], float(distance) < 1e-9) == ("retrograde", True)
    head = {"m_1": 0.95, "m_end": 0.6}
    psi = solution_set(3, Branch("direct", 3), Chain(**head), section=1)[-1]
    gait, _, distance = classify(3, psi, Chain(**head))
    assert (GAITS[int(gait)], float(distance) < 1e-9) == ("direct", True)


@pytest.mark.slow
def test_rows_may_differ_in_every_parameter() -> None:
    chains = (Chain(), Chain(beta=0.72, kappa=140.0, m=1.1, m_1=0.8, m_end=0.8, a=0.35, g=9.81))
    psi = jnp.stack([solution_set(4, Branch("B", 3), chain, section=1)[20] for chain in chains])
    given = [[value for value in chain if value is not None] for chain in chains]
    columns = dict(zip(Chain._fields, jnp.array(given).T, strict=False))
    gait, k, distance = jax.jit(jax.vmap(lambda p, values: classify(4, p, Chain(**values))))(psi, columns)
    assert gait.tolist() == [SOURCE, SOURCE]
    assert k.tolist() == [3, 3]
    assert float(distance.max()) < 1e-12


def test_two_legs_in_phase_are_locked_in_longer_chains() -> None:
    psi = jnp.array([[5.1, 1.0, 0.01, 1.0], [5.1, 1.0, 0.1, 1.0]])
    assert labels(psi)[0].tolist() == [LOCKED, NONE]
