"""Styles of figures: where they come from, which takes precedence, what they change; angles on axes."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
import pytest
import yaml
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure

import gaitsweep as gs
from gaitsweep import plot
from gaitsweep.cli import main
from gaitsweep.plot.columns import PlotError
from gaitsweep.plot.figure_style import FORMATS, StyleError
from gaitsweep.plot.theme import angle_ticks, in_pi
from gaitsweep.runs.figures import draw_figures
from gaitsweep.table import Snapshot
from tests.support.plot_tables import rendered, settle_table

BASIN = {"x": "psi_1", "y": "psi_2", "panels": "psi_3"}
JOB = {
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
    plt.close(figure)


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
        ({"width": 5}, "width is 5, but must be column, page, or a number of mm from 50 to 500."),
        ({"format": "pgf"}, 'format[0] is "pgf"'),
        ({"colours": {"trot": "blu"}}, 'colours.trot is "blu", but must be a colour'),
        ({"colour": {}}, "colour is not a field of a style; did you mean colours?"),
    ],
)
def test_what_a_style_does_not_allow_is_refused(fields: dict, sentence: str) -> None:
    with pytest.raises(StyleError) as refused, plot.style(**fields):
        pass
    assert sentence in str(refused.value)


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
    assert {file.suffix[1:] for file in draw_figures(result.path)} == set(FORMATS)


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
    assert [in_pi(angle, fractions=False) for angle in (0.75 * pi, -0.05 * pi)] == ["0.75π", "−0.05π"]
    figure = Figure()
    axes = figure.subplots()
    axes.set_xlim(2.2, 3.0)
    angle_ticks(axes, "x")
    rendered(figure)
    assert "0.85π" in [tick.get_text() for tick in axes.get_xticklabels()]
