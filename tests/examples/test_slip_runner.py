"""The spring-mass runner against its equations in SciPy and published results."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import gaitsweep as gs
from gaitsweep.cli.main import main
from gaitsweep.examples.slip_runner import SlipRunner
from gaitsweep.shipped import EXAMPLES
from gaitsweep.table import Snapshot

ALPHA, K, M, L0, G, SPEED = np.deg2rad(68.0), 20e3, 80.0, 1.0, 9.81, 5.0


def stance(height: float) -> tuple[np.ndarray, float]:
    """Return the state (x, z, v_x, v_z) at lift-off and the time of stance, after an apex of this height."""

    def flow(t: float, s: np.ndarray) -> list[float]:
        x, z, u, w = s
        r = np.hypot(x, z)
        push = K / M * (L0 - r) / r
        return [u, w, push * x, push * z - G]

    def length(t: float, s: np.ndarray) -> float:
        return np.hypot(s[0], s[1]) - L0

    length.terminal, length.direction = True, 1.0  # type: ignore[attr-defined]
    down = L0 * np.sin(ALPHA)
    forwards = np.sqrt(SPEED**2 + 2.0 * G * (L0 - height))
    begin = [-L0 * np.cos(ALPHA), down, forwards, -np.sqrt(2.0 * G * (height - down))]
    run = solve_ivp(flow, (0.0, 2.0), begin, "DOP853", events=length, rtol=1e-12, atol=1e-12)
    return run.y_events[0][0], run.t_events[0][0]


def next_apex(height: float) -> float:
    _, z, _, w = stance(height)[0]
    return z + w**2 / (2.0 * G)


@pytest.mark.slow
def test_successive_apices_are_scipys() -> None:
    heights = np.array([0.95, 1.0, 1.1, 1.2, 1.3])
    rows = gs.sweep(SlipRunner(), z_0=heights, run=gs.ReturnMap(crossings=3), numerics={"rtol": 1e-11}).table
    result = rows["z_n"].to_numpy().reshape(5, 4)
    for n in range(3):
        np.testing.assert_allclose(result[:, n + 1], [next_apex(z) for z in result[:, n]], rtol=0, atol=1e-8)
    np.testing.assert_allclose(rows["energy_n"], M * G * L0 + M * SPEED**2 / 2.0, rtol=1e-8)


@pytest.mark.slow
def test_fixed_points_at_68_degrees() -> None:
    """A stable and an unstable gait, as Fig. 6 of Seyfarth, Geyer and Herr 2003 shows."""
    mapping = gs.return_map(SlipRunner())
    fixed = mapping.fixed_points({"z_0": [0.95, 1.3]})
    assert fixed.converged.all()
    for (z,), (multiplier,) in zip(fixed.points.at, mapping.multipliers(fixed), strict=True):
        assert abs(next_apex(z) - z) < 1e-7
        slope = (next_apex(z + 1e-5) - next_apex(z - 1e-5)) / 2e-5
        assert abs(multiplier - slope) < 1e-4
    assert (np.abs(mapping.multipliers(fixed))[:, 0] < 1.0).tolist() == [True, False]


@pytest.mark.slow
def test_stance_is_that_of_the_published_approximation() -> None:
    """Geyer, Seyfarth and Blickhan 2005: within 1 % of the compression and 0.6 degrees of the angle.

    The leg's strain e obeys e'' + w^2 e = W^2 - g/l0 with w^2 = k/m + 3 W^2, W the leg's rate at touchdown;
    the leg turns at W (1 - 2 e).
    """
    trace = gs.simulate(SlipRunner(), duration=0.5, every=2e-4, z_0=0.95)
    leg = np.hypot(trace["x"].to_numpy(), trace["z"].to_numpy())
    down = np.flatnonzero(np.diff(trace["x"]) < -0.1)[0] + 1  # x counts from the foot
    up = down + np.flatnonzero(leg[down:] > L0)[0]
    t = (trace["t"] - trace["t"][down]).to_numpy()[down:up]
    at = trace.iloc[down]
    radial = (at["x"] * at["v_x"] + at["z"] * at["v_z"]) / L0
    turning = (at["z"] * at["v_x"] - at["x"] * at["v_z"]) / L0**2
    w = np.sqrt(K / M + 3.0 * turning**2)
    mean = (turning**2 - G / L0) / w**2
    strain = mean * (1.0 - np.cos(w * t)) + radial / (L0 * w) * np.sin(w * t)
    assert np.abs(strain - (leg[down:up] / L0 - 1.0)).max() < 0.01
    swept = np.arctan2(trace["x"].to_numpy(), trace["z"].to_numpy())[down:up]
    turned = turning * np.concatenate([[0.0], np.cumsum(np.diff(t) * (1.0 - 2.0 * strain[:-1]))])
    assert np.abs(np.rad2deg(swept - swept[0] - turned)).max() < 0.6


@pytest.mark.slow
def test_an_apex_below_touchdown_falls_and_so_does_a_leg_too_steep() -> None:
    low = gs.sweep(SlipRunner(), z_0=[0.92]).table
    steep = gs.sweep(SlipRunner(), alpha=[74.0]).table
    assert low["status"].tolist() == steep["status"].tolist() == ["fell"]
    assert low["cycles"].tolist() == [0]


@pytest.mark.slow
def test_a_start_below_touchdown_on_rising_ground_falls() -> None:
    """At 20 degrees the ground at the first foothold is 0.14 m high, and touchdown above the first apex."""
    table = gs.sweep(SlipRunner(ground="slope"), ground_slope=[20.0], verify=0).table
    assert table["status"].tolist() == ["fell"]
    assert table["t_end"].tolist() == [0.0]


@pytest.fixture(scope="module")
def atlas_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the shipped atlas, on a shorter path."""
    folder = tmp_path_factory.mktemp("atlas") / "runner"
    gs.run(EXAMPLES / "slip_runner_atlas.yaml", folder, overrides=["run.path=[66, 70]", "run.depth=0"])
    return folder


@pytest.mark.slow
def test_times_of_touchdown_and_liftoff_along_the_branch(atlas_folder: Path) -> None:
    """The runner falls from the apex to touchdown, and a gait that repeats after one step is symmetric."""
    gaits = gs.load(atlas_folder)
    drop = gaits["z_n"] - L0 * np.sin(np.deg2rad(gaits["alpha"]))
    np.testing.assert_allclose(gaits["t_foot_lands"], np.sqrt(2.0 * drop / G), atol=1e-8)
    lands, lifts, apex = (gaits[f"t_{name}"] for name in ("foot_lands", "foot_lifts_off", "apex"))
    np.testing.assert_allclose(apex, gaits["time"], atol=1e-8)
    np.testing.assert_allclose(lands + lifts, gaits["time"], atol=1e-6)
    assert set(gaits["events"]) == {"foot lands, foot lifts off, apex"}


@pytest.mark.slow
def test_an_atlas_is_summed_up_drawn_and_explored(atlas_folder: Path) -> None:
    found = Snapshot.of(atlas_folder).manifest["findings"]
    assert found[0] == "At alpha = 68: 2 of period 1, 1 of them stable."
    fold, flip = (float(text.split(" at ")[1].rstrip(".")) for text in found[1].split("; "))
    gaits = gs.load(atlas_folder).set_index("special")
    assert (fold, flip) == pytest.approx((gaits.loc["fold", "alpha"], gaits.loc["flip", "alpha"]), rel=1e-6)
    family = gs.Result(atlas_folder).plot.orbit_family()
    assert [axes.get_ylabel() for axes in family.axes] == ["share of the cycle", "duration (s)"]
    with pytest.raises(gs.plot.PlotError, match="branch is 7, but row 0 has the branches 0"):
        gs.Result(atlas_folder).plot.orbit_family(branch=7)
    page = gs.Result(atlas_folder).explore(replays=4)
    assert "4 of" in page.read_text()


@pytest.mark.slow
def test_more_of_an_atlas_goes_one_bifurcation_further(
    atlas_folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(atlas_folder)
    assert main(["atlas", ".", "--more"]) == 0
    assert "2 of period 1" in capsys.readouterr().out
    more = gs.load(f"{atlas_folder}_more")
    depth, period = more["depth"].to_numpy(int), more["period"].to_numpy(int)
    assert np.unique(depth).tolist() == [0, 1]
    assert np.unique(period[depth == 1]).tolist() == [2]
    assert main(["atlas", str(atlas_folder), "--more", "--set", "run.most=9"]) == 2
    assert "--set is for a job" in capsys.readouterr().err
    assert main(["atlas", str(atlas_folder)]) == 2
    assert "a directory needs --more" in capsys.readouterr().err
    assert main(["atlas", "builtin:hopper"]) == 2
    assert "run.kind is settle, but must be atlas" in capsys.readouterr().err
