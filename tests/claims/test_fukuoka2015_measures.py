"""The measures of Fukuoka et al. 2015 on synthetic tables, and the verdicts that follow."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
import pytest

from gaitsweep.analysis.records import AnalysisError
from gaitsweep.claims.claims_and_verdicts import ClaimVerdict, _wrong_arguments, read_paper, verdict
from gaitsweep.claims.measures import MeasureError, default_values
from gaitsweep.errors import ArgumentError
from gaitsweep.papers.fukuoka2015 import gait_measures, ramp_measures
from gaitsweep.papers.fukuoka2015.planar_quadruped.nine_gaits import CHART, LEGS
from tests.support.gait_traces import ideal_phases


def trace(gait: str, *, period: float = 0.4, row: int = 0, nod: int = 2) -> pd.DataFrame:
    """Four seconds of a gait: flexors that swing for 0.3 of a cycle, pitch that nods so often a cycle."""
    t = np.arange(0.0, 4.0, 4.0e-3)
    table = pd.DataFrame({"row": row, "t": t})
    for leg, phase in ideal_phases(gait, shift=0.2).items():
        # the flexor is active in the first 0.3 of the cycle that begins at the leg's phase
        into = (t / period - phase) % 1.0
        table[f"u_f_{leg}"] = np.where(into < 0.3, np.sin(np.pi * into / 0.3), -0.5)
        table[f"F_{leg}"] = np.where(into < 0.3, 0.0, 30.0 if leg.endswith("F") else 20.0)
    return table.assign(pitch=0.01 * np.sin(2.0 * np.pi * nod * t / period), status="complete")


def ramp(order: list[str], *, row: int = 0) -> pd.DataFrame:
    """Crossings of a ramp up and down, whose gaits follow each other up and, in reverse, down."""
    period, each = 0.25, 16
    records, t = [], 0.0
    for falling, names in enumerate((order, order[::-1])):
        for place, gait in enumerate(names):
            for _ in range(each):
                t += period
                phases = ideal_phases(gait, shift=0.2)
                level = place if not falling else len(names) - 1 - place
                record = {"row": row, "crossing": len(records) + 1, "pass": falling, "t": t}
                record |= {f"since_{leg}_n": (1.0 - phases[leg]) % 1.0 * period for leg in LEGS}
                records.append(record | {"speed_n": 0.3 + 0.5 * level, "status": "complete"})
    table = pd.DataFrame(records)
    table["v_d"] = table["speed_n"]
    table.attrs["job"] = {"run": {"parameter": "v_d", "initial_dwell": 0.0}}
    return table


@pytest.mark.parametrize("gait", CHART)
def test_the_order_of_swings_is_the_charts(gait: str) -> None:
    assert gait_measures.swing_order(trace(gait), gait=gait) == gait_measures.chart_order(gait=gait)
    assert gait_measures.footfall_order(trace(gait), gait=gait) == gait_measures.chart_order(gait=gait)


def test_footfalls_and_flights_follow_from_loads() -> None:
    """RF and LH alone bear load, for 0.3 of a cycle each, half a cycle apart: two flights of 0.2."""
    table = trace("RT-gallop")
    assert gait_measures.flight_between(table, gait="RT-gallop", legs=["RF", "LH"]) == 0.0
    into = table["t"] / 0.4 % 1.0
    table[["F_LF", "F_RH"]] = 0.0
    table["F_RF"], table["F_LH"] = (into < 0.3) * 30.0, ((into >= 0.5) & (into < 0.8)) * 30.0
    result = gait_measures.flight_between(table, gait="RT-gallop", legs=["RF", "LH"])
    assert result == pytest.approx(0.4, abs=0.04)
    assert gait_measures.flight_between(table, gait="RT-gallop", legs=["LF", "RF"]) == 0.0
    with pytest.raises(MeasureError, match="LF touches down"):
        gait_measures.footfall_order(table, gait="RT-gallop")


def test_a_foot_that_lands_twice_a_cycle_has_no_order() -> None:
    table = trace("trot")
    twice = table["t"] / 0.2 % 1.0 < 0.5  # a cycle takes 0.4 s
    with pytest.raises(MeasureError, match="RH does not touch down once a cycle"):
        gait_measures.footfall_order(table.assign(F_RH=30.0 * twice), gait="trot")


def test_the_orders_of_the_paper() -> None:
    assert gait_measures.chart_order(gait="L-walk") == "LF-RH-RF-LH"
    assert gait_measures.chart_order(gait="R-canter") == "LF+RH-RF-LH"
    assert gait_measures.chart_order(gait="trot") == "LF+RH-LH+RF"


def test_an_order_does_not_depend_on_the_cut_of_the_cycle() -> None:
    """RF and LH swing just before and just after LF, and then just before and just after RH."""
    phases = {"LF": 0.0, "RH": 0.5}
    assert gait_measures._order(phases | {"RF": 0.98, "LH": 0.02}) == "LF-RH-LH+RF"
    assert gait_measures._order(phases | {"RF": 0.48, "LH": 0.52}) == "LF-LH+RF-RH"


def test_a_gait_that_no_row_has_is_refused() -> None:
    with pytest.raises(MeasureError, match="has the gait L-walk"):
        gait_measures.swing_order(trace("trot"), gait="L-walk")


@pytest.mark.slow
def test_the_sequence_of_gaits_in_each_pass() -> None:
    order = ["L-walk", "trot", "R-canter", "RT-gallop"]
    table = pd.concat([ramp(order), ramp(["D-walk", *order[1:]], row=1)], ignore_index=True)
    table.attrs = ramp(order).attrs
    families = ["walk", "trot", "canter", "gallop"]
    assert ramp_measures.most_frequent_order(table) == families
    assert ramp_measures.share_in_order(table, order=order, by="gait") == 0.5
    assert ramp_measures.share_in_order(table, order=families[::-1], falling=True) == 1.0
    assert ramp_measures.share_in_order(table, order=["trot", "walk"], falling=True, at="end") == 1.0
    assert ramp_measures.share_up_and_down(table, up=order, down=order[::-1]) == 0.5
    assert ramp_measures.share_up_and_down(table, up=order, down=order) == 0.0
    assert ramp_measures.gallops_by_their_canter_or_trot(table) == 1.0
    beginning = ["RT-gallop", "R-canter"]
    assert ramp_measures.share_in_order(table, order=beginning, falling=True, by="gait", at="begin") == 1.0


def test_rows_without_a_steady_gait_count_in_shares_and_medians() -> None:
    """Row 1 falls after one cycle, so that it has no bout: it neither has the order nor time in a walk."""
    walk = ramp(["L-walk", "trot"])
    fell = walk.loc[walk["crossing"] <= 2].assign(row=1, status="fell")
    table = pd.concat([walk, fell], ignore_index=True)
    table.attrs = walk.attrs
    assert ramp_measures.share_in_order(table, order=["walk", "trot"]) == 0.5
    assert ramp_measures.share_up_and_down(table, up=["L-walk", "trot"], down=["trot", "L-walk"]) == 0.5
    ratio = ramp_measures.bout_time_ratio(table, walk, family="walk")
    assert ratio == pytest.approx(0.5)  # the median of the walk's time and 0
    fell.attrs = walk.attrs
    assert ramp_measures.share_in_order(fell, order=["walk", "trot"]) == 0.0


def test_a_row_of_left_leads_counts_as_its_mirror_image() -> None:
    left = ramp(["L-walk", "trot", "L-canter", "LT-gallop"])
    assert ramp_measures.most_frequent_order(left, by="right") == ["L-walk", "trot", "R-canter", "RT-gallop"]
    mixed = ramp(["trot", "L-canter", "RT-gallop"])
    assert ramp_measures.most_frequent_order(mixed, by="right") == ["trot", "R-canter", "LT-gallop"]


def test_a_gallop_after_the_other_leads_canter_counts_against_it() -> None:
    assert ramp_measures.gallops_by_their_canter_or_trot(ramp(["trot", "L-canter", "RT-gallop"])) == 0.0
    assert ramp_measures.gallops_by_their_canter_or_trot(ramp(["trot", "RT-gallop"])) == 1.0


def test_pitch_cycles_and_stance() -> None:
    both = pd.concat([trace("trot", nod=1), trace("trot", period=0.2, row=1)], ignore_index=True)
    assert gait_measures.pitch_cycles(both, where="row == 0") == 1.0
    assert gait_measures.pitch_cycles(both, where="row == 1") == 2.0
    assert gait_measures.stance_ratio(both, where="row == 0", to="row == 1") == pytest.approx(2.0, rel=0.05)
    for without in (both.assign(pitch=np.nan), both.loc[both["t"] < 0.1]):
        with pytest.raises(MeasureError, match="No row has one of the nine gaits"):
            gait_measures.pitch_cycles(without)


def test_loads_of_pairs() -> None:
    table = trace("L-walk")
    assert gait_measures.pairs_measure(table, gait="L-walk", quantity="load_stance") == pytest.approx(
        [10.0, 10.0], abs=0.5
    )
    assert gait_measures.pairs_measure(table, gait="L-walk", quantity="delta") == pytest.approx(
        [0.2, 0.2], abs=0.02
    )
    assert gait_measures.loaded_longer(table, gait="L-walk") == pytest.approx([0.0, 0.0], abs=0.02)
    tilt = gait_measures.pairs_measure(table, gait="L-walk", quantity="tilt_late")
    assert gait_measures.late_tilt(table, gait="L-walk") == pytest.approx(
        [tilt_of_pair / 0.02 for tilt_of_pair in tilt], rel=0.01
    )
    with pytest.raises(AnalysisError, match="weight is not a column of this table"):
        gait_measures.pair_measure(table, gait="L-walk", pair=1, quantity="weight")
    with pytest.raises(ArgumentError, match="no measure weight"):
        gait_measures.rule_agreement(table, quantity="weight")


def test_speeds_of_gaits_without_numbers() -> None:
    table = pd.DataFrame({"gait": ["trot", "trot", "L-walk"], "speed_end": [1.0, np.nan, np.nan]})
    assert gait_measures.nearest_speed(table, gait="trot", speed=3.0) == 1.0
    with pytest.raises(MeasureError, match="gait L-walk has a speed"):
        gait_measures.nearest_speed(table, gait="L-walk", speed=3.0)
    with pytest.raises(MeasureError, match="gait tro't"):
        gait_measures.nearest_speed(table, gait="tro't", speed=3.0)
    with pytest.raises(MeasureError, match="family walk has") as missing:
        gait_measures.speed_gap(table, slow=["walk"], fast=["trot"])
    assert "trot" not in str(missing.value)
    slower = table.assign(speed_end=[1.0, np.nan, 0.4])
    assert gait_measures.speed_gap(slower, slow=["walk"], fast=["trot"]) == pytest.approx(0.6)
    assert gait_measures.largest_deviation(table, column="speed_end", centre=0.5) == 0.5
    with pytest.raises(MeasureError, match="speed_end"):
        gait_measures.largest_deviation(table, column="speed_end", centre=0.5, where="gait == 'L-walk'")


def test_angles_on_both_sides_of_zero() -> None:
    table = pd.DataFrame({"f": [1, 1, 2, 2], "phase_n": [6.2, 6.25, 0.05, np.nan]})
    table.attrs["quantities"] = {"phase": {"circular": True}}
    less = gait_measures.difference_of_medians(table, column="phase_n", where="f == 1", less="f == 2")
    assert less == pytest.approx(6.225 - 2.0 * np.pi - 0.05)
    deviation = gait_measures.largest_deviation(table, column="phase_n", centre=0.0)
    assert deviation == pytest.approx(2.0 * np.pi - 6.2)


def test_values_of_the_model() -> None:
    assert gait_measures.total_mass() == pytest.approx(7.0)
    assert gait_measures.motors() == 8.0
    assert gait_measures.diagonal_links() == 0.0
    assert gait_measures.load_feedback(F=20.0, k2=0.08) == [0.0, 1.0]
    assert gait_measures.motor_targets() == [0.0] * 4
    with pytest.raises(ArgumentError, match="torso_mass"):
        default_values(model="planar_quadruped", names=["torso_mas"])


@pytest.mark.parametrize(
    ("measure", "fields", "sentence"),
    [
        ("gait_share", {"gaits": ["trott"]}, "did you mean trot"),
        ("chart_order", {"gait": "L-wak"}, "did you mean L-walk"),
        ("flight_between", {"gait": "trot", "legs": ["LF", "FR"]}, "legs: a list"),
        ("flight_between", {"gait": "trot", "legs": ["LF", "RF"]}, None),
    ],
)
def test_names_in_claims_are_those_of_gaits_and_legs(
    measure: str, fields: dict[str, Any], sentence: str | None
) -> None:
    claim = next(claim for claim in read_paper("fukuoka2015").claims if claim.measure == measure)
    refusal = _wrong_arguments(claim.model_copy(update={"with_": fields}))
    assert refusal is None if sentence is None else sentence in str(refusal)


def test_verdicts_of_the_claims() -> None:
    claims = {claim.id: claim for claim in read_paper("fukuoka2015").claims}
    order = claims["fig4a_gaits"]
    assert verdict(order, ["L-walk", "trot", "R-canter", "RT-gallop"]) == ClaimVerdict.reproduced
    assert verdict(order, ["L-walk", "trot", "uR-canter", "LT-gallop"]) == ClaimVerdict.not_reproduced
    assert verdict(claims["fig3d_speed"], 2.09) == ClaimVerdict.open_constants
    assert verdict(claims["fig3f_speed"], 2.4985) == ClaimVerdict.reproduced
    assert verdict(claims["fig2_pitch_large_at_high_speed"], 0.6) == ClaimVerdict.not_reproduced
    assert verdict(claims["fig6a_load"], [-4.4, 4.2]) == ClaimVerdict.not_reproduced


def test_measures_of_ramps_without_records_are_refused() -> None:
    table = ramp(["L-walk", "trot"])
    for measured in (
        lambda: ramp_measures.share_up_and_down(table.head(0), up=["walk"], down=["walk"]),
        lambda: ramp_measures.rise_with(table.head(0), parameter="sigma", columns=["speed_n"]),
        lambda: ramp_measures.acceleration(table, between=[90.0, 91.0]),
    ):
        with pytest.raises(MeasureError):
            measured()
    for lacking, name in ((table, "sigma"), (table.drop(columns="pass"), "pass")):
        with pytest.raises(AnalysisError, match=f"{name} is not a column"):
            ramp_measures.rise_with(lacking, parameter="sigma", columns=["speed_n"])


def test_rows_without_swept_parameters_are_one_set() -> None:
    table = pd.DataFrame(
        {"row": range(3), "seed": range(3), "status": "settled", "gait": ["trot"] * 2 + ["L-walk"]}
    )
    assert gait_measures.parameter_sets_with(table, gaits=["trot", "L-walk"]) == 1.0
    assert gait_measures.parameter_sets_with(table, gaits=["D-walk"]) == 0.0
