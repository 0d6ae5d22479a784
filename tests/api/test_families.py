"""Families of gaits of a model that conserves its energy, against a quadrature."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import quad

import gaitsweep as gs
from gaitsweep.analysis.continuation.newton import newton
from gaitsweep.examples.slip_runner import SlipRunner
from gaitsweep.examples.spring_mass_walker import SpringMassWalker
from gaitsweep.kinds import RUN_KINDS
from gaitsweep.kinds.columns import quantities_of

OMEGA = 1.7


class TwoSprings(gs.DeclaredModel):
    """A body on a spring that stiffens, and another on a linear spring; the section is x = 0, upwards."""

    section_coordinates = ("v", "u", "w")

    omega = gs.parameter("rad/s", "frequency of the second body", OMEGA, low=0.0)

    x = gs.variable("m", "place of the first body")
    v = gs.variable("m/s", "speed of the first body", 1.0, observed=True)
    u = gs.variable("m", "place of the second body")
    w = gs.variable("m/s", "speed of the second body")

    def flow(self, p, s):
        return {"x": s.v, "v": -s.x - s.x**3, "u": s.w, "w": -(p.omega**2) * s.u}

    @gs.event("first body passes", section=True)
    def passing(self, p, s):
        return s.x

    @gs.energy("J/kg", "energy of both", conserved=True)
    def energy(self, p, s):
        first = 0.5 * s.v**2 + 0.5 * s.x**2 + 0.25 * s.x**4
        return first + 0.5 * s.w**2 + 0.5 * p.omega**2 * s.u**2

    def complete(self, p, s):
        return s.replace(x=0.0)

    def period(self, p):
        return jnp.asarray(2.0 * np.pi)


def period(energy: float) -> float:
    """4 times the time from 0 to the turning point, with x = top sin(a)."""
    top = np.sqrt(np.sqrt(1.0 + 4.0 * energy) - 1.0)
    return 4.0 * quad(lambda a: 1.0 / np.sqrt(1.0 + 0.5 * top**2 * (1.0 + np.sin(a) ** 2)), 0.0, np.pi / 2)[0]


@pytest.mark.slow
def test_a_family_is_followed_along_its_energy() -> None:
    """V = sqrt(2 E), the period is the quadrature's, and the second body turns by omega T in a cycle."""
    mapping = gs.return_map(TwoSprings(), numerics={"rtol": 1e-11, "atol": 1e-12})
    assert mapping.conserved == ["energy"]
    table = mapping.continue_([1.0, 0.0, 0.0], "energy", (0.2, 3.0))
    energy = table["energy"].to_numpy(float)
    assert energy.min() == 0.2
    assert energy.max() == 3.0
    np.testing.assert_allclose(table["v"], np.sqrt(2.0 * energy), atol=1e-8)
    exact = np.array([period(each) for each in energy])
    np.testing.assert_allclose(table["time"], exact, atol=1e-8)
    np.testing.assert_allclose(table["multiplier_re"], np.cos(OMEGA * exact), atol=1e-6)
    np.testing.assert_allclose(table["multiplier"], 1.0, atol=1e-6)
    assert np.all(np.abs(table["drift_energy"]) < 1e-8)
    described = table.attrs["quantities"]
    assert [name for name in table if not described.get(name, {}).get("meaning")] == ["direction"]
    assert {name: described[name]["unit"] for name in ("energy", "drift_energy", "time", "v")} == {
        "energy": "J/kg", "drift_energy": "J/kg", "time": "s", "v": "m/s",
    }  # fmt: skip


def test_what_a_cycle_adds_has_the_unit_of_what_is_held() -> None:
    model = TwoSprings()
    along: dict[str, Any] = {"parameter": "omega", "path": [1.7, 2.0], "fix": ["energy"]}
    runs = gs.Continuation(**along), RUN_KINDS["atlas"](**along, ranges={"v_0": [0.5, 1.0]})
    for run in runs:
        drift = quantities_of(model, run.all_columns(model))["drift_energy"]
        assert (drift["unit"], drift["meaning"]) == ("J/kg", "what a cycle adds to energy, which is held")


class FreeRunner(SlipRunner):
    """The spring-mass runner with its speed as a coordinate: the energy is not eliminated."""

    section_coordinates = ("z", "v_x")
    v_x = gs.variable("m/s", "forward speed", 5.0, observed=True)

    def complete(self, p: Any, s: Any) -> Any:
        return s.replace(x=0.0, v_z=0.0)

    @gs.energy("J", "energy", observed=True, conserved=True)
    def energy(self, p: Any, s: Any) -> Any:
        return 0.5 * p.m * (s.v_x**2 + s.v_z**2) + p.m * p.g * s.z


class FreeWalker(SpringMassWalker):
    """The spring-mass walker with its speed as a coordinate, in single support at the apex."""

    section_coordinates = ("x", "z", "v_x")
    v_x = gs.variable("m/s", "forward speed", 1.1, observed=True)

    def complete(self, p: Any, s: Any) -> Any:
        return s.replace(v_z=0.0, reach=0.0)

    @gs.energy("J", "energy", observed=True, conserved=True)
    def energy(self, p: Any, s: Any) -> Any:
        stored = 0.5 * p.k * (p.l0 - jnp.hypot(s.x, s.z)) ** 2
        return 0.5 * p.m * s.v_x**2 + p.m * p.g * s.z + stored


@pytest.mark.slow
def test_families_of_spring_legged_models_are_their_branches_over_the_energy() -> None:
    """Gaits along the conserved energy are those of the models that have the energy as a parameter."""
    numerics = {"rtol": 1e-11, "atol": 1e-12}
    free = gs.return_map(FreeRunner(), numerics=numerics)
    bound = gs.return_map(SlipRunner(), numerics=numerics)
    run = bound.fixed_points({"z_0": [0.95]})
    start = [run.points.at[0, 0], run.images.observed["v_x"][0]]
    family = free.continue_(start, "energy", (1770.0, 1800.0))
    assert [family["energy"].min(), family["energy"].max()] == [1770.0, 1800.0]
    speeds = np.sqrt(2.0 * (family["energy"].to_numpy(float) - 80.0 * 9.81) / 80.0)
    points = bound.settled({"z_0": family["z"].to_numpy(float)}, 0)
    gaits = newton(bound.mapping, points, {"speed": speeds})
    assert gaits.converged.all()
    np.testing.assert_allclose(gaits.points.at[:, 0], family["z"], atol=1e-7)

    free = gs.return_map(FreeWalker(), numerics=numerics)
    bound = gs.return_map(SpringMassWalker(), numerics=numerics)
    walk = bound.fixed_points(bound.settled({"z_0": 0.97}, 50))
    start = [*walk.points.at[0, :2], walk.images.observed["v_x"][0]]
    family = free.continue_(start, "energy", (814.0, 818.0))
    assert [family["energy"].min(), family["energy"].max()] == [814.0, 818.0]
    places = family[["x", "z"]].to_numpy(float)
    points = bound.settled({"x_0": places[:, 0], "z_0": places[:, 1]}, 0)
    gaits = newton(bound.mapping, points, {"E": family["energy"].to_numpy(float)})
    assert gaits.converged.all()
    np.testing.assert_allclose(gaits.points.at[:, :2], places, atol=1e-7)
    # the two models have the same multipliers, beside 1 along the family
    own = np.abs(np.linalg.eigvals(gaits.images.jacobian[:, :2, :2])).max(axis=1)
    np.testing.assert_allclose(family["multiplier"], own, atol=1e-5)
