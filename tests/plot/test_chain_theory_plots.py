"""The figures of the chain's theory and waves, and what footprints say of free links and lost contacts."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from gaitsweep import plot
from gaitsweep.papers.ambe2021.figures.chain_theory import SHOWN, theory_figure
from gaitsweep.papers.ambe2021.theory.chain import Chain, touchdown_phase
from gaitsweep.papers.ambe2021.theory.solution_sets import Branch, places, rule_of
from tests.support.plot_tables import rendered, settle_table, trace_table

OMEGA = 0.4


def walking(branches: list[Branch], N: int = 3, share: float = 0.5, duration: float = 50.0) -> pd.DataFrame:
    """Traces of the reduced chain along its analytic solutions, one row each."""
    circle, parts = float(touchdown_phase(Chain())), []
    for row, branch in enumerate(branches):
        rule = rule_of(N, branch, Chain())
        theta = np.asarray(places(rule, rule.low + share * (rule.high - rule.low)))
        t = np.arange(0.0, duration, 0.05)
        phase = np.mod(theta + OMEGA * t[:, None] + 0.01, circle)
        columns = {"row": row, "omega": OMEGA, "t": t}
        for i in range(N + 1):
            down = (phase[:, i] < 1.65 * np.pi).astype(float)
            columns |= {f"phase_{i + 1}": phase[:, i], f"x_{i + 1}": 1.0, f"l_{i + 1}": 1.0}
            columns |= {f"contact_{i + 1}": down}
        parts.append(pd.DataFrame(columns))
    table = pd.concat(parts, ignore_index=True)
    table.attrs["job"] = {"model": "multilegged", "structure": {"N": N}}
    return table


@pytest.mark.parametrize("show", SHOWN)
def test_the_theory_is_drawn_for_the_chain_of_a_table(show: str) -> None:
    rendered(plot.chain_theory(settle_table(), show=show))


def test_the_free_phase_turns_at_psi_b() -> None:
    axes = theory_figure(3, Chain(), show="free_phase").axes[0]
    (set_a, set_b), b = axes.lines[0:3:2] if len(axes.lines) < 3 else _sets_of(axes), 0.153938
    psi_A, psi_B = 0.4 * np.pi - 1.7 * b, 0.4 * np.pi - 0.9 * b
    assert set_a.get_xdata() == pytest.approx([psi_A, psi_B], abs=1e-5)
    assert set_b.get_xdata() == pytest.approx([psi_B, 1.6 * np.pi], abs=1e-5)
    assert set_b.get_ydata() == pytest.approx([1.6 * np.pi + 1.7 * b] * 2, abs=1e-5)
    assert np.ptp(set_a.get_ydata()) == pytest.approx(psi_B - psi_A, abs=1e-5)  # eq. (20): slope 1


def _sets_of(axes: object) -> list:
    return [line for line in axes.lines if str(line.get_label()).startswith("solution set")]  # type: ignore[attr-defined]


def test_the_order_of_touchdowns_is_numbered_leg_by_leg() -> None:
    left = theory_figure(9, Chain(), show="order", k=2, at=0.45).axes[0]
    texts = [text.get_text() for text in left.texts]
    assert texts[::2] == ["6", "1", "3", "5", "7", "8", "9", "10", "2", "4"]  # 2 9 3 10 4 1 5 6 7 8
    assert texts[1::2] == [f"$S_{{{i}}}$" for i in (2, 3, 6, 6, 6, 6, 6, 4, 3, 8)]


@pytest.mark.parametrize(
    ("given", "words"),
    [({"show": "everything"}, "show is everything"), ({"show": "sets", "k": 4}, "k = 2 to 3"),
     ({"show": "order", "at": 1.5}, "between 0 and 1")],
)  # fmt: skip
def test_what_the_theory_cannot_show_is_refused(given: dict, words: str) -> None:
    with pytest.raises(plot.PlotError, match=words):
        plot.chain_theory(settle_table(), **given)


def test_the_theory_of_a_table_of_another_model_is_refused() -> None:
    with pytest.raises(plot.PlotError, match="multi-legged chain"):
        plot.chain_theory(pd.DataFrame({"row": [0], "t": [0.0]}), show="sets")


def test_wave_speed_shows_measured_waves_on_the_theorys_curves() -> None:
    table = walking([Branch("direct", 3), Branch("B", 2)]).assign(omega=lambda each: 0.4 + 0.0 * each["row"])
    figure = plot.wave_speed(table, x="omega")
    for axes, expected in zip(figure.axes, (6.175876, 0.402033), strict=True):
        dots = np.concatenate([np.asarray(each.get_offsets()) for each in axes.collections])
        assert dots[:, 1] == pytest.approx([expected] * 2, abs=1e-6)
    rendered(figure)
    assert plot.wave_speed(table.head(0), x="omega").axes[0].texts[0].get_text() == "no rows yet"
    with pytest.raises(plot.PlotError, match="two cycles"):
        plot.wave_speed(table.loc[table["t"] < 12.0], x="omega")
    both = table.assign(beta=0.8 + 0.0 * table["row"])
    both = both[["row", "beta", *table.columns[1:]]].assign(omega=0.4 + 0.1 * table["row"])
    both.attrs = table.attrs
    with pytest.raises(plot.PlotError, match="in this table omega varies at one beta, too"):
        plot.wave_speed(both, x="beta")


def test_footprints_of_the_chain_mark_the_link_whose_lag_is_free() -> None:
    figure = plot.footprints(walking([Branch("direct", 3), Branch("B", 2), Branch("B", 3)]))
    panels = [axes for axes in figure.axes if axes.get_yticklabels()]
    for axes, free in zip(panels, (2, 0, 1), strict=True):
        links = {(np.asarray(line.get_ydata())[0], line.get_color()) for line in axes.lines}
        assert {link for link, colour in links if colour == "#CC79A7"} <= {free}
        assert {link for link, colour in links if colour != "#CC79A7"} == {0, 1, 2} - {free}
    assert "the lag of this link is free" in [text.get_text() for text in figure.legends[0].get_texts()]
    # other models have no such link
    words = [text.get_text() for text in plot.footprints(trace_table()).legends[0].get_texts()]
    assert "the lag of this link is free" not in words


def bars_of(table: pd.DataFrame) -> list[list[tuple[float, float]]]:
    """The ends (s) of the bars of each leg in the first panel."""
    extents = [
        [path.get_extents() for path in bars.get_paths()]
        for bars in plot.footprints(table, guides=False).axes[0].collections
    ]
    return [[(round(each.x0, 3), round(each.x1, 3)) for each in of_leg] for of_leg in extents]


def stepping(legs: list[list[tuple[float, float]]], duration: float) -> pd.DataFrame:
    """A trace of legs that are on the ground between these times, s."""
    t = np.arange(0.0005, duration, 0.001)
    down = [np.any([(a <= t) & (t < b) for a, b in stances], axis=0) for stances in legs]
    return pd.DataFrame({"row": 0, "t": t, **{f"contact_{i + 1}": each * 1.0 for i, each in enumerate(down)}})


def test_a_swing_is_no_loss_within_a_stance_if_another_of_its_leg_is_twice_as_long() -> None:
    """A quadruped on the moon: a leg that leaves a cycle out swings for more than two of its other swings."""
    regular = [(0.15 + 0.31 * k, 0.22 + 0.31 * k) for k in range(6)]
    leaves_out = [(0.05, 0.09), (0.62, 0.70), (0.966, 1.0), (1.527, 1.608), (1.856, 1.91)]
    assert bars_of(stepping([regular, leaves_out], 2.0)) == [
        [(round(a, 3), round(b, 3)) for a, b in stances] for stances in (regular, leaves_out)
    ]


def test_losses_are_filled_up_to_an_eighth_of_the_cycle_and_half_of_the_longest_swing() -> None:
    for loss, filled in ((0.12, True), (0.13, False)):
        stances = [(k + start, k + end) for k in range(6) for start, end in ((0.0, 0.3), (0.3 + loss, 0.6))]
        assert len(bars_of(stepping([stances], 6.0))[0]) == (6 if filled else 12)
    swings = [(k + 0.02, k + 1.0) for k in range(6)]  # shorter than an eighth, but there are no longer ones
    assert len(bars_of(stepping([swings], 6.0))[0]) == 6
    once = [(0.0, 0.3), (0.32, 0.6), (0.9, 1.1)]  # a single step: no cycle is known
    assert len(bars_of(stepping([once], 1.2))[0]) == 3


def test_short_losses_of_contact_are_filled_and_said() -> None:
    table = trace_table(4, 1)
    loose = table["t"].between(5.02, 5.12)
    chattering = table.assign(contact_1=table["contact_1"].where(~loose, 0.0))
    bars = [
        path.get_extents().width for path in plot.footprints(chattering).axes[0].collections[0].get_paths()
    ]
    whole = [path.get_extents().width for path in plot.footprints(table).axes[0].collections[0].get_paths()]
    assert bars == pytest.approx(whole)
    message = plot.footprints(chattering).legends[0].get_title().get_text()
    assert message == "1 loss of contact within a stance filled, of 0.1 s at most"
    assert plot.footprints(table).legends[0].get_title().get_text() == ""
