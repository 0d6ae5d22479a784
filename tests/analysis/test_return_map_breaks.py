"""Breaks in the data of return maps: jumps, gaps, cusps, branches and the cut of a circle."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from gaitsweep import plot
from gaitsweep.analysis.transitions.drift import drifts_of, ghosts_of
from gaitsweep.analysis.transitions.return_map import branches, drift, fixed_points, ghosts
from tests.support.hysteresis_tables import TURN, map_table

LORENZ = pd.read_csv(Path(__file__).parents[1] / "reference" / "lorenz_crossings.csv")


def crossings(values: np.ndarray, name: str = "v") -> pd.DataFrame:
    """A return map's table of rows (rows, crossings)."""
    rows, count = np.atleast_2d(values).shape
    row, crossing = np.repeat(np.arange(rows), count), np.tile(np.arange(count), rows)
    value = np.atleast_2d(values).ravel()
    return pd.DataFrame({"row": row, "crossing": crossing, "status": "complete", f"{name}_n": value})


def iterated(
    function: Callable[[np.ndarray], np.ndarray], starts: np.ndarray, count: int, noise: float = 0.0
) -> np.ndarray:
    """Values (starts, count) of a map from some starts."""
    random = np.random.default_rng(5)
    course = [np.asarray(starts, float)]
    for _ in range(count - 1):
        course.append(function(course[-1]) + noise * random.normal(size=len(starts)))
    return np.array(course).T


@pytest.mark.parametrize("bandwidth", [None, 0.3, 1.5])
def test_lorenz_map_of_a_plane_has_no_fixed_point(bandwidth: float | None) -> None:
    """Between -2 and 2 it has two branches, 9 apart, of which the mean goes through zero at zero."""
    table = crossings(LORENZ["x"].to_numpy())
    assert not len(fixed_points(table, "v", bandwidth=bandwidth))
    assert not len(ghosts(table, "v", bandwidth=bandwidth, near=0.05))
    message = drift(table, "v", bandwidth=bandwidth)
    assert message["value"].between(-6.0, -4.0).any()
    # where the points lie on two branches alone, the curve lies on none of them, and is not told
    assert not message["value"].between(-0.8, 0.8).any()


def test_lorenz_map_of_maxima_has_one_fixed_point_and_a_cusp() -> None:
    """The point itself is where a line through the nearest raw points crosses the diagonal."""
    z = LORENZ["z"].to_numpy()
    here, change = z[:-1], np.diff(z)
    near = np.argsort(np.abs(here - 39.82))[:12]
    slope, level = np.polyfit(here[near], change[near], 1)
    result = fixed_points(crossings(z), "v")
    assert result["value"].tolist() == [pytest.approx(-level / slope, abs=0.005)]
    assert result["slope"].item() == pytest.approx(1.0 + slope, abs=0.1)
    assert result["stable"].tolist() == [False]
    message = drift(crossings(z), "v")
    # the curve goes where the points go, and is not drawn over the cusp, of which it would cut off 3 units
    between = np.interp(message["value"], np.sort(here), change[np.argsort(here)])
    off = np.abs(message["drift"] - between) / np.hypot(1.0, 1.0 + message["slope"])
    assert off.max() < 0.05


@pytest.mark.slow
def test_the_figure_of_the_lorenz_map_shows_no_such_point() -> None:
    figure = plot.draw("return_map", crossings(LORENZ["x"].to_numpy()), y="v", form="next")
    axes = figure.axes[0]
    assert not [line for line in axes.lines if line.get_marker() == "o"]
    assert [text.get_text() for text in figure.legends[0].get_texts()] == [
        "one step of one start",
        "smoothed, ± 2 standard errors",
        "no change",
    ]
    at = np.asarray(axes.lines[-1].get_xdata(), float)
    steps = np.isfinite(at[1:]) & np.isfinite(at[:-1])
    assert not np.any(steps & (at[:-1] < 0.0) & (at[1:] > 0.0))  # it is broken between the branches
    change = plot.return_map(crossings(LORENZ["z"].to_numpy()), y="v", form="change").axes[0]
    low, high = change.get_ylim()
    assert -18.0 < low < -15.0  # the data go from -15.4 to 7.9
    assert 7.0 < high < 11.0


@pytest.mark.slow("200-0.0", "200-0.02")
@pytest.mark.parametrize("noise", [0.0, 0.004, 0.02])
@pytest.mark.parametrize("rows", [12, 200])
def test_a_map_that_jumps_over_the_diagonal(rows: int, noise: float) -> None:
    """X' = 0.8 x + 0.35 below 0.5, 0.8 x - 0.15 above: a jump by 0.5 over the diagonal, no fixed point."""
    jumps = iterated(
        lambda x: 0.8 * x + np.where(x < 0.5, 0.35, -0.15), np.linspace(0.0, 1.0, rows), 40, noise
    )
    table = crossings(jumps)
    assert not len(fixed_points(table, "v"))
    assert not len(ghosts(table, "v"))
    message = drift(table, "v")
    if (rows, noise) == (200, 0.0):
        assert set(message["piece"]) == {0, 1}
        below = message["value"] < 0.5
        exact = -0.2 * message["value"].to_numpy() + np.where(below, 0.35, -0.15)
        np.testing.assert_allclose(message["drift"], exact, atol=1e-9)
        assert message.loc[below, "value"].max() > 0.49  # up to the jump, from both sides
        assert message.loc[~below, "value"].min() < 0.51


@pytest.mark.parametrize("slope", [-0.9, 0.6, 1.08, 1.7, -1.4])
@pytest.mark.parametrize("noise", [0.0, 0.002])
def test_a_jump_elsewhere_hides_no_fixed_point(slope: float, noise: float) -> None:
    """The fixed point at 0.3, of any slope, stays where the map jumps at 0.6."""
    starts = np.linspace(0.0, 1.0, 300)
    table = crossings(
        iterated(lambda x: 0.3 + slope * (x - 0.3) + np.where(x < 0.6, 0.0, -0.8), starts, 2, noise)
    )
    result = fixed_points(table, "v")
    assert result["value"].tolist() == [pytest.approx(0.3, abs=0.05)]
    assert result["slope"].item() == pytest.approx(slope, abs=1e-6 if noise == 0.0 else 0.15)
    assert result["stable"].tolist() == [abs(slope) < 1.0]


def test_a_resolved_steep_crossing_is_not_a_jump() -> None:
    """X' = x - 0.3 tanh((x - 0.5)/0.01): slope -29 at the fixed point, over a fifth of the window."""
    starts = np.linspace(0.0, 1.0, 2001)
    table = crossings(iterated(lambda x: x - 0.3 * np.tanh((x - 0.5) / 0.01), starts, 2))
    assert fixed_points(table, "v")["value"].tolist() == [pytest.approx(0.5, abs=1e-3)]


@pytest.mark.slow("60")
@pytest.mark.parametrize("rows", [1, 60])
def test_the_logistic_map_with_a_gap_in_its_data(rows: int) -> None:
    """Its fixed point 1 - 1/r is found where there are points around it, and not in a gap."""
    r = 3.9
    starts = np.random.default_rng(1).uniform(0.1, 0.9, rows)
    values = iterated(lambda x: r * x * (1.0 - x), starts, 3000 // rows)
    star = 1.0 - 1.0 / r
    result = fixed_points(crossings(values), "v")
    assert result["value"].tolist() == [pytest.approx(star, abs=0.002)]
    assert result["slope"].item() == pytest.approx(2.0 - r, abs=0.02)
    for half in (0.04, 0.08):
        holed = crossings(np.where(np.abs(values - star) < half, np.nan, values))
        assert not len(fixed_points(holed, "v"))
        message = drift(holed, "v")["value"]
        assert not message.between(star - 0.9 * half, star + 0.9 * half).any()
        assert message.between(star + half, star + half + 0.05).any()


@pytest.mark.slow("0.3-0.0-3.0", "0.3-0.05-3.3", "2.0-0.0-3.3", "2.0-0.05-3.0")
@pytest.mark.parametrize("advance", [3.0, 3.3])
@pytest.mark.parametrize("noise", [0.0, 0.05])
@pytest.mark.parametrize("depth", [0.3, 2.0])
def test_an_angle_that_turns_by_half_a_turn_and_more(advance: float, noise: float, depth: float) -> None:
    """Psi' = psi + advance + depth sin(psi): its change passes through pi, where its sign turns, not through
    zero (advance 3, depth 0.3), so there is no fixed point."""
    starts = np.linspace(0.0, TURN, 300, endpoint=False)
    values = iterated(lambda x: x + advance + depth * np.sin(x), starts, 4, noise)
    assert not len(fixed_points(crossings(np.mod(values, TURN), "psi_1"), "psi_1"))


@pytest.mark.slow("0.02", "6.27")
@pytest.mark.parametrize("place", [0.0, 0.02, 3.0, 6.27])
def test_the_cut_of_the_circle_is_not_a_break(place: float) -> None:
    """Psi' = psi - 0.3 sin(psi - place): one stable and one unstable point, wherever the circle is cut."""
    starts = np.linspace(0.0, TURN, 90, endpoint=False) + 0.013
    values = iterated(lambda x: x - 0.3 * np.sin(x - place), starts, 25)
    result = fixed_points(crossings(np.mod(values, TURN), "psi_1"), "psi_1").sort_values("stable")
    assert result["stable"].tolist() == [False, True]
    away = np.angle(np.exp(1j * (result["value"].to_numpy() - [place + np.pi, place])))
    np.testing.assert_allclose(away, 0.0, atol=2e-3)
    assert not len(ghosts(crossings(np.mod(values, TURN), "psi_1"), "psi_1"))


def test_a_gap_removes_the_unstable_point_of_one_value_only() -> None:
    """A gap around the unstable point at one value of the parameter takes it from the branch there alone."""
    table = map_table([-0.1, 0.0, 0.1], starts=60, crossings=60)
    hole = (table["f"] == 0.0) & (np.abs(table["delta_13_n"] - 2.6) < 0.06)
    table.loc[hole, "delta_13_n"] = np.nan
    result = branches(table, "delta_13", "f")
    assert result.groupby("f").size().tolist() == [3, 2, 3]
    assert result.loc[result["f"] == 0.0, "stable"].tolist() == [True, True]


def test_rows_that_still_move_have_no_fixed_point() -> None:
    """A state that rows approach from one side counts once they come to rest there."""

    def towards(x):
        return 2.9 + 0.9 * (x - 2.9)

    starts = np.linspace(2.5, 2.7, 20)
    moving, rested = (crossings(iterated(towards, starts, count), "delta") for count in (15, 150))
    assert not len(fixed_points(moving, "delta"))
    assert fixed_points(rested, "delta")["value"].tolist() == [pytest.approx(2.9, abs=1e-4)]
    # the drift at rest is that of rounding, with either sign
    at_rest = crossings(iterated(lambda x: 0.37 + 0.5 * (x - 0.37), 0.37 - np.linspace(0.05, 1.05, 40), 400))
    assert fixed_points(at_rest, "v")["stable"].tolist() == [True]
    assert not len(ghosts(at_rest, "v"))
    message = drift(moving, "delta")["value"]
    assert np.max(message.to_numpy()) <= np.max(moving["delta_n"].to_numpy())


def test_a_constant_drift_has_no_ghost_beside_missing_values() -> None:
    """The curve has no value at the sparse ends, which do not make its smallest value a minimum."""
    beyond, with_ghosts = np.array([0.15, 0.33, 0.5]), 0
    for seed in range(20):
        random = np.random.default_rng(seed)
        value = np.sort(np.concatenate([random.uniform(0.6, 1.4, 300), 0.6 - beyond, 1.4 + beyond]))
        change = 0.008 + 0.0005 * random.standard_normal(value.size)
        (piece,) = drifts_of(value, change, np.arange(value.size), 0.2, False)
        assert np.isnan(piece.smooth.value).any()
        with_ghosts += bool(ghosts_of(piece, 0.01))
    assert with_ghosts <= 3  # by chance, at two standard errors
