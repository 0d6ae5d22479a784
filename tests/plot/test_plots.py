"""Figures from small synthetic tables: what they show and what they say."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from matplotlib.collections import Collection, QuadMesh
from matplotlib.colors import to_hex, to_rgba
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from mpl_toolkits.mplot3d import Axes3D

from gaitsweep import models, plot
from gaitsweep.extension import gait_styles
from gaitsweep.papers.ambe2021.figures.solution_set import chain_of
from gaitsweep.papers.ambe2021.theory.chain import Chain
from gaitsweep.plot import PlotError
from gaitsweep.plot.column_labels import axis_label, row_names, written
from gaitsweep.plot.limbs import limb_colours
from gaitsweep.plot.theme import COLOURS, HATCH
from tests.support.plot_tables import (
    AXES,
    POINTS,
    TURN,
    crossing_table,
    legend_texts,
    rendered,
    settle_table,
    trace_table,
)


def texts(figure: Figure) -> list[str]:
    return [text.get_text() for legend in figure.legends for text in legend.get_texts()]


def faces(part: Collection) -> np.ndarray:
    """The colours of the faces of a collection: (faces, 4)."""
    return np.asarray(part.get_facecolor())


def test_basin_names_axes_panels_and_shares() -> None:
    figure = plot.draw("basin", settle_table(), x="psi_1", y="psi_2", panels="psi_3", title="Slices")
    rendered(figure)
    titles = [axes.get_title().partition("\n") for axes in figure.axes]
    assert [value for value, _, _ in titles] == [
        r"$\psi_{3}$ = $0.4\,\pi$",
        r"$\psi_{3}$ = $\pi$",
        r"$\psi_{3}$ = $1.6\,\pi$",
    ]
    shares = {" ".join(shares.split()) for _, _, shares in titles}
    assert {text.replace(",", "") for text in shares} == {"direct 25 % source 25 % retrograde 50 %"}
    assert figure.axes[0].get_xlabel() == r"$\psi_{1}$ (rad)"
    assert figure.axes[0].get_ylabel() == r"$\psi_{2}$ (rad)"
    assert [tick.get_text() for tick in figure.axes[0].get_xticklabels()] == ["0", "π/2", "π", "3π/2", "2π"]
    assert texts(figure) == ["direct", "source", "retrograde"]
    assert [to_hex(patch.get_facecolor()) for patch in figure.legends[0].get_patches()] == [
        gait_styles()[gait][0].lower() for gait in ("direct", "source", "retrograde")
    ]
    assert figure.get_suptitle() == "Slices"
    cells = faces(figure.axes[0].collections[0]).reshape(4, 4, 4)
    assert (cells[:, 0] == to_rgba(gait_styles()["direct"][0])).all()
    assert (cells[:, 1:3] == to_rgba(gait_styles()["retrograde"][0])).all()


def test_basin_without_gaits_describes_its_axes_and_proposes_a_hue() -> None:
    table = settle_table().iloc[:16].assign(gait="none").rename(columns={"psi_1": "launch_0"})
    table.attrs["quantities"] = {"launch_0": {"unit": "m/s", "meaning": "speed at the start"}}
    figure = plot.draw("basin", table, x="launch_0", y="psi_2")
    assert figure.axes[0].get_xlabel() == "speed at the start (m/s)"
    assert "psi_1_end as hue" in figure.legends[0].get_title().get_text()


def test_basin_has_the_legends_colours_in_every_panel_whatever_the_gaits_are_called() -> None:
    """A model's own gaits have no colour of their own, and come in another order in each panel."""
    table = settle_table()
    names = {"direct": "hop", "source": "skip", "retrograde": "jump"}
    table["gait"] = table["gait"].cat.rename_categories(names)
    # the first panel begins with a jump
    table = table.loc[(table["psi_3"] > 2.0) | (table["psi_1"] > TURN / 2)]
    figure = plot.basin(table, x="psi_1", y="psi_2", panels="psi_3")
    rendered(figure)
    key = {text.split()[0]: patch.get_facecolor() for text, patch in _key(figure)}
    first, second = (faces(axes.collections[0]).reshape(4, -1, 4) for axes in figure.axes[:2])
    assert tuple(first[0, 2]) == tuple(second[0, 2]) == key["jump"]
    assert tuple(second[0, 0]) == key["hop"]
    assert tuple(first[0, 3]) == tuple(second[0, 3]) == key["skip"]
    assert not first[0, :2, 3].any(), "cells that are not there are white"


def _key(figure: Figure) -> list[tuple[str, Patch]]:
    return list(zip(legend_texts(figure), figure.legends[0].get_patches(), strict=True))


def test_basin_hatches_rows_that_failed_and_leaves_missing_cells_white() -> None:
    table = settle_table()
    table.loc[table["row"] == 0, "status"] = "fell"
    table.loc[table["row"] == 2, "status"] = "cycle_limit"
    table = table.loc[table["row"] < 15]  # the first panel, its last cell missing
    figure = plot.basin(table, x="psi_1", y="psi_2")
    rendered(figure)
    assert {"not settled  7 %", "failed  7 %"} < set(texts(figure))
    assert len([patch for patch in figure.axes[0].patches if patch.get_hatch() == HATCH]) == 2
    cells = faces(figure.axes[0].collections[0]).reshape(4, 4, 4)
    assert cells[3, 3, 3] == 0.0
    assert tuple(cells[0, 0]) == to_rgba(COLOURS["failed"])


def test_basin_with_a_numeric_hue_has_a_colour_scale() -> None:
    figure = plot.basin(settle_table(), x="psi_1", y="psi_2", panels="psi_3", hue="cycles")
    rendered(figure)
    assert figure.axes[-1].get_ylabel() == "cycles"
    assert not legend_texts(figure)


def test_a_colour_scale_is_that_of_the_rows_that_are_not_hatched() -> None:
    table = settle_table()
    table["cycles"] = 50 + table["row"]
    table.loc[table["row"] == 0, ["status", "cycles"]] = "cycle_limit", 9000
    figure = plot.basin(table, x="psi_1", y="psi_2", panels="psi_3", hue="cycles")
    rendered(figure)
    mesh = figure.axes[0].collections[0]
    assert isinstance(mesh, QuadMesh)
    assert mesh.get_clim() == (51, 97)
    assert np.isnan(np.asarray(mesh.get_array(), float)).sum() == 1


def test_basin_of_starts_on_no_grid_is_drawn_as_points() -> None:
    random = np.random.default_rng(0)
    table = settle_table(6)
    table["psi_1"], table["psi_2"] = random.uniform(0, TURN, (2, len(table)))
    figure = plot.basin(table, x="psi_1", y="psi_2")
    rendered(figure)
    assert len(figure.axes[0].collections) == 3


def test_basin_refuses_a_cell_of_several_rows() -> None:
    with pytest.raises(PlotError, match="Name psi_3 as `panels`"):
        plot.basin(settle_table(), x="psi_1", y="psi_2")


def test_solution_set_has_three_panels_lines_points_and_counts() -> None:
    table = settle_table()
    table.loc[0, "status"] = "cycle_limit"
    figure = plot.draw("solution_set", table, axes=AXES, points=POINTS)
    rendered(figure)
    space, low, high = figure.axes
    assert isinstance(space, Axes3D)
    assert [space.get_xlabel(), space.get_ylabel(), space.get_zlabel()] == [
        rf"$\psi_{{{i}}}$ (rad)" for i in (1, 2, 3)
    ]
    assert (low.get_xlabel(), high.get_ylabel()) == (r"$\psi_{1}$ (rad)", r"$\psi_{3}$ (rad)")
    assert {text.get_text() for text in low.texts} == {"a", "b", "c"}
    assert legend_texts(figure) == [
        "direct (11)",
        "source (12)",
        "retrograde (24)",
        "not settled: 1, not shown",
        "analytic solutions",
    ]
    reached = np.concatenate([np.array(line.get_xydata()) for line in low.lines])
    assert len(low.lines) == len(high.lines) == len(space.lines)
    assert np.linalg.norm(reached - [3.97, 5.29], axis=1).min() < 2.2  # pieces are lines: their ends
    direct = [part for part in low.collections if len(np.asarray(part.get_offsets())) == 11]
    assert to_hex(faces(direct[0])[0]) == gait_styles()["direct"][0].lower()


def test_solution_set_marks_points_within_its_axes() -> None:
    """Angles of marked points are those of the states, from 0 to 2 pi."""
    figure = plot.solution_set(settle_table(), axes=AXES, points={"a": [-0.5, 1.0, 7.0]})
    rings = np.array(figure.axes[1].collections[-1].get_offsets())
    np.testing.assert_allclose(rings, [[TURN - 0.5, 1.0]])
    np.testing.assert_allclose(np.array(figure.axes[2].collections[-1].get_offsets()), [[1.0, 7.0 - TURN]])


def test_solution_set_takes_the_theory_from_the_jobs_parameters() -> None:
    table = settle_table()
    even = {"kappa_1": 100.0, "kappa_end": 100.0, "a_1": 0.4, "a_end": 0.4}
    assert chain_of(table) == Chain(**even)
    table.attrs["job"] = {
        "params": {"beta": 0.7, "m_B": 0.8, "m_1": "m_B", "m_end": "m_B", "sigma": "2*sqrt(kappa)"}
    }
    assert chain_of(table) == Chain(beta=0.7, m_1=0.8, m_end=0.8, **even)
    table.attrs["job"] = {"params": {"m_B": 0.7}}
    assert chain_of(table) == Chain(m_1=0.7, m_end=0.7, **even)


def test_solution_set_says_why_it_has_no_lines() -> None:
    table = settle_table()
    table["beta"] = np.linspace(0.7, 0.8, len(table))
    figure = plot.solution_set(table, axes=AXES)
    rendered(figure)
    assert figure.legends[0].get_title().get_text() == "No analytic solutions are drawn: beta varies."
    assert not plot.solution_set(settle_table(), axes=AXES, theory=False).axes[1].lines
    other = settle_table()
    other.attrs["job"] = {"model": "lab:Ring", "params": {"pull": 0.2}}
    title = plot.solution_set(other, axes=AXES).legends[0].get_title().get_text()
    assert title == "No analytic solutions are drawn: they are those of the multi-legged chain."
    with pytest.raises(PlotError, match="not of the multi-legged chain"):
        plot.chain_theory(other, show="sets")
    with pytest.raises(PlotError, match="three axes"):
        plot.solution_set(table, axes=AXES, points={"a": [1.0, 2.0]})
    with pytest.raises(PlotError, match="three observables"):
        plot.solution_set(table, axes=AXES[:2])


def test_cycles_break_lines_where_an_angle_wraps() -> None:
    figure = plot.draw("cycles", crossing_table(), y=["psi_1"])
    rendered(figure)
    axes = figure.axes[0]
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("cycle", r"$\psi_{1}$ (rad)")
    longest = max(axes.lines, key=lambda line: np.size(line.get_xdata()))
    assert np.isnan(longest.get_ydata()).sum() == 1  # of the start at 5.9
    steps = np.abs(np.diff(np.asarray(longest.get_ydata(), float)))
    assert np.nanmax(steps) < np.pi
    assert legend_texts(figure) == ["(0.50)", "(3.00)", "(5.90)"]
    assert len({line.get_color() for line in axes.lines}) == 3


def test_cycles_mark_where_a_row_failed() -> None:
    table = crossing_table()
    table.loc[table["row"] == 1, "status"] = "fell"
    table = table.loc[~((table["row"] == 1) & (table["crossing"] > 2))]
    table.loc[table["row"] == 2, "psi_1_n"] = np.nan
    figure = plot.cycles(table, y=["psi_1"])
    rendered(figure)
    crosses = [line for line in figure.axes[0].lines if line.get_marker() == "x"]
    assert [np.asarray(line.get_xdata()).tolist() for line in crosses] == [[2.0]]


def test_footprints_put_leg_1_on_top_and_count_cycles() -> None:
    figure = plot.draw("footprints", trace_table(), titles=["first"])
    rendered(figure)
    first, second = (axes for axes in figure.axes if axes.get_yticklabels())
    assert [tick.get_text() for tick in first.get_yticklabels()] == ["leg 1", "leg 2", "leg 3", "leg 4"]
    assert first.yaxis_inverted()
    assert (first.get_title("left"), second.get_title("left")) == ("first", "row 1")
    assert second.get_xlabel() == "time (s)"
    assert [above.get_xlabel() for above in first.child_axes] == ["cycles of 15.00 s"]
    bars = first.collections[0].get_paths()[0].get_extents()
    assert (bars.x0, bars.x1) == pytest.approx((0.0, 12.0), abs=0.06)
    assert to_hex(faces(first.collections[0])[0]) == "#000000"
    # each leg after the one before it
    assert {line.get_color() for line in first.lines} == {gait_styles()["retrograde"][0]}
    assert not plot.footprints(trace_table(), guides=False).axes[0].lines


def test_footprints_of_a_window() -> None:
    table = trace_table()
    low, high = np.quantile(table["t"].dropna(), [0.25, 0.75])
    axes = plot.footprints(table, window=(low, high), guides=False).axes[0]
    begin, end = axes.get_xlim()
    assert low <= begin < end <= high


def test_footprints_show_a_window_and_name_limbs_as_movies_do() -> None:
    table = trace_table(rows=1)
    table.attrs["job"] = {"model": "waist_quadruped", "structure": {}, "run": {"kind": "trace"}}
    figure = plot.draw("footprints", table, window=[20.0, 40.0], guides=False)
    axes = figure.axes[0]
    assert axes.get_xlim() == (20.0, 40.0)
    limbs = models.find("waist_quadruped")().limbs
    assert [tick.get_text() for tick in axes.get_yticklabels()] == [limb.name for limb in limbs]
    bars = [to_hex(faces(bar)[0]) for bar in axes.collections]
    assert bars == [colour.lower() for colour in limb_colours(limbs)]
    assert len(set(bars)) == 4
    above = axes.child_axes[0]
    rendered(figure)
    assert above.get_xlim() == pytest.approx((0.0, 20.0 / 15.0))
    beyond = plot.draw("footprints", table, window=[60.0, 70.0]).axes[0]
    (reason,) = beyond.texts
    assert " ".join(reason.get_text().split()) == "This row was recorded from 0 to 49.95 s only."


def test_rows_are_named_by_what_differs_between_them() -> None:
    table = trace_table(rows=3)
    table.insert(1, "beta", 0.8)
    table.insert(2, "psi_1", table["row"] * np.pi / 2)
    assert row_names(table) == {
        0: r"$\psi_{1}$ = $0$",
        1: r"$\psi_{1}$ = $0.5\,\pi$",
        2: r"$\psi_{1}$ = $\pi$",
    }
    assert row_names(table, without=["psi_1"]) == {0: "row 0", 1: "row 1", 2: "row 2"}


def test_footprints_of_many_legs_and_of_rows_without_samples() -> None:
    table = trace_table(10, 1)
    lost = pd.DataFrame({"row": [1], "t": [np.nan], "status": ["fell"]})
    figure = plot.footprints(
        pd.concat([table, lost], ignore_index=True), titles=["ten", "lost", "not there yet"]
    )
    rendered(figure)
    assert figure.axes[1].get_title("left") == "lost"
    assert [" ".join(text.get_text().split()) for text in figure.axes[1].texts] == [
        "No sample of this row was recorded."
    ]


@pytest.mark.parametrize("panels", [None, "beta"])
def test_a_panel_of_footprints_shows_one_row(panels: str | None) -> None:
    table = trace_table().assign(beta=0.5)
    with pytest.raises(PlotError, match=r"Rows 0 and 1 would share a panel .* panels: row"):
        plot.footprints(table, panels=panels)
    assert len(plot.footprints(table.query("row == 1"), panels=panels).axes) == 1


def test_names_on_axes() -> None:
    table = settle_table()
    assert axis_label(table, "psi_1_end") == r"$\psi_{1}$ (rad)"
    assert axis_label(table, "kappa") == r"$\kappa$"
    assert axis_label(table, "m_B") == "$m_{B}$"
    assert axis_label(table, "t_end") == "time at the end (s)"
    table.attrs["quantities"] = {"kappa": {"unit": "N/m", "symbol": r"\kappa"}, "heading": {"circular": True}}
    assert axis_label(table, "kappa") == r"$\kappa$ (N/m)"
    assert axis_label(table, "heading") == "heading (rad)"
    table.attrs["quantities"] = {"kappa": {"unit": "$\\bm{N}$", "symbol": r"\bm{\kappa}"}}
    assert axis_label(table, "kappa") == r"$\kappa$ (\$\bm{N}\$)"  # what Matplotlib cannot set
    assert written(table, "beta", 0.8) == r"$\beta$ = 0.8"
    assert written(table, "psi_2", 0.0) == r"$\psi_{2}$ = $0$"
