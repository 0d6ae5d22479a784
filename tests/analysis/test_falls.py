"""Falls of a rimless wheel on rough ground, against its transition matrix on a fine grid."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest
from scipy import sparse, special, stats

import gaitsweep as gs
from gaitsweep.analyses import AnalysisError, steps_to_fall, survival
from gaitsweep.analysis.rare_falls import _hazard, _way_out, _Windows
from gaitsweep.examples.rimless_wheel import RimlessWheel

SLOPE, ALPHA = 0.14, 0.4


def by_matrix(roughness: float, cells: int, slope: float = SLOPE) -> float:
    """1 / (1 - the largest eigenvalue) of the chain of energies above 1, the barrier, in so many cells.

    With slope g, an impact turns the energy K into keeps K + a cos g + b sin g, which grows with g.
    """
    keeps = np.cos(2.0 * ALPHA) ** 2
    a, b = (1.0 - keeps) * np.cos(ALPHA), (1.0 + keeps) * np.sin(ALPHA)
    size, angle = np.hypot(a, b), np.arctan2(b, a)
    edges = np.linspace(1.0, size / (1.0 - keeps), cells + 1)
    middles = 0.5 * (edges[1:] + edges[:-1])
    share = np.clip((edges[None, :] - keeps * middles[:, None]) / size, -1.0, 1.0)
    below = special.ndtr((angle - np.arccos(share) - slope) / roughness)
    return 1.0 / (1.0 - float(sparse.linalg.eigs(np.diff(below, axis=1), 1)[0].real[0]))


@pytest.mark.slow
def test_the_mean_of_a_wheel_is_that_of_its_transition_matrix() -> None:
    """Means over three orders of magnitude; an estimate from n falls has a relative error of 1 / sqrt(n)."""
    roughness, rows = [0.08, 0.06, 0.045], 400
    exact = [by_matrix(each, 400) for each in roughness]
    # the cells are fine enough
    assert exact[2] == pytest.approx(by_matrix(roughness[2], 800), rel=1e-3)
    assert exact[2] > 10.0 * exact[0]
    run = gs.FixedTime(duration=1000.0)
    table = gs.sweep(RimlessWheel(), roughness=roughness, seed=np.arange(rows), run=run, verify=0).table
    found = steps_to_fall(table, "roughness").to_dict("records")[::-1]
    for record, mean in zip(found, exact, strict=True):
        assert record["falls"] > 100
        assert abs(np.log(record["steps"] / mean)) < 3.5 / np.sqrt(record["falls"])
        assert record["low"] < record["steps"] < record["high"]


def drawn(p, s):
    """The number that the last impact of the wheel drew."""
    return (s.ahead - p.slope) / p.roughness


@pytest.mark.slow
@pytest.mark.parametrize(
    ("roughness", "choices", "decade"),
    [(0.03, {"rounds": 32}, 4), (0.02, {"rounds": 120, "scales": [3.5]}, 8), (0.018, {"rounds": 16}, 9)],
    ids=["0.03", "0.02", "0.018"],
)
def test_rare_falls_of_a_wheel_are_those_of_its_transition_matrix(
    roughness: float, choices: dict[str, Any], decade: int
) -> None:
    """From 10^4 steps to ten thousand million: within 4 standard errors, and within 10 % up to 1e8."""
    exact = by_matrix(roughness, 800)
    assert int(np.log10(exact)) == decade
    found = gs.return_map(RimlessWheel(), roughness=roughness).rare_falls("roughness", drawn, **choices)
    low, high = found.steps_interval
    assert abs(np.log(found.steps / exact)) < np.log(high / low)  # an interval is 4 standard errors wide
    if decade < 9:
        assert found.steps == pytest.approx(exact, rel=0.1)
    # two bad slopes at least: one alone would be as unlikely as both are together
    way = found.way_out["draw_1"].to_numpy()
    assert way.min() < -1.0
    if decade >= 8:
        assert np.sort(way)[1] < -1.0
        assert np.sum(way**2) < 1.1 * -2.0 * np.log(1.0 / exact)


@pytest.mark.slow
def test_falls_along_parameters_are_those_of_the_transition_matrix() -> None:
    """Common and rare falls over two parameters, within 4 standard errors and 20 %; 6 rounds give 5 %."""
    both = {"roughness": [0.2, 0.06, 0.03], "slope": [0.12, SLOPE, 0.13]}
    wheel = gs.return_map(RimlessWheel(), zip=both)
    table: Any = wheel.steps_to_fall("roughness", drawn, rounds=6, scales=[1.0, 2.0, 3.0])
    exact = [by_matrix(row.roughness, 800, row.slope) for row in table.itertuples()]
    assert exact[0] < 5.0
    assert exact[2] > 1e3
    np.testing.assert_allclose(table["steps"], exact, rtol=0.2)
    widths = np.log(table["high"] / table["low"])
    assert (np.abs(np.log(table["steps"] / exact)) < widths).all()
    assert (table["scale"][:2] == 1.0).all()
    assert table["scale"][2] > 1.0
    assert (table["note"] == "").all()
    # plain steps do not meet the rarest falls
    rare = gs.return_map(RimlessWheel(), zip={"roughness": [0.02], "slope": [SLOPE]})
    few: Any = rare.steps_to_fall("roughness", drawn, rounds=2, scales=[1.0])
    assert few["steps"].isna().tolist() == [True]
    assert few["note"].iloc[-1].startswith("fewer than 20 falls")


@pytest.mark.slow
def test_each_of_several_starts_has_its_falls() -> None:
    wheel = gs.return_map(RimlessWheel(), roughness=0.2, rate_0=[1.0, 1.1])
    table: Any = wheel.steps_to_fall("roughness", drawn, rounds=2, scales=[1.0])
    assert table["rate_0"].tolist() == [1.0, 1.1]
    assert table["steps"].notna().all()


def test_what_rare_falls_cannot_count_is_refused() -> None:
    wheel = gs.return_map(RimlessWheel(), roughness=0.03)
    with pytest.raises(gs.ArgumentError, match="roughness of this map has several values"):
        gs.return_map(RimlessWheel(), roughness=[0.02, 0.03]).rare_falls("roughness", drawn)
    starts = gs.return_map(RimlessWheel(), roughness=0.2, rate_0=[1.0, 1.1])
    with pytest.raises(gs.ArgumentError, match="rate_0 of this map has several values"):
        starts.rare_falls("roughness", drawn)
    with pytest.raises(gs.ArgumentError, match="seed has several values"):
        gs.return_map(RimlessWheel(), roughness=0.1, seed=[1, 2]).steps_to_fall("roughness", drawn)
    with pytest.raises(AnalysisError, match=r"rouhness is not a parameter .*did you mean roughness"):
        wheel.rare_falls("rouhness", drawn)
    with pytest.raises(AnalysisError, match="scales"):
        wheel.rare_falls("roughness", drawn, scales=[0.5])
    bounded = gs.return_map(Pushed(), sigma=0.6)
    with pytest.raises(AnalysisError, match=r"sigma is at most 1, which each of the scales exceeds"):
        bounded.rare_falls("sigma", drawn, scales=[2.0, 3.0])
    with pytest.raises(AnalysisError, match="2 or more"):
        wheel.rare_falls("roughness", drawn, steps=1)
    with pytest.raises(AnalysisError, match="level is 95, but must be between 0 and 1"):
        wheel.rare_falls("roughness", drawn, level=95)


class Pushed(gs.DeclaredModel):
    """x halves in a cycle; then a push draws a number, and |x| > 1 after it is a fall."""

    section_coordinates = ("x",)
    sigma = gs.parameter("1", "noise", 0.22, low=0.0, high=1.0)
    seed = gs.parameter("1", "seed", 0.0, whole=True)
    clock = gs.variable("1", "clock", observed=False)
    x = gs.variable("1", "state", 0.0)
    push = gs.variable("1", "last push", signal=False, held=True, observed=False)
    steps = gs.mode(0, "steps")

    def complete(self, p, s):
        return s.replace(clock=0.0)

    def flow(self, p, s):
        return {"clock": jnp.ones_like(s.clock), "x": -jnp.log(2.0) * s.x}

    @gs.event("tick", section=True)
    def tick(self, p, s):
        return s.clock - 1.0

    @tick.jump
    def pushed(self, p, s):
        push = gs.normal(p.seed, s.steps + 1.0)
        return s.replace(clock=0.0, x=s.x + p.sigma * push, push=push, steps=s.steps + 1)

    def failed(self, p, s):
        return jnp.abs(s.x) > 1.0

    def period(self, p):
        return jnp.ones_like(p.sigma)


@pytest.mark.slow
def test_a_fall_by_the_push_of_its_own_step_is_weighted_by_it() -> None:
    """Within 4 standard errors of the recursion x -> x / 2 + sigma push on |x| < 1, by quadrature."""
    nodes, weights = np.polynomial.legendre.leggauss(200)
    kernel = stats.norm.pdf(nodes - 0.5 * nodes[:, None], scale=0.22) * weights
    exact = 1.0 - float(np.abs(np.linalg.eigvals(kernel)).max())
    found = gs.return_map(Pushed()).rare_falls("sigma", lambda p, s: s.push, rounds=16, scales=[2.5])
    assert abs(np.log(found.chance / exact)) < np.log(found.high / found.low)
    assert found.chance == pytest.approx(exact, rel=0.3)
    # the push of the fall itself is the largest
    assert found.way_out["step"].tolist() == [-5, -4, -3, -2, -1, 0]


def test_survival_counts_the_rows_that_walk_so_far() -> None:
    table = pd.DataFrame({"cycles": [110, 120, 50, 7], "status": ["complete", "complete", "fell", "fell"]})
    found = survival(table, steps=50).to_dict("records")[0]
    assert (found["rows"], found["walked"], found["share"]) == (4, 3, 0.75)
    assert found["low"] == pytest.approx(stats.beta.ppf(0.025, 3, 2))
    assert found["high"] == pytest.approx(stats.beta.ppf(0.975, 4, 1))
    with pytest.raises(
        AnalysisError, match="1 of 4 rows ended before 115 steps without a fall, the first after 110"
    ):
        survival(table, steps=115)
    with pytest.raises(AnalysisError, match="steps is 0"):
        survival(table, steps=0)
    # one of forty rows steps on the spot: it may or may not walk on, and the interval covers both
    ends = {"cycles": [120] * 30 + [12] * 10, "status": ["complete"] * 30 + ["fell"] * 9 + ["complete"]}
    found = survival(pd.DataFrame(ends), steps=50).to_dict("records")[0]
    assert (found["walked"], found["open"], found["share"]) == (30, 1, 0.75)
    assert found["low"] == pytest.approx(stats.beta.ppf(0.025, 30, 11))
    assert found["high"] == pytest.approx(stats.beta.ppf(0.975, 32, 9))


def test_rows_without_a_fall_give_a_lower_bound() -> None:
    table = pd.DataFrame({"cycles": [110, 110, 50], "status": ["complete", "complete", "complete"]})
    found = steps_to_fall(table).to_dict("records")[0]
    assert (found["falls"], found["tried"]) == (0, 240)
    assert np.isinf(found["steps"])
    # 1 - (1 - 0.05 / 2)^(1 / 240) is the largest chance that is not excluded
    assert found["low"] == pytest.approx(1.0 / (1.0 - 0.025 ** (1.0 / 240.0)))
    fell = table.assign(status=["complete", "fell", "fell"])
    assert steps_to_fall(fell)["steps"].tolist()[0] == 242 / 2
    assert steps_to_fall(fell, after=60)[["rows", "falls", "tried"]].iloc[0].tolist() == [2, 1, 101]


def test_the_mean_is_unknown_where_all_rows_fell_before_the_steps_that_count() -> None:
    fell_early = pd.DataFrame({"cycles": [3, 4], "status": ["fell", "fell"]})
    found = steps_to_fall(fell_early).to_dict("records")[0]
    assert (found["rows"], found["falls"], found["tried"], found["low"]) == (0, 0, 0, 1.0)
    assert np.isnan(found["steps"])
    assert np.isinf(found["high"])


def test_other_ends_and_arguments_are_refused() -> None:
    table = pd.DataFrame({"cycles": [10], "status": ["diverged"]})
    with pytest.raises(AnalysisError, match="1 rows ended as diverged"):
        steps_to_fall(table)
    with pytest.raises(AnalysisError, match="level is 2"):
        steps_to_fall(table, level=2.0)
    with pytest.raises(AnalysisError, match="roughnes"):
        steps_to_fall(table, "roughnes")
    with pytest.raises(AnalysisError, match="1 rows have no number of cycles"):
        survival(pd.DataFrame({"cycles": [10, np.nan], "status": "fell"}))


def test_the_chance_of_a_fall_is_that_of_a_window_and_at_most_one() -> None:
    """A window of 6 steps counts falls after 3 to 5 steps; no chance gives a mean of 0.5 there."""
    chance = 0.01
    assert _hazard(float(np.mean(chance * (1.0 - chance) ** np.arange(3, 6))), 6) == pytest.approx(chance)
    assert _hazard(0.5, 6) == 1.0


def test_the_way_out_is_unknown_without_a_fall_at_the_end_of_a_window() -> None:
    windows = _Windows(np.full(2, 0.1), np.zeros(0), np.zeros((0, 4, 1)), falls=20, undecided=0.0)
    way = _way_out(windows, 4)
    assert way["step"].tolist() == [-3, -2, -1]
    assert np.all(way["draw_1"].isna())
