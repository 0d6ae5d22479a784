"""The page of a paper's claims: one HTML file with embedded figures."""

from __future__ import annotations

import html
from collections.abc import Hashable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import pandas as pd

import gaitsweep
from gaitsweep.claims.claims_and_verdicts import ClaimVerdict
from gaitsweep.view.report import SCHEMES, document, figure_of

if TYPE_CHECKING:
    from gaitsweep.claims.reproduce import JobRun

# Colours of words and bars on the light and the dark background, each with a contrast of at least 4.5 : 1.
_COLOURS = {
    ClaimVerdict.reproduced: ("#0B5CAD", "#56B4E9"),
    ClaimVerdict.not_reproduced: ("#A84300", "#FF9D5C"),
    ClaimVerdict.open_constants: ("#7A5A00", "#E8C15A"),
    ClaimVerdict.definition: ("#5B4B8A", "#B9A7E8"),
    ClaimVerdict.answered: ("#00704E", "#4FD0A5"),
    ClaimVerdict.not_run: ("#5C636B", "#A7AFB8"),
}
# The sections of the page: what disagrees with the paper first and open, the rest folded.
_FIRST = (ClaimVerdict.not_reproduced, ClaimVerdict.open_constants)
_ORDER = (*_FIRST, *(verdict for verdict in ClaimVerdict if verdict not in _FIRST))


def _style() -> str:
    """The style sheet of the page, with the verdicts' colours on light and on dark background."""
    light, dark = (
        " ".join(f"--{verdict.name}: {colours[scheme]};" for verdict, colours in _COLOURS.items())
        for scheme in (0, 1)
    )
    colours = f":root {{ {light} }}\n@media (prefers-color-scheme: dark) {{ :root {{ {dark} }} }}\n"
    return SCHEMES + colours + _file("page.css")


def _file(name: str) -> str:
    """The text of a file beside this one."""
    return Path(__file__).with_name(name).read_text(encoding="utf-8")


def page(paper: str, table: pd.DataFrame, runs: Sequence[JobRun], *, quick: bool) -> str:
    """The HTML text of the page.

    Args:
        paper: authors, year, journal.
        table: one row per claim, from `reproduce`.
        runs: the jobs that ran.
        quick: whether to state that these are the quick jobs.
    """
    failed = any(run.path is None for run in runs)
    shown: set[str] = set()
    sections = [_head(paper, table, quick=quick)]
    for verdict in _ORDER:
        if verdict in set(table["verdict"]):
            sections.append(_section(verdict, table, shown, failed=failed))
    script = f"<script>\n{_file('page.js')}</script>"
    return document(html.escape(paper), _style(), [*sections, _jobs(runs), script])


def _section(verdict: ClaimVerdict, table: pd.DataFrame, shown: set[str], *, failed: bool) -> str:
    """The claims with one verdict, grouped by their figure, which stands beside them.

    Args:
        verdict: the verdict.
        table: the claims.
        shown: files of the figures that the page has so far; this section's are added.
        failed: whether a job failed, so that claims which were not run are not folded.
    """
    judged = table.loc[table["verdict"] == verdict]
    groups = "".join(
        _beside(str(file), claims, shown) for file, claims in judged.groupby("figure", sort=False)
    )
    is_open = verdict in _FIRST or (failed and verdict is ClaimVerdict.not_run)
    return (
        f"<details{' open' * is_open}><summary><h2>{len(judged)} {html.escape(verdict.words)}</h2></summary>"
        f'<div id="{verdict.name}">{groups}</div></details>'
    )


def _beside(file: str, claims: pd.DataFrame, shown: set[str]) -> str:
    """Claims with their figure beside them, or a link to it where the page has it already."""
    articles = "".join(map(_claim, claims.to_dict("records")))
    if not file:
        return articles
    path = Path(file)
    name = f"{path.parents[1].name}: {path.stem}"
    anchor = html.escape(f"figure {name}".replace(": ", "_").replace(" ", "_"))
    if file in shown:
        return f'{articles}<p class="small">Figure: <a href="#{anchor}">{html.escape(name)}</a></p>'
    shown.add(file)
    return f'<div class="pair"><div>{articles}</div><div id="{anchor}">{figure_of(path, name)}</div></div>'


def _head(paper: str, table: pd.DataFrame, *, quick: bool) -> str:
    """The title of the page, and the number of claims with each verdict."""
    verdicts = [ClaimVerdict(verdict) for verdict in table["verdict"]]
    lines = "".join(
        f'<tr style="--colour: var(--{verdict.name})"><td><a class="verdict" href="#{verdict.name}">'
        f"{verdicts.count(verdict)} {html.escape(verdict.words)}</a></td>"
        f"<td>{html.escape(verdict.sentence)}</td></tr>"
        for verdict in _ORDER
        if verdict in verdicts
    )
    how = " These are the quick jobs, with fewer rows and wider tolerances." if quick else ""
    return (
        f"<h1>{html.escape(paper)}</h1><p>{len(table)} claims, compared with the results of "
        f"gaitsweep {html.escape(gaitsweep.__version__)}.{how}</p><table>{lines}</table>"
    )


def _claim(claim: Mapping[Hashable, object]) -> str:
    """The article of a claim, from its record in the table."""
    verdict = ClaimVerdict(str(claim["verdict"]))
    unit = "" if claim["unit"] in ("", "1") else f" {claim['unit']}"
    fields = {
        "paper": f"{claim['paper']}{unit}",
        "gaitsweep": f"{claim['ours']}{unit}" if claim["ours"] else "",
        "allowed": f"{claim['allowed']}{unit}: {claim['because']}",
    }
    for key, words in (
        ("why", "reason"),
        ("chosen", "our choice"),
        ("definition", "by definition"),
        ("constants", "constants"),
        ("tried", "tried"),
        ("open", "not in the paper"),
    ):
        if claim[key] and (key not in ("tried", "open") or verdict is not ClaimVerdict.reproduced):
            fields[words] = str(claim[key])
    listed = "".join(
        f"<dt>{html.escape(key)}</dt><dd>{html.escape(text)}</dd>" for key, text in fields.items() if text
    )
    return (
        f'<article id="{html.escape(str(claim["id"]))}" style="--colour: var(--{verdict.name})">'
        f'<h3><span class="verdict">{html.escape(str(claim["where"]))}</span> '
        f"{html.escape(str(claim['claim']))}</h3>"
        f'<dl>{listed}</dl><p class="small"><code>{html.escape(str(claim["command"]))}</code></p></article>'
    )


def _jobs(runs: Sequence[JobRun]) -> str:
    """The section of the jobs that ran; empty without jobs."""
    lines = "".join(
        f"<dt>{html.escape(run.name)}</dt><dd><code>{html.escape(run.command)}</code><br>"
        f'<span class="small">{html.escape(run.notes)}</span></dd>'
        for run in runs
    )
    return f"<h2>Jobs</h2><dl>{lines}</dl>" if runs else ""
