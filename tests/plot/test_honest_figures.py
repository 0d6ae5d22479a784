"""Figures say of their tables what is missing in them, and draw no line where a table has no record."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection, QuadMesh
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure

from gaitsweep import plot
from gaitsweep.plot import FIGURES
from gaitsweep.plot.bifurcations.atlas import _events
from gaitsweep.plot.columns import rows_where
from gaitsweep.plot.footprint_diagrams import _guides
from gaitsweep.plot.provenance_marks import remarks
from tests.support.hysteresis_tables import map_table, ramp_table, staircase_table
from tests.support.plot_tables import AXES, crossing_table, rendered, settle_table, trace_table

ROOT = Path(__file__).parents[2]


def corner(figure: Figure) -> list[str]:
    rendered(figure)
    return [text.get_text() for text in figure.texts if text.get_color() == "#B00020"]


@pytest.mark.parametrize(
    ("share", "text"),
    [(0.0, "0"), (0.001, "<1"), (0.006, "1"), (0.994, "99"), (0.996, ">99"), (1.0, "100")],
)
def test_a_share_is_0_or_100_only_where_it_is(share: float, text: str) -> None:
    assert plot.theme.percent(share) == text


def figures() -> list[tuple[str, pd.DataFrame, dict[str, Any]]]:
    return [
        ("basin", settle_table(), {"x": "psi_1", "y": "psi_2", "panels": "psi_3", "title": "Basins"}),
        ("solution_set", settle_table(), {"axes": AXES}),
        ("cycles", crossing_table(), {"y": ["psi_1"]}),
        ("footprints", trace_table(), {"title": "Footprints"}),
        ("hysteresis", staircase_table(hold=5), {"y": "delta_13"}),
        ("return_map", map_table(starts=5, crossings=5), {"y": "delta_13"}),
        ("branches", map_table(starts=5, crossings=5), {"y": "delta_13", "x": "f"}),
        ("shock", settle_table().iloc[:16], {"x": "psi_1", "y": "psi_2"}),
    ]


@pytest.mark.slow("solution_set--", "footprints--", "shock--")
@pytest.mark.parametrize(
    ("kind", "table", "spec"), figures(), ids=lambda each: each if isinstance(each, str) else ""
)
def test_a_table_that_is_not_complete_is_marked(kind: str, table: pd.DataFrame, spec: dict) -> None:
    assert corner(plot.draw(kind, table, **spec)) == []
    table = table.copy()
    table.attrs |= {"complete": False, "rows_missing": 188, "manifest": {"rows": 1000}}
    figure = plot.draw(kind, table, **spec)
    assert corner(figure) == ["incomplete: 812 of 1000 rows"]
    assert corner(getattr(plot, kind)(table, **spec)) == ["incomplete: 812 of 1000 rows"]
    title = figure._suptitle  # type: ignore[attr-defined]
    if title is not None:
        (mark,) = [text for text in figure.texts if text.get_color() == "#B00020"]
        assert title.get_window_extent().y1 <= mark.get_window_extent().y0 + 1.0
        highest = max(axes.get_tightbbox().y1 for axes in figure.axes)  # type: ignore[union-attr]
        assert highest <= title.get_window_extent().y0 + 1.0


def test_long_remarks_are_broken_into_lines_of_the_figures_width() -> None:
    table = settle_table()
    differences = {"status_differs": 8, "count_differs": 2, "moved": 3, "gait_differs": 4}
    table.attrs["manifest"] = {"self_check": {"verdict": "warned", "rows": 32, **differences}}
    figure = plot.draw("basin", table, x="psi_1", y="psi_2", panels="psi_3", width="column")
    (text,) = corner(figure)
    assert text.count("\n") >= 1
    (mark,) = [text for text in figure.texts if text.get_color() == "#B00020"]
    box = mark.get_window_extent()
    assert box.x0 >= 0.0
    assert box.x1 <= figure.bbox.x1
    assert max(axes.get_tightbbox().y1 for axes in figure.axes) <= box.y0  # type: ignore[union-attr]


def test_every_kind_is_marked() -> None:
    assert all(hasattr(plot.drawing_function(figure), "__wrapped__") for figure in FIGURES.values())
    assert all(getattr(plot, kind) is plot.drawing_function(figure) for kind, figure in FIGURES.items())


def test_remarks() -> None:
    table = crossing_table()
    assert remarks(table) == []
    for verdict, told in (("passed", []), ("off", []), ("warned", ["self-check: warned"])):
        table.attrs = {
            "complete": True,
            "rows_missing": 0,
            "manifest": {"rows": 3, "self_check": {"verdict": verdict}},
        }
        assert remarks(table) == told
    table.attrs |= {"complete": False, "rows_missing": 1}
    assert remarks(table) == ["incomplete: 2 of 3 rows", "self-check: warned"]
    table.attrs = {"complete": False, "manifest": {"rows": 7}}
    assert remarks(table) == ["incomplete: 3 of 7 rows"]
    table.attrs = {"complete": False}
    assert remarks(table) == ["incomplete"]


def test_the_second_table_of_a_figure_is_marked_too() -> None:
    ramp, stairs = ramp_table(steps=60), staircase_table(hold=5)
    stairs.attrs |= {"complete": False, "rows_missing": 1, "manifest": {"rows": 2}}
    figure = plot.hysteresis(ramp, y="delta_13", with_table=stairs)
    assert corner(figure) == []
    assert figure.axes[1].get_title() == "held at each value\nincomplete: 1 of 2 rows"


def joined(axes: Axes) -> list[tuple[float, float, float, float]]:
    """Every straight piece of the lines of an axis: x, y of its two ends."""
    pieces = []
    for line in axes.lines:
        if line.get_linestyle() != "None":
            at = np.stack([np.asarray(each, float) for each in line.get_data()], axis=1)
            pieces += [(*a, *b) for a, b in itertools.pairwise(at) if np.isfinite([a, b]).all()]
    return pieces


def test_cycles_are_not_joined_over_crossings_that_are_not_there() -> None:
    table = crossing_table()
    holed = table.loc[table["crossing"] != 3]
    for each in (holed, table.assign(psi_1_n=table["psi_1_n"].where(table["crossing"] != 3))):
        pieces = joined(plot.cycles(each, y=["psi_1"]).axes[0])
        assert pieces
        assert not [piece for piece in pieces if piece[0] < 3 < piece[2]]


def test_a_ramp_is_not_joined_over_crossings_that_are_not_there() -> None:
    table = ramp_table(steps=200)
    lost = table["crossing"].between(100, 120)
    longest = [0.0, 0.0]
    for number, each in enumerate((table, table.assign(delta_13_n=table["delta_13_n"].where(~lost)))):
        each.attrs = table.attrs
        pieces = joined(plot.hysteresis(each, y="delta_13").axes[0])
        longest[number] = max(abs(x1 - x0) for x0, _, x1, _ in pieces)
    assert longest[1] == pytest.approx(longest[0])


def test_holds_on_two_branches_are_not_joined() -> None:
    pieces = joined(plot.hysteresis(staircase_table(), y="delta_13").axes[0])
    assert len(pieces) == 2 * (17 - 1) - 2
    assert max(abs(y1 - y0) for _, y0, _, y1 in pieces) < 0.1  # the jump is by 0.5 rad


def test_hysteresis_names_only_the_ways_that_are_there() -> None:
    table = ramp_table(steps=60)
    up = table.loc[table["pass"] == 0]
    figure = plot.hysteresis(up, y="delta_13")
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["$f$ rises →"]


def test_branches_are_not_joined_over_a_value_without_a_point() -> None:
    table = map_table([-0.1, 0.0, 0.1], starts=60, crossings=60)
    holed = table.assign(delta_13_n=table["delta_13_n"].where(table["f"] != 0.0))
    holed.attrs = table.attrs
    assert len(joined(plot.branches(table, y="delta_13", x="f").axes[0])) >= 6
    flat = [
        piece for piece in joined(plot.branches(holed, y="delta_13", x="f").axes[0]) if piece[0] != piece[2]
    ]
    assert flat == []


def test_an_angle_s_axis_goes_as_far_as_the_data() -> None:
    near = crossing_table()
    near["psi_1_n"] = 1.0 + 0.01 * near["crossing"]
    low, high = plot.cycles(near, y=["psi_1"]).axes[0].get_ylim()
    assert 0.9 < low < high < 1.2
    assert plot.cycles(crossing_table(), y=["psi_1"]).axes[0].get_ylim() == (0.0, pytest.approx(2 * np.pi))


def test_cells_that_were_not_simulated_are_counted_in_the_legend() -> None:
    table = settle_table()
    status = table["status"].astype(str)
    status[::4] = "inferred"
    figure = plot.basin(table.assign(status=status), x="psi_1", y="psi_2", panels="psi_3")
    assert "25 % of cells inferred" in figure.legends[0].get_title().get_text()
    assert (
        "inferred"
        not in plot.basin(table, x="psi_1", y="psi_2", panels="psi_3").legends[0].get_title().get_text()
    )


def test_footprints_name_only_the_guides_that_are_drawn() -> None:
    words = [text.get_text() for text in plot.footprints(trace_table()).legends[0].get_texts()]
    assert words == ["swings pass backwards, as in a retrograde wave"]


def test_swings_half_a_cycle_apart_are_joined_one_by_one() -> None:
    axes = Figure().add_subplot()
    swings = np.arange(6.0)
    assert len(_guides(axes, [swings, swings + 0.5], 1.0, free=1)) == 1
    assert [np.asarray(line.get_xdata())[1] for line in axes.lines] == (swings + 0.5).tolist()


def branch(row: int, mass: float, low: float, high: float, gait: str = "trot") -> pd.DataFrame:
    """A stable branch of eleven points over f, as a continuation leaves it."""
    f = np.linspace(low, high, 11)
    records = {"row": row, "mass": mass, "point": np.arange(11), "f": f, "delta_13": 2.0 + 0.1 * f}
    return pd.DataFrame(records | {"stable": True, "special": "", "end": [""] * 10 + ["range"], "gait": gait})


def followed(*branches: pd.DataFrame) -> pd.DataFrame:
    table = pd.concat(branches, ignore_index=True)
    table.attrs["job"] = {"run": {"parameter": "f"}}
    return table


def test_a_branch_is_not_joined_over_points_that_are_not_there() -> None:
    table = followed(branch(0, 1.0, 0.0, 1.0))
    lost = table["point"].between(4, 5)
    for each in (table.loc[~lost], table.assign(delta_13=table["delta_13"].where(~lost))):
        each.attrs = table.attrs
        pieces = joined(plot.continuation(each, y="delta_13").axes[0])
        assert len(pieces) == 3 + 4
        assert max(x1 - x0 for x0, _, x1, _ in pieces) == pytest.approx(0.1)


def test_a_point_whose_stability_is_missing_is_not_called_stable() -> None:
    table = followed(branch(0, 1.0, 0.0, 1.0))
    for missing in (pd.NA, np.nan):
        stable = table["stable"].astype(object)
        stable[3] = missing
        poor = table.assign(stable=stable)
        poor.attrs = table.attrs
        with pytest.raises(plot.PlotError, match="stable has no value at some points"):
            plot.continuation(poor, y="delta_13")


def test_both_directions_of_a_map_are_lines_of_their_own() -> None:
    """`continue_` follows a branch both ways from one point; y is the map's first coordinate."""
    both = [branch(0, 1.0, 0.5, end).assign(direction=way) for way, end in ((1, 1.0), (-1, 0.0))]
    table = followed(*both)
    table.attrs["recorded"] = ["delta_13"]
    pieces = joined(plot.continuation(table).axes[0])
    assert len(pieces) == 20
    assert max(abs(x1 - x0) for x0, _, x1, _ in pieces) == pytest.approx(0.05)
    del table.attrs["recorded"]
    with pytest.raises(plot.PlotError, match=r"give y\. Allowed: row, mass, point, f, delta_13"):
        plot.continuation(table)


def test_branches_of_angles_stay_within_a_turn_and_their_lines_end_at_its_cut() -> None:
    """One branch turns all the way round, so that a line has to end somewhere; the other lies beside it."""
    turning, other = branch(0, 1.0, 0.0, 1.0), branch(1, 1.0, 0.0, 1.0)
    table = followed(
        turning.assign(delta_13=np.linspace(5.0, 11.0, 11)), other.assign(delta_13=np.linspace(7.0, 7.1, 11))
    )
    axes = plot.continuation(table, y="delta_13").axes[0]
    pieces = joined(axes)
    assert len(pieces) == 9 + 10
    assert max(abs(y1 - y0) for _, y0, _, y1 in pieces) == pytest.approx(0.6)
    heights = [y for _, *ends in ((0, p[1], p[3]) for p in pieces) for y in ends]
    assert max(heights) - min(heights) < 2.0 * np.pi
    flat = followed(branch(0, 1.0, 0.0, 1.0).assign(delta_13=np.linspace(1.0, 1.0 + 1e-7, 11)))
    figure = plot.continuation(flat, y="delta_13")
    figure.draw_without_rendering()
    assert figure.axes[0].yaxis.get_offset_text().get_text() == ""


def test_phase_shifts_are_not_joined_where_a_row_returns_to_another_crossing() -> None:
    """Three alike crossings: the shift jumps by a third of the period, and once from 1/2 to -1/2."""
    phase = np.linspace(0.0, 0.95, 20)
    shift = 0.02 * np.sin(2.0 * np.pi * phase) + np.where(phase > 0.475, 0.49, 1.0 / 6.0)
    shift = np.where(phase > 0.775, shift - 1.0, shift)
    axes = plot.draw("phase_response", pd.DataFrame({"push_phase": phase, "phase_shift": shift})).axes[0]
    pieces = [p for p in joined(axes) if p[0] != p[2] and p[2] - p[0] < 0.1]
    assert len(pieces) == 17
    assert max(abs(y1 - y0) for _, y0, _, y1 in pieces) < 0.02


def test_no_area_of_stability_goes_over_a_value_at_which_there_is_none() -> None:
    """The trot is stable at masses of 1, 2, 4 and 5, the walk alone at 3: two areas, not one."""
    rows = [
        branch(k, mass, 0.0, 1.0, "walk" if mass == 3.0 else "trot")
        for k, mass in enumerate([1.0, 2.0, 3.0, 4.0, 5.0])
    ]
    areas = plot.stable_ranges(followed(*rows), y="mass").axes[0].collections
    corners = [np.asarray(path.vertices) for path in areas[0].get_paths()]
    heights = [sorted({round(float(y), 9) for y in each[:, 1]}) for each in corners]
    assert heights == [[1.0, 2.0], [4.0, 5.0]]


def test_a_gait_that_is_stable_at_one_value_has_a_line_and_no_overlap_with_others() -> None:
    """The trot is stable at 1 and 2, the walk at 3 alone: never both; a row without a value is left out."""
    rows = [branch(k, k + 1.0, 0.2, 0.8, "walk" if k == 2 else "trot") for k in range(3)]
    rows += [branch(3, np.nan, 0.0, 1.0, "pace"), branch(4, 2.0, 0.0, 1.0).assign(gait=None)]
    figure = plot.stable_ranges(followed(*rows), y="mass")
    lines = [each for each in figure.axes[0].collections if isinstance(each, LineCollection)]
    assert [line.get_segments()[0].tolist() for line in lines] == [[[0.2, 3.0], [0.8, 3.0]]]
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["trot stable", "walk stable"]


def test_a_branch_of_one_point_is_drawn() -> None:
    """The table has a column whose name is a number, as an unnamed one of the reader's."""
    table = followed(branch(0, 1.0, 0.3, 0.7).iloc[:1].assign(delta_13=1.0))
    table[0] = 5.0
    drawn = [np.asarray(line.get_xydata()) for line in plot.continuation(table, y="delta_13").axes[0].lines]
    assert [line.tolist() for line in drawn if len(line)] == [[[0.3, 1.0]]]


def test_a_parameter_is_no_event_of_a_family_of_orbits() -> None:
    """Its name begins as those of the times of events do."""
    table = pd.read_parquet(ROOT / "docs/gallery/orbit_family.parquet")
    events = ["foot lands", "foot lifts off", "apex"]
    assert [*_events(table, table).values()] == events
    table.insert(1, "t_off", 0.1)
    table.attrs["quantities"]["t_off"] = {"unit": "s", "meaning": "time without contact"}
    assert [*_events(table, table).values()] == events


@pytest.mark.parametrize(("at", "shown"), [(None, 60.0), (68.0, 68.0)])
def test_a_road_map_shows_where_gaits_were_searched(at: float | None, shown: float) -> None:
    """By default at the beginning of the path; the job then has no value there."""
    table = pd.read_parquet(ROOT / "docs/gallery/orbit_family.parquet")
    table = rows_where(table, table["number"] == 0)
    table.attrs["job"]["run"] |= {"at": at, "path": [60.0, 75.0]}
    lines = plot.road_map(table).axes[0].lines
    assert [line.get_xdata() for line in lines if line.get_color() == "#BBBBBB"] == [[shown, shown]]


def test_rows_that_have_not_settled_are_open_among_speeds() -> None:
    from gaitsweep.papers.fukuoka2015.figures.gait_ramp import _bands

    part = pd.DataFrame(
        {"gait": ["trot"] * 3, "speed": [0.1, 0.5, 0.9], "status": ["settled", "cycle_limit", "complete"]}
    )
    axes = Figure().subplots()
    _bands(axes, part, "gait", ["trot"], "speed", 0.8)
    faces = {tuple(np.asarray(line.get_xdata()).tolist()): line.get_markerfacecolor() for line in axes.lines}
    assert faces[(0.5,)] == "white"
    assert faces[(0.1, 0.9)] != "white"


def cells_of(axes: Axes) -> tuple[np.ndarray, np.ndarray]:
    """The corners of the cells of a map of five by five, and their colours."""
    mesh = axes.collections[0]
    assert isinstance(mesh, QuadMesh)
    return np.asarray(mesh.get_coordinates()), np.asarray(mesh.get_facecolor()).reshape(5, 5, 4)


@pytest.mark.slow
def test_cells_that_are_not_there_stay_white_at_their_own_size() -> None:
    """Two of five columns are missing in one panel, and one row in all: their neighbours do not grow."""
    table = settle_table(5)
    first = table["psi_3"] == table["psi_3"].min()
    columns, rows = np.unique(table["psi_1"]), np.unique(table["psi_2"])
    kept = table.loc[~((first & table["psi_1"].isin(columns[1:3].tolist())) | (table["psi_2"] == rows[2]))]
    figure = plot.basin(kept, x="psi_1", y="psi_2", panels="psi_3")
    rendered(figure)
    for number, axes in enumerate(figure.axes):
        corners, colours = cells_of(axes)
        np.testing.assert_allclose(np.diff(corners[0, :, 0]), 2 * np.pi / 5)
        np.testing.assert_allclose(np.diff(corners[:, 0, 1]), 2 * np.pi / 5)
        drawn = colours[:, :, 3] > 0
        there = np.ones((5, 5), bool)
        there[2] = False
        if number == 0:
            there[:, 1:3] = False
        np.testing.assert_array_equal(drawn, there)


def test_a_gait_map_does_not_stretch_its_cells_either() -> None:
    table = settle_table(5)
    rows = np.unique(table["psi_2"])
    figure = plot.gait_map(table.loc[table["psi_2"] != rows[2]], x="psi_1", y="psi_2")
    rendered(figure)
    corners, colours = cells_of(figure.axes[0])
    np.testing.assert_allclose(np.diff(corners[:, 0, 1]), 2 * np.pi / 5)
    assert not colours[2, :, 3].any()


def corners_of(figure: Any) -> list[np.ndarray]:
    """The corners of the cells of each mesh of a figure's first panel."""
    meshes = [mesh for mesh in figure.axes[0].collections if isinstance(mesh, QuadMesh)]
    return [np.asarray(mesh.get_coordinates()) for mesh in meshes]


def table_over(values: list[float], **job: Any) -> pd.DataFrame:
    """A table of one row for each pair of values of kappa and beta."""
    table = pd.DataFrame(list(itertools.product(values, [0.6, 0.7])), columns=["kappa", "beta"])
    table.insert(0, "row", range(len(table)))
    table["status"], table["gait"] = "settled", "direct"
    table.attrs["job"] = {"model": "multilegged", "vary": {"kappa": values, "beta": [0.6, 0.7]}, **job}
    return table


def test_uneven_values_of_a_list_leave_no_blank_cells() -> None:
    """All multiples of a step between them would be cells without a row; a missing one of the list is."""
    values = [50.0, 100.0, 200.0]
    (corners,) = corners_of(plot.basin(table_over(values), x="kappa", y="beta"))
    assert corners[0, :, 0].tolist() == [25.0, 75.0, 150.0, 250.0]
    partial = table_over(values).query("kappa != 100")
    (corners,) = corners_of(plot.basin(partial, x="kappa", y="beta"))
    assert corners[0, :, 0].tolist() == [25.0, 75.0, 150.0, 250.0]
    steps = {"kappa": {"linspace": [50, 200, 4]}, "beta": [0.6, 0.7]}
    (corners,) = corners_of(plot.basin(table_over(values, vary=steps), x="kappa", y="beta"))
    assert corners[0, :, 0].tolist() == [25.0, 75.0, 125.0, 175.0, 225.0]


def test_shares_over_two_parameters_are_of_rows() -> None:
    def caption(table: pd.DataFrame, **spec: Any) -> str:
        (legend,) = plot.basin(table, **spec).legends
        return legend.get_title().get_text()

    table = table_over([50.0, 100.0])
    assert caption(table, x="kappa", y="beta") == "share of rows"
    starts = table.rename(columns={"kappa": "psi_1"})
    starts.attrs = table.attrs
    assert caption(starts, x="psi_1", y="beta") == "share of starts"


def test_lines_of_cycles_may_have_no_value_of_their_hue() -> None:
    """A missing number is another object in each row, and a single observable may stand without a list."""
    table = crossing_table()
    table["depth"] = np.where(table["row"] == 0, 1.0, np.nan)
    figure = plot.cycles(table, y="psi_1", hue="depth")
    assert len(figure.axes) == 1
    (legend,) = figure.legends
    assert [text.get_text() for text in legend.get_texts()] == ["1.0", "none"]


def test_many_lines_of_texts_have_colours_in_turn() -> None:
    """A column of texts has no colour scale."""
    amounts = [f"push {number}" for number in range(9)]
    table = pd.DataFrame({"push_phase": 0.5, "phase_shift": 0.1, "who": amounts})
    assert len(plot.phase_response(table, hue="who").axes[0].lines) == 10


def test_more_numbers_of_steps_than_colours_are_drawn() -> None:
    table = pd.DataFrame({"row": range(4), "roughness": [0.1, 0.1, 0.2, 0.2], "cycles": 20})
    table["status"] = "complete"
    figure = plot.survival(table, x="roughness", steps=range(1, 11))
    assert len(figure.axes[0].containers) == 10


def test_infinite_numbers_have_colours_beyond_the_scale_of_the_finite_ones() -> None:
    table = settle_table()
    table["speed"] = np.linspace(0.0, 1.0, len(table))
    table.loc[1, "speed"] = np.inf
    figure = plot.basin(table, x="psi_1", y="psi_2", panels="psi_3", hue="speed")
    panel, bar = figure.axes[0], figure.axes[-1]
    rendered(figure)
    assert bar.get_ylabel() == "speed\n(arrow: infinite)"
    mesh = panel.collections[0]
    assert isinstance(mesh, QuadMesh)
    assert mesh.get_clim() == (0.0, 1.0)
    colours = np.asarray(mesh.get_facecolor()).reshape(4, 4, 4)
    assert np.argwhere((colours == to_rgba("#D55E00")).all(axis=-1)).tolist() == [[0, 1]]

    branches = followed(branch(0, 1.0, 0.0, 1.0), branch(1, 2.0, 0.0, 1.0), branch(2, -np.inf, 0.0, 1.0))
    figure = plot.continuation(branches, y="delta_13", hue="mass")
    assert figure.axes[-1].get_ylim() == (1.0, 2.0)
    pushes = [
        pd.DataFrame({"push_phase": [0.2, 0.7], "phase_shift": 0.1 * k, "amount": amount})
        for k, amount in enumerate([*range(9), np.inf])
    ]
    figure = plot.phase_response(pd.concat(pushes), hue="amount")
    assert figure.axes[-1].get_ylim() == (0.0, 8.0)
    assert to_rgba(figure.axes[0].lines[9].get_color()) == to_rgba("#D55E00")


def test_an_interval_shows_in_the_gaps_of_dashes() -> None:
    table = followed(branch(0, 1.0, 0.0, 1.0).assign(stable=False))
    figure = plot.continuation(table, y="delta_13", intervals={"lost": [-0.5, 1.5]})
    rendered(figure)
    axes = figure.axes[0]
    axes.set_xlim(0.0, 1.0)
    figure.set_layout_engine("none")
    canvas = figure.canvas
    assert isinstance(canvas, FigureCanvasAgg)
    canvas.draw()
    pixels = np.asarray(canvas.buffer_rgba())[::-1, :, :3]
    inside = axes.get_window_extent().padded(-4.0)
    panel = pixels[int(inside.y0) : int(inside.y1), int(inside.x0) : int(inside.x1)]
    assert panel.size
    assert panel.min(axis=2).max() < 255  # no pixel is white
