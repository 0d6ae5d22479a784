"""The figure of chains with unequal ends, from tables."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from gaitsweep import plot
from gaitsweep.papers.ambe2021.theory.chain import Chain
from gaitsweep.papers.ambe2021.theory.solution_sets import worst_case_cycles


def table() -> pd.DataFrame:
    rows = [
        (m_1, m_end, "direct" if m_1 > m_end else "retrograde", cycles)
        for m_1, m_end in ((0.9, 0.8), (0.8, 0.9), (0.9, 0.7), (0.9, 0.9))
        for cycles in (100, 300, 700)
    ]
    frame = pd.DataFrame(rows, columns=["m_1", "m_end", "gait", "cycles"])
    return frame.assign(status="settled", **{f"psi_{i}_end": 0.0 for i in (1, 2, 3)})


def test_drift_law_shows_the_most_and_the_median_beside_the_law() -> None:
    figure = plot.draw("drift_law", table())
    (axes,) = figure.axes
    (law,) = axes.get_lines()
    x, y = np.asarray(law.get_data(), float)
    assert x == pytest.approx([0.1, 0.2])  # equal masses are left out
    expected = [float(worst_case_cycles(3, Chain(m_1=0.9, m_end=m_end))) for m_end in (0.8, 0.7)]
    assert y == pytest.approx(expected, rel=0.02)
    dots = np.concatenate([np.asarray(collection.get_offsets()) for collection in axes.collections])
    places = {tuple(place) for place in np.round(dots, 6).tolist()}
    assert places == {(0.1, 700.0), (0.1, 300.0), (0.2, 700.0), (0.2, 300.0)}
    assert "kg" in axes.get_xlabel()


def test_drift_law_of_a_table_without_unequal_ends_says_so() -> None:
    figure = plot.drift_law(table().query("m_1 == m_end"))
    assert "unequal ends" in figure.axes[0].texts[0].get_text()
    with pytest.raises(plot.PlotError, match="m_end"):
        plot.drift_law(table().drop(columns="m_end"))


def test_drift_law_needs_one_value_of_what_else_the_law_has() -> None:
    rows = table()
    with pytest.raises(plot.PlotError, match="beta varies"):
        plot.drift_law(rows.assign(beta=np.linspace(0.7, 0.8, len(rows))))
    assert plot.drift_law(rows.assign(beta=0.8)).axes
    assert plot.drift_law(rows.assign(beta=0.8).head(0)).axes
    with pytest.raises(plot.PlotError, match="N varies"):  # a joined table
        plot.drift_law(rows.assign(N=np.arange(len(rows)) % 2 + 3))


@pytest.mark.slow
def test_the_law_of_a_parameter_that_follows_an_end_has_its_value_for_each_pair() -> None:
    rows = table()
    rows.attrs["job"] = {"model": "multilegged", "params": {"a_1": "0.4 * m_end / 0.8"}}
    (law,) = plot.drift_law(rows).axes[0].get_lines()
    at_0_2 = worst_case_cycles(3, Chain(m_1=0.9, m_end=0.7, a_1=0.35))
    assert np.asarray(law.get_ydata())[-1] == pytest.approx(float(at_0_2))


def test_drift_law_of_any_ends_is_drawn_over_the_drift() -> None:
    """Springs and amplitudes in one table: 0.9 b (10/9 - 1) for the softer spring, by hand."""
    ends = pd.DataFrame(
        {"kappa_1": [90.0, 100.0, 100.0], "kappa_end": 100.0, "a_1": 0.4, "a_end": [0.4, 0.48, 0.4]}
    )
    rows = ends.assign(gait="direct", cycles=[800, 500, 60], status="settled")
    rows = rows.assign(**{f"psi_{i}_end": 0.0 for i in (1, 2, 3)})
    (axes,) = plot.draw("drift_law", rows, of="ends").axes
    (law,) = axes.get_lines()
    b = 0.2 * np.pi * 9.8 / (100.0 * 0.4)
    drifts = [0.9 * b / 9.0, 0.9 * b / 6.0]  # equal ends are left out
    assert np.asarray(law.get_xdata(), float) == pytest.approx(drifts, abs=1e-8)
    with pytest.raises(plot.PlotError, match="kappa_1 and kappa_end, or a_1 and a_end"):
        plot.drift_law(rows.drop(columns=["kappa_1", "a_end"]), of="ends")
    with pytest.raises(plot.PlotError, match="one of m, kappa, a, ends"):
        plot.drift_law(rows, of="springs")
