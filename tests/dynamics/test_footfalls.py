"""Footfalls of constructed sequences, whose lags, duty factors, support and names of gaits are known."""

from __future__ import annotations

import dataclasses
import itertools
from types import SimpleNamespace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest

import gaitsweep as gs
from gaitsweep import DeclaredModel, event, footfalls, mode, parameter, variable
from gaitsweep.dynamics.gaits_by_footfalls import (
    GAITS,
    LEGS,
    SHORTEST_CONTACT,
    Footfalls,
    Steps,
    gait_of_footfalls,
    support_patterns,
)
from gaitsweep.models.conformity import fault
from gaitsweep.models.value_faults import faults
from gaitsweep.runs.sentences import remarks
from gaitsweep.runs.summary import (
    add_backwards,
    add_short_contacts,
    add_uneven_strides,
    add_without_gait,
)

# Touchdowns as shares of a stride, in the order of `LEGS`, and the duty factor, of gaits as their sources
# describe them. Fours are LF, RF, LH, RH; sixes L1, R1, L2, R2, L3, R3.
FOOTFALLS = [
    ("walk", [0.0, 0.5], 0.6),
    ("run", [0.0, 0.5], 0.35),
    ("hop", [0.0, 0.02], 0.3),
    ("none", [0.0, 0.25], 0.4),
    # Hildebrand 1965: the hind foot, then the fore foot of its side a quarter of the stride later
    ("lateral sequence walk", [0.0, 0.5, 0.75, 0.25], 0.65),
    ("lateral sequence run", [0.0, 0.5, 0.75, 0.25], 0.4),  # the running walk
    ("lateral sequence walk", [0.0, 0.5, 0.65, 0.15], 0.65),  # in diagonal couplets
    ("diagonal sequence walk", [0.0, 0.5, 0.25, 0.75], 0.65),  # of primates
    ("diagonal sequence run", [0.0, 0.5, 0.25, 0.75], 0.4),
    ("trot", [0.0, 0.5, 0.5, 0.0], 0.45),
    ("trot", [0.0, 0.5, 0.54, 0.04], 0.55),
    ("pace", [0.0, 0.5, 0.0, 0.5], 0.45),
    ("pace", [0.0, 0.5, 0.95, 0.45], 0.45),
    ("pronk", [0.0, 0.02, 0.98, 0.0], 0.3),
    ("bound", [0.0, 0.0, 0.5, 0.5], 0.3),
    ("bound", [0.0, 0.03, 0.7, 0.71], 0.3),
    ("half-bound", [0.0, 0.15, 0.5, 0.5], 0.3),
    # Hildebrand 1977: hind feet left, right, then fore feet in the same order, or in the other one
    ("transverse gallop", [0.0, 0.15, 0.5, 0.65], 0.3),
    ("transverse gallop", [0.0, 0.85, 0.5, 0.35], 0.3),
    ("rotary gallop", [0.0, 0.85, 0.5, 0.65], 0.3),
    ("none", [0.0, 0.5, 0.3, 0.3], 0.3),  # one pair alternates, the other lands together
    ("tripod", [0.0, 0.5, 0.5, 0.0, 0.0, 0.5], 0.5),
    # DeAngelis et al. 2019: legs follow those behind them by a third or a sixth
    ("tetrapod", [2 / 3, 0.0, 1 / 3, 2 / 3, 0.0, 1 / 3], 0.65),
    ("tetrapod", [2 / 3, 1 / 3, 1 / 3, 0.0, 0.0, 2 / 3], 0.65),
    ("metachronal wave", [2 / 6, 5 / 6, 1 / 6, 4 / 6, 0.0, 3 / 6], 0.8),
    ("none", [0.0, 0.0, 0.0, 0.0, 0.0, 0.0], 0.5),
]


@pytest.mark.parametrize(("gait", "touchdowns", "duty"), FOOTFALLS)
def test_gaits_have_the_names_of_their_sources(gait: str, touchdowns: list[float], duty: float) -> None:
    """Whatever the instant from which touchdowns count, and in whichever order the legs are."""
    legs = LEGS[len(touchdowns)]
    order = np.random.default_rng(0).permutation(len(legs))
    for shift in (0.0, 0.37, -2.2):
        named = gait_of_footfalls(
            [touchdowns[i] + shift for i in order], [duty] * len(legs), [legs[i] for i in order]
        )
        assert named == gait


@dataclasses.dataclass(frozen=True)
class Stepper(DeclaredModel):
    """Legs that turn at one rate: they land at the phase 2 pi and lift at that of their duty factor."""

    N: int = 4

    omega = parameter("rad/s", "rate of the legs", 5.0, low=0.0, open_ends=True)
    duty = parameter("1", "share of the turn on the ground", 0.6, low=0.0, high=1.0)
    phase = variable("rad", "phase of leg", 0.0, count="N", circular=True)
    down = mode(True, "leg is down", count="N")
    time = variable("s", "time since the first leg's touchdown")

    def flow(self, p, s):
        return {"phase": p.omega * jnp.ones(self.N), "time": 1.0}

    @event("foot {} lands", count="N", section="first", during=lambda s: ~s.down)
    def landing(self, p, s):
        return s.phase - 2.0 * jnp.pi

    @landing.jump
    def land(self, p, s, i):
        phase, down = s.phase.at[i].add(-2.0 * jnp.pi), s.down.at[i].set(True)
        return s.replace(phase=phase, down=down, time=0.0 if i == 0 else s.time)

    @event("foot {} lifts", count="N", during=lambda s: s.down)
    def lift(self, p, s):
        return s.phase - 2.0 * jnp.pi * p.duty

    @lift.jump
    def lifted(self, p, s, i):
        return s.replace(down=s.down.at[i].set(False))

    def period(self, p):
        return 2.0 * jnp.pi / p.omega


class Biped(Stepper):
    feet = footfalls("time", legs=LEGS[2])(lambda self, p, s: s.down)


class Quadruped(Stepper):
    feet = footfalls("time", legs=LEGS[4])(lambda self, p, s: s.down)


class Hexapod(Stepper):
    feet = footfalls("time", legs=LEGS[6])(lambda self, p, s: s.down)


MODELS = {2: Biped(N=2), 4: Quadruped(), 6: Hexapod(N=6)}


class Unheard(Stepper):
    """Its feet come down and lift between the sections, at no event."""

    feet = footfalls("time", legs=LEGS[2])(lambda self, p, s: (s.phase > 2.0) & (s.phase < 4.0))


class Lame(Stepper):
    """Its right foot never comes down."""

    feet = footfalls("time", legs=LEGS[2])(lambda self, p, s: s.down & jnp.array([True, False]))


@pytest.mark.slow
def test_a_foot_that_lands_in_no_row_is_named() -> None:
    with pytest.warns(UserWarning, match="Foot R of .* has no stride in any row"):
        manifest = gs.sweep(Lame(N=2), run=gs.Settle(max_cycles=8), verify=0).manifest
    (about,) = manifest["without_strides"].values()
    assert about["feet"] == ["R"]
    assert not about["body"]
    of_body = {"rows": 3, "row": 0, "body": True}
    assert "contype and conaffinity" in remarks({"without_strides": {"biped": of_body}})[0]


@pytest.mark.slow
def test_feet_that_change_between_events_are_remarked() -> None:
    with pytest.warns(UserWarning, match="No foot of .* has a stride in any row") as said:
        result = gs.sweep(Unheard(N=2), duty=[0.5, 0.9], run=gs.Settle(max_cycles=8), verify=0)
    assert np.isnan(result.table[["stride_1_end", "stride_2_end", "lag_2_end"]].to_numpy()).all()
    assert any("changes only at events or by modes" in str(each.message) for each in said)
    runs = [gs.Settle(max_cycles=8), gs.Staircase(parameter="duty", path=[0.5, 0.6], step=0.05, dwell=4.0)]
    for run, model in itertools.product(runs, (Unheard, Biped)):
        manifest = gs.sweep(model(N=2), omega=5.0, run=run, verify=0).manifest
        assert ("without_strides" in manifest) == (model is Unheard)


@pytest.mark.slow
@pytest.mark.parametrize("legs", [2, 4, 6])
def test_observables_are_those_of_the_constructed_footfalls(legs: int) -> None:
    """Events are located to 1e-12 of a stride and tolerances are 1e-8: 1e-7 finds any other step."""
    rows = [row for row in FOOTFALLS if len(row[1]) == legs and 0.0 < row[2] < 1.0]
    lags = np.mod(np.array([row[1] for row in rows]), 1.0)
    lags = np.mod(lags - lags[:, :1], 1.0)
    start = np.mod(2.0 * np.pi * (0.9 - lags), 2.0 * np.pi)
    duty = np.array([row[2] for row in rows])
    axes = {f"phase_{i + 1}_0": start[:, i] for i in range(legs)} | {"duty": duty}
    axes |= {f"down_{i + 1}_0": (start[:, i] < 2.0 * np.pi * duty).astype(float) for i in range(legs)}
    table = gs.sweep(MODELS[legs], zip=axes, run=gs.Settle(tolerance=1e-9), verify=0).table
    assert table["gait"].tolist() == [row[0] for row in rows]
    assert set(table["status"]) == {"settled"}
    for i in range(legs):
        np.testing.assert_allclose(table[f"stride_{i + 1}_end"], 2.0 * np.pi / 5.0, atol=1e-7)
        np.testing.assert_allclose(table[f"duty_{i + 1}_end"], duty, atol=1e-7)
        if i:
            away = table[f"lag_{i + 1}_end"].to_numpy() / (2.0 * np.pi) - lags[:, i]
            np.testing.assert_allclose(away - np.round(away), 0.0, atol=1e-7)
    for row, (at, share) in enumerate(zip(lags, duty, strict=True)):
        patterns = support_patterns(at.tolist(), [share] * legs, LEGS[legs])
        assert sum(patterns.values()) == pytest.approx(1.0)
        for k in range(legs + 1):
            known = sum(part for feet, part in patterns.items() if len(feet.split()) == k)
            np.testing.assert_allclose(table[f"support_{k}_end"].to_numpy(float)[row], known, atol=1e-7)


def test_support_patterns_are_the_feet_that_are_down() -> None:
    """Hildebrand's lateral sequence walk of duty factor 5/8 stands on two or three feet."""
    result = support_patterns([0.0, 0.5, 0.75, 0.25], [0.625] * 4, LEGS[4])
    assert result == pytest.approx(
        {
            "LF RF LH": 0.125, "LF LH": 0.125, "LF LH RH": 0.125, "LF RH": 0.125,
            "LF RF RH": 0.125, "RF RH": 0.125, "RF LH RH": 0.125, "RF LH": 0.125,
        }
    )  # fmt: skip
    # 0.11 + 0.5 is not 0.61 to the last bit
    assert set(support_patterns([0.61, 0.11], [0.5, 0.5], LEGS[2])) == {"L", "R"}


def test_footfalls_that_are_not_numbers_have_no_gait() -> None:
    """A foot that stands has no lag; all comparisons with it are false, which left a rotary gallop."""
    for at, duty in ([[0.0, 0.5, np.nan, 0.0], [0.6] * 4], [[0.0, 0.5, 0.5, 0.0], [0.6, np.nan, 0.6, 0.6]]):
        assert gait_of_footfalls(at, duty, LEGS[4]) == "none"
        with pytest.raises(ValueError, match=r"are .*nan.*, but must be finite"):
            support_patterns(at, duty, LEGS[4])


@pytest.mark.slow
def test_a_model_with_footfalls_has_names_limbs_and_contacts() -> None:
    model = Quadruped()
    assert fault(model) is None
    assert model.gaits == GAITS[4]
    assert [limb.name for limb in model.limbs] == ["LF", "RF", "LH", "RH"]
    assert [q.name for q in model.signals][-4:] == [f"contact_{i}" for i in (1, 2, 3, 4)]
    chart = model.chart()
    assert chart is not None
    names = [q.name for q in chart.coordinates]
    assert names == ["phase_1", "phase_2", "phase_3", "phase_4"], "without the clock"


def test_a_leg_that_does_not_step_once_a_stride_has_no_gait() -> None:
    """The same lags, but the second leg lands twice as often, or has stopped in the air."""
    feet = Biped.declarations.feet
    assert feet is not None
    at = {"stride_1": 1.0, "stride_2": 1.0, "lag_2": np.pi, "duty_1": 0.6, "duty_2": 0.6}
    names = [
        feet.gaits[int(feet.gait({**at, **changed}))]
        for changed in ({}, {"stride_2": 0.5}, {"duty_2": 0.0}, {"stride_1": 0.0, "stride_2": 0.0})
    ]
    assert names == ["walk", "none", "none", "none"]


@pytest.mark.slow
@pytest.mark.parametrize(("drag", "steps"), [(1.0, True), (0.0, False)])
def test_a_foot_that_stands_has_no_steps_and_its_row_settles(drag: float, steps: bool) -> None:
    """The right foot stands from the start, so that its last step would be one of no time."""

    class Dragging(Biped):
        drag = parameter("1", "rate of the right leg, as a share", 1.0)

        def flow(self, p, s):
            return {"phase": p.omega * jnp.stack([jnp.ones(()), p.drag]), "time": 1.0}

    table = gs.sweep(Dragging(N=2), phase_2_0=[np.pi], drag=[drag], run=gs.Settle(), verify=1).table
    assert (table["status"][0], table["gait"][0]) == ("settled", "walk" if steps else "none")
    assert table["stride_1_end"].to_numpy(float)[0] == pytest.approx(2.0 * np.pi / 5.0, rel=1e-9)
    for name in ("stride_2_end", "lag_2_end", "duty_2_end"):
        assert np.isnan(table[name].to_numpy(float)[0]) != steps


def test_footfalls_that_have_no_names_are_refused() -> None:
    with pytest.raises(ValueError, match="allowed are, in any order, L, R; LF, RF, LH, RH; L1"):
        footfalls("time", legs=("FL", "FR", "HL", "HR"))
    for legs, duty in ((("L", "R"), [0.6]), ((), [])):
        with pytest.raises(ValueError, match="give one touchdown and one duty factor for each leg"):
            support_patterns([0.0] * len(legs), duty, legs)
    for function in (gait_of_footfalls, support_patterns):
        with pytest.raises(ValueError, match="A duty factor is 60, but must be a share"):
            function([0.0, 0.5], [0.6, 60.0], LEGS[2])
    with pytest.raises(TypeError, match="footfalls of the clock tme, no variable; did you mean time"):
        type("Mine", (Stepper,), {"feet": footfalls("tme", legs=LEGS[4])(lambda self, p, s: s.down)})
    with pytest.raises(TypeError, match="gaits of its own without label: leave gaits out"):
        type("Mine", (Quadruped,), {"gaits": ("a", "b")})

    class Numbers(Stepper):
        feet = footfalls("time", legs=LEGS[4])(lambda self, p, s: s.down.astype(float))

    assert "must return (4,) of bool, one for each of LF, RF, LH, RH" in (fault(Numbers()) or "")


@pytest.mark.slow
def test_a_clock_of_another_rate_is_a_fault() -> None:
    """Its strides would be twice as long."""

    class Doubled(Quadruped):
        def flow(self, p, s):
            return {"phase": p.omega * jnp.ones(4), "time": 2.0}

    class Without(Quadruped):
        def flow(self, p, s):
            return {"phase": p.omega * jnp.ones(4)}

    for model, words in (
        (Doubled, "flow returns the rate 2 of time"),
        (Without, "no rate of time, the clock"),
    ):
        (message,) = faults(model)
        assert words in message


@pytest.mark.slow
def test_contacts_of_a_step_or_two_do_not_count() -> None:
    """A trot of stride 0.4 s and duty 0.6, whose contacts chatter at touchdown and before liftoff.

    A foot has landed at the first touch of its bounce, and lifted at the last lift. Without the rule it has
    no stride.
    """
    dt, period, duty, touchdown = 0.002, 0.4, 0.6, np.array([0.0, 0.5, 0.5, 0.0])
    phase = np.mod(np.arange(1100)[:, None] * dt / period - touchdown + 1e-9, 1.0)
    down = phase < duty
    step = np.floor(phase * period / dt + 1e-6)
    of_stance = round(duty * period / dt)
    down[step == 1] = False  # it bounces
    down[(step >= of_stance - 4) & (step < of_stance - 2)] = False
    feet = Footfalls(lambda model, params, state: state.down, "time", LEGS[4])
    model: Any = SimpleNamespace(period=lambda params: jnp.asarray(period))
    debounced, plain = (feet.begun(jnp.zeros(()), debounced=debounced) for debounced in (True, False))
    states = SimpleNamespace(down=jnp.asarray(down), time=dt * jnp.arange(len(down)))
    every_step = np.arange(len(down))
    # a located model knows of feet at its events alone: here the changes, and a section in each stride
    changes = np.flatnonzero((down[1:] != down[:-1]).any(axis=1)) + 1
    at_events = np.union1d(changes, np.r_[0, 150 : len(down) : 200, len(down) - 1])

    def at(i: Any) -> Any:
        return SimpleNamespace(down=states.down[i], time=states.time[i])

    def steps_at(steps: Steps, instants: np.ndarray) -> Steps:
        def after(k: Any, before: Any) -> Any:
            j, i = jnp.asarray(instants)[k - 1], jnp.asarray(instants)[k]
            return feet.after(model, None, before, at(j), at(i), jnp.zeros(()))

        return jax.lax.fori_loop(1, len(instants), after, steps)

    def end(steps: Steps, instants: np.ndarray = every_step) -> dict[str, float]:
        last = steps_at(steps, instants)
        return {k: float(v) for k, v in feet.observed(model, None, at(-1), last).items()}

    assert SHORTEST_CONTACT * period > 4 * dt
    for instants in (every_step, at_events):
        numbers = end(debounced, instants)
        for leg in range(4):
            assert numbers[f"stride_{leg + 1}"] == pytest.approx(period, abs=1e-9)
            assert numbers[f"duty_{leg + 1}"] == pytest.approx(duty, abs=1e-9)
        lags = [numbers[f"lag_{i}"] for i in (2, 3, 4)]
        np.testing.assert_allclose(np.cos(lags), [-1.0, -1.0, 1.0], atol=1e-9)
        assert numbers["support_4"] == pytest.approx(0.2, abs=1e-9)
        assert GAITS[4][int(feet.gait(numbers))] == "trot"
    assert not abs(end(plain)["stride_1"] - period) < 0.1 * period  # none
    # a bounce of one diagonal alone does not change the gait, nor that the shares of support add up
    plain_touchdown = np.array(down)
    plain_touchdown[:, [1, 2]] |= (step[:, [1, 2]] < 12) & (phase[:, [1, 2]] < duty)
    states.down = jnp.asarray(
        plain_touchdown & ~((step >= 1) & (step < 9) & np.array([True, False, False, True]))
    )
    numbers = end(feet.begun(jnp.zeros(()), debounced=True))
    assert [numbers[f"lag_{i}"] for i in (2, 4)] == pytest.approx([np.pi, 0.0], abs=1e-9)
    assert sum(numbers[f"support_{k}"] for k in range(5)) == pytest.approx(1.0, abs=1e-9)
    states.down = jnp.asarray(down)
    # the stances in which feet begin are no touchdowns
    start = feet.begun(states.time[20], debounced=True)
    for instants in (every_step[20:150], np.union1d([20], at_events[(at_events > 20) & (at_events < 150)])):
        assert steps_at(start, instants).landings.tolist() == [0, 1, 1, 0]
    feet = dataclasses.replace(feet, shortest_contact=0.0)  # every contact counts
    # strides of bounces are short, but are strides: a foot that bounces has landed
    assert 0.0 < end(feet.begun(jnp.zeros(()), debounced=True))["stride_1"] < 0.1 * period
    with pytest.raises(ValueError, match=r"shortest_contact is 0\.6, but must be a share from 0 to 0\.5"):
        footfalls("time", legs=LEGS[4], shortest_contact=0.6)


def test_a_settled_row_whose_foot_lands_more_than_once_a_stride_is_remarked() -> None:
    """Row 1 has a walk, row 2 an orbit of two crossings, and row 3 equal strides without a name."""
    part = pd.DataFrame({
        "row": [0, 1, 2, 3], "status": ["settled"] * 4, "attractor_period": [1, 1, 2, 1],
        "gait": ["none", "walk", "none", "none"],
        "stride_1_end": [0.96, 0.96, 0.96, 0.96], "stride_2_end": [0.42, 0.96, 0.42, 0.96],
        "duty_1_end": [0.55] * 4, "duty_2_end": [0.15] * 4,
    })  # fmt: skip
    uneven: dict[str, Any] = {}
    reasons: dict[str, dict[str, int]] = {}
    add_uneven_strides(uneven, part, {"stride_1_end": "L", "stride_2_end": "R"})
    assert uneven == {"R": {"rows": 1, "row": 0, "contact": pytest.approx([0.063, 0.063])}}
    (sentence,) = remarks({"uneven_strides": {"feet": uneven, "body": True}})
    assert "1 row has no gait, since a foot lands more than once a stride" in sentence
    assert "foot R: its last contact has 0.063 s" in sentence
    assert "`shortest_contact` in the model file" in sentence
    # the stance of a bounce's end is longer than the time between its touchdowns: no duty factor
    bouncing = part.loc[[3]].assign(
        stride_1_end=0.18, stride_2_end=0.18, duty_1_end=np.nan, duty_2_end=np.nan
    )
    uneven, reasons = {}, {}
    # of two nearly equal strides that of the foot that bounces counts
    of_right = bouncing.assign(stride_2_end=0.1801, duty_1_end=0.6)
    add_uneven_strides(uneven, of_right, {"stride_1_end": "L", "stride_2_end": "R"})
    assert list(uneven) == ["R"]
    uneven = {}
    add_uneven_strides(uneven, bouncing, {"stride_1_end": "L", "stride_2_end": "R"})
    add_without_gait(reasons, bouncing, {"stride_1_end": "L", "stride_2_end": "R"})
    assert uneven == {"L": {"rows": 1, "row": 3, "contact": []}}
    # on an orbit of several crossings too
    both = bouncing.assign(attractor_period=2)
    add_uneven_strides(uneven, both, {"stride_1_end": "L", "stride_2_end": "R"})
    assert uneven["L"]["rows"] == 2
    assert not reasons
    (sentence,) = remarks({"uneven_strides": {"feet": uneven, "body": True}})
    assert "foot L: its last contact is longer than that stride" in sentence
    # strides differ by more than those of a gait, 1/16 of the first
    longer = part.loc[[3]].assign(stride_2_end=0.96 * 1.064)
    add_without_gait(reasons, longer, {"stride_1_end": "L", "stride_2_end": "R"})
    assert not reasons
    # row 2's strides differ over two crossings, those of row 3 are equal, and row 4 has a foot that stands
    part.loc[4] = [4, "settled", 1, "none", 0.96, np.nan, 0.55, np.nan]
    add_without_gait(reasons, part, {"stride_1_end": "L", "stride_2_end": "R"})
    assert {reason: about["row"] for reason, about in reasons.items()} == {
        "no_stride": 4, "several": 2, "other_lags": 3,
    }  # fmt: skip
    (sentence,) = remarks({"without_gait": {"legs": 2, "reasons": reasons}})
    assert "3 settled rows have the gait none" in sentence
    assert "in 1 row (row 4) foot R has no stride" in sentence
    assert "lag_2 / (2 pi) is within 0.1 of 1/2 in a walk or run, and within 0.0625 of 0 in a hop" in sentence


def test_rows_at_the_limit_of_cycles_have_a_reason_for_no_gait() -> None:
    """Row 0 has strides that differ, row 1 a foot whose last stance is longer than its stride."""
    part = pd.DataFrame({
        "row": [0, 1, 2, 3], "status": ["cycle_limit"] * 3 + ["fell"], "attractor_period": [0] * 4,
        "gait": ["none", "none", "walk", "none"],
        "stride_1_end": [0.96, 0.2, 0.96, 0.9], "stride_2_end": [0.42, 0.2, 0.96, 0.4],
        "duty_1_end": [0.55, np.nan, 0.5, 0.5], "duty_2_end": [0.15, 0.4, 0.5, 0.5],
    })  # fmt: skip
    feet = {"stride_1_end": "L", "stride_2_end": "R"}
    uneven: dict[str, Any] = {}
    reasons: dict[str, dict[str, Any]] = {}
    add_uneven_strides(uneven, part, feet)
    add_without_gait(reasons, part, feet)
    assert {foot: about["row"] for foot, about in uneven.items()} == {"L": 1}
    assert reasons == {"unsettled": {"rows": 1, "row": 0}}
    (sentence,) = remarks({"without_gait": {"legs": 2, "reasons": reasons}})
    assert "1 row (row 0) reached the limit of cycles" in sentence


def test_names_that_depend_on_the_shortest_contact_are_remarked() -> None:
    """Stances last for 0.08 and 0.3 of the period; twice 0.05 leaves out the first, and not a lone swing."""
    part = pd.DataFrame({
        "row": [4, 5, 6], "status": ["settled", "settled", "cycle_limit"], "gait": ["run", "run", "run"],
        "stride_1_end": [1.0] * 3, "stride_2_end": [1.0] * 3,
        "duty_1_end": [0.16, 0.3, 0.1], "duty_2_end": [0.3, 0.3, 0.1],
    })  # fmt: skip
    about: dict[str, Any] = {}
    feet = {"stride_1_end": "L", "stride_2_end": "R"}
    add_short_contacts(about, part, feet, 0.05, lambda rows: np.full(len(rows), 2.0))
    assert about == {
        "rows": 1, "row": 4, "feet": ["L"], "share": pytest.approx([0.08, 0.08]), "shortest_contact": 0.05,
    }  # fmt: skip
    (sentence,) = remarks({"short_contacts": about})
    assert "1 row (row 4) depends on `shortest_contact`, 0.05" in sentence
    assert "foot L would not count, which lasts for 0.08" in sentence
    nothing: dict[str, Any] = {}
    add_short_contacts(nothing, part, feet, 0.05, lambda rows: np.full(len(rows), 1.0))
    assert not nothing


def test_a_settled_body_that_walks_backwards_is_remarked() -> None:
    about: dict[str, Any] = {}
    for speeds in ([-0.2, 0.3, -1e-9], [-0.4, -0.5, np.nan]):
        status = ["settled", "settled", "cycle_limit"]
        add_backwards(about, pd.DataFrame({"row": [7, 8, 9], "status": status, "speed_end": speeds}))
    assert about == {"rows": 3, "row": 7, "fastest": -0.5}
    (sentence,) = remarks({"backwards": about})
    assert "3 rows (the first is row 7) settled, but walk backwards" in sentence
    assert "-0.5 m/s" in sentence
