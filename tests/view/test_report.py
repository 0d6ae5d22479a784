"""The report of a result directory: its counts add up and agree with the table."""

from __future__ import annotations

import html
import re
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import gaitsweep as gs
from gaitsweep.cli import main
from gaitsweep.runs import provenance
from gaitsweep.runs.sentences import status_sentence
from gaitsweep.view.report import write_report
from tests.support.browser import browser, program

Capture = pytest.CaptureFixture[str]


@pytest.fixture(scope="module")
def toy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Rows that settle, rows that fall and rows that do not come to rest."""
    folder = tmp_path_factory.mktemp("toy") / "toy"
    gs.sweep(
        "toy_model:Toy",
        launch_1=[0.5, 1.0, 2.0, 40.0],
        restitution=[0.0, 0.5, 0.98],
        ceiling=5.0,
        run=gs.Settle(max_cycles=12),
        verify=3,
        out=folder,
    )
    return folder


def table_under(text: str, heading: str) -> list[list[str]]:
    """The cells of the first table under a heading, without marks."""
    part = text.partition(f"<h2>{heading}</h2>")[2]
    rows = re.findall(r"<tr[^>]*>(.*?)</tr>", part.partition("</table>")[0])
    cells = [re.findall(r"<t[hd][^>]*>(.*?)</t[hd]>", row) for row in rows]
    return [[html.unescape(re.sub(r"<[^>]*>", "", cell)) for cell in row] for row in cells]


def test_statuses_and_gaits_add_up_to_the_rows(toy: Path) -> None:
    table, text = gs.load(toy), write_report(toy).read_text()
    statuses = {row[0]: row for row in table_under(text, "Outcomes of rows")}
    assert len(statuses) > 3
    for status, row in statuses.items():
        rows = len(table) if status == "all" else int(np.sum(table["status"].astype(str) == status))
        assert int(row[1]) == rows
        if status != "all":
            attrs = table.attrs
            assert row[3] == status_sentence(status, attrs["job"], attrs["manifest"])
    assert sum(int(row[1]) for name, row in statuses.items() if name != "all") == len(table)
    head, *gaits = table_under(text, "Gaits of the rows")
    names = head[3:]
    crossed = pd.crosstab(table["gait"].astype(object).fillna("not read"), table["status"].astype(str))
    for gait, number, _, *each in gaits[:-1]:
        assert int(number) == int(crossed.loc[gait].sum())
        assert [int(cell) for cell in each] == [int(crossed.loc[gait, name]) for name in names]
    assert gaits[-1][:2] == ["all", str(len(table))]
    assert np.sum([int(row[1]) for row in gaits[:-1]]) == len(table)


def test_the_report_has_the_provenance_of_the_table(toy: Path) -> None:
    manifest, text = gs.load(toy).attrs["manifest"], write_report(toy).read_text()
    for piece in (
        manifest["job_hash"],
        provenance.machine(),
        "Self-check: 3 of 12 rows",
        manifest["versions"]["jax"],
    ):
        assert piece in text
    commit = provenance.git_commit()
    assert manifest.get("git_commit") == commit
    assert commit is None or commit in text


def test_gaits_of_several_records_a_row_are_counted_by_record(tmp_path: Path) -> None:
    path: dict[str, Any] = {"parameter": "lean", "path": [0.0, 1.0], "step": 0.25, "dwell": 2.0}
    gs.sweep(
        "double_well:DoubleWell",
        x_0=[-1.0, 0.5],
        run=gs.Staircase(**path),
        numerics={"dt": 0.05},
        verify=0,
        out=tmp_path / "stairs",
    )
    text = write_report(tmp_path / "stairs").read_text()
    assert table_under(text, "Gaits of the records")[-1][:2] == ["all", "10"]


@pytest.mark.parametrize(("field", "result"), [("search", "target"), ("sensitivity", "output")])
def test_a_failed_set_is_described_in_a_sentence(field: str, result: str) -> None:
    message = status_sentence("failed", {field: {}})
    assert message == f"Some {result} has no value for this set; the column `why` says which and why."
    assert status_sentence("fell", {}) == gs.Status.fell.sentence
    assert status_sentence("failed", {}) == ""


@pytest.mark.slow
def test_info_and_report_have_the_reasons_of_failed_sets(
    tmp_path: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("job.yaml").write_text(
        "name: toy_search\nmodel: toy_model:Toy\nrun: {kind: settle, max_cycles: 60}\n"
        "search:\n  free: {kick: [0.1, 30.0]}\n  method: sobol\n  budget: 8\n  population: 8\n"
        "  targets:\n    speed: {kind: value, of: launch_1, at: {ceiling: 4}, wanted: 1.6, error: 0.01}\n"
    )
    assert main(["search", "job.yaml"]) == 0
    table = gs.load("results/toy_search")
    failed = table.loc[table["status"].astype(str) == "failed"]
    assert 0 < len(failed) < len(table)
    capsys.readouterr()
    assert main(["info", "results/toy_search"]) == 0
    assert f"{len(failed)}   {status_sentence('failed', {'search': {}})}" in capsys.readouterr().out
    text = write_report("results/toy_search").read_text()
    assert status_sentence("failed", {"search": {}}) in text
    assert str(failed["why"].iloc[0]) in text


@pytest.mark.slow
@pytest.mark.skipif(program() is None, reason="no Chromium on this machine (apt-get install chromium)")
def test_a_report_fits_a_phone(toy: Path) -> None:
    with browser() as page:
        page.size(390, 844)
        page.call("Page.navigate", url=write_report(toy).resolve().as_uri())
        page.wait("document.readyState === 'complete' && document.querySelector('h1')?.textContent")
        assert page.evaluate("document.documentElement.scrollWidth") <= 390


@pytest.mark.slow
@pytest.mark.skipif(program() is None, reason="no Chromium on this machine (apt-get install chromium)")
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_texts_of_a_report_have_contrast(toy: Path, scheme: str) -> None:
    """At least 4.5 : 1 (WCAG 2.2, AA)."""
    file = write_report(toy).resolve().as_uri()
    with browser() as page:
        page.scheme(scheme)
        for width in (390, 1280):
            page.size(width, 844)
            page.call("Page.navigate", url=file)
            page.wait("document.readyState === 'complete' && document.querySelector('h1')?.textContent")
            page.evaluate("document.querySelectorAll('details').forEach(each => each.open = true)")
            assert page.least_contrast() >= (4.5, "")
        paper = page.evaluate("getComputedStyle(document.body).backgroundColor")
        assert paper == {"light": "rgb(255, 255, 255)", "dark": "rgb(20, 24, 28)"}[scheme]


def test_observables_that_kept_rows_from_settling_are_reported(toy: Path, capsys: Capture) -> None:
    table = gs.load(toy)
    unsettled = table.loc[table["status"].astype(str) == "cycle_limit"]
    result = unsettled["slowest"].value_counts()
    assert result.sum() == len(unsettled) > 0
    assert main(["info", str(toy)]) == 0
    line = next(line for line in capsys.readouterr().out.splitlines() if line.startswith("unsettled"))
    assert f"launch_1 in {result['launch_1']} row" in line
    assert f"launch_1 in {result['launch_1']} row" in write_report(toy).read_text()
