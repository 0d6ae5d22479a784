"""Gaits from swing onsets: the nine of the chart, noise, missing steps, falls, thresholds."""

from __future__ import annotations

import itertools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest

from gaitsweep.analysis.records import AnalysisError
from gaitsweep.angles import is_circular
from gaitsweep.papers.fukuoka2015.analysis.swing_onsets import (
    GAITS,
    Steadiness,
    gait_of,
    onsets_in,
    onsets_of_crossings,
)
from gaitsweep.papers.fukuoka2015.planar_quadruped.nine_gaits import CHART, LEGS, margin, place, signs
from tests.support.gait_traces import ideal_phases, onset_table


def _steps(
    gait: str,
    shift: float = 0.2,
    period: float = 0.5,
    cycles: int = 12,
    begin: float = 0.0,
    noise: float = 0.0,
) -> np.ndarray:
    """Onsets (4, cycles) of the legs in their order; `noise` in cycles."""
    phases = np.array(list(ideal_phases(gait, shift).values()))
    jitter = noise * np.random.default_rng(0).standard_normal((4, cycles))
    return begin + period * (np.arange(cycles) + phases[:, None] + jitter)


def _table(onsets: np.ndarray, row: int = 0) -> pd.DataFrame:
    leg = np.repeat(LEGS, onsets.shape[1])
    return pd.DataFrame({"row": row, "leg": leg, "t": onsets.ravel()})


def _gaits(onsets: np.ndarray, **options: Any) -> pd.DataFrame:
    return gait_of(onset_table(onsets), rows=range(len(onsets)), **options)


def _gait(onsets: np.ndarray, **options: object) -> str:
    return _gaits(onsets[None], **options).loc[0, "gait"]


# The orders in which the legs swing in the paper's Fig. 3; "=": together.
ORDERS = {
    "trot": "LF=RH RF=LH",
    "L-walk": "LF RH RF LH",
    "D-walk": "LF LH RF RH",
    "R-canter": "LF=RH RF LH",
    "L-canter": "LF RH RF=LH",
    "RT-gallop": "LF RF LH RH",
    "LT-gallop": "LF RH LH RF",
}


@pytest.mark.parametrize("gait", ORDERS)
def test_the_chart_has_the_papers_orders_of_swing(gait: str) -> None:
    phases = ideal_phases(gait, 0.2)
    groups = [group.split("=") for group in ORDERS[gait].split()]
    at = [phases[group[0]] for group in groups]
    assert at == sorted(at)
    for group in groups:
        assert {round(phases[leg], 12) for leg in group} == {round(phases[group[0]], 12)}
    assert len({round(p, 12) for p in phases.values()}) == len(groups)


def test_a_walks_legs_are_a_quarter_apart() -> None:
    assert ideal_phases("L-walk") == pytest.approx({"LF": 0.0, "RH": 0.25, "RF": 0.5, "LH": 0.75})


@pytest.mark.parametrize("gait", CHART)
def test_signs_name_the_gait_and_mirroring_exchanges_left_and_right(gait: str) -> None:
    first, second = signs(gait)
    assert CHART[int(place(0.2 * first, 0.2 * second))] == gait
    swapped = {"L": "R", "R": "L"}
    mirrored = CHART[int(place(0.2 * second, 0.2 * first))]
    other = ideal_phases(mirrored)
    phases = {swapped[leg[0]] + leg[1]: phase for leg, phase in ideal_phases(gait).items()}
    for leg in LEGS:
        assert (phases[leg] - phases["LF"] - other[leg]) % 1.0 == pytest.approx(0.0, abs=1e-12)
    assert (mirrored == gait) == (gait in ("trot", "L-walk", "D-walk"))


def test_places_can_be_traced() -> None:
    delta = jnp.array([-0.2, 0.0, 0.2])
    pairs = jnp.array(list(itertools.product(delta, delta)))
    np.testing.assert_array_equal(jax.jit(jax.vmap(place))(pairs[:, 0], pairs[:, 1]), np.arange(9))


def test_no_such_gait() -> None:
    with pytest.raises(ValueError, match="did you mean R-canter"):
        signs("R-cantor")


@pytest.mark.parametrize("gait", CHART)
@pytest.mark.parametrize("noise", [0.0, 0.01])
def test_every_gait_is_found_from_any_start(gait: str, noise: float) -> None:
    onsets = np.stack([_steps(gait, begin=begin, noise=noise) for begin in np.linspace(-0.7, 0.7, 21)])
    result = _gaits(onsets)
    assert np.all(result["gait"] == gait)
    assert np.all(result["steady"])
    atol = 1e-9 if not noise else 0.01
    np.testing.assert_allclose(result["period"], 0.5, rtol=1e-9 if not noise else 0.01)
    np.testing.assert_allclose(result["delta_1"], 0.2 * signs(gait)[0], atol=atol)
    np.testing.assert_allclose(result["delta_2"], 0.2 * signs(gait)[1], atol=atol)
    np.testing.assert_allclose(result["antiphase"], 0.5, atol=atol)
    wanted = ideal_phases(gait, 0.2)
    for leg in LEGS:
        off = result[f"phase_{leg}"] - wanted[leg]
        np.testing.assert_allclose((off + 0.5) % 1.0 - 0.5, 0.0, atol=atol)
    np.testing.assert_array_equal(result["row"], np.arange(21))


@pytest.mark.parametrize("seed", range(8))
def test_onsets_may_be_in_any_order(seed: int) -> None:
    random = np.random.default_rng(seed)
    shift, period = random.uniform(0.09, 0.4), random.uniform(0.1, 3.0)
    onsets = np.stack([_steps(gait, shift, period) for gait in CHART])
    shuffled = pd.concat([_table(each, row) for row, each in enumerate(onsets)]).sample(
        frac=1, random_state=seed
    )
    one, other = gait_of(shuffled), _gaits(onsets)
    pd.testing.assert_frame_equal(one, other, atol=1e-9)
    assert list(one["gait"]) == list(CHART)
    near = [[0.07 if sign == 0 else min(shift - 0.07, 0.5 - shift) for sign in signs(gait)] for gait in CHART]
    np.testing.assert_allclose(one["margin"], np.min(near, axis=1), atol=1e-9)


def test_the_spread_is_that_of_the_noise() -> None:
    result = _gaits(_steps("trot", cycles=4000, noise=0.02)[None])
    # both legs' noise; the length of the cycle that a shift lies in adds little
    assert result.loc[0, "spread_delta_1"] == pytest.approx(0.028, abs=0.003)
    assert result.loc[0, "length_delta_1"] == pytest.approx(
        np.exp(-0.5 * (2 * np.pi * 0.028) ** 2), abs=0.004
    )
    assert result.loc[0, "variation"] == pytest.approx(0.028, abs=0.003)
    assert result.loc[0, "gait"] == "trot"


def test_phases_are_below_one_cycle_also_by_rounding() -> None:
    onsets = np.tile(np.arange(1.0, 9.0), (4, 1))
    onsets[LEGS.index("RH"), 1] = np.nextafter(2.0, 0.0)
    assert 0.0 <= _gaits(onsets[None]).loc[0, "phase_RH"] < 1.0


def test_rows_that_two_tables_share_are_refused() -> None:
    trace = pd.DataFrame({"row": 0, "t": [0.0, 1.0], "u": [-1.0, 1.0]})
    assert len(onsets_in(trace, {"LF": "u"})) == 1
    with pytest.raises(AnalysisError, match=r"Row 0.* has several records of t 0.*gs\.concat"):
        onsets_in(pd.concat([trace, trace]), {"LF": "u"})
    since = {f"since_{leg}_n": 0.1 for leg in LEGS}
    crossings = pd.DataFrame({"row": 0, "crossing": [1, 2], "t": [0.5, 1.0], **since})
    assert len(onsets_of_crossings(crossings)) == 8
    with pytest.raises(AnalysisError, match=r"several records of crossing 1.*gs\.concat"):
        onsets_of_crossings(pd.concat([crossings, crossings]))


def test_large_scatter_is_unsteady() -> None:
    assert _gait(_steps("trot", noise=0.1)) == "unsteady"
    wander = _steps("trot", cycles=20)
    wander[[1, 3]] += 0.5 * np.linspace(0.0, 0.4, 20)  # hind legs that fall behind their pairs
    assert _gait(wander) == "unsteady"
    slower = _steps("trot", cycles=20) ** 1.3  # together, but ever slower
    result = _gaits(slower[None]).loc[0]
    assert result["gait"] == "unsteady"
    assert result["length_delta_1"] > 0.95
    assert result["variation"] > 0.05
    assert _gait(slower, steadiness=Steadiness(variation=1.0)) == "trot"


def test_each_threshold_has_its_gait() -> None:
    result = _gaits(np.stack([_steps("L-walk", shift) for shift in (0.04, 0.06, 0.08)]))
    assert list(result["gait"]) == ["trot", "trot", "L-walk"]
    assert list(result["gait_at_0.05"]) == ["trot", "L-walk", "L-walk"]
    np.testing.assert_allclose(result["margin"], [0.03, 0.01, 0.01], atol=1e-9)
    result = _gaits(_steps("L-walk", 0.06)[None], thresholds=(0.03, 0.1))
    assert list(result.loc[0, ["gait", "gait_at_0.1"]]) == ["L-walk", "trot"]
    # exactly at the threshold there is no shift
    assert CHART[int(place(0.07, -0.07, 0.07))] == "trot"
    assert margin(-0.25, 0.49) == pytest.approx(0.01)


def test_pairs_that_are_not_in_antiphase_have_none_of_the_gaits() -> None:
    pronk = np.tile(0.5 * np.arange(12.0), (4, 1))
    bound = pronk + np.array([[0.0], [0.24], [0.0], [0.24]])
    assert list(_gaits(np.stack([pronk, bound]))["gait"]) == ["none", "none"]
    pace = _gaits((pronk + np.array([[0.0], [0.0], [0.25], [0.25]]))[None]).loc[0]
    assert pace["margin"] == pytest.approx(0.0, abs=1e-9)  # where walks meet


def test_a_missed_or_doubled_step_is_left_out_and_many_are_not_steady() -> None:
    for leg in range(4):
        onsets = _steps("R-canter", cycles=20, noise=0.003)
        plain = _gaits(onsets[None]).loc[0]
        onsets[leg, 9] = np.nan
        missed = _gaits(onsets[None]).loc[0]
        onsets[leg, 9] = onsets[leg, 8] + 0.01
        doubled = _gaits(onsets[None]).loc[0]
        for found in (missed, doubled):
            assert found["gait"] == "R-canter"
            assert found["period"] == pytest.approx(plain["period"], rel=2e-3)
            assert [found["delta_1"], found["delta_2"]] == pytest.approx([0.2, 0.0], abs=0.003)
            assert 0.0 < found["skipped"] < 0.05
        onsets[leg, 1::3] = np.nan
        assert _gait(onsets) == "unsteady"


def test_rows_without_enough_steps_and_falls_have_no_gait() -> None:
    walk, short = _steps("D-walk"), _steps("D-walk")
    short[2, 3:] = np.nan
    onsets = np.stack([walk, short, np.full_like(walk, np.nan)])
    onsets[2, 0, 0] = np.inf
    result = _gaits(onsets)
    assert list(result["gait"]) == ["D-walk", "none", "none"]
    assert list(result["cycles"]) == [11, 2, 0]
    assert np.isnan(result.loc[2, "delta_1"])
    assert list(_gaits(np.full((2, 4, 0), np.nan))["gait"]) == ["none", "none"]
    parts = [_table(walk, row).assign(status=status) for row, status in ((5, "complete"), (3, "fell"))]
    table = gait_of(pd.concat(parts), rows=[3, 4, 5])
    assert list(table["row"]) == [3, 4, 5]
    assert list(table["gait"]) == ["none", "none", "D-walk"]
    assert list(table["gait"].cat.categories) == list(GAITS)
    assert list(gait_of(pd.concat(parts))["row"]) == [3, 5]
    table = pd.concat(parts).astype({"leg": "category", "status": "category"})
    assert list(gait_of(table)["gait"]) == ["none", "D-walk"]


def test_only_the_window_is_read() -> None:
    early, late = _steps("trot", cycles=20), _steps("L-walk", cycles=20, begin=10.0)
    onsets = np.stack([np.concatenate([early, late], axis=1)] * 2)
    assert list(_gaits(onsets, window=(10.0, 30.0))["gait"]) == ["L-walk", "L-walk"]
    assert _gaits(onsets, window=(-np.inf, [9.8, np.inf])).loc[0, "gait"] == "trot"
    assert list(_gaits(onsets, window=([0.0, 9.9], [9.9, 25.0]))["gait"]) == ["trot", "L-walk"]


def test_onsets_in_a_trace() -> None:
    t = np.arange(0.0, 10.0, 1e-3)
    phases = ideal_phases("LT-gallop", 0.2)
    columns = {f"u_{leg}": np.sin(2.0 * np.pi * (t / 0.7 - phase)) for leg, phase in phases.items()}
    trace = pd.DataFrame({"row": 4, "t": t, **columns, "status": "complete"})
    trace.loc[5000, "u_LF"] = np.nan
    other = trace.assign(row=2, t=trace["t"] - 100.0).sample(frac=1.0, random_state=0)
    onsets = onsets_in(pd.concat([trace, other]), {leg: f"u_{leg}" for leg in LEGS})
    first = onsets.loc[(onsets["row"] == 4) & (onsets["leg"] == "RF"), "t"].to_numpy()
    np.testing.assert_allclose(first, 0.7 * (np.arange(len(first)) + phases["RF"]), atol=1e-6)
    result = gait_of(onsets)
    assert list(result["row"]) == [2, 4]
    assert np.all(result["gait"] == "LT-gallop")
    stance = trace.assign(**{name: (trace[name] <= 0.0).astype(float) for name in columns})
    lifted = onsets_in(stance, {leg: f"u_{leg}" for leg in LEGS}, level=0.5, falling=True)
    assert gait_of(lifted).loc[0, "gait"] == "LT-gallop"


def test_refusals_and_units() -> None:
    onsets = _table(_steps("trot"))
    with pytest.raises(AnalysisError, match="LG is not a leg"):
        gait_of(onsets.assign(leg="LG"))
    with pytest.raises(AnalysisError, match="leg is not a column"):
        gait_of(onsets.drop(columns="leg"))
    with pytest.raises(AnalysisError, match="u_LF is not a column"):
        onsets_in(onsets, {"LF": "u_LF"})
    assert not is_circular(gait_of(onsets), "delta_1")  # cycles, not rad


@pytest.mark.parametrize("swinging", [(), ("LF",), ("LF", "RF"), LEGS])
def test_a_trace_too_short_for_a_cycle_has_no_gait(swinging: tuple[str, ...]) -> None:
    t = 0.02 * np.arange(20)
    signals = {leg: f"u_f_{leg}" for leg in LEGS}
    columns = {name: np.where((t > 0.2) & (leg in swinging), 1.0, -1.0) for leg, name in signals.items()}
    onsets = onsets_in(pd.DataFrame({"row": 0, "t": t, **columns}), signals)
    result = gait_of(onsets, rows=[0])
    assert result["gait"].tolist() == ["none"]
    assert result["cycles"].tolist() == [0]
