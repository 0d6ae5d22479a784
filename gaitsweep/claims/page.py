"""The page of a paper's claims: one HTML file with embedded figures."""

from __future__ import annotations

import html
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import pandas as pd

from gaitsweep.claims.verdicts import ClaimVerdict
from gaitsweep.version import version
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


def _verdicts(scheme: int) -> str:
    """The CSS properties of the verdicts' colours: scheme 0 is light, 1 is dark."""
    return " ".join(f"--{each.name}: {colours[scheme]};" for each, colours in _COLOURS.items())


_STYLE = (
    SCHEMES
    + f":root {{ {_verdicts(0)} }}\n@media (prefers-color-scheme: dark) {{ :root {{ {_verdicts(1)} }} }}"
    + """
body { font: 16px/1.5 system-ui, sans-serif; max-width: 62rem; margin: 1.5rem auto; padding: 0 1rem;
  color: var(--ink); background: var(--paper); }
h1 { font-size: 1.5rem; margin-bottom: 0; } h2 { margin-top: 2.5rem; border-bottom: 1px solid var(--rule); }
article { border-left: 5px solid var(--colour); padding: .2rem 0 .2rem 1rem; margin: 1.4rem 0; }
article h3 { font-size: 1rem; margin: 0; } article p { margin: .3rem 0; }
.verdict { color: var(--colour); font-weight: 700; } .small { color: var(--faint); font-size: .9rem; }
dl { display: grid; grid-template-columns: max-content 1fr; gap: 0 1rem; margin: .3rem 0; }
dt { color: var(--faint); } dd { margin: 0; overflow-wrap: anywhere; }
code { background: var(--code); padding: 0 .2rem; overflow-wrap: anywhere; }
figure { margin: 1rem 0; } img { max-width: 100%; height: auto; background: #fff; }
figcaption { color: var(--faint); }
table { border-collapse: collapse; } td { vertical-align: top; padding: .2rem 1rem .2rem 0; }
@media (max-width: 40rem) { dl { grid-template-columns: 1fr; } dt { margin-top: .3rem; } }
"""
)


def page(paper: str, table: pd.DataFrame, runs: Sequence[JobRun], *, quick: bool) -> str:
    """The HTML text of the page.

    Args:
        paper: authors, year, journal.
        table: one row per claim, from `reproduce`.
        runs: the jobs that ran.
        quick: whether to state that these are the quick jobs.
    """
    sections = [_head(paper, table, quick)]
    shown: set[str] = set()
    for where, claims in table.groupby("where", sort=False):
        sections.append(f"<h2>{html.escape(str(where))}</h2>")
        for claim in claims.to_dict("records"):
            sections.append(_claim({str(key): value for key, value in claim.items()}))
        for file in dict.fromkeys(claims["figure"]):
            if file and file not in shown:
                shown.add(file)
                sections.append(figure_of(Path(file), f"{Path(file).parents[1].name}: {Path(file).stem}"))
    sections.append(_jobs(runs))
    return document(html.escape(paper), _STYLE, sections)


def _head(paper: str, table: pd.DataFrame, quick: bool) -> str:
    found = [ClaimVerdict(each) for each in table["verdict"]]
    lines = "".join(
        f'<tr style="--colour: var(--{each.name})"><td class="verdict">{html.escape(each.words)}</td>'
        f"<td>{found.count(each)}</td><td>{html.escape(each.sentence)}</td></tr>"
        for each in ClaimVerdict
    )
    how = " These are the quick jobs, with fewer rows and wider tolerances." if quick else ""
    return (
        f"<h1>{html.escape(paper)}</h1><p>{len(table)} claims, compared with the results of "
        f"gaitsweep {html.escape(version())}.{how}</p><table>{lines}</table>"
    )


def _claim(claim: dict[str, object]) -> str:
    found = ClaimVerdict(str(claim["verdict"]))
    unit = "" if claim["unit"] in ("", "1") else f" {claim['unit']}"
    fields = {
        "paper": f"{claim['paper']}{unit}",
        "gaitsweep": f"{claim['ours']}{unit}" if claim["ours"] else "",
    }
    fields["allowed"] = f"{claim['allowed']}{unit}: {claim['because']}"
    for key, words in (
        ("why", "reason"),
        ("chosen", "our choice"),
        ("definition", "by definition"),
        ("constants", "constants"),
        ("tried", "tried"),
        ("open", "not in the paper"),
    ):
        if claim[key] and (key not in ("tried", "open") or found is not ClaimVerdict.reproduced):
            fields[words] = str(claim[key])
    listed = "".join(
        f"<dt>{html.escape(key)}</dt><dd>{html.escape(text)}</dd>" for key, text in fields.items() if text
    )
    return (
        f'<article id="{html.escape(str(claim["id"]))}" style="--colour: var(--{found.name})">'
        f'<h3><span class="verdict">{html.escape(found.words)}</span> {html.escape(str(claim["claim"]))}</h3>'
        f'<dl>{listed}</dl><p class="small"><code>{html.escape(str(claim["command"]))}</code></p></article>'
    )


def _jobs(runs: Sequence[JobRun]) -> str:
    lines = "".join(
        f"<dt>{html.escape(run.name)}</dt><dd><code>{html.escape(run.command)}</code><br>"
        f'<span class="small">{html.escape(run.notes)}</span></dd>'
        for run in runs
    )
    return f"<h2>Jobs</h2><dl>{lines}</dl>" if runs else ""
