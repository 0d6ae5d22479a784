"""Labels of columns, and the colours of branches by a column."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from matplotlib.axes import Axes
from matplotlib.colors import to_hex

from gaitsweep import plot
from gaitsweep.mathtext import can_be_set, escape_unparsable
from gaitsweep.plot.column_labels import described, observable_in, symbol, written


@pytest.mark.parametrize(("name", "text"), [("m_1_", "m 1 "), ("k_1_x_", "k 1 x "), ("m_1", "$m_{1}$")])
def test_names_that_tex_cannot_have_are_written_as_words(name: str, text: str) -> None:
    assert symbol(pd.DataFrame({name: [1.0]}), name) == text


@pytest.mark.parametrize(
    ("meaning", "label"),
    [
        ("ipsilateral coupling, positive: antiphase", "ipsilateral coupling"),
        ("coupling, negative antiphase, positive: in phase", "coupling"),
        ("lateral coupling (left-right), negative: alternate", "lateral coupling (left-right)"),
        ("touchdown of LH, after that of LF; NaN without steps", "touchdown of LH, after that of LF"),
    ],
)
def test_a_label_keeps_the_sense_of_a_meaning_without_its_remark(meaning: str, label: str) -> None:
    table = pd.DataFrame({"K_ips": [1.0]})
    table.attrs["quantities"] = {"K_ips": {"unit": "1/s", "meaning": meaning}}
    assert described(table, "K_ips", 80) == rf"{label}, $K_{{\mathrm{{ips}}}}$ (1/s)"


def test_a_start_value_is_its_symbol_at_time_0_and_no_index_has_an_index() -> None:
    table = pd.DataFrame({"phi_3_0": [1.0], "m_1_0": [1.0]})
    table.attrs["quantities"] = {"phi_3_0": {"unit": "rad", "meaning": "phase of leg 3 at the start"}}
    assert symbol(table, "phi_3_0") == r"$\phi_{3}(0)$"
    assert symbol(table, "m_1_0") == "$m_{1,0}$"
    assert can_be_set(symbol(table, "phi_3_0"))


def test_a_swept_parameter_records_no_observable() -> None:
    """`m_end` is the mass of an end as an axis, and the last `m` of a row behind its status."""
    m = {"unit": "kg", "symbol": None, "meaning": "mass"}
    swept = pd.DataFrame({"row": [0], "m_end": [1.0], "status": ["settled"]})
    swept.attrs["quantities"] = {"m": m, "m_end": m}
    recorded = pd.DataFrame(swept[["row", "status", "m_end"]])
    assert observable_in(swept, "m_end") == "m_end"
    assert symbol(swept, "m_end") == r"$m_{\mathrm{end}}$"
    assert symbol(recorded, "m_end") == "$m$"
    indices = pd.DataFrame({"parameter": ["m_end"]})
    indices.attrs["quantities"] = {"m": m, "m_end": m}
    assert observable_in(indices, "m_end") == "m_end"
    for name, observable in {"psi_1_end": "psi_1", "speed_n": "speed", "t_end": "t_end"}.items():
        assert observable_in(pd.DataFrame({name: [1.0]}), name) == observable


@pytest.mark.parametrize(
    ("value", "of_angle", "of_number"),
    [
        (-0.0, "$0$", "0"),
        (np.nan, "nan", "nan"),
        (True, "True", "True"),
        (-np.pi, r"$-\pi$", "−3.142"),
        (1.0, r"$0.318\,\pi$", "1"),
    ],
)
def test_values_that_are_no_multiples_of_pi(value: float, of_angle: str, of_number: str) -> None:
    table = pd.DataFrame({"q": [0.0], "u": [0.0]})
    table.attrs["quantities"] = {
        "q": {"unit": "rad", "symbol": "q", "circular": True},
        "u": {"unit": "1", "symbol": "u", "circular": False},
    }
    assert written(table, "q", value) == f"$q$ = {of_angle}"
    assert written(table, "u", value) == f"$u$ = {of_number}"


def test_values_of_a_column_are_told_apart() -> None:
    """Also seeds above 10 000, and angles that differ by less than a thousandth of pi; text stays text."""
    near, word = 0.5 * np.pi * (1.0 + 1e-5), "walk"
    table = pd.DataFrame({"row": [0, 1], "seed": [10_000, 10_001], "q": [0.5 * np.pi, near], "gait": word})
    table.attrs["quantities"] = {"q": {"unit": "rad", "symbol": "q", "circular": True}}
    assert [written(table, "seed", value).split(" = ")[1] for value in table["seed"]] == ["10000", "10001"]
    far = table.assign(seed=[12_345, 20_006])  # which are told apart by fewer digits than they have
    assert [written(far, "seed", value).split(" = ")[1] for value in far["seed"]] == ["12345", "20006"]
    assert [written(table, "q", value) for value in table["q"]] == [
        rf"$q$ = $0.5{x}\,\pi$" for x in ("", "0001")
    ]
    assert written(table, "gait", word).endswith(" = walk")


def test_escaped_dollars_are_not_escaped_again() -> None:
    text = escape_unparsable(r"a \$ and $\nothing{$")
    assert text == r"a \$ and \$\nothing{\$"
    assert can_be_set(text)
    assert escape_unparsable(r"\$5 for $x$") == r"\$5 for $x$"


def branches(**of_rows: list[object]) -> pd.DataFrame:
    """Three branches, each with a level of its own."""
    parts = []
    for row in range(3):
        part = pd.DataFrame({"row": row, "point": range(4), "p": np.linspace(0.0, 1.0, 4), "y_n": float(row)})
        parts.append(part.assign(stable=True, special="", **{k: v[row] for k, v in of_rows.items()}))
    return pd.concat(parts, ignore_index=True)


def colours_of_lines(axes: Axes) -> dict[float, str]:
    """The colour of each branch, by its level."""
    lines = [line for line in axes.lines if len(line.get_xdata()) > 2]  # pyright: ignore[reportArgumentType]
    return {float(np.nanmax(np.asarray(line.get_ydata(), float))): to_hex(line.get_color()) for line in lines}


def test_the_legend_has_the_colours_of_branches() -> None:
    table = branches(gait=["amble", "canter", "amble"])
    with plot.style(order=["canter", "amble"]):
        figure = plot.continuation(table, y="y", x="p", hue="gait")
    lines = colours_of_lines(figure.axes[0])
    (legend,) = figure.legends
    named = {
        text.get_text(): to_hex(line.get_color())
        for text, line in zip(legend.get_texts(), legend.get_lines(), strict=False)
    }
    assert lines == {0.0: named["amble"], 1.0: named["canter"], 2.0: named["amble"]}
    assert named["amble"] != named["canter"]


def test_a_branch_without_a_number_is_grey() -> None:
    figure = plot.continuation(branches(mass=[1.0, np.nan, 2.0]), y="y", x="p", hue="mass")
    low, none, high = (colours_of_lines(figure.axes[0])[level] for level in (0.0, 1.0, 2.0))
    assert (low, high) == ("#440154", "#fde725")  # the ends of viridis
    assert none == plot.theme.COLOURS["none"].lower()
    empty = plot.continuation(branches(mass=[np.nan] * 3), y="y", x="p", hue="mass")
    assert set(colours_of_lines(empty.axes[0]).values()) == {none}


def test_a_branch_without_a_name_is_grey() -> None:
    grey = plot.theme.COLOURS["none"].lower()
    figure = plot.continuation(branches(gait=["amble", None, "canter"]), y="y", x="p", hue="gait")
    lines = colours_of_lines(figure.axes[0])
    assert lines[1.0] == grey
    assert grey not in (lines[0.0], lines[2.0])
    assert "no gait" in [text.get_text() for text in figure.legends[0].get_texts()]
