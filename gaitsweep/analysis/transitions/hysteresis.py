"""Where states are lost as a parameter rises and falls, and the area between the branches."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import pandas as pd

from gaitsweep.analysis.records import AnalysisError
from gaitsweep.analysis.transitions.transition_points import (
    LEAST,
    loop_area,
    transition_points,
    transition_points_by_gait,
)


@dataclasses.dataclass(frozen=True)
class Hysteresis:
    """Find where a state is lost as a parameter rises and falls, and the area between the branches.

    `transition_points`: one record a pass (direction, low, high, size, rows, ...), or a gait for settled
    rows. `loops`: one record a row and pair of passes (area, signed, low, high); areas are in the parameter's
    unit times the observable's. Of ramps and staircases both have the column `observable`.
    """

    transition_points: pd.DataFrame
    loops: pd.DataFrame


def hysteresis(
    table: pd.DataFrame,
    observable: str | None = None,
    parameter: str | None = None,
    *,
    start: str | None = None,
    least: float = LEAST,
    by: Sequence[str] = (),
) -> Hysteresis:
    """Measure the hysteresis of a ramp, of a staircase, or of settled rows.

    Args:
        table: a table of one of these runs.
        observable: the section observable that jumps; each of the table's in turn by default.
        parameter: the parameter's column; the one that the run moved by default.
        start: of settled rows, the column of the start value that selects the branch.
        least: smallest change that counts as a jump, in the observable's unit.
        by: columns of what varies; rows that share them are taken together.

    Raises:
        AnalysisError: a column is not there, or has to be named.

    Example:
        A speed rises in four stairs and falls again; x jumps from 0 to 1 between 3 and 4, and back between
        2 and 1:

        >>> import pandas as pd, gaitsweep as gs
        >>> table = pd.DataFrame({"row": 0, "pass": [0, 0, 0, 0, 1, 1, 1, 1], "stair": range(8)})
        >>> table["speed"], table["x_n"] = [1, 2, 3, 4, 4, 3, 2, 1], [0, 0, 0, 1, 1, 1, 1, 0]
        >>> found = gs.hysteresis(table, "x", "speed")
        >>> found.transition_points[["direction", "low", "high"]].to_numpy().tolist()
        [['rising', 3.0, 4.0], ['falling', 1.0, 2.0]]
        >>> found.loops["area"].tolist()
        [2.0]
    """
    run = table.attrs.get("job", {}).get("run", {})
    parameter = parameter or run.get("parameter")
    if parameter is None:
        raise AnalysisError("No parameter moves in this run: name the column as parameter=.")
    if "pass" not in table.columns:
        if start is None:
            raise AnalysisError(
                "These rows have no passes up and down: name the column of the start value that selects the "
                "branch as start=."
            )
        return Hysteresis(transition_points_by_gait(table, parameter, start, by=by), pd.DataFrame())
    names = [observable] if observable is not None else _observables(table)
    points = [transition_points(table, name, parameter, least, by).assign(observable=name) for name in names]
    loops = [loop_area(table, name, parameter).assign(observable=name) for name in names]
    return Hysteresis(_joined(points), _joined(loops))


def _observables(table: pd.DataFrame) -> list[str]:
    """The section observables of a table, by their own names."""
    columns = table.columns[table.columns.str.endswith("_n")]
    return [str(name).removesuffix("_n") for name in columns if pd.api.types.is_numeric_dtype(table[name])]


def _joined(parts: list[pd.DataFrame]) -> pd.DataFrame:
    """The frames under each other, `observable` first; of empty ones only the columns."""
    full = [part for part in parts if len(part)] or parts[:1]
    joined = pd.concat(full, ignore_index=True) if full else pd.DataFrame({"observable": []})
    joined.insert(0, "observable", joined.pop("observable"))
    return joined
