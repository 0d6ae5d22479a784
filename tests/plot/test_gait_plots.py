"""Figures of the nine gaits from small synthetic tables: what they show, and of what they refuse."""

from __future__ import annotations

import itertools

import numpy as np
import pandas as pd
import pytest
from matplotlib.colors import to_hex
from matplotlib.patches import Patch, Rectangle

from gaitsweep import plot
from gaitsweep.papers.fukuoka2015.figures.gait_looks import areas_of, colour_of, marker_of
from gaitsweep.plot import PlotError
from tests.support.gait_traces import crossings_of, ends, trace_of, traces
from tests.support.plot_tables import legend_texts, rendered

DELTA = np.linspace(-0.25, 0.25, 21)


def span(bar: Patch) -> tuple[float, float]:
    assert isinstance(bar, Rectangle)
    return bar.get_x(), bar.get_x() + bar.get_width()


def _ends() -> pd.DataFrame:
    table = ends(DELTA, -40.0 * DELTA, 0.02 * DELTA, axes={"sigma": np.arange(21.0)})
    table.attrs["quantities"] = {
        "speed": {"unit": "m/s", "meaning": "speed", "symbol": "v", "circular": False}
    }
    return table


def test_all_gaits_have_looks_and_sides_differ() -> None:
    for left, right in (("L-canter", "R-canter"), ("LT-gallop", "RT-gallop"), ("L-walk", "D-walk")):
        assert marker_of(left) != marker_of(right)


def test_sides_of_a_gait_share_an_area_and_dark_gaits_differ_in_hatch() -> None:
    areas = areas_of(["LT-gallop", "RT-gallop", "D-walk", "trot"])
    assert areas["LT-gallop"] == areas["RT-gallop"]
    assert areas["D-walk"]["hatch"] != areas["trot"]["hatch"]


def test_gaits_over_speed() -> None:
    table = _ends()
    figure = plot.draw("speed_gaits", table)
    rendered(figure)
    axes = figure.axes[0]
    names = [label.get_text() for label in axes.get_yticklabels()]
    assert names == ["D-walk", "L-walk", "trot"]
    drawn = {
        to_hex(line.get_color()): np.size(line.get_xdata())
        for line in axes.lines
        if str(line.get_marker()) in "v^o"
    }
    assert drawn[colour_of("D-walk").lower()] == (DELTA < -0.07).sum()
    assert drawn[colour_of("trot").lower()] == (np.abs(DELTA) <= 0.07).sum()
    assert "m/s" in axes.get_xlabel()
    figure = plot.draw("speed_gaits", pd.concat([table, table.assign(row=table["row"] + 21, k2=0.1)]), y="k2")
    rendered(figure)
    assert [label.get_text() for label in figure.axes[0].get_yticklabels()] == ["0.08", "0.1"]
    assert legend_texts(figure) == ["D-walk", "L-walk", "trot"]
    panels = plot.draw("speed_gaits", table, panels="k2")
    rendered(panels)
    assert len(panels.axes) == 1
    with pytest.raises(PlotError, match="did you mean sigma"):
        plot.draw("speed_gaits", table, y="sigm")


def test_bands_of_near_values_have_names_of_their_own() -> None:
    table = _ends().assign(k2=1000.0 + np.repeat([0.01, 0.02, 0.03], 7))
    axes = plot.draw("speed_gaits", table, y="k2").axes[0]
    assert [label.get_text() for label in axes.get_yticklabels()] == ["1000.01", "1000.02", "1000.03"]


@pytest.mark.parametrize("rows", [0, 21])
def test_panels_without_a_value_are_one(rows: int) -> None:
    assert len(plot.draw("speed_gaits", _ends().assign(k2=np.nan).head(rows), panels="k2").axes) == 1


def test_bands_of_texts() -> None:
    table = _ends().assign(kind="b")
    table.loc[0, "kind"] = "a"
    figure = plot.draw("speed_gaits", table, y="kind")
    rendered(figure)
    assert [text.get_text() for text in figure.axes[0].get_yticklabels()] == ["a", "b"]


def test_points_of_one_speed_do_not_hide_each_other() -> None:
    table = ends(np.full(6, 0.2), np.zeros(6), np.zeros(6))
    axes = plot.draw("speed_gaits", table).axes[0]
    heights = np.concatenate([line.get_ydata() for line in axes.lines])
    assert len(set(heights)) == 6
    assert np.ptp(heights) < 1.0


def test_the_rule() -> None:
    figure = plot.draw("loading_rule", _ends())
    rendered(figure)
    titles = [axes.get_title() for axes in figure.axes if axes.get_visible()]
    assert titles[0] == "r = \u22121.00, sign right 100 %"
    assert titles[2] == "r = 1.00, sign right 0 %"
    assert "(N)" in figure.axes[0].get_xlabel()
    assert "(rad)" in figure.axes[2].get_xlabel()
    one = plot.draw("loading_rule", _ends(), measures=["tilt_stance"], only="k2", value=0.08, title="Loads,")
    rendered(one)
    assert len(one.axes) == 1
    # a value of an axis may be rounded, and that of no row is no result
    assert (
        plot.draw("loading_rule", _ends(), only="k2", value=0.08 * (1.0 + 1e-15)).axes[0].get_title()
        == titles[0]
    )
    none = plot.draw("loading_rule", _ends(), only="k2", value=0.09)
    assert [text.get_text() for text in none.axes[0].texts] == ["No row has this value."]
    with pytest.raises(PlotError, match="load_together is not a measure"):
        plot.draw("loading_rule", _ends(), measures=["load_together"])
    with pytest.raises(PlotError, match="only and value"):
        plot.draw("loading_rule", _ends(), only="k2")
    trots = ends(0.0 * DELTA, DELTA, DELTA)
    assert "no pair shifted" in plot.draw("loading_rule", trots).axes[0].get_title()


def test_nine_cells() -> None:
    figure = plot.draw("nine_gaits", traces())
    rendered(figure)
    assert len(figure.axes) == 9
    words = [text.get_text() for axes in figure.axes for text in axes.texts]
    assert "no row has it" not in words
    assert "1.00 m/s, $\\sigma$ = 0.4" in words
    few = plot.draw("nine_gaits", traces(["trot", "RT-gallop"]))
    rendered(few)
    assert sum(text.get_text() == "no row has it" for axes in few.axes for text in axes.texts) == 7
    with pytest.raises(PlotError, match="u_f_LF"):
        plot.draw("nine_gaits", pd.DataFrame({"row": [0], "t": [0.0]}))


def test_the_example_is_the_one_farthest_from_other_gaits() -> None:
    near = trace_of("R-canter", 0.09, row=0, speed=1.0)
    clear = trace_of("R-canter", 0.2, row=1, speed=2.0)
    figure = plot.draw("nine_gaits", pd.concat([near, clear]))
    words = [text.get_text() for axes in figure.axes for text in axes.texts]
    assert "2.00 m/s" in words


@pytest.mark.slow
def test_series() -> None:
    table = traces(["trot", "L-walk"])
    figure = plot.draw("gait_series", table, loads=True, window=[0.0, 1.5])
    rendered(figure)
    assert len(figure.axes) == 2 * 4
    assert figure.axes[0].get_title(loc="left") == "trot, 1.00 m/s, $\\sigma$ = 0"
    assert figure.axes[3].get_xlim() == pytest.approx((0.0, 1.5))
    strips = plot.draw("gait_series", table, row=1, strip=2.0, title="one row")
    rendered(strips)
    assert len(strips.axes) == 3 * 4
    words = {text.get_text() for axes in strips.axes for text in axes.texts}
    assert {"L-walk", "1.00 m/s"} <= words
    rendered(plot.draw("gait_series", table.iloc[:0]))
    rendered(plot.draw("gait_series", table.iloc[:3]))
    with pytest.raises(PlotError, match="F_LF"):
        plot.draw("gait_series", table.drop(columns="F_LF"), loads=True)


@pytest.mark.slow
def test_long_series_are_in_two_columns_read_downwards() -> None:
    table = traces(["trot", "L-walk", "D-walk", "R-canter", "RT-gallop"])
    figure = plot.draw("gait_series", table, window=[0.0, 1.5])
    rendered(figure)
    tops = [figure.axes[3 * number] for number in range(5)]
    places = [tuple(axes.get_window_extent().p0) for axes in tops]
    assert places[0][0] == pytest.approx(places[2][0], abs=15.0)
    assert places[3][0] > places[0][0] + 300.0
    assert places[0][1] > places[1][1] > places[2][1]
    assert legend_texts(figure)[:4] == ["left fore", "left hind", "right fore", "right hind"]
    one = plot.draw("gait_series", table, window=[0.0, 1.5], strip_columns=1)
    assert one.get_size_inches()[1] > figure.get_size_inches()[1]
    many = plot.draw("gait_series", table, row=0, strip=0.4)
    assert many.get_suptitle() == "(the first 12 of 15 strips)"


def test_a_ramp() -> None:
    parts = []
    for row, k2 in ((0, 0.0), (1, 0.08)):
        gait = "trot" if k2 == 0.0 else "LT-gallop"
        part = crossings_of(gait, row=row, n=40)
        way = np.concatenate([np.linspace(1.0, 2.0, 20), np.linspace(2.0, 1.0, 20)])
        part = part.assign(speed_n=way, v_d=way)
        part["pass"] = np.repeat([0, 1], 20)
        part.insert(1, "k2", k2)
        parts.append(part)
    table = pd.concat(parts, ignore_index=True)
    table.attrs |= {
        "job": {"run": {"parameter": "v_d"}},
        "quantities": {"v_d": {"unit": "m/s", "symbol": "v_d"}},
    }
    figure = plot.draw("gait_ramp", table, panels="k2")
    rendered(figure)
    assert figure.axes[-1].get_xlabel() == "$v_d$ (m/s)"
    assert legend_texts(figure) == ["trot", "gallop"]
    colours = [{to_hex(patch.get_facecolor()) for patch in axes.patches} for axes in figure.axes]
    assert colours == [{colour_of("trot").lower()}, {colour_of("LT-gallop").lower()}]
    bars = figure.axes[0].patches
    spans = np.array([span(bar) for bar in bars])
    assert spans.min() >= 1.0
    assert spans.max() <= 2.0
    assert [axes.get_yticklabels()[0].get_text() for axes in figure.axes] == ["row 0", "row 1"]
    measured = plot.draw("gait_ramp", table.assign(speed_n=0.5 * table["v_d"]), x="speed")
    rendered(measured)
    assert measured.axes[0].get_xlabel() == "measured speed (m/s)"
    names = [label.get_text() for label in measured.axes[0].get_yticklabels()]
    assert names == ["k2 = 0", "k2 = 0.08"]
    bars = measured.axes[0].patches
    assert {to_hex(bar.get_facecolor()) for bar in bars} == {
        colour_of("trot").lower(),
        colour_of("LT-gallop").lower(),
    }
    ends = [end for bar in bars for end in span(bar)]
    assert 0.5 <= min(ends) < max(ends) <= 1.0
    table.insert(1, "seed", table["row"])
    figure = plot.draw("gait_ramp", table.drop(columns="k2"))
    assert [name.get_text() for name in figure.axes[0].get_yticklabels()] == ["start 1", "start 2"]
    with pytest.raises(PlotError, match="o parameter moves"):
        plot.draw("gait_ramp", crossings_of("trot"))
    with pytest.raises(PlotError, match="3 successive cycles"):
        plot.draw("gait_ramp", table.loc[table["t"] < table["t"].min() + 0.1])


def test_a_ramp_has_a_bar_for_each_pass() -> None:
    """Up, down and up again: the third pass is drawn, too, and bars of two rows are apart."""
    way = np.concatenate([np.linspace(1.0, 2.0, 20), np.linspace(2.0, 1.0, 20), np.linspace(1.0, 2.0, 20)])
    parts = [crossings_of("trot", row=row, n=60).assign(v_d=way) for row in (0, 1)]
    table = pd.concat([part.assign(**{"pass": np.repeat([0, 1, 2], 20)}) for part in parts])
    table.attrs |= {"job": {"run": {"parameter": "v_d"}}}
    axes = plot.draw("gait_ramp", table).axes[0]
    boxes = [bar.get_bbox() for bar in axes.patches if isinstance(bar, Rectangle)]
    bars = sorted((box.y0, box.y1) for box in boxes)
    assert len(bars) == 6
    assert all(end < begin for (_, end), (begin, _) in itertools.pairwise(bars))
    assert [text.get_text() for text in axes.texts if text.get_text() in "\u2190\u2192"] == [
        *"\u2192\u2190\u2192"
    ] * 2


def test_gaits_without_a_bar_are_not_in_the_legend() -> None:
    """The canter occurs only while the parameter is held at its first value."""
    parts = [crossings_of(gait, n=20) for gait in ("uR-canter", "trot")]
    parts[1]["crossing"] += 20
    parts[1]["t"] += 13.0  # no gait is read over this gap
    table = pd.concat(parts).assign(v_d=np.r_[np.ones(20), np.linspace(1.0, 2.0, 20)], **{"pass": 0})
    table.attrs |= {"job": {"run": {"parameter": "v_d"}}}
    figure = plot.draw("gait_ramp", table)
    assert legend_texts(figure) == ["trot"]
