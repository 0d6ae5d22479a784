"""Families of gaits of a model that conserves its energy, against a quadrature."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import quad

import gaitsweep as gs

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
