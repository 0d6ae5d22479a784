"""The atlas of maps whose orbits and bifurcations are known in closed form, or from the literature."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace
from typing import Any, cast

import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest

import gaitsweep as gs
from gaitsweep.analysis.atlas.atlas import BranchAtlas
from gaitsweep.analysis.atlas.atlas_tables import atlas_table, atlas_tables
from gaitsweep.analysis.atlas.branch import Branch, point_of, text_of
from gaitsweep.analysis.atlas.order_changes import OrderChange
from gaitsweep.analysis.atlas.periodic_orbits import OrbitSearch, OrbitSearchOptions, Rows
from gaitsweep.analysis.continuation import bifurcation_curves
from gaitsweep.analysis.continuation.branch_follower import ArclengthSteps
from gaitsweep.analysis.continuation.lockstep import alone
from gaitsweep.analysis.continuation.plain_map import PlainMap
from gaitsweep.engine.poincare.maps import Coordinates, Events, Map, Points, Values
from gaitsweep.engine.poincare.return_map import BatchedReturnMap
from gaitsweep.errors import ArgumentError
from gaitsweep.examples.rimless_wheel import RimlessWheel


def logistic(values: Values, x: Coordinates) -> Coordinates:
    return values["r"] * x * (1.0 - x)


def henon(values: Values, x: Coordinates) -> Coordinates:
    return jnp.stack([1.0 - values["a"] * x[0] ** 2 + x[1], values["b"] * x[0]])


def odd(values: Values, x: Coordinates) -> Coordinates:
    """Odd in x: a pitchfork at r = 0, and flips of both outer branches."""
    return x + values["r"] * x - x**3


def delayed(values: Values, x: Coordinates) -> Coordinates:
    """The delayed logistic map with a leak: its circle is born at a = 2 with cos(theta) = 1 - c / 2."""
    return jnp.stack([values["a"] * x[0] * (1.0 - x[1]), values["c"] * x[0] + (1.0 - values["c"]) * x[1]])


def turning(values: Values, x: Coordinates) -> Coordinates:
    """Turns by the angle b and grows by r: a circle is born at r = 1 for each b."""
    cos, sin = jnp.cos(values["b"]), jnp.sin(values["b"])
    return (values["r"] - x @ x) * jnp.stack([cos * x[0] - sin * x[1], sin * x[0] + cos * x[1]])


def folding(values: Values, x: Coordinates) -> Coordinates:
    """Folds on the circle a^2 + b^2 = 1, and flips at a = 0.7995."""
    drift = 0.3 * (values["a"] ** 2 + values["b"] ** 2 - 1.0 + x[0] ** 2)
    return jnp.stack([x[0] + drift, -x[1] * (1.0 + 0.3 * (values["a"] - 0.7995))])


LOGISTIC = PlainMap(logistic, ("x",), (("r", 2.5),))
HENON = PlainMap(henon, ("x", "y"), (("a", 1.4), ("b", 0.3)))
ODD = PlainMap(odd, ("x",), (("r", 0.5),), symmetries=(("sign", lambda values, x: -x),))
DELAYED = PlainMap(delayed, ("x", "y"), (("a", 1.5), ("c", 1.0)))
TURNING = PlainMap(turning, ("x", "y"), (("r", 0.9), ("b", 2.0)))
FOLDING = PlainMap(folding, ("x", "y"), (("a", 0.0), ("b", 0.6)))


def searched(
    mapping: PlainMap,
    values: dict[str, float],
    low: list[float],
    high: list[float],
    periods: int,
    starts: int,
) -> OrbitSearch:
    rng = np.random.default_rng(0)

    def draw(rows: Rows, begun: int) -> Points:
        return mapping.points(rng.uniform(low, high, (len(rows), len(low))))

    search = OrbitSearch(mapping, values, {}, OrbitSearchOptions(periods, budget=starts, batch=starts // 2))
    search.run(draw, [0])
    return search


def atlas_of(
    mapping: Map, search: OrbitSearch, values: dict[str, float], parameter: str, within: tuple[float, float],
    depth: int,
) -> BranchAtlas:  # fmt: skip
    steps = ArclengthSteps(through=(values[parameter],))
    atlas = BranchAtlas(mapping, values, parameter=parameter, within=within, steps=steps)
    atlas.follow(search, values[parameter], depth)
    return atlas


def specials(table: pd.DataFrame, kind: str, parameter: str) -> np.ndarray:
    own = (table["special"] == kind) & (table["end"] != "flip")
    return table.loc[own, parameter].to_numpy(float)


class Small(gs.MapModel):
    """The logistic map of a length in units of 10 nm."""

    r = gs.parameter("1", "rate", 3.2)
    x = gs.variable("m", "length", 0.3e-8)

    def image(self, p, s):
        return {"x": p.r * s.x * (1.0 - s.x / 1e-8)}


@pytest.mark.slow
def test_gaits_and_branches_do_not_depend_on_the_unit() -> None:
    """At the flip a displacement becomes x -> -x + 9 (x / 10 nm)^3."""
    found = gs.atlas(
        Small(),
        parameter="r",
        path=(2.9, 3.3),
        at=3.2,
        ranges={"x_0": (0.05e-8, 0.95e-8)},
        budget=64,
        periods=2,
        depth=1,
        verify=0,
    )
    gaits = found.gaits.sort_values("period", kind="stable")
    assert gaits["period"].tolist() == [1, 1, 2]
    assert gaits["reached"].tolist() == [0.0, 0.0, 1.0]
    assert found.points["special"].tolist() == ["flip"]
    assert found.points["r"].item() == pytest.approx(3.0, abs=1e-9)
    assert found.points["coefficient"].item() == pytest.approx(9.0 * (0.1 / 1e-8) ** 2, rel=1e-4)
    assert set(found.branches["number"]) == {0, 1, 2}


@pytest.mark.slow
def test_orbits_of_the_henon_map() -> None:
    """At a = 1.4, b = 0.3 it has 2, 1, 0, 1, 0 and 2 orbits of the periods 1 to 6 (Galias 1998)."""
    search = searched(HENON, {"a": 1.4, "b": 0.3}, [-2.0, -1.0], [2.0, 1.0], 6, 512)
    periods, counts = np.unique([orbit.period for orbit in search.orbits], return_counts=True)
    assert dict(zip(periods.tolist(), counts.tolist(), strict=True)) == {1: 2, 2: 1, 4: 1, 6: 2}
    assert max(orbit.error for orbit in search.orbits) < 1e-13
    assert search.missing(0) < 1.0
    for orbit in search.orbits:
        images = HENON.images(orbit.points, {"a": 1.4, "b": 0.3}).points.at
        np.testing.assert_allclose(images, np.roll(orbit.points.at, -1, axis=0), atol=1e-12)


class Bounded(PlainMap):
    """A map whose trajectories meet one event, and none from x = 1 on, where they do not come back."""

    def events(self, points: Points, values: Values) -> list[Events]:
        return [[(0.5, "turn")] if x < 1.0 else [] for x in points.at[:, 0]]


def test_a_branch_is_lost_where_trajectories_do_not_come_back() -> None:
    bounded = Bounded(lambda v, x: jnp.where(x < 1.0, 0.5 * (x + v["r"]), jnp.nan), ("x",), (("r", 0.5),))
    search = searched(bounded, {"r": 0.5}, [0.0], [0.9], 1, 8)
    table = atlas_table(atlas_of(bounded, search, {"r": 0.5}, "r", (0.2, 2.0), 0), search, 0.5)
    lost = table[table["end"] == "lost"]
    np.testing.assert_allclose(lost["r"], [1.0], atol=1e-3)
    assert lost["change"].tolist() == ["no return to the section"]


class BoundedFlip(PlainMap):
    """A map with an event in each iteration, but none below x = 0.55, where trajectories do not come back."""

    def events(self, points: Points, values: Values) -> list[Events]:
        return [[(0.5, "turn")] if x > 0.55 else [] for x in points.at[:, 0]]


def test_a_branch_of_several_crossings_is_lost_where_one_of_them_does_not_come_back() -> None:
    """The smaller one of the two points of the logistic map's orbit is 0.55 where r is about 3.12."""

    def image(values: Values, x: Coordinates) -> Coordinates:
        return jnp.where(x > 0.55, values["r"] * x * (1.0 - x), jnp.nan)

    bounded = BoundedFlip(image, ("x",), (("r", 2.9),))
    search = searched(bounded, {"r": 2.9}, [0.5], [0.7], 1, 8)
    table = atlas_table(atlas_of(bounded, search, {"r": 2.9}, "r", (2.8, 3.4), 1), search, 2.9)
    lost = table[(table["end"] == "lost") & (table["period"] == 2)]
    assert lost["change"].tolist() == ["no return to the section"]


@pytest.mark.slow
def test_a_cascade_to_period_16() -> None:
    """Flips of the logistic map at 3, 1 + sqrt 6, ... to 1e-10, and Feigenbaum's ratio to a per cent."""
    search = searched(LOGISTIC, {"r": 2.5}, [-1.0], [2.0], 1, 64)
    atlas = atlas_of(LOGISTIC, search, {"r": 2.5}, "r", (0.5, 3.5699), 4)
    table = atlas_table(atlas, search, 2.5)
    assert [branch.period for branch in atlas.branches] == [1, 1, 2, 4, 8, 16]
    flips = specials(table, "flip", "r")
    np.testing.assert_allclose(flips[:2], [3.0, 1.0 + np.sqrt(6.0)], atol=1e-10)
    assert abs(flips[2] - 3.5440903595519228) < 1e-10
    gaps = np.diff(flips)
    assert abs(gaps[-2] / gaps[-1] / 4.669201609 - 1.0) < 0.01
    # the normal form at r = 3: f = -x + b x^3, b in units of the coordinate's scale, 0.1 + 2/3
    own = table.query("special == 'flip' and branch == 0")
    assert own["coefficient"].to_numpy(float)[0] == pytest.approx(9.0 * (0.1 + 2.0 / 3.0) ** 2, rel=1e-5)
    assert specials(table, "transcritical", "r") == pytest.approx([1.0, 1.0], abs=1e-9)


@pytest.mark.slow
def test_the_cascade_of_the_henon_map() -> None:
    """Flips at 3 (1 - b)^2 / 4 and (5 - 6 b + 5 b^2) / 4, and Feigenbaum's ratio to a per cent."""
    b = 0.3
    search = searched(HENON, {"a": 0.2, "b": b}, [-2.0, -1.0], [2.0, 1.0], 1, 64)
    atlas = atlas_of(HENON, search, {"a": 0.2, "b": b}, "a", (0.1, 1.0579), 4)
    flips = specials(atlas_table(atlas, search, 0.2), "flip", "a")
    assert sorted({branch.period for branch in atlas.branches}) == [1, 2, 4, 8, 16]
    np.testing.assert_allclose(flips[:2], [0.75 * (1.0 - b) ** 2, 1.25 - 1.5 * b + 1.25 * b**2], atol=1e-10)
    gaps = np.diff(flips)
    assert abs(gaps[-2] / gaps[-1] / 4.669201609 - 1.0) < 0.01


def test_a_pitchfork_and_its_symmetric_branches() -> None:
    """From x = 0 at r < 0 the outer branches x = +-sqrt r are found, as one, to their flip at r = 1."""
    search = searched(ODD, {"r": -0.5}, [-0.5], [0.5], 1, 32)
    assert [orbit.symmetry for orbit in search.orbits] == [("sign",)]
    atlas = atlas_of(ODD, search, {"r": -0.5}, "r", (-1.0, 1.5), 1)
    table = atlas_table(atlas, search, -0.5)
    assert specials(table, "supercritical_pitchfork", "r") == pytest.approx([0.0], abs=1e-9)
    outer = table.query("depth == 1")
    assert len(set(outer["branch"])) == 1
    np.testing.assert_allclose(outer["x"].to_numpy(float) ** 2, outer["r"], atol=1e-8)
    assert specials(outer, "flip", "r") == pytest.approx([1.0], abs=1e-10)


@pytest.mark.parametrize("special", ["kink", "fold"])
def test_a_gait_at_a_special_point_of_its_branch_is_listed(special: str) -> None:
    """As where the first step of a half leads over a bend of the map: its first record is a kink."""
    search = searched(ODD, {"r": -0.5}, [-0.5], [0.5], 1, 8)
    atlas = atlas_of(ODD, search, {"r": -0.5}, "r", (-0.6, -0.4), 0)
    (at_place,) = [record for record in atlas.branches[0].records if record["r"] == -0.5]
    at_place["special"] = special
    assert atlas_table(atlas, search, -0.5)["found"].tolist().count(search.orbits[0].hits) == 1


@pytest.mark.parametrize("unit", [1.0, 1e7, 1e-9])
def test_a_pitchfork_on_two_branches_is_listed_once_in_any_unit(unit: float) -> None:
    table = pd.DataFrame({"r": [0.0, 0.4, 0.4 + 1e-13, 0.7, 1.0]}) * unit
    table["special"] = [
        "",
        "supercritical_pitchfork",
        "supercritical_pitchfork",
        "supercritical_pitchfork",
        "",
    ]
    table["end"] = ["", "", "pitchfork", "pitchfork", "range"]
    points = atlas_tables(table.assign(row=0, part="branch", found=-1), "r")["points"]
    np.testing.assert_allclose(points["r"], np.array([0.4, 0.7]) * unit)


def test_a_crossing_of_two_branches_is_listed_once() -> None:
    """Both branches have its record; another place at the same value is another one."""
    table = pd.DataFrame({"r": [0.0, 0.4, 0.4 + 1e-13, 0.4, 1.0]})
    table["special"] = ["", "transcritical", "transcritical", "transcritical", ""]
    table["stored_point"] = ["[[0.0]]", "[[1.0]]", "[[1.0000000001]]", "[[-1.0]]", "[[2.0]]"]
    points = atlas_tables(table.assign(row=0, part="branch", found=-1, end=""), "r")["points"]
    assert points["stored_point"].tolist() == ["[[1.0]]", "[[-1.0]]"]


def test_a_branch_ends_where_it_becomes_its_image() -> None:
    """From x = sqrt r the branch turns at the pitchfork and goes on as x = -sqrt r, its image."""
    search = searched(ODD, {"r": 0.5}, [-1.2], [1.2], 1, 32)
    table = atlas_table(atlas_of(ODD, search, {"r": 0.5}, "r", (-1.0, 1.5), 0), search, 0.5)
    assert specials(table, "flip", "r") == pytest.approx([1.0], abs=1e-10)
    outer = table[np.abs(table["x"]) > 1e-3]
    assert len(np.unique(np.sign(outer["x"]))) == 1
    assert np.sum(table["found"] > 0) == 2
    assert set(table["end"]) == {"", "range", "pitchfork"}


@pytest.mark.slow("0.3")
@pytest.mark.parametrize("place", [-0.5, 0.3])
def test_a_closed_branch_between_two_pitchforks_is_whole(place: float) -> None:
    """X + 0.3 x (1 - r^2 - x^2) has the gaits r^2 + x^2 = 1, which are one branch with their images."""
    circle = PlainMap(
        lambda values, x: x + 0.3 * x * (1.0 - values["r"] ** 2 - x**2), ("x",), (("r", place),),
        symmetries=(("sign", lambda values, x: -x),),
    )  # fmt: skip
    search = searched(circle, {"r": place}, [-1.5], [1.5], 1, 32)
    atlas = atlas_of(circle, search, {"r": place}, "r", (-1.5, 1.5), 1)
    table = atlas_table(atlas, search, place)
    outer = table[np.abs(table["x"]) > 1e-3]
    assert len(np.unique(table["branch"])) == 2
    assert [outer["r"].min(), outer["r"].max()] == pytest.approx([-1.0, 1.0], abs=0.02)


def test_a_closed_branch_stays_closed_from_another_record_on() -> None:
    """Its last step, here over a corner of the map, leads to its first record."""
    at = SimpleNamespace(points=SimpleNamespace(at=np.zeros((1, 1))), parameter=np.zeros(1))
    specials, ends = ("", "", "fold", "", "kink"), ("", "", "", "", "closed")
    records = [
        {"special": special, "end": end, "at": at} for special, end in zip(specials, ends, strict=True)
    ]
    branch = Branch(0, 1, 0, None, cast(Any, None), records, {}).begun_at(2)
    assert [record["special"] for record in branch.records] == ["fold", "", "kink", "", "fold"]
    assert [record["end"] for record in branch.records] == ["", "", "", "", "closed"]
    assert records[0]["special"] == records[2]["end"] == ""


@pytest.mark.slow
def test_hits_of_a_gait_count_where_its_image_is_listed() -> None:
    """Branches pass the images of orbits that the search found, which then have a record."""
    folded = PlainMap(
        lambda values, x: x + 0.3 * x * (values["r"] + x**2 - x**4), ("x",), (("r", -0.1),),
        symmetries=(("sign", lambda values, x: -x),),
    )  # fmt: skip
    search = searched(folded, {"r": -0.1}, [-1.2], [1.2], 1, 64)
    table = atlas_table(atlas_of(folded, search, {"r": -0.1}, "r", (-0.4, 0.4), 0), search, -0.1)
    assert sorted(k for k in table["found"].tolist() if k >= 0) == sorted(
        orbit.hits for orbit in search.orbits
    )


@pytest.mark.slow
def test_a_symmetry_of_a_declared_model() -> None:
    """Two decaying bodies: their exchange turns the states between crossings into each other's."""
    mapping = BatchedReturnMap(TwoBodies())
    points, _ = mapping.settled({"left_0": np.array([1.0]), "right_0": np.array([0.25])}, {}, 0)
    (image,) = mapping.mirrored(points, {}).values()
    np.testing.assert_allclose(image.at, np.exp(-1.0) * np.array([[0.25, 1.0]]), rtol=1e-8)


class TwoBodies(gs.DeclaredModel):
    section_coordinates = ("left", "right")

    left = gs.variable("m", "place of the left body", 1.0)
    right = gs.variable("m", "place of the right body", 0.5)
    clock = gs.variable("s", "time since the last crossing", 0.0)

    def flow(self, p, s):
        return {"left": -s.left, "right": -s.right, "clock": 1.0}

    @gs.event("a second has passed", section=True)
    def tick(self, p, s):
        return s.clock - 1.0

    @tick.jump
    def reset(self, p, s):
        return s.replace(clock=0.0)

    def complete(self, p, s):
        return s.replace(clock=0.0)

    @gs.symmetry("left and right exchanged")
    def mirror(self, p, s):
        return s.replace(left=s.right, right=s.left)

    def period(self, p: Any) -> Any:
        return jnp.ones(())


def test_images_under_combined_symmetries_are_one_orbit() -> None:
    """Of the square's eight symmetries two are named; the nine fixed points are three under the group.

    They are 0, the corners (+-x, +-x) with x = sqrt(r / 3), and the edges (+-x, 0) and (0, +-x) with
    x = sqrt(r), whose point (0, -x) is no image of (x, 0) under one of the two alone.
    """
    square = PlainMap(
        lambda values, x: x + x * (values["r"] - x**2 - 2.0 * x[::-1] ** 2), ("x", "y"), (("r", 0.3),),
        symmetries=(
            ("sign", lambda values, x: x * jnp.array([-1.0, 1.0])), ("swap", lambda values, x: x[::-1]),
        ),
    )  # fmt: skip
    search = searched(square, {"r": 0.3}, [-0.7, -0.7], [0.7, 0.7], 1, 128)
    found = np.sort([np.sum(orbit.points.at[0] ** 2) for orbit in search.orbits])
    np.testing.assert_allclose(found, [0.0, 0.2, 0.3], atol=1e-12)
    assert len(square.mirrored(square.points([[0.1, 0.2]]), {})) == 7


def test_a_symmetry_of_no_finite_order_is_refused() -> None:
    shift = dataclasses.replace(ODD, symmetries=(("shift", lambda values, x: x + 1.0),))
    with pytest.raises(ArgumentError, match="shift generate more than 47 others"):
        shift.mirrored(shift.points([[0.1]]), {})
    root = dataclasses.replace(ODD, symmetries=(("root", lambda values, x: jnp.sqrt(x - 2.0)),))
    with pytest.raises(ArgumentError, match="symmetry root after root gives NaN"):
        root.mirrored(root.points([[0.1]]), {})


@pytest.mark.parametrize("within", [(-0.3, 0.7), (-1.0, 1.5), (-0.011, 3.0), (-2.0, 0.02)])
def test_a_pitchfork_is_found_in_any_range(within: tuple[float, float]) -> None:
    search = searched(ODD, {"r": -0.01}, [-0.05], [0.05], 1, 8)
    table = atlas_table(atlas_of(ODD, search, {"r": -0.01}, "r", within, 0), search, -0.01)
    assert specials(table, "supercritical_pitchfork", "r") == pytest.approx([0.0], abs=1e-9)
    np.testing.assert_allclose([table["r"].min(), table["r"].max()], within, rtol=1e-14)


@pytest.mark.slow
def test_a_doubled_cycle_ends_at_its_parents_other_flip() -> None:
    """X -> -(1 + g) x + x^3 with g = r (1 - r): the cycle of period 2 leads from the flip r = 0 to r = 1."""

    def window(values: Values, x: Coordinates) -> Coordinates:
        r = values["r"]
        return -(1.0 + r * (1.0 - r)) * x + x**3

    mapping = PlainMap(window, ("x",), (("r", -0.5),))
    search = searched(mapping, {"r": -0.5}, [-0.2], [0.2], 1, 16)
    atlas = atlas_of(mapping, search, {"r": -0.5}, "r", (-0.5, 1.5), 2)
    table = atlas_table(atlas, search, -0.5)
    assert specials(table, "flip", "r")[:2] == pytest.approx([0.0, 1.0], abs=1e-9)
    doubled = table.query("period == 2")
    assert len(set(doubled["branch"])) == 1
    r = doubled["r"].to_numpy(float)
    np.testing.assert_allclose(doubled["x"].to_numpy(float) ** 2, r * (1.0 - r), atol=1e-6)
    assert doubled["end"].iloc[-1] == "flip"
    assert r[-1] == pytest.approx(1.0, abs=1e-6)


@pytest.mark.slow
def test_curves_of_the_henon_map() -> None:
    """The fold is a = -(1 - b)^2 / 4, the flips 3 (1 - b)^2 / 4 and (1 - b)^2 + (1 + b)^2 / 4, to 1e-9."""
    search = searched(HENON, {"a": 0.2, "b": 0.3}, [-2.0, -1.0], [2.0, 1.0], 1, 64)
    atlas = atlas_of(HENON, search, {"a": 0.2, "b": 0.3}, "a", (-0.5, 1.0), 1)
    atlas.steps = ArclengthSteps(longest=0.05, most=120)
    curves = atlas.follow_curves("b", (-0.4, 0.7))
    b, a = curves["b"].to_numpy(float), curves["a"].to_numpy(float)
    kind, period = curves["kind"].to_numpy(str), curves["period"].to_numpy(int)
    fold, flip, doubled = kind == "fold", (kind == "flip") & (period == 1), (kind == "flip") & (period == 2)
    assert np.all(fold | flip | doubled)
    np.testing.assert_allclose(a[fold], -((1.0 - b[fold]) ** 2) / 4.0, atol=1e-9)
    np.testing.assert_allclose(a[flip], 3.0 * (1.0 - b[flip]) ** 2 / 4.0, atol=1e-9)
    np.testing.assert_allclose(a[doubled], (1.0 - b[doubled]) ** 2 + (1.0 + b[doubled]) ** 2 / 4.0, atol=1e-9)
    ends = curves.query("end != ''")
    assert set(ends["end"]) == {"range"}
    away = [np.abs(ends[name] - edge) for name, edge in (("a", -0.5), ("a", 1.0), ("b", -0.4), ("b", 0.7))]
    assert np.all(np.min(away, axis=0) < 1e-9)  # exactly at the borders


@pytest.mark.slow
def test_a_circle_and_its_resonances() -> None:
    """Along a = 2 the pair has cos(theta) = 1 - c / 2: 1:4 at c = 2, 1:3 at c = 3, and the end at 4."""
    search = searched(DELAYED, {"a": 1.5, "c": 1.0}, [0.1, 0.1], [0.6, 0.6], 1, 32)
    atlas = atlas_of(DELAYED, search, {"a": 1.5, "c": 1.0}, "a", (1.2, 3.0), 0)
    points = atlas_table(atlas, search, 1.5)
    assert specials(points, "neimark_sacker", "a") == pytest.approx([2.0], abs=1e-10)
    for longest in (0.05, 0.06):  # the second one steps over the end
        atlas.steps = ArclengthSteps(longest=longest, most=300)
        curves = atlas.follow_curves("c", (0.1, 4.5))
        circle = curves.query("kind == 'neimark_sacker'")
        np.testing.assert_allclose(circle["a"], 2.0, atol=1e-9)
        np.testing.assert_allclose(circle["multiplier_re"], 1.0 - circle["c"] / 2.0, atol=1e-8)
        resonances = dict(zip(circle["special"], circle["c"], strict=True))
        assert resonances["resonance_1_4"] == pytest.approx(2.0, abs=1e-6)
        assert resonances["resonance_1_3"] == pytest.approx(3.0, abs=1e-6)
        assert circle["end"].iloc[-1] == "resonance_1_2"
        assert np.all(np.diff(circle["c"]) > 0.0)
        assert circle["c"].iloc[-1] == pytest.approx(4.0, abs=1e-3)


def test_a_leap_does_not_pass_the_meeting_of_a_pair(monkeypatch: pytest.MonkeyPatch) -> None:
    """Behind an angle of pi the curve leads back along itself."""

    def point(angle: float) -> Any:
        return SimpleNamespace(tangent=np.ones(1), unknowns=np.array([angle]))

    def step(equations: Any, before: Any, length: float) -> Any:
        yield from ()
        return point(before.unknowns[0] + length)

    monkeypatch.setattr(bifurcation_curves, "step", step)
    pair: Any = SimpleNamespace(kind="neimark_sacker")
    for begin, ends in ((3.13, None), (3.0, 3.05)):
        leap = alone(bifurcation_curves._leap(pair, point(begin), 0.8))
        assert (leap if leap is None else leap.unknowns[0]) == ends


@pytest.mark.slow
@pytest.mark.parametrize("low", [1.57380, 2.0])
def test_curves_have_no_points_beyond_their_ranges(low: float) -> None:
    """The 1:4 resonance at b = pi / 2 is below the least b; a curve that begins there has one point there."""
    search = searched(TURNING, {"r": 0.9, "b": 2.0}, [-0.2, -0.2], [0.2, 0.2], 1, 16)
    atlas = atlas_of(TURNING, search, {"r": 0.9, "b": 2.0}, "r", (0.8, 1.2), 0)
    atlas_table(atlas, search, 0.9)
    circle = atlas.follow_curves("b", (low, 2.5)).query("kind == 'neimark_sacker'")
    assert set(circle["special"]) <= {"", "resonance_1_3"}
    assert np.min(circle["b"].to_numpy(float)) == pytest.approx(low, abs=1e-12)
    assert np.all(np.diff(circle["b"].to_numpy(float)) > 0.0)


@pytest.mark.slow
def test_a_closed_curve_ends_at_its_first_point() -> None:
    """Folds on a circle in the plane of a and b; flips at a = 0.7995 meet it twice, once beside the start."""
    search = searched(FOLDING, {"a": 0.0, "b": 0.6}, [-1.0, -0.2], [1.0, 0.2], 1, 16)
    atlas = atlas_of(FOLDING, search, {"a": 0.0, "b": 0.6}, "a", (-1.5, 1.5), 0)
    atlas_table(atlas, search, 0.0)
    curves = atlas.follow_curves("b", (-1.5, 1.5))
    circles = [curve for _, curve in curves.groupby("curve") if curve["kind"].iloc[0] == "fold"]
    assert circles
    for circle in circles:
        both = sorted(circle["b"][circle["special"] == "fold_flip"])
        assert both == pytest.approx([-np.sqrt(1.0 - 0.7995**2), np.sqrt(1.0 - 0.7995**2)], abs=1e-6)
        assert circle["end"].iloc[-1] == "closed"
        np.testing.assert_allclose(circle[["a", "b"]].iloc[-1], circle[["a", "b"]].iloc[0], atol=1e-12)


def test_a_turn_at_a_bend_of_the_tent_map_is_a_corner() -> None:
    """Fixed points m / (1 - slope) on both sides of x = 0 meet at m = 0, where slopes are 1/2 and b > 1."""
    tent = PlainMap(
        lambda v, x: v["m"] + jnp.where(x < 0.0, 0.5, v["b"]) * x, ("x",), (("m", 0.0), ("b", 1.5))
    )
    values = {"m": -0.1, "b": 1.5}
    search = searched(tent, values, [-1.0], [1.0], 1, 16)
    atlas = atlas_of(tent, search, values, "m", (-0.3, 0.3), 1)
    corners = specials(atlas_table(atlas, search, -0.1), "corner", "m")
    np.testing.assert_allclose(corners, 0.0, atol=1e-8)
    assert len(corners) == 1


@pytest.mark.slow
def test_a_curve_of_corners() -> None:
    """X + p - q^2 - |x - q| / 2 has the gaits x = q +- 2 (p - q^2), which meet in the corner p = q^2."""
    cornered = PlainMap(
        lambda values, x: x + values["p"] - values["q"] ** 2 - 0.5 * jnp.abs(x - values["q"]), ("x",),
        (("p", 0.5), ("q", 0.3)),
    )  # fmt: skip
    corner = OrderChange(
        mapping=cornered, parameter="p", second="q", within=((-0.5, 1.5), (-0.6, 1.0)), values={}, fix={},
        point=cornered.points([[0.31]]), home=(0.09, 0.3), events=[], changes=frozenset(), vanishes=True,
    )  # fmt: skip
    curve = pd.DataFrame(corner.curve())
    np.testing.assert_allclose(curve["p"], curve["q"] ** 2, atol=1e-8)
    assert [curve["q"].min(), curve["q"].max()] == [-0.6, 1.0]


FOLD_AND_FLIP = PlainMap(
    lambda v, at: jnp.stack([at[0] + v["r"] - at[0] ** 2, -(1.0 + v["s"]) * at[1] + at[1] ** 3]), ("x", "y"),
    (("r", 0.2), ("s", -0.3)),
)  # fmt: skip
TAKENS = PlainMap(
    lambda v, at: jnp.stack([at[0] + at[1], at[1] + v["r"] + v["s"] * at[1] + at[0] ** 2]), ("x", "y"),
    (("r", -0.2), ("s", -0.3)),
)  # fmt: skip
CUBIC_FLIP = PlainMap(
    lambda v, x: -(1.0 + v["r"]) * x + v["s"] * x**3 + x**5, ("x",), (("r", -0.2), ("s", -0.3))
)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("mapping", "place", "kind", "name"),
    [
        (FOLD_AND_FLIP, 0.2, "fold", "fold_flip"),
        (TAKENS, -0.2, "fold", "resonance_1_1"),
        (CUBIC_FLIP, -0.2, "flip", "generalized_flip"),
    ],
)
def test_points_of_codimension_two(mapping: PlainMap, place: float, kind: str, name: str) -> None:
    """Of each normal form, folds or flips at r = 0 for all s, and the point at s = 0."""
    values, size = {"r": place, "s": -0.3}, len(mapping.names)
    search = searched(mapping, values, [-0.6] * size, [0.6] * size, 1, 32)
    atlas = atlas_of(mapping, search, values, "r", (-0.4, 0.4), 0)
    atlas.steps = ArclengthSteps(longest=0.05)
    curves = atlas.follow_curves("s", (-0.5, 0.5)).query(f"kind == '{kind}'")
    np.testing.assert_allclose(curves["r"], 0.0, atol=1e-9)
    points = curves[curves["special"] == name]
    assert len(points) >= 1
    np.testing.assert_allclose(points["s"], 0.0, atol=1e-5)


@pytest.mark.slow
def test_a_rimless_wheel_has_the_multiplier_of_its_impacts() -> None:
    """An impact keeps the share cos(2 alpha) of the rate; the energy above an impact's, its square."""
    wheel = gs.return_map(RimlessWheel(), alpha=0.4, slope=0.14, numerics={"rtol": 1e-11, "atol": 1e-12})
    rolls = wheel.fixed_points(wheel.settled({"rate_0": 0.5}, 60))
    assert rolls.converged.all()
    assert wheel.multipliers(rolls)[0, 0] == pytest.approx(np.cos(0.8) ** 2, abs=1e-8)


def test_a_stored_point_is_read_again_also_from_an_older_text() -> None:
    """An older text has the drifts, the parameter and the tangent between the coordinates and the modes."""
    point = Points(np.array([[0.1, 1.0 / 3.0]]), (np.array([[True, False]]), np.array([2])))
    text = text_of(SimpleNamespace(points=point))  # pyright: ignore[reportArgumentType]
    like = Points(np.zeros((1, 2)), (np.zeros((1, 2), bool), np.zeros(1, int)))
    older = "[[0.1, 0.3333333333333333], [0.5], [0.7], [0.6, 0.8], [true, false], [2]]"
    for stored in (text, older):
        read = point_of(stored, like).points
        np.testing.assert_array_equal(read.at, point.at)
        np.testing.assert_array_equal(read.modes[0], point.modes[0])
        np.testing.assert_array_equal(read.modes[1], point.modes[1])
    assert len(text) < len(older)
