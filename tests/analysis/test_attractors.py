"""Attractors from settled states alone: points, lines on a torus, corners, names along a parameter."""

from __future__ import annotations

from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.cluster.hierarchy import fcluster, linkage
from scipy.spatial.distance import squareform

import gaitsweep as gs
from gaitsweep.analysis.basins.attractor_matching import follow_attractors
from gaitsweep.analysis.basins.attractors import (
    MOST_CELLS,
    MOST_STATES,
    SampledSet,
    agreement,
    attractors,
    cells,
    components,
    linking_distance,
    spanning_tree,
    with_attractors,
)
from gaitsweep.analysis.basins.state_space import Space
from gaitsweep.analysis.records import AnalysisError
from gaitsweep.papers.ambe2021.theory.chain import Chain
from gaitsweep.papers.ambe2021.theory.gaits import GAITS, classify, locked_state, segments

TURN = 2 * np.pi


def settled(states: np.ndarray, **more) -> pd.DataFrame:
    """A table of rows that settled in these states, angles psi_1, psi_2, ..."""
    columns = {f"psi_{i + 1}_end": np.mod(states[:, i], TURN) for i in range(states.shape[1])}
    return pd.DataFrame({"row": np.arange(len(states)), **more, "status": "settled", **columns})


def same_partition(one: np.ndarray, other: np.ndarray) -> bool:
    pairs = np.unique(np.stack([one, other]), axis=1).shape[1]
    return pairs == len(np.unique(one)) == len(np.unique(other))


@settings(max_examples=30)
@given(
    seed=st.integers(0, 10**6),
    count=st.integers(2, 60),
    closed=st.lists(st.booleans(), min_size=1, max_size=4),
)
def test_linkage_is_scipys(seed: int, count: int, closed: list[bool]) -> None:
    """The tree's links are the heights of SciPy's single linkage, and cutting it gives SciPy's clusters."""
    random = np.random.default_rng(seed)
    space = Space(np.where(closed, TURN, 0.0), np.ones(len(closed)))
    points = random.uniform(0, TURN, (count, len(closed)))
    apart = np.sqrt(
        sum(
            np.minimum(d := np.abs(points[:, None, i] - points[None, :, i]), TURN - d if closed[i] else d)
            ** 2
            for i in range(len(closed))
        )
    )
    oracle = linkage(squareform(apart, checks=False), "single")
    links, lengths = spanning_tree(space, points)
    np.testing.assert_allclose(np.sort(lengths), oracle[:, 2], atol=1e-12)
    at = float(np.median(lengths)) + 1e-9
    mine = components(count, links[lengths <= at])
    assert same_partition(mine, fcluster(oracle, at, "distance"))


def test_attractors_that_cross_the_seam_of_an_angle() -> None:
    """A point at the seam, a closed line along psi_2 and a line that winds twice are one attractor each."""
    random = np.random.default_rng(1)
    point = 0.01 * random.normal(size=(300, 3)) + [0.0, 3.0, 0.0]
    t = random.uniform(0, TURN, 900)
    ring = np.stack([np.full_like(t, 1.5), t, np.full_like(t, 2.0)], 1)
    winding = np.stack([4.0 + 0.2 * np.cos(2 * t), t, 2 * t], 1)
    table = settled(np.concatenate([point, ring, winding]))
    result = attractors(table)
    truth = np.repeat([0, 1, 2], [300, 900, 900])
    assert same_partition(result.column.cat.codes.to_numpy(), truth)
    by_size = result.summary.set_index("rows")
    assert by_size.loc[300, ["dimension", "kind"]].tolist() == [0, "point"]
    np.testing.assert_allclose(
        np.cos(by_size.loc[300, ["psi_1_end", "psi_3_end"]].astype(float)), 1.0, atol=1e-3
    )
    lines = result.summary[result.summary["rows"] == 900]
    assert set(lines["kind"]) == {"line"}
    assert sorted(lines["extent"])[0] == pytest.approx(TURN, rel=0.03)  # the ring, but for its widest gap


@settings(max_examples=12)
@given(factor=st.floats(1e-3, 1e3), seed=st.integers(0, 1000))
def test_grouping_is_independent_of_the_unit(factor: float, seed: int) -> None:
    """States in another unit give the same attractors, with the link scaled accordingly."""
    random = np.random.default_rng(seed)
    centres = np.array([[0.0, 0.0], [1.0, 0.3], [0.2, 1.1]])
    states = np.concatenate([centre + 0.03 * random.normal(size=(80, 2)) for centre in centres])

    def group(scale: float):
        columns = {"a_end": scale * states[:, 0], "b_end": scale * states[:, 1]}
        return attractors(pd.DataFrame({"status": "settled", **columns}), grain=0.01 * scale)

    one, other = group(1.0), group(factor)
    assert len(one.summary) == 3
    np.testing.assert_array_equal(one.column, other.column)
    assert other.link == pytest.approx(factor * one.link)


def test_without_a_gap_all_is_one() -> None:
    assert linking_distance(np.array([0.5, 0.4, 0.3, 0.2]), 0.01, rows=5) == np.inf
    assert linking_distance(np.array([1.0, 0.1, 0.09]), 0.01, rows=4) == pytest.approx(np.sqrt(0.1))
    # links below the grain are as good as the grain: no gap among them
    assert linking_distance(np.array([1e-3, 1e-9, 1e-12]), 0.01, rows=4) == np.inf
    # ten cells of a line, and one more row in one of them: no eleven attractors
    assert linking_distance(np.full(10, 0.3), 0.01, rows=12) == np.inf
    # two cells with five rows each are two attractors
    assert linking_distance(np.array([1.0]), 0.01, rows=10) == pytest.approx(0.1)


@pytest.mark.slow
def test_a_million_rows_need_no_matrix_of_them() -> None:
    random = np.random.default_rng(0)
    n = 1_000_000
    line = random.random(n) < 0.7
    t = random.uniform(0, 4, n)
    states = np.where(
        line[:, None], np.stack([t, 0 * t + 1, 0 * t], 1), 0.005 * random.normal(size=(n, 3)) + 5
    )
    space = Space(np.full(3, TURN), np.ones(3))
    assert cells(space, np.mod(states, TURN), 2e-4).first.size <= MOST_CELLS
    result = attractors(settled(states))
    assert same_partition(result.column.cat.codes.to_numpy()[::97], line[::97].astype(int))
    assert result.summary["kind"].tolist() == ["line", "point"]


def chain_states(n: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Points of the chain's analytic solution lines (N = 3), and the gait that the classifier gives each."""
    random = np.random.default_rng(seed)
    lines = segments(3)
    middle, direction = np.asarray(lines.middle).reshape(-1, 3), np.asarray(lines.direction).reshape(-1, 3)
    half = np.maximum(np.asarray(lines.half).ravel(), 0.0)
    piece = random.choice(half.size, n, p=half / half.sum())
    states = middle[piece] + (random.uniform(-1, 1, n) * half[piece])[:, None] * direction[piece]
    gait = jax.jit(jax.vmap(lambda psi: classify(3, psi)[0]))(jnp.asarray(states))
    return states, np.asarray(gait)


@pytest.mark.slow
def test_the_chains_solution_lines_and_its_locked_state() -> None:
    """The lines of the three gaits meet at corners and are one attractor each; the locked state is its own.

    Rows closer to a corner than a tenth of a line may be counted to either line: 0.95 would fail if two lines
    were one (0.7 at most) and is met with half of the corners on the other side.
    """
    states, gait = chain_states(600)
    locked = np.tile(np.asarray(locked_state(Chain())), (20, 1))
    table = settled(np.concatenate([states, locked]))
    table["gait"] = np.array(GAITS)[np.concatenate([gait, np.full(20, GAITS.index("locked"))])]
    result = attractors(table)
    assert len(result.summary) == 4
    assert agreement(table, result.column) > 0.95
    own = result.column.loc[table["gait"] == "locked"].unique()
    assert len(own) == 1
    alone = result.summary.set_index("attractor").loc[own[0]]
    assert (alone["rows"], alone["kind"]) == (20, "point")
    assert set(result.summary.loc[result.summary["rows"] > 20, "kind"]) == {"line"}
    assert len(attractors(table, corners=False).summary) == 2


def test_rows_that_did_not_settle_have_none() -> None:
    table = settled(np.zeros((4, 2)))
    table["status"] = ["settled", "cycle_limit", "inferred", "fell"]
    table.loc[3, "psi_1_end"] = np.nan
    result = attractors(table)
    assert result.column.isna().tolist() == [False, True, True, True]
    none = attractors(table.iloc[1:])
    assert none.column.isna().all()
    assert len(none.summary) == 0
    with pytest.raises(AnalysisError, match="inferred"):
        with_attractors(table)
    with pytest.raises(AnalysisError, match="status is not a column"):
        with_attractors(table.drop(columns="status"))
    with pytest.raises(AnalysisError, match="not tested for settling"):
        attractors(table.assign(status="complete"))


@pytest.mark.parametrize(
    ("given_", "said"),
    [
        ({"columns": ["psi_3_end"]}, "did you mean psi_2_end|did you mean psi_1_end"),
        ({"grain": 0.0}, "above 0"),
        ({"scales": {"psi_1_end": -1.0}}, "above 0"),
        ({"scales": {"psi_1": 2.0}}, r"scales\.psi_1 is not one of the columns; did you mean psi_1_end"),
    ],
)
def test_bad_arguments_are_refused(given_: dict, said: str) -> None:
    with pytest.raises(AnalysisError, match=said):
        attractors(settled(np.zeros((3, 2))), **given_)


def moving_table() -> pd.DataFrame:
    """Over p = 0 ... 9: a point that moves 0.1 a step, a line that is gone at 4 and 5, a point from 6 on."""
    random = np.random.default_rng(3)
    parts = []
    for p in range(10):
        s = random.uniform(0, 2, 200)
        point = np.tile([1.0 + 0.1 * p, 5.0], (100 + 10 * p, 1))
        line = np.stack([s + 3.0, np.full(200, 2.0 + 0.05 * p)], 1) if p not in (4, 5) else np.zeros((0, 2))
        late = np.tile([3.0, 5.0], (30 if p >= 6 else 0, 1))
        states = np.concatenate([point, line, late]) + 1e-3 * random.normal(
            size=(len(point) + len(line) + len(late), 2)
        )
        parts.append(settled(states, p=float(p), start=np.arange(len(states))))
    return pd.concat(parts, ignore_index=True)


@pytest.mark.slow
def test_names_stay_along_a_parameter() -> None:
    table = moving_table()
    result = follow_attractors(table, "p")
    wide = result.fractions.pivot(index="p", columns="outcome", values="rows").fillna(0).astype(int)
    line, point, late = result.summary.loc[result.summary["p"].isin([0.0, 6.0])].drop_duplicates("attractor")[
        "attractor"
    ]
    assert wide[line].tolist() == [200] * 4 + [0, 0] + [200] * 4  # the vanished one comes back by its name
    assert wide[point].tolist() == [100 + 10 * p for p in range(10)]
    assert wide[late].tolist() == [0] * 6 + [30] * 4
    moved = result.summary[(result.summary["attractor"] == point) & (result.summary["p"] > 0)]["moved"]
    np.testing.assert_allclose(moved, 0.1, atol=2e-3)
    assert result.within > 0.15
    of_one_column = follow_attractors(table.drop(columns="psi_2_end"), "p").column
    assert follow_attractors(table, "p", columns="psi_1_end").column.tolist() == of_one_column.tolist()
    with pytest.raises(AnalysisError, match="within is -1, but must be 0 or more"):
        follow_attractors(table, "p", within=-1.0)
    with pytest.raises(AnalysisError, match="No row of the table has a value of p"):
        follow_attractors(table.iloc[:0], "p")
    # a tight limit makes each a new one
    assert len(follow_attractors(table, "p", within=0.02).column.cat.categories) > 10


@pytest.fixture(scope="module")
def landscape(tmp_path_factory: pytest.TempPathFactory) -> pd.DataFrame:
    angle = {"linspace": [0, TURN, 24], "at": "centre"}
    job = gs.Job(
        name="landscape",
        model="landscape_model:Landscape",
        vary={"shift": [0.0, 0.4, 0.8], "theta_2": angle, "theta_1": angle},
        run={"kind": "settle", "max_cycles": 60},
        numerics={"dt": 0.05},
        engine={"name": "xla"},
    )
    return gs.run(job, Path(tmp_path_factory.mktemp("landscape")) / "out").table


@pytest.mark.slow
def test_attractors_of_a_simulated_table_are_its_gaits(landscape: pd.DataFrame) -> None:
    """Two closed lines, pi apart, are found from the states alone and followed as they move."""
    part = landscape.loc[landscape["shift"] == 0.4]
    part.attrs = landscape.attrs
    result = attractors(part)
    assert agreement(part, result.column) == 1.0
    assert result.summary["kind"].tolist() == ["line", "line"]
    followed = follow_attractors(landscape, "shift")
    assert agreement(landscape, followed.column) == 1.0
    assert len(followed.column.cat.categories) == 2
    assert np.abs(followed.fractions["fraction"] - 0.5).max() < 0.05


def cloud_rows(
    centre: tuple[float, float], rows: int, crossings: int, rng: np.random.Generator
) -> np.ndarray:
    """Crossings (rows, crossings, 2) of rows on a circle, at random places."""
    angle = rng.uniform(0.0, TURN, (rows, crossings))
    return np.stack([centre[0] + np.cos(angle), centre[1] + np.sin(angle)], axis=2)


def unsettled(clouds: np.ndarray, status: str) -> pd.DataFrame:
    columns = {
        f"{name}_end{'' if k == 0 else f'_{k + 1}'}": clouds[:, k, i]
        for k in range(clouds.shape[1])
        for i, name in enumerate("xy")
    }
    return pd.DataFrame({"status": status, "attractor_period": 0, **columns})


@pytest.mark.parametrize(("apart", "number"), [(0.0, 1), (1.0, 2)])
def test_sets_without_a_period_are_told_apart_by_their_crossings(apart: float, number: int) -> None:
    """Circles that coincide, or that meet in two points only."""
    rng = np.random.default_rng(0)
    clouds = np.concatenate([cloud_rows((0.0, 0.0), 60, 40, rng), cloud_rows((apart, 0.0), 40, 40, rng)])
    table = unsettled(clouds, "quasi_periodic")
    grouped = attractors(pd.concat([table, unsettled(clouds[:1], "chaotic")], ignore_index=True))
    summary = grouped.summary
    assert summary["kind"].tolist() == ["chaotic", *["quasi_periodic"] * number]
    assert summary["rows"].tolist() == [1, *([60, 40] if number == 2 else [100])]
    if number == 2:
        names = grouped.column.astype(str).to_numpy()
        assert len(set(names[:60])) == len(set(names[60:100])) == 1
    with pytest.raises(AnalysisError, match="of 101 rows, but the table has 100"):
        agreement(table.assign(gait="trot"), grouped.column)


def test_rows_with_fewer_crossings_are_on_their_sets() -> None:
    """As in joined tables, of which one has fewer crossings, and an observable without a value."""
    rng = np.random.default_rng(0)
    clouds = np.concatenate([cloud_rows((centre, 0.0), 4, 40, rng) for centre in (0.0, 5.0)])
    clouds[[1, 6], 30:] = np.nan
    table = unsettled(clouds, "chaotic")
    names = [name.replace("x_", "z_") for name in table.columns if name.startswith("x_")]
    table = pd.concat([table, pd.DataFrame(np.nan, table.index, names)], axis=1)
    assert attractors(table, ["x_end", "y_end", "z_end"]).column.tolist() == ["A1"] * 4 + ["A2"] * 4


def test_a_sampled_set_is_joined_without_a_change_of_either() -> None:
    rng = np.random.default_rng(3)
    space = Space(np.zeros(2), np.ones(2))
    large, small = (SampledSet.of(space, [k], rng.random((n, 2))) for k, n in enumerate((MOST_STATES, 5)))
    for one, other in ((large, small), (small, small)):
        before = [*one.rows]
        assert sorted(one.joined(other, space).rows) == sorted([*before, *other.rows])
        assert one.rows == before


def test_sets_without_a_period_keep_their_names_along_a_parameter() -> None:
    rng = np.random.default_rng(1)
    tables = []
    for a in (0.0, 0.1, 0.2):
        first, second = cloud_rows((a, 0.0), 20, 40, rng), cloud_rows((4.0 + a, 0.0), 10, 40, rng)
        tables += [unsettled(clouds, "chaotic").assign(a=a, of=k) for k, clouds in enumerate((first, second))]
    table = pd.concat(tables, ignore_index=True)
    followed = follow_attractors(table, "a")
    names = followed.column.astype(str).groupby(table["of"]).unique()
    assert [len(own) for own in names] == [1, 1]
    assert np.nanmax(followed.summary["moved"].to_numpy(float)) < 0.3


def test_orbits_without_all_crossings_have_no_states() -> None:
    """Two orbits of two crossings each, of which the table has one, are known by their period alone."""
    table = pd.DataFrame({"status": "settled", "attractor_period": 2, "x_end": [1.0, 1.0, 3.0]})
    grouped = attractors(table)
    assert grouped.states == {}
    assert grouped.summary["attractor"].tolist() == ["period 2"]
    assert grouped.summary["rows"].tolist() == [3]


@pytest.mark.parametrize("missing", [np.inf, np.nan])
def test_a_crossing_without_a_value_leaves_other_orbits_as_they_are(missing: float) -> None:
    table = pd.DataFrame({"status": "settled", "attractor_period": 2, "x_end": [0.0, 0.0, 5.0, 5.0, 0.0]})
    table["x_end_2"] = [1.0, 1.0, 6.0, 6.0, missing]
    assert attractors(table).column.tolist() == ["A1", "A1", "A2", "A2", "period 2"]


@pytest.mark.parametrize("order", [[0, 1, 2], [1, 0, 2]])
def test_rows_at_rest_where_others_settled_are_an_attractor_of_their_own(order: list[int]) -> None:
    """The states of both are equal, so that they are in one cell."""
    table = pd.DataFrame({"status": ["settled", "at_rest", "settled"], "psi_1_end": 1.0}).iloc[order]
    result = attractors(table)
    assert result.column.loc[[0, 1, 2]].tolist() == ["A1", "A2", "A1"]
    assert result.summary["kind"].tolist() == ["point", "rest"]


def test_states_at_rest_join_no_others() -> None:
    """Two settled states, and a line of states at rest from one to the other."""
    x = np.concatenate([np.repeat([0.0, 2.0], 20), np.linspace(0.05, 1.95, 60)])
    table = pd.DataFrame({"status": np.repeat(["settled", "at_rest"], [40, 60]), "x_end": x})
    assert attractors(table).summary[["rows", "kind"]].to_numpy().tolist() == [
        [60, "rest"],
        [20, "point"],
        [20, "point"],
    ]


@pytest.mark.parametrize("statuses", [("settled", "at_rest"), ("at_rest", "settled")])
def test_two_states_are_two_attractors_beside_many_of_another_status(statuses: tuple[str, str]) -> None:
    x = [5.0, 9.0, *np.linspace(0.0, 1.0, 50)]
    table = pd.DataFrame({"status": np.repeat(statuses, [2, 50]), "x_end": x})
    assert attractors(table).summary["rows"].tolist() == [50, 1, 1]


def test_attractors_are_followed_in_a_table_whose_index_repeats() -> None:
    table = settled(np.array([[0.0], [1.0], [0.01], [1.01]]), f=[1.0, 1.0, 2.0, 2.0])
    expected = follow_attractors(table, "f", link=0.5).column.tolist()
    twice = follow_attractors(pd.concat([table, table]), "f", link=0.5)
    assert twice.column.tolist() == expected * 2
    assert twice.column.index.tolist() == [0, 1, 2, 3] * 2


def test_observables_without_a_tolerance_of_their_own_have_the_default_one() -> None:
    """Rows that settled at 1e-3 are no line of states because the other observable has 1e-9."""
    states = np.column_stack([np.ones(40), 1.0 + 1e-3 * np.linspace(0.0, 1.0, 40)])
    table = settled(states)
    table.attrs["job"] = {"run": {"tolerance": {"psi_1": 1e-9}}}
    grouped = attractors(table)
    assert grouped.grain == pytest.approx(1e-2)
    assert grouped.summary["kind"].tolist() == ["point"]
    table.attrs["job"] = {"run": {"tolerance": {"psi_1": 1e-9, "psi_2": 1e-8}}}
    assert attractors(table).grain == pytest.approx(1e-7)
