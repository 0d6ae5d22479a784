"""Declared maps and models with explicit time, beside closed forms."""

from __future__ import annotations

import re
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

import gaitsweep as gs
from gaitsweep.claims.measures import defaults
from gaitsweep.dynamics.mjx import against_c
from gaitsweep.engine.poincare.return_map import BatchedReturnMap
from gaitsweep.examples.duffing import Duffing
from gaitsweep.examples.henon import Henon
from gaitsweep.models.conformity import fault
from gaitsweep.models.sampled_points import sampled_points
from gaitsweep.status import Status


class Logistic(gs.MapModel):
    r = gs.parameter("1", "rate of growth", 3.2)
    x = gs.variable("1", "population", 0.3)

    def image(self, p: Any, s: Any) -> dict[str, Any]:
        return {"x": p.r * s.x * (1.0 - s.x)}


class Turn(gs.MapModel):
    """A rotation of the plane, which keeps the square of the distance."""

    angle = gs.parameter("rad", "angle of a turn", 0.7)
    x = gs.variable("1", "abscissa", 1.0)
    y = gs.variable("1", "ordinate", 0.0)
    turns = gs.mode(0, "turns so far")

    def image(self, p: Any, s: Any) -> dict[str, Any]:
        c, sine = jnp.cos(p.angle), jnp.sin(p.angle)
        return {"x": c * s.x - sine * s.y, "y": sine * s.x + c * s.y, "turns": s.turns + 1}

    @gs.energy("1", "square of the distance", conserved=True)
    def distance(self, p: Any, s: Any) -> Any:
        return s.x**2 + s.y**2

    @gs.symmetry("half a turn")
    def opposite(self, p: Any, s: Any) -> Any:
        return s.replace(x=-s.x, y=-s.y)


class StandardMap(gs.MapModel):
    K = gs.parameter("1", "strength of a kick", 0.9)
    angle = gs.variable("rad", "angle", 1.0, circular=True)
    rate = gs.variable("rad", "change of the angle", 0.3)

    def image(self, p: Any, s: Any) -> dict[str, Any]:
        angle = s.angle + s.rate
        return {"angle": angle, "rate": s.rate + p.K * jnp.sin(angle)}


class KickedRotor(gs.DeclaredModel):
    K = gs.parameter("rad/s", "strength of a kick", 0.9)
    T = gs.parameter("s", "time between kicks", 1.0)
    t = gs.time()
    angle = gs.variable("rad", "angle", 1.0, circular=True)
    rate = gs.variable("rad/s", "rate of the angle", 0.3)
    kick = gs.instants("kick", every=lambda p: p.T, section=True)

    def flow(self, p: Any, s: Any) -> dict[str, Any]:
        return {"t": 1.0, "angle": s.rate}

    @kick.jump
    def kicked(self, p: Any, s: Any) -> Any:
        return s.replace(rate=s.rate + p.K * jnp.sin(s.angle))

    def period(self, p: Any) -> Any:
        return p.T


@pytest.mark.parametrize("engine", ["kernel", "xla"])
def test_crossings_are_the_applications(engine: str) -> None:
    run = gs.ReturnMap(crossings=40)
    table = gs.sweep(Henon(), run=run, engine=engine).table.query("crossing > 0")
    x, y, expected = 0.1, 0.1, []
    for _ in range(40):
        x, y = 1.0 - 1.4 * x**2 + y, 0.3 * x
        expected.append((x, y))
    np.testing.assert_array_equal(table["t"], table["crossing"])
    # 40 applications grow errors of rounding by e^(0.42 * 40)
    np.testing.assert_allclose(table[["x_n", "y_n"]].to_numpy(), expected, atol=1e-7)


def test_orbits_settle_with_their_period_and_escapes_diverge() -> None:
    table = gs.sweep(Logistic(), r=[0.5, 2.8, 3.2, 3.5, 4.1], run=gs.Settle(max_cycles=400)).table
    assert table["attractor_period"].tolist() == [1, 1, 2, 4, 0]
    assert table["status"].tolist() == ["settled"] * 4 + ["diverged"]


def test_derivatives_and_fixed_points_are_exact() -> None:
    fixed = (-(1.0 - 0.3) + np.sqrt((1.0 - 0.3) ** 2 + 4.0 * 1.4)) / (2.0 * 1.4)
    mapping = gs.return_map(Henon())
    point = mapping.fixed_points([0.6, 0.2])
    np.testing.assert_allclose(point.points.at, [[fixed, 0.3 * fixed]], atol=1e-12)
    np.testing.assert_allclose(mapping.jacobian(point)[0], [[-2.8 * fixed, 1.0], [0.3, 0.0]], atol=1e-12)
    assert mapping.events(point) == [[]]


@pytest.mark.slow
def test_an_atlas_finds_the_flips_of_the_logistic_map() -> None:
    """At r = 3 and 1 + sqrt 6."""
    atlas = gs.atlas(Logistic(), parameter="r", path=(2.5, 3.5), ranges={"x_0": (0.05, 1.0)}, depth=2)
    flips = atlas.table.query("special == 'flip'")["r"]
    np.testing.assert_allclose(sorted(set(flips.round(9))), [3.0, 1.0 + np.sqrt(6.0)], atol=1e-8)


@pytest.mark.slow
def test_conserved_quantities_and_symmetries_are_known() -> None:
    mapping = gs.return_map(Turn())
    assert mapping.conserved == ["distance"]
    points = mapping._points([3.0, 4.0])[0]
    assert mapping.mapping.linearised(points, {}).conserved_values.tolist() == [[25.0]]
    # a start by a formula has a value in a row alone, and needs none here
    shifted = type("Shifted", (Turn,), {"x": gs.variable("1", "abscissa", "2*angle")})
    shifted_mapping = gs.return_map(shifted()).mapping
    assert shifted_mapping.linearised(points, {}).conserved_values.tolist() == [[25.0]]
    # a point of the orbit of the mirrored point: its image
    np.testing.assert_allclose(mapping.mapping.mirrored(points, {})["opposite"].at, -mapping([[3.0, 4.0]]))
    np.testing.assert_allclose(shifted_mapping.mirrored(points, {})["opposite"].at, -mapping([[3.0, 4.0]]))


@pytest.mark.slow
def test_a_kicked_rotor_is_the_standard_map() -> None:
    """At T = 1 s, for 200 kicks: an orbit on a circle, along which errors grow with their number only."""
    run = gs.ReturnMap(crossings=200)
    numerics = {"rtol": 1e-12, "atol": 1e-13}
    exact = gs.sweep(StandardMap(), run=run, rate_0=0.3, angle_0=1.0).table.query("crossing > 0")
    kicked = gs.sweep(KickedRotor(), run=run, numerics=numerics).table.query("crossing > 0")
    np.testing.assert_allclose(kicked["t"], np.arange(1, 201), rtol=0, atol=1e-9)
    for name in ("angle_n", "rate_n"):
        np.testing.assert_allclose(kicked[name], exact[name], atol=1e-7)
    jacobians = [gs.return_map(model, K=2.0).jacobian([1.0, 0.3]) for model in (StandardMap(), KickedRotor())]
    np.testing.assert_allclose(jacobians[0], jacobians[1], atol=1e-9)


@pytest.mark.slow
def test_a_linear_oscillator_follows_its_drive() -> None:
    """The steady oscillation of x'' + d x' + x = f cos(omega t) at t = 0, and multipliers exp(-d T)."""

    class Linear(Duffing):
        name = "linear"

        def flow(self, p: Any, s: Any) -> dict[str, Any]:
            return {"t": 1.0, "x": s.v, "v": p.f * jnp.cos(p.omega * s.t) - p.d * s.v - s.x}

    mapping = gs.return_map(Linear(), omega=1.3, d=0.2, numerics={"rtol": 1e-11, "atol": 1e-12})
    assert mapping.coordinates == ["x", "v"]
    steady = 0.3 / (1.0 - 1.3**2 + 0.2j * 1.3)
    point = mapping.fixed_points([0.0, 0.0])
    np.testing.assert_allclose(point.points.at[0], [steady.real, (1.3j * steady).real], atol=1e-9)
    product = np.prod(mapping.multipliers(point))
    assert product.real == pytest.approx(np.exp(-0.2 * 2.0 * np.pi / 1.3), abs=1e-9)


@pytest.mark.slow
def test_single_instants_happen_once() -> None:
    class Pushed(gs.DeclaredModel):
        push = gs.parameter("m/s", "first change of the velocity", 1.0)
        t = gs.time()
        v = gs.variable("m/s", "velocity", 0.0)
        pushes = gs.instants("push", at=(0.5, 1.75))
        strobe = gs.instants("strobe", every=lambda p: 1.0, after=0.25, section=True)

        def flow(self, p: Any, s: Any) -> dict[str, Any]:
            return {"t": 1.0, "v": 0.0 * s.v}

        @pushes.jump
        def pushed(self, p: Any, s: Any, i: int) -> Any:
            return s.replace(v=s.v + p.push * 10.0**i)

        def period(self, p: Any) -> Any:
            return jnp.ones(())

    table = gs.sweep(Pushed(), run=gs.ReturnMap(crossings=4)).table.query("crossing > 0")
    np.testing.assert_allclose(table["t"], [1.25, 2.25, 3.25, 4.25], atol=1e-9)
    assert table["v_n"].tolist() == [1.0, 11.0, 11.0, 11.0]


def test_what_a_map_cannot_have_is_refused() -> None:
    with pytest.raises(TypeError, match="falls, but a map has no event"):
        type("Falling", (Logistic,), {"falls": gs.event("falls", section=True)(lambda self, p, s: s.x)})
    with pytest.raises(TypeError, match="noise, but a map has no diffusion"):
        type("Noisy", (Logistic,), {"noise": gs.diffusion(lambda self, p, s: {"x": 0.1})})
    with pytest.raises(TypeError, match="either every= or at="):
        gs.instants("never")
    with pytest.raises(gs.JobError, match=r"numerics\.dt is set, but logistic is a map"):
        gs.sweep(Logistic(), numerics={"dt": 0.5})

    class Misspelt(Logistic):
        def image(self, p: Any, s: Any) -> dict[str, Any]:
            return {"xx": s.x}

    assert re.search("image returns a value of xx, .*did you mean x", str(fault(Misspelt())))

    class Timeless(Logistic):
        t = gs.time()

    assert "image returns no value of the time t" in str(fault(Timeless()))


def test_no_step_is_refined() -> None:
    """Rows of maps have no error of integration, so that no self-check reruns them."""
    table = gs.sweep(Logistic(), r=[2.8, 3.2], verify=2).table
    assert set(table["status"]) == {Status.settled.name}
    assert table.attrs["manifest"]["self_check"]["verdict"] == "off"


class TwoWells(gs.MapModel):
    """Wells at -1 and 1, in which y begins in units of `unit` at the place of x."""

    unit = gs.parameter("1", "sign of y at the start", -1.0)
    x = gs.variable("1", "place that decays", 0.3)
    y = gs.variable("1", "place that falls into a well", "unit * x_0", observed=True)

    def image(self, p, s):
        return {"x": 0.5 * s.x, "y": s.y + 0.25 * (s.y - s.y**3)}


@pytest.mark.slow
def test_drawn_starts_of_an_atlas_move_the_starts_that_follow_them() -> None:
    """The formula has the drawn start, and the value of the parameter at which gaits are searched."""
    atlas = gs.atlas(
        TwoWells(), parameter="unit", path=(-1.0, 1.0), at=1.0, ranges={"x_0": (0.1, 1.4)}, batch=8, budget=8
    )
    gaits = atlas.table[atlas.table["found"] >= 0].groupby("y_n")["reached"].first()
    np.testing.assert_allclose(gaits.loc[gaits > 0.0].to_numpy(), [1.0])
    np.testing.assert_allclose(gaits.loc[gaits > 0.0].index, [1.0])


class LaterFirst(gs.MapModel):
    """Formulas of quantities that are declared later."""

    a = gs.parameter("1", "twice c", "2 * c")
    c = gs.parameter("1", "twice b", "2 * b")
    b = gs.parameter("1", "number", 0.5)
    x = gs.variable("1", "place", "y_0 + a")
    y = gs.variable("1", "other place", "2 * z_0")
    z = gs.variable("1", "third place", 3.0)

    def image(self, p, s):
        return {"x": p.a * s.x, "y": s.y, "z": s.z}


def test_defaults_may_use_quantities_that_are_declared_later() -> None:
    """As `check-model`, claims, the comparison of an MJCF with MuJoCo C and return maps read them."""
    parameters, starts = sampled_points(LaterFirst(), 3)
    np.testing.assert_allclose(parameters["a"], 4.0 * parameters["b"])
    np.testing.assert_allclose(starts["x_0"], starts["y_0"] + parameters["a"])
    assert defaults(LaterFirst().parameters) == {"a": 2.0, "c": 1.0, "b": 0.5}
    values = against_c._defaults(LaterFirst().parameters, {})
    of_starts = against_c._defaults(LaterFirst().initial_conditions, values)
    assert of_starts == {"x_0": 8.0, "y_0": 6.0, "z_0": 3.0}
    mapping = BatchedReturnMap(LaterFirst())
    points, _ = mapping.settled({"z_0": np.array([3.0, 4.0])}, {"b": np.array([0.5, 1.0])}, 0)
    np.testing.assert_allclose(points.at, [[8.0, 6.0, 3.0], [12.0, 8.0, 4.0]])
