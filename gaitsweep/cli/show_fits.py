"""Text output of `gaitsweep search` and `gaitsweep sensitivity`."""

from __future__ import annotations

import io
import math
from collections.abc import Mapping
from typing import Any

import pandas as pd
from rich.console import Console
from rich.table import Table

from gaitsweep.cli.show import aligned, counts, duration
from gaitsweep.fitting.free_parameters import number_of_sets
from gaitsweep.fitting.identifiability import NEAR_BEST_FACTOR
from gaitsweep.fitting.search import SearchResult
from gaitsweep.fitting.search_cost import SearchEstimate
from gaitsweep.fitting.sensitivity import FIGURE, INDICES_FILE, Sensitivity
from gaitsweep.fitting.sensitivity_methods import INDICES
from gaitsweep.fitting.targets import MISS
from gaitsweep.status import SetStatus
from gaitsweep.table.manifest import FIGURES, TABLE

# Reasons that are shown where all sets failed.
_REASONS = 3


def search_estimate(needs: SearchEstimate) -> str:
    """Format the estimate of a search."""
    rows = str(needs.rows_of_a_set)
    if needs.rows_of_neighbours:
        rows += f", and at most {needs.rows_of_neighbours} of its neighbours"
    lines = {"sets": f"{needs.sets}, {needs.together} at a time", "rows of a set": rows}
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


def search_outcome(result: SearchResult) -> str:
    """Format the result of a search: sets by status, the best one, its targets, and each constant's range."""
    by_status = ", ".join(f"{status.among(result.table).sum()} {status}" for status in SetStatus)
    lines = [f"{number_of_sets(len(result.table))}: {by_status}."]
    if result.path is not None:
        lines.append(f"Table: {result.path / 'table'}")
    near = result.identifiability
    if not len(near.best):
        counts_of_reasons = result.table["why"].value_counts().head(_REASONS)
        reasons = [f"  {number_of_sets(count)}: {reason}" for reason, count in counts_of_reasons.items()]
        return "\n".join([*lines, "No set has a value for every target. Most frequent reasons:", *reasons])
    best: dict[str, Any] = near.best.iloc[0].to_dict()
    lines.append(
        f"Best set: row {best['row']}, score {best['score']:.4g} (root mean square miss in reading errors)."
    )
    if near.fitting:
        meet = f"meet{'s' * (near.fitting == 1)} all targets within their reading errors:"
        lines.append(f"{number_of_sets(near.fitting)} {meet}")
    else:
        lines.append(
            "No set meets all targets within their reading errors. The near-best sets, with scores up to "
            f"{NEAR_BEST_FACTOR:g} times the lowest ({len(near.best)} of {len(result.table)}):"
        )
    constants = [
        (constant.name, *constant.words, f"{100 * constant.spread:.0f} %", constant.verdict)
        for constant in near.constants
    ]
    lines.append(_table(("constant", "best", "near-best", "share of range", ""), constants))
    lines.append(_targets(result, best))
    lines += [f"Figure: {figure}" for figure in result.figures]
    return "\n".join(lines)


def _targets(result: SearchResult, best: Mapping[Any, Any]) -> str:
    """Format the targets of a search with the values of its best set."""
    rows = []
    half = result.finalists
    for name, target in result.job.targets.items():
        low, high = target.value.wanted
        wanted = f"{low:g}" if low == high else f"{low:g} to {high:g}"
        at_half = "" if half is None else f"{half.iloc[0][f'{name}_half']:.5g}"
        rows.append(
            (
                name,
                f"{wanted} +- {target.value.error:g}",
                f"{best[name]:.5g}",
                at_half,
                f"{best[f'{MISS}{name}']:+.2f}",
                "held back" if target.value.held_back else "",
            )
        )
    return _table(("target", "wanted", "best set", "at half the step", "miss in reading errors", ""), rows)


def _table(head: tuple[str, ...], rows: list[tuple[str, ...]]) -> str:
    """Format rows in columns below their heads."""
    table = Table(box=None, pad_edge=False, show_header=True, header_style="")
    for name in head:
        table.add_column(name)
    for row in rows:
        table.add_row(*row)
    text = io.StringIO()
    Console(file=text, width=160, highlight=False).print(table)
    return "\n".join(line.rstrip() for line in text.getvalue().rstrip().splitlines())


def sensitivity_outcome(result: Sensitivity) -> str:
    """Format sets by status, and the indices of each output, the most important parameter first."""
    status = result.table["status"].astype(str).value_counts()
    by_status = {str(name): int(number) for name, number in status.items() if number}
    lines = [f"{number_of_sets(len(result.table))}: {counts(by_status)}."]
    for output, indices in result.indices.groupby("output", sort=False):
        lines += ["", *_of_output(str(output), indices)]
    if result.half_step is not None and not result.half_step.many:  # else it was a warning
        lines += ["", result.half_step.sentence]
    if result.path is not None:
        files = {"Table": TABLE, "Indices": INDICES_FILE, "Figure": f"{FIGURES}/{FIGURE}"}
        lines += ["", *(f"{name}: {result.path / file}" for name, file in files.items())]
    return "\n".join(lines)


def _of_output(output: str, indices: pd.DataFrame) -> list[str]:
    """Format the indices of one output as lines."""
    first = indices.iloc[0]
    units = {str(unit) for unit in indices["unit"]} - {"1"}
    unit = f" ({units.pop()})" if len(units) == 1 else ""
    with_value = set(indices["index"][indices["value"].notna()])  # why others have no value stands below
    names = [name for name in INDICES[first["method"]] if name in with_value]
    rows = [["", *names]]
    for parameter, own in indices.groupby("parameter", sort=False):
        texts = {record["index"]: _number(record) for record in own.to_dict("records")}
        rows.append([str(parameter), *(texts.get(name, "") for name in names)])
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    rows_used = "" if first["method"] == "one_at_a_time" else f", {first['rows']} rows"
    lines = [f"{output}{unit}, {first['method']}{rows_used}"]
    for row in rows:
        cells = "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True))
        lines.append(f"  {cells}".rstrip())
    return [*lines, *(f"  {note}." for note in dict.fromkeys(indices["note"]) if note)]


def _number(index: Mapping[Any, Any]) -> str:
    """Format the value of an index, with half its 95 % interval if known."""
    if math.isnan(index["value"]):
        return "-"
    half = "" if math.isnan(index["confidence"]) else f" ± {index['confidence']:.2g}"
    return f"{index['value']:.3g}{half}"
