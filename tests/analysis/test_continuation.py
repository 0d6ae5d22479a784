"""Branches of fixed points by pseudo-arclength, and their folds."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest
from jax import Array
from matplotlib.colors import to_hex

from gaitsweep.analysis.continuation.bifurcation_tests import located
from gaitsweep.analysis.continuation.branch_follower import ArclengthSteps
from gaitsweep.analysis.continuation.continuation import _followed_on_refined, continuation
from gaitsweep.analysis.continuation.lockstep import alone
from gaitsweep.analysis.continuation.plain_map import PlainMap
from gaitsweep.errors import ArgumentError
from gaitsweep.plot.bifurcations.continuation import continuation as draw

Values = Mapping[str, Array]


def fold(values: Values, x: Array) -> Array:
    return x + values["r"] - x**2


def cusp(values: Values, x: Array) -> Array:
    return x + values["r"] + values["a"] * x - x**3


def broken(values: Values, x: Array) -> Array:
    """Fixed points x = r up to r = 1, and x = r + gap beyond: the map jumps where x passes 1."""
    return x + 0.5 * (values["r"] - x + jnp.where(x > 1.0 + 0.5 * values["gap"], values["gap"], 0.0))


def spiral(values: Values, x: Array) -> Array:
    """Multipliers r exp(+-i): a circle is born at r = 1."""
    turn = jnp.array([[jnp.cos(1.0), -jnp.sin(1.0)], [jnp.sin(1.0), jnp.cos(1.0)]])
    return values["r"] * (turn @ x)


def conserving(values: Values, x: Array) -> Array:
    """Pulls y towards b x^2 and conserves x + y."""
    pull = 0.2 * (x[1] - values["b"] * x[0] ** 2)
    return jnp.stack([x[0] + pull, x[1] - pull])


FOLD = PlainMap(fold, ("x",), (("r", 0.1),))
CUSP = PlainMap(cusp, ("x",), (("r", 0.0), ("a", 1.0)))


ZEROS: dict[str, tuple[Any, float, int]] = {
    "smooth": (lambda x: np.exp(x) - 1.7, np.log(1.7), 6),
    "steep": (lambda x: np.exp(30.0 * x) - np.exp(24.0), 0.8, 12),
    "triple": (lambda x: (x - 0.37) ** 3, 0.37, 20),
    "jump": (lambda x: 5.0 if x > 0.937 else -0.01, 0.937, 22),  # at most that of bisection and two more
}


@pytest.mark.parametrize("name", ZEROS)
def test_zeros_of_test_functions_are_found_in_few_trials(name: str) -> None:
    function, zero, most = ZEROS[name]
    trials: list[float] = []

    def point_at(arclength: float) -> Any:
        trials.append(arclength)
        return arclength if len(trials) <= most else None
        yield

    found: Any = alone(located((function(0.0), function(1.0)), 1.0, point_at, function))
    assert found.arclength == pytest.approx(zero, abs=2e-6)
    trials += most * [0.0]  # no point is found any more
    assert alone(located((function(0.0), function(1.0)), 1.0, point_at, function)) is None


def test_branches_have_points_at_the_very_values_that_they_pass() -> None:
    """Steps of 0.16 lead past small values: their difference to such a value, added again, is rounded."""
    line = PlainMap(lambda values, x: 0.5 * (x + values["r"]), ("x",), (("r", 0.0),))
    steps = ArclengthSteps(through=(0.003, 0.01, 0.052))
    table = continuation(line, line.points([[-1.0]]), {}, parameter="r", within=(-1.0, 1.0), steps=steps)
    assert set(steps.through) <= set(table["r"])


def test_levels_at_the_starts_stay_so_on_the_refined_map(monkeypatch: pytest.MonkeyPatch) -> None:
    """A branch that is lost is followed again with the levels given: None is the value at the start."""
    monkeypatch.setattr(PlainMap, "refined", lambda mapping: mapping)
    lost = pd.DataFrame({"row": [0, 1], "end": ["lost", ""], "special": ""})
    given: list[Any] = []

    def follow(*args: Any) -> pd.DataFrame:
        given.append(args)
        return pd.DataFrame({"row": [0], "end": ["range"], "special": ""})

    starts = FOLD.points([[0.9], [0.8]])
    levels = {"L": None, "E": np.array([1.0, 2.0])}
    table = _followed_on_refined(lost, follow, FOLD, starts, {}, 1.0, levels)
    assert table["end"].tolist() == ["range", ""]
    assert given[0][-1] == {"L": None, "E": [1.0]}


def test_values_that_are_not_given_are_not_shown() -> None:
    with pytest.raises(ArgumentError, match="shown has b, which"):
        continuation(FOLD, FOLD.points([[0.9]]), {}, parameter="r", within=(0.5, 2.0), shown=["b"])


def test_around_a_fold() -> None:
    """X -> x + r - x^2: both branches x = +-sqrt(r), the fold at r = 0 to 1e-8, multiplier 1 - 2x."""
    table = continuation(
        FOLD, FOLD.points([[0.9]]), {}, parameter="r", within=(-0.5, 2.0), begin=0.9, towards=-1
    )
    folds = table.query("special == 'fold'")
    assert len(folds) == 1
    assert abs(folds["r"].to_numpy()[0]) < 1e-8
    assert abs(folds["x"].to_numpy()[0]) < 1e-4  # r is flat there: x to the square root of r's error
    np.testing.assert_allclose(table["x"] ** 2, table["r"], atol=1e-8)
    np.testing.assert_allclose(table["multiplier_re"], 1.0 - 2.0 * table["x"], atol=1e-7)
    assert table.loc[table["x"] > 1e-3, "stable"].all()
    assert not table.loc[table["x"] < -1e-3, "stable"].any()
    assert table["end"].iloc[-1] == "range"
    assert table["r"].iloc[-1] == 2.0
    assert table["point"].tolist() == list(range(len(table)))


def test_progress_has_points_and_the_share_of_the_range() -> None:
    reports: list[tuple[np.ndarray, np.ndarray]] = []
    steps = ArclengthSteps(on_progress=lambda points, shares: reports.append((points, shares)))
    starts = FOLD.points([[0.9], [1.2]])  # the second is half as far from the end
    table = continuation(FOLD, starts, {}, parameter="r", within=(-0.5, 2.0), begin=[0.81, 1.44], steps=steps)
    points, shares = (np.array(each) for each in zip(*reports, strict=True))
    assert points[0].tolist() == [1, 1]
    assert shares[0].tolist() == [0.0, 0.0]
    assert np.all(np.diff(points, axis=0) >= 0)
    ended = np.flatnonzero(shares[:, 1] == 1.0)
    assert ended.size  # the first branch is still followed
    assert points[-1, 1] == np.sum(table["row"] == 1)
    assert np.all(shares[:, 0] <= 0.95)
    at = table.loc[table["row"] == 0, "r"].tolist()[points[-1, 0] - 1]
    assert shares[-1, 0] == pytest.approx((at - 0.81) / 2.5)


def test_a_table_without_a_fixed_point_has_all_columns() -> None:
    """X -> x + r - x^2 has none for r < 0; both rows have a record with the reason."""
    starts = FOLD.points([[0.5], [2.0]])
    table = continuation(FOLD, starts, {}, parameter="r", within=(-1.0, -0.5))
    whole = continuation(FOLD, FOLD.points([[0.9]]), {}, parameter="r", within=(0.5, 1.0))
    assert list(table.columns) == list(whole.columns)
    assert table["row"].tolist() == [0, 1]
    assert np.all(table["stable"].isna())
    assert not set(table["end"]) & {"range", "closed", "most", "lost", ""}


def test_many_branches_over_a_second_parameter() -> None:
    """X -> x + r + a x - x^3: folds at r = +-2 (a/3)^1.5, flips where 1 + a - 3 x^2 = -1, for a grid of a.

    Each row is an S-shaped curve with its own steps.
    """
    a = np.array([0.0, 0.25, 0.5, 1.0])
    starts = CUSP.points([[-1.3]] * 4)
    table = continuation(CUSP, starts, {"a": a}, parameter="r", within=(-2.0, 2.0), begin=-1.0)
    for row, each in enumerate(a):
        branch = table[table["row"] == row]
        assert np.all(branch["a"] == each)
        folds = branch.loc[branch["special"] == "fold", "r"].to_numpy()
        expected = 2.0 * (each / 3.0) ** 1.5
        # at the cusp itself, a = 0, the two folds have met
        assert len(folds) == (0 if each == 0.0 else 2)
        np.testing.assert_allclose(folds, [expected, -expected][: len(folds)], atol=1e-8)
        flips = branch.loc[branch["special"] == "flip", "x"].to_numpy()
        np.testing.assert_allclose(flips, np.sqrt((2.0 + each) / 3.0) * np.array([-1.0, 1.0]), atol=1e-6)
        assert branch["end"].tolist()[-1] == "range"


def test_a_row_does_not_depend_on_the_others() -> None:
    options: dict[str, Any] = {"parameter": "r", "within": (-2.0, 2.0), "begin": -1.0}
    alone = continuation(CUSP, CUSP.points([[-1.3]]), {"a": 0.5}, **options)
    both = continuation(CUSP, CUSP.points([[-1.3]] * 2), {"a": np.array([1.0, 0.5])}, **options)
    second = both[both["row"] == 1].reset_index(drop=True)
    np.testing.assert_allclose(second["x"], alone["x"], atol=1e-9)


def test_neimark_sacker_bifurcations_are_located() -> None:
    mapping = PlainMap(spiral, ("x", "y"), (("r", 0.5),))
    table = continuation(mapping, mapping.points([[0.0, 0.0]]), {}, parameter="r", within=(0.5, 1.5))
    special = table[table["special"] != ""]
    assert special["special"].tolist() == ["neimark_sacker"]
    np.testing.assert_allclose(special["r"], 1.0, atol=1e-6)


def test_a_branch_continues_beyond_a_jump_of_the_map() -> None:
    """The map jumps by 0.05, and no record lies in the gap."""
    mapping = PlainMap(broken, ("x",), (("r", 0.5), ("gap", 0.05)))
    table = continuation(mapping, mapping.points([[0.5]]), {}, parameter="r", within=(0.5, 1.5))
    assert table["end"].iloc[-1] == "range"
    below, above = table[table["x"] <= 1.025], table[table["x"] > 1.025]
    assert len(below)
    assert len(above)
    np.testing.assert_allclose(below["x"], below["r"], atol=1e-8)
    np.testing.assert_allclose(above["x"], above["r"] + 0.05, atol=1e-8)


@pytest.mark.parametrize("gap", [0.0, 0.05])
def test_a_branch_that_turns_at_a_bend_of_the_map_has_a_corner(gap: float) -> None:
    """Fixed points x = r below 1, and x = 3 - 2 r + gap above: the branch turns, or there is a jump."""

    def bent(values: Values, x: Array) -> Array:
        return 0.5 * (x + jnp.where(x < 1.0, values["r"], 3.0 - 2.0 * values["r"] + gap))

    mapping = PlainMap(bent, ("x",), (("r", 0.5),))
    table = continuation(mapping, mapping.points([[0.5]]), {}, parameter="r", within=(0.5, 1.5))
    kink = table["special"].tolist().index("kink")
    assert (table["x"].iloc[kink:] > 1.0).all()
    corner = table[table["special"] == "corner"]
    assert corner.index.tolist() == ([kink - 1] if gap == 0.0 else [])
    np.testing.assert_allclose(corner[["x", "r"]], 1.0, atol=1e-8)


def test_a_closed_branch_ends() -> None:
    """Fixed points on the circle x^2 + r^2 = 1."""
    mapping = PlainMap(lambda v, x: x + 0.1 * (1.0 - x**2 - v["r"] ** 2), ("x",), (("r", 0.0),))
    table = continuation(mapping, mapping.points([[1.0]]), {}, parameter="r", within=(-2.0, 2.0), begin=0.1)
    assert table["end"].iloc[-1] == "closed"
    folds = table.loc[table["special"] == "fold", "r"].to_numpy()
    np.testing.assert_allclose(np.sort(folds), [-1.0, 1.0], atol=1e-8)


def test_with_a_condition() -> None:
    """Fixed points x + b x^2 = E of a map that conserves E, over b at E = 2."""
    mapping = PlainMap(
        conserving, ("x", "y"), (("b", 1.0),), invariants=(("E", lambda values, x: x[0] + x[1]),)
    )
    table = continuation(
        mapping, mapping.points([[1.1, 0.9]]), {}, parameter="b", within=(1.0, 3.0), fix=["E"]
    )
    np.testing.assert_allclose(table["x"] + table["b"] * table["x"] ** 2, 2.0, atol=1e-8)
    np.testing.assert_allclose(table["drift_E"], 0.0, atol=1e-12)
    # 1, of the conserved E, is left out
    np.testing.assert_allclose(table["multiplier_re"], 0.8 - 0.4 * table["b"] * table["x"], atol=1e-8)
    assert table["end"].iloc[-1] == "range"


def test_a_start_without_a_fixed_point() -> None:
    """Branches from the fold or without a fixed point (r < 0) end with a reason; another continues."""
    starts, begin = FOLD.points([[0.0], [0.7], [0.5]]), np.array([0.0, -0.2, 0.1])
    table = continuation(FOLD, starts, {}, parameter="r", within=(-0.2, 1.0), begin=begin)
    ends = table.groupby("row")["end"].agg("last").tolist()
    assert ends == ["singular", "not_converged", "range"]
    assert table["row"].value_counts()[[0, 1]].tolist() == [1, 1]
    assert table.loc[table["row"] < 2, "stable"].isna().all()
    with pytest.raises(ValueError, match="towards is 0, but must be 1 or -1"):
        continuation(FOLD, FOLD.points([[0.5]]), {}, parameter="r", within=(0.0, 1.0), towards=0)
    with pytest.raises(ValueError, match="two different numbers"):
        continuation(FOLD, FOLD.points([[0.5]]), {}, parameter="r", within=(1.0, 1.0))


def test_a_branch_ends_where_the_map_has_no_derivative() -> None:
    """It is lost there, at x = sqrt(r) = 0.9, and other branches continue."""

    def edged(values: Values, x: Array) -> Array:
        # the root's derivative beyond its end is 0 times infinity
        return fold(values, x) + 0.0 * jnp.sqrt(jnp.maximum(values["edge"] - x, 0.0))

    mapping = PlainMap(edged, ("x",), (("r", 0.1), ("edge", 9.0)))
    values = {"edge": np.array([0.9, 9.0])}
    starts = mapping.points([[0.5], [0.5]])
    table = continuation(mapping, starts, values, parameter="r", within=(0.25, 1.5))
    assert table.groupby("row")["end"].agg("last").tolist() == ["lost", "range"]
    assert 0.8 < np.max(table.query("row == 0")["x"]) <= 0.9
    np.testing.assert_allclose(table["x"] ** 2, table["r"], atol=1e-8)


def test_figure_of_branches() -> None:
    """Solid where stable, broken where not, one mark for the fold."""
    table = continuation(
        FOLD, FOLD.points([[0.9]]), {}, parameter="r", within=(-0.5, 2.0), begin=0.9, towards=-1
    )
    figure = draw(table, x="r", y="x", intervals={"lost in a ramp": (-0.1, 0.1)})
    lines = figure.axes[0].get_lines()
    styles = [
        (to_hex(line.get_color()), line.get_linestyle()) for line in lines if np.size(line.get_xdata()) > 1
    ]
    beneath = (to_hex(figure.axes[0].get_facecolor()), "-")  # of dashes of another branch
    interval = ("#e2e2e2", "-")  # over it, so that the gaps have the colour of the interval
    assert styles == [("#0072b2", "-"), beneath, interval, ("#d55e00", "--")]
    marks = [line for line in lines if line.get_marker() == "o" and np.size(line.get_xdata())]
    assert len(marks) == 1
    a = np.array([0.25, 1.0])
    many = continuation(
        CUSP, CUSP.points([[-1.3]] * 2), {"a": a}, parameter="r", within=(-2.0, 2.0), begin=-1.0
    )
    assert len(draw(many, x="r", y="x", hue="a").axes) == 2  # the second is the colour bar
    named = many.assign(gait=np.where(many["a"] == 1.0, "walk", "trot"))
    figure = draw(named, x="r", y="x", hue="gait")
    assert {"walk", "trot"} <= {text.get_text() for text in figure.legends[0].get_texts()}
    shown = {to_hex(line.get_color()) for line in figure.axes[0].get_lines() if line.get_marker() == "None"}
    assert len(shown - {beneath[0]}) == 2


def turned(values: Values, x: Array) -> Array:
    """An angle driven from an unstable fixed point to the stable one opposite, the faster the larger k."""
    middle = 0.5 * jnp.sin(values["k"])
    half = 0.5 * (x - middle)
    return middle + 2.0 * jnp.arctan2(jnp.exp(values["k"]) * jnp.sin(half), jnp.cos(half))


@pytest.mark.slow
def test_a_step_does_not_lead_from_an_unstable_branch_to_another() -> None:
    """With multipliers up to exp(9) Newton's method may converge to the other fixed point."""
    mapping = PlainMap(turned, ("x",), (("k", 1.0),), angles=("x",))
    start = mapping.points([[0.5 * np.sin(1.0)]])
    branch = continuation(mapping, start, {}, parameter="k", within=(1.0, 9.0))
    np.testing.assert_allclose(branch["x"], 0.5 * np.sin(branch["k"]), atol=1e-8)
    assert branch["k"].iloc[-1] == 9.0
