"""Measures of gaits, the effect of the threshold, transition speeds and pitch along a row."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

import gaitsweep as gs
from gaitsweep.analysis.records import AnalysisError
from gaitsweep.papers.fukuoka2015.analysis.gait_bouts import (
    after_dwell,
    oscillation_along,
    speed_transitions,
)
from gaitsweep.papers.fukuoka2015.analysis.gait_tables import (
    gait_measures,
    gaits_by_threshold,
    gaits_in,
    shift_sizes,
)
from gaitsweep.papers.fukuoka2015.planar_quadruped.nine_gaits import LEGS
from tests.support.gait_traces import crossings_of, ends, ideal_phases, trace_of


def ramp_of(up: list[tuple[str, int]], down: list[tuple[str, int]], *, row: int = 0) -> pd.DataFrame:
    """Crossings of a ramp whose speed changes by 0.01 m/s a cycle: gaits with their numbers of cycles."""
    period, records, speed = 0.25, [], 0.5
    for falling, course in enumerate((up, down)):
        for gait, cycles in course:
            phases = ideal_phases(gait, 0.2)
            for _ in range(cycles):
                speed += -0.01 if falling else 0.01
                record = {"row": row, "crossing": len(records) + 1, "pass": falling, "speed_n": speed}
                record |= {"t": period * (len(records) + 1) + 1e-4, "status": "complete"}
                record |= {f"since_{leg}_n": (-phases[leg] % 1.0) * period + 1e-4 for leg in LEGS}
                records.append(record)
    table = pd.DataFrame(records)
    table.attrs["job"] = {"run": {"parameter": "v_d", "initial_dwell": 0.0}}
    return table


def test_a_gait_has_the_medians_of_its_rows() -> None:
    table = ends(
        np.array([-0.2, -0.2, -0.2, 0.0]), np.zeros(4), np.zeros(4), axes={"sigma": [0.1, 0.1, 0.1, 0.5]}
    )
    table = table.assign(flight_end=[0.0, 0.1, 0.3, 0.2], cost_of_transport_end=[1.0, 2.0, 4.0, 3.0])
    table = table.assign(margin=[0.13, 0.02, 0.01, 0.07])
    result = gait_measures(table, ["sigma", "gait"]).set_index("gait")
    assert result.loc["D-walk", "delta_1_mean"] == -0.2
    assert list(result["margin"]) == [0.02, 0.07]
    assert list(result["rows"]) == [3, 1]
    assert result.loc["D-walk", "flight"] == 0.1
    assert result.loc["D-walk", "cost_of_transport"] == 2.0
    assert result.loc["trot", "speed"] == 1.0
    fell = table.assign(status=["fell", "complete", "complete", "complete"])
    assert np.sum(gait_measures(fell, ["sigma"])["rows"]) == 3


def test_a_table_without_measures_is_refused() -> None:
    with pytest.raises(AnalysisError, match="none of speed"):
        gait_measures(pd.DataFrame({"row": [0], "gait": ["trot"], "status": ["complete"]}), [])


def test_gaits_by_threshold_are_read_from_onsets() -> None:
    parts = [
        crossings_of("D-walk", 0.2),
        crossings_of("L-walk", 0.06, row=1),
        crossings_of("RT-gallop", 0.08, row=2),
    ]
    table = pd.concat(parts, ignore_index=True)
    table["speed_n"] = np.array([0.4, 1.2, 2.0])[table["row"]]
    result = gaits_by_threshold(table, (0.05, 0.07, 0.09)).set_index("threshold")
    assert list(result["gaits"]) == [3, 3, 2]
    assert list(result["trot"]) == [0, 1, 2]
    assert list(result["L-walk"]) == [1, 0, 0]
    assert result.loc[0.07, "order"] == "walk trot gallop"
    assert result.loc[0.05, "order"] == "walk gallop"
    with pytest.raises(AnalysisError, match="thresholds is empty"):
        gaits_by_threshold(table, ())


def test_shifts_are_counted_on_either_side_of_the_threshold() -> None:
    """Two shifts a row; an unsteady row has none, and by touchdowns the second row has no gait."""
    table = ends(np.array([-0.065, 0.075, 0.2, 0.1]), np.zeros(4), np.zeros(4))
    table.loc[3, "gait"] = "unsteady"
    landed = pd.Categorical(["D-walk", "unsteady", "L-walk", "trot"], table["gait"].cat.categories)
    table = table.assign(gait_by_touchdowns=landed, delta_1_touchdown_end=0.155, delta_2_touchdown_end=0.0)
    result = shift_sizes(gaits_in(table))
    assert len(result) == 21
    shown = result[result["shifts"] > 0]
    np.testing.assert_allclose(shown["low"], [0.06, 0.07, 0.19], atol=0.011)
    assert list(shown["shifts"]) == [2, 2, 2]
    assert list(shown["read_as"]) == ["in phase", "shifted", "shifted"]
    assert np.sum(result["by_touchdowns"]) == 6
    assert list(result.loc[[0, 15], "by_touchdowns"]) == [3, 3]


def test_transitions_up_and_down_with_their_hysteresis() -> None:
    up = [("L-walk", 30), ("trot", 30), ("R-canter", 30)]
    # the gallop begins after the turn; then straight to the trot
    table = ramp_of(up, [("RT-gallop", 50), ("trot", 30), ("D-walk", 30)])
    result = speed_transitions(table).set_index("slower")
    assert list(result.index) == ["walk", "trot", "canter"]
    assert result.loc["walk", "up"] == pytest.approx(0.80, abs=0.03)
    assert result.loc["trot", "up"] == pytest.approx(1.10, abs=0.03)
    assert result.loc["canter", "up"] == pytest.approx(1.40, abs=0.03)
    assert result.loc["canter", "down"] == pytest.approx(0.90, abs=0.03)
    assert result.loc["trot", "down"] == pytest.approx(0.90, abs=0.03)
    assert result.loc["walk", "down"] == pytest.approx(0.60, abs=0.03)
    assert result.loc["walk", "width"] == pytest.approx(0.20, abs=0.04)
    pd.testing.assert_frame_equal(
        speed_transitions(table, "row").drop(columns="row"), speed_transitions(table)
    )


def test_a_row_that_keeps_its_gait_has_no_transition() -> None:
    result = speed_transitions(ramp_of([("trot", 30)], [("trot", 30)]))
    assert np.all(result["up"].isna())
    assert np.all(result["rows"] == 0)
    with pytest.raises(AnalysisError, match="no passes"):
        speed_transitions(crossings_of("trot"))
    table = ramp_of([("trot", 30)], [("trot", 30)])
    falling = table.copy()
    falling.attrs["job"] = {"run": {"kind": "ramp", "parameter": "v_d", "path": [2.0, 1.0, 2.0]}}
    with pytest.raises(AnalysisError, match="falls in pass 0, from 2 to 1"):
        speed_transitions(falling)
    with pytest.raises(AnalysisError, match="cycles is 0"):
        speed_transitions(table, cycles=0)
    with pytest.raises(AnalysisError, match="t"):
        speed_transitions(table.drop(columns="t"))


def test_rows_without_a_bout_count_among_all_rows() -> None:
    """Of a row that falls after a few cycles no gait bout, no transition and no oscillation is known."""
    table = ramp_of([("L-walk", 30), ("trot", 30)], [("trot", 30), ("L-walk", 30)])
    for cycles in (2, 5):  # no window, and fewer than a bout
        fell = table.loc[table["crossing"] <= cycles].assign(row=1, status="fell")
        both = pd.concat([table, fell], ignore_index=True)
        both.attrs = fell.attrs = table.attrs
        result = speed_transitions(both)
        assert list(result["of"]) == [2] * 3
        assert list(result["rows"]) == [1, 0, 0]
        assert np.asarray(result["up"], float)[0] == pytest.approx(0.80, abs=0.03)
        assert np.all(speed_transitions(fell)["up"].isna())
    short = trace_of("trot", duration=0.6)
    assert list(oscillation_along(short).columns[:3]) == ["row", "pass", "family"]
    assert not len(oscillation_along(short))


def test_pitch_along_a_row() -> None:
    first, second = trace_of("L-walk", duration=6.0), trace_of("RT-gallop", duration=6.0)
    table = pd.concat([first, second.assign(t=second["t"] + 6.0, x=second["x"] + 6.0)], ignore_index=True)
    t = table["t"].to_numpy()
    # once and twice in a gait cycle of 0.5 s, on a slow drift
    pitch = np.where(t < 6.0, 0.01 * np.sin(8.0 * np.pi * t), 0.03 * np.sin(4.0 * np.pi * t))
    result = oscillation_along(table.assign(pitch=pitch + 0.05 * t)).set_index("family")
    assert list(result.loc[["walk", "gallop"], "body_cycles"]) == [2, 1]
    assert result.loc["walk", "twice"] == pytest.approx(0.01, rel=0.05)
    assert result.loc["gallop", "once"] == pytest.approx(0.03, rel=0.05)


def test_pitch_that_is_not_known_agrees_with_no_number_of_oscillations() -> None:
    table = trace_of("trot", duration=6.0)
    t = table["t"].to_numpy()
    table = table.assign(pitch=0.01 * np.sin(8.0 * np.pi * t))
    gap = table.assign(pitch=table["pitch"].where((t < 2.0) | (t > 2.1)))
    (bout,) = oscillation_along(gap).to_dict("records")
    assert (bout["body_cycles"], bout["agree"]) == (2, 1.0)
    (bout,) = oscillation_along(table.assign(pitch=np.nan)).to_dict("records")
    assert np.isnan([bout["once"], bout["body_cycles"], bout["agree"]]).all()


def test_each_row_of_joined_ramps_has_its_own_dwell() -> None:
    """Joined jobs have no common dwell, and the parameter of each row begins to move at its own time."""
    t = np.arange(10.0)
    tables = []
    for row, dwell in enumerate((2.5, 5.5)):
        table = pd.DataFrame({"row": row, "t": t, "v_d": np.maximum(t - dwell, 0.0)})
        table.attrs["job"] = {"run": {"kind": "ramp", "parameter": "v_d", "initial_dwell": dwell}}
        tables.append(table)
    joined = gs.concat(tables)
    moving = after_dwell(joined)
    assert [moving.loc[moving["row"] == row, "t"].min() for row in (0, 1)] == [3.0, 6.0]
    assert [after_dwell(table)["t"].min() for table in tables] == [3.0, 6.0]
