"""Figures of hysteresis, return maps, branches and gait maps from small synthetic tables: what they show."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from matplotlib.colors import to_hex, to_rgb, to_rgba
from matplotlib.figure import Figure
from matplotlib.patches import FancyArrowPatch, Rectangle

from gaitsweep import plot
from gaitsweep.extension import gait_styles
from gaitsweep.plot import PlotError
from gaitsweep.plot.bifurcations.passes import DOWN, UP
from gaitsweep.plot.theme import COLOURS, HATCH, angle_ticks, in_pi
from tests.support.hysteresis_tables import (
    FOLD,
    delta,
    map_table,
    ramp_table,
    roots,
    settle_table,
    staircase_table,
)
from tests.support.plot_tables import rendered


def texts(figure: Figure) -> list[str]:
    return [text.get_text() for legend in figure.legends for text in legend.get_texts()]


def labels(axes) -> list[str]:
    return [text.get_text() for text in axes.get_legend().get_texts()]


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


def test_hysteresis_of_a_staircase_marks_the_jumps() -> None:
    figure = plot.draw("hysteresis", staircase_table(), y="delta_13", title="Hysteresis")
    rendered(figure)
    axes = figure.axes[0]
    assert axes.get_xlabel() == "stiffness frequency of the joint, $f$ (Hz)"
    assert axes.get_ylabel() == "phase of the fore leg ahead of\nthe hind leg, $\\Delta_{13}$ (rad)"
    assert axes.get_title() == "held at each value"
    assert labels(axes) == ["$f$ rises: 0.3 to 0.4 Hz", "$f$ falls: −0.4 to −0.3 Hz"]
    assert bars(axes) == {UP: pytest.approx([0.3, 0.4]), DOWN: pytest.approx([-0.4, -0.3])}
    assert texts(figure) == ["$f$ rises →", "$f$ falls ←"]
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


def test_arrows_are_along_a_row_that_stands_on_a_branch() -> None:
    """Row 0 goes to and fro far above the others: no arrow is there, and it is not counted."""
    table = staircase_table(2)
    wild = table["row"] == 0
    table.loc[wild, "delta_13_n"] = np.where(np.arange(np.sum(wild)) % 2, 4.5, 5.5)
    axes, strip = plot.hysteresis(table, y="delta_13").axes
    arrows = [patch for patch in axes.patches if isinstance(patch, FancyArrowPatch)]
    assert len(arrows) == 2
    assert all(np.asarray(patch.get_path().vertices)[:, 1].max() < 3.5 for patch in arrows)
    assert all(text.endswith("1 of 2 rows") for text in labels(strip))


def test_irregular_passes_stand_apart_with_the_ticks_near_them() -> None:
    """A row that wanders about zero is not among the branches, whose axis it would stretch."""
    table = staircase_table(4, hold=40)
    wild = (table["row"] == 2).to_numpy()
    table.loc[wild, "delta_13_n"] = np.mod(np.tile([0.6, -0.4, 0.1], wild.sum())[: wild.sum()], 2 * np.pi)
    figure = plot.draw(
        "hysteresis", table, y="delta_13", ticks={"trot": np.pi, "walk": np.pi / 2, "pace": 0.0}
    )
    rendered(figure)
    axes, strip = figure.axes
    assert strip.get_title("left") == "irregular, on no branch: 1 of 4 rows"
    assert 1.4 < axes.get_ylim()[0] < axes.get_ylim()[1] < 3.4
    assert -1.0 < strip.get_ylim()[0] < strip.get_ylim()[1] < 1.0
    points = sum(np.size(line.get_xdata()) for line in strip.lines if line.get_marker() == ".")
    assert points == wild.sum()
    names = [[tick.get_text() for tick in each.child_axes[0].get_yticklabels()] for each in (axes, strip)]
    assert names == [["trot", "walk"], ["pace"]]
    assert all(text.endswith("3 of 4 rows") for text in labels(strip))


def test_arrows_stand_where_the_passes_differ_and_nowhere_else() -> None:
    axes = plot.hysteresis(staircase_table(), y="delta_13").axes[0]
    for arrow in (patch for patch in axes.patches if isinstance(patch, FancyArrowPatch)):
        ends = [x for x, _ in arrow._posA_posB]  # type: ignore[attr-defined]
        assert -FOLD < min(ends) < max(ends) < FOLD
    same = staircase_table()
    same["delta_13_n"] = delta(0.2 * same["f"].to_numpy())  # one branch, the same both ways
    axes = plot.hysteresis(same, y="delta_13").axes[0]
    assert not [patch for patch in axes.patches if isinstance(patch, FancyArrowPatch)]


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
    """Jumps lie in the speeds of the records between which they are, which fall as f rises."""
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
    assert texts(figure) == ["$f$ rises →", "$f$ falls ←", "hold not settled"]
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


def test_hysteresis_of_an_angle_that_goes_over_zero_is_not_torn() -> None:
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
    assert labels(figure.axes[0])[0] == "$f$ rises: 0.3 to 0.4 Hz, 3 of 3 rows"
    with pytest.raises(PlotError, match="moves no parameter"):
        plot.hysteresis(map_table(starts=3), y="delta_13")


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
    assert texts(figure) == [
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


def test_a_return_map_whose_points_lie_near_the_diagonal_is_drawn_as_the_change() -> None:
    for eps, form in ((0.02, "change of"), (0.9, "$\\Delta_{13}$ at")):
        table = map_table([0.0], starts=60, crossings=20, eps=eps)
        assert plot.return_map(table, y="delta_13").axes[0].get_ylabel().startswith(form)


def test_branches_are_solid_where_stable_and_open_where_not() -> None:
    values = np.round(np.linspace(-0.6, 0.6, 7), 3)
    table = map_table(values, starts=60, crossings=60, noise=0.002)
    table = table.loc[(table["f"] < 0.5) | (table["crossing"] > 59)]  # no pairs at the last value
    figure = plot.draw("branches", table, y="delta_13", x="f")
    rendered(figure)
    axes = figure.axes[0]
    assert texts(figure) == [
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


def test_gait_map_names_the_set_of_each_cell() -> None:
    table = settle_table(np.linspace(-0.8, 0.8, 9), [-1.0, 0.0, 1.0], others=[0.7, 0.75, 0.8])
    table.loc[table["beta"] == 0.8, "status"] = "fell"
    table.loc[(table["beta"] == 0.8) & (table["f"] == 0.8), "status"] = "cycle_limit"
    table.loc[(table["beta"] == 0.7) & (table["f"] == 0.8), "gait"] = "none"
    table.loc[(table["beta"] == 0.75) & (table["f"] == 0.8) & (table["delta_13"] < 2.5), "status"] = "fell"
    figure = plot.draw("gait_map", table, x="f", y="beta")
    rendered(figure)
    axes = figure.axes[0]
    names = ["trot only", "walk only", "trot and walk", "trot; another start failed"]
    names += ["another gait", "not settled", "failed"]
    assert [text.rsplit("  ")[0] for text in texts(figure)] == names
    cells = np.asarray(axes.collections[0].get_facecolor()).reshape(3, 9, 4)
    # darker: its start from the walk fell
    assert max(cells[1, 8][:3]) < max(to_rgba(gait_styles()["trot"][0])[:3])
    assert tuple(cells[1, 0]) == to_rgba(gait_styles()["walk"][0])
    assert tuple(cells[1, 4]) == to_rgba(gait_styles()["trot"][0])
    (striped,) = [each for each in axes.patches if each.get_edgecolor() == to_rgba(gait_styles()["walk"][0])]
    assert striped.get_path().contains_point((0.0, 0.75))
    assert tuple(cells[0, 8]) == to_rgba(COLOURS["none"])
    assert len([patch for patch in axes.patches if patch.get_hatch() == HATCH]) == 2
    assert sum(int(text.split("  ")[1].split()[0]) for text in texts(figure)) in (99, 100, 101)


def test_gait_map_of_starts_on_no_grid() -> None:
    table = settle_table([0.0], [-1.0, 1.0], others=np.sort(np.random.default_rng(0).uniform(0.6, 0.9, 12)))
    table["f"] = np.random.default_rng(1).uniform(-1, 1, 12).repeat(2)
    figure = plot.gait_map(table, x="f", y="beta")
    rendered(figure)
    assert sum(len(np.asarray(line.get_xdata())) for line in figure.axes[0].lines) == 12


def test_gait_map_of_values_that_the_job_draws_has_points() -> None:
    """A Sobol sequence of 24 values lies on a grid of 32, of which 8 columns would be empty stripes."""
    drawn = (np.arange(32)[np.arange(32) % 4 > 0] + 0.5) / 32
    table = settle_table([0.7, 0.75, 0.8], [-1.0, 1.0], others=drawn).rename(
        columns={"f": "beta", "beta": "f"}
    )
    table.attrs["job"] = {"vary": {"f": {"sobol": [0, 1, 24]}, "beta": [0.7, 0.75, 0.8]}}
    axes = plot.gait_map(table, x="f", y="beta").axes[0]
    assert not axes.collections
    assert sum(len(np.asarray(line.get_xdata())) for line in axes.lines) == 3 * 24


@pytest.mark.parametrize(
    ("kind", "spec", "sentence"),
    [
        (
            "hysteresis",
            {"y": "delta_31"},
            r"delta_31 is not a column of this table; did you mean delta_13_n\?",
        ),
        ("hysteresis", {"y": "delta_13", "parameter": "beta"}, "beta is not a column"),
        ("hysteresis", {"y": "delta_13", "panels": "mas"}, "mas is not a column"),
        ("return_map", {"y": "delta_13", "panels": "beta"}, "beta is not a column"),
        ("return_map", {"y": "delta_13", "form": "both"}, "form is both, but must be change or next"),
        ("branches", {"y": "delta_13", "x": "beta"}, "beta is not a column"),
        ("gait_map", {"x": "f", "y": "beta"}, "beta is not a column"),
        ("gait_map", {"x": "f", "y": "t", "hue": "gate"}, "gate is not a column"),
    ],
)
def test_what_is_not_there_is_refused(kind: str, spec: dict, sentence: str) -> None:
    with pytest.raises(PlotError, match=sentence):
        plot.draw(kind, ramp_table(steps=10), **spec)


@pytest.mark.parametrize("whole", ["none of its rows", "failed", "no numbers", "one record"])
def test_tables_of_little_use_do_not_crash(whole: str) -> None:
    tables = [
        ramp_table(steps=60),
        staircase_table(hold=5),
        map_table(starts=5, crossings=5),
        settle_table([0.0], [1.0]),
    ]
    for number, table in enumerate(tables):
        kept = dict(table.attrs)
        if whole == "none of its rows":
            table = table.iloc[:0]
        elif whole == "failed":
            table["status"] = pd.Categorical(["fell"] * len(table))
        elif whole == "no numbers":
            values = [name for name in table.columns if name.startswith("delta_13_")]
            table = table.assign(**dict.fromkeys(values, np.nan), gait=np.nan)
        else:
            table = table.iloc[:1]
        table.attrs = kept
        tables[number] = table
    ramp, stairs, crossings, settled = tables
    rendered(plot.hysteresis(ramp, y="delta_13", with_table=stairs))
    rendered(plot.return_map(crossings, y="delta_13", panels="f"))
    rendered(plot.return_map(crossings, y="delta_13", form="next"))
    rendered(plot.branches(crossings, y="delta_13", x="f"))
    rendered(plot.gait_map(settled, x="f", y="beta"))


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


def test_where_each_gait_is_lost() -> None:
    """Walk is lost as f rises through FOLD, trot as it falls through -FOLD; rows that fell are below."""
    table = settle_table(np.linspace(-0.8, 0.8, 81), [-1.0, 1.0], others=[0.75])
    table.loc[table.index[-2:], "status"] = ["fell", "cycle_limit"]
    figure = plot.draw("gait_transitions", table, x="f", y="delta_13", start="delta_13")
    rendered(figure)
    assert texts(figure) == [
        "trot",
        "walk",
        "not settled",
        "failed",
        "trot lost as $f$ falls: -0.4 to -0.38 Hz",
        "walk lost as $f$ rises: 0.38 to 0.4 Hz",
    ]
    assert len(figure.axes[0].patches) == 2
