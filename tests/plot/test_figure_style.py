"""Styles of figures: where they come from, which takes precedence, what they change; angles on axes."""

from __future__ import annotations

import io
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
import pytest
import yaml
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure

import gaitsweep as gs
from gaitsweep import plot
from gaitsweep.cli import main
from gaitsweep.plot.arguments import fields_of
from gaitsweep.plot.column_labels import described
from gaitsweep.plot.columns import PlotError
from gaitsweep.plot.figure_layout import wrapped
from gaitsweep.plot.figure_style import FORMATS, FigureStyle, StyleError, read_style, styled
from gaitsweep.plot.theme import angle_axis, angle_ticks, in_pi
from gaitsweep.runs.figures import draw_figures
from gaitsweep.table import Snapshot
from tests.support import ROOT
from tests.support.hysteresis_tables import map_table, staircase_table
from tests.support.plot_tables import legend_texts, rendered, settle_table
from tests.support.text_boxes import text_problems

LABELS = {"walk": "W"}
BASIN = {"x": "psi_1", "y": "psi_2", "panels": "psi_3"}
JOB: dict[str, Any] = {
    "name": "styled",
    "model": "multilegged_reduced",
    "vary": {"psi_1": {"values": [0.5, 3.0]}, "psi_2": {"values": [0.5, 3.0]}},
    "start": {"psi_3": 2.0},
    "run": {"kind": "settle"},
    "verify": 0,
}


@pytest.mark.parametrize(
    ("width", "inches"), [("column", 85 / 25.4), ("page", 180 / 25.4), (120, 120 / 25.4)]
)
def test_a_figure_has_the_width_of_its_style(width: str | float, inches: float) -> None:
    table, axes = settle_table().iloc[:16], {"x": "psi_1", "y": "psi_2"}
    assert plot.draw("basin", table, **axes, width=width).get_figwidth() == pytest.approx(inches)
    with plot.style(width=width):
        assert plot.draw("basin", settle_table(), **BASIN).get_figwidth() == pytest.approx(inches)
        assert plot.draw("basin", table, **axes, width=60).get_figwidth() == pytest.approx(60 / 25.4)
    assert plot.draw("basin", table, **axes, height=50).get_figheight() == pytest.approx(50 / 25.4)


def test_colours_order_and_labels_of_gaits_and_columns() -> None:
    look: dict[str, Any] = {"colours": {"source": "#112233"}, "order": ["retrograde", "source"]}
    figure = plot.draw(
        "basin", settle_table(), **BASIN, **look, labels={"source": "from within", "psi_1": "lag"}
    )
    (legend,) = figure.legends
    names = [text.get_text() for text in legend.get_texts()]
    assert names == ["retrograde", "from within", "direct"]
    assert legend.get_patches()[1].get_facecolor() == to_rgba("#112233")
    assert [axes.get_xlabel() for axes in figure.axes] == ["lag"] * 3


def test_labels_name_an_observable_without_its_suffix_and_stand_in_legends_without_unit() -> None:
    label = "fore-hind lag, averaged over many cycles of the gait, $d$ (rad)"
    look: dict[str, Any] = {"labels": {"delta_13": label, "f": "stiffness of the waist (Hz)"}, "width": 85}
    figure = plot.draw("hysteresis", staircase_table(), y="delta_13", **look)
    rendered(figure)
    axes = figure.axes[0]
    assert axes.get_ylabel().replace("\n", " ") == label
    assert axes.get_xlabel() == "stiffness of the waist (Hz)"
    rising, falling = legend_texts(figure)  # one legend of passes and their jumps
    assert re.match(r"stiffness of the waist\s+rises →, jumps\s+at −?\d", rising)
    assert re.match(r"stiffness of the waist\s+falls ←, jumps\s+at −?\d", falling)
    assert axes.get_legend() is None
    (legend,) = figure.legends
    box = legend.get_window_extent()
    markers = [float(line.get_markersize()) for line in axes.lines if line.get_marker() in ("^", "v")]
    assert max(markers) < 4.0
    assert 0.0 <= box.x0 < box.x1 <= figure.bbox.width
    assert axes.get_position().width > 0.6
    points = plot.draw("branches", map_table(starts=5, crossings=5), x="f", y="delta_13", **look)
    assert points.axes[0].get_ylabel().replace("\n", " ") == label


@pytest.mark.parametrize(
    ("look", "sentence", "near"),
    [
        ({"labels": {"psi1": "lag"}}, "labels.psi1 names no column or gait", "psi_1"),
        ({"colours": {"direkt": "red"}}, "colours.direkt names no gait", "direct"),
        ({"order": ["source", "retrogade"]}, "order[1] is retrogade, which is no gait", "retrograde"),
    ],
)
def test_names_in_a_style_that_name_nothing_are_refused(
    look: dict[str, Any], sentence: str, near: str
) -> None:
    with pytest.raises(PlotError) as refused:
        plot.draw("basin", settle_table(), **BASIN, **look)
    assert f"{sentence} of this table or of its model; did you mean {near}?" in str(refused.value)
    with pytest.raises(PlotError), plot.style(**look):
        plot.draw("basin", settle_table(), **BASIN)
    with pytest.raises(gs.JobError) as refused_in_job:
        gs.Job(**JOB, style=look)
    assert f"style.{sentence} of this table or of its model; did you mean {near}?" in str(
        refused_in_job.value
    )


def test_a_style_of_several_tables_may_name_what_others_have() -> None:
    with plot.style(colours={"gallop of another model": "red"}, labels={"speed": "v"}):
        plot.draw("basin", settle_table(), **BASIN)


def test_colours_of_statuses_are_refused_with_the_outcome_that_is_shown() -> None:
    """Rows that fell are shown as `failed`; a figure of the statuses or of recoveries names them."""
    fell = settle_table().assign(status=pd.Categorical(["fell"] * 48, ["settled", "cycle_limit", "fell"]))
    for name, outcome in (("fell", "failed"), ("cycle_limit", "not settled")):
        with pytest.raises(PlotError, match=f"colours.{name} names no gait .*did you mean {outcome}"):
            plot.draw("basin", fell, **BASIN, colours={name: "red"})
    with pytest.raises(gs.JobError, match=r"figures\[0\].colours.fell names .*did you mean failed"):
        gs.Job(**JOB, figures=[{"kind": "basin", "x": "psi_1", "y": "psi_2", "colours": {"fell": "red"}}])
    by_status = fell.assign(crossing=0, psi_1_n=0.1)
    plot.draw("cycles", by_status, y=["psi_1"], hue="status", colours={"fell": "red"})
    with plot.style(colours={"fell": "red"}):  # of several tables, one of which may have recoveries
        plot.draw("basin", fell, **BASIN)


def test_colours_of_gaits_are_refused_where_they_have_no_effect() -> None:
    with pytest.raises(PlotError, match="does not colour gaits"):
        plot.draw("hysteresis", staircase_table(), y="delta_13", colours={"trot": "red"})
    warned = pytest.warns(UserWarning, match=r"hysteresis does not colour gaits. .*basin")
    with warned, plot.style(colours={"trot": "red"}):
        plot.draw("hysteresis", staircase_table(), y="delta_13")
    wrong: Any = {"kind": "return_map", "y": "psi_1", "colours": {"direct": "red"}}
    job: dict[str, Any] = JOB | {"run": {"kind": "return_map", "crossings": 4}}
    with pytest.raises(gs.JobError, match=r"figures\[0\].colours has no effect"):
        gs.Job(**job, figures=[wrong])
    with pytest.raises(PlotError, match="a figure cycles colours gaits only with hue: gait"):
        plot.draw("cycles", staircase_table(), y=["delta_13"], colours={"trot": "red"})
    with pytest.raises(gs.JobError, match=r"style.colours has no effect.* colour gaits: .*basin.* Remove it"):
        gs.Job(**job, figures=[wrong | {"colours": None}], style={"colours": {"direct": "red"}})


@pytest.mark.slow
def test_colours_of_gaits_have_no_effect_on_a_colour_scale(recwarn: pytest.WarningsRecorder) -> None:
    """Rows that failed have a colour beside the scale, and a column of texts has no scale."""
    table = settle_table()
    by_number: dict[str, Any] = {**BASIN, "hue": "psi_1_end"}
    with pytest.raises(PlotError, match=r"no effect for direct: a figure basin .* with hue: gait"):
        plot.draw("basin", table, **by_number, colours={"direct": "red", "failed": "black"})
    figure: dict[str, Any] = {"kind": "basin", "x": "psi_1", "y": "psi_2", "hue": "psi_1_end"}
    with pytest.raises(gs.JobError, match=r"figures\[0\].colours has no effect for direct"):
        gs.Job(**JOB, figures=[figure | {"colours": {"direct": "red"}}])
    with pytest.raises(gs.JobError, match=r"style.colours has no effect"):
        gs.Job(**JOB, figures=[figure], style={"colours": {"direct": "red"}})
    with pytest.warns(UserWarning, match="no effect for direct"), plot.style(colours={"direct": "red"}):
        plot.draw("basin", table, **by_number)
    assert plot.FIGURES["basin"].colours_of("direct", {"hue": "gait_of_hind_legs"})  # a model's label field
    recwarn.clear()
    plot.draw("basin", table, **by_number, colours={"failed": "black"})
    with_texts = table.assign(kind=table["gait"].astype(str))
    plot.draw("basin", with_texts, **BASIN, hue="kind", colours={"direct": "red"})
    with plot.style(colours={"direct": "red", "failed": "black"}):
        plot.draw("basin", table, **by_number)
    assert not recwarn.list


def test_an_argument_of_single_figures_is_no_field_of_a_style() -> None:
    with pytest.raises(StyleError, match=r"shares .* argument of .*plot\.basin\("), plot.style(shares=False):
        pass


def test_periods_of_an_atlas_have_colours_and_no_gait_has() -> None:
    ball = pd.read_parquet(ROOT / "docs/gallery/road_map.parquet")
    figure = plot.draw("atlas", ball, colours={"period 1": "#123456"})
    assert "#123456" in {line.get_color() for line in figure.axes[0].lines}
    figure = plot.draw("road_map", ball, y="phase", colours={"period 1": "#123456"})
    assert "#123456" in {line.get_color() for line in figure.axes[0].lines}
    with pytest.raises(PlotError, match=r"no effect for none: a figure atlas colours periods"):
        plot.draw("atlas", ball, colours={"none": "red"})
    with pytest.raises(PlotError, match=r"names no gait .*did you mean period"):
        plot.draw("road_map", ball, y="phase", colours={"period 7": "red"})


@pytest.mark.slow
def test_letters_stand_above_headings_that_leave_them_no_room() -> None:
    """A heading wider than its panel reaches over the letter's place, so all letters are above it."""
    narrow: dict[str, Any] = {"width": "column", "panel_columns": 3}
    figure = plot.draw("basin", settle_table(), **BASIN, panel_letters=True, **narrow)
    assert text_problems(figure) == []
    for axes in figure.axes[:3]:
        (letter,) = axes.texts
        assert letter.get_window_extent().y0 >= axes.title.get_window_extent().y1
    wide = plot.draw("basin", settle_table(), **BASIN, panel_letters=True, shares=False, width="page")
    wide.draw_without_rendering()
    assert wide.axes[0].texts[0].get_window_extent().y0 < wide.axes[0].title.get_window_extent().y1


def test_letters_of_one_panel_and_letters_that_are_chosen() -> None:
    def letters(**look: Any) -> list[str]:
        table = settle_table()
        figure = plot.draw("basin", table, **BASIN, **look)
        return [text.get_text() for axes in figure.axes for text in axes.texts]

    one = plot.draw("basin", settle_table().iloc[:16], x="psi_1", y="psi_2", panel_letters=True)
    assert [text.get_text() for text in one.axes[0].texts] == ["a"]
    assert letters(panel_letters=["b", "c", "d"]) == ["b", "c", "d"]
    with pytest.raises(PlotError, match="2 letters, but the figure has 3 panels"):
        letters(panel_letters=["b", "c"])
    with pytest.raises(StyleError, match="must be true, false, or a list of letters"):
        letters(panel_letters="b")


@pytest.mark.slow
def test_one_letter_is_that_of_the_whole_figure_and_a_list_wins_over_true() -> None:
    """The first panels of a larger figure; the letter is in its top left corner and over no text."""
    for titled in ({}, {"title": "Basins of attraction of a walker with legs of three segments"}):
        figure = plot.draw("basin", settle_table(), **BASIN, panel_letters=["d"], width="column", **titled)
        assert [text.get_text() for axes in figure.axes for text in axes.texts] == []
        (letter,) = (text for text in figure.texts if text.get_fontweight() == "bold")
        rendered(figure)
        box = letter.get_window_extent()
        assert letter.get_text() == "d"
        assert box.x0 < 2.0 / 25.4 * figure.dpi
        assert figure.bbox.height - box.y1 < 2.0 / 25.4 * figure.dpi
        assert text_problems(figure) == []
    asked = FigureStyle(panel_letters=True).over(FigureStyle(panel_letters=["d", "e"]))
    assert asked.panel_letters == ["d", "e"]


@pytest.mark.slow
def test_basins_of_a_column_are_compact() -> None:
    """Three panels of 20 mm and more in one row, each with numbers below, in less than 70 mm."""
    figure = plot.draw("basin", settle_table(), **BASIN, width="column")
    rendered(figure)
    millimetre = figure.dpi / 25.4
    boxes = [axes.get_window_extent() for axes in figure.axes]
    assert len({round(box.y0) for box in boxes}) == 1
    assert min(box.width for box in boxes) > 20.0 * millimetre
    assert figure.bbox.height < 70.0 * millimetre
    for axes in figure.axes:
        assert any(tick.get_text() and tick.get_visible() for tick in axes.get_xticklabels())
        assert ",\n" not in axes.get_title()
    one = plot.draw("basin", settle_table().iloc[:16], x="psi_1", y="psi_2", width="column")
    assert one.axes[0].get_xlabel() == figure.axes[0].get_xlabel()
    low: dict[str, Any] = {"panel_columns": 3, "shares": False, "caption": False}
    figure = plot.draw("basin", settle_table(), **BASIN, width="column", height=55, **low)
    rendered(figure)
    top = max(axes.title.get_window_extent().y1 for axes in figure.axes)
    assert figure.bbox.height - top < 2.0 * figure.dpi / 25.4, "no blank band above panels of a given height"


def test_a_misspelt_colour_gets_its_near_miss() -> None:
    with pytest.raises(StyleError, match=r"crimsn.*did you mean crimson\?"):
        plot.draw("basin", settle_table(), **BASIN, colours={"direct": "crimsn"})


@pytest.mark.slow
def test_panels_in_given_columns_have_numbers_below_and_no_hidden_axes() -> None:
    figure = plot.draw("basin", settle_table(), **BASIN, width="column", panel_columns=2)
    rendered(figure)
    numbers = [[tick.get_text() for tick in axes.get_xticklabels() if tick.get_visible()]
               for axes in figure.axes]  # fmt: skip
    assert [bool(each) for each in numbers] == [False, True, True]  # the third stands below the first
    legend = figure.legends[0].get_window_extent()
    _, second, third = (axes.get_window_extent() for axes in figure.axes)
    assert legend.x0 > third.x1
    assert legend.y1 < second.y0
    assert figure.get_figheight() * 25.4 < 125
    for columns in (1, 2, 3):
        arranged = plot.draw("basin", settle_table(), **BASIN, width="column", panel_columns=columns)
        rendered(arranged)
        assert len({round(axes.get_position().x0, 3) for axes in arranged.axes}) == columns
        assert len(arranged.axes) == 3


def test_shares_and_captions_are_left_out() -> None:
    plain = plot.draw("basin", settle_table(), **BASIN, shares=False)
    assert [axes.get_title().strip() for axes in plain.axes] == [
        r"$\psi_{3}$ = $0.4\,\pi$", r"$\psi_{3}$ = $\pi$", r"$\psi_{3}$ = $1.6\,\pi$"]  # fmt: skip
    assert plain.legends[0].get_title().get_text() == ""
    rendered(plain)
    below = plain.legends[0].get_window_extent().y1 / plain.dpi
    axis_labels = min(axes.get_tightbbox().y0 for axes in plain.axes) / plain.dpi  # pyright: ignore
    assert 0.0 < axis_labels - below < 0.3, "inches between panels and legend: no blank band"
    titled = plot.draw("basin", settle_table(), **BASIN)
    assert titled.legends[0].get_title().get_text() == "share of starts above each panel"
    bare = plot.draw("basin", settle_table(), **BASIN, caption=False)
    assert bare.legends[0].get_title().get_text() == ""
    assert "%" in bare.axes[0].get_title()


@pytest.mark.parametrize(("name", "value"), [("dpi", 100_000), ("height", 1e6), ("dpi", 0), ("height", 0)])
def test_a_picture_that_would_fill_the_memory_is_refused(name: str, value: float) -> None:
    with pytest.raises(StyleError, match=rf"{name} is .*, but must be"):
        read_style(**{name: value})
    assert read_style(dpi=1200, height=999.0).dpi == 1200


@pytest.mark.slow
@pytest.mark.filterwarnings("error")
def test_a_height_that_does_not_fit_is_refused_with_the_least_that_does() -> None:
    with pytest.raises(
        PlotError, match=r"height is 40 mm, but this figure needs at least (\d+) mm"
    ) as refused:
        plot.draw("basin", settle_table(), **BASIN, width="column", height=40)
    least = float(str(refused.value).split()[-2])
    figure = plot.draw("basin", settle_table(), **BASIN, width="column", height=least)
    assert figure.get_figheight() * 25.4 == pytest.approx(least)
    assert min(axes.get_window_extent().height for axes in figure.axes) > 11.0 / 25.4 * figure.dpi


def test_a_value_that_is_constant_to_rounding_is_drawn_as_constant() -> None:
    table = map_table(starts=5, crossings=40)
    noise = 1e-13 * np.sin(np.arange(len(table)))
    for value, least in ((1.0, 0.01), (0.0, 0.01)):
        figure = plot.draw("cycles", table.assign(delta_13_n=value + noise), y=["delta_13"])
        assert np.ptp(figure.axes[0].get_ylim()) >= 0.99 * least
    table["speed_n"] = 2.0 + noise
    figure = plot.draw("cycles", table, y=["speed"])
    assert np.ptp(figure.axes[0].get_ylim()) == pytest.approx(0.002, rel=0.01)
    branch = pd.DataFrame({"row": 0, "point": range(40), "k": np.linspace(1, 2, 40), "stable": True,
                           "special": "", "delta_n": 1.2 + noise[:40]})  # fmt: skip
    low, high = plot.draw("continuation", branch, x="k", y="delta").axes[0].get_ylim()
    assert (low, high) == (pytest.approx(1.195), pytest.approx(1.205))


def test_no_title() -> None:
    figure = plot.draw("hysteresis", staircase_table(), y="delta_13", title="")
    assert figure.axes[0].get_title() == figure.get_suptitle() == ""
    job: dict[str, Any] = JOB | {"figures": [{"kind": "basin", "x": "psi_1", "y": "psi_2", "title": ""}]}
    assert gs.Job(**job).figures[0].title == ""  # type: ignore[attr-defined]
    job["figures"][0]["title"] = "none"
    assert gs.Job(**job).figures[0].title == ""  # type: ignore[attr-defined]


def test_panel_letters_and_marks_that_are_left_out() -> None:
    table = settle_table()
    table.attrs["complete"] = False
    letters = ["a", "b", "c"]
    for panel_letters, marks in ((True, True), (False, False)):
        figure = plot.draw("basin", table, **BASIN, panel_letters=panel_letters, marks=marks)
        written = [text.get_text() for axes in figure.axes for text in axes.texts]
        assert written == letters * panel_letters
        assert [text.get_text() for text in figure.texts] == ["incomplete"] * marks


def test_a_figure_of_one_panel_goes_into_given_axes() -> None:
    figure, (left, right) = plt.subplots(1, 2)
    one = settle_table().iloc[:16]
    assert plot.draw("basin", one, x="psi_1", y="psi_2", ax=right) is figure
    assert right.get_xlabel().startswith("$\\psi_{1}$")
    assert right.get_legend() is not None
    assert not left.has_data()
    with pytest.raises(PlotError, match="3 panels, but ax is one"):
        plot.draw("basin", settle_table(), **BASIN, ax=left)
    with styled(FigureStyle(), left), plot.theme.canvas(3.0, 2.0) as one_panel:
        assert one_panel.axes == [left]
        with pytest.raises(PlotError, match="leave ax out"):
            one_panel.supylabel("beside the panel")
    plt.close(figure)


@pytest.mark.slow
def test_rcparams_of_the_user_are_obeyed_and_fonts_are_embedded_as_type_42() -> None:
    with mpl.rc_context({"font.size": 16.0, "lines.linewidth": 3.0}):
        figure = plot.draw("basin", settle_table(), **BASIN, title="Basins")
        assert figure._suptitle.get_fontsize() == pytest.approx(19.0)  # type: ignore[attr-defined]
        assert figure.axes[0].xaxis.label.get_fontsize() == pytest.approx(17.0)
    assert mpl.rcParams["pdf.fonttype"] == 3
    for format_ in ("pdf", "ps"):
        file = io.BytesIO()
        plot.draw("basin", settle_table().iloc[:16], x="psi_1", y="psi_2").savefig(file, format=format_)
        assert b"/Type3" not in file.getvalue()
        assert b"/FontType 3" not in file.getvalue()


@pytest.mark.parametrize(
    "look", [plt.style.library["dark_background"], {"figure.facecolor": "none", "axes.facecolor": "none"}]
)
def test_figures_are_dark_on_white_whatever_the_notebook_s_style(look: dict[Any, Any]) -> None:
    def saved() -> bytes:
        file = io.BytesIO()
        plot.draw("basin", settle_table(), **BASIN).savefig(file, metadata={"Software": None})
        return file.getvalue()

    plain = saved()
    with mpl.rc_context(look):
        assert saved() == plain


@pytest.mark.parametrize(
    ("fields", "sentence"),
    [
        ({"width": "wide"}, 'width is "wide", but must be column, page, or a number of mm from 50 to 500.'),
        (
            {"width": [85]},
            "width is a list (85), but must be column, page, or a number of mm from 50 to 500.",
        ),
        ({"width": 5}, "width is 5, but must be column, page, or a number of mm from 50 to 500."),
        ({"format": "pgf"}, 'format[0] is "pgf"'),
        ({"colours": {"trot": "blu"}}, 'colours.trot is "blu", but must be a colour'),
        ({"colours": {"trot": "none"}}, 'colours.trot is "none", but must be an opaque colour'),
        ({"colours": {"trot": "#0072B280"}}, 'colours.trot is "#0072B280", but must be an opaque colour'),
        ({"colour": {}}, "colour is not a field of a style; did you mean colours?"),
    ],
)
def test_what_a_style_does_not_allow_is_refused(fields: dict, sentence: str) -> None:
    with pytest.raises(StyleError) as refused, plot.style(**fields):
        pass
    assert sentence in str(refused.value)


@pytest.mark.parametrize("figures", [[], [{"kind": "basin_measures"}]])
def test_fields_of_a_figure_in_the_style_of_a_job_are_named_with_their_place(figures: list) -> None:
    with pytest.raises(gs.JobError) as refused:
        gs.Job(**JOB, figures=figures, style={"shares": False, "title": "Basins"})
    shares, title = str(refused.value).splitlines()
    assert "style.shares is not a field of a style: it belongs in an entry of figures (basin" in shares
    assert "style.title is not a field of a style: it belongs in an entry of figures (of any kind)" in title


@pytest.mark.slow
def test_a_job_has_a_style_that_its_figures_may_replace(
    tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    figures = [{"kind": "basin", "x": "psi_1", "y": "psi_2", "format": "svg"}, {"kind": "basin_measures"}]
    job = gs.Job(**JOB, style={"format": ["png", "pdf"], "width": "column"}, figures=figures)
    plain = gs.Job(**JOB)
    assert job.hash() == plain.hash()
    assert "style" not in plain.resolved()
    file = tmp_path / "styled.yaml"
    file.write_text(yaml.safe_dump(job.resolved()))
    result = gs.run(file, out=tmp_path / "results")
    assert [file.name for file in result.figures] == ["basin.svg", "basin_measures.pdf", "basin_measures.png"]
    assert main(["plot", str(result.path), "--format", "pdf", "--colour", "direct=crimson"]) == 0
    assert {file.name for file in Snapshot.of(result.path).figures} >= {"basin.pdf", "basin_measures.pdf"}
    assert main(["plot", str(result.path), "--width", "wide"]) == 2
    assert "width is" in capsys.readouterr().err
    assert main(["plot", str(result.path), "--colour", "direkt=crimson"]) != 0
    assert "did you mean direct?" in capsys.readouterr().err
    assert main(["plot", str(result.path), "--colour", "crimson"]) == 2
    assert "--colour: is crimson, but must be GAIT=COLOUR" in capsys.readouterr().err
    reset = [
        "--set",
        "shares=false",
        "--set",
        "title=none",
        "--set",
        "labels.psi_1=lag",
        "--panel-columns",
        "1",
    ]
    assert main(["plot", str(result.path), *reset, "--format", "svg", "--out", str(tmp_path / "own")]) == 0
    assert "source" in (own := (tmp_path / "own/basin.svg").read_text())
    assert "%" not in own  # the fonts are outlines, but the comments have the texts
    assert "<!-- lag -->" in own
    assert main(["plot", str(result.path), "--set", "sharse=false"]) == 2
    assert "did you mean shares?" in capsys.readouterr().err
    assert main(["plot", str(result.path), "--set", "shares=maybe"]) == 2
    assert "shares" in capsys.readouterr().err
    assert main(["plot", str(result.path), "--height", "10"]) != 0
    assert "needs at least" in capsys.readouterr().err
    assert {file.suffix[1:] for file in draw_figures(result.path)} == set(FORMATS)


def test_a_formula_is_as_long_as_its_letters_and_has_no_break() -> None:
    label = r"start ($\psi_{1}$, $\psi_{2}$, $\psi_{3}$), rad"
    assert wrapped(label, 1.9, 7.5) == label
    assert wrapped(r"drift of the sum $|m_{N + 1} - m_1|$ = 3", 1.4, 7.5).splitlines() == [
        "drift of the sum",
        r"$|m_{N + 1} - m_1|$ = 3",
    ]
    priced = wrapped(r"a price of \$5 beside $\alpha + \beta + \gamma$ of the gait", 1.0, 7.5)
    assert any(line.startswith(r"$\alpha + \beta + \gamma$") for line in priced.splitlines())


def test_remarks_on_a_meaning_are_not_in_a_label() -> None:
    table = pd.DataFrame({"k": [1.0]})
    for meaning, label in (
        ("feedback of the load; 0: none", "feedback of the load, $k$"),
        ("spring under a foot (body: tree)", "spring under a foot (body: tree), $k$"),
        ("1: pulls; 0: does not", "1: pulls; 0: does not, $k$"),
    ):
        table.attrs["quantities"] = {"k": {"unit": "1", "symbol": "k", "meaning": meaning}}
        assert described(table, "k") == label
    table = pd.DataFrame({"x_end_2": [1.0]})
    table.attrs["quantities"] = {"x_end": {"unit": "m", "symbol": "x", "meaning": "way"}}
    assert described(table, "x_end_2") == "way, $x$ (m)"


@pytest.mark.slow
def test_rows_of_panels_share_a_label() -> None:
    table = map_table()
    single = plot.draw("return_map", table, y="delta_13")
    assert getattr(single, "_supylabel") is None  # noqa: B009
    part = pd.concat([table.assign(f=f, row=table["row"] + 1000 * f) for f in (1, 2, 3)])
    figure = plot.draw("return_map", part, y="delta_13", panels="f", width="column")
    rendered(figure)
    label = getattr(figure, "_supylabel")  # noqa: B009
    assert "next" in label.get_text()
    assert [axes.get_ylabel() for axes in figure.axes] == [""] * 3
    assert [bool(axes.get_xlabel()) for axes in figure.axes] == [False, False, True]
    page = plot.draw("return_map", part, y="delta_13", panels="f")
    assert [bool(axes.get_xlabel()) for axes in page.axes] == [False, True, False]


def test_angles_as_multiples_of_pi() -> None:
    pi = np.pi
    assert [in_pi(angle) for angle in (0, pi, -pi, 2 * pi, pi / 2, -pi / 4, 3 * pi / 4)] == [
        "0",
        "π",
        "−π",
        "2π",
        "π/2",
        "−π/4",
        "3π/4",
    ]
    for steps in (1, 3):
        with pytest.raises(PlotError, match=f"steps is {steps}, but must be even"):
            angle_axis(Figure().subplots(), "x", steps=steps)
    assert [in_pi(angle, fractions=False) for angle in (0.75 * pi, -0.05 * pi)] == ["0.75π", "−0.05π"]
    figure = Figure()
    axes = figure.subplots()
    axes.set_xlim(2.2, 3.0)
    angle_ticks(axes, "x")
    rendered(figure)
    assert "0.85π" in [tick.get_text() for tick in axes.get_xticklabels()]


def test_wide_axes_of_angles_have_seven_ticks_at_most() -> None:
    axes = Figure().subplots()
    for turns, distance in ((3, 1.0), (10, 5.0), (5000, 2000.0)):
        axes.set_xlim(0, turns * 2 * np.pi)
        angle_ticks(axes, "x")
        ticks = axes.get_xticks() / np.pi
        np.testing.assert_allclose(np.diff(ticks), distance)
        assert sum((ticks >= 0) & (ticks <= 2 * turns)) <= 7
    assert in_pi(10.001 * np.pi, fractions=False) == "10.001π"
    axes = Figure().subplots()
    axes.plot([0.1, 0.2], [0.1, 0.2])
    with pytest.raises(PlotError, match="steps is 3, but must be even"):  # of a part of the circle, too
        angle_axis(axes, "x", steps=3)


@pytest.mark.parametrize(
    ("kind", "fields"),
    [
        ("loading_rule", {}),
        ("gait_shares", {"x": "k"}),
        ("source_place", {"x": ["k"]}),
        ("survival", {"x": "k"}),
    ],
)
def test_a_figure_refuses_a_table_that_its_analysis_refuses(kind: str, fields: dict[str, Any]) -> None:
    with pytest.raises(PlotError):
        plot.draw(kind, pd.DataFrame({"row": [0, 1], "k": [0.0, 1.0], "status": "settled"}), **fields)


def test_a_mapping_that_a_figure_takes_keeps_its_default() -> None:
    def draw(
        table: pd.DataFrame, *, labels: Annotated[Mapping[str, str], "labels of gaits"] = LABELS
    ) -> None:
        del table, labels

    _, field = fields_of(draw)["labels"]
    first, second = field.get_default(call_default_factory=True), field.get_default(call_default_factory=True)
    assert first == second == LABELS
    assert first is not second
