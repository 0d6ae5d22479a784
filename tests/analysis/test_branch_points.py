"""Bifurcations on normal forms, alone and inside maps of several dimensions, in closed form."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest

from gaitsweep.analysis.continuation.branch_follower import ArclengthSteps
from gaitsweep.analysis.continuation.continuation import continuation
from gaitsweep.analysis.continuation.plain_map import PlainMap
from gaitsweep.analysis.continuation.stable_ranges import range_of_gait, stable_ranges
from gaitsweep.analysis.records import AnalysisError
from gaitsweep.plot.bifurcations.continuation import continuation as draw

LOWER, UPPER = "supercritical_pitchfork", "subcritical_pitchfork"
# x -> s x + r (k x + p) + a x^2 + b x^3
FORMS = {
    "transcritical": {"a": -1.0},
    LOWER: {"b": -1.0},
    UPPER: {"b": 1.0},
    "fold": {"k": 0.0, "p": 1.0, "a": -1.0},
    "flip": {"s": -1.0, "k": -1.0, "b": 1.0},
}
DEFAULTS = {"r": 0.0, "s": 1.0, "k": 1.0, "p": 0.0, "a": 0.0, "b": 0.0, "h": 0.0, "m": 0.5, "n": -0.4}
# the fold's branch x = sqrt(r) begins at r > 0, the others on x = 0, from where Newton leads to it
STARTS = {-1: ((0.83, 0.03), (0.4, -0.02)), 1: ((-0.83, 0.03), (-0.02, 0.001))}
STEPS = (ArclengthSteps(0.02, 0.08), ArclengthSteps(0.05, 0.2))


def form(size: int) -> tuple[PlainMap, np.ndarray]:
    """The normal form in the first of `size` coordinates, then turned and shifted by 0.3; the rotation."""
    turn = np.linalg.qr(np.random.default_rng(size).normal(size=(size, size)))[0]

    def mapping(v: Any, at: Any) -> Any:
        x, *others = turn.T @ (at - 0.3)
        image = v["s"] * x + v["r"] * (v["k"] * x + v["p"]) + v["a"] * x**2 + v["b"] * x**3 + v["h"]
        rest = [v[name] * each + 0.2 * x**2 for name, each in zip("mn", others, strict=False)]
        return jnp.asarray(turn) @ jnp.stack([image, *rest]) + 0.3

    names = tuple(f"x_{k}" for k in range(size))
    return PlainMap(mapping, names, tuple(DEFAULTS.items())), turn


MAPS = {size: form(size) for size in (1, 2, 3)}


def followed(size: int, cases: list[dict[str, float]], **options: Any) -> pd.DataFrame:
    """Branches of cases that begin at parameter `r` and first coordinate `x`."""
    mapping, turn = MAPS[size]
    at = np.zeros((len(cases), size))
    at[:, 0] = [case["x"] for case in cases]
    values = {
        name: np.array([case.get(name, default) for case in cases])
        for name, default in DEFAULTS.items()
        if name != "r"
    }
    begin = np.array([case["r"] for case in cases])
    points = mapping.points(at @ turn.T + 0.3)
    return continuation(
        mapping, points, values, parameter="r", begin=begin, **{"within": (-1.0, 0.95), **options}
    )


def specials(table: pd.DataFrame, row: int) -> tuple[list[str], np.ndarray]:
    result = table.loc[(table["row"] == row) & (table["special"] != "")]
    return result["special"].tolist(), result["r"].to_numpy()


@pytest.mark.slow(
    "2--1-steps0",
    "2--1-steps1",
    "2-1-steps0",
    "2-1-steps1",
    "3--1-steps0",
    "3--1-steps1",
    "3-1-steps0",
    "3-1-steps1",
)
@pytest.mark.parametrize("steps", STEPS)
@pytest.mark.parametrize("towards", [1, -1])
@pytest.mark.parametrize("size", [1, 2, 3])
def test_normal_forms(size: int, towards: int, steps: ArclengthSteps) -> None:
    """Each at r = 0 and nowhere else, with other multipliers inside and outside the unit circle."""
    cases, kinds = [], []
    for kind, terms in FORMS.items():
        for r, x in STARTS[towards]:
            if kind == "fold" and r < 0.0:
                continue
            for m in (0.5, 1.8, -1.7)[: 3 if size > 1 else 1]:
                cases.append({**terms, "r": r, "x": 0.9 if kind == "fold" else x, "m": m})
                kinds.append(kind)
    table = followed(size, cases, towards=towards, steps=steps)
    for row, kind in enumerate(kinds):
        found, at = specials(table, row)
        assert found == [kind]
        np.testing.assert_allclose(at, 0.0, atol=1e-8)
        branch = table.loc[(table["row"] == row) & (table["special"] == "")]
        assert branch["end"].iloc[-1] == "range"
        before = branch["point"] < table.loc[(table["row"] == row) & (table["special"] != ""), "point"].item()
        assert branch.loc[before, "unstable"].nunique() == branch.loc[~before, "unstable"].nunique() == 1


@pytest.mark.slow
def test_the_branches_that_cross() -> None:
    """The same branch point is found from x^2 = +-r and from x = r; a pitchfork is not a fold."""
    down = [{"b": -1.0, "r": 0.8, "x": 0.9}, {"b": -1.0, "r": 0.8, "x": -0.9, "m": -1.7}]
    down += [{"a": -1.0, "r": 0.8, "x": 0.8}, {"a": -1.0, "r": 0.7, "x": 0.7, "m": 1.6}]
    up = [{"b": 1.0, "r": -0.8, "x": 0.9}, {"a": -1.0, "r": -0.7, "x": -0.7}]
    expected = [LOWER, LOWER, "transcritical", "transcritical"], [UPPER, "transcritical"]
    for cases, towards, kinds in zip((down, up), (-1, 1), expected, strict=True):
        table = followed(2, cases, towards=towards)
        for row, kind in enumerate(kinds):
            found, at = specials(table, row)
            assert found == [kind]
            np.testing.assert_allclose(at, 0.0, atol=1e-8)


@pytest.mark.slow
def test_branches_that_pass_each_other() -> None:
    """X + r x - x^3 + h has a fold at 3 (h/2)^(2/3), x + r x - x^2 - h at -2 sqrt(h): no branches cross."""
    heights = np.array([1e-2, 1e-4, 1e-6])
    cases = [{"b": -1.0, "h": h, "r": 0.5, "x": x} for h in heights for x in (0.0, -0.7, 0.7)]
    table = followed(2, cases, towards=-1)
    for row, case in enumerate(cases):
        found, at = specials(table, row)
        assert found == (["fold"] if case["x"] < 0.5 else [])
        np.testing.assert_allclose(at, [3.0 * (case["h"] / 2.0) ** (2.0 / 3.0)] * len(at), atol=1e-6)
    signs = [{"a": -1.0, "h": sign * h, "r": -0.5, "x": 0.0} for h in heights for sign in (1.0, -1.0)]
    smooth = [{"b": -1.0, "h": h, "r": -0.5, "x": 0.0} for h in heights]
    table = followed(2, signs + smooth)
    for row, case in enumerate(signs + smooth):
        found, at = specials(table, row)
        folds = int(case["h"] < 0.0)
        assert [each for each in found if each != "flip"] == ["fold"] * folds
        np.testing.assert_allclose(at[:folds], [-2.0 * np.sqrt(abs(case["h"]))] * folds, atol=1e-6)


def test_branches_that_cross_are_followed() -> None:
    """From x = 0 of x + r x - x^3 both halves of x^2 = r, of x + r x - x^2 both of x = r."""
    cases = [{"b": -1.0, "r": -0.8, "x": 0.0}, {"a": -1.0, "r": -0.8, "x": 0.0}]
    table = followed(1, cases, crossing=True)
    assert not table.duplicated(["row", "point"]).any()
    x = (table["x_0"].to_numpy() - 0.3) * MAPS[1][1][0, 0]
    r, branch, row = (table[name].to_numpy() for name in ("r", "branch", "row"))
    assert [sorted(set(branch[row == each])) for each in (0, 1)] == [[0, 1, 2]] * 2
    np.testing.assert_allclose(x[branch == 0], 0.0, atol=1e-7)
    across = branch > 0
    np.testing.assert_allclose((x**2)[across & (row == 0)], r[across & (row == 0)], atol=1e-7)
    np.testing.assert_allclose(x[across & (row == 1)], r[across & (row == 1)], atol=1e-7)
    assert table.loc[across & (r > 0.0), "stable"].all()
    assert not table.loc[across & (r < 0.0), "stable"].any()
    assert set(table.drop_duplicates(["row", "branch"], keep="last")["end"]) == {"range"}
    ranges = stable_ranges(table, "r")
    assert ranges["row"].tolist() == [0, 0, 0, 1, 1]
    np.testing.assert_allclose(ranges["high"], [0.0, 0.95, 0.95, 0.0, 0.95], atol=1e-9)
    assert ranges["high_by"].tolist() == [LOWER, "range", "range", "transcritical", "range"]
    assert len(draw(table, x="r", y="x_0").axes[0].get_lines()) > 0


@pytest.mark.parametrize(
    ("kink", "bounds"), [(1, ["", ""]), (2, ["kink", ""]), (3, ["", ""]), (5, ["", ""]), (6, ["", "kink"])]
)
def test_a_kink_bounds_a_stable_range_at_its_own_end(kink: int, bounds: list[str]) -> None:
    """Points 2 to 5 are stable, and a kink marks the step that leads to its record; rising and falling."""
    stable = [False, False, True, True, True, True, False]
    special = ["kink" if k == kink else "" for k in range(7)]
    table = pd.DataFrame(
        {"row": 3, "point": range(7), "p": np.arange(7.0), "stable": stable, "special": special}
    )
    table = table.assign(end=[""] * 6 + ["range"], branch=np.nan, gait=[None] * 7)
    for sign in (1.0, -1.0):
        (piece,) = stable_ranges(table.assign(p=sign * table["p"]), "p").to_dict("records")
        assert (piece["row"], piece["gait"]) == (3, None)
        assert [piece["low_by"], piece["high_by"]][:: int(sign)] == bounds
    with pytest.raises(AnalysisError, match="Stable here: none"):
        range_of_gait(table, "p", "walk")


def coupled(v: Any, at: Any) -> Any:
    image = v["a"] * at * (1.0 - at)
    return (1.0 - v["c"]) * image + v["c"] * image[::-1]


def test_two_coupled_logistic_maps() -> None:
    """In phase x = 1 - 1/a, with multipliers 2 - a and (1 - 2c)(2 - a) across; c = -1/4.

    Out of phase d^2 = s (2 - 2/a - s) with d, s = x - y, x + y = 1 - 2/(3a): only for a > 4/3, where the
    gait in phase is stable. There is a transcritical point with x = 0 at a = 1, where the multiplier across
    is 3/2, and flips are at 2 + 2/3 and 3.
    """
    mapping = PlainMap(coupled, ("x", "y"), (("a", 2.0), ("c", -0.25)))
    for begin, towards in ((2.0, -1), (0.85, 1), (3.15, -1)):
        table = continuation(
            mapping,
            mapping.points([[1.0 - 1.0 / begin + 0.01, 1.0 - 1.0 / begin - 0.02]]),
            {},
            parameter="a",
            within=(0.8, 3.2),
            begin=begin,
            towards=towards,
        )
        every = [("transcritical", 1.0), (UPPER, 4.0 / 3.0), ("flip", 8.0 / 3.0), ("flip", 3.0)]
        every = [each for each in every if (each[1] - begin) * towards > 0.0][::towards]
        result = table[table["special"] != ""]
        assert result["special"].tolist() == [kind for kind, _ in every]
        np.testing.assert_allclose(result["a"], [a for _, a in every], atol=1e-6)
        np.testing.assert_allclose(table["x"], 1.0 - 1.0 / table["a"], atol=1e-7)
        np.testing.assert_allclose(table["y"], table["x"], atol=1e-7)


@pytest.mark.slow
@pytest.mark.parametrize("unit", [1e-9, 1.0, 1e9])
def test_with_a_conserved_quantity(unit: float) -> None:
    """X + y = E is conserved, and u = x - y -> u + r u - u^3; no step of the first length converges."""
    mapping = PlainMap(
        lambda v, at: at + jnp.array([0.5, -0.5]) * (v["r"] * (at[0] - at[1]) - (at[0] - at[1]) ** 3),
        ("x", "y"),
        (("r", 0.0),),
        invariants=(("E", lambda values, at: unit * (at[0] + at[1])),),
    )
    steps = ArclengthSteps(2.0, 2.0)
    for x, r, towards in ((0.0, -0.4, 1), (0.6, 0.36, -1)):
        start = mapping.points([[1.0 + 0.5 * x, 1.0 - 0.5 * x]])
        table = continuation(
            mapping, start, {}, parameter="r", within=(-0.5, 0.5), begin=r, towards=towards, fix=["E"],
            steps=steps, crossing=True,
        )  # fmt: skip
        result = table[table["special"] != ""]
        assert result["special"].tolist() == [LOWER]
        np.testing.assert_allclose(result["r"], 0.0, atol=1e-8)
        u = (table["x"] - table["y"]).to_numpy()
        np.testing.assert_allclose(u * (table["r"] - u**2), 0.0, atol=1e-8)
        assert len(set(table["branch"])) == 3


@pytest.mark.slow
def test_henon() -> None:
    """X -> 1 - a x^2 + y, y -> b x: the fold at -(1 - b)^2/4, the flip at 3 (1 - b)^2/4; b = .3."""
    mapping = PlainMap(
        lambda v, at: jnp.stack([1.0 - v["a"] * at[0] ** 2 + at[1], 0.3 * at[0]]), ("x", "y"), (("a", 0.1),)
    )
    table = continuation(
        mapping, mapping.points([[0.6, 0.2]]), {}, parameter="a", within=(-0.2, 1.0), begin=1.0, towards=-1
    )
    result = table[table["special"] != ""]
    assert result["special"].tolist() == ["flip", "fold"]
    np.testing.assert_allclose(result["a"], [0.75 * 0.49, -0.25 * 0.49], atol=1e-6)


def test_two_multipliers_at_once() -> None:
    """X -> (1 + r) x - x |x|^2 in the plane: two cross 1 at r = 0, in every direction at once."""
    mapping = PlainMap(lambda v, at: at * (1.0 + v["r"] - at @ at), ("x", "y"), (("r", 0.0),))
    table = continuation(mapping, mapping.points([[0.01, 0.0]]), {}, parameter="r", within=(-0.47, 0.5))
    result = table[table["special"] != ""]
    assert result["special"].tolist() == ["branch_point"]
    np.testing.assert_allclose(result["r"], 0.0, atol=1e-6)


def test_steps_that_end_at_the_point_itself() -> None:
    """Steps of 1/4 from r = -3/4 and 3/4 meet r = 0 exactly, where Newton's equations are singular."""
    steps = ArclengthSteps(0.125, 0.125)
    kinds = [kind for kind in FORMS if kind != "fold"]
    for r, towards in ((-0.75, 1), (0.75, -1)):
        for size in (1, 2):
            cases = [{**FORMS[kind], "r": r, "x": 0.0} for kind in kinds]
            table = followed(size, cases, within=(-1.0, 1.0), towards=towards, steps=steps)
            for row, kind in enumerate(kinds):
                found, at = specials(table, row)
                assert found == [kind]
                np.testing.assert_allclose(at, 0.0, atol=1e-8)


@pytest.mark.slow
def test_two_bifurcations_within_one_step() -> None:
    """X and y lose stability at r = 0 and r = 0.003, in pitchforks or in flips."""
    for sign, kind in ((1.0, LOWER), (-1.0, "flip")):
        mapping = PlainMap(
            lambda v, at: v["sign"] * ((1.0 + v["r"] - jnp.array([0.0, 0.003])) * at - at**3),
            ("x", "y"),
            (("r", 0.0), ("sign", sign)),
        )
        table = continuation(mapping, mapping.points([[0.0, 0.0]]), {}, parameter="r", within=(-0.5, 0.5))
        result = table[table["special"] != ""]
        assert result["special"].tolist() == [kind, kind]
        np.testing.assert_allclose(result["r"], [0.0, 0.003], atol=1e-8)


@pytest.mark.slow("60.0")
@pytest.mark.parametrize("high", [10.0, 60.0])
def test_a_pitchfork_seen_from_the_branch_that_turns(high: float) -> None:
    """Lorenz's flow over 1 s: from C+ the pitchfork at rho = 1, in ranges much wider than its natural scale.

    The multiplier of the branch that turns only touches 1 there. No symmetry helps the search.
    """

    def rates(v: Any, at: Any) -> Any:
        x, y, z = at
        return jnp.stack([10.0 * (y - x), x * (v["rho"] - z) - y, x * y - 8.0 / 3.0 * z])

    def second(v: Any, at: Any) -> Any:
        def step(at: Any, _: Any) -> Any:
            middle = at + 0.01 * rates(v, at)
            return at + 0.02 * rates(v, middle), None

        return jax.lax.scan(step, at, None, length=50)[0]

    mapping = PlainMap(second, ("x", "y", "z"), (("rho", 3.0),))
    start = mapping.points([[np.sqrt(16.0 / 3.0)] * 2 + [2.0]])
    table = continuation(mapping, start, {}, parameter="rho", within=(0.5, high), begin=3.0, towards=-1)
    first = table[table["special"] != ""].iloc[0]
    assert first["special"] == LOWER
    np.testing.assert_allclose(first["rho"], 1.0, atol=1e-9)
