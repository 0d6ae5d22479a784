"""The bifurcation diagram of a settle table."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
import pytest
from matplotlib.colors import to_hex

from gaitsweep import plot
from gaitsweep.plot import PlotError


def diagram_table() -> pd.DataFrame:
    """A fixed point, an orbit of two crossings, a chaotic row with three, and a row without an attractor."""
    nan = np.nan
    return pd.DataFrame(
        {
            "a": [1.0, 2.0, 3.0, 4.0],
            "status": ["settled", "settled", "chaotic", "cycle_limit"],
            "x_end": [0.1, 0.2, 0.3, 0.4],
            "x_end_2": [nan, 0.25, 0.35, nan],
            "x_end_3": [nan, nan, 0.37, nan],
            "lyapunov_1": [-0.5, -0.1, 0.4, 0.01],
            "lyapunov_1_error": [0.01, nan, 0.02, 0.1],
        }
    )


def drawn(axes: Any) -> np.ndarray:
    """The places of the markers in axes, (n, 2)."""
    points = [np.stack(line.get_data(), axis=1) for line in axes.lines if line.get_marker() == "o"]
    points = np.concatenate(points)
    return points[np.isfinite(points).all(axis=1)]


def test_all_crossings_are_drawn_with_the_exponent_below() -> None:
    figure: Any = plot.orbit(diagram_table(), x="a", y="x")
    above, below = figure.axes
    expected = [(1.0, 0.1), (2.0, 0.2), (2.0, 0.25), (3.0, 0.3), (3.0, 0.35), (3.0, 0.37)]
    assert sorted(map(tuple, drawn(above).tolist())) == expected
    assert sorted(map(tuple, drawn(below).tolist())) == [(1.0, -0.5), (2.0, -0.1), (3.0, 0.4)]
    marks = [line for line in above.lines if line.get_marker() == "|"]
    assert [line.get_xdata().tolist() for line in marks] == [[4.0]]
    words = [text.get_text() for legend in figure.legends for text in legend.get_texts()]
    assert words == ["periodic", "chaotic", "not settled"]


def test_points_have_the_colours_of_gaits() -> None:
    """By default where settled rows have several gaits; rows that are not settled keep their status."""
    table = diagram_table().assign(gait=["trot", "pace", None, None])
    figure: Any = plot.draw("orbit", table, x="a", y="x", hue="gait", colours={"trot": "crimson"})
    (legend,) = figure.legends
    words = [text.get_text() for text in legend.get_texts()]
    assert set(words) == {"trot", "pace", "chaotic", "not settled"}
    of_trot = [line for line in figure.axes[0].lines if to_hex(line.get_color()) == to_hex("crimson")]
    assert [line.get_xydata()[0].tolist() for line in of_trot] == [[1.0, 0.1]]
    assert all(line.get_markersize() >= 3.0 for line in of_trot)
    by_default: Any = plot.orbit(table, x="a", y="x")
    assert "trot" in [text.get_text() for text in by_default.legends[0].get_texts()]
    # a colour of its own shows a single gait, too
    of_one: Any = plot.draw("orbit", table.assign(gait="trot"), x="a", y="x", colours={"trot": "crimson"})
    assert any(to_hex(line.get_color()) == to_hex("crimson") for line in of_one.axes[0].lines)
    by_status: Any = plot.orbit(table, x="a", y="x", hue="status")
    assert "periodic" in [text.get_text() for text in by_status.legends[0].get_texts()]
    # the x of rows without a gait has edges alone, which need a width
    figure = plot.orbit(table.assign(gait=["trot", "none", None, None]), x="a", y="x", hue="gait")
    crosses = [line for line in figure.axes[0].lines if line.get_marker() == "x"]
    crosses += [handle for handle in figure.legends[0].legend_handles if handle.get_marker() == "x"]
    assert len(crosses) == 2
    assert all(line.get_markeredgewidth() > 0.5 for line in crosses)
    with pytest.raises(PlotError, match="gait is not a column"):
        plot.orbit(diagram_table(), x="a", y="x", hue="gait")


def test_without_exponents_there_are_no_lower_axes() -> None:
    table = diagram_table().drop(columns=["lyapunov_1", "lyapunov_1_error"])
    assert len(plot.orbit(table, x="a", y="x").axes) == 1
    assert len(plot.orbit(table.iloc[:0], x="a", y="x").axes) == 1


def test_rows_of_another_parameter_are_not_drawn_over_each_other() -> None:
    """Points of two systems look like one that has two attractors."""
    table = pd.DataFrame({"row": [0, 1], "a": [1.0, 1.0], "b": [0.2, 0.3], "status": "settled", "x_end": 0.1})
    table.attrs["job"] = {"model": "gaitsweep.examples.henon:Henon"}
    with pytest.raises(PlotError, match=r'differ in b, too, .*table\[table\["b"\] == 0\.2\]'):
        plot.orbit(table, x="a", y="x")
    assert len(plot.orbit(table.iloc[:1], x="a", y="x").axes) == 1


def test_values_without_crossings_say_why() -> None:
    """An undecided row leaves its value open, beside failed ones too; at rest there are no crossings."""
    table = pd.DataFrame({"a": [1.0, 2.0, 2.0, 3.0, 4.0, 4.0], "x_end": 0.1})
    table["status"] = ["settled", "cycle_limit", "fell", "fell", "at_rest", "fell"]
    figure: Any = plot.orbit(table, x="a", y="x")
    marks = [line.get_xdata().tolist() for line in figure.axes[0].lines if line.get_marker() == "|"]
    assert marks == [[2.0], [3.0, 4.0]]
    words = [text.get_text() for legend in figure.legends for text in legend.get_texts()]
    assert words == ["periodic", "not settled", "failed"]
    at_rest: Any = plot.orbit(table.iloc[[4]], x="a", y="x")
    assert [text.get_text() for legend in at_rest.legends for text in legend.get_texts()] == ["at rest"]


def test_another_parameter_has_a_panel_for_each_of_its_values() -> None:
    """Panels share their scales and the legend; a value without an exponent has an empty lower panel."""
    upper = diagram_table().assign(b=1.0)
    lower = diagram_table().assign(b=0.5, x_end=-0.4, lyapunov_1=np.nan)
    table = pd.concat([upper, lower.iloc[:1]], ignore_index=True)
    figure: Any = plot.orbit(table, x="a", y="x", panels="b")
    left, right, below_left, below_right = figure.axes
    assert [axes.get_title() for axes in (left, right)] == ["$b$ = 0.5", "$b$ = 1"]
    assert drawn(left).tolist() == [[1.0, -0.4]]
    assert len(drawn(right)) == 6
    assert not [line for line in below_left.lines if line.get_marker() == "o" and len(line.get_xdata())]
    assert len(drawn(below_right)) == 3
    assert left.get_ylim() == right.get_ylim()
    assert left.get_ylim()[0] < -0.4
    words = [text.get_text() for legend in figure.legends for text in legend.get_texts()]
    assert words == ["periodic", "chaotic", "not settled"]
    # a selection of rows has an index that does not begin at 0
    assert len(drawn(plot.orbit(table.iloc[1:4], x="a", y="x").axes[0])) == 5
    henon = table.assign(row=range(5)).reindex(columns=["row", "a", "b", "status", "x_end"])
    henon.attrs["job"] = {"model": "gaitsweep.examples.henon:Henon"}
    with pytest.raises(PlotError, match="differ in b, too"):
        plot.orbit(henon, x="a", y="x")
    assert len(plot.orbit(henon, x="a", y="x", panels="b").axes) == 2
