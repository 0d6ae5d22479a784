"""Text output of `gaitsweep sensitivity`."""

from __future__ import annotations

import math

import pandas as pd

from gaitsweep.cli.show import counts
from gaitsweep.fitting.indices import INDICES
from gaitsweep.fitting.sensitivity import FIGURE, INDICES_FILE, Sensitivity
from gaitsweep.table.manifest import FIGURES, TABLE


def outcome(found: Sensitivity) -> str:
    """Format sets by status, and the indices of each output, the most important parameter first."""
    status = found.table["status"].astype(str).value_counts()
    by_status = {str(name): int(number) for name, number in status.items() if number}
    lines = [f"{len(found.table)} sets: {counts(by_status)}."]
    for output, indices in found.indices.groupby("output", sort=False):
        lines += ["", *_of_output(str(output), indices)]
    if found.half_step is not None and not found.half_step.many:  # else it was a warning
        lines += ["", found.half_step.sentence]
    if found.path is not None:
        files = {"Table": TABLE, "Indices": INDICES_FILE, "Figure": f"{FIGURES}/{FIGURE}"}
        lines += ["", *(f"{name}: {found.path / file}" for name, file in files.items())]
    return "\n".join(lines)


def _of_output(output: str, indices: pd.DataFrame) -> list[str]:
    """Format the indices of one output as lines."""
    first = indices.iloc[0]
    units = {str(unit) for unit in indices["unit"]} - {"1"}
    unit = f" ({units.pop()})" if len(units) == 1 else ""
    known = set(indices["index"][indices["value"].notna()])  # why others have no value stands below
    names = [name for name in INDICES[first["method"]] if name in known]
    rows = [["", *names]]
    for parameter, own in indices.groupby("parameter", sort=False):
        by_index = {each["index"]: each for each in own.to_dict("records")}
        rows.append(
            [str(parameter), *(_number(by_index[name]) if name in by_index else "" for name in names)]
        )
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    rows_used = "" if first["method"] == "one_at_a_time" else f", {first['rows']} rows"
    lines = [f"{output}{unit}, {first['method']}{rows_used}"]
    lines += [
        "  " + "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip()
        for row in rows
    ]
    return [*lines, *(f"  {note}." for note in dict.fromkeys(indices["note"]) if note)]


def _number(index: dict) -> str:
    """Format the value of an index, with half its 95 % interval if known."""
    if math.isnan(index["value"]):
        return "-"
    half = index["confidence"]
    return f"{index['value']:.3g}" + ("" if math.isnan(half) else f" ± {half:.2g}")
