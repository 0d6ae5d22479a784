"""A report of a result directory in one HTML file: outcomes of rows, figures, job and provenance."""

from __future__ import annotations

import base64
import collections
import html
import warnings
from collections.abc import Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import Any

import pandas as pd
import yaml

from gaitsweep.analysis.records import in_order
from gaitsweep.plot import theme
from gaitsweep.runs.sentences import (
    DESCRIBED,
    advice,
    axes,
    plain,
    repeating,
    self_check_sentence,
    settings_of,
    status_sentence,
    unsettled,
)
from gaitsweep.status import SetStatus
from gaitsweep.table import Snapshot, load, replace_file, writing
from gaitsweep.table.manifest import self_check_warned


def _css(name: str) -> str:
    """The text of a style sheet beside this file."""
    return resources.files("gaitsweep.view").joinpath(name).read_text("utf-8")


SCHEMES = _css("page_colours.css")
_WITHOUT_GAIT = "not read"  # of records whose gait is missing
_REASONS = 5  # that are shown for failed sets of constants
# Entries of the manifest that are shown elsewhere, or are of no use to a reader.
_NOT_SHOWN = (
    "quantities", "job", "figures_drawn", "sha256", "counts", "gaits", "self_check", "stalls", "slowest",
    "complete", "periods", "largest_distance", "program", "findings", *DESCRIBED,
)  # fmt: skip
_ENTRY_NAMES = {"model_folder": "folder of the model", "made_before": "parts made by other versions"}


def write_report(path: str | Path) -> Path:
    """Write the self-contained page `report.html` into a result directory.

    Args:
        path: the directory, complete or not.

    Returns:
        The file.

    Raises:
        TableError: it is not a result directory, or a file of its table is damaged.
        WriteError: the report cannot be written.
    """
    snapshot = Snapshot.of(path)
    snapshot.require_sound()
    target = snapshot.path / "report.html"
    with writing(f"{target} could not be written"):
        text = _page(snapshot)
        replace_file(target, lambda file: file.write(text.encode()))
    return target


def _page(snapshot: Snapshot) -> str:
    """The HTML page of a result directory."""
    name = html.escape(str(snapshot.written.get("name", snapshot.path.name)))
    model = html.escape(str(snapshot.job.get("model", "unknown")))
    rows = snapshot.manifest["rows"]
    state = f"{rows} rows" if snapshot.complete else f"{snapshot.rows_done} of {rows} rows so far"
    kind = snapshot.job.get("run", {}).get("kind")
    run = f", run of kind {html.escape(str(kind))}" if kind else ""
    job = html.escape(yaml.safe_dump(snapshot.job, sort_keys=False, allow_unicode=True))
    drawn = [figure for figure in snapshot.figures if figure.suffix == ".png"]
    figures = "".join(figure_of(figure, figure.stem) for figure in drawn)
    explorer = ""
    if (snapshot.path / "explore.html").exists():
        explorer = '<p><a href="explore.html">Explorer: click a start to see the model walk from it.</a></p>'
    sections = [
        f'<h1>{name}</h1><p class="faint">Model {model}, {state}{run}.</p>{_warnings(snapshot)}',
        explorer,
        figures,
        f"<h2>Outcomes of rows</h2>{_counts(snapshot)}",
        "".join(f"<p>{html.escape(text)}</p>" for text in snapshot.manifest.get("findings", [])),
        _gaits(snapshot),
        _self_check(snapshot),
        f"<h2>Provenance</h2>{_provenance(snapshot)}",
        f"<h2>Job</h2><details><summary>as it was run</summary><pre>{job}</pre></details>",
    ]
    return document(name, SCHEMES + _css("report.css"), [section for section in sections if section])


def document(title: str, style: str, sections: Sequence[str]) -> str:
    """A self-contained HTML document from an escaped title, CSS, and sections of HTML."""
    body = "\n".join(sections)
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{title}</title><style>{style}</style></head><body>\n{body}\n</body></html>\n"
    )


def figure_of(path: Path, caption: str) -> str:
    """The HTML of a PNG file, with its image embedded."""
    image = base64.b64encode(path.read_bytes()).decode()
    name = html.escape(caption)
    picture = f'<img alt="{name}" src="data:image/png;base64,{image}">'
    return f"<figure>{picture}<figcaption>{name}</figcaption></figure>"


def _warnings(snapshot: Snapshot) -> str:
    """The sentences at the top of the report about a table that is incomplete or doubtful."""
    sentences = []
    if not snapshot.complete:
        sentences.append("The table is not complete. Run the same command to continue it.")
    if snapshot.job_edited:
        sentences.append("job.yaml was changed after the run; the job below is the one that was run.")
    if self_check_warned(snapshot.manifest.get("self_check")):
        sentences.append("The self-check warned: see below.")
    return "".join(f'<p class="warning">{html.escape(sentence)}</p>' for sentence in sentences)


def _counts(snapshot: Snapshot) -> str:
    """Rows by status, with the meaning of each status; they add up to the rows that ended."""
    total = sum(snapshot.counts.values())
    if not total:
        return "<p>No row has ended yet.</p>"
    lines = [
        f"<tr><td>{html.escape(status)}</td>{_number(number, total)}"
        f"<td>{html.escape(status_sentence(status, snapshot.job, snapshot.manifest))}</td></tr>"
        for status, number in snapshot.counts.items()
    ]
    lines.append(f'<tr class="sum"><td>all</td>{_number(total, total)}<td></td></tr>')
    stalls: Mapping[str, Any] = snapshot.manifest.get("stalls") or {}
    rows_of = {html.escape(guards): int(stall.get("rows", 0)) for guards, stall in stalls.items()}
    notes = "".join(f"<p>{rows} stalled: {guards}.</p>" for guards, rows in rows_of.items())
    if slowest := snapshot.manifest.get("slowest"):
        because = f"{unsettled(slowest)}.{repeating(snapshot.manifest)}"
        notes += f"<p>Rows did not settle because of {html.escape(because)}</p>"
    return f'<div class="wide"><table>{"".join(lines)}</table></div>{notes}{_reasons(snapshot)}'


def _columns(snapshot: Snapshot, *names: str) -> pd.DataFrame:
    """Columns of the table, which may be incomplete; the page says so elsewhere."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # those of `load`
        return load(snapshot.path, columns=names)


def _number(number: int, total: int) -> str:
    """The cells of a number and of its share of a total."""
    return f'<td class="number">{number}</td><td class="number">{100 * number / total:.1f} %</td>'


def _reasons(snapshot: Snapshot) -> str:
    """The most frequent reasons for failed sets of constants; empty if none failed."""
    if not snapshot.counts.get(SetStatus.FAILED):  # a `Status` of rows has another name
        return ""
    reasons = collections.Counter(filter(None, map(str, _columns(snapshot, "why")["why"])))
    most_frequent = reasons.most_common(_REASONS)
    lines = [f"<li>{html.escape(reason)} ({number} sets)</li>" for reason, number in most_frequent]
    return f"<p>Most frequent reasons for failed sets:</p><ul>{''.join(lines)}</ul>"


def _gaits(snapshot: Snapshot) -> str:
    """The gaits by the status of their rows; they add up to the rows, or to the records of all rows."""
    footers = snapshot.files.footers.values()
    if not any("gait" in footer.categories for footer in footers):
        return ""
    table = _columns(snapshot, "row", "status", "gait")
    gait = table["gait"].astype(object).where(table["gait"].notna(), _WITHOUT_GAIT)
    has_records = len(table) != table["row"].nunique()
    statuses = list(snapshot.counts) if len(snapshot.counts) > 1 and not has_records else []
    names = in_order(table, "gait", pd.Series(gait))
    colours = theme.colours(names)
    counts = pd.crosstab(gait, table["status"].astype(str))

    def cells(of_status: pd.Series) -> str:
        """The cells of rows of the table, counted by status: their number, their share, and each count."""
        numbers = "".join(f'<td class="number">{of_status.get(status, 0)}</td>' for status in statuses)
        return f"{_number(int(of_status.sum()), len(table))}{numbers}"

    lines = []
    for name in names:
        chip = f'<span class="chip" style="background:{colours[name]}"></span>'
        head = f'<td class="name">{chip}{html.escape(name)}</td>'
        lines.append(f"<tr>{head}{cells(counts.loc[name])}</tr>")
    lines.append(f'<tr class="sum"><td>all</td>{cells(counts.sum())}</tr>')
    heads = "".join(f'<th class="number">{html.escape(name)}</th>' for name in ("all", "", *statuses))
    table_of_gaits = f'<div class="wide"><table><tr><th>gait</th>{heads}</tr>{"".join(lines)}</table></div>'
    return f"<h2>Gaits of the {'records' if has_records else 'rows'}</h2>{table_of_gaits}"


def _self_check(snapshot: Snapshot) -> str:
    """The section on the self-check; empty without one."""
    check = snapshot.manifest.get("self_check")
    if not isinstance(check, dict):
        return ""
    text = self_check_sentence(check)
    style = ""
    if self_check_warned(check):
        dt = snapshot.job.get("numerics", {}).get("dt")
        text = f"{text} {advice(check, dt if isinstance(dt, float) else None)}"
        style = ' class="warning"'
    quantities = snapshot.manifest.get("quantities", {})
    lines = []
    for name, change in check.get("largest", {}).items():
        unit = str(quantities.get(name, {}).get("unit", ""))
        lines.append(
            f'<tr><td>{html.escape(name)}</td><td class="number">{change:.1e}</td>'
            f"<td>{html.escape('' if unit == '1' else unit)}</td></tr>"
        )
    head = "<tr><th>largest change of</th><th></th><th></th></tr>"
    largest = f'<div class="wide"><table>{head}{"".join(lines)}</table></div>' if lines else ""
    return f"<h2>Self-check</h2><p{style}>{html.escape(text)}</p>{largest}"


def _provenance(snapshot: Snapshot) -> str:
    """The provenance of the table: entries of the manifest, with the versions last."""
    manifest = snapshot.manifest
    facts: dict[str, Any] = {**settings_of(manifest)}
    facts |= {_ENTRY_NAMES.get(key, key): value for key, value in manifest.items() if key not in _NOT_SHOWN}
    facts["axes"] = axes(manifest.get("axes", []))
    if manifest.get("git_commit") is None:
        facts["commit of the source"] = "unknown: gaitsweep did not run from a checkout"
    facts["command to reproduce it"] = "gaitsweep run job.yaml"
    lines = [
        f"<tr><th>{html.escape(str(name))}</th><td>{html.escape(plain(value))}</td></tr>"
        for name, value in facts.items()
        if value not in (None, "")
    ]
    return f'<table class="facts">{"".join(lines)}</table>'
