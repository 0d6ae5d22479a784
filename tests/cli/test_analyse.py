"""The commands `gaitsweep analyse`: each prints the numbers of one analysis."""

from __future__ import annotations

import sys
import types
from collections.abc import Callable

import numpy as np
import pandas as pd
import pytest
import typer
from typer.main import get_group

import gaitsweep as gs
import gaitsweep.table
from gaitsweep import extension
from gaitsweep.analysis.transitions.jumps import jump_intervals
from gaitsweep.cli import analyse, main
from gaitsweep.papers.ambe2021.analyses import _chain_of_settings
from tests.support.basin_tables import grid_table
from tests.support.gait_traces import ends, traces
from tests.support.hysteresis_tables import settle_table, staircase_table

Show = Callable[..., str]


@pytest.fixture
def show(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Show:
    """Output of a command for a table."""

    def shown(table: pd.DataFrame, *arguments: str) -> str:
        monkeypatch.setattr(gaitsweep.table, "load", lambda _: table)
        assert main(["analyse", arguments[0], "results/any", *arguments[1:]]) == 0
        return capsys.readouterr().out

    return shown


def test_gaits_are_counted(show: Show) -> None:
    lines = show(traces(("trot", "D-walk")), "gaits", "--window", "1", "20").splitlines()
    assert [line.split()[1:] for line in lines] == [["D-walk", "trot"], ["0", "1"], ["1", "0"]]
    # shifts of 0.06 are a trot by the model's own threshold of 0.07
    delta = np.array([0.0, 0.06, 0.2])
    table = ends(delta, delta, delta)
    assert show(table, "gaits").split() == ["k2", "trot", "L-walk", "0.08", "2", "1"]
    assert show(table, "gaits", "--threshold", "0.05").split() == ["k2", "trot", "L-walk", "0.08", "1", "2"]


def test_bouts_have_their_speeds(show: Show) -> None:
    trace = traces(("trot",))
    trace = trace.assign(x=1.5 * trace["t"])
    assert show(trace, "gait-bouts") == "row 0, m/s: trot 1.50 to 1.50\n"
    # there are two strides of 0.5 s, which are read once
    short = show(trace[trace["t"] < 1.5], "gait-bouts", "--cycles", "2", "--least", "1")
    assert short == "row 0, m/s: trot 1.50 to 1.50 (1)\n"
    assert show(trace[trace["t"] < 1.5], "gait-bouts", "--cycles", "2") == ""


@pytest.mark.slow
def test_the_loading_rule_is_judged(show: Show) -> None:
    delta = np.linspace(-0.25, 0.25, 41)
    table = ends(delta, -50.0 * delta, 0.1 * delta, axes={"k2": np.repeat([0.0, 0.08], [20, 21])})
    lines = show(table, "loading-rule", "--split", "k2").splitlines()
    assert lines[0].split()[:3] == ["k2", "measure", "pairs"]
    assert len(lines) == 1 + 2 * 4


def test_pitch_is_given_by_gait(show: Show) -> None:
    trace = traces(("trot",))
    printed = show(trace.assign(pitch=0.1 * np.sin(trace["t"])), "body-oscillation")
    assert "once" in printed
    assert "trot" in printed


def test_gaits_have_their_measures(show: Show) -> None:
    delta = np.array([-0.2, 0.0])
    table = ends(delta, delta, delta, axes={"k2": [0.0, 0.08]}).assign(flight_end=[0.0, 0.1])
    lines = show(table, "gait-measures", "--by", "k2").splitlines()
    assert [line.split()[1] for line in lines[1:]] == ["D-walk", "trot"]


def test_gaits_at_several_thresholds(show: Show) -> None:
    lines = show(traces(("trot", "D-walk")), "gait-thresholds", "--window", "1", "20").splitlines()
    assert lines[0].split()[:2] == ["threshold", "gaits"]
    assert lines[8].split()[0] == "0.10"
    # the trot's two shifts, and the walk's of 0.2
    assert [int(line.split()[-1]) for line in lines[12:] if not line.endswith(" 0")] == [2, 2]
    ended = ends(np.array([-0.2, 0.0]), np.zeros(2), np.zeros(2)).assign(delta_1_touchdown_end=0.0)
    ended = ended.assign(delta_2_touchdown_end=0.0, gait_by_touchdowns=ended["gait"].iloc[[1, 1]].array)
    assert "1 of 2 rows (50.0 %) have the same gait by touchdowns." in show(ended, "gait-thresholds")


def test_transitions_have_their_speeds(show: Show) -> None:
    trace = traces(("trot",))
    table = trace.assign(**{"pass": (trace["t"] > 3.0).astype(int)})
    lines = show(table, "speed-transitions").splitlines()
    assert [line.split()[:2] for line in lines[1:]] == [
        ["walk", "trot"],
        ["trot", "canter"],
        ["canter", "gallop"],
    ]


def test_pitch_along_a_row(show: Show) -> None:
    trace = traces(("trot",))
    printed = show(trace.assign(pitch=0.1 * np.sin(8.0 * np.pi * trace["t"])), "body-oscillation", "--along")
    assert printed.splitlines()[1].split()[2] == "trot"


def test_sets_have_their_repertoire(show: Show) -> None:
    rows = [(0.1, "trot", 1.0, "settled"), (0.1, "L-walk", 0.4, "settled"), (0.2, "trot", 1.2, "settled")]
    table = pd.DataFrame(rows, columns=["com_x", "gait", "speed_end", "status"])
    assert len(show(table, "repertoire", "--set", "com_x").splitlines()) == 3


def test_attractors_are_grouped(show: Show) -> None:
    psi = np.repeat([1.0, 4.0], 20) + np.tile(np.linspace(0.0, 1e-3, 20), 2)
    gait = np.repeat(["trot", "pace"], 20)
    table = pd.DataFrame({"row": np.arange(40), "status": "settled", "gait": gait, "psi_1_end": psi})
    printed = show(table, "attractors")
    assert "A2" in printed
    assert "100.00 % of the rows" in printed


def test_hysteresis_has_points_and_areas(show: Show) -> None:
    printed = show(staircase_table(hold=200), "hysteresis", "--observable", "delta_13", "--parameter", "f")
    assert "rising" in printed
    assert "area" in printed
    table = staircase_table(hold=200)
    assert show(table, "hysteresis") == printed  # both names from the job
    without = show(table, "hysteresis", "--least", "5")
    assert "No pass jumps: no change of delta_13 is 5 or more" in without
    assert "area" in without
    table.attrs["job"]["figures"] = [{"kind": "hysteresis", "y": "delta_13", "least": 5}]
    assert show(table, "hysteresis") == without  # the size that counts is the figure's
    small = table.assign(delta_13_n=table["delta_13_n"] * 0.01)
    small.attrs["job"]["figures"] = []
    points = gs.hysteresis(small, "delta_13").transition_points
    intervals = jump_intervals(small, "delta_13", "f")  # what the figure shows
    assert points[["direction", "low", "high"]].equals(intervals[["direction", "low", "high"]])
    assert len(points) == 2  # jumps of 0.01 count, where the range is small
    still = small.assign(delta_13_n=0.5)
    assert "No pass jumps" in show(still, "hysteresis")


def test_names_that_the_job_does_not_give_once_are_asked_for(
    show: Show, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    table = staircase_table(hold=200)
    table["speed_n"] = 1.0
    table.attrs["job"]["figures"] = [{"kind": "hysteresis", "y": "delta_13"}]
    assert "rising" in show(table, "hysteresis")
    table.attrs["job"]["figures"].append({"kind": "hysteresis", "y": "speed"})
    assert main(["analyse", "hysteresis", "results/any"]) == 2
    assert "delta_13 and speed" in capsys.readouterr().err


def test_hysteresis_of_a_table_without_a_moving_parameter(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    table = settle_table([0.0, 1.0], [0.0, 1.0])
    monkeypatch.setattr(analyse, "result_table", lambda _: table)
    assert main(["analyse", "hysteresis", "results/any"]) in (1, 2)
    assert "results/any is the table of a run of kind settle, which is no staircase or ramp" in (
        capsys.readouterr().err
    )


def test_gaits_are_lost_at_transition_points(show: Show) -> None:
    f = np.array([1.0, 2.0, 3.0])
    table = pd.DataFrame({"row": np.arange(3), "status": "settled", "f": f, "delta_13": 1.0})
    table["gait"] = ["walk", "walk", "trot"]
    printed = show(table, "gait-transitions", "--parameter", "f", "--start", "delta_13")
    assert "walk rising" in " ".join(printed.split())
    axes = table[["row", "f", "delta_13", "status", "gait"]]
    assert show(axes, "gait-transitions", "--parameter", "f") == printed  # the other axis is the start


def test_gaits_are_lost_separately_for_each_value_of_another_parameter(show: Show) -> None:
    """Walk is lost above f = 1 at beta = 0.7 and above f = 2 at beta = 0.8."""
    f, beta = np.tile([1.0, 2.0, 3.0], 2), np.repeat([0.7, 0.8], 3)
    table = pd.DataFrame({"row": np.arange(6), "beta": beta, "f": f, "delta_13": 1.0, "status": "settled"})
    table["gait"] = ["walk", "trot", "trot", "walk", "walk", "trot"]
    table.attrs["job"] = {"model": "waist_quadruped", "run": {"kind": "settle"}}
    printed = show(table, "gait-transitions", "--parameter", "f", "--start", "delta_13")
    edges = [" ".join(line.split()) for line in printed.splitlines() if " walk " in line]
    assert edges == ["0.7 walk rising 1.0 2.0 1.0 2.0 1", "0.8 walk rising 2.0 3.0 2.0 3.0 1"]


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ("", "--start is not given, and the job does not name it"),
        ("--parameter f", "--start is not given"),
        ("--start f", "start is f, the parameter itself"),
    ],
)
def test_the_parameter_is_not_the_start(
    options: str, words: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    table = pd.DataFrame({"row": [0, 1], "f": [1.0, 2.0], "status": "settled", "gait": ["walk", "trot"]})
    monkeypatch.setattr(gaitsweep.table, "load", lambda _: table)
    assert main(["analyse", "gait-transitions", "results/any", *options.split()]) == 2
    assert capsys.readouterr().err.startswith(words)


@pytest.mark.slow
def test_the_theory_needs_no_table(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["analyse", "multilegged-theory", "--N", "4", "--set", "m=1.0"]) == 0
    printed = capsys.readouterr().out
    assert "6.14464" in printed
    assert "B, k = 3" in printed
    assert "psi_4 from 1.256637 to 5.165092 rad on section 4" in printed  # eq. (25)
    assert "eigenvalues  1, 0.666667 (2), 0.5" in printed  # eq. (22), set A
    assert "motions of the chain        direct, source, retrograde\n" in printed
    assert main(["analyse", "multilegged-theory", "--set", "m_1=5"]) == 0  # far above m_B < m
    assert "motions of the chain        none\n" in capsys.readouterr().out
    assert main(["analyse", "multilegged-theory", "--set", "m_B=0.5"]) == 0  # at m_B = m/2
    assert "nan" not in capsys.readouterr().out


@pytest.mark.parametrize(
    ("setting", "message"),
    [
        ("m1=0.85", "did you mean m_1"),
        ("beta=1.5", "beta is 1.5, but must be between 0 and 1"),
        ("kappa=-1", "kappa is -1, but must be above 0"),
        ("kappa", "must be NAME=VALUE"),
    ],
)
def test_wrong_parameters_of_the_theory_are_refused(
    setting: str, message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["analyse", "multilegged-theory", "--set", setting]) == 2
    assert message in capsys.readouterr().err


def test_the_theory_refuses_a_frequency_that_is_not_above_0(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["analyse", "multilegged-theory", "--omega", "0"]) == 2
    assert "omega is 0, but must be above 0." in capsys.readouterr().err


def test_the_mass_of_both_ends_is_a_parameter_of_the_theory() -> None:
    chain = _chain_of_settings(["m_B=0.8", "m_1=0.7"])
    assert (chain.m_1, chain.m_end) == (0.7, 0.8)


def test_pairs_are_of_all_rows(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["analyse", "loading-rule", "results/any", "--pairs", "--split", "k2"]) == 2
    assert "leave out --split and --predict" in capsys.readouterr().err


def test_basins_are_measured(show: Show) -> None:
    """A line in thirds: the outer two of three basins share no boundary and are 33 steps apart."""
    thirds = grid_table((99, 99), lambda x, y: np.floor(3 * x), circular=False)
    assert "exponent_low" in show(thirds, "basins")
    assert "33.0" in show(thirds, "wada")


def test_the_stability_of_attractors_is_quantified(show: Show) -> None:
    """Two of three starts settle at 0, and one at 1; the nearest start of each is 0.5 from the other."""
    table = pd.DataFrame(
        {
            "k": 2.0,
            "x_0": [0.0, 0.5, 1.0],
            "status": "settled",
            "t_end": [1.0, 3.0, 5.0],
            "x_end": [0.0, 0.0, 1.0],
            "gait": "none",
        }
    )
    lines = show(table, "quantifiers", "--parameter", "k").splitlines()
    header, *records = (line.split() for line in lines)
    shares = [record[header.index("fraction")] for record in records]
    assert [float(share) for share in shares] == pytest.approx([2 / 3, 1 / 3], abs=1e-3)


def test_groups_have_their_medians(show: Show) -> None:
    table = pd.DataFrame({"gait": ["trot", "walk", "trot"], "cycles": [3, 5, 4]})
    lines = show(table, "summary", "--by", "gait", "--of", "cycles").splitlines()
    assert [line.split() for line in lines[1:]] == [
        ["trot", "2", "3.5", "3", "4"],
        ["walk", "1", "5.0", "5", "5"],
    ]


def test_groups_of_angles_across_zero_have_medians_among_them(show: Show) -> None:
    """The median of 0.1, 6.2 and 6.25 rad is 6.25 rad (-0.033), not 6.2; other groups are unchanged."""
    table = pd.DataFrame({"gait": [*"aaabb"], "psi_1_end": [0.1, 6.2, 6.25, -1.0, -2.0]})
    lines = show(table, "summary", "--by", "gait", "--of", "psi_1_end").splitlines()
    assert [line.split() for line in lines[1:]] == [
        ["a", "3", "-0.033185", "-0.083185", "0.1"],
        ["b", "2", "-1.500000", "-2.000000", "-1.0"],
    ]


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ("--by k --of gait", "The values of gait are not numbers"),
        ("--by k --of k", "two columns k"),
        ("--by gait --of cycles --of cycles_least", "two columns cycles_least"),
        ("--by gait --of cycle", "did you mean cycles"),
    ],
)
def test_columns_that_have_no_median_are_refused(
    options: str, words: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    table = pd.DataFrame({"gait": pd.Categorical(["trot", "walk"]), "k": [1.0, 2.0], "cycles": [3, 5]})
    monkeypatch.setattr(gaitsweep.table, "load", lambda _: table.assign(cycles_least=0.0))
    assert main(["analyse", "summary", "results/any", *options.split()]) == 2
    assert words in capsys.readouterr().err


def test_a_command_of_an_extension_replaces_none_of_gaitsweep(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    app = typer.Typer()
    app.command("summary")(lambda: None)
    module = types.ModuleType("analyses_of_another_package")
    vars(module)["app"] = app
    monkeypatch.setitem(sys.modules, module.__name__, module)
    installed = {**extension.extensions(), "mine": extension.Extension(analyses=(module.__name__,))}
    monkeypatch.setattr(analyse, "extensions", lambda: installed)
    with pytest.raises(extension.ExtensionError, match=r"the extension mine both have .* analyse summary"):
        _ = get_group(analyse.app).commands
