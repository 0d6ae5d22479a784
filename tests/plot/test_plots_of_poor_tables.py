"""Figures of tables that lack columns, rows or numbers."""

from __future__ import annotations

import numpy as np
import pytest

from gaitsweep import plot
from gaitsweep.plot import PlotError
from tests.support.plot_tables import AXES, crossing_table, rendered, settle_table, trace_table


@pytest.mark.parametrize(
    ("kind", "spec", "sentence"),
    [
        ("basin", {"x": "psi1", "y": "psi_2"}, r"psi1 is not a column of this table; did you mean psi_1\?"),
        ("basin", {"x": "psi_1", "y": "psi_2", "hue": "gate"}, r"did you mean gait\?"),
        ("solution_set", {"axes": ["psi_1", "psi_2", "psj_3"]}, r"psj_3 .* did you mean psi_3\?"),
        ("cycles", {"y": ["psi_1"], "x": "cycle", "hue": "row"}, r"did you mean cycles\?"),
        ("footprints", {}, "t is not a column"),
        ("basins", {}, r"basins is not a kind of figure; did you mean basin\?"),
    ],
)
def test_what_is_not_there_is_refused_with_the_near_miss(kind: str, spec: dict, sentence: str) -> None:
    with pytest.raises(PlotError, match=sentence):
        plot.draw(kind, settle_table(), **spec)
    with pytest.raises(PlotError, match="contact_1"):
        plot.footprints(crossing_table().assign(t=0.0))


@pytest.mark.parametrize("whole", ["none of its rows", "failed", "no numbers"])
def test_tables_of_little_use_do_not_crash(whole: str) -> None:
    settle, crossing, trace = settle_table(), crossing_table(), trace_table()
    settle["status"] = settle["status"].cat.add_categories(["diverged"])
    if whole == "none of its rows":
        settle, crossing, trace = settle.iloc[:0], crossing.iloc[:0], trace.iloc[:0]
    else:
        settle["status"], crossing["status"], trace["status"] = "diverged", "diverged", "fell"
    if whole == "no numbers":
        for table, pattern in ((settle, "_end"), (crossing, "_n"), (trace, "contact")):
            names = [name for name in table.columns if pattern in name]
            table[names] = np.nan
        settle["gait"] = np.nan
    rendered(plot.basin(settle, x="psi_1", y="psi_2", panels="psi_3"))
    rendered(plot.basin(settle, x="psi_1", y="psi_2", panels="psi_3", hue="cycles"))
    rendered(plot.solution_set(settle, axes=AXES))
    rendered(plot.cycles(crossing, y=["psi_1"]))
    rendered(plot.footprints(trace))
