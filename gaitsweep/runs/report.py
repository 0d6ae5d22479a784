"""A result directory as one HTML file: what was asked, how rows ended, the figures, and the provenance."""

from __future__ import annotations

import base64
import html
import json
from collections.abc import Sequence
from pathlib import Path

import yaml

from gaitsweep.contract import Status
from gaitsweep.table import Snapshot, replace_file, writing

_STYLE = """
body { font: 16px/1.5 system-ui, sans-serif; max-width: 60rem; margin: 2rem auto; padding: 0 1rem; }
h1 { margin-bottom: 0; } h2 { margin-top: 2.5rem; border-bottom: 1px solid #ccc; }
table { border-collapse: collapse; }
td, th { padding: .2rem 1.2rem .2rem 0; text-align: left; vertical-align: top; }
td.number { text-align: right; font-variant-numeric: tabular-nums; }
pre { background: #f5f5f5; padding: 1rem; overflow-x: auto; font-size: 13px; }
figure { margin: 1.5rem 0; } img { max-width: 100%; } figcaption { color: #555; }
"""


def write_report(path: str | Path) -> Path:
    """Write `report.html` into a result directory; it needs no other file.

    Args:
        path: the directory, complete or not.

    Returns:
        Where the report stands.

    Raises:
        TableError: it is no result directory, or a file of its table is damaged.
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
    name = html.escape(str(snapshot.written.get("name", snapshot.path.name)))
    model = html.escape(str(snapshot.job.get("model", "unknown")))
    rows = snapshot.manifest["rows"]
    state = f"{rows} rows" if snapshot.complete else f"{snapshot.rows_done} of {rows} rows so far"
    job = html.escape(yaml.safe_dump(snapshot.job, sort_keys=False, allow_unicode=True))
    sections = [
        f"<h1>{name}</h1><p>Model {model}, {state}.</p>",
        *(figure_of(figure, figure.stem) for figure in snapshot.figures),
        f"<h2>How rows ended</h2>{_counts(snapshot)}",
        f"<h2>Job</h2><pre>{job}</pre>",
        f"<h2>Provenance</h2>{_provenance(snapshot)}",
    ]
    return document(name, _STYLE, sections)


def document(title: str, style: str, sections: Sequence[str]) -> str:
    """An HTML document that needs no other file, from an escaped title, CSS, and sections of HTML."""
    body = "\n".join(sections)
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{title}</title><style>{style}</style></head><body>\n{body}\n</body></html>\n"
    )


def figure_of(path: Path, caption: str) -> str:
    """The HTML of a PNG file, with its image inside."""
    image = base64.b64encode(path.read_bytes()).decode()
    name = html.escape(caption)
    return (
        f'<figure><img alt="{name}" src="data:image/png;base64,{image}">'
        f"<figcaption>{name}</figcaption></figure>"
    )


def _counts(snapshot: Snapshot) -> str:
    lines = []
    for status, number in snapshot.counts.items():
        meaning = Status[status].sentence if status in Status.__members__ else ""
        share = 100 * number / snapshot.manifest["rows"]
        lines.append(
            f'<tr><td>{html.escape(status)}</td><td class="number">{number}</td>'
            f'<td class="number">{share:.1f} %</td><td>{html.escape(meaning)}</td></tr>'
        )
    return f"<table>{''.join(lines)}</table>" if lines else "<p>No row has ended yet.</p>"


def _provenance(snapshot: Snapshot) -> str:
    lines = []
    for key, value in snapshot.manifest.items():
        if key in ("quantities", "job", "figures_drawn"):
            continue
        text = value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)
        lines.append(f"<tr><th>{html.escape(key)}</th><td>{html.escape(text)}</td></tr>")
    return f"<table>{''.join(lines)}</table>"
