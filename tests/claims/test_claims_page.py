"""The page of a paper's claims: legible in both colour schemes and on a phone."""

from __future__ import annotations

from pathlib import Path

import pandas as pd
import pytest

from gaitsweep.claims.page import page
from gaitsweep.claims.verdicts import ClaimVerdict
from tests.support.browser import browser, program

TEXT = (
    "where", "claim", "paper", "ours", "allowed", "because", "unit", "figure", "why", "chosen", "tried",
    "open",
)  # fmt: skip


@pytest.mark.slow
@pytest.mark.skipif(program() is None, reason="no Chromium on this machine (apt-get install chromium)")
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_texts_have_contrast_and_fit_a_phone(tmp_path: Path, scheme: str) -> None:
    """At least 4.5 : 1 (WCAG 2.2, AA), for every verdict."""
    claims = [
        {**dict.fromkeys(TEXT, "a word"), "id": each.name, "verdict": each.value, "figure": "",
         "command": "gaitsweep run a_job_of_a_long_name.yaml --set numerics.method=semi_implicit --out it"}
        for each in ClaimVerdict
    ]  # fmt: skip
    file = tmp_path / "index.html"
    file.write_text(page("Nobody (2026)", pd.DataFrame(claims), [], quick=True))
    with browser() as shown:
        shown.scheme(scheme)
        for width in (390, 1280):
            shown.size(width, 844)
            shown.call("Page.navigate", url=file.resolve().as_uri())
            shown.wait("document.readyState === 'complete' && document.querySelector('h1')?.textContent")
            assert shown.least_contrast() >= (4.5, "")
            assert shown.evaluate("document.documentElement.scrollWidth") <= width
