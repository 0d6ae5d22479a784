"""The panels of a hysteresis figure: their tables, of one run or two, and what each of them shows."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import pandas as pd

from gaitsweep.analysis.transitions.jumps import irregular_passes, where_it_moves
from gaitsweep.plot.column_labels import unit_of, written
from gaitsweep.plot.columns import column, rows_where
from gaitsweep.plot.provenance_marks import remarks
from gaitsweep.table import TableError, load


class Panel(NamedTuple):
    """A panel of the figure: its heading, its table, and a note in place of a missing table."""

    heading: str
    table: pd.DataFrame | None  # None if the table does not exist yet; the heading names it
    note: str = ""


class Columns(NamedTuple):
    """The columns along the axes that all panels share.

    `table` is the first table; `name` and `x` are along axis y and axis x; `origin` is the angle
    (rad) at which axis y cuts the circle, None if it is no angle.
    """

    table: pd.DataFrame
    name: str
    x: str
    origin: float | None


def panels_of(table: pd.DataFrame, panels: str | None, *, beside: bool) -> list[Panel]:
    """A table's panels; with a second table, their headings describe how the parameter moves."""
    if panels is None:
        return [Panel(_pace(table), table)]
    pace = f", {_pace(table)}" if beside else ""
    column(table, panels)
    values = sorted(table[panels].dropna().unique())
    several = [
        Panel(written(table, panels, value) + pace, rows_where(table, table[panels] == value))
        for value in values
    ]
    return several or [Panel("", table)]


def panels_of_second(
    table: pd.DataFrame, other: str | pd.DataFrame | None, panels: str | None
) -> list[Panel]:
    """The panels of a second table, or of its path relative to `table`, with remarks in their headings."""
    if other is None:
        return []
    if not isinstance(other, pd.DataFrame):
        beside_first = Path(str(table.attrs.get("path", "."))).parent / other
        path = Path(other) if Path(other).is_dir() else beside_first
        try:
            other = load(path)
        except TableError:
            text = f"{path.name} has no table yet: run its job, then gaitsweep plot."
            return [Panel(path.name, None, text)]
    notes = "".join(f"\n{note}" for note in remarks(other))
    return [panel._replace(heading=panel.heading + notes) for panel in panels_of(other, panels, beside=True)]


def _pace(table: pd.DataFrame) -> str:
    """Describe how a table's parameter moves, with its speed if the job gives it."""
    run = table.attrs.get("job", {}).get("run", {})
    unit = unit_of(table, str(run.get("parameter", "")))
    if "stair" in table.columns:
        return f"held {run['dwell']:g} s at each value" if "dwell" in run else "held at each value"
    rate = f" ({run['rate']:g} {unit}/s)".replace(" /s", "/s") if "rate" in run else ""
    return f"moved slowly{rate}"


def while_moving(table: pd.DataFrame | None, parameter: str) -> pd.DataFrame | None:
    """A table without the records of a ramp before its parameter moves."""
    if table is None or "stair" in table.columns:
        return table
    table = table.sort_values(["row", "crossing"], kind="stable")
    first = table.groupby("row")[parameter].transform(lambda values: where_it_moves(values.to_numpy(float)))
    return rows_where(table, table.groupby("row").cumcount() >= first)


def irregular_parted(
    table: pd.DataFrame | None, name: str, parameter: str, least: float
) -> tuple[pd.DataFrame | None, pd.DataFrame]:
    """The records on branches, and those of irregular passes."""
    if table is None:
        return None, pd.DataFrame()
    keys = pd.MultiIndex.from_arrays([table["row"], table["pass"]])
    irregular = keys.isin(pd.MultiIndex.from_frame(irregular_passes(table, name, parameter, least)))
    return rows_where(table, ~irregular), rows_where(table, irregular)
