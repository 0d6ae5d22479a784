"""Text output of `gaitsweep search`."""

from __future__ import annotations

import io
from typing import Any

from rich.console import Console
from rich.table import Table

from gaitsweep.cli.show import aligned, duration
from gaitsweep.fitting.estimate import SearchEstimate
from gaitsweep.fitting.identifiability import NEAR
from gaitsweep.fitting.search import SearchResult
from gaitsweep.fitting.targets import MISS
from gaitsweep.runs.status_sentences import SetStatus

# Reasons that are shown where all sets failed.
_REASONS = 3


def estimate(needs: SearchEstimate) -> str:
    """Format the estimate of a search."""
    lines = {
        "sets": f"{needs.sets}, {needs.together} at a time",
        "rows of a set": str(needs.rows_of_a_set)
        + (f", and at most {needs.rows_of_neighbours} of its neighbours" if needs.rows_of_neighbours else ""),
    }
    if needs.batch is None:
        lines["time"] = "not estimated: the search computes only fixed points"
    else:
        lines["engine"] = f"{needs.batch.engine} on {needs.batch.device}, {needs.batch.lanes} lanes"
        lines["steps"] = f"about {needs.steps:.2g}"
        lines["time"] = f"about {duration(needs.seconds)}"
        if needs.seconds_most > 1.05 * needs.seconds:
            lines["time"] += f", at most {duration(needs.seconds_most)}"
        lines["time"] += " (measured in the middle of the ranges)"
    return aligned(lines)


def outcome(found: SearchResult) -> str:
    """Format the result of a search: sets by status, the best one, its targets, and each constant's range."""
    counts = ", ".join(f"{status.among(found.table).sum()} {status}" for status in SetStatus)
    lines = [f"{len(found.table)} sets: {counts}."]
    if found.path is not None:
        lines.append(f"Table: {found.path / 'table'}")
    near = found.identifiability
    if not len(near.best):
        most = found.table["why"].value_counts().head(_REASONS)
        why = [f"  {count} sets: {reason}" for reason, count in most.items()]
        return "\n".join([*lines, "No set has a value for every target. Most frequent reasons:", *why])
    best: dict[str, Any] = near.best.iloc[0].to_dict()
    lines.append(
        f"Best set: row {best['row']}, score {best['score']:.4g} (root mean square miss in reading errors)."
    )
    if near.fitting:
        lines.append(f"{near.fitting} sets meet all targets within their reading errors:")
    else:
        lines.append(
            f"No set meets all targets within their reading errors. The {len(near.best)} near-best sets have "
            f"scores up to {NEAR:g} times the lowest:"
        )
    constants = [
        (
            each.name,
            *each.words,
            f"{100 * each.spread:.0f} %",
            each.verdict,
        )
        for each in near.constants
    ]
    lines.append(_table(("constant", "best", "near-best", "share of range", ""), constants))
    targets = []
    for name, target in found.job.targets.items():
        low, high = target.value.wanted
        wanted = f"{low:g}" if low == high else f"{low:g} to {high:g}"
        kept = "held back" if target.value.held_back else ""
        half = found.finalists
        at_half = "" if half is None else f"{half.iloc[0][f'{name}_half']:.5g}"
        miss = f"{best[f'{MISS}{name}']:+.2f}"
        targets.append(
            (name, f"{wanted} +- {target.value.error:g}", f"{best[name]:.5g}", at_half, miss, kept)
        )
    lines.append(
        _table(("target", "wanted", "best set", "at half the step", "miss in reading errors", ""), targets)
    )
    lines += [f"Figure: {figure}" for figure in found.figures]
    return "\n".join(lines)


def _table(head: tuple[str, ...], rows: list[tuple[str, ...]]) -> str:
    table = Table(box=None, pad_edge=False, show_header=True, header_style="")
    for name in head:
        table.add_column(name)
    for row in rows:
        table.add_row(*row)
    text = io.StringIO()
    Console(file=text, width=160, highlight=False).print(table)
    return "\n".join(line.rstrip() for line in text.getvalue().rstrip().splitlines())
