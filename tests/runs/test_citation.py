"""The command `gaitsweep cite`: entries with the right paper and version, and refusals."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
import yaml

import gaitsweep
import gaitsweep as gs
from gaitsweep.cli import main
from gaitsweep.contract import Model
from gaitsweep.runs.citation import tool_entry
from gaitsweep.runs.provenance import git_commit
from tests.support.toy_directories import fill, open_toy

Capture = pytest.CaptureFixture[str]
HOPPER = Path(__file__).parents[2] / "gaitsweep" / "examples" / "hopper.py"


def cited(path: Path, capsys: Capture) -> str:
    capsys.readouterr()
    assert main(["cite", str(path)]) == 0
    return capsys.readouterr().out


def fields(text: str, key: str) -> dict[str, str]:
    """The fields of a BibTeX entry by its key."""
    entry = re.search(rf"^@\w+\{{{key},\n(.*?)^\}}", text, re.MULTILINE | re.DOTALL)
    assert entry is not None
    return dict(re.findall(r"^  (\w+) = \{(.*?)\},?$", entry[1], re.MULTILINE | re.DOTALL))


def test_the_entry_of_the_program_is_that_of_citation_cff(capsys: Capture) -> None:
    facts = yaml.safe_load((Path(__file__).parents[2] / "CITATION.cff").read_text())
    assert main(["cite"]) == 0
    entry = fields(capsys.readouterr().out, "gaitsweep")
    assert entry["title"] == f"{{{facts['title']}}}"
    assert entry["version"] == facts["version"] == gaitsweep.__version__
    assert entry["year"] == str(facts["date-released"].year)
    assert fields(tool_entry("0.0.1"), "gaitsweep")["howpublished"] == "Python package, version 0.0.1"
    assert "year" not in fields(tool_entry("0.0.1"), "gaitsweep")  # which CITATION.cff does not date


@pytest.mark.slow
def test_a_result_cites_its_paper_method_check_and_versions(tmp_path: Path, capsys: Capture) -> None:
    gs.sweep(
        "multilegged_reduced", psi_1=[1.0, 2.0], psi_2=2.0, psi_3=3.0,
        run=gs.Settle(max_cycles=7), numerics={"dt": 0.04}, out=tmp_path / "chain",
    )  # fmt: skip
    text, manifest = cited(tmp_path / "chain", capsys), gs.load(tmp_path / "chain").attrs["manifest"]
    assert fields(text, "ambe2021")["doi"] == "10.3389/fncir.2021.706064"
    commit = git_commit()
    assert commit is None or commit in fields(text, "gaitsweep")["note"]
    methods = text.partition("Methods: ")[2]
    for piece in (
        "multilegged_reduced [ambe2021]",
        f"gaitsweep {gaitsweep.__version__} [gaitsweep]",
        "2 rows over psi_1 (2).",
        "(settle, max_cycles 7, tolerance",
        f"({manifest['method']}), steps of at most 0.04 s, in float64",
        "Self-check: 2 rows rerun",
        f"JAX {manifest['versions']['jax']}",
    ):
        assert piece in methods
    assert "differ" not in methods
    assert "coarse" not in methods  # a field without effect, since the run does not refine


@pytest.mark.slow
def test_inferred_rows_and_changed_parameters_are_named(tmp_path: Path, capsys: Capture) -> None:
    """A refined run simulates few of its rows; the paper's values are the model's defaults."""
    gs.sweep(
        "landscape_model:Landscape",
        theta_1={"linspace": [0, 6, 24]}, theta_2={"linspace": [0, 6, 24]}, bend=0.25,
        run=gs.Settle(max_cycles=60, refine="boundary"), numerics={"dt": 0.05}, out=tmp_path / "rows",
    )  # fmt: skip
    methods = cited(tmp_path / "rows", capsys).partition("Methods: ")[2]
    counts = gs.load(tmp_path / "rows").attrs["manifest"]["counts"]
    assert counts["inferred"] > 0
    simulated = 576 - counts["inferred"]
    assert f"of which {simulated} were simulated and {counts['inferred']} inferred between equal" in methods
    assert "Run of each simulated row: " in methods
    assert "differ from the model's defaults: bend = 0.25." in methods


def test_persons_and_url_of_citation_cff(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    facts = yaml.safe_load((Path(__file__).parents[2] / "CITATION.cff").read_text())
    authors = [{"family-names": "Curie", "given-names": "Marie"}, {"name": "The Walkers"}]
    file = tmp_path / "CITATION.cff"
    file.write_text(
        yaml.safe_dump({**facts, "authors": authors, "repository-code": "https://a.org/b", "doi": "10.1/a"})
    )
    monkeypatch.setattr("gaitsweep.runs.citation.shipped", lambda _: file)
    entry = fields(tool_entry(), "gaitsweep")
    assert (entry["author"], entry["url"]) == ("Curie, Marie and {The Walkers}", "https://a.org/b")
    assert entry["doi"] == "10.1/a"
    assert "howpublished" not in entry


@pytest.mark.parametrize(
    ("line", "printed", "missing"),
    [
        ("", "", "The paper of cited_hopper:Hopper is missing"),
        pytest.param(
            'source = "Raibert 1986, Legged Robots"', "note = {Raibert 1986, Legged Robots}", "",
            marks=pytest.mark.slow,
        ),
        pytest.param(
            'bibtex = "@book{raibert86,\\n  year = {1986}\\n}"', "hopper:Hopper [raibert86] was", "",
            marks=pytest.mark.slow,
        ),
        pytest.param('bibtex = "Raibert 1986"', "", "no BibTeX entry", marks=pytest.mark.slow),
    ],
)  # fmt: skip
def test_a_users_model_gives_its_own_paper(
    line: str, printed: str, missing: str, tmp_path: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(__import__("sys").modules, "cited_hopper", raising=False)
    text = HOPPER.read_text().replace("    gaits = (", f"    {line}\n    gaits = (", 1)
    text = text.replace("9.81", '"981/100"')
    Path("cited_hopper.py").write_text(text)
    gs.sweep("cited_hopper:Hopper", launch_0=[2.5], verify=0, out="hops")
    Path("cited_hopper.py").unlink()  # the directory alone has the reference
    capsys.readouterr()
    assert main(["cite", "hops"]) == 0
    output = capsys.readouterr()
    assert printed in output.out
    assert "There was no self-check." in output.out
    assert "differ from the model's defaults" not in output.out  # g is its default, a formula of numbers
    assert "rtol 1e-" in output.out  # the hopper's method has step control
    assert missing in output.err
    others = [line for line in output.err.splitlines() if "no DOI" not in line]
    assert bool(missing) == bool(others)


def test_every_model_of_a_paper_has_an_entry() -> None:
    for name in gs.models.names():
        kind: type[Model] = gs.models.find(name)
        year = re.search(r"\d{4}", kind.source)
        assert year is not None
        assert f"year = {{{year[0]}}}" in kind.bibtex


def test_missing_entries_are_reported(tmp_path: Path, capsys: Capture) -> None:
    assert main(["cite", str(tmp_path / "nothing")]) == 2
    assert "does not exist" in capsys.readouterr().err
    with open_toy(tmp_path / "toy") as directory:
        pass
    assert main(["cite", str(tmp_path / "toy")]) == 2
    assert "has 0 of 10 rows" in capsys.readouterr().err
    with open_toy(tmp_path / "toy") as directory:
        fill(directory)
    assert main(["cite", str(tmp_path / "toy")]) == 2
    assert "The manifest" in (said := capsys.readouterr().err)
    assert "has no method" in said
