"""Branch points of maps that are smooth only on each side of a corner."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest

import gaitsweep as gs
from gaitsweep.analysis.continuation.branch_follower import ArclengthSteps
from gaitsweep.analysis.continuation.continuation import continuation
from gaitsweep.analysis.continuation.plain_map import PlainMap

TURN = np.linalg.qr(np.random.default_rng(2).normal(size=(2, 2)))[0]
# x -> x + r x - a x^2 for x > 0, x + (r + d) x - b x^2 - e x^3 for x < 0
CASES = {
    "supercritical_pitchfork": [(1.0, -1.0), (1.0, -0.4), (8.0, -8.0)],
    "subcritical_pitchfork": [(-1.0, 1.0), (-0.4, 1.0)],
    "transcritical": [(1.0, 0.4), (-0.4, -1.0), (0.7, 0.7)],
    "branch_point": [(1.0, 0.0)],
}


def cornered(v: Any, at: Any) -> Any:
    x, y = TURN.T @ (at - 0.3)
    right = x > 0.0
    image = (
        x
        + (v["r"] + jnp.where(right, 0.0, v["d"])) * x
        - jnp.where(right, v["a"], v["b"] + v["e"] * x) * x**2
    )
    return jnp.asarray(TURN) @ jnp.stack([image, 0.5 * y + 0.2 * x**2]) + 0.3


MAPPING = PlainMap(cornered, ("x", "y"), (("r", 0.0), ("a", 1.0), ("b", -1.0), ("d", 0.0), ("e", 0.0)))


def followed(towards: int, **values: Any) -> pd.DataFrame:
    n = max(map(np.size, values.values()))
    starts = MAPPING.points(np.full((n, 2), 0.3))
    table = continuation(
        MAPPING, starts, values, parameter="r", within=(-0.5, 0.5), begin=-0.45 * towards,
        towards=towards, crossing=True, steps=ArclengthSteps(most=40),
    )  # fmt: skip
    at = table[["x", "y"]].to_numpy() - 0.3
    return table.assign(x=at @ TURN[:, 0])


@pytest.mark.parametrize("towards", [1, -1])
def test_both_sides_decide(towards: int) -> None:
    """Half-branches r = a x at x > 0, b x + e x^2 at x < 0; the sides of r = 0 that they take decide."""
    cases = [(kind, *pair) for kind, pairs in CASES.items() for pair in pairs]
    kinds, a, b = zip(*cases, strict=True)
    b = np.array(b)
    e = np.where(b == 0.0, 1.0, 0.0)
    table = followed(towards, a=np.array(a), b=b, e=e)
    at_zero = table[table["special"] != ""]
    assert at_zero["special"].tolist() == list(kinds)
    np.testing.assert_allclose(at_zero["r"], 0.0, atol=1e-8)
    # the multiplier that is 1 there counts on neither side, whatever its last digits are
    assert set(at_zero["unstable"]) == {0}
    assert sorted(set(table["branch"])) == [0, 1, 2]
    assert set(table["end"]) <= {"", "range", "most"}
    across = table.iloc[np.flatnonzero(table["branch"] > 0)]
    x, row = across["x"].to_numpy(float), across["row"].to_numpy(int)
    slope = np.where(x > 0.0, np.array(a)[row], b[row] + e[row] * x)
    np.testing.assert_allclose(across["r"], slope * x, atol=1e-7)
    sides = across.groupby(["row", "branch"])["x"].agg(lambda half: np.sign(half).sum() / len(half))
    assert sorted(sides) == [-1.0] * len(cases) + [1.0] * len(cases)
    np.testing.assert_array_equal(across["stable"], across["r"] > 0.0)


@pytest.mark.parametrize(("a", "b"), [(1.0, -1.0), (1.0, -0.4), (0.7, -2.0)])
def test_from_the_half_that_ends_in_the_corner(a: float, b: float) -> None:
    """From r = a x the pitchfork is named, and the other half and both ways of x = 0 are followed."""
    start = MAPPING.points([0.3 + TURN @ [0.1, 0.004]])
    table = continuation(
        MAPPING, start, {"a": a, "b": b}, parameter="r", within=(-0.5, 1.0), begin=0.1 * a, towards=-1,
        crossing=True, steps=ArclengthSteps(most=40),
    )  # fmt: skip
    x = (table[["x", "y"]].to_numpy() - 0.3) @ TURN[:, 0]
    first = table[table["special"] != ""].iloc[0]
    assert first["special"] == "supercritical_pitchfork"
    np.testing.assert_allclose(first["r"], 0.0, atol=1e-8)
    ends = x[table.groupby("branch").tail(1).index]
    assert sorted(np.sign(np.round(ends[1:], 6))) == [-1.0, 0.0, 0.0]


def test_a_branch_point_of_one_side_alone() -> None:
    """At x < 0 the multiplier is 1 at r = 0.2: there is no second half at r = 0, and the table says so."""
    table = followed(1, a=1.0, d=-0.2)
    at_zero = table[table["special"] != ""].iloc[0]
    assert at_zero["special"] == "branch_point"
    ends = table.groupby("branch")["end"].last()
    assert sorted(ends[1:]) == ["not_found", "range"]
    alone = table[table["end"] == "not_found"].iloc[0]
    assert alone["r"] == at_zero["r"]
    assert (table["branch"] == alone["branch"]).sum() == 1


def test_crossing_branches_that_are_not_found() -> None:
    """X -> (1 + r) x - x |x|^2 in the plane: branches leave r = 0 in every direction at once."""
    mapping = PlainMap(lambda v, at: at * (1.0 + v["r"] - at @ at), ("x", "y"), (("r", 0.0),))
    start = mapping.points([[0.01, 0.0]])
    table = continuation(mapping, start, {}, parameter="r", within=(-0.47, 0.5), crossing=True)
    assert table.loc[table["branch"] > 0, "end"].tolist() == ["not_found", "not_found"]
    assert table.loc[table["special"] != "", "unstable"].tolist() == [0]


class TwoLegs(gs.DeclaredModel):
    """Two legs that land together, and push each other apart while only one of them is down."""

    k = gs.parameter("1/s", "coupling of the phases", 0.1)
    c = gs.parameter("1/s", "the push", 1.0)
    phi = gs.variable("rad", "phase of leg", 0.0, count=2, circular=True)
    down = gs.mode(False, "foot is down", count=2)

    def flow(self, p: Any, s: Any) -> Any:
        apart = jnp.sin(s.phi[::-1] - s.phi)
        return {"phi": 2.0 * jnp.pi + (p.k - p.c * (s.down[0] != s.down[1])) * apart}

    @gs.event("foot {} lands", count=2, section="first", during=lambda s: ~s.down)
    def landing(self, p: Any, s: Any) -> Any:
        return s.phi - 2.0 * jnp.pi

    @landing.jump
    def land(self, p: Any, s: Any, i: int) -> Any:
        return s.replace(phi=s.phi.at[i].set(0.0), down=s.down.at[i].set(True))

    @gs.event("foot {} lifts", count=2, during=lambda s: s.down)
    def lifting(self, p: Any, s: Any) -> Any:
        return s.phi - jnp.pi

    @lifting.jump
    def lift(self, p: Any, s: Any, i: int) -> Any:
        return s.replace(down=s.down.at[i].set(False))

    def complete(self, p: Any, s: Any) -> Any:
        return s.replace(down=s.phi < jnp.pi)

    def period(self, p: Any) -> Any:
        return jnp.ones(())


@pytest.mark.slow
def test_a_phase_that_waits_for_its_event_keeps_its_turn() -> None:
    """With 2 pi + 0.07 a leg has not landed; with 0.07 it has."""
    model = TwoLegs()
    params = model.params({"k": jnp.asarray(0.1), "c": jnp.asarray(1.0)})
    starts = {quantity.name: jnp.asarray(quantity.default) for quantity in model.initial_conditions}
    state = model.init(params, starts).replace(phi=jnp.array([0.0, 2.0 * jnp.pi + 0.07]))
    chart = model.chart()
    assert chart is not None
    at = chart.to_coordinates(params, state)
    np.testing.assert_allclose(at, [0.0, 0.07], atol=1e-12)
    again = chart.from_coordinates(params, at, state)
    np.testing.assert_allclose(again.phi, state.phi, atol=1e-12)
    assert again.down.tolist() == [True, False]


@pytest.mark.slow
def test_two_feet_that_land_at_once() -> None:
    """Phase difference x -> x - 2 k x + (2 c / pi) |x| x: a pitchfork at k = 0, by the sign of c.

    x = phi_2 - phi_1 changes by -2 k sin x in a period, and by 2 c sin x over |x| / (2 pi) twice, between the
    landings and between the lift-offs.
    """
    for c, kind in ((1.0, "subcritical_pitchfork"), (-1.0, "supercritical_pitchfork")):
        chain = gs.return_map(TwoLegs(), c=c, k=0.1)
        starts = chain.settled({"phi_2_0": 0.02}, cycles=60)
        table = continuation(
            chain.mapping, starts, {"c": c}, parameter="k", within=(-0.1, 0.1), begin=0.1, towards=-1,
            crossing=True, steps=ArclengthSteps(most=12),
        )  # fmt: skip
        at_zero = table[table["special"] != ""]
        assert at_zero["special"].tolist() == [kind]
        np.testing.assert_allclose(at_zero["k"], 0.0, atol=1e-8)
        assert at_zero["unstable"].tolist() == [0]
        across = table.iloc[np.flatnonzero(table["branch"] > 0)]
        x = np.sin(across["phi_2"].to_numpy(float) - across["phi_1"].to_numpy(float))
        sides = set(zip(across["branch"], np.sign(x), strict=True))
        assert sides in ({(1, 1.0), (2, -1.0)}, {(1, -1.0), (2, 1.0)})
        # the next term is of the order of x^3
        np.testing.assert_allclose(across["k"], c * np.abs(x) / np.pi, rtol=0.1)
        assert set(across["stable"]) == {c < 0.0}
