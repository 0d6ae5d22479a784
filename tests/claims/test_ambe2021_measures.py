"""The measures of Ambe et al. (2021) on small tables made from the theory, whose values are known."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest

from gaitsweep import ArgumentError, plot
from gaitsweep.claims.claims_and_verdicts import ClaimVerdict, read_paper, verdict
from gaitsweep.claims.measures import MeasureError
from gaitsweep.errors import UserError
from gaitsweep.papers.ambe2021 import (
    equation_measures,
    settled_measures,
    theory_measures,
    wave_measures,
)
from gaitsweep.papers.ambe2021.analysis.travelling_wave import source_place, waves
from gaitsweep.papers.ambe2021.multilegged.forces import obstacle_problem
from gaitsweep.papers.ambe2021.theory.chain import Chain, touchdown_phase
from gaitsweep.papers.ambe2021.theory.solution_sets import Branch, places, rule_of

N = 9
LEGS = list(range(1, N + 1))  # of ten legs those that follow one another in a direct wave
OMEGA = 0.4
ROWS = [Branch("direct", N), Branch("B", 2), Branch("B", 6)]
CIRCLE = float(touchdown_phase(Chain()))


def trace(branch: Branch, at: float, row: int, springs: int = N) -> pd.DataFrame:
    """The reduced chain along a solution: phases turn at omega from 0 to the touchdown phase."""
    rule = rule_of(springs, branch, Chain())
    theta = np.asarray(places(rule, rule.low + at * (rule.high - rule.low)))
    t = np.arange(0.0, 50.0, 0.05)
    phase = np.mod(theta + OMEGA * t[:, None] + 0.01, CIRCLE)
    legs = range(1, springs + 2)
    columns = {f"phase_{i}": phase[:, i - 1] for i in legs}
    columns |= {f"contact_{i}": (phase[:, i - 1] < 1.65 * np.pi).astype(float) for i in legs}
    return pd.DataFrame({"row": row, "t": t, **columns})


@pytest.fixture(scope="module")
def table() -> pd.DataFrame:
    return pd.concat([trace(branch, 0.3, row) for row, branch in enumerate(ROWS)], ignore_index=True)


@pytest.mark.slow
def test_waves_of_the_theory_have_its_wavelength_and_exact_speed(table: pd.DataFrame) -> None:
    result = waves(table)
    assert list(result["gait"]) == ["direct", "retrograde", "source"]
    assert list(result["k"]) == [0, 2, 6]
    assert list(result["free_link"]) == [9, 1, 5]
    assert np.allclose(result["wavelength"], result["wavelength_27"], atol=1e-9)
    assert np.allclose(result["speed"], result["speed_exact"], atol=1e-9)
    assert np.allclose(result["period"], CIRCLE / OMEGA, atol=1e-9)
    assert np.max(result["spread"]) < 1e-9
    assert np.max(result["distance"]) < 1e-6


def test_directions_and_order_of_a_wave(table: pd.DataFrame) -> None:
    assert wave_measures.directions(table, row=0) == ["forwards"] * 8 + ["free"]
    assert wave_measures.directions(table, row=1) == ["free"] + ["backwards"] * 8
    assert wave_measures.directions(table, row=2) == ["forwards"] * 4 + ["free"] + ["backwards"] * 4
    part = [2, 3, 4, 5, 6, 7, 8, 9]
    assert wave_measures.simulated_order(table, row=1, legs=part) == "2 9 3 4 5 6 7 8"
    sets = wave_measures.reset_set_numbers(table, row=1, k=2)
    assert sets == [2.0, 3.0, 6.0, 6.0, 6.0, 6.0, 6.0, 4.0, 3.0, 8.0]
    assert wave_measures.leads(table, row=0, links=[1, 2]) == pytest.approx([0.994942393] * 2, abs=1e-8)
    with pytest.raises(ArgumentError, match=r"links has 0, but .* 1 to 9"):
        wave_measures.leads(table, row=0, links=[0])
    assert wave_measures.neighbours_at_touchdown(table, row=2, k=6) == 1.0
    assert wave_measures.neighbours_at_touchdown(table, row=0, k=6) < 0.6
    assert wave_measures.one_swing_share(table, row=0, of=list(range(1, 10))) == 1.0
    assert wave_measures.touchdown_phases_apart(table) < 1e-9


def test_touchdowns_of_long_traces_count_too(table: pd.DataFrame) -> None:
    """A source wave for a cycle and a half, and a direct wave for many: the share is that of the latter."""
    cycle = round(CIRCLE / OMEGA / 0.05)
    source, direct = (table.loc[table["row"] == row] for row in (2, 0))
    parts = [source.iloc[: 3 * cycle // 2], *[direct.iloc[: 3 * cycle]] * 20]
    long = pd.concat(parts, ignore_index=True).assign(row=0)
    long["t"] = 0.05 * np.arange(len(long))
    assert wave_measures.neighbours_at_touchdown(long, row=0, k=6) < 0.65


def test_a_trace_of_less_than_two_cycles_is_refused(table: pd.DataFrame) -> None:
    with pytest.raises(UserError, match="at least two cycles"):
        waves(table.loc[table["t"] < 20.0])
    few = table.loc[table["t"] % 3.0 < 0.04]  # every 3 s, by which a phase turns by more than 1 rad
    with pytest.raises(UserError, match="smaller interval between samples"):
        waves(few)


def settled(gait: str, psi: np.ndarray) -> pd.DataFrame:
    columns = {f"psi_{i + 1}_end": psi[:, i] for i in range(3)}
    return pd.DataFrame({"status": "settled", "gait": gait, "distance": 0.05, **columns})


def test_three_lines_at_right_angles() -> None:
    s = np.linspace(1.1, 5.1, 41)
    one, low, high = np.ones_like(s), 1.1 * np.ones_like(s), 5.3 * np.ones_like(s)
    table = pd.concat(
        [
            settled("direct", np.stack([low, one, s], axis=1)),
            settled("source", np.stack([low, s, high], axis=1)),
            settled("retrograde", np.stack([s, high, high], axis=1)),
        ],
        ignore_index=True,
    )
    assert settled_measures.angles_of_lines(table) == pytest.approx([90.0, 90.0], abs=1e-9)
    assert settled_measures.distance_from_planes(table) == pytest.approx(0.0, abs=1e-12)
    assert settled_measures.gap_between_lines(table)[1] == pytest.approx(0.2, abs=1e-9)
    assert settled_measures.free_range(table, gait="source", phase="psi_2") == pytest.approx([1.1, 5.1])
    assert settled_measures.gait_ends(table, gait="direct", phases=["psi_1", "psi_3"]) == pytest.approx(
        [1.1, 3.1]
    )
    single = table.drop_duplicates("gait")
    with pytest.raises(MeasureError, match="two settled rows of the gait direct that differ"):
        settled_measures.angles_of_lines(single)
    bent = settled("source", np.stack([low, s, np.minimum(s + 4.0, 5.3)], axis=1))
    result = settled_measures.slopes_of_segments(
        bent, gait="source", free="psi_2", other="psi_3", within=0.15
    )
    assert result == pytest.approx([1.0, 0.0])
    with pytest.raises(MeasureError, match="two settled rows of the gait source"):
        settled_measures.slopes_of_segments(bent.head(3), gait="source", free="psi_2", other="psi_3")
    table.loc[3, "psi_2_end"] += 0.5  # off both planes only where psi_1 and psi_3 are, too
    assert settled_measures.distance_from_planes(table) == pytest.approx(0.0, abs=1e-12)


def test_lines_over_the_branch_cut_are_those_of_other_places() -> None:
    """All phases are moved by 4.5 rad, so that those of the free phase go over 2 pi."""
    s = np.linspace(1.1, 5.1, 41)
    states = np.stack([0.1 + 0.05 * s, np.full_like(s, 1.783), s], axis=1)
    table, moved = (settled("direct", (states + shift) % (2.0 * np.pi)) for shift in (0.0, 4.5))
    for of_gait in (table, moved):
        assert settled_measures.slopes_of_segments(
            of_gait, gait="direct", free="psi_3", other="psi_1", within=0.3
        ) == pytest.approx([0.05, 0.05])
    low, high = settled_measures.free_range(moved, gait="direct", phase="psi_3")
    assert (low % (2.0 * np.pi), high - low) == pytest.approx((5.6, 4.0))
    ends = settled_measures.gait_ends(moved, gait="direct", phases=["psi_1", "psi_3"])
    assert ends == pytest.approx([4.755, 7.6 - 2.0 * np.pi])


def test_parts_of_a_basin_are_connected_on_the_torus() -> None:
    cell = np.arange(9)
    rows = [(2, 1, "direct"), (2, 0, "direct"), (2, 8, "direct"), (0, 3, "retrograde"), (7, 3, "retrograde")]
    grid = {(i, j): "source" for i in cell for j in cell} | {(i, j): gait for i, j, gait in rows}
    table = pd.DataFrame(
        [{"psi_3": 1.0, "psi_2": i, "psi_1": j, "gait": gait} for (i, j), gait in grid.items()]
    )
    assert settled_measures.largest_part(table, number=0) == [1.0, 1.0, 1.0]
    table.loc[(table["psi_2"] == 5) & (table["psi_1"] == 1), "gait"] = "direct"  # two cells off
    assert settled_measures.largest_part(table, number=0) == [0.75, 1.0, 1.0]
    assert settled_measures.slice_shares(table, number=0) == pytest.approx([4 / 81, 75 / 81, 2 / 81])


def test_places_of_sources_and_of_meeting_waves() -> None:
    """Leg k of a source by its label; waves meet where the lags turn from retrograde to direct."""
    lags = {"source": [1.0, 2.8, -1.0], "none": [-1.0, 1.0, 1.0], "direct": [1.0, 1.0, 2.9]}
    rows = [
        {"m_slope": slope, "psi_1": start, "status": "settled", "gait": gait, "k": 3 * (gait == "source")}
        | {f"psi_{i + 1}_end": lag % (2 * np.pi) for i, lag in enumerate(lags[gait])}
        for slope, gaits in ((0.0, ["source", "source", "direct"]), (0.2, ["none", "none", "source"]))
        for start, gait in enumerate(gaits)
    ]
    table = pd.DataFrame(rows)
    table.insert(0, "row", range(6))
    assert wave_measures.fewest_source_legs(table) == 1.0
    assert wave_measures.fewest_source_legs(table.query("gait != 'source'")) == 0.0
    assert wave_measures.meeting_share(table, leg=2, where="m_slope > 0") == pytest.approx(2 / 3)
    figure = plot.draw("source_place", table, x=["m_slope"])
    assert [text.get_text() for text in figure.axes[0].get_yticklabels()] == ["1", "2", "3", "4", "neither"]
    drawn = figure.axes[0].collections[0].get_array()  # legs by strengths
    assert drawn is not None
    shown = np.ma.filled(drawn, 0.0)
    assert shown[2].tolist() == pytest.approx([2 / 3, 1 / 3])
    with pytest.raises(plot.PlotError, match="x is empty"):
        plot.draw("source_place", table, x=[])
    for x, several, message in (
        (["psi_1"], table, r"x is psi_1, which is not a swept parameter.*m_slope"),
        (["m_slope"], _with_axis(table, m_B=[0.8, 0.9] * 3), "leaves out m_B"),
    ):
        with pytest.raises(plot.PlotError, match=message):
            plot.draw("source_place", several, x=x)
    with pytest.raises(UserError, match="no rows"):
        source_place(table.head(0))
    with pytest.raises(UserError, match="inferred rows, which have no k"):
        source_place(table.assign(status="inferred"))


def _with_axis(table: pd.DataFrame, **axis: list[float]) -> pd.DataFrame:
    """The table with one more swept axis."""
    ((name, values),) = axis.items()
    more = table.copy()
    more.insert(1, name, values)
    return more


def test_drift_and_period_of_a_return_map() -> None:
    crossing = np.arange(30)
    parts = [
        pd.DataFrame(
            {
                "row": row,
                "crossing": crossing,
                "t": crossing * (15.0 + row),
                "psi_1_n": (6.0 + rate * crossing) % (2 * np.pi),  # passes 2 pi
                "psi_2_n": 1.0,
            }
        )
        for row, rate in enumerate((0.0, 0.02))
    ]
    table = pd.concat(parts[::-1], ignore_index=True)
    assert wave_measures.drift_of_sum(table, row=1) == pytest.approx(0.02, abs=1e-12)
    assert wave_measures.largest_drift(table) == pytest.approx(0.02, abs=1e-12)
    assert settled_measures.last_change(table) == pytest.approx(0.02, abs=1e-12)
    assert wave_measures.period_in_phase(table) == pytest.approx([6.0, 6.4])
    assert settled_measures.distinct_ends(table) == [2.0, 1.0]


def test_the_theory_of_ten_legs_satisfies_the_printed_equations(table: pd.DataFrame) -> None:
    assert theory_measures.touchdown_relation_error(N=3) < 1e-14
    assert theory_measures.order_sets_agree(N=3) == 1.0
    assert theory_measures.table_2(number=1) == ["none", "no"]
    with pytest.raises(MeasureError, match="numbers 1 to 8"):
        theory_measures.table_2(number=9)
    assert theory_measures.slopes_of_fig10(table, k=3) == pytest.approx([1.0, 0.0], abs=1e-9)


def test_every_claim_has_a_tolerance_that_excludes_wrong_values() -> None:
    paper = read_paper("ambe2021")
    assert len(paper.claims) > 100
    for claim in paper.claims:
        wrong = "backwards" if isinstance(claim.paper, str) and not claim.unit else float("nan")
        assert verdict(claim, wrong) is not ClaimVerdict.reproduced, claim.id


def test_measures_of_legs_take_the_parameters_of_the_table() -> None:
    """A table of another job than the claim's is measured with its own duty factor and frequency."""
    legs = trace(Branch("direct", 3), 0.3, 0, springs=3)
    default = Chain()
    expected = equation_measures.air_in_swing(legs)
    phases = legs[[f"phase_{i}" for i in range(1, 5)]].to_numpy()
    contacts = legs[[f"contact_{i}" for i in range(1, 5)]].to_numpy() > 0.5

    def share(beta: float) -> float:
        swings = phases > 2.0 * beta * np.pi
        return float(((swings & ~contacts).sum(axis=0) / swings.sum(axis=0)).min())

    assert expected == pytest.approx(share(float(default.beta)), abs=1e-12)
    legs.attrs["job"] = {"params": {"beta": 0.7, "omega": 2.0 * OMEGA}}
    assert equation_measures.air_in_swing(legs) == pytest.approx(share(0.7), abs=1e-12)
    assert share(0.7) != pytest.approx(share(float(default.beta)), abs=0.01)
    plain = trace(Branch("direct", 3), 0.3, 0, springs=3)
    twice = np.array(wave_measures.leads(legs, row=0)) / np.array(wave_measures.leads(plain, row=0))
    np.testing.assert_allclose(twice, 2.0, rtol=1e-12)
    # the other rows of the table may have other frequencies
    several = pd.concat([plain.assign(omega=OMEGA), plain.assign(row=1, omega=3.0 * OMEGA)])
    leads = [wave_measures.leads(several, row=row) for row in (0, 1)]
    np.testing.assert_allclose(leads[0], wave_measures.leads(plain, row=0), rtol=1e-12)
    np.testing.assert_allclose(leads[1], 3.0 * np.array(leads[0]), rtol=1e-12)
    gains = equation_measures.phase_gain(several), equation_measures.phase_gain(plain)
    assert gains[0] == pytest.approx(gains[1], rel=1e-12)


def test_measures_of_the_theory_take_the_parameters_of_the_table(table: pd.DataFrame) -> None:
    """Jumps have the size m_B b, a wave has the wavelength of its duty factor, heights are of its masses."""
    other = table.copy()
    other.attrs["job"] = {"params": {"beta": 0.7}}
    for beta, of_beta in ((0.8, table), (0.7, other)):
        size = 0.9 * (1.0 - beta) * np.pi * 9.8 / (100.0 * 0.4)
        assert theory_measures.jump_sizes(of_beta) == pytest.approx([size, size], abs=1e-5)
        assert theory_measures.chain_of_sets(of_beta) < 1e-9

    # the legs lift off early, so that swings overlap
    up = {f"contact_{leg}": (other[f"phase_{leg}"] < 1.3 * np.pi).astype(float) for leg in range(1, N + 2)}
    early = other.assign(**up)
    phases = early.loc[early["row"] == 0, [f"phase_{leg}" for leg in LEGS]].to_numpy()

    def share(width: int) -> float:
        """Least share of time with one leg at most in its swing at 0.7 among so many neighbours."""
        swings = phases > 1.4 * np.pi
        counts = [swings[:, i : i + width].sum(axis=1) for i in range(len(LEGS) - width + 1)]
        return min(float(np.mean(count <= 1)) for count in counts)

    # eq. (27) gives 4.07 legs at 0.7 and 6.18 at 0.8
    assert wave_measures.one_swing_share(early, row=0, of=LEGS) == pytest.approx(share(4), abs=1e-12)
    assert share(4) > share(6) + 0.05


@pytest.mark.slow
def test_heights_are_compared_with_the_balance_of_the_rows_own_masses() -> None:
    trace_of_row = pd.DataFrame({"row": 0, "t": [0.0, 1.0]})
    lengths = np.array([[0.6, 1.0, 1.0, 0.6], [0.7, 1.0, 1.0, 0.7]])  # both ends are in the air
    mass = jnp.array([0.7, 1.0, 1.0, 0.7])
    balance = jax.vmap(lambda of_legs: obstacle_problem(of_legs, mass, jnp.full(3, 100.0), jnp.asarray(9.8)))
    heights = np.asarray(balance(jnp.asarray(lengths))[0])
    for leg in range(4):
        columns = {"phase": np.zeros(2), "l": lengths[:, leg], "x": heights[:, leg]}
        trace_of_row = trace_of_row.assign(**{f"{name}_{leg + 1}": at for name, at in columns.items()})
    assert equation_measures.height_error(trace_of_row.assign(m_B=0.7)) < 1e-12
    assert equation_measures.height_error(trace_of_row.assign(m_B=0.9)) > 1e-4


def test_a_leg_that_does_not_swing_has_no_share_of_air() -> None:
    """Where the row stands in the table makes no difference."""
    swinging = trace(Branch("direct", 3), 0.3, 0, springs=3)
    standing = trace(Branch("direct", 3), 0.3, 1, springs=3).assign(phase_2=0.1)
    for rows in ([swinging, standing], [standing, swinging]):
        with pytest.raises(UserError, match="A leg of row 1 does not swing"):
            equation_measures.air_in_swing(pd.concat(rows, ignore_index=True))
    faster = swinging.assign(row=1, omega=0.5)
    with pytest.raises(UserError, match="omega differs between the rows"):
        wave_measures.touchdown_phases_apart(pd.concat([swinging.assign(omega=0.4), faster]))


def test_ends_on_both_sides_of_the_branch_cut_are_one() -> None:
    ends = pd.DataFrame(
        {"row": [0, 1, 2], "crossing": 5, "psi_1_n": [-3.14, 3.14, 3.139], "psi_2_n": [0.1, 2.0, 6.2]}
    )
    assert settled_measures.distinct_ends(ends) == [1.0, 3.0]
    lost = pd.concat([ends, ends.tail(1).assign(row=3, psi_1_n=np.nan, psi_2_n=np.nan)])
    assert settled_measures.distinct_ends(lost) == [1.0, 3.0]
    with pytest.raises(MeasureError, match="No row ends with a value of psi_1_n"):
        settled_measures.distinct_ends(lost.tail(1))
    for of_rows in (settled_measures.last_change, settled_measures.distinct_ends):
        with pytest.raises(MeasureError, match="The table is empty"):
            of_rows(ends.head(0))


def test_legs_and_links_that_a_chain_lacks_are_refused(table: pd.DataFrame) -> None:
    """Neither a number below 1, which would count from the tail, nor one above the last."""
    for number in (0, N + 2):
        with pytest.raises(ArgumentError, match=f"link is {number}"):
            theory_measures.set_phase(kind="A", k=5, link=number)
        with pytest.raises(ArgumentError, match=f"has {number}, but"):
            wave_measures.leads(table, row=0, links=[1, number])
        with pytest.raises(ArgumentError, match=f"has {number}, but"):
            wave_measures.simulated_order(table, row=0, legs=[1, number])


def test_a_trace_without_what_a_measure_needs_is_refused(table: pd.DataFrame) -> None:
    with pytest.raises(MeasureError, match="empty"):
        wave_measures.touchdown_phases_apart(table.head(0))
    without_rows = table.head(0).assign(**{f"{name}_{i}": [] for name in "xl" for i in range(1, N + 2)})
    for of_legs in (
        equation_measures.leg_length_error,
        equation_measures.contact_as_printed,
        equation_measures.height_error,
        equation_measures.air_in_swing,
    ):
        with pytest.raises(MeasureError, match="empty"):
            of_legs(without_rows)
    row = table.loc[table["row"] == 0].assign(contact_1=1.0)
    still = row.assign(**{f"contact_{i}": 1.0 for i in range(1, N + 2)})
    with pytest.raises(MeasureError, match="No leg of row 0 touches down"):
        wave_measures.neighbours_at_touchdown(still, row=0, k=3)
