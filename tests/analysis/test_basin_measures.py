"""Basin measures against cases whose answers are known."""

from __future__ import annotations

import functools

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gaitsweep import analyses
from gaitsweep.analysis.basins.basin_boundaries import (
    Exponent,
    uncertainty_exponent,
    uncertainty_fraction,
    wada,
)
from gaitsweep.analysis.basins.fractions import fractions, one_a_cell, proportion_interval
from gaitsweep.analysis.basins.grid import BasinGrid, find_grid
from gaitsweep.analysis.basins.measures import basins, minimal_fatal_shock
from gaitsweep.analysis.basins.quantifiers import quantifiers
from gaitsweep.analysis.records import AnalysisError
from tests.support.basin_tables import (
    TURN,
    cantor_labels,
    final_state,
    grid_table,
    julia,
    newton,
    weierstrass,
)


@pytest.mark.slow
def test_coverage_of_intervals_for_grids() -> None:
    """The intervals of the area of discs anywhere on 33 x 33 grids contain it in at least 95 % of cases.

    The interval is a third of Wilson's: only cells on the edge add to the error of a grid.
    """
    random = np.random.default_rng(1)
    inside, width, independent = [], [], []
    for _ in range(200):
        centre, radius = random.uniform(0, TURN, 2), random.uniform(0.8, 2.4)

        def disc(x: np.ndarray, y: np.ndarray, centre=centre, radius=radius) -> np.ndarray:
            gaps = [np.abs((at - c + np.pi) % TURN - np.pi) for at, c in zip((x, y), centre, strict=True)]
            return np.hypot(*gaps) < radius

        table = grid_table((33, 33), disc)
        result = fractions(table).set_index("outcome").loc["True"]
        area = np.pi * radius**2 / TURN**2
        inside.append(result["low"] <= area <= result["high"])
        width.append(result["high"] - result["low"])
        low, high = proportion_interval(int(result["rows"]), int(result["of"]), 0.95)
        independent.append(high - low)
    assert np.mean(inside) >= 0.95
    assert np.mean(width) < 0.45 * np.mean(independent)


def test_fractions_of_outcomes() -> None:
    """Rows that failed or did not settle are outcomes of their own, and shares add up to one."""
    table = grid_table((10, 10), lambda x, y: x < np.pi)
    table["status"] = ["fell"] * 10 + ["cycle_limit"] * 20 + ["inferred"] * 30 + ["settled"] * 40
    result = fractions(table, level=0.9).set_index("outcome")
    assert result["rows"].to_dict() == {"False": 50, "True": 20, "not settled": 20, "failed": 10}
    assert np.sum(result["fraction"]) == pytest.approx(1.0)
    assert set(result["interval"]) == {"cells"}
    alike = fractions(table.assign(status="fell")).iloc[0]
    assert (alike["interval"], alike["high"]) == ("wilson", 1.0)
    assert alike["low"] == pytest.approx(proportion_interval(100, 100)[0])
    rows = table.sample(60, random_state=0)
    assert set(fractions(rows)["interval"]) == {"wilson"}
    assert set(fractions(table, interval="clopper_pearson")["interval"]) == {"clopper_pearson"}


def test_inferred_rows_have_no_label_of_the_model_but_the_gait() -> None:
    """Whole numbers of such rows are 0 in the table."""
    table = grid_table((10, 10), lambda x, y: x < np.pi).assign(k=3, status="settled")
    table.attrs["quantities"] = {"k": {}, "psi_1": {}, "outcome": {}}
    assert fractions(table, label="k")["outcome"].tolist() == ["3"]
    table.loc[:49, ["k", "status"]] = [0, "inferred"]
    assert len(fractions(table)) == 2
    assert len(fractions(table, label="psi_1")) == 10
    assert len(fractions(table.assign(outcome=table["gait"]), label="outcome")) == 2
    with pytest.raises(AnalysisError, match="inferred rows, which have no k"):
        fractions(table, label="k")


@pytest.mark.parametrize("circular", [True, False])
def test_a_straight_boundary(circular: bool) -> None:
    """Exponent 1, boundary of dimension 1, and the entropies of boxes that a straight line crosses.

    A box of 5 that it crosses has k of its 5 columns on one side, k = 1 to 4, each as often.
    """
    n = 96
    half = np.pi if circular else 0.5
    table = grid_table((n, n), lambda x, y: x < half, circular=circular)
    result = basins(table)
    panel = result.panels.iloc[0]
    assert panel["exponent"] == pytest.approx(1.0, abs=1e-9)
    assert panel["exponent_low"] < 1.0 < panel["exponent_high"]
    assert panel["boundary_dimension"] == pytest.approx(1.0, abs=1e-9)
    k = np.arange(1, 5) / 5
    boundary = float(np.mean(-k * np.log(k) - (1 - k) * np.log(1 - k)))
    crossed = 8 / n if circular else 4 / (n - 4)
    assert panel["boundary_entropy"] == pytest.approx(boundary)
    assert panel["boundary_entropy"] < np.log(2)
    assert panel["crossed"] == pytest.approx(crossed)
    assert panel["basin_entropy"] == pytest.approx(boundary * crossed)
    uncertain = result.uncertainty
    if circular:  # two boundaries across one of two axes, with `steps` uncertain starts on both their sides
        np.testing.assert_allclose(uncertain["uncertain"], 2 * uncertain["steps"] / n)
        np.testing.assert_allclose(uncertain["eps"], uncertain["steps"] * TURN / n)


def test_a_cantor_boundary() -> None:
    """A boundary that is the Cantor set: exponent 1 - ln 2 / ln 3, within 0.02 over factors of 9.

    Over other factors the slope ripples, since outcomes recur at every second step of the construction: the
    interval is wide and holds the exponent.
    """
    expected = 1 - np.log(2) / np.log(3)
    labels = cantor_labels(9)
    line = grid_table((labels.size,), lambda x: labels[(x * labels.size).astype(int)], circular=False)
    result = basins(line, sizes=[9, 81, 729]).panels.iloc[0]
    assert result["exponent"] == pytest.approx(expected, abs=0.02)
    assert result["boundary_dimension"] == pytest.approx(np.log(2) / np.log(3), abs=0.02)
    for sizes in ([9, 27, 81, 243], None):
        panel = basins(line, sizes=sizes).panels.iloc[0]
        assert panel["exponent_low"] < expected < panel["exponent_high"]
    # times a line: no start is uncertain along the second axis
    sheet, alone = (
        BasinGrid(np.arange(np.prod(shape)), shape, (1.0,) * len(shape), (False,) * len(shape))
        for shape in ((729, 60), (729,))
    )
    of_sheet = uncertainty_fraction(sheet, np.repeat(cantor_labels(6), 60), [3, 9, 27]).fractions
    of_line = uncertainty_fraction(alone, cantor_labels(6), [3, 9, 27]).fractions
    compared = (729 - 54) * 60, 729 * (60 - 54)
    np.testing.assert_allclose(of_sheet["uncertain"], of_line["uncertain"] * compared[0] / sum(compared))


# exponent, outcome of a start (x, y), and the ends of x and y
PUBLISHED = {
    # Grebogi et al. 1983, Phys. Lett. A 99:415: 0.20 (0.03)
    "final_state": (0.20, final_state, (0.0, TURN, -0.5, 0.5)),
    # McMullen 1998, Am. J. Math. 120:691: dimensions 1.268, 1.3934 and 1.0812
    "c = -1": (0.732, functools.partial(julia, c=-1.0), (-1.8, 1.8, -1.2, 1.2)),
    "rabbit": (0.607, functools.partial(julia, c=-0.122561 + 0.744862j), (-1.5, 1.5, -1.5, 1.5)),
    "c = 1/4": (0.919, functools.partial(julia, c=0.25), (-1.3, 1.3, -1.3, 1.3)),
    # dimension 1.42 by counting boxes, as ChaosTools.jl cites it; Bowen's formula gives 1.444, exponent 0.556
    "newton": (0.58, newton, (-1.5, 1.6, -1.5, 1.6)),
}
# McDonald et al. 1985, Physica D 17:125: the exponent is known exactly, log2 of the growth
CLOSED = {
    f"weierstrass {growth}": (
        np.log2(growth),
        functools.partial(weierstrass, growth=growth),
        (0, TURN, -1, 1),
    )
    for growth in (1.2, 1.5, 1.8)
}


def exponent_of(name: str, side: int) -> Exponent:
    """The exponent of a set on a grid of `side` starts along each axis."""
    _, label, (left, right, low, high) = (PUBLISHED | CLOSED)[name]
    x, y = (np.indices((side, side)).reshape(2, -1) + 0.5) / side
    grid = BasinGrid(np.arange(side * side), (side, side), (1.0, 1.0), (False, False))
    labels = label(left + x * (right - left), low + y * (high - low))
    return uncertainty_exponent(uncertainty_fraction(grid, labels))


@pytest.mark.parametrize("name", [*PUBLISHED, *CLOSED])
def test_exponents_of_fractal_boundaries(name: str) -> None:
    """The exponent lies in the interval of a coarse grid, and within 0.1 of its middle."""
    side = 99 if name in PUBLISHED else 400
    found, (known, *_) = exponent_of(name, side), (PUBLISHED | CLOSED)[name]
    assert found.low < known < found.high
    assert found.value == pytest.approx(known, abs=0.1)


@pytest.mark.slow
def test_published_exponents_on_fine_grids() -> None:
    """At least 14 of 15 intervals hold the published exponent; at 1 200 a side they are 0.17 wide at most."""
    results = {(name, side): exponent_of(name, side) for name in PUBLISHED for side in (99, 400, 1200)}
    for (name, side), each in results.items():
        print(f"{name} {side}: {each.value:.3f} ({each.low:.3f} to {each.high:.3f})")
    assert sum(each.low < PUBLISHED[name][0] < each.high for (name, _), each in results.items()) >= 14
    assert all(each.high - each.low < 0.17 for (_, side), each in results.items() if side == 1200)


def test_newtons_basins_are_wada() -> None:
    """Every boundary point of Newton's basins is one of all three: Daza et al. 2015, Sci. Rep. 5:16579."""
    result = wada(grid_table((99, 99), lambda x, y: newton(3.1 * x - 1.5, 3.1 * y - 1.5), circular=False))
    assert np.max(result["distance"]) < 5.0


@pytest.mark.parametrize(
    ("label", "distance"),
    [
        (lambda x, y: np.floor(3 * x), 33.0),
        (lambda x, y: (np.hypot(x - 0.25, y - 0.5) < 0.2) + 2 * (np.hypot(x - 0.75, y - 0.5) < 0.2), 49.0),
    ],
)
def test_stripes_and_discs_are_not_wada(label, distance: float) -> None:
    """Boundaries lie as far apart as constructed, 1/3 and 1/2 of the side."""
    result = wada(grid_table((99, 99), label, circular=False))
    assert np.min(result["within"]) == 0.0
    assert np.max(result["distance"]) >= distance


def test_two_basins_have_no_wada_property_to_test() -> None:
    """Two basins share their boundary whatever its shape; a third is one of the next panel alone."""
    table = grid_table(
        (99, 99), lambda x, y, p: np.minimum(np.floor(3 * x), p), circular=False, panels=[1.0, 2.0]
    )
    result = wada(table, by="p").set_index("p")[["distance", "within"]]
    assert result.loc[1.0].isna().to_numpy().all()
    assert result.loc[2.0].notna().to_numpy().all()


def test_bounds_of_entropies() -> None:
    """The entropy of noise of k outcomes is near its bound ln k; that of a single basin is 0."""
    random = np.random.default_rng(2)
    for k in (2, 3):
        noise = basins(grid_table((60, 60), lambda x, y, k=k: random.integers(0, k, x.size))).panels.iloc[0]
        assert 0.95 * np.log(k) < noise["boundary_entropy"] < np.log(k)
        assert noise["crossed"] == 1.0
        assert noise["exponent_low"] < 0.0 < noise["exponent_high"]
        assert abs(noise["exponent"]) < 0.05
    one = basins(grid_table((20, 20), lambda x, y: 0 * x))
    panel = one.panels.iloc[0]
    assert (panel["basin_entropy"], panel["boundary_entropy"], panel["crossed"]) == (0.0, 0.0, 0.0)
    assert np.isnan(panel["exponent"])
    assert np.isinf(one.rows["shock"]).all()
    assert np.all(one.rows["shock_to"].isna())


@settings(max_examples=25)
@given(
    lengths=st.lists(st.integers(2, 9), min_size=1, max_size=3).map(tuple),
    circular=st.booleans(),
    seed=st.integers(0, 10**6),
    random_starts=st.booleans(),
)
def test_shocks_are_those_of_brute_force(lengths, circular: bool, seed: int, random_starts: bool) -> None:
    random = np.random.default_rng(seed)
    table = grid_table(lengths, lambda *x: random.integers(0, 3, x[0].size), circular=circular)
    axes = [name for name in table if name.startswith(("psi", "x_"))]
    if random_starts:
        table[axes] = random.uniform(0, TURN if circular else 1.0, (len(table), len(axes)))
    found = basins(table, axes).rows
    starts = table[axes].to_numpy()
    gap = np.abs(starts[:, None] - starts[None])
    gap = np.minimum(gap, TURN - gap) if circular else gap
    apart = np.sqrt((gap**2).sum(axis=-1))
    gait = table["gait"].to_numpy()
    apart[gait[:, None] == gait[None]] = np.inf
    np.testing.assert_allclose(found["shock"], apart.min(axis=1), atol=1e-9)
    reached = np.isfinite(found["shock"].to_numpy())
    for row in np.flatnonzero(reached):
        nearest = gait[np.isclose(apart[row], apart[row].min(), atol=1e-9)]
        assert found["shock_to"].iloc[row] in nearest


def test_panels_are_measured_separately() -> None:
    """A panel gives the same as its own table; without `by`, the panels' axis is an axis of the starts."""
    table = grid_table((16, 16), lambda x, y, p: x < p, panels=[1.0, 3.0])
    result = basins(table, by="p")
    for number, p in enumerate([1.0, 3.0]):
        alone = basins(table.loc[table["p"] == p].drop(columns="p"))
        pd.testing.assert_frame_equal(
            result.panels.drop(columns="p").iloc[[number]].reset_index(drop=True), alone.panels
        )
        mine = result.fractions.loc[result.fractions["p"] == p].drop(columns="p").reset_index(drop=True)
        pd.testing.assert_frame_equal(mine, alone.fractions)
        np.testing.assert_array_equal(result.rows.loc[table["p"] == p, "shock"], alone.rows["shock"])


def test_grids_are_detected() -> None:
    table = grid_table((7, 5), lambda x, y: x < 3)
    grid = find_grid(table, ["psi_1", "psi_2"])
    assert grid is not None
    assert (grid.lengths, grid.wraps) == ((7, 5), (True, True))
    shuffled = table.sample(len(table), random_state=1)
    again = find_grid(shuffled, ["psi_1", "psi_2"])
    assert again is not None
    np.testing.assert_array_equal(again.place, grid.place[shuffled.index])
    assert find_grid(table.iloc[1:], ["psi_1", "psi_2"]) is None
    assert find_grid(pd.concat([table, table.iloc[:1]]), ["psi_1", "psi_2"]) is None
    uneven = table.assign(psi_1=table["psi_1"] ** 2)
    assert find_grid(uneven, ["psi_1", "psi_2"]) is None
    assert basins(uneven).panels["grid"].tolist() == [False]
    open_ended = table.loc[table["psi_1"] < 5]
    part = find_grid(open_ended, ["psi_1", "psi_2"])
    assert part is not None
    assert part.wraps == (False, True)


def test_starts_in_single_precision_form_a_grid() -> None:
    table = grid_table((101, 5), lambda x, y: x < 3)
    rounded = table.assign(psi_1=table["psi_1"].astype(np.float32))
    grid = find_grid(rounded, ["psi_1", "psi_2"])
    assert grid is not None
    assert (grid.lengths, grid.wraps) == ((101, 5), (True, True))
    # far from 0 rounding is larger than the step, and tells nothing
    far = table.assign(psi_1=table["psi_1"] ** 2 + 1e9)
    assert find_grid(far, ["psi_1", "psi_2"]) is None


def test_one_draw_from_each_cell() -> None:
    """The half width against a million draws of one start a cell."""
    shares = np.array([0.0, 1.0, 0.2, 0.5, 0.9, 1.0, 0.0, 0.7])
    drawn = (np.random.default_rng(0).random((1_000_000, 8)) < shares).mean(axis=1)
    assert one_a_cell(shares) == pytest.approx(1.96 * drawn.std(), rel=0.005)


def test_a_label_may_have_the_name_of_an_outcome() -> None:
    gait = pd.Categorical(["failed", "walk", "walk", "failed"])
    measured = basins(pd.DataFrame({"x": np.arange(4.0), "status": "settled", "gait": gait}))
    assert measured.fractions["outcome"].astype(str).tolist() == ["walk", "failed"]


@pytest.mark.parametrize(
    ("given_", "said"),
    [
        ({"label": "gate"}, "did you mean gait"),
        ({"by": "psi_3"}, "did you mean psi_1|did you mean psi_2"),
        ({"level": 95}, "between 0 and 1"),
        ({"interval": "wald"}, "cells, wilson, clopper_pearson"),
        ({"by": ["psi_1", "psi_2"]}, "No axis is left"),
        ({"scales": {"psi_1": 0.0}}, "above 0"),
    ],
)
def test_bad_arguments_are_refused(given_: dict, said: str) -> None:
    with pytest.raises(AnalysisError, match=said):
        basins(grid_table((4, 4), lambda x, y: x < 2), **given_)


@pytest.mark.parametrize(
    ("change", "said"),
    [({"radius": 0.0}, "above 0"), ({"axes": ["psi_1"]}, "do not form a grid")],
)
def test_wada_refusals(change: dict, said: str) -> None:
    with pytest.raises(AnalysisError, match=said):
        wada(grid_table((9, 9), lambda x, y: x < 2), **change)
    with pytest.raises(AnalysisError, match="The table has no rows"):
        wada(grid_table((9, 9), lambda x, y: x < 2).head(0))
    missing = grid_table((8, 8), lambda x, y: x < 3)
    missing.loc[3, "psi_1"] = np.nan
    with pytest.raises(AnalysisError, match="1 row has no start along psi_1, psi_2"):
        basins(missing)
    with pytest.raises(AnalysisError, match="box is 1, but a box needs 2 cells"):
        basins(grid_table((8, 8), lambda x, y: x < 3), box=1)
    with pytest.raises(AnalysisError, match=r"box is 2\.5, but .* whole number"):
        basins(grid_table((8, 8), lambda x, y: x < 3), box=2.5)  # pyright: ignore[reportArgumentType]
    with pytest.raises(AnalysisError, match=r"sizes has 1\.5, but must be whole numbers"):
        basins(grid_table((8, 8), lambda x, y: x < 3), sizes=[1.5])  # pyright: ignore[reportArgumentType]
    with pytest.raises(AnalysisError, match="sizes has 0 steps"):
        basins(grid_table((8, 8), lambda x, y: x < 3), sizes=[0])
    with pytest.raises(AnalysisError, match=r"scales\.psi is not one of the columns"):
        basins(grid_table((8, 8), lambda x, y: x < 3), scales={"psi": 2.0})
    with pytest.raises(AnalysisError, match="at most 4 steps"):
        basins(grid_table((9, 9), lambda x, y: x < 2), sizes=[1, 5])


def test_axes_of_different_units_need_scales() -> None:
    table = grid_table((6, 6), lambda x, y: x < 3)
    table.attrs["quantities"] = {
        "psi_1": {"unit": "rad", "circular": True},
        "psi_2": {"unit": "m", "circular": False},
    }
    unscaled = basins(table)
    assert np.isnan(unscaled.rows["shock"]).all()
    pd.testing.assert_frame_equal(unscaled.panels, basins(table, scales={"psi_2": 1.0}).panels)
    assert unscaled.fractions["fraction"].tolist() == [0.5, 0.5]
    with pytest.raises(AnalysisError, match=r"psi_1 in rad, psi_2 in m: give scales"):
        minimal_fatal_shock(table, ["psi_1", "psi_2"], pd.Series(table["gait"]))
    scaled = basins(table, scales={"psi_1": TURN / 6, "psi_2": 0.1})
    assert np.min(scaled.rows["shock"]) == pytest.approx(1.0)


def _of_a_job(share: float, params: dict[str, object], **columns: float) -> pd.DataFrame:
    """A table of two basins, the first with this share of the starts, and the constants of its job."""
    x = np.arange(100) / 100.0
    gait = pd.Categorical(np.where(x < share, "walk", "trot"), ["walk", "trot"])
    table = pd.DataFrame({"row": np.arange(100), "x_0": x, **columns, "status": "settled", "gait": gait})
    table.attrs["job"] = {"params": params, "structure": {"N": 4}, "start": {"y_0": 0.5}}
    return table


def test_tables_of_several_jobs_are_panels_by_their_constants() -> None:
    """Each table has one value of K, in its job only; the constant of one may be a column of another."""
    tables = [_of_a_job(0.2, {"K": 1.0}), _of_a_job(0.7, {"K": 2.0})]
    found = basins(tables, by="K").fractions
    assert found.set_index(["K", "outcome"])["fraction"].to_dict() == {
        (1.0, "walk"): 0.2, (1.0, "trot"): 0.8, (2.0, "walk"): 0.7, (2.0, "trot"): 0.3,
    }  # fmt: skip
    assert len(basins(tables, by=["K"]).panels) == 2
    varied = _of_a_job(0.4, {}, K=3.0)
    assert fractions([*tables, varied], by="K")["K"].unique().tolist() == [1.0, 2.0, 3.0]
    panels = basins(tables[0], by=["N", "y_0"]).panels[["N", "y_0"]]
    assert panels.to_numpy().tolist() == [[4.0, 0.5]]


def test_constants_that_tables_do_not_have_are_refused() -> None:
    tables = [_of_a_job(0.2, {"K": "2*omega"}), _of_a_job(0.7, {"K": 2.0}, z_0=0.1)]
    with pytest.raises(AnalysisError, match="k is not a column of this table or a constant of its job"):
        basins(tables, by="k")
    with pytest.raises(AnalysisError, match=r'K is the formula "2\*omega" in the job of a table'):
        basins(tables, by="K")
    with pytest.raises(AnalysisError, match="different axes, x_0 and x_0, z_0: name the constants in `by`"):
        basins([_of_a_job(0.2, {"K": 1.0}), tables[1]], by="K")
    with pytest.raises(AnalysisError, match="no table"):
        basins([], by="K")
    with pytest.raises(AnalysisError, match="no rows"):
        basins(tables[1].iloc[:0], axes="x_0")


@pytest.mark.parametrize("name", ["number", "category", "text"])
def test_rows_without_a_value_are_a_panel_of_their_own(name: str) -> None:
    """Of six rows two have no value: a panel of two, as the shares are counted by hand."""
    values = {
        "number": [1.0, 1.0, np.nan, 2.0, 2.0, np.nan],
        "category": pd.Categorical(["a", "a", None, "b", "b", None]),
        "text": ["a", "a", None, "b", "b", None],
    }
    gait = ["walk", "trot", "walk", "walk", "walk", "walk"]
    table = pd.DataFrame({"row": range(6), "x_0": 0.0, "v": values[name], "status": "settled", "gait": gait})
    shares = fractions(table, axes="x_0", by="v")
    counts = shares.groupby("v", dropna=False, observed=True)["of"].first()
    assert counts.tolist() == [2, 2, 2]
    assert shares.loc[shares["v"].isna(), ["outcome", "fraction"]].to_numpy().tolist() == [
        ["trot", 0.0],
        ["walk", 1.0],
    ]


def test_texts_in_place_of_numbers_are_refused() -> None:
    texts = {"row": range(4), "gait": "walk", "status": "settled", "x_0": [0.0, 1.0, 0.0, 1.0], "t_end": 1.0}
    table = pd.DataFrame(texts).assign(x_end=0.0, point=0, stable=True, special="", end="")
    for call in (
        lambda: analyses.attractors(table, "gait"),
        lambda: analyses.fractions(table, axes="gait"),
        lambda: analyses.transition_points_by_gait(table, "gait", "x_0"),
        lambda: analyses.stable_ranges(table, "gait"),
        lambda: analyses.hysteresis(table, parameter="gait", start="x_0"),
        lambda: analyses.transition_points(table.assign(**{"pass": 0, "stair": 0}), "gait", "x_0"),
        lambda: analyses.fixed_points(table.assign(crossing=0), "gait"),
        lambda: quantifiers(table, "gait"),
    ):
        with pytest.raises(AnalysisError, match="The values of gait are not numbers"):
            call()
    with pytest.raises(AnalysisError, match="level is 2, but must be between 0 and 1"):
        proportion_interval(1, 3, 2.0)


def test_stairs_are_no_starts() -> None:
    """The stairs of a staircase would count as starts of a basin; one stair has each start once."""
    start = grid_table((8, 8), lambda x, y: x < 3)
    stairs = pd.concat([start.assign(stair=stair) for stair in (0, 1)], ignore_index=True)
    with pytest.raises(AnalysisError, match=r'a record for each stair, .* table\[table\["stair"\] == 0\]'):
        basins(stairs)
    assert basins(stairs.query("stair == 1")).fractions["of"].tolist() == [64, 64]
