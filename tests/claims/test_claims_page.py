"""The page of a paper's claims: legible in both colour schemes and on a phone."""

from __future__ import annotations

import re
from pathlib import Path

import pandas as pd
import pytest

from gaitsweep.claims.claims_and_verdicts import ClaimVerdict
from gaitsweep.claims.page import page
from tests.support.browser import browser, program

TEXT = (
    "where", "claim", "paper", "ours", "allowed", "because", "unit", "figure", "why", "chosen", "tried",
    "open",
)  # fmt: skip


def claims_of(figure: str) -> pd.DataFrame:
    """A claim with each verdict, those that are reproduced first; all have one figure."""
    claims = [
        {**dict.fromkeys((*TEXT, "definition", "constants"), "a word"), "id": f"a_{each.name}",
         "verdict": each.value, "figure": figure,
         "command": "gaitsweep run a_job_of_a_long_name.yaml --set numerics.method=semi_implicit --out it"}
        for each in ClaimVerdict
    ]  # fmt: skip
    return pd.DataFrame(claims)


def test_failures_come_first_with_their_figure_and_agreement_is_folded(tmp_path: Path) -> None:
    file = tmp_path / "job" / "figures" / "it.png"
    file.parent.mkdir(parents=True)
    file.write_bytes(b"a figure")
    text = page("Nobody (2026)", claims_of(str(file)), [], quick=False)
    sections = re.findall(r"<details( open)?><summary><h2>1 ([\w ]+)</h2></summary><div id=\"(\w+)\">", text)
    assert [bool(is_open) for is_open, _, _ in sections] == [True, True, False, False, False, False]
    assert [words for _, words, _ in sections[:2]] == ["not reproduced", "with open constants"]
    assert re.findall(r'class="verdict" href="#(\w+)">1 ', text) == [name for _, _, name in sections]
    assert text.count("<img") == 1  # later sections link to it
    assert text.index('class="pair"') < text.index('id="a_not_reproduced"') < text.index("<img")
    anchors, links = re.findall(r'id="([^"]+)"', text), re.findall(r'href="#([^"]+)"', text)
    assert set(links) <= set(anchors)
    assert len(set(anchors)) == len(anchors)


@pytest.mark.slow
@pytest.mark.skipif(program() is None, reason="no Chromium on this machine (apt-get install chromium)")
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_texts_have_contrast_and_fit_a_phone(tmp_path: Path, scheme: str) -> None:
    """At least 4.5 : 1 (WCAG 2.2, AA), for every verdict."""
    file = tmp_path / "index.html"
    file.write_text(page("Nobody (2026)", claims_of(""), [], quick=True))
    with browser() as shown:
        shown.scheme(scheme)
        for width in (390, 1280):
            shown.size(width, 844)
            shown.call("Page.navigate", url=file.resolve().as_uri())
            shown.wait("document.readyState === 'complete' && document.querySelector('h1')?.textContent")
            assert shown.least_contrast() >= (4.5, "")
            assert shown.evaluate("document.documentElement.scrollWidth") <= width
