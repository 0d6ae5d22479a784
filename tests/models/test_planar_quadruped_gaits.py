"""Gaits of the planar quadruped over speed, by its tree in the kernel; the order is the paper's."""

# MuJoCo's compiled modules come without types.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pandas as pd
import pytest
from reference.planar_quadruped_mujoco import PlanarQuadruped as InMujoco
from reference.planar_quadruped_mujoco import onsets

from gaitsweep.engine.numerics import Numerics
from gaitsweep.engine.recorders.recordings import CrossingRecorder
from gaitsweep.papers.fukuoka2015.analysis.swing_onsets import gait_of, onsets_of_crossings
from gaitsweep.papers.fukuoka2015.planar_quadruped import PlanarQuadruped, cycle
from gaitsweep.papers.fukuoka2015.planar_quadruped.mechanics import mjcf
from gaitsweep.papers.fukuoka2015.planar_quadruped.nine_gaits import CHART, LEGS, signs
from gaitsweep.status import Status
from tests.support.gait_traces import ideal_phases
from tests.support.sweeping import complete, run_rows, scalars

DURATION, READ = 24.0, 15.0  # s; what is read comes after READ
WALKS, CANTERS = {"D-walk", "L-walk"}, {"uR-canter", "uL-canter", "R-canter", "L-canter"}
GALLOPS = {"RT-gallop", "LT-gallop"}


def gaits(sigma: Any, seeds: Any, **params: float) -> pd.DataFrame:
    """The gait of each sigma and seed, with the mean speed and share of flight in what is read."""
    model = PlanarQuadruped()
    grid, seed = (each.ravel() for each in np.meshgrid(sigma, seeds, indexing="ij"))
    block = run_rows(
        model,
        CrossingRecorder(model, duration=DURATION),
        {"seed": seed.astype(float), "pair": (seed % 2).astype(float)},
        params={"sigma": grid, **params},
        numerics=Numerics(dt=1e-3),
        lanes=32,
        engine="kernel",
    )
    names = ["crossing", "t", *(f"{quantity.name}_n" for quantity in model.observables)]
    table = pd.DataFrame(block.samples, columns=names).assign(row=block.owner)
    table["status"] = np.where(block.status == Status.complete, "complete", "fell")[block.owner]
    result = gait_of(onsets_of_crossings(table), window=(READ, DURATION), rows=range(grid.size))
    late = table.loc[table["t"] > READ].groupby("row")[["speed_n", "flight_n"]].mean()
    return result.set_index("row").assign(
        sigma=grid, seed=seed, speed=late["speed_n"], flight=late["flight_n"], fell=block.status
    )


@pytest.fixture(scope="module")
def fed_back() -> pd.DataFrame:
    return gaits([0.0, 0.2, 0.4, 0.5, 0.6, 0.8, 0.95, 1.0], [20, 21])


@pytest.mark.slow
def test_walk_trot_canter_gallop_in_the_papers_order_of_speed(fed_back: pd.DataFrame) -> None:
    named = {sigma: set(part["gait"]) for sigma, part in fed_back.groupby("sigma")}
    for sigma in (0.0, 0.2, 0.4):
        assert named[sigma] <= WALKS, sigma
    assert named[0.5] == named[0.6] == {"trot"}
    assert named[0.8] <= CANTERS
    assert named[0.95] <= GALLOPS
    assert named[1.0] <= GALLOPS


@pytest.mark.slow
def test_speeds_periods_and_flight_are_the_pages(fed_back: pd.DataFrame) -> None:
    mean = fed_back.pivot_table(index="sigma", values=["speed", "period", "flight"])
    # the page's speeds, with MuJoCo's contacts; the compliant foot is within 3 % of them
    for sigma, speed in {0.0: 0.25, 0.4: 0.75, 0.5: 0.95, 0.6: 1.25, 0.8: 1.80, 1.0: 2.5}.items():
        assert mean.loc[sigma, "speed"] == pytest.approx(speed, rel=0.03), sigma
    assert mean.loc[0.0, "period"] == pytest.approx(0.83, rel=0.03)
    assert mean.loc[0.4, "period"] == pytest.approx(0.43, rel=0.03)
    # no foot on the ground: never in walks, for a tenth of the cycle and more in gallops
    assert np.all(mean.loc[[0.0, 0.2, 0.4], "flight"] == 0.0)
    assert np.all(mean.loc[[0.95, 1.0], "flight"] > 0.1)


def test_without_load_feedback_it_trots_at_every_speed() -> None:
    result = gaits([0.0, 0.25, 0.5, 0.75, 1.0], [20, 21], k2=0.0)
    assert np.all(result["gait"] == "trot")
    speed = result.pivot_table(index="sigma", values="speed")["speed"]
    assert speed.is_monotonic_increasing
    assert speed.loc[0.0] == pytest.approx(0.29, abs=0.02)
    assert speed.loc[1.0] == pytest.approx(2.55, abs=0.05)


def test_without_the_hips_feedback_it_falls() -> None:
    """Whatever the speed, without it and with its sign turned (Fukuoka 2015, Methods)."""
    for k1 in (0.0, -3.0):
        assert np.all(gaits([0.0, 0.5, 1.0], [20, 21], k1=k1, k2=0.0)["fell"] == Status.fell)


def test_each_start_gives_its_lead() -> None:
    """At one speed the first pair and the perturbation decide whether the gallop leads with right or left."""
    both = gaits([1.0], range(20, 26))
    assert set(both["gait"]) == GALLOPS


@pytest.mark.slow
def test_the_compliant_foot_gives_mujocos_gaits_and_speeds() -> None:
    sigma = [0.2, 0.5, 0.8, 1.0]
    by_tree = gaits(sigma, [1]).set_index("sigma")
    model = PlanarQuadruped()
    params = model.params({name: jnp.asarray(v[0]) for name, v in complete(model, {}, 1).items()})
    begin = {"seed": 1.0, "pair": 1.0, "scatter": 0.1}
    start = model.init(params, {name: jnp.asarray(v) for name, v in begin.items()})
    for place in sigma:
        walker = InMujoco(mujoco.MjModel.from_xml_string(mjcf()), place, np.array(start.u), pair=1)
        onsets(walker, READ)
        x = walker.data.qpos[0]
        results = [(LEGS[leg], t) for leg, t in onsets(walker, DURATION - READ)]
        named = gait_of(pd.DataFrame(results, columns=["leg", "t"]).assign(row=0)).iloc[0]["gait"]
        group = next(each for each in (WALKS, {"trot"}, CANTERS, GALLOPS) if named in each)
        assert by_tree.loc[place, "gait"] in group, place
        speed = (walker.data.qpos[0] - x) / (DURATION - READ)
        assert by_tree.loc[place, "speed"] == pytest.approx(speed, rel=0.02), place


PERIOD, STANCE = 0.5, 0.5  # s, share of a cycle
BREAK_AT = 0.004  # s after an onset


@jax.jit
def _followed(loads: jax.Array, onsets: jax.Array, silence: jax.Array | float = 0.0) -> cycle.Cycle:
    """Readings of loads (n, 4) at each millisecond, on legs that begin to swing at phases (4,).

    At the beginning of each swing their flexors are silent again for `silence` (4,) s.
    """
    zero, dt = jnp.zeros(()), jnp.asarray(1e-3)

    def flexors(t: jax.Array) -> jax.Array:
        turn = t / PERIOD - onsets
        since = PERIOD * (turn - jnp.floor(turn)) - BREAK_AT
        breaks = (since > 0.0) & (since <= silence)
        return jnp.tile(jnp.where(breaks, -0.1, jnp.sin(2.0 * jnp.pi * turn)), (2, 1))

    def step(read: cycle.Cycle, load: jax.Array) -> tuple[cycle.Cycle, None]:
        u = flexors(read.clock), flexors(read.clock + dt)
        return cycle.after_step(read, u, load, zero, zero, jnp.zeros(2), jnp.asarray(10.0), dt), None

    return jax.lax.scan(step, cycle.initial_cycle(zero, zero), loads)[0]


def footfalls(gait: str, leg: str = "LF", at: float = 0.06, air: float = 0.0, each: int = 1) -> np.ndarray:
    """Loads (n, 4) of a gait by its footfalls; `leg` lifts off for `air` s, `at` s after it touches down.

    It does so in each stride, or only in every so manieth.
    """
    t = 1e-3 * np.arange(12000)
    loads = np.zeros((t.size, 4))
    for number, name in enumerate(LEGS):
        strides, place = np.divmod(t / PERIOD - ideal_phases(gait, 0.2)[name] - 0.45, 1.0)
        lifted = (name == leg) & (np.abs(place * PERIOD - at - 0.5 * air) < 0.5 * air) & (strides % each == 0)
        loads[:, number] = np.where((place < STANCE) & ~lifted, 10.0, 0.0)
    return loads


@pytest.mark.parametrize("leg", LEGS)
def test_a_flexor_that_is_silent_for_10_ms_stays_in_its_swing_and_one_for_30_ms_does_not(leg: str) -> None:
    onsets = jnp.array([ideal_phases("L-walk", 0.2)[name] for name in LEGS])
    loads = jnp.asarray(footfalls("L-walk"))

    def followed(silence: float) -> cycle.Cycle:
        return _followed(loads, onsets, jnp.where(np.array(LEGS) == leg, silence, 0.0))

    once, broken, twice = followed(0.0), followed(0.010), followed(0.030)
    number = LEGS.index(leg)
    assert np.allclose(once.period, PERIOD, atol=1e-9)
    for name in ("onset", "period", "irregular", "stance_pitch", "late_load"):
        np.testing.assert_array_equal(getattr(broken, name), getattr(once, name), err_msg=name)
    for new, old in zip(jax.tree.leaves(broken.average), jax.tree.leaves(once.average), strict=True):
        np.testing.assert_array_equal(new, old)
    # the next cycle begins after the break, in the rest of the swing
    assert twice.onset[number] - once.onset[number] == pytest.approx(BREAK_AT + 0.030, abs=2e-3)
    assert twice.irregular[number] > once.irregular[number]


@jax.jit
def _labels(params: Any, seen: dict[str, jax.Array]) -> dict[str, jax.Array]:
    return PlanarQuadruped().label(params, seen)


def _by_touchdowns(loads: np.ndarray, by_onsets: str = "trot") -> tuple[str, str, np.ndarray]:
    """The gait by onsets, that by touchdowns, and the shifts (2,) of the latter."""
    onsets = np.array([ideal_phases(by_onsets, 0.2)[leg] for leg in LEGS])
    model, average = PlanarQuadruped(), _followed(jnp.asarray(loads), jnp.asarray(onsets)).average
    shifts, lengths = average.shifts(), average.lengths().min(axis=1)
    seen = {"antiphase": jnp.asarray(0.5), "variation": average.variation()}
    for row, (by, length) in enumerate((("mean", "length"), ("touchdown", "length_touchdown"))):
        seen |= {f"delta_1_{by}": shifts[row, 0], f"delta_2_{by}": shifts[row, 1], length: lengths[row]}
    named = _labels(scalars(model), seen)
    gaits = [model.gaits[int(named[name])] for name in ("gait", "gait_by_touchdowns")]
    return gaits[0], gaits[1], np.array(shifts[1, :2])


@pytest.mark.parametrize("gait", CHART)
def test_footfalls_determine_the_gait_independent_of_the_network(gait: str) -> None:
    by_onsets, by_touchdowns, shifts = _by_touchdowns(footfalls(gait))
    assert (by_onsets, by_touchdowns) == ("trot", gait)
    np.testing.assert_allclose(shifts, 0.2 * np.array(signs(gait)), atol=0.004)  # steps of 0.002 of a cycle
    assert _by_touchdowns(footfalls("trot"), by_onsets=gait)[:2] == (gait, "trot")


@pytest.mark.slow(
    *(
        f"{gait}-{leg}"
        for gait in ("trot", "RT-gallop", "L-walk")
        for leg in LEGS
        if (gait, leg) != ("trot", "LF")
    )
)
@pytest.mark.parametrize("leg", LEGS)
@pytest.mark.parametrize("gait", ["trot", "RT-gallop", "L-walk"])
def test_a_break_of_40_ms_is_one_stance_and_one_of_80_ms_two(gait: str, leg: str) -> None:
    assert _by_touchdowns(footfalls(gait, leg, air=0.04))[1] == gait
    assert _by_touchdowns(footfalls(gait, leg, air=0.08))[1] == "unsteady"


def test_feet_that_do_not_touch_down_in_each_stride_have_no_gait() -> None:
    dragged = footfalls("trot")
    dragged[:, LEGS.index("RH")] = 5.0
    assert _by_touchdowns(dragged)[:2] == ("trot", "unsteady")
    skipped = footfalls("trot", "RF", at=-0.001, air=STANCE * PERIOD + 0.002, each=2)
    assert _by_touchdowns(skipped)[:2] == ("trot", "unsteady")
