"""Figures of return maps and of branches of fixed points, from small synthetic tables."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from matplotlib.colors import to_hex

from gaitsweep import plot
from tests.support.hysteresis_tables import (
    FOLD,
    delta,
    map_table,
    roots,
)
from tests.support.plot_tables import legend_texts, rendered


@pytest.mark.slow("change")
@pytest.mark.parametrize("form", ["change", "next"])
def test_return_map_marks_fixed_points_and_ghosts(form: str) -> None:
    table = map_table([0.0, 0.44], starts=60, crossings=60, noise=0.002)
    figure = plot.draw("return_map", table, y="delta_13", panels="f", form=form)
    rendered(figure)
    left, right = figure.axes
    assert (left.get_title(), right.get_title()) == ("$f$ = 0 Hz", "$f$ = 0.44 Hz")
    points = [line for line in left.lines if line.get_marker() == "o"]
    assert [np.asarray(line.get_xdata())[0] for line in points] == pytest.approx(delta(roots(0.0)), abs=0.005)
    for line in points:
        x, y = np.asarray(line.get_data())[:, 0]
        assert y == (x if form == "next" else 0.0)
    assert [to_hex(line.get_markerfacecolor()) == "#ffffff" for line in points] == [False, True, False]
    ghost = [line for line in right.lines if line.get_marker() == "^"]
    (passed,) = (np.asarray(line.get_xdata())[0] for line in ghost)
    assert passed == pytest.approx(delta(-1 / np.sqrt(3)), abs=0.02)
    assert right.texts[0].get_text().startswith("+0.0")
    assert legend_texts(figure) == [
        "one step of one start",
        "smoothed, ± 2 standard errors",
        *(["no change"] if form == "next" else []),
        "stable",
        "unstable",
        "ghost: slow passage, with its change",
    ]
    label = (
        "change of $\\Delta_{13}$ to\nthe next crossing (rad)"
        if form == "change"
        else "$\\Delta_{13}$ at\nthe next crossing (rad)"
    )
    assert left.get_ylabel() == label
    assert all("π" in tick.get_text() for tick in left.get_xticklabels())


@pytest.mark.slow
def test_branches_are_solid_where_stable_and_open_where_not() -> None:
    values = np.round(np.linspace(-0.6, 0.6, 7), 3)
    table = map_table(values, starts=60, crossings=60, noise=0.002)
    table = table.loc[(table["f"] < 0.5) | (table["crossing"] > 59)]  # no pairs at the last value
    figure = plot.draw("branches", table, y="delta_13", x="f")
    rendered(figure)
    axes = figure.axes[0]
    assert legend_texts(figure) == [
        "stable: starts nearby come to it",
        "unstable: starts nearby leave it",
        "none found",
    ]
    joined = {line.get_linestyle(): line for line in axes.lines if line.get_linestyle() in ("-", "--")}
    assert set(joined) == {"-", "--"}
    lone = [line for line in axes.lines if line.get_marker() == "|" and line.get_linestyle() == "None"]
    assert [np.asarray(line.get_xdata()).tolist() for line in lone] == [[0.6]]
    unstable = [
        line
        for line in axes.lines
        if line.get_marker() == "o" and to_hex(line.get_markerfacecolor()) == "#ffffff"
    ]
    (places,) = (np.asarray(line.get_xdata()).tolist() for line in unstable)
    assert places == [f for f in values if abs(f) < FOLD]


def test_lines_of_branches_of_lengths_are_not_interrupted() -> None:
    """Fixed points at 200 f, in mm: neighbours are more than pi apart, but no angle wraps between them."""
    x = np.linspace(-1.0, 1.0, 40)
    at = [0.0, 0.1, 0.2, 0.3]
    fixed = np.repeat(200.0 * np.array(at), 40)
    before = fixed + np.tile(20.0 * x, 4)
    height = np.stack([before, fixed + 0.5 * (before - fixed)], axis=1).ravel()
    row, crossing = np.repeat(np.arange(160), 2), np.tile([0, 1], 160)
    table = pd.DataFrame({"row": row, "f": np.repeat(at, 80), "crossing": crossing, "height_n": height})
    axes = plot.draw("branches", table, y="height", x="f", bandwidth=5.0).axes[0]
    (line,) = [line for line in axes.lines if line.get_linestyle() == "-"]
    assert np.asarray(line.get_ydata()).tolist() == pytest.approx([0.0, 20.0, 40.0, 60.0], abs=0.1)


def test_a_return_map_whose_points_lie_near_the_diagonal_is_drawn_as_the_change() -> None:
    for eps, form in ((0.02, "change of"), (0.9, "$\\Delta_{13}$ at")):
        table = map_table([0.0], starts=60, crossings=20, eps=eps)
        assert plot.return_map(table, y="delta_13").axes[0].get_ylabel().startswith(form)
