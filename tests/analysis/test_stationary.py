"""Stationary points of flows and their bifurcations, in closed form."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
import pytest

import gaitsweep as gs
from gaitsweep.engine import content
from gaitsweep.examples.lorenz import Lorenz
from tests.support.models.cusp_flow import CuspFlow


class Polynomial(gs.DeclaredModel):
    """x' = r (k x + p) + a x^2 + b x^3, with another variable that decays."""

    r = gs.parameter("1", "the parameter", 0.0)
    k = gs.parameter("1", "growth", 1.0)
    p = gs.parameter("1", "push", 0.0)
    a = gs.parameter("1", "quadratic term", 0.0)
    b = gs.parameter("1", "cubic term", 0.0)
    x = gs.variable("1", "the place", 0.0)
    y = gs.variable("1", "a place that follows", 0.0)

    def flow(self, p: Any, s: Any) -> Any:
        return {"x": p.r * (p.k * s.x + p.p) + p.a * s.x**2 + p.b * s.x**3, "y": 0.3 * s.x**2 - s.y}

    def period(self, p: Any) -> Any:
        return 1.0


class Bautin(gs.DeclaredModel):
    """z' = (m + i w + n |z|^2 - |z|^4) z beside u' = p + u^2 and v' = g v."""

    m = gs.parameter("1/s", "growth", -0.5)
    n = gs.parameter("1/s", "cubic term", -1.0)
    w = gs.parameter("rad/s", "frequency", 3.0)
    p = gs.parameter("1", "push", -1.0)
    g = gs.parameter("1/s", "growth of v", -2.0)
    x = gs.variable("1", "real part", 0.0)
    y = gs.variable("1", "imaginary part", 0.0)
    u = gs.variable("1", "a place with a fold", -1.0)
    v = gs.variable("1", "a place that follows", 0.0)

    def flow(self, p: Any, s: Any) -> Any:
        size = s.x**2 + s.y**2
        growth = p.m + p.n * size - size**2
        return {
            "x": growth * s.x - p.w * s.y,
            "y": growth * s.y + p.w * s.x,
            "u": p.p + s.u**2,
            "v": p.g * s.v,
        }

    def period(self, p: Any) -> Any:
        return 2.0


class Circuit(gs.DeclaredModel):
    """z' = (C_0 / C - 1 + 3 i - |z|^2) z."""

    C_0 = gs.parameter("F", "capacity at the Hopf point", 1.0)
    C = gs.parameter("F", "capacity", 2.0, low=0.0, open_ends=True)
    x = gs.variable("1", "real part", 0.0)
    y = gs.variable("1", "imaginary part", 0.0)

    def flow(self, p: Any, s: Any) -> Any:
        growth = p.C_0 / p.C - 1.0 - s.x**2 - s.y**2
        return {"x": growth * s.x - 3.0 * s.y, "y": growth * s.y + 3.0 * s.x}

    def period(self, p: Any) -> Any:
        return 2.0


class BogdanovTakens(gs.DeclaredModel):
    """x' = y, y' = b1 + b2 x + x^2 - x y: Kuznetsov 2004, section 8.4."""

    b1 = gs.parameter("1", "first parameter", -0.2)
    b2 = gs.parameter("1", "second parameter", -1.0)
    x = gs.variable("1", "place", 0.0)
    y = gs.variable("1", "speed", 0.0)

    def flow(self, p: Any, s: Any) -> Any:
        return {"x": s.y, "y": p.b1 + p.b2 * s.x + s.x**2 - s.x * s.y}

    def period(self, p: Any) -> Any:
        return 6.0


class Brusselator(gs.DeclaredModel):
    """x' = A - (B + 1) x + x^2 y, y' = B x - x^2 y: at rest at (A, B/A); Hopf at B = 1 + A^2."""

    A = gs.parameter("1", "supply", 1.5)
    B = gs.parameter("1", "supply", 2.5)
    x = gs.variable("1", "concentration", 1.0)
    y = gs.variable("1", "concentration", 1.0)

    def flow(self, p: Any, s: Any) -> Any:
        return {"x": p.A - (p.B + 1.0) * s.x + s.x**2 * s.y, "y": p.B * s.x - s.x**2 * s.y}

    @gs.event("x rises through A", section=True)
    def rises(self, p: Any, s: Any) -> Any:
        return s.x - p.A

    def period(self, p: Any) -> Any:
        return 4.2


class Neuron(gs.DeclaredModel):
    """x' = current - x, reset to 0 at 1; its phase turns meanwhile, and its place moves with x."""

    current = gs.parameter("1", "input", 0.4)
    x = gs.variable("1", "voltage", 0.0)
    phase = gs.variable("rad", "phase", 0.0, circular=True)
    place = gs.variable("m", "place", 0.0)

    def flow(self, p: Any, s: Any) -> Any:
        return {"x": p.current - s.x, "phase": 3.0, "place": s.x - p.current}

    @gs.event("fires", section=True)
    def fires(self, p: Any, s: Any) -> Any:
        return s.x - 1.0

    @fires.jump
    def reset(self, p: Any, s: Any) -> Any:
        return s.replace(x=0.0)

    def period(self, p: Any) -> Any:
        return 1.0


def specials(table: pd.DataFrame) -> pd.DataFrame:
    return table.iloc[np.flatnonzero(~np.isin(table["special"].astype(str), ["", "kink"]))]


@pytest.mark.slow(
    "fold-values0-0.7071067811865476",
    "transcritical-values1-0.5",
    "supercritical_pitchfork-values3-0.0",
    "supercritical_pitchfork-values4-0.7071067811865476",
    "subcritical_pitchfork-values5-0.7071067811865476",
)
@pytest.mark.parametrize(
    ("kind", "values", "start"),
    [
        ("fold", {"k": 0.0, "p": 1.0, "a": -1.0, "r": 0.5}, np.sqrt(0.5)),
        ("transcritical", {"a": -1.0, "r": 0.5}, 0.5),
        ("transcritical", {"a": -1.0, "r": 0.5}, 0.0),
        ("supercritical_pitchfork", {"b": -1.0, "r": 0.5}, 0.0),
        ("supercritical_pitchfork", {"b": -1.0, "r": 0.5}, np.sqrt(0.5)),
        ("subcritical_pitchfork", {"b": 1.0, "r": -0.5}, np.sqrt(0.5)),
    ],
)
def test_bifurcations_of_one_variable(kind: str, values: dict[str, float], start: float) -> None:
    """At r = 0, also in a range where the parameter's natural scale is small; coefficients are the flow's."""
    rest = gs.stationary(Polynomial(), params=values)
    table = rest.continue_([start, 0.3 * start**2], "r", (-1.0, 30.0), towards=int(-np.sign(values["r"])))
    (special,) = specials(table).to_dict("records")
    assert special["special"] == kind
    assert abs(special["r"]) < 1e-9
    # x is in units of its scale there, 0.1
    terms = {"a": 0.1, "b": 0.01}
    expected = sum(share * values.get(name, 0.0) for name, share in terms.items())
    np.testing.assert_allclose(special["coefficient"], expected, rtol=1e-4)
    stable = values["r"] < 0.0 if start == 0.0 else kind != "subcritical_pitchfork"
    assert bool(table["stable"].iloc[0]) == stable
    # eigenvalues: dx'/dx, and -1 of y
    slope = values.get("k", 1.0) * values["r"] + 2.0 * values.get("a", 0.0) * start
    slope += 3.0 * values.get("b", 0.0) * start**2
    np.testing.assert_allclose(table["eigenvalue_re"].iloc[0], max(slope, -1.0), atol=1e-9)
    np.testing.assert_allclose(np.sort(rest.eigenvalues([start, 0.0])), np.sort([slope, -1.0]), atol=1e-9)


def test_a_branch_reads_the_content_of_its_model_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Programs are looked up by it at each point, which would take a quarter of the time of a branch."""
    reads: list[Any] = []
    read = content._read
    monkeypatch.setattr(content, "_read", lambda model: reads.append(model) or read(model))
    rest = gs.stationary(Polynomial(), params={"a": -1.0, "r": 0.5})
    branch = rest.continue_([0.0, 0.0], "r", (-1.0, 30.0), towards=1)
    assert len(branch) > 10
    assert len(reads) < 5


@pytest.mark.slow
@pytest.mark.parametrize("n", [-1.0, 0.7])
def test_hopf_point_of_the_normal_form(n: float) -> None:
    """At m = 0, with l1 = 2 n / w where |q| = 1; cycles have the radius at which m + n r^2 - r^4 = 0."""
    rest = gs.stationary(Bautin(), n=n, g=0.2)
    table = rest.continue_([0.0, 0.0, -1.0, 0.0], "m", (-0.5, 0.5))
    (hopf,) = specials(table).to_dict("records")
    assert hopf["special"] == "hopf"
    assert abs(hopf["m"]) < 1e-9
    # v is unstable, so that the critical pair is not that with the largest real part
    np.testing.assert_allclose(hopf["eigenvalue_re"], 0.2)
    np.testing.assert_allclose(hopf["hopf_frequency"], 3.0)
    np.testing.assert_allclose(hopf["hopf_period"], 2.0 * np.pi / 3.0)
    np.testing.assert_allclose(hopf["coefficient"], 2.0 * n / 3.0)
    cycle = rest.cycle(hopf, "m", 0.1)
    np.testing.assert_allclose(np.hypot(cycle["x"], cycle["y"]), 0.1)
    np.testing.assert_allclose(cycle["m"], -n * 0.1**2, atol=1e-9)
    wrong: tuple[tuple[Any, str], ...] = (
        ((hopf, "mm", 0.1), "mm is not a parameter of .*; did you mean m"),
        ((hopf, "g", 0.1), "The record has no g: give the parameter along which"),
        (({"special": "hopf"}, "m", 0.1), "The record has no row"),
        ((hopf, "m", 0.0), "amplitude is 0, but must be a number above 0"),
        ((hopf, "m", np.nan), "amplitude is nan"),
        ((hopf, "m", 0.1, 0), "points is 0"),
    )
    for arguments, words in wrong:
        with pytest.raises(gs.ArgumentError, match=words):
            rest.cycle(*arguments)


def test_no_cycle_begins_at_a_saddle() -> None:
    saddle = {"special": "hopf", "row": 0, "b1": -0.2, "x": 0.5 + np.sqrt(0.45), "y": 0.0}
    with pytest.raises(gs.ArgumentError, match="no Hopf point: all eigenvalues"):
        gs.stationary(BogdanovTakens()).cycle(saddle, "b1", 0.1)


@pytest.mark.parametrize("C_0", [1.0, 1e-6])
def test_a_cycle_is_the_same_in_any_unit_of_the_parameter(C_0: float) -> None:
    hopf = {"special": "hopf", "row": 0, "C": C_0, "x": 0.0, "y": 0.0}
    cycle = gs.stationary(Circuit(), C_0=C_0).cycle(hopf, "C", 0.1)
    np.testing.assert_allclose(cycle["C"], 0.99 * C_0)  # C_0 / C - 1 = |z|^2, to first order


@pytest.mark.slow
def test_lorenz() -> None:
    """From the rolls: the pitchfork at rho = 1, and the subcritical Hopf point."""
    start = [np.sqrt(8.0 / 3.0 * 19.0)] * 2 + [19.0]
    table = gs.stationary(Lorenz(), rho=20.0).continue_(start, "rho", (0.5, 30.0))
    rolls = specials(table)
    rolls = rolls.iloc[np.flatnonzero(rolls["x"] > -1.0)]
    assert rolls["special"].tolist() == ["hopf", "supercritical_pitchfork"]
    sigma, b = 10.0, 8.0 / 3.0
    expected = [sigma * (sigma + b + 3.0) / (sigma - b - 1.0), 1.0]
    np.testing.assert_allclose(rolls["rho"], expected, rtol=1e-9)
    hopf = rolls.iloc[0]
    np.testing.assert_allclose(
        hopf["hopf_frequency"], np.sqrt(2.0 * sigma * (sigma + 1.0) * b / (sigma - b - 1.0))
    )
    assert hopf["coefficient"] > 0.0


@pytest.mark.slow
def test_cycles_begin_at_a_hopf_point() -> None:
    """The return map's cycles shrink to it as the root of the distance."""
    A = 1.5
    rest = gs.stationary(Brusselator(), A=A)
    table = rest.continue_([A, 2.5 / A], "B", (2.0, 4.0), towards=1)
    (hopf,) = specials(table).to_dict("records")
    np.testing.assert_allclose([hopf["B"], hopf["hopf_frequency"]], [1.0 + A**2, A])
    np.testing.assert_allclose(hopf["coefficient"], -(2.0 + A**2) / (2.0 * A * (1.0 + 2.0 * A**2)))
    away = []
    for amplitude in (0.02, 0.04):
        guess = rest.cycle(hopf, "B", amplitude)
        cycles = gs.return_map(Brusselator(), A=A, B=guess["B"].iloc[0])
        start = guess.iloc[int(guess["x"].argmin())]
        cycle = cycles.fixed_points(cycles.settled({"x_0": start["x"], "y_0": start["y"]}, 1))
        assert cycle.converged.all()
        crossing = guess.iloc[int(np.argmin(np.abs(guess["x"] - A) + 9.0 * (np.gradient(guess["x"]) < 0.0)))]
        at = cycle.points.at[0]
        away.append(at[1] - guess["B"].iloc[0] / A)
        np.testing.assert_allclose(away[-1], crossing["y"] - guess["B"].iloc[0] / A, rtol=0.05)
        # it differs from 2 pi / A by 2e-5 and 8e-5 of it
        np.testing.assert_allclose(cycle.images.observed["time"], guess["period"].iloc[0], rtol=1e-6)
    # the distance in B grows with the square of the amplitude
    np.testing.assert_allclose(away[1] / away[0], 2.0, rtol=0.01)


def atlas(model: Any, **options: Any) -> gs.Atlas:
    return gs.atlas(model, stationary=True, settle=0, budget=64, batch=32, patience=1, verify=0, **options)


@pytest.mark.slow
def test_bogdanov_takens_point() -> None:
    """Fold: b1 = b2^2 / 4; Hopf: b1 = 0, b2 < 0; both end or pass at (0, 0)."""
    atlas_of = atlas(
        BogdanovTakens(), parameter="b1", path=(-0.6, 0.4), ranges={"x_0": (-1.0, 1.5), "y_0": (-0.5, 0.5)},
        at=-0.1, second={"b2": (-1.5, 1.0)},
    )  # fmt: skip
    assert set(atlas_of.gaits["gait"]) == {"rest"}
    assert set(atlas_of.points["special"]) == {"fold", "hopf"}
    curves = atlas_of.curves
    fold, hopf = (curves.iloc[np.flatnonzero(curves["part"] == kind)] for kind in ("fold", "hopf"))
    np.testing.assert_allclose(fold["b1"], fold["b2"] ** 2 / 4.0, atol=1e-8)
    np.testing.assert_allclose(hopf["b1"], 0.0, atol=1e-7)
    # The frequency goes to zero at the Bogdanov-Takens point; its square is linear there.
    np.testing.assert_allclose(hopf["hopf_frequency"] ** 2, -hopf["b2"], atol=1e-8)
    (special,) = specials(fold).to_dict("records")
    assert special["special"] == "bogdanov_takens"
    np.testing.assert_allclose([special["b1"], special["b2"]], 0.0, atol=1e-6)
    assert specials(hopf).empty
    assert "bogdanov_takens" in set(hopf["end"])


@pytest.mark.slow
def test_generalized_hopf_and_fold_hopf_points() -> None:
    """On m = 0 at n = 0, and on the fold p = 0 at m = 0; a neutral saddle at m = 2 - 2 is none."""
    ranges = {"x_0": (-0.1, 0.1), "y_0": (-0.1, 0.1), "u_0": (-2.0, 2.0), "v_0": (-0.1, 0.1)}
    over_n = atlas(Bautin(), parameter="m", path=(-0.5, 0.5), ranges=ranges, second={"n": (-1.0, 1.0)}).curves
    found = specials(over_n)
    assert set(over_n["part"]) == {"hopf"}
    assert set(found["special"]) == {"generalized_hopf"}
    np.testing.assert_allclose(found[["m", "n"]], 0.0, atol=1e-6)
    over_m = atlas(
        Bautin(), parameter="p", path=(-1.0, 0.5), ranges=ranges, second={"m": (-1.0, 1.0)}, n=-1.0
    )
    found = specials(over_m.curves)
    assert set(over_m.curves["part"]) == {"fold"}
    assert set(found["special"]) == {"fold_hopf"}
    np.testing.assert_allclose(found[["p", "m"]], 0.0, atol=1e-6)
    over_g = atlas(
        Bautin(), parameter="p", path=(-1.0, 0.5), ranges=ranges, second={"g": (-3.0, 3.0)}, n=-1.0
    )
    assert specials(over_g.curves).empty


@pytest.mark.slow
def test_folds_and_cusp() -> None:
    """27 r^2 = 4 a^3 of a flow with a clock, which need not rest."""
    found = atlas(
        CuspFlow(), parameter="r", path=(-2.0, 2.0), at=0.0, a=1.0, second={"a": (-1.0, 2.0)},
        ranges={"x_0": (-2.0, 2.0)}, without=["clock"],
    )  # fmt: skip
    assert set(found.curves["part"]) == {"fold"}
    np.testing.assert_allclose(27.0 * found.curves["r"] ** 2, 4.0 * found.curves["a"] ** 3, atol=1e-7)
    (cusp,) = specials(found.curves).to_dict("records")
    assert cusp["special"] == "cusp"
    np.testing.assert_allclose([cusp["r"], cusp["a"]], 0.0, atol=1e-5)
    np.testing.assert_allclose(found.curves["eigenvalue_re"], 0.0, atol=1e-6)


@pytest.mark.slow
def test_variables_that_never_rest() -> None:
    """A clock is refused, as is a place that no rate depends on, unless they are left out."""
    with pytest.raises(gs.ArgumentError, match=r"phase .* 3 rad/s.* `without`"):
        gs.stationary(Neuron()).fixed_points([0.1, 0.0, 0.0])
    with pytest.raises(gs.ArgumentError, match=r"place .* `without`"):
        gs.stationary(Neuron(), without=["phase"]).fixed_points([0.1, 0.0])
    with pytest.raises(gs.ArgumentError, match=r"phase"):
        repr(gs.stationary(Neuron(), without=["phaze"]))
    everything = gs.stationary(Neuron()).coordinates
    with pytest.raises(gs.ArgumentError, match="leaves out all variables"):
        gs.stationary(Neuron(), without=everything).fixed_points([])
    run = gs.Continuation(parameter="current", path=[0.4, 0.8], stationary=True)
    with pytest.raises(gs.JobError, match=r"run.stationary: phase"):
        gs.sweep(Neuron(), run=run)


@pytest.mark.slow
def test_events_end_a_branch() -> None:
    """A neuron is at rest at x = current only below its threshold; a branch ends there."""
    rest = gs.stationary(Neuron(), without=["phase", "place"], current=[0.4, 1.2])
    found = rest.fixed_points([[0.1], [0.1]])
    assert found.converged.tolist() == [True, False]
    table = gs.stationary(Neuron(), without=["phase", "place"]).continue_(
        [0.4], "current", (0.2, 1.5), towards=1
    )
    assert table["end"].iloc[-1] == "lost"
    np.testing.assert_allclose(table["current"].max(), 1.0, atol=1e-3)
