"""Figures of hysteresis from small synthetic tables."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from matplotlib.colors import to_hex, to_rgb
from matplotlib.patches import FancyArrowPatch, Rectangle

from gaitsweep import plot
from gaitsweep.analysis.transitions.jumps import jumps
from gaitsweep.plot import PlotError
from gaitsweep.plot.bifurcations.passes import DOWN, UP
from tests.support.hysteresis_tables import (
    CENTRE,
    FOLD,
    delta,
    half_turn_table,
    map_table,
    ramp_table,
    staircase_table,
)
from tests.support.plot_tables import legend_texts, rendered


def bars(axes) -> dict[str, list[float]]:
    """The ends of the bars at jumps, by colour; rising passes have theirs at the top."""
    found: dict[str, list[float]] = {}
    for patch in (each for each in axes.patches if isinstance(each, Rectangle)):
        low, high = patch.get_y(), patch.get_y() + patch.get_height()
        if (low, high) == (0.0, 1.0):
            assert (patch.get_alpha(), patch.get_hatch()) == (0.1, None)  # points stay visible over the tint
            continue
        assert low > 0.9 if to_hex(patch.get_facecolor()).upper() == UP else high < 0.1
        ends = [patch.get_x(), patch.get_x() + patch.get_width()]
        found[to_hex(patch.get_facecolor()).upper()] = sorted(ends)
    return found


def test_a_parameter_without_a_symbol_is_named_along_its_axis_as_in_the_legend() -> None:
    table = staircase_table().rename(columns={"f": "bias"})
    table.attrs["quantities"] = {"bias": {"unit": "rad", "meaning": "angle of the waist"}}
    axes = plot.draw("hysteresis", table, y="delta_13", parameter="bias").axes[0]
    assert axes.get_xlabel() == "angle of the waist, bias\u00a0(rad)"


def test_hysteresis_of_a_staircase_marks_the_jumps() -> None:
    figure = plot.draw("hysteresis", staircase_table(), y="delta_13", title="Hysteresis")
    rendered(figure)
    axes = figure.axes[0]
    assert axes.get_xlabel() == "stiffness frequency of the joint, $f$ (Hz)"
    assert axes.get_ylabel() == "phase of the fore leg ahead of\nthe hind leg, $\\Delta_{13}$ (rad)"
    assert axes.get_title() == "held at each value"
    assert legend_texts(axes) == ["$f$ rises: 0.3 to 0.4 Hz", "$f$ falls: −0.4 to −0.3 Hz"]
    assert bars(axes) == {UP: pytest.approx([0.3, 0.4]), DOWN: pytest.approx([-0.4, -0.3])}
    assert legend_texts(figure) == ["$f$ rises →", "$f$ falls ←"]
    holds = {
        line.get_marker(): line
        for line in axes.lines
        if str(line.get_marker()) in "^v" and np.size(line.get_xdata())
    }
    assert {marker: (line.get_color(), np.size(line.get_xdata())) for marker, line in holds.items()} == {
        "^": (UP, 17),
        "v": (DOWN, 16),
    }
    assert figure.get_suptitle() == "Hysteresis"


def test_arrows_are_drawn_along_rows_on_branches_only() -> None:
    """Row 0 alternates between two values far above the others: it has no arrow and is not counted."""
    table = staircase_table(2)
    irregular = table["row"] == 0
    table.loc[irregular, "delta_13_n"] = np.where(np.arange(np.sum(irregular)) % 2, 4.5, 5.5)
    axes, strip = plot.hysteresis(table, y="delta_13").axes
    arrows = [patch for patch in axes.patches if isinstance(patch, FancyArrowPatch)]
    assert len(arrows) == 2
    assert all(np.asarray(patch.get_path().vertices)[:, 1].max() < 3.5 for patch in arrows)
    assert all(text.endswith("1 of 2 rows") for text in legend_texts(strip))


def test_a_pass_after_an_irregular_one_keeps_its_direction() -> None:
    """Pass 1 is on no branch and is not drawn; pass 2 rises, from a value below the last one of pass 0."""
    table = staircase_table()
    again = table.loc[(table["pass"] == 0) & (table["f"] < 0.5)].copy()
    again[["pass", "stair"]] = np.column_stack([np.full(len(again), 2), again["stair"] + len(table)])
    table = pd.concat([table, again], ignore_index=True)
    irregular = table["pass"] == 1
    table.loc[irregular, "delta_13_n"] = np.where(np.arange(np.sum(irregular)) % 2, 4.5, 5.5)
    axes = plot.hysteresis(table, y="delta_13").axes[0]
    lines = [line for line in axes.lines if line.get_marker() == "None" and np.size(line.get_xdata())]
    assert {line.get_color() for line in lines} == {UP}
    assert not any(np.diff(np.asarray(line.get_xdata())).min() < 0.0 for line in lines)


def test_irregular_rows_have_their_own_panel_and_ticks() -> None:
    """A row that is irregular about zero has a panel of its own, so that the branches fill theirs."""
    table = staircase_table(4, hold=40)
    irregular = (table["row"] == 2).to_numpy()
    count = irregular.sum()
    table.loc[irregular, "delta_13_n"] = np.mod(np.resize([0.6, -0.4, 0.1], count), 2 * np.pi)
    figure = plot.draw(
        "hysteresis", table, y="delta_13", ticks={"trot": np.pi, "walk": np.pi / 2, "pace": 0.0}
    )
    rendered(figure)
    axes, strip = figure.axes
    assert strip.get_title("left") == "irregular, on no branch: 1 of 4 rows"
    assert 1.4 < axes.get_ylim()[0] < axes.get_ylim()[1] < 3.4
    assert -1.0 < strip.get_ylim()[0] < strip.get_ylim()[1] < 1.0
    points = sum(np.size(line.get_xdata()) for line in strip.lines if line.get_marker() == ".")
    assert points == count
    names = [[tick.get_text() for tick in panel.child_axes[0].get_yticklabels()] for panel in (axes, strip)]
    assert names == [["trot", "walk"], ["pace"]]
    assert all(text.endswith("3 of 4 rows") for text in legend_texts(strip))


def test_the_order_of_records_has_no_influence() -> None:
    """Row 1 falls, and turns far away in its last crossings, which are not drawn."""
    table = ramp_table(2, steps=80)
    table["status"] = np.where(table["row"] == 1, "fell", "complete")
    table = table.loc[(table["row"] == 0) | (table["crossing"] <= 140)]
    last = (table["row"] == 1) & (table["crossing"] > 132)
    table.loc[last, "delta_13_n"] += np.linspace(1.0, 3.0, 8)
    shuffled = table.sample(frac=1.0, random_state=0)
    drawn = [plot.hysteresis(each, y="delta_13").axes[0].lines for each in (table, shuffled)]
    for line, other in zip(*drawn, strict=True):
        np.testing.assert_array_equal(line.get_xydata(), other.get_xydata())
    assert max(np.nanmax(line.get_ydata()) for line in drawn[0]) < 3.1


def test_a_trace_without_passes_is_refused_in_a_sentence() -> None:
    table = ramp_table(steps=4).drop(columns="pass")
    table.attrs["job"] = {"run": {"kind": "trace", "rate": None}}
    with pytest.raises(PlotError, match="pass is not a column"):
        plot.hysteresis(table, y="delta_13", parameter="f")


@pytest.mark.parametrize("unit", [0.01, 1000.0])
def test_the_unit_of_holds_has_no_influence(unit: float) -> None:
    """A height in m or mm: its branches wind, and differ by a tenth of a metre."""
    table = staircase_table(hold=40).drop(columns="gait")
    f = table["f"].to_numpy()
    table["height_n"] = unit * (0.1 * (table["delta_13_n"] - CENTRE) + 0.002 * np.sin(16.0 * f))
    (axes,) = plot.hysteresis(table, y="height").axes
    assert len(legend_texts(axes)) == 2
    assert len([patch for patch in axes.patches if isinstance(patch, FancyArrowPatch)]) == 2


def test_arrows_are_only_where_the_passes_differ() -> None:
    axes = plot.hysteresis(staircase_table(), y="delta_13").axes[0]
    for arrow in (patch for patch in axes.patches if isinstance(patch, FancyArrowPatch)):
        ends = [x for x, _ in arrow._posA_posB]  # type: ignore[attr-defined]
        assert -FOLD < min(ends) < max(ends) < FOLD
    same = staircase_table()
    same["delta_13_n"] = delta(0.2 * same["f"].to_numpy())  # one branch, the same both ways
    axes = plot.hysteresis(same, y="delta_13").axes[0]
    assert not [patch for patch in axes.patches if isinstance(patch, FancyArrowPatch)]


def test_branches_half_a_turn_apart_are_drawn_whole_and_named_after_their_gaits() -> None:
    """Values about 0 and pi, with the gaps between them equally wide, up to rounding."""
    table = half_turn_table()
    figure = plot.hysteresis(table, y="delta_13")
    rendered(figure)
    axes = figure.axes[0]
    values = np.concatenate([np.asarray(line.get_ydata(), float) for line in axes.lines])
    assert np.nanmin(values) == pytest.approx(0.0, abs=1e-9)
    assert np.nanmax(values) == pytest.approx(np.pi)
    assert jumps(table, "delta_13", "f")["size"].tolist() == pytest.approx([np.pi, -np.pi])
    assert {text.get_text() for text in axes.texts} == {"trot", "pace"}
    (trot,) = (text for text in axes.texts if text.get_text() == "trot")
    assert abs(trot.xy[1] - np.pi) < 1e-6  # type: ignore[attr-defined]
    long = "a name for which a panel of this figure has no room, since it is far longer than the panel"
    crowded = plot.draw("hysteresis", table, y="delta_13", labels={"trot": long})
    assert [text.get_text() for text in crowded.axes[0].texts] == ["pace"]
    assert legend_texts(crowded)[-1].replace("\n", " ") == f"{long} about $\\Delta_{{13}}$ = $\\pi$"


def test_the_two_passes_differ_in_grey_print() -> None:
    """By their lines and by the lightness of their colours, whose scale goes from 0 to 1."""
    for table in (staircase_table(), ramp_table(steps=1000)):
        axes = plot.hysteresis(table, y="delta_13").axes[0]
        drawn = {
            line.get_color(): line.get_linestyle() for line in axes.lines if line.get_linestyle() != "None"
        }
        assert drawn == {UP: "-", DOWN: "--"}
    light, dark = (np.dot(to_rgb(colour), (0.3, 0.59, 0.11)) for colour in (UP, DOWN))
    assert light > dark + 0.25


def test_hysteresis_over_a_measured_observable() -> None:
    """The speed falls as f rises, so a band over the speed is the other pass's band over f."""
    table = ramp_table(steps=1500)
    table["speed_n"] = 0.2 - 0.05 * table["f"]
    over = plot.hysteresis(table, y="delta_13", x="speed")
    rendered(over)
    axes, plain = over.axes[0], plot.hysteresis(table, y="delta_13").axes[0]
    assert axes.get_xlabel() == "speed"
    speeds, values = bars(axes), bars(plain)
    for here, there in ((UP, DOWN), (DOWN, UP)):
        assert speeds[here] == pytest.approx(sorted(0.2 - 0.05 * f for f in values[there]))
    thin = [line for line in axes.lines if np.size(line.get_xdata()) > 900]
    assert [line.get_color() for line in thin] == [DOWN, UP]
    assert np.ptp(np.asarray(thin[0].get_ydata())[:50]) < 0.02  # without the transient of the start


def test_hysteresis_shows_a_ramp_and_holds_side_by_side() -> None:
    ramp, stairs = ramp_table(steps=1000), staircase_table(hold=20)
    ramp.attrs["job"]["run"] |= {"rate": 0.01}
    stairs.attrs["job"]["run"] |= {"dwell": 8.0}
    figure = plot.hysteresis(ramp, y="delta_13", with_table=stairs)
    rendered(figure)
    left, right = figure.axes
    assert (left.get_title(), right.get_title()) == ("moved slowly (0.01 Hz/s)", "held 8 s at each value")
    assert left.get_ylim() == right.get_ylim()
    assert legend_texts(figure) == ["$f$ rises →", "$f$ falls ←", "hold not settled"]
    thin = [line for line in left.lines if np.size(line.get_xdata()) > 900]
    assert [line.get_color() for line in thin] == [UP, DOWN]
    assert all(line.get_marker() in ("", "None") for line in left.lines)
    assert np.ptp(np.asarray(thin[0].get_ydata())[:50]) < 0.02  # without the transient of the start


def test_hysteresis_beside_a_directory(tmp_path: Path) -> None:
    ramp = ramp_table(steps=200)
    ramp.attrs["path"] = str(tmp_path / "ramp")
    figure = plot.hysteresis(ramp, y="delta_13", with_table="stairs")
    rendered(figure)
    (reason,) = figure.axes[1].texts
    assert " ".join(reason.get_text().split()).startswith("stairs has no table yet:")


def test_hysteresis_of_an_angle_that_crosses_zero_is_continuous() -> None:
    figure = plot.hysteresis(staircase_table(centre=0.05), y="delta_13")
    rendered(figure)
    low, high = figure.axes[0].get_ylim()
    assert -0.6 < low < high < 0.6
    assert "0" in [tick.get_text() for tick in figure.axes[0].get_yticklabels()]


def test_hysteresis_by_panels_and_of_many_rows() -> None:
    table = staircase_table(6)
    table.insert(1, "mass", np.where(table["row"] < 3, 1.0, 1.2))
    figure = plot.hysteresis(table, y="delta_13", panels="mass")
    rendered(figure)
    assert [axes.get_title() for axes in figure.axes] == ["mass = 1", "mass = 1.2"]
    assert legend_texts(figure.axes[0])[0] == "$f$ rises: 0.3 to 0.4 Hz, 3 of 3 rows"
    with pytest.raises(PlotError, match="moves no parameter"):
        plot.hysteresis(map_table(starts=3), y="delta_13")


@pytest.mark.slow
def test_rows_of_several_parameter_values_have_a_panel_each() -> None:
    """Rows that differ in starts alone stay in one panel; too many parameter values are refused."""
    table = staircase_table(6, stairs=9, hold=40)
    table.attrs["job"]["model"] = "waist_quadruped"
    table.insert(1, "delta_13", table["row"] / 10.0)
    assert len(plot.hysteresis(table, y="delta_13").axes) == 1
    table.insert(1, "body_mass", 1.0 + table["row"] % 2)
    table.insert(1, "body_length", 0.1 + 0.01 * (table["row"] // 4))
    figure = plot.hysteresis(table, y="delta_13")
    headings = [axes.get_title() for axes in figure.axes if axes.get_title()]
    assert [heading.count("=") for heading in headings] == [2, 2, 2, 2]
    assert "0.11" in headings[3]
    assert legend_texts(figure.axes[0])[0].endswith("2 of 2 rows")  # of six
    by_mass = plot.hysteresis(table.loc[table["row"] < 4], y="delta_13", panels="body_mass")
    assert len(by_mass.axes) == 2
    many = pd.concat([table.assign(row=table["row"] + 6 * n, body_mass=n) for n in range(13)])
    many.attrs = table.attrs
    sentence = (
        r"body_length and body_mass, in 26 combinations.*12 at most.*table\[table\[\"body_mass\"\] == 12\]"
    )
    with pytest.raises(PlotError, match=sentence):
        plot.hysteresis(many, y="delta_13")


@pytest.mark.slow
def test_a_figure_of_many_panels_is_low_enough_or_says_that_it_is_not() -> None:
    table = staircase_table(8, stairs=9, hold=1)
    table.insert(1, "mass", table["row"])
    few = table.loc[table["row"] < 3]
    assert plot.draw("hysteresis", few, y="delta_13", panels="mass", width="column").get_figheight() < 8.2
    with pytest.warns(UserWarning, match=r"mm high, more than a page: .* width of page"):
        plot.draw("hysteresis", table, y="delta_13", panels="mass", width="column")
