"""The events of gaits along a branch: their times against a closed form, and where their order changes."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

import gaitsweep as gs
from gaitsweep.analysis.atlas import order_changes
from gaitsweep.analysis.atlas.order_changes import changes_of_order

# The height is p + cos(theta - pi/4) / sqrt(2), so that it rises through zero with the bell at this p.
BELL = 0.5
TOGETHER = -np.cos(BELL - np.pi / 4.0) / np.sqrt(2.0)


class TwoBells(gs.DeclaredModel):
    """A force that begins with the later of two events: at an angle, and where a height rises."""

    section_coordinates = ("height", "speed")

    p = gs.parameter("1", "mean height", -0.65)
    bell_at = gs.parameter("rad", "angle of the bell", BELL)

    theta = gs.variable("rad", "angle, which turns at the rate 1", 0.0)
    height = gs.variable("m", "height", -0.2, observed=True)
    speed = gs.variable("m/s", "speed", 0.0, observed=True)
    rung = gs.mode(False, "whether the bell has rung in this turn")
    high = gs.mode(False, "whether the height has risen in this turn")

    def flow(self, p, s):
        force = jnp.where(s.rung & s.high, 1.0, 0.0)
        return {"theta": 1.0, "height": p.p - s.height + jnp.cos(s.theta), "speed": force - s.speed}

    @gs.event("bell", during=lambda s: ~s.rung)
    def bell(self, p, s):
        return s.theta - p.bell_at

    @bell.jump
    def ring(self, p, s):
        return s.replace(rung=True)

    @gs.event("height rises", during=lambda s: ~s.high)
    def rising(self, p, s):
        return s.height

    @rising.jump
    def rise(self, p, s):
        return s.replace(high=True)

    @gs.event("turn", section=True)
    def turn(self, p, s):
        return s.theta - 2.0 * np.pi

    @turn.jump
    def begin(self, p, s):
        return s.replace(theta=0.0, rung=False, high=False)

    def complete(self, p, s):
        return s.replace(theta=0.0)

    def period(self, params: Any) -> Any:
        return 2.0 * np.pi


@pytest.mark.slow
def test_times_and_order_of_events_and_where_it_changes() -> None:
    bells = gs.atlas(
        TwoBells(), parameter="p", path=(-0.70, -0.62), at=-0.65, ranges={"height": (-1.0, 1.0)},
        periods=1, depth=0, budget=8, batch=8, verify=0, second={"bell_at": (0.4, 0.6)},
    )  # fmt: skip
    branch = bells.branches
    rises = np.pi / 4.0 - np.arccos(-branch["p"] * np.sqrt(2.0))
    np.testing.assert_allclose(branch["t_height_rises"], rises, atol=1e-9)
    np.testing.assert_allclose(branch["t_bell"], BELL, atol=1e-12)
    first = np.where(branch["p"] > TOGETHER, "height rises, bell, turn", "bell, height rises, turn")
    assert branch["events"].astype(str).tolist() == first.tolist()
    changes = branch[branch["special"] == "order_change"]
    assert changes["change"].tolist() == ["bell and height rises change places"]
    np.testing.assert_allclose(changes["p"], TOGETHER, atol=1e-9)
    assert set(branch["change"].astype(str)) == {"", *changes["change"]}
    curve = bells.curves
    assert set(curve["part"]) == {"order_change"}
    exact = -np.cos(curve["bell_at"] - np.pi / 4.0) / np.sqrt(2.0)
    np.testing.assert_allclose(curve["p"], exact, atol=1e-8)
    assert [curve["bell_at"].min(), curve["bell_at"].max()] == pytest.approx([0.4, 0.6])
    assert set(curve["end"].astype(str)) == {"", "range"}


def test_a_change_of_order_in_words() -> None:
    lands, lifts = (0.1, "foot 1 lands"), (0.2, "foot 2 lifts")
    assert changes_of_order([lands, lifts], [lands, lifts]) == ()
    strike, apex = (0.3, "strike"), (0.4, "apex")
    moved = changes_of_order([lands, lifts, strike, apex], [strike, lands, lifts, apex])
    assert moved == ("strike passes the section",)
    again = changes_of_order([lands, lifts, lands], [lands, lands, lifts])
    assert again == ("foot 2 lifts and foot 1 lands change places",)
    assert changes_of_order([lands, lifts], [lands]) == ("without foot 2 lifts",)
    assert changes_of_order([lands], [lands, lifts]) == ("with foot 2 lifts",)
    assert changes_of_order([lands, lifts], [lifts, lands]) == (
        "foot 1 lands and foot 2 lifts change places",
    )
    comma = (0.3, "heel, then toe, lands")
    assert set(changes_of_order([lands, comma], [])) == {
        "without foot 1 lands",
        "without heel, then toe, lands",
    }


def test_changes_beyond_the_most_of_a_step_are_noted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(order_changes, "MOST_CHANGES", 0)
    before = {"at": None, "events": [(0.1, "foot 1 lands"), (0.2, "foot 2 lands")]}
    after: dict[str, Any] = {"at": None, "events": [(0.1, "foot 2 lands"), (0.2, "foot 1 lands")]}
    problem: Any = None
    assert list(order_changes._marks_on_step(problem, before, after)) == []
    assert after["changes"] == ("foot 1 lands and foot 2 lands change places",)
