"""`gaitsweep reproduce`: jobs run once, claims judged, one page; a failing job harms no other claim."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from benchmarks.reliability.faults import FAULTS, ROOT
from gaitsweep.analysis.records import ColumnError
from gaitsweep.claims.claims_and_verdicts import PaperJob, known_papers, read_paper
from gaitsweep.claims.measures import MEASURES, MeasureError, difference_of_shares, share, texts, value
from gaitsweep.claims.reproduce import _source, reproduce
from gaitsweep.cli import main
from gaitsweep.errors import ArgumentError, JobError
from gaitsweep.expression import ExpressionError

JOB = """\
name: small
model: multilegged_reduced
vary:
  psi_1: {linspace: [0, 2*pi, 4], at: centre}
  psi_2: {linspace: [0, 2*pi, 4], at: centre}
start: {psi_3: 3.0}
run: {kind: settle, max_cycles: 150, tolerance: 1.0e-3}
figures:
  - {kind: basin, x: psi_1, y: psi_2}
"""
CLAIMS = """\
paper: Nobody (2026)
jobs:
  basins: {job: small.yaml, quick: {vary.psi_1.linspace: [0, 2*pi, 2]}}
  lost: {job: bad.yaml, quick: false}
claims:
  - {id: all_settle, where: Fig. 1, claim: All starts settle., measure: share, of: [basins],
     with: {where: "status == 'settled'"}, paper: 1, tolerance: 0, unit: "1", because: exact, figure: basin}
  - {id: far_off, where: Fig. 1, claim: Nothing settles., measure: share, of: [basins],
     with: {where: "status == 'settled'"}, paper: 0, tolerance: 0.1, because: exact, tried: two ways}
  - {id: not_there, where: Fig. 2, claim: A word., measure: texts, of: [basins],
     with: {column: nothing}, paper: a, because: exact}
  - {id: of_lost, where: Fig. 2, claim: A number., measure: value, of: [lost], with: {column: psi_1},
     paper: 1, tolerance: 1, because: exact}
  - {id: long, where: Fig. 3, claim: Whole only., measure: share, of: [basins],
     with: {where: "status == 'settled'"}, paper: 1, tolerance: 0, because: exact, quick: false}
  - {id: a_turn_off, where: Fig. 3, claim: An angle., measure: value, of: [basins],
     with: {column: psi_2, where: row == 0}, paper: -5.5, tolerance: 0.01, unit: rad, because: exact}
"""


@pytest.fixture
def table_of_claims(tmp_path: Path) -> Path:
    (tmp_path / "small.yaml").write_text(JOB)
    (tmp_path / "bad.yaml").write_text("name: bad\nmodel: multilegged_reduced\nrun: {kind: settled}\n")
    file = tmp_path / "nobody2026.yaml"
    file.write_text(CLAIMS)
    return file


@pytest.mark.slow
def test_every_claim_has_a_verdict(
    table_of_claims: Path, tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    out = tmp_path / "out"
    # 1: `not_there` asks for a column that its job lacks
    assert main(["reproduce", str(table_of_claims), "--quick", "--out", str(out)]) == 1
    result = pd.read_parquet(out / "claims.parquet").set_index("id")
    assert result["verdict"].to_dict() == {
        "all_settle": "reproduced",
        "far_off": "not",
        "not_there": "not run",
        "of_lost": "not run",
        "long": "not run",
        "a_turn_off": "reproduced",
    }
    assert result.loc[["all_settle", "a_turn_off"], "ours"].tolist() == ["1", "-5.49779"]
    assert result[["simulated", "model", "constants"]].loc["all_settle"].tolist() == [
        True,
        "multilegged_reduced",
        "defaults",
    ]
    assert "nothing is not a column of this table" in result.loc["not_there", "why"]
    assert result.loc["all_settle", "command"].startswith("gaitsweep run ")
    message = capsys.readouterr().out
    assert "2 of 6 claims reproduced, 1 not reproduced, 3 not run." in message
    assert "far_off (not reproduced): 1; paper: 0\n" in message
    page = (out / "index.html").read_text()
    assert page.count("<article") == 6
    assert page.count("data:image/png") == 1
    assert "two ways" in page
    assert "http" not in page
    made = (out / "quick" / "basins" / "manifest.json").stat().st_mtime_ns
    answered = ["--quick", "--out", str(out), "--claims", "all_settle,far_off"]
    assert main(["reproduce", str(table_of_claims), *answered]) == 0
    assert main(["reproduce", str(table_of_claims), *answered, "--strict"]) == 3
    assert (out / "quick" / "basins" / "manifest.json").stat().st_mtime_ns == made


@pytest.mark.parametrize(
    ("text", "source"),
    [
        ("config: builtin:ambe2021\n", ("multilegged", "ambe2021")),
        ("model: multilegged_reduced\nconfig: builtin:ambe2021\n", ("multilegged_reduced", "ambe2021")),
        ("model: multilegged_reduced\n", ("multilegged_reduced", "defaults")),
    ],
)
def test_a_job_has_the_model_and_the_constants_that_it_names(
    text: str, source: tuple[str, str], tmp_path: Path
) -> None:
    (tmp_path / "small.yaml").write_text(text)
    assert _source(tmp_path / "small.yaml", PaperJob(job="small.yaml")) == source


@pytest.mark.slow
def test_a_failed_job_does_not_affect_others(
    table_of_claims: Path, tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    out = tmp_path / "out"
    assert main(["reproduce", str(table_of_claims), "--out", str(out)]) == 1
    result = pd.read_parquet(out / "claims.parquet").set_index("id")
    assert result["verdict"].to_dict()["all_settle"] == "reproduced"
    assert result["verdict"].to_dict()["long"] == "reproduced"
    assert result["verdict"].to_dict()["of_lost"] == "not run"
    assert "settled" in result["why"]["of_lost"]
    assert "lost failed" in capsys.readouterr().err


@pytest.mark.slow
def test_a_job_without_its_config_does_not_affect_others(table_of_claims: Path, tmp_path: Path) -> None:
    table_of_claims.with_name("bad.yaml").write_text("name: bad\nconfig: gone.yaml\nrun: {kind: settle}\n")
    of_tau = (
        "measure: distance_over_lag, of: [basins],\n     with: {low: 0.1, high: 0.5}, paper: 1, tolerance: 1"
    )
    of_words = "measure: texts, of: [basins],\n     with: {column: nothing}, paper: a"
    table_of_claims.write_text(CLAIMS.replace(of_words, of_tau))
    result = reproduce(read_paper(table_of_claims), tmp_path / "out").table.set_index("id")
    assert result["verdict"][["all_settle", "of_lost"]].tolist() == ["reproduced", "not run"]
    assert result["constants"][["all_settle", "of_lost"]].tolist() == ["defaults", ""]
    # nor does a measure that does not fit the table: its claim has no verdict
    assert result.loc["not_there", "verdict"] == "not run"
    assert "tau is not a column" in result.loc["not_there", "why"]


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        (
            "tolerance: 0, unit",
            "tolerence: 0, unit",
            "tolerence is not a field of a claim; did you mean tolerance?",
        ),
        ("measure: texts", "measure: text", "not a measure"),
        ("of: [lost]", "of: [lsot]", "did you mean lost?"),
        ("with: {column: nothing}", "with: {colum: nothing}", "does not fit the measure texts"),
        ("id: far_off", "id: all_settle", "claims[0]"),
        ("bad.yaml", "worse.yaml", "worse.yaml"),
        ("paper: 0, tolerance: 0.1", "paper: 0", "claims[1] must have a tolerance"),
        ("paper: Nobody (2026)", "papers: Nobody (2026)", "papers is not a field"),
        ("paper: 0, tolerance: 0.1", "paper: [], tolerance: 0.1", "claims[1].paper"),
        (
            "paper: 0, tolerance: 0.1",
            "paper: 1e999, tolerance: 0.1",
            "claims[1] has a paper that is not finite",
        ),
        ("paper: 0, tolerance: 0.1", "paper: 0, tolerance: .inf", "claims[1].tolerance"),
        ("paper: 0, tolerance: 0.1", "paper: 0, between: [2, 1]", "claims[1] allows values from 2 to 1"),
        ("paper: 0, tolerance: 0.1", "paper: 0, above: 3, below: 1", "claims[1] allows values from 3 to 1"),
        (
            "paper: 0, tolerance: 0.1",
            "paper: 0, tolerance: 0.1, above: 0",
            "claims[1] has a tolerance beside",
        ),
        ("paper: 0, tolerance: 0.1", "paper: 0, tolerance: 0.1, equals: a", "claims[1] has equals"),
        ("paper: 0, tolerance: 0.1", "paper: none, above: 0, equals: a", "claims[1] has equals beside"),
        ("paper: 0, tolerance: 0.1", "paper: 0, between: [1]", "claims[1].between[1] is missing"),
        (
            "paper: 0, tolerance: 0.1",
            "paper: 0, tolerance: 0.1, quick: {between: [2, 1]}",
            "claims[1].quick allows values from 2 to 1",
        ),
        ("because: exact, tried", "tried", "because is missing"),
        ("\"status == 'settled'\"", "\"@pd.os.system('true') == 0\"", "is not a condition"),
        ("\"status == 'settled'\"", "\"psi_1.to_csv('out')\"", "is not a condition"),
        ("\"status == 'settled'\"", "5", "where: 5"),
        ("with: {column: nothing}", "with: {column: [1]}", "column: a list (1)"),
        ("with: {column: psi_1}", "with: {column: psi_1, take: medain}", "did you mean median?"),
        ("basins: {job", "../../basins: {job", "file name of letters"),
        ("basins: {job", '"a\\nb": {job', "file name of letters"),
        ("job: small.yaml", "job: ../small.yaml", "file name of letters"),
        ("figure: basin", "figure: ../../../basin", "figure"),
    ],
)
def test_a_bad_table_of_claims_is_refused(table_of_claims: Path, old: str, new: str, told: str) -> None:
    table_of_claims.write_text(CLAIMS.replace(old, new, 1))
    with pytest.raises(JobError) as refused:
        read_paper(table_of_claims)
    assert told in str(refused.value)
    assert "nobody2026.yaml, line " in str(refused.value) or "papers" in told


def test_papers() -> None:
    for name in known_papers():
        paper = read_paper(name)
        assert {claim.measure for claim in paper.claims} <= set(MEASURES)
    with pytest.raises(ArgumentError, match="is not a paper"):
        read_paper("ambe2012")


def test_some_claims_of_a_paper() -> None:
    paper = read_paper("ambe2021")
    assert [claim.id for claim in paper.only(["fig3_converge", "eq2_contact"]).claims] == [
        "eq2_contact",
        "fig3_converge",
    ]
    with pytest.raises(ArgumentError, match="did you mean eq2_contact"):
        paper.only(["eq2_contacts"])
    with pytest.raises(ArgumentError, match="names is empty"):
        paper.only([])


def test_measures_may_return_numbers_of_numpy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    results = {"whole": np.int64(3), "several": np.array([1.0, 2.0]), "words": ("a", "b"), "other": {"a": 1}}
    claims = []
    for name, result in results.items():
        monkeypatch.setitem(MEASURES, name, lambda result=result: result)
        paper = {"several": "[1, 2]", "words": "[a, b]"}.get(name, "3")
        rule = "" if name == "words" else ", tolerance: 0"
        head = f"id: {name}, where: Fig. 1, claim: It is so., measure: {name}, command: none, because: exact"
        claims.append(f"  - {{{head}, paper: {paper}{rule}}}")
    file = tmp_path / "numbers.yaml"
    file.write_text("\n".join(["paper: Nobody (2026)", "claims:", *claims]))
    table = reproduce(read_paper(file), tmp_path / "out").table.set_index("id")
    assert table["verdict"].to_dict() == {
        "whole": "reproduced",
        "several": "reproduced",
        "words": "reproduced",
        "other": "not",
    }
    assert table["ours"].tolist() == ["3", "1, 2", "a, b", ""]
    assert "returned dict, but must return a number" in table.loc["other", "why"]


@pytest.mark.parametrize("name", FAULTS)
def test_planted_faults_find_their_text(name: str) -> None:
    for fault in FAULTS[name]:
        assert (ROOT / "gaitsweep" / fault.file).read_text().count(fault.right) == 1, fault.name


def test_general_measures() -> None:
    table = pd.DataFrame({"gait": ["walk", "trot", "walk", None], "speed": [1.0, 2.0, 4.0, 8.0]})
    assert share(table, where="gait == 'walk'") == 0.5
    assert share(table, where="gait == 'walk'", of="speed < 3") == 0.5
    less = {"of": "speed < 3", "less": "speed > 3"}
    assert difference_of_shares(table, where="gait == 'trot'", **less) == 0.5
    assert value(table, column="speed", where="gait == 'walk'", take="mean") == 2.5
    assert value(table, column="speed", where="gait == 'pace'", take="count") == 0
    assert texts(table, column="gait") == ["walk", "trot"]
    # of rows without a fixed point
    flags = pd.DataFrame({"stable": pd.Series([True, False, None], dtype=object), "speed": [1.0, 2.0, 4.0]})
    assert value(flags, column="speed", where="stable == 1") == 1.0
    assert value(flags, column="speed", where="stable == 0") == 2.0
    assert value(flags.iloc[:2], column="speed", where="not stable") == 2.0
    # angles around 0, and others, which stay in their turn
    angles = pd.DataFrame({"psi_1": [6.2, 0.1, 0.0, 6.1], "delta": [-0.4, -0.1, -0.2, -0.3]})
    assert value(angles, column="psi_1", take="mean") == pytest.approx(3.1 - np.pi)
    assert value(angles, column="psi_1", take="max") == pytest.approx(0.1)
    assert value(angles, column="psi_1", take="last") == 6.1
    assert value(angles, column="delta", take="min") == -0.4
    for wrong in (
        lambda: share(table, where="gait == 'walk'", of="speed > 9"),
        lambda: value(table, column="gait"),
        lambda: value(table.astype({"gait": "category"}), column="gait", take="max"),
        lambda: value(table, column="speed", take="mode"),  # pyright: ignore[reportArgumentType]
        lambda: texts(table, column="gait", where="speed > 9"),
    ):
        with pytest.raises(MeasureError):
            wrong()
    with pytest.raises(ColumnError, match="did you mean speed"):
        value(table, column="speeds")
    with pytest.raises(ExpressionError, match="did you mean gait"):
        share(table, where="gaits == 'walk'")
